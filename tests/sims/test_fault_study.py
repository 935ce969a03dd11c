"""Study of faults, and the outcomes of its runs."""

import importlib.util
import json
import math
import sys
from pathlib import Path

import fault_outcomes
import fault_study
import numpy as np
import pytest
from fault_outcomes import OUTCOMES, Outcome, Units, all_kinds, outcome_of, outcomes, page, write_section
from fault_severities import LEAST_SHIFT, halvings, severities
from fault_study import (
    ALL_OR_NOTHING,
    CLEAN,
    FACTORS,
    LEAST_ONE,
    SHARES,
    DiagnosedRecording,
    FaultStudy,
    all_injections,
    diagnose_unit,
    severity_at,
)
from faults import markdown, missed_targets
from hypothesis import given
from hypothesis import strategies as st
from injected_faults.foreign_operators import PAIRS
from injected_faults.injection import GRADES, INJECTIONS, VARIANTS, Injection

from srt.diagnosis.faults import FAULTS
from srt.exceptions import InputError

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "faults.py"
FIRST, SECOND = GRADES[:2]


def injection(fault, severity, unit="m", unseen=None):
    return Injection(fault, lambda case, severity, rng: None, severity, unit, unseen=unseen or {})


@pytest.fixture
def trials(monkeypatch):
    """Two faults, of which the smallest severity named is known, and the trials that were run."""
    catalogue = {
        "bump": injection("bump", {FIRST: 8.0, SECOND: 8.0}),
        "north": injection("north", {FIRST: 3.0}, unseen={SECOND: "It is too dark."}),
    }
    smallest = {("bump", FIRST): 2.0, ("bump", SECOND): 9.0, ("north", FIRST): 3.0}
    ran = []

    def stand_in(grade, seed, asked):
        ran.extend((grade, seed, *question) for question in asked)
        rows = []
        for fault, rung in asked:
            if fault == CLEAN:
                rows.append(
                    DiagnosedRecording(CLEAN, grade, seed, 0, 0.0, "spikes" if (grade, seed) == (FIRST, 1) else None)
                )
                continue
            severity = severity_at(fault_study.all_injections()[fault], grade, rung)
            # Below the smallest one a unit here and there is named all the same.
            named = fault if severity >= smallest[fault, grade] or seed % 7 == 0 else "creep"
            rows.append(DiagnosedRecording(fault, grade, seed, rung, severity, named))
        return rows

    monkeypatch.setattr(fault_study, "all_injections", lambda: catalogue)
    monkeypatch.setattr(fault_study, "diagnose_unit", stand_in)
    return ran


def study(path, **changes):
    return FaultStudy(path, grades=(FIRST, SECOND), **({"injections": 50, "clean": 3} | changes))


def test_smallest_severity_and_counts(tmp_path, trials):
    run = study(tmp_path / "results")
    run.run()
    pairs = {(pair.fault, pair.grade): pair for pair in run.detections()}
    bump, missed, north, dark = (
        pairs[key] for key in (("bump", FIRST), ("bump", SECOND), ("north", FIRST), ("north", SECOND))
    )
    assert (bump.named, bump.of, bump.smallest, bump.seen, bump.misnamed) == (50, 50, 2.0, True, {})
    assert (missed.named, missed.of, missed.smallest, missed.seen) == (8, 50, None, False)
    assert missed.misnamed == {"creep": 42}
    assert (north.smallest, north.seen) == (3.0, True)
    assert (dark.severity, dark.reason, dark.seen) == (None, "It is too dark.", False)
    assert run.alarms(FIRST) == (3, {"spikes": 1})
    assert run.alarms(SECOND) == (3, {})
    # A rung that is not seen is given up after its first few units.
    assert len([1 for _, _, fault, rung in trials if (fault, rung) == ("north", 1)]) < fault_study.LADDER_UNITS


