"""The certificate as a PDF of A4 pages: the same sentences, tables and pictures as the page, set line by line.

All letters are measured before they are set, so that nothing runs out of its column. Lengths are in points.
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from srt.reports.certificate.figures import certificate_figures
from srt.reports.certificate.unit_description import MATHTEXT
from srt.reports.figures.style import FAINT, GREY, INK, ConstrainedLayoutEngine, Figure, Line2D

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from srt.reports.certificate.content import Certificate
    from srt.reports.certificate.figures import CertificateFigure
    from srt.reports.certificate.tables import CertificateTable

_POINTS: Final = 72.0
_WIDTH, _HEIGHT = 595.3, 841.9
_MARGIN, _TOP, _BOTTOM = 50.0, 48.0, 52.0
_BODY: Final = _WIDTH - 2.0 * _MARGIN
_SIZE: Final = 9.0
_SMALL: Final = 8.0
_LEAST: Final = 5.5
"""Below this no letter is set: a table that is still too wide loses the ends of its longest cells."""
_LEADING: Final = 1.38
_GAP: Final = 9.0
"""Between columns."""
_COLOURS: Final = {"passed": "#00694d", "failed": "#b03a00", "changed": "#b03a00", "held": "#555555", "": INK}


def write_pdf(certificate: Certificate, path: Path) -> None:
    """Write the certificate as a PDF.

    Parameters
    ----------
    certificate : Certificate
    path : Path
        The same certificate makes the same file.

    Raises
    ------
    MissingExtraError
        Without matplotlib.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_pdf import PdfPages

    # Letters as text, which can be found and copied; the setting is restored at once.
    with mpl.rc_context({"pdf.fonttype": 42}), warnings.catch_warnings():
        # A name in a script that the font lacks shows boxes here, and is right on the page.
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        layout = _Layout(certificate.title)
        _write(certificate, layout)
        about = {"Title": certificate.title, "CreationDate": None}
        with PdfPages(path, metadata=about) as pdf:
            for figure in layout.finished():
                pdf.savefig(figure)


def _write(certificate: Certificate, layout: _Layout) -> None:
    """Set the parts of the certificate in their order."""
    layout.paragraph(certificate.title, size=16.0, weight="bold")
    layout.space(4.0)
    if certificate.outcome:
        colour = _COLOURS[certificate.outcome]
        layout.paragraph(certificate.outcome.capitalize(), size=12.0, weight="bold", colour=colour)
    for sentence in certificate.summary:
        layout.paragraph(sentence)
    layout.heading("The unit and its test")
    layout.facts(certificate.facts)
    if certificate.recordings is not None:
        layout.table(certificate.recordings, titled=True)
    layout.heading(certificate.parameters.title, needs=150.0)
    layout.table(certificate.parameters)
    if certificate.held:
        layout.paragraph("Held, not measured:")
        layout.bullets(certificate.held)
    if certificate.changes is not None:
        layout.heading(certificate.changes.title, needs=150.0)
        layout.table(certificate.changes)
        for sentence in certificate.change_notes:
            layout.paragraph(sentence, size=_SMALL)
    layout.heading("How well it fits", needs=120.0)
    for sentence in certificate.residual_notes:
        layout.paragraph(sentence)
    if certificate.residuals is not None:
        layout.table(certificate.residuals)
    for picture in certificate_figures(certificate):
        layout.picture(certificate, picture)
    layout.heading("How to apply it", needs=150.0)
    for words, formula in zip(("The unit reads", "and a reading is corrected by"), MATHTEXT, strict=True):
        layout.paragraph(words)
        layout.formula(formula)
    layout.bullets(certificate.application.sentences)
    for table in certificate.application.tables:
        layout.table(table, titled=True)
    layout.heading("What the test cannot see", needs=80.0)
    layout.bullets(certificate.limitations)
    if certificate.notes:
        layout.heading("Notes of the calibration")
        layout.bullets(certificate.notes)


