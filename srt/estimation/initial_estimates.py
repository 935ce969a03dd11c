"""Initial estimates: from the fixture, from gravity alone, in stages from the shortest rotations, or from given errors.

The summed raw gyro reading of a leg is ``∫ω̃ dt = Mg U_T (angle · axis)`` up to bias and Earth rate, which the mean
reading of the windows removes; the mean raw specific force of a pose is ``Ma (−g û_dwn) + λ_Bias``. Both are linear in
the matrices, so linear least squares needs no first guess. Asymmetry is left out: over the six faces ``|f|`` of all
axes is collinear with the bias, and the ± pairs cancel the gyros' own.

Only ``|f| = g`` is known of a pose. It fixes the accelerometer matrix up to a rotation; the symmetric one is taken,
which is near the truth where the sensor axes nearly coincide. A weak prior decides what the poses do not.

What is known of a turn is the specific force before and after it. A scale error of 50 % turns a full turn into half of
one or three halves, and next to them lie false answers that fit nearly as well; of a half turn it makes a quarter or
three, which still point to the truth. So the short turns are fitted first, and the longer ones from there.

The measurements are those of a play-back with all three components of the change of specific force: where angles are
large, its vertical part tells which way to go. They are weighted as if every turn were off by a hundredth of a radian,
against a prior of the size of the errors looked for; this is a first estimate, and its weights need be no better.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import least_squares

from srt.estimation.srt_measurements import SrtProcessor
from srt.exceptions import DataError
from srt.model import measurement_model as model
from srt.model.analytic_platform import gyro_stream
from srt.model.measurement_model import down_jacobian
from srt.model.sensor_model import Triad, accel_triad, outside_model, to_mars
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, SensorErrors
from srt.sequences.manoeuvres import end_attitude

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.model.analytic_platform import GyroStream
    from srt.model.table1 import Sequence
    from srt.sequences.preparation import PlaybackData
    from srt.types import Array, Indices


def initial_estimate(data: PlaybackData, options: Options) -> tuple[SensorErrors, Array]:
    """Errors to begin with and the rotation from the table-mounted frame to MARS.

    Parameters
    ----------
    data : PlaybackData
    options : Options
        ``start``: "auto", "zero", or the errors themselves.
    """
    if options.start != "auto":
        errors = options.start if isinstance(options.start, SensorErrors) else estimate_in_stages(data, options)
        # How MARS lies on the table is as the data show it under these errors.
        return errors, SrtProcessor(data, options).process(errors, nominal_vertical=True).U
    if data.nominal is None:
        return estimate_from_gravity(data), np.eye(3)
    stream = gyro_stream(
        data.recording.gyro,
        data.recording.interval_s,
        data.rotation,
        data.rotation,
        rates=data.recording.kind == "rate",
    )
    return estimate_from_fixture(data, stream)


_RIDGE: Final = 1e-6
"""Weight of the prior (a perfect triad) against one pose or one radian: decides only what nothing else does."""
_MOVING: Final = 0.2
"""Share of a sequence's highest rate above which a leg is taken to turn."""


def estimate_from_fixture(data: PlaybackData, stream: GyroStream) -> tuple[SensorErrors, Array]:
    """First estimate of the errors, and the orientation of MARS on the table.

    Parameters
    ----------
    data : PlaybackData
        All sequences with nominal rotations.
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
        A left-handed gyro triad, or an accelerometer triad left-handed against it.
    """
    rest = data.windows.gyro_mean
    turned, angles = [], []
    for k, sequence in enumerate(data.catalogue):
        if sequence is None:
            continue
        bias = 0.5 * (rest[data.start[k]] + rest[data.end[k]])
        legs = rotation_angles(stream, k, sequence, bias)
        if legs is not None:
            turned.append(legs)
            angles.append(sequence.axes * sequence.angles_rad[:, None])
    Mg = _fit_matrix(np.concatenate(angles), np.concatenate(turned)) if turned else np.eye(3)
    nominal = data.nominal
    if nominal is None:
        raise DataError("A start from the fixture needs nominal attitudes; this recording has none.")
    down = nominal[:, 2]
    down_end = np.stack([end_attitude(s).T @ u for s, u in zip(data.catalogue, down, strict=True) if s is not None])
    force = data.windows.accel_mean
    vertical = np.concatenate([down, down_end])
    readings = np.concatenate([force[data.start], force[data.end]])
    Ma, accel_bias = _fit_affine(-data.gravity * vertical, readings, data.gravity)
    if np.linalg.det(Mg) > 0.0 and np.linalg.det(Ma) <= 0.0:
        raise DataError("The accelerometers come out left-handed against the gyros: " + _flipped(Ma, "accelerometer"))
    if np.linalg.det(Mg) <= 0.0:
        raise DataError("The gyros come out left-handed against the rotations: " + _flipped(Mg, "gyro"))
    errors, U = to_mars(Triad(Mg, np.zeros(3), np.zeros(3)), Triad(Ma, np.zeros(3), accel_bias))
    earth = U @ np.swapaxes(nominal, 1, 2) @ data.earth_rate_base()
    vector = errors.vector.copy()
    vector[-3:] = (rest[data.start] - earth @ (Mg @ U.T).T).mean(axis=0)
    return type(errors)(vector), U


