"""Values of the joint problem: what it is linearised at, and the recorded data played back there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from estimators.bias_instability import BiasInstability
    from srt.sensor_errors import SensorErrors
    from srt.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class LevelFrame:
    """Sequences whose attitudes are stated in one level frame L.

    Attributes
    ----------
    earth_rate : ndarray, shape (3,), rad/s
        What is known of the Earth's rate in L.
    unknown_sigma : ndarray, shape (3,), rad/s
        One sigma of what is not.
    fixture : bool
        Whether nominal attitudes and heading are those of the fixture; otherwise the heading is that of the first pose.
    """

    earth_rate: Array
    unknown_sigma: Array
    fixture: bool


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """Values that the problem is linearised at.

    Attributes
    ----------
    errors : SensorErrors
        With the gyro bias common to the recording.
    bias_deviation : ndarray, shape (K, 3), rad/s
        Bias of each sequence less the common one, raw channels.
    base, U : ndarray, shape (3, 3)
        True to nominal fixture base; T to MARS components.
    gravity : float
        Correction to the stated gravity, m/s².
    earth_rate : ndarray, shape (number of chains, 3), rad/s
        Unknown part of the Earth's rate.
    attitude : ndarray, shape (W, 3, 3)
        Of every window, B to L; filled in by the first linearisation.
    """

    errors: SensorErrors
    bias_deviation: Array
    base: Array
    U: Array
    gravity: float
    earth_rate: Array
    attitude: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CompensatedData:
    """The recorded data played back at a point: compensated measurements, and what the model needs around them.

    Attributes
    ----------
    force, rate : ndarray, shape (W, 3)
        Compensated means of the windows, m/s² and rad/s, the bias of the own sequence taken off.
    force_jacobian, rate_jacobian : ndarray, shape (W, 3, 27)
        Their derivative with respect to errors in the estimate, negative.
    force_noise, rate_noise, turned_noise : dict of str to ndarray, shape (W or K, 3, 3)
        Their noise covariance, source by source.
    rate_slope : ndarray, shape (W, 3, 3)
        Inverse slope of the gyros' reading model at rest: raw to compensated bias.
    turned : ndarray, shape (K, 3, 3)
        Rotation between the windows against inertial space, B_End to B_Strt.
    turned_jacobian : ndarray, shape (K, 3, 27)
        Derivative of its attitude error.
    duration_s : ndarray, shape (K,)
    edge_slope : ndarray, shape (3, 3), rad
        Compensated angle of a unit reading error at a window's edge; zero where these do not matter.
    drift : Drift
        What the stated bias instability adds to all of them.
    """

    force: Array
    rate: Array
    force_jacobian: Array
    rate_jacobian: Array
    force_noise: dict[str, Array]
    rate_noise: dict[str, Array]
    rotation_noise: dict[str, Array]
    rate_slope: Array
    rotation: Array
    rotation_jacobian: Array
    duration_s: Array
    edge_slope: Array
    instability: BiasInstability