class _Layout:
    """Pages, and the place on the last one down to which they are full."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.pages: list[Figure] = []
        self._turn()

    def finished(self) -> Iterator[Figure]:
        """Give the pages with their numbers."""
        for number, page in enumerate(self.pages, start=1):
            y = _HEIGHT - 0.6 * _BOTTOM
            _put(page, _MARGIN, y, _shortened(self.title, 0.7 * _BODY, 7.5), 7.5, colour=GREY)
            _put(page, _WIDTH - _MARGIN, y, f"page {number} of {len(self.pages)}", 7.5, colour=GREY, align="right")
            yield page

    def space(self, height: float) -> None:
        """Leave room."""
        self.y += height

    def heading(self, text: str, *, needs: float = 60.0) -> None:
        """Set a heading that stays with the ``needs`` points below it."""
        self.space(12.0)
        self._room(needs)
        self._line(text, 12.0, weight="bold")
        self._rule(INK)
        self.space(5.0)

    def paragraph(
        self, text: str, *, size: float = _SIZE, weight: str = "normal", colour: str = INK, indent: float = 0.0
    ) -> None:
        """Set a text in lines that fit."""
        for line in _wrapped(text, _BODY - indent, size, weight):
            self._line(line, size, weight=weight, colour=colour, indent=indent)
        self.space(2.5)

    def bullets(self, texts: Iterable[str]) -> None:
        """Set sentences with a mark before each."""
        for text in texts:
            self._room(_SIZE * _LEADING)
            _put(self.pages[-1], _MARGIN + 2.0, self.y + _SIZE, "•", _SIZE)
            self.paragraph(text, indent=12.0)

    def facts(self, facts: Iterable[tuple[str, str]]) -> None:
        """Set labels and what stands against them in two columns."""
        rows = tuple(facts)
        indent = max(_length(label, _SIZE) for label, _ in rows) + 2.0 * _GAP
        for label, text in rows:
            self._room(_SIZE * _LEADING)
            _put(self.pages[-1], _MARGIN, self.y + _SIZE, label, _SIZE, colour="#555555")
            self.paragraph(text or "-", indent=indent)

    def formula(self, text: str) -> None:
        """Set a formula in matplotlib's notation."""
        self._room(26.0)
        _put(self.pages[-1], _MARGIN + 20.0, self.y + 15.0, text, 12.0, mathematics=True)
        self.space(26.0)

    def table(self, table: CertificateTable, *, titled: bool = False) -> None:
        """Set a table; its head is repeated on every page."""
        if titled:
            self.space(6.0)
            self._room(80.0)
            self._line(table.title, _SIZE, weight="bold")
        size, widths = _fitted(table)
        step = size * _LEADING
        self._room(4.0 * step)
        self._head(table, size, widths)
        for number, row in enumerate(table.rows):
            if self.y + step > _HEIGHT - _BOTTOM:
                self._turn()
                self._head(table, size, widths)
            elif number and number in table.breaks:
                self._rule(FAINT)
            for cell, (x, width), side in zip(row, _columns(widths), table.alignment, strict=True):
                text = _shortened(cell.text, width, size)
                self._cell(text, x, width, side, size, colour=_COLOURS[cell.mark])
            self.space(step)
        self.space(4.0)
        if table.note:
            self.paragraph(table.note, size=_SMALL, colour="#555555")

    def picture(self, certificate: Certificate, picture: CertificateFigure) -> None:
        """Set a picture with its title and caption."""
        width = min(_POINTS * picture.size_in[0], _BODY)
        height = width * picture.size_in[1] / picture.size_in[0]
        self.space(10.0)
        self._room(height + 50.0)
        self._line(picture.title, _SIZE + 1.0, weight="bold")
        page = self.pages[-1]
        page.set_layout_engine(ConstrainedLayoutEngine(h_pad=0.04, w_pad=0.03, hspace=0.03, wspace=0.02))
        place = page.add_gridspec(
            3,
            3,
            width_ratios=(_MARGIN, width, _WIDTH - _MARGIN - width),
            height_ratios=(self.y, height, _HEIGHT - self.y - height),
        )
        part = page.add_subfigure(place[1, 1])
        part.patch.set_visible(False)
        picture.draw(certificate, part)
        self.space(height + 3.0)
        self.paragraph(picture.caption, size=_SMALL, colour="#555555")

    def _head(self, table: CertificateTable, size: float, widths: list[float]) -> None:
        for text, (x, width), side in zip(table.head, _columns(widths), table.alignment, strict=True):
            self._cell(text, x, width, side, size, weight="bold")
        self.space(size * _LEADING)
        self._rule(GREY)
        self.space(1.5)

    def _cell(
        self, text: str, x: float, width: float, side: str, size: float, *, weight: str = "normal", colour: str = INK
    ) -> None:
        at, align = (x, "left") if side == "l" else (x + width, "right")
        _put(self.pages[-1], _MARGIN + at, self.y + size, text, size, align=align, weight=weight, colour=colour)

    def _line(self, text: str, size: float, *, weight: str = "normal", colour: str = INK, indent: float = 0.0) -> None:
        self._room(size * _LEADING)
        _put(self.pages[-1], _MARGIN + indent, self.y + size, text, size, weight=weight, colour=colour)
        self.space(size * _LEADING)

    def _rule(self, colour: str) -> None:
        y = 1.0 - self.y / _HEIGHT
        ends = (_MARGIN / _WIDTH, 1.0 - _MARGIN / _WIDTH)
        self.pages[-1].add_artist(Line2D(ends, (y, y), color=colour, linewidth=0.5))

    def _room(self, height: float) -> None:
        if self.y + height > _HEIGHT - _BOTTOM:
            self._turn()

    def _turn(self) -> None:
        self.pages.append(Figure(figsize=(_WIDTH / _POINTS, _HEIGHT / _POINTS)))
        self.y = _TOP


