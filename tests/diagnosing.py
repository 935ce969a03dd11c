"""Parts that the tests of the diagnosis share: the checks of some stages alone, on what is labelled."""

from __future__ import annotations

from functools import cached_property

from srt.diagnosis.evidence import Evidence
from srt.diagnosis.findings import sort_by_cause, stage_checks


class WithoutRecognition(Evidence):
    """Evidence of what is labelled alone."""

    @cached_property
    def recognition(self):
        return None


def examine_stages(recording, stages):
    """Findings of some stages, the first cause first."""
    evidence, out = WithoutRecognition(recording), []
    for stage in stages:
        for registered in stage_checks(stage):
            out += registered.run(evidence)
        if any(finding.effect.startswith("exit") for finding in out):
            break
    return sort_by_cause(out)
