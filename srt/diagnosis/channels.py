"""Channels and logger: dead or exchanged columns, repeated or interpolated samples, dead bands of gyros, and spikes."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import gammainc

from srt.constants import EARTH_RATE_RAD_S, STANDARD_GRAVITY_M_S2
from srt.diagnosis.findings import Fault, by_sensor
from srt.diagnosis.repeated_samples import FALSE_ALARM as REPEATS_BY_CHANCE
from srt.diagnosis.repeated_samples import repeated_runs, single_repeats
from srt.diagnosis.rotation_readings import ROUNDING
from srt.diagnosis.sensor_synchronisation import sample_twice
from srt.model.table1 import AXES
from srt.noise.allan import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array, Indices, Mask


SAMPLES: Final = 20_000
"""Number of samples that suffices for the tests of whole columns: more would only take longer."""
_PIECES: Final = 8
"""Number of pieces, evenly spaced over the recording, from which these samples are taken."""
_MANY: Final = 50
"""Fewest changes of a column for a useful correlation."""
_SCALES: Final = 10.0
"""Largest ratio between the count values of the axes of one triad."""
_POLE: Final = 1.02
"""Largest component of the Earth rate along gravity, in units of the Earth rate: at a pole, with 2 % of scale-factor
error."""
_GRAVITY: Final = 4.0
"""Largest ratio of the largest to the smallest magnitude (of 99 % of the readings) of a triad that senses gravity:
scale-factor errors and biases of 50 % make 3.2. Gyros exceed it, as they read far more in rotations than at rest."""
_TURNED: Final = 0.95
"""Ratio of the magnitude of the mean vector to the mean magnitude, above which the direction hardly changed."""


def _constant(column: Array) -> bool:
    # The first 100 readings exclude nearly every column; only the others are compared in full.
    return bool(np.all(column[:100] == column[0]) and np.all(column == column[0]))


def dead_channels(evidence: Evidence) -> Iterator[Finding]:
    """Find constant columns, if other columns are noisy or the labels change the input of the axis."""
    for sensor, table, moved_axes in (
        ("gyro", evidence.recording.gyro, _turned_axes),
        ("accel", evidence.recording.accel, _tilted_axes),
    ):
        dead = np.array([_constant(table[:, axis]) for axis in range(3)])
        if not dead.any():
            continue
        # Noise-free readings can be constant. Such a column is dead only if the labels change the input of its axis.
        moved = moved_axes(evidence)
        named = [axis for axis in range(3) if dead[axis] and (evidence.noisy_channels.any() or moved[axis])]
        if named:
            yield CHANNEL_DEAD[sensor].found(
                channel=", ".join(f"{sensor}_{AXES[axis]}" for axis in named),
                value=float(table[0, named[0]]),
            )


CHANNEL_DEAD: Final = by_sensor(
    "channel_dead",
    "[A gyro|An accelerometer] column never changes",
    "range of every [gyro|accelerometer] column",
    "Column {channel} reads {value:g} in all samples, but noise or [rotation|gravity] should change it: connect the "
    "sensor, or name the right column.",
    "exit 1",
    dead_channels,
)


def _turned_axes(evidence: Evidence) -> Mask:
    """True for each axis about which the labels rotate the unit, shape (3,)."""
    if evidence.data is None or evidence.recording.fixture is None:
        return np.zeros(3, dtype=bool)
    turned = [np.abs(s.axes).max(axis=0) for s in evidence.data.catalogue if s is not None]
    return np.asarray(np.any(np.array(turned) > 0.5, axis=0)) if turned else np.zeros(3, dtype=bool)


def _tilted_axes(evidence: Evidence) -> Mask:
    """True for each axis along which the gravity component differs between the labelled poses, shape (3,)."""
    if evidence.data is None or evidence.recording.fixture is None:
        return np.zeros(3, dtype=bool)
    nominal, _ = evidence.poses
    if len(nominal) == 0:
        return np.zeros(3, dtype=bool)
    return np.asarray(np.ptp(nominal, axis=0) > 0.5 * evidence.recording.site.gravity_m_s2)


def columns_repeat(evidence: Evidence) -> Iterator[Finding]:
    """Find two columns with the same readings, or readings that differ by a constant factor."""
    columns = evidence.columns
    n = len(columns[0])
    length = max(2, min(n, SAMPLES // _PIECES))
    starts = np.unique(np.linspace(0, n - length, _PIECES).astype(np.intp))
    # Differences of successive readings contain the noise, which differs from column to column, but no bias.
    steps = np.array([np.concatenate([np.diff(c[a : a + length]) for a in starts.tolist()]) for c in columns])
    size = np.sqrt(np.einsum("cn,cn->c", steps, steps))
    changes = np.count_nonzero(steps, axis=1)
    for i, j in combinations(range(6), 2):
        if min(changes[i], changes[j]) < _MANY:
            continue
        product = float(steps[i] @ steps[j])
        if abs(product) < (1.0 - ROUNDING) * size[i] * size[j]:
            continue
        factor = product / float(size[j]) ** 2
        off = columns[i] - factor * columns[j]
        if np.ptp(off) <= 1e-6 * np.ptp(columns[i]) and _may_repeat(evidence, i, j, factor):
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


def _may_repeat(evidence: Evidence, i: int, j: int, factor: float) -> bool:
    """True if proportional columns i and j are a fault.

    In noise-free readings, rounding and the Earth rate make proportional columns, too. Columns of one triad are a fault
    if the factor is a possible ratio of count values. Columns of two triads are a fault if the factor is larger than
    that of the Earth rate relative to gravity, or if the readings are noisy.
    """
    if i // 3 == j // 3:
        return 1.0 / _SCALES < abs(factor) < _SCALES
    earth = EARTH_RATE_RAD_S / STANDARD_GRAVITY_M_S2
    return abs(factor) > _POLE * earth or bool(evidence.noisy_channels[j])


def sensors_exchanged(evidence: Evidence) -> Iterator[Finding]:
    """Find gyro columns that read a rotating vector of constant magnitude, while the accelerometer columns do not."""
    recording = evidence.recording
    stride = max(1, len(recording.time) // SAMPLES)
    gyro, accel = recording.gyro[::stride], recording.accel[::stride]
    if not (_holds_gravity(gyro) and _range_of_size(accel) > _GRAVITY):
        return
    turns = evidence.manoeuvres
    rate, force = (gyro, accel) if turns is None else (turns.rate / evidence.per_rate, turns.force / evidence.per_rate)
    yield SENSORS_EXCHANGED.found(
        gyro=float(np.median(np.linalg.norm(rate, axis=1))) * evidence.per_rate,
        accel=float(np.median(np.linalg.norm(force, axis=1))) * evidence.per_rate,
    )


SENSORS_EXCHANGED: Final = Fault(
    "sensors_exchanged",
    "Gyro and accelerometer columns are exchanged",
    "columns that measure gravity, a vector of constant magnitude",
    "At rest the gyro columns read {gyro:.3g} rad/s and the accelerometer columns {accel:.3g} m/s², as if they were "
    "exchanged: correct the mapping of the columns.",
    "exit 1",
    sensors_exchanged,
)


def _range_of_size(vectors: Array) -> float:
    low, high = np.quantile(np.linalg.norm(vectors, axis=1), (0.005, 0.995))
    return float(high / low) if low > 0.0 else float("inf")


def _holds_gravity(vectors: Array) -> bool:
    size = float(np.linalg.norm(vectors, axis=1).mean())
    turned = float(np.linalg.norm(vectors.mean(axis=0))) < _TURNED * size
    return turned and _range_of_size(vectors) < _GRAVITY


def repeated_rows(evidence: Evidence) -> Iterator[Finding]:
    """Find the longest runs of equal samples, in both triads, one triad or one axis, that chance does not explain."""
    names = ("samples_stuck", "gyro_stuck", "accel_stuck", *CHANNELS)
    longest = {
        name: max(runs, key=lambda run: run.count)
        for name, runs in zip(names, repeated_runs(evidence), strict=True)
        if runs
    }
    stuck = [(fault, fault.name) for fault in (SAMPLES_STUCK, *STUCK.values())]
    for sensor, fault in AXIS_STUCK.items():
        axes = [name for name in CHANNELS if name in longest and name.startswith(sensor)]
        stuck += [(fault, max(axes, key=lambda name: longest[name].count))] if axes else []
    for fault, name in stuck:
        if name not in longest:
            continue
        run = longest[name]
        yield fault.found(
            channel=name,
            count=run.count + 1,
            time=float(evidence.recording.time[run.first]),
            sequence=evidence.place_title(run.first),
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


_TWICE: Final = 3.0
"""Smallest ratio of the number of repeated samples to the number expected by chance: the expected number assumes
independent readings, but pulses are not quite independent."""
_FEWEST_TWICE: Final = 3
"""Fewest repeated samples for a finding: a single data frame may have been sent twice."""


def duplicated_samples(evidence: Evidence) -> Iterator[Finding]:
    """Find samples that repeat the previous one in all channels, more often than by chance or against the motion.

    Where the rate changes, a repeated sample deviates from its neighbours like a spike. Where the rate is steady, an
    additional sample makes an attitude error by its angle. Both show also in readings whose pulses often repeat by
    chance. Statistic: number of repeated samples. Distribution: Poisson.
    """
    for rows, expected in single_repeats(evidence):
        count = len(rows)
        if count < max(_FEWEST_TWICE, _TWICE * expected) or gammainc(count, expected) > REPEATS_BY_CHANCE:
            continue
        yield _duplicated(evidence, rows, expected)
        return
    there = evidence.spikes
    rows = np.unique(there.sample[there.of_repeats(evidence.recording)]) if there.sample.size else there.sample
    if rows.size == 0:
        again = sample_twice(evidence)
        rows = rows if again is None else np.array([again])
    if rows.size:
        yield _duplicated(evidence, rows, 0.0)


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


def _duplicated(evidence: Evidence, rows: Indices, expected: float) -> Finding:
    time = float(evidence.recording.time[rows[0]])
    return SAMPLES_DUPLICATED.found(count=len(rows), time=time, expected=expected)


_LINE: Final = 8
"""Fewest samples on a straight line for a finding. With noise of one quantization step, a second difference is zero
with p = 0.16; six successive second differences in six channels are all zero with p = 1e-28."""
_SLOPES: Final = 2
"""Fewest channels that must change along the line: constant channels are frozen, or have no pulses at rest."""


def samples_interpolated(evidence: Evidence) -> Iterator[Finding]:
    """Find the longest run of samples on straight lines in all channels."""
    columns = evidence.columns
    if not evidence.noisy_channels.reshape(2, 3).any(axis=1).all():
        return
    straight = np.ones(len(columns[0]) - 2, dtype=np.bool_)
    slopes = np.zeros(len(straight), dtype=np.intp)
    for column in columns:
        rounding = ROUNDING * float(np.abs(column).max())
        step = np.diff(column)
        straight &= np.abs(np.diff(step)) <= rounding
        slopes += np.abs(step[1:]) > rounding
    edges = np.flatnonzero(np.diff(np.concatenate(([False], straight & (slopes >= _SLOPES), [False]))))
    lengths = np.diff(edges)[::2]
    if lengths.max(initial=0) + 2 < _LINE:
        return
    first = int(edges[::2][np.argmax(lengths)])
    yield SAMPLES_INTERPOLATED.found(
        time=float(evidence.recording.time[first]),
        count=int(lengths.max()) + 2,
        sequence=evidence.place_title(first),
    )


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
    """Find spikes; the message states the largest spike of the channel with the most spikes."""
    there = evidence.spikes
    if there.sample.size:
        own = ~there.of_repeats(evidence.recording)
        there = there[own]
    if there.sample.size == 0:
        return
    most = int(np.argmax(np.bincount(there.channel)))
    k = int(np.argmax(np.where(there.channel == most, np.abs(there.jump), -1.0)))
    yield SPIKES.found(
        channel=CHANNELS[int(there.channel[k])],
        size=f"{abs(float(there.jump[k])) * evidence.per_rate:.3g} {'rad/s' if there.channel[k] < 3 else 'm/s²'}",
        time=float(evidence.recording.time[there.sample[k]]),
        count=int(there.sample.size),
        sequence=evidence.place_title(int(there.sample[k])),
    )


SPIKES: Final = Fault(
    "spikes",
    "Spikes: single outlying readings",
    "deviation of every reading from its neighbours, relative to the noise around it",
    "{channel} jumps by {size} for one sample at {time:.6g} s, far more than its noise ({count} such readings in the "
    "recording): look for a bad contact or transmission errors, and repeat {sequence}.",
    "warning",
    spikes,
)
