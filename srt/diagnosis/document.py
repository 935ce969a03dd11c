"""The catalogue of faults as a page: ``python -m srt.diagnosis.document`` writes ``docs/faults.md``."""

from __future__ import annotations

import re
import sys
from typing import Final

from srt.diagnosis.faults import FAULTS, STAGES, Fault
from srt.recording.atomic import atomic_write_text

_INTRODUCTION: Final = """# Faults of a recording

What can be wrong with a recording, in the order in which one fault explains another: of several findings, the first
by this order is the cause. Words in braces are filled in from the recording. How reliably each fault is named is in
[fault-detection.md](fault-detection.md).

Effects: **exit 2**, the recording is refused on reading; **exit 1**, it cannot be calibrated; **warning**, the
calibration says so; **note**, only `srt inspect` says so.

This page is made from `srt/diagnosis/faults.py` by `python -m srt.diagnosis.document`.
"""


def document() -> str:
    """All faults as Markdown, a table for each stage."""
    parts = [_INTRODUCTION]
    for stage, title in STAGES.items():
        rows = [_row(fault) for fault in FAULTS.values() if fault.stage == stage]
        head = ["| fault | name | looks at | says | effect |", "|---|---|---|---|---|"]
        parts.append("\n".join([f"## {title}", "", *head, *rows, ""]))
    return "\n".join(parts)


def _row(fault: Fault) -> str:
    says = "what reading says" if fault.sentence == "{message}" else re.sub(r"\{(\w+):[^}]*\}", r"{\1}", fault.sentence)
    cells = (fault.title, f"`{fault.name}`", fault.looks_at, says, fault.effect)
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


if __name__ == "__main__":
    atomic_write_text(sys.argv[1] if len(sys.argv) > 1 else "docs/faults.md", document())
