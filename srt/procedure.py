"""Noise and calibration of library and command line: fault detection, estimation, checks of the result."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from srt.diagnosis.false_alarms import FALSE_ALARM
from srt.diagnosis.staged_diagnosis import StagedDiagnosis
from srt.estimation.goodness_of_fit import chi_square_probability, specification_test
from srt.estimation.options import Options, chosen_options
from srt.estimation.registry import estimate
from srt.exceptions import DataError, SrtError
from srt.ranking import significant
from srt.recording.reading import READING_KEYS, read
from srt.result.consistency import Contradiction
from srt.result.verdict import MISFIT_PROBABILITY, SOUND, USABLE, WITHOUT_VALUES, explained, modelled, p_value_text
from srt.sensor_errors import NAMES
from srt.sequences.protocol_matching import with_protocol
from srt.sequences.recognition import leave_out

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srt.diagnosis.findings import Finding
    from srt.diagnosis.fitness import Fitness
    from srt.diagnosis.staged_diagnosis import Diagnosis
    from srt.estimation.registry import Progress
    from srt.noise.noise_terms import NoiseTerms
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.result.consistency import ChiSquareTest, LeaveOneOut

UNCHECKED = (
    "The recording was not checked for faults (checks=False): units, axes, labels, timing, stationary windows and site "
    "are taken as stated."
)
"""Warning of a calibration without checks."""
_OPENING = 30
"""Characters by which two sentences on the same readings are known: "At rest the accelerometers read"."""
_IN_RESULT = frozenset({"accel_bias_drift", "sequence_missing"})
"""Faults that the result itself states: what drifts, and what is fixed, with the sequences to record."""


def calibrate(
    source: Any,
    estimator: str = "auto",
    *,
    checks: bool = True,
    force: bool = False,
    without_turns: Sequence[str | int] = (),
    options: Options | None = None,
    progress: Progress | None = None,
    announce: Callable[[Fitness], None] | None = None,
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
        Check for all faults of the catalogue, before the calibration and with its result, and compare the closed form
        with least squares, which uses recorded moves, as the command does. Fatal faults stop the calibration; others
        become warnings. False: estimation alone, and a warning says so.
    force : bool
        Calibrate in spite of fatal faults.
    without_turns : sequence of str or int
        Turns, poses or sequences to leave out: numbers of those without an id, and ids, as "1a".
    options : Options, optional
    progress : callable, optional
        Called after every iteration with its number and the largest correction.
    announce : callable, optional
        Called with the fitness of the recording before the first iteration; not without checks.
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
        A fatal fault, a recording that is not fit, or data that do not support a result, with the likely cause.
    """
    stated = {name: choices.pop(name) for name in READING_KEYS & set(choices)}
    options = chosen_options(options, choices)
    recording = with_protocol(read(source, **stated))
    if without_turns:
        recording, titles = leave_out(recording, [str(name) for name in without_turns])
        result = calibrate(
            recording, estimator, checks=checks, force=force, options=options, progress=progress, announce=announce
        )
        voided = {**dict.fromkeys(titles, "left out on request"), **result.provenance.voided}
        return replace(result, provenance=replace(result.provenance, voided=voided))
    if not checks:
        result = estimate(recording, estimator, options, progress)
        return replace(result, warnings=(*result.warnings, UNCHECKED))
    staged = StagedDiagnosis(recording, options)
    screened = staged.before_calibration()
    if screened.refusal is not None and not force:
        raise _refused(screened)
    fit = staged.fitness(estimator)
    if fit.stops and not force:
        raise DataError(f"{fit}.")
    if announce is not None:
        announce(fit)
    try:
        result = estimate(recording, estimator, options, progress)
    except DataError as error:
        if screened.first is None or error.fault is not None:
            raise
        raise _caused(str(error), screened.first) from error
    diagnosis = staged.with_calibration(result)
    if diagnosis.refusal is not None and not force:
        raise _refused(diagnosis)
    result = _without_the_worst(recording, _beside_moves(recording, result, options), estimator, options)
    told = _IN_RESULT | explained(result)
    warnings = tuple(f.sentence for f in diagnosis.findings if f.effect != "note" and f.fault not in told)
    return replace(
        result,
        warnings=(*warnings, *result.warnings),
        diagnostics=replace(result.diagnostics, faults=diagnosis.faults),
    )


