"""The sequence to run next, from what a running test knows already."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.planning.information import GRAVITY, N_UNKNOWNS, NORTH
from srt.planning.plan import Limits, Task, check_targets
from srt.sensor_errors import N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from srt.planning.candidates import Candidate
    from srt.planning.information import Conditions
    from srt.planning.plan import Progress
    from srt.planning.stand import Stand
    from srt.result.calibration import Calibration
    from srt.types import Array


_MOSTLY: Final = 0.95
_FAR: Final = 1e6
"""Variance over the target's beyond which a parameter counts as unknown."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """One more sequence, and what it would do.

    Attributes
    ----------
    candidate : Candidate
    windows_s : (float, float)
        Length of the start and of the end window.
    time_s : float
        With its waits, without the move to its start.
    ratio : float
        Worst sigma over target after it; infinite while a target is not seen at all.
    improved : tuple of (str, float, float)
        Parameters with a target that it improves most: sigma before (infinite: not seen) and after, SI; at most three.
    """

    candidate: Candidate
    windows_s: tuple[float, float]
    time_s: float
    ratio: float
    improved: tuple[tuple[str, float, float], ...]


def known_information(calibration: Calibration, conditions: Conditions) -> Array:
    """What a calibration knows, as information on sensor errors, gravity and north.

    Parameters
    ----------
    calibration : Calibration
        Of the test so far. Of parameters that it holds nothing is taken to be known.
    conditions : Conditions
        For the uncertainty of gravity: it is in the calibration's sigmas, and a further sequence does not lessen it.

    Returns
    -------
    ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), SI

    Raises
    ------
    InputError
        A calibration in which nothing was observed.
    """
    seen = np.flatnonzero(calibration.observed)
    if seen.size == 0:
        raise InputError(
            f"The calibration of the test so far has the status {calibration.status} and observed nothing: give one "
            "of a recording that could be calibrated."
        )
    P = calibration.covariance[np.ix_(seen, seen)].copy()
    # The drift that the whole test has in common is in the sigmas of the biases, and no sequence takes it away: it is
    # added again to what is predicted.
    P[np.diag_indices_from(P)] -= np.minimum(conditions.drift_variance()[seen], _MOSTLY * np.diag(P))
    effect = np.asarray(calibration.noise.get("gravity_effect", np.zeros(N_PARAMETERS)), dtype=np.float64)[seen]
    d = np.sqrt(np.diag(P))
    rest = (P - np.outer(effect, effect)) / np.outer(d, d)
    # The accelerometer scales may be known as well as gravity alone allows: rounding must not make that less.
    values, vectors = np.linalg.eigh(rest)
    root = (vectors / np.sqrt(np.maximum(values, 1e-6 * values.max()))).T / d
    rows = np.zeros((len(seen), N_UNKNOWNS))
    rows[:, seen] = root
    # A larger gravity reads as smaller scales: the effect is stored with the sign of larger ones.
    rows[:, GRAVITY] = -root @ effect / max(conditions.gravity_sigma_m_s2, 1e-12)
    out: Array = rows.T @ rows
    out[[GRAVITY, NORTH], [GRAVITY, NORTH]] += conditions.prior()[[GRAVITY, NORTH]]
    return out


def next_sequences(
    stand: Stand,
    conditions: Conditions,
    targets: Array,
    known: Array,
    *,
    limits: Limits | None = None,
    horizon_s: float = 300.0,
    count: int = 5,
    progress: Progress | None = None,
) -> tuple[Proposal, ...]:
    """Propose what to run next: what the best continuation of the test would spend most time on.

    Sequences may be worth something only together; so the optimum with fractions is found for the rest of the test,
    from what is known already, and its sequences are proposed.

    Parameters
    ----------
    stand : Stand
    conditions : Conditions
    targets : ndarray, shape (27,), SI
        NaN: none.
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS)
        Information of the test so far, see :func:`known_information`.
    limits : Limits, optional
    horizon_s : float
        How long the test may go on, s.
    count : int
        Of proposals: different sequences, of those that differ in the sense of turns or in what is up alone, one.
    progress : callable, optional
        As for :func:`srt.planning.plan.make_plan`.

    Returns
    -------
    tuple of Proposal
        What is worth most first; fewer than ``count`` if no more is worth running.

    Raises
    ------
    InputError, DataError
        As :func:`srt.planning.plan.make_plan`.
    """
    check_targets(targets)
    task = Task(stand, conditions, targets, limits or Limits(), progress, known)
    task.require_seen()
    optimum = task.relaxed(horizon_s)
    spent = optimum.weight * task.columns.cost_s[optimum.which]
    by_kind: dict[tuple[str, ...], list[int]] = {}
    for j in np.argsort(-spent).tolist():
        by_kind.setdefault(_kind(task.signatures.candidates[task.sequence[optimum.which[j]]]), []).append(j)
    ranked = sorted(by_kind.values(), key=lambda of: -float(spent[of].sum()))
    return tuple(_proposal(task, int(optimum.which[of[0]]), targets) for of in ranked[:count])


def _kind(candidate: Candidate) -> tuple[str, ...]:
    return candidate.down[-1], *(f"{abs(turn)}{axis}" for axis, turn in candidate.rotations)


def _proposal(task: Task, column: int, targets: Array) -> Proposal:
    judge = task.judge
    rows = task.columns.rows[column]
    before, after = judge.variances(judge.prior), judge.variances(judge.prior + rows.T @ rows)
    counted = judge.targets
    improved = tuple(
        (NAMES[counted[i]], _sigma(before[i], targets[counted[i]]), _sigma(after[i], targets[counted[i]]))
        for i in np.argsort(after / before)[:3]
        if after[i] < min(0.98 * before[i], _FAR)
    )
    first, last = task.windows[column]
    time_s = float(task.columns.cost_s[column])
    return Proposal(
        task.signatures.candidates[task.sequence[column]],
        (float(first), float(last)),
        time_s,
        _sigma(after.max(), 1.0),
        improved,
    )


def _sigma(variance: float, target: float) -> float:
    """Sigma in SI of a variance in units of the target; more than a thousand targets are none."""
    return math.inf if variance > _FAR else math.sqrt(variance) * float(target)
