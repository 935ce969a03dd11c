"""Gyro g-sensitivity in Kalman filter and factor graph."""

from dataclasses import replace

import accuracy_trials
import numpy as np
import pytest
from accuracy_trials import noisy_recording
from dense_solution import solve
from g_sensitivity import mems_scenario
from test_drift_terms import ALL, assert_columns

import sims
import srt
from sims.physics.imu import ImuModel, read_out
from srt.constants import DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.estimation.drift_model import DriftTerm
from srt.estimation.options import Options
from srt.recording.recording import Fixture, Site

pytest.importorskip("filterpy")
pytest.importorskip("gtsam")
from estimators.kalman_filter import run_filter
from estimators.unscented_filter import SequenceModel
from srt.estimation.iterations import PARAMETER_UNITS
from srt.estimation.observability import default_prior
from srt.joint.block_solution import BlockSolution
from srt.joint.initial_attitudes import placed
from srt.joint.linearisation import linearise
from srt.joint.recording_opening import open_joint_model

PER_G = DEG_PER_H / STANDARD_GRAVITY_M_S2
SIZE = 30.0 * PER_G
UNIT = {"sample_rate_hz": 50.0, "g_sensitivity": SIZE}


def opened(recording):
    """Joint model with g-sensitivity and a drift, so that the coefficients of both have their places."""
    joint = open_joint_model(recording, Options(gyro_bias="g-sensitive"))
    return joint.with_drift((DriftTerm("gyro", "linear", 1e-3),), joint.start)[0]


def test_columns_against_differences():
    """At a Γ of hundreds of °/h/g."""
    joint = opened(noisy_recording(1, "industrial", **UNIT)[0])
    sizes = ((10.0 * SIZE, 9), (100.0 * DEG_PER_H, 3))
    assert_columns(joint, lambda rng: [rng.normal(0.0, *size) for size in sizes], [SIZE] * 9)


def test_filter_and_blocks_are_the_dense_solution():
    """At one point of linearisation, to 1e-7 sigma, Γ and its covariance included."""
    joint = opened(noisy_recording(3, "industrial", **UNIT)[0])
    state, compensated = placed(joint, replace(joint.start, drift=np.zeros(joint.choice.drift.size)))
    prior = default_prior()
    system = linearise(joint, state, compensated, ALL, prior)
    dense, blocks = solve(system), BlockSolution(system)
    filtered = run_filter(joint, linearise(joint, state, compensated, ALL), state, prior)
    E = system.columns.parameter_map()
    P = (E @ dense.root) @ (E @ dense.root).T
    sigma = np.sqrt(np.diag(P))
    for covariance in (blocks.covariance, filtered.covariance):
        assert np.abs((covariance - P) / np.outer(sigma, sigma)).max() < 1e-7
    at = system.columns.of("drift_form")
    sigma = np.linalg.norm(dense.root[at], axis=1)
    for delta in (blocks.delta, filtered.delta):
        assert np.abs((delta - dense.delta)[at] / sigma).max() < 1e-6
    unit = np.eye(len(system.active))[:, at]
    of_drift = unit.T @ blocks.with_columns(unit)
    assert np.abs((of_drift - dense.root[at] @ dense.root[at].T) / np.outer(sigma, sigma)).max() < 1e-7


@pytest.fixture(scope="module")
def industrial():
    """An industrial unit with 30 °/h/g, and its calibrations with default options."""
    recording, truth = noisy_recording(311, "industrial", **UNIT)
    names = ("least-squares", "ekf", "graph")
    return recording, truth, {name: srt.calibrate(recording, name, checks=False) for name in names}


def test_estimated_where_the_residuals_ask_for_it(industrial):
    """Unasked; as least squares to a sigma, and better known, as rotations measure it too; filter and graph agree."""
    _, truth, found = industrial
    for name, calibration in found.items():
        assert calibration.status == "converged", name
        assert any("the g-sensitivity was estimated" in line for line in calibration.warnings)
        error = calibration.errors.vector - truth.vector
        assert error @ np.linalg.solve(calibration.covariance, error) < 27.0 + 3.5 * np.sqrt(54.0)
    matrix, sigma = (
        {name: getattr(c.diagnostics.g_sensitivity, key) for name, c in found.items()} for key in ("matrix", "sigma")
    )
    assert np.all(np.abs(matrix["graph"] - matrix["ekf"]) < 0.02 * sigma["graph"])
    assert np.all(np.abs(matrix["graph"] - matrix["least-squares"]) < 3.5 * sigma["least-squares"])
    assert np.all(sigma["graph"] < 1.01 * sigma["least-squares"])
    assert np.abs(matrix["graph"]).max() > 10.0 * sigma["graph"].max()


def test_unscented_filter_has_the_axes_of_all_poses(industrial):
    """Two windows of a sequence show one axis of Γ alone; its model of a sequence has the three of the recording."""
    joint = open_joint_model(industrial[0], Options(gyro_bias="g-sensitive"))
    single = SequenceModel(joint, placed(joint, joint.start)[0], 0, ALL)
    np.testing.assert_array_equal(single.joint.choice.drift.force_axes, joint.choice.drift.force_axes)


@pytest.mark.parametrize("estimator", ["ekf", "graph"])
def test_noise_free(estimator):
    """A unit of 1e-3 with tens of °/h/g on a perfect fixture that is stated to 1 mrad."""
    motion = accuracy_trials.table1_motion(
        site=Site(9.80665, latitude_rad=0.8), sample_rate_hz=50.0, dwell_s=2.0, stated_fixture=Fixture(0.0, 1e-3, 1e-3)
    )
    truth = accuracy_trials.normal_errors(np.random.default_rng(6), 1e-3, 10.0 * DEG_PER_H)
    gamma = np.random.default_rng(7).normal(0.0, SIZE, (3, 3))
    recording = read_out(motion, truth, ImuModel(gyro_g_sensitivity=gamma))
    found = srt.calibrate(recording, estimator, gyro_bias="g-sensitive", checks=False)
    assert found.status == "converged"
    assert np.abs((found.errors.vector - truth.vector) / PARAMETER_UNITS).max() < 1e-7
    assert np.abs(found.g_sensitivity - gamma).max() < 1e-4 * PER_G


@pytest.mark.parametrize("units", [3, pytest.param(60, marks=pytest.mark.campaign)])
def test_nees(units):
    """Sensor errors and Γ of industrial units with 30 °/h/g and 0.5 °/s of bias."""
    plan, errors, followed = mems_scenario(dwell_s=4.0, sample_rate_hz=50.0), [], []
    for seed in range(7000, 7000 + units):
        unit = sims.simulate(plan.model_copy(update={"seed": seed}))
        found = srt.calibrate(unit.recording, "graph", gyro_bias="g-sensitive", checks=False)
        error = found.errors.vector - unit.truth.vector
        errors.append(float(error @ np.linalg.solve(found.covariance, error)) / 27.0)
        told = found.diagnostics.g_sensitivity
        error = (np.array(told.matrix) - unit.imu.gyro_g_sensitivity).ravel()
        followed.append(float(error @ np.linalg.solve(np.array(told.covariance), error)) / 9.0)
    assert abs(np.mean(errors) - 1.0) < 3.5 * np.sqrt(2.0 / (27.0 * units))
    assert abs(np.mean(followed) - 1.0) < 3.5 * np.sqrt(2.0 / (9.0 * units))
