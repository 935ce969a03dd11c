"""Least squares, the block solver of the joint model: the optimum of the graph, and options that it refuses."""

import frozen_results
import pytest

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
