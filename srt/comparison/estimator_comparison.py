"""Comparison of estimators on one recording, with a test of their agreement.

The statistics of a difference are those of :mod:`srt.comparison.estimate_difference`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.comparison.estimate_difference import (
    FALSE_ALARM,
    EstimateDifference,
    estimate_difference,
    finite,
    joined,
    listing,
    modelled_effects,
    ratio_of,
    verdicts_differ,
)
from srt.estimation.fixed_parameters import in_frame_of_poses
from srt.estimation.options import Options
from srt.estimation.registry import ESTIMATORS, automatic_estimator, find_estimator
from srt.exceptions import DataError, InputError, SrtError
from srt.presentation import Presented
from srt.result.document import to_document
from srt.result.json_file import save_json_file
from srt.result.verdict import DOUBTFUL, USABLE
from srt.sensor_errors import NAMES, SYMBOLS, UNITS
from srt.sequences.recognition import label_sequences

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.types import Array, Mask

    Progress = Callable[[str, int, float], None]
    from collections.abc import Callable, Iterable, Mapping
    from os import PathLike

    from srt.sensor_errors import SensorErrors


def default_estimators(recording: Recording) -> tuple[tuple[str, ...], dict[str, str]]:
    """Estimators of this distribution that can run on this recording, and the reasons of the others.

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
    recording: Recording, names: Sequence[str], options: Options | None = None, progress: Progress | None = None
) -> tuple[dict[str, Calibration], dict[str, float], dict[str, str]]:
    """Calibrate one recording with several estimators; one that fails does not stop the others.

    Parameters
    ----------
    options : Options, optional
        The same for all.
    progress : callable, optional
        Called after every iteration with the name of the estimator, its number and the largest correction.

    Returns
    -------
    calibrations : dict of str to Calibration
    seconds : dict of str to float
        Run time of every estimator, without the import of its module.
    failures : dict of str to str
        Reasons of the estimators without a result.

    Raises InputError: an estimator that is not registered, or whose packages are not installed.
    """
    recording, recognition = label_sequences(recording)
    calibrations: dict[str, Calibration] = {}
    seconds: dict[str, float] = {}
    failures: dict[str, str] = {}
    found = {name: find_estimator(name) for name in names}  # imported before the run times are measured
    options = in_frame_of_poses(recording, options or Options())
    for name, estimator in found.items():
        started = perf_counter()
        try:
            result = estimator(recording, options, None if progress is None else partial(progress, name))
            calibrations[name] = result if recognition is None else recognition.told_in(result)
        except SrtError as error:
            failures[name] = str(error)
        seconds[name] = perf_counter() - started
    return calibrations, seconds, failures


