"""Run the checks, cause by cause: what an earlier stage refuses would only mislead the later ones."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from srt.diagnosis.evidence import Evidence, plain
from srt.diagnosis.faults import FAULTS, STAGES
from srt.diagnosis.findings import Finding, checks_of, found, in_order

if TYPE_CHECKING:
    from srt.calibration import Calibration
    from srt.exceptions import SrtError
    from srt.options import Options
    from srt.recording import Recording

_MODULES: Final = ("timing", "channels", "units", "ranges", "frames", "sequences", "windows", "motion", "site", "unit")
"""Modules of this package that hold checks, one for each stage or part of one."""


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


def load_checks() -> None:
    """Import the modules that register checks."""
    for name in _MODULES:
        import_module(f"srt.diagnosis.{name}")


def diagnose(
    recording: Recording,
    options: Options | None = None,
    *,
    result: Calibration | None = None,
    calibrating: bool = True,
) -> Diagnosis:
    """Look for every fault of the catalogue.

    Parameters
    ----------
    recording : Recording
    options : Options, optional
        Of the calibration that the last stages look at.
    result : Calibration, optional
        That calibration, if there is one already.
    calibrating : bool
        False: only what needs no calibration.

    Returns
    -------
    Diagnosis
    """
    load_checks()
    evidence = Evidence(recording, options, result)
    findings: list[Finding] = []
    for stage in STAGES:
        for registered in checks_of(stage):
            if registered.needs_result and not calibrating:
                continue
            findings += registered.run(evidence)
        if any(f.effect.startswith("exit") for f in findings):
            break
    return Diagnosis(in_order(findings))


def from_error(error: SrtError) -> Diagnosis:
    """Diagnosis of a recording that reading refused, where the refusal is in the catalogue."""
    if error.fault is None:
        return Diagnosis(())
    assert error.fault in FAULTS
    return Diagnosis((found(error.fault, message=str(error)),))
