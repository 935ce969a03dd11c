"""Binary words of a logger: readings that wrap around, misread or missing signs, stuck bits, dead bands, truncation."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import chdtri, ndtr

from srt.constants import MICRO_G
from srt.diagnosis.channels import MOVED, unread
from srt.diagnosis.evidence import MANY
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.findings import Fault, by_sensor
from srt.diagnosis.rotation_readings import ROUNDING
from srt.model.table1 import AXES
from srt.noise.allan import CHANNELS
from srt.noise.noise_model import OFF_GRID

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices

_WHOLE: Final = 1e-3
"""Largest distance of a reading from a multiple of the step, in steps: rounding leaves less."""


def wrapped_words(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that jump between their two extremes, or between zero and an extreme; report the first channel."""
    for sensor, (axis, jumps) in evidence.wrapped_readings.items():
        channel = f"{sensor}_{AXES[axis]}"
        low, high = (float(x[CHANNELS.index(channel)]) * evidence.per_rate for x in evidence.extremes)
        yield WRAPPED[sensor].found(
            channel=channel,
            low=low,
            high=high,
            count=len(jumps),
            time=float(evidence.recording.time[jumps[0]]),
        )


WRAPPED: Final = by_sensor(
    "wrapped",
    "[A gyro|An accelerometer] reading overflows and wraps around",
    "jumps from one extreme to the other, or between zero and an extreme, that are no motion",
    "{channel} jumps from one sample to the next, first at {time:.6g} s and {count} times in all (lowest reading "
    "{low:.4g}, highest {high:.4g} [rad/s|m/s²]): the reading overflows and wraps around; choose a wider range or "
    "format[, or rotate more slowly|].",
    "exit 1",
    wrapped_words,
)


