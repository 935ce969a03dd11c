"""The certificate as one self-contained page of HTML: for light and dark, wide and narrow screens, and print.

Texts out of files are escaped. The style of the page sets the colours of the figures.
"""

from __future__ import annotations

import re
from importlib.resources import files
from typing import TYPE_CHECKING, Final

from srt.exceptions import optional
from srt.reports.certificate.figures import certificate_figures, figure_svg
from srt.reports.figures.style import BLUE, FAINT, GREY, INK

if TYPE_CHECKING:
    from srt.reports.certificate.content import Certificate
    from srt.reports.certificate.figures import CertificateFigure

EXTRA: Final = "report"
_TEMPLATE: Final = "certificate.html.jinja"
_STYLED: Final = {
    INK: "var(--ink)",
    GREY: "var(--grey)",
    FAINT: "var(--faint)",
    BLUE: "var(--blue)",
    "#000000": "var(--ink)",
}
"""Figure colours replaced by variables of the page's style; the others are legible on both backgrounds."""
_REFERENCE: Final = re.compile(r'(\bid="|href="#|url\(#)')


def html_page(certificate: Certificate) -> str:
    """Write the certificate as a page of HTML that loads no other files and runs no scripts.

    Raises MissingExtraError without Jinja2 or matplotlib.
    """
    with optional("jinja2", EXTRA, "A certificate"):
        from jinja2 import Environment, StrictUndefined

    source = (files("srt.reports.certificate") / _TEMPLATE).read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["css_string"] = _css_string
    drawn = {figure.name: (figure, _drawing(certificate, figure)) for figure in certificate_figures(certificate)}
    return environment.from_string(source).render(certificate=certificate, figures=drawn)


def _css_string(text: str) -> str:
    """Quote a text for a style sheet; all characters except letters and digits become numeric escapes."""
    # A space ends the number, so that a digit which follows is not read as part of it.
    return '"' + "".join(c if c.isalnum() else f"\\{ord(c):x} " for c in text) + '"'


def _drawing(certificate: Certificate, figure: CertificateFigure) -> str:
    """SVG of a figure with the colours of the page and identifiers that no other figure has."""
    text = figure_svg(certificate, figure)
    for colour, variable in _STYLED.items():
        text = text.replace(colour.lower(), variable).replace(colour, variable)
    # Identifiers must be unique in the page, so each begins with the figure's name.
    text = _REFERENCE.sub(lambda found: f"{found[1]}{figure.name}-", text)
    head = rf'<svg viewBox="\1" role="img" aria-label="{figure.title}">'
    return re.sub(r'<svg\b[^>]*?viewBox="([^"]*)"[^>]*>', head, text, count=1)
