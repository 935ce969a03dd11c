"""Estimator ``closed-form``: the iterated closed-form SRT (Savage 2020 [P], §§6-9), and its result.

Unmodelled noise and drift are tested: residuals that noise does not explain enlarge all sigmas by their Birge ratio,
and they show a drift or step of the biases of a triad. ``least-squares`` models both.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.closed_form.fixture_accuracy import fixture_excess
from srt.closed_form.formulas import SelectedFormulas
from srt.closed_form.iteration import iterate, iterate_units
from srt.closed_form.leave_one_out import sequence_diagnostics
from srt.closed_form.measurement_covariance import accel_drift, covariance, covariance_by_source, disturbances, effect
from srt.estimation import g_sensitivity_report
from srt.estimation.calibration_builder import build_calibration, partial_or_converged, reported_covariance
from srt.estimation.drift_model import DriftEstimate, change, gyro_statistics, most_likely, possible_sigma
from srt.estimation.error_sources import NO_ERRORS, as_found
from srt.estimation.fixed_parameters import fixed_sigma, fixed_values, reason_on_request, value_of_fixed
from srt.estimation.g_sensitivity import MODE as G_SENSITIVE
from srt.estimation.g_sensitivity import RestRates
from srt.estimation.goodness_of_fit import chi_square, contradicting_group, faulty_group, is_misfit
from srt.estimation.initial_estimates import initial_estimate, initial_estimates
from srt.estimation.options import Options
from srt.estimation.rest_rate_scatter import gyro_instability
from srt.estimation.solver_result import SolverResult
from srt.exceptions import DataError
from srt.model import srt_formulas
from srt.model.table1 import SEQUENCES
from srt.noise.drift_forms import LINEAR, drift_test, likelihood_gain, variance_component
from srt.result.calibration import Residual
from srt.result.diagnostics import Diagnostics
from srt.result.verdict import MISFIT_PROBABILITY
from srt.sensor_errors import N_PARAMETERS, NAMES, SensorErrors
from srt.sequences.checked_preparation import prepare_checked, prepare_together
from srt.sequences.moves import recorded_moves
from srt.sequences.prepared_units import alike, together

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.closed_form.solution import Solution
    from srt.estimation.drift_model import DriftTerm, Sensor
    from srt.estimation.error_sources import UnmodelledErrors
    from srt.estimation.registry import Progress
    from srt.noise.drift_forms import Statistics
    from srt.recording.recording import Recording, SequenceLabel
    from srt.result.calibration import Calibration
    from srt.result.diagnostics import GSensitivity
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

ESTIMATOR: Final = "closed-form"
"""Name of the estimator in results."""
_SOLVED_EXACTLY: Final = 1e-6
"""Residual sigma over measurement sigma below which a component is solved exactly and its residual sigma is zero."""


def estimate(recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
    """Calibrate by the iterated closed-form SRT.

    Raises
    ------
    DataError
        If the recording has no fixture, or its sequences are not those of Table 1.
    """
    prepared = _Prepared.of(recording, options)
    unit = prepared.from_estimate(*initial_estimate(prepared.data, options))
    return unit.calibration(unit.solution(progress), progress)


@dataclass(frozen=True, slots=True, eq=False)
class UnitEstimate:
    """Estimate of one of many units: what its calibration states, without the report on the measurements.

    Attributes
    ----------
    estimator, status, message, errors, covariance, corrections, observed
        As those of :class:`srt.result.calibration.Calibration`.
    """

    estimator: str
    status: str
    message: str
    errors: SensorErrors
    covariance: Array
    corrections: tuple[float, ...]
    observed: Mask

    @property
    def sigma(self) -> Array:
        """1-sigma of every parameter, shape (27,); NaN for fixed parameters."""
        return np.where(self.observed, np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.nan)


def estimate_units(recordings: Sequence[Recording], options: Sequence[Options]) -> list[UnitEstimate | Exception]:
    """Calibrate units, with those of one schedule as arrays; results are those of :func:`estimate` to rounding.

    Parameters
    ----------
    recordings : sequence of Recording
    options : sequence of Options
        Of each recording. Units with different options, except for the errors to start from, are iterated apart.

    Returns
    -------
    list of UnitEstimate or Exception
        Of each unit: what its calibration states, or what :func:`estimate` raises for it.
    """
    out: list[UnitEstimate | Exception | None] = [None] * len(recordings)
    groups: dict[int, list[tuple[int, _Prepared]]] = {}  # by their formulas
    prepare_together([(own, _labels(own), chosen.average) for own, chosen in zip(recordings, options, strict=True)])
    for number, (recording, chosen) in enumerate(zip(recordings, options, strict=True)):
        try:
            unit = _Prepared.of(recording, chosen, [group[0][1] for group in groups.values()])
        except Exception as error:  # a unit that cannot be calibrated leaves the others
            out[number] = error
            continue
        groups.setdefault(id(unit.formulas), []).append((number, unit))
    for group in groups.values():
        units = []
        for (number, prepared), first in zip(group, _first_estimates([unit for _, unit in group]), strict=True):
            if isinstance(first, Exception):
                out[number] = first
            else:
                units.append((number, prepared.from_estimate(*first)))
        for (number, unit), solution in zip(units, _solutions([unit for _, unit in units]), strict=True):
            try:
                out[number] = solution if isinstance(solution, Exception) else unit.estimate(solution)
            except Exception as error:
                out[number] = error
    return [found for found in out if found is not None]


def _labels(recording: Recording) -> tuple[SequenceLabel, ...]:
    return tuple(s for s in recording.sequences if s.id in SEQUENCES)


def _first_estimates(units: list[_Prepared]) -> Sequence[tuple[SensorErrors, Array] | Exception]:
    """Initial estimates of units of one schedule, each in its turn where they fail together.

    Raises
    ------
    Exception
        As :func:`_solutions`.
    """
    try:
        return initial_estimates(together([unit.data for unit in units]), [unit.options for unit in units])
    except Exception:
        found: list[tuple[SensorErrors, Array] | Exception] = []
        for unit in units:
            try:
                found.append(initial_estimate(unit.data, unit.options))
            except Exception as error:
                found.append(error)
        if not any(isinstance(first, Exception) for first in found):
            raise
        return found


def _solutions(units: list[_Unit]) -> Sequence[Solution | Exception]:
    """Solutions of units of one schedule, each in its turn where they cannot be iterated together.

    Raises
    ------
    Exception
        A failure of the units together that none of them has alone.
    """
    if not units:
        return []
    first = units[0]
    start, U = np.stack([unit.first[0].vector for unit in units]), np.stack([unit.first[1] for unit in units])
    data = together([unit.data for unit in units])
    try:
        return iterate_units(data, first.options, first.formulas, start, U, fixed_sigma=first.uncertain)
    except Exception:
        found: list[Solution | Exception] = []
        for unit in units:
            try:
                found.append(unit.solution())
            except Exception as error:
                found.append(error)
        if not any(isinstance(solution, Exception) for solution in found):
            raise
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    """Recording before the initial estimate, with the uncertainty of fixed parameters."""

    recording: Recording
    options: Options
    labels: tuple[SequenceLabel, ...]
    data: PreparedRecording
    uncertain: Array
    formulas: SelectedFormulas

    @classmethod
    def of(cls, recording: Recording, options: Options, others: Sequence[_Prepared] = ()) -> _Prepared:
        """Prepare a recording; formulas are those of the first of others that can be iterated together with it."""
        options.refuse(("loss", "filter", "prior", "fixture_states", "live", "targets"), "The closed form")
        labels = _labels(recording)
        if recording.fixture is None or not labels:
            raise DataError(
                "The closed form needs labelled sequences of Table 1 on a fixture, and this recording has none; "
                "use the least-squares estimator."
            )
        data = prepare_checked(recording, labels, options.average)
        uncertain = fixed_sigma(data, options)
        like = next((own for own in others if own.is_like(data, options, uncertain)), None)
        formulas = SelectedFormulas(data, options) if like is None else like.formulas
        return cls(recording, options, labels, data, uncertain, formulas)

    def is_like(self, data: PreparedRecording, options: Options, uncertain: Array) -> bool:
        """True if another unit can be iterated together with this one."""
        # The initial estimates are arrays by unit.
        names = [f.name for f in fields(Options) if f.name != "start"]
        same = all(getattr(self.options, name) == getattr(options, name) for name in names)
        return same and np.array_equal(self.uncertain, uncertain) and alike(self.data, data)

    def from_estimate(self, initial: SensorErrors, U: Array) -> _Unit:
        """Unit with an initial estimate, whose fixed parameters have their values."""
        fixed = self.formulas.fixed
        if fixed.any():
            values = fixed_values(self.data, self.options, initial).vector
            initial = SensorErrors(np.where(fixed, values, initial.vector))
        own = {f.name: getattr(self, f.name) for f in fields(_Prepared)}
        return _Unit(**own, first=(initial, U))


@dataclass(frozen=True, slots=True, eq=False)
class _Unit(_Prepared):
    """Recording before the iteration, with its initial estimate."""

    first: tuple[SensorErrors, Array]

    def solution(self, progress: Progress | None = None) -> Solution:
        return iterate(self.data, self.options, self.formulas, *self.first, progress, fixed_sigma=self.uncertain)

    def calibration(self, solution: Solution, progress: Progress | None = None) -> Calibration:
        """Calibration of the solution, or of one with other noise or g-sensitivity if the residuals show them."""
        return self._final(solution, progress).calibration()

    def estimate(self, solution: Solution) -> UnitEstimate:
        """Statement of the calibration of a solution; the calibration is built where the measurements disagree."""
        final = self._final(solution)
        found = final.undisputed()
        if found is not None:
            return found
        built = final.calibration()
        stated = {f.name: getattr(built, f.name) for f in fields(UnitEstimate)}
        return UnitEstimate(**stated)

    def _final(self, solution: Solution, progress: Progress | None = None) -> _FinalSolution:
        options, data, formulas, uncertain = self.options, self.data, self.formulas, self.uncertain
        used = options
        if options.gyro_bias == "auto" and _shows_g_sensitivity(data, solution):
            used = replace(options, gyro_bias=G_SENSITIVE)
            solution = iterate(data, used, formulas, *self.first, progress, fixed_sigma=uncertain, before=solution)
        data, solution = _with_instability(data, used, formulas, solution, fixed_sigma=uncertain, progress=progress)
        excess, stated = NO_ERRORS, data
        if solution.status == "converged" and solution.verticals_disagree:
            excess = fixture_excess(data, solution.measurements, solution.covariance)
        if any(excess):
            data, start = as_found(data, excess), (solution.errors, solution.U)
            uncertain = fixed_sigma(data, options)
            solution = iterate(data, used, formulas, *start, progress, fixed_sigma=uncertain, before=solution)
        return _FinalSolution(self, stated, data, uncertain, solution, excess)


@dataclass(frozen=True, slots=True, eq=False)
class _FinalSolution:
    """Solution of a unit with all noise that its residuals show: data as ``stated``, and with excess of the fixture."""

    unit: _Unit
    stated: PreparedRecording
    data: PreparedRecording
    uncertain: Array
    solution: Solution
    excess: UnmodelledErrors

    def fixed(self) -> dict[str, str]:
        """Fixed parameters with the reason."""
        data, options, formulas = self.data, self.unit.options, self.unit.formulas
        fixed = {name: reason_on_request(name, self.uncertain, data) for name in options.fixed_names}
        for name in formulas.missing:
            absent = [s for s in srt_formulas.sequences_needed(name) if s not in data.ids]
            value = value_of_fixed(name, self.uncertain, data, options)
            reason = (
                f"sequence {', '.join(absent)} is missing or void" if absent else "the closed form has no formula of it"
            )
            fixed[name] = f"{reason}; {value}"
        return fixed

    def undisputed(self) -> UnitEstimate | None:
        """Estimate if the residuals show nothing but the noise, or it did not converge; else None."""
        solution, by_unseen = self.solution, np.zeros((N_PARAMETERS, N_PARAMETERS))
        status, message, observed = solution.status, solution.message, ~self.unit.formulas.fixed
        if status == "converged":
            fit = _fit(solution)
            if is_misfit(*fit) or contradicting_group(solution.sequence_tests, *fit) is not None:
                return None
            by_unseen = _unseen(self.data, solution)[1]
            status, message = partial_or_converged(
                message, (*self.unit.options.fixed_names, *self.unit.formulas.missing)
            )
        if status == "outside_model":
            observed = np.zeros(N_PARAMETERS, dtype=np.bool_)
        covariance = reported_covariance(self.stated, solution.covariance + by_unseen, observed)
        if not (np.isfinite(covariance).all() and np.isfinite(solution.errors.vector).all()):
            return None
        return UnitEstimate(ESTIMATOR, status, message, solution.errors, covariance, solution.corrections, observed)

    def calibration(self) -> Calibration:
        unit, data, fixed = self.unit, self.data, self.fixed()
        recording, options = unit.recording, unit.options
        unused = [s.title for s in recording.sequences if s.id not in SEQUENCES]
        warnings = (f"Not of Table 1 and not used by the closed form: {', '.join(unused)}.",) if unused else ()
        result = _result(data, options, unit.formulas, self.solution, np.array([name in fixed for name in NAMES]))
        result = replace(result, unmodelled=self.excess)
        if not options.ignore_moves:
            moves = len(recorded_moves(recording, unit.labels))
            result = replace(result, diagnostics=replace(result.diagnostics, unused_moves=moves))
        return build_calibration(ESTIMATOR, self.stated, options, result, fixed, warnings=warnings)


def _shows_g_sensitivity(data: PreparedRecording, solution: Solution) -> bool:
    """True if the residuals exceed the noise, and the rest rates show a g-sensitivity of the gyros."""
    m = solution.measurements
    if solution.status != "converged" or not is_misfit(*solution.chi_square):
        return False
    return g_sensitivity_report.significant_g_sensitivity(data, m.force, m.rest_rate, m.integrated) is not None


def _with_instability(
    data: PreparedRecording, options: Options, formulas: SelectedFormulas, solution: Solution, **given: Any
) -> tuple[PreparedRecording, Solution]:
    """Solution with the bias instability that residuals and rates at rest show, if that alone explains them."""
    if solution.status != "converged" or formulas.fixed.all():
        return data, solution
    noise, m, sizes, gain = data.noise, solution.measurements, dict[str, Any](), 0.0
    before = solution.chi_square
    if np.any(noise.accel_limit > noise.accel_flicker):
        _, seen = _by_accel_drift(solution, data.window_drift)
        component = variance_component(seen)
        shown = component.p_value < MISFIT_PROBABILITY or noise.accel_flicker.any()
        if shown or is_misfit(*before):
            gain += likelihood_gain(component.ratio, 1, *before)
            sizes["accel_instability"] = noise.expected_accel_instability(seen)[0]
    if noise.gyro_wander is None and options.gyro_bias == "auto":
        rates = data, m.gyro.inverse, m.rest_rate, m.integrated
        if solution.may_be_unstable and (of_gyros := gyro_instability(*rates, (), m.window_sequence)) is not None:
            sizes["gyro_instability"], gain = of_gyros[0], gain + of_gyros[1]
    if not sizes or _drift(data, solution):
        return data, solution
    if faulty_group(solution.sequence_tests, *before, against=gain, wholly=True) is not None:
        return data, solution
    other = replace(data, **sizes)
    found = iterate(other, options, formulas, solution.errors, solution.U, before=solution, **given)
    fit = found.chi_square
    if found.status != "converged" or is_misfit(*fit) or contradicting_group(found.sequence_tests, *fit) is not None:
        return data, solution.counted(found.iterations())
    return other, found


def _fit(solution: Solution) -> tuple[float, int]:
    """Chi-square and degrees of freedom, with the squares of the fixture's errors in the noise if they explain it."""
    fit = solution.chi_square
    if is_misfit(*fit) and not is_misfit(*(with_squares := solution.white_with_squares.test)):
        return with_squares
    return fit


