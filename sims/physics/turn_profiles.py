"""Angle of a turn by hand or by a servo as a function of time: profiles of a rotation about a fixed axis.

With Θ the angle, T the duration and s = t/T:

- ``quintic``: θ = Θ (10 s³ − 15 s⁴ + 6 s⁵); rate and acceleration vanish at both ends;
- ``raised-cosine``: θ = Θ (1 − cos πs)/2; the rate vanishes at both ends, the acceleration is largest there;
- ``trapezoid``: constant acceleration over the first and the last fifth of T, constant rate between;
- ``constant-rate``: θ = Θ s; the rate jumps at both ends;
- ``recorded-hand``: the quintic with speed fluctuations of 1-3 Hz and a tremor of 8-12 Hz, which fade in and out with
  16 s² (1 − s)², as hand-turned recordings show them. Frequencies and phases are drawn for each turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, get_args

import numpy as np

from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.types import Array

ProfileName = Literal["quintic", "raised-cosine", "trapezoid", "constant-rate", "recorded-hand"]
"""Names of the profiles."""
_RAMP: Final = 0.2
"""Duration of each ramp of the trapezoid, as a share of the whole."""
_FLUCTUATION_HZ: Final = (1.0, 3.0)
"""Band of the speed fluctuations of a hand, Hz."""
_FLUCTUATION: Final = 0.15
"""Amplitude of each of the two components of the fluctuation, relative to the mean rate."""
_TREMOR_HZ: Final = (8.0, 12.0)
"""Band of the physiological tremor of a hand, Hz."""
_TREMOR_RAD_S: Final = 0.05
"""Amplitude of each of the two components of the tremor, rad/s: 1 mrad at 8 Hz."""


@dataclass(frozen=True, slots=True)
class TurnProfile:
    """Angle of a turn over its duration T.

    Attributes
    ----------
    evaluate : callable
        ``(Θ, s) -> (θ, dθ/ds)`` for an angle Θ (rad) and an array s from 0 to 1.
    peak : float
        Ratio of the largest rate to the mean rate Θ/T.
    bandwidth : float
        Highest angular frequency of the profile times T, rad; it determines the number of quadrature nodes.
    borders : tuple of float
        Values of s at which the formula changes.
    """

    evaluate: Callable[[float, Array], tuple[Array, Array]]
    peak: float
    bandwidth: float
    borders: tuple[float, ...] = ()


def _quintic(total: float, s: Array) -> tuple[Array, Array]:
    return total * s**3 * (10.0 + s * (6.0 * s - 15.0)), 30.0 * total * (s * (1.0 - s)) ** 2


def _raised_cosine(total: float, s: Array) -> tuple[Array, Array]:
    return 0.5 * total * (1.0 - np.cos(math.pi * s)), 0.5 * math.pi * total * np.sin(math.pi * s)


def trapezoid(ramp: float) -> TurnProfile:
    """Profile of constant acceleration over the share ``ramp`` of the duration at either end, at most a half."""

    def evaluate(total: float, s: Array) -> tuple[Array, Array]:
        peak = total / (1.0 - ramp)
        into, left = np.minimum(s, ramp), np.minimum(1.0 - s, ramp)
        ramps = 0.5 * (into**2 + ramp**2 - left**2) / ramp
        return peak * (ramps + np.clip(s - ramp, 0.0, 1.0 - 2.0 * ramp)), peak * np.minimum(into, left) / ramp

    return TurnProfile(evaluate, 1.0 / (1.0 - ramp), 12.0, (ramp, 1.0 - ramp) if ramp < 0.5 else (0.5,))


def _constant_rate(total: float, s: Array) -> tuple[Array, Array]:
    return total * s, np.full_like(s, total)


_PROFILES: Final = {
    # The quintic's bandwidth (12 rad) adds to that of the attitude.
    "quintic": TurnProfile(_quintic, 15.0 / 8.0, 12.0),
    "raised-cosine": TurnProfile(_raised_cosine, 0.5 * math.pi, math.pi),
    "trapezoid": trapezoid(_RAMP),
    "constant-rate": TurnProfile(_constant_rate, 1.0, 0.0),
}


def peak_factor(name: ProfileName) -> float:
    """Ratio of largest to mean rate of a profile; for "recorded-hand", that of the quintic.

    Raises
    ------
    InputError
        If the profile is unknown.
    """
    if name not in get_args(ProfileName):
        raise InputError(f"There is no turn profile {name!r}: the profiles are {', '.join(get_args(ProfileName))}.")
    return _PROFILES["quintic" if name == "recorded-hand" else name].peak


def turn_profile(
    name: ProfileName, total_rad: float, duration_s: float, rng: np.random.Generator | None = None
) -> TurnProfile:
    """Profile of one turn.

    Parameters
    ----------
    name : str
    total_rad, duration_s : float
        Angle and duration of the turn, positive.
    rng : numpy.random.Generator, optional
        Required for "recorded-hand".

    Raises
    ------
    InputError
        If the profile is unknown, or ``rng`` is missing for "recorded-hand".
    """
    peak_factor(name)
    if name != "recorded-hand":
        return _PROFILES[name]
    if rng is None:
        raise InputError("The profile 'recorded-hand' is random: pass a numpy.random.Generator.")
    frequency = 2.0 * math.pi * np.concatenate([rng.uniform(*_FLUCTUATION_HZ, 2), rng.uniform(*_TREMOR_HZ, 2)])
    phase = rng.uniform(0.0, 2.0 * math.pi, 4)
    # Rate amplitudes converted to angle amplitudes, divided by Θ.
    rate = np.array([_FLUCTUATION * total_rad / duration_s] * 2 + [_TREMOR_RAD_S] * 2)
    size = rate / frequency / total_rad
    turns = frequency * duration_s  # phase over the whole turn, rad

    def hand(total: float, s: Array) -> tuple[Array, Array]:
        angle, slope = _quintic(total, s)
        argument = s[..., np.newaxis] * turns + phase
        fade, fade_slope = 16.0 * (s * (1.0 - s)) ** 2, 32.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
        sine, cosine = np.sin(argument) @ size, np.cos(argument) @ (size * turns)
        return angle + total * fade * sine, slope + total * (fade_slope * sine + fade * cosine)

    peak = 15.0 / 8.0 + float(size @ turns) + 6.2 * float(size.sum())  # 6.2: largest slope of the fading, 16·2·√3/9
    return TurnProfile(hand, peak, 12.0 + float(turns.max()))
