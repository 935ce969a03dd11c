"""Channels and logger: dead or exchanged columns, repeated or interpolated samples, and spikes.

Sound readings repeat, too: coarse readings often, and those of a quantized gyro at a steady rate for long. A run of
repeats therefore counts only if it is longer than by chance at the frequency of repeats next to it, and more than twice
as long as the longest runs of the other windows (or rotations).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import gammainc

from srt.constants import EARTH_RATE_RAD_S, STANDARD_GRAVITY_M_S2
from srt.diagnosis.evidence import SAMPLES
from srt.diagnosis.false_alarms import FALSE_ALARM
from srt.diagnosis.findings import Fault, by_sensor
from srt.diagnosis.gravity_rotation import SAME
from srt.diagnosis.rotation_readings import BESIDE, ROUNDING
from srt.diagnosis.sensor_synchronisation import sample_twice
from srt.model.table1 import AXES
from srt.noise.allan import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices, Mask

BY_CHANCE: Final = 0.5 * FALSE_ALARM
"""False-alarm probability of all runs, and of all single repeats. It assumes independent repeats. The pulses of a
steady input are evenly spaced, so that the true probability is smaller."""
_LONGER: Final = 2.0
"""Smallest ratio of a run to the ordinary runs of the other windows (or rotations) for a finding. In noise-free
readings a whole rotation is one run, and a rotation of 360° lasts twice as long as one of 180°."""
PULSES: Final = 8.0
"""Smallest ratio of a run to the longest run next to it for a finding: where a changing rate passes a whole number of
pulses per sample, sound readings repeat for up to five times as long as before and after."""
_CHUNK: Final = 50
"""Fewest samples over which the frequency of repeats is averaged: a pause between rotations is as short."""
_FEW: Final = 3
"""Largest number of repeats in a row of a sample that was written twice or a few times; fewest repeated samples for a
finding, as one may be a data frame that was sent twice, and smallest ratio to their number by chance: pulses are not
quite independent."""
_FROZEN: Final = 0.9
"""Share of repeated samples of the other sensor from which that sensor counts as frozen, too."""


def repeated_runs(evidence: Evidence) -> list[tuple[int, int] | None]:
    """First sample, and number of repeats, of the longest run that chance does not explain, by row of the repeats.

    A run of one triad is found only if the other triad changes meanwhile, a run of one channel only if its triad
    changes, and none at the largest or smallest reading, where the channel saturates.
    """
    data = evidence.data
    found: list[tuple[int, int] | None] = [None] * len(evidence.repeats)
    if data is None:
        return found
    same, windows, columns = evidence.repeats, data.windows.samples, evidence.columns
    parts = np.concatenate([windows[data.start], windows[data.end], data.rotation])
    turning = np.arange(len(parts)) >= 2 * data.K
    parts, turning = (x[parts[:, 1] - parts[:, 0] > 1] for x in (parts, turning))
    # Number of repeats up to each sample. A run is cut where a window or rotation begins.
    place = np.arange(same.shape[1] + 1, dtype=np.int32)
    cut = np.pad(~same, ((0, 0), (0, 1)), constant_values=True)
    cut[:, parts[parts[:, 0] > 0, 0] - 1] = True
    count = place - np.maximum.accumulate(np.where(cut, place, np.int32(-1)), axis=1)
    pairs = np.stack([parts[:, 0], parts[:, 1] - 1], axis=1)
    longest = np.maximum.reduceat(count, pairs.ravel(), axis=1)[:, ::2]
    total = int((pairs[:, 1] - pairs[:, 0]).sum())
    ordinary = [np.quantile(longest[:, kind], 0.9, axis=1) for kind in (turning, ~turning) if kind.any()]
    for row, k in np.argwhere(longest > _LONGER * np.max([np.zeros(9), *ordinary], axis=0)[:, None]).tolist():
        n, (a, b), best = int(longest[row, k]), pairs[k].tolist(), found[row]
        other = 3 - row if row < 3 else row // 3  # the other sensor, or the triad of a channel
        first = a + int(np.argmax(count[row, a:b])) - n + 1
        own = columns[row - 3 : row - 2] if row > 2 else columns[3 * row - 3 : 3 * row]
        span = max(_CHUNK, 2 * n)
        beside = np.r_[max(a, first - span) : first, first + n : min(b, first + n + span)]
        frequency = (np.count_nonzero(same[row, beside]) + 1) / (len(beside) + 1)
        if (
            (best is None or n > best[1])
            and n * math.log(frequency) < math.log(BY_CHANCE / (len(same) * total))
            and n > PULSES * count[row, beside].max(initial=0)
            and (row == 0 or np.mean(same[other, first : first + n]) < _FROZEN)
            and not (row and np.all((own[:, first] == own.min(axis=1)) | (own[:, first] == own.max(axis=1))))
            and not (row > 2 and _goes_on(evidence, row - 3, (a, first, first + n, b + 1)))
        ):
            found[row] = first, n
    return found


def _goes_on(evidence: Evidence, channel: int, bounds: tuple[int, int, int, int]) -> bool:
    """True if the pulses of one channel continue before and after a run as in the run: the channel is not frozen.

    The pulses of a steady input may repeat for any time. A freeze ends with a jump, but a changing rate changes no
    faster at the end of the run than at the next sample. ``bounds`` are those of the run (inclusive) in those of its
    window or rotation.
    """
    data, (a, first, last, b) = evidence.data, bounds
    sensor, axis = ("gyro", "accel")[channel // 3], channel % 3
    stated = getattr(evidence.recording.noise, f"{sensor}_quantization")
    unit = stated / (evidence.dt * evidence.per_rate) if stated else float(evidence.steps[channel // 3, axis])
    assert data is not None
    if unit == 0.0:
        return False
    # White noise makes a random walk of the counted angle, which stays within one pulse over n samples with
    # p = exp(−n (π σ)² / 2), for a noise σ of a sample in pulses.
    sigma = getattr(data.noise, f"{sensor}_white")[axis] / (unit * evidence.per_rate * math.sqrt(evidence.dt))
    if 0.5 * (last - first) * (math.pi * sigma) ** 2 > -math.log(BY_CHANCE):
        return False
    column = evidence.columns[channel]
    value = float(column[first])
    for beside in (column[max(a, first - BESIDE) : first][::-1], column[last + 1 : min(b, last + 1 + BESIDE)]):
        changes = np.abs(np.diff(beside[:2], prepend=value))
        # Evenly spaced pulses differ by one. The median, because the edge of a window may lie within a sample.
        steady = len(beside) == 0 or round(abs(float(np.median(beside)) - value) / unit) <= 1
        if not (steady or (len(changes) == 2 and round((changes[0] - changes[1]) / unit) <= 1)):
            return False
    return True


def single_repeats(evidence: Evidence) -> list[tuple[Indices, float]]:
    """Samples that repeat the previous one in all channels, at most three times, and their number by chance.

    One pair is for the windows, the other for the rotations, in which pulses hardly repeat. By chance, gyros and
    accelerometers repeat independently: the product of both frequencies, which vary from chunk to chunk.
    """
    found: list[tuple[Indices, float]] = []
    for parts in () if evidence.data is None else (evidence.data.windows.samples, evidence.data.rotation):
        at = np.concatenate([np.arange(a, b - 1) for a, b in parts.tolist()])
        if at.size == 0:
            continue
        every, gyro, accel = evidence.repeats[:3, at]
        by_gyro, by_accel = (
            np.add.reduceat(x.astype(np.float64), np.arange(0, at.size, _CHUNK)) for x in (gyro, accel)
        )
        edges = np.flatnonzero(np.diff(np.concatenate(([False], every, [False]))))
        rows = at[edges[::2][np.diff(edges)[::2] <= _FEW]] + 1
        found.append((rows, float(by_gyro @ by_accel) / _CHUNK))
    return found


MOVED: Final = 0.5
"""Labelled rotation, rad, and change of a gravity component, g, that the readings of an axis must show."""
SENSOR_ERROR: Final = 0.1
"""Largest scale-factor error, misalignment, and bias (in g) of a working sensor."""
_MISSING: Final = 0.8
"""Change of gravity on a dead accelerometer that the others must show, g. An axis keeps its reading in a rotation about
it; errors of 0.1 g of both others then change what they leave of gravity by up to 0.69 g."""
_GRAVITY: Final = 4.0
"""Largest ratio of the largest to the smallest magnitude (of 99 % of the readings) of a triad that senses gravity:
scale-factor errors and biases of 50 % make 3.2. Gyros exceed it, as they read far more in rotations than at rest."""


def dead_channels(evidence: Evidence) -> Iterator[Finding]:
    """Find columns that are constant although others are noisy or the labels change their input, and dead axes."""
    recording = evidence.recording
    tables, finders = (recording.gyro, recording.accel), (_dead_gyro, _dead_accel)
    for (sensor, fault), table, inputs, find in zip(
        CHANNEL_DEAD.items(), tables, evidence.labelled_inputs, finders, strict=True
    ):
        # The first 100 readings exclude nearly every column; only the others are compared in full.
        axes = [axis for axis in range(3) if np.all(table[:100, axis] == table[0, axis])]
        dead = [axis for axis in axes if np.all(table[:, axis] == table[0, axis])]
        if dead and not evidence.noisy_channels.any():
            dead = [axis for axis in dead if len(inputs) and np.ptp(inputs[:, axis]) > MOVED]
        if dead:
            names = ", ".join(f"{sensor}_{AXES[axis]}" for axis in dead)
            value = float(table[0, dead[0]]) * evidence.per_rate
            yield fault.found(channel=names, value=value, what=_EQUAL.format(value=value, count=len(table), when=""))
        elif (part := _constant_part(evidence, sensor) or find(evidence)) is not None:
            axis, first, last, what = part
            when = f" from {recording.time[first]:.6g} s to {recording.time[last - 1]:.6g} s"
            what = what.format(when=when, count=last - first)
            yield fault.found(channel=f"{sensor}_{AXES[axis]}", what=what)


_Part = tuple[int, int, int, str]
"""Dead axis, first sample and one past the last, and what its readings show, with the fields ``when`` and ``count``."""
_EQUAL: Final = "{value:.4g} in all {count} samples{when}, but noise or its input should change it"


def _constant_part(evidence: Evidence, sensor: str) -> _Part | None:
    """Axis with one reading through a whole rotation, far longer than elsewhere."""
    if evidence.manoeuvres is None or not evidence.noisy_channels.any():
        return None
    begin, end = evidence.manoeuvres.spans.T
    for axis, name in enumerate(AXES):
        same = evidence.repeats[3 + CHANNELS.index(f"{sensor}_{name}")]
        edges = np.flatnonzero(np.pad(~same, 1, constant_values=True))
        runs = np.diff(edges)
        k = int(np.argmax(runs))
        first, last = edges[k : k + 2].tolist()
        if np.any((begin >= first) & (end <= last)) and runs[k] > PULSES * np.delete(runs, k).max(initial=1):
            value = float(evidence.columns[CHANNELS.index(f"{sensor}_{name}"), first]) * evidence.per_rate
            return axis, first, last, _EQUAL.replace("{value:.4g}", f"{value:.4g}")
    return None


def _dead_gyro(evidence: Evidence) -> _Part | None:
    """Axis of a gyro that misses successive rotations; None if there is none.

    Exchanged or scaled axes read something wherever they miss something, and one of one polarity misses one sense.
    """
    missed, read = evidence.missed_rotations
    dead, moved = unread(missed, read), np.abs(read) > MOVED
    alive = moved & (np.abs(missed) < np.abs(read))
    # Readings that freeze or saturate in one rotation are another fault.
    for axis in np.flatnonzero(dead.sum(axis=0) > 1).tolist():
        first, *_, last = np.flatnonzero(dead[:, axis]).tolist()
        senses = {*np.sign(missed[dead[:, axis], axis]), *-np.sign(read[alive[:, axis], axis])}
        within = alive[first:last, axis].any() or np.any(moved[:, axis] & ~alive[:, axis])
        if evidence.manoeuvres is not None and alive.any() and len(senses) > 1 and not within:
            spans, (seen, turned) = evidence.manoeuvres.spans, (x[dead[:, axis], axis] for x in (read, missed))
            what = (
                f"at most {np.degrees(np.abs(seen).max()):.2g}° in each of {len(seen)} rotations{{when}}, but gravity "
            )
            what += f"turns by {np.degrees(np.abs(turned).min()):.3g}° or more about it"
            return axis, int(spans[first, 0]), int(spans[last, 1]), what
    return None


def unread(missed: Array, read: Array) -> Mask:
    """True for each rotation, by axis, of which a gyro reads next to nothing, beyond the errors of the others."""
    size, most = np.abs(missed), np.abs(read).max(axis=1, initial=0.0, keepdims=True)
    return np.asarray(
        (size > np.maximum(2.0 * MOVED, 2.0 * SENSOR_ERROR * most)) & (np.abs(read) < SENSOR_ERROR * size)
    )


def _dead_accel(evidence: Evidence) -> _Part | None:
    """Axis of an accelerometer whose reading stays as gravity moves on and off it, as the others show; or None."""
    turns, gravity = evidence.manoeuvres, evidence.recording.site.gravity_m_s2
    if turns is None or len(turns.spans) == 0:
        return None
    force = turns.force[turns.between.ravel()] / gravity
    reach, found, poses = np.abs(force).max(axis=0), [], evidence.labelled_inputs[1]
    labelled = len(poses) == len(force)
    for axis in range(3):
        others = np.delete(np.arange(3), axis)
        left = np.sqrt(np.maximum(1.0 - np.sum(force[:, others] ** 2, axis=1), 0.0))
        # Runs of windows with one reading.
        cuts = [0, *(np.flatnonzero(np.abs(np.diff(force[:, axis])) > SAME) + 1).tolist(), len(force)]
        first, last = max(pairwise(cuts), key=lambda run: float(np.ptp(left[slice(*run)])))
        inside = slice(first, last)
        # A channel of one polarity reads zero for the other sign, and one sign alone elsewhere.
        low, high = (float(x[3 + axis]) * evidence.per_rate / gravity for x in evidence.extremes)
        middle = float(np.median(force[inside, axis]))
        one_polarity = high - low > MOVED and min(middle - low, high - middle) < 2.0 * SAME
        if (
            last - first > 2
            and np.ptp(left[inside]) > (MOVED if labelled else _MISSING)
            and (not labelled or np.ptp(poses[inside, axis]) > _MISSING)
            and np.ptp(force[inside, axis]) < 2.0 * SAME
            and np.all(np.abs(reach[others] - 1.0) < SENSOR_ERROR)
        ):
            means, span = gravity * force[inside, axis], turns.spans[[first // 2, (last - 1) // 2]]
            what = (
                f"{means.min():.4g} to {means.max():.4g} m/s² in the mean of every window{{when}}, but the other axes "
            )
            what += f"show that gravity along it changes by {gravity * np.ptp(left[inside]):.3g} m/s²"
            found.append((one_polarity, (axis, int(span[0, 0]), int(span[1, 1]), what)))
    # Gravity that one axis cuts off is missing while another axis is level, too.
    return found[0][1] if len(found) == 1 and not found[0][0] else None


CHANNEL_DEAD: Final = by_sensor(
    "channel_dead",
    "[A gyro|An accelerometer] column does not change with its input",
    "range of every [gyro|accelerometer] column; successive [rotations of gravity that the gyro does not measure"
    "|windows with one reading, though the other two axes show gravity move onto the axis or off it]",
    "Column {channel} reads {what}: connect the sensor, or name the right column.",
    "exit 1",
    dead_channels,
)


def columns_repeat(evidence: Evidence) -> Iterator[Finding]:
    """Find two columns with the same readings, or readings that differ by a constant factor.

    In noise-free readings, misalignments make proportional columns of one triad, and the Earth rate those of two
    triads.
    """
    columns = evidence.columns
    # Differences of successive readings contain the noise, which differs from column to column, but no bias.
    steps = np.diff(columns[:, :SAMPLES])
    product = steps @ steps.T
    size = np.sqrt(np.diag(product))
    alike = (np.abs(product) >= (1.0 - ROUNDING) * np.outer(size, size)) & (np.abs(product) > 0.0)
    for i, j in np.argwhere(np.triu(alike, 1)).tolist():
        factor = float(product[i, j] / product[j, j])
        proportional = np.ptp(columns[i] - factor * columns[j]) <= 1e-6 * np.ptp(columns[i])
        if i // 3 == j // 3:
            fault = SENSOR_ERROR < abs(factor) < 1.0 / SENSOR_ERROR
        else:
            earth = (1.0 + SENSOR_ERROR) * EARTH_RATE_RAD_S / STANDARD_GRAVITY_M_S2
            fault = abs(factor) > earth or bool(evidence.noisy_channels[j])
        if fault and proportional:
            yield COLUMNS_REPEAT.found(channel=CHANNELS[i], other=CHANNELS[j])
            return


COLUMNS_REPEAT: Final = Fault(
    "columns_repeat",
    "Two columns have the same readings",
    "correlation of every pair of columns",
    "Columns {channel} and {other} have the same readings, except for a constant factor: one column was probably read "
    "twice; correct the mapping of the columns.",
    "exit 1",
    columns_repeat,
)


def sensors_exchanged(evidence: Evidence) -> Iterator[Finding]:
    """Find gyro columns that read a rotating vector of constant magnitude, while the accelerometer columns do not."""
    recording = evidence.recording
    stride = max(1, 10 * len(recording.time) // SAMPLES)
    tables = recording.gyro[::stride], recording.accel[::stride]
    size = np.stack([np.linalg.norm(table, axis=1) for table in tables])
    (low, least), (high, most) = np.quantile(size, (0.005, 0.995), axis=1)
    if high >= _GRAVITY * low or most <= _GRAVITY * least:
        return
    turns = evidence.manoeuvres
    if turns is not None:
        size = np.stack([np.linalg.norm(mean, axis=1) for mean in (turns.rate, turns.force)]) / evidence.per_rate
    gyro, accel = (np.median(size, axis=1) * evidence.per_rate).tolist()
    yield SENSORS_EXCHANGED.found(gyro=gyro, accel=accel)


SENSORS_EXCHANGED: Final = Fault(
    "sensors_exchanged",
    "Gyro and accelerometer columns are exchanged",
    "columns that measure gravity, a vector of constant magnitude",
    "At rest the gyro columns read {gyro:.3g} rad/s and the accelerometer columns {accel:.3g} m/s², as if they were "
    "exchanged: correct the mapping of the columns.",
    "exit 1",
    sensors_exchanged,
)


def repeated_rows(evidence: Evidence) -> Iterator[Finding]:
    """Find the longest runs of equal samples, in both triads, one triad or one axis, that chance does not explain."""
    runs = list(enumerate(repeated_runs(evidence)))
    faults = (SAMPLES_STUCK, *STUCK.values(), *AXIS_STUCK.values())
    for fault, rows in zip(faults, (runs[:1], runs[1:2], runs[2:3], runs[3:6], runs[6:]), strict=True):
        count, row, first = max(((run[1], -row, run[0]) for row, run in rows if run is not None), default=(0, 0, 0))
        if count:
            yield fault.found(
                channel=fault.name if row > -3 else CHANNELS[-3 - row],
                count=count + 1,
                time=float(evidence.recording.time[first]),
                sequence=evidence.place_title(first),
            )


SAMPLES_STUCK: Final = Fault(
    "samples_stuck",
    "The logger repeats samples",
    "runs of equal samples in all six channels, longer than by chance",
    "All six channels repeat their readings for {count} samples from {time:.6g} s, as when a logger stalls: repeat "
    "{sequence}, or omit it.",
    "warning",
    repeated_rows,
)
STUCK: Final = by_sensor(
    "stuck",
    "The [gyro|accelerometer] readings freeze for a while",
    "runs of equal [gyro|accelerometer] readings while the [accelerometer|gyro] readings change",
    "The [gyros|accelerometers] repeat one reading for {count} samples from {time:.6g} s while the "
    "[accelerometer|gyro] readings change: repeat {sequence}, or omit it.",
    "warning",
    repeated_rows,
)
AXIS_STUCK: Final = by_sensor(
    "axis_stuck",
    "One [gyro|accelerometer] axis freezes for a while",
    "runs of equal readings of one axis while the other axes of its triad change, longer than by chance",
    "{channel} repeats one reading for {count} samples from {time:.6g} s while the other [gyro|accelerometer] axes "
    "change: look for a bad contact, and repeat {sequence}, or omit it.",
    "warning",
    repeated_rows,
)


def duplicated_samples(evidence: Evidence) -> Iterator[Finding]:
    """Find samples that repeat the previous one in all channels, more often than by chance or against the motion.

    A repeated sample deviates from its neighbours like a spike where the rate changes, and makes an attitude error
    where it is steady. Statistic: number of repeated samples. Distribution: Poisson.
    """
    for rows, expected in single_repeats(evidence):
        if len(rows) >= _FEW * max(1.0, expected) and gammainc(len(rows), expected) <= BY_CHANCE:
            break
    else:
        every = evidence.spikes + evidence.unused_spikes
        rows, expected = np.unique(every.sample[every.of_repeats(evidence.repeats[0])]), 0.0
        again = sample_twice(evidence) if rows.size == 0 else None
        rows = rows if again is None else np.array([again])
    if rows.size:
        time = float(evidence.recording.time[rows[0]])
        yield SAMPLES_DUPLICATED.found(count=len(rows), time=time, expected=expected)


SAMPLES_DUPLICATED: Final = Fault(
    "samples_duplicated",
    "The logger writes samples twice",
    "samples that equal the previous one in all six channels, more often than by chance; equal samples while the "
    "readings change, or with an attitude error by the angle of one sample",
    "{count} samples equal the previous sample in all six channels, the first at {time:.6g} s, but {expected:.2g} are "
    "expected by chance: the logger writes samples twice, or in place of lost ones; correct the logger, and record "
    "again.",
    "warning",
    duplicated_samples,
)

_LINE: Final = 8
"""Fewest samples on a straight line for a finding. With noise of one quantization step, a second difference is zero
with p = 0.16; six successive second differences in six channels are all zero with p = 1e-28."""


def samples_interpolated(evidence: Evidence) -> Iterator[Finding]:
    """Find the longest run of samples on straight lines in all channels, at least two of which change along the line.

    Constant channels are frozen, or have no pulses at rest. Samples outside the sequences are not in the result.
    """
    data, columns = evidence.data, evidence.columns
    if data is None or not evidence.noisy_channels.reshape(2, 3).any(axis=1).all():
        return
    # A run that is long enough contains one of every six second differences.
    if not len(_on_lines(columns, np.arange(0, columns.shape[1] - 2, _LINE - 2))):
        return
    spans = np.stack([data.windows.samples[data.start, 0], data.windows.samples[data.end, 1] - 2], axis=1)
    at = _on_lines(columns, np.unique(np.concatenate([np.arange(a, b) for a, b in spans.tolist()])))
    ends = np.flatnonzero(np.diff(at, prepend=-2) > 1)
    lengths = np.diff(ends, append=len(at))
    if lengths.max(initial=0) + 2 < _LINE:
        return
    first = int(at[ends[np.argmax(lengths)]])
    yield SAMPLES_INTERPOLATED.found(
        time=float(evidence.recording.time[first]), count=int(lengths.max()) + 2, sequence=evidence.place_title(first)
    )


def _on_lines(columns: Array, at: Indices) -> Indices:
    """Those of the samples from which three lie on a straight line in all channels, and on a slope in at least two."""
    slopes = np.zeros(len(at), dtype=np.intp)
    for column in columns:
        rounding, step = ROUNDING * float(np.abs(column).max()), column[at + 1] - column[at]
        straight = np.abs(column[at + 2] - column[at + 1] - step) <= rounding
        at, slopes = at[straight], slopes[straight] + (np.abs(step[straight]) > rounding)
    return at[slopes > 1]


SAMPLES_INTERPOLATED: Final = Fault(
    "samples_interpolated",
    "Lost samples were filled by interpolation",
    "samples on straight lines in all six channels, in a recording with noise",
    "From {time:.6g} s, {count} samples lie on straight lines in all six channels, without noise ({sequence}): the "
    "logger or a tool interpolated lost samples; remove them, so that the stamps show the gap, and repeat the "
    "sequence.",
    "warning",
    samples_interpolated,
)


def spikes(evidence: Evidence) -> Iterator[Finding]:
    """Find spikes, beyond the limits of :mod:`srt.diagnosis.jumps`; the message states the largest of one channel."""
    there = evidence.spikes[~evidence.spikes.of_repeats(evidence.repeats[0])]
    if there.sample.size == 0:
        return
    most = int(np.argmax(np.bincount(there.channel)))
    k = int(np.argmax(np.where(there.channel == most, np.abs(there.jump), -1.0)))
    length = int(np.count_nonzero(there.number == there.number[k]))
    shift = evidence.largest_spike_shift
    yield SPIKES.found(
        channel=CHANNELS[most],
        size=f"{abs(float(there.jump[k])) * evidence.per_rate:.3g} {'rad/s' if most < 3 else 'm/s²'}",
        length="one sample" if length == 1 else f"{length} samples",
        time=float(evidence.recording.time[there.first[k]]),
        count=int(there.sample.size),
        sequence=evidence.place_title(int(there.sample[k])),
        largest_shift_sigma=shift,
        shift="" if shift is None else f"; no sensor error shifts by more than {shift:.1g} sigma",
    )


SPIKES: Final = Fault(
    "spikes",
    "Spikes: single outlying readings, or bursts of up to five",
    "deviation of every reading from its neighbours, relative to the noise around it; in turns by hand, also to the "
    "other channels, and the agreement of the turns with the reading and with its prediction",
    "{channel} jumps by {size} for {length} at {time:.6g} s, far more than its noise and its neighbours ({count} such "
    "readings in the recording{shift}): look for a bad contact, transmission errors or a knock; repeat {sequence}.",
    "warning",
    spikes,
)
