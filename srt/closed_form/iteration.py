"""Iteration of the closed form until the corrections are negligible (Savage 2020 [P], §8).

Each iteration re-processes (plays back, [P] §8) the recorded data with the corrected compensation, and solves for a
correction δ = G z. Two steps are available:

* Jacobian (default): the full Jacobian at the estimate; δ is added. This is a Gauss-Newton step, and its fixed point
  is that of the closed form. What the next iteration takes from this one, U and the biases of the sequences, is that of
  the corrected errors (:meth:`SrtProcessor.after`). So a correction is followed by one of its square, and of less than
  a hundredth of it: the Jacobian neglects that the Earth's rate refers to the measured vertical. The iteration ends
  when what would follow is negligible.
* Coefficients: those of [P] eq. 13, the Jacobian at zero error. δ is then an error of the compensated data and is
  composed with the estimate: Mg ← Mg (I + δκ).
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.closed_form.measurement_covariance import (
    bias_of_test,
    covariance,
    disturbances,
    projection,
    squared,
    through,
)
from srt.closed_form.solution import Solution, residuals_of_units
from srt.constants import EARTH_RATE_RAD_S
from srt.estimation.error_sources import earth_rate_sigma
from srt.estimation.g_sensitivity import LEAST_SCATTER
from srt.estimation.g_sensitivity import MODE as G_SENSITIVE
from srt.estimation.iterations import CONVERGED_CORRECTION, CONVERGED_SIGMAS, MAX_STEP, PARAMETER_UNITS
from srt.estimation.rest_rate_scatter import bias_gain, excess_variance, rest_rate_variance
from srt.estimation.srt_measurements import SrtProcessor
from srt.exceptions import DataError
from srt.model.sensor_model import compose, outside_models
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors
from srt.sequences.prepared_units import together
from srt.sequences.stillness import moved_windows, suspect_units

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from srt.closed_form.formulas import SelectedFormulas
    from srt.estimation.options import Options
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.prepared_units import PreparedUnits
    from srt.types import Array, Indices, Mask


_NEAR: Final = 1e-3
"""Correction, in ``PARAMETER_UNITS``, below which the covariance is computed: it changes with the estimate by 1e-3."""

_LEAST_RATE: Final = 0.01
"""Smallest ratio of a correction to the one before that is relied upon: the latter may have been small by chance."""

_COVARIANCES: Final = 16
"""Units whose covariances are computed together: with more, they no longer fit into a processor's cache."""