def words_of_one_polarity(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that often read zero, and never one of the signs.

    Some labelled rotation or pose requires that sign, or the resolution is fine and no other axis reads zero, as behind
    a dead band or without noise.
    """
    turned, poses = evidence.labelled_inputs
    missed, read = evidence.missed_rotations
    turned = np.concatenate([turned, np.where(unread(missed, read), missed, read)])
    both = np.concatenate([np.any(x > MOVED, axis=0) & np.any(x < -MOVED, axis=0) for x in (turned, poses)])
    often = evidence.zeros >= MANY
    alone = evidence.noisy_channels.any() & (often.reshape(2, 3).sum(axis=1) == 1).repeat(3)
    for c in np.flatnonzero(evidence.cut_at_zero).tolist():
        channel, column, low = CHANNELS[c], evidence.columns[c], float(evidence.extremes[0][c])
        sensor = channel[:-2]
        # Signed words that are read as unsigned ones have no negative values either.
        if sensor in evidence.wrapped_readings:
            continue
        size = np.abs(column[column != 0.0])
        if both[c] or (alone[c] and not _on_grid(size, float(size.min()))):
            missing, share = "negative" if low == 0.0 else "positive", 100.0 * evidence.zeros[c] / len(column)
            yield ONE_POLARITY[sensor].found(channel=channel, missing=missing, share=share)
            return


ONE_POLARITY: Final = by_sensor(
    "one_polarity",
    "[A gyro|An accelerometer] reads values of only one sign",
    "zeros, and no reading of a sign that some [rotation of gravity|labelled pose] requires; or zeros on one axis "
    "alone, of fine resolution",
    "{channel} has no {missing} reading, and reads zero in {share:.3g} % of the samples, but its input has both "
    "signs: {missing} values are cut off (by an unsigned word, or a unipolar converter); read signed words.",
    "exit 1",
    words_of_one_polarity,
)


def bit_stuck(evidence: Evidence) -> Iterator[Finding]:
    """Find a bit that is set in all words of an axis; the axes of a triad have the same count value."""
    tables = (evidence.recording.gyro, evidence.recording.accel)
    for sensor, table, some, step in zip(("gyro", "accel"), tables, evidence.some, evidence.steps, strict=True):
        # Count value of the axes with steps, from first and second differences of their sorted readings. The second
        # differences are needed if all readings are several counts apart.
        lsb = math.inf
        for column in map(np.unique, some[:, step > 0.0].T):
            gaps = np.unique(np.diff(column))
            steps, largest = np.concatenate([gaps, np.diff(gaps)]), float(np.abs(column).max())
            # The largest reading, a whole number of counts, gives it without the rounding of a difference.
            lsb = min(lsb, largest / max(1, round(largest / float(steps[steps > ROUNDING * largest].min()))))
        for axis in range(3):
            bit = _stuck_bit(some[:, axis] / lsb)
            if bit is None or _stuck_bit(table[:, axis] / lsb) != bit:
                continue
            periods = float(np.ptp(table[:, axis])) / (lsb * 2.0**bit)
            channel = f"{sensor}_{AXES[axis]}"
            yield BIT_STUCK.found(bit=bit, channel=channel, count=len(table), periods=periods)
            return


BIT_STUCK: Final = Fault(
    "bit_stuck",
    "One bit of a converter is stuck",
    "a bit that is set in all readings of an axis, although their range is many times its value",
    "Bit {bit} of {channel} is set in all {count} readings, although their range is {periods:.3g} times the value of "
    "the bit: one bit of the converter or of its bus is stuck; repair it, and record again.",
    "warning",
    bit_stuck,
)


def _stuck_bit(counts: Array) -> int | None:
    """Lowest bit that is set in all words; None if there is none, or if the readings are not whole numbers."""
    # The accuracy of the readings bounds the words that they can show.
    whole = np.rint(np.clip(counts, -1.0 / np.finfo(float).eps, 1.0 / np.finfo(float).eps)).astype(np.int64)
    common = int(np.bitwise_and.reduce(whole))
    bit = (common & -common).bit_length() - 1
    if bit < 0 or np.abs(counts - whole).max() > _WHOLE:
        return None
    # Readings that pass through all values of the lower bits, as in rotations, pass through those without the bit, too.
    values, sixteenths = len(np.unique(whole >> bit)), len(np.unique((whole & ((1 << bit) - 1)) * 16 >> bit))
    return bit if values >= MANY or (values > 2 and sixteenths == 16) else None


_NEAR_BAND: Final = 10.0
"""Largest reading, relative to the smallest nonzero one, in the search for a grid of pulses."""


def dead_bands(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that read zero as the input changes sign, or gyros at rest, but never less than a threshold.

    Gyros without noise may read zero at rest: those of a recording with noisy accelerometers have noise.
    """
    for sensor in DEAD_BAND:
        if sensor in evidence.wrapped_readings:
            continue
        below = evidence.once(bands_below_noise).get(sensor)
        if sensor == "accel" or evidence.noisy_channels[3:].any():
            found = next(_gaps_around_zero(evidence, sensor), None)
            if found is not None:
                yield found
                continue
        if below is not None:
            yield replace(DEAD_BAND[sensor], message=_BELOW_NOISE[sensor]).found(**below)


def _gaps_around_zero(evidence: Evidence, sensor: str) -> Iterator[Finding]:
    """Axes of a triad whose readings leave a gap around zero, or gyros that read zero at rest."""
    data, noise, gyro = evidence.data, evidence.recording.noise, sensor == "gyro"
    table, steps, zeros = (
        (evidence.rate, evidence.steps[0], evidence.zeros[:3])
        if gyro
        else (evidence.force, evidence.steps[1], evidence.zeros[3:])
    )
    pulse = (noise.gyro_quantization if gyro else noise.accel_quantization) or 0.0
    for axis in np.flatnonzero((zeros >= MANY // 2) & (zeros < len(table))).tolist():
        size = np.abs(table[table[:, axis] != 0.0, axis])
        threshold = float(size.min())
        near = size[size < _NEAR_BAND * threshold]
        step = float(steps[axis]) * evidence.per_rate
        two, three = (np.count_nonzero(np.abs(size - n * step) < 0.5 * step) for n in (2, 3))
        if threshold > 1.5 * step and min(two, three) >= MANY and not _counts_pulses(evidence, sensor):
            yield _gap(evidence, sensor, axis, threshold, step)  # a band of one step
        resting = False
        if gyro and data is not None:
            at_rest = np.abs(np.concatenate([table[a:b, axis] for a, b in data.windows.samples.tolist()]))
            # If readings at rest lie between pulses in some window, they come as near to zero as can be, in few sizes;
            # a band that is subtracted leaves all sizes.
            shown = at_rest[at_rest > 0.0]
            near_zero = np.median(np.append(shown, 0.0)) < _NEAR_BAND * threshold
            resting = bool(np.median(at_rest) == 0.0 and (near_zero or len(np.unique(shown)) > 0.5 * len(shown)))
        # If most readings are multiples of the threshold, it is the quantization step.
        if not (resting or np.count_nonzero(near < 2.0 * threshold) >= MANY) or _on_grid(size, threshold):
            continue
        values, counts = np.unique(near, return_counts=True)
        common = float(values[np.argmax(counts > 0.5 * counts.max())])
        grid = max(steps[axis] * evidence.per_rate, pulse / evidence.dt, common * _on_grid(near, common))
        # A band of one step is told by many readings of the two steps that come next, and none of one.
        many = np.count_nonzero(size < 2.0 * threshold - (1.0 + OFF_GRID) * grid) >= MANY
        if threshold > (2.0 + (-OFF_GRID if many else OFF_GRID)) * grid:
            yield _gap(evidence, sensor, axis, threshold, grid)


def _gap(evidence: Evidence, sensor: str, axis: int, threshold: float, grid: float) -> Finding:
    unit, mark = (1.0, "") if sensor == "gyro" else (MICRO_G, "_ug")
    sizes = {f"threshold{mark}": threshold / unit, f"step{mark}": grid / unit}
    count = int(evidence.zeros[CHANNELS.index(f"{sensor}_{AXES[axis]}")])
    return DEAD_BAND[sensor].found(channel=f"{sensor}_{AXES[axis]}", count=count, **sizes)


def _counts_pulses(evidence: Evidence, sensor: str) -> bool:
    """True for a sensor whose readings are counts that carry the remainder over."""
    pulse = getattr(evidence.recording.noise, f"{sensor}_quantization")
    return bool(pulse) or (pulse is None and evidence.recording.kind == "increment")


DEAD_BAND: Final = by_sensor(
    "dead_band",
    "The [gyros|accelerometers] suppress small [rates|readings]",
    "zeros, but no other reading below a threshold far above the quantization step; below the noise, zeros more often "
    "than the readings next to zero make likely",
    "{channel} reads zero {count} times, and otherwise at least [{threshold:.3g} rad/s|{threshold_ug:.3g} µg], but its "
    "quantization step is [{step:.2g} rad/s|{step_ug:.2g} µg]: the unit suppresses small [rates|readings]; switch off "
    "its dead band.",
    "warning",
    dead_bands,
)


_BELOW_NOISE: Final = {
    sensor: f"{{channel}} reads zero {{count}} times, but {{expected}} times is expected by the readings next to zero: "
    f"the unit suppresses small {what}, and takes about {{band:.2g}} {unit} off others, below its noise; switch off "
    "its dead band."
    for sensor, what, unit in (("gyro", "rates", "rad/s"), ("accel", "readings", "m/s²"))
}


def bands_below_noise(evidence: Evidence) -> dict[str, dict[str, object]]:
    """Fields of the message on a dead band below the noise that is subtracted from larger readings, by sensor.

    Such a band leaves no gap around zero. Of readings of fine resolution none repeats, but zero does; of coarse ones
    zero is more frequent beside its neighbours than by rounding or truncation.
    """
    out: dict[str, dict[str, object]] = {}
    for c in np.flatnonzero(evidence.noisy_channels & (evidence.zeros >= MANY // 2)).tolist():
        sensor, axis = CHANNELS[c][:-2], c % 3
        if sensor in out or sensor in evidence.wrapped_readings:
            continue
        column, triad = evidence.columns[c], evidence.columns[3 * (c // 3) : 3 * (c // 3) + 3]
        size = np.abs(column[column != 0.0])
        near = np.partition(size, MANY)[:MANY] if len(size) > MANY else size
        sides = np.count_nonzero((column > 0.0) & (column <= near.max(initial=0.0)))
        # A frozen axis counts once, and a lost sample that is written as zeros not at all.
        zero = (column == 0.0) & ~np.all(triad == 0.0, axis=0)
        before = column[:-1][zero[1:] & (column[:-1] != 0.0)]
        # Readings beside zeros are other pulses, or evenly spread: of so many, one is below half of the largest.
        fine = len(np.unique(near)) == MANY and len(np.unique(before)) > 0.5 * len(before)
        if fine and len(before) >= MANY // 2 and 0 < sides < MANY and near.min() < 0.5 * near.max():
            band = float(near.max()) * evidence.zeros[c] / MANY
            out[sensor] = {"count": int(evidence.zeros[c]), "expected": 0}
        elif (steps := evidence.once(zero_cells)[c].band) > 0:
            band, beside = steps * float(evidence.steps[c // 3, axis]), 1.5 * float(evidence.steps[c // 3, axis])
            expected = np.count_nonzero((column != 0.0) & (np.abs(column) < beside)) / 2.0
            out[sensor] = {"count": int(evidence.zeros[c]), "expected": round(expected)}
        else:
            continue
        out[sensor] |= {"channel": CHANNELS[c], "band": band * evidence.per_rate}
    return out


def _on_grid(sizes: Array, step: float) -> bool:
    """True if most readings are multiples of a step: three quarters, as half of those of half the step are, too."""
    multiple = sizes / step
    return bool(np.quantile(np.abs(multiple - np.rint(multiple)), 0.75) < _WHOLE)


_CELLS: Final = 12
"""Tests of the interval of inputs that read zero: six channels, for truncation and for a dead band."""
_WIDEST: Final = 64
"""Widest dead band in steps, beyond which the readings are finer than any band."""
_OTHERS: Final = (*range(-8, 0), *range(1, 9))
"""Readings, in steps, whose intervals are compared with that of zero."""
_UNEVEN: Final = 1e-3
"""p-value of any of them below which the steps of a converter are uneven; it hides so many truncations."""
_LIKE_ZERO: Final = 0.25
"""Statistic of another reading over that of zero up to which zero is special."""
_NEAR: Final = 2
"""Largest reading that is counted, in steps: noise of any distribution is like normal noise over a few steps."""
_OUTLIERS: Final = 1e-4
"""Share of readings of each value that no noise explains."""
_LEAST_NOISE: Final = 0.05
"""Noise in steps below which all readings of a window are equal."""
_CARRIED: Final = 0.16
"""Squared range of sums over the variance of independent readings, 1.6 on average, below which pulses carry over."""
_FEWEST: Final = 10
"""Readings beyond the two most common of a window below which the widths of the steps do not show."""
_GRID: Final = 17
"""Number of noises, and of means of a window, that are compared in one pass."""
_PASSES: Final = 3
"""Passes over a finer and finer grid: the tails of little noise need its size to 1 %."""


class ZeroCell(NamedTuple):
    """Interval of inputs that read zero: twice the log-likelihood ratio of truncation, and of a dead band, in steps."""

    truncated: float = 0.0
    band: int = 0


def zero_cells(evidence: Evidence) -> list[ZeroCell]:
    """Intervals of inputs that read zero in the windows, by channel; that of rounding where no other is significant.

    Statistic: twice the logarithm of the ratio of the likelihoods of truncation and of rounding, and of a dead band and
    the likelier of both, for normal noise with the most likely mean of each window and noise of each channel.
    Distribution: chi-square, one degree of freedom.
    """
    out = [ZeroCell()] * 6
    if evidence.data is None:
        return out
    windows, uneven = evidence.data.windows.samples, float(chdtri(1, _UNEVEN / len(_OTHERS)))
    least = limit("chi-square", 1, tests=_CELLS)
    steps, tables = evidence.steps * evidence.per_rate, (evidence.rate, evidence.force)
    for s, sensor in enumerate(TRUNCATED):
        if _counts_pulses(evidence, sensor) or sensor in evidence.wrapped_readings:
            continue  # wrapped readings lie on several grids
        for axis in range(3):
            column, step = tables[s][:, axis], steps[s, axis]
            cell = _zero_cell(column, step, windows)
            if cell.truncated <= least and not cell.band:
                continue  # as of rounding: the other readings, which take sixteen times as long, decide nothing
            # A converter with uneven steps has other readings that are as frequent beside their neighbours.
            others = (_zero_cell(column - k * step, step, windows) for k in _OTHERS)
            if all(other.truncated < max(uneven, _LIKE_ZERO * cell.truncated) for other in others):
                out[3 * s + axis] = cell
    return out


def truncation(evidence: Evidence) -> Iterator[Finding]:
    """Find sensors whose stationary readings near zero are zero about twice as often as its neighbours."""
    least = limit("chi-square", 1, tests=_CELLS)
    cells = evidence.once(zero_cells)
    for s, sensor in enumerate(TRUNCATED):
        if sensor in evidence.once(bands_below_noise):
            continue
        own = cells[3 * s : 3 * s + 3]
        found = np.array([cell.truncated > least for cell in own])
        if found.any():
            names = ", ".join(f"{sensor}_{AXES[axis]}" for axis in np.flatnonzero(found))
            half = 0.5 * float((evidence.steps[s] * evidence.per_rate)[found].max())
            yield TRUNCATED[sensor].found(channels=names, half=half)


TRUNCATED: Final = by_sensor(
    "truncated",
    "The readings of the [gyros|accelerometers] are truncated toward zero",
    "stationary readings near zero: zero about twice as often as its neighbours",
    "At rest {channels} read zero about twice as often as one step above or below it: a conversion to integers "
    "truncates toward zero, so that readings are half a step ({half:.2g} [rad/s|m/s²]) too small by their sign, which "
    "noise does not average out; let the logger round, and record again.",
    "warning",
    truncation,
)


def _zero_cell(column: Array, step: float, windows: Indices) -> ZeroCell:
    """Interval of inputs that a channel reads as zero; that of rounding for readings without steps."""
    if step == 0.0:
        return ZeroCell()
    rows = []
    for a, b in windows.tolist():
        steps = column[a:b] / step
        whole = np.rint(steps).astype(np.intp)
        if np.abs(steps - whole).max() > OFF_GRID:
            return ZeroCell()
        own = np.bincount(whole[np.abs(whole) <= _NEAR] + _NEAR, minlength=2 * _NEAR + 1)
        # Zeros without neighbours are a dead band, or stand for lost readings.
        if own[_NEAR] and (own[_NEAR - 1] + own[_NEAR + 1] or own[_NEAR] == b - a):
            rows.append((own, np.median(whole), whole.var(), np.ptp(np.cumsum(whole - whole.mean())) ** 2 / (b - a)))
    if not rows:
        return ZeroCell()
    counts, middle, variance, of_sums = (np.array(values) for values in zip(*rows, strict=True))
    if np.sort(counts, axis=1)[:, -3].sum() < _FEWEST or of_sums.sum() < _CARRIED * variance.sum():
        return ZeroCell()
    read = counts.sum(axis=0) > 0
    if np.any(read[[0, -1]] & ~read[[1, -2]]):
        return ZeroCell()  # words that never occur, as with a stuck bit
    noise = math.sqrt(float(np.median(variance)))

    def logarithm(half: float) -> float:
        """Log-likelihood of a cell of zero as wide as by truncation or a dead band; other roundings make a bias."""
        edges = half + np.arange(_NEAR + 1.0)
        return _logarithm(np.concatenate([-edges[::-1], edges]), middle, noise, counts)

    rounded, truncated = logarithm(0.5), logarithm(1.0)
    best, bands = max(rounded, truncated), [0]
    while truncated > rounded and bands[-1] < _WIDEST:
        band = max(1, 2 * bands[-1])
        likely = logarithm(band + 0.5)
        if 2.0 * (likely - best) <= (limit("chi-square", 1, tests=_CELLS) if band == 1 else 0.0):
            break
        best, bands = likely, [*bands, band]
    return ZeroCell(2.0 * (truncated - rounded), bands[-1])


def _logarithm(limits: Array, mean: Array, seen: float, counts: Array) -> float:
    """Largest logarithm of the likelihood of counts near zero, shape (w, 5), over means of windows and one noise."""
    far, low, high = limits[-1] - 0.5 + seen, _LEAST_NOISE, limits[-1] - 1.5 + 2.0 * seen
    total: Array = np.zeros(1)
    for _ in range(_PASSES):
        noise = np.geomspace(low, high, _GRID)
        means = mean[:, None] + np.linspace(-far, far, _GRID)
        share = np.diff(ndtr((limits - means[..., None]) / noise[:, None, None, None]), axis=-1) + _OUTLIERS
        each = np.einsum("swmk,wk->swm", np.log(share / share.sum(axis=-1, keepdims=True)), counts)
        total = each.max(axis=2).sum(axis=1)
        k = int(total.argmax())
        mean, far = means[np.arange(len(mean)), each[k].argmax(axis=1)], 2.0 * far / (_GRID - 1)
        low, high = noise[max(k - 1, 0)], noise[min(k + 1, _GRID - 1)]
    return float(total.max())
