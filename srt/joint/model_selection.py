"""Explanations of the residuals of a converged solution: what the joint model has besides the sensor errors.

:data:`EXPLANATIONS` are tried in order, each at the same solution; :func:`explained` takes the first that holds. Its
function returns the iteration with the model that it selects, or None if the model stays as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.estimation.drift_model import (
    MOST_TERMS,
    DriftSearch,
    candidates,
    gyro_courses,
    gyro_statistics,
    most_likely,
)
from srt.estimation.error_sources import LARGEST_FIXTURE_RAD, NO_ERRORS, accel_drift, by_drift, turns_estimated
from srt.estimation.g_sensitivity_report import significant_g_sensitivity
from srt.estimation.goodness_of_fit import contradicting_group, faulty_group, is_misfit
from srt.estimation.rest_rate_scatter import gyro_instability
from srt.joint.block_solution import BlockSolution
from srt.joint.linearisation import linearise
from srt.joint.residual_analysis import contradictions, undersampling_likelihood, unmodelled_noise
from srt.joint.solution_analysis import (
    accel_instability,
    force_statistics,
    goodness_of_fit,
    scale_change,
    whole_solution,
)
from srt.model.sensor_model import gyro_triad
from srt.noise.drift_forms import WALK, Statistics, VarianceComponent, likelihood_gain, variance_component
from srt.result.verdict import MISFIT_PROBABILITY

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from srt.estimation.drift_model import Sensor
    from srt.estimation.error_sources import UnmodelledErrors
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import JointState
    from srt.joint.linearisation import Linearisation
    from srt.joint.solver import IterationState, JointSolver
    from srt.noise.variance_components import RestrictedLikelihood
    from srt.types import Array


_FOLDED: Final = (0.4, 0.3)
"""Error of a rotation over its motion near half the sample rate: median, and spread of its logarithm. Readings of gyros
with known error, taken at a part of their rate, give 0.33 to 0.44, steps of the rate 0.52."""
_INTEGRATION: Final = (1e-10, 5e-6)
"""Range of the error of the rotations of a simulation without noise, over their angle."""
_SHARES: Final = 100
"""Errors in that range, a tenth apart, for which the likelihood is computed."""
_LARGEST_TURN_RAD: Final = 0.1
"""Largest error of a turn that is no fault of it."""
_SIZES: Final = (-5.0, 5.0)
"""Range of a bias instability of the gyros, logarithm of its ratio to the noise of a window."""
_BEYOND_WINDOWS: Final = 2.0
"""Largest bias instability of the gyros over that which the rates at rest do not exclude: turns see no other one."""
_SIZE_TOLERANCE: Final = 0.1
"""Tolerance of that logarithm; the recordings themselves tell it to a fifth at best."""
_SAME_NOISE: Final = (0.1, 1e-6)
"""Relative and absolute (rad, m/s², rad/s) change of the unmodelled error that is negligible."""


@dataclass(frozen=True, slots=True, eq=False)
class Converged:
    """A converged solution, whose residuals are to be explained.

    Attributes
    ----------
    solver : JointSolver
    iteration : IterationState
    solution : BlockSolution
        Solution of all columns.
    fit : float, int
        Chi-square of the residuals and its degrees of freedom.
    """

    solver: JointSolver
    iteration: IterationState
    solution: BlockSolution
    fit: tuple[float, int]

    @property
    def joint(self) -> JointModel:
        """Model of the solution."""
        return self.iteration.joint

    @property
    def misfit(self) -> bool:
        """True if the residuals exceed the noise."""
        return is_misfit(*self.fit)

    @property
    def point(self) -> Linearisation:
        """Linearisation of the solution."""
        assert self.iteration.point is not None
        return self.iteration.point


@dataclass(frozen=True, slots=True)
class Explanation:
    """Something that the joint model can have besides the sensor errors.

    Attributes
    ----------
    select : callable
        Iteration with the model that it selects for a solution, or None.
    beside_noise : bool
        True if it is tried where unmodelled noise of the unit is in the model, too. Such noise hides the others.
    """

    select: Callable[[Converged], IterationState | None]
    beside_noise: bool = False


def explained(
    solver: JointSolver, iteration: IterationState, explanations: tuple[Explanation, ...]
) -> IterationState | None:
    """Iteration with the first of some explanations that holds for a converged solution; None if none does.

    A robust loss reduces the weight of the sequences that do not agree instead.
    """
    if solver.weights():
        return None
    solution = whole_solution(solver, iteration)
    now = Converged(solver, iteration, solution, goodness_of_fit(iteration.joint, solver, solution))
    noisy = any(now.joint.choice.unmodelled_sigma.of_unit)
    tried = (one.select(now) for one in explanations if one.beside_noise or not noisy)
    found = next(filter(None, tried), None)
    if found is not None:
        solver.restart()
    return found


def _g_sensitivity(now: Converged) -> IterationState | None:
    """Gyro g-sensitivity, if the residuals exceed the noise and the rates at rest show it."""
    joint, point = now.joint, now.point
    if joint.options.gyro_bias != "auto" or joint.choice.drift.force_axes is not None or not now.misfit:
        return None
    rest = joint.rest_rate(point.state, point.compensated)
    if significant_g_sensitivity(joint.data, point.compensated.force, rest, joint.choice.integrated) is None:
        return None
    joint, state = joint.with_g_sensitivity(now.iteration.state)
    return replace(now.iteration, joint=joint, state=state)


def _fast_motion(now: Converged) -> IterationState | None:
    """Error of rotations by motion too fast for the sample rate; None if it is as before.

    It must be more likely than an error that is equal in all rotations, and than a fault of one of them. Without noise
    it is that of the integration of a simulation, which is too small to be anything else and need not be a misfit.
    """
    joint, data = now.joint, now.joint.data
    if not data.fast_motion.any():
        return None
    if data.undersampling is None and not now.misfit and not data.noise.noise_free:
        return None
    share = _undersampling(joint, now.solution, now.fit)
    if share is None or (
        data.undersampling is not None and math.isclose(share, data.undersampling, rel_tol=_SAME_NOISE[0])
    ):
        return None
    return replace(now.iteration, joint=joint.with_data(replace(data, undersampling=share)))


def _undersampling(joint: JointModel, solution: BlockSolution, fit: tuple[float, int]) -> float | None:
    """Error of the rotations over their fast motion by restricted likelihood and prior; None if others are likelier.

    An equal error of all rotations has no prior but that its logarithm is uniform, from the noise of the rotations to
    the largest error of an angle.
    """
    from scipy.optimize import minimize_scalar  # heavy, and few calibrations come here

    likelihood = undersampling_likelihood(joint, solution.system)
    if joint.data.noise.noise_free:
        return _integration_error(likelihood)
    none = likelihood.logarithm(np.zeros(2))
    equal = likelihood.variances(np.array([True, False]))
    turning = np.diff(joint.data.rotation, axis=1) * joint.data.recording.nominal_interval_s
    width = math.log(_LARGEST_TURN_RAD / float(joint.data.noise.gyro_white.max() * np.sqrt(np.median(turning))))
    median, spread = _FOLDED

    def logarithm(log_share: float) -> float:
        by_prior = 0.5 * ((log_share - math.log(median)) / spread) ** 2 + math.log(spread * math.sqrt(2.0 * math.pi))
        return likelihood.logarithm(np.array([0.0, math.exp(2.0 * log_share)])) - by_prior

    reach = 4.0 * spread
    bounds = math.log(median) - reach, math.log(median) + reach
    best = minimize_scalar(lambda x: -logarithm(x), bounds=bounds, method="bounded", options={"xatol": 1e-2})
    explained = -float(best.fun) - none
    if joint.data.undersampling is not None:
        return math.exp(float(best.x))
    if 2.0 * explained < chdtri(1, 2.0 * MISFIT_PROBABILITY):
        return None
    if -float(best.fun) < likelihood.logarithm(equal) - math.log(max(width, 1.0)):
        return None
    gain = likelihood_gain(2.0 * explained, 1, *fit)
    return None if _one_is_faulty(joint, solution, fit, gain) else math.exp(float(best.x))


def _integration_error(likelihood: RestrictedLikelihood) -> float | None:
    """Error of the rotations over their angle, expected with a prior uniform in it; None if it is no integration's."""
    share = np.geomspace(*_INTEGRATION, _SHARES)
    found = np.array([likelihood.logarithm(np.array([0.0, own])) for own in share**2])
    if np.argmax(found) == _SHARES - 1:
        return None
    weight = share * np.exp(found - found.max())  # of a grid in its logarithm
    return math.sqrt(float(weight @ share**2 / weight.sum()))


