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
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.types import Array, Indices, Mask

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

    def ramp_and_plateau_s(self, angle_rad: float) -> tuple[float, float]:
        """Durations of one ramp and of the plateau for a leg of this angle, s."""
        size = abs(angle_rad)
        if size * self.accel_rad_s2 < self.rate_rad_s**2:
            return math.sqrt(size / self.accel_rad_s2), 0.0
        ramp_s = self.rate_rad_s / self.accel_rad_s2
        return ramp_s, size / self.rate_rad_s - ramp_s

    def duration_s(self, angle_rad: float) -> float:
        """Duration of a leg of this angle, s."""
        ramp_s, plateau_s = self.ramp_and_plateau_s(angle_rad)
        return 2.0 * ramp_s + plateau_s

    @property
    def settling_life_s(self) -> float:
        """Duration of the ringing until it is negligible, s."""
        ratio = 4.0 * self.settling_rad / NEGLIGIBLE_RAD
        return self.settling_decay_s * math.log(ratio) if ratio > 1.0 else 0.0


@dataclass(frozen=True, slots=True)
class Ringing:
    """Settling oscillation of one axis (0 inner, 1 outer) that begins at ``start_s`` of an episode."""

    axis: int
    start_s: float


@dataclass(frozen=True, slots=True, eq=False)
class AngleProfile:
    """Both fixture angles over one episode, which begins with a leg and ends at rest.

    Attributes
    ----------
    breaks_s : ndarray, shape (m + 1,), s
        Borders of the pieces, from 0; the last is infinite.
    coefficients : ndarray, shape (m, 2, 3)
        Quadratic of each axis in the time since the piece's border, lowest power first, rad, rad/s, rad/s².
    moving : ndarray of bool, shape (m,)
        False: both angles are constant.
    ringings : tuple of Ringing
    profile : RateProfile
    end_rad : (float, float)
        Angles (inner, outer) at rest after the last leg, rad.
    legs_end_s : float
        End of the last leg, s.
    """

    breaks_s: Array
    coefficients: Array
    moving: Mask
    ringings: tuple[Ringing, ...]
    profile: RateProfile
    end_rad: tuple[float, float]
    legs_end_s: float

    @property
    def bandwidth_rad_s(self) -> float:
        """Highest angular frequency in functions of the attitude, rad/s; determines the number of quadrature nodes."""
        turning = self.profile.rate_rad_s + math.sqrt(self.profile.accel_rad_s2)
        if not self.ringings:
            return turning
        return turning + 2.0 * math.pi * self.profile.settling_hz + 2.0 / self.profile.settling_decay_s

    def ramp(self, before: float, after: float) -> tuple[Array, float]:
        """Value that changes at a constant rate while an axis turns: as bearings do, it stays while both rest.

        Returns
        -------
        ramp : ndarray, shape (2, m)
            Value at the border of each piece, and its rate in the piece, 1/s.
        at_end : float
            ``after``; ``before`` in an episode without a rotation.
        """
        border = self.breaks_s[:-1]
        if before == after:
            return np.stack([np.full(len(border), before), np.zeros(len(border))]), before
        turning = np.any(self.coefficients[:, :, 1:], axis=(1, 2)) & (border < self.legs_end_s)
        spent = np.where(turning, np.diff(self.breaks_s), 0.0)
        if not turning.any():
            return np.stack([np.full(len(border), before), np.zeros(len(border))]), before
        slope = np.where(turning, (after - before) / spent.sum(), 0.0)
        at_border = before + np.concatenate([[0.0], np.cumsum(slope * spent)[:-1]])
        return np.stack([np.where(border >= self.legs_end_s, after, at_border), slope]), after

    def add_ringing(
        self,
        ringing: Ringing,
        piece: Indices,
        time_s: Array,
        angle: Array,
        rate: Array,
    ) -> None:
        """Add one oscillation, in place, to angles and rates of shape (k, n, 2)."""
        border = self.breaks_s[piece[:, 0]]
        rows = (border >= ringing.start_s) & (border < ringing.start_s + self.profile.settling_life_s)
        t = time_s[rows] - ringing.start_s
        slow = np.exp(-t / self.profile.settling_decay_s)
        w = 2.0 * math.pi * self.profile.settling_hz
        envelope = 4.0 * self.profile.settling_rad * (slow - slow**2)
        envelope_rate = 4.0 * self.profile.settling_rad * (2.0 * slow**2 - slow) / self.profile.settling_decay_s
        angle[rows, :, ringing.axis] += np.sin(w * t) * envelope
        rate[rows, :, ringing.axis] += w * np.cos(w * t) * envelope + np.sin(w * t) * envelope_rate


