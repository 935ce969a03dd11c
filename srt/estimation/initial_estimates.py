"""Initial estimates of the sensor errors, one for each kind of recording.

*From the fixture* (nominal rotations and attitudes known). The gyro increments of a rotation, less bias, sum to
``Σ ω̃ dt = Mg U (angle · axis)``, and the mean specific force of a static pose is ``f̃ = Ma (−g û_dwn) + λ_Bias``. Both
are linear in the matrices, so that linear least squares needs no initial value. Asymmetries are left out: they are
small, and pairs of opposite rotations or poses cancel their effect on the scale factors.

*From gravity* (free rotations). Each pose gives only |f| = g. This determines the accelerometer matrix up to a
rotation; the symmetric matrix is taken, which is close to the truth if the sensor axes nearly coincide. A weak prior
determines the rest.

*In stages* (any recording, from zero errors). The specific force before and after a rotation is known. A scale-factor
error of 50 % makes a full rotation look like half of one or like three halves, close to wrong minima; half a rotation
looks like a quarter or three quarters, which still leads to the right minimum. Therefore the shortest rotations are
fitted first, and their result is the initial value for longer ones. The residuals are all three components of the
change of specific force: the horizontal ones, g sin θ, are equal for attitude errors of θ and π − θ. The vertical one
separates these. The weights are approximate (0.01 rad per rotation), with a prior of the size of the expected errors;
this is accurate enough for an initial estimate.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation.fixed_parameters import POSE_FRAME
from srt.estimation.srt_measurements import SrtProcessor
from srt.exceptions import DataError
from srt.model import measurement_model as model
from srt.model.measurement_model import down_jacobian
from srt.model.sensor_model import Triad, accel_triad, outside_model, vectors_in_mars
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, SensorErrors, by_parameter
from srt.sequences.manoeuvres import end_attitude, rotation_angles, whole_rotations
from srt.sequences.prepared_units import together

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srt.estimation.options import Options
    from srt.model.gyro_stream import GyroStream
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.prepared_units import PreparedUnits
    from srt.types import Array, Indices, Mask


def initial_estimate(data: PreparedRecording, options: Options) -> tuple[SensorErrors, Array]:
    """Initial sensor errors, and the rotation from the table-mounted frame to MARS.

    Parameters
    ----------
    data : PreparedRecording
    options : Options
        ``start``: "auto", "zero", or the errors themselves.
    """
    if options.start != "auto":
        errors = options.start if isinstance(options.start, SensorErrors) else estimate_in_stages(data, options)
        # U follows from the data compensated with these errors.
        return errors, SrtProcessor(data, options).process(errors, nominal_vertical=True).U
    if data.nominal is None:
        return estimate_from_gravity(data), np.eye(3)
    return estimate_from_fixture(data, data.rotation_stream)


def initial_estimates(data: PreparedUnits, options: Sequence[Options]) -> list[tuple[SensorErrors, Array] | DataError]:
    """:func:`initial_estimate` of units with options that differ in ``start`` alone, or what it raises for a unit."""
    out: dict[int, tuple[SensorErrors, Array] | DataError] = {}
    given = {u: own.start for u, own in enumerate(options) if isinstance(own.start, SensorErrors)}
    if given:
        vectors = np.stack([errors.vector for errors in given.values()])
        units = data.of_units(np.array(list(given)))
        by_data = SrtProcessor(units, options[0]).process(vectors, nominal_vertical=True).U
        out |= {u: (errors, U) for (u, errors), U in zip(given.items(), by_data, strict=True)}
    nominal = [] if data.nominal is None else [u for u, own in enumerate(options) if own.start == "auto"]
    if nominal:
        units = data.of_units(np.array(nominal))
        found = _estimates_from_fixture(units, [unit.rotation_stream for unit in units.units])
        out |= dict(zip(nominal, found, strict=True))
    for u, own in enumerate(options):
        if u not in out:
            try:
                out[u] = initial_estimate(data.units[u], own)
            except DataError as error:
                out[u] = error
    return [out[u] for u in range(len(options))]


_RIDGE: Final = 1e-6
"""Weight of the prior (a perfect triad) against one pose or one radian; it affects only what the data leave open."""


def estimate_from_fixture(data: PreparedRecording, stream: GyroStream) -> tuple[SensorErrors, Array]:
    """Initial estimate from the fixture's nominal angles, and the orientation of MARS on the table.

    Parameters
    ----------
    data : PreparedRecording
        With nominal attitudes; free turns contribute nothing.
    stream : GyroStream
        Raw gyro samples of the rotations.

    Returns
    -------
    errors : SensorErrors
    U : ndarray, shape (3, 3)
        T to MARS components.

    Raises
    ------
    DataError
        A left-handed gyro triad, or an accelerometer triad of the opposite handedness.
    """
    (found,) = _estimates_from_fixture(together([data]), [stream])
    if isinstance(found, DataError):
        raise found
    return found


def _estimates_from_fixture(
    data: PreparedUnits, streams: Sequence[GyroStream]
) -> list[tuple[SensorErrors, Array] | DataError]:
    """:func:`estimate_from_fixture` of several units, or the error of a unit."""
    nominal = data.nominal
    if nominal is None:
        raise DataError("A start from the fixture needs nominal attitudes; this recording has none.")
    Mg, units = _gyro_matrices(data, streams), len(streams)
    labelled = np.array([s is not None for s in data.catalogue])
    nominal, start = nominal[labelled], data.start[labelled]
    down, sequences = nominal[:, 2], [s for s in data.catalogue if s is not None]
    down_end = np.stack([end_attitude(s).T @ u for s, u in zip(sequences, down, strict=True)])
    force = data.windows.accel_mean
    readings = np.concatenate([force[:, start], force[:, data.end[labelled]]], axis=1)
    specific_force = -data.gravity * np.concatenate([down, down_end])
    accel_bias = _fit_triads(specific_force, readings, data.gravity, with_bias=True)[1]
    # An asymmetry enters the misalignments where the poses of an axis are not alike in number up and down. With that of
    # the own axis, the matrix is free of it, but the bias rests on the poses in which the axis is horizontal.
    rows = [_fit_own_asymmetry(specific_force, readings, data.gravity, i) for i in range(3)]
    Ma, none = np.stack(rows, axis=1), np.zeros((units, 3))
    right_handed = np.linalg.det(Mg) > 0.0, np.linalg.det(Ma) > 0.0
    sound = np.logical_and(*right_handed)
    out: dict[int, tuple[SensorErrors, Array] | DataError] = {}
    for u in np.flatnonzero(~sound).tolist():
        if right_handed[0][u]:
            cause = "The accelerometers come out left-handed against the gyros: " + _wrong_axes(Ma[u], "accelerometer")
        else:
            cause = "The gyros come out left-handed against the rotations: " + _wrong_axes(Mg[u], "gyro")
        out[u] = DataError(cause)
    which = np.flatnonzero(sound)
    vectors, U = vectors_in_mars(
        Triad(Mg[which], none[which], none[which]), Triad(Ma[which], none[which], accel_bias[which])
    )
    earth = np.mean(np.swapaxes(nominal, 1, 2), axis=0) @ data.earth_rate_base()
    vectors[:, GROUP_SLICES["gyro_bias"]] = data.windows.gyro_mean[which][:, start].mean(axis=1) - Mg[which] @ earth
    out |= {u: (SensorErrors(vectors[i]), U[i]) for i, u in enumerate(which.tolist())}
    return [out[u] for u in range(units)]


def _gyro_matrices(data: PreparedUnits, streams: Sequence[GyroStream]) -> Array:
    """Gyro matrices of units from the nominal rotations, shape (units, 3, 3)."""
    rest = data.windows.gyro_mean
    between = 0.5 * (rest[:, data.start] + rest[:, data.end])
    pooled, one_bias = _pooled_bias(data)
    single = np.array([s is not None and len(s.rotations) == 1 for s in data.catalogue])
    earth_rates = data.of_schedule("mean Earth rate of rotations", lambda: _mean_earth_rates(data))
    bias = np.where(one_bias[:, None, None] & single[:, None], pooled[:, None] + earth_rates, between)
    turned: list[dict[int, Array]] = []
    for stream, own in zip(streams, bias, strict=True):
        whole = whole_rotations(stream, own)
        turned.append({k: whole[k][None] for k in np.flatnonzero(single).tolist()})
        for k, sequence in enumerate(data.catalogue):
            if sequence is not None and len(sequence.rotations) > 1:
                legs = rotation_angles(stream, k, sequence, own[k])
                if legs is not None:
                    turned[-1][k] = legs
    out = np.broadcast_to(np.eye(3), (len(streams), 3, 3)).copy()
    for seen in {tuple(sorted(own)) for own in turned if own}:
        which = [u for u, own in enumerate(turned) if tuple(sorted(own)) == seen]
        sequences = [s for k in seen if (s := data.catalogue[k]) is not None]
        angles = np.concatenate([s.axes * s.angles_rad[:, None] for s in sequences])
        readings = np.stack([np.concatenate([turned[u][k] for k in seen]) for u in which])
        out[which] = _fit_triads(angles, readings)[0]
    return out


_ONE_BIAS: Final = 1.5
"""Largest rms of the rest rates about one bias, over their noise; beyond it the bias is taken to drift."""


def _pooled_bias(data: PreparedUnits) -> tuple[Array, Mask]:
    """Gyro biases of units from all windows, (units, 3), rad/s; False if it changes, or the Earth rate is not known."""
    recording, rest = data.recording, data.windows.gyro_mean
    fixture = recording.fixture
    if data.nominal is None or recording.site.latitude_rad is None or fixture is None or fixture.heading_rad is None:
        return np.zeros((len(rest), 3)), np.zeros(len(rest), dtype=np.bool_)
    rest = rest - data.of_schedule("Earth rate at rest", lambda: _earth_rate_at_rest(data))
    T = data.windows.duration_s[:, None]
    bias = np.sum(T * rest, axis=1) / T.sum()
    scatter = np.sqrt(np.mean(T * (rest - bias[:, None]) ** 2, axis=1))
    return bias, np.asarray(np.all(scatter < _ONE_BIAS * data.noise.gyro_white, axis=1))


def _earth_rate_at_rest(data: PreparedRecording) -> Array:
    """Earth rate in T in every window, by the nominal attitudes, shape (W, 3), rad/s."""
    attitude = np.zeros((len(data.windows.duration_s), 3, 3))
    for k, sequence in enumerate(data.catalogue):
        if sequence is not None and data.nominal is not None:
            attitude[data.start[k]] = data.nominal[k]
            attitude[data.end[k]] = data.nominal[k] @ end_attitude(sequence)
    return np.asarray(np.einsum("wba,b->wa", attitude, data.earth_rate_base()))


def _mean_earth_rates(data: PreparedRecording) -> Array:
    """Mean Earth rate in T during each rotation about one axis, shape (K, 3), rad/s; zero for other sequences."""
    out = np.zeros((data.K, 3))
    for k, sequence in enumerate(data.catalogue):
        if data.nominal is None or sequence is None or len(sequence.rotations) != 1:
            continue
        earth = data.nominal[k].T @ data.earth_rate_base()
        axis, angle = sequence.axes[0], float(sequence.angles_rad[0])
        along = axis * (axis @ earth)
        # Mean of R(axis, φ)ᵀ ω over φ from 0 to the angle.
        across = np.sin(angle) / angle * (earth - along) - (1.0 - np.cos(angle)) / angle * np.cross(axis, earth)
        out[k] = along + across
    return out


def _fit_triads(x: Array, y: Array, scale: float = 1.0, *, with_bias: bool = False) -> tuple[Array, Array]:
    """Least-squares solutions M, b of y = M x + b with a weak prior, of units; x and y are of size ``scale``.

    x has the shape (n, 3), y (units, n, 3). b is zero unless ``with_bias``.

    The prior gives an initial estimate for every recording. The fits of the diagnosis answer other questions:
    whether the labels explain the readings, and which triad most of them agree on (:mod:`srt.diagnosis.triad_fits`).
    """
    design = np.hstack([x / scale, np.ones((len(x), 1))]) if with_bias else x / scale
    n = design.shape[1]
    solution = _fit(design, y / scale, np.eye(n, 3))
    return np.swapaxes(solution[:, :3], 1, 2), solution[:, 3] * scale if with_bias else np.zeros((len(y), 3))


def _fit_own_asymmetry(x: Array, y: Array, scale: float, axis: int) -> Array:
    """Row m of an axis in y = m x + bias + asymmetry · |x| of the own axis, with a weak prior, shape (units, 3)."""
    own = np.abs(x[:, axis, None]) / scale
    design = np.hstack([x / scale, np.ones((len(x), 1)), own])
    return _fit(design, y[..., axis, None] / scale, np.eye(5)[axis][:, None])[:, :3, 0]


def _fit(design: Array, y: Array, prior: Array) -> Array:
    """Least-squares solutions, (units, n, q), of y (units, m, q) by a design (m, n), with a weak prior (n, q)."""
    (units, _, q), n = y.shape, design.shape[1]
    target = np.concatenate([y, np.broadcast_to(_RIDGE * prior, (units, n, q))], axis=1)
    A = np.concatenate([design, _RIDGE * np.eye(n)])
    solution = np.linalg.lstsq(A, np.moveaxis(target, 0, 1).reshape(len(A), -1), rcond=None)[0]
    return np.moveaxis(solution.reshape(n, units, q), 1, 0)


def _wrong_axes(M: Array, sensor: str) -> str:
    """Name the axis mapping that would make a left-handed triad right-handed."""
    nearest = [int(np.argmax(np.abs(row))) for row in M]
    flipped = ["xyz"[i] for i in range(3) if nearest[i] == i and M[i, i] < 0.0]
    swapped = ["xyz"[i] for i in range(3) if nearest[i] != i]
    if swapped and sorted(nearest) == [0, 1, 2]:
        return f"{sensor} axes {' and '.join(swapped)} look swapped; correct the column order."
    if flipped:
        return f"{sensor} axis {', '.join(flipped)} reads with the wrong sign; flip that column."
    return f"one {sensor} axis is flipped or two are swapped; correct the axis mapping."


_MATRIX_PRIOR: Final = 0.5
"""Prior 1-sigma of bias over g, scale and misalignment: errors of 50 % are admitted."""
_NOISE: Final = 1e-3
"""Assumed 1-sigma of |f| / g in a pose; it only weighs the poses against the prior."""
_GAUSS_NEWTON_STEPS: Final = 8
"""Largest number of full Gauss-Newton steps."""
_LINEAR: Final = 0.75
"""Least ratio of actual to predicted decrease of the cost after a full step."""
_SMALL: Final = 0.3
"""Largest solution accepted from Gauss-Newton: 238 of 1,500 units with errors of 30 to 80 % had one, each the minimum
that Levenberg-Marquardt reached too."""
_STEP_DONE: Final = 1e-6
"""Step at which Gauss-Newton ends, as a scale-factor error; the iteration starts well from 1e-2."""


def _layout() -> Array:
    """Matrix from nine unknowns (bias/g, scale, symmetric misalignment) to the 27 parameters, shape (27, 9)."""
    E = np.zeros((N_PARAMETERS, 9))
    E[GROUP_SLICES["accel_bias"], :3] = np.eye(3)
    E[GROUP_SLICES["accel_scale"], 3:6] = np.eye(3)
    for k, (i, j) in enumerate((("x", "y"), ("x", "z"), ("y", "z"))):
        E[INDEX[f"accel_misalignment_{i}{j}"], 6 + k] = E[INDEX[f"accel_misalignment_{j}{i}"], 6 + k] = 1.0
    return E


def estimate_from_gravity(data: PreparedRecording) -> SensorErrors:
    """Initial estimate for free rotations, from |f| = g in every pose.

    Parameters
    ----------
    data : PreparedRecording
    """
    g, readings = data.gravity, data.windows.accel_mean
    E = _layout()
    E[GROUP_SLICES["accel_bias"]] *= g
    if data.posed.all():  # the axes are those of the accelerometers
        E[[INDEX[name] for name in POSE_FRAME]] = 0.0

    def residuals(u: Array) -> Array:
        f = accel_triad(SensorErrors(E @ u)).compensate(readings)
        return np.concatenate([(np.linalg.norm(f, axis=1) / g - 1.0) / _NOISE, u / _MATRIX_PRIOR])

    def jacobian(u: Array) -> Array:
        triad = accel_triad(SensorErrors(E @ u))
        J = down_jacobian(triad.compensate(readings), triad) @ E / (g * _NOISE)
        return np.concatenate([J, np.eye(9) / _MATRIX_PRIOR])

    solution = _by_gauss_newton(residuals, jacobian, np.zeros(9))
    if solution is None:
        from scipy.optimize import least_squares  # heavy, and small errors do without

        solution = least_squares(residuals, np.zeros(9), jac=jacobian, method="lm").x
    vector = E @ solution
    weights = data.windows.duration_s / data.windows.duration_s.sum()
    vector[GROUP_SLICES["gyro_bias"]] = weights @ data.windows.gyro_mean
    return SensorErrors(vector)


def _by_gauss_newton(residuals: Callable[[Array], Array], jacobian: Callable[[Array], Array], u: Array) -> Array | None:
    """Minimum reached by full Gauss-Newton steps; None if the problem is not nearly linear from the start to there."""
    r = residuals(u)
    for _ in range(_GAUSS_NEWTON_STEPS):
        J = jacobian(u)
        step = np.linalg.lstsq(J, -r, rcond=None)[0]
        predicted = r @ r - np.sum((r + J @ step) ** 2)
        before, u, r = r, u + step, residuals(u + step)
        if np.abs(step).max() < _STEP_DONE:
            return u if np.abs(u).max() < _SMALL else None
        if not before @ before - r @ r >= _LINEAR * predicted:
            return None
    return None


_PRIOR: Final = by_parameter("widest_sigma")
"""1-sigma of the errors that the staged fit expects, SI: 50 % scale, 0.3 rad, 1 % asymmetry, 1 m/s², 1 °/s."""
for _group, _size in {
    "gyro_scale": 0.5,
    "gyro_asymmetry": 0.01,
    "gyro_orthogonality": 0.3,
    "accel_bias": 1.0,
    "accel_scale": 0.5,
    "accel_asymmetry": 0.01,
    "accel_misalignment": 0.3,
    "gyro_bias": 0.02,
}.items():
    _PRIOR[GROUP_SLICES[_group]] = _size
_ROTATION_SIGMA_RAD: Final = 0.01
"""Assumed 1-sigma of the attitude after a rotation, rad; also the 1-sigma of a_Down / g."""
_REST_SIGMA_RAD_S: Final = 1e-5
"""Assumed 1-sigma of the pooled rest rate, rad/s (2 °/h)."""
_STAGE_FACTOR: Final = 1.5
"""Ratio of the longest to the shortest new rotation of a stage."""
_TOLERANCE: Final = 1e-3
"""Relative change of cost and of the unknowns below which a stage ends."""
_FIRST_STEP: Final = 0.1
"""Largest first step, in units of the prior: 3 of 150 IMUs ended in a wrong minimum with 1, none of 650 with 0.1."""
_EVALUATIONS: Final = 60
"""Largest number of evaluations in a stage."""


def estimate_in_stages(data: PreparedRecording, options: Options) -> SensorErrors:
    """Initial estimate from the recording alone, beginning with the shortest rotations.

    Parameters
    ----------
    data : PreparedRecording
    options : Options

    Returns
    -------
    SensorErrors
        Within the convergence range of the iteration; fixed parameters are zero.
    """
    sizes = _PRIOR.copy()
    sizes[[INDEX[name] for name in options.fixed_names]] = 0.0
    u = np.zeros(N_PARAMETERS)
    length = _rotation_lengths(data)
    for limit in _stage_limits(length):
        u = _Stage(data, options, np.flatnonzero(length <= limit), sizes).fit(u)
    return SensorErrors(u * sizes)


def _rotation_lengths(data: PreparedRecording) -> Array:
    """Total angle of each sequence's rotations, shape (K,), rad: nominal if known, else from the raw gyros."""
    stream = data.stream(np.zeros(len(data.windows.duration_s), dtype=np.bool_))[0]
    out = np.empty(data.K)
    for k, sequence in enumerate(data.catalogue):
        if sequence is not None:
            out[k] = np.abs(sequence.angles_rad).sum()
        else:
            s, e = stream.rotation[k]
            rest = 0.5 * (data.windows.gyro_mean[data.start[k]] + data.windows.gyro_mean[data.end[k]])
            rate = stream.smooth[:, s:e] - rest[:, None] * stream.interval_s[s:e]
            out[k] = np.linalg.norm(rate, axis=0).sum()
    return out


