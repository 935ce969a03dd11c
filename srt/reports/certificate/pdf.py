"""The certificate as a PDF of A4 pages: the sentences, tables and figures of the page, set by fpdf2. Lengths in mm."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from srt.exceptions import optional
from srt.recording.file_marks import PROGRAM
from srt.reports.certificate.figures import certificate_figures, figure_svg
from srt.reports.certificate.unit_description import FORMULAS
from srt.reports.figures.style import FAINT, GREY, INK

with optional("fpdf", "report", "A certificate", "fpdf2"):
    from fpdf import FPDF, FontFace
    from fpdf.enums import CellBordersLayout, XPos, YPos

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.reports.certificate.content import Certificate
    from srt.reports.tables import Table

_MARGIN: Final = 17.0  # margin at the left, the right and the top of a page
_BODY_PT: Final = 9.0
_SMALL_PT: Final = 8.0
_LEAST_PT: Final = 5.5
"""Smallest size of letters, as of footnotes; a table that is still too wide breaks its cells into lines."""
_LEADING: Final = 1.35 * 25.4 / 72.0
"""Height of a line, mm per point of its letters: the customary 1.2 to 1.45 of their size."""
_PADDING: Final = 1.3  # space on either side of the text of a cell
_QUIET: Final = "#555555"
_BAD: Final = "#b03a00"
_COLOURS: Final = {"passed": "#00694d", "failed": _BAD, "doubtful": _BAD, "changed": _BAD, "held": _QUIET, "": INK}
_PAGE_ONLY: Final = ("parameters", "convergence", "correlation")
"""Figures of the HTML page only: the PDF is for reading on paper, and has their numbers in tables."""
_FIGURE_SHARE: Final = 0.78  # width of a figure over that of the text
_UNDATED: Final = datetime(2000, 1, 1, tzinfo=UTC)
"""Time of creation that every file states, so that the same certificate makes the same file."""
_FONTS: Final = {"": "DejaVuSans.ttf", "B": "DejaVuSans-Bold.ttf", "I": "DejaVuSans-Oblique.ttf"}
"""Files of the font by style. matplotlib brings them; they have the Greek letters and the signs of the formulas."""


def write_pdf(certificate: Certificate, path: Path) -> None:
    """Write the certificate as a PDF; the same certificate makes the same file.

    Raises MissingExtraError without fpdf2 or matplotlib.
    """
    document = _Document(certificate.title)
    _write(certificate, document)
    path.write_bytes(bytes(document.output()))


def _write(certificate: Certificate, document: _Document) -> None:
    """Set the parts of the certificate in their order."""
    document.paragraph(certificate.title, size=16.0, style="B")
    if certificate.outcome:
        document.paragraph(certificate.outcome.capitalize(), size=12.0, style="B", colour=_COLOURS[certificate.outcome])
    document.paragraphs(certificate.summary)
    if certificate.parties or certificate.equipment:
        document.heading("Laboratory, customer and conditions")
        document.pairs(certificate.parties)
        document.titled_table(certificate.equipment)
    document.heading("The unit and its test")
    document.definitions(certificate.description)
    document.titled_table(certificate.references)
    document.paragraph(certificate.missing, size=_SMALL_PT, colour=_QUIET)
    document.titled_table(certificate.recordings)
    document.heading(certificate.parameters.title, needs=50.0)
    document.certificate_table(certificate.parameters)
    document.titled_table(certificate.g_sensitivity)
    if certificate.held:
        document.paragraph("Fixed, not measured:")
        document.bullets(certificate.held)
    document.titled_table(certificate.budget)
    if certificate.changes is not None:
        document.heading(certificate.changes.title, needs=50.0)
        document.certificate_table(certificate.changes)
        document.paragraphs(certificate.change_notes, size=_SMALL_PT)
    document.heading("Residuals", needs=40.0)
    document.paragraphs(certificate.residual_notes)
    if certificate.residuals is not None:
        document.certificate_table(certificate.residuals)
    for figure in certificate_figures(certificate):
        if figure.name not in _PAGE_ONLY:
            document.figure(figure.title, figure.caption, figure.size_in, figure_svg(certificate, figure))
    document.heading("Application", needs=50.0)
    for words, formula in zip(("Sensor model:", "Compensation:"), FORMULAS, strict=True):
        document.paragraph(words)
        document.paragraph(formula, size=11.0, style="I", indent=8.0)
    document.bullets(certificate.application.sentences)
    for table in certificate.application.tables:
        document.titled_table(table)
    document.heading("Limitations of the test", needs=30.0)
    document.bullets(certificate.limitations)
    if certificate.notes:
        document.heading("Warnings of the calibration")
        document.bullets(certificate.notes)
    document.paragraph(
        "The HTML page of this certificate draws the parameters and their correlations, and has all numbers in full; "
        "the calibration file has the covariance. The certificate is valid for the unit in the state of the test "
        "only, and may be copied as a whole only.",
        size=_SMALL_PT,
        colour=_QUIET,
    )


def _unbroken(head: str) -> str:
    """Text of a head that is not broken within an equation, as "U (k = 2)"."""
    return head.replace(" = ", "\u00a0=\u00a0")


class _Document(FPDF):
    """A4 pages with the parts that a certificate has."""

    def __init__(self, title: str) -> None:
        from matplotlib import get_data_path

        super().__init__(format="A4")
        for style, file in _FONTS.items():
            self.add_font("DejaVu", style, Path(get_data_path(), "fonts", "ttf", file))
        self.set_title(title)
        self.set_creator(PROGRAM)
        self.heading_text = title
        self.set_creation_date(_UNDATED)
        self.set_margins(_MARGIN, _MARGIN)
        self.set_auto_page_break(auto=True, margin=_MARGIN + 2.0)
        self.set_font("DejaVu", size=_BODY_PT)
        self.c_margin = 0.0
        self.add_page()

    def file_id(self) -> str:
        """Identifier of the file: fpdf2's own holds the time of the call."""
        name = hashlib.sha256(self.heading_text.encode()).hexdigest()[:32].upper()
        return f"<{name}><{name}>"

    def footer(self) -> None:
        """Title and page number at the foot of a page; fpdf2 calls it."""
        self.set_y(-0.8 * _MARGIN)
        self._letters(7.5, colour=GREY)
        number = f"page {self.page_no()} of {{nb}}"
        room = self.epw - 30.0
        title = self.heading_text
        while self.get_string_width(title) > room:
            title = title[:-2] + "…"
        self.cell(room, text=title)
        self.cell(30.0, text=number, align="R")

    def heading(self, text: str, *, needs: float = 20.0) -> None:
        """Set a heading with a rule below it, on the same page as the ``needs`` mm that follow."""
        self.ln(4.0)
        self._keep(needs)
        self._letters(12.0, "B")
        self._text(text)
        self.set_draw_color(INK)
        self.line(self.l_margin, self.y, self.w - self.r_margin, self.y)
        self.ln(1.5)

    def paragraph(
        self, text: str, *, size: float = _BODY_PT, style: str = "", colour: str = INK, indent: float = 0.0
    ) -> None:
        """Set a text in lines; nothing for an empty one."""
        if not text:
            return
        self._letters(size, style, colour)
        self._text(text, indent)
        self.ln(0.9)

    def paragraphs(self, texts: Iterable[str], *, size: float = _BODY_PT) -> None:
        """Set texts one below the other."""
        for text in texts:
            self.paragraph(text, size=size)

    def bullets(self, texts: Iterable[str]) -> None:
        """Set sentences with a mark before each."""
        for text in texts:
            self._keep(_BODY_PT * _LEADING)
            self._letters(_BODY_PT)
            self.set_x(self.l_margin + 1.0)
            self.cell(3.0, h=_BODY_PT * _LEADING, text="•")
            self.paragraph(text, indent=4.5)

    def definitions(self, pairs: Iterable[tuple[str, str]]) -> None:
        """Set labels and their texts in two columns."""
        rows = tuple(pairs)
        self._letters(_BODY_PT)
        indent = max(self.get_string_width(label) for label, _ in rows) + 6.0
        for label, text in rows:
            self._keep(_BODY_PT * _LEADING)
            self._letters(_BODY_PT, colour=_QUIET)
            self.cell(indent, h=_BODY_PT * _LEADING, text=label)
            self.paragraph(text or "-", indent=indent)

    def pairs(self, pairs: Iterable[tuple[str, str]]) -> None:
        """Set labels and their texts in two pairs of columns, read down the first pair and then the second."""
        rows = [*pairs]
        if not rows:
            return
        half = -(-len(rows) // 2)
        rows += [("", "")] * (2 * half - len(rows))
        self._letters(_SMALL_PT)
        label = max(self.get_string_width(text) for text, _ in rows) + 2.0 * _PADDING + 1.0
        text = 0.5 * self.epw - label
        with self.table(
            width=self.epw, col_widths=(label, text, label, text), text_align="LEFT", borders_layout="NONE",
            line_height=_SMALL_PT * _LEADING, padding=(0.15, _PADDING), first_row_as_headings=False,
        ) as out:  # fmt: skip
            for left, right in zip(rows[:half], rows[half:], strict=True):
                line = out.row()
                for name, value in (left, right):
                    line.cell(name, style=FontFace(color=_QUIET))
                    line.cell(value, style=FontFace(color=INK))
        self.ln(1.0)

    def titled_table(self, table: Table | None) -> None:
        """Set a table below its title; nothing for None."""
        if table is None:
            return
        self.ln(2.0)
        self._keep(25.0)
        self.paragraph(table.title, style="B")
        self.certificate_table(table)

    def certificate_table(self, table: Table) -> None:
        """Set a table; its head is repeated on every page."""
        size, widths = self._fitted(table)
        self._letters(size)
        self.set_draw_color(FAINT)
        with self.table(
            align="L",
            width=min(sum(widths), self.epw),  # the sum of fitted widths can exceed the page by a rounding
            col_widths=widths,
            text_align=tuple("RIGHT" if side == "r" else "LEFT" for side in table.alignment),
            line_height=size * _LEADING,
            padding=(0.25, _PADDING),
            borders_layout="NONE",
            headings_style=FontFace(emphasis="BOLD", color=INK),
        ) as out:
            out.row([*map(_unbroken, table.head)])
            for number, row in enumerate(table.rows):
                line = out.row()
                rule = CellBordersLayout.TOP if number == 0 or number in table.breaks else CellBordersLayout.NONE
                for cell in row:
                    line.cell(cell.text, style=FontFace(color=_COLOURS[cell.mark]), border=rule)
        self.ln(1.0)
        if table.note:
            self.paragraph(table.note, size=_SMALL_PT, colour=_QUIET)

    def figure(self, title: str, caption: str, size_in: tuple[float, float], svg: str) -> None:
        """Set a figure with its title and caption, all on one page."""
        width = min(25.4 * size_in[0], _FIGURE_SHARE * self.epw)
        height = width * size_in[1] / size_in[0]
        self.ln(3.0)
        self._keep(height + 18.0)
        self.paragraph(title, size=_BODY_PT + 1.0, style="B")
        self.image(BytesIO(svg.encode("utf-8")), w=width, h=height)
        self.ln(1.0)
        self.paragraph(caption, size=_SMALL_PT, colour=_QUIET)

    def _fitted(self, table: Table) -> tuple[float, list[float]]:
        """Size of letters at which a table fits the page, and the widths of its columns; heads break at blanks."""
        longest = []
        for k, head in enumerate(table.head):
            self._letters(_SMALL_PT, "B")
            width = max(self.get_string_width(word) for word in _unbroken(head).split(" "))
            self._letters(_SMALL_PT)
            longest.append(max(width, *(self.get_string_width(row[k].text) for row in table.rows)) + 0.2)
        padding = 2.0 * _PADDING * len(longest)
        size = max(min(1.0, (self.epw - padding) / sum(longest)) * _SMALL_PT, _LEAST_PT)
        widths = [width * size / _SMALL_PT + 2.0 * _PADDING for width in longest]
        # A table that is still too wide: the widest columns are narrowed to one width, and break their cells.
        narrow: list[float] = []
        for columns, width in zip(range(len(widths), 0, -1), sorted(widths), strict=True):
            narrow.append(min(width, (self.epw - sum(narrow)) / columns))
        return size, [min(width, narrow[-1]) for width in widths]

    def _letters(self, size: float, style: str = "", colour: str = INK) -> None:
        self.set_font("DejaVu", style, size)
        self.set_text_color(colour)

    def _text(self, text: str, indent: float = 0.0) -> None:
        after: dict[str, Any] = {"new_x": XPos.LMARGIN, "new_y": YPos.NEXT}
        self.set_x(self.l_margin + indent)
        self.multi_cell(self.epw - indent, h=self.font_size_pt * _LEADING, text=text, align="L", **after)

    def _keep(self, height: float) -> None:
        """Begin a new page unless a height fits on this one."""
        if self.will_page_break(height):
            self.add_page()
