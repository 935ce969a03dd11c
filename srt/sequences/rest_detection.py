"""Rest detection: mean and variance of short blocks of samples, and the blocks in which the unit is at rest.

The thresholds are relative to the Earth rate and to the noise of the unit, which is estimated from the quietest
blocks. The rest rate (bias and Earth rate) is the mean rate that most quiet, steady blocks share, counted over
different faces. The faces matter because a slow rotation at a constant rate can be as quiet as rest, and last longer;
but it changes the specific force, or it is about the vertical and has one face only. The *activity* of a block is its
distance from the rest rate, combined with its standard deviation. The distribution of the activity has two modes, rest
(on a bench, or in an unsteady hand) and rotation; the threshold lies between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.constants import EARTH_RATE_RAD_S
from srt.exceptions import DataError
from srt.noise.allan import undisturbed
from srt.noise.quantization import reading_steps
from srt.sequences.plausibility import check_interval

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.types import Array, Counts, Indices, Mask


BLOCK_S: Final = 0.1
"""Length of a block, s: much shorter than a rotation, much longer than a sample."""

MIN_BLOCK_SAMPLES: Final = 8
"""Smallest number of samples of a block; with fewer, its variance is too uncertain."""

SPREAD: Final = 6.0
"""Largest difference of block means that count as equal, in sigma of the difference."""
_FALSE_ALARM: Final = 1e-4
"""Probability that a block at rest with normal noise is classified as moving by its variance."""

_LOUD: Final = 10.0
"""Ratio of a block's variance to that of the quiet blocks, above which the unit moves. Vibration of a table changes
the variance at rest by a small factor; rotation by hand increases it some hundred times. Steady rotations are
recognised by their mean rate."""
_SHAKEN: Final = 400.0
"""Ratio of the variance of specific force to its quiet level, above which the block contains a knock."""
_ROUNDING: Final = 1e-9
"""Rounding error of a block mean, relative to the largest reading."""

_EARTH_SPREAD: Final = 3.0 * EARTH_RATE_RAD_S
"""Largest change of the rate at rest with attitude, rad/s: Earth rate, with a margin for g-sensitivity."""

_FACE: Final = 0.5
"""Cell size of the unit vector of specific force; directions in different cells count as different faces."""
_STEADY_BLOCKS: Final = 10
"""Distance, in blocks (1 s), over which the specific force of a steady block does not change."""

_CELL: Final = 4.0
"""Cell size in which mean rates are counted, in units of the largest deviation of the rate at rest."""


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Means and variances of consecutive blocks, gyro then accelerometer columns, as rates.

    Attributes
    ----------
    first : ndarray of int, shape (B,)
        First sample of each block.
    size : int
        Samples of a block.
    mean, variance : ndarray, shape (B, 6)
    piece : ndarray of int, shape (B,)
        Contiguous piece of the recording that the block lies in.
    floor : ndarray, shape (6,)
        Variance by resolution and rounding of the readings; smaller variances are not distinguished from rest.
    """

    first: Indices
    size: int
    mean: Array
    variance: Array
    piece: Indices
    floor: Array


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """Blocks at rest, and the noise of a sample at rest.

    Attributes
    ----------
    still : ndarray of bool, shape (B,)
    level : ndarray, shape (6,)
        Variance of a sample at rest.
    """

    still: Mask
    level: Array


def blocks_of(recording: Recording) -> Blocks:
    """Cut every contiguous piece of a recording into blocks of a tenth of a second.

    Raises
    ------
    DataError
        If there are too few samples for one block.
    """
    dt = recording.nominal_interval_s
    size = max(MIN_BLOCK_SAMPLES, round(BLOCK_S / dt))
    factor = recording.rates_factor
    pieces = [0, *recording.gaps.tolist(), len(recording.time)]
    first, mean, variance, piece = [], [], [], []
    for p, (a, b) in enumerate(pairwise(pieces)):
        n = (b - a) // size
        if n == 0:
            continue
        both = [_moments(table[a : a + n * size], n, size) for table in (recording.gyro, recording.accel)]
        first.append(a + size * np.arange(n))
        piece.append(np.full(n, p))
        mean.append(np.concatenate([m for m, _ in both], axis=1) * factor)
        variance.append(np.concatenate([v for _, v in both], axis=1) * factor**2)
    if not first:
        raise DataError(
            f"The recording has {len(recording.time)} samples at {1.0 / dt:.6g} Hz, and no piece without a gap has the "
            f"{size} that stillness needs: check the time stamps, their unit, or record for longer."
        )
    centre = np.concatenate(mean)
    floor = np.maximum(resolution_floor(recording), (_ROUNDING * np.abs(centre).max(axis=0)) ** 2)
    return Blocks(np.concatenate(first), size, centre, np.concatenate(variance), np.concatenate(piece), floor)


