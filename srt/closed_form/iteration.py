"""Iteration of the closed form until the corrections are negligible (Savage 2020 [P], §8).

Each iteration re-processes (plays back, [P] §8) the recorded data with the corrected compensation, and solves for a
correction δ = G z. Two steps are available:

* Jacobian (default): the full Jacobian at the estimate; δ is added. This is a Gauss-Newton step. It converges
  quadratically, and its fixed point is that of the closed form.
* Coefficients: those of [P] eq. 13, the Jacobian at zero error. δ is then an error of the compensated data and is
  composed with the estimate: Mg ← Mg (I + δκ).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.closed_form import measurement_covariance
from srt.estimation.convergence import CONVERGED_CORRECTION, CONVERGED_SIGMAS, MAX_STEP, PARAMETER_UNITS
from srt.estimation.error_sources import earth_rate_sigma
from srt.estimation.g_sensitivity import LEAST_SCATTER
from srt.estimation.g_sensitivity import MODE as G_SENSITIVE
from srt.estimation.rest_rate_scatter import bias_gain, excess_variance, rest_rate_variance
from srt.estimation.srt_measurements import SrtProcessor
from srt.exceptions import DataError
from srt.model.sensor_model import compose, outside_model
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors
from srt.sequences.stillness import moved_windows

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.closed_form.formulas import SelectedFormulas
    from srt.estimation.options import Options
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


_NEAR: Final = 1e-3
"""Correction, in ``PARAMETER_UNITS``, below which the covariance is computed: it changes with the estimate by 1e-3."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of the iteration.

    Attributes
    ----------
    errors : SensorErrors
    U : ndarray, shape (3, 3)
    covariance : dict of str to ndarray, shape (27, 27)
        By source of error.
    measurement_covariance, residual_covariance : ndarray, shape (n_z, n_z)
        Covariance of z, and of the residuals after the estimate.
    gain : ndarray, shape (27, n_z)
    projection : dict of str to ndarray
        Effect of errors of rotations and windows on z; see :mod:`srt.closed_form.measurement_covariance`.
    measurements : SrtMeasurements
        Measurements of the last iteration.
    corrections : tuple of float
        Largest correction of each iteration (accelerometer biases in g).
    status, message : str
    integrated : tuple of int
        Windows that moved; their attitude was integrated.
    wander : ndarray, shape (3,), rad/s
        1-sigma of a sequence's gyro bias about the mean of the test, as used, before compensation (sensor axes).
    bias_by_sequence : ndarray, shape (K, 3), rad/s
        Bias of each sequence less the common one, as used.
    g_sensitivity : ndarray, shape (3, 3), rad/s per m/s²
        Γ as used (rows: gyro axes before compensation; columns: axes of B); zero if it is not estimated.
    """

    errors: SensorErrors
    U: Array
    covariance: dict[str, Array]
    measurement_covariance: Array
    residual_covariance: Array
    gain: Array
    projection: dict[str, Array]
    measurements: SrtMeasurements
    corrections: tuple[float, ...]
    status: str
    message: str
    integrated: tuple[int, ...]
    wander: Array
    bias_by_sequence: Array
    g_sensitivity: Array


class _DivergenceError(Exception):
    """The iteration cannot continue; the message gives the reason."""


class _Iteration:
    """State of an iteration; :func:`iterate` runs it."""

    def __init__(
        self,
        data: PreparedRecording,
        options: Options,
        formulas: SelectedFormulas,
        start: SensorErrors,
        fixed_sigma: Array,
    ) -> None:
        self.data, self.options, self.formulas, self.start = data, options, formulas, start
        self.fixed_sigma = fixed_sigma
        self.offset, self.g_sensitivity = np.zeros((data.K, 3)), np.zeros((3, 3))
        self.wander = np.zeros(3) if data.noise.gyro_wander is None else data.noise.gyro_wander
        self.integrated = np.full(len(data.windows.duration_s), options.window_attitude == "integrated")
        self.processor = SrtProcessor(data, options, self.integrated)

    def run(self, U: Array, progress: Callable[[int, float], None] | None) -> Solution:
        """Iterate until the corrections are negligible, or the largest number of iterations is reached."""
        errors = self.start
        corrections: list[float] = []
        sigma: Array | None = None
        noise: tuple[Array | None, Array | None] = None, None
        status, message = "not_converged", ""
        final: SrtMeasurements | None = None
        inside = errors, U
        for i in range(self.options.max_playbacks):
            fresh = sigma is None and bool(corrections) and corrections[-1] < _NEAR
            nominal = i == 0 or not self.options.measured_vertical
            measurements = self._process(errors, U, nominal=nominal, with_noise=fresh)
            if fresh and self._release_moving(measurements):
                continue
            try:
                gain = self._gain(measurements)
                if fresh:
                    noise = measurements.integrals.noise, measurements.integrals.time_parts
                    R = sum(self._by_source(measurements, self._projection(measurements)).values())
                    sigma = np.sqrt(np.maximum(np.diag(gain @ R @ gain.T), 0.0))
                errors, U, correction = self._correct(errors, measurements, gain)
                size = float(np.max(np.abs(correction) / PARAMETER_UNITS))
                corrections.append(size)
                if progress is not None:
                    progress(len(corrections), size)
                _require_inside(errors)
                inside = errors, U
            except _DivergenceError as reason:
                status, message = "outside_model", f"After iteration {len(corrections)} {reason}."
                break
            settled = self._update_offsets(measurements, np.zeros(N_PARAMETERS) if sigma is None else sigma)
            if sigma is None:
                continue
            tolerance = np.maximum(CONVERGED_CORRECTION * PARAMETER_UNITS, CONVERGED_SIGMAS * sigma)
            if settled and bool(np.all(np.abs(correction) <= tolerance)) and not self._release_moving(measurements):
                status, message = "converged", f"Converged after {len(corrections)} iterations."
                # The last correction is below 0.01 sigma: linear prediction gives z without another iteration.
                integrals = replace(measurements.integrals, noise=noise[0], time_parts=noise[1])
                final = replace(measurements, z=measurements.z - measurements.H @ correction, integrals=integrals)
                break
            if self.processor.integrated is not measurements.integrated:
                sigma = None
        else:
            message = (
                f"Not converged after {len(corrections)} iterations: the last correction was "
                f"{corrections[-1] if corrections else np.inf:.2e} "
                "(largest component: ratios, rad; accelerometer biases in g)."
            )
        if final is None:
            # Readings cannot be compensated with errors outside the sensor model: the last estimate inside it.
            final = self._process(*inside, nominal=not self.options.measured_vertical, with_noise=True)
        return self._finish(final, errors, U, corrections, status, message)

    def _process(self, errors: SensorErrors, U: Array, *, nominal: bool, with_noise: bool) -> SrtMeasurements:
        """Process the recorded data with given errors."""
        return self.processor.process(
            errors,
            U=U,
            nominal_vertical=nominal,
            bias_offset=self.offset,
            g_sensitivity=self.g_sensitivity,
            with_noise=with_noise,
        )

    def _gain(self, measurements: SrtMeasurements) -> Array:
        try:
            gain = self.formulas.gain(measurements)
        except np.linalg.LinAlgError:
            gain = np.full((N_PARAMETERS, len(measurements.z)), np.nan)
        if not np.all(np.isfinite(gain)):
            raise _DivergenceError("the equations could not be solved (wrong label, or a sequence without rotation?)")
        return gain

    def _correct(
        self, errors: SensorErrors, measurements: SrtMeasurements, gain: Array
    ) -> tuple[SensorErrors, Array, Array]:
        # U is estimated from the data (axes and verticals), so that the nominal attitudes hold no mounting error.
        U = measurements.U
        composed = self.options.step == "coefficients"
        delta = (self.formulas.coefficients if composed else gain) @ measurements.z
        if not np.all(np.isfinite(delta)):
            raise _DivergenceError("the correction is not finite")
        largest = float(np.max(np.abs(delta) / PARAMETER_UNITS))
        if largest > MAX_STEP:
            delta *= MAX_STEP / largest
        if composed:
            try:
                corrected, turn = compose(errors, delta)
            except DataError as error:
                raise _DivergenceError("the composed gyro triad is left-handed") from error
            vector, U = corrected.vector.copy(), turn @ U
        else:
            vector = errors.vector + delta
        vector[self.formulas.fixed] = self.start.vector[self.formulas.fixed]
        return SensorErrors(vector), U, vector - errors.vector

    def _update_offsets(self, measurements: SrtMeasurements, sigma: Array) -> bool:
        """Update g-sensitivity and the biases of the sequences; return True if the change is negligible."""
        followed = 0.0
        if measurements.poses is not None:
            left = measurements.poses.fit(measurements.rest_rate)
            measurements = replace(measurements, rest_rate=measurements.rest_rate - measurements.force @ left.T)
            self.g_sensitivity = self.g_sensitivity + measurements.gyro.matrix @ left
            followed = self.data.gravity * float(np.abs(left).max())
        if self.data.noise.gyro_wander is None and self.options.gyro_bias in ("auto", G_SENSITIVE):
            self.wander = self._scatter(measurements)
        gain = self._bias_gain(measurements)
        new = gain * measurements.bias_by_sequence
        change = max(np.abs(new - self.offset).max() if new.size else 0.0, followed)
        self.offset = new
        return bool(change <= max(CONVERGED_CORRECTION, CONVERGED_SIGMAS * sigma[GROUP_SLICES["gyro_bias"]].max()))

    def _bias_gain(self, measurements: SrtMeasurements) -> Array:
        return bias_gain(measurements, self.data, self.options.gyro_bias, self._compensated(measurements))

    def _compensated(self, measurements: SrtMeasurements) -> Array:
        return np.asarray(np.sqrt(measurements.gyro.inverse**2 @ self.wander**2))

    def _scatter(self, measurements: SrtMeasurements) -> Array:
        """1-sigma of the bias between sequences, from the variation of their rest rates beyond noise (sensor axes)."""
        left = measurements.scatter_left()
        if np.sum(~self.data.is_move) < 3 or left < LEAST_SCATTER:
            return np.zeros(3)
        rest = measurements.rest_rate
        # A move has no windows of its own.
        own = measurements.share[~self.data.is_move]
        deviation = (own @ rest - measurements.pool @ rest) / np.sqrt(left)
        doubt = earth_rate_sigma(self.data.recording)
        expected = rest_rate_variance(measurements, self.data) + doubt**2
        # Without a fixture, errors of the rotations are larger, and the bound would spoil the weights.
        unstated = self.data.recording.noise.gyro_noise is None and self.data.recording.fixture is not None
        excess = excess_variance(deviation, expected, bounded=unstated)
        return np.asarray(np.sqrt(measurements.gyro.matrix**2 @ excess))

    def _release_moving(self, measurements: SrtMeasurements) -> bool:
        """Mark windows that rotated beyond their noise for integration; return True if there are new ones."""
        rest = measurements.rest_rate - measurements.pool @ measurements.rest_rate
        moving = moved_windows(self.data, measurements.gyro, measurements.accel, rest, self._compensated(measurements))
        moving &= ~self.integrated
        if not moving.any():
            return False
        self.integrated = self.integrated | moving
        self.processor = SrtProcessor(self.data, self.options, self.integrated)
        return True

    def _projection(self, measurements: SrtMeasurements) -> dict[str, Array]:
        return measurement_covariance.projection(measurements, self.data, self._bias_gain(measurements))

    def _by_source(self, measurements: SrtMeasurements, projection: dict[str, Array]) -> dict[str, Array]:
        return measurement_covariance.covariances(projection, measurements, self.data, self.wander)

    def _finish(
        self,
        measurements: SrtMeasurements,
        errors: SensorErrors,
        U: Array,
        corrections: list[float],
        status: str,
        message: str,
    ) -> Solution:
        projection = self._projection(measurements)
        by_source = self._by_source(measurements, projection)
        total = np.asarray(sum(by_source.values()))
        try:
            gain = self._gain(measurements)
        except _DivergenceError:
            gain, status = np.zeros((N_PARAMETERS, len(measurements.z))), "outside_model"
        covariance = {name: gain @ R @ gain.T for name, R in by_source.items()}
        beyond = measurement_covariance.accel_drift(measurements, self.data.noise.accel_unseen, self.data.window_drift)
        unseen = gain @ measurement_covariance.effect(projection, beyond)
        covariance["accel_bias_instability"] += unseen @ unseen.T
        # The errors of the fixed values propagate into the estimated parameters.
        by_fixed = measurements.H * np.where(self.formulas.fixed, self.fixed_sigma, 0.0)
        covariance["held_values"] = gain @ by_fixed @ by_fixed.T @ gain.T
        total = total + by_fixed @ by_fixed.T
        if self.data.noise.gyro_flicker is None:
            # The reported bias is the unit's; the bias during this test differs from it by one random draw. A stated
            # bias instability includes this already: its part common to all windows is an error of the bias alone.
            bias = np.arange(N_PARAMETERS)[GROUP_SLICES["gyro_bias"]]
            covariance["gyro_bias_instability"][bias, bias] += self.wander**2
        left = np.eye(len(measurements.z)) - measurements.H @ gain
        return Solution(
            errors=errors,
            U=U,
            covariance=covariance,
            measurement_covariance=total,
            residual_covariance=left @ total @ left.T,
            gain=gain,
            projection=projection,
            measurements=measurements,
            corrections=tuple(corrections),
            status=status,
            message=message,
            integrated=tuple(np.flatnonzero(self.integrated).tolist()),
            wander=self.wander,
            bias_by_sequence=self.offset,
            g_sensitivity=self.g_sensitivity,
        )


def _require_inside(errors: SensorErrors) -> None:
    """Raise if the errors lie outside the range of the sensor model."""
    reason = outside_model(errors)
    if reason is not None:
        raise _DivergenceError(reason)


def iterate(
    data: PreparedRecording,
    options: Options,
    formulas: SelectedFormulas,
    errors: SensorErrors,
    U: Array,
    progress: Callable[[int, float], None] | None = None,
    *,
    fixed_sigma: Array | None = None,
) -> Solution:
    """Iterate from an initial estimate until the corrections are negligible.

    Parameters
    ----------
    data : PreparedRecording
    options : Options
    formulas : SelectedFormulas
    errors : SensorErrors
        Initial estimate; fixed parameters keep these values.
    U : ndarray, shape (3, 3)
        T to MARS components.
    progress : callable, optional
        Called with the number of the iteration and the largest correction.
    fixed_sigma : ndarray, shape (27,), optional
        1-sigma of each parameter's initial value, used for fixed parameters; zero means exact.
    """
    uncertain = np.zeros(N_PARAMETERS) if fixed_sigma is None else fixed_sigma
    return _Iteration(data, options, formulas, errors, uncertain).run(U, progress)
