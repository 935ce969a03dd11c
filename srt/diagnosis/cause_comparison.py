"""Comparison of the possible causes of one set of residuals, by likelihood (Bayesian information criterion).

Each cause predicts a pattern: a linear combination of its columns. With n normal residuals of one variance, the
logarithm of the likelihood at the best combination is ``-n/2 log(RSS/n)``, up to a constant. Each fitted parameter is
penalised by ``log(n)/2`` (G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6, 1978), and a choice
among m possible places by ``log m``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.types import Array

CLOSE: Final = math.log(20.0)
"""Difference of the scores below which the second cause is reported: the best one is less than 20 times as likely."""


_DEPENDENT: Final = 1e-9
"""Part of a column, over its length, that other columns leave, below which it depends on them: rounding errors."""


@dataclass(frozen=True, slots=True, eq=False)
class Cause:
    """Cause and the pattern of the residuals that it predicts.

    ``fault`` is the key of the catalogue, empty for no fault; ``columns``, shape (n, k), are the effects of the k
    fitted parameters on the n residuals; ``details`` are values for the message; ``choices`` is the number of places,
    axes or times among which the columns were chosen.
    """

    fault: str
    columns: Array
    details: dict[str, Any]
    choices: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """Cause with its score (logarithm of the likelihood, less the penalty) and the fit of its columns.

    ``value`` and ``sigma``, shape (k,), are the coefficients of the columns and their standard deviations from the
    scatter of the remaining residuals, which have the sum of squares ``square`` with ``freedom`` degrees of freedom.
    """

    cause: Cause
    score: float
    value: Array
    sigma: Array
    square: float
    freedom: int


def compare(values: Array, causes: Iterable[Cause], nuisance: Array | None = None) -> list[Explanation]:
    """Explanations of the residuals by each cause, the most likely first; parameters as for :func:`explain`."""
    return sorted(explain(values, causes, nuisance), key=lambda explanation: -round(explanation.score, 6))


def explain(values: Array, causes: Iterable[Cause], nuisance: Array | None = None) -> list[Explanation]:
    """Fit the residuals by each cause.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Residuals of equal standard deviation.
    causes : iterable of Cause
    nuisance : ndarray, shape (n, p), optional
        Columns of nuisance parameters that are fitted together with every cause.
    """
    n, basis, causes = len(values), np.zeros((len(values), 0)), list(causes)
    if nuisance is not None and nuisance.shape[1]:
        U, size, _ = np.linalg.svd(nuisance, full_matrices=False)
        basis = U[:, size > _DEPENDENT * size.max(initial=0.0)]
    k = np.array([cause.columns.shape[1] for cause in causes], dtype=np.intp)
    columns = np.zeros((len(causes), n, k.max(initial=0)))
    for table, cause in zip(columns, causes, strict=True):
        table[:, : cause.columns.shape[1]] = cause.columns
    size = np.linalg.norm(columns, axis=(1, 2))
    columns -= basis @ (basis.T @ columns)
    left = values - basis @ (basis.T @ values)
    # Directions that the nuisance columns explain as well are left out.
    own = np.linalg.norm(columns, axis=(1, 2))
    inverse = np.linalg.pinv(columns, rcond=_DEPENDENT * size / np.where(own > 0.0, own, 1.0))
    value = inverse @ left
    square = np.maximum(np.sum((left - np.einsum("cnk,ck->cn", columns, value)) ** 2, axis=1), 1e-300)
    freedom = n - basis.shape[1] - k
    sigma = np.linalg.norm(inverse, axis=2) * np.sqrt(square / np.maximum(1, freedom))[:, None]
    score = -0.5 * n * np.log(square / n) - 0.5 * k * math.log(n) - np.log([cause.choices for cause in causes])
    return [
        Explanation(cause, float(score[c]), value[c, : k[c]], sigma[c, : k[c]], float(square[c]), int(freedom[c]))
        for c, cause in enumerate(causes)
    ]


def with_known_noise(cause: Cause, square: float, parameters: int, n: int) -> Explanation:
    """Explanation of n residuals of known noise, whitened, by a cause that need not be linear in its parameters."""
    score = -0.5 * square - 0.5 * parameters * math.log(n)
    return Explanation(cause, score, np.zeros(0), np.zeros(0), square, n - parameters)
