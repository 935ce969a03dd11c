"""SRT measurements of the compensated data (Savage 2020 [P], eq. 1) and their Jacobian.

The measurements of K sequences over W windows are one vector ``z = [Δa_H (2 per sequence), a_Down (W), ω_rest (3)]``:
the change of horizontal specific force along two horizontal directions of B_Strt, the down part of every window, and
the pooled gyro rate at rest less the Earth rate. With the true errors, z is noise alone; fixture errors cancel. The
attitudes are those of :mod:`srt.model.analytic_platform` ([P] eq. 2).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.estimation.g_sensitivity import MODE, PoseRegression, compensate_stream, pose_regression
from srt.model import measurement_model as model
from srt.model.analytic_platform import integrate_attitude
from srt.model.rotations import cross_matrix, smallest_rotation
from srt.model.sensor_model import accel_triad, gyro_triad, triads
from srt.model.table1 import AXES
from srt.ranking import rounded
from srt.sensor_errors import SensorErrors

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.model.gyro_stream import GyroStream
    from srt.model.rotation_integrals import RotationIntegrals
    from srt.model.sensor_model import Triad
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


_PARALLEL: Final = 0.1
"""Ratio of singular values below which all measured directions count as parallel."""


_BY_UNIT: Final = (
    "z", "H", "basis", "acceleration", "carried", "force", "rate", "rest_rate", "window_attitude", "earth_rate", "U"
)  # fmt: skip
"""Arrays that have a leading axis of units where several are processed together."""


@dataclass(frozen=True, slots=True, eq=False)
class SrtMeasurements:
    """SRT measurements of one iteration, and the linear model around them.

    Those of several units have a leading axis of units, in all arrays that depend on the readings.

    Attributes
    ----------
    z : ndarray, shape (2 K + W + 3,)
        Measurements, m/s² and rad/s.
    H : ndarray, shape (2 K + W + 3, 27)
        Derivative of z with respect to the remaining sensor errors.
    integrals : RotationIntegrals
    basis : ndarray, shape (K, 2, 3)
        Horizontal directions of the components, in B_Strt.
    acceleration : ndarray, shape (K, 3), m/s²
        Mean of â at start and end, in B_Strt.
    carried : ndarray, shape (K, 2, 3), m/s²
        Mean of â over the start and the end window, in B_Strt.
    force : ndarray, shape (W, 3), m/s²
        Compensated specific force of the windows, in B.
    rate : ndarray, shape (W, 3), rad/s
        Compensated mean rate of the windows, in B.
    rest_rate : ndarray, shape (W, 3), rad/s
        ``rate`` less the Earth rate.
    pool : ndarray, shape (W,)
        Weights of the windows in the pooled rate.
    share : ndarray, shape (K, W)
        Weights of the windows in each sequence's own rate.
    window_attitude : ndarray, shape (W, 3, 3)
        B to B_Strt of the sequence that the window belongs to.
    window_sequence : ndarray of int, shape (W,)
    earth_rate : ndarray, shape (K, 3), rad/s
        ω̂e in B_Strt.
    gyro, accel : Triad
        Sensor models that the data were compensated with.
    U : ndarray, shape (3, 3)
        T to MARS components, from the recorded axes and verticals; identity without a fixture.
    integrated : ndarray of bool, shape (W,)
    nominal_vertical : bool
        True if the vertical was the nominal one.
    poses : PoseRegression, or None
        Regression of ``rest_rate`` on specific force; None where gyro g-sensitivity is not estimated.
    """

    z: Array
    H: Array
    integrals: RotationIntegrals
    basis: Array
    acceleration: Array
    carried: Array
    force: Array
    rate: Array
    rest_rate: Array
    pool: Array
    share: Array
    window_attitude: Array
    window_sequence: Indices
    earth_rate: Array
    gyro: Triad
    accel: Triad
    U: Array
    integrated: Mask
    nominal_vertical: bool
    poses: PoseRegression | None = None

    def of(self, which: Indices | int) -> SrtMeasurements:
        """Measurements of some units, or those of one."""
        by_unit = {name: getattr(self, name)[which] for name in _BY_UNIT}
        parts: dict[str, Any] = {f.name: getattr(self.integrals, f.name) for f in fields(self.integrals)}
        parts = {name: part[which] for name, part in parts.items() if part is not None}
        poses = self.poses
        return replace(
            self,
            **by_unit,
            integrals=replace(self.integrals, **parts),
            gyro=self.gyro.of(which),
            accel=self.accel.of(which),
            poses=None if poses is None else PoseRegression(poses.weights[which], poses.axes[which], poses.seen[which]),
        )

    @property
    def bias_by_sequence(self) -> Array:
        """Rest rate of each sequence less the pooled one, shape (K, 3), rad/s."""
        out: Array = (self.share - self.pool) @ self.rest_rate
        return out

    @property
    def attitude_effect(self) -> Array:
        """Effect of φ on the two horizontal measurements, shape (K, 2, 3)."""
        return model.attitude_to_horizontal(self.basis, self.acceleration)

    def after_g_sensitivity(self, rate: Array) -> tuple[Array, Array]:
        """Disturbances of the window rates after Γ was estimated from these rates, and their effect on φ.

        Parameters
        ----------
        rate : ndarray, shape (W, 3, S), rad/s
            On the compensated mean rate of each window.

        Returns
        -------
        rate : ndarray, shape (..., W, 3, S), rad/s
            Less the estimated g-sensitivity that they cause.
        phi : ndarray, shape (..., K, 3, S), rad
            On φ in B_Strt.
        """
        if self.poses is None or self.integrals.velocity is None:
            return rate, np.zeros((*self.acceleration.shape, rate.shape[-1]))
        followed = np.einsum("was,...wc->...acs", rate, self.poses.weights)
        raw = np.einsum("...ab,...bcs->...acs", self.gyro.matrix, followed)
        phi = -np.einsum("...kabc,...bcs->...kas", self.integrals.velocity, raw)
        return rate - np.einsum("...acs,...wc->...was", followed, self.force), phi

    def scatter_left(self) -> Array | float:
        """Share of the variance of a bias per sequence that remains after the regression on specific force."""
        if self.poses is None:
            return 1.0
        return self.poses.scatter_left(self.force, self.share - self.pool, self.window_sequence)


class SrtProcessor:
    """Data processing of one recording ([P] §3): sensor errors in, SRT measurements out.

    The gyro samples of the rotations and the averages of the windows do not depend on the errors and are stored.
    """

    def __init__(self, data: PreparedRecording, options: Options, integrated: Mask | None = None) -> None:
        W = len(data.windows.duration_s)
        self.data, self.options = data, options
        self.integrated = np.zeros(W, dtype=np.bool_) if integrated is None else integrated
        self._g_sensitive = options.gyro_bias == MODE
        self._stream, self._force, self._weights = data.stream(self.integrated, with_force=self._g_sensitive)
        self._roles()

    def _roles(self) -> None:
        """Assign each window to a sequence (as its start window, if it is one) and set the pooling weights."""
        data, duration = self.data, self.data.windows.duration_s
        W = len(duration)
        self._sequence, self._is_end = np.full(W, -1, dtype=np.intp), np.zeros(W, dtype=np.bool_)
        for k in range(data.K - 1, -1, -1):
            self._sequence[data.start[k]], self._is_end[data.start[k]] = k, False
        for k, w in enumerate(data.end.tolist()):
            if self._sequence[w] < 0:
                self._sequence[w], self._is_end[w] = k, True
        # The mean rate of a window that moved is not a rest rate. If the option integrates all windows, they all count.
        rested = duration if self.integrated.all() else np.where(self.integrated, 0.0, duration)
        self._pool = rested / rested.sum()
        self._share = np.zeros((data.K, W))
        for k in range(data.K):
            for w in {int(data.start[k]), int(data.end[k])}:
                self._share[k, w] = rested[w]
            if not self._share[k].any():
                self._share[k] = self._pool
        self._share /= self._share.sum(axis=1, keepdims=True)
        # Free turns: the axis, of T where the pose is known and else of B, from which a horizontal direction is built.
        # It stays the same in all iterations, because the weights of the measurements depend on it.
        vertical = data.windows.accel_mean.reshape(-1, W, 3)[0, data.start]  # of several units, the first
        if data.nominal is not None:
            vertical = np.where(data.placed[:, None], data.nominal[:, 2], vertical)
        self._least_vertical = np.argmin(rounded(np.abs(vertical)), axis=1)
        # The two axes of T that are horizontal at the start of each labelled sequence.
        self._labelled = np.array([s is not None for s in data.catalogue])
        self._horizontal = np.array(
            [[AXES.index(axis) for axis in s.horizontal] for s in data.catalogue if s is not None], dtype=np.intp
        ).reshape(-1, 2)

    @property
    def stream(self) -> GyroStream:
        """Gyro samples that are integrated."""
        return self._stream

    def stream_without(self, g_sensitivity: Array, accel: Triad) -> GyroStream:
        """Gyro samples less Γ f̂, with f̂ compensated by ``accel``, if the options select g-sensitivity."""
        if not self._g_sensitive or self._force is None:
            return self._stream
        return compensate_stream(self._stream, self._force, accel, g_sensitivity)

    def process(
        self,
        errors: SensorErrors | Array,
        *,
        U: Array | None = None,
        nominal_vertical: bool = False,
        bias_offset: Array | None = None,
        g_sensitivity: Array | None = None,
        earth_rate_offset: Array | float = 0.0,
        with_noise: bool = False,
    ) -> SrtMeasurements:
        """Compensate the recorded data with given errors and form the SRT measurements.

        Parameters
        ----------
        errors : SensorErrors, or ndarray, shape (units, 27)
            Estimate to compensate with; of several units, the other arrays have a leading axis of units, too.
        U : ndarray, shape (3, 3), optional
            T to MARS components for the nominal attitudes.
        nominal_vertical : bool
            Take the vertical from the nominal attitude instead of the measured specific force (first iteration).
        bias_offset : ndarray, shape (K, 3), optional
            Gyro bias of each sequence less the common one, rad/s.
        g_sensitivity : ndarray, shape (3, 3), rad/s per m/s², optional
            Γ (rows: gyro axes before compensation; columns: axes of B), used if the options select it; default zero.
        earth_rate_offset : ndarray, shape (K, 3), rad/s, optional
            Estimate of the unknown part of the Earth rate in each B_Strt (no heading or latitude); default zero.
        with_noise : bool
            Compute the noise integrals too.
        """
        data, U = self.data, np.eye(3) if U is None else U
        if isinstance(errors, SensorErrors):
            gyro, accel = gyro_triad(errors), accel_triad(errors)
        else:
            gyro, accel = triads(errors)
        gyro_mean, accel_mean = data.means(gyro, accel)
        force = accel.compensate(accel_mean)
        stream, gyro_mean, poses = self._without_g_sensitivity(accel, force, gyro_mean, g_sensitivity)
        rate = gyro.compensate(gyro_mean)
        ends = force[..., data.start, :], force[..., data.end, :]
        known, down = self._earth_rate(U, ends[0], nominal_vertical)
        earth_rate = known + earth_rate_offset
        sample = data.noise.gyro_sample(data.recording.nominal_interval_s)
        integrals, attitude = integrate_attitude(
            stream, gyro, earth_rate, bias_offset=bias_offset, sample_noise_rad=sample, with_noise=with_noise
        )
        carried = self._carried_force(integrals, attitude, accel, force)
        basis = self._basis(down, U)
        window_C = np.where(self._is_end[:, None, None], integrals.C_end[..., self._sequence, :, :], np.eye(3))
        rest = rate - np.einsum("...ab,...a->...b", window_C, earth_rate[..., self._sequence, :])
        # Δa_H = horizontal part of (â_End − â_Strt)  ([P] eq. 1)
        horizontal = np.einsum("...ia,...a->...i", basis, carried[..., 1, :] - carried[..., 0, :])
        z = (horizontal.reshape(*force.shape[:-2], -1), self._down(force, down, window_C), self._pool @ rest)
        H = model.horizontal_jacobian(integrals, basis, *ends, accel)
        return SrtMeasurements(
            z=np.concatenate(z, axis=-1),
            H=self._jacobian(H, force, rate, gyro, accel),
            integrals=integrals,
            basis=basis,
            acceleration=carried.mean(axis=-2),
            carried=carried,
            force=force,
            rate=rate,
            rest_rate=rest,
            pool=self._pool,
            share=self._share,
            window_attitude=window_C,
            window_sequence=self._sequence,
            earth_rate=earth_rate,
            gyro=gyro,
            accel=accel,
            U=self._orientation(integrals.angle, force, U),
            integrated=self.integrated,
            nominal_vertical=nominal_vertical and data.nominal is not None,
            poses=poses,
        )

    def after(self, m: SrtMeasurements, correction: Array) -> SrtMeasurements:
        """Rates at rest and U after a correction of the sensor errors (units, 27), to first order in it.

        Those of ``m`` belong to the errors before: the next iteration would follow with a delay of one.
        """
        data, integrals, by_gyro, by_accel = self.data, m.integrals, *triads(correction)
        seconds = integrals.weight_s[..., None]
        rate, force = _corrected(m.rate, m.gyro, by_gyro), _corrected(m.force, m.accel, by_accel)
        angle = seconds * _corrected(integrals.angle / seconds, m.gyro, by_gyro)
        # φ = ∫ F Ĉ (δMg ω̂ + δκ_Asym ∘ |ω̂| + δκ_Bias) dt  ([P] eq. 3)
        phi = np.einsum("...kabc,...bc->...ka", integrals.rate, by_gyro.matrix - np.eye(3))
        phi += np.einsum("...kab,...b->...ka", integrals.abs_rate, by_gyro.asymmetry)
        phi += np.einsum("...kab,...b->...ka", integrals.time, by_gyro.bias)
        U = self._orientation(angle, force, m.U)
        known, _ = self._earth_rate(U, force[..., data.start, :], not self.options.measured_vertical)
        C_end = integrals.C_end - cross_matrix(phi) @ integrals.C_end
        window_C = np.where(self._is_end[:, None, None], C_end[..., self._sequence, :, :], np.eye(3))
        rest = rate - np.einsum("...ab,...a->...b", window_C, known[..., self._sequence, :])
        return replace(m, rate=rate, force=force, rest_rate=rest, U=U)

    def _without_g_sensitivity(
        self, accel: Triad, force: Array, gyro_mean: Array, matrix: Array | None
    ) -> tuple[GyroStream, Array, PoseRegression | None]:
        """Gyro samples and window means less Γ f̂, and the regression that estimates Γ; None if it is not estimated."""
        data = self.data
        if not self._g_sensitive:
            return self._stream, gyro_mean, None
        matrix = np.zeros((3, 3)) if matrix is None else matrix
        stream = self.stream_without(matrix, accel)
        gyro_mean = gyro_mean - force @ np.swapaxes(matrix, -1, -2)
        return stream, gyro_mean, pose_regression(force, self._pool, data.gravity)

    def _jacobian(self, horizontal: Array, force: Array, rate: Array, gyro: Triad, accel: Triad) -> Array:
        """Derivative of z with respect to the sensor errors ([P] eqs. 3-5), shape (..., 2 K + W + 3, 27)."""
        by_rate = model.rate_error_jacobian(rate, gyro, self.data.rectified(gyro, accel)[0])
        parts = (
            horizontal.reshape(*force.shape[:-2], 2 * self.data.K, -1),
            model.down_jacobian(force, accel),
            (self._pool @ by_rate.reshape(*rate.shape[:-1], -1)).reshape(*rate.shape[:-2], 3, -1),
        )
        return np.concatenate(parts, axis=-2)

    def _earth_rate(self, U: Array, force: Array, nominal_vertical: bool) -> tuple[Array, Array]:
        """Earth rate ω̂e and the vertical, from the specific force or nominal, in each B_Strt."""
        data = self.data
        base = data.earth_rate_base()
        down = -force / np.linalg.norm(force, axis=-1, keepdims=True)
        vertical_part: Array = base[2] * down
        if data.nominal is None:
            return vertical_part, down
        placed = data.placed[:, None]
        to_body = U[..., None, :, :] @ np.swapaxes(data.nominal, 1, 2)
        nominal, nominal_down = to_body @ base, np.where(placed, to_body[..., 2], down)
        if nominal_vertical:
            return np.where(placed, nominal, vertical_part), nominal_down
        # The smallest rotation from the nominal to the measured vertical: north alone stays nominal.
        nominal = np.einsum("...ab,...b->...a", smallest_rotation(nominal_down, down), nominal)
        return np.where(placed, nominal, vertical_part), down

    def _basis(self, down: Array, U: Array) -> Array:
        """Two horizontal directions per sequence: nominal axes of T made horizontal, or any two for a free turn."""
        data = self.data
        of_T = np.swapaxes(U, -1, -2)
        reference = np.where(data.placed[:, None], of_T[..., self._least_vertical, :], np.eye(3)[self._least_vertical])
        first = np.cross(down, reference)
        first /= np.linalg.norm(first, axis=-1, keepdims=True)
        axes = np.stack([first, np.cross(down, first)], axis=-2)
        if data.nominal is not None:
            axes[..., self._labelled, :, :] = of_T[..., self._horizontal, :]
        out: Array = axes @ model.horizontal_projector(down)
        return out

    def _down(self, force: Array, down: Array, window_C: Array) -> Array:
        """Down measurement of every window, shape (W,), m/s²."""
        g = self.data.gravity
        if self.options.down == "tilt-immune":
            out: Array = g - np.linalg.norm(force, axis=-1)
        else:
            # a_Down = û_dwn·â + g  ([P] eq. 1)
            vertical = np.einsum("...ab,...a->...b", window_C, down[..., self._sequence, :])
            out = g + np.einsum("...a,...a->...", vertical, force)
        return out

    def _carried_force(self, integrals: RotationIntegrals, attitude: Array, accel: Triad, force: Array) -> Array:
        """Mean of â = Ĉ f̂ over the start and the end window of every sequence, shape (..., K, 2, 3), m/s²."""
        data, stream = self.data, self._stream
        at_end = np.einsum("...ab,...b->...a", integrals.C_end, force[..., data.end, :])
        out = np.stack([force[..., data.start, :], at_end], axis=-2)
        if self._force is None or self._weights is None:
            return out
        # One unit after the other, as in the stream; one slope of the sensor model for a whole window.
        slopes, flat = accel.sensitivity(force).reshape(-1, len(self._sequence), 3, 3), out.reshape(-1, 2, 3)
        bias = np.broadcast_to(accel.bias, (*force.shape[:-2], 3)).reshape(-1, 3)
        for row, (first, last) in enumerate(stream.rotation.tolist()):
            unit, k = divmod(row, data.K)
            windows = ((data.start[k], stream.starts[row], first), (data.end[k], last, stream.starts[row + 1]))
            for side, (w, lo, hi) in enumerate(windows):
                if self.integrated[w]:
                    f = slopes[unit, w] @ (self._force[:, lo:hi] - bias[unit][:, None])
                    flat[row, side] = np.einsum("abn,bn->a", attitude[:, :, lo:hi], f * self._weights[lo:hi])
        return flat.reshape(out.shape)

    def _orientation(self, angle: Array, force: Array, U: Array) -> Array:
        """Rotation U from T to MARS by Wahba's problem: measured rotation axes and measured verticals at rest.

        U includes the mounting error of the IMU on the table, so that ω̂e is free of it.
        """
        data = self.data
        if data.nominal is None or data.posed.all():
            return U  # without a rotation, no gyro axis shows on the table
        starts = force[..., data.start[self._labelled], :]
        # Rotations about one axis: the gyros show it.
        single = {
            k: np.sign(s.angles_rad[0]) * s.axes[0]
            for k, s in enumerate(data.catalogue)
            if s is not None and len(s.rotations) == 1 and data.labels[k].rate is None
        }
        in_T = np.concatenate([data.nominal[self._labelled, 2], *(axis[None] for axis in single.values())])
        in_B = np.concatenate([-starts, angle[..., list(single), :]], axis=-2)
        B = np.swapaxes(in_B / np.linalg.norm(in_B, axis=-1, keepdims=True), -1, -2) @ in_T
        left, singular, right = np.linalg.svd(B)
        # Parallel verticals without a single-axis rotation leave the angle about the vertical unknown: U keeps it.
        parallel = (singular[..., 1] < _PARALLEL * singular[..., 0])[..., None, None]
        if parallel.any():
            left, _, right = np.linalg.svd(np.where(parallel, B + _PARALLEL * singular[..., :1, None] * U, B))
        left[..., 2] *= np.linalg.det(left @ right)[..., None]
        out: Array = left @ right
        return out


def _corrected(values: Array, triad: Triad, correction: Triad) -> Array:
    """Compensated values (units, n, 3) after a correction of the sensor errors, to first order in it."""
    own = values @ np.swapaxes(correction.matrix - np.eye(3), -1, -2) + correction.bias[:, None]
    own += correction.asymmetry[:, None] * np.abs(values)
    return np.asarray(values - (triad.sensitivity(values) @ own[..., None])[..., 0])
