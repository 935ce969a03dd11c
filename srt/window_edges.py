"""Edges of stationary windows to the sample, and joins inside them where the attitude jumps without a turn."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator
    from collections.abc import Sequence as SequenceOf

    from numpy.typing import NDArray

    from srt.blocks import Blocks
    from srt.recording import Recording

    Array = NDArray[np.float64]

_LONGEST_SUM: Final = 32
_SIGMAS: Final = 6.0
"""Beyond which readings are motion: the 500,000 tests of a usual recording exceed it by chance about 0.001 times."""
_REFERENCE_BLOCKS: Final = 20
_INWARD_BLOCKS: Final = 20
_OUTWARD_BLOCKS: Final = 3
_CHUNK_S: Final = 0.5
_JUMP: Final = 60.0
"""Smallest gain in chi-square (six channels, one of some forty places) by which a jump is believed."""
_ALONE: Final = 6.0
"""Times the gain of any other place in the window."""
_MOST_CHUNKS: Final = 10


def to_the_sample(recording: Recording, blocks: Blocks, runs: SequenceOf[tuple[int, int]]) -> list[tuple[int, int]]:
    """Stationary windows from runs of still blocks, each extended to the last sample that is still.

    The readings outward of an edge are summed over 1, 2, 4 ... samples and compared with the window beside it. What
    first exceeds its noise ends the window, and as much again is left out: noise hides the beginning of a slow turn.

    Parameters
    ----------
    recording : Recording
    blocks : Blocks
    runs : sequence of (int, int)
        First block and one past the last.

    Returns
    -------
    list of (int, int)
        First sample and one past the last; windows do not overlap.
    """
    factor = 1.0 if recording.kind == "rate" else 1.0 / recording.nominal_interval_s
    pieces = np.array([0, *recording.gaps.tolist(), len(recording.time)])
    least = np.sqrt(blocks.floor)
    out: list[tuple[int, int]] = []
    for first, last in runs:
        if last - first < 3:
            continue
        # Where the turns are slow, the outermost still blocks move a little already: begin well inside. A hand
        # trembles all the time, so there the blocks' verdict stands.
        inside = max(1, min(_INWARD_BLOCKS, (last - first) // 4)) if recording.fixture is not None else 1
        inner = (int(blocks.first[first + inside]), int(blocks.first[last - inside]))
        piece = int(np.searchsorted(pieces, inner[0], side="right"))
        reach = (inside + _OUTWARD_BLOCKS) * blocks.size
        low = max(int(pieces[piece - 1]), inner[0] - reach)
        high = min(int(pieces[piece]), inner[1] + reach)
        n = min(inner[1] - inner[0], _REFERENCE_BLOCKS * blocks.size)
        sides = (
            (slice(inner[0], inner[0] + n), range(inner[0] - 1, low - 1, -1)),
            (slice(inner[1] - n, inner[1]), range(inner[1], high)),
        )
        before, after = (_still_outward(recording, *side, factor, least) for side in sides)
        a, b = inner[0] - before, inner[1] + after
        if out and a < out[-1][1]:  # both reach into the blocks between them: each keeps its half
            middle = (a + out[-1][1]) // 2
            out[-1], a = (out[-1][0], middle), middle
        out.append((a, b))
    return out


def _still_outward(recording: Recording, reference: slice, outward: range, factor: float, least: Array) -> int:
    """How many samples next to a window belong to it."""
    if len(outward) == 0:
        return 0
    beside = np.concatenate([recording.gyro[reference], recording.accel[reference]], axis=1) * factor
    index = np.array(outward)
    away = np.concatenate([recording.gyro[index], recording.accel[index]], axis=1) * factor
    sigma = np.maximum(beside.std(axis=0), least)
    total = np.cumsum((away - beside.mean(axis=0)) / sigma, axis=0)
    total = np.concatenate([np.zeros((1, 6)), total])
    best, kept = len(index), len(index)
    n = 1
    while n <= min(len(index), _LONGEST_SUM):
        beyond = np.any(np.abs(total[n:] - total[:-n]) > _SIGMAS * np.sqrt(n), axis=1)
        if beyond.any():
            found = int(np.argmax(beyond)) + n - 1
            if found < best:
                best, kept = found, max(0, found - 2 * (n - 1))
        n *= 2
    return kept


def split_at_jumps(recording: Recording, a: int, b: int, floor: Array) -> Iterator[tuple[int, int]]:
    """Cut a window where the attitude jumps though the gyros saw no turn.

    Parameters
    ----------
    recording : Recording
    a, b : int
        First sample and one past the last.
    floor : ndarray, shape (6,)
        Variance of one sample, as a rate, that the resolution of the readings makes.

    Yields
    ------
    (int, int)
        The window, or its parts.
    """
    at = _jump(recording, a, b, floor)
    if at is None:
        yield a, b
        return
    yield from split_at_jumps(recording, a, at, floor)
    yield from split_at_jumps(recording, at, b, floor)


def _jump(recording: Recording, a: int, b: int, floor: Array) -> int | None:
    """First sample after the largest jump of a window, if it has one."""
    dt = recording.nominal_interval_s
    size = max(1, round(_CHUNK_S / dt))
    count = (b - a) // size
    span = min(_MOST_CHUNKS, count // 4)
    if span < 2:
        return None
    mean = _chunks(recording, a, size, count)
    steps = np.diff(mean, axis=0) ** 2
    # Noise from neighbours, without the largest difference of a channel, which may be the jump itself.
    variance = (steps.sum(axis=0) - steps.max(axis=0)) / (2.0 * (count - 2))
    # The sum of counts over a chunk is wrong by less than one, at either end.
    variance = np.maximum(variance, 2.0 * floor / size**2)
    total = np.concatenate([np.zeros((1, 6)), np.cumsum(mean, axis=0)])
    # Means over `span` chunks on both sides of one chunk, in which the jump may lie.
    before = (total[span : count - span] - total[: count - 2 * span]) / span
    after = (total[2 * span + 1 :] - total[span + 1 : count - span + 1]) / span
    gain = np.sum((after - before) ** 2 / variance, axis=1) * 0.5 * span
    best = int(np.argmax(gain))
    elsewhere = gain[np.abs(np.arange(len(gain)) - best) > span]
    # A wandering bias steps everywhere a little; a join stands alone.
    if gain[best] < max(_JUMP, _ALONE * float(elsewhere.max(initial=0.0))):
        return None
    tilt = _angle(before[best, 3:], after[best, 3:])
    near = slice(max(0, best + span - 1), min(count, best + span + 2))
    rest = 0.5 * (before[best, :3] + after[best, :3])
    turned = float(np.linalg.norm((mean[near, :3] - rest).sum(axis=0))) * size * dt
    noise = 3.0 * float(np.sqrt(variance[:3].max())) * size * dt
    if noise < 0.5 * tilt < turned:
        return None  # the gyros saw it: the unit was bumped, and stays one piece
    return best_join(recording, a + size * max(0, best + span - 1), a + size * min(count, best + span + 2))


def best_join(recording: Recording, a: int, b: int) -> int:
    """Most likely place of a jump between two samples: the first sample after it.

    Parameters
    ----------
    recording : Recording
    a, b : int
        First sample to look at, and one past the last; at least two samples.
    """
    samples = np.concatenate([recording.gyro[a:b], recording.accel[a:b]], axis=1)
    samples = samples - samples.mean(axis=0)
    spread = np.maximum(np.diff(samples, axis=0).std(axis=0), 1e-300)
    total = np.cumsum(samples / spread, axis=0)[:-1]
    before = np.arange(1, b - a)
    gain = np.sum(total**2, axis=1) * (b - a) / (before * (b - a - before))
    return a + 1 + int(np.argmax(gain))


def _chunks(recording: Recording, a: int, size: int, count: int) -> Array:
    """Mean readings of consecutive chunks, shape (count, 6), as rates."""
    factor = 1.0 if recording.kind == "rate" else 1.0 / recording.nominal_interval_s
    end = a + size * count
    both = [t[a:end].reshape(count, size, 3).mean(axis=1) for t in (recording.gyro, recording.accel)]
    return np.concatenate(both, axis=1) * factor


def _angle(first: Array, second: Array) -> float:
    """Angle between two vectors, rad."""
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second))


def adjoin(windows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether each window begins where the one before ends, shape (W - 1,): a join lies between them."""
    return np.array([second[0] == first[1] for first, second in pairwise(windows)], dtype=np.bool_)