def rotation_angles(stream: GyroStream, k: int, sequence: Sequence, bias: Array) -> Array | None:
    """Summed raw gyro angle of each leg, less bias, shape (number of legs, 3), rad.

    Returns None where the standstills between the legs cannot be told: other sequences then serve.
    """
    s, e = stream.rotation[k]
    increments = stream.increments[:, s:e] - bias[:, None] * stream.interval_s[s:e]
    m = len(sequence.rotations)
    if m == 1:
        whole: Array = increments.sum(axis=1)[None]
        return whole
    speed = np.linalg.norm(stream.smooth[:, s:e] / stream.interval_s[s:e] - bias[:, None], axis=0)
    moving = speed > _MOVING * speed.max()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moving, [False]]).astype(np.int8)))
    begins, ends = edges[::2], edges[1::2]
    long_enough = ends - begins > 0.02 * (e - s)
    begins, ends = begins[long_enough], ends[long_enough]
    if len(begins) != m:
        return None
    middles = (ends[:-1] + begins[1:]) // 2
    cuts = np.concatenate([[0], middles, [e - s]])
    return np.stack([increments[:, a:b].sum(axis=1) for a, b in pairwise(cuts.tolist())])


def _fit_matrix(x: Array, y: Array) -> Array:
    """M of y = M x by least squares, with a weak prior for directions that x lacks."""
    A = np.concatenate([x, _RIDGE * np.eye(3)])
    solution = np.linalg.lstsq(A, np.concatenate([y, _RIDGE * np.eye(3)]), rcond=None)[0]
    return np.asarray(solution.T)


def _fit_affine(x: Array, y: Array, scale: float) -> tuple[Array, Array]:
    """M and b of y = M x + b likewise; x and y are of size ``scale``."""
    A = np.concatenate([np.hstack([x / scale, np.ones((len(x), 1))]), _RIDGE * np.eye(4)])
    prior = _RIDGE * np.concatenate([np.eye(3), np.zeros((1, 3))])
    solution = np.linalg.lstsq(A, np.concatenate([y / scale, prior]), rcond=None)[0]
    return solution[:3].T, solution[3] * scale


def _flipped(M: Array, sensor: str) -> str:
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
_NOISE: Final = 1e-3
"""Assumed error of a pose over g: weighs poses against the prior, nothing else."""


def _layout() -> Array:
    """Nine unknowns (bias/g, scale, symmetric misalignment) to the 27 parameters, shape (27, 9)."""
    E = np.zeros((N_PARAMETERS, 9))
    E[GROUP_SLICES["accel_bias"], :3] = np.eye(3)
    E[GROUP_SLICES["accel_scale"], 3:6] = np.eye(3)
    for k, (i, j) in enumerate((("x", "y"), ("x", "z"), ("y", "z"))):
        E[INDEX[f"accel_misalignment_{i}{j}"], 6 + k] = E[INDEX[f"accel_misalignment_{j}{i}"], 6 + k] = 1.0
    return E


def estimate_from_gravity(data: PlaybackData) -> SensorErrors:
    """First estimate for free turns.

    Parameters
    ----------
    data : PlaybackData
    """
    g, readings = data.gravity, data.windows.accel_mean
    E = _layout()
    E[GROUP_SLICES["accel_bias"]] *= g

    def residuals(u: Array) -> Array:
        f = accel_triad(SensorErrors(E @ u)).compensate(readings)
        return np.concatenate([(np.linalg.norm(f, axis=1) / g - 1.0) / _NOISE, u / _MATRIX_PRIOR])

    def jacobian(u: Array) -> Array:
        triad = accel_triad(SensorErrors(E @ u))
        J = down_jacobian(triad.compensate(readings), triad) @ E / (g * _NOISE)
        return np.concatenate([J, np.eye(9) / _MATRIX_PRIOR])

    solution = least_squares(residuals, np.zeros(9), jac=jacobian, method="lm")
    vector = E @ solution.x
    weights = data.windows.duration_s / data.windows.duration_s.sum()
    vector[GROUP_SLICES["gyro_bias"]] = weights @ data.windows.gyro_mean
    return SensorErrors(vector)


