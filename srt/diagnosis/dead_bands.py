"""Dead bands: gyros and accelerometers that read zero, but nothing between zero and a threshold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

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
_BAND_STEPS: Final = 2.5
"""Smallest ratio of the smallest nonzero reading to the quantization step for a dead band; without one, it is 1."""
_FREQUENT: Final = 0.3
"""Smallest count of a frequent value, relative to that of the most frequent value."""
_NEAR: Final = 10.0
"""Largest reading, relative to the smallest nonzero one, in the search for a grid of pulses."""
_MOSTLY: Final = 0.5
"""Share of the readings that lie on a grid of pulses, and of the stationary readings that a dead band sets to zero."""


def dead_bands(evidence: Evidence) -> Iterator[Finding]:
    """Find channels that read zero as the input changes sign, or gyros at rest, but never less than a threshold.

    Wrapped readings lie on several grids, so that their quantization step is not found. Gyros without noise may read
    zero at rest: those of a recording with noisy accelerometers have noise.
    """
    data, noise = evidence.data, evidence.recording.noise
    for sensor, table, pulse, unit, name in (
        ("gyro", evidence.rate, noise.gyro_quantization, 1.0, "{}"),
        ("accel", evidence.force, noise.accel_quantization, MICRO_G, "{}_ug"),
    ):
        if sensor in evidence.wrapped_readings or (sensor == "gyro" and not evidence.noisy_channels[3:].any()):
            continue
        zeros = np.count_nonzero(table == 0.0, axis=0)
        step = None
        for axis in np.flatnonzero((zeros >= _MANY // 3) & (zeros < len(table))).tolist():
            size = np.abs(table[:, axis])
            size = size[size > 0.0]
            threshold = float(size.min())
            near = size[size < _NEAR * threshold]
            at_rest = np.ones(1)
            if sensor == "gyro" and data is not None:
                at_rest = np.abs(np.concatenate([table[a:b, axis] for a, b in data.windows.samples.tolist()]))
            shown = at_rest[at_rest > 0.0]
            # If readings at rest lie between pulses in some window, they come as near to zero as can be.
            resting = len(shown) < (1.0 - _MOSTLY) * len(at_rest)
            resting &= len(shown) == 0 or float(np.median(shown)) < _NEAR * threshold
            # If most readings are multiples of the threshold, it is the quantization step.
            passing = np.count_nonzero(near < 2.0 * threshold) >= _MANY
            if not (passing or resting) or _on_grid(size, threshold):
                continue
            step = smallest_step(table[:: max(1, len(table) // SAMPLES)]) if step is None else step
            values, counts = np.unique(near, return_counts=True)
            common = float(values[np.argmax(counts >= _FREQUENT * counts.max())])
            grid = max(float(step[axis]), (pulse or 0.0) / evidence.dt, common if _on_grid(near, common) else 0.0)
            if threshold > _BAND_STEPS * grid:
                sizes = {name.format("threshold"): threshold / unit, name.format("step"): grid / unit}
                yield DEAD_BAND[sensor].found(channel=f"{sensor}_{AXES[axis]}", count=int(zeros[axis]), **sizes)
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
    return bool(np.mean(np.abs(multiple - np.rint(multiple)) < WHOLE) > _MOSTLY)