def _result(
    data: PreparedRecording, options: Options, formulas: SelectedFormulas, solution: Solution, fixed: Mask
) -> SolverResult:
    """Solver result of a solution whose ``fixed`` parameters are not estimated."""
    m, R, forces = solution.measurements, solution.measurement_covariance, slice(2 * data.K, -3)
    statistic, freedom = _fit(solution)
    by_source = covariance_by_source(m, data, solution.wander, solution.gain, solution.projection, solution.held)
    followed, notes = _g_sensitivity(data, solution, automatic=options.gyro_bias != G_SENSITIVE)
    drift: tuple[DriftEstimate, ...] = ()
    possible, changed = 0.0, None
    if solution.status == "converged" and not fixed.all():
        drift = _drift(data, solution)
        changed = solution.scale_change(data)
        possible, by_unseen = _unseen(data, solution)
        by_source["accel_bias_instability"] += by_unseen
    return SolverResult(
        errors=solution.errors,
        U=solution.U,
        covariance=by_source,
        corrections=solution.corrections,
        refits=solution.refits,
        status=solution.status,
        message=solution.message,
        residuals=_residuals(data, solution),
        chi_square=statistic,
        degrees_of_freedom=freedom,
        sensor_noise_fit=(statistic, freedom),
        force_fit=chi_square(m.z[forces], m.H[forces, ~fixed], R[forces, forces]),
        integrated=solution.integrated,
        wander=solution.wander,
        bias_by_sequence=solution.bias_by_sequence,
        end_attitude=m.integrals.C_end,
        diagnostics=Diagnostics(
            g_sensitivity=followed,
            possible_accel_drift_sigma_m_s2=possible or None,
            drift=tuple(term.result for term in drift) or None,
        ),
        drift=drift,
        scale_change=changed,
        sequences=() if solution.status == "outside_model" else sequence_diagnostics(data, formulas, solution, fixed),
        notes=notes,
    )


