"""Several estimators on one recording, one after another."""

from __future__ import annotations

from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Final

from srt.estimation.options import Options
from srt.estimation.registry import automatic_estimator, find_estimator
from srt.exceptions import DataError, SrtError
from srt.sequences.recognition import label_sequences

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

    Progress = Callable[[str, int, float], None]

ESTIMATORS: Final = ("closed-form", "least-squares", "ekf", "graph")
"""Those compared where none are named: the least efficient first."""


def default_estimators(recording: Recording) -> tuple[tuple[str, ...], dict[str, str]]:
    """Estimators of :data:`ESTIMATORS` that can run here and on this recording; the others with the reason.

    Returns
    -------
    names : tuple of str
    left_out : dict of str to str
    """
    recording, _ = label_sequences(recording)
    names, left_out = [], {}
    for name in ESTIMATORS:
        try:
            find_estimator(name)
            if name == "closed-form" and automatic_estimator(recording) != name:
                raise DataError(
                    "The closed form needs labelled sequences of Table 1 on a fixture, and this recording has none."
                )
        except SrtError as error:
            left_out[name] = str(error)
        else:
            names.append(name)
    return tuple(names), left_out


def run_estimators(
    recording: Recording,
    names: Sequence[str],
    options: Options | None = None,
    progress: Progress | None = None,
) -> tuple[dict[str, Calibration], dict[str, float], dict[str, str]]:
    """Calibrate one recording with several estimators; one that fails does not stop the others.

    Parameters
    ----------
    recording : Recording
    names : sequence of str
    options : Options, optional
        The same for all.
    progress : callable, optional
        Called after every play-back with the estimator's name, its number and the largest correction.

    Returns
    -------
    calibrations : dict of str to Calibration
    seconds : dict of str to float
        Of every estimator, without the import of its module.
    failures : dict of str to str
        Why an estimator gave no result.

    Raises
    ------
    InputError
        An estimator that is not registered, or whose packages are not installed.
    """
    options = Options() if options is None else options
    recording, recognition = label_sequences(recording)
    calibrations: dict[str, Calibration] = {}
    seconds: dict[str, float] = {}
    failures: dict[str, str] = {}
    found = {name: find_estimator(name) for name in names}  # imported before any clock starts
    for name, estimator in found.items():
        started = perf_counter()
        try:
            result = estimator(recording, options, None if progress is None else partial(progress, name))
            calibrations[name] = result if recognition is None else recognition.told_in(result)
        except SrtError as error:
            failures[name] = str(error)
        seconds[name] = perf_counter() - started
    return calibrations, seconds, failures
