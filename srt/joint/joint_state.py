"""State of the joint model, the choice of what it models, and the recorded data as compensated with a state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from srt.estimation.error_sources import NO_ERRORS

if TYPE_CHECKING:
    from srt.estimation.error_sources import Slopes, Source, UnmodelledErrors
    from srt.joint.drift import DriftStates, DriftTerms
    from srt.joint.stated_rates import StatedRates
    from srt.sensor_errors import SensorErrors
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask


@dataclass(frozen=True, slots=True, eq=False)
class LevelFrame:
    """Level frame L that the attitudes of some sequences refer to.

    Attributes
    ----------
    earth_rate : ndarray, shape (3,), rad/s
        Known part of the Earth's rate in L.
    unknown_sigma : ndarray, shape (3,), rad/s
        Standard deviation of the unknown part.
    fixture : bool
        True: L has the heading of the fixture; False: the first pose defines the heading of L.
    """

    earth_rate: Array
    unknown_sigma: Array
    fixture: bool


@dataclass(frozen=True, slots=True, eq=False)
class ModelChoice:
    """Choice of what is modelled besides the sensor errors, as residuals and estimates show it.

    Attributes
    ----------
    data : PreparedRecording
        Data with their noise model, bias instability and undersampled motion included.
    drift : DriftTerms
        Drift within the recording, and gyro g-sensitivity.
    bias_scatter, bias_step : ndarray, shape (3,), rad/s
        Standard deviations of the gyro biases of the sequences about their mean, and of their steps from one to the
        next.
    integrated : ndarray of bool, shape (W,)
        Windows over which the attitude is integrated, as the unit moved in them.
    admission : ndarray, shape (27,)
        A parameter counts as observed if its sigma is below a third of this.
    U_prior : ndarray, shape (3, 3)
        Prior mean of U.
    U_note : str
        Warning if that is not the stated mounting.
    unmodelled_sigma : UnmodelledErrors
        Unmodelled errors that are added to the noise.
    ends_tied : bool
        True if the angle between the fixture's axes is a measurement in end attitudes, too.
    """

    data: PreparedRecording
    drift: DriftTerms
    bias_scatter: Array
    bias_step: Array
    integrated: Mask
    admission: Array
    U_prior: Array
    U_note: str
    unmodelled_sigma: UnmodelledErrors = NO_ERRORS
    ends_tied: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """Estimate of all unknowns of the joint model, about which it is linearised.

    Attributes
    ----------
    errors : SensorErrors
        Sensor errors; the gyro bias is its mean over the sequences.
    bias_deviation : ndarray, shape (K, 3), rad/s
        Gyro bias of each sequence minus the mean bias, before compensation with M⁻¹ (sensor axes).
    base, U : ndarray, shape (3, 3)
        Rotation from true to nominal fixture base; rotation from T to MARS components.
    non_orthogonality : float
        Angle between inner and outer axis of the fixture less 90°, rad.
    gravity : float
        Correction to the stated gravity, m/s².
    earth_rate : ndarray, shape (number of level frames, 3), rad/s
        Unknown part of the Earth's rate.
    drift : ndarray, shape (n,)
        Coefficients of the forms of drift that are modelled, rad/s and m/s².
    attitude : ndarray, shape (W, 3, 3), or None
        Attitude of every window, B to L; None before the first iteration, which computes it from the data.
    table_rate : float
        Error of the stated rates of a rate table, in sigmas.
    """

    errors: SensorErrors
    bias_deviation: Array
    base: Array
    U: Array
    non_orthogonality: float
    gravity: float
    earth_rate: Array
    drift: Array
    attitude: Array | None = None
    table_rate: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CompensatedData:
    """Compensated measurements of a recording, their Jacobians and their noise.

    Attributes
    ----------
    force, rate : ndarray, shape (W, 3)
        Compensated means of the windows, m/s² and rad/s, the rate with the bias deviation of the sequence subtracted.
    force_jacobian, rate_jacobian : ndarray, shape (W, 3, 27)
        Negative derivative of force and rate with respect to the 27 sensor errors.
    force_noise, rate_noise, rotation_noise : dict of str to ndarray, shape (W or K, 3, 3)
        Noise covariance by source.
    rotation : ndarray, shape (K, 3, 3)
        Rotation between the windows against inertial space, B_End to B_Strt.
    rotation_jacobian : ndarray, shape (K, 3, 27)
        Derivative of the rotation's attitude error with respect to the 27 sensor errors.
    duration_s : ndarray, shape (K,)
    edges : Source
        Quantization of the angle; its shared unknowns, if it has any, are the errors at the window edges.
    slopes : Slopes
        Derivatives of force, rate and rotation with respect to errors of the raw channels.
    stated : StatedRates
        Runs at a stated rate.
    drift_form : dict of str to ndarray, shape (n, d, number of coefficients)
        Effect of the coefficients of the modelled drift on "force", "rate", "turn" and "stated_rate".
    drift : dict of str to DriftStates
        Effect of the bias instability on all measurements, by sensor ("gyro", "accel"), if specified.
    """

    force: Array
    rate: Array
    force_jacobian: Array
    rate_jacobian: Array
    force_noise: dict[str, Array]
    rate_noise: dict[str, Array]
    rotation_noise: dict[str, Array]
    rotation: Array
    rotation_jacobian: Array
    duration_s: Array
    edges: Source
    slopes: Slopes
    stated: StatedRates
    drift_form: dict[str, Array]
    drift: dict[str, DriftStates]
