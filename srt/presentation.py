"""Presentation of results: text, HTML, figure and table of numbers, by the name of the class.

Results lie below the reports in the floors of the package, so a function that presents one is named here in a string
and imported on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, Final

from srt.exceptions import InputError

PRESENTATIONS: Final = {
    "Recording": {
        "text": "reports.text.recording:recording_text",
        "html": "reports.text.recording:recording_html",
        "figure": "reports.figures.inspection:inspection_figure",
        "frame": "reports.frames:samples_frame",
    },
    "Calibration": {
        "text": "reports.text.calibration_summary:calibration_summary",
        "html": "reports.text.calibration_summary:calibration_html",
        "figure": "reports.figures.calibration:calibration_figure",
        "frame": "reports.frames:parameter_frame",
    },
    "Inspection": {
        "text": "reports.text.inspection:inspection_report",
        "frame": "reports.frames:manoeuvre_frame",
    },
    "Comparison": {
        "text": "reports.text.estimator_comparison:comparison_text",
        "figure": "reports.figures.comparison:comparison_figure",
        "frame": "reports.frames:comparison_frame",
    },
    "Plan": {
        "text": "planning.plan_text:plan_text",
        "figure": "planning.plan_figure:plan_figure",
        "frame": "planning.plan_document:plan_frame",
    },
    "Certificate": {
        "text": "reports.certificate.content:certificate_text",
        "frame": "reports.frames:certificate_frame",
    },
}
"""By the name of the class, functions "module:function" below ``srt`` that give a text of at most 80 columns, HTML (or
else the text, with its line ends), a matplotlib figure, or a pandas DataFrame."""


class Presented:
    """Base class of results whose ``repr`` is their table, in a notebook as HTML."""

    __slots__ = ()

    def __repr__(self) -> str:
        text: str = present(self, "text")
        return text

    def _repr_html_(self) -> str:
        from html import escape  # on use: notebooks alone need it

        page: str = present(self, "html") if "html" in _forms(self) else f"<pre>{escape(repr(self))}</pre>"
        return page


def _forms(result: object) -> dict[str, str]:
    """Presentations of the class of an object, or of its nearest base class that has some."""
    names = (each.__name__ for each in type(result).__mro__)
    return next((PRESENTATIONS[name] for name in names if name in PRESENTATIONS), {})


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
    target = _forms(result).get(form)
    if target is None:
        known = ", ".join(name for name, forms in PRESENTATIONS.items() if form in forms)
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
