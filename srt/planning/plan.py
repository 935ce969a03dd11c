"""Plan of a test: its limits, its sequences with their predicted accuracy, and its making from selected sequences."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.planning.order import nearest_angles
from srt.planning.prediction import Prediction, predict, prior_information, unknown_scales, variances_of_test
from srt.planning.selection import AccuracyCriterion, filled
from srt.planning.timetable import ScheduledSequence, timetable
from srt.presentation import Presented
from srt.ranking import ranked, significant
from srt.sensor_errors import N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from srt.planning.candidates import Candidate
    from srt.planning.conditions import Conditions
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.planning.information import Signatures
    from srt.types import Array, Indices


MET: Final = 1.0 + 1e-4
"""Sigma over target up to which a target counts as met; the margin is the accuracy of the optimisation."""
_REFINEMENTS: Final = 2
"""Optimisations of the windows, each with the variances of the whole test by the windows before."""


@dataclass(frozen=True, slots=True)
class PlanLimits:
    """Limits of a plan.

    Attributes
    ----------
    shortest_window_s, longest_window_s : float
        Limits of the length of a stationary window, s.
    largest_turn_deg : int
        Largest angle of one rotation, deg.
    most_legs : int
        Largest number of rotations in a sequence.
    longest_test_s : float
        Longest test that is considered, s.
    most_sequences : int
        Largest number of sequences.
    """

    shortest_window_s: float = 5.0
    longest_window_s: float = 60.0
    largest_turn_deg: int = 1080
    most_legs: int = 8
    longest_test_s: float = 8.0 * 3600.0
    most_sequences: int = 40

    def __post_init__(self) -> None:
        if not 0.0 < self.shortest_window_s <= self.longest_window_s < math.inf:
            raise InputError(
                f"Windows of {self.shortest_window_s:g} to {self.longest_window_s:g} s are contradictory: the shortest "
                "must be positive and not above the longest."
            )
        least = {"largest_turn_deg": 90, "most_legs": 1, "most_sequences": 1}
        for name, low in least.items():
            if getattr(self, name) < low:
                raise InputError(f"{name} is {getattr(self, name)}, which leaves no sequence: give at least {low}.")

    def grid_s(self, count: int) -> Array:
        """Window lengths of the continuous design, in geometric steps, s."""
        if self.shortest_window_s == self.longest_window_s:
            return np.array([self.shortest_window_s])
        return np.geomspace(self.shortest_window_s, self.longest_window_s, count)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plan(Presented):
    """Plan of a test.

    Attributes
    ----------
    candidates : tuple of Candidate
        Sequences in the order of execution.
    windows_s : ndarray, shape (n, 2)
        Lengths of the start and of the end window, s.
    total_s, moves_s : float
        Length of the test from the first window to the last, and the part of it between the sequences, s.
    targets : ndarray, shape (27,), SI
        Target sigma; NaN: none.
    bound : float
        Lower bound of the worst ratio for any plan of this length with these sequences and this fixture; NaN: not
        computed.
    limiting_targets : tuple of (str, float)
        Parameters whose targets determine the optimum, and their weights.
    with_moves : ndarray, shape (27,), SI, optional
        Expected sigma where the moves between the sequences are recorded, for the estimators that use them. The bound
        does not hold then.
    """

    candidates: tuple[Candidate, ...]
    windows_s: Array
    total_s: float
    moves_s: float
    fixture: FixtureKinematics
    conditions: Conditions
    targets: Array
    prediction: Prediction
    bound: float = math.nan
    limiting_targets: tuple[tuple[str, float], ...] = ()
    with_moves: Array | None = None

    @property
    def sigma(self) -> Array:
        """Expected sigma that counts for the targets, shape (27,), SI: with the moves where they are recorded."""
        return self.prediction.sigma if self.with_moves is None else self.with_moves

    def timetable(self) -> tuple[ScheduledSequence, ...]:
        """Times of every sequence, if no time is lost."""
        return timetable(self.candidates, self.windows_s, self.fixture)

    @property
    def ratios(self) -> Array:
        """Sigma over target, shape (27,); NaN where there is no target."""
        return np.asarray(self.sigma / self.targets)

    @property
    def ratio(self) -> float:
        """Worst sigma over target."""
        return float(np.nanmax(self.ratios))

    @property
    def worst(self) -> str:
        """Parameter with the worst sigma over target."""
        return NAMES[int(ranked(self.ratios)[0])]

    @property
    def unmet(self) -> tuple[str, ...]:
        """Parameters whose target is not met."""
        return tuple(NAMES[k] for k in np.flatnonzero(self.ratios > MET))


def check_targets(targets: Array) -> None:
    """Raise InputError unless there is at least one target and all are positive."""
    if targets.shape != (N_PARAMETERS,):
        raise InputError(
            f"The targets have shape {targets.shape}: give {N_PARAMETERS} sigmas, NaN where none is wanted."
        )
    if not np.isfinite(targets).any():
        raise InputError("The plan has no target: state the sigma that is wanted of at least one parameter.")
    low = [NAMES[k] for k in np.flatnonzero(targets <= 0.0)]
    if low:
        raise InputError(f"The target of {low[0]} is not positive: give the sigma that is wanted.")


def accuracy_criterion(
    signatures: Signatures, targets: Array, limits: PlanLimits, known: Array | None = None
) -> AccuracyCriterion:
    """Accuracy criterion for selections of sequences.

    Parameters
    ----------
    targets : ndarray, shape (27,), SI
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), optional
        Information from earlier measurements, SI; default: that on gravity and north.
    """
    scale = unknown_scales(targets)
    counted = np.flatnonzero(np.isfinite(targets))
    return AccuracyCriterion(
        signatures,
        scale,
        prior_information(signatures.conditions, scale, known),
        counted,
        signatures.conditions.drift_variance()[counted] / targets[counted] ** 2,
        limits.shortest_window_s,
        limits.longest_window_s,
        np.ones(len(counted)),
    )


class TooLongError(InputError):
    """Error: the moves leave no time for the windows; ``missing_s`` is the time by which the test is too long."""

    def __init__(self, message: str, missing_s: float) -> None:
        super().__init__(message)
        self.missing_s = missing_s


def too_short(criterion: AccuracyCriterion, which: Indices, total_s: float) -> TooLongError:
    """Error of a time that is too short for selected sequences in their order."""
    own, least = criterion.signatures, 2.0 * criterion.shortest_s * len(which)
    moves_s = nearest_angles([own.candidates[k] for k in which], own.fixture)[1]
    fixed_s = moves_s + float(own.between_windows_s[which].sum())
    return TooLongError(
        f"{total_s:g} s are too short for {len(which)} sequences: rotations and moves alone take {fixed_s:.0f} s, and "
        f"the windows at least {least:.0f} s.",
        fixed_s + least - total_s,
    )


def scheduled_plan(
    criterion: AccuracyCriterion, which: Indices, windows_s: Array, targets: Array, total_s: float
) -> Plan:
    """Plan of selected sequences in their order, with the time shared among the windows.

    Parameters
    ----------
    which : ndarray of int, shape (n,)
    windows_s : ndarray, shape (n,), s
        Initial lengths of both windows of each.

    Raises
    ------
    TooLongError
        The windows have no time.
    """
    own = criterion.signatures
    ways, moves_s = nearest_angles([own.candidates[k] for k in which], own.fixture)
    each_s = np.array([own.fixture.move_s(a.end_deg, b.start_deg) for a, b in pairwise(ways)])
    budget = total_s - moves_s - float(own.between_windows_s[which].sum())
    # Rounding may leave the time of windows that are all of the least length a little below their sum.
    if budget < 2.0 * criterion.shortest_s * len(which) * (1.0 - 1e-9):
        raise too_short(criterion, which, total_s)
    windows = filled(np.repeat(windows_s[:, None], 2, axis=1), budget, criterion.shortest_s, criterion.longest_s)
    variances = variances_of_test(criterion, which, windows, each_s)
    best = significant(variances.max()), windows
    for _ in range(_REFINEMENTS):
        # The drift of a whole test is not additive: the additive variances are corrected to those of the whole test.
        simple = np.exp(criterion.log_variances(which, windows)[0])
        windows = replace(criterion, correction=variances / simple).best_windows(which, windows, budget)
        variances = variances_of_test(criterion, which, windows, each_s)
        best = min(best, (significant(variances.max()), windows), key=lambda pair: pair[0])
    used = total_s - budget + float(best[1].sum())
    prediction = predict(ways, best[1], own.fixture, own.conditions, targets)
    return Plan(ways, best[1], used, moves_s, own.fixture, own.conditions, targets, prediction)
