"""Presentation of results: text, HTML, figure and table of numbers, by the name of the class.

Results lie below the reports in the floors of the package, so a function that presents one is named here in a string
and imported on first use.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final

from srt.exceptions import InputError


@dataclass(frozen=True, slots=True)
class Presentation:
    """Functions that present objects of one class, as "module:function" below ``srt``.

    Attributes
    ----------
    text : str
        Gives a text of at most 80 columns.
    html : str or None
        Gives HTML; None: the text, with its line ends.
    figure : str or None
        Gives a matplotlib figure.
    frame : str or None
        Gives a pandas DataFrame.
    """

    text: str
    html: str | None = None
    figure: str | None = None
    frame: str | None = None


PRESENTATIONS: Final = {
    "Recording": Presentation(
        "reports.text.recording:recording_text", "reports.text.recording:recording_html",
        "reports.figures.inspection:inspection_figure", "reports.frames:samples_frame",
    ),
    "Calibration": Presentation(
        "reports.text.calibration_summary:calibration_summary", "reports.text.calibration_summary:calibration_html",
        "reports.figures.calibration:calibration_figure", "reports.frames:parameter_frame",
    ),
    "Inspection": Presentation(
        "reports.text.inspection:inspection_report", frame="reports.frames:manoeuvre_frame",
    ),
    "Comparison": Presentation(
        "reports.text.estimator_comparison:comparison_text", None, "reports.figures.comparison:comparison_figure",
        "reports.frames:comparison_frame",
    ),
    "Plan": Presentation(
        "planning.plan_text:plan_text", None, "planning.plan_figure:plan_figure", "planning.plan_document:plan_frame"
    ),
    "Certificate": Presentation(
        "reports.certificate.content:certificate_text", frame="reports.frames:certificate_frame",
    ),
}  # fmt: skip
"""Presentations by the name of the class."""


class Presented:
    """Base class of results whose ``repr`` is their table, in a notebook as HTML."""

    __slots__ = ()

    def __repr__(self) -> str:
        text: str = present(self, "text")
        return text

    def _repr_html_(self) -> str:
        from html import escape  # on use: notebooks alone need it

        own = _presentation(self)
        page: str = f"<pre>{escape(repr(self))}</pre>" if own is None or own.html is None else present(self, "html")
        return page


def _presentation(result: object) -> Presentation | None:
    """Presentation of the class of an object, or of its nearest base class that has one."""
    return next((PRESENTATIONS[each.__name__] for each in type(result).__mro__ if each.__name__ in PRESENTATIONS), None)


def present(result: object, form: str, **choices: Any) -> Any:
    """Present a result.

    Parameters
    ----------
    result : object
    form : "text", "html", "figure" or "frame"
    **choices
        Arguments of the function that presents it.

    Raises
    ------
    InputError
        An object that has no such form.
    MissingExtraError
        If the form needs a package that is not installed.
    """
    target = getattr(_presentation(result), form, None)
    if target is None:
        known = ", ".join(name for name, each in PRESENTATIONS.items() if getattr(each, form) is not None)
        raise InputError(f"There is no {form} of a {type(result).__name__}: it is made of {known}.")
    module, _, function = target.partition(":")
    return getattr(import_module(f"srt.{module}"), function)(result, **choices)


def to_frame(result: object) -> Any:
    """Table of a recording, calibration, inspection, comparison, plan or certificate, as a pandas DataFrame.

    Parameters
    ----------
    result : object
        Recording: one row a sample. Calibration, comparison, plan and certificate: one row a parameter, in the units of
        the tables. Inspection: one row a manoeuvre.

    Raises
    ------
    InputError
        Another object.
    MissingExtraError
        Without pandas.
    """
    return present(result, "frame")


def plot(result: object, path: Any = None, **choices: Any) -> Any:
    """Figure of a recording, calibration, comparison or plan.

    Parameters
    ----------
    result : object
    path : path-like, optional
        File to write: .png, .pdf or .svg.
    **choices
        Arguments of the figure, as ``title`` and, of a calibration, ``truth``.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        Another object, or a path that cannot be written.
    MissingExtraError
        Without matplotlib.
    """
    figure = present(result, "figure", **choices)
    if path is not None:
        import_module("srt.reports.figures.style").save_figure(figure, path)
    return figure
