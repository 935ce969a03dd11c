"""Estimator ``closed-form``: solves the formulas of :mod:`srt.model.closed_form` at the current sensor errors.

Eq. 13 of Savage 2020 [P] reads one combination of measured components per parameter. The solver keeps this choice, S,
and inverts their full Jacobian: ``δ = (S H)⁻¹ S z``; at zero error that equals the coefficients of the
paper. Leave-one-out solves the formulas that the other sequences support.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation.calibration_builder import build_calibration
from srt.estimation.fixed_parameters import fixed_sigma, reason_on_request
from srt.estimation.initial_estimates import initial_estimate
from srt.estimation.leave_one_out import LeaveOneOutEstimate, pooling_weights_without
from srt.estimation.solver_result import solver_result
from srt.estimation.unmodelled_errors import iterate_with_unmodelled_errors
from srt.exceptions import DataError
from srt.model import closed_form
from srt.model.table1 import AXES, SEQUENCES
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, NAMES
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.moves import recorded_moves

if TYPE_CHECKING:
    from srt.estimation.iteration import Solution
    from srt.estimation.leave_one_out import SequenceRows
    from srt.estimation.options import Options
    from srt.estimation.registry import Progress
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

_BIAS = GROUP_SLICES["gyro_bias"]


class ClosedFormSolver:
    """Solution of the formulas of the closed form, one combination of components per parameter, and of the rest rate.

    Parameters
    ----------
    data : PreparedRecording
        Sequences of Table 1; those that occur more than once are averaged.
    options : Options

    Raises
    ------
    DataError
        If the sequences support no formula at all.
    """

    def __init__(self, data: PreparedRecording, options: Options) -> None:
        self.data = data
        fixed = set(options.fixed_names)
        supported = closed_form.formulas(set(data.ids), asymmetry=not {*NAMES[GROUP_SLICES["gyro_asymmetry"]]} <= fixed)
        self.formulas = tuple(f for f in supported if f.parameter not in fixed)
        if not self.formulas:
            raise DataError(
                f"The sequences {', '.join(data.ids)} support none of the closed-form formulas; "
                "use the least-squares estimator, or record more of Table 1."
            )
        self.components = closed_form.components(self.formulas)
        self.missing = tuple(n for n in closed_form.missing_parameters(supported) if n not in fixed)
        self.rest_axes = [i for i, name in enumerate(NAMES[_BIAS]) if name not in fixed]
        self.kept = np.array([INDEX[f.parameter] for f in self.formulas] + [_BIAS.start + i for i in self.rest_axes])

    @cached_property
    def fixed(self) -> Mask:
        """Parameters without a formula, and those fixed on request, shape (27,)."""
        out = np.ones(N_PARAMETERS, dtype=np.bool_)
        out[self.kept] = False
        return out

    @cached_property
    def selection(self) -> Array:
        """Selection matrix S from the measurements to the formulas, shape (number of kept parameters, n_z).

        A row per formula: its components, each averaged over the repetitions of the sequence; then a row per gyro bias.
        """
        own = np.zeros((len(self.formulas), len(self.components)))
        order = {c: j for j, c in enumerate(self.components)}
        for row, formula in enumerate(self.formulas):
            for coefficient, component in formula.components:
                own[row, order[component]] = coefficient
        n_z = self._averaged.shape[1]
        return np.concatenate([own @ self._averaged, np.eye(n_z)[[n_z - 3 + i for i in self.rest_axes]]])

    @cached_property
    def _averaged(self) -> Array:
        """Components from the measurements, averaged over occurrences, shape (number of components, n_z)."""
        data = self.data
        out = np.zeros((len(self.components), 2 * data.K + len(data.windows.duration_s) + 3))
        for row, component in enumerate(self.components):
            occurrences = [k for k, name in enumerate(data.ids) if name == component.sequence]
            for k in occurrences:
                out[row, self._column(k, component.kind)] += 1.0 / len(occurrences)
        return out

    def _column(self, k: int, kind: str) -> int:
        data = self.data
        if kind == "start":
            return 2 * data.K + int(data.start[k])
        if kind == "end":
            return 2 * data.K + int(data.end[k])
        sequence = data.catalogue[k]
        assert sequence is not None
        return 2 * k + sequence.horizontal.index(kind)

    def gain(self, measurements: SrtMeasurements, covariance: Array, *, near: bool) -> Array:  # noqa: ARG002 - no weights here
        """Gain G = (S H)⁻¹ S of δ = G z: the inverse of the full Jacobian of the selected components."""
        S = self.selection
        G = np.zeros((N_PARAMETERS, S.shape[1]))
        G[self.kept] = np.linalg.solve(S @ measurements.H[:, self.kept], S)
        return G

    @cached_property
    def coefficients(self) -> Array:
        """Coefficients of [P] eq. 13 for the averaged components, and 1 for gyro bias by rest rate; shape (27, n_z)."""
        A = closed_form.inversion_matrix(self.formulas, self.data.gravity) @ self._averaged
        for i in self.rest_axes:
            A[_BIAS.start + i, A.shape[1] - 3 + i] = 1.0
        return A


def estimate(recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
    """Calibrate by the iterated closed-form SRT.

    Raises
    ------
    DataError
        If the recording has no fixture, or its sequences are not those of Table 1.
    """
    options.refuse(("loss", "filter", "prior", "fixture_states", "live", "targets"), "The closed form")
    labels = tuple(s for s in recording.sequences if s.id in SEQUENCES)
    if recording.fixture is None or not labels:
        raise DataError(
            "The closed form needs labelled sequences of Table 1 on a fixture, and this recording has none; "
            "use the least-squares estimator."
        )
    data = prepare_checked(recording, labels, options.average)
    first = initial_estimate(data, options)
    uncertain = fixed_sigma(data, options)
    solver = ClosedFormSolver(data, options)
    fitted = iterate_with_unmodelled_errors(data, options, lambda: solver, first, uncertain, progress)
    data = fitted.data
    fixed = {name: reason_on_request(name, uncertain, data) for name in options.fixed_names}
    for name in solver.missing:
        absent = [s for s in closed_form.sequences_needed(name) if s not in data.ids]
        source = "estimated from the fixture's nominal angles" if options.start == "auto" else "that of the given start"
        fixed[name] = f"sequence {', '.join(absent)} is missing or void; the value is {source}"
    unused = [s.title for s in recording.sequences if s.id not in SEQUENCES]
    warnings = (f"Not of Table 1 and not used by the closed form: {', '.join(unused)}.",) if unused else ()
    result = solver_result(fitted, options, fixed, without_sequences)
    if not options.ignore_moves:
        moves = len(recorded_moves(recording, labels))
        result = replace(result, diagnostics={**result.diagnostics, "unused_moves": moves})
    return build_calibration("closed-form", data, options, result, fixed, warnings=warnings)


def without_sequences(
    data: PreparedRecording, options: Options, solution: Solution, rows_by_sequence: list[SequenceRows]
) -> list[LeaveOneOutEstimate]:
    """Estimates without each sequence, by the formulas that the other sequences support."""
    measurements, n = solution.measurements, len(solution.measurements.z)
    fixed = options.fixed_names
    axes = [i for i in range(3) if NAMES[_BIAS.start + i] not in fixed]
    rates = np.eye(n)[[n - 3 + i for i in axes]]
    # As for uncorrelated measurements, a sequence's information is taken as its share of the parameter's variance.
    weight = solution.gain**2 * np.diag(solution.measurement_covariance)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    estimated = np.asarray(solution.gain.any(axis=1), dtype=np.bool_)
    pools = pooling_weights_without(data, solution, rows_by_sequence)
    shifts = (pools - measurements.pool) @ measurements.rest_rate
    measured = _measured(data)
    out = []
    for k, (rows, windows) in enumerate(rows_by_sequence):
        again = data.ids.count(data.ids[k]) > 1
        ids = frozenset(data.ids) if again else frozenset(data.ids) - {data.ids[k]}
        parameters, coefficients = _supported(ids, fixed)
        S = coefficients @ (_measured(data, without=k) if again else measured)
        kept = list(parameters)
        if pools[k].any():
            kept += [_BIAS.start + i for i in axes]
            S = np.concatenate([S, rates])
        z = measurements.z.copy()
        z[n - 3 :] += shifts[k]
        lost = estimated.copy()
        lost[kept] = False
        change = np.zeros(N_PARAMETERS)
        if kept:
            change[kept] = np.linalg.solve(S @ measurements.H[:, kept], S @ z)
        share = weight[:, rows].sum(axis=1) + weight[:, n - 3 :].sum(axis=1) * measurements.pool[windows].sum()
        out.append(LeaveOneOutEstimate(np.where(estimated, change, 0.0), lost, np.where(lost, 1.0, share)))
    return out


_COMPONENTS: Final = tuple(closed_form.Component(s, kind) for s in SEQUENCES for kind in (*AXES, "start", "end"))
_PLACE: Final = {component: i for i, component in enumerate(_COMPONENTS)}


@lru_cache(maxsize=256)
def _supported(ids: frozenset[str], fixed: tuple[str, ...]) -> tuple[tuple[int, ...], Array]:
    """Parameters that a set of sequences determines, and the coefficients of :data:`_COMPONENTS` in their formulas."""
    asymmetry = not {*NAMES[GROUP_SLICES["gyro_asymmetry"]]} <= {*fixed}
    formulas = [f for f in closed_form.formulas(ids, asymmetry=asymmetry) if f.parameter not in fixed]
    coefficients = np.zeros((len(formulas), len(_COMPONENTS)))
    for row, formula in zip(coefficients, formulas, strict=True):
        for coefficient, component in formula.components:
            row[_PLACE[component]] = coefficient
    return tuple(INDEX[f.parameter] for f in formulas), coefficients


def _measured(data: PreparedRecording, without: int = -1) -> Array:
    """:data:`_COMPONENTS` from the measurements, averaged over repetitions; sequence ``without`` is omitted."""
    out = np.zeros((len(_COMPONENTS), 2 * data.K + len(data.windows.duration_s) + 3))
    for k, sequence in enumerate(data.catalogue):
        if k == without or sequence is None:
            continue
        rows = {axis: 2 * k + i for i, axis in enumerate(sequence.horizontal)}
        rows |= {"start": 2 * data.K + int(data.start[k]), "end": 2 * data.K + int(data.end[k])}
        count = data.ids.count(data.ids[k]) - (without >= 0 and data.ids[k] == data.ids[without])
        for kind, row in rows.items():
            out[_PLACE[closed_form.Component(data.ids[k], kind)], row] += 1.0 / count
    return out
