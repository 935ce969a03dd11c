"""Angles of the two fixture axes as analytic functions of time.

Each leg is a rotation about one axis with a trapezoidal rate: a ramp of constant acceleration, a plateau at
the peak rate, and a ramp down. A leg that is too short for the peak rate has a triangular rate. Angles are
therefore piecewise quadratic. After each leg the axis can oscillate (ring)::

    δ(t) = 4 A sin(2πft) (exp(−t/τ) − exp(−2t/τ))

The maximum of its envelope is ``A``. δ and its rate are zero at the start, so that angle and rate are
continuous.

Time is counted from the start of each episode, not of the recording: the resolution of a double for the
time of day is too coarse for integrals exact to 1e-15 rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sims.physics.integrals import ranges
from srt.exceptions import InputError

if TYPE_CHECKING:
    from srt.types import Array, Indices

NEGLIGIBLE_RAD = 1e-17
"""A ringing ends when its envelope is below this, as the rounding error of the angle is larger."""


@dataclass(frozen=True, slots=True)
class RateProfile:
    """Rate profile of a fixture axis.

    Attributes
    ----------
    rate_rad_s : float
        Peak rate, rad/s.
    accel_rad_s2 : float
        Acceleration of the ramps, rad/s².
    settling_rad, settling_hz, settling_decay_s : float
        Amplitude A, frequency f and decay time τ of the ringing after each leg; amplitude 0: none.

    Raises
    ------
    InputError
        If a value is not a positive number (the amplitude may be zero).
    """

    rate_rad_s: float = 1.0
    accel_rad_s2: float = 10.0
    settling_rad: float = 0.0
    settling_hz: float = 8.0
    settling_decay_s: float = 0.1

    def __post_init__(self) -> None:
        positive = ("rate_rad_s", "accel_rad_s2", "settling_hz", "settling_decay_s")
        for name in positive:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"The motion's {name} is {value!r}: it must be a positive number.")
        if not (math.isfinite(self.settling_rad) and self.settling_rad >= 0.0):
            raise InputError(f"The motion's settling_rad is {self.settling_rad!r}: it must be zero or positive.")

    def ramp_and_plateau_s(self, angle_rad: Array) -> tuple[Array, Array]:
        """Durations of one ramp and of the plateau of legs of these angles, s."""
        size, ramp_s = np.abs(angle_rad), self.rate_rad_s / self.accel_rad_s2
        shorter = np.minimum(np.sqrt(size / self.accel_rad_s2), ramp_s)
        return shorter, np.maximum(size / self.rate_rad_s - ramp_s, 0.0)

    def duration_s(self, angle_rad: float) -> float:
        """Duration of a leg of this angle, s."""
        ramp_s, plateau_s = self.ramp_and_plateau_s(np.array(angle_rad))
        return float(2.0 * ramp_s + plateau_s)

    @property
    def settling_life_s(self) -> float:
        """Duration of the ringing until it is negligible, s."""
        ratio = 4.0 * self.settling_rad / NEGLIGIBLE_RAD
        return self.settling_decay_s * math.log(ratio) if ratio > 1.0 else 0.0

    def ringing(self, since_s: Array) -> tuple[Array, Array]:
        """Oscillation at times since its start, and its rate, rad and rad/s."""
        slow = np.exp(-since_s / self.settling_decay_s)
        w = 2.0 * math.pi * self.settling_hz
        sine = 4.0 * self.settling_rad * np.sin(w * since_s)
        cosine = 4.0 * self.settling_rad * np.cos(w * since_s)
        envelope, envelope_rate = slow - slow**2, (2.0 * slow**2 - slow) / self.settling_decay_s
        return sine * envelope, w * cosine * envelope + sine * envelope_rate


class Legs(NamedTuple):
    """Executed legs, shape (r,) each: episode, axis, and end as time since the start of the episode, s."""

    episode: Indices
    axis: Indices
    end_s: Array


@dataclass(frozen=True, slots=True, eq=False)
class AngleProfile:
    """Both fixture angles over the episodes of a run, in m pieces of one formula; every episode ends at rest.

    Attributes
    ----------
    episode : ndarray of int, shape (m,)
        Episode of each piece; the pieces are in the order of time.
    begin_s, end_s : ndarray, shape (m,), s
        Borders of the piece, as time since the start of its episode; the last of an episode ends at infinity.
    coefficients : ndarray, shape (2, 3, m)
        Quadratic of each axis in the time since the piece's border, lowest power first, rad, rad/s, rad/s².
    progress : ndarray, shape (2, m)
        Time for which the episode's legs turned before the piece, over that of all its legs, and the rate of this
        share in the piece, 1/s.
    legs : Legs
    legs_end_s : ndarray, shape (e,), s
        End of the last leg of every episode.
    profile : RateProfile
    ringing_axis : ndarray of int, shape (j, m)
        Axis that each of the oscillations of a piece is about; -1 for none.
    ringing_start_s : ndarray, shape (j, m), s
        Its start, as time since the start of the episode; negative for one that began in an earlier episode.
    """

    episode: Indices
    begin_s: Array
    end_s: Array
    coefficients: Array
    progress: Array
    legs: Legs
    legs_end_s: Array
    profile: RateProfile
    ringing_axis: Indices
    ringing_start_s: Array

    @property
    def bandwidth_rad_s(self) -> float:
        """Highest angular frequency in functions of the attitude, rad/s; determines the number of quadrature nodes."""
        turning = self.profile.rate_rad_s + math.sqrt(self.profile.accel_rad_s2)
        if not len(self.ringing_axis):
            return turning
        return turning + 2.0 * math.pi * self.profile.settling_hz + 2.0 / self.profile.settling_decay_s

    @property
    def kind(self) -> Indices:
        """Axes that move in each piece, shape (m,): 0 none, 1 inner, 2 outer, 3 both."""
        turns = np.any(self.coefficients[:, 1:], axis=1)
        inner, outer = (turns[axis] | np.any(self.ringing_axis == axis, axis=0) for axis in (0, 1))
        return np.asarray(inner + 2 * outer)

    def angle(self, axis: int, piece: Indices, time_s: Array) -> tuple[Array, Array]:
        """Angle of one axis and its rate, rad and rad/s.

        Parameters
        ----------
        axis : int
            0 inner, 1 outer.
        piece : ndarray of int, shape (k,)
        time_s : ndarray, shape (n, k), s
            Time since the start of the episode.

        Returns
        -------
        angle, rate : ndarray, shape (n, k), or (k,) if the axis rests in all of the pieces
        """
        angle, rate, half_accel = self.coefficients[axis][:, piece]
        if rate.any() or half_accel.any():
            since = time_s - self.begin_s[piece]
            angle, rate = angle + since * (rate + since * half_accel), rate + since * (2.0 * half_accel)
        for of, start_s in zip(self.ringing_axis[:, piece], self.ringing_start_s[:, piece], strict=True):
            rings = of == axis
            if rings.any():
                swing, swing_rate = self.profile.ringing(time_s - start_s)
                angle, rate = angle + np.where(rings, swing, 0.0), rate + np.where(rings, swing_rate, 0.0)
        return angle, rate

    def with_ringings(self, first_sample: Indices, interval_s: float) -> AngleProfile:
        """Profile in which every leg is followed by its oscillation, also in later episodes.

        ``first_sample``, shape (e,), is the number of the sample interval with which each episode begins.
        """
        life_s = self.profile.settling_life_s
        if life_s == 0.0:
            return self
        starts_s, began = first_sample * interval_s, first_sample[self.legs.episode]
        last = np.searchsorted(starts_s, began * interval_s + self.legs.end_s + life_s)
        leg, episode = ranges(self.legs.episode, last)
        start_s = self.legs.end_s[leg] + (began[leg] - first_sample[episode]) * interval_s
        episodes = np.concatenate([self.episode, episode, episode])
        borders = np.concatenate([self.begin_s, np.maximum(start_s, 0.0), start_s + life_s])
        is_piece = np.arange(len(borders)) < len(self.episode)
        order = np.lexsort((~is_piece, borders, episodes))
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        began_at, ended_at = np.split(place[len(self.episode) :], 2)
        split = self._divided(episodes[order], borders[order], np.cumsum(is_piece[order]) - 1)
        ringing, piece = ranges(began_at, ended_at)
        # Oscillations of one piece, in any order, one below the other
        by_piece = np.argsort(piece, kind="stable")
        ringing, piece = ringing[by_piece], piece[by_piece]
        row = np.arange(len(piece)) - np.searchsorted(piece, piece)
        axes = np.full((row.max(initial=-1) + 1, len(order)), -1)
        starts = np.zeros(axes.shape)
        axes[row, piece], starts[row, piece] = self.legs.axis[leg[ringing]], start_s[ringing]
        return replace(split, ringing_axis=axes, ringing_start_s=starts)

    def _divided(self, episode: Indices, begin_s: Array, old: Indices) -> AngleProfile:
        """Profile with pieces from other borders, each within the piece ``old``."""
        since, c, progress = begin_s - self.begin_s[old], self.coefficients[..., old], self.progress[:, old]
        return replace(
            self,
            episode=episode,
            begin_s=begin_s,
            end_s=np.where(np.diff(episode, append=-1) == 0, np.append(begin_s[1:], math.inf), math.inf),
            coefficients=np.stack(
                [c[:, 0] + since * (c[:, 1] + since * c[:, 2]), c[:, 1] + 2.0 * since * c[:, 2], c[:, 2]], axis=1
            ),
            progress=np.stack([progress[0] + since * progress[1], progress[1]]),
        )


def angle_profile(
    start_rad: Array, axis: Indices, turn_rad: Array, profile: RateProfile, *, rest_s: Array | float = 0.0
) -> AngleProfile:
    """Concatenate the legs of each of e episodes from time 0, with rest after the last.

    Parameters
    ----------
    start_rad : ndarray, shape (e, 2)
        Angles (inner, outer) at the start, rad.
    axis : ndarray of int, shape (e, l)
        Axis of each leg, 0 inner, 1 outer; one axis turns at a time.
    turn_rad : ndarray, shape (e, l)
        Angle of each leg, rad; 0 for none.
    profile : RateProfile
    rest_s : ndarray, shape (e, l), or float
        Rest before each leg, s.
    """
    episodes, count = turn_rad.shape
    steps = turn_rad[..., np.newaxis] * (axis[..., np.newaxis] == np.arange(2))
    reached = np.cumsum(np.concatenate([start_rad[:, np.newaxis], steps], axis=1), axis=1)

    ramp_s, plateau_s = profile.ramp_and_plateau_s(turn_rad)
    half = np.copysign(0.5 * profile.accel_rad_s2, turn_rad)
    ramp_rad = half * ramp_s**2
    # Four pieces of each leg: rest, ramp, plateau, ramp; then the rest of the episode
    durations = np.stack(np.broadcast_arrays(rest_s, ramp_s, plateau_s, ramp_s), axis=-1).reshape(episodes, -1)
    turned = np.zeros((3, episodes, count + 1, 4))
    turned[0, :, :-1, 2], turned[0, :, :-1, 3] = ramp_rad, turn_rad - ramp_rad
    turned[1, :, :-1, 2:] = (2.0 * half * ramp_s)[..., np.newaxis]
    turned[2, :, :-1, 1], turned[2, :, :-1, 3] = half, -half

    ends = np.cumsum(durations, axis=1)
    borders = np.concatenate([np.zeros((episodes, 1)), ends, np.full((episodes, 1), math.inf)], axis=1)
    spent = np.where(np.arange(4 * count) % 4 > 0, durations, 0.0)
    whole = np.maximum(spent.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    progress = np.zeros((2, episodes, 4 * count + 1))
    progress[0, :, 1:] = np.cumsum(spent, axis=1) / whole
    progress[1, :, :-1] = (spent > 0.0) / whole

    episode, place = np.nonzero(borders[:, 1:] > borders[:, :-1])
    leg, part = np.divmod(place, 4)
    coefficients, number = np.zeros((2, 3, len(episode))), np.arange(len(episode))
    coefficients[axis[episode, np.minimum(leg, count - 1)], :, number] = turned[:, episode, leg, part].T
    coefficients[:, 0] += reached[episode, leg].T
    of_leg, nth = np.nonzero(turn_rad)
    return AngleProfile(
        episode,
        borders[episode, place],
        borders[episode, place + 1],
        coefficients,
        progress[:, episode, place],
        Legs(of_leg, axis[of_leg, nth], ends[of_leg, 4 * nth + 3]),
        ends[:, -1],
        profile,
        np.zeros((0, len(episode)), dtype=np.intp),
        np.zeros((0, len(episode))),
    )