def _drift(data: PreparedRecording, solution: Solution) -> tuple[DriftEstimate, ...]:
    """Significant drift of each triad. A linear drift is tested, and steps where it is likely."""
    m, course = solution.measurements, data.drift_shapes[LINEAR].windows

    def statistics(sensor: Sensor, course: Array) -> Statistics:
        if sensor == "gyro":
            return gyro_statistics(data, m.gyro.inverse, m.rest_rate, m.integrated, (), {"": course})[""]
        return _by_accel_drift(solution, course)[1]

    def by_window(sensor: Sensor) -> Statistics:
        return statistics(sensor, np.eye(len(course)))

    def estimated(term: DriftTerm) -> DriftEstimate:
        shape = data.drift_shape(*term[:2]).windows
        test = drift_test(statistics(term.sensor, shape))
        assert test is not None
        change_by = change(term.form, test.amplitude.reshape(-1, 3), shape)
        return DriftEstimate(term.sensor, term.form, change_by, modelled=False)

    linear: dict[tuple[Sensor, str], Statistics] = {
        ("accel", LINEAR): solution.by_linear_drift[1],
        ("gyro", LINEAR): statistics("gyro", course),
    }
    return tuple(estimated(term) for term in most_likely(data, linear, (), 0.0, by_window).terms)


