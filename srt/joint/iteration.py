"""Gauss-Newton iteration of the joint model.

It solves for the attitudes of the windows together with the sensor errors. The iteration of the closed form, which
solves for the sensor errors alone, is :mod:`srt.closed_form.iteration`.

Each iteration re-processes (plays back, Savage 2020, §8) the recorded data. Solvers differ only in their
:class:`~srt.joint.solver.JointSolver`: compensation, observability, convergence, goodness of fit and the result are the
same.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.sparse import hstack

from srt.estimation.iterations import CONVERGED_CORRECTION, CONVERGED_SIGMAS, MAX_STEP, PARAMETER_UNITS
from srt.estimation.observability import admission_sigma, admit
from srt.joint.block_solution import eliminate
from srt.joint.initial_attitudes import initial_attitudes
from srt.joint.linear_system import N_ERRORS, global_columns, total
from srt.joint.linearisation import Linearisation
from srt.model.rotations import rotation_matrix, rotation_vector
from srt.model.sensor_model import outside_model
from srt.sensor_errors import N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from srt.estimation.iterations import Iterations
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import CompensatedData, JointState
    from srt.joint.linear_system import Columns, LinearSystem
    from srt.joint.solver import IterationState, JointSolver
    from srt.types import Array, Mask


_SCATTER_UPDATES: Final = 2
"""Number of updates of the bias scatter. Further updates could alternate between zero and a small scatter."""
_INDEPENDENT: Final = 1e-10
"""Columns are scaled to norm 1. A smaller diagonal element of R marks a linearly dependent column."""
_REVERSED: Final = 0.5
"""Share of a correction that the next one takes back, and of that the next, from which the three alternate."""
_ALIGNED, _ALIKE, _LONGEST = 0.9, 2, 20.0
"""Cosine between corrections along one line, how many of these in turn show their ratio, and the largest sum."""
_NEAR: Final = 1e-2
"""The noise is assessed, and alternating corrections are halved, below this correction (dimensionless, rad, g)."""


def apply_correction(state: JointState, c: Columns, delta: Array) -> JointState:
    """Apply a correction of the columns ``c`` to a state.

    Raises
    ------
    InputError
        If the correction is not finite.
    """
    bias = delta[c["bias"]].reshape(-1, 3)
    common = bias.mean(axis=0)
    vector = state.errors.vector.copy()
    vector[:N_ERRORS] += delta[c["errors"]]
    deviation = state.bias_deviation
    if len(bias) > 1:
        deviation = deviation + bias - common
        shift = deviation.mean(axis=0)
        deviation, common = deviation - shift, common + shift
    vector[N_ERRORS:] += common
    assert state.attitude is not None
    # Columns are rotations about the axes of L; attitudes are corrected from the right, in B.
    in_body = np.einsum("wba,wb->wa", state.attitude, delta[c["attitude"]].reshape(-1, 3))
    return replace(
        state,
        errors=SensorErrors(vector),
        bias_deviation=deviation,
        base=state.base @ rotation_matrix(delta[c["base"]]),
        U=state.U @ rotation_matrix(delta[c["mounting"]]),
        non_orthogonality=state.non_orthogonality + float(delta[c["non_orthogonality"]][0]),
        gravity=state.gravity + float(delta[c["gravity"]][0]),
        earth_rate=state.earth_rate + delta[c["earth_rate"]].reshape(-1, 3),
        drift=state.drift + delta[c["drift_form"]],
        attitude=state.attitude @ rotation_matrix(in_body),
        table_rate=state.table_rate + float(delta[c["table_rate"]].sum()),
    )


def iterate(
    solver: JointSolver,
    iteration: IterationState,
    *,
    count: Iterations | None = None,
    converged: tuple[float, float] = (CONVERGED_CORRECTION, CONVERGED_SIGMAS),
    max_step: float = MAX_STEP,
) -> IterationState:
    """Compensate, linearise and solve until the correction is negligible.

    Parameters
    ----------
    solver : JointSolver
    iteration : IterationState
        Model, initial state and free parameters.
    count : Iterations, optional
        Count over all models.
    converged : (float, float)
        Corrections below either limit are negligible: absolute, and in sigmas.
    max_step : float
        Longest step; longer ones are shortened to it.
    """
    corrections: list[float] = [] if iteration.corrections is None else iteration.corrections
    iteration.corrections = corrections
    if count is not None:
        count.begin()
    scatter_updates = 0
    damping = _Damping()
    for _ in range(iteration.joint.options.max_playbacks):
        near = bool(corrections) and corrections[-1] < _NEAR
        last = corrections[-1] if near else None
        joint, state, compensated = _compensate(iteration.joint, iteration.state, scatter_updates, last)
        iteration.joint, scatter_updates = joint, scatter_updates + near
        point = Linearisation(joint, state, compensated, iteration.free)
        correction = _correct(solver, iteration, point, max_step, damping, count)
        if correction is None:
            break
        sigma = iteration.sigma
        if (tied := joint.with_tied_ends(sigma)) is not None:
            iteration.joint = tied
            continue
        negligible = np.maximum(converged[0] * PARAMETER_UNITS, converged[1] * sigma)
        if (
            np.all(np.abs(correction) <= negligible)
            and _neglected_tilt(state, iteration.state) <= converged[1] * _least_tilt_sigma(joint, compensated)
            and solver.settled
        ):
            iteration.status, iteration.message = "converged", f"Converged after {len(corrections)} iterations."
            break
    else:
        iteration.status = "not_converged"
        iteration.message = (
            f"Not converged after {len(corrections)} iterations: the last correction was {corrections[-1]:.2e} "
            "(largest component: ratios, rad; accelerometer bias in g)."
        )
    return iteration


class _Damping:
    """Share of a correction that is applied: while corrections alternate, it is halved whenever one reverses the last.

    Asymmetry makes the model continuous but not smooth: where a channel reads zero, the corrections of both sides can
    point to each other for ever, although the minimum lies between them. Weights of robust losses alternate, too.

    Corrections that shrink slowly along one line are those of a direction that is hardly determined beside the accuracy
    of the Jacobian: their geometric series is summed (Aitken's method).
    """

    def __init__(self) -> None:
        self._share, self._last, self._reversed, self._alike = 1.0, np.zeros(N_PARAMETERS), False, 0

    def share(self, correction: Array) -> float:
        """Share of this correction, in :data:`PARAMETER_UNITS`."""
        along, size = float(correction @ self._last), float(self._last @ self._last)
        taken_back = _REVERSED * size < -along < size / _REVERSED
        if np.max(np.abs(correction)) > _NEAR:  # far from the solution, linearisation alone can reverse corrections
            taken_back, self._share = False, 1.0
        if along < 0.0 and ((taken_back and self._reversed) or self._share < 1.0):
            self._share *= 0.5
        aligned = self._share == 1.0 and np.max(np.abs(correction)) <= _NEAR and along < size
        aligned &= along > _ALIGNED * np.sqrt(size * float(correction @ correction))
        self._alike = self._alike + 1 if aligned else 0
        self._last, self._reversed = correction, taken_back
        if self._alike < _ALIKE:
            return self._share
        self._alike = 0
        return min(size / (size - along), _LONGEST)


def _neglected_tilt(before: JointState, after: JointState) -> float:
    """Largest tilt that the linearisation of the attitudes left out in the last correction, rad.

    It is the product of tilt and heading, which for milliradians exceeds the noise of the accelerometers; a change of
    heading alone leaves nothing out.
    """
    assert before.attitude is not None
    assert after.attitude is not None
    turned = rotation_vector(after.attitude @ np.swapaxes(before.attitude, 1, 2))
    return float(np.max(np.hypot(turned[:, 0], turned[:, 1]) * np.linalg.norm(turned, axis=1)))


def _least_tilt_sigma(joint: JointModel, compensated: CompensatedData) -> float:
    """Smallest standard deviation of the tilt that the mean force of a window shows, rad."""
    variance = np.einsum("waa->wa", total(compensated.force_noise))
    return float(np.sqrt(variance.min())) / joint.data.gravity


def _compensate(
    joint: JointModel, state: JointState, scatter_updates: int, correction: float | None
) -> tuple[JointModel, JointState, CompensatedData]:
    """Compensate the data; close to the solution, also update the priors of the model that the data show.

    ``scatter_updates`` is the number of updates so far; the last correction is None while the state is far from the
    solution.
    """
    compensated = joint.compensate(state)
    if state.attitude is None:
        state = initial_attitudes(joint, state, compensated)
    if correction is None:
        return joint, state, compensated
    if scatter_updates == 0:
        joint = joint.with_mounting_prior(state)
    if scatter_updates < _SCATTER_UPDATES:
        joint = joint.with_bias_scatter(state, compensated, correction)
        if not joint.bias_walks and state.bias_deviation.any():  # a fault of one sequence caused the scatter
            state = replace(state, bias_deviation=np.zeros_like(state.bias_deviation))
            compensated = joint.compensate(state)
    return joint, state, compensated


def _correct(
    solver: JointSolver,
    iteration: IterationState,
    point: Linearisation,
    max_step: float,
    damping: _Damping,
    count: Iterations | None,
) -> Array | None:
    """Solve the linearised model and correct the state; None if there is no valid correction, with the status set."""
    iteration.status = "outside_model"  # the caller overwrites this status after a valid correction
    try:
        solved = solver.solve(point)
    except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises ValueError for numbers that are not finite
        iteration.message = f"The equations cannot be solved ({error})."
        return None
    delta, correction = solved.delta, solved.correction
    if not np.all(np.isfinite(delta)) or not np.all(np.isfinite(solved.covariance)):
        iteration.message = "The correction is not finite."
        return None
    size = float(np.max(np.abs(correction) / PARAMETER_UNITS))
    if size > max_step:
        delta, correction = delta * (max_step / size), correction * (max_step / size)
    share = damping.share(correction / PARAMETER_UNITS)
    delta, correction = share * delta, share * correction
    assert iteration.corrections is not None
    iteration.corrections.append(size)
    if count is not None:
        count(len(iteration.corrections), size)
    iteration.state = apply_correction(point.state, point.columns, delta)
    iteration.point, iteration.covariance = point, solved.covariance
    if solved.whole is not None:
        iteration.whole = point, solver.prior, solved.whole
    reason = outside_model(iteration.state.errors)
    if reason is not None:
        iteration.message = f"After iteration {len(iteration.corrections)} {reason}."
        return None
    return correction


def observable_parameters(system: LinearSystem, requested: Mask) -> Mask:
    """Mask of the sensor errors that are observable if all other unknowns are estimated, too, shape (27,)."""
    bias = system.columns["bias"]
    number = (bias.stop - bias.start) // 3
    active = system.active.copy()
    active[system.columns["errors"]] = True
    A = system.A
    if number > 1:  # the biases are re-parametrised as their mean, in the columns of the first, and K − 1 deviations
        mean = sum(A[:, bias.start + 3 * k : bias.start + 3 * k + 3] for k in range(number))
        A = hstack([A[:, : bias.start], mean, A[:, bias.start + 3 :]]).tocsr()
    active[bias.start : bias.start + 3] = True
    again = replace(system, A=A, active=active)
    columns = global_columns(again)
    R = eliminate(again, columns)[2][:, :-1]
    parameters = np.concatenate([system.columns.of("errors"), system.columns.of("bias")[:3]])
    others = R[:, ~np.isin(columns, parameters)]
    wanted = R[:, np.searchsorted(columns, parameters)]
    Q, T = np.linalg.qr(others / np.maximum(np.linalg.norm(others, axis=0), 1e-300))
    Q = Q[:, np.abs(np.diag(T)) > _INDEPENDENT]  # dependent columns add rounding errors only
    left = wanted - Q @ (Q.T @ wanted)
    return admit(left * admission_sigma(), ~requested)
