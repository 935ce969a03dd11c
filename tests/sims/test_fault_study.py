"""Study of faults, and the outcomes of its runs."""

import math

import fault_outcomes
import faults
import pytest
from fault_outcomes import OUTCOMES, Outcome, outcome_of, outcomes, table
from fault_severities import (
    ALL_OR_NOTHING,
    FACTORS,
    KINDS,
    LEAST_ONE,
    LEAST_SHIFT,
    SHARES,
    Units,
    halvings,
    severities,
    severity_at,
)
from faults import CLEAN, NOTHING, FaultStudy, missed_targets, page, trials
from hypothesis import given
from hypothesis import strategies as st
from injected_faults.foreign_operators import PAIRS
from injected_faults.injection import GRADES, INJECTIONS, VARIANTS, Injection

from srt.diagnosis.faults import FAULTS
from srt.exceptions import InputError

FIRST, SECOND = GRADES[:2]


def injection(fault, severity, unit="m", unseen=None):
    return Injection(fault, lambda case, severity, rng: None, severity, unit, unseen=unseen or {})


@pytest.fixture
def ran(monkeypatch):
    """Trials that were run, of two faults of which the smallest severity named is known."""
    catalogue = {
        "bump": injection("bump", {FIRST: 8.0, SECOND: 8.0}),
        "north": injection("north", {FIRST: 3.0}, unseen={SECOND: "It is too dark."}),
    }
    smallest = {("bump", FIRST): 2.0, ("bump", SECOND): 9.0, ("north", FIRST): 3.0}
    done = []

    def stand_in(grade, seed, asked):
        rows = []
        for fault, severity in asked:
            if fault == CLEAN:
                cause = "spikes" if (grade, seed) == (FIRST, 1) else NOTHING
            else:
                # Below the smallest one a unit here and there is named all the same.
                cause = fault if severity >= smallest[fault, grade] or seed % 7 == 0 else "creep"
            rows.append((fault, grade, severity, seed, cause))
        done.extend(row[:4] for row in rows)
        return rows

    monkeypatch.setattr(faults, "INJECTIONS", catalogue)
    monkeypatch.setattr(faults, "trials", stand_in)
    return done


def study(path, **changes):
    return FaultStudy(path, grades=(FIRST, SECOND), **({"injections": 50, "clean": 3} | changes))


def test_smallest_severity_and_counts(tmp_path, ran):
    run = study(tmp_path / "results")
    run.run()
    pairs = {(pair.fault, pair.grade): pair for pair in run.detections()}
    bump, missed, north, dark = (
        pairs[key] for key in (("bump", FIRST), ("bump", SECOND), ("north", FIRST), ("north", SECOND))
    )
    assert (bump.causes, bump.smallest, bump.seen) == ({"bump": 50}, 2.0, True)
    assert (missed.causes, missed.smallest, missed.seen) == ({"bump": 8, "creep": 42}, None, False)
    assert (north.smallest, north.seen) == (3.0, True)
    assert (dark.severity, dark.seen) == (None, False)
    assert run.alarms(FIRST) == (3, {"spikes": 1})
    assert run.alarms(SECOND) == (3, {})
    # A rung that is not seen is given up after its first few units.
    assert len([1 for fault, _, severity, _ in ran if (fault, severity) == ("north", 1.5)]) < faults.LADDER_UNITS


def test_an_interrupted_study_goes_on(tmp_path, ran, monkeypatch):
    """Stopped after any unit, it runs the other trials, each once, and the result is the same."""
    whole = study(tmp_path / "whole")
    whole.run()
    expected, every = list(whole.detections()), sorted(ran)
    assert len(every) == len(set(every))
    stand_in = faults.trials
    for units in (0, 20, 60):
        ran.clear()
        left = iter(range(units))

        def stopped(*task, left=left):
            if next(left, None) is None:
                raise KeyboardInterrupt
            return stand_in(*task)

        monkeypatch.setattr(faults, "trials", stopped)
        with pytest.raises(KeyboardInterrupt):
            study(tmp_path / str(units)).run()
        monkeypatch.setattr(faults, "trials", stand_in)
        resumed = study(tmp_path / str(units))
        resumed.run()
        assert list(resumed.detections()) == expected
        assert sorted(ran) == every


def test_a_severity_that_is_stated_anew_is_run_anew(tmp_path, ran, monkeypatch):
    path = tmp_path / "results"
    study(path).run()
    monkeypatch.setitem(faults.INJECTIONS, "bump", injection("bump", {FIRST: 4.0, SECOND: 20.0}))
    run = study(path)
    # A detection at 4 was found on the way from 8, with fewer units.
    assert [pair.causes.total() for pair in run.detections()] == [faults.LADDER_UNITS, 0, 50, 0]
    ran.clear()
    run.run()
    assert {fault for fault, *_ in ran} == {"bump"}
    assert [pair.smallest for pair in run.detections()] == [2.0, 10.0, 3.0, None]