_PRIOR: Final = np.ones(N_PARAMETERS)
"""Size of the errors looked for; accelerometer bias and gyro bias in SI."""
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
_TURN_RAD: Final = 0.01
_REST_RAD_S: Final = 1e-5
_NEXT: Final = 1.5
"""Turns longer by this factor than those before wait for the next stage."""
_ENOUGH: Final = 1e-3
"""Gain of an evaluation over what is left, below which a stage is through."""
_FIRST_STEP: Final = 0.1
"""Largest first step, in units of the sizes: three of 150 units lost their way with 1, none of 650 with this."""
_EVALUATIONS: Final = 60


def estimate_in_stages(data: PlaybackData, options: Options) -> SensorErrors:
    """First estimate from the recorded stillness and turns alone.

    Parameters
    ----------
    data : PlaybackData
    options : Options

    Returns
    -------
    SensorErrors
        Near enough for a play-back to go on from; held parameters are zero.
    """
    sizes = _PRIOR.copy()
    sizes[[INDEX[name] for name in options.fixed_names]] = 0.0
    u = np.zeros(N_PARAMETERS)
    length = _turned(data)
    for limit in _limits(length):
        u = _Stage(data, options, np.flatnonzero(length <= limit), sizes).fit(u)
    return SensorErrors(u * sizes)


def _turned(data: PlaybackData) -> Array:
    """Angle of each turn, all its legs added up, rad: as it should be if that is known, else as the raw gyros read."""
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


def _limits(length: Array) -> list[float]:
    """Longest turn of every stage, ascending."""
    ordered = np.sort(length)
    limits = [_NEXT * float(ordered[0])]
    while ordered[-1] > limits[-1]:
        limits.append(_NEXT * float(ordered[ordered > limits[-1]][0]))
    return limits


class _Stage:
    """Fit of some of the turns.

    Parameters
    ----------
    data : PlaybackData
    options : Options
    chosen : ndarray of int
        Sequences that take part.
    sizes : ndarray, shape (27,)
        Units that the errors are fitted in; zero holds one.
    """

    def __init__(self, data: PlaybackData, options: Options, chosen: Indices, sizes: Array) -> None:
        self.data = replace(
            data,
            labels=tuple(data.labels[k] for k in chosen),
            catalogue=tuple(data.catalogue[k] for k in chosen),
            start=data.start[chosen],
            end=data.end[chosen],
        )
        self.processor, self.sizes = SrtProcessor(self.data, options), sizes
        self.windows = np.unique(np.concatenate([self.data.start, self.data.end]))
        self._at: Array | None = None

    def fit(self, u: Array) -> Array:
        """Errors in units of their sizes, from a first guess in the same."""
        found = least_squares(
            lambda v: self._played(v)[0],
            u,
            jac=lambda v: self._played(v)[1],
            x_scale=_FIRST_STEP,
            ftol=_ENOUGH,
            xtol=_ENOUGH,
            gtol=None,
            max_nfev=_EVALUATIONS,
        )
        return np.asarray(found.x)

    def _played(self, u: Array) -> tuple[Array, Array]:
        """Residuals and their derivative; not finite outside the model, where no step may go."""
        if self._at is None or not np.array_equal(u, self._at):
            self._at, self._last = u.copy(), self._play(u)
        return self._last

    def _play(self, u: Array) -> tuple[Array, Array]:
        errors = SensorErrors(u * self.sizes)
        data, g = self.data, self.data.gravity
        K = data.K
        if outside_model(errors) is not None:
            n = 3 * K + len(self.windows) + 3 + N_PARAMETERS
            return np.full(n, np.inf), np.zeros((n, N_PARAMETERS))
        played = self.processor.process(errors)
        change = played.carried[:, 1] - played.carried[:, 0]
        force, axes = played.force, np.broadcast_to(np.eye(3), (K, 3, 3))
        H = model.horizontal_jacobian(played.integrals, axes, force[data.start], force[data.end], played.accel)
        rows = 2 * K + self.windows
        scale = np.concatenate(
            [np.full(3 * K, g * _TURN_RAD), np.full(len(rows), g * _TURN_RAD), np.full(3, _REST_RAD_S)]
        )
        z = np.concatenate([change.ravel(), played.z[rows], played.z[-3:]]) / scale
        H = np.concatenate([H.reshape(3 * K, -1), played.H[rows], played.H[-3:]]) * self.sizes / scale[:, None]
        # The derivative is that of what the errors still to be found leave, so its sign is the other one.
        return np.concatenate([z, u]), np.concatenate([-H, np.eye(N_PARAMETERS)])
