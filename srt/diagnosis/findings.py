"""Findings, and the registry of checks. Each check declares the faults that it can find."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from srt.diagnosis.faults import FAULTS, RANK, STAGES, Effect
from srt.result import diagnostics

if TYPE_CHECKING:
    from srt.diagnosis.evidence import Evidence

FALSE_ALARM: Final = 3e-6
"""False-alarm probability of each statistical test, for one recording.

All checks together report a fault in at most 1e-4 of the recordings without faults. 15 tests at this probability add up
to 4.5e-5: lost samples; lags; oscillation, bumps, creep and noise of windows; settling; joined units; drift of scale
factors; absent Earth rate, latitude and north; drift of bias; noise of gyros and of accelerometers. The detection of a
drift in a calibration adds 2e-5, clipping 1.4e-5, vibration and rotation in windows 8e-6, repeated samples 6e-6 and
spikes 5e-6. The test of an omitted asymmetry, which only runs with the option that fixes it, is not included.
"""


class RunnerUp(diagnostics.RunnerUp):
    """Fault that explains the same data nearly as well, with its sentence."""

    __slots__ = ()

    @property
    def sentence(self) -> str:
        """Sentence that names the fault and the difference."""
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
        Values in the sentence, in SI units unless the key ends in another unit.
    runner_up : RunnerUp or None
        Second most likely fault, if it explains the data nearly as well.
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
        """Stage of the checks that find the fault."""
        return FAULTS[self.fault].stage


def finding(fault: str, **details: Any) -> Finding:
    """Make the finding of a fault; ``details`` are the fields of its sentence."""
    return Finding(fault, FAULTS[fault].sentence.format(**details), details)


CheckFunction = Callable[["Evidence"], Iterable[Finding]]


@dataclass(frozen=True, slots=True)
class Check:
    """One check and the faults that it can find.

    Attributes
    ----------
    run : callable
        Function that yields the findings of one recording.
    faults : tuple of str
    stage : str
    needs_result : bool
        True if the check uses a calibration of the recording.
    """

    run: CheckFunction
    faults: tuple[str, ...]
    stage: str
    needs_result: bool


CHECKS: Final[list[Check]] = []
"""All checks; a module registers its checks on import."""


def check(*faults: str, needs_result: bool = False) -> Callable[[CheckFunction], CheckFunction]:
    """Register a check that can find these faults, which must be of one stage.

    A check yields at most one finding for each cause, also if the cause affects several sequences.
    """
    stages = {FAULTS[name].stage for name in faults}
    assert len(stages) == 1, "the faults of a check must be of one stage"
    stage = stages.pop()

    def register(run: CheckFunction) -> CheckFunction:
        CHECKS.append(Check(run, faults, stage, needs_result))
        return run

    return register


def sort_by_cause(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sort findings in the order of the catalogue: each fault before the faults that it causes."""
    return tuple(sorted(findings, key=lambda finding: RANK[finding.fault]))


def stage_checks(stage: str) -> list[Check]:
    """Checks of one stage."""
    assert stage in STAGES
    return [check for check in CHECKS if check.stage == stage]
