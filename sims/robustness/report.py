"""Reports of a campaign: a self-contained HTML page, tables in Markdown, and rows for the command line.

The page starts with the result in sentences. Figures with explanations follow, then all tables. Labels and messages
come from files and are always escaped.
"""

from __future__ import annotations

import base64
import html
import io
import re
import warnings
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Final

from sims.robustness.summary import FAILURES, CampaignSummary
from sims.robustness.tables import (
    OUTCOME_WORDS,
    TextTable,
    accuracy_tables,
    averaged,
    cause_table,
    consistency_tables,
    effort_table,
    failure_table,
    innovation_table,
    map_tables,
    outcome_table,
    point_table,
    region_table,
    score_tables,
    sentences,
    share_table,
    varied_table,
)
from sims.robustness.trial import OUTCOMES
from srt.exceptions import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

_TEMPLATE: Final = "report.html.jinja"
_ROWS: Final = 60
"""Largest number of rows of a table of errors in a document; longer ones are only in the HTML page."""


@dataclass(frozen=True, slots=True)
class Picture:
    """Figure of the HTML page.

    Attributes
    ----------
    uri : str
        SVG as a data URI.
    text : str
        Alternative text.
    caption : str
        Explanation.
    """

    uri: str
    text: str
    caption: str


def html_report(found: CampaignSummary) -> str:
    """Write the report of a campaign as one page of HTML, figures included, without external resources and scripts.

    Raises
    ------
    MissingExtraError
        Without Jinja2 or matplotlib.
    """
    try:
        from jinja2 import Environment, StrictUndefined
    except ModuleNotFoundError:
        raise MissingExtraError("jinja2", "campaign", "The report of a campaign") from None

    header = found.header
    source = (files("sims.robustness") / _TEMPLATE).read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    estimators, some = header.estimators, bool(found.outcomes["judged"].sum())
    return environment.from_string(source).render(
        header=header,
        sentences=sentences(found),
        varied=varied_table(found),
        outcomes=outcome_table(found),
        meanings={OUTCOME_WORDS[name]: text for name, text in OUTCOMES.items()},
        shares=share_table(found),
        innovations=innovation_table(found),
        causes=cause_table(found),
        region=region_table(found),
        points=point_table(found),
        maps=list(_maps(found)) if some else [],
        sizes=list(_sizes(found)) if found.outcomes["converged"].sum() else [],
        accuracy=[t for a in found.accuracy for t in accuracy_tables(a, estimators, noisy=header.noisy) if t.rows],
        consistency=_consistency(found),
        consistency_tables=[t for t in consistency_tables(found) if t.rows],
        effort=_effort(found) if found.outcomes["converged"].sum() else None,
        effort_table=effort_table(found),
        failures=list(_failure_tables(found)),
    )


def markdown_tables(found: CampaignSummary) -> str:
    """Write the results of a campaign as sentences and tables in Markdown."""
    header = found.header
    tables = [varied_table(found), outcome_table(found), share_table(found), region_table(found)]
    tables += score_tables(found) or [t for m in found.maps[:1] for t in map_tables(m, header.estimators)]
    for a in found.accuracy:
        if a.axis is None or a.axis.on_grid:  # random axes have too many levels for a document
            errors = accuracy_tables(a, header.estimators, noisy=header.noisy)
            tables += [table for table in errors if len(table.rows) <= _ROWS]
    tables += [*consistency_tables(found)[:1], innovation_table(found), cause_table(found), effort_table(found)]
    text = "".join(f"- {_escaped(sentence)}\n" for sentence in sentences(found))
    return "\n".join([text, *(_markdown(t) for t in tables if t.rows)])


def text_summary(found: CampaignSummary) -> list[tuple[str, ...]]:
    """Rows of a table for the command line, one per estimator; the first row is the heading.

    They are plain text: labels may contain the markup of a terminal library.
    """
    outcomes, effort = outcome_table(found), effort_table(found)
    return [
        (*first, *second[1:])
        for first, second in zip((outcomes.head, *outcomes.rows), (effort.head, *effort.rows), strict=True)
    ]


def _maps(found: CampaignSummary) -> Iterator[Picture]:
    from sims.robustness.figures import map_figure

    for m in found.maps:
        if m.across is None:
            continue
        axes = m.across.name if m.up is None else f"{m.across.name} (across) and {m.up.name} (up)"
        words = f"Share of converged trials over {axes}"
        rest = averaged(m)
        yield _picture(map_figure(m, found.header.estimators), words, f"{words}, in percent. {rest}".strip())


def _sizes(found: CampaignSummary) -> Iterator[Picture]:
    from sims.robustness.figures import size_figure

    for a in found.accuracy:
        if a.axis is None or len(a.axis.labels) < 2:
            continue
        words = f"Error of converged trials against {a.axis.name}"
        others = [axis.name for axis in found.axes if axis is not a.axis]
        rest = f" All values of {', '.join(others)} together." if others else ""
        yield _picture(size_figure(a, found.header.estimators, noisy=found.header.noisy), words, f"{words}.{rest}")


def _consistency(found: CampaignSummary) -> Picture | None:
    if found.consistency is None or not found.consistency.parameters["count"].any():
        return None
    from sims.robustness.figures import consistency_figure

    words = "Root mean square of error over sigma, by parameter"
    return _picture(
        consistency_figure(found.consistency, found.header.estimators), words, f"{words}; 1 if sigmas match the errors."
    )


def _effort(found: CampaignSummary) -> Picture:
    from sims.robustness.figures import effort_figure

    words = "Iterations until converged, and CPU time of a calibration"
    return _picture(effort_figure(found.effort, found.header.estimators), words, f"{words}.")


def _failure_tables(found: CampaignSummary) -> Iterator[TextTable]:
    for row in found.outcomes.itertuples():
        own, total = found.failures[found.failures["estimator"] == row.Index], row.judged - row.converged
        if len(own):
            yield failure_table(own, f"{row.Index}: {total} failed" + (f", the first {FAILURES}" * (total > FAILURES)))


def _picture(figure: Figure, text: str, caption: str) -> Picture:
    """SVG of a figure; equal numbers give an equal file."""
    import matplotlib as mpl

    drawn = io.BytesIO()
    # Without a salt the identifiers in the file are random; the setting is restored at once.
    with mpl.rc_context({"svg.hashsalt": "srt"}), warnings.catch_warnings():
        # Characters that the font lacks show as boxes in the figure and correctly in the tables.
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = drawn.getvalue()
    encoded = base64.b64encode(svg[svg.index(b"<svg") :]).decode("ascii")
    return Picture(f"data:image/svg+xml;base64,{encoded}", text, caption)


def _markdown(table: TextTable) -> str:
    lines = [f"**{_escaped(table.title)}**", ""]
    lines += [_line(table.head), "|" + "---|" * len(table.head), *(_line(row) for row in table.rows), ""]
    lines += [_escaped(table.note), ""] if table.note else []
    return "\n".join(lines)


def _line(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(_escaped(cell) for cell in cells) + " |"


def _escaped(text: str) -> str:
    """Text that Markdown shows unchanged, in one line."""
    flat = html.escape(" ".join(text.split()), quote=False)
    # An underscore within a word is harmless, and names have many.
    return re.sub(r"[\\`*\[\]|~$]|(?<![^\W_])_|_(?![^\W_])", r"\\\g<0>", flat)
