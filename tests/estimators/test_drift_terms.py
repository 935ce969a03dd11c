"""Bias drift within a recording in Kalman filter and factor graph."""

from dataclasses import replace

import numpy as np
import pytest
from accuracy_trials import noisy_recording

import srt
from srt.constants import DEG_PER_H, MICRO_G
from srt.estimation.drift_model import DriftTerm
from srt.estimation.options import Options
from srt.noise.drift_forms import WALK
from srt.sensor_errors import N_PARAMETERS, SensorErrors

pytest.importorskip("filterpy")
from estimators.kalman_filter import run_filter
from srt.estimation.observability import default_prior
from srt.joint.drift import DriftTerms
from srt.joint.initial_attitudes import placed
from srt.joint.linearisation import linearise
from srt.joint.recording_opening import open_joint_model

ALL = np.ones(N_PARAMETERS, dtype=bool)
TERMS = (DriftTerm("accel", "linear", 1.0), DriftTerm("gyro", "warm-up", 1e-2), DriftTerm("accel", WALK, 1e-2))


def unwhitened(system, kind):
    rows = system.rows_of(kind)
    W, A = system.whitening[kind], system.A.toarray()
    return (
        np.linalg.solve(W, system.b[rows.index][..., None])[..., 0].ravel(),
        np.linalg.solve(W, A[rows.index]).reshape(rows.index.size, -1),
    )


def assert_columns(joint, draw, steps):
    """Residuals change by the columns of the first coefficients, at errors of a percent and the drift drawn.

    The drift within a rotation acts to first order, and through an attitude that it has turned itself: 1e-2 of its own
    effect is left.
    """
    rng = np.random.default_rng(4)
    errors = SensorErrors(joint.start.errors.vector + 1e-2 * rng.standard_normal(N_PARAMETERS))
    drift = np.concatenate(draw(rng))
    state, compensated = placed(joint, replace(joint.start, errors=errors, drift=drift))
    system = linearise(joint, state, compensated, ALL)
    assert system.columns.of("drift_form").size == drift.size
    for i, (column, step) in enumerate(zip(system.columns.of("drift_form").tolist(), steps, strict=False)):
        plus, minus = (replace(state, drift=drift + sign * step * np.eye(drift.size)[i]) for sign in (1.0, -1.0))
        plus, minus = (linearise(joint, s, joint.compensate(s), ALL) for s in (plus, minus))
        for kind in ("force", "rate", "turn"):
            J = unwhitened(system, kind)[1][:, column]
            expected = (unwhitened(plus, kind)[0] - unwhitened(minus, kind)[0]) / (2.0 * step)
            tolerance = 2e-2 if kind == "turn" else 1e-8
            assert np.abs(J - expected).max() <= tolerance * np.abs(J).max() + 1e-9, (kind, i)


@pytest.mark.slow
def test_columns_against_differences():
    """At drifts of 40 mg and 1000 °/h."""
    recording, _ = noisy_recording(1, "tactical", sample_rate_hz=50.0)
    joint = open_joint_model(recording, Options())
    joint = joint.with_choice(drift=DriftTerms(joint.data, TERMS))
    sizes = ((0.4, 3), (1000.0 * DEG_PER_H, 3), (0.1, joint.choice.drift.size - 6))
    assert_columns(joint, lambda rng: [rng.normal(0.0, *size) for size in sizes], 1e-2 * joint.choice.drift.sigma)


def ramp(recording, ug_per_h, deg_h_per_h=0.0):
    """The recording with ramps of all channels, zero on average over the labelled windows."""
    spans = [recording.window_indices(*w) for s in recording.sequences for w in (s.start_static_s, s.end_static_s)]
    at_rest = np.concatenate([recording.time[span] for span in spans]).mean()
    course = ((recording.time - at_rest) / 3600.0)[:, None] * np.array([1.0, -1.0, 1.0])
    accel, gyro = recording.accel + course * ug_per_h * MICRO_G, recording.gyro + course * deg_h_per_h * DEG_PER_H
    return replace(recording, accel=accel, gyro=gyro)


