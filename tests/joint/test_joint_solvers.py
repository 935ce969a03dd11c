"""The joint estimators together: one optimum, options of others refused, and a slow turn in a rest."""

from dataclasses import replace
from itertools import pairwise

import frozen_results
import numpy as np
import pytest
from foreign_motion import GRADES, Turn, drawn_errors, hand_turns, recording, windows
from scipy.stats import chi2

import srt
from srt.exceptions import InputError


@pytest.mark.parametrize("name", ["half of Table 1", "moves tactical", "hand-turned protocol", "rate table"])
def test_all_joint_solvers_agree(name):
    """The same optimum as the factor graph to 1e-6 sigma; status, observed parameters and verdict of all three."""
    pytest.importorskip("gtsam")
    pytest.importorskip("filterpy")
    recording = frozen_results.RECORDINGS[name]()
    least, graph, ekf = (frozen_results.result(recording, e) for e in ("least-squares", "graph", "ekf"))
    value, sigma, notes = frozen_results.difference(least, graph)
    assert value < frozen_results.LARGEST
    assert sigma < frozen_results.LARGEST
    assert notes == ""
    assert frozen_results.difference(ekf, graph)[2] == ""


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("step", "coefficients"), ("down", "paper"), ("measured_vertical", False), ("window_attitude", "integrated"),
        ("loss", "cauchy"), ("filter", "one-pass"), ("live", True), ("targets", {"gyro_scale": 1e-5}),
    ],
)  # fmt: skip
def test_options_of_other_estimators_are_refused(option, value):
    recording = frozen_results.RECORDINGS["six faces"]()
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
