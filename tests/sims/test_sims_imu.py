"""The simulator's IMU: statistics of its noise against their theory.

Readings worked by hand are in ``model/test_sensor_model``.
"""

import math

import numpy as np
import pytest

import sims
from sims.physics.imu import ALLAN_FLOOR, CORRELATION_TIMES_S, ImuModel, drift, read_out
from sims.physics.true_motion import TrueMotion
from srt.exceptions import InputError
from srt.recording.recording import ImuNoise, Site
from srt.sensor_errors import SensorErrors

SITE = Site(9.80665, 5e-6, math.radians(45.0))
NONE = SensorErrors()


def constant_motion(rate, force, n, sample_rate_hz=100.0, gap_after=None):
    """A motion of constant rate and specific force, in one piece or two."""
    dt = 1.0 / sample_rate_hz
    number = np.arange(n)
    starts = [0]
    if gap_after is not None:
        number[gap_after:] += 1000
        starts.append(gap_after)
    angle, velocity = np.tile(np.array(rate) * dt, (n, 1)), np.tile(np.array(force) * dt, (n, 1))
    return TrueMotion(
        (number + 1) / sample_rate_hz,
        dt,
        np.array(starts),
        angle,
        np.abs(angle),
        velocity,
        np.abs(velocity),
        windows=(),
        attitudes=np.zeros((0, 2, 3, 3)),
        labels=(),
        site=SITE,
        fixture=None,
        U=np.eye(3),
        draw=None,
    )


STILL = constant_motion((0, 0, 0), (0, 0, -9.8), 20000)


def chi_square_bounds(count, sigmas=3.5):
    """Interval of a chi-square of many degrees of freedom over that number, at about the given sigmas."""
    width = sigmas * math.sqrt(2.0 / count)
    return 1.0 - width, 1.0 + width


def test_g_sensitivity():
    G = np.arange(9.0).reshape(3, 3)
    recording = read_out(constant_motion((1, 1, 1), (1, 2, 3), 2), NONE, ImuModel(gyro_g_sensitivity=G))
    np.testing.assert_allclose(recording.gyro, [[9, 27, 45]] * 2, rtol=1e-14)
    np.testing.assert_allclose(recording.accel, [[1, 2, 3]] * 2, rtol=1e-14)


def test_increments_are_rates_times_the_interval():
    motion = sims.table1_motion(site=SITE, sequences=("7",), sample_rate_hz=100.0, dwell_s=1.0)
    model = ImuModel(gyro_noise=1e-4, accel_noise=1e-3, accel_bias_instability=1e-4, gyro_quantization=1e-6)
    errors = SensorErrors(np.random.default_rng(1).normal(size=27) * 1e-3)
    rate = read_out(motion, errors, model, np.random.default_rng(2))
    increment = read_out(motion, errors, model, np.random.default_rng(2), kind="increment")
    assert (rate.kind, increment.kind) == ("rate", "increment")
    np.testing.assert_allclose(increment.gyro, rate.gyro * 0.01, rtol=1e-14)
    np.testing.assert_allclose(increment.accel, rate.accel * 0.01, rtol=1e-14)


def test_random_walks_have_their_density():
    model = ImuModel(gyro_noise=2e-5, accel_noise=3e-4)
    recording = read_out(STILL, NONE, model, np.random.default_rng(4), kind="increment")
    dt = STILL.interval
    for increments, density in ((recording.gyro, 2e-5), (recording.accel - [0, 0, -9.8 * dt], 3e-4)):
        low, high = chi_square_bounds(increments.size)
        assert low < np.mean(increments**2) / (density**2 * dt) < high
        sums = increments.reshape(200, 100, 3).sum(axis=1)  # over 1 s: the density itself, and no correlation
        low, high = chi_square_bounds(sums.size)
        assert low < np.mean(sums**2) / density**2 < high


def test_gyro_and_accelerometer_noise_are_independent():
    model = ImuModel(gyro_noise=1.0, accel_noise=1.0)
    recording = read_out(STILL, NONE, model, np.random.default_rng(5))
    correlation = np.corrcoef(np.hstack([recording.gyro, recording.accel]).T) - np.eye(6)
    assert np.abs(correlation).max() < 3.5 / math.sqrt(len(STILL.time)) * 1.2  # 15 pairs


