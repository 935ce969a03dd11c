"""Calibration procedure of library and command line: fault detection, estimation, and checks of the result."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from srt.diagnosis.staged_diagnosis import StagedDiagnosis
from srt.estimation.options import Options, chosen_options
from srt.estimation.registry import estimate
from srt.exceptions import DataError

if TYPE_CHECKING:
    from srt.estimation.registry import Progress
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

UNCHECKED = (
    "The recording was not checked for faults (checks=False): units, axes, labels, timing, stationary windows and site "
    "are taken as stated."
)
"""Warning of a calibration without checks."""


def calibrate(
    recording: Recording,
    estimator: str = "auto",
    *,
    checks: bool = True,
    force: bool = False,
    options: Options | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> Calibration:
    """Calibrate an IMU from a recording.

    Parameters
    ----------
    recording : Recording
        Without labels, sequences of Table 1 on a fixture are recognised; other recordings become free rotations.
    estimator : str
        "auto": the closed form for labelled sequences of Table 1 on a fixture, otherwise least squares. Other names:
        :func:`srt.estimators`.
    checks : bool
        Check for all faults of the catalogue, before the calibration and with its result, as the command does. Fatal
        faults stop the calibration; others become warnings. False: estimation alone, and a warning says so.
    force : bool
        Calibrate in spite of fatal faults.
    options : Options, optional
    progress : callable, optional
        Called after every iteration with its number and the largest correction.
    **choices
        Fields of :class:`srt.Options`, instead of ``options``.

    Returns
    -------
    Calibration
        With the findings among its warnings, and in ``diagnostics["faults"]``.

    Raises
    ------
    InputError
        Unknown estimator or option.
    DataError
        A fatal fault, or data that do not support a result, with the likely cause.
    """
    options = chosen_options(options, choices)
    if not checks:
        result = estimate(recording, estimator, options, progress)
        return replace(result, warnings=(*result.warnings, UNCHECKED))
    staged = StagedDiagnosis(recording, options)
    screened = staged.before_calibration()
    if screened.refusal is not None and not force:
        raise DataError(screened.refusal.sentence, fault=screened.refusal.fault)
    try:
        result = estimate(recording, estimator, options, progress)
    except DataError as error:
        if screened.first is None or error.fault is not None:
            raise
        raise DataError(f"{error} The likely cause: {screened.first.sentence}", fault=screened.first.fault) from error
    diagnosis = staged.with_calibration(result)
    warnings = tuple(f.sentence for f in diagnosis.findings if f.effect != "note")
    return replace(
        result,
        warnings=(*warnings, *result.warnings),
        diagnostics={**result.diagnostics, "faults": diagnosis.as_dicts()},
    )
