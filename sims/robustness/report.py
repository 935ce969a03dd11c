"""Reports of a campaign: a page of HTML that needs nothing beside it, tables in Markdown, rows for the command line.

The page is for a person who has not read the papers: the answer first, then the figures with a word on how to read
each, then every number. Labels and messages come out of files and are never taken for markup.
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

from sims.robustness.answers import FAILURES, Answers, answer
from sims.robustness.tables import (
    MEANINGS,
    Table,
    accuracy_tables,
    averaged,
    effort_table,
    failure_table,
    honesty_tables,
    map_tables,
    outcome_table,
    point_table,
    reach_table,
    sentences,
    varied_table,
)
from srt.exceptions import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pyarrow as pa
    from matplotlib.figure import Figure

    from sims.robustness.tidy import Header

_TEMPLATE: Final = "report.html.jinja"


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure as the page holds it.

    Attributes
    ----------
    uri : str
        The figure itself, as a data URI.
    text : str
        In place of the figure for who cannot see it.
    caption : str
        How to read it.
    """

    uri: str
    text: str
    caption: str


def html_report(table: pa.Table, header: Header) -> str:
    """Write the report of a campaign as one page of HTML, figures included.

    Parameters
    ----------
    table : pyarrow.Table
        One row per trial and estimator.
    header : Header

    Returns
    -------
    str
        It asks for nothing from elsewhere, and runs no scripts.

    Raises
    ------
    InputError
        A table that is not that of the campaign.
    DataError
        A trial that is there twice.
    MissingExtraError
        Without Jinja2 or matplotlib.
    """
    try:
        from jinja2 import Environment, StrictUndefined
    except ModuleNotFoundError:
        raise MissingExtraError("jinja2", "campaign", "The report of a campaign") from None

    found = answer(table, header)
    source = (files("sims.robustness") / _TEMPLATE).read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    estimators, some = header.estimators, bool(found.outcomes.judged.sum())
    return environment.from_string(source).render(
        header=header,
        sentences=sentences(found),
        varied=varied_table(found),
        outcomes=outcome_table(found),
        meanings=MEANINGS,
        reach=reach_table(found),
        points=point_table(found),
        maps=list(_maps(found)) if some else [],
        sizes=list(_sizes(found)) if found.outcomes.converged.sum() else [],
        accuracy=[t for a in found.accuracy for t in accuracy_tables(a, estimators, noisy=header.noisy) if t.rows],
        honesty=_honesty(found),
        honesty_tables=[t for t in honesty_tables(found) if t.rows],
        effort=_effort(found) if found.outcomes.converged.sum() else None,
        effort_table=effort_table(found),
        failures=list(_failure_tables(found)),
    )


def markdown_tables(table: pa.Table, header: Header) -> str:
    """Write the answers of a campaign as sentences and tables in Markdown.

    Parameters
    ----------
    table : pyarrow.Table
    header : Header

    Raises
    ------
    InputError
        A table that is not that of the campaign.
    DataError
        A trial that is there twice.
    """
    found = answer(table, header)
    tables = [varied_table(found), outcome_table(found), reach_table(found)]
    tables += [t for m in found.maps[:1] for t in map_tables(m, header.estimators)]
    for a in found.accuracy:
        if a.axis is None or a.axis.on_grid:  # what is drawn has too many levels for a document
            tables += accuracy_tables(a, header.estimators, noisy=header.noisy)
    tables += [*honesty_tables(found)[:1], effort_table(found)]
    text = "".join(f"- {_escaped(sentence)}\n" for sentence in sentences(found))
    return "\n".join([text, *(_markdown(t) for t in tables if t.rows)])


def text_summary(table: pa.Table, header: Header) -> list[tuple[str, ...]]:
    """Give one row per estimator for a table on the command line; the first row is the heading.

    Parameters
    ----------
    table : pyarrow.Table
    header : Header

    Returns
    -------
    list of tuple of str
        Plain text: a label may hold what a terminal library takes for markup.

    Raises
    ------
    InputError
        A table that is not that of the campaign.
    DataError
        A trial that is there twice.
    """
    found = answer(table, header)
    outcomes, effort = outcome_table(found), effort_table(found)
    return [
        (*first, *second[1:])
        for first, second in zip((outcomes.head, *outcomes.rows), (effort.head, *effort.rows), strict=True)
    ]


