"""Proposals for the next sequence of a running test, from the calibration of the test so far."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.planning.conditions import GRAVITY, N_UNKNOWNS, NORTH
from srt.planning.plan import PlanLimits, check_targets
from srt.planning.planner import Planner
from srt.planning.prediction import OBSERVED_LIMIT
from srt.ranking import ranked
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from srt.planning.candidates import Candidate
    from srt.planning.conditions import Conditions
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.planning.planner import Progress
    from srt.result.calibration import Calibration
    from srt.types import Array


_LARGEST_DRIFT_SHARE: Final = 0.95
"""Share of a variance that the drift common to the test may take: the rest keeps the covariance positive definite."""
_ROUNDING: Final = 1e-6
"""Smallest eigenvalue of the scaled covariance over its largest: smaller ones are rounding error."""
_LEAST_GAIN: Final = 0.98
"""Factor of a variance below which a parameter counts as improved."""
_MOST_LISTED: Final = 3
"""Improved parameters listed for a proposal."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """Proposal of one more sequence, with the sigmas after it.

    Attributes
    ----------
    windows_s : (float, float)
        Length of the start and of the end window.
    time_s : float
        Time of the sequence with its waits, without the move to its start, s.
    ratio : float
        Worst sigma over target after it; infinite while a target is not observed.
    improved : tuple of (str, float, float)
        Parameters with a target that it improves most: sigma before (infinite: not observed) and after, SI; at most
        three.
    """

    candidate: Candidate
    windows_s: tuple[float, float]
    time_s: float
    ratio: float
    improved: tuple[tuple[str, float, float], ...]


def known_information(calibration: Calibration, conditions: Conditions) -> Array:
    """Information of a calibration on sensor errors, gravity and north.

    Parameters
    ----------
    calibration : Calibration
        Calibration of the test so far. Its fixed parameters count as unknown.
    conditions : Conditions
        Conditions of the test: the uncertainty of gravity is part of the sigmas, and no sequence reduces it.

    Returns
    -------
    ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), SI

    Raises
    ------
    InputError
        A calibration in which no parameter was observed.
    """
    seen = np.flatnonzero(calibration.observed)
    if seen.size == 0:
        raise InputError(
            f"The calibration of the test so far has the status {calibration.status} and observed nothing: give one "
            "of a recording that could be calibrated."
        )
    P = calibration.covariance[np.ix_(seen, seen)].copy()
    # The drift common to the whole test is part of the bias sigmas, and no sequence reduces it: it is taken out here
    # and added again to the prediction.
    P[np.diag_indices_from(P)] -= np.minimum(conditions.drift_variance()[seen], _LARGEST_DRIFT_SHARE * np.diag(P))
    gravity = calibration.noise.gravity_effect
    effect = np.zeros(len(seen)) if gravity is None else gravity[seen]
    d = np.sqrt(np.diag(P))
    rest = (P - np.outer(effect, effect)) / np.outer(d, d)
    # The accelerometer scales may be limited by gravity alone: rounding must not leave a negative variance.
    values, vectors = np.linalg.eigh(rest)
    root = (vectors / np.sqrt(np.maximum(values, _ROUNDING * values.max()))).T / d
    rows = np.zeros((len(seen), N_UNKNOWNS))
    rows[:, seen] = root
    # Gravity above its stated value looks like smaller scales; the effect is stored with the opposite sign.
    prior = conditions.prior()
    rows[:, GRAVITY] = -root @ effect * math.sqrt(prior[GRAVITY])
    out: Array = rows.T @ rows
    out[[GRAVITY, NORTH], [GRAVITY, NORTH]] += prior[[GRAVITY, NORTH]]
    return out


def next_sequences(
    fixture: FixtureKinematics,
    conditions: Conditions,
    targets: Array,
    known: Array,
    *,
    limits: PlanLimits | None = None,
    horizon_s: float = 300.0,
    count: int = 5,
    progress: Progress | None = None,
) -> tuple[Proposal, ...]:
    """Propose the next sequence: those on which the optimal continuation of the test spends most time.

    The value of a sequence may depend on others. So the optimal continuous design for the rest of the test is found,
    from the information so far, and its sequences are proposed.

    Parameters
    ----------
    targets : ndarray, shape (27,), SI
        Target sigma; NaN: none.
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS)
        Information of the test so far, see :func:`known_information`.
    horizon_s : float
        Length of the continuation, s.
    count : int
        Number of proposals. Of sequences that differ only in the sense of rotations or of the vertical, one is
        proposed.
    progress : callable, optional
        As for :func:`srt.planning.planner.make_plan`.

    Returns
    -------
    tuple of Proposal
        In the order of their time in the optimum; fewer than ``count`` if it holds fewer.

    Raises
    ------
    InputError, DataError
        As :func:`srt.planning.planner.make_plan`.
    """
    check_targets(targets)
    planner = Planner(fixture, conditions, targets, limits or PlanLimits(), progress, known)
    planner.require_observable()
    design = planner.continuous(horizon_s)
    spent = design.weight * planner.columns.cost_s[design.which]
    by_kind: dict[tuple[str, ...], list[int]] = {}
    for j in ranked(spent).tolist():
        by_kind.setdefault(_kind(planner.signatures.candidates[planner.sequence[design.which[j]]]), []).append(j)
    kinds = list(by_kind.values())
    first = ranked(np.array([spent[of].sum() for of in kinds]))[:count]
    return tuple(_proposal(planner, int(design.which[kinds[k][0]]), targets) for k in first)


def _kind(candidate: Candidate) -> tuple[str, ...]:
    return candidate.down[-1], *(f"{abs(turn)}{axis}" for axis, turn in candidate.rotations)


def _proposal(planner: Planner, column: int, targets: Array) -> Proposal:
    criterion = planner.criterion
    rows = planner.columns.rows[column]
    before, after = criterion.variances(criterion.prior), criterion.variances(criterion.prior + rows.T @ rows)
    counted = criterion.targets
    improved = tuple(
        (NAMES[counted[i]], _sigma(before[i], targets[counted[i]]), _sigma(after[i], targets[counted[i]]))
        for i in ranked(-after / before)[:_MOST_LISTED]
        if after[i] < min(_LEAST_GAIN * before[i], OBSERVED_LIMIT**2)
    )
    first, last = planner.windows[column]
    time_s = float(planner.columns.cost_s[column])
    return Proposal(
        planner.signatures.candidates[planner.sequence[column]],
        (float(first), float(last)),
        time_s,
        _sigma(after.max(), 1.0),
        improved,
    )


def _sigma(variance: float, target: float) -> float:
    """Sigma in SI from a variance in units of the squared target; infinite if not observed."""
    return math.inf if variance > OBSERVED_LIMIT**2 else math.sqrt(variance) * float(target)
