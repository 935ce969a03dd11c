"""Calibration by the joint model: what is modelled besides the sensor errors is chosen between the iterations.

Moves, moving windows and sequences are accused only beside the bias drift that may explain them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation.drift_model import MOST_TERMS
from srt.estimation.error_sources import NO_ERRORS, as_found
from srt.estimation.fixed_parameters import (
    determined_by_fixture,
    fixed_sigma,
    reason_not_observed,
    reason_on_request,
    seen_by_earth_rate_alone,
)
from srt.estimation.iterations import Iterations
from srt.estimation.observability import default_prior, finest_sigma, observed_limit
from srt.joint.block_solution import BlockSolution
from srt.joint.initial_attitudes import placed
from srt.joint.iteration import iterate, observable_parameters
from srt.joint.linearisation import linearise
from srt.joint.model_selection import DRIFT, EXPLANATIONS, FIXTURE, G_SENSITIVITY, explained
from srt.joint.recording_opening import contradicting_move
from srt.joint.residual_analysis import contradicting_rests, contradictions
from srt.joint.solution_analysis import FixedParameters, analyse_solution, make_calibration, whole_solution
from srt.joint.solver import IterationState, JointSolver
from srt.model.table1 import SEQUENCES
from srt.sensor_errors import NAMES, OMISSIBLE

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.estimation.registry import Progress
    from srt.joint.joint_model import JointModel
    from srt.result.calibration import Calibration
    from srt.result.diagnostics import Diagnostics
    from srt.types import Array, Mask


_ROUNDS: Final = 6
"""Maximum number of rounds; a change of the noise model or of the free parameters starts a new round."""


def run(joint: JointModel, solver: JointSolver, progress: Progress | None) -> Calibration:
    """Calibrate with a solver.

    Raises
    ------
    InputError
        If an option does not apply to joint estimation.
    """
    joint.options.refuse(("step", "down", "measured_vertical", "window_attitude"), "Joint estimation")
    count = Iterations(progress)
    iteration = _with_sound_moves(joint, solver, count)
    unseen, fixed = _not_shown_by_poses(iteration.joint), joint.options.fixed_names
    requested = np.array([name in unseen or name in fixed for name in NAMES])
    if iteration.point is None:
        iteration = IterationState.at_start(iteration.joint, requested)
    before: Diagnostics | None = None
    for _ in range(_ROUNDS * (1 + MOST_TERMS)):
        iteration = iterate(solver, iteration, count=count)
        iteration = _with_still_windows(solver, iteration, count)
        uncertain = _fixed_sigma(iteration.joint)
        if (table := _integrate_moving_windows(solver, iteration, uncertain)) is not None:
            before = table
            continue
        if _relies_on_fixture(iteration, uncertain):
            vague = requested | _vague(iteration, requested)
            joint, solver.prior = iteration.joint.relying_on_fixture(uncertain)
            solver.restart()
            start = replace(joint.start, drift=iteration.state.drift)
            iteration = IterationState(joint, joint.with_fixed_values(start, vague), ~vague)
            continue
        if iteration.status != "converged":
            break
        if (changed := explained(solver, iteration, EXPLANATIONS)) is not None:
            iteration = changed
            if iteration.joint.relies_on_fixture:
                iteration.joint, solver.prior = iteration.joint.relying_on_fixture(_fixed_sigma(iteration.joint))
            continue
        # A drift can hide a wrong move, or come from one: the moves are judged again beside it.
        if iteration.joint.choice.drift.terms and (moves := _contradicting_move(solver, iteration)):
            solver.restart()
            iteration = IterationState.at_start(iteration.joint.without_moves(moves), requested)
            continue
        suspect = contradicting_rests(iteration.joint, whole_solution(solver, iteration))
        if (table := _integrate_moving_windows(solver, iteration, uncertain, suspect)) is not None:
            before = table
            iteration.joint = iteration.joint.with_choice(unmodelled_sigma=NO_ERRORS)
            continue
        break
    iteration.corrections, iteration.refits = count.corrections, count.refits
    if iteration.status == "converged":
        iteration.message = count.converged
    uncertain = _fixed_sigma(iteration.joint)
    reasons = unseen | {name: reason_on_request(name, uncertain, iteration.joint.data) for name in fixed}
    return make_calibration(solver, iteration, FixedParameters(reasons, uncertain), before)


def _fixed_sigma(joint: JointModel) -> Array:
    """1-sigma of every parameter where it is fixed, shape (27,), with the accuracy of the fixture as found."""
    return fixed_sigma(as_found(joint.data, joint.choice.unmodelled_sigma), joint.options)


def _with_drift(
    solver: JointSolver,
    iteration: IterationState,
    count: Iterations,
    accused: Callable[[IterationState], int],
) -> IterationState | None:
    """Solution with bias drift if less than half of the windows or moves accused without it are so beside it."""
    found = replace(iteration, corrections=list(iteration.corrections or ()))
    before = left = accused(iteration)
    while left and (changed := explained(solver, found, (DRIFT,))) is not None:
        found = iterate(solver, changed, count=count)
        if found.status != "converged":
            left = before
            break
        left = accused(found)
    if 2 * left < before:
        return found
    solver.restart()
    return None


def _with_still_windows(solver: JointSolver, iteration: IterationState, count: Iterations) -> IterationState:
    """Solution with a bias drift, if that explains why windows seem to move."""

    def moving(at: IterationState) -> int:
        assert at.point is not None
        return int(at.joint.moving_windows(at.state, at.point.compensated).sum())

    if iteration.status != "converged":
        return iteration
    return _with_drift(solver, iteration, count, moving) or iteration


def _integrate_moving_windows(
    solver: JointSolver, iteration: IterationState, uncertain: Array, suspect: Mask | None = None
) -> Diagnostics | None:
    """Integrate the attitude in windows in which the unit moved; diagnostics before, None if there are no new ones.

    Motion in a window can prevent convergence, and would pass for noise or drift of the sensors.
    """
    if iteration.point is None or iteration.status == "outside_model":
        return None
    joint = iteration.joint
    moving_windows = joint.moving_windows(iteration.state, iteration.point.compensated, suspect)
    if not moving_windows.any():
        return None
    table = analyse_solution(solver, iteration, uncertain).table
    before = replace(solver.diagnostics(joint), sequences=table)
    iteration.joint = joint.with_integrated(moving_windows)
    solver.restart()
    return before


def _relies_on_fixture(iteration: IterationState, uncertain: Array) -> bool:
    """True if the nominal angles of the fixture give a parameter more accurately than the test, which lacks sequences.

    ``uncertain`` is the sigma of the initial values. Poses alone measure the directions that the fixture states.
    """
    joint, data = iteration.joint, iteration.joint.data
    if data.nominal is None or data.posed.all() or set(SEQUENCES) <= set(data.ids):
        return False
    if joint.options.prior is not None or joint.relies_on_fixture:
        return False
    vague = iteration.free & (uncertain > 0.0) & (iteration.sigma > uncertain)
    return bool(vague.any()) or iteration.status != "converged"


def _vague(iteration: IterationState, requested: Mask) -> Mask:
    """Parameters that neither the measurements nor the nominal angles of the fixture give, but for omissible ones.

    They are fixed: within a prior as wide as a third, the iteration would wander. That of omissible ones is narrow.
    """
    known = determined_by_fixture(iteration.joint.data) | OMISSIBLE
    if iteration.point is not None:
        known = known | observable_parameters(iteration.point.system, requested)
    return np.asarray(~known)


def _not_shown_by_poses(joint: JointModel) -> dict[str, str]:
    """Parameters that a test of poses and stated rates does not show, with reasons; none if there are other rotations.

    They are fixed from the start. With a wide prior, the square of a misalignment of a third would become a scale
    error, and the iteration would wander.
    """
    by_earth_rate = seen_by_earth_rate_alone(joint.data)
    if not by_earth_rate:
        return {}
    wanted = np.array([name not in by_earth_rate and name not in joint.options.fixed_names for name in NAMES])
    observable = observable_parameters(linearise(joint, *placed(joint, joint.start), wanted), ~wanted)
    others = [name for name, lost in zip(NAMES, wanted & ~observable, strict=True) if lost]
    return by_earth_rate | {name: reason_not_observed(name) for name in others}


def observable_at_start(joint: JointModel, wanted: Mask) -> Mask:
    """Mask of those of the wanted parameters that are observed by the sigmas of the initial estimate, shape (27,)."""
    start = placed(joint, joint.start)
    observable = observable_parameters(linearise(joint, *start, wanted), ~wanted)
    covariance = BlockSolution(linearise(joint, *start, wanted, default_prior())).covariance
    limit = observed_limit(joint.choice.admission, finest_sigma(covariance))
    return observable & (np.sqrt(np.diag(covariance)) <= limit)


def _with_sound_moves(joint: JointModel, solver: JointSolver, count: Iterations) -> IterationState:
    """Solution without the moves that contradict the other measurements, left out one after the other.

    If there is none, or no move is left, the state is that before the first iteration.
    """
    requested = np.array([name in joint.options.fixed_names for name in NAMES])
    while joint.data.moves:
        iteration = iterate(solver, IterationState.at_start(joint, requested), count=count)
        joint = iteration.joint
        if iteration.status != "converged":
            solver.restart()
            break
        if (changed := explained(solver, iteration, (G_SENSITIVITY, FIXTURE))) is not None:
            joint = changed.joint
            continue
        reasons = _contradicting_move(solver, iteration)
        if not reasons:
            return iteration
        found = _with_drift(solver, iteration, count, lambda at: len(_contradicting_move(solver, at)))
        if found is not None:
            return found
        joint = joint.without_moves(reasons)
        solver.restart()
    return IterationState.at_start(joint, requested)


def _contradicting_move(solver: JointSolver, iteration: IterationState) -> dict[int, str]:
    """Move that contradicts the other measurements of a solution, with the reason; empty if none does."""
    joint = iteration.joint
    against = contradictions(joint, whole_solution(solver, iteration))
    tests = [(against[step].chi_square, against[step].degrees_of_freedom) for step in joint.rank.tolist()]
    return contradicting_move(tests, joint.data.is_move)