class _Iteration:
    """State of the iteration of units: all arrays have a leading axis of the units that still iterate."""

    def __init__(
        self,
        data: PreparedUnits,
        options: Options,
        formulas: SelectedFormulas,
        start: Array,
        U: Array,
        fixed_sigma: Array,
    ) -> None:
        self.data, self.options, self.formulas, self.fixed_sigma = data, options, formulas, fixed_sigma
        units, K, W = len(start), data.K, len(data.windows.duration_s)
        self.number, self.start, self.vector, self.U = np.arange(units), start, start.copy(), U
        self.inside = start, U
        self.offset, self.g_sensitivity = np.zeros((units, K, 3)), np.zeros((units, 3, 3))
        stated = data.noise.gyro_wander
        self.wander = np.zeros((units, 3)) if stated is None else np.asarray(stated)
        self.sigma = np.full((units, N_PARAMETERS), np.nan)
        self.corrections = np.zeros((units, 0))
        self.noise: list[Array] = []
        self.integrated = np.full(W, options.window_attitude == "integrated")
        self._processor: SrtProcessor | None = None
        self.solutions: dict[int, Solution] = {}
        self.count, self.alone = 0, list[_Iteration]()

    def run(self, progress: Callable[[int, float], None] | None) -> None:
        """Iterate until the corrections are negligible, or the largest number of iterations is reached."""
        while self.count < self.options.max_playbacks:
            if not self.number.size:
                return
            near = self.corrections[:, -1] < _NEAR if self.corrections.size else np.zeros(len(self.number), dtype=bool)
            fresh = near & np.isnan(self.sigma[:, 0])
            nominal = self.count == 0 or not self.options.measured_vertical
            measurements = self._process(nominal=nominal, noise=bool(fresh.any()))
            self.count += 1
            if fresh.any():
                moving = self._moving(measurements, fresh)
                if self._integrate(moving):
                    continue
                if moving.any():
                    still = np.flatnonzero(~moving.any(axis=1))
                    self._keep(still)
                    if not still.size:
                        return
                    measurements, fresh = measurements.of(still), fresh[still]
            if fresh.any():
                self._assess(measurements, fresh)
            correction, failures = self._correct(measurements)
            size = np.max(np.abs(correction) / PARAMETER_UNITS, axis=1)
            self.corrections = np.column_stack([self.corrections, size])
            if progress is not None and size.size:
                progress(self.corrections.shape[1], float(size.max()))
            self._test_convergence(measurements, correction, failures)
        message = (
            "Not converged after {count} iterations: the last correction was {last:.2e} "
            "(largest component: ratios, rad; accelerometer biases in g)."
        )
        self._finish_inside(np.arange(len(self.number)), "not_converged", [message] * len(self.number))

    def _test_convergence(self, measurements: SrtMeasurements, correction: Array, failures: list[str | None]) -> None:
        """Take the units out that failed or converged; update what the others follow."""
        count = self.corrections.shape[1]
        sound = np.array([reason is None for reason in failures])
        failed = np.flatnonzero(~sound)
        self._finish_inside(
            failed, "outside_model", [f"After iteration {count} {failures[u]}." for u in failed.tolist()]
        )
        if failed.size:
            measurements, correction = measurements.of(np.flatnonzero(sound)), correction[sound]
            self._keep(np.flatnonzero(sound))
        if not self.number.size:
            return
        ahead = self._processing.after(measurements, correction)
        self.U = ahead.U
        settled = self._update_offsets(ahead)
        tolerance = np.maximum(CONVERGED_CORRECTION * PARAMETER_UNITS, CONVERGED_SIGMAS * self.sigma)
        # A comparison with the NaN of a sigma that is not known yet is false.
        settled &= np.all(np.minimum(np.abs(correction), self._following(measurements)) <= tolerance, axis=1)
        if not settled.any():
            return
        moving = self._moving(measurements, settled)
        if self._integrate(moving):
            return
        done = np.flatnonzero(settled & ~moving.any(axis=1))
        # The last correction is below 0.01 sigma: linear prediction gives z without another iteration.
        final, last = measurements.of(done), correction[done]
        noise, parts = (part[done] for part in self.noise)
        predicted = final.z - np.einsum("uzp,up->uz", final.H, last)
        integrals = replace(final.integrals, noise=noise, time_parts=parts)
        self._finish(
            replace(final, z=predicted, integrals=integrals),
            done,
            "converged",
            ["Converged after {count} iterations."] * len(done),
        )
        self._keep(np.flatnonzero(~settled))

    def _following(self, measurements: SrtMeasurements) -> Array:
        """Largest sum of the corrections that would follow the last one, (units, 27), by the rate of convergence."""
        if self.corrections.shape[1] < 2:
            return np.full(self.vector.shape, np.inf)
        before, last = self.corrections[:, -2:].T
        # An error tilts the vertical, which the Earth's rate refers to, while the Earth turns.
        turned = EARTH_RATE_RAD_S * float(measurements.integrals.weight_s.max())
        ratio = np.divide(last, before, out=np.ones_like(last), where=before > 0.0)
        rate = np.clip(ratio, max(_LEAST_RATE, turned), 1.0)
        left = np.maximum(1.0 - rate, np.finfo(np.float64).eps)  # without convergence, what follows has no bound
        return np.asarray((last * rate / left)[:, None] * PARAMETER_UNITS)

    def _keep(self, which: Indices) -> None:
        """Continue with some of the units."""
        if len(which) == len(self.number):
            return
        for name in ("number", "start", "vector", "U", "offset", "g_sensitivity", "wander", "sigma", "corrections"):
            setattr(self, name, getattr(self, name)[which])
        self.inside = self.inside[0][which], self.inside[1][which]
        self.noise = [part[which] for part in self.noise]
        if which.size:
            self.data, self._processor = self.data.of_units(which), None

    @property
    def _processing(self) -> SrtProcessor:
        """Processor of the data of the units that still iterate."""
        if self._processor is None:
            self._processor = SrtProcessor(self.data, self.options, self.integrated)
        return self._processor

    def _process(self, *, nominal: bool, noise: bool) -> SrtMeasurements:
        return self._processing.process(
            self.vector,
            U=self.U,
            nominal_vertical=nominal,
            bias_offset=self.offset,
            g_sensitivity=self.g_sensitivity,
            with_noise=noise,
        )

    def _assess(self, measurements: SrtMeasurements, fresh: Mask) -> None:
        """Compute the sigmas of the parameters, and store the noise integrals that belong to them."""
        integrals = measurements.integrals
        found = [part for part in (integrals.noise, integrals.time_parts) if part is not None]
        self.noise = self.noise or [np.zeros_like(part) for part in found]
        for stored, part in zip(self.noise, found, strict=True):
            stored[fresh] = part[fresh]
        for which in _parts(np.flatnonzero(fresh)):
            own, chosen = copy(self), measurements.of(which)
            own._keep(which)
            seen = through(self.formulas.gain(chosen), own._projection(chosen))
            variance = covariance(seen, disturbances(chosen, own.data, own.wander).values())
            self.sigma[which] = np.sqrt(np.einsum("upp->up", variance))

    def _correct(self, measurements: SrtMeasurements) -> tuple[Array, list[str | None]]:
        """Correct the estimates; corrections (units, 27), and the reason where a unit cannot continue."""
        composed = self.options.step == "coefficients"
        solution = self.formulas.correction(measurements)
        delta = measurements.z @ self.formulas.coefficients.T if composed else solution.copy()
        infinite = np.asarray(~np.isfinite(measurements.z).all(axis=1))
        unsolved = np.asarray(~np.isfinite(solution).all(axis=1)) & ~infinite
        delta[unsolved | infinite] = 0.0
        largest = np.max(np.abs(delta) / PARAMETER_UNITS, axis=1)
        delta *= (MAX_STEP / np.maximum(largest, MAX_STEP))[:, None]
        # U is estimated from the data (axes and verticals), so that the nominal attitudes hold no mounting error.
        vector, U = self.vector + delta, measurements.U.copy()
        reasons: list[str | None] = [None] * len(vector)
        for u in range(len(vector)) if composed else ():
            try:
                corrected, turn = compose(SensorErrors(self.vector[u]), delta[u])
                vector[u], U[u] = corrected.vector, turn @ U[u]
            except DataError:
                reasons[u] = "the composed gyro triad is left-handed"
        vector[:, self.formulas.fixed] = self.start[:, self.formulas.fixed]
        for u, outside in enumerate(outside_models(vector)):
            reasons[u] = reasons[u] or outside
            if infinite[u]:
                reasons[u] = "the correction is not finite"
            if unsolved[u]:
                reasons[u] = "the equations could not be solved (wrong label, or a sequence without rotation?)"
        correction, self.vector, self.U = vector - self.vector, vector, U
        sound = np.array([reason is None for reason in reasons])[:, None]
        self.inside = np.where(sound, vector, self.inside[0]), np.where(sound[..., None], U, self.inside[1])
        return correction, reasons

    def _update_offsets(self, measurements: SrtMeasurements) -> Mask:
        """Update g-sensitivity and the biases of the sequences; True for units where the change is negligible."""
        followed = np.zeros(len(self.number))
        if measurements.poses is not None:
            left = measurements.poses.fit(measurements.rest_rate)
            rest = measurements.rest_rate - measurements.force @ np.swapaxes(left, -1, -2)
            measurements = replace(measurements, rest_rate=rest)
            self.g_sensitivity = self.g_sensitivity + measurements.gyro.matrix @ left
            followed = self.data.gravity * np.abs(left).max(axis=(1, 2))
        if self.data.noise.gyro_wander is None and self.options.gyro_bias in ("auto", G_SENSITIVE):
            self.wander = self._scatter(measurements)
        new = self._bias_gain(measurements)[..., None, :] * measurements.bias_by_sequence
        change = np.maximum(np.abs(new - self.offset).max(axis=(1, 2)), followed)
        self.offset = new
        bias_sigma = np.nan_to_num(self.sigma[:, GROUP_SLICES["gyro_bias"]].max(axis=1))
        return np.asarray(change <= np.maximum(CONVERGED_CORRECTION, CONVERGED_SIGMAS * bias_sigma))

    def _bias_gain(self, measurements: SrtMeasurements) -> Array:
        return bias_gain(measurements, self.data, self.options.gyro_bias, self._compensated(measurements))

    def _compensated(self, measurements: SrtMeasurements) -> Array:
        return np.asarray(np.sqrt(np.einsum("uab,ub->ua", measurements.gyro.inverse**2, self.wander**2)))

    def _scatter(self, measurements: SrtMeasurements) -> Array:
        """1-sigma (units, 3) of the bias between sequences, from rest rates beyond noise, sensor axes."""
        left = np.broadcast_to(measurements.scatter_left(), len(self.number))
        if self.data.K < 3:
            return np.zeros((len(left), 3))
        shown = left >= LEAST_SCATTER
        deviation = measurements.bias_by_sequence / np.sqrt(np.where(shown, left, 1.0))[:, None, None]
        expected = rest_rate_variance(measurements, self.data) + earth_rate_sigma(self.data.recording) ** 2
        # Without a fixture, errors of the rotations are larger, and the bound would spoil the weights.
        unstated = self.data.recording.noise.gyro_noise is None and self.data.recording.fixture is not None
        excess = excess_variance(deviation, expected, expected if unstated else None)
        scatter = np.sqrt(np.einsum("uab,ub->ua", measurements.gyro.matrix**2, excess))
        return np.where(shown[:, None], scatter, 0.0)

    def _moving(self, measurements: SrtMeasurements, which: Mask) -> Mask:
        """Windows that rotated beyond their noise and are not integrated yet, of some of the units, (units, W)."""
        rest = measurements.rest_rate - (measurements.pool @ measurements.rest_rate)[:, None]
        wander, moving = self._compensated(measurements), np.zeros(rest.shape[:2], dtype=np.bool_)
        suspect = suspect_units(self.data, measurements.gyro, measurements.accel, rest, wander)
        for u in np.flatnonzero(which & suspect).tolist():
            gyro, accel = measurements.gyro.of(u), measurements.accel.of(u)
            moving[u] = moved_windows(self.data.units[u], gyro, accel, rest[u], wander[u])
        return np.asarray(moving & ~self.integrated)

    def _integrate(self, moving: Mask) -> bool:
        """Integrate moving windows of a single unit, True if there are any; of several units, each continues alone."""
        if len(moving) > 1:
            # The windows that are integrated are the same for all units of an iteration.
            for u in np.flatnonzero(moving.any(axis=1)):
                own = copy(self)
                own._keep(np.array([u]))
                own._integrate(moving[u][None])
                self.alone.append(own)
            return False
        if not moving.any():
            return False
        self.integrated, self._processor = self.integrated | moving[0], None
        self.sigma[:] = np.nan
        return True

    def _projection(self, measurements: SrtMeasurements) -> dict[str, Array]:
        return projection(measurements, self.data, self._bias_gain(measurements))

    def _finish_inside(self, which: Indices, status: str, messages: list[str]) -> None:
        """Solutions of units that did not converge, at the last estimate inside the sensor model."""
        if not which.size:
            return
        ended = copy(self)
        ended._keep(which)
        # Readings cannot be compensated with errors outside the sensor model.
        ended.vector, ended.U = ended.inside
        measurements = ended._process(nominal=not self.options.measured_vertical, noise=True)
        ended.vector, ended.U = self.vector[which], self.U[which]
        ended._finish(measurements, np.arange(len(which)), status, messages)

    def _finish(self, measurements: SrtMeasurements, which: Indices, status: str, messages: list[str]) -> None:
        """Store the solutions of some of the units, from their last measurements."""
        for part in _parts(np.arange(len(which))):
            own = copy(self)
            own._keep(which[part])
            own._store(measurements.of(part), status, [messages[u] for u in part])

    def _store(self, measurements: SrtMeasurements, status: str, messages: list[str]) -> None:
        gain, projected = self.formulas.gain(measurements), self._projection(measurements)
        solved = np.asarray(np.isfinite(gain).all(axis=(1, 2)))
        gain[~solved] = 0.0
        # The errors of the fixed values propagate into the estimated parameters.
        held = measurements.H * np.where(self.formulas.fixed, self.fixed_sigma, 0.0)
        found = disturbances(measurements, self.data, self.wander).values()
        total = covariance(projected, found) + squared(held)
        of_parameters = gain @ total @ np.swapaxes(gain, -1, -2) + bias_of_test(self.data, self.wander)
        of_units = residuals_of_units(self.data, self.formulas.kept, measurements, total, of_parameters, projected)
        for u, number in enumerate(self.number.tolist()):
            corrections = self.corrections[u].tolist()
            last = corrections[-1] if corrections else np.inf
            self.solutions[number] = Solution(
                errors=SensorErrors(self.vector[u]),
                U=self.U[u],
                covariance=of_parameters[u],
                measurement_covariance=total[u],
                gain=gain[u],
                projection={kind: part[u] for kind, part in projected.items()},
                held=held[u],
                measurements=measurements.of(u),
                corrections=tuple(corrections),
                status=status if solved[u] else "outside_model",
                message=messages[u].format(count=len(corrections), last=last),
                integrated=tuple(np.flatnonzero(self.integrated).tolist()),
                wander=self.wander[u],
                bias_by_sequence=self.offset[u],
                g_sensitivity=self.g_sensitivity[u],
                of_units=of_units[u][0],
                row=of_units[u][1],
            )


