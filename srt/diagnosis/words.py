"""Binary words of a logger: readings that wrap around, misread or missing signs, stuck bits, dead bands, truncation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtr

from srt.constants import MICRO_G
from srt.diagnosis.channels import MOVED, unread
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.findings import Fault, by_sensor
from srt.diagnosis.rotation_readings import ROUNDING
from srt.model.table1 import AXES
from srt.noise.noise_model import OFF_GRID

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices


_ONE_POLARITY: Final = 0.05
"""Smallest share of zeros in the readings of a channel without one of the signs."""
_WHOLE: Final = 1e-3
"""Largest distance of a reading from a multiple of the step, in steps: rounding leaves less."""
_BITS: Final = 32
"""Largest number of bits of a word."""
_PASSED: Final = 20
"""Fewest values of the bits from the stuck bit upwards: for independent readings, such as those of static poses, all of
them have the bit set with p = 1e-6. For rotations, in which the readings pass all values between, p is far smaller."""


def wrapped_words(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that jump between their two extremes, or between zero and an extreme; report the first channel."""
    for sensor, (axis, jumps) in evidence.wrapped_readings.items():
        column = (evidence.rate if sensor == "gyro" else evidence.force)[:, axis]
        yield WRAPPED[sensor].found(
            channel=f"{sensor}_{AXES[axis]}",
            low=float(column.min()),
            high=float(column.max()),
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
    for sensor, table, some, inputs in zip(
        ONE_POLARITY, (evidence.rate, evidence.force), evidence.some, (turned, poses), strict=True
    ):
        if sensor in evidence.wrapped_readings:
            continue  # signed words that are read as unsigned ones have no negative values either
        both = np.any(inputs > MOVED, axis=0) & np.any(inputs < -MOVED, axis=0)
        zeros = np.mean(table == 0.0, axis=0) if (some == 0.0).any() else np.zeros(3)
        often = zeros >= _ONE_POLARITY
        for axis in np.flatnonzero(often).tolist():
            column = table[:, axis]
            low, high = float(column.min()), float(column.max())
            if low * high != 0.0 or low == high:
                continue
            size = np.abs(column[column != 0.0])
            if both[axis] or not (np.count_nonzero(often) > 1 or _on_grid(size, float(size.min()))):
                missing = "negative" if low == 0.0 else "positive"
                channel = f"{sensor}_{AXES[axis]}"
                yield ONE_POLARITY[sensor].found(channel=channel, missing=missing, share=100.0 * zeros[axis])
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
        lsb = _count_value(some[:, step > 0.0])
        if lsb is None:
            continue
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


def _count_value(table: Array) -> float | None:
    """Count value of axes with steps, from first and second differences of their sorted readings; None without axes.

    The second differences are needed if all readings are several counts apart.
    """
    least = []
    for column in map(np.unique, table.T):
        gaps = np.unique(np.diff(column))
        steps, largest = np.concatenate([gaps, np.diff(gaps)]), float(np.abs(column).max())
        step = float(steps[steps > ROUNDING * largest].min())
        # The largest reading, a whole number of counts, gives the count value without the rounding of a difference.
        least.append(largest / max(1, round(largest / step)))
    return min(least) if least else None


def _stuck_bit(counts: Array) -> int | None:
    """Lowest bit that is set in all words; None if there is none, or if the readings are not whole numbers."""
    words = np.rint(counts)
    if float(np.abs(counts - words).max()) > _WHOLE or float(np.abs(words).max()) >= 2.0**_BITS:
        return None
    whole = words.astype(np.int64)
    common = int(np.bitwise_and.reduce(whole))
    bit = (common & -common).bit_length() - 1
    return bit if 0 <= bit < _BITS and len(np.unique(whole >> bit)) >= _PASSED else None


_MANY: Final = 30
"""Fewest readings just outside a dead band: without a dead band, as many are expected inside it, and the probability of
none is 1e-13."""
_BAND_STEPS: Final = 2.5
"""Smallest ratio of the smallest nonzero reading to the quantization step for a dead band; without one, it is 1."""
_FREQUENT: Final = 0.3
"""Smallest count of a frequent value, relative to that of the most frequent value."""
_NEAR_BAND: Final = 10.0
"""Largest reading, relative to the smallest nonzero one, in the search for a grid of pulses."""
_MOSTLY: Final = 0.5
"""Share of the readings that lie on a grid of pulses, and of the stationary readings that a dead band sets to zero."""


def dead_bands(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that read zero as the input changes sign, or gyros at rest, but never less than a threshold.

    Wrapped readings lie on several grids, so that their quantization step is not found. Gyros without noise may read
    zero at rest: those of a recording with noisy accelerometers have noise.
    """
    data, noise = evidence.data, evidence.recording.noise
    steps = evidence.steps * evidence.per_rate
    for sensor, table, step, pulse, unit, name in (
        ("gyro", evidence.rate, steps[0], noise.gyro_quantization, 1.0, "{}"),
        ("accel", evidence.force, steps[1], noise.accel_quantization, MICRO_G, "{}_ug"),
    ):
        if sensor in evidence.wrapped_readings or (sensor == "gyro" and not evidence.noisy_channels[3:].any()):
            continue
        zeros = np.count_nonzero(table == 0.0, axis=0)
        for axis in np.flatnonzero((zeros >= _MANY // 3) & (zeros < len(table))).tolist():
            size = np.abs(table[:, axis])
            size = size[size > 0.0]
            threshold = float(size.min())
            near = size[size < _NEAR_BAND * threshold]
            at_rest = np.ones(1)
            if sensor == "gyro" and data is not None:
                at_rest = np.abs(np.concatenate([table[a:b, axis] for a, b in data.windows.samples.tolist()]))
            shown = at_rest[at_rest > 0.0]
            # If readings at rest lie between pulses in some window, they come as near to zero as can be, in few sizes;
            # a band that is subtracted leaves all sizes.
            sizes = len(np.unique(shown))
            resting = len(shown) < (1.0 - _MOSTLY) * len(at_rest)
            resting &= sizes >= _MOSTLY * len(shown) or float(np.median(shown)) < _NEAR_BAND * threshold
            # If most readings are multiples of the threshold, it is the quantization step.
            passing = np.count_nonzero(near < 2.0 * threshold) >= _MANY
            if not (passing or resting) or _on_grid(size, threshold):
                continue
            values, counts = np.unique(near, return_counts=True)
            common = float(values[np.argmax(counts >= _FREQUENT * counts.max())])
            grid = max(float(step[axis]), (pulse or 0.0) / evidence.dt, common if _on_grid(near, common) else 0.0)
            if threshold > _BAND_STEPS * grid:
                levels = {name.format("threshold"): threshold / unit, name.format("step"): grid / unit}
                yield DEAD_BAND[sensor].found(channel=f"{sensor}_{AXES[axis]}", count=int(zeros[axis]), **levels)
                break


DEAD_BAND: Final = by_sensor(
    "dead_band",
    "The [gyros|accelerometers] suppress small [rates|readings]",
    "zeros, but no other reading below a threshold far above the quantization step",
    "{channel} reads zero {count} times, and otherwise at least [{threshold:.3g} rad/s|{threshold_ug:.3g} µg], but its "
    "quantization step is [{step:.2g} rad/s|{step_ug:.2g} µg]: the unit suppresses small [rates|readings]; switch off "
    "its dead band.",
    "warning",
    dead_bands,
)


def _on_grid(sizes: Array, step: float) -> bool:
    """True if most readings are multiples of a step."""
    multiple = sizes / step
    return bool(np.mean(np.abs(multiple - np.rint(multiple)) < _WHOLE) > _MOSTLY)


_NEAR: Final = 2
"""Largest reading that is counted, in steps: noise of any distribution is like normal noise over a few steps."""
_ROUNDED: Final = np.arange(-_NEAR - 0.5, _NEAR + 1.0)
"""Limits of the true values that are read as −2 to 2 steps, in steps, if readings are rounded. Rounding down differs by
a bias."""
_TRUNCATED: Final = np.delete(np.arange(-_NEAR - 1.0, _NEAR + 2.0), _NEAR + 1)
"""The same if readings are truncated: zero is read twice as often as its neighbours."""
_OUTLIERS: Final = 1e-4
"""Share of readings of each value that no noise explains."""
_UNDITHERED: Final = 0.5
"""Noise in steps below which the scatter of the readings does not show it."""
_LEAST_NOISE: Final = 0.05
"""Noise in steps below which all readings of a window are equal."""
_NOISES: Final = 17
"""Number of noises compared in one pass."""
_MEANS: Final = np.linspace(-1.0, 1.0, 33)
"""Means of a window compared in one pass, as a share of the largest distance from the previous one."""
_PASSES: Final = 3
"""Passes over a finer and finer grid: the tails of little noise need its size to 1 %."""


def truncation(evidence: Evidence) -> Iterator[Finding]:
    """Find sensors whose stationary readings near zero are zero about twice as often as its neighbours.

    Noise spreads the readings of a window over several steps. The likelihood of their counts near zero for normal noise
    is compared between truncation and rounding, each with its most likely mean of each window and noise of each
    channel. A channel that never rests near zero shows nothing.
    """
    if evidence.data is None:
        return
    windows = evidence.data.windows.samples
    least = limit("chi-square", 1, tests=6)
    steps, tables = evidence.steps * evidence.per_rate, (evidence.rate, evidence.force)
    for sensor, table, step in zip(TRUNCATED, tables, steps, strict=True):
        pulse = getattr(evidence.recording.noise, f"{sensor}_quantization")
        counted = pulse or (pulse is None and evidence.recording.kind == "increment")
        if counted or sensor in evidence.wrapped_readings:
            continue  # pulse counts carry the remainder over; wrapped readings lie on several grids
        ratios = np.array([_likelihood_ratio(table[:, axis], step[axis], windows) for axis in range(3)])
        if ratios.max() > least:
            names = ", ".join(f"{sensor}_{AXES[axis]}" for axis in np.flatnonzero(ratios > least))
            yield TRUNCATED[sensor].found(channels=names, half=0.5 * float(step[ratios > least].max()))


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


def _likelihood_ratio(column: Array, step: float, windows: Indices) -> float:
    """Twice the logarithm of the likelihood ratio of truncation and rounding; zero for readings without steps."""
    if step == 0.0:
        return 0.0
    rows = []
    for a, b in windows.tolist():
        steps = column[a:b] / step
        whole = np.rint(steps).astype(np.intp)
        if np.abs(steps - whole).max() > OFF_GRID:
            return 0.0
        own = np.bincount(whole[np.abs(whole) <= _NEAR] + _NEAR, minlength=2 * _NEAR + 1)
        # Zeros without neighbours are a dead band, or stand for lost readings.
        if own[_NEAR] and (own[_NEAR - 1] + own[_NEAR + 1] or own[_NEAR] == b - a):
            rows.append((own, np.median(whole), whole.var(), b - a))
    if not rows:
        return 0.0
    counts, middle, variance, number = (np.array(values) for values in zip(*rows, strict=True))
    read = counts.sum(axis=0) > 0
    if np.any(read[[0, -1]] & ~read[[1, -2]]):
        return 0.0  # words that never occur, as with a stuck bit
    seen = math.sqrt(max(float(np.median(variance)) - 1.0 / 12.0, 0.0))
    noises = (0.5 * seen if seen > _UNDITHERED else _LEAST_NOISE, 2.0 * max(seen, _UNDITHERED))
    far = max(1.5, 6.0 * noises[1] / math.sqrt(number.min()))
    truncated, rounded = (_logarithm(limits, middle, far, noises, counts) for limits in (_TRUNCATED, _ROUNDED))
    return 2.0 * (truncated - rounded)


def _logarithm(limits: Array, mean: Array, far: float, noises: tuple[float, float], counts: Array) -> float:
    """Largest logarithm of the likelihood of counts near zero, shape (w, 5), over means of windows and one noise."""
    best = -math.inf
    for _ in range(_PASSES):
        noise = np.geomspace(*noises, _NOISES)
        means = mean[:, None] + far * _MEANS
        share = np.diff(ndtr((limits - means[..., None]) / noise[:, None, None, None]), axis=-1) + _OUTLIERS
        each = np.einsum("swmk,wk->swm", np.log(share / share.sum(axis=-1, keepdims=True)), counts)
        total = each.max(axis=2).sum(axis=1)
        k = int(total.argmax())
        best = max(best, float(total[k]))
        mean, far = means[np.arange(len(mean)), each[k].argmax(axis=1)], far * (_MEANS[1] - _MEANS[0])
        noises = (noise[max(k - 1, 0)], noise[min(k + 1, _NOISES - 1)])
    return best