def _stage_limits(length: Array) -> list[float]:
    """Largest rotation angle of every stage, ascending, rad."""
    ordered = np.sort(length)
    limits = [_STAGE_FACTOR * float(ordered[0])]
    while ordered[-1] > limits[-1]:
        limits.append(_STAGE_FACTOR * float(ordered[ordered > limits[-1]][0]))
    return limits


class _Stage:
    """Least-squares fit to some of the sequences.

    Parameters
    ----------
    data : PreparedRecording
    options : Options
    chosen : ndarray of int
        Sequences that take part.
    sizes : ndarray, shape (27,)
        Units of the fitted errors; zero fixes a parameter.
    """

    def __init__(self, data: PreparedRecording, options: Options, chosen: Indices, sizes: Array) -> None:
        self.data = replace(
            data,
            labels=tuple(data.labels[k] for k in chosen),
            catalogue=tuple(data.catalogue[k] for k in chosen),
            start=data.start[chosen],
            end=data.end[chosen],
            moves=int(data.is_move[chosen].sum()),
        )
        self.processor, self.sizes = SrtProcessor(self.data, options), sizes
        self.windows = np.unique(np.concatenate([self.data.start, self.data.end]))
        self._at: Array | None = None

    def fit(self, u: Array) -> Array:
        """Fit the errors, in units of ``sizes``, from an initial value in the same units."""
        from scipy.optimize import least_squares  # heavy, and labelled sequences do without

        found = least_squares(
            lambda v: self._evaluated(v)[0],
            u,
            jac=lambda v: self._evaluated(v)[1],
            x_scale=_FIRST_STEP,
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=None,
            max_nfev=_EVALUATIONS,
        )
        return np.asarray(found.x)

    def _evaluated(self, u: Array) -> tuple[Array, Array]:
        """Residuals and their Jacobian at u; the last evaluation is stored, because scipy requests both separately."""
        if self._at is None or not np.array_equal(u, self._at):
            self._at, self._last = u.copy(), self._evaluate(u)
        return self._last

    def _evaluate(self, u: Array) -> tuple[Array, Array]:
        errors = SensorErrors(u * self.sizes)
        data, g = self.data, self.data.gravity
        K = data.K
        if outside_model(errors) is not None:
            n = 3 * K + len(self.windows) + 3 + N_PARAMETERS
            return np.full(n, np.inf), np.zeros((n, N_PARAMETERS))
        measured = self.processor.process(errors)
        change = measured.carried[:, 1] - measured.carried[:, 0]
        force, axes = measured.force, np.broadcast_to(np.eye(3), (K, 3, 3))
        H = model.horizontal_jacobian(measured.integrals, axes, force[data.start], force[data.end], measured.accel)
        rows = 2 * K + self.windows
        scale = np.concatenate(
            [
                np.full(3 * K, g * _ROTATION_SIGMA_RAD),
                np.full(len(rows), g * _ROTATION_SIGMA_RAD),
                np.full(3, _REST_SIGMA_RAD_S),
            ]
        )
        z = np.concatenate([change.ravel(), measured.z[rows], measured.z[-3:]]) / scale
        H = np.concatenate([H.reshape(3 * K, -1), measured.H[rows], measured.H[-3:]]) * self.sizes / scale[:, None]
        # H is the derivative by the errors left after compensation; by the fitted ones it is -H.
        return np.concatenate([z, u]), np.concatenate([-H, np.eye(N_PARAMETERS)])
