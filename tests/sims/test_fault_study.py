"""Study of faults: severities, detection, outcomes and tables."""

import faults
import pytest
from faults import (
    KINDS,
    MOVED,
    Outcome,
    case_of,
    injected,
    main,
    outcome_of,
    severity_at,
)
from injected_faults.foreign_operators import PAIRS
from injected_faults.injection import GRADES, INJECTIONS, VARIANTS, Injection

from srt.diagnosis.faults import FAULTS

FIRST, SECOND = GRADES[:2]


def injection(fault, severity, unit="m", unseen=None):
    return Injection(fault, lambda case, severity, rng: None, severity, unit, unseen=unseen or {})


@pytest.fixture
def ran(monkeypatch):
    """Injections that were run, of two faults of which the smallest severity named is known."""
    smallest = {("bump", FIRST): 2.0, ("bump", SECOND): 9.0, ("north", FIRST): 3.0}
    done = []

    def stand_in(fault, grade, severity, seed):
        done.append((fault, grade, severity, seed))
        # Below the smallest one a unit here and there is named all the same.
        named = severity >= smallest[fault, grade] or seed % 7 == 0
        return Outcome(fault if named else "creep", "doubtful", 1.0)

    monkeypatch.setitem(KINDS, "bump", injection("bump", {FIRST: 8.0, SECOND: 8.0}))
    monkeypatch.setitem(KINDS, "north", injection("north", {FIRST: 3.0}, unseen={SECOND: "It is too dark."}))
    monkeypatch.setattr(faults, "injected", stand_in)
    return done


def test_smallest_severity_counts_and_table(ran, capsys):
    assert main(kinds=("bump", "north"), grades=(FIRST, SECOND), units=50, jobs=1) == 1
    lines = capsys.readouterr().out.splitlines()
    assert f"| `bump` | {FAULTS['bump'].effect} | 8 m: 50/50; ≥ 2 | 8 m: 8/50; none seen |" in lines
    assert f"| `north` | {FAULTS['north'].effect} | 3 m: 50/50; ≥ 3 | unseen |" in lines
    assert f"- `north`, {SECOND}: It is too dark." in lines
    assert f"- `bump`, {SECOND}, named otherwise: 42 creep" in lines
    # A severity that is not seen is given up after its first few units.
    assert len([1 for fault, _, severity, _ in ran if (fault, severity) == ("north", 1.5)]) == faults.FIRST_UNITS
    assert len(ran) == len(set(ran))
    assert main(kinds=("bump",), grades=(FIRST,), units=50, jobs=1) == 0


def test_real_outcomes():
    """No finding without a fault, a warning, a refusal on reading, and a half severity."""
    grade, seed = "tactical-fog", 320_000
    case = case_of(grade, seed)
    assert outcome_of(lambda: case.recording, (), case.simulation.truth.vector).harmless
    half = severity_at(INJECTIONS["temperature_drift"], grade, 1)
    assert half == 0.5 * INJECTIONS["temperature_drift"].severity[grade]
    gravity = INJECTIONS["gravity"].severity[grade]
    for fault, severity in (("gravity", gravity), ("not_finite", 1.0), ("temperature_drift", half)):
        assert injected(fault, grade, severity, seed).first == fault


def test_outcomes_of_some_kinds():
    """One fault that is named, one that the calibration finds as an error of the sensors, one with the wrong cause."""
    grade, seed = "consumer-mems", 20261430
    named = injected("gyro_degrees", grade, 1.0, seed)
    assert named.told == "gyro_degrees"
    found = injected("offset subtracted twice", grade, 0.01, seed)
    assert found.harmless
    assert found.told == "nothing"
    assert 0.0 < found.error < faults.SIGMAS
    # Gyros that do not sense the Earth rate cannot tell a wrong latitude from wrong gravity.
    assert injected("longitude for latitude", grade, 1.0, seed).first == "gravity"


@pytest.mark.parametrize("study", ["drawn", "clean"])
def test_the_other_studies(study, capsys):
    """A recording that is named, or silent, as it must be."""
    assert main(study, units=1, first=1, seed=20261147, jobs=1) == 0
    assert (
        capsys.readouterr()
        .out.splitlines()[-1]
        .startswith(
            "sound beyond 4 sigma: 0" if study == "drawn" else "0 of 1 clean recordings raise a finding; verdicts: 1 "
        )
    )


def test_every_fault_is_injected_or_said_to_be_unseen():
    assert set(INJECTIONS) == set(FAULTS)
    for fault, made in INJECTIONS.items():
        assert {*made.severity, *made.unseen} == set(GRADES), fault
        assert all(len(reason) > 20 for reason in made.unseen.values()), fault


def test_kinds():
    assert len(KINDS) >= 120
    assert len(VARIANTS) * 3 >= len(KINDS)
    assert set(INJECTIONS) <= set(FAULTS)
    for kind in KINDS.values():
        assert set(kind.causes) <= set(FAULTS), kind.fault
    assert set(MOVED) <= set(KINDS)
    assert {f"{first} and {second}" for first, second in PAIRS} <= set(VARIANTS)