def short_answer(table: pa.Table, header: Header) -> tuple[str, ...]:
    """Give the answer of a campaign in sentences.

    Parameters
    ----------
    table : pyarrow.Table
    header : Header

    Raises
    ------
    InputError
        A table that is not that of the campaign.
    DataError
        A trial that is there twice.
    """
    return sentences(answer(table, header))


def _maps(found: Answers) -> Iterator[Picture]:
    from sims.robustness.figures import map_figure

    for m in found.maps:
        if m.across is None:
            continue
        axes = m.across.name if m.up is None else f"{m.across.name} (across) and {m.up.name} (up)"
        words = f"Share of converged trials over {axes}"
        rest = averaged(m)
        yield _picture(map_figure(m, found.header.estimators), words, f"{words}, in percent. {rest}".strip())


def _sizes(found: Answers) -> Iterator[Picture]:
    from sims.robustness.figures import size_figure

    for a in found.accuracy:
        if a.axis is None or len(a.axis.labels) < 2:
            continue
        words = f"Error of converged trials against {a.axis.name}"
        others = [axis.name for axis in found.axes if axis is not a.axis]
        rest = f" All values of {', '.join(others)} together." if others else ""
        yield _picture(size_figure(a, found.header.estimators, noisy=found.header.noisy), words, f"{words}.{rest}")


def _honesty(found: Answers) -> Picture | None:
    if found.honesty is None or not found.honesty.count.any():
        return None
    from sims.robustness.figures import honesty_figure

    words = "Root mean square of error over sigma, by parameter"
    return _picture(honesty_figure(found.honesty, found.header.estimators), words, f"{words}; 1 is honest.")


def _effort(found: Answers) -> Picture:
    from sims.robustness.figures import effort_figure

    words = "Play-backs until converged, and CPU time of a calibration"
    return _picture(effort_figure(found.effort, found.header.estimators), words, f"{words}.")


def _failure_tables(found: Answers) -> Iterator[Table]:
    for k, name in enumerate(found.header.estimators):
        own = [f for f in found.failures if f.estimator == name]
        total = int(found.outcomes.judged[k] - found.outcomes.converged[k])
        if own:
            yield failure_table(own, f"{name}: {total} failed" + (f", the first {FAILURES}" * (total > FAILURES)))


def _picture(figure: Figure, text: str, caption: str) -> Picture:
    """Draw to SVG, the same file from the same numbers."""
    import matplotlib as mpl

    drawn = io.BytesIO()
    # Identifiers in the file are random numbers without a salt; the setting is restored at once.
    with mpl.rc_context({"svg.hashsalt": "srt"}), warnings.catch_warnings():
        # A label in a script that the font lacks shows boxes in the figure, and is right in the tables.
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = drawn.getvalue()
    encoded = base64.b64encode(svg[svg.index(b"<svg") :]).decode("ascii")
    return Picture(f"data:image/svg+xml;base64,{encoded}", text, caption)


def _markdown(table: Table) -> str:
    lines = [f"**{_escaped(table.title)}**", ""]
    lines += [_line(table.head), "|" + "---|" * len(table.head), *(_line(row) for row in table.rows), ""]
    lines += [_escaped(table.note), ""] if table.note else []
    return "\n".join(lines)


def _line(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(_escaped(cell) for cell in cells) + " |"


def _escaped(text: str) -> str:
    """Give a text as Markdown shows it unchanged, in one line."""
    flat = html.escape(" ".join(text.split()), quote=False)
    # An underscore within a word is harmless, and names have many.
    return re.sub(r"[\\`*\[\]|~$]|(?<![^\W_])_|_(?![^\W_])", r"\\\g<0>", flat)
