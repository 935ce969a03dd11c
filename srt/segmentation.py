"""Stillness and turns of an unlabelled recording, told by the unit's own noise and bias.

Nothing here is an absolute threshold. The quietest blocks of samples give the unit's noise, and where their mean rates
crowd together lies the rest rate (bias and Earth rate): a slow constant turn is as quiet but scatters over many means.
A block's *activity* is its distance from that rest, mean and scatter together. Its distribution has two modes, resting
(on a bench, or in a hand that trembles) and turning; the valley between them decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.constants import EARTH_RATE_RAD_S
from srt.exceptions import DataError
from srt.noise_estimation import smallest_step
from srt.recording import SequenceLabel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.recording import Recording

    Array = NDArray[np.float64]

BLOCK_S: Final = 0.1
MIN_BLOCK_SAMPLES: Final = 8
MIN_WINDOW_S: Final = 1.0
MIN_TURN_RAD: Final = 0.1
_FALSE_ALARM: Final = 1e-4
_LOUD: Final = 10.0
"""Variance of a block over that of the unit's quiet ones, above which it moves. Real rests differ by a few (a hand
near by, a table that hums); turns by hand are louder by hundreds, steady turns are told by their mean."""
_SHAKEN: Final = 400.0
"""Variance of specific force over the quiet level, beyond which a block is a knock and no rest."""
_MAX_SAMPLES_FOR_RESOLUTION: Final = 4000
_ROUNDING: Final = 1e-9
_SPREAD: Final = 6.0
"""Sigmas of a block mean within which it counts as the rest rate."""
_EARTH_SPREAD: Final = 3.0 * EARTH_RATE_RAD_S


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Means and variances of consecutive blocks, gyro then accelerometer columns, as rates.

    ``floor`` is the variance below which nothing is told from rest: that of the readings' resolution, and rounding.
    """

    first: NDArray[np.intp]
    size: int
    mean: Array
    variance: Array
    piece: NDArray[np.intp]
    floor: Array


def find_windows(recording: Recording) -> NDArray[np.intp]:
    """Stationary windows, first sample and one past the last, shape (W, 2), in time order.

    Raises
    ------
    DataError
        If fewer than two are found, with what was looked for.
    """
    blocks = _blocks(recording)
    still = _still(blocks)
    runs = _runs(still, blocks)
    shortest = max(MIN_WINDOW_S, 3 * BLOCK_S)
    dt = recording.nominal_interval_s
    windows = []
    for first, last in runs:
        # The outermost blocks may hold the settling of the turn before or the onset of the next.
        if last - first > 2:
            a, b = int(blocks.first[first + 1]), int(blocks.first[last - 1])
            if b - a >= shortest / dt:
                windows.append((a, b))
    if len(windows) < 2:
        raise DataError(
            f"Only {len(windows)} stationary windows of at least {shortest:g} s were found in the recording; "
            "stillness, turn, stillness is needed: let the unit rest between turns, or label the windows."
        )
    return np.array(windows, dtype=np.intp)


def find_turns(recording: Recording) -> tuple[SequenceLabel, ...]:
    """Free turns between successive stationary windows: each pose ends one turn and starts the next.

    A disturbance that left the unit where it was makes no turn: of the windows around it the longer is kept.

    Raises
    ------
    DataError
        If the recording holds no turn between two windows.
    """
    windows = find_windows(recording)
    dt = recording.nominal_interval_s
    gaps = recording.gaps
    rates = 1.0 if recording.kind == "rate" else 1.0 / dt
    kept: list[tuple[int, int]] = [(int(windows[0, 0]), int(windows[0, 1]))]
    breaks: list[bool] = []
    for a, b in windows[1:].tolist():
        last_a, last_b = kept[-1]
        apart = bool(np.any((gaps > last_a) & (gaps < b)))
        rest = recording.gyro[last_a:last_b].mean(axis=0)
        angle = np.linalg.norm((recording.gyro[last_b:a] - rest).sum(axis=0)) * rates * dt
        path = np.linalg.norm((recording.gyro[last_b:a] - rest), axis=1).sum() * rates * dt
        if not apart and max(float(angle), 0.2 * float(path)) < MIN_TURN_RAD:
            if b - a > last_b - last_a:
                kept[-1] = (a, b)
            continue
        kept.append((a, b))
        breaks.append(apart)
    labels = tuple(
        SequenceLabel(_times(recording, first), _times(recording, second))
        for first, second, apart in zip(kept[:-1], kept[1:], breaks, strict=True)
        if not apart
    )
    if not labels:
        raise DataError(
            f"{len(windows)} stationary windows were found, but no turn between two of them: the unit was not rotated."
        )
    return labels


def _times(recording: Recording, window: tuple[int, int]) -> tuple[float, float]:
    """Window bounds in time: the interval of the first sample begins one step before its stamp."""
    dt = recording.nominal_interval_s
    return float(recording.time[window[0]] - dt), float(recording.time[window[1] - 1])