FORMAT: Final = "srt-comparison"
VERSION: Final = 1


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Comparison(Presented):
    """Calibrations of one recording side by side.

    Attributes
    ----------
    calibrations : mapping of str to Calibration
        By the estimator's name, whatever their status.
    reference : str or None
        The estimate taken as efficient; None if none is usable.
    differences : mapping of str to EstimateDifference
        Difference of every other usable estimate from the reference.
    seconds : mapping of str to float
    failures, left_out : mapping of str to str
        Estimators that ran without a result, and those that were not run, with the reason in a sentence.
    """

    calibrations: Mapping[str, Calibration]
    reference: str | None
    differences: Mapping[str, EstimateDifference]
    seconds: Mapping[str, float] = field(default_factory=dict)
    failures: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    truth: SensorErrors | None = None
    notes: tuple[str, ...] = ()

    @property
    def agree(self) -> bool:
        """True if there are at least two usable estimates and all agree with the reference."""
        return bool(self.differences) and all(pair.agrees for pair in self.differences.values())

    @property
    def complete(self) -> bool:
        """True if every estimator that ran gave a usable result."""
        return not self.failures and all(c.status in USABLE for c in self.calibrations.values())

    @property
    def verdicts_differ(self) -> str:
        """Sentence on usable estimates of which some are doubtful and others sound; empty if all have one verdict."""
        return verdicts_differ({name: c for name, c in self.calibrations.items() if c.status in USABLE})

    @property
    def verdict(self) -> str:
        """Agreement of the estimates in a sentence."""
        if self.reference is None:
            return "There is nothing to compare: no estimator gave a usable result."
        if not self.differences:
            return f"There is nothing to compare: only {self.reference} gave a usable result."
        if not self.agree:
            ordered = sorted(self.differences.values(), key=lambda pair: pair.agrees)
            return "; ".join(pair.sentence() for pair in ordered) + "."
        worst = max(self.differences.values(), key=lambda pair: float(np.nanmax(np.abs(pair.normalised))))
        assert worst.largest is not None
        return (
            f"{joined([self.reference, *self.differences])} agree: largest difference "
            f"{abs(worst.normalised[worst.largest]):.1f} times its expected standard deviation "
            f"({NAMES[worst.largest]} of {worst.estimator}; limit {worst.limit:.1f})."
        )

    def error_over_sigma(self, name: str) -> Array:
        """Error of an estimate over its sigma, shape (27,); NaN where fixed, or without a truth."""
        true = np.nan if self.truth is None else self.truth.vector
        return ratio_of(self.calibrations[name].values - true, self.calibrations[name].sigma)

    def rms_error(self, name: str) -> float:
        """Root mean square of error over sigma of an estimate; NaN without a truth."""
        ratio = self.error_over_sigma(name)
        seen = ratio[np.isfinite(ratio)]
        return float(np.sqrt(np.mean(seen**2))) if seen.size else math.nan

    def as_dict(self) -> dict[str, Any]:
        """The JSON form: SI, in the order of the parameters; None for absent values, and no NaN."""
        origin: dict[str, Any] = next((to_document(c.provenance) for c in self.calibrations.values()), {})
        kept = ("data_sha256", "serial", "date", "software", "options")
        return {
            "format": FORMAT,
            "version": VERSION,
            "verdict": self.verdict,
            "agree": self.agree,
            "verdicts_differ": self.verdicts_differ or None,
            "reference": self.reference,
            "false_alarm_probability": FALSE_ALARM,
            "notes": list(self.notes),
            "parameters": [{"name": n, "symbol": s, "unit": u} for n, s, u in zip(NAMES, SYMBOLS, UNITS, strict=True)],
            "truth": None if self.truth is None else self.truth.vector.tolist(),
            "estimators": [self._estimate_dict(name) for name in self.calibrations],
            "failed": [{"name": name, "message": text} for name, text in self.failures.items()],
            "left_out": [{"name": name, "message": text} for name, text in self.left_out.items()],
            "provenance": {k: v for k, v in origin.items() if k in kept},
        }

    def save(self, path: str | PathLike[str]) -> None:
        """Write the JSON form, whole or not at all. Raises InputError if the path cannot be written."""
        save_json_file(path, self.as_dict())

    def _estimate_dict(self, name: str) -> dict[str, Any]:
        calibration, pair = self.calibrations[name], self.differences.get(name)
        return {
            "name": name,
            "status": calibration.status,
            "message": calibration.message,
            "judgement": calibration.judgement.word,
            "reason": calibration.judgement.reason,
            "playbacks": len(calibration.corrections),
            "seconds": self.seconds.get(name),
            "observed": int(calibration.observed.sum()),
            "value": finite(calibration.values),
            "sigma": finite(calibration.sigma),
            "held": dict(calibration.fixed),
            "error_over_sigma": None if self.truth is None else finite(self.error_over_sigma(name)),
            "comparison": None if pair is None else pair.as_dict(),
        }


