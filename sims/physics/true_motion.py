"""True integrals of a motion: the readings of an IMU without errors.

One :class:`TrueMotion` can be read out (:func:`sims.physics.imu.read_out`) any number of times with different sensor
errors and noise. Time stamps are the ends of the sample intervals, ``start + (k + 1) / rate``; k counts all sample
intervals, including those not recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sims.physics.integrals import Episode, Integrals, integrate

if TYPE_CHECKING:
    from sims.physics.fixture import FixtureDraw
    from srt.recording.recording import Fixture, SequenceLabel, Site
    from srt.types import Array, Counts, Indices


@dataclass(frozen=True, slots=True, eq=False)
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


@dataclass(slots=True)
class Clock:
    """Sample clock, and the recorded episodes on it.

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
    now: int
    episodes: list[Episode]
    numbers: list[Counts]

    @classmethod
    def start(cls, sample_rate_hz: float, start_s: float) -> Clock:
        """Start a clock without recorded episodes."""
        return cls(sample_rate_hz, start_s, 0, [], [])

    @property
    def interval(self) -> float:
        """Sample interval, s."""
        return 1.0 / self.sample_rate_hz

    def samples(self, duration_s: float) -> int:
        """Number of whole samples that cover a duration, with a tolerance of 1e-6 sample."""
        return int(np.ceil(duration_s * self.sample_rate_hz - 1e-6))

    def at(self, sample: int) -> float:
        """Time of a sample edge, s."""
        return float(self.start_s + sample / self.sample_rate_hz)

    def record(self, episode: Episode) -> None:
        """Append an episode."""
        self.episodes.append(episode)
        self.numbers.append(np.arange(self.now, self.now + episode.n_samples))
        self.now += episode.n_samples

    def stack(self) -> tuple[Array, Indices, Integrals]:
        """Time stamps, first sample of each gapless piece, and integrals of all recorded episodes."""
        numbers = np.concatenate(self.numbers)
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 2) > 1)
        time = np.asarray(self.start_s + (numbers + 1) / self.sample_rate_hz, dtype=np.float64)
        return time, starts, integrate(self.episodes, self.interval)
