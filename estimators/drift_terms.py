"""Bias drift within a recording as unknowns of the joint model: coefficients of the selected forms.

The effects on forces, rates and rotations are linear in the coefficients. Rotations are integrated with the mean drift
of each, because a drift of hundreds of degrees per hour is not linear in the attitude.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.estimation.drift_model import DriftEstimate, DriftTerm, candidates, change, most_significant
from srt.estimation.drift_search import gyro_statistics
from srt.estimation.error_sources import by_drift
from srt.model import measurement_model as model
from srt.model.sensor_model import gyro_triad
from srt.noise.drift_forms import Statistics

if TYPE_CHECKING:
    from estimators.block_solution import BlockSolution
    from estimators.joint_model import JointModel
    from estimators.solver import IterationState
    from srt.estimation.drift_model import Sensor
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


class DriftTerms:
    """Selected forms of drift, each with three coefficients for every function of the form.

    Parameters
    ----------
    data : PreparedRecording
    terms : tuple of DriftTerm
    """

    def __init__(self, data: PreparedRecording, terms: tuple[DriftTerm, ...] = ()) -> None:
        self.data, self.terms = data, terms
        sizes = [3 * data.drift_shapes[term.form].windows.shape[1] for term in terms]
        stops = np.cumsum(sizes, dtype=np.intp).tolist()
        self.slices = [slice(stop - size, stop) for stop, size in zip(stops, sizes, strict=True)]
        self.size = sum(sizes)
        """Number of coefficients."""

    @property
    def sigma(self) -> Array:
        """Prior standard deviations of all coefficients."""
        return np.repeat([term.sigma for term in self.terms], [s.stop - s.start for s in self.slices])

    def of(self, sensor: str) -> list[tuple[DriftTerm, slice]]:
        """Terms of a sensor, with their coefficients."""
        return [(t, s) for t, s in zip(self.terms, self.slices, strict=True) if t.sensor == sensor]

    def raw(self, sensor: str, coefficients: Array, of: str) -> Array:
        """Drift of the raw channels of a sensor in all "windows" (W, 3) or "parts" of rotations (K, P, 3)."""
        shapes = self.data.drift_shapes
        shape = (*getattr(shapes["linear"], of).shape[:-1], 3)
        parts = [getattr(shapes[t.form], of) @ coefficients[s].reshape(-1, 3) for t, s in self.of(sensor)]
        return np.asarray(sum(parts, np.zeros(shape)))

    def jacobian(self, sensor: str, of: str, slope: Array) -> Array:
        """Effect of all coefficients on the windows (W, 3, size) or, by parts (K, P, 3, 3), on the rotations."""
        out = np.zeros((len(slope), 3, self.size))
        for term, at in self.of(sensor):
            shape = getattr(self.data.drift_shapes[term.form], of)
            out[:, :, at] = by_drift(slope, shape)
        return out

    def estimates(self, coefficients: Array) -> tuple[DriftEstimate, ...]:
        """Drift of every term over the recording."""
        return tuple(
            DriftEstimate(
                t.sensor,
                t.form,
                change(t.form, coefficients[s].reshape(-1, 3), self.data.drift_shapes[t.form].windows),
                modelled=True,
            )
            for t, s in zip(self.terms, self.slices, strict=True)
        )


def search(
    joint: JointModel, iteration: IterationState, solution: BlockSolution, freedom: int
) -> tuple[DriftTerm, ...]:
    """Most significant form of drift of each triad that the residuals of a joint solution show."""
    state, compensated, data = iteration.linearisation_point, iteration.compensated, joint.data
    assert state is not None
    assert state.attitude is not None
    assert compensated is not None
    keys = candidates(data, joint.drift.terms)
    residual = solution.residual
    found: dict[tuple[Sensor, str], Statistics] = {}
    rows, W = solution.system.rows_of("force").index.ravel(), solution.system.whitening["force"]
    for sensor, form in keys:
        if sensor == "accel":
            effect = (-W @ by_drift(compensated.force_slope, data.drift_shapes[form].windows)).reshape(len(rows), -1)
            by_columns = np.asarray(solution.system.A[rows].T @ effect)
            information = effect.T @ effect - by_columns.T @ solution.with_columns(by_columns)
            chi_square = float(residual @ residual)
            found[sensor, form] = Statistics(effect.T @ residual[rows], information, chi_square, freedom)
    rest, _, _ = model.angular_rate_residual(compensated.rate, state.attitude, joint.earth_rate(state))
    # Rates at rest with their bias and with the drift that is modelled.
    slope = np.asarray(np.linalg.inv(gyro_triad(state.errors).matrix), dtype=np.float64)
    rest = rest + (state.bias_deviation @ slope.T)[joint.window_sequence]
    rest = rest + joint.drift.raw("gyro", state.drift, "windows") @ slope.T
    found |= gyro_statistics(data, slope, rest, joint.integrated, joint.drift.terms)
    return most_significant(found, len(keys))
