"""Parts that the tests of the diagnosis share: the checks of some stages alone, on what is labelled."""

from functools import cache, cached_property
from itertools import count, product

import pytest
from injected_faults.injection import GRADES, Case

from srt.diagnosis.evidence import Evidence
from srt.diagnosis.faults import STAGES, sort_by_cause

case_of = cache(Case)
"""Unit of a grade and a seed, simulated once."""


class WithoutRecognition(Evidence):
    """Evidence of what is labelled alone."""

    @cached_property
    def recognition(self):
        return None


def findings_of_stage(evidence, stage, *, calibrating=True):
    """Findings of all checks of a stage, or of those alone that need no calibration."""
    checks = [
        check for of_result in (False, True)[: 1 + calibrating] for check in STAGES[stage].checks(of_result=of_result)
    ]
    return [finding for check in checks for finding in check(evidence)]


def examine_stages(recording, stages, *, options=None, calibrating=True):
    """Findings of some stages, the first cause first."""
    evidence, out = WithoutRecognition(recording, options), []
    for stage in stages:
        out += findings_of_stage(evidence, stage, calibrating=calibrating)
        if any(finding.effect.startswith("exit") for finding in out):
            break
    return sort_by_cause(out)


def grades_and_faults(faults):
    """Parameters ``grade`` and ``fault``: every fault with every second grade, in turns.

    Every nineteenth of the other pairs is slow, which takes the grades in turns; the rest are a campaign.
    """
    pairs, others = [], count()
    for (i, fault), (k, grade) in product(enumerate(faults), enumerate(GRADES)):
        marks = []
        if (i + k) % 2:
            marks = [pytest.mark.campaign if next(others) % 19 else pytest.mark.slow]
        pairs.append(pytest.param(grade, fault, id=f"{grade}-{fault}", marks=marks))
    return pytest.mark.parametrize(("grade", "fault"), pairs)


def every_second_grade(first):
    """Values of ``grade``: every second one from the first or the second on; with ``slow`` the others, too."""
    return [pytest.param(grade, marks=[pytest.mark.slow] * ((k + first) % 2)) for k, grade in enumerate(GRADES)]