def compare(
    calibrations: Mapping[str, Calibration],
    *,
    reference: str | None = None,
    seconds: Mapping[str, float] | None = None,
    failures: Mapping[str, str] | None = None,
    left_out: Mapping[str, str] | None = None,
    truth: SensorErrors | None = None,
) -> Comparison:
    """Compare calibrations of one recording.

    Parameters
    ----------
    calibrations : mapping of str to Calibration
        By any names; they appear in that order.
    reference : str, optional
        Estimate that is taken as efficient. Default: graph, ekf, least-squares, closed-form, others in their order; the
        first that is usable.
    seconds : mapping of str to float, optional
        Run time of each.
    failures, left_out : mapping of str to str, optional
        Estimators without a result, and those not run, with the reason.

    Raises
    ------
    InputError
        A reference that is not among them, or calibrations of different recordings.
    """
    failures = dict(failures or {})
    known = [*calibrations, *failures]
    if reference is not None and reference not in known:
        raise InputError(f"The reference {reference!r} is not among the estimators compared: {', '.join(known)}.")
    if len({c.provenance.data_sha256 for c in calibrations.values()} - {None}) > 1:
        raise InputError("The calibrations are of different recordings (data_sha256), and cannot be compared.")
    usable = [name for name, c in calibrations.items() if c.status in USABLE]
    chosen = reference if reference in usable else min(usable, key=_rank, default=None)
    pairs: dict[str, EstimateDifference] = {}
    if chosen is not None:
        others = {name: calibrations[name] for name in usable if name != chosen}
        shared = {name: _shared(c, calibrations[chosen]) for name, c in others.items()}
        count = sum(int(mask.sum()) for mask in shared.values())
        for name, other in others.items():
            pairs[name] = estimate_difference(
                name, other, chosen, calibrations[chosen], shared=shared[name], tests=count, estimators=len(others)
            )
    return Comparison(
        calibrations={name: c.as_written for name, c in calibrations.items()},
        reference=chosen,
        differences=pairs,
        seconds=dict(seconds or {}),
        failures=failures,
        left_out=dict(left_out or {}),
        truth=truth,
        notes=tuple(_notes(calibrations, reference, chosen, pairs)),
    )


def _rank(name: str) -> int:
    """Rank by efficiency, the most efficient first; unknown estimators last."""
    return -ESTIMATORS.index(name) if name in ESTIMATORS else 1


def _shared(a: Calibration, b: Calibration) -> Mask:
    """Parameters that two calibrations observed, with a positive sigma; that of a fixed one is NaN."""
    mask: Mask = (a.sigma > 0.0) & (b.sigma > 0.0)
    return mask


def _notes(
    calibrations: Mapping[str, Calibration],
    wanted: str | None,
    chosen: str | None,
    differences: Mapping[str, EstimateDifference],
) -> Iterable[str]:
    """Remarks on the verdict, in sentences."""
    if wanted is not None and chosen not in (wanted, None):
        yield f"The reference asked for, {wanted}, gave no usable result; it is {chosen} instead."
    for name, calibration in calibrations.items():
        if calibration.status not in USABLE:
            status = calibration.status.replace("_", " ")
            yield f"{name} is not compared, because its status is {status}: {calibration.message}"
        elif calibration.consistency and calibration.judgement.word == DOUBTFUL:
            yield f"{name} is doubtful: {calibration.judgement.reason}"
    for name, pair in differences.items():
        if pair.smaller_sigma:
            enlarged = modelled_effects(calibrations[pair.reference]).enlarged
            reason = "has sigmas that its residuals have enlarged" if enlarged else "is not efficient for them"
            yield (
                f"{name} reports a smaller sigma than {pair.reference} for {listing(pair.smaller_sigma)}: "
                f"{pair.reference} {reason}."
            )
    usable = [name for name in calibrations if name in differences or name == chosen]
    alone: dict[tuple[str, ...], list[str]] = {}
    for parameter in NAMES:
        holders = tuple(name for name in usable if parameter in calibrations[name].fixed)
        if holders and holders != tuple(usable):
            alone.setdefault(holders, []).append(parameter)
    for holders, parameters in alone.items():
        yield f"Fixed by {joined(holders)} and not by the others: {listing(parameters)}."
