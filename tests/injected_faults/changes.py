"""Changes of a recording that several injections share."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.signal import lfilter

from srt.recording.recording import Recording, SequenceLabel
from srt.types import Array, Indices

_EDGE: Final = 5
"""Number of undisturbed samples at each end of a sequence."""


def sign(rng: np.random.Generator) -> float:
    """Random sign, 1 or -1."""
    return float(rng.choice((-1.0, 1.0)))


def per_sample(recording: Recording) -> float:
    """Factor from rates to the stored values: 1 for rates, the interval in s for increments."""
    return recording.nominal_interval_s if recording.kind == "increment" else 1.0


def with_sensor(recording: Recording, sensor: str, values: Array) -> Recording:
    """Recording with other readings of one triad."""
    changes: dict[str, Any] = {sensor: values}
    return replace(recording, **changes)


def kept(recording: Recording, rows: Indices) -> Recording:
    """Recording with only some of its samples, or with repeated ones; they keep their time stamps."""
    return replace(recording, time=recording.time[rows], gyro=recording.gyro[rows], accel=recording.accel[rows])


def moved_labels(labels: Sequence[SequenceLabel], clock: Callable[[Array], Array]) -> tuple[SequenceLabel, ...]:
    """Labels with their times transformed by ``clock``."""
    spans = [[clock(np.array(at)).tolist() for at in (label.start_static_s, label.end_static_s)] for label in labels]
    return tuple(
        replace(label, start_static_s=tuple(start), end_static_s=tuple(end))
        for label, (start, end) in zip(labels, spans, strict=True)
    )


def restamped(recording: Recording, clock: Callable[[Array], Array]) -> Recording:
    """Recording with the times of its samples and labels transformed by ``clock``."""
    return replace(recording, time=clock(recording.time), sequences=moved_labels(recording.sequences, clock))


def somewhere(recording: Recording, rng: np.random.Generator, count: int, *, at_rest: bool = False) -> slice:
    """Consecutive samples at a random place in the windows or the rotation of a random sequence, or in one window."""
    label = recording.sequences[int(rng.integers(len(recording.sequences)))]
    first = recording.window_indices(*label.start_static_s).start + _EDGE
    last = recording.window_indices(*(label.start_static_s if at_rest else label.end_static_s)).stop - _EDGE
    count = min(count, last - first)
    start = int(rng.integers(first, last - count + 1))
    return slice(start, start + count)


def low_passed(values: Array, interval_s: float, time_s: float) -> Array:
    """Readings behind a first-order low-pass filter that has settled at the first of them."""
    keep = math.exp(-interval_s / time_s)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, axis=0, zi=keep * values[:1])[0])
