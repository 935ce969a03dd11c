"""Leave-one-out diagnostics of the closed form: the formulas that the other sequences support, at the solution.

The rows of a sequence are its two horizontal components and the down components of windows that no other sequence uses.
Its windows are also removed from the pooled rest rate; where each sequence has its own bias, this changes the biases of
the others. See :mod:`srt.estimation.leave_one_out` for the tests.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.closed_form.solution import rows_of_sequence, second_order_variance
from srt.estimation.leave_one_out import LeaveOneOutEstimate, SequenceDiagnostics, tests_of_groups
from srt.exceptions import DataError
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from srt.closed_form.formulas import SelectedFormulas
    from srt.closed_form.solution import Solution
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Mask


def sequence_diagnostics(
    data: PreparedRecording, formulas: SelectedFormulas, solution: Solution, fixed: Mask
) -> tuple[SequenceDiagnostics, ...]:
    """Leave-one-out diagnostics of every sequence, in their order; empty where the linear model is singular.

    Parameters
    ----------
    data : PreparedRecording
    formulas : SelectedFormulas
    solution : Solution
    fixed : ndarray of bool, shape (27,)
    """
    if fixed.all():
        return ()
    groups = [rows_of_sequence(data, k)[0] for k in range(data.K)]
    R = solution.measurement_covariance + np.diag(second_order_variance(data, len(solution.measurements.z)))
    try:
        against = tests_of_groups(solution.white_with_squares, R, groups, formulas.kept)
        without = [_estimate_without(k, data, formulas, solution) for k in range(len(against))]
    except np.linalg.LinAlgError:
        return ()
    return tuple(SequenceDiagnostics(*row) for row in zip(data.ids, data.occurrences, against, without, strict=True))


def _estimate_without(
    k: int, data: PreparedRecording, formulas: SelectedFormulas, solution: Solution
) -> LeaveOneOutEstimate:
    """Estimate without sequence k, by the formulas that the other sequences support."""
    rows, windows = rows_of_sequence(data, k)
    m, n = solution.measurements, len(solution.measurements.z)
    # As for uncorrelated measurements, a sequence's information is taken as its share of the parameter's variance.
    weight = solution.gain**2 * np.diag(solution.measurement_covariance)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    lost = np.asarray(solution.gain.any(axis=1), dtype=np.bool_)
    estimated, change = lost.copy(), np.zeros(N_PARAMETERS)
    pool = m.pool.copy()
    pool[windows] = 0.0
    try:
        others = formulas.without(k)
    except DataError:  # the other sequences support no formula
        return LeaveOneOutEstimate(change, lost, lost.astype(float))
    S, kept, z = others.selection, others.kept, m.z.copy()
    if pool.sum() > 1e-9:
        z[n - 3 :] += (pool / pool.sum() - m.pool) @ m.rest_rate
    else:  # no other window shows the gyro bias
        S, kept = S[: len(others.formulas)], kept[: len(others.formulas)]
    lost[kept] = False
    change[kept] = np.linalg.solve(S @ m.H[:, kept], S @ z)
    share = weight[:, rows].sum(axis=1) + weight[:, n - 3 :].sum(axis=1) * m.pool[windows].sum()
    return LeaveOneOutEstimate(np.where(estimated, change, 0.0), lost, np.where(lost, 1.0, share))
