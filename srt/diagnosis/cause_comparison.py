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
    """Fit the residuals by each cause, and sort the explanations by likelihood, the most likely first.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Residuals of equal standard deviation.
    causes : iterable of Cause
    nuisance : ndarray, shape (n, p), optional
        Columns of nuisance parameters that are fitted together with every cause.
    """
    n, basis = len(values), np.zeros((len(values), 0))
    if nuisance is not None and nuisance.shape[1]:
        U, size, _ = np.linalg.svd(nuisance, full_matrices=False)
        basis = U[:, size > 1e-9 * size.max(initial=0.0)]
    left, found = values - basis @ (basis.T @ values), []
    for cause in causes:
        columns = cause.columns - basis @ (basis.T @ cause.columns)
        k = columns.shape[1]
        freedom = n - basis.shape[1] - k
        # Directions that the nuisance columns explain as well are left out.
        inverse = np.linalg.pinv(columns, rcond=np.finfo(float).eps * n) if k else np.zeros((0, n))
        value = inverse @ left
        rest = left - columns @ value
        square = max(float(rest @ rest), 1e-300)
        sigma = np.linalg.norm(inverse, axis=1) * math.sqrt(square / max(1, freedom))
        score = -0.5 * n * math.log(square / n) - 0.5 * k * math.log(n) - math.log(cause.choices)
        found.append(Explanation(cause, score, value, np.asarray(sigma), square, freedom))
    return sorted(found, key=lambda explanation: -explanation.score)
