"""Input refused by Kalman filter and factor graph, their messages about too little data, and their command line."""

import json
import math
import re
import sys

import accuracy_trials
import numpy as np
import pytest
from small_units import on_fixture, simulated

import srt
from sims.physics.imu import read_out
from srt.constants import DEG_PER_H
from srt.exceptions import InputError
from srt.model.prior import Prior
from srt.sensor_errors import GROUP_SLICES, NAMES, SensorErrors

JOINT = ("ekf", "graph")
PACKAGE = {"ekf": "filterpy", "graph": "gtsam"}


@pytest.fixture(scope="module", params=JOINT)
def estimator(request):
    pytest.importorskip(PACKAGE[request.param])
    return request.param


@pytest.fixture(scope="module")
def unit():
    """A navigation unit without gyro asymmetry on a 1 mrad fixture: recording and truth."""
    rng = np.random.default_rng(201)
    vector = accuracy_trials.normal_errors(rng, 1e-3, 10.0 * DEG_PER_H).vector.copy()
    vector[GROUP_SLICES["gyro_asymmetry"]] = 0.0
    truth = SensorErrors(vector)
    motion = on_fixture(rng, dwell_s=5.0)
    return read_out(motion, truth, accuracy_trials.GRADES["navigation"], rng), truth


@pytest.fixture(scope="module")
def full(unit, estimator):
    """Calibration of the whole test."""
    return srt.calibrate(unit[0], estimator, checks=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A simulated recording on disk."""
    place = tmp_path_factory.mktemp("joint") / "recording"
    # 50 Hz and windows of 2 s: small enough to calibrate in a moment.
    return simulated(place, seed=11, dwell_s=2.0, sample_rate_hz=50.0, recording='format = "csv"')


def only(recording, *ids):
    return recording.with_sequences(tuple(s for s in recording.sequences if s.id in ids))


def assert_whole(calibration):
    """JSON without NaN, every value finite, and what is not observed named with a reason."""
    document = json.loads(json.dumps(calibration.to_dict(), allow_nan=False))
    assert document["estimator"] == calibration.estimator
    for row in document["parameters"]:
        assert math.isfinite(row["value"]) if calibration.has_values else row["value"] is None
        if row["observed"]:
            assert row["sigma"] > 0.0
        else:
            assert row["sigma"] is None
            assert row["held_reason"]


# Priors


def changed(change):
    covariance = np.eye(len(NAMES))
    change(covariance)
    return covariance


def put(*cells):
    """A change of single cells, (row, column, value)."""

    def change(covariance):
        for row, column, value in cells:
            covariance[row, column] = value

    return change


@pytest.mark.parametrize(
    ("covariance", "fragments"),
    [
        (changed(put((0, 1, 2.0), (1, 0, 2.0))), ["indefinite"]),
        (np.ones((len(NAMES), len(NAMES))), ["indefinite"]),
        (changed(put((0, 1, 0.5))), ["not symmetric"]),
        (changed(put((3, 4, np.nan))), [NAMES[3], NAMES[4], "finite"]),
        (changed(put((5, 5, np.inf))), [NAMES[5], "finite"]),
        (changed(put((7, 7, 0.0))), [NAMES[7], "positive"]),
        (changed(put((7, 7, -1.0))), [NAMES[7], "positive"]),
        (np.ones(len(NAMES)), ["shape", "(27,)", "27 by 27"]),
        (np.eye(24), ["shape", "(24, 24)", "27 by 27"]),
        (None, ["27 by 27"]),
        ("wide", ["numbers"]),
    ],
    ids=[
        "indefinite", "singular", "asymmetric", "nan", "infinite", "zero", "negative",
        "vector", "small", "none", "word",
    ],
)  # fmt: skip
def test_a_prior_that_is_none_is_refused(covariance, fragments):
    with pytest.raises(InputError) as refused:
        Prior(SensorErrors(), covariance)
    sentence = str(refused.value)
    assert sentence.endswith(".")
    for fragment in fragments:
        assert fragment in sentence, sentence


@pytest.mark.parametrize("mean", [None, np.zeros(27), "zero"], ids=["none", "array", "word"])
def test_a_prior_needs_sensor_errors_for_its_mean(mean):
    with pytest.raises(InputError, match="mean"):
        Prior(mean, np.eye(len(NAMES)))


@pytest.mark.parametrize("growth", [0.0, -1.0, math.nan])
def test_a_prior_does_not_grow_by_nothing(unit, growth):
    with pytest.raises(InputError):
        Prior.from_calibration(srt.calibrate(unit[0]), growth=growth)


def test_a_prior_of_another_kind_is_refused(unit):
    with pytest.raises(InputError, match="prior"):
        srt.calibrate(unit[0], "ekf", prior=np.eye(len(NAMES)))


def test_a_calibration_with_fixed_parameters_is_a_prior(unit, estimator, full):
    """Fixed parameters get the wide default prior: everything is observed, and no sigma grows."""
    recording, truth = unit
    earlier = srt.calibrate(recording, estimator, hold=("gyro_asymmetry",), checks=False)
    assert earlier.status == "partial"
    assert len(earlier.fixed) == 3
    prior = Prior.from_calibration(earlier)
    assert np.all(np.isfinite(prior.covariance))
    calibration = srt.calibrate(recording, estimator, prior=prior, checks=False)
    assert calibration.status == "converged"
    assert calibration.observed.all()
    assert_whole(calibration)
    assert np.all(calibration.sigma < 1.001 * full.sigma)
    # The data counted twice: the errors are the same, in sigmas that are at best smaller by a root of two.
    assert np.abs((calibration.errors.vector - truth.vector) / calibration.sigma).max() < 4.6 * np.sqrt(2.0)


def test_a_prior_carries_what_two_sequences_cannot_show(unit, estimator, full):
    recording, _ = unit
    few = srt.calibrate(
        only(recording, "4", "13"), estimator, prior=Prior.from_calibration(full, growth=2.0), checks=False
    )
    assert few.status == "converged"
    assert few.observed.all()
    assert np.all(np.abs(few.errors.vector - full.errors.vector) < 3.5 * 2.0 * full.sigma)
    # Something is learnt, nothing is lost.
    assert np.all(few.sigma < 2.001 * full.sigma)
    assert np.any(few.sigma < 1.9 * full.sigma)


# Too little data


@pytest.mark.parametrize("ids", [("4", "13"), ("1",), ("7",)], ids="-".join)
def test_too_few_sequences_name_what_they_do_not_show(unit, estimator, ids):
    """Partial, whatever the sequences show; held parameters are named and keep the start's values."""
    recording, truth = unit
    calibration = srt.calibrate(only(recording, *ids), estimator, checks=False)
    assert_whole(calibration)
    assert calibration.status == "partial", calibration.message
    # A sequence has two windows of three forces and three rates, and one turn: 15 numbers, of which its end attitude
    # takes three; of its start attitude the fixture knows as much as counts for being observed.
    assert 0 < calibration.observed.sum() <= 12 * len(ids)
    for name in calibration.fixed:
        assert name in calibration.message
    error = np.abs(calibration.errors.vector - truth.vector)
    assert np.all(error[calibration.observed] < 4.6 * calibration.sigma[calibration.observed])
    # What is held keeps the start's value: from the fixture, to some milliradians, or none, and the errors are of 1e-3.
    for group in ("gyro_scale", "gyro_orthogonality", "accel_scale", "accel_misalignment"):
        part = np.zeros(len(NAMES), dtype=bool)
        part[GROUP_SLICES[group]] = True
        assert np.all(error[part & ~calibration.observed] < 0.02), group


def test_everything_held_is_no_crash(unit, estimator):
    calibration = srt.calibrate(only(unit[0], "4", "13"), estimator, hold=NAMES)
    assert calibration.status == "partial"
    assert set(calibration.fixed) == set(NAMES)
    assert_whole(calibration)


@pytest.mark.parametrize(
    "start",
    [{"gyro_scale_x": -0.95}, {"accel_scale_x": -1.95}, {"gyro_orthogonality_xy": 2.5}],
    ids=["coplanar", "left-handed", "indefinite"],
)
def test_an_estimate_outside_the_model_says_so(unit, estimator, start):
    """A start where no IMU is: the iteration ends there, nothing counts as observed, and the result is still whole."""
    calibration = srt.calibrate(unit[0], estimator, start=SensorErrors.from_dict(start))
    assert_whole(calibration)
    if "gyro_scale_x" in start:
        assert calibration.status == "outside_model"
        assert "coplanar" in calibration.message
    if calibration.status == "converged":  # some come back: then to the right place
        assert np.abs((calibration.errors.vector - unit[1].vector) / calibration.sigma).max() < 4.6
        return
    assert calibration.status in ("outside_model", "not_converged")
    if calibration.status == "outside_model":
        assert not calibration.observed.any()
        causes = r"coplanar|left-handed|opposite handedness|not positive definite|singular"
        assert re.search(causes, calibration.message)


# Options that are another estimator's


def test_the_filter_has_no_robust_loss(unit):
    pytest.importorskip("filterpy")
    for loss in ("huber", "cauchy"):
        with pytest.raises(InputError, match=f"loss='{loss}'"):
            srt.calibrate(unit[0], "ekf", loss=loss)


@pytest.mark.parametrize(("option", "value"), [("step", "coefficients"), ("down", "paper")])
def test_options_of_the_closed_form_are_refused(folder, tmp_path, estimator, option, value, refused):
    output = tmp_path / "calibration.json"
    choices = ["--estimator", estimator, f"--{option}", value, "-q", "-o", str(output)]
    assert f"{option}='{value}'" in refused("calibrate", folder, *choices)
    assert not output.exists()


# Without the package


@pytest.mark.parametrize("name", JOINT)
def test_a_missing_package_is_one_sentence(folder, tmp_path, monkeypatch, name, refused):
    """No traceback: what is missing, and what to run."""
    import estimators

    for module in list(sys.modules):
        if module.startswith((f"{PACKAGE[name]}.", "estimators.")):
            monkeypatch.delitem(sys.modules, module)
    for attribute in ("ekf", "root_ekf", "graph", "live"):  # what is imported anew below must not stay
        monkeypatch.delattr(estimators, attribute, raising=False)
    monkeypatch.setitem(sys.modules, PACKAGE[name], None)
    output = tmp_path / "calibration.json"
    err = refused("calibrate", folder, "--estimator", name, "-q", "-o", output)
    assert f"needs the package '{PACKAGE[name]}" in err
    assert "pip install 'strapdown-rotation-test[" in err
    assert not output.exists()


# The command line end to end


def test_calibrate_through_the_command_line(folder, tmp_path, estimator, shell):
    output = tmp_path / "calibration.json"
    arguments = ["--estimator", estimator, "-o", output, "--truth", folder / "truth.json"]
    out, err = shell("calibrate", folder, *arguments)
    assert "gyro_scale_x" in out
    assert "Traceback" not in err
    document = json.loads(output.read_text())
    assert document["estimator"] == estimator
    assert document["status"] == "converged"
    assert "sequences" in document["diagnostics"]
    assert ("filter" in document["diagnostics"]) == (estimator == "ekf")
    loaded = srt.load_calibration(output)
    direct = srt.calibrate(srt.load_recording(folder), estimator)
    np.testing.assert_allclose(loaded.errors.vector, direct.errors.vector, rtol=1e-12)
    np.testing.assert_allclose(loaded.covariance, direct.covariance, rtol=1e-9)
    closed = srt.calibrate(srt.load_recording(folder))
    apart = np.abs(direct.errors.vector - closed.errors.vector)
    # Both from the same data: their difference is no larger than the less accurate one's own errors are.
    assert np.all(apart < 4.6 * np.maximum(direct.sigma, closed.sigma))
