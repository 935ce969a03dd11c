"""Suspected gyro readings in turns by hand: motion, if the turns are likelier with them than with predicted ones.

A false reading adds a known angle to the rotation between two stationary windows. At a solution of the joint model,
with its weights and derivatives fixed, the residuals change by a known vector where a reading is replaced by what its
neighbours predict, and twice the logarithm of the ratio of both likelihoods is the change of chi-square. The noise is
that at rest and what the median of the residuals of each kind shows beyond it, so that a false reading does not enlarge
its own yardstick.

The turns do not accuse a reading by themselves: in recorded turns by hand, twice that logarithm was up to 25 for true
motion, whose readings its neighbours and the other channels show.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import chdtri, ndtri

from srt.estimation.observability import default_prior
from srt.estimation.white_residuals import LEAST_PREDICTED_SHARE
from srt.exceptions import DataError
from srt.joint.block_solution import BlockSolution
from srt.joint.iteration import iterate
from srt.joint.least_squares import BlockSolver
from srt.joint.linearisation import linearise
from srt.joint.recording_opening import open_joint_model
from srt.joint.solver import IterationState
from srt.model import measurement_model as model
from srt.model.platform_steps import AttitudeChain, Steps
from srt.model.rotations import to_matrix
from srt.model.sensor_model import gyro_triad
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import CompensatedData, JointState
    from srt.recording.recording import Recording
    from srt.sensor_errors import SensorErrors
    from srt.types import Array, Indices, Mask

_CONTRADICTED: Final = 0.01
"""Probability that the turns contradict any of the false readings of a recording."""
_ROUNDS: Final = 5
"""Largest number of solutions: a false reading that is replaced can reveal another."""
_KINDS: Final = (("force", "force_noise", "pose_excess"), ("rate", "rate_noise", "rest_excess"),
                 ("turn", "rotation_noise", "turn_excess"))  # fmt: skip
"""Kinds of rows, and the name and source of their noise."""
_SAME: Final = 0.1
"""Relative change of the noise that is negligible."""


class Suspects(NamedTuple):
    """Suspected gyro readings; a burst is judged as one suspect.

    Attributes
    ----------
    sample, axis, number : ndarray of int, shape (n,)
        Sample and axis of each reading, and number of its suspect.
    jump : ndarray, shape (n,)
        Reading less its prediction, stored value.
    """

    sample: Indices
    axis: Indices
    number: Indices
    jump: Array


def false_readings(recording: Recording, options: Options, suspects: Suspects) -> Mask:
    """Suspects that the turns do not contradict, and that matter beside the noise of their turns, shape (m,).

    All of them, if the recording cannot be solved.
    """
    false = before = np.ones(int(suspects.number.max()) + 1, dtype=np.bool_)
    limit = float(ndtri(_CONTRADICTED / len(false))) ** 2
    for _ in range(_ROUNDS):
        turns = _solved(recording, options, suspects, false)
        if turns is None:
            return false
        before, false = false, turns.uncontradicted(false, limit)
        if np.array_equal(before, false):
            break
    assert turns is not None
    return before & false & turns.relevant(before & false)


class _Turns(NamedTuple):
    """Residuals of a linearised solution, and what they would change by if suspected readings were as recorded.

    Attributes
    ----------
    residual : ndarray, shape (rows,)
        Whitened residuals with some suspects replaced.
    change : ndarray, shape (rows, m)
        Change of the residuals of the solution by the jump of each suspect.
    turn : ndarray of int, shape (m,)
        Member of the rows of the rotations that each suspect belongs to; −1 for none.
    """

    residual: Array
    change: Array
    turn: Indices

    def uncontradicted(self, false: Mask, limit: float) -> Mask:
        """Suspects of which chi-square is not smaller by ``limit`` with the reading as recorded, shape (m,).

        ``false`` are those that are replaced in the residuals.
        """
        found, own = false.copy(), np.sum(self.change**2, axis=0)
        for _ in range(2 * len(found)):
            along = self.change.T @ (self.residual + self.change @ (false.astype(np.float64) - found))
            gain = np.where(found, -limit - 2.0 * along - own, 2.0 * along - own + limit)
            gain[self.turn < 0] = 0.0
            best = int(np.argmax(gain))
            if gain[best] <= 0.0:
                break
            found[best] = ~found[best]
        return found

    def relevant(self, false: Mask) -> Mask:
        """Suspects in turns whose false readings together change the residuals by more than their sigma, shape (m,)."""
        size = np.where(false & (self.turn >= 0), np.sum(self.change**2, axis=0), 0.0)
        return np.asarray(((self.turn[:, None] == self.turn) @ size > 1.0) & (self.turn >= 0))


def _solved(recording: Recording, options: Options, suspects: Suspects, false: Mask) -> _Turns | None:
    """Solution with the false readings replaced; None if there is none."""
    gone = false[suspects.number]
    if gone.any():
        gyro = recording.gyro.copy()
        gyro[suspects.sample[gone], suspects.axis[gone]] -= suspects.jump[gone]
        recording = replace(recording, gyro=gyro)
    requested = np.array([name in options.fixed_names for name in NAMES])
    try:
        joint, solver = open_joint_model(recording, options), BlockSolver(options.prior or default_prior())
        iteration = iterate(solver, IterationState.at_start(joint, requested))
        if iteration.point is None or iteration.status == "outside_model":
            return None
        moving = iteration.joint.moving_windows(iteration.point.state, iteration.point.compensated)
        if moving.any():
            iteration.joint = iteration.joint.with_integrated(moving)
            iteration = iterate(solver, iteration)
        joint, point = iteration.joint, iteration.point
        if point is None or iteration.status == "outside_model":
            return None
        solution = BlockSolution(linearise(joint, point.state, point.compensated, iteration.free, solver.prior))
        for _ in range(_ROUNDS):
            data = _with_robust_noise(solution)
            if data is None:
                break
            solution = BlockSolution(linearise(joint, point.state, data, iteration.free, solver.prior))
        return _turns(joint, point.state, solution, suspects)
    except (DataError, np.linalg.LinAlgError):
        return None


def _with_robust_noise(solution: BlockSolution) -> CompensatedData | None:
    """Data with the noise that makes the median of the squared residuals of each kind as expected; None if it is."""
    system, changed = solution.system, False
    data, left = system.compensated, 1.0 - solution.leverage
    for kind, name, source in _KINDS:
        rows, noise = system.rows_of(kind).index.ravel(), getattr(data, name)
        seen = rows[left[rows] > LEAST_PREDICTED_SHARE]
        if not seen.size:
            continue
        ratio = float(np.median(solution.residual[seen] ** 2 / left[seen])) / float(chdtri(1, 0.5))
        total = float(np.median(1.0 / np.sum(system.whitening[kind] ** 2, axis=2)))
        unit = np.broadcast_to(np.eye(3), next(iter(noise.values())).shape)
        before = float(noise[source].max()) if source in noise else 0.0
        after = max(total * ratio - (total - before), 0.0)
        if abs(after - before) > _SAME * max(after, before):
            data, changed = replace(data, **{name: noise | {source: after * unit}}), True
    return data if changed else None


def _turns(joint: JointModel, state: JointState, solution: BlockSolution, suspects: Suspects) -> _Turns:
    """Residuals, and their changes by the suspects, of a solution."""
    system, data = solution.system, joint.data
    assert state.attitude is not None
    rows, m = system.rows_of("turn"), int(suspects.number.max()) + 1
    inside = (data.rotation[:, 0] <= suspects.sample[:, None]) & (suspects.sample[:, None] < data.rotation[:, 1])
    member = np.full(data.K, -1, dtype=np.intp)
    member[rows.owner] = np.arange(len(rows.owner))
    sequence = np.where(inside.any(axis=1), np.argmax(inside, axis=1), -1)
    turn = np.where(sequence >= 0, member[sequence], -1)
    used = np.flatnonzero(turn >= 0)
    angle = _angles(joint, state.errors, suspects, used, sequence[used])
    first, last = data.start[rows.owner], data.end[rows.owner]
    by_rotation = model.rotation_residual(
        system.compensated.rotation[rows.owner],
        state.attitude[first],
        state.attitude[last],
        joint.earth_rate(state)[first],
        np.asarray(system.compensated.duration_s)[rows.owner],
    ).by_rotation
    # The derivative is that by the error of the rotation: a rotation that is larger by φ has the error −φ.
    white = -np.einsum("nab,nbc,nc->na", system.whitening["turn"][turn[used]], by_rotation[turn[used]], angle)
    effect = np.zeros((len(system.b), m))
    np.add.at(effect, (rows.index[turn[used]], suspects.number[used][:, None]), white)
    of_suspect = np.full(m, -1, dtype=np.intp)
    of_suspect[suspects.number[used]] = turn[used]
    change = effect - system.A @ solution.with_columns(np.asarray(system.A.T @ effect))
    return _Turns(solution.residual, np.asarray(change), of_suspect)


def _angles(joint: JointModel, errors: SensorErrors, suspects: Suspects, used: Indices, sequence: Indices) -> Array:
    """Rotation vectors in B_Strt of the jumps of the readings ``used``, in their sequences, (n, 3), rad."""
    stream, gyro, recording = joint.processor.stream, gyro_triad(errors), joint.data.recording
    at = stream.rotation[sequence, 0] + suspects.sample[used] - joint.data.rotation[sequence, 0]
    steps = Steps(stream, gyro, np.zeros((joint.data.K, 3)), None)
    steps.chain = AttitudeChain(np.concatenate([stream.starts[:-1], at]))
    steps.block(0, len(stream.interval_s))
    attitude = np.moveaxis(to_matrix(np.ascontiguousarray(steps.chain.edges)), 2, 0)
    jump = suspects.jump[used] * recording.rates_factor * recording.nominal_interval_s
    raw = gyro.inverse[:, suspects.axis[used]].T * jump[:, None]
    return np.asarray(np.einsum("nba,nbc,nc->na", attitude[sequence], attitude[joint.data.K :], raw))
