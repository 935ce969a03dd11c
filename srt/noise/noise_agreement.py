"""Agreement of readings at rest with the noise terms fitted to them, and of the parts of a record with one another.

The fitted terms give every discrete cosine coefficient of a record its variance λ. In each octave of frequency the mean
of c²/λ is one if the terms describe the readings, and the same in all parts of the record if the noise does not change.
A low-pass filter, interpolated samples and vibration contradict the first, a disturbance for some time the second. The
intervals of the terms then need not hold a value of the unit.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import fdtrc

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from srt.types import Array

FALSE_ALARM: Final = 0.01 / 6.0
"""Probability of a false contradiction of one channel: 1 % for the six of a log."""
LARGEST_RATIO: Final = 1.5
"""Ratio of two noise amplitudes that are not the same: a term is known from ± 50 % on."""
_FEWEST: Final = 32
"""Smallest number of coefficients of an octave: means of fewer scatter by nearly the square of the largest ratio."""
_QUARTERS: Final = ("first", "second", "third", "fourth")


class _Level(NamedTuple):
    """Mean of c²/λ in an octave, and its number of coefficients (degrees of freedom)."""

    mean: float
    freedom: float


def contradiction(x: Array, dt: float, variance: Callable[[int], Array]) -> str | None:
    """Clause on the octave that contradicts most the fitted terms, or the same octave of another part; None without.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Readings at rest as rates, less their ramp.
    dt : float, s
    variance : callable
        Variance of the coefficients 1 to n − 1 of a record of n samples by the fitted terms.
    """
    compared = list(_compared(x, variance))
    found = []
    for number, octave, level, other in compared:
        ratio = level.mean / other.mean
        above = fdtrc(level.freedom, other.freedom, ratio)
        p = 2.0 * float(min(above, fdtrc(other.freedom, level.freedom, 1.0 / ratio)))
        if max(ratio, 1.0 / ratio) > LARGEST_RATIO**2 and p * len(compared) < FALSE_ALARM:
            high = 0.5 / dt / 2**octave
            where = f"the {_QUARTERS[number]} quarter of the window has" if number else "the window has"
            against = f"as in the {_QUARTERS[number - 1]}" if number else "as the fitted terms give"
            found.append((p, f"{where} {np.sqrt(ratio):.2g} times the noise at {0.5 * high:.2g} to {high:.2g} Hz "
                          f"{against}"))  # fmt: skip
    return min(found)[1] if found else None


def _compared(x: Array, variance: Callable[[int], Array]) -> Iterator[tuple[int, int, _Level, _Level]]:
    """Whole record against the terms (number 0), and each quarter from the second on against the one before it."""
    expected = _Level(1.0, 1e9)  # chi-square in the limit
    yield from ((0, octave, level, expected) for octave, level in enumerate(_levels(x, variance)))
    quarters = [_levels(part, variance) for part in np.array_split(x, len(_QUARTERS))]
    for number, (before, after) in enumerate(pairwise(quarters), start=1):
        for octave, (level, other) in enumerate(zip(after, before, strict=False)):
            yield number, octave, level, other


def _levels(x: Array, variance: Callable[[int], Array]) -> list[_Level]:
    """Octaves below the Nyquist frequency that have enough coefficients, the highest first."""
    from scipy.fft import dct

    n = len(x)
    power = np.asarray(dct(x - x.mean(), norm="ortho")[1:]) ** 2 / variance(n)
    borders = [n]
    while borders[-1] // 2 >= _FEWEST:
        borders.append(borders[-1] // 2)
    return [_Level(float(power[low - 1 : high - 1].mean()), high - low) for high, low in pairwise(borders)]