def test_every_recording_is_asked_once_and_what_is_done_is_not_done_again(tmp_path, trials):
    path = tmp_path / "results"
    study(path).run()
    assert len(trials) == len(set(trials))
    count = len(trials)
    again = study(path)
    again.run()
    assert len(trials) == count
    assert next(again.detections()).smallest == 2.0


def test_an_interrupted_study_goes_on(tmp_path, trials):
    """Cut at any place, even within a line, the file serves, and the result is the same."""
    path = tmp_path / "results"
    whole = study(path)
    whole.run()
    expected, content, count = list(whole.detections()), path.read_bytes(), len(trials)
    for share in (0.01, 0.3, 0.8, 0.999):
        path.write_bytes(content[: int(share * len(content))])
        trials.clear()
        resumed = study(path)
        resumed.run()
        assert list(resumed.detections()) == expected
        assert len(trials) < count or share < 0.02
        assert list(study(path).detections()) == expected


def test_a_severity_that_is_stated_anew_is_run_anew(tmp_path, trials, monkeypatch):
    path = tmp_path / "results"
    study(path).run()
    catalogue = fault_study.all_injections() | {"bump": injection("bump", {FIRST: 4.0, SECOND: 20.0})}
    monkeypatch.setattr(fault_study, "all_injections", lambda: catalogue)
    run = study(path)
    assert [pair.of for pair in run.detections()] == [0, 0, 50, 0]
    trials.clear()
    run.run()
    assert {fault for _, _, fault, _ in trials} == {"bump"}
    assert [pair.smallest for pair in run.detections()] == [2.0, 10.0, 3.0, None]


def test_the_file_of_something_else_is_refused(tmp_path, trials):
    path = tmp_path / "results"
    for content in ("not JSON\n", '{"format": 2}\n', json.dumps(fault_study.FORMAT) + '\n{"fault": 1}\n'):
        path.write_text(content, encoding="utf-8")
        with pytest.raises(InputError, match="holds no results of this study"):
            study(path)
        assert path.read_text(encoding="utf-8") == content
    assert trials == []


@pytest.mark.parametrize(("key", "value"), [("faults", ("gremlins",)), ("grades", ("toy",))])
def test_unknown_names_are_refused(tmp_path, trials, key, value):
    with pytest.raises(InputError, match=f"no {key[:-1]} '{value[0]}'"):
        FaultStudy(tmp_path / "results", **{key: value})
    assert trials == []


def test_the_committed_table(tmp_path, trials):
    run = study(tmp_path / "results")
    run.run()
    page = markdown(run)
    assert f"| `bump` | {FAULTS['bump'].effect} | 8 m: 50/50; ≥ 2 | 8 m: 8/50; none seen |" in page
    assert f"| `north` | {FAULTS['north'].effect} | 3 m: 50/50; ≥ 3 | unseen |" in page
    assert f"- `north`, {SECOND}: It is too dark." in page
    assert f"- `bump`, {SECOND}: creep 42" in page
    assert f"| {FIRST} | 3 | 1 | `spikes` 1 |" in page
    # 40 of 40 are likely at 0.99 (0.99^40 = 0.67), and as unlikely as 5 % at 0.05^(1/40) = 0.928.
    assert "67 times in 100" in page
    assert "92.8 %" in page
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
    """Results of three trials: a refusal on reading, a warning, and no finding without a fault."""
    rows = diagnose_unit(
        "tactical-fog", 320_000, [(CLEAN, 0), ("gravity", 0), ("not_finite", 0), ("temperature_drift", 1)]
    )
    assert [row.named for row in rows] == [None, "gravity", "not_finite", "temperature_drift"]
    stated = all_injections()["temperature_drift"].severity["tactical-fog"]
    assert [row.severity for row in rows[1:]][2] == 0.5 * stated
    assert diagnose_unit("tactical-fog", 320_000, [("gravity", 0)]) == rows[1:2]


def test_every_fault_is_injected_or_said_to_be_unseen():
    catalogue = all_injections()
    assert set(catalogue) == set(FAULTS)
    for fault, made in catalogue.items():
        assert {*made.severity, *made.unseen} == set(GRADES), fault
        assert all(len(reason) > 20 for reason in made.unseen.values()), fault


