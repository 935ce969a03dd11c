"""Run the checks, cause by cause: what an earlier stage refuses would only mislead the later ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from srt.diagnosis import (
    axes,
    channels,
    clipping,
    imu_properties,
    sensor_synchronisation,
    sequences,
    site,
    timing,
    units,
    window_disturbances,
)
from srt.diagnosis.evidence import Evidence, plain
from srt.diagnosis.faults import FAULTS, STAGES
from srt.diagnosis.findings import Finding, finding, sort_by_cause, stage_checks

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.exceptions import SrtError
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.sequences.recognition import Recognition

_MODULES: Final = (
    timing,
    channels,
    units,
    clipping,
    axes,
    sequences,
    window_disturbances,
    sensor_synchronisation,
    site,
    imu_properties,
)
"""Modules with checks, which register themselves on import."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All that was found wrong with a recording.

    Attributes
    ----------
    findings : tuple of Finding
        Causes before consequences.
    """

    findings: tuple[Finding, ...]

    @property
    def first(self) -> Finding | None:
        """The first cause; None for a sound recording. Notes are no causes."""
        return next((f for f in self.findings if f.effect != "note"), None)

    @property
    def refusal(self) -> Finding | None:
        """The first finding with which no calibration makes sense."""
        return next((f for f in self.findings if f.effect.startswith("exit")), None)

    def as_dicts(self) -> list[dict[str, Any]]:
        """Findings as JSON values."""
        return [
            {
                "fault": f.fault,
                "effect": f.effect,
                "sentence": f.sentence,
                "details": {name: plain(value) for name, value in f.details.items()},
            }
            for f in self.findings
        ]


class StagedDiagnosis:
    """Checks of one recording, in two parts: before a calibration, and with one.

    Parameters
    ----------
    recording : Recording
    options : Options, optional
        Of the calibration.
    recognition : Recognition, optional
        Of the recording, if it was made already.
    """

    def __init__(
        self, recording: Recording, options: Options | None = None, recognition: Recognition | None = None
    ) -> None:
        self.evidence = Evidence(recording, options)
        if recognition is not None:
            self.evidence.recognition = recognition
        self._findings: list[Finding] = []

    def before_calibration(self) -> Diagnosis:
        """Run all checks that need no calibration, up to the first stage that refuses the recording."""
        for stage in STAGES:
            for registered in stage_checks(stage):
                if not registered.needs_result:
                    self._findings += registered.run(self.evidence)
            if self._refused:
                break
        return Diagnosis(sort_by_cause(self._findings))

    def with_calibration(self, result: Calibration | None = None) -> Diagnosis:
        """Run the checks that look at a calibration, of this recording and these options; it is made if not given."""
        if not self._refused:
            if result is not None:
                self.evidence.result = result
            for stage in STAGES:
                for registered in stage_checks(stage):
                    if registered.needs_result:
                        self._findings += registered.run(self.evidence)
        return Diagnosis(sort_by_cause(self._findings))

    @property
    def _refused(self) -> bool:
        return any(f.effect.startswith("exit") for f in self._findings)


def diagnose(
    recording: Recording,
    options: Options | None = None,
    *,
    calibrating: bool = True,
    recognition: Recognition | None = None,
) -> Diagnosis:
    """Look for every fault of the catalogue.

    Parameters
    ----------
    recording : Recording
    options : Options, optional
        Of the calibration that the last checks look at.
    calibrating : bool
        False: only what needs no calibration.
    recognition : Recognition, optional
        Of the recording, if it was made already.

    Returns
    -------
    Diagnosis
    """
    examination = StagedDiagnosis(recording, options, recognition)
    screened = examination.before_calibration()
    return examination.with_calibration() if calibrating else screened


def from_error(error: SrtError) -> Diagnosis:
    """Diagnosis of a recording that reading refused, where the refusal is in the catalogue."""
    if error.fault is None:
        return Diagnosis(())
    assert error.fault in FAULTS
    return Diagnosis((finding(error.fault, message=str(error)),))
