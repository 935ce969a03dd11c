"""Causes compared by likelihood: the right one of patterns that overlap, the runner-up where two fit alike."""

import math
from dataclasses import asdict

import numpy as np
import pytest

from srt.diagnosis.cause_comparison import CLOSE, Cause, compare
from srt.diagnosis.faults import FAULTS
from srt.diagnosis.findings import with_runner_up
from srt.diagnosis.staged_diagnosis import Diagnosis
from srt.reports.text.inspection import runner_up_sentence
from srt.result.diagnostics import RunnerUp
from srt.result.document import to_document

N = 12
ALL = Cause("sensor_time_offset", np.ones((N, 1)), {})
ONE = Cause("gyro_axis_delayed", np.repeat([[1.0], [0.0]], N // 2, axis=0), {}, choices=3)
NOTHING = Cause("", np.zeros((N, 0)), {})
TOLD = FAULTS["sensor_time_offset"].found(offset_ms=5.0)


def test_the_pattern_that_made_the_residuals_is_first_and_has_its_value():
    rng = np.random.default_rng(5)
    for true in (ALL, ONE):
        values = true.columns @ [3.0] + rng.standard_normal(N)
        best = compare(values, (NOTHING, ALL, ONE))[0]
        assert best.cause is true
        # t of 11 degrees of freedom: 1e-4 of all samples lie beyond 5.9 sigmas.
        assert abs(best.value[0] - 3.0) < 5.9 * best.sigma[0]


def test_a_parameter_that_explains_nothing_costs():
    values = np.tile([1.0, -1.0], N // 2)
    explained = compare(values, (ALL, NOTHING))
    assert explained[0].cause is NOTHING
    assert explained[0].score - explained[1].score == pytest.approx(0.5 * math.log(N))


def test_columns_of_the_nuisance_explain_nothing_twice():
    values = np.random.default_rng(6).standard_normal(N) + 100.0
    found = compare(values, (NOTHING, ALL), nuisance=np.ones((N, 1)))
    assert found[0].cause is NOTHING
    assert found[0].freedom == N - 1
    assert found[0].square == pytest.approx(np.sum((values - values.mean()) ** 2))


def test_a_close_runner_up_is_told_and_a_distant_one_is_not():
    values = 1e-3 * np.random.default_rng(7).standard_normal(N) + 1.0
    assert with_runner_up(TOLD, compare(values, (NOTHING, ALL, ONE))).runner_up is None
    alike = Cause("gyro_axis_delayed", ALL.columns, {}, choices=3)
    told = with_runner_up(TOLD, compare(values, (NOTHING, ALL, alike)))
    assert told.runner_up == RunnerUp("gyro_axis_delayed", pytest.approx(math.log(3.0)))
    assert math.log(3.0) < CLOSE
    assert "One gyro axis has another delay" in runner_up_sentence(told.runner_up)
    (fault,) = Diagnosis((told,)).faults
    assert to_document(fault)["runner_up"] == asdict(told.runner_up)
