"""Raw gyro samples of all sequences of a recording as one stream, which the analytic platform integrates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.types import Array, Indices

_SMOOTHING_S: Final = 0.2
"""Averaging time of the rate that decides the sign of a channel near zero, s; short against a rotation."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroStream:
    """Raw gyro samples of K sequences, one after another.

    Attributes
    ----------
    increments : ndarray, shape (3, n)
        Raw readings times their interval, rad.
    smooth : ndarray, shape (3, n)
        Increments averaged over 0.2 s, which decide the sign of a channel near zero.
    interval_s : ndarray, shape (n,)
    starts : ndarray of int, shape (K + 1,)
        Sequence k is the samples starts[k] to starts[k + 1].
    rotation : ndarray of int, shape (K, 2)
        First sample of the rotation and one past its last, within the stream. Windows with integrated attitude lie
        outside it.
    F : ndarray, shape (n,), or None
        Weight of an attitude error, see :mod:`srt.model.rotation_integrals`; None: 1 everywhere.
    velocity : ndarray, shape (3, n), m/s, or None
        Compensated specific force times the interval, for the integral ``velocity``; None: not computed.
    """

    increments: Array
    smooth: Array
    interval_s: Array
    starts: Indices
    rotation: Indices
    F: Array | None = None
    velocity: Array | None = None


def gyro_stream(
    gyro: Array,
    interval_s: float | Array,
    spans: Indices,
    rotation: Indices,
    *,
    rates: bool,
    F: Array | None = None,
) -> GyroStream:
    """Collect the gyro samples of all sequences into one stream.

    Parameters
    ----------
    gyro : ndarray, shape (n, 3)
        Raw readings of the whole recording, rad/s (``rates``) or rad.
    interval_s : float or ndarray, shape (n,)
    spans : ndarray of int, shape (K, 2)
        First sample and one past the last, per sequence.
    rotation : ndarray of int, shape (K, 2)
        The rotation's samples in the recording's numbering.
    rates : bool
        The readings are rates; False: increments.
    F : ndarray, shape (sum of the spans' lengths,), optional
    """
    lengths = spans[:, 1] - spans[:, 0]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    n = int(starts[-1])
    parts = [slice(a, b) for a, b in spans.tolist()]
    increments = np.ascontiguousarray(np.concatenate([gyro[part] for part in parts]).T) if n else np.empty((3, 0))
    if isinstance(interval_s, float):
        dt = np.full(n, interval_s)
    else:
        dt = np.concatenate([interval_s[part] for part in parts]) if n else np.empty(0)
    if rates:
        increments *= dt
    width = max(1, round(_SMOOTHING_S / float(np.median(dt)))) if n else 1
    smooth = moving_average(increments, width)
    offset = starts[:-1] - spans[:, 0]
    return GyroStream(increments, smooth, dt, starts, rotation + offset[:, None], F)


def joined_streams(streams: Sequence[GyroStream]) -> GyroStream:
    """Streams of several units as one, one after another."""
    first = np.cumsum([0, *(len(stream.interval_s) for stream in streams)])
    starts = [stream.starts[:-1] + at for stream, at in zip(streams, first.tolist(), strict=False)]
    rotation = [stream.rotation + at for stream, at in zip(streams, first.tolist(), strict=False)]
    weights = [stream.F for stream in streams if stream.F is not None]
    return GyroStream(
        increments=np.concatenate([stream.increments for stream in streams], axis=1),
        smooth=np.concatenate([stream.smooth for stream in streams], axis=1),
        interval_s=np.concatenate([stream.interval_s for stream in streams]),
        starts=np.append(np.concatenate(starts), first[-1]),
        rotation=np.concatenate(rotation),
        F=np.concatenate(weights) if weights else None,
    )


def moving_average(values: Array, width: int) -> Array:
    """Centred moving average along the last axis; the ends are continued by their last value.

    Differences of one cumulative sum, so the cost does not depend on the width. ``scipy.ndimage`` has the same filter,
    but its import takes 0.04 s.
    """
    n = values.shape[-1]
    if width <= 1 or not n:
        return values
    out = np.empty((values.size // n, n))
    before = width // 2
    sums = np.empty(n + width)
    for k, row in enumerate(values.reshape(-1, n)):
        # The value before the first sample is zero, so that sums[k + width] - sums[k] is that of the window of k.
        sums[0], sums[1 : before + 1], sums[before + n + 1 :] = 0.0, row[0], row[-1]
        sums[before + 1 : before + n + 1] = row
        np.cumsum(sums, out=sums)
        out[k] = (sums[width:] - sums[:n]) / width
    return out
