"""Catalogue of faults as a page: ``python -m srt.diagnosis.document`` writes ``docs/faults.md``."""

from __future__ import annotations

import re
import sys
from typing import Final

from srt.diagnosis.faults import FAULTS, STAGES, Fault
from srt.recording.atomic_file import atomic_write_text

_INTRODUCTION: Final = """# Faults of a recording

The faults that a recording can have, causes before their consequences: of several findings, the first by this order is
named as the cause. Words in braces are filled in from the recording. How reliably each fault is named is in
[fault-detection.md](fault-detection.md).

Effects: **exit 2**, the recording is refused on reading; **exit 1**, it cannot be calibrated; **warning**, it is
calibrated with a warning; **note**, only `srt inspect` reports it.

This page is made from `srt/diagnosis/faults.toml` by `python -m srt.diagnosis.document`.
"""


def document() -> str:
    """All faults as Markdown, one table for each stage."""
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
