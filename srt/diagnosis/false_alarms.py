"""False alarms: the probability that all checks share, and the limit of a statistic that it gives.

All checks together report a fault in at most 1e-4 of the recordings without faults. 20 tests at :data:`FALSE_ALARM` add
up to 6e-5: lost samples; repeated samples; truncation; spikes; lags; rotation, oscillation, bumps, creep, noise of
windows; settling; joined units; drift of scale factors; absent Earth rate, latitude and north; drift of bias; noise of
gyros and of accelerometers; moves that contradict a closed form. The detection of a drift in a calibration adds 2e-5,
clipping 1.4e-5 and vibration 4e-6. Not included are the test of an omitted asymmetry, which only runs with
the option that fixes it, and wrong scales, whose limit depends on what sound units are (``RARE`` of the scale causes).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from scipy.special import chdtri, fdtri, ndtri, stdtrit

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from srt.types import Array

Distribution = Literal["normal", "t", "chi-square", "F"]
"""Distribution of a statistic in recordings without the fault."""

FALSE_ALARM: Final = 3e-6
"""False-alarm probability of each statistical test, for one recording."""

_EXCEEDED: Final[Mapping[Distribution, Callable[..., Any]]] = {
    "normal": lambda p: -ndtri(p),
    "t": lambda p, n: -stdtrit(n, p),
    "chi-square": lambda p, n: chdtri(n, p),
    "F": lambda p, m, n: np.reciprocal(fdtri(n, m, p)),
}
"""Value that is exceeded with probability p, for the degrees of freedom."""


def limit(
    distribution: Distribution, *freedom: Any, tests: float = 1.0, both_sides: bool = False, shared: float = FALSE_ALARM
) -> Any:
    """Limit that a statistic exceeds in any of several tests with the false-alarm probability that they share.

    Parameters
    ----------
    distribution : Distribution
    freedom : float or ndarray
        Degrees of freedom: one of t and chi-square, two of F.
    tests : float
        Number of tests in one recording.
    both_sides : bool
        True if the statistic may exceed the limit in both directions.
    shared : float
        False-alarm probability of all of these tests.

    Returns
    -------
    float or ndarray
        With the shape of the degrees of freedom.
    """
    return _EXCEEDED[distribution](shared / ((2.0 if both_sides else 1.0) * tests), *freedom)


def robust_sigma(deviations: Array, axis: int | tuple[int, ...] | None = None, quantile: float = 0.5) -> Any:
    """Standard deviation of normal deviations from a quantile of their magnitudes, which few outliers hardly change."""
    return np.quantile(np.abs(deviations), quantile, axis=axis) / ndtri(0.5 + 0.5 * quantile)


def robust_freedom(count: float, quantile: float = 0.5) -> float:
    """Degrees of freedom of the square of :func:`robust_sigma`, from the asymptotic variance of a sample quantile."""
    z = float(ndtri(0.5 + 0.5 * quantile))
    return count * z**2 * math.exp(-(z**2)) / (math.pi * quantile * (1.0 - quantile))
