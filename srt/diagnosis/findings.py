"""Findings, and the registry of checks: each check declares the faults that it can name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from srt.diagnosis.faults import FAULTS, RANK, STAGES, Effect

if TYPE_CHECKING:
    from srt.diagnosis.evidence import Evidence

FALSE_ALARM: Final = 3e-6
"""False-alarm probability of each statistical test in a recording.

All checks and the selection of a drift together raise a finding in at most 1e-4 of the sound recordings. 15 tests at
this probability make 4.5e-5: lost samples; lags; oscillation, bumps, creep, noise of windows; settling; joined units;
drift of scale factors; absent Earth rate, latitude, north; drift of bias; noise of gyros and of accelerometers. The
drift in a calibration adds 2e-5, clipping 1.4e-5, vibration and rotation in windows 8e-6, repeated rows 6e-6 and spikes
5e-6. Tests of the options come on top.
"""


@dataclass(frozen=True, slots=True)
class RunnerUp:
    """Fault that explains the same data nearly as well, and by how much less: a difference of log-likelihoods."""

    fault: str
    log_likelihood_lower: float

    @property
    def sentence(self) -> str:
        """Remark for the reader."""
        title = FAULTS[self.fault].title
        return f"Nearly as likely (log-likelihood lower by {max(0.0, self.log_likelihood_lower):.2g}): {title}."


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault found in a recording.

    Attributes
    ----------
    fault : str
        Key of :data:`srt.diagnosis.faults.FAULTS`.
    sentence : str
    details : dict
        Values in the sentence, SI where the name carries no unit.
    runner_up : RunnerUp or None
        Next cause, if it explains the data nearly as well.
    """

    fault: str
    sentence: str
    details: dict[str, Any]
    runner_up: RunnerUp | None = None

    @property
    def effect(self) -> Effect:
        """Effect of the fault on the calibration."""
        return FAULTS[self.fault].effect

    @property
    def stage(self) -> str:
        """Stage of the checks that name the fault."""
        return FAULTS[self.fault].stage


def finding(fault: str, **details: Any) -> Finding:
    """Make the finding of a fault; ``details`` are the fields of its sentence."""
    return Finding(fault, FAULTS[fault].sentence.format(**details), details)


CheckFunction = Callable[["Evidence"], Iterable[Finding]]


@dataclass(frozen=True, slots=True)
class Check:
    """One check and the faults that it can name.

    Attributes
    ----------
    run : callable
        Yields the findings of one recording.
    faults : tuple of str
    stage : str
    needs_result : bool
        True: the check uses a calibration of the recording.
    """

    run: CheckFunction
    faults: tuple[str, ...]
    stage: str
    needs_result: bool


CHECKS: Final[list[Check]] = []
"""All checks; a module registers its own on import."""


def check(*faults: str, needs_result: bool = False) -> Callable[[CheckFunction], CheckFunction]:
    """Register a check that can name these faults, all of one stage.

    A check yields at most one finding for each cause: several sequences with one cause are one finding.
    """
    stages = {FAULTS[name].stage for name in faults}
    assert len(stages) == 1, "a check belongs to one stage"
    stage = stages.pop()

    def register(run: CheckFunction) -> CheckFunction:
        CHECKS.append(Check(run, faults, stage, needs_result))
        return run

    return register


def sort_by_cause(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sort findings, causes before their consequences."""
    return tuple(sorted(findings, key=lambda finding: RANK[finding.fault]))


def stage_checks(stage: str) -> list[Check]:
    """Checks of one stage."""
    assert stage in STAGES
    return [check for check in CHECKS if check.stage == stage]