def test_the_benchmark(tmp_path, trials, monkeypatch, capsys):
    spec = importlib.util.spec_from_file_location("benchmark_faults", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    page = tmp_path / "table.md"
    monkeypatch.setattr(
        sys,
        "argv",
        [
            *("faults.py", "--grades", FIRST, "--injections", "50", "--clean", "300", "--jobs", "1", "--seed", "0"),
            *("--results", str(tmp_path / "new" / "results"), "--markdown", str(page)),
        ],
    )
    assert module.main() == 0
    assert "bump" in capsys.readouterr().out
    assert f"| {FIRST} | 300 | 1 | `spikes` 1 |" in page.read_text(encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["faults.py", "--faults", "gremlins", "--results", str(tmp_path / "results")])
    assert module.main() == 2
    assert "no fault 'gremlins'" in capsys.readouterr().out


SEED = 20261400


def test_kinds():
    assert len(all_kinds()) >= 120
    assert len(VARIANTS) * 3 >= len(all_kinds())
    assert set(INJECTIONS) <= set(FAULTS)
    for kind in all_kinds().values():
        assert set(kind.causes) <= set(FAULTS), kind.fault
    assert {f"{first} and {second}" for first, second in PAIRS} <= set(VARIANTS)


@pytest.mark.parametrize("kind", ["bump", "labels_exchanged", "gyro_lsb", "left_handed", "window_short", "north"])
def test_halvings_do_not_increase(kind):
    for grade in GRADES:
        steps = halvings(all_kinds()[kind], grade)
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
    units, injection = Units(SEED), all_kinds()[kind]
    harmful, (most, middle, least) = severities(injection, units, grade)
    assert harmful
    assert most > middle > least > 0.0
    assert LEAST_SHIFT[0] <= units.shift_at(injection, grade, least) <= LEAST_SHIFT[1]


def test_harmless_kinds_have_the_stated_severity():
    """A misread temperature moves no parameter of a unit without temperature coefficients."""
    injection = all_kinds()["temperature_unit"]
    harmful, steps = severities(injection, Units(SEED), "industrial-mems")
    assert not harmful
    assert steps == halvings(injection, "industrial-mems")


def test_outcomes_of_some_kinds():
    """One fault that is named, one that the calibration finds as an error of the sensors, one with the wrong cause."""
    units, kinds = Units(SEED), all_kinds()
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
    rows = list(outcomes(list(all_kinds())[::20], GRADES, SEED))
    assert len(rows) == 12 * len(list(all_kinds())[::20])
    assert not [row for row in rows if row.outcome == OUTCOMES[5] and not fault_outcomes.unseen(row)]


def test_page(tmp_path):
    rows = [
        Outcome("bump", "consumer-mems", 1, 0.5, OUTCOMES[5], "", 4.2, "gyro_scale_x"),
        Outcome("bump", "consumer-mems", 0, 1.0, OUTCOMES[0], "bump"),
        Outcome("north", "consumer-mems", 0, 1.0, OUTCOMES[5], "", 9.0, "gyro_bias_x"),
        Outcome("clock fast", "navigation-rlg", 0, 1.05, OUTCOMES[1], "latitude"),
    ]
    path = tmp_path / "page.md"
    path.write_text("# Page\n\ntext\n", encoding="utf-8")
    for _ in range(2):
        write_section(path, page(rows, SEED))
    text = path.read_text(encoding="utf-8")
    assert text.count("## Outcomes") == 1
    assert text.startswith("# Page\n\ntext\n\n<!--")
    assert "| consumer-mems | largest | 1 | 0 | 0 | 0 | 0 | 1 |" in text
    assert "- bump: silent, beyond 3σ: consumer-mems 1 (4.2σ)" in text
    assert "- north: silent, beyond 3σ: consumer-mems 0 (9σ)*" in text
    assert "- clock fast: latitude: navigation-rlg 0" in text
