"""Dead bands: gyros and accelerometers that read zero, but nothing between zero and a threshold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.constants import MICRO_G
from srt.diagnosis.channels import SAMPLES
from srt.diagnosis.findings import by_sensor
from srt.diagnosis.words import WHOLE
from srt.model.table1 import AXES
from srt.noise.noise_model import smallest_step

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array


_MANY: Final = 30
"""Fewest readings just outside a dead band: without a dead band, as many are expected inside it, and the probability of
none is 1e-13."""
_ZEROS: Final = 0.3
"""Smallest ratio of zeros to the readings just outside a dead band: the motion may be faster inside the band."""
_BESIDE: Final = 1.5
"""Largest median size of the readings after zeros, relative to the threshold, if a slow motion passes the dead band."""
_BAND_STEPS: Final = 2.5
"""Smallest ratio of the smallest nonzero reading to the quantization step for a dead band; without one, it is 1."""
_FREQUENT: Final = 0.3
"""Smallest count of a frequent value, relative to that of the most frequent value."""
_NEAR: Final = 10.0
"""Largest reading, relative to the smallest nonzero one, in the search for a grid of pulses."""
_DEAD_SHARE: Final = 0.5
"""Smallest share of zeros in the stationary readings of a channel with a dead band."""
_DEAD_PULSES: Final = 1.5
"""Smallest such ratio at rest if the pulse size is stated, so that the step is known."""
_DEAD_EDGE: Final = 0.1
"""Smallest ratio of the smallest to the median size of the nonzero stationary readings for a dead band: the readings
outside the band begin at its edge."""


def dead_bands(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that read zero as the input changes sign, or gyros at rest, but never less than a threshold.

    Wrapped readings lie on several grids, so that their quantization step is not found. Gyros without noise may read
    zero at rest: those of a recording with noisy accelerometers have noise.
    """
    for sensor, unit, name in (("gyro", 1.0, "{}"), ("accel", MICRO_G, "{}_ug")):
        if sensor in evidence.wrapped_readings or (sensor == "gyro" and not evidence.noisy_channels[3:].any()):
            continue
        found = _suppressed(evidence, sensor) or (_zero_at_rest(evidence) if sensor == "gyro" else None)
        if found is not None:
            sizes = {name.format("threshold"): found.threshold / unit, name.format("step"): found.step / unit}
            yield DEAD_BAND[sensor].found(channel=f"{sensor}_{AXES[found.axis]}", count=found.zeros, **sizes)


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


class SuppressedReadings(NamedTuple):
    """Axis without readings between zero and a threshold.

    Attributes
    ----------
    axis, zeros : int
        Number of the axis, and number of its readings that are zero.
    threshold, step : float
        Magnitude of the smallest nonzero reading, and quantization step, rad/s or m/s².
    """

    axis: int
    zeros: int
    threshold: float
    step: float


def _suppressed(evidence: Evidence, sensor: str) -> SuppressedReadings | None:
    """First axis of a triad ("gyro" or "accel") whose readings pass through zero, but are never small and nonzero."""
    table = evidence.rate if sensor == "gyro" else evidence.force
    step = smallest_step(table[:: max(1, len(table) // SAMPLES)])
    pulse = getattr(evidence.recording.noise, f"{sensor}_quantization") or 0.0
    for axis in range(3):
        size = np.abs(table[:, axis])
        zeros = int(np.count_nonzero(size == 0.0))
        if zeros < _ZEROS * _MANY or zeros == len(size):
            continue
        threshold = float(size[size > 0.0].min())
        beyond = int(np.count_nonzero((size > 0.0) & (size < 2.0 * threshold)))
        multiple = size[size > 0.0] / threshold
        if np.mean(np.abs(multiple - np.rint(multiple)) < WHOLE) > 0.5:
            continue  # the threshold is the step of most readings; the others were interpolated
        grid = max(float(step[axis]), pulse / evidence.dt, _grid(size[(size > 0.0) & (size < _NEAR * threshold)]))
        # Zeros that stand for lost samples have neighbours of any size.
        beside = size[np.minimum(np.flatnonzero(size == 0.0) + 1, len(size) - 1)]
        passing = zeros >= _ZEROS * beyond or float(np.median(beside)) < _BESIDE * threshold
        if beyond >= _MANY and passing and threshold > _BAND_STEPS * grid:
            return SuppressedReadings(axis, zeros, threshold, grid)
    return None


def _grid(small: Array) -> float:
    """Smallest of the frequent values of small readings; 0 if most readings are not multiples of it."""
    values, counts = np.unique(small, return_counts=True)
    common = float(values[np.argmax(counts >= _FREQUENT * counts.max())])
    multiple = small / common
    return common if np.mean(np.abs(multiple - np.rint(multiple)) < WHOLE) > 0.5 else 0.0


def _zero_at_rest(evidence: Evidence) -> SuppressedReadings | None:
    """First gyro that reads zero in most stationary samples, and otherwise far more than its quantization step."""
    assert evidence.data is not None
    windows = evidence.data.windows.samples.tolist()
    stationary = np.concatenate([evidence.rate[a:b] for a, b in windows])
    share = np.mean(stationary == 0.0, axis=0)
    for axis in np.flatnonzero(share > _DEAD_SHARE).tolist():
        size = np.abs(evidence.rate[:, axis])
        # Readings at the largest size are left out: a saturation limit is not a multiple of the quantization step.
        moving = evidence.rate[(size > 0.0) & (size < size.max())]
        if len(moving) < _MANY:
            continue
        threshold = float(size[size > 0.0].min())
        shown = np.abs(stationary[stationary[:, axis] != 0.0, axis])
        if shown.size and threshold < _DEAD_EDGE * float(np.median(shown)):
            continue  # the nonzero readings reach down to zero: pulses, with noise in some window
        if shown.size and np.all(np.abs(shown / threshold - np.rint(shown / threshold)) < WHOLE):
            continue  # all readings are multiples of the smallest one: pulses
        # In corrected samples, which mix the pulses of several axes, readings differ by less than a pulse.
        pulse = (evidence.recording.noise.gyro_quantization or 0.0) / evidence.dt
        step = max(pulse, float(smallest_step(moving[-SAMPLES:])[axis]))
        if threshold > (_DEAD_PULSES if pulse else _BAND_STEPS) * step:
            return SuppressedReadings(axis, int(np.count_nonzero(size == 0.0)), threshold, step)
    return None
