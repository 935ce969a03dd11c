"""Diagnosis in stages. A fatal fault ends the diagnosis, because it would cause wrong findings in later stages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from srt.arguments import require_type
from srt.diagnosis.evidence import Evidence, plain
from srt.diagnosis.faults import STAGES, sort_by_cause
from srt.diagnosis.fitness import fitness
from srt.diagnosis.units import refuted
from srt.recording.recording import Recording
from srt.result.diagnostics import Fault

if TYPE_CHECKING:
    from srt.diagnosis.findings import Finding
    from srt.diagnosis.fitness import Fitness
    from srt.estimation.options import Options
    from srt.result.calibration import Calibration
    from srt.result.verdict import Verdict
    from srt.sequences.recognition import Recognition


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Faults found in a recording.

    ``findings`` are in the order of the catalogue: each fault before the faults that it causes. ``judgement`` is the
    verdict on the calibration of the recording; None without a calibration.
    """

    findings: tuple[Finding, ...]
    judgement: Verdict | None = None

    @property
    def first(self) -> Finding | None:
        """First finding that is not a note; None for a recording without faults."""
        return next((f for f in self.findings if f.effect != "note"), None)

    @property
    def refusal(self) -> Finding | None:
        """First finding of a fatal fault; None if the recording can be calibrated."""
        return next((f for f in self.findings if f.effect.startswith("exit")), None)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Findings as a result states them."""
        return tuple(
            Fault(
                fault=f.fault,
                effect=f.effect,
                sentence=f.sentence,
                details={name: plain(value) for name, value in f.details.items()},
                runner_up=f.runner_up,
            )
            for f in self.findings
        )


class StagedDiagnosis:
    """Diagnosis of one recording, before and after its calibration; ``recognition`` if it is known already."""

    def __init__(
        self, recording: Recording, options: Options | None = None, recognition: Recognition | None = None
    ) -> None:
        self.evidence = Evidence(recording, options)
        if recognition is not None:
            self.evidence.recognition = recognition
        self._findings: list[Finding] = []

    def before_calibration(self) -> Diagnosis:
        """Run the checks that need no calibration, up to the first stage with a fatal fault."""
        for stage in STAGES.values():
            for check in stage.checks(of_result=False):
                self._findings += check(self.evidence)
            if self._refused:
                break
        return Diagnosis(sort_by_cause(self._findings))

    def fitness(self, estimator: str = "auto") -> Fitness:
        """Fitness of the recording for a calibration by an estimator; after :meth:`before_calibration`."""
        refusal = Diagnosis(sort_by_cause(self._findings)).refusal
        return fitness(self.evidence, refusal, estimator)

    def with_calibration(self, result: Calibration | None = None) -> Diagnosis:
        """Run the checks that need a calibration of this recording with these options; None computes one."""
        if not self._refused:
            if result is not None:
                self.evidence.result = result
            for stage in STAGES.values():
                for check in stage.checks(of_result=True):
                    self._findings += check(self.evidence)
            self._findings = [each for each in self._findings if not refuted(self.evidence, each)]
        found = None if self._refused else self.evidence.result
        return Diagnosis(sort_by_cause(self._findings), None if found is None else found.judgement)

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
    """Find the faults of a recording.

    Parameters
    ----------
    recording : Recording
    options : Options, optional
        Options of the calibration that the last checks use.
    calibrating : bool
        False to run only the checks that need no calibration.
    recognition : Recognition, optional
        Sequences recognised in the recording, if known already.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        Anything but a recording.
    """
    require_type("diagnose", "a recording (srt.read makes one of arrays)", recording, Recording)
    examination = StagedDiagnosis(recording, options, recognition)
    screened = examination.before_calibration()
    return examination.with_calibration() if calibrating else screened
