"""What the joint solution says of its measurements: residuals, every sequence against all others, noise left over."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import chdtrc

from srt.calibration import Residual
from srt.variance_components import restricted_likelihood

if TYPE_CHECKING:
    from collections.abc import Sequence as SequenceOf

    from numpy.typing import NDArray

    from estimators.batch import BatchSolution
    from estimators.problem import Problem
    from estimators.system import System

    Array = NDArray[np.float64]

_COMPONENTS: Final = {"force": "xyz", "rate": "xyz", "turn": "xyz"}
_RANK: Final = 1e-8
SUSPECT_PROBABILITY: Final = 1e-4
"""Chance below which a sequence is said to contradict the others; over 17 sequences, about once in 600 recordings."""


def residuals(problem: Problem, system: System, solution: BatchSolution) -> tuple[Residual, ...]:
    """Residuals of force, rate and turn at the solution, each with the sigma it should have."""
    data = problem.data
    left = system.b + system.A @ solution.delta
    leverage = np.einsum("ij,ij->i", system.A @ solution.root, system.A @ solution.root)
    out = []
    for kind, axes in _COMPONENTS.items():
        rows = system.rows_of(kind)
        for member, index in enumerate(rows.index):
            k = int(rows.owner[member])
            name = kind if kind == "turn" else f"{_which(problem, k, member)}_{kind}"
            for axis, i in zip(axes, index.tolist(), strict=True):
                sigma = float(np.sqrt(max(1.0 - leverage[i], 0.0)))
                # Whitened: the value is in units of the measurement's own sigma.
                sigma = 0.0 if sigma < 1e-6 else sigma
                out.append(Residual(data.ids[k], data.occurrences[k], f"{name}_{axis}", float(left[i]), sigma))
    return tuple(out)


def _which(problem: Problem, k: int, window: int) -> str:
    """Role of a window in its sequence; one without its turn is named apart."""
    if window == problem.data.start[k]:
        return "start"
    return "end" if window == problem.data.end[k] else "lone"


def deletion_table(problem: Problem, system: System, solution: BatchSolution) -> list[dict[str, Any]]:
    """Every sequence against all the others: chi-square of its residuals as the others predict it.

    Returns
    -------
    list of dict
        Sequence, occurrence, chi_square, degrees_of_freedom, probability; in time order.
    """
    left = system.b + system.A @ solution.delta
    spread = system.A @ solution.root
    owned: dict[int, list[Array]] = {}
    for rows in system.rows:
        for owner, index in zip(rows.owner.tolist(), rows.index, strict=True):
            if owner >= 0:
                owned.setdefault(owner, []).append(index)
    data, table = problem.data, []
    for k in problem.order.tolist():
        at = np.concatenate(owned[k])
        v, H = left[at], spread[at]
        # What the data of a sequence alone decide, its own attitudes, leaves no residual there: directions without one.
        values, vectors = np.linalg.eigh(np.eye(len(at)) - H @ H.T)
        seen = values > _RANK
        statistic = float(np.sum((vectors[:, seen].T @ v) ** 2 / values[seen]))
        number = int(seen.sum())
        table.append(
            {
                "sequence": data.ids[k],
                "occurrence": data.occurrences[k],
                "chi_square": statistic,
                "degrees_of_freedom": number,
                "probability": float(chdtrc(number, statistic)) if number else 1.0,
            }
        )
    return table


def suspects(table: SequenceOf[dict[str, Any]]) -> list[str]:
    """Name the sequence that contradicts the others most, if its chance is small."""
    if not table:
        return []
    # Probabilities underflow: the statistic over its degrees of freedom orders what is hopeless.
    worst = max(table, key=lambda row: row["chi_square"] / max(row["degrees_of_freedom"], 1))
    if worst["probability"] > SUSPECT_PROBABILITY:
        return []
    again = f" (occurrence {worst['occurrence']})" if worst["occurrence"] > 1 else ""
    return [
        f"Sequence {worst['sequence']}{again} contradicts all the others (chi-square {worst['chi_square']:.3g} for "
        f"{worst['degrees_of_freedom']} degrees of freedom): look at its windows and its turn, leave it out, or use a "
        "robust loss."
    ]


def excess_noise(problem: Problem, system: System) -> tuple[float, float, float]:
    """One sigma of attitude per turn, of force and of rate per window beyond the noise (restricted maximum likelihood).

    Returns
    -------
    tuple of float
        rad, m/s², rad/s.
    """
    m = len(system.b)
    parts = []
    known = np.eye(m)
    for kind, present, source in (
        ("turn", problem.excess[0], "turn_excess"),
        ("force", problem.excess[1], "pose_excess"),
        ("rate", problem.excess[2], "rest_excess"),
    ):
        rows = system.rows_of(kind)
        W = system.whitening[kind]
        unit = W @ np.swapaxes(W, 1, 2)
        part = np.zeros((m, m))
        for index, block in zip(rows.index, unit, strict=True):
            part[np.ix_(index, index)] = block
        if source in rows.sources:
            known = known - present**2 * part
        parts.append(part)
    turn, force, rate = np.sqrt(restricted_likelihood(system.b, system.A[:, system.active], known, tuple(parts)))
    return float(turn), float(force), float(rate)