def test_bias_instability_sits_at_its_allan_floor():
    # Allan variance of Gauss-Markov processes (IEEE Std 952): the floor must be flat over the middle decades.
    spacing = math.log(10.0)
    variance = spacing / math.pi / ALLAN_FLOOR**2
    for tau in (3.0, 10.0, 30.0, 100.0):
        total = 0.0
        for correlation in CORRELATION_TIMES_S:
            x = tau / correlation
            bracket = 1.0 - (3.0 - 4.0 * math.exp(-x) + math.exp(-2.0 * x)) / (2.0 * x)
            total += 2.0 * variance / x * bracket
        assert math.sqrt(total) == pytest.approx(1.0, abs=0.1)


def test_drift_is_stationary_and_runs_on_across_gaps():
    motion = constant_motion((0, 0, 0), (0, 0, 0), 3, 1.0, gap_after=2)  # a gap of 1000 s
    rng = np.random.default_rng(6)
    draws = np.array([drift(1.0, motion, rng) for _ in range(1500)]).transpose(1, 0, 2).reshape(3, -1)
    process = math.log(10.0) / math.pi / ALLAN_FLOOR**2
    low, high = chi_square_bounds(draws.shape[1])
    for row in draws:
        assert low < np.mean(row**2) / (len(CORRELATION_TIMES_S) * process) < high
    for first, second, age in ((0, 1, 1.0), (1, 2, 1001.0)):
        expected = process * sum(math.exp(-age / tau) for tau in CORRELATION_TIMES_S)
        spread = 4 * process / math.sqrt(draws.shape[1])
        assert np.mean(draws[first] * draws[second]) == pytest.approx(expected, abs=3.5 * spread * math.sqrt(2.0))


def test_quantization_carries_its_remainder():
    quantum = 2.5e-6
    motion = constant_motion((1e-5, -3e-5, 0.2), (0, 0, 0), 5000, gap_after=2000)
    recording = read_out(motion, NONE, ImuModel(gyro_quantization=quantum), np.random.default_rng(8), kind="increment")
    pulses = recording.gyro / quantum
    np.testing.assert_allclose(pulses, np.round(pulses), atol=1e-9)
    for piece in (slice(0, 2000), slice(2000, None)):
        error = np.cumsum(recording.gyro[piece] - motion.angle[piece], axis=0)
        assert np.abs(error).max() < quantum
        assert np.ptp(error) > 0.9 * quantum


def test_saturation_and_resolution():
    motion = constant_motion((3.0, -3.0, 0.7), (50.0, -50.0, 0.26), 10)
    model = ImuModel(gyro_range=2.0, accel_range=40.0, gyro_resolution=0.5, accel_resolution=0.1)
    recording = read_out(motion, NONE, model)
    np.testing.assert_allclose(recording.gyro, [[2.0, -2.0, 0.5]] * 10, rtol=1e-14)
    np.testing.assert_allclose(recording.accel, [[40.0, -40.0, 0.3]] * 10, rtol=1e-14)


def test_statement_of_the_noise():
    model = ImuModel(gyro_noise=1e-5, accel_noise=1e-4, gyro_range=5.0)
    stated = read_out(STILL, NONE, model, np.random.default_rng(0)).noise
    assert stated == ImuNoise(gyro_noise=1e-5, accel_noise=1e-4, gyro_range=5.0)
    assert read_out(STILL, NONE, model, np.random.default_rng(0), state_noise=False).noise == ImuNoise()
    assert read_out(STILL, NONE).noise == ImuNoise()


def test_random_model_needs_a_generator():
    with pytest.raises(InputError, match="Generator"):
        read_out(STILL, NONE, ImuModel(gyro_noise=1.0))


def test_read_out_leaves_the_motion_alone():
    motion = constant_motion((1, 2, 3), (4, 5, 6), 5)
    before = motion.angle.copy()
    model = ImuModel(gyro_noise=1.0, gyro_range=1.0, gyro_quantization=0.1, gyro_resolution=0.1)
    read_out(motion, SensorErrors(np.full(27, 0.1)), model, np.random.default_rng(0))
    np.testing.assert_array_equal(motion.angle, before)
