"""Comparison of estimators on one recording: choice of those that can run, their runs, and the test of agreement."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from srt.comparison.estimator_comparison import compare as compare_calibrations
from srt.comparison.estimator_comparison import default_estimators, run_estimators
from srt.diagnosis import diagnose
from srt.estimation.options import Options, chosen_options
from srt.exceptions import DataError, InputError
from srt.recording.reading import READING_KEYS, read

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from srt.comparison.estimator_comparison import Comparison
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.sensor_errors import SensorErrors


def compare(
    source: Any,
    estimators: Sequence[str] = (),
    *,
    reference: str | None = None,
    truth: SensorErrors | None = None,
    options: Options | None = None,
    progress: Callable[[str, int, float], None] | None = None,
    **choices: Any,
) -> Comparison:
    """Calibrate with several estimators, and test whether they agree.

    Parameters
    ----------
    source : Recording, path-like, or arrays
        Recording, or a source that :func:`srt.read` accepts.
    estimators : sequence of str
        Two names at least; empty: all four of this package that can run here and on this recording.
    reference : str, optional
        Estimate that the others are compared with. Default: the first of graph, ekf, least-squares, closed-form.
    truth : SensorErrors, optional
        True errors of a simulated recording.
    options : Options, optional
        The same for all.
    progress : callable, optional
        Called after every iteration with the estimator, the number of the iteration and the largest correction.
    **choices
        Fields of :class:`srt.Options`, instead of ``options``, and keywords of :func:`srt.read`.

    Raises
    ------
    InputError
        Unknown estimator or option, or a source that cannot be read.
    DataError
        Fewer than two estimators that can run.
    """
    stated = {name: choices.pop(name) for name in READING_KEYS & set(choices)}
    options = chosen_options(options, choices)
    recording = read(source, **stated)
    names, left_out = runnable_estimators(recording, estimators, reference)
    calibrations, seconds, failures = run_estimators(recording, names, options, progress)
    calibrations = with_findings(recording, options, calibrations)
    return compare_calibrations(
        calibrations, reference=reference, seconds=seconds, failures=failures, left_out=left_out, truth=truth
    )


def with_findings(
    recording: Recording, options: Options, calibrations: Mapping[str, Calibration]
) -> dict[str, Calibration]:
    """Calibrations with the faults of the recording, as :func:`srt.calibrate` finds them before it calibrates."""
    faults = diagnose(recording, options, calibrating=False).faults
    return {
        name: replace(found, diagnostics=replace(found.diagnostics, faults=faults))
        for name, found in calibrations.items()
    }


def runnable_estimators(
    recording: Recording, names: Sequence[str] = (), reference: str | None = None
) -> tuple[tuple[str, ...], dict[str, str]]:
    """Names of the estimators to compare, and the reasons why others are left out.

    Parameters
    ----------
    names : sequence of str
        Names asked for; empty: all of this package that can run.

    Raises InputError: a reference that cannot run, or that is not one of the compared estimators; DataError: fewer than
    two estimators that can run.
    """
    left_out: dict[str, str] = {}
    chosen = tuple(dict.fromkeys(names))
    if not chosen:
        chosen, left_out = default_estimators(recording)
    if reference in left_out:
        raise InputError(f"The reference {reference} cannot run here: {left_out[reference]}")
    if len(chosen) < 2:
        reasons = "; ".join(f"{name} is left out: {reason.rstrip('.')}" for name, reason in left_out.items())
        named = f"only {chosen[0]} is named" if names else reasons
        raise DataError(f"Fewer than two estimators can run on {recording.source or 'this recording'}: {named}.")
    return chosen, left_out
