"""Unmodelled errors of rotations and specific forces, added to the noise where the residuals are larger than it.

Both closed form and least squares estimate them from the residuals by restricted maximum likelihood. If one sequence
alone explains the misfit, that sequence is faulty, and no noise is added.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation import measurement_covariance
from srt.estimation.goodness_of_fit import chi_square, is_misfit, one_group_explains
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

    UnmodelledErrors = tuple[float, float]

_ROUNDS: Final = 3
"""Largest number of rounds that estimate the unmodelled errors."""


def iterate_with_unmodelled_errors(
    data: PreparedRecording,
    options: Options,
    new_solver: Callable[[], Solver],
    first: tuple[SensorErrors, Array],
    uncertain: Array,
    progress: Progress | None,
) -> tuple[Solution, Solver, UnmodelledErrors]:
    """Iterate, and repeat with unmodelled errors if the residuals contradict the noise.

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

    Returns
    -------
    Solution
    Solver
    tuple of float
        Unmodelled rotation error, rad, and specific-force error per window, m/s², 1-sigma.
    """
    solver = new_solver()
    solution = iterate(data, options, solver, *first, progress, fixed_sigma=uncertain)
    sizes = (0.0, 0.0)
    for _ in range(_ROUNDS):
        fit = chi_square(solution, solver.fixed)
        if solution.status != "converged" or not is_misfit(*fit):
            break
        if not any(sizes) and _one_sequence_explains(solution, data, solver.fixed, *fit):
            break
        new = _estimated(solution, data, solver.fixed, sizes)
        if np.allclose(new, sizes, rtol=0.1, atol=1e-6):
            break
        sizes = new
        solver = new_solver()
        solution = iterate(
            data, options, solver, first[0], solution.U, progress,
            excess=sizes, resume=solution, fixed_sigma=uncertain,
        )  # fmt: skip
    return solution, solver, sizes


def fit_to_sensor_noise(
    solution: Solution, data: PreparedRecording, fixed: Mask, sizes: UnmodelledErrors
) -> tuple[float, int]:
    """Chi-square of the residuals and its degrees of freedom, without the unmodelled errors in the noise."""
    return chi_square(solution, fixed, _sensor_noise(solution, data, sizes)[0])


def _sensor_noise(
    solution: Solution, data: PreparedRecording, sizes: UnmodelledErrors
) -> tuple[Array, tuple[Array, Array]]:
    """Covariance of the measurements without unmodelled errors, and that of each for unit size."""
    unit = measurement_covariance.covariances(solution.measurements, data, np.zeros(3), np.zeros(3), (1.0, 1.0))
    parts = unit["turn_excess"], unit["pose_excess"]
    added = sum((size**2 * part for size, part in zip(sizes, parts, strict=True)), np.zeros_like(parts[0]))
    return solution.measurement_covariance - added, parts


def _one_sequence_explains(
    solution: Solution, data: PreparedRecording, fixed: Mask, statistic: float, freedom: int
) -> bool:
    """True if the measurements without one sequence agree, and that sequence contradicts them."""
    H, groups = np.where(fixed, 0.0, solution.measurements.H), [rows for rows, _ in rows_of_sequences(data)]
    try:
        found = consistency_tests(solution.measurements.z, H, solution.measurement_covariance, groups)
    except np.linalg.LinAlgError:
        return False
    return one_group_explains([(test.chi_square, test.degrees_of_freedom) for test in found], statistic, freedom)


def _estimated(solution: Solution, data: PreparedRecording, fixed: Mask, present: UnmodelledErrors) -> UnmodelledErrors:
    """Unmodelled errors by restricted likelihood."""
    known, parts = _sensor_noise(solution, data, present)
    measurements = solution.measurements
    rotation, force = np.sqrt(restricted_likelihood(measurements.z, measurements.H[:, ~fixed], known, parts))
    return float(rotation), float(force)