def test_the_closed_form_says_that_it_does_not_model_a_ramp():
    closed = srt.calibrate(ramp(noisy_recording(1, "navigation", sample_rate_hz=50.0)[0], 100.0), checks=False)
    (warning,) = (w for w in closed.warnings if "accelerometer biases changed" in w)
    assert "does not model it" in warning
    assert closed.diagnostics.drift[0].modelled is False


def test_a_ramp_of_the_accelerometers_alone():
    """100 µg/h: least squares keeps its accuracy."""
    recording, truth = noisy_recording(1, "navigation", sample_rate_hz=50.0)
    quiet, found = (srt.calibrate(r, "least-squares", checks=False) for r in (recording, ramp(recording, 100.0)))
    assert [term.sensor for term in found.diagnostics.drift] == ["accel"]
    error = found.errors.vector - truth.vector
    assert error @ np.linalg.solve(found.covariance, error) < 27.0 + 3.5 * np.sqrt(54.0)
    assert np.all(found.sigma < 2.0 * quiet.sigma)


@pytest.mark.parametrize("estimator", ["ekf", "graph"])
def test_ramps_on_a_fixture_are_named_and_modelled(estimator):
    """1 mg/h and 3 °/h with a navigation-grade unit: named with their size; sigmas within 1.5 of those without.

    The gyro bias of the unit is known to the standard deviation of its drift, as no instability is stated.
    """
    if estimator == "graph":
        pytest.importorskip("gtsam")
    recording, truth = noisy_recording(2, "navigation", sample_rate_hz=50.0)
    quiet, found = (srt.calibrate(r, estimator, checks=False) for r in (recording, ramp(recording, 1000.0, 3.0)))
    assert quiet.diagnostics.drift is None
    sizes = {term.sensor: term for term in found.diagnostics.drift}
    assert set(sizes) == {"accel", "gyro"}
    samples = [recording.window_indices(*w) for w in (recording.sequences[0].start_static_s,)]
    samples += [recording.window_indices(*recording.sequences[-1].end_static_s)]
    span = np.diff([recording.time[s].mean() for s in samples])[0] / 3600.0
    signs = np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(np.array(sizes["accel"].change_m_s2) / MICRO_G, span * 1000.0 * signs, atol=5.0)
    np.testing.assert_allclose(np.array(sizes["gyro"].change_rad_s) / DEG_PER_H, span * 3.0 * signs, atol=0.05)
    error = found.errors.vector - truth.vector
    assert error @ np.linalg.solve(found.covariance, error) < 27.0 + 3.5 * np.sqrt(54.0)
    assert np.all(found.sigma[:-3] < 1.5 * quiet.sigma[:-3])
    drifted = np.array(sizes["gyro"].change_rad_s) / np.sqrt(12.0)
    assert np.all(found.sigma[-3:] > np.abs(drifted))
    assert np.all(found.sigma[-3:] < np.hypot(drifted, 1.5 * quiet.sigma[-3:]))
    assert found.noise.degrees_of_freedom == quiet.noise.degrees_of_freedom - 6


def test_filter_is_the_block_solution_with_drift():
    """All forms together, a random walk included, at one point of linearisation."""
    from srt.joint.block_solution import BlockSolution

    recording = ramp(noisy_recording(3, "navigation", sample_rate_hz=50.0, instability=True)[0], 1000.0)
    joint = open_joint_model(recording, Options())
    joint = joint.with_choice(drift=DriftTerms(joint.data, TERMS))
    state, compensated = placed(joint, replace(joint.start, drift=np.zeros(joint.choice.drift.size)))
    prior = default_prior()
    solution = BlockSolution(linearise(joint, state, compensated, ALL, prior))
    filtered = run_filter(joint, linearise(joint, state, compensated, ALL), state, prior)
    sigma = np.sqrt(np.diag(solution.covariance))
    assert np.abs((filtered.covariance - solution.covariance) / np.outer(sigma, sigma)).max() < 1e-7
    assert np.abs(filtered.delta - solution.delta).max() < 1e-7 * np.abs(solution.delta).max()
