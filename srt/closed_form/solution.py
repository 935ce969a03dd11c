"""Solutions of the closed form, with the residuals and tests of the units that were iterated together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from srt.closed_form.fixture_accuracy import verticals_disagree
from srt.closed_form.measurement_covariance import effect
from srt.estimation.error_sources import by_drift
from srt.estimation.iterations import Iterations
from srt.estimation.leave_one_out import by_size
from srt.estimation.rest_rate_scatter import may_be_unstable
from srt.estimation.scale_changes import most_likely_change, scale_effects
from srt.estimation.white_residuals import PredictedGroups, WhiteResiduals
from srt.noise.drift_forms import LINEAR

if TYPE_CHECKING:
    from srt.closed_form.measurement_covariance import Draws
    from srt.estimation.registry import Progress
    from srt.estimation.scale_changes import ScaleChange
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.noise.drift_forms import Statistics
    from srt.sensor_errors import SensorErrors
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.prepared_units import PreparedUnits
    from srt.types import Array, Counts, Indices, Mask


class UnitsResiduals:
    """Residuals and tests of units that were iterated together, computed for all when one is asked for.

    Parameters
    ----------
    data : PreparedUnits
    kept : ndarray of int
        Estimated parameters.
    measurements : SrtMeasurements
    R, covariance : ndarray, shape (units, n, n) and (units, 27, 27)
        Covariance of the measurements and of the estimate.
    projected : dict of str to ndarray
        :func:`srt.closed_form.measurement_covariance.projection`.
    """

    def __init__(
        self,
        data: PreparedUnits,
        kept: Indices,
        measurements: SrtMeasurements,
        R: Array,
        covariance: Array,
        projected: Draws,
    ) -> None:
        self._data, self._m, self._covariance, self._projected = data, measurements, covariance, projected
        self._z, self._H, self._R = measurements.z, measurements.H[..., kept], R
        self._squares = second_order_variance(data, self._z.shape[-1])
        self._groups = [rows_of_sequence(data, k)[0] for k in range(data.K)]

    @cached_property
    def white(self) -> WhiteResiduals:
        """Residuals in units of their noise."""
        return WhiteResiduals.of(self._z, self._H, self._R)

    @cached_property
    def with_squares(self) -> WhiteResiduals:
        """Residuals with :func:`second_order_variance` in the noise."""
        return WhiteResiduals.of(self._z, self._H, self._R + np.diag(self._squares))

    @cached_property
    def by_linear_drift(self) -> tuple[Array, list[Statistics]]:
        """Effect of linear drifts of the three accelerometers, (units, n, 3), and its statistics in the residuals."""
        slopes = zip(self._m.accel.sensitivity(self._m.force), self._data.units, strict=True)
        drifts = [by_drift(slope, unit.drift_shapes[LINEAR].windows) for slope, unit in slopes]
        effects = effect(self._projected, {"force": np.stack(drifts)})
        return effects, self.white.statistics_by_unit(effects)

    @cached_property
    def sequence_tests(self) -> tuple[Array, Counts]:
        """Chi-square of each sequence as predicted from the others, and its degrees of freedom, (units, K)."""
        R, shape = self._R + np.diag(self._squares), (len(self._z), len(self._groups))
        chi_square, freedom = np.zeros(shape), np.zeros(shape, dtype=np.int64)
        for which, rows in by_size(self._groups):
            found = PredictedGroups.of(self.with_squares, R, rows)
            chi_square[:, which], freedom[:, which] = found.chi_square, found.freedom
        return chi_square, freedom

    @cached_property
    def may_be_unstable(self) -> Mask:
        """:func:`srt.estimation.rest_rate_scatter.may_be_unstable` of each unit."""
        return may_be_unstable(self._data, self._m.gyro.inverse, self._m.rest_rate, self._m.integrated)

    @cached_property
    def verticals_disagree(self) -> Mask:
        """:func:`srt.closed_form.fixture_accuracy.verticals_disagree` of each unit."""
        return verticals_disagree(self._data, self._m, self._covariance)


def residuals_of_units(
    data: PreparedUnits, kept: Indices, measurements: SrtMeasurements, R: Array, covariance: Array, projected: Draws
) -> list[tuple[UnitsResiduals, int]]:
    """Residuals that contain each unit, and its number in them; each by itself where a covariance is singular."""
    found = UnitsResiduals(data, kept, measurements, R, covariance, projected)
    try:
        _ = found.white
    except np.linalg.LinAlgError:
        if len(R) > 1:
            each = np.arange(len(R))[:, None]
            parts = (
                (data.of_units(own), kept, measurements.of(own), R[own], covariance[own], _of_units(projected, own))
                for own in each
            )
            return [found for part in parts for found in residuals_of_units(*part)]
    return [(found, u) for u in range(len(R))]


def _of_units(projected: Draws, which: Indices) -> Draws:
    return {kind: part[which] for kind, part in projected.items()}


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


def rows_of_sequence(data: PreparedRecording, k: int) -> tuple[Indices, Indices]:
    """Rows of z that belong to sequence k alone, and its windows that no other sequence uses."""
    used = np.bincount(np.concatenate([data.start, data.end]), minlength=len(data.windows.duration_s))
    own = np.array([w for w in (int(data.start[k]), int(data.end[k])) if used[w] == 1], dtype=np.intp)
    return np.concatenate([[2 * k, 2 * k + 1], 2 * data.K + own]).astype(np.intp), own


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of the iteration.

    Attributes
    ----------
    errors : SensorErrors
    U : ndarray, shape (3, 3)
    covariance : ndarray, shape (27, 27)
        Covariance of the estimate by all sources.
    measurement_covariance : ndarray, shape (n_z, n_z)
    gain : ndarray, shape (27, n_z)
    projection : dict of str to ndarray
        Effect of errors of rotations and windows on z; see :mod:`srt.closed_form.measurement_covariance`.
    held : ndarray, shape (n_z, 27)
        Effect of the fixed values' errors on z, 1-sigma.
    measurements : SrtMeasurements
        Measurements of the last iteration.
    corrections : tuple of float
        Largest correction of each iteration (accelerometer biases in g).
    refits : tuple of int
        See :class:`srt.estimation.iterations.Iterations`.
    status, message : str
    integrated : tuple of int
        Windows that moved; their attitude was integrated.
    wander : ndarray, shape (3,), rad/s
        1-sigma of a sequence's gyro bias about the mean of the test, as used, before compensation (sensor axes).
    bias_by_sequence : ndarray, shape (K, 3), rad/s
        Bias of each sequence less the common one, as used.
    g_sensitivity : ndarray, shape (3, 3), rad/s per m/s²
        Γ as used (rows: gyro axes before compensation; columns: axes of B); zero if it is not estimated.
    of_units : UnitsResiduals
        Residuals and tests of the units that were iterated together.
    row : int
        Number of this unit among them.
    """

    errors: SensorErrors
    U: Array
    covariance: Array
    measurement_covariance: Array
    gain: Array
    projection: dict[str, Array]
    held: Array
    measurements: SrtMeasurements
    corrections: tuple[float, ...]
    status: str
    message: str
    integrated: tuple[int, ...]
    wander: Array
    bias_by_sequence: Array
    g_sensitivity: Array
    of_units: UnitsResiduals
    row: int
    refits: tuple[int, ...] = ()

    def iterations(self, progress: Progress | None = None) -> Iterations:
        """Count of the iterations so far, for another solution that follows."""
        return Iterations(progress, self.corrections, self.refits)

    def counted(self, count: Iterations) -> Solution:
        """The same solution with all iterations."""
        message = count.converged if self.status == "converged" else self.message
        return replace(self, corrections=tuple(count.corrections), refits=tuple(count.refits), message=message)

    @property
    def white(self) -> WhiteResiduals:
        """Residuals in units of their noise.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the covariance is not positive definite, as far outside the model.
        """
        return self.of_units.white.of_unit(self.row)

    @property
    def white_with_squares(self) -> WhiteResiduals:
        """Residuals with the neglected squares of the fixture's errors in the noise; raises as :attr:`white`."""
        return self.of_units.with_squares.of_unit(self.row)

    @property
    def by_linear_drift(self) -> tuple[Array, Statistics]:
        """Effect of linear drifts of the accelerometers on z, (n_z, 3), and its statistics; raises as :attr:`white`."""
        effects, statistics = self.of_units.by_linear_drift
        return effects[self.row], statistics[self.row]

    @property
    def residual_covariance(self) -> Array:
        """Covariance of the residuals after the estimate, shape (n_z, n_z)."""
        left = np.eye(self.gain.shape[1]) - self.measurements.H @ self.gain
        return np.asarray(left @ self.measurement_covariance @ left.T)

    @property
    def may_be_unstable(self) -> bool:
        """False if the rates at rest show no bias instability of the gyros."""
        return bool(self.of_units.may_be_unstable[self.row])

    @property
    def verticals_disagree(self) -> bool:
        """True if the stated accuracy of the fixture does not explain the measured verticals."""
        return bool(self.of_units.verticals_disagree[self.row])

    @property
    def chi_square(self) -> tuple[float, int]:
        """Chi-square of the residuals and its degrees of freedom; zero where the covariance is singular."""
        try:
            return self.white.test
        except np.linalg.LinAlgError:
            return 0.0, 0  # the status reports that failure

    @property
    def sequence_tests(self) -> list[tuple[float, int]]:
        """Chi-square of each sequence as predicted from the others, and its degrees of freedom; as :attr:`white`."""
        chi_square, freedom = self.of_units.sequence_tests
        return list(zip(chi_square[self.row].tolist(), freedom[self.row].tolist(), strict=True))

    def scale_change(self, data: PreparedRecording) -> ScaleChange | None:
        """Change of scale factors within the recording that explains the residuals best."""
        m, white, order = self.measurements, self.white_with_squares, np.argsort(data.rotation[:, 0], kind="stable")
        owner = np.concatenate([np.repeat(np.arange(data.K), 2), m.window_sequence, [-1, -1, -1]])
        found = {sensor: white.statistics(own) for sensor, own in scale_effects(m.H, owner, order).items()}
        middle = data.rotation.mean(axis=1)[order]
        return most_likely_change(found, middle, [data.ids[k] for k in order.tolist()])
