"""Saturation: readings at the limit of a range, which make their sequence useless."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.channels import CHANNELS
from srt.diagnosis.findings import check, finding
from srt.noise.noise_model import smallest_step
from srt.noise.quantization import quantization_step
from srt.sequences.plausibility import Clipping, ClippingLevels, clipped_samples, clipping_levels

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Mask


@check("gyro_clipped", "accel_clipped")
def clipping(evidence: Evidence) -> Iterator[Finding]:
    """Find readings at the stated range, or runs of one extreme reading that noise would not make."""
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


_LEAST_RUN: Final = 50
"""Equal readings in a row at a limit of coarse readings: a constant rate in pulses repeats for less."""


_SOME_WINDOWS: Final = 8
"""Windows from which the steps are taken."""


def _without_pulses(evidence: Evidence, levels: ClippingLevels) -> ClippingLevels:
    """Levels without those of corrected pulses, which repeat at a constant rate and are on no grid."""
    data = evidence.data
    if data is None:
        return levels
    low, high = levels.low.copy(), levels.high.copy()
    windows = data.windows.samples[:: max(1, len(data.windows.samples) // _SOME_WINDOWS)].tolist()
    for s, table in enumerate((evidence.recording.gyro, evidence.recording.accel)):
        # One axis alone may show no pulse in some poses.
        mixed = np.any([smallest_step(table[a:b]) < 0.5 * quantization_step(table[a:b]) for a, b in windows], axis=0)
        for axis in np.flatnonzero(mixed).tolist():
            i, channel = 3 * s + axis, table[:, axis]
            if np.isfinite(high[i]) and _longest_run(channel >= high[i]) < _LEAST_RUN:
                high[i] = np.inf
            if np.isfinite(low[i]) and _longest_run(channel <= low[i]) < _LEAST_RUN:
                low[i] = -np.inf
    return ClippingLevels(low, high)


def _longest_run(mask: Mask) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def clipped_parts(evidence: Evidence) -> list[tuple[int | None, tuple[Clipping, ...]]]:
    """Sequences with saturated readings, and their channels; without labels, the whole recording (None)."""
    recording = evidence.recording
    levels = _without_pulses(evidence, clipping_levels(recording))
    if not (np.isfinite(levels.low).any() or np.isfinite(levels.high).any()):
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
