"""Right angles: which face of a unit is down, and how many quarter turns it made, whatever its scale errors."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence as SequenceOf

    from numpy.typing import NDArray

    from srt.turns import Turn

    Array = NDArray[np.float64]
    Whole = NDArray[np.int64]

QUARTER: Final = 0.5 * np.pi
LEGAL_SCALE: Final = (0.5, 1.6)
"""Reading over truth of a gyro that quarter turns are counted by; 30 % of error and as much in safety."""
_UPRIGHT: Final = 0.75
"""Cosine of the angle to the next axis, within which a face counts as down: 40° take in misalignment and bias."""
_PURE: Final = 0.75
OFF: Final = 0.4
"""Quarter turns by which an angle may be off the next whole number and still stand for it."""


@cache
def quarter_turn(axis: int, count: int) -> Whole:
    """Rotation by quarter turns about a body axis, turned to unturned components, shape (3, 3), whole numbers."""
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[count % 4]
    out = np.eye(3, dtype=np.int64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    out.flags.writeable = False
    return out


def centred(force: Array, gravity: float) -> Array:
    """Mean specific force of windows less what the extremes of each axis have in common, its bias, shape (W, 3)."""
    low, high = force.min(axis=0), force.max(axis=0)
    both = (low < -0.3 * gravity) & (high > 0.3 * gravity)
    return np.asarray(force - np.where(both, 0.5 * (low + high), 0.0))


def faces(force: Array, gravity: float) -> list[tuple[int, int] | None]:
    """Body axis that is down, and its sign, for every window; None where no axis is near the vertical."""
    f = centred(force, gravity)
    axis = np.argmax(np.abs(f), axis=1)
    share = np.abs(f[np.arange(len(f)), axis]) / np.maximum(np.linalg.norm(f, axis=1), 1e-300)
    sign = -np.sign(f[np.arange(len(f)), axis]).astype(int)
    return [(int(a), int(s)) if c > _UPRIGHT else None for a, s, c in zip(axis, sign, share, strict=True)]


def face_vector(face: tuple[int, int]) -> Whole:
    """Down in body axes, shape (3,)."""
    out = np.zeros(3, dtype=np.int64)
    out[face[0]] = face[1]
    return out


def leg_axis(leg: Array) -> tuple[int, float] | None:
    """Sensor axis of a leg and its signed raw angle; None where no axis stands out."""
    axis = int(np.argmax(np.abs(leg)))
    size = float(np.linalg.norm(leg))
    if size == 0.0 or abs(leg[axis]) < _PURE * size:
        return None
    return axis, float(np.sign(leg[axis]) * size)


def scales(turns: SequenceOf[Turn], face: SequenceOf[tuple[int, int] | None]) -> Array:
    """Reading over truth of each gyro axis, from turns of one leg that turn a face over, shape (3,).

    What is down before and after such a turn tells its angle but for whole turns, whatever the gyro reads.
    """
    ratios: list[list[float]] = [[], [], []]
    for turn in turns:
        before, after = face[turn.start_window], face[turn.end_window]
        found = leg_axis(turn.legs[0]) if len(turn.legs) == 1 else None
        if found is None or before is None or after is None or found[0] == before[0]:
            continue
        axis, angle = found
        down, end = face_vector(before), face_vector(after)
        for q in range(1, 7):
            count = q if angle > 0.0 else -q
            ratio = angle / (count * QUARTER)
            if LEGAL_SCALE[0] < ratio < LEGAL_SCALE[1] and np.array_equal(quarter_turn(axis, count).T @ down, end):
                ratios[axis].append(ratio)
    middle = [float(np.median(r)) if r else np.nan for r in ratios]
    common = float(np.nanmedian(middle)) if not np.all(np.isnan(middle)) else 1.0
    return np.array([common if np.isnan(m) else m for m in middle])


def quarters(legs: Array, scale: Array) -> list[tuple[int, int]] | None:
    """Axis and quarter turns of each leg; None where a leg is no whole number of quarter turns about one axis."""
    out = []
    for leg in legs:
        found = leg_axis(leg)
        if found is None:
            return None
        axis, angle = found
        turns = angle / (QUARTER * scale[axis])
        count = round(turns)
        if count == 0 or abs(turns - count) > OFF:
            return None
        out.append((axis, count))
    return out
