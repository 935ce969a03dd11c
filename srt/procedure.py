"""Calibration of a recording as library and command make it: checks, estimation, and checks of the result."""

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
    "Faults of the recording were not looked for (checks=False): units, axes, labels, timing, stillness and site are "
    "taken as stated."
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
        Without labels, sequences of Table 1 made on a fixture are recognised; a free recording is cut into free turns.
    estimator : str
        "auto" takes the closed form where sequences of Table 1 are labelled on a fixture, least squares elsewhere.
        Others by name, see :func:`srt.estimators`.
    checks : bool
        Look for every fault of the catalogue, before the calibration and with its result, as the command does; a fatal
        one stops it, the others become warnings. False: estimation alone, and the result says so.
    force : bool
        Calibrate whatever fault was found.
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
        A fault that makes any calibration meaningless, or data that cannot support a result, with the fault that
        likely causes it.
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