def resolution_floor(recording: Recording) -> Array:
    """Variance of a sample, as a rate, due to the resolution of the readings, shape (6,); never zero.

    Pulses that were corrected hold those of the other axes, far below a pulse: the stated pulse counts.
    """
    stated = recording.noise.gyro_quantization, recording.noise.accel_quantization
    step = np.maximum(reading_steps(recording), np.repeat([pulse or 0.0 for pulse in stated], 3))
    return np.asarray((step / recording.nominal_interval_s) ** 2 / 12.0 + 1e-300)


_BATCH: Final = 1 << 16
"""Number of samples processed together; they fit into the processor's cache."""


def _moments(table: Array, n: int, size: int) -> tuple[Array, Array]:
    """Mean and variance of n blocks, each of shape (n, 3)."""
    mean, variance = np.empty((n, 3)), np.empty((n, 3))
    step = max(1, _BATCH // size)
    weights = np.full(size, 1.0 / size)
    for a in range(0, n, step):
        b = min(a + step, n)
        x = table[a * size : b * size].reshape(b - a, size, 3)
        # One matrix product gives the means; deviations from one reading of the block avoid cancellation.
        x = x - x[:, :1]
        m = weights @ x
        np.multiply(x, x, out=x)
        variance[a:b] = (weights @ x - m * m) * (size / (size - 1.0))
        mean[a:b] = m + table[a * size : b * size : size]
    return mean, np.maximum(variance, 0.0)


def find_rest(blocks: Blocks) -> Rest:
    """Find the blocks at rest."""
    n = blocks.size
    upper = max(_LOUD, float(chdtri(n - 1, _FALSE_ALARM)) / (n - 1))
    middle = float(chdtri(n - 1, 0.5)) / (n - 1)
    # The quietest tenth is assumed to be at rest; the loop estimates the level from all blocks consistent with it.
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
    radius = np.hypot(SPREAD * np.sqrt(level[:3] / n), _EARTH_SPREAD)
    candidates = np.flatnonzero(quiet)
    if candidates.size == 0:
        return Rest(np.asarray(quiet), level)
    rest = _rest_rate(blocks, candidates, level, radius)
    distance = np.sqrt((blocks.mean[:, :3] - rest) ** 2 + blocks.variance[:, :3])
    bench = np.sqrt((1.5 * radius) ** 2 + upper * level[:3])
    # Relative to the largest deviation of a unit at rest on a bench: below 1 the block is at rest.
    activity = np.max(distance / bench, axis=1)
    shaken = np.any(blocks.variance[:, 3:] > _SHAKEN * level[3:], axis=1)
    return Rest(np.asarray((activity <= max(1.0, _valley(activity))) & ~shaken), level)


def _rest_rate(blocks: Blocks, candidates: Indices, level: Array, radius: Array) -> Array:
    """Mean rate at rest, shape (3,): the rate that most steady blocks share, counted over different faces."""
    points = blocks.mean[candidates, :3] / radius
    force = blocks.mean[candidates, 3:]
    steady = _steady(blocks, level)[candidates]
    if not steady.any():
        steady = np.ones(len(candidates), dtype=np.bool_)
    points, force = points[steady], force[steady]
    unit = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-12)
    face = np.unique(_keys(np.floor(unit / _FACE + 0.5)), return_inverse=True)[1]
    many = int(face.max()) + 1
    best, centre = -1.0, points[0]
    # A cluster smaller than half a cell lies entirely in one cell of at least one of the eight grids.
    for offset in product((0.0, 0.5), repeat=3):
        cells = _keys(np.floor(points / _CELL + np.array(offset)))
        names, index = np.unique(cells, return_inverse=True)
        counts = np.bincount(index * many + face, minlength=len(names) * many).reshape(-1, many)
        # With the square root, ten seconds in each of six faces weigh more than a minute in one face.
        score = np.sqrt(counts).sum(axis=1)
        if score.max() > best:
            best = float(score.max())
            centre = np.median(points[cells == names[int(np.argmax(score))]], axis=0)
    for _ in range(5):
        near = np.all(np.abs(points - centre) <= 1.0, axis=1)
        if not near.any():
            break
        centre = points[near].mean(axis=0)
    out: Array = centre * radius
    return out