def _blocks(recording: Recording) -> _Blocks:
    dt = recording.nominal_interval_s
    size = max(MIN_BLOCK_SAMPLES, round(BLOCK_S / dt))
    factor = 1.0 if recording.kind == "rate" else 1.0 / dt
    pieces = [0, *recording.gaps.tolist(), len(recording.time)]
    first, mean, variance, piece = [], [], [], []
    for p, (a, b) in enumerate(pairwise(pieces)):
        n = (b - a) // size
        if n == 0:
            continue
        stop = a + n * size
        means, variances = [], []
        for table in (recording.gyro, recording.accel):
            x = table[a:stop].reshape(n, size, 3) * factor
            m = x.mean(axis=1)
            x -= m[:, None]
            means.append(m)
            variances.append(np.einsum("nsc,nsc->nc", x, x) / (size - 1))
        first.append(a + size * np.arange(n))
        piece.append(np.full(n, p))
        mean.append(np.concatenate(means, axis=1))
        variance.append(np.concatenate(variances, axis=1))
    if not first:
        raise DataError(
            f"The recording has {len(recording.time)} samples, too few to find stillness: at least {size} are needed."
        )
    stride = max(1, len(recording.time) // _MAX_SAMPLES_FOR_RESOLUTION)
    step = np.concatenate([smallest_step(table[::stride]) for table in (recording.gyro, recording.accel)]) * factor
    centre = np.concatenate(mean)
    floor = np.maximum(step**2 / 12.0, (_ROUNDING * np.abs(centre).max(axis=0)) ** 2 + 1e-300)
    return _Blocks(np.concatenate(first), size, centre, np.concatenate(variance), np.concatenate(piece), floor)


def _still(blocks: _Blocks) -> NDArray[np.bool_]:
    """Which blocks are at rest."""
    n = blocks.size
    upper = max(_LOUD, float(chdtri(n - 1, _FALSE_ALARM)) / (n - 1))
    middle = float(chdtri(n - 1, 0.5)) / (n - 1)
    # The quietest tenth is at rest if anything is; the loop then takes the level from all blocks that agree.
    level = np.maximum(np.quantile(blocks.variance, 0.1, axis=0), blocks.floor)
    quiet = np.all(blocks.variance <= upper * level, axis=1)
    for _ in range(5):
        if not quiet.any():
            break
        level = np.maximum(np.median(blocks.variance[quiet], axis=0) / middle, blocks.floor)
        new = np.all(blocks.variance <= upper * level, axis=1)
        if np.array_equal(new, quiet):
            break
        quiet = new
    radius = np.hypot(_SPREAD * np.sqrt(level[:3] / n), _EARTH_SPREAD)
    candidates = np.flatnonzero(quiet)
    if candidates.size == 0:
        return np.asarray(quiet)
    points = blocks.mean[candidates, :3] / radius
    # The rest rate is where most block means crowd together; turns at a steady rate scatter over many values.
    cells, counts = np.unique(np.floor(points), axis=0, return_counts=True)
    centre = cells[int(np.argmax(counts))] + 0.5
    for _ in range(5):
        near = np.all(np.abs(points - centre) <= 1.0, axis=1)
        centre = points[near].mean(axis=0)
    rest = centre * radius
    distance = np.sqrt((blocks.mean[:, :3] - rest) ** 2 + blocks.variance[:, :3])
    bench = np.sqrt((1.5 * radius) ** 2 + upper * level[:3])
    # In units of what a bench at rest may show; below 1 everything is rest.
    activity = np.max(distance / bench, axis=1)
    shaken = np.any(blocks.variance[:, 3:] > _SHAKEN * level[3:], axis=1)
    return np.asarray((activity <= max(1.0, _valley(activity))) & ~shaken)


def _valley(activity: Array) -> float:
    """Threshold between two modes of the activity's logarithm (Otsu: greatest between-class variance)."""
    x = np.sort(np.log(np.maximum(activity, 1e-6)))
    n = np.arange(1, len(x))
    total = np.cumsum(x)
    low, high = total[:-1] / n, (total[-1] - total[:-1]) / (len(x) - n)
    between = n * (len(x) - n) * (high - low) ** 2
    best = int(np.argmax(between))
    return float(np.exp(0.5 * (x[best] + x[best + 1])))


def _runs(still: NDArray[np.bool_], blocks: _Blocks) -> list[tuple[int, int]]:
    """Runs of still blocks (first, one past last), bridging single blocks that chance threw out."""
    filled = still.copy()
    lone = ~still[1:-1] & still[:-2] & still[2:]
    # A lone loud block between quiet ones is chance unless it moved the unit: then the force differs after it.
    scatter = np.sqrt(np.median(blocks.variance[still], axis=0)[3:] / blocks.size) if still.any() else np.ones(3)
    same = np.all(np.abs(blocks.mean[2:, 3:] - blocks.mean[:-2, 3:]) <= _SPREAD * np.sqrt(2.0) * scatter, axis=1)
    filled[1:-1] |= lone & same
    key = np.where(filled, blocks.piece, -1)
    edges = np.flatnonzero(np.diff(key, prepend=-2, append=-2))
    return [(a, b) for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True) if filled[a]]
