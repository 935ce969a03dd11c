"""The certificate as one page of HTML that needs nothing beside it: light or dark, wide or narrow, or printed.

Texts out of files are never taken for markup. Pictures are drawn once, in colours that the page's style decides.
"""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Final

from srt.exceptions import MissingExtraError
from srt.reports.certificate.figures import certificate_figures
from srt.reports.figures.style import BLUE, DPI, FAINT, GREY, INK, ConstrainedLayoutEngine, Figure

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
"""Colours of the pictures that the page chooses; the others show on either ground."""
_COMMENT: Final = re.compile(r"<!--.*?-->\s*|<metadata>.*?</metadata>\s*", re.DOTALL)
_REFERENCE: Final = re.compile(r'(\bid="|href="#|url\(#)')


@dataclass(frozen=True, slots=True)
class PageFigure:
    """A picture as the page holds it.

    Attributes
    ----------
    title, caption : str
    svg : str
        The picture itself.
    width_px : int
        On a screen that is wide enough.
    """

    title: str
    caption: str
    svg: str
    width_px: int


def html_page(certificate: Certificate) -> str:
    """Write the certificate as a page of HTML.

    Parameters
    ----------
    certificate : Certificate

    Returns
    -------
    str
        It asks for nothing from elsewhere, and runs no scripts.

    Raises
    ------
    MissingExtraError
        Without Jinja2 or matplotlib.
    """
    try:
        from jinja2 import Environment, StrictUndefined
    except ModuleNotFoundError:
        raise MissingExtraError("jinja2", EXTRA, "A certificate") from None

    source = (files("srt.reports.certificate") / _TEMPLATE).read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    drawn = {picture.name: _drawn(certificate, picture) for picture in certificate_figures(certificate)}
    return environment.from_string(source).render(certificate=certificate, pictures=drawn)


def _drawn(certificate: Certificate, picture: CertificateFigure) -> PageFigure:
    """Draw to SVG: the same text from the same numbers."""
    import matplotlib as mpl

    layout = ConstrainedLayoutEngine(h_pad=0.04, w_pad=0.03, hspace=0.03, wspace=0.02)
    figure = Figure(figsize=picture.size_in, dpi=DPI, layout=layout)
    picture.draw(certificate, figure)
    written = io.BytesIO()
    # Identifiers in the file are random numbers without a salt; the setting is restored at once.
    with mpl.rc_context({"svg.hashsalt": "srt", "svg.fonttype": "path"}), warnings.catch_warnings():
        # A name in a script that the font lacks shows boxes in the picture, and is right in the tables.
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
        figure.savefig(written, format="svg", transparent=True, metadata=nothing)
    text = written.getvalue().decode("utf-8")
    text = _COMMENT.sub("", text[text.index("<svg") :])
    for colour, variable in _STYLED.items():
        text = text.replace(colour.lower(), variable).replace(colour, variable)
    # All pictures of the page share one space of names.
    text = _REFERENCE.sub(lambda found: f"{found[1]}{picture.name}-", text)
    text = re.sub(
        r'<svg\b[^>]*?viewBox="([^"]*)"[^>]*>',
        rf'<svg viewBox="\1" role="img" aria-label="{picture.title}">',
        text,
        count=1,
    )
    return PageFigure(picture.title, picture.caption, text.strip(), round(96 * picture.size_in[0]))
