"""Preintegrated factor with the sensor errors: every Jacobian, its noise, its sums, and a graph that uses the prior."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from g_sensitive import with_g_sensitivity

import sims
import srt
from srt.model.rotations import rotation_matrix, rotation_vector
from srt.result.diagnostics import Diagnostics
from srt.result.noise_figures import NoiseFigures
from srt.sensor_errors import N_PARAMETERS, SensorErrors
from srt.stacks.preintegration import POSITION, ROTATION, VELOCITY, preintegrate

gtsam = pytest.importorskip("gtsam")

from srt.stacks.gtsam_factor import ErrorVariable, preintegrated_factor, residual_of  # noqa: E402

G = np.array([0.0, 0.0, -9.8])
DT = 0.005
RNG = np.random.default_rng(1)
NOISE = {
    "gyro_noise_rad_per_sqrt_s": np.array([3e-5, 4e-5, 5e-5]),
    "accel_noise_m_s2_sqrt_s": np.array([5e-4, 6e-4, 7e-4]),
}
SIGMA = np.r_[np.full(9, 5e-4), np.full(3, 2e-3), np.full(12, 5e-4), np.full(3, 5e-5)]
GAMMA = RNG.normal(0.0, 1e-4, (3, 3))


def calibrated(*, g_sensitive=False):
    root = RNG.normal(size=(N_PARAMETERS, N_PARAMETERS)) / 6.0 + np.eye(N_PARAMETERS)
    P = SIGMA[:, None] * (root @ root.T) * SIGMA
    diagnostics = with_g_sensitivity(GAMMA) if g_sensitive else Diagnostics()
    errors = SensorErrors(RNG.normal(0.0, 0.01, N_PARAMETERS))
    return srt.Calibration("hand", "converged", "", errors, P, noise=NoiseFigures(**NOISE), diagnostics=diagnostics)


def samples(n=200):
    """A second of quick turns and forces that never come near zero, where asymmetry has no derivative."""
    t = DT * np.arange(n)[:, None]
    gyro = np.array([0.9, -0.7, 1.2]) + 0.5 * np.sin(5.0 * t + np.array([0.0, 1.0, 2.0]))
    accel = np.array([4.0, -5.0, 8.0]) + 2.0 * np.cos(7.0 * t + np.array([0.5, 1.5, 2.5]))
    return gyro, accel


@pytest.mark.parametrize("g_sensitive", [False, True])
def test_derivatives_of_the_sums(g_sensitive):
    """By central differences of 1e-6 in each of the 27 errors."""
    unit = calibrated(g_sensitive=g_sensitive)
    gyro, accel = samples()
    found = preintegrate(unit, gyro, accel, DT)
    step = 1e-6
    for k in range(N_PARAMETERS):
        d = np.zeros(N_PARAMETERS)
        d[k] = step
        high, low = (
            preintegrate(unit, gyro, accel, DT, errors=SensorErrors(unit.errors.vector + sign * d))
            for sign in (1.0, -1.0)
        )
        turn = rotation_vector((low.rotation.T @ high.rotation)[None])[0] / (2.0 * step)
        # Rounding of a column is 1e-16 · 10 / 1e-6; the sums take a sample's own rotation to order dt/T = 1/200 of
        # what one sample does, 1/200 of the whole.
        for part, value in (
            (ROTATION, turn),
            (VELOCITY, (high.velocity - low.velocity) / (2.0 * step)),
            (POSITION, (high.position - low.position) / (2.0 * step)),
        ):
            np.testing.assert_allclose(found.jacobian[part, k], value, rtol=0, atol=2e-8 + 5e-5 * np.abs(value).max())


@pytest.mark.parametrize("count", [500, pytest.param(4000, marks=pytest.mark.campaign)])
def test_covariance_is_that_of_the_noise(count):
    """Draws of the samples' noise: n of them show a variance to √(2/n), 3.5 of these; correlations to √(1/n)."""
    unit = calibrated()
    gyro, accel = samples(40)
    exact = preintegrate(unit, gyro, accel, DT)
    rng = np.random.default_rng(2)
    draws = []
    for _ in range(count):
        noisy = [
            v + NOISE[key] / np.sqrt(DT) * rng.standard_normal(v.shape)
            for v, key in ((gyro, "gyro_noise_rad_per_sqrt_s"), (accel, "accel_noise_m_s2_sqrt_s"))
        ]
        found = preintegrate(unit, *noisy, DT)
        turn = rotation_vector((exact.rotation.T @ found.rotation)[None])[0]
        draws.append(np.r_[turn, found.velocity - exact.velocity, found.position - exact.position])
    P = np.cov(np.transpose(draws))
    sigma = np.sqrt(np.diag(exact.covariance))
    difference = (P - exact.covariance) / np.outer(sigma, sigma)
    # Asymmetry makes the corrected noise differ by 1 % with the sign, which the linear covariance leaves out: 2 %.
    assert np.abs(np.diag(difference)).max() < 3.5 * np.sqrt(2.0 / count) + 0.02
    assert np.abs(difference).max() < 4.5 * np.sqrt(2.0 / count) + 0.02


