"""Chi-square of the residuals: agreement of the measurements with each other and with the noise of the sensors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtrc, chdtri, fdtrc

from srt.estimation.white_residuals import WhiteResiduals
from srt.noise.drift_forms import likelihood_gain
from srt.ranking import significant
from srt.result.verdict import MISFIT_PROBABILITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.types import Array


CONTRADICTION_PROBABILITY: Final = 1e-4
"""p-value of all sequences or turns together, below which one contradicts the others."""
_ONE_FAULT: Final = 0.05
"""A group explains the misfit if the other measurements have a smaller share of chi-square than this.

The threshold is not zero because the linearisation about a gross fault is not exact.
"""
_APART: Final = 0.25
"""Share of its variance that an estimate gains in a direction in which it is compared with the efficient one."""


def chi_square(z: Array, H: Array, R: Array) -> tuple[float, int]:
    """Smallest weighted square sum of residuals over all values of the parameters, and its degrees of freedom.

    Parameters are those of :meth:`WhiteResiduals.of`, for a single unit.
    """
    if not H.shape[1]:
        return 0.0, 0
    try:
        return WhiteResiduals.of(z, H, R).test
    except np.linalg.LinAlgError:
        return 0.0, 0  # the status reports that failure


def chi_square_probability(statistic: float, freedom: int) -> float | None:
    """p-value of a chi-square; None without degrees of freedom."""
    return float(chdtrc(freedom, statistic)) if freedom > 0 else None


def specification_test(difference: Array, own: Array, other: Array) -> tuple[float, int]:
    """Chi-square of the difference of two estimates of one recording, and its degrees of freedom.

    The covariance of the difference is that of the estimate less that of an efficient one (Hausman, Econometrica 46,
    1978, section 2). Directions in which the two are nearly one estimate are left out: there the difference of the
    covariances is that of their noise.

    Parameters
    ----------
    difference : ndarray, shape (n,)
    own, other : ndarray, shape (n, n)
        Covariance of the estimate and of the efficient one.
    """
    sigma = np.sqrt(np.diag(own))
    values, vectors = np.linalg.eigh((own - other) / np.outer(sigma, sigma))
    apart = values > _APART
    return float(np.sum((vectors[:, apart].T @ (difference / sigma)) ** 2 / values[apart])), int(apart.sum())


def is_misfit(chi_square: float, degrees_of_freedom: int) -> bool:
    """Return True if noise alone makes the residuals this large with p < 1e-3."""
    return degrees_of_freedom > 0 and chi_square > float(chdtri(degrees_of_freedom, MISFIT_PROBABILITY))


def contradicting_group(
    tests: Sequence[tuple[float, int]],
    chi_square: float,
    degrees_of_freedom: int,
    *,
    estimated_from: float = math.inf,
) -> tuple[int, float] | None:
    """Group of measurements that contradicts all others, and the p-value; None if none does.

    A group is tested with the noise that the others show. If these agree within their noise, the test is that of
    chi-square; if not, all noise may be too small, and the ratio of both mean squares has an F-distribution.

    Parameters
    ----------
    tests : sequence of (float, int)
        Chi-square of each group against the prediction by the others, and its degrees of freedom.
    chi_square, degrees_of_freedom : float, int
        Of all residuals.
    estimated_from : float
        Groups from whose residuals their noise was estimated: it is known as a mean of so many squares is.
    """
    limit = CONTRADICTION_PROBABILITY / max(len(tests), 1)
    worst: tuple[int, float] | None = None
    least = math.inf, -math.inf
    for number, (own, freedom) in enumerate(tests):
        rest, others = max(chi_square - own, 0.0), degrees_of_freedom - freedom
        if not freedom:
            continue
        if is_misfit(rest, others):
            p = float(fdtrc(freedom, min(others, estimated_from), own / freedom / (rest / others)))
        elif math.isfinite(estimated_from):
            p = float(fdtrc(freedom, estimated_from, own / freedom))
        else:
            p = float(chdtrc(freedom, own))
        # One redundant measurement tests all groups alike, and of gross errors all probabilities are zero.
        key = significant(p), -significant(own / freedom)
        if p <= limit and key < least:
            worst, least = (number, p), key
    return worst


def faulty_group(
    tests: Sequence[tuple[float, int]],
    chi_square: float,
    degrees_of_freedom: int,
    *,
    estimated_from: float = math.inf,
    against: float = -math.inf,
    wholly: bool = False,
) -> tuple[int, float] | None:
    """Group that contradicts the others, and the p-value, if these agree and no other cause is likelier; else None.

    Where the others disagree without it, too, the model does not hold, and no group is to blame.

    Parameters
    ----------
    tests, chi_square, degrees_of_freedom, estimated_from
        As in :func:`contradicting_group`.
    against : float
        Gain of an effect on all groups that may explain the residuals instead, see
        :func:`srt.noise.drift_forms.likelihood_gain`. That of the group has the penalty of its number, too.
    wholly : bool
        The other effect must explain all residuals to be chosen, and so must the group.
    """
    worst = contradicting_group(tests, chi_square, degrees_of_freedom, estimated_from=estimated_from)
    if worst is None:
        return None
    own, freedom = tests[worst[0]]
    rest, others = chi_square - own, degrees_of_freedom - freedom
    gain = likelihood_gain(own, freedom, chi_square, degrees_of_freedom) - 2.0 * math.log(len(tests))
    gross = rest < _ONE_FAULT * chi_square and not wholly
    return worst if (gross or not is_misfit(rest, others)) and gain > against else None
