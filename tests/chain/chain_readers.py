"""Tables of parameters read back out of texts, HTML and PDF, without the modules that write them."""

import re
import zlib
from collections.abc import Iterable
from html.parser import HTMLParser
from pathlib import Path

Rows = dict[str, tuple[str, str]]
"""Value and sigma as printed, by the name of the parameter."""


def named(rows: Iterable[list[str]]) -> Rows:
    """Rows of cells "symbol, parameter, value, sigma" by parameter; the first that names a parameter counts."""
    found: Rows = {}
    for row in rows:
        if len(row) >= 4 and re.fullmatch(r"(gyro|accel)[_ ][a-z]+[_ ][xyz]{1,2}", row[1]):
            found.setdefault(row[1].replace(" ", "_"), (row[2], row[3]))
    return found


def text_rows(text: str) -> Rows:
    """Rows of the table on the terminal."""
    return named(line.split() for line in text.splitlines())


class _Tables(HTMLParser):
    """Texts of the cells of all rows."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.inside = False

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th") and self.rows:
            self.rows[-1].append("")
            self.inside = True

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self.inside = False

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.rows[-1][-1] += data


def html_rows(page: str) -> Rows:
    """Rows of the table of parameters of a page."""
    tables = _Tables()
    tables.feed(page)
    return named([cell.strip() for cell in row] for row in tables.rows)


_SHOWN = rb"/(F\d+) [\d.]+ Tf|\(((?:[^\\)]|\\.)*)\) Tj"
"""Choice of a font, or a text."""
_ESCAPES = {b"n": b"\n", b"r": b"\r", b"t": b"\t", b"b": b"\b", b"f": b"\f"}


def pdf_texts(path: Path) -> list[str]:
    """Texts that a PDF of fpdf2 shows, in their order: one a cell of a table."""
    objects = {
        int(number): body for number, body in re.findall(rb"\n(\d+) 0 obj\n(.*?)\nendobj", path.read_bytes(), re.DOTALL)
    }

    def stream(body: bytes) -> bytes:
        head, _, rest = body.partition(b"stream\n")
        data = rest.rpartition(b"\nendstream")[0]
        return zlib.decompress(data) if b"/FlateDecode" in head else data

    fonts = {}
    for body in objects.values():
        for font, number in re.findall(rb"/(F\d+) (\d+) 0 R", body):
            table = stream(objects[int(re.search(rb"/ToUnicode (\d+) 0 R", objects[int(number)])[1])])
            pairs = re.findall(rb"<([0-9A-F]{4})> <([0-9A-F]{4,})>", table.partition(b"endcodespacerange")[2])
            fonts[font] = {int(code, 16): bytes.fromhex(to.decode()).decode("utf-16-be") for code, to in pairs}
    texts = []
    for number in re.findall(rb"/Contents (\d+) 0 R", b"\n".join(objects.values())):
        font: dict[int, str] = {}
        for name, text in re.findall(_SHOWN, stream(objects[int(number)]), re.DOTALL):
            if name:
                font = fonts[name]
                continue
            raw = re.sub(rb"\\(.)", lambda m: _ESCAPES.get(m[1], m[1]), text, flags=re.DOTALL)
            texts.append("".join(font[int.from_bytes(raw[i : i + 2])] for i in range(0, len(raw), 2)))
    return texts


def pdf_rows(path: Path) -> Rows:
    """Rows of the table of parameters of a certificate."""
    texts = pdf_texts(path)
    return named(texts[i : i + 4] for i in range(len(texts)))
