"""True integrals of a motion: the readings of an IMU without errors, for any number of read-outs.

One :class:`TrueMotion` serves any number of read-outs with other sensor errors and noise
(:func:`sims.physics.imu.read_out`). Time stamps are the ends of the sample intervals, ``start + (k + 1) / rate``
with k the sample's number on one common clock, which skips where samples were not recorded.
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
    """Per-sample integrals of the true rate and specific force in B, and what is known of the run.

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
        Times of the still windows before and after each turn, s; on sample edges.
    attitudes : ndarray, shape (w, 2, 3, 3)
        True C_NED,B at the end of each of these windows.
    labels : tuple of SequenceLabel
        Empty for a free recording.
    site : Site
    fixture : Fixture or None
        As the recording will state it; None for a free recording.
    U : ndarray, shape (3, 3)
        From table-mounted components T to B.
    draw : FixtureDraw or None
        The fixture errors in force.
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
        """Change what recordings made from this motion state of site or fixture."""
        return replace(self, site=site or self.site, fixture=fixture or self.fixture)


@dataclass(slots=True)
class Clock:
    """Collects recorded episodes on a common sample clock.

    Attributes
    ----------
    sample_rate_hz : float
    start_s : float
        Time at which the first sample's interval begins.
    now : int
        Number of sample intervals gone by.
    """

    sample_rate_hz: float
    start_s: float
    now: int
    episodes: list[Episode]
    numbers: list[Counts]

    @classmethod
    def start(cls, sample_rate_hz: float, start_s: float) -> Clock:
        """Start a clock with nothing recorded."""
        return cls(sample_rate_hz, start_s, 0, [], [])

    @property
    def interval(self) -> float:
        """Sample interval, s."""
        return 1.0 / self.sample_rate_hz

    def samples(self, duration_s: float) -> int:
        """Whole samples that cover a duration, forgiving its rounding."""
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
        """Time stamps, first sample of each gapless piece, and the integrals of everything recorded."""
        numbers = np.concatenate(self.numbers)
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 2) > 1)
        time = np.asarray(self.start_s + (numbers + 1) / self.sample_rate_hz, dtype=np.float64)
        return time, starts, integrate(self.episodes, self.interval)
