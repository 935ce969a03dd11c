"""Inspection, noise and calibration of library and command line: fault detection, estimation, checks of the result."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from srt.diagnosis.staged_diagnosis import StagedDiagnosis
from srt.estimation.options import Options, chosen_options
from srt.estimation.registry import estimate
from srt.exceptions import DataError, SrtError
from srt.recording.reading import READING_KEYS, read
from srt.result.verdict import USABLE, explained
from srt.sequences.protocol_matching import with_protocol
from srt.sequences.recognition import leave_out

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.diagnosis.findings import Finding
    from srt.diagnosis.inspection import Inspection
    from srt.diagnosis.staged_diagnosis import Diagnosis
    from srt.estimation.registry import Progress
    from srt.noise.noise_terms import NoiseTerms
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

UNCHECKED = (
    "The recording was not checked for faults (checks=False): units, axes, labels, timing, stationary windows and site "
    "are taken as stated."
)
"""Warning of a calibration without checks."""
_IN_RESULT = frozenset({"accel_bias_drift", "sequence_missing"})
"""Faults that the result itself states: what drifts, and what is fixed, with the sequences to record."""


def calibrate(
    source: Any,
    estimator: str = "auto",
    *,
    checks: bool = True,
    force: bool = False,
    without_turns: Sequence[str] = (),
    options: Options | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> Calibration:
    """Calibrate an IMU from a recording.

    Parameters
    ----------
    source : Recording, path-like, or arrays
        Recording, or what :func:`srt.read` makes one of. Without labels, its protocol labels it; otherwise sequences
        of Table 1 on a fixture are recognised, and other recordings become free rotations.
    estimator : str
        "auto": the closed form for labelled sequences of Table 1 on a fixture, otherwise least squares. Other names:
        :func:`srt.estimators`.
    checks : bool
        Check for all faults of the catalogue, before the calibration and with its result, as the command does. Fatal
        faults stop the calibration; others become warnings. False: estimation alone, and a warning says so.
    force : bool
        Calibrate in spite of fatal faults.
    without_turns : sequence of str
        Turns, poses or sequences to leave out: numbers of those without an id, as "22", and ids, as "1a".
    options : Options, optional
    progress : callable, optional
        Called after every iteration with its number and the largest correction.
    **choices
        Fields of :class:`srt.Options`, instead of ``options``, and keywords of :func:`srt.read`.

    Returns
    -------
    Calibration
        With the findings among its warnings, and in ``diagnostics.faults``.

    Raises
    ------
    InputError
        Unknown estimator or option, a turn to leave out that there is not, or a source that cannot be read.
    DataError
        A fatal fault, or data that do not support a result, with the likely cause.
    """
    stated = {name: choices.pop(name) for name in READING_KEYS & set(choices)}
    options = chosen_options(options, choices)
    recording = with_protocol(read(source, **stated))
    if without_turns:
        recording, titles = leave_out(recording, without_turns)
        result = calibrate(recording, estimator, checks=checks, force=force, options=options, progress=progress)
        voided = {**dict.fromkeys(titles, "left out on request"), **result.provenance.voided}
        return replace(result, provenance=replace(result.provenance, voided=voided))
    if not checks:
        result = estimate(recording, estimator, options, progress)
        return replace(result, warnings=(*result.warnings, UNCHECKED))
    staged = StagedDiagnosis(recording, options)
    screened = staged.before_calibration()
    if screened.refusal is not None and not force:
        raise _refused(screened)
    try:
        result = estimate(recording, estimator, options, progress)
    except DataError as error:
        if screened.first is None or error.fault is not None:
            raise
        raise _caused(str(error), screened.first) from error
    diagnosis = staged.with_calibration(result)
    if diagnosis.refusal is not None and not force:
        raise _refused(diagnosis)
    told = _IN_RESULT | explained(result)
    warnings = tuple(f.sentence for f in diagnosis.findings if f.effect != "note" and f.fault not in told)
    return replace(
        result,
        warnings=(*warnings, *result.warnings),
        diagnostics=replace(result.diagnostics, faults=diagnosis.faults),
    )


def _refused(diagnosis: Diagnosis) -> DataError:
    """Error for a fatal fault, with the first finding as its cause: repeated samples also shift the labels."""
    refusal, first = diagnosis.refusal, diagnosis.first
    assert refusal is not None
    assert first is not None
    return DataError(refusal.sentence, fault=refusal.fault) if first is refusal else _caused(refusal.sentence, first)


def _caused(sentence: str, cause: Finding) -> DataError:
    return DataError(f"{sentence} The likely cause: {cause.sentence}", fault=cause.fault)


def sigmas_with_moves(recording: Recording, result: Calibration, options: Options) -> tuple[float, float] | None:
    """Smallest and largest sigma of least squares, which uses recorded moves, over that of the closed form.

    Parameters
    ----------
    recording : Recording
    result : Calibration
        Of the recording.
    options : Options

    Returns
    -------
    (float, float) or None
        Over the parameters that both estimate; None for a result without unused moves, or if least squares has none.
    """
    if not result.diagnostics.unused_moves or result.status not in USABLE:
        return None
    try:
        whole = estimate(recording, "least-squares", options)
    except SrtError:  # the closed form stands, whatever the other estimator refuses
        return None
    ratio = (whole.sigma / result.sigma)[whole.observed & result.observed]
    return (float(ratio.min()), float(ratio.max())) if whole.status in USABLE else None


def inspect(source: Any, *, deep: bool = False, **stated: Any) -> Inspection:
    """Inspect a recording: rate, gaps, noise at rest, stationary windows, rotations, recognised sequences, faults.

    Parameters
    ----------
    source : Recording, path-like, or arrays
        Recording, or what :func:`srt.read` makes one of.
    deep : bool
        Also calibrate, and look for faults that only a calibration shows.
    **stated
        Keywords of :func:`srt.read`.

    Returns
    -------
    Inspection

    Raises
    ------
    InputError
        A source that cannot be read.
    """
    from srt.diagnosis import inspection

    recording = read(source, **stated)
    units = inspection.declared_units(recording.source) if recording.source else {}
    return inspection.inspect(recording, calibrating=deep, units=units)


def noise_terms(source: Any, **stated: Any) -> NoiseTerms:
    """Fit the noise terms of a unit at rest over the longest stationary window, as ``srt noise`` does.

    Parameters
    ----------
    source : Recording, path-like, or arrays
        Recording, or what :func:`srt.read` makes one of.
    **stated
        Keywords of :func:`srt.read`; gravity has no effect on the terms.

    Returns
    -------
    NoiseTerms

    Raises
    ------
    InputError
        A source that cannot be read.
    DataError
        No stationary window of 30 s.
    """
    from srt.noise import noise_terms as fit
    from srt.sequences.rest_detection import undisturbed_rest

    recording = read(source, **stated)
    return fit.noise_terms(recording, undisturbed_rest(recording))
