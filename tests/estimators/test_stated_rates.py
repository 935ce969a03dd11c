"""Runs at a stated rate in all estimators: noise-free solutions, agreement, a brute-force minimum, and true sigmas."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sims
import srt
import srt.comparison.estimator_comparison
from sims.scenarios.scenario import scenario_from_dict
from srt.estimation.drift_model import DriftTerm
from srt.noise.drift_forms import LINEAR
from srt.recording.protocol import protocols_path
from srt.sensor_errors import GROUP_SLICES, SensorErrors

pytest.importorskip("filterpy")
pytest.importorskip("gtsam")
from jacobian_cases import RATE, VARIANTS, G, make, simulated_motions
from test_joint_jacobians import unwhitened, unwhitened_residuals

from srt.joint.linearisation import linearise

HZ = 20.0
NOT_SHOWN = ("gyro_orthogonality", "accel_asymmetry", "accel_misalignment")
SHOWN = np.concatenate(
    [np.r_[GROUP_SLICES[group]] for group in ("gyro_scale", "gyro_asymmetry", "gyro_bias", "accel_bias", "accel_scale")]
)
WHITE = dict.fromkeys(("gyro_bias_instability_deg_per_h", "accel_bias_instability_ug"), 0.0)
EXACT = {"hold": NOT_SHOWN, "start": SensorErrors(), "checks": False}
"""The parameters that a rate table does not show are zero in these units, and known to be."""
ESTIMATORS = ("least-squares", "ekf", "graph")


def simulated(seed, *, noise=None, protocol="rate-table", recording=None):
    not_shown = {"gyro_orthogonality_urad": 0.0, "accel_asymmetry_ppm": 0.0, "accel_misalignment_urad": 0.0}
    tables = {
        "seed": seed,
        "imu": {"from": "tactical-fog", "errors": not_shown, "noise": noise or {}},
        "site": {"from": "latitude-45"},
        "protocol": {"from": protocol},
        "recording": {"sample_rate_hz": HZ} | (recording or {}),
    }
    return sims.simulate(scenario_from_dict(tables))


def off_truth(found, simulation):
    return (found.errors.vector - simulation.truth.vector)[SHOWN]


@pytest.fixture(scope="module")
def white():
    """A recording with white noise alone, and the results of all estimators."""
    simulation = simulated(1, noise=WHITE)
    return simulation, {name: srt.calibrate(simulation.recording, name, **EXACT) for name in ESTIMATORS}


@pytest.mark.parametrize("name", ESTIMATORS)
def test_without_noise_the_shipped_table_gives_the_truth(name, tmp_path):
    """The rate of the table is a draw, too: 1e-9 of it here."""
    text = (protocols_path() / "rate-table.toml").read_text()
    path = tmp_path / "rates.toml"
    path.write_text(text.replace("rate_sigma_ppm = 20.0", "rate_sigma_ppm = 1e-3"))
    simulation = simulated(1, protocol=str(path), recording={"noise": False})
    found = srt.calibrate(simulation.recording, name, **EXACT)
    assert found.status == "partial", found.message
    off = found.errors.vector - simulation.truth.vector
    off[GROUP_SLICES["accel_bias"]] /= G
    assert np.abs(off).max() < 2e-8


def test_estimators_agree_on_white_noise(white):
    """Least squares pools the rates at rest, the others weight them: 0.1 sigma of what a rate table shows."""
    _, found = white
    least, ekf, graph = (found[name] for name in ESTIMATORS)
    for joint in (ekf, graph):
        np.testing.assert_allclose(joint.sigma[SHOWN], least.sigma[SHOWN], rtol=0.02)
        assert np.all(np.abs(joint.errors.vector - least.errors.vector)[SHOWN] < 0.1 * least.sigma[SHOWN])
    # The filter's prior is wide.
    assert np.all(np.abs(ekf.errors.vector - graph.errors.vector)[SHOWN] < 1e-3 * graph.sigma[SHOWN])
    np.testing.assert_allclose(ekf.sigma[SHOWN], graph.sigma[SHOWN], rtol=1e-3)
    for one in found.values():
        scale = GROUP_SLICES["gyro_scale"]
        common = one.covariance[scale, scale][~np.eye(3, dtype=bool)]
        assert np.all(np.abs(common / (20e-6) ** 2 - 1.0) < 0.05)  # the error of the table is common to all runs
        assert np.all(one.contributions["stated_rate"][scale] > 0.9 * 20e-6)


@pytest.mark.parametrize("units", [5, pytest.param(100, marks=pytest.mark.campaign)])
@pytest.mark.parametrize(("name", "bias"), [*((name, "auto") for name in ESTIMATORS), ("least-squares", "g-sensitive")])
def test_errors_agree_with_their_sigmas(name, bias, units):
    """NEES of all parameters that a rate table shows, and of the gyro scale factors alone: 3.5 standard errors.

    Least squares estimates the unknown Earth rate of every pose and the g-sensitivity from the same rates at rest.
    """
    every, scale = [], []
    for seed in range(units):
        simulation = one_unit(9100 + seed)
        found = srt.calibrate(simulation.recording, name, **EXACT, gyro_bias=bias)
        assert found.status == "partial", found.message
        off, P = off_truth(found, simulation), found.covariance[np.ix_(SHOWN, SHOWN)]
        every.append(float(off @ np.linalg.solve(P, off)))
        scale.append(float(off[:3] @ np.linalg.solve(P[:3, :3], off[:3])))
    for nees, n in ((every, len(SHOWN)), (scale, 3)):
        freedom = n * units
        assert abs(sum(nees) - freedom) < 3.5 * math.sqrt(2.0 * freedom), (n, sum(nees) / freedom)


@cache
def one_unit(seed):
    return simulated(seed)


def test_drift_and_g_sensitivity_act_on_the_mean_rates():
    """Every coefficient, by differences of recordings that are compensated again."""
    case = make(simulated_motions(), VARIANTS["rates"], "large")
    joint = case.joint.with_force_axes(np.eye(3)).with_drift((DriftTerm("gyro", LINEAR, 1.0),), case.state)[0]
    step = 1e-6
    state = replace(case.state, drift=np.full(joint.choice.drift.size, 2.0 * step))
    system = linearise(joint, state, joint.compensate(state), case.system.free)
    J = unwhitened(system)["stated_rate"][1][..., system.columns["drift_form"]]
    for i in range(joint.choice.drift.size):
        residuals = []
        for sign in (1.0, -1.0):
            moved = replace(state, drift=state.drift + sign * step * np.eye(joint.choice.drift.size)[i])
            again = linearise(joint, moved, joint.compensate(moved), case.system.free)
            residuals.append(unwhitened_residuals(again)["stated_rate"])
        expected = (residuals[0] - residuals[1]) / (2.0 * step)
        # The axis of the run is that of the readings before the drift is taken off, and the Earth's rate is across it.
        tolerance = np.abs(J).max() * (np.abs(state.drift).sum() * G + 1e-4) / RATE
        np.testing.assert_allclose(J[..., i], expected, rtol=0, atol=tolerance)
    assert np.abs(J[..., :9]).max() > G / 2.0


def test_filters_of_one_pass_refuse_stated_rates():
    recording = simulated(1).recording
    run = next(label for label in recording.sequences if label.rate is not None)
    alone = recording.with_sequences((run,))
    with pytest.raises(srt.exceptions.InputError, match="no stated rates"):
        srt.calibrate(alone, "ekf", checks=False, filter="one-pass")


def test_a_fixture_whose_attitudes_are_not_used_changes_no_sigma_of_the_graph(white):
    """The angles of such a fixture have priors only, and are no part of the graph of the sensor errors."""
    simulation, found = white
    fixed = srt.calibrate(replace(simulation.recording, fixture=srt.Fixture()), "graph", **EXACT)
    assert fixed.sigma[SHOWN] == pytest.approx(found["graph"].sigma[SHOWN], rel=1e-6)