def _beside_moves(recording: Recording, result: Calibration, options: Options) -> Calibration:
    """Result with what least squares, which uses the recorded moves, shows of it: gain in sigma, contradiction.

    Where that result is sound, the two are compared by the specification test of Hausman (1978).
    """
    if not result.diagnostics.unused_moves or result.status not in USABLE:
        return result
    try:
        whole = estimate(recording, "least-squares", options)
    except SrtError:  # the closed form stands, whatever the other estimator refuses
        return result
    both = whole.observed & result.observed
    if whole.status not in USABLE or not both.any():
        return result
    ratio = (whole.sigma / result.sigma)[both]
    diagnostics = replace(result.diagnostics, sigma_with_moves=(float(ratio.min()), float(ratio.max())))
    difference = (result.errors.vector - whole.errors.vector)[both]
    own, other = (found.covariance[np.ix_(both, both)] for found in (result, whole))
    p = chi_square_probability(*specification_test(difference, own, other))
    if whole.judgement.word == SOUND and p is not None and p < FALSE_ALARM:
        size = np.abs(difference) / result.sigma[both]
        most = int(np.argmax(size))
        sentence = " ".join(
            (
                f"The recorded moves contradict these values ({p_value_text(p)}; {np.array(NAMES)[both][most]} by "
                f"{size[most]:.1f} sigma): use '--estimator least-squares'.",
                *modelled(whole),
            )
        )
        diagnostics = replace(diagnostics, contradicted=(*(diagnostics.contradicted or ()), sentence))
        result = replace(result, warnings=(sentence, *result.warnings))
    return replace(result, diagnostics=diagnostics)


def _without_the_worst(recording: Recording, result: Calibration, estimator: str, options: Options) -> Calibration:
    """Result that says without which turn or sequence the others agree, of the two that they predict worst.

    Only where the residuals exceed the noise of the sensors: linearised about a gross fault, the tests of one solution
    cannot tell that of a turn from that of its neighbour, and not whether others are wrong, too.
    """
    evidence, tried = result.consistency, _fits_without(_predicted_worst(result), recording, estimator, options)
    if evidence is None or not tried:
        return result
    accused, (row, own) = evidence.contradicting, tried[-1]
    size = f"chi-square {own.chi_square:.4g} for {own.degrees_of_freedom} degrees of freedom"
    if not _agree(own):
        message = (
            f"The model does not hold at this level: without {row.title} the others disagree, too ({size}): check "
            "labels, windows and units, and whether the unit warms up."
        )
        whole = replace(result, message=message, consistency=replace(evidence, contradicting=None))
        return result if accused is None else whole
    told = (
        f"Without {row.title} the others agree ({size}): repeat it, or leave it out: '--without-turn {_name(row)}'. "
        "'--estimator graph --loss cauchy' gives it less weight."
    )
    if accused is None:
        return replace(result, warnings=(told, *result.warnings))
    found = Contradiction(sequence=row.sequence, occurrence=row.occurrence, probability=row.probability or 0.0)
    corrected = replace(result, message=told, consistency=replace(evidence, contradicting=found))
    return result if accused.title == row.title else corrected


def _agree(own: ChiSquareTest) -> bool:
    return own.probability is None or own.probability >= MISFIT_PROBABILITY


def _predicted_worst(result: Calibration) -> list[LeaveOneOut]:
    """The two turns or sequences that the others predict worst, where residuals exceed the noise of the sensors."""
    evidence = result.consistency
    if evidence is None or evidence.own_noise is None or _agree(evidence.own_noise):
        return []
    if result.status in WITHOUT_VALUES or result.diagnostics.weights is not None:
        return []
    tested = [row for row in evidence.sequences if not row.sequence.startswith("move ")]
    return sorted(tested, key=lambda row: -significant(row.chi_square))[:2]


def _fits_without(
    suspects: Sequence[LeaveOneOut], recording: Recording, estimator: str, options: Options
) -> list[tuple[LeaveOneOut, ChiSquareTest]]:
    """Agreement of the others with the noise of the sensors without each suspect, until they agree.

    Empty if they support no calibration.
    """
    out: list[tuple[LeaveOneOut, ChiSquareTest]] = []
    for row in suspects:
        try:
            evidence = estimate(leave_out(recording, [_name(row)])[0], estimator, options).consistency
        except SrtError:
            return []
        if evidence is None or evidence.own_noise is None:
            return []
        out.append((row, evidence.own_noise))
        if _agree(evidence.own_noise):
            break
    return out


def _name(row: LeaveOneOut) -> str:
    """Name of a turn, pose or sequence, by which it is left out."""
    return row.sequence.removeprefix("turn ").removeprefix("pose ")


def _refused(diagnosis: Diagnosis) -> DataError:
    """Error for a fatal fault, with the first finding as its cause: repeated samples also shift the labels."""
    refusal, first = diagnosis.refusal, diagnosis.first
    assert refusal is not None
    assert first is not None
    return DataError(refusal.sentence, fault=refusal.fault) if first is refusal else _caused(refusal.sentence, first)


def _caused(sentence: str, cause: Finding) -> DataError:
    # The estimator refuses readings at rest in the words of the fault.
    same = sentence[:_OPENING] == cause.sentence[:_OPENING]
    return DataError(cause.sentence if same else f"{sentence} The likely cause: {cause.sentence}", fault=cause.fault)


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
