"""Saturation: readings at the limit of the measuring range. A sequence with such readings cannot be used."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import by_sensor
from srt.noise.allan import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding


def clipping(evidence: Evidence) -> Iterator[Finding]:
    """Find readings at the stated range, or runs of the same extreme reading that noise does not explain."""
    clipped = evidence.clipped_parts
    for sensor in ("gyro", "accel"):
        mine = [(k, part) for k, parts in clipped for part in parts if part.channel.startswith(sensor)]
        if not mine:
            continue
        k, first = mine[0]
        at = int(np.searchsorted(evidence.recording.time, first.first_s))
        table = getattr(evidence.recording, sensor)
        others = len({number for number, _ in mine}) - 1
        where = evidence.place_title(at) if k is None else evidence.title(k)
        yield CLIPPED[sensor].found(
            channel=first.channel,
            limit=abs(float(table[at, CHANNELS.index(first.channel) % 3])) * evidence.per_rate,
            count=first.count,
            time=first.first_s,
            sequence=where + (f" (and {others} more)" if others else ""),
        )


CLIPPED: Final = by_sensor(
    "clipped",
    "[A gyro|An accelerometer] saturates",
    "readings at the stated range, or runs of the same extreme reading",
    "{channel} is at the limit of its range ({limit:.4g} [rad/s|m/s²]) in {count} samples from {time:.6g} s: "
    "{sequence} cannot be used; [rotate more slowly|avoid shocks, or choose a wider range], and repeat the sequence.",
    "warning",
    clipping,
)
