"""Catalogue of faults as a page: ``python -m srt.diagnosis.document`` writes ``docs/faults.md``."""

from __future__ import annotations

import re
import sys
from typing import Final

from srt.diagnosis.faults import FAULTS, STAGES, Fault
from srt.recording.atomic_file import atomic_write_text

_INTRODUCTION: Final = """# Faults of a recording

This page lists the faults that a recording can have. A fault is listed before the faults that it causes: of several
findings, the first in this order is reported as the cause. The words in braces of a message are filled in from the
recording. [fault-detection.md](fault-detection.md) has the detection rate of each fault.

Effects: **exit 2**, the recording is refused on reading; **exit 1**, it is read, but not calibrated; **warning**, it is
calibrated with a warning; **note**, only `srt inspect` reports the fault.

`python -m srt.diagnosis.document` writes this page from `srt/diagnosis/faults.toml`.
"""


def document() -> str:
    """Catalogue as a page in Markdown, with one table for each stage."""
    parts = [_INTRODUCTION]
    for stage, title in STAGES.items():
        rows = [_row(fault) for fault in FAULTS.values() if fault.stage == stage]
        head = ["| fault | name | criterion | message | effect |", "|---|---|---|---|---|"]
        parts.append("\n".join([f"## {title}", "", *head, *rows, ""]))
    return "\n".join(parts)


def _row(fault: Fault) -> str:
    own = re.sub(r"\{(\w+):[^}]*\}", r"{\1}", fault.sentence)
    message = "the reader's message" if fault.sentence == "{message}" else own
    cells = (fault.title, f"`{fault.name}`", fault.criterion, message, fault.effect)
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


if __name__ == "__main__":
    atomic_write_text(sys.argv[1] if len(sys.argv) > 1 else "docs/faults.md", document())
