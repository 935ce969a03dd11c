"""Faults, and the findings of a recording. A check is a function of the evidence that yields findings."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from srt.diagnosis.cause_comparison import CLOSE
from srt.result.diagnostics import RunnerUp

if TYPE_CHECKING:
    from srt.diagnosis.cause_comparison import Explanation
    from srt.diagnosis.evidence import Evidence

Effect = Literal["exit 2", "exit 1", "warning", "note"]
"""Refused on reading; refused by the calibration; calibrated with a warning; reported only by ``srt inspect``."""

Check = Callable[["Evidence"], Iterator["Finding"]]
"""Search for one fault or for several related ones, with at most one finding for each cause."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault that a recording can have.

    ``name`` is the key for scripts and files, ``title`` the fault in a few words, ``criterion`` the data that show it,
    ``message`` the sentence of what was found, where, what is expected, and what to do, with the fields of a finding in
    braces, and ``check`` the check that finds it, None if the reader refuses it. A check with ``needs_result`` uses a
    calibration of the recording.
    """

    name: str
    title: str
    criterion: str
    message: str
    effect: Effect
    check: Check | None = None
    needs_result: bool = False

    def found(self, **details: Any) -> Finding:
        """Finding of the fault; ``details`` are the fields of its message."""
        return Finding(self, details)


def by_sensor(name: str, title: str, criterion: str, message: str, effect: Effect, check: Check) -> dict[str, Fault]:
    """Fault of the gyros and fault of the accelerometers; a text in brackets is ``[of gyros|of accelerometers]``."""
    out = {}
    for n, sensor in enumerate(("gyro", "accel"), 1):
        own = [re.sub(r"\[(.*?)\|(.*?)\]", rf"\{n}", text) for text in (title, criterion, message)]
        out[sensor] = Fault(f"{sensor}_{name}", own[0], own[1], own[2], effect, check)
    return out


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault found in a recording.

    ``details`` are the values in the sentence, in SI units unless the key ends in another unit. ``runner_up`` is the
    second most likely fault, if it explains the data nearly as well.
    """

    cause: Fault
    details: dict[str, Any]
    runner_up: RunnerUp | None = None

    @property
    def fault(self) -> str:
        """Name of the fault."""
        return self.cause.name

    @property
    def sentence(self) -> str:
        """Message of the fault with the values of this recording."""
        return self.cause.message.format(**self.details)

    @property
    def effect(self) -> Effect:
        """Effect of the fault on the calibration."""
        return self.cause.effect


def with_runner_up(finding: Finding, ranked: list[Explanation]) -> Finding:
    """Finding with the most likely other fault added, if that fault is nearly as likely."""
    own = next(e.score for e in ranked if e.cause.fault == finding.fault)
    for other in ranked:
        if other.cause.fault not in ("", finding.fault) and own - other.score < CLOSE:
            return replace(finding, runner_up=RunnerUp(other.cause.fault, own - other.score))
    return finding
