"""Registry of estimators, and the choice of one for a recording.

Estimators are functions ``(recording, options, progress) -> Calibration``. Those of ``srt`` are listed here, those of
other packages in the entry-point group ``srt.estimators``; any distribution can add its own.
"""

from __future__ import annotations

import importlib
from functools import cache
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Final, Protocol

from srt.estimation.options import Options
from srt.exceptions import InputError, MissingExtraError
from srt.model.table1 import SEQUENCES
from srt.sequences.recognition import label_sequences

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

    Progress = Callable[[int, float], None]

GROUP: Final = "srt.estimators"
BUILT_IN: Final = {
    "closed-form": "srt.estimation.closed_form_solver:estimate",
    "least-squares": "srt.estimation.least_squares_solver:estimate",
}
"""Estimators of ``srt``; the residuals of both are those of :func:`srt.estimation.iteration.iterate`."""
ESTIMATORS: Final = (*BUILT_IN, "ekf", "graph")
"""Estimators of this distribution, the least efficient first: compared by default, with fixed colours in figures."""


class Estimator(Protocol):
    """Signature of the entry points of the group ``srt.estimators``."""

    def __call__(self, recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
        """Calibrate a recording."""


def estimators() -> tuple[str, ...]:
    """Names of all registered estimators."""
    _installed.cache_clear()
    return tuple(sorted({*BUILT_IN, *_installed()}))


@cache
def _installed() -> dict[str, str]:
    """Entry points of the group by name; cached, as listing them takes a tenth of the time of a calibration."""
    return {entry.name: entry.value for entry in entry_points(group=GROUP)}


def find_estimator(name: str) -> Estimator:
    """Load an estimator by name.

    Raises
    ------
    InputError
        If no estimator of that name is registered, or a package that it needs is not installed.
    """
    target = BUILT_IN.get(name) or _installed().get(name)
    if target is None:  # the package may have been installed since the last call
        known = estimators()
        target = _installed().get(name)
        if target is None:
            raise InputError(f"There is no estimator {name!r}; installed are {', '.join(known)}.")
    module, _, attribute = target.partition(":")
    try:
        found: Estimator = getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as error:
        raise MissingExtraError(str(error.name), "all", f"The estimator {name!r}") from None
    return found


def estimate(
    recording: Recording, estimator: str = "auto", options: Options | None = None, progress: Progress | None = None
) -> Calibration:
    """Estimate the sensor errors, without checks for faults of the recording.

    Parameters
    ----------
    recording : Recording
    estimator : str
    options : Options, optional
    progress : callable, optional
        As for :func:`srt.calibrate`.

    Raises
    ------
    InputError
        Unknown estimator.
    DataError
        Data that cannot support a result.
    """
    recording, recognition = label_sequences(recording)
    name = automatic_estimator(recording) if estimator == "auto" else estimator
    calibration = find_estimator(name)(recording, options or Options(), progress)
    return calibration if recognition is None else recognition.told_in(calibration)


def automatic_estimator(recording: Recording) -> str:
    """Name that "auto" stands for: the closed form for sequences of Table 1 on a fixture, else least squares."""
    labelled = [s for s in recording.sequences if s.id in SEQUENCES]
    return "closed-form" if recording.fixture is not None and labelled else "least-squares"
