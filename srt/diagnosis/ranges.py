"""Clipping: readings at the end of a sensor's range void their sequence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.diagnosis.channels import CHANNELS
from srt.diagnosis.findings import check, found
from srt.diagnosis.range_evidence import clipped_parts

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding


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
        where = evidence.called_at(at) if k is None else evidence.title(k)
        yield found(
            f"{sensor}_clipped",
            channel=first.channel,
            limit=abs(float(table[at, CHANNELS.index(first.channel) % 3])) * evidence.per_rate,
            count=first.count,
            time=first.first_s,
            sequence=where + (f" (and {others} more)" if others else ""),
        )