class JoinedProfile:
    """Profiles of many episodes with consecutive numbers of all pieces, so that one call evaluates all."""

    def __init__(self) -> None:
        self._profiles: list[AngleProfile] = []
        self._first: list[int] = [0]
        self._joined: tuple[Array, Array] | None = None

    def append(self, profile: AngleProfile) -> int:
        """Add the profile of an episode, and return the number of its first piece."""
        first = self._first[-1]
        self._profiles.append(profile)
        self._first.append(first + len(profile.moving))
        self._joined = None
        return first

    def since_border(self, piece: Indices, time_s: Array) -> Array:
        """Time since the border of each piece, s."""
        return np.asarray(time_s - self._pieces()[0][piece])

    def _pieces(self) -> tuple[Array, Array]:
        """Borders and coefficients of all pieces."""
        if self._joined is None:
            self._joined = (
                np.concatenate([p.breaks_s[:-1] for p in self._profiles]),
                np.concatenate([p.coefficients for p in self._profiles]),
            )
        return self._joined

    def angles(self, piece: Indices, time_s: Array) -> tuple[Array, Array]:
        """Angles and their rates.

        Parameters
        ----------
        piece : ndarray of int, shape (k, 1)
            Piece that each row of times belongs to.
        time_s : ndarray, shape (k, n), s
            Time since the start of the piece's episode.

        Returns
        -------
        angle, rate : ndarray, shape (k, n, 2), rad and rad/s
            Columns inner, outer.
        """
        breaks, coefficients = self._pieces()
        angle, rate = _polynomial(time_s - breaks[piece], coefficients[piece])
        for first, profile in zip(self._first, self._profiles, strict=False):
            if profile.ringings:
                rows = np.flatnonzero((piece[:, 0] >= first) & (piece[:, 0] < first + len(profile.moving)))
                part = angle[rows], rate[rows]
                for ringing in profile.ringings:
                    profile.add_ringing(ringing, piece[rows] - first, time_s[rows], *part)
                angle[rows], rate[rows] = part
        return angle, rate


def _polynomial(since: Array, coefficients: Array) -> tuple[Array, Array]:
    """Angles and rates, shape (k, n, 2) each, of quadratics (k, 1, 2, 3) at times (k, n) since the pieces' borders."""
    t, c = since[..., np.newaxis], coefficients
    return c[..., 0] + t * (c[..., 1] + t * c[..., 2]), c[..., 1] + 2.0 * t * c[..., 2]


def angle_profile(
    start_rad: tuple[float, float],
    legs: Sequence[tuple[int, float]],
    profile: RateProfile,
    *,
    leg_dwell_s: float = 0.0,
    ringings: tuple[Ringing, ...] = (),
) -> AngleProfile:
    """Concatenate legs from time 0, with rest after the last.

    Parameters
    ----------
    start_rad : (float, float)
        Angles (inner, outer) at the start, rad.
    legs : sequence of (axis, angle in rad)
        Axis 0 inner, 1 outer; one axis turns at a time.
    profile : RateProfile
    leg_dwell_s : float
        Rest between two legs, s.
    ringings : tuple of Ringing
        Oscillations that continue from earlier episodes; their start times are negative.
    """
    angles = np.array(start_rad)
    breaks: list[float] = []
    pieces: list[Array] = []
    moving: list[bool] = []
    now = 0.0
    active = list(ringings)

    def add(duration_s: float, axis: int, angle: float, rate: float, half_accel: float, *, turns: bool) -> None:
        nonlocal now
        if duration_s <= 0.0:
            return
        coefficients = np.zeros((2, 3))
        coefficients[:, 0] = angles
        coefficients[axis] = angle, rate, half_accel
        breaks.append(now)
        pieces.append(coefficients)
        moving.append(turns)
        now += duration_s

    for number, (axis, turn) in enumerate(legs):
        if number:
            add(leg_dwell_s, axis, angles[axis], 0.0, 0.0, turns=False)
        if turn == 0.0:
            continue
        ramp_s, plateau_s = profile.ramp_and_plateau_s(turn)
        half = math.copysign(0.5 * profile.accel_rad_s2, turn)
        peak = 2.0 * half * ramp_s
        begin, end = float(angles[axis]), float(angles[axis]) + turn
        ramp_angle = half * ramp_s**2
        add(ramp_s, axis, begin, 0.0, half, turns=True)
        add(plateau_s, axis, begin + ramp_angle, peak, 0.0, turns=True)
        add(ramp_s, axis, end - ramp_angle, peak, -half, turns=True)
        angles[axis] = end
        if profile.settling_rad > 0.0:
            active.append(Ringing(axis, now))
    legs_end = now
    add(math.inf, 0, angles[0], 0.0, 0.0, turns=False)
    result = AngleProfile(
        np.array([*breaks, math.inf]),
        np.array(pieces),
        np.array(moving),
        tuple(active),
        profile,
        (float(angles[0]), float(angles[1])),
        legs_end,
    )
    return _split_at_ringings(result) if active else result


def _split_at_ringings(profile: AngleProfile) -> AngleProfile:
    """Add borders at the start and end of each oscillation; pieces with an oscillation are moving."""
    starts = np.array([r.start_s for r in profile.ringings])
    ends = starts + profile.profile.settling_life_s
    borders = np.unique(np.concatenate([profile.breaks_s, starts[starts > 0.0], ends[ends > 0.0]]))
    old = np.searchsorted(profile.breaks_s, borders[:-1], side="right") - 1
    since = (borders[:-1] - profile.breaks_s[old])[:, np.newaxis]
    c = profile.coefficients[old].copy()
    c[..., 0] += since * (c[..., 1] + since * c[..., 2])
    c[..., 1] += 2.0 * since * c[..., 2]
    alive = (borders[:-1, np.newaxis] >= starts) & (borders[:-1, np.newaxis] < ends)
    return AngleProfile(
        borders,
        c,
        profile.moving[old] | alive.any(axis=1),
        profile.ringings,
        profile.profile,
        profile.end_rad,
        profile.legs_end_s,
    )
