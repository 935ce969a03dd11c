"""Filters linearised about their running estimate, sequence by sequence, for comparison with the iterated filter.

They start at the initial estimate (:func:`initial_prior`), process every sequence once in time
order, and never return to an earlier one:

- ``one-pass``: each sequence linearised about the estimate from the sequences before it (textbook extended filter);
- ``per-sequence``: the update of each sequence iterated (iterated extended filter);
- ``unscented``: see :mod:`estimators.unscented_filter`.

Limits: one level frame, no window shared by two sequences, no stated rates, and one gyro bias. There is no convergence
criterion. Instead, the estimate is compared with the optimum of all measurements, linearised about the estimate; a
difference of more than 1 sigma is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.kalman_filter import FilterRun, filter_diagnostics, hand_on, padded, prior_root
from estimators.nuisance_elimination import eliminate_nuisances
from estimators.square_root_filter import SquareRootFilter
from srt.estimation.fixed_parameters import determined_by_fixture, fixed_sigma, reason_on_request
from srt.estimation.initial_estimates import estimate_from_fixture
from srt.estimation.iterations import PARAMETER_UNITS
from srt.exceptions import InputError
from srt.joint.initial_attitudes import placed
from srt.joint.iteration import apply_correction
from srt.joint.linear_system import attitude_columns, global_columns
from srt.joint.linearisation import Linearisation, linearise
from srt.joint.nominal_attitudes import mounting_prior
from srt.joint.solution_analysis import FixedParameters, make_calibration, whole_solution
from srt.joint.solver import IterationState, JointSolver, LinearSolution
from srt.model.prior import Prior
from srt.model.sensor_model import outside_model
from srt.result.diagnostics import Optimum
from srt.sensor_errors import NAMES, SensorErrors

if TYPE_CHECKING:
    from srt.estimation.registry import Progress
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import JointState
    from srt.result.calibration import Calibration
    from srt.result.diagnostics import Diagnostics
    from srt.types import Array, Mask


_ITERATIONS: Final = {"one-pass": 1, "per-sequence": 10}
"""Maximum number of linearisations of each sequence."""
_SETTLED_SIGMAS: Final = 1e-3
"""The iteration of a sequence has converged if the correction, in sigmas of the updated state, is below this."""
_ATTITUDE_PASSES: Final = 3
"""Number of linearisations of the attitudes for the comparison with the optimum: the second is exact to 1e-9 rad."""
_OPTIMUM_SIGMAS: Final = 1.0
"""Distance from the optimum of all measurements, in sigmas, above which linearisation errors are reported."""
_START_SIGMAS: Final = 3.0
"""Factor on the fixture's accuracy in the prior: its angles are measurements, too, and this second use of them makes no
sigma smaller by more than 5 %."""


@dataclass(frozen=True, slots=True, eq=False)
class SequenceUpdate:
    """Estimate after the update with a sequence.

    Attributes
    ----------
    state : JointState
    x : ndarray, shape (n,)
        Mean of the filter's states: zero for states that ``state`` includes.
    root : ndarray, shape (n, n)
        Square root of the states' covariance.
    correction : ndarray, shape (27,)
        Correction of the reported parameters by this sequence.
    covariance : ndarray, shape (27, 27)
    innovations : ndarray
        Innovations, normalised and decorrelated.
    """

    state: JointState
    x: Array
    root: Array
    correction: Array
    covariance: Array
    innovations: Array


class SequentialFilter(JointSolver):
    """Filter that processes each sequence once, linearised about the running estimate.

    Parameters
    ----------
    joint : JointModel
    prior : Prior
    form : "one-pass" or "per-sequence"
    free : ndarray of bool, shape (27,)
        Parameters that are estimated.

    Raises
    ------
    InputError
        If the recording or the options require states that these filters do not model.
    """

    name = "ekf"
    error_source = "errors of the linearisation about its earlier estimates"

    def __init__(self, joint: JointModel, prior: Prior, form: str, free: Mask) -> None:
        windows = np.concatenate([joint.data.start, joint.data.end])
        unsuitable = len(joint.level_frames) > 1 or joint.bias_walks or bool(joint.steady.rated.size)
        if unsuitable or len(np.unique(windows)) < len(windows):
            raise InputError(
                f"The filter {form!r} needs labelled sequences on a fixture, no shared windows, no stated rates and "
                "one gyro bias: use filter='iterated'."
            )
        self.prior: Prior = prior
        self.form, self.free = form, free
        self.last: FilterRun | None = None
        self.optimum: Optimum | None = None

    def solve(self, point: Linearisation) -> LinearSolution:
        """Unavailable, as these filters choose their own linearisation points."""
        raise NotImplementedError

    def diagnostics(self, joint: JointModel) -> Diagnostics:
        """Innovations and standard deviations by sequence, and the comparison with the optimum."""
        return replace(filter_diagnostics(joint, self.last), optimum=self.optimum)

    def process(self, joint: JointModel, progress: Progress | None) -> IterationState:
        """Process all sequences in time order, starting from the prior mean."""
        joint, data = joint.with_choice(ends_tied=True), joint.data  # the filter does not return to a sequence later
        if isinstance(joint.options.start, SensorErrors) and data.nominal is not None:
            # The rotation of MARS on the table, too, would be that of the given errors, and is not renewed later.
            U, note = mounting_prior(data.recording.fixture, estimate_from_fixture(data, data.rotation_stream)[1])
            joint = joint.with_choice(U_prior=U, U_note=note)
        vector = np.where(self.free, self.prior.mean.vector, joint.fixed_values.vector)
        start = replace(joint.start, errors=SensorErrors(vector), U=joint.choice.U_prior)
        iteration = IterationState(joint, start, self.free)
        iteration.corrections = []
        updates: list[SequenceUpdate] = []
        for i, k in enumerate(joint.order.tolist()):
            try:
                update = self.update(joint, iteration.state, i, updates[-1] if updates else None)
            except (np.linalg.LinAlgError, ValueError) as error:
                iteration.message = f"The filter {self.form!r} failed in sequence {joint.data.ids[k]}: {error}."
                return iteration
            updates.append(update)
            iteration.state = update.state
            iteration.corrections.append(float(np.max(np.abs(update.correction) / PARAMETER_UNITS)))
            if progress is not None:
                progress(i + 1, iteration.corrections[-1])
        self.last = FilterRun(
            delta=np.zeros(0),
            correction=updates[-1].correction,
            covariance=updates[-1].covariance,
            sequences=tuple(joint.order.tolist()),
            innovations=tuple(update.innovations for update in updates),
            sigma=np.array([np.sqrt(np.diag(update.covariance)) for update in updates]),
        )
        iteration.covariance = updates[-1].covariance
        self._compare_with_optimum(iteration)
        return iteration

    def update(
        self, joint: JointModel, state: JointState, number: int, previous: SequenceUpdate | None
    ) -> SequenceUpdate:
        """Update the estimate with a sequence, linearised once or until the correction is negligible."""
        state, compensated = placed(joint, state)
        total: Array | float = 0.0
        for i in range(_ITERATIONS[self.form]):
            if i:
                compensated = joint.compensate(state)
            system = linearise(joint, state, compensated, self.free)
            part = eliminate_nuisances(system, number)[-1]
            columns = global_columns(system)
            n, handed = len(columns), max(len(part.before), len(part.after))
            if previous is None:
                root, mean = np.zeros((n + handed, n + handed)), np.zeros(n + handed)
                root[:n, :n], mean[:n] = prior_root(system, state, self.prior, columns)
            else:
                root, mean = previous.root, previous.x.copy()
                mean[:n] -= total  # predicted state relative to the present linearisation point
            ekf = SquareRootFilter(mean, root)
            ekf.correct(-part.b, padded(np.concatenate([part.H, part.H_handed], axis=1), len(mean)))
            delta = np.zeros(system.columns.count)
            delta[columns] = ekf.x[:n]
            # The attitudes are those expected before the drift of the next sequence is known.
            handed_in = ekf.x[n : n + len(part.before)]
            by_g, by_p, constant, _ = part.advance()
            handed_on = by_g @ ekf.x[:n] + by_p @ handed_in + constant
            delta[part.local[0]] = part.nuisances(ekf.x[:n], handed_in, handed_on)
            state = apply_correction(state, system.columns, delta)
            require_valid(state)
            total = total + ekf.x[:n]
            if np.all(np.abs(ekf.x[:n]) <= _SETTLED_SIGMAS * np.linalg.norm(ekf.root[:n], axis=1)):
                break
        E = padded(system.columns.parameter_map()[:, columns], len(ekf.x))
        covariance, innovations = ekf.project(E), ekf.whitened
        if len(part.after):
            hand_on(ekf, part, np.eye(n), handed)
        x = ekf.x.copy()
        x[:n] = 0.0
        return SequenceUpdate(state, x, ekf.root, E[:, :n] @ total, covariance, innovations)

    def _compare_with_optimum(self, iteration: IterationState) -> None:
        """Set the status by the distance of the estimate from the optimum of all measurements and the prior."""
        joint = iteration.joint
        state, compensated = placed(joint, iteration.state)
        for _ in range(_ATTITUDE_PASSES):
            iteration.point = point = Linearisation(joint, state, compensated, self.free)
            solution = whole_solution(self, iteration)
            kept = np.where(attitude_columns(point.columns), solution.delta, 0.0)
            state = apply_correction(state, point.columns, kept)
        assert iteration.covariance is not None
        E = point.columns.parameter_map()
        sigma = np.sqrt(np.maximum(np.diag(solution.covariance), np.finfo(float).tiny))
        distance = np.where(self.free, np.abs(E @ solution.delta) / sigma, 0.0)
        worst = int(np.argmax(distance))
        ratio = (np.sqrt(np.diag(iteration.covariance)) / sigma)[self.free]
        self.optimum = Optimum(
            distance_sigma=float(distance[worst]),
            parameter=NAMES[worst],
            sigma_ratio=(float(ratio.min()), float(ratio.max())),
        )
        if distance[worst] <= _OPTIMUM_SIGMAS:
            iteration.status, iteration.message = "converged", f"Processed {joint.data.K} sequences once."
        else:
            iteration.message = (
                f"The filter {self.form!r} ended {distance[worst]:.3g} sigma ({NAMES[worst]}) from the optimum of all "
                f"measurements: {self.error_source}."
            )


def initial_prior(joint: JointModel, prior: Prior) -> Prior:
    """Distribution of the sensor errors with which a sequential filter begins.

    It has the mean that the options give and the covariance of the prior, or it is the prior updated with the estimate
    from the fixture's nominal angles. With that mean and a wide covariance, a filter is inconsistent: the derivatives
    of a sequence are wrong by the errors of the mean, and act on the width of the covariance.

    Parameters
    ----------
    joint : JointModel
    prior : Prior
    """
    if isinstance(joint.options.start, SensorErrors):
        return replace(prior, mean=joint.options.start)
    seen = determined_by_fixture(joint.data)
    mean, P = prior.mean.vector, prior.covariance
    R = np.diag((_START_SIGMAS * fixed_sigma(joint.data, joint.options)[seen]) ** 2)
    gain = np.linalg.solve(P[np.ix_(seen, seen)] + R, P[seen]).T
    mean = mean + gain @ (joint.start.errors.vector - mean)[seen]
    return Prior(SensorErrors(mean), P - gain @ P[seen])


def require_valid(state: JointState) -> None:
    """Raise an error if the estimated errors are outside the sensor model."""
    reason = outside_model(state.errors)
    if reason is not None:
        raise np.linalg.LinAlgError(f"the estimate left the sensor model, as {reason}")


def run_sequentially(solver: SequentialFilter, joint: JointModel, progress: Progress | None) -> Calibration:
    """Calibrate with a filter that processes each sequence once.

    Raises
    ------
    InputError
        If an option does not apply to joint estimation.
    """
    options = joint.options
    refused = ("step", "down", "measured_vertical", *(["start"] if options.start == "zero" else []))
    options.refuse(refused, f"The filter {solver.form!r}")
    uncertain = fixed_sigma(joint.data, options)
    fixed = FixedParameters(
        {name: reason_on_request(name, uncertain, joint.data) for name in options.fixed_names}, uncertain
    )
    with threadpool_limits(limits=1, user_api="blas"):
        return make_calibration(solver, solver.process(joint, progress), fixed, None)
