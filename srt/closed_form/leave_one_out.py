"""Leave-one-out diagnostics of the closed form: the formulas that the other sequences support, at the solution.

The rows of a sequence are its two horizontal components and the down components of windows that no other sequence uses.
Its windows are also removed from the pooled rest rate; where each sequence has its own bias, this changes the biases of
the others. See :mod:`srt.estimation.leave_one_out` for the tests.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.estimation.leave_one_out import (
    ConsistencyTest,
    LeaveOneOutEstimate,
    SequenceDiagnostics,
    consistency_tests,
)
from srt.exceptions import DataError
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from srt.closed_form.formulas import SelectedFormulas
    from srt.closed_form.iteration import Solution
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


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
    try:
        against = contradictions(data, solution, fixed)
        without = [_estimate_without(k, data, formulas, solution) for k in range(len(against))]
    except np.linalg.LinAlgError:
        return ()
    if not against:
        return ()
    return tuple(SequenceDiagnostics(*row) for row in zip(data.ids, data.occurrences, against, without, strict=True))


def contradictions(data: PreparedRecording, solution: Solution, fixed: Mask) -> list[ConsistencyTest]:
    """Consistency test of every sequence with the others; empty if all parameters are ``fixed``."""
    if fixed.all():
        return []
    z, H = solution.measurements.z, np.where(fixed, 0.0, solution.measurements.H)
    R = solution.measurement_covariance + np.diag(second_order_variance(data, len(z)))
    return consistency_tests(z, H, R, [_rows(data, k)[0] for k in range(data.K)])


def second_order_variance(data: PreparedRecording, rows: int) -> Array:
    """Variance of the neglected squares of the fixture's errors in each of the measurements, (m/s²)².

    The measurement covariance has their first order. With 1 mrad, squares tilt gravity by 1 µrad: nothing beside the
    noise of most gyros, but beyond the covariance of a sequence that the others predict almost exactly. The magnitude
    of specific force does not depend on a tilt.
    """
    out = np.zeros(rows)
    fixture = data.recording.fixture
    if fixture is not None:
        square = 0.5 * (fixture.alignment_sigma_rad**2 + fixture.rotation_sigma_rad**2)
        out[: 2 * data.K] = (data.recording.site.gravity_m_s2 * square) ** 2
    return out


def _rows(data: PreparedRecording, k: int) -> tuple[Indices, Indices]:
    """Rows of z that belong to sequence k alone, and its windows that no other sequence uses."""
    used = np.bincount(np.concatenate([data.start, data.end]), minlength=len(data.windows.duration_s))
    own = np.array([w for w in (int(data.start[k]), int(data.end[k])) if used[w] == 1], dtype=np.intp)
    return np.concatenate([[2 * k, 2 * k + 1], 2 * data.K + own]).astype(np.intp), own


def _estimate_without(
    k: int, data: PreparedRecording, formulas: SelectedFormulas, solution: Solution
) -> LeaveOneOutEstimate:
    """Estimate without sequence k, by the formulas that the other sequences support."""
    rows, windows = _rows(data, k)
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