def test_sums_are_those_of_the_manifold_variant():
    """gtsam holds the attitude over a sample: ω × f dt/2 of force, 1e-2 at 5 ms, and a tenth of it at 0.5 ms."""
    unit = replace(calibrated(), errors=SensorErrors())
    for divide in (1, 10):
        n, dt = 200 * divide, DT / divide
        t = dt * np.arange(n)[:, None]
        gyro = np.array([0.9, -0.7, 1.2]) * (1.0 + 0.3 * np.sin(5.0 * t))
        accel = np.array([4.0, -5.0, 8.0]) * (1.0 + 0.2 * np.cos(7.0 * t))
        found = preintegrate(unit, gyro, accel, dt)
        summed = gtsam.PreintegratedImuMeasurementsManifold(
            gtsam.PreintegrationParams.MakeSharedU(9.8), gtsam.imuBias.ConstantBias()
        )
        for w, f in zip(gyro, accel, strict=True):
            summed.integrateMeasurement(f, w, dt)
        np.testing.assert_allclose(summed.deltaRij().matrix(), found.rotation, rtol=0, atol=1e-12)
        largest = np.linalg.norm(np.cross(gyro, accel), axis=1).max() * 0.5 * dt
        np.testing.assert_allclose(summed.deltaVij(), found.velocity, rtol=0, atol=largest)
        np.testing.assert_allclose(summed.deltaPij(), found.position, rtol=0, atol=0.5 * largest)


def state(rng):
    R = rotation_matrix(rng.normal(size=3))
    return R, 10.0 * rng.normal(size=3), rng.normal(size=3)