def _put(
    page: Figure,
    x: float,
    y: float,
    text: str,
    size: float,
    *,
    weight: str = "normal",
    colour: str = INK,
    align: str = "left",
    mathematics: bool = False,
) -> None:
    """Set one line with its baseline at y from the top of the page."""
    page.text(
        x / _WIDTH, 1.0 - y / _HEIGHT, text, fontsize=size, fontweight=weight, color=colour, ha=align, va="baseline",
        parse_math=mathematics,
    )  # fmt: skip


def _columns(widths: list[float]) -> Iterator[tuple[float, float]]:
    """Left edge and width of every column."""
    x = 0.0
    for width in widths:
        yield x, width
        x += width + _GAP


def _fitted(table: CertificateTable) -> tuple[float, list[float]]:
    """Size of letters at which a table fits the page, and the widths of its columns."""
    gaps = _GAP * (len(table.head) - 1)
    longest = [
        max(_length(head, _SMALL, "bold"), *(_length(row[k].text, _SMALL) for row in table.rows), 1.0)
        for k, head in enumerate(table.head)
    ]
    scale = min(1.0, (_BODY - gaps) / sum(longest))
    size = max(_SMALL * scale, _LEAST)
    widths = [width * size / _SMALL for width in longest]
    excess = sum(widths) + gaps - _BODY
    if excess > 0.0:
        widest = max(range(len(widths)), key=widths.__getitem__)
        widths[widest] = max(widths[widest] - excess, 20.0)
    return size, widths


def _wrapped(text: str, width: float, size: float, weight: str) -> Iterator[str]:
    """Break a text into lines no longer than ``width``; a word that is longer is broken, too."""
    line = ""
    for word in text.split():
        longer = f"{line} {word}".lstrip()
        if _length(longer, size, weight) <= width:
            line = longer
            continue
        if line:
            yield line
        line = word
        while _length(line, size, weight) > width:
            fits = next(n for n in range(len(line) - 1, 0, -1) if n == 1 or _length(line[:n], size, weight) <= width)
            yield line[:fits]
            line = line[fits:]
    if line:
        yield line


def _shortened(text: str, width: float, size: float) -> str:
    """Cut a text that is too long for its column."""
    if _length(text, size) <= width + 0.5:
        return text
    fits = (n for n in range(len(text) - 1, 0, -1) if _length(text[:n] + "…", size) <= width)
    return text[: next(fits, 0)] + "…"


@lru_cache(maxsize=8192)
def _length(text: str, size: float, weight: str = "normal") -> float:
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    width, _, _ = text_to_path.get_text_width_height_descent(text, FontProperties(size=size, weight=weight), False)
    return float(width)
