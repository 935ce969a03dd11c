"""Tables of results as HTML, for notebooks."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from srt.reports.text.calibration import parameter_rows
from srt.reports.text.calibration_summary import verdict_lines
from srt.reports.text.recording import recording_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration


def calibration_html(calibration: Calibration) -> str:
    """Status and verdict of a calibration, and the table of its parameters."""
    lines = "<br>".join(map(escape, verdict_lines(calibration, "Calibration")))
    return f"<p>{lines}</p>{html_table(*parameter_rows(calibration))}"


def recording_html(recording: Recording) -> str:
    """Table of the properties of a recording."""
    return html_table(["recording", ""], recording_rows(recording), "ll")


def html_table(headers: Sequence[str], rows: Sequence[Sequence[str] | None], alignment: str) -> str:
    """Table of texts, escaped.

    Parameters
    ----------
    headers : sequence of str
    rows : sequence of sequences of str, or None
        None, which parts groups of rows, is left out.
    alignment : str
        One letter per column: "l" or "r".
    """
    sides = [{"l": "left", "r": "right"}[letter] for letter in alignment]

    def line(cells: Sequence[str], tag: str) -> str:
        columns = zip(cells, sides, strict=True)
        return "".join(f'<{tag} style="text-align:{side}">{escape(cell)}</{tag}>' for cell, side in columns)

    body = "".join(f"<tr>{line(row, 'td')}</tr>" for row in rows if row is not None)
    return f"<table><thead><tr>{line(headers, 'th')}</tr></thead><tbody>{body}</tbody></table>"
