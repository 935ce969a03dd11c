"""The page of faults is made from the catalogue, and the committed one is up to date."""

from pathlib import Path

from srt.diagnosis.document import document
from srt.diagnosis.faults import STAGES

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"


def test_the_committed_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == document(), "run python -m srt.diagnosis.document"


def test_every_fault_stands_once_under_its_stage():
    sections = document().split("\n## ")[1:]
    assert [section.splitlines()[0] for section in sections] == [stage.title for stage in STAGES.values()]
    for stage, section in zip(STAGES.values(), sections, strict=True):
        rows = [line.split(" | ") for line in section.splitlines() if line.startswith("| ")][1:]
        assert [row[1].strip("`") for row in rows] == [f.name for f in stage.faults]
        assert all(len(row) == 5 for row in rows)
