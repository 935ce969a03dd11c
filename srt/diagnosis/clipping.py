"""Clipping: readings at the end of a range void their sequence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.channels import CHANNELS
from srt.diagnosis.findings import check, finding
from srt.noise.noise_model import smallest_step
from srt.sequences.plausibility import Clipping, ClippingLevels, clipped_samples, clipping_levels

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array


@check("gyro_clipped", "accel_clipped")
def clipping(evidence: Evidence) -> Iterator[Finding]:
    """Readings at the stated range, or at an extreme that is held as no noise would."""
    clipped = clipped_parts(evidence)
    for sensor in ("gyro", "accel"):
        mine = [(k, part) for k, parts in clipped for part in parts if part.channel.startswith(sensor)]
        if not mine:
            continue
        k, first = mine[0]
        at = int(np.searchsorted(evidence.recording.time, first.first_s))
        table = getattr(evidence.recording, sensor)
        others = len({number for number, _ in mine}) - 1
        where = evidence.place_title(at) if k is None else evidence.title(k)
        yield finding(
            f"{sensor}_clipped",
            channel=first.channel,
            limit=abs(float(table[at, CHANNELS.index(first.channel) % 3])) * evidence.per_rate,
            count=first.count,
            time=first.first_s,
            sequence=where + (f" (and {others} more)" if others else ""),
        )


_BEYOND: Final = 1.001
"""Reading over stated range from which the range is not what stopped it: a unit or a range is stated wrongly."""
_COARSE: Final = 0.5
"""Step of readings over their noise (differences of neighbours), below which they repeat by chance alone. A fixture
turns at one rate: coarser ones repeat at their extreme by nature, and so do readings without noise."""
_READINGS: Final = 4000


def clipped_parts(evidence: Evidence) -> list[tuple[int | None, tuple[Clipping, ...]]]:
    """Sequences with clipped readings, and their channels; without labels, the recording as a whole (None)."""
    recording = evidence.recording
    levels = _levels(evidence)
    if levels is None:
        return []
    if not evidence.has_labels:
        whole = clipped_samples(recording, slice(0, len(recording.time)), levels)
        return [(None, whole)] if whole else []
    data = evidence.data
    if data is None:
        return []
    windows = data.windows.samples
    parts = ((k, slice(int(windows[data.start[k], 0]), int(windows[data.end[k], 1]))) for k in range(data.K))
    return [(k, channels) for k, part in parts if (channels := clipped_samples(recording, part, levels))]


def _levels(evidence: Evidence) -> ClippingLevels | None:
    """Readings at which channels are clipped; None if no channel is."""
    recording = evidence.recording
    known = clipping_levels(recording)
    low, high = known.low.copy(), known.high.copy()
    noise, per_sample = recording.noise, 1.0 / evidence.per_rate
    stated = ((noise.gyro_range, noise.gyro_quantization), (noise.accel_range, noise.accel_quantization))
    for s, (table, (limit, pulse)) in enumerate(zip((recording.gyro, recording.accel), stated, strict=True)):
        triad = slice(3 * s, 3 * s + 3)
        if limit is not None:
            peak = max(float(table.max()), -float(table.min()))
            # Pulses carry what is left of the sample before.
            most = (_BEYOND * limit + 2.0 * (pulse or 0.0) / evidence.dt) * per_sample
            if not high[3 * s] <= peak <= most:
                low[triad], high[triad] = -np.inf, np.inf
        elif s == 0 and evidence.data is not None:
            a, b = evidence.data.windows.samples[0].tolist()
            scatter = np.std(np.diff(table[a:b], axis=0), axis=0)
            noisy = smallest_step(table[:: max(1, len(table) // _READINGS)]) < _COARSE * scatter
            for axis in np.flatnonzero(noisy).tolist():
                low[axis], high[axis] = _seen_limits(table[:, axis], low[axis], high[axis])
    return ClippingLevels(low, high) if np.isfinite(high).any() or np.isfinite(low).any() else None


def _seen_limits(channel: Array, low: float, high: float) -> tuple[float, float]:
    """Limits of a noisy gyro whose range is not stated: the extremes, where they are held in rows."""
    for sign in (1.0, -1.0):
        top = float((sign * channel).max())
        at = sign * channel == top
        if top > 0.0 and np.any(at[2:] & at[1:-1] & at[:-2]):
            low, high = (low, top) if sign > 0.0 else (-top, high)
    return low, high
