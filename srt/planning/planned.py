"""What a plan is: the limits it is made within, the plan itself with its accuracy, and how a choice becomes one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.planning.order import best_order
from srt.planning.prediction import Prediction, predict, prior_information, units
from srt.planning.selection import Judge
from srt.sensor_errors import N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from srt.planning.candidates import Candidate
    from srt.planning.information import Conditions, Signatures
    from srt.planning.selection import Choice
    from srt.planning.stand import Stand
    from srt.types import Array


MET: Final = 1.0 + 1e-4
"""Sigma over target up to which a target counts as met: what an optimum is found to."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What the planner may choose from.

    Attributes
    ----------
    shortest_window_s, longest_window_s : float
    largest_turn_deg : int
        Of one rotation.
    most_legs : int
        Rotations in a sequence.
    longest_test_s : float
        Targets that take longer are out of reach.
    most_sequences : int
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
        """Windows that the optimum with fractions chooses from, s."""
        if self.shortest_window_s == self.longest_window_s:
            return np.array([self.shortest_window_s])
        return np.geomspace(self.shortest_window_s, self.longest_window_s, count)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A test, ready to be run.

    Attributes
    ----------
    candidates : tuple of Candidate
        In the order of execution, at the fixture's angles.
    windows_s : ndarray, shape (n, 2)
    total_s, moves_s : float
        The whole test from the first window to the last; what of it is moves, pauses and settling between sequences.
    targets : ndarray, shape (27,), SI
        NaN: none.
    prediction : Prediction
    bound : float
        No plan of this length, for this fixture and of this kind of sequences, has a smaller worst ratio; NaN where
        it was not computed.
    ruling : tuple of (str, float)
        Parameters that rule the optimum, and their weights.
    """

    candidates: tuple[Candidate, ...]
    windows_s: Array
    total_s: float
    moves_s: float
    stand: Stand
    conditions: Conditions
    targets: Array
    prediction: Prediction
    bound: float = math.nan
    ruling: tuple[tuple[str, float], ...] = ()

    @property
    def ratios(self) -> Array:
        """Sigma over target, shape (27,); NaN where there is no target."""
        return np.asarray(self.prediction.sigma / self.targets)

    @property
    def ratio(self) -> float:
        """Worst sigma over target."""
        return float(np.nanmax(self.ratios))

    @property
    def worst(self) -> str:
        """Parameter of the worst sigma over target."""
        return NAMES[int(np.nanargmax(self.ratios))]

    @property
    def unmet(self) -> tuple[str, ...]:
        """Parameters whose target is missed."""
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
        raise InputError(f"The target of {low[0]} is not positive: no test is perfect; give the sigma that is wanted.")


def judge_of(signatures: Signatures, targets: Array, limits: Limits, known: Array | None = None) -> Judge:
    """Judge of choices among sequences.

    Parameters
    ----------
    signatures : Signatures
    targets : ndarray, shape (27,), SI
    limits : Limits
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), optional
        Information that there already is; default that on gravity and north.
    """
    scale = units(targets)
    counted = np.flatnonzero(np.isfinite(targets))
    return Judge(
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
    """The moves leave no time for the windows; they took so much per sequence."""

    def __init__(self, message: str, per_sequence_s: float) -> None:
        super().__init__(message)
        self.per_sequence_s = per_sequence_s


def finished(
    judge: Judge,
    choice: Choice,
    stand: Stand,
    conditions: Conditions,
    targets: Array,
    total_s: float,
) -> Plan:
    """Order the sequences, and give the time that the moves leave to the windows."""
    order, ways, moves_s = best_order([judge.signatures.candidates[k] for k in choice.which], stand)
    which = choice.which[list(order)]
    budget = total_s - moves_s - float(judge.signatures.own_s[which].sum())
    least = 2.0 * judge.shortest_s * len(which)
    if budget < least:
        raise TooLongError(
            f"{total_s:g} s are too short for {len(which)} sequences: rotations and moves alone take "
            f"{total_s - budget:.0f} s, and the windows at least {least:.0f} s.",
            moves_s / max(1, len(which) - 1),
        )
    refined = judge.refine(which, choice.windows_s[list(order)], budget)
    used = total_s - budget + float(refined.windows_s.sum())
    prediction = predict(ways, refined.windows_s, stand, conditions, targets)
    return Plan(ways, refined.windows_s, used, moves_s, stand, conditions, targets, prediction)
