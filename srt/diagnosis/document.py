"""Catalogue of faults as a page: ``python -m srt.diagnosis.document`` writes ``docs/faults.md``."""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING, Final

from srt.diagnosis.faults import STAGES
from srt.recording.atomic_file import atomic_write_text
from srt.result.verdict import LEFT_TO_RESIDUALS

if TYPE_CHECKING:
    from srt.diagnosis.findings import Fault

_INTRODUCTION: Final = """# Faults of a recording

This page lists the faults that a recording can have. A fault is listed before the faults that it causes: of several
findings, the first in this order is reported as the cause. The words in braces of a message are filled in from the
recording. [fault-detection.md](fault-detection.md) has the detection rate of each fault.

Effects: **exit 2**, the recording is refused on reading; **exit 1**, it is read, but not calibrated; **warning**, it is
calibrated with a warning; **note**, only `srt inspect` reports the fault. A warning makes the verdict doubtful at best,
except for a drift that is modelled and **warning, verdict by residuals**: the estimate leaves out, corrects or measures
what such a fault changes.

`python -m srt.diagnosis.document` writes this page from the catalogue in `srt/diagnosis/faults.py`.
"""

_UNSEEN: Final = """## What no check sees

Nothing in such a recording contradicts the result. The sizes are the largest error over its sigma of simulated units.

- **The scale factor of a gyro changes where its range switches.** On a fixture all turns pass the switch alike, and the
  result is the scale factor at the rates that were turned. 0.3 % from 0.5 rad/s on: 66 sigma (consumer grade), 160
  (industrial), 550 (tactical), 4200 (navigation); turned by hand 43 to 59, and doubtful for navigation grade. Turn each
  axis below the switch in one test and above it in another, and compare the two.
- **Time stamps and `sample_rate_hz` agree, but the clock is wrong**: 1 ppm of every gyro scale factor for 1 ppm. State
  `clock_sigma_ppm`.
- **A dead band is subtracted from coarse readings, below their noise, and the biases keep all axes from zero at rest**:
  35 sigma for half of the noise (consumer grade, one unit of ten). Fine readings show it in rotations, too.
- **A low-pass in the sensor takes away a part of the motion.** First order at 10 Hz, 50 Hz recorded, and a hand that
  strays by 3° at up to 3 Hz: 5 sigma of a gyro scale factor (industrial grade). Turn more smoothly, or widen the band.
"""


def document() -> str:
    """Catalogue as a page in Markdown, with one table for each stage, and what no check sees."""
    parts = [_INTRODUCTION]
    for stage in STAGES.values():
        rows = [_row(fault) for fault in stage.faults]
        head = ["| fault | name | criterion | message | effect |", "|---|---|---|---|---|"]
        parts.append("\n".join([f"## {stage.title}", "", *head, *rows, ""]))
    parts.append(_UNSEEN)
    return "\n".join(parts)


def _row(fault: Fault) -> str:
    own = re.sub(r"\{(\w+):[^}]*\}", r"{\1}", fault.message)
    message = "the reader's message" if fault.message == "{message}" else own
    effect = f"{fault.effect}, verdict by residuals" if fault.name in LEFT_TO_RESIDUALS else fault.effect
    cells = (fault.title, f"`{fault.name}`", fault.criterion, message, effect)
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


if __name__ == "__main__":
    atomic_write_text(sys.argv[1] if len(sys.argv) > 1 else "docs/faults.md", document())
