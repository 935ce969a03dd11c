"""Stationary windows of an unlabelled recording to the sample, attitude jumps in them, and manoeuvres between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.recording.readings import derived, six_channels
from srt.recording.recording import SequenceLabel
from srt.sequences.manoeuvres import angles_between
from srt.sequences.rest_detection import BLOCK_S, blocks_of, find_rest, still_runs

if TYPE_CHECKING:
    from collections.abc import Sequence as SequenceOf

    from srt.recording.recording import Recording
    from srt.sequences.rest_detection import Blocks, Rest
    from srt.types import Array, Indices


_LONGEST_SUM_S: Final = 2.0
"""Longest sum of readings compared with rest, s; enough to detect the start of a rotation of 30 s from zero rate."""

_SIGMAS: Final = 6.0
"""Limit of a sum of readings, in sigma, for motion: about 0.001 false alarms in the 500,000 tests of a recording."""

_COARSE: Final = 4.0
"""Ratio of the variance of the gyros at rest to that of their steps below which the steps hide more than the noise."""
_GROWN: Final = 4.0
"""Growth of a rate beyond its limit from which the beginning of the motion is extrapolated."""
_BEGINNING: Final = 2.0 / 3.0
"""Power of the growth that is in proportion to the time: between rates that grow with time (1) and its square (1/2)."""
_DOUBTFUL: Final = 2.5
"""Limit, in sigma, of a single gyro reading next to motion; a larger one is excluded from the window."""
_CORE_BLOCKS: Final = 20
"""Length, in blocks (2 s), of the core: the quietest part near either end of a run of still blocks."""

_LEAST_CORE_BLOCKS: Final = 4
"""Length up to which a core keeps the outermost blocks of its run."""

_SEARCH_BLOCKS: Final = 60
"""Distance, in blocks (6 s), from the end of a run within which the core lies: slow rotations start almost still."""

_OUTWARD_BLOCKS: Final = 3
"""Distance, in blocks, beyond a run of still blocks up to which samples may still be at rest."""

_FEW: Final = 8
"""Smallest number of samples of a part of a window; shorter parts are dropped."""

_MEDIAN_OF_DIFFERENCES: Final = 0.954
"""Median absolute difference of two normal values, in sigma of one: 0.6745 √2."""

_CHUNK_S: Final = 0.5
"""Averaging time of the means in which attitude jumps are searched, s."""

_JUMP: Final = 60.0
"""Decrease of chi-square (six channels, the best of some forty places) above which a jump is accepted."""
_ALONE: Final = 6.0
"""Ratio of the gain at a jump to the largest gain elsewhere in the window."""
_UNUSUAL: Final = 8.0
"""Ratio of the gain at a jump to the median, over all windows, of the gain away from the largest step."""
_FEWEST_CHUNKS: Final = 4
"""Half of the smallest number of means of a window in which a jump is searched."""
_MOST_CHUNKS: Final = 10
"""Largest number of means on either side of a jump that are compared."""


def to_the_sample(
    recording: Recording, blocks: Blocks, rest: Rest, runs: SequenceOf[tuple[int, int]]
) -> list[tuple[int, int]]:
    """Stationary windows from runs of still blocks, each extended to the last sample that is still.

    The threshold for still blocks may lie far above the noise of the unit, so that the ends of a run may belong to a
    slow rotation. Therefore the quietest part of the run near either end (the core) represents rest. From the core
    outward, sums of 1, 2, 4 ... readings are compared with it. The first sum beyond its noise ends the window, and as
    many samples again are excluded, because noise hides the start of a slow rotation. Where the steps of the readings
    hide more than their noise, so is the time in which the motion grows to that rate. Excluded samples belong to the
    rotation.

    Parameters
    ----------
    runs : sequence of (int, int)
        First block and one past the last.

    Returns
    -------
    list of (int, int)
        First sample and one past the last; windows do not overlap.
    """
    pieces = np.array([0, *recording.gaps.tolist(), len(recording.time)])
    # A hand trembles less in a core than elsewhere; the noise of a unit on a fixture is the same everywhere.
    spread = np.ones(6) if recording.fixture is None else _spread_of_sums(blocks, rest)
    coarse = bool(np.any(rest.level[:3] < _COARSE * blocks.floor[:3]))
    out: list[tuple[int, int]] = []
    for first, last in runs:
        if last - first < 3:
            continue
        cores = _cores(blocks, rest, first, last)
        piece = int(np.searchsorted(pieces, cores[0][0], side="right"))
        reach = _OUTWARD_BLOCKS * blocks.size
        outer = (
            max(int(pieces[piece - 1]), int(blocks.first[first]) - reach),
            min(int(pieces[piece]), int(blocks.first[last - 1]) + blocks.size + reach),
        )
        a, b = _extend(recording, cores, outer, rest.level, spread, coarse=coarse)
        if out and a < out[-1][1]:  # both extend into the same blocks: each gets one half
            middle = (a + out[-1][1]) // 2
            out[-1], a = (out[-1][0], middle), middle
        out.append((a, b))
    return out


def _cores(blocks: Blocks, rest: Rest, first: int, last: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Samples of the quietest blocks near the start and near the end of a run of blocks."""
    search = min(_SEARCH_BLOCKS, last - first)
    length = max(min(_CORE_BLOCKS, search // 3), 2)
    cores = []
    for begin in (first, last - search):
        mean = blocks.mean[begin : begin + search] / np.sqrt(rest.level / blocks.size)
        sums, squares = (np.cumsum(np.pad(x, ((1, 0), (0, 0))), axis=0) for x in (mean, mean**2))
        scatter = (squares[length:] - squares[:-length]) - (sums[length:] - sums[:-length]) ** 2 / length
        best = begin + int(np.argmin(scatter.sum(axis=1)))
        # The outermost blocks of the run may hold the last of the motion: their samples are compared one by one.
        inner, beyond = best, best + length
        if length > _LEAST_CORE_BLOCKS:
            inner, beyond = max(inner, first + 1), min(beyond, last - 1)
        cores.append((int(blocks.first[inner]), int(blocks.first[beyond - 1]) + blocks.size))
    return cores[0], cores[1]


def trimmed(recording: Recording, window: tuple[int, int], floor: Array) -> tuple[int, int]:
    """Remove moving samples at the ends of a window, within a quarter of its length.

    Parameters
    ----------
    window : (int, int)
        First sample and one past the last.
    floor : ndarray, shape (6,)
        Variance of one sample, as a rate, due to the resolution of the readings.
    """
    inside = (window[1] - window[0]) // 4
    n = max(1, round(BLOCK_S * _CORE_BLOCKS / recording.nominal_interval_s))
    a, b = window[0] + inside, window[1] - inside
    return _extend(recording, ((a, min(b, a + n)), (max(a, b - n), b)), window, floor)


def _spread_of_sums(blocks: Blocks, rest: Rest) -> Array:
    """Variance of the sum of a block at rest over that of independent readings, at least 1, shape (6,).

    Filtered readings are correlated. A core, which is chosen for its small scatter, shows less of it.
    """
    together = rest.still[1:] & rest.still[:-1] & (np.diff(blocks.piece) == 0)
    if not together.any():
        return np.ones(6)
    change = np.median(np.abs(np.diff(blocks.mean, axis=0)[together]), axis=0) / _MEDIAN_OF_DIFFERENCES
    return np.asarray(np.maximum(1.0, blocks.size * change**2 / rest.level))


def _extend(
    recording: Recording,
    cores: tuple[tuple[int, int], tuple[int, int]],
    outer: tuple[int, int],
    variance: Array,
    spread: Array | float = 1.0,
    *,
    coarse: bool = False,
) -> tuple[int, int]:
    """Extend the first core backward and the second forward to the last still samples, not beyond ``outer``."""
    (a, b), (c, d) = cores
    sides = ((slice(a, b), range(a - 1, outer[0] - 1, -1)), (slice(c, d), range(d, outer[1])))
    before, after = (_still_outward(recording, *side, np.sqrt(variance), spread, coarse=coarse) for side in sides)
    return a - before, d + after


def _still_outward(
    recording: Recording, core: slice, outward: range, least: Array, spread: Array | float, *, coarse: bool
) -> int:
    """Number of samples next to a core that are consistent with it; negative if motion begins in the core."""
    if len(outward) == 0:
        return 0
    beside, away = six_channels(recording, core), six_channels(recording, np.array(outward))
    sigma = np.maximum(beside.std(axis=0), least)
    wander = _wander(recording) / sigma**2
    deviation = (away - beside.mean(axis=0)) / sigma
    total = np.cumsum(np.concatenate([np.zeros((1, 6)), deviation]), axis=0)
    within = np.cumsum(np.concatenate([np.zeros((1, 6)), (beside - beside.mean(axis=0)) / sigma]), axis=0)
    best, kept = len(outward), len(outward)
    n, tremor = 1, np.ones(6)
    while n <= min(len(outward), max(1, round(_LONGEST_SUM_S / recording.nominal_interval_s))):
        if 4 * n <= len(beside):  # tremor of a hand: sums vary more than those of independent readings
            change = within[n:] - within[:-n]
            tremor = np.maximum(tremor, np.einsum("nc,nc->c", change, change) / (len(change) * n))
        if n > 1:
            tremor = np.maximum(tremor, spread)
        # The factor (1 + n/N) is the uncertainty of the core's mean.
        limit = _SIGMAS * np.sqrt(n * tremor * (1.0 + n / len(beside)) + n**2 * wander)
        ratio = (np.abs(total[n:] - total[:-n]) / limit).max(axis=1)
        if (ratio > 1.0).any():
            first = int(np.argmax(ratio > 1.0))
            # Longer sums that end later do not shorten the window.
            best = first + n - 1
            kept = min(kept, max(0, best - 2 * (n - 1)))
            if coarse:
                kept = min(kept, max(first + n // 2 - _hidden(ratio), -len(beside) // 4))
            total = total[: best + 1]
        n *= 2
    # The sample next to the motion may contain its first or last moment, below the detection limit.
    while 0 < kept < len(outward) and np.any(np.abs(deviation[kept - 1, :3]) > _DOUBTFUL):
        kept -= 1
    return kept


def _hidden(ratio: Array) -> int:
    """Samples between the beginning of a motion and its first rate beyond the limit; ``ratio`` is the rate over it."""
    grown = min(_GROWN, float(ratio.max()))
    growing = int(np.argmax(ratio >= grown)) - int(np.argmax(ratio > 1.0))
    share: float = max(grown**_BEGINNING - 1.0, 0.5)
    return round(growing / share)


def split_at_jumps(recording: Recording, windows: SequenceOf[tuple[int, int]], floor: Array) -> list[tuple[int, int]]:
    """Cut windows where the attitude jumps: at a join, or where the unit was bumped or moved a little.

    Parameters
    ----------
    windows : sequence of (int, int)
        First sample and one past the last.
    floor : ndarray, shape (6,)
        Variance of one sample, as a rate, due to the resolution of the readings.

    Returns
    -------
    list of (int, int)
    """
    # The few means of one window may scatter little by chance; the noise of the unit is that of all its windows.
    changes = [np.diff(_chunks(recording, *window), axis=0) for window in windows]
    usual_variance = [0.5 * np.mean(change**2, axis=0) for change in changes if len(change)]
    least = np.maximum(
        2.0 * floor / _chunk_size(recording) ** 2, np.median(usual_variance, axis=0) if usual_variance else 0.0
    )
    steps = {window: _largest_step(recording, *window, least) for window in windows}
    # Bias instability makes small steps in every window; a jump exceeds them in its window and in all others.
    usual = float(np.median([step.elsewhere for step in steps.values()])) if steps else 0.0
    out: list[tuple[int, int]] = []
    waiting = list(reversed(windows))
    while waiting:
        window = waiting.pop()
        step = steps.get(window) or _largest_step(recording, *window, least)
        if step.gain > max(_JUMP, _ALONE * step.elsewhere, _UNUSUAL * usual):
            parts = ((step.at, window[1]), (window[0], step.at))
            waiting += [trimmed(recording, part, floor) for part in parts if part[1] - part[0] >= _FEW]
        else:
            out.append(window)
    return out


@dataclass(frozen=True, slots=True)
class _LargestStep:
    """Largest step in a window: its gain in chi-square, the largest gain away from it, and the sample after it."""

    gain: float = 0.0
    elsewhere: float = 0.0
    at: int = 0


def _chunk_size(recording: Recording) -> int:
    """Samples of a mean in which attitude jumps are searched."""
    return max(1, round(_CHUNK_S / recording.nominal_interval_s))


def _chunks(recording: Recording, a: int, b: int) -> Array:
    """Mean readings of consecutive chunks of a window, shape (n, 6), as rates; none for a window of too few."""
    size = _chunk_size(recording)
    count = (b - a) // size
    if count < 2 * _FEWEST_CHUNKS:
        return np.zeros((0, 6))
    return np.asarray(six_channels(recording, slice(a, a + size * count)).reshape(count, size, 6).mean(axis=1))


def _largest_step(recording: Recording, a: int, b: int, least: Array) -> _LargestStep:
    """Largest step in a window whose means have at least the given variance."""
    mean = _chunks(recording, a, b)
    if not len(mean):
        return _LargestStep()
    size, count = _chunk_size(recording), len(mean)
    span, squares = min(_MOST_CHUNKS, count // 4), np.diff(mean, axis=0) ** 2
    # The largest difference of a channel is excluded, as it may be the jump.
    variance = np.maximum((squares.sum(axis=0) - squares.max(axis=0)) / (2.0 * (count - 2)), least)
    total = np.concatenate([np.zeros((1, 6)), np.cumsum(mean, axis=0)])
    wander = _wander(recording)
    # Means over `span` chunks on both sides of one chunk, in which the jump may lie.
    before = (total[span : count - span] - total[: count - 2 * span]) / span
    after = (total[2 * span + 1 :] - total[span + 1 : count - span + 1]) / span
    gain = np.sum((after - before) ** 2 / (2.0 * variance / span + wander), axis=1)
    best = int(np.argmax(gain))
    elsewhere = gain[np.abs(np.arange(len(gain)) - best) > span]
    lo, hi = a + size * max(0, best + span - 1), a + size * min(count, best + span + 2)
    return _LargestStep(float(gain[best]), float(elsewhere.max(initial=0.0)), best_join(recording, lo, hi)[0])


def _wander(recording: Recording) -> Array:
    """Variance of the difference of two means by the stated bias instability, shape (6,), as a rate.

    It does not depend on the averaging time: the Allan variance of flicker noise is flat.
    """
    stated = (recording.noise.gyro_bias_instability, recording.noise.accel_bias_instability)
    return np.asarray(2.0 * np.repeat([figure or 0.0 for figure in stated], 3) ** 2)


def best_join(recording: Recording, a: int, b: int) -> tuple[int, float]:
    """Most likely place of a jump between two samples: the first sample after it, and its gain in chi-square.

    Parameters
    ----------
    a, b : int
        First sample to look at, and one past the last; at least three samples.
    """
    samples = six_channels(recording, slice(a, b))
    least = 1e-9 * np.abs(samples).max(axis=0) + 1e-150
    samples = samples - samples.mean(axis=0)
    spread = np.maximum(np.diff(samples, axis=0).std(axis=0) / np.sqrt(2.0), least)
    total = np.cumsum(samples / spread, axis=0)[:-1]
    before = np.arange(1, b - a)
    gain = np.sum(total**2, axis=1) * (b - a) / (before * (b - a - before))
    best = int(np.argmax(gain))
    return a + 1 + best, float(gain[best])


MIN_WINDOW_S: Final = 1.0
"""Shortest stationary window, s."""

MIN_TURN_RAD: Final = 0.1
"""Smallest angle between two windows that counts as a turn, rad; less is a disturbance."""


@derived
def find_windows(recording: Recording) -> Indices:
    """Stationary windows, first sample and one past the last, shape (W, 2), in time order.

    Two that adjoin without a sample between them lie on both sides of a join: the attitude jumps there, as where
    recordings were put end to end.

    Raises
    ------
    DataError
        If fewer than two are found.
    """
    blocks = blocks_of(recording)
    rest = find_rest(blocks)
    runs = still_runs(rest.still, blocks)
    shortest = max(MIN_WINDOW_S, 3 * BLOCK_S)
    dt = recording.nominal_interval_s
    found = to_the_sample(recording, blocks, rest, runs)
    if recording.fixture is not None:
        # Motion of a hand looks like a join; on a fixture only a join or a bump makes a step.
        found = split_at_jumps(recording, found, blocks.floor)
    windows = [w for w in found if w[1] - w[0] >= shortest / dt - 0.5]
    if len(windows) < 2:
        gaps = recording.gaps.size
        cut = f" A gap ends a window, and the recording has {gaps}: log without gaps." if gaps else ""
        raise DataError(
            f"{'Only one' if windows else 'No'} stationary window of at least {shortest:g} s was found, and at least "
            f"two are needed, with a turn between them: let the unit rest between turns, or label the windows.{cut}"
        )
    out = np.array(windows, dtype=np.intp)
    out.flags.writeable = False
    return out


@derived
def find_turns(recording: Recording) -> tuple[SequenceLabel, ...]:
    """Free turns between successive stationary windows: each pose ends one turn and starts the next.

    A disturbance that left the unit where it was makes no turn: of the windows around it the longer is kept.

    Raises
    ------
    DataError
        If the recording holds no turn between two windows.
    """
    kept, breaks = rests_between_turns(recording)
    labels = tuple(
        SequenceLabel(window_times(recording, first), window_times(recording, second))
        for first, second, apart in zip(kept[:-1], kept[1:], breaks, strict=True)
        if not apart
    )
    if not labels:
        raise DataError(
            f"No turn was found between two stationary windows ({len(kept)} in all): the unit was not rotated. "
            "Poses alone show the accelerometers: label them, or name the protocol of the test."
        )
    return labels


def rests_between_turns(recording: Recording) -> tuple[list[tuple[int, int]], list[bool]]:
    """Stationary windows without those that a disturbance alone separates; the longer one is kept.

    Returns
    -------
    kept : list of (int, int)
        First sample and one past the last, in time order.
    breaks : list of bool
        For each pair of neighbours, True if no recorded turn leads from one to the other: a gap, or a jump.
    """
    first, *others = [(a, b) for a, b in find_windows(recording).tolist()]
    kept, breaks = [first], list[bool]()
    for window in others:
        apart = no_turn_between(recording, kept[-1], window)
        angles = angles_between(recording, kept[-1], window)
        turned = max(np.linalg.norm(angles.sum(axis=0)), 0.2 * np.linalg.norm(angles, axis=1).sum())
        if apart or turned >= MIN_TURN_RAD:
            kept.append(window)
            breaks.append(apart)
        else:
            kept[-1] = max(kept[-1], window, key=lambda own: own[1] - own[0])
    return kept, breaks


def no_turn_between(recording: Recording, first: SequenceOf[int], second: SequenceOf[int]) -> bool:
    """True if no recorded turn leads from one window to the next: at a gap, or at a join of recordings."""
    return second[0] == first[1] or bool(recording.gaps_inside((first[0], second[1]))[0] >= 0)


def window_times(recording: Recording, window: tuple[int, int]) -> tuple[float, float]:
    """Window bounds in time: the interval of the first sample begins one step before its stamp."""
    dt = recording.nominal_interval_s
    return float(recording.time[window[0]] - dt), float(recording.time[window[1] - 1])
