"""A recording in memory: samples in SI units, and what is known of site, fixture, unit and sequences.

Conventions: a *rate* sample is the mean over the interval that ends at its time stamp, an *increment* sample the
integral over that interval. Specific force at rest points up.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np



if TYPE_CHECKING:
    from numpy.typing import NDArray

Kind = Literal["rate", "increment"]


@dataclass(frozen=True, slots=True)
class Site:
    """Where the recording was made.

    Attributes
    ----------
    gravity_m_s2 : float
        Plumb-bob gravity, m/s².
    gravity_sigma_m_s2 : float
        Its one-sigma uncertainty, a common error of the accelerometer scales.
    latitude_rad : float or None
        None: unknown; the Earth's rate is then a bounded unknown in the gyro-bias sigma.
    """

    gravity_m_s2: float
    gravity_sigma_m_s2: float = 5e-6
    latitude_rad: float | None = None


@dataclass(frozen=True, slots=True)
class Fixture:
    """The two-axis fixture and its accuracy (one sigma). Heading is that of the table x axis, clockwise from north.

    Attributes
    ----------
    heading_rad : float or None
        None: unknown (not zero).
    alignment_sigma_rad : float
        One draw per recording of each of: base level x, y, north; mounting x, y, z.
    rotation_sigma_rad : float
        One draw per executed rotation, the move to a start attitude included.
    """

    heading_rad: float | None = 0.0
    alignment_sigma_rad: float = 1e-3
    rotation_sigma_rad: float = 1e-3


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Stated noise of a unit; None means not stated, to be estimated from the stationary windows.

    Attributes
    ----------
    gyro_noise : float or None
        Angle random walk, rad/√s.
    accel_noise : float or None
        Velocity random walk, m/s²·√s (that is m/s/√s).
    gyro_quantization : float or None
        Angle per pulse, rad.
    accel_quantization : float or None
        Velocity per pulse, m/s.
    gyro_bias_instability, accel_bias_instability : float or None
        rad/s, m/s².
    gyro_range, accel_range : float or None
        Saturation, rad/s, m/s².
    """

    gyro_noise: float | None = None
    accel_noise: float | None = None
    gyro_quantization: float | None = None
    accel_quantization: float | None = None
    gyro_bias_instability: float | None = None
    accel_bias_instability: float | None = None
    gyro_range: float | None = None
    accel_range: float | None = None


@dataclass(frozen=True, slots=True)
class SequenceLabel:
    """One stillness-rotation-stillness piece of a recording.

    Attributes
    ----------
    start_static_s, end_static_s : (float, float)
        A window [a, b] holds the samples with a + dt/2 < t <= b + dt/2.
    id : str or None
        Name in Table 1 of Savage 2020 ("1" ... "14", "1a" ...); None for a free turn.
    down, along_outer : str or None
        For an id outside Table 1: the IMU axis ("x", "y", "z") that is down, and the one along the outer axis.
    rotations : tuple of (axis, angle in rad)
        For an id outside Table 1.
    """

    start_static_s: tuple[float, float]
    end_static_s: tuple[float, float]
    id: str | None = None
    down: str | None = None
    along_outer: str | None = None
    rotations: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Samples and what is known about them.

    Attributes
    ----------
    time : ndarray, shape (n,), s
        Time stamps, strictly increasing; sample i covers the ``interval`` that ends at ``time[i]``.
    gyro : ndarray, shape (n, 3)
        rad/s for kind "rate", rad for "increment".
    accel : ndarray, shape (n, 3)
        m/s² for "rate", m/s for "increment".
    site : Site
    kind : "rate" or "increment"
    fixture : Fixture or None
        None: no fixture, attitudes and heading unknown (a free recording).
    noise : ImuNoise
    sequences : tuple of SequenceLabel
        Empty: the recording is segmented automatically.
    sample_rate_hz : float or None
        Overrides the time stamps' spacing where given.
    temperature : ndarray, shape (n,), °C, or None
    serial, date, source : str or None
    data_sha256 : str or None
        Hash of the samples file.

    Raises
    ------
    InputError
        Shapes that disagree, values that are not finite, time that does not increase.
    """

    time: NDArray[np.float64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    site: Site
    kind: Kind = "rate"
    fixture: Fixture | None = None
    noise: ImuNoise = field(default_factory=ImuNoise)
    sequences: tuple[SequenceLabel, ...] = ()
    sample_rate_hz: float | None = None
    temperature: NDArray[np.float64] | None = None
    serial: str | None = None
    date: str | None = None
    source: str | None = None
    data_sha256: str | None = None

    def with_sequences(self, sequences: tuple[SequenceLabel, ...]) -> Recording:
        """The same samples with other sequence labels."""
        return replace(self, sequences=sequences)