def _parts(which: Indices) -> Iterator[Indices]:
    """Units whose covariances are computed together."""
    return (which[a : a + _COVARIANCES] for a in range(0, len(which), _COVARIANCES))


def iterate_units(
    data: PreparedUnits,
    options: Options,
    formulas: SelectedFormulas,
    start: Array,
    U: Array,
    progress: Callable[[int, float], None] | None = None,
    *,
    fixed_sigma: Array | None = None,
) -> list[Solution]:
    """Iterate units together from initial estimates until the corrections are negligible.

    A unit that converges, diverges or moved in a window leaves the others.

    Parameters
    ----------
    data : PreparedUnits
    options : Options
    formulas : SelectedFormulas
    start : ndarray, shape (units, 27)
        Initial estimates; fixed parameters keep these values.
    U : ndarray, shape (units, 3, 3)
        T to MARS components.
    progress : callable, optional
        Called with the number of the iteration and the largest correction.
    fixed_sigma : ndarray, shape (27,), optional
        1-sigma of each parameter's initial value, used for fixed parameters; zero means exact.
    """
    uncertain = np.zeros(N_PARAMETERS) if fixed_sigma is None else fixed_sigma
    iteration = _Iteration(data, options, formulas, start, U, uncertain)
    iteration.run(progress)
    for own in iteration.alone:
        own.run(progress)
    return [iteration.solutions[u] for u in range(len(start))]


def iterate(
    data: PreparedRecording,
    options: Options,
    formulas: SelectedFormulas,
    errors: SensorErrors,
    U: Array,
    progress: Callable[[int, float], None] | None = None,
    *,
    fixed_sigma: Array | None = None,
    before: Solution | None = None,
) -> Solution:
    """:func:`iterate_units` of one unit; its iterations are counted on from those of a solution ``before``."""
    start, count = (errors.vector[None], U[None]), None if before is None else before.iterations(progress)
    ahead = count or progress
    found = iterate_units(together([data]), options, formulas, *start, ahead, fixed_sigma=fixed_sigma)[0]
    return found if count is None else found.counted(count)
