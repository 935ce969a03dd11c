"""Outcomes of faults: kinds and their severities, the twin without the fault, and a run of a few kinds."""

import fault_outcomes
import numpy as np
import pytest
from fault_outcomes import OUTCOMES, Outcome, outcome_of, outcomes, table
from fault_severities import KINDS, LEAST_SHIFT, Units, halvings, severities
from injected_faults.foreign_operators import PAIRS
from injected_faults.injection import GRADES, INJECTIONS, VARIANTS

from srt.diagnosis.faults import FAULTS

SEED = 20261400


def test_kinds():
    assert len(KINDS) >= 120
    assert len(VARIANTS) * 3 >= len(KINDS)
    assert set(INJECTIONS) <= set(FAULTS)
    for kind in KINDS.values():
        assert set(kind.causes) <= set(FAULTS), kind.fault
    assert {f"{first} and {second}" for first, second in PAIRS} <= set(VARIANTS)


@pytest.mark.parametrize("kind", ["bump", "labels_exchanged", "gyro_lsb", "left_handed", "window_short", "north"])
def test_halvings_do_not_increase(kind):
    for grade in GRADES:
        steps = halvings(KINDS[kind], grade)
        assert len(steps) == 3
        away = [abs(np.log(step)) if kind == "gyro_lsb" else step for step in steps]
        assert away == sorted(away, reverse=kind != "window_short")


@pytest.mark.parametrize(
    ("kind", "grade"),
    [
        ("gyro_axis_delayed", "tactical-fog"),
        pytest.param("gravity", "industrial-mems", marks=pytest.mark.slow),
        pytest.param("gyro bias steps", "industrial-mems", marks=pytest.mark.slow),
        pytest.param("labels_shifted", "consumer-mems", marks=pytest.mark.slow),
    ],
)
def test_least_severity_shifts_one_parameter_by_3_to_5_sigma(kind, grade):
    units, injection = Units(SEED), KINDS[kind]
    harmful, (most, middle, least) = severities(injection, units, grade)
    assert harmful
    assert most > middle > least > 0.0
    assert LEAST_SHIFT[0] <= units.shift_at(injection, grade, least) <= LEAST_SHIFT[1]


def test_harmless_kinds_have_the_stated_severity():
    """A misread temperature moves no parameter of a unit without temperature coefficients."""
    injection = KINDS["temperature_unit"]
    harmful, steps = severities(injection, Units(SEED), "industrial-mems")
    assert not harmful
    assert steps == halvings(injection, "industrial-mems")


def test_outcomes_of_some_kinds():
    """One fault that is named, one that the calibration finds as an error of the sensors, one with the wrong cause."""
    units, kinds = Units(SEED), KINDS
    named = outcome_of(kinds["gyro_degrees"], units, "consumer-mems", 0, 1.0)
    assert (named.outcome, named.named) == (OUTCOMES[0], "gyro_degrees")
    found = outcome_of(kinds["offset subtracted twice"], units, "consumer-mems", 0, 0.01)
    assert found.outcome == OUTCOMES[4]
    assert 0.0 < found.shift < 3.0
    # Gyros that do not sense the Earth rate cannot tell a wrong latitude from wrong gravity.
    wrong = outcome_of(kinds["longitude for latitude"], units, "consumer-mems", 0, 1.0)
    assert (wrong.outcome, wrong.named) == (OUTCOMES[1], "gravity")


@pytest.mark.slow
def test_a_twentieth_of_the_study():
    rows = list(outcomes(list(KINDS)[::20], GRADES, SEED))
    assert len(rows) == 12 * len(list(KINDS)[::20])
    assert not [row for row in rows if row.outcome == OUTCOMES[5] and not fault_outcomes.unseen(row)]


def test_table():
    """A fault named, one in silence that could be seen and one that cannot, and another cause."""
    rows = [
        Outcome("bump", "consumer-mems", 0, 1.0, OUTCOMES[0], "bump"),
        Outcome("bump", "consumer-mems", 1, 0.5, OUTCOMES[5], "", 4.2, "gyro_scale_x"),
        Outcome("north", "consumer-mems", 0, 1.0, OUTCOMES[5], "", 9.0, "gyro_bias_x"),
        Outcome("clock fast", "navigation-rlg", 0, 1.05, OUTCOMES[1], "latitude"),
    ]
    assert list(table(rows))[2:] == [
        "| consumer-mems | 1 of 3 (33 %) | 1 of 3 (33 %) | 1 of 2 (50 %) | 0 | 0 | 0 | 0 | 2 |",
        "| navigation-rlg | 0 of 1 (0 %) | 0 of 1 (0 %) | 0 of 1 (0 %) | 1 | 0 | 0 | 0 | 0 |",
        "| all | 1 of 4 (25 %) | 1 of 4 (25 %) | 1 of 3 (33 %) | 1 | 0 | 0 | 0 | 2 |",
    ]