def _by_accel_drift(solution: Solution, course: Array) -> tuple[Array, Statistics]:
    """Effect on the measurements of accelerometer biases that follow courses, and its statistics in the residuals."""
    by_drift = effect(solution.projection, accel_drift(solution.measurements, np.ones(3), course))
    return by_drift, solution.white.statistics(by_drift)


def _unseen(data: PreparedRecording, solution: Solution) -> tuple[float, Array]:
    """Possible linear drift of the accelerometers, m/s², and the covariance by what the residuals do not exclude."""
    by_drift, linear = solution.by_linear_drift
    possible = 0.0 if (test := drift_test(linear)) is None else possible_sigma(linear, test.p_value)
    root = possible * solution.gain @ by_drift
    by_unseen = root @ root.T
    if data.noise.accel_unseen.any():
        by_instability, seen = _by_accel_drift(solution, data.window_drift)
        root = data.noise.expected_accel_instability(seen)[1] * solution.gain @ by_instability
        by_unseen = by_unseen + root @ root.T
    return possible, by_unseen


def _g_sensitivity(
    data: PreparedRecording, solution: Solution, *, automatic: bool
) -> tuple[GSensitivity | None, tuple[str, ...]]:
    """Estimated g-sensitivity of the gyros, and warnings."""
    m = solution.measurements
    if m.poses is None:
        size = g_sensitivity_report.significant_g_sensitivity(data, m.force, m.rest_rate, m.integrated)
        return None, g_sensitivity_report.warnings(None, size, automatic=automatic)
    rest = RestRates(m.poses, m.force, m.rest_rate, m.pool, m.window_sequence, m.gyro)
    # Γ is linear in the rates of the windows.
    W = len(m.pool)
    of_rates = np.einsum("ab,wc->acwb", m.gyro.matrix, m.poses.weights)
    projection = {kind: np.zeros((9, *part.shape[1:])) for kind, part in solution.projection.items()}
    projection["rate"] = of_rates.reshape(9, W, 3)
    by_noise = covariance(projection, disturbances(m, data, solution.wander).values())
    found = g_sensitivity_report.estimated_g_sensitivity(data, rest, solution.g_sensitivity, by_noise, solution.wander)
    return found, g_sensitivity_report.warnings(m.poses.unobserved, None, automatic=automatic)


def _residuals(data: PreparedRecording, solution: Solution) -> tuple[Residual, ...]:
    """Residuals after the last iteration with their predicted sigma, zero where a component is solved exactly."""
    z, sigma = solution.measurements.z, np.sqrt(np.maximum(np.diag(solution.residual_covariance), 0.0))
    measurement_sigma = np.sqrt(np.diag(solution.measurement_covariance))
    sigma[sigma < _SOLVED_EXACTLY * measurement_sigma] = 0.0
    rows = []
    for k, name in enumerate(data.ids):
        sequence = data.catalogue[k]
        horizontal = ("1", "2") if sequence is None else sequence.horizontal
        for j, axis in enumerate(horizontal):
            rows.append((name, data.occurrences[k], f"horizontal_{axis}", 2 * k + j))
        for label, w in (("start_down", data.start[k]), ("end_down", data.end[k])):
            rows.append((name, data.occurrences[k], label, 2 * data.K + int(w)))
    return tuple(Residual(n, o, c, float(z[i]), float(sigma[i])) for n, o, c, i in rows)