def _instability(now: Converged) -> IterationState | None:
    """A smooth drift, or a bias instability of accelerometers or gyros or both; None if none explains the residuals.

    Where one sequence contradicts the others, the instability must be more likely than a fault of that sequence.
    """
    joint, solver, iteration, solution, fit = now.joint, now.solver, now.iteration, now.solution, now.fit
    shown = _instabilities(now)
    if not shown:
        return None
    state, found = now.point.state, search(iteration, solution, fit[1])
    smooth = tuple(term for term in found.terms if term.sensor == "accel" and term.form != WALK)
    if smooth:
        model, before = joint.with_drift(smooth, state)
        if _explains(model, solver, iteration, before):
            return replace(iteration, joint=model, state=joint.with_drift(smooth, iteration.state)[1])
    if any(term.sensor == "gyro" for term in found.terms):
        shown = [sensors for sensors in shown if "gyro" not in sensors]
    undeviated = replace(state, bias_deviation=np.zeros_like(state.bias_deviation))
    gyro_size = cache(lambda: _gyro_size(joint, solver, iteration, undeviated))  # of gyros alone, and of both triads
    for sensors in shown:
        model, at, ratio = joint, state, 0.0
        if "gyro" in sensors:
            at = undeviated
            size, likelihood = gyro_size()
            ratio = 2.0 * (likelihood - solution.log_likelihood)
            model = joint.with_data(replace(joint.data, gyro_instability=size))
        if "accel" in sensors:
            other = solution if at is state else _solution(model, solver, iteration, at)
            ratio += accel_component(model, other, fit[1]).ratio
            model = model.with_data(replace(model.data, accel_instability=accel_instability(model, other)[0]))
        gain = likelihood_gain(ratio, len(sensors), *fit)
        if not _one_is_faulty(model, solution, fit, gain, wholly=True) and _explains(model, solver, iteration, at):
            own = at if "gyro" in sensors else iteration.state
            return replace(iteration, joint=model, state=replace(iteration.state, bias_deviation=own.bias_deviation))
    return None