def test_jacobians_of_the_residual():
    """Every block, by central differences in gtsam's coordinates."""
    rng = np.random.default_rng(3)
    unit = calibrated()
    variable = ErrorVariable(unit)
    readings = preintegrate(unit, *samples(), DT)
    start = state(rng)
    # The end is near what the readings say, so that the rotation of the residual is large but not near π.
    end = (start[0] @ readings.rotation @ rotation_matrix(0.3 * rng.normal(size=3)), *state(rng)[1:])
    z = 3.0 * rng.normal(size=variable.size)
    _, blocks = residual_of(readings, variable, G, start, end, z)

    def moved(which, d):
        states = [list(start), list(end)]
        zz = z.copy()
        if which in (0, 2):
            R, p, v = states[which // 2]
            states[which // 2] = [R @ rotation_matrix(d[:3]), p + R @ d[3:], v]
        elif which in (1, 3):
            states[which // 2][2] = states[which // 2][2] + d
        else:
            zz = z + d
        return residual_of(readings, variable, G, tuple(states[0]), tuple(states[1]), zz)[0]

    step = 1e-5
    for which, block in enumerate(blocks):
        for k in range(block.shape[1]):
            d = np.zeros(block.shape[1])
            d[k] = step
            slope = (moved(which, d) - moved(which, -d)) / (2.0 * step)
            # Second order of the differences 1e-10 of values of 10; rounding 1e-15 · 10 / 1e-5.
            np.testing.assert_allclose(block[:, k], slope, rtol=0, atol=1e-8)


def test_the_factor_hands_them_to_gtsam():
    rng = np.random.default_rng(4)
    unit = calibrated()
    variable = ErrorVariable(unit)
    readings = preintegrate(unit, *samples(), DT)
    start = state(rng)
    end = (start[0] @ readings.rotation, *state(rng)[1:])
    z = rng.normal(size=variable.size)
    values = gtsam.Values()
    for key, (R, p, v) in ((0, start), (2, end)):
        values.insert(key, gtsam.Pose3(gtsam.Rot3(R), p))
        values.insert(key + 1, v)
    values.insert(4, z)
    factor = preintegrated_factor((0, 1, 2, 3, 4), readings, variable, G)
    residual, blocks = residual_of(readings, variable, G, start, end, z)
    expected = residual @ np.linalg.solve(readings.covariance, residual)
    assert 2.0 * factor.error(values) == pytest.approx(expected, rel=1e-9)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    ordering = gtsam.Ordering()
    for key in range(5):
        ordering.push_back(key)
    A, _ = graph.linearize(values).jacobian(ordering)
    J = np.hstack(blocks)
    np.testing.assert_allclose(
        A.T @ A, J.T @ np.linalg.solve(readings.covariance, J), rtol=1e-6, atol=1e-6 * (A.T @ A).max()
    )


def test_fixed_parameters_stay_out_of_the_variable():
    unit = calibrated()
    P = unit.covariance.copy()
    P[3:6] = P[:, 3:6] = 0.0
    variable = ErrorVariable(replace(unit, covariance=P))
    assert variable.size == N_PARAMETERS - 3
    np.testing.assert_allclose(variable.root @ variable.root.T, P, rtol=0, atol=1e-12 * P.max())
    z = np.random.default_rng(5).normal(size=variable.size)
    np.testing.assert_array_equal(variable.errors(z).vector[3:6], unit.errors.vector[3:6])
    assert variable.prior(7, weight=2.0).keys() == [7]


def test_the_recipe_of_the_page_converges_on_the_navigation_demo():
    """Gtsam's default solver makes no step there, and reports no failure."""
    page = (Path(__file__).parents[2] / "docs/exports.md").read_text(encoding="utf-8")
    section = page.partition("### Sensor errors as variables")[2].partition("\n## ")[0]
    recording = sims.simulate(sims.load_scenario("demo")).recording
    unit, gyro, accel = srt.calibrate(recording), recording.gyro, recording.accel
    known = {"gtsam": gtsam, "calibration": unit, "gyro": gyro, "accel": accel, "dt": recording.nominal_interval_s}
    known["force"] = unit.apply(gyro, accel)[1]
    for code in re.findall(r"^```python\n(.*?)^```", section, re.M | re.S):
        exec(code, known)  # noqa: S102 - our own page
    graph, start = known["graph"], known["start"]
    assert graph.error(start) > 4000.0
    assert graph.error(known["result"]) < 1.0
    assert 1 < known["optimizer"].iterations() < 10
    assert np.all(np.abs(known["errors"].vector - unit.errors.vector) <= 3.0 * np.sqrt(np.diag(unit.covariance)))
    untouched = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    assert graph.error(untouched) == graph.error(start)


def test_refusals():
    unit = calibrated()
    with pytest.raises(srt.InputError, match="0 samples"):
        preintegrate(unit, np.zeros((0, 3)), np.zeros((0, 3)), DT)
    with pytest.raises(srt.InputError, match="does not state the white noise of the gyro"):
        preintegrate(replace(unit, noise=NoiseFigures()), *samples(), DT)


@pytest.mark.parametrize(
    "count", [pytest.param(2, marks=pytest.mark.slow), pytest.param(8, marks=pytest.mark.campaign)]
)
def test_the_prior_helps_and_its_covariance_is_true(count):
    """Draws of unit, noise and fixes: squares of the errors over their covariance, 27 for z and 6 for a pose."""
    study = pytest.importorskip("intrinsic_priors")
    true, rng = study.truth(), np.random.default_rng(6)
    runs = [study.run(rng, true) for _ in range(count)]
    prior, fixed, ignored = (
        [r[name] for r in runs] for name in ("calibration as prior", "fixed at the calibration", "no prior")
    )
    for name, freedom in (("nees_z", 27), ("nees_pose", 6)):
        mean = np.mean([getattr(r, name) for r in prior])
        assert abs(mean - freedom) < 3.5 * np.sqrt(2.0 * freedom / count)

    def last(found):
        return np.sqrt(np.mean([r.position[-1] @ r.position[-1] for r in found]))

    assert last(prior) < last(fixed)
    assert np.mean([r.attitude**2 for r in prior]) < np.mean([r.attitude**2 for r in ignored])
    assert np.mean([r.z**2 for r in prior]) < 1.0 < np.mean([r.z**2 for r in ignored])
