"""Gyro bias that differs from sequence to sequence: its scatter, its course, and a value of it that is fixed."""

from dataclasses import replace
from functools import cache

import accuracy_trials
import numpy as np
import pytest
from linear_problems import iterated_to_rounding

import srt
from sims.physics.imu import ImuModel, read_out
from sims.physics.table_motion import table1_motion
from srt.constants import DEG_PER_SQRT_H, MICRO_G
from srt.recording.recording import Fixture
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, SensorErrors

SCATTER = 2e-5
"""Scatter of the biases, rad/s: 4 °/h, of which a window shows a hundredth."""
to_rounding = pytest.fixture(iterated_to_rounding)
BIAS = GROUP_SLICES["gyro_bias"]


@cache
def unit(scatter=SCATTER):
    """Table 1 with a unit of no errors but a bias of each sequence; the recording and the biases, (K, 3) in rad/s."""
    motion = table1_motion(
        site=accuracy_trials.SITE, stated_fixture=Fixture(0.0, 1e-4, 1e-4), heading_rad=0.0, sample_rate_hz=20.0,
        rate_rad_s=3.0, dwell_s=4.0,
    )  # fmt: skip
    imu = ImuModel(gyro_noise=0.001 * DEG_PER_SQRT_H, accel_noise=2.0 * MICRO_G)
    recording = read_out(motion, SensorErrors(), imu, np.random.default_rng(1))
    drawn = np.random.default_rng(2).normal(0.0, scatter, (len(recording.sequences), 3))
    gyro = recording.gyro.copy()
    for label, bias in zip(recording.sequences, drawn, strict=True):
        gyro[recording.window_indices(label.start_static_s[0], label.end_static_s[1])] += bias
    return replace(recording, gyro=gyro), drawn


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares"])
def test_the_bias_is_uncertain_by_its_scatter_between_sequences(estimator):
    """The bias of the test is one draw of the unit's; the mean of K sequences has at most 1 / K of their variance."""
    recording, drawn = unit()
    found, scatter, K = srt.calibrate(recording, estimator, checks=False), drawn.std(axis=0, ddof=1), len(drawn)
    np.testing.assert_allclose(found.noise.gyro_bias_wander_rad_s, scatter, rtol=0.01)
    for variance in (found.sigma[BIAS] ** 2, found.contributions["gyro_bias_instability"][BIAS] ** 2):
        assert np.all(variance > 0.98 * scatter**2)
        assert np.all(variance < 1.02 * (1.0 + 1.0 / K) * scatter**2)


@pytest.mark.parametrize("stated", [None, SCATTER])
def test_biases_of_sequences_are_about_their_mean(stated):
    recording, drawn = unit()
    recording = replace(recording, noise=replace(recording.noise, gyro_bias_instability=stated))
    found = srt.calibrate(recording, "least-squares", checks=False).noise.gyro_bias_by_sequence_rad_s
    np.testing.assert_allclose(found, drawn - drawn.mean(axis=0), rtol=0, atol=0.05 * SCATTER)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=1e-12 * SCATTER)


@pytest.mark.parametrize("gyro_bias", ["pooled", "per-sequence"])
@pytest.mark.parametrize("estimator", ["closed-form", "least-squares"])
@pytest.mark.usefixtures("to_rounding")
def test_a_fixed_bias_is_off_by_the_same_in_every_sequence(estimator, gyro_bias, monkeypatch):
    """The contribution of a fixed bias with a sigma is half the change of the result from one sigma below to above."""
    name, size = "gyro_bias_x", 1e-9
    sigma = np.where(np.arange(N_PARAMETERS) == INDEX[name], size, 0.0)
    module = {"closed-form": "srt.closed_form.estimator", "least-squares": "srt.joint.calibration_run"}[estimator]
    monkeypatch.setattr(f"{module}.fixed_sigma", lambda _data, _options: sigma)
    below, above = (
        srt.calibrate(
            unit(0.0)[0], estimator, hold=(name,), start=SensorErrors(sign * sigma), gyro_bias=gyro_bias, checks=False
        )
        for sign in (-1.0, 1.0)
    )
    change = 0.5 * np.abs(above.errors.vector - below.errors.vector)
    others = np.arange(N_PARAMETERS) != INDEX[name]
    np.testing.assert_allclose(above.contributions["held_values"][others], change[others], atol=1e-3 * change.max())
