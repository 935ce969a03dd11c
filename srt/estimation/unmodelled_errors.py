"""Errors beyond the noise of the sensors in the closed form: of rotations and specific forces, and bias drift.

Where the residuals are larger than the noise, the closed form estimates the unmodelled errors from them by restricted
maximum likelihood. If one sequence alone explains the misfit, it is faulty, and no noise is added. Once the noise is
settled, a drift is searched for, which the result reports.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.estimation import measurement_covariance
from srt.estimation.drift_model import DriftSearch
from srt.estimation.drift_search import explaining_drift, search
from srt.estimation.error_sources import NO_ERRORS, UnmodelledErrors
from srt.estimation.g_sensitivity import MODE
from srt.estimation.g_sensitivity_report import significant_g_sensitivity
from srt.estimation.goodness_of_fit import (
    chi_square,
    contradicting_group,
    is_misfit,
    one_group_explains,
)
from srt.estimation.iteration import iterate
from srt.estimation.leave_one_out import consistency_tests, rows_of_sequences
from srt.noise.variance_components import restricted_likelihood

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.estimation.iteration import Solution, Solver
    from srt.estimation.options import Options
    from srt.estimation.registry import Progress
    from srt.sensor_errors import SensorErrors
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

_ROUNDS: Final = 3
"""Largest number of rounds that estimate the unmodelled errors."""


class Fitted(NamedTuple):
    """Solution with the noise that its residuals show.

    Attributes
    ----------
    data : PreparedRecording
        Recording with the noise that was used.
    solution : Solution
    solver : Solver
    unmodelled : UnmodelledErrors
    unmodelled_drift : DriftSearch
        Drift that the residuals show beyond what the solution models.
    """

    data: PreparedRecording
    solution: Solution
    solver: Solver
    unmodelled: UnmodelledErrors
    unmodelled_drift: DriftSearch


def iterate_with_unmodelled_errors(
    data: PreparedRecording,
    options: Options,
    new_solver: Callable[[], Solver],
    first: tuple[SensorErrors, Array],
    uncertain: Array,
    progress: Progress | None,
) -> Fitted:
    """Iterate, and repeat with unmodelled errors if the residuals contradict the noise.

    If the rest rates then show a g-sensitivity of the gyros, it is estimated first. If the largest bias instability
    that the windows cannot exclude explains the residuals, and no smooth drift does, it is used instead.

    Parameters
    ----------
    data : PreparedRecording
    options : Options
    new_solver : callable
        Makes a solver; every repetition has a new one.
    first : SensorErrors and ndarray, shape (3, 3)
        Initial estimate of the sensor errors and of U.
    uncertain : ndarray, shape (27,)
        Standard deviation of fixed values.
    progress : callable, optional
    """
    solver = new_solver()
    solution = iterate(data, options, solver, *first, progress, fixed_sigma=uncertain)
    present = NO_ERRORS
    for _ in range(_ROUNDS):
        if solution.status != "converged":
            break
        new = present
        fit = chi_square(solution, solver.fixed)
        if is_misfit(*fit):
            if options.gyro_bias == "auto" and _shows_g_sensitivity(solution, data):
                options, solver = replace(options, gyro_bias=MODE), new_solver()
                solution = iterate(data, options, solver, *first, progress, fixed_sigma=uncertain)
                continue
            if not any(present) and _explained_at_limit(solution, data, solver.fixed):
                if not explaining_drift(data, options, solution, solver.fixed):
                    data, solver = replace(data, noise_at_limit=True), new_solver()
                    solution = iterate(
                        data, options, solver, first[0], solution.U, progress,
                        excess=present, resume=solution, fixed_sigma=uncertain,
                    )  # fmt: skip
                    continue
            elif not any(present) and _one_sequence_explains(solution, data, solver.fixed, *fit):
                break
            new = _estimated(solution, data, solver.fixed, present)
        if np.allclose(new, present, rtol=0.1, atol=1e-6):
            break
        present, solver = new, new_solver()
        solution = iterate(
            data, options, solver, first[0], solution.U, progress,
            excess=present, resume=solution, fixed_sigma=uncertain,
        )  # fmt: skip
    found = search(data, options, solution, solver.fixed) if solution.status == "converged" else DriftSearch()
    return Fitted(data, solution, solver, present, found)


def _explained_at_limit(solution: Solution, data: PreparedRecording, fixed: Mask) -> bool:
    """True if the largest bias instability that the windows cannot exclude explains the residuals of all sequences."""
    grown = data.noise.accel_limit**2 - data.noise.accel_flicker**2
    if not np.any(grown > 0.0):
        return False
    G = measurement_covariance.accel_drift(solution.measurements, data, np.sqrt(np.maximum(grown, 0.0)))
    R = solution.measurement_covariance + G @ G.T
    fit = chi_square(solution, fixed, R)
    return not is_misfit(*fit) and contradicting_group(_tests(solution, data, fixed, R), *fit) is None


def _shows_g_sensitivity(solution: Solution, data: PreparedRecording) -> bool:
    m = solution.measurements
    return significant_g_sensitivity(data, m.force, m.rest_rate, m.integrated) is not None


def fit_to_sensor_noise(
    solution: Solution, data: PreparedRecording, fixed: Mask, present: UnmodelledErrors
) -> tuple[float, int]:
    """Chi-square of the residuals and its degrees of freedom, without the unmodelled errors in the noise."""
    return chi_square(solution, fixed, _sensor_noise(solution, data, present)[0])


def _sensor_noise(
    solution: Solution, data: PreparedRecording, present: UnmodelledErrors
) -> tuple[Array, tuple[Array, Array]]:
    """Covariance of the measurements without unmodelled errors, and that of each for unit size."""
    unit = measurement_covariance.covariances(
        solution.measurements, data, np.zeros(3), np.zeros(3), UnmodelledErrors(1.0, 1.0)
    )
    parts = unit["turn_excess"], unit["pose_excess"]
    added = sum((size**2 * part for size, part in zip(present, parts, strict=False)), np.zeros_like(parts[0]))
    return solution.measurement_covariance - added, parts


def _one_sequence_explains(
    solution: Solution, data: PreparedRecording, fixed: Mask, statistic: float, freedom: int
) -> bool:
    """True if the measurements without one sequence agree, and that sequence contradicts them."""
    return one_group_explains(_tests(solution, data, fixed, solution.measurement_covariance), statistic, freedom)


def _tests(solution: Solution, data: PreparedRecording, fixed: Mask, R: Array) -> list[tuple[float, int]]:
    """Chi-square and degrees of freedom of every sequence, with the covariance R; empty if R is singular."""
    H, groups = np.where(fixed, 0.0, solution.measurements.H), [rows for rows, _ in rows_of_sequences(data)]
    try:
        found = consistency_tests(solution.measurements.z, H, R, groups)
    except np.linalg.LinAlgError:
        return []
    return [(test.chi_square, test.degrees_of_freedom) for test in found]


def _estimated(solution: Solution, data: PreparedRecording, fixed: Mask, present: UnmodelledErrors) -> UnmodelledErrors:
    """Unmodelled errors by restricted likelihood."""
    known, parts = _sensor_noise(solution, data, present)
    measurements = solution.measurements
    rotation, force = np.sqrt(restricted_likelihood(measurements.z, measurements.H[:, ~fixed], known, parts))
    return UnmodelledErrors(float(rotation), float(force))
