"""Turns between stationary windows, as the raw gyros saw them, split into legs about one sensor axis each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import uniform_filter1d

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.recording.recording import Recording

    Array = NDArray[np.float64]

MOVING: Final = 0.2
"""Share of a turn's highest rate above which it is moving."""
_SMOOTH_S: Final = 0.05
_SHORTEST: Final = 0.02
"""Share of a turn's duration, below which a leg is a transient between two others."""


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """What happened between two successive stationary windows of one contiguous piece.

    Attributes
    ----------
    start_window, end_window : int
        Indices into the windows.
    first, last : int
        First sample of the turn and one past its last.
    legs : ndarray, shape (m, 3), rad
        Summed raw gyro angle of each leg, less the bias that the two windows show.
    bounds : ndarray of int, shape (m, 2)
        First sample of each leg and one past its last.
    """

    start_window: int
    end_window: int
    first: int
    last: int
    legs: Array
    bounds: NDArray[np.intp]

    @property
    def angle_rad(self) -> float:
        """Sum of the legs' angles."""
        return float(np.linalg.norm(self.legs, axis=1).sum())


def find_legs(recording: Recording, windows: NDArray[np.intp], start: int) -> Turn:
    """Split the turn after a window into legs.

    A leg is a stretch in which the same sensor axis turns fastest, in the same sense: a fixture turns about one axis at
    a time, and sensor axes lie within some tenths of a radian of the fixture's. A stop on the way does not end a leg.

    Parameters
    ----------
    recording : Recording
    windows : ndarray of int, shape (W, 2)
    start : int
        Window before the turn; the turn ends at the next one.
    """
    a, b = int(windows[start, 1]), int(windows[start + 1, 0])
    rest = [recording.gyro[lo:hi].mean(axis=0) for lo, hi in windows[start : start + 2].tolist()]
    per_sample = recording.gyro[a:b] - 0.5 * (rest[0] + rest[1])
    interval = recording.interval_s
    if recording.kind == "rate":
        per_sample = per_sample * (interval if isinstance(interval, float) else interval[a:b, None])
    smooth = uniform_filter1d(
        per_sample, max(1, round(_SMOOTH_S / recording.nominal_interval_s)), axis=0, mode="nearest"
    )
    speed = np.linalg.norm(smooth, axis=1)
    moving = np.flatnonzero(speed > MOVING * speed.max())
    axis = np.argmax(np.abs(smooth[moving]), axis=1)
    sense = np.sign(smooth[moving, axis])
    key = (axis * 2 + (sense > 0)).astype(np.int64)
    cuts = np.flatnonzero(np.diff(key)) + 1
    starts, stops = np.concatenate([[0], cuts]), np.append(cuts, len(key))
    keep = stops - starts > _SHORTEST * len(moving)
    bounds: list[list[int]] = []
    names: list[int] = []
    for lo, hi in zip(starts[keep].tolist(), stops[keep].tolist(), strict=True):
        if names and names[-1] == key[lo]:
            bounds[-1][1] = int(moving[hi - 1]) + 1
        else:
            bounds.append([int(moving[lo]), int(moving[hi - 1]) + 1])
            names.append(int(key[lo]))
    # Every sample belongs to a leg: cut in the middle of what lies between two.
    middles = [(bounds[i][1] + bounds[i + 1][0]) // 2 for i in range(len(bounds) - 1)]
    edges = np.array([0, *middles, b - a], dtype=np.intp)
    legs = np.add.reduceat(per_sample, edges[:-1], axis=0)
    return Turn(start, start + 1, a, b, legs, a + np.stack([edges[:-1], edges[1:]], axis=1))