def _steady(blocks: Blocks, level: Array) -> Mask:
    """Blocks whose specific force equals, within its noise, that one second before or after, shape (B,).

    Within a second, even a slow rotation changes the specific force by more than the noise of a block.
    """
    k = min(_STEADY_BLOCKS, len(blocks.mean) - 1)
    out = np.zeros(len(blocks.mean), dtype=np.bool_)
    if k == 0:
        return out
    change = np.abs(blocks.mean[k:, 3:] - blocks.mean[:-k, 3:])
    same = np.all(change <= SPREAD * np.sqrt(2.0 * level[3:] / blocks.size), axis=1)
    same &= blocks.piece[k:] == blocks.piece[:-k]
    out[k:] |= same
    out[:-k] |= same
    return out


def _keys(cells: Array) -> Counts:
    """Integer key of each cell of a three-dimensional grid."""
    whole = np.clip(cells, -1e6, 1e6).astype(np.int64) + 1_000_000
    out: Counts = (whole[:, 0] * 2_000_001 + whole[:, 1]) * 2_000_001 + whole[:, 2]
    return out


def _valley(activity: Array) -> float:
    """Threshold between two modes of the activity's logarithm (Otsu: greatest between-class variance)."""
    if len(activity) < 2:
        return 1.0  # one block has no two modes; at rest on a bench the activity is below 1
    x = np.sort(np.log(np.maximum(activity, 1e-6)))
    n = np.arange(1, len(x))
    total = np.cumsum(x)
    low, high = total[:-1] / n, (total[-1] - total[:-1]) / (len(x) - n)
    between = n * (len(x) - n) * (high - low) ** 2
    best = int(np.argmax(between))
    return float(np.exp(0.5 * (x[best] + x[best + 1])))


def still_runs(still: Mask, blocks: Blocks) -> list[tuple[int, int]]:
    """Runs of still blocks (first, one past last), with single blocks bridged that were excluded by noise."""
    filled = still.copy()
    lone = ~still[1:-1] & still[:-2] & still[2:]
    # A single loud block between quiet ones is noise, unless the specific force differs after it (the unit moved).
    scatter = np.sqrt(np.median(blocks.variance[still], axis=0)[3:] / blocks.size) if still.any() else np.ones(3)
    same = np.all(np.abs(blocks.mean[2:, 3:] - blocks.mean[:-2, 3:]) <= SPREAD * np.sqrt(2.0) * scatter, axis=1)
    filled[1:-1] |= lone & same
    key = np.where(filled, blocks.piece, -1)
    edges = np.flatnonzero(np.diff(key, prepend=-2, append=-2))
    return [(a, b) for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True) if filled[a]]


def longest_rest(recording: Recording) -> tuple[int, int] | None:
    """Longest stationary window of a recording without rotations, such as a log on a shelf.

    Returns
    -------
    (int, int) or None
        First sample and one past the last; None if there is no such window.
    """
    try:
        check_interval(recording)
        blocks = blocks_of(recording)
    except DataError:
        return None
    # The first and last block of a run may contain motion.
    runs = [(a + 1, b - 1) for a, b in still_runs(find_rest(blocks).still, blocks) if b - a > 2]
    if not runs:
        return None
    first, last = max(runs, key=lambda run: run[1] - run[0])
    return int(blocks.first[first]), int(blocks.first[last])


def undisturbed_rest(recording: Recording) -> tuple[int, int]:
    """Longest part without knocks of the longest stationary window.

    Returns
    -------
    (int, int)
        First sample and one past the last.

    Raises
    ------
    DataError
        An implausible sampling interval, or a recording without a stationary window.
    """
    check_interval(recording)
    rest = longest_rest(recording)
    pieces = [] if rest is None else undisturbed(recording, *rest)
    if not pieces:
        raise DataError(f"{recording.source or 'The recording'} has no stationary window: log the unit at rest.")
    return max(pieces, key=lambda piece: piece[1] - piece[0])
