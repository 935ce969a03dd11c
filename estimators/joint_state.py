"""State of the joint model, and the recorded data as compensated with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from estimators.bias_instability import BiasInstability
    from srt.sensor_errors import SensorErrors
    from srt.types import Array


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
        True for the frame of the fixture, whose heading L has; otherwise the first pose defines the heading.
    """

    earth_rate: Array
    unknown_sigma: Array
    fixture: bool


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """Estimate of all unknowns of the joint model, about which it is linearised.

    Attributes
    ----------
    errors : SensorErrors
        With the mean gyro bias of the recording.
    bias_deviation : ndarray, shape (K, 3), rad/s
        Gyro bias of each sequence less the mean one, raw channels.
    base, U : ndarray, shape (3, 3)
        True to nominal fixture base; T to MARS components.
    gravity : float
        Correction to the stated gravity, m/s².
    earth_rate : ndarray, shape (number of level frames, 3), rad/s
        Unknown part of the Earth's rate.
    attitude : ndarray, shape (W, 3, 3), or None
        Attitude of every window, B to L; None before the first iteration, which computes it from the data.
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
    """Compensated measurements of a recording, their Jacobians and their noise.

    Attributes
    ----------
    force, rate : ndarray, shape (W, 3)
        Compensated means of the windows, m/s² and rad/s; the rate without the bias deviation of its sequence.
    force_jacobian, rate_jacobian : ndarray, shape (W, 3, 27)
        Negative derivative of force and rate by the estimated errors.
    force_noise, rate_noise, rotation_noise : dict of str to ndarray, shape (W or K, 3, 3)
        Noise covariance by source.
    rate_slope : ndarray, shape (W, 3, 3)
        Inverse slope of the gyros' sensor model at rest: raw to compensated bias.
    rotation : ndarray, shape (K, 3, 3)
        Rotation between the windows against inertial space, B_End to B_Strt.
    rotation_jacobian : ndarray, shape (K, 3, 27)
        Derivative of its attitude error.
    duration_s : ndarray, shape (K,)
    edge_slope : ndarray, shape (3, 3), rad
        Compensated angle of a unit error of the raw angle at a window edge; zero where edges are no unknowns.
    instability : BiasInstability
        Effect of the bias instability on all measurements.
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
