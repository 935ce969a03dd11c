"""Stationary windows of an unlabelled recording, to the sample; free manoeuvres between; jumps of attitude within."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.recording.recording import SequenceLabel
from srt.sequences.rest_detection import BLOCK_S, blocks_of, find_rest, still_runs

if TYPE_CHECKING:
    from collections.abc import Sequence as SequenceOf

    from srt.recording.recording import Recording
    from srt.sequences.rest_detection import Blocks
    from srt.types import Array, Indices


_LONGEST_SUM: Final = 32
_SIGMAS: Final = 6.0
"""Beyond which readings are motion: the 500,000 tests of a usual recording exceed it by chance about 0.001 times."""
_DOUBTFUL: Final = 2.5
"""Sigmas of a single reading, next to motion, that are better left out."""
_REFERENCE_S: Final = 2.0
_INWARD_BLOCKS: Final = 20
_OUTWARD_BLOCKS: Final = 3
_FEW: Final = 8
_CHUNK_S: Final = 0.5
_JUMP: Final = 60.0
"""Smallest gain in chi-square (six channels, one of some forty places) by which a jump is believed."""
_ALONE: Final = 6.0
"""Times the gain of any other place in the window."""
_UNUSUAL: Final = 8.0
"""Times what is usual away from the largest step of a window."""
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
    pieces = np.array([0, *recording.gaps.tolist(), len(recording.time)])
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
        outer = (max(int(pieces[piece - 1]), inner[0] - reach), min(int(pieces[piece]), inner[1] + reach))
        a, b = _extend(recording, inner, outer, blocks.floor)
        if out and a < out[-1][1]:  # both reach into the blocks between them: each keeps its half
            middle = (a + out[-1][1]) // 2
            out[-1], a = (out[-1][0], middle), middle
        out.append((a, b))
    return out


def trimmed(recording: Recording, window: tuple[int, int], floor: Array) -> tuple[int, int]:
    """Cut off what is not still at the ends of a window, within a quarter of its length.

    Parameters
    ----------
    recording : Recording
    window : (int, int)
        First sample and one past the last.
    floor : ndarray, shape (6,)
        Variance of one sample, as a rate, that the resolution of the readings makes.
    """
    inside = (window[1] - window[0]) // 4
    return _extend(recording, (window[0] + inside, window[1] - inside), window, floor)


def _extend(recording: Recording, inner: tuple[int, int], outer: tuple[int, int], floor: Array) -> tuple[int, int]:
    """Extend a still span to the last still samples on both sides, not beyond ``outer``."""
    factor = 1.0 if recording.kind == "rate" else 1.0 / recording.nominal_interval_s
    n = max(1, min(inner[1] - inner[0], round(_REFERENCE_S / recording.nominal_interval_s)))
    sides = (
        (slice(inner[0], inner[0] + n), range(inner[0] - 1, outer[0] - 1, -1)),
        (slice(inner[1] - n, inner[1]), range(inner[1], outer[1])),
    )
    before, after = (_still_outward(recording, *side, factor, np.sqrt(floor)) for side in sides)
    return inner[0] - before, inner[1] + after


def _still_outward(recording: Recording, reference: slice, outward: range, factor: float, least: Array) -> int:
    """How many samples next to a window belong to it."""
    if len(outward) == 0:
        return 0
    beside = np.concatenate([recording.gyro[reference], recording.accel[reference]], axis=1) * factor
    index = np.array(outward)
    away = np.concatenate([recording.gyro[index], recording.accel[index]], axis=1) * factor
    sigma = np.maximum(beside.std(axis=0), least)
    deviation = (away - beside.mean(axis=0)) / sigma
    total = np.cumsum(deviation, axis=0)
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
    # The sample beside the motion may hold its first or last moment, too little to be told for sure.
    while 0 < kept < len(index) and np.any(np.abs(deviation[kept - 1, :3]) > _DOUBTFUL):
        kept -= 1
    return kept


def split_at_jumps(recording: Recording, windows: SequenceOf[tuple[int, int]], floor: Array) -> list[tuple[int, int]]:
    """Cut windows where the attitude jumps: at a join, or where the unit was bumped or moved a little.

    Parameters
    ----------
    recording : Recording
    windows : sequence of (int, int)
        First sample and one past the last.
    floor : ndarray, shape (6,)
        Variance of one sample, as a rate, that the resolution of the readings makes.

    Returns
    -------
    list of (int, int)
    """
    steps = {window: _largest_step(recording, *window, floor) for window in windows}
    # A wandering bias steps a little in every window; a jump stands out of its own window and of all of them.
    usual = float(np.median([step.elsewhere for step in steps.values()])) if steps else 0.0
    out: list[tuple[int, int]] = []
    waiting = list(reversed(windows))
    while waiting:
        window = waiting.pop()
        step = steps.get(window) or _largest_step(recording, *window, floor)
        if step.gain > max(_JUMP, _ALONE * step.elsewhere, _UNUSUAL * usual):
            parts = ((step.at, window[1]), (window[0], step.at))
            waiting += [trimmed(recording, part, floor) for part in parts if part[1] - part[0] >= _FEW]
        else:
            out.append(window)
    return out


@dataclass(frozen=True, slots=True)
class _Step:
    """Largest step in a window: its gain in chi-square, the largest gain away from it, and the sample after it."""

    gain: float = 0.0
    elsewhere: float = 0.0
    at: int = 0


def _largest_step(recording: Recording, a: int, b: int, floor: Array) -> _Step:
    dt = recording.nominal_interval_s
    size = max(1, round(_CHUNK_S / dt))
    count = (b - a) // size
    span = min(_MOST_CHUNKS, count // 4)
    if span < 2:
        return _Step()
    mean = _chunks(recording, a, size, count)
    steps = np.diff(mean, axis=0) ** 2
    # Noise from neighbours, without the largest difference of a channel, which may be the jump itself.
    variance = (steps.sum(axis=0) - steps.max(axis=0)) / (2.0 * (count - 2))
    # The sum of counts over a chunk is wrong by less than one, at either end.
    variance = np.maximum(variance, 2.0 * floor / size**2)
    total = np.concatenate([np.zeros((1, 6)), np.cumsum(mean, axis=0)])
    # A bias that wanders as stated steps by this much between neighbouring means, however long they are: the Allan
    # variance of flicker noise is flat.
    stated = (recording.noise.gyro_bias_instability, recording.noise.accel_bias_instability)
    wander = 2.0 * np.repeat([figure or 0.0 for figure in stated], 3) ** 2
    # Means over `span` chunks on both sides of one chunk, in which the jump may lie.
    before = (total[span : count - span] - total[: count - 2 * span]) / span
    after = (total[2 * span + 1 :] - total[span + 1 : count - span + 1]) / span
    gain = np.sum((after - before) ** 2 / (2.0 * variance / span + wander), axis=1)
    best = int(np.argmax(gain))
    elsewhere = gain[np.abs(np.arange(len(gain)) - best) > span]
    lo, hi = a + size * max(0, best + span - 1), a + size * min(count, best + span + 2)
    return _Step(float(gain[best]), float(elsewhere.max(initial=0.0)), best_join(recording, lo, hi)[0])


def best_join(recording: Recording, a: int, b: int) -> tuple[int, float]:
    """Most likely place of a jump between two samples: the first sample after it, and its gain in chi-square.

    Parameters
    ----------
    recording : Recording
    a, b : int
        First sample to look at, and one past the last; at least three samples.
    """
    samples = np.concatenate([recording.gyro[a:b], recording.accel[a:b]], axis=1)
    least = 1e-9 * np.abs(samples).max(axis=0) + 1e-150
    samples = samples - samples.mean(axis=0)
    spread = np.maximum(np.diff(samples, axis=0).std(axis=0) / np.sqrt(2.0), least)
    total = np.cumsum(samples / spread, axis=0)[:-1]
    before = np.arange(1, b - a)
    gain = np.sum(total**2, axis=1) * (b - a) / (before * (b - a - before))
    best = int(np.argmax(gain))
    return a + 1 + best, float(gain[best])


def _chunks(recording: Recording, a: int, size: int, count: int) -> Array:
    """Mean readings of consecutive chunks, shape (count, 6), as rates."""
    factor = 1.0 if recording.kind == "rate" else 1.0 / recording.nominal_interval_s
    end = a + size * count
    both = [t[a:end].reshape(count, size, 3).mean(axis=1) for t in (recording.gyro, recording.accel)]
    return np.concatenate(both, axis=1) * factor


MIN_WINDOW_S: Final = 1.0

MIN_TURN_RAD: Final = 0.1


def find_windows(recording: Recording) -> Indices:
    """Stationary windows, first sample and one past the last, shape (W, 2), in time order.

    Two that adjoin without a sample between them lie on both sides of a join: the attitude jumps there, as where
    recordings were put end to end.

    Raises
    ------
    DataError
        If fewer than two are found, with what was looked for.
    """
    blocks = blocks_of(recording)
    rest = find_rest(blocks)
    runs = still_runs(rest.still, blocks)
    shortest = max(MIN_WINDOW_S, 3 * BLOCK_S)
    dt = recording.nominal_interval_s
    found = to_the_sample(recording, blocks, runs)
    if recording.fixture is not None:
        # A hand wobbles as a bad join would; on a fixture only a join, or a bump, makes a step.
        found = split_at_jumps(recording, found, blocks.floor)
    windows = [w for w in found if w[1] - w[0] >= shortest / dt - 0.5]
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
        apart = a == last_b or bool(np.any((gaps > last_a) & (gaps < b)))
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
        SequenceLabel(window_times(recording, first), window_times(recording, second))
        for first, second, apart in zip(kept[:-1], kept[1:], breaks, strict=True)
        if not apart
    )
    if not labels:
        raise DataError(
            f"{len(windows)} stationary windows were found, but no turn between two of them: the unit was not rotated."
        )
    return labels


def window_times(recording: Recording, window: tuple[int, int]) -> tuple[float, float]:
    """Window bounds in time: the interval of the first sample begins one step before its stamp."""
    dt = recording.nominal_interval_s
    return float(recording.time[window[0]] - dt), float(recording.time[window[1] - 1])
