"""The joint estimators together: one optimum, options of others refused, and a slow turn in a rest."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from accuracy_trials import fixture_recording
from foreign_motion import GRADES, Turn, drawn_errors, hand_turns, recording, windows
from scipy.stats import chi2

import sims
import srt
from srt.estimation.drift_model import DriftTerm
from srt.estimation.options import Options
from srt.exceptions import InputError
from srt.joint.recording_opening import open_joint_model

HALF = ("1", "2", "3", "1a", "4", "5", "6", "7", "8", "9", "13")
SCENARIOS = {
    "half of Table 1": {
        "seed": 32, "fixture": {"from": "lab-1mrad"},
        "schedule": {"dwell_s": 4.0, "rate_rad_s": 2.0, "acceleration_rad_s2": 20.0, "sequences": HALF},
    },
    "rate table": {"seed": 37, "protocol": {"from": "rate-table"}},
    "six faces": {"seed": 38, "protocol": {"from": "six-face-tumble"}},
    "hand-turned protocol": {"seed": 39, "imu": {"from": "industrial-mems"}, "protocol": {"from": "hand-turned"}},
}  # fmt: skip


def simulated(name):
    if name == "moves":
        return fixture_recording(21, "tactical", moves="recorded", sample_rate_hz=50.0)[0]
    base = {"imu": {"from": "tactical-fog"}, "site": {"from": "latitude-45"}, "recording": {"sample_rate_hz": 50.0}}
    return sims.simulate(sims.scenario_from_dict(base | SCENARIOS[name])).recording


@pytest.mark.parametrize("name", ["half of Table 1", "moves", "hand-turned protocol", "rate table"])
def test_all_joint_solvers_agree(name):
    """The same optimum as the factor graph to 1e-6 sigma; status, observed parameters and verdict of all three."""
    pytest.importorskip("gtsam")
    pytest.importorskip("filterpy")
    recording = simulated(name)
    least, graph, ekf = (srt.calibrate(recording, e, checks=False) for e in ("least-squares", "graph", "ekf"))
    seen = graph.observed & (graph.sigma > 0.0)
    difference = (least.errors.vector - graph.errors.vector)[seen] / graph.sigma[seen]
    assert np.abs(difference).max() < 1e-6
    np.testing.assert_allclose(least.sigma[seen], graph.sigma[seen], rtol=1e-6)
    for other in (least, ekf):
        assert (other.status, other.judgement.word) == (graph.status, graph.judgement.word)
        # The figures of a reason follow from the values.
        reasons = (re.sub(r"[\d.]+(e[+-]?\d+)?", "#", found.judgement.reason) for found in (other, graph))
        assert len(set(reasons)) == 1
        np.testing.assert_array_equal(other.observed, graph.observed)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("step", "coefficients"), ("down", "paper"), ("measured_vertical", False), ("window_attitude", "integrated"),
        ("loss", "cauchy"), ("filter", "one-pass"), ("live", True), ("targets", {"gyro_scale": 1e-5}),
    ],
)  # fmt: skip
def test_options_of_other_estimators_are_refused(option, value):
    recording = simulated("six faces")
    with pytest.raises(InputError, match=f"has no option {option}"):
        srt.calibrate(recording, "least-squares", **{option: value}, checks=False)


def test_a_rest_in_which_the_unit_turns_slowly_accuses_no_turn():
    """Evenly, so that its halves agree: its rate contradicts the other rests, and the tilt is that of the rate."""
    rng = np.random.default_rng(20261125)
    errors = drawn_errors(GRADES["consumer"], rng)
    turns = hand_turns(rng, shortest_s=1.0, longest_s=4.0, count=20, rest_s=3.0)
    turns[6:7] = [replace(turns[6], rest_s=0.02), Turn((1.0, -0.5, 0.7), 0.002, 3.0, 0.02)]
    unit = recording(turns, 5.0, errors, GRADES["consumer"], rng, profile="constant-rate")
    rests = windows(turns, 5.0)
    rests[7:9] = [(rests[7][0], rests[8][1])]
    labels = tuple(srt.SequenceLabel(a, b) for a, b in pairwise((x + 0.05, y - 0.05) for x, y in rests))
    found = srt.calibrate(unit.with_sequences(labels), "least-squares", checks=False)
    assert found.status in ("converged", "partial"), found.message
    assert any(f"moved in the stationary windows from {int(rests[7][0])}." in warning for warning in found.warnings)
    truth, seen = np.array([errors.get(name, 0.0) for name in srt.NAMES]), found.observed
    z, sigma = ((found.errors.vector - truth) / found.sigma)[seen], found.sigma[seen]
    nees = z @ np.linalg.solve(found.covariance[np.ix_(seen, seen)] / np.outer(sigma, sigma), z)
    assert nees < chi2.isf(1e-3, seen.sum())


def test_a_model_does_not_change():
    """Another choice makes another model, which shares what does not depend on it, and leaves the first as it was."""
    joint = open_joint_model(simulated("six faces"), Options())
    before = vars(joint).copy()
    other, state = joint.with_g_sensitivity(joint.start)
    moved = other.with_integrated(np.arange(len(joint.window_sequence)) == 1).with_choice(ends_tied=True)
    moved, state = moved.with_drift((DriftTerm("gyro", "linear", 1e-3),), state)
    moved.compensate(state)
    assert moved.choice.integrated.tolist() != joint.choice.integrated.tolist()
    assert moved.choice.drift.size == other.choice.drift.size + 3 == len(state.drift)
    assert all(vars(joint)[name] is value for name, value in before.items())
    assert moved.order is joint.order
    for name in ("choice", "start", "drift"):
        with pytest.raises(AttributeError, match=f"{name} of a joint model does not change"):
            setattr(moved, name, None)
