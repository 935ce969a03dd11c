"""Calibration of a recording that was looked through for faults first, and what was found told with the result."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from srt.diagnosis.run import Examination
from srt.estimation.registry import calibrate
from srt.exceptions import DataError

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.estimation.registry import Progress
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration


def calibrate_examined(
    recording: Recording,
    estimator: str = "auto",
    *,
    options: Options,
    progress: Progress | None = None,
    force: bool = False,
) -> Calibration:
    """Look for faults, calibrate, and look for those that only a calibration shows.

    Parameters
    ----------
    recording : Recording
    estimator : str
    options : Options
    progress : callable, optional
        As for :func:`srt.calibrate`.
    force : bool
        Calibrate whatever was found.

    Returns
    -------
    Calibration
        With the findings among its warnings, and in ``diagnostics["faults"]``.

    Raises
    ------
    DataError
        A fault with which no calibration makes sense; or what :func:`srt.calibrate` raises, with the fault that likely
        causes it.
    """
    examination = Examination(recording, options)
    screened = examination.screen()
    if screened.refusal is not None and not force:
        raise DataError(screened.refusal.sentence, fault=screened.refusal.fault)
    try:
        result = calibrate(recording, estimator, options=options, progress=progress)
    except DataError as error:
        if screened.first is None or error.fault is not None:
            raise
        raise DataError(f"{error} The likely cause: {screened.first.sentence}", fault=screened.first.fault) from error
    diagnosis = examination.complete(result)
    warnings = tuple(f.sentence for f in diagnosis.findings if f.effect != "note")
    return replace(
        result,
        warnings=(*warnings, *result.warnings),
        diagnostics={**result.diagnostics, "faults": diagnosis.as_dicts()},
    )
