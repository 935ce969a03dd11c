"""Recordings of a foreign simulator without noise: rounded to single precision, and with errors of its integration."""

import numpy as np
import pytest
from foreign_fixture import LATITUDE_DEG, on_fixture, table_1
from foreign_motion import DEG, GRADES, GRAVITY_M_S2, drawn_errors

import srt
from srt.sensor_errors import NAMES

UNITS = {"SI": (1.0, 1.0), "deg/s and g": (DEG, 9.80665)}


def simulated(seed, *, integration=0.0, unit=None, wrong=None):
    """Recording without noise and its errors; rates off by a share ``integration`` that changes every 7 s.

    Those of the sequence ``wrong`` are off by 1e-4.
    """
    rng = np.random.default_rng((20261201, seed))
    errors = drawn_errors(GRADES["tactical"], rng)
    motion = on_fixture(table_1(), rng, rest_s=10.0, rate_rad_s=0.6, sigma_rad=1e-3)
    samples = motion.sampled(errors, None, rng)
    time, gyro, accel = samples["time"], samples["gyro"], samples["accel"]
    gyro = gyro * (1.0 + rng.normal(0.0, integration, (int(time[-1] // 7.0) + 1, 3))[(time // 7.0).astype(int)])
    if unit is not None:
        gyro, accel = (
            np.float64(scale) * (x / scale).astype(np.float32)
            for x, scale in zip((gyro, accel), UNITS[unit], strict=True)
        )
    labels = tuple(
        srt.SequenceLabel(tuple(row["start_static_s"]), tuple(row["end_static_s"]), id=row["id"])
        for row in motion.labels(0.1)
    )
    for label in labels:
        if label.id == wrong:
            gyro[(time > label.start_static_s[1]) & (time < label.end_static_s[0])] *= 1.0 + 1e-4
    site, fixture = srt.Site(GRAVITY_M_S2, latitude_rad=LATITUDE_DEG * DEG), srt.Fixture(0.0, 1e-3, 1e-3)
    truth = np.array([errors.get(name, 0.0) for name in NAMES])
    return srt.Recording(time, gyro, accel, site, fixture=fixture, sequences=labels), truth


def assert_sound(recording, truth, estimator, limit):
    found = srt.calibrate(recording, estimator)
    assert found.status == "converged", found.message
    assert found.judgement.word == "sound", found.judgement.reason
    # Normal to six sigma at most: the shares are few, and what a float32 reading is off by is uniform.
    off = np.abs(found.errors.vector - truth)
    assert np.all(off < 6.0 * found.sigma)
    assert np.all(off < limit)
    return found


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("estimator", ["closed-form", "least-squares"])
def test_single_precision_has_the_rounding_of_its_readings(estimator, unit):
    """Half a step of 9.8 m/s² is 5e-7 m/s² or less, of 1 rad/s 6e-8 rad/s, which averages over a turn."""
    assert_sound(*simulated(1, unit=unit), estimator, 2e-6)


@pytest.mark.parametrize("integration", [1e-8, 1e-7, 1e-6])
@pytest.mark.parametrize("estimator", ["least-squares", "ekf", "graph"])
def test_errors_of_the_integration_are_no_fault_of_a_turn(estimator, integration):
    found = assert_sound(*simulated(2, integration=integration), estimator, 20.0 * integration)
    share = found.diagnostics.undersampling
    assert share.noise_free
    # A turn of some seven seconds has one or two draws of the error, of each axis.
    assert 0.2 * integration < share.share < 2.0 * integration
    assert "Readings without noise: the rotations agree to" in found.judgement.reason


@pytest.mark.slow
def test_a_sequence_that_is_wrong_is_named_also_without_noise():
    recording, _ = simulated(3, wrong="9")
    assert srt.calibrate(recording, "least-squares").consistency.contradicting.sequence == "9"
    assert srt.calibrate(recording, "closed-form").judgement.word == "failed"