def _instabilities(now: Converged) -> list[tuple[str, ...]]:
    """Sensors whose bias instability is to be tried, one alternative after the other.

    With a misfit, all that is not stated; else what windows, residuals or rates at rest show.
    """
    joint, noise, point = now.joint, now.joint.data.noise, now.point
    accel = bool(np.any(noise.accel_limit > noise.accel_flicker))
    gyro = noise.gyro_wander is None and joint.options.gyro_bias == "auto"
    if now.misfit:
        alternatives = [("accel",) * accel, ("gyro",) * gyro, ("gyro", "accel") if accel and gyro else ()]
        return [sensors for sensors in alternatives if sensors]
    accel = accel and bool(
        noise.accel_flicker.any() or accel_component(joint, now.solution, now.fit[1]).p_value < MISFIT_PROBABILITY
    )
    # The error of a g-sensitivity is in the rates at rest, too.
    if gyro and joint.bias_walks and joint.choice.drift.force_axes is None:
        slope, rest = _rest_rates(joint, point)
        owner, terms = joint.window_sequence, joint.choice.drift.terms
        gyro = gyro_instability(joint.data, slope, rest, joint.choice.integrated, terms, owner) is not None
    else:
        gyro = False
    return [("gyro",) * gyro + ("accel",) * accel] if gyro or accel else []


