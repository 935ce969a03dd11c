"""Comparison of the causes that could explain one set of residuals, by likelihood.

Each cause predicts a pattern, a linear combination of its columns. With n normal residuals of one variance, the
logarithm of the likelihood at the best combination is ``-n/2 log(RSS/n)``; each fitted parameter costs ``log(n)/2``
(G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6, 1978), and a choice among m places ``log m``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.diagnosis.findings import RunnerUp

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.diagnosis.findings import Finding
    from srt.types import Array

CLOSE: Final = math.log(20.0)
"""Difference of the scores below which a runner-up is told: the best cause is less than 20 times as likely."""


@dataclass(frozen=True, slots=True, eq=False)
class Cause:
    """Cause and the pattern that it predicts.

    Attributes
    ----------
    fault : str
        Key of the catalogue of faults; empty for no fault.
    columns : ndarray, shape (n, k)
    details : dict
        Values for the message.
    choices : int
        Places, axes or times among which the columns were chosen.
    """

    fault: str
    columns: Array
    details: dict[str, Any]
    choices: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """Cause with its score.

    Attributes
    ----------
    cause : Cause
    score : float
        Logarithm of the likelihood, less the penalty.
    value, sigma : ndarray, shape (k,)
        Coefficients of the columns, and their standard deviations by the scatter of what is left.
    square : float
        Sum of the squares of what is left.
    freedom : int
        Its degrees of freedom.
    """

    cause: Cause
    score: float
    value: Array
    sigma: Array
    square: float
    freedom: int


def compare(values: Array, causes: Iterable[Cause], nuisance: Array | None = None) -> list[Explanation]:
    """Explain residuals by each cause; the most likely first.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Residuals of equal standard deviation.
    causes : iterable of Cause
    nuisance : ndarray, shape (n, p), optional
        Columns that every cause may use.
    """
    common = np.zeros((len(values), 0)) if nuisance is None else nuisance
    basis = _basis(common)
    left = values - basis @ (basis.T @ values)
    found = [_explanation(left, cause, cause.columns - basis @ (basis.T @ cause.columns), basis) for cause in causes]
    return sorted(found, key=lambda explanation: -explanation.score)


def _basis(columns: Array) -> Array:
    """Orthonormal basis of what the columns span."""
    if columns.shape[1] == 0:
        return columns
    U, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(U[:, size > 1e-9 * size.max(initial=0.0)])


def _explanation(left: Array, cause: Cause, columns: Array, basis: Array) -> Explanation:
    n, k = columns.shape
    freedom = n - basis.shape[1] - k
    value = np.linalg.lstsq(columns, left, rcond=None)[0] if k else np.zeros(0)
    rest = left - columns @ value
    square = max(float(rest @ rest), 1e-300)
    variance = np.einsum("kn,kn->k", *[np.linalg.pinv(columns)] * 2) if k else np.zeros(0)
    sigma = np.sqrt(variance * square / max(1, freedom))
    score = -0.5 * n * math.log(square / n) - 0.5 * k * math.log(n) - math.log(cause.choices)
    return Explanation(cause, score, np.asarray(value), np.asarray(sigma), square, freedom)


def with_runner_up(finding: Finding, ranked: list[Explanation]) -> Finding:
    """Finding with the most likely cause of another name, if it is nearly as likely."""
    own = next(e.score for e in ranked if e.cause.fault == finding.fault)
    for other in ranked:
        if other.cause.fault not in ("", finding.fault) and own - other.score < CLOSE:
            return replace(finding, runner_up=RunnerUp(other.cause.fault, own - other.score))
    return finding