def test_the_file_of_something_else_is_refused(tmp_path, ran):
    path = tmp_path / "results"
    path.write_text("no results\n" * 100, encoding="utf-8")
    with pytest.raises(InputError, match="holds no results of this study"):
        study(path)
    assert path.read_text(encoding="utf-8") == "no results\n" * 100


def test_the_tables(tmp_path, ran):
    run = study(tmp_path / "results")
    run.run()
    lines = list(page(run))
    assert f"| `bump` | {FAULTS['bump'].effect} | 8 m: 50/50; ≥ 2 | 8 m: 8/50; none seen |" in lines
    assert f"| `north` | {FAULTS['north'].effect} | 3 m: 50/50; ≥ 3 | unseen |" in lines
    assert f"- `north`, {SECOND}: It is too dark." in lines
    assert f"- `bump`, {SECOND}, named otherwise: 42 creep" in lines
    assert f"| {FIRST} | 3 | 1 | 1 spikes |" in lines
    assert list(missed_targets(run)) == [
        f"bump, {SECOND}: 8 of 50 named",
        "1 of 6 clean recordings raise a finding",
    ]


@given(
    stated=st.floats(1.5, 1e3),
    unit=st.sampled_from(["mrad", LEAST_ONE[0], FACTORS[0], ALL_OR_NOTHING[0]]),
    rung=st.integers(0, 12),
)
def test_steps_go_towards_no_fault_and_never_reach_it(stated, unit, rung):
    """None is 0 of an amount and a factor of 1; of things that are counted one is the least."""
    made = injection("bump", {FIRST: stated}, unit)
    here, smaller = (severity_at(made, FIRST, r) for r in (rung, rung + 1))
    if rung == 0:
        assert here == stated
    if here is None:
        assert smaller is None
    elif smaller is not None:
        assert smaller < here or (unit in LEAST_ONE and smaller < math.ceil(here))
        assert smaller > (1.0 if unit in FACTORS else 0.0)
    else:
        assert unit in ALL_OR_NOTHING or (unit in LEAST_ONE and here <= 1.0) or rung == 0


@given(st.floats(0.0, 0.9))
def test_a_share_that_is_left_nears_the_whole(stated):
    made = injection("window_short", {FIRST: stated}, SHARES[0])
    left = [1.0 - severity_at(made, FIRST, rung) for rung in range(5)]
    assert left == pytest.approx([(1.0 - stated) * 0.5**rung for rung in range(5)])


def test_real_trials():
    """Results of four trials: no finding without a fault, a warning, a refusal on reading, and a half severity."""
    half = severity_at(INJECTIONS["temperature_drift"], "tactical-fog", 1)
    gravity = INJECTIONS["gravity"].severity["tactical-fog"]
    asked = [(CLEAN, 0.0), ("gravity", gravity), ("not_finite", 1.0), ("temperature_drift", half)]
    rows = trials("tactical-fog", 320_000, asked)
    assert [cause for *_, cause in rows] == [NOTHING, "gravity", "not_finite", "temperature_drift"]
    assert half == 0.5 * INJECTIONS["temperature_drift"].severity["tactical-fog"]
    assert trials("tactical-fog", 320_000, asked[1:2]) == rows[1:2]


def test_every_fault_is_injected_or_said_to_be_unseen():
    assert set(INJECTIONS) == set(FAULTS)
    for fault, made in INJECTIONS.items():
        assert {*made.severity, *made.unseen} == set(GRADES), fault
        assert all(len(reason) > 20 for reason in made.unseen.values()), fault


def test_the_benchmark(tmp_path, ran, capsys):
    results = tmp_path / "new" / "results"
    assert faults.main(grades=(FIRST,), injections=50, clean=300, jobs=1, results=results) == 0
    printed = capsys.readouterr().out
    assert "| `bump` |" in printed
    assert f"| {FIRST} | 300 | 1 | 1 spikes |" in printed
    assert faults.main(grades=(SECOND,), injections=50, clean=3, jobs=1, results=results, fresh=True) == 1
    assert f"Missed: bump, {SECOND}: 8 of 50 named" in capsys.readouterr().out


SEED = 20261400


def test_kinds():
    assert len(KINDS) >= 120
    assert len(VARIANTS) * 3 >= len(KINDS)
    assert set(INJECTIONS) <= set(FAULTS)
    for kind in KINDS.values():
        assert set(kind.causes) <= set(FAULTS), kind.fault
    assert {f"{first} and {second}" for first, second in PAIRS} <= set(VARIANTS)


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