def _gyro_size(
    joint: JointModel, solver: JointSolver, iteration: IterationState, state: JointState
) -> tuple[float, float]:
    """Bias instability of the gyros by restricted likelihood at a state, rad/s, and its log-likelihood."""
    from scipy.optimize import minimize_scalar  # heavy, and few calibrations come here

    data, noise = joint.data, joint.data.noise
    # The compensated readings and their noise do not depend on it.
    compensated, gyro = joint.compensate(state), gyro_triad(state.errors)
    window = float(np.median(noise.gyro_white) / np.sqrt(np.median(data.windows.duration_s)))
    assert iteration.point is not None
    largest = math.log(_BEYOND_WINDOWS * _shown_at_rest(_rest_rates(joint, iteration.point)[1], window) / window)

    def cost(log_ratio: float) -> float:
        model = joint.with_data(replace(data, gyro_instability=window * math.exp(log_ratio)))
        changed = replace(compensated, drift=model.instability(compensated.slopes, gyro))
        return -BlockSolution(linearise(model, state, changed, iteration.free, solver.prior)).log_likelihood

    bounds = _SIZES[0], min(_SIZES[1], largest)
    best = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": _SIZE_TOLERANCE})
    return window * math.exp(float(best.x)), -float(best.fun)


def _shown_at_rest(rest: Array, window: float) -> float:
    """Largest bias instability that rates at rest with noise ``window`` do not exclude (3 sigma), rad/s."""
    scatter = float(np.mean(np.var(rest, axis=0, ddof=1)))
    doubt = 3.0 * math.sqrt(2.0 / (3.0 * (len(rest) - 1))) * max(scatter, window**2)
    return math.sqrt(max(scatter - window**2, 0.0) + doubt)


def _solution(joint: JointModel, solver: JointSolver, iteration: IterationState, state: JointState) -> BlockSolution:
    """Solution of a model, linearised at a state."""
    return BlockSolution(linearise(joint, state, joint.compensate(state), iteration.free, solver.prior))


def _rest_rates(joint: JointModel, point: Linearisation) -> tuple[Array, Array]:
    """Derivative of compensated rates by raw ones, and rates at rest with their bias and the drift that is modelled."""
    slope = np.asarray(np.linalg.inv(gyro_triad(point.state.errors).matrix), dtype=np.float64)
    drift = joint.choice.drift.raw("gyro", point.state.drift, "windows")
    return slope, joint.rest_rate(point.state, point.compensated) + drift @ slope.T


def _explains(joint: JointModel, solver: JointSolver, iteration: IterationState, state: JointState) -> bool:
    """True if a model explains the residuals at a state, and no sequence contradicts the others."""
    solution = _solution(joint, solver, iteration, state)
    fit = goodness_of_fit(joint, solver, solution)
    tests = [(test.chi_square, test.degrees_of_freedom) for test in contradictions(joint, solution)]
    return not is_misfit(*fit) and contradicting_group(tests, *fit, estimated_from=turns_estimated(joint.data)) is None


def _fixture_errors(now: Converged) -> IterationState | None:
    """Errors of a fixture less accurate than stated, if that explains the residuals; None if not."""
    if any(now.joint.choice.unmodelled_sigma) or not now.misfit or _one_is_faulty(now.joint, now.solution, now.fit):
        return None
    found = unmodelled_noise(now.joint, now.solution.system).of_fixture()
    model = _with_fixture_errors(now, found) if any(found.of_fixture) else None
    return None if model is None else replace(now.iteration, joint=model)


def _one_is_faulty(
    joint: JointModel,
    solution: BlockSolution,
    fit: tuple[float, int],
    against: float = -math.inf,
    *,
    wholly: bool = False,
) -> bool:
    """True if one sequence or move explains the misfit, and with a larger gain than an effect on all."""
    tests = [(test.chi_square, test.degrees_of_freedom) for test in contradictions(joint, solution)]
    turns = turns_estimated(joint.data)
    if faulty_group(tests, *fit, estimated_from=turns, against=against, wholly=wholly) is None:
        return False
    change = scale_change(joint, solution, fit[1])
    against = -math.inf if change is None else change.gain
    return faulty_group(tests, *fit, estimated_from=turns, against=against, wholly=wholly) is not None


def _with_fixture_errors(now: Converged, errors: UnmodelledErrors) -> JointModel | None:
    """Model with these errors of the fixture; None if it does not explain the residuals, or no fixture is so bad.

    Sequences and moves are then tested against each other with them.
    """
    if max(errors) > LARGEST_FIXTURE_RAD:
        return None
    model = now.joint.with_choice(unmodelled_sigma=errors)
    solution = _solution(model, now.solver, now.iteration, now.point.state)
    return None if is_misfit(*goodness_of_fit(model, now.solver, solution)) else model


