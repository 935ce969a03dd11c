"""True integrals of a motion: the readings of an IMU without errors.

One :class:`TrueMotion` can be read out (:func:`sims.physics.imu.read_out`) any number of times with different sensor
errors and noise. Time stamps are the ends of the sample intervals, ``start + (k + 1) / rate``; k counts all sample
intervals, including those not recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sims.physics.integrals import Pieces, integrate
from srt.recording.recording import Recording

if TYPE_CHECKING:
    from sims.physics.fixture import FixtureDraw
    from srt.recording.recording import Fixture, SequenceLabel, Site
    from srt.types import Array, Indices


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """Per-sample integrals of the true rate and specific force in B, with labels, site and fixture of the run.

    Attributes
    ----------
    time : ndarray, shape (n,), s
        Ends of the sample intervals.
    interval : float
        Sample interval, s.
    piece_starts : ndarray of int, shape (p,)
        First sample of each gapless piece.
    angle, angle_abs : ndarray, shape (n, 3), rad
        ∫ω dt and ∫|ω| dt; ω is the rate relative to inertial space.
    velocity, velocity_abs : ndarray, shape (n, 3), m/s
        ∫f dt and ∫|f| dt.
    windows : tuple of ((start, end), (start, end))
        Times of the still windows before and after each turn, s; their limits are sample edges.
    attitudes : ndarray, shape (w, 2, 3, 3)
        True C_NED,B at the end of each of these windows.
    labels : tuple of SequenceLabel
        Empty for a free recording.
    site : Site
    fixture : Fixture or None
        Fixture that recordings state; None for a free recording.
    U : ndarray, shape (3, 3)
        Rotation from table-mounted components T to B.
    draw : FixtureDraw or None
        Fixture errors of this run.
    """

    time: Array
    interval: float
    piece_starts: Indices
    angle: Array
    angle_abs: Array
    velocity: Array
    velocity_abs: Array
    windows: tuple[tuple[tuple[float, float], tuple[float, float]], ...]
    attitudes: Array
    labels: tuple[SequenceLabel, ...]
    site: Site
    fixture: Fixture | None
    U: Array
    draw: FixtureDraw | None

    def stated_as(self, *, site: Site | None = None, fixture: Fixture | None = None) -> TrueMotion:
        """Return a copy whose recordings declare another site or fixture."""
        return replace(self, site=site or self.site, fixture=fixture or self.fixture)

    @cached_property
    def ideal(self) -> Recording:
        """Increments of an IMU without errors; all its recordings have stamps and labels in common, checked once."""
        return Recording(
            self.time,
            self.angle,
            self.velocity,
            self.site,
            "increment",
            self.fixture,
            sequences=self.labels,
            source="simulated",
        )


@dataclass(slots=True)
class Clock:
    """Sample clock, and what is recorded on it.

    Attributes
    ----------
    sample_rate_hz : float
    start_s : float
        Time at which the first sample's interval begins.
    now : int
        Number of sample intervals so far.
    """

    sample_rate_hz: float
    start_s: float
    now: int = 0
    _recorded: list[tuple[Pieces, Indices]] = field(default_factory=list)

    @property
    def interval(self) -> float:
        """Sample interval, s."""
        return 1.0 / self.sample_rate_hz

    def samples(self, duration_s: Array | float) -> Indices:
        """Number of whole samples that cover a duration, with a tolerance of 1e-6 sample."""
        return np.ceil(np.multiply(duration_s, self.sample_rate_hz) - 1e-6).astype(np.intp)

    def at(self, sample: Indices | int) -> Array:
        """Time of a sample edge, s."""
        return np.asarray(self.start_s + np.divide(sample, self.sample_rate_hz))

    def record(self, pieces: Pieces, numbers: Indices) -> None:
        """Record pieces of a motion at these numbers of sample intervals."""
        self._recorded.append((pieces, numbers))
        self.now = int(numbers[-1]) + 1

    def stack(self) -> tuple[Array, Indices, tuple[Array, Array, Array, Array]]:
        """Time stamps, first sample of each gapless piece, and the four integrals of all that is recorded."""
        numbers = np.concatenate([numbers for _, numbers in self._recorded])
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 2) > 1)
        parts = [integrate(pieces, self.interval) for pieces, _ in self._recorded]
        total = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        (angle, velocity), (angle_abs, velocity_abs) = np.moveaxis(total.reshape(2, 3, 2, -1), 1, -1)
        return self.at(numbers + 1), starts, (angle, angle_abs, velocity, velocity_abs)
