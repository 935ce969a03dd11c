"""Start from the fixture: sensor errors to the fixture's accuracy, whatever their size.

The summed raw gyro reading of a leg is ``∫ω̃ dt = Mg U_T (angle · axis)`` up to bias and Earth rate, which the mean
reading of the windows removes; the mean raw specific force of a pose is ``Ma (−g û_dwn) + λ_Bias``. Both are linear in
the matrices, so linear least squares needs no first guess. Asymmetry is left out: over the six faces ``|f|`` of all
axes is collinear with the bias, and the ± pairs cancel the gyros' own.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.model.sensor_model import Triad, to_mars
from srt.sequences.manoeuvres import end_attitude

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.model.analytic_platform import GyroStream
    from srt.model.table1 import Sequence
    from srt.sensor_errors import SensorErrors
    from srt.sequences.preparation import PlaybackData

    Array = NDArray[np.float64]

_RIDGE: Final = 1e-6
"""Weight of the prior (a perfect triad) against one pose or one radian: decides only what nothing else does."""
_MOVING: Final = 0.2
"""Share of a sequence's highest rate above which a leg is taken to turn."""


def start_from_fixture(data: PlaybackData, stream: GyroStream) -> tuple[SensorErrors, Array]:
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
        legs = split_legs(stream, k, sequence, bias)
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


def split_legs(stream: GyroStream, k: int, sequence: Sequence, bias: Array) -> Array | None:
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