def _unmodelled_noise(now: Converged) -> IterationState | None:
    """Unmodelled errors, if the residuals of several sequences exceed their noise; None if they are as before.

    If one sequence explains the misfit, that sequence is faulty: a warning names it, and no noise is added.
    """
    joint = now.joint
    # Unmodelled noise from an earlier round is always estimated again: it may be too large now.
    if not any(joint.choice.unmodelled_sigma) and (not now.misfit or _one_is_faulty(joint, now.solution, now.fit)):
        return None
    noise = unmodelled_noise(joint, now.solution.system)
    model = _with_fixture_errors(now, noise.of_fixture())
    if model is None:
        model = joint.with_choice(unmodelled_sigma=noise.of_all())
    if np.allclose(model.choice.unmodelled_sigma, joint.choice.unmodelled_sigma, *_SAME_NOISE):
        return None
    return replace(now.iteration, joint=model)


def _drift(now: Converged) -> IterationState | None:
    """The most likely form of drift that the residuals show; None if there is none.

    There is none if one faulty sequence or move explains the residuals with a larger likelihood. The unmodelled noise
    is then estimated again.
    """
    joint, iteration = now.joint, now.iteration
    if len(joint.choice.drift.terms) >= MOST_TERMS:
        return None
    iteration.unmodelled_drift = found = search(iteration, now.solution, now.fit[1])
    if not found.terms:
        return None
    if not any(joint.choice.unmodelled_sigma) and _one_is_faulty(joint, now.solution, now.fit, found.gain):
        iteration.unmodelled_drift = DriftSearch()
        return None
    # The other triad is searched again in what this form leaves.
    joint, state = joint.with_choice(unmodelled_sigma=NO_ERRORS).with_drift(found.terms[:1], iteration.state)
    return replace(iteration, joint=joint, state=state)


G_SENSITIVITY: Final = Explanation(_g_sensitivity)
FIXTURE: Final = Explanation(_fixture_errors)
DRIFT: Final = Explanation(_drift, beside_noise=True)
EXPLANATIONS: Final = (
    G_SENSITIVITY,  # it would pass for any of the others
    Explanation(_fast_motion),
    Explanation(_instability),
    Explanation(_unmodelled_noise, beside_noise=True),
    DRIFT,
)
"""Explanations in the order in which they are tried."""


def search(iteration: IterationState, solution: BlockSolution, freedom: int) -> DriftSearch:
    """Search the residuals of a joint solution for bias drift that it does not model."""
    joint = iteration.joint
    assert iteration.point is not None
    slope, data = iteration.point.compensated.slopes.force, joint.data
    keys = candidates(data, joint.choice.drift.terms)
    by_rate, rest = _rest_rates(joint, iteration.point)

    def of_gyro(courses: Mapping[str, Array]) -> dict[str, Statistics]:
        return gyro_statistics(data, by_rate, rest, joint.choice.integrated, joint.choice.drift.terms, courses)

    def by_window(sensor: Sensor) -> Statistics:
        each = np.eye(len(rest))
        if sensor == "gyro":
            return of_gyro({"each": each})["each"]
        # As the noise has it, of compensated force: more than the noise cannot be taken away from it.
        return force_statistics(solution, [by_drift(np.broadcast_to(np.eye(3), slope.shape), each)], freedom)[0]

    forms = [key for key in keys if key[0] == "accel"]
    effects = [by_drift(slope, data.drift_shapes[form].tested.windows) for _, form in forms]
    found = dict(zip(forms, force_statistics(solution, effects, freedom), strict=True))
    found |= {("gyro", form): statistics for form, statistics in of_gyro(gyro_courses(data, keys)).items()}
    return most_likely(data, found, joint.choice.drift.terms, joint.choice.unmodelled_sigma.force, by_window)


def accel_component(joint: JointModel, solution: BlockSolution, freedom: int) -> VarianceComponent:
    """Bias instability of the accelerometers that the residuals show, as a share of the limit of the noise model.

    Three quarters of the residuals are those of gyros and rotations. The chi-square of all therefore does not show an
    instability that the windows show.
    """
    effect = accel_drift(joint.data, solution.system.compensated.slopes.force, joint.data.noise.accel_limit)
    return variance_component(force_statistics(solution, [effect], freedom)[0])
