"""Turns with motion near and above half the sample rate, by a generator that shares nothing with the estimators."""

from functools import lru_cache

import numpy as np
import pytest
from foreign_motion import DEG, GRADES, GRAVITY_M_S2, attitudes, drawn_errors, hand_turns, readings, true_samples
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import srt
from srt.sensor_errors import NAMES

HZ, FIRST_REST_S, LATITUDE = 62.5, 5.0, 34.0 * DEG
SHAKING_HZ, SHAKING_RAD = 8.0, 1e-3
"""Lowest frequency of the shaking in turns, and its angle, which falls with the square of the frequency."""


@lru_cache
def shaken(seed, *, filtered):
    """Recording of a unit that shakes while a hand turns it, and its errors; readings at one moment, or averages."""
    rng = np.random.default_rng((20261128, seed))
    turns, grade = hand_turns(rng, shortest_s=1.0, longest_s=4.0, rest_s=6.0), GRADES["consumer"]
    start = Rotation.from_euler("ZYX", (-91.0, 1.0, -91.0), degrees=True)
    body = attitudes(turns, start, FIRST_REST_S, 1.0 / HZ, "hand", rng)
    t = np.arange(len(body)) / HZ / 8
    begins = FIRST_REST_S + np.cumsum([0.0, *(turn.duration_s + turn.rest_s for turn in turns[:-1])])
    shaking = np.zeros((len(t), 3))
    frequency = np.fft.rfftfreq(len(t), t[1])
    size = np.where(frequency > SHAKING_HZ, (SHAKING_HZ / np.maximum(frequency, SHAKING_HZ)) ** 2, 0.0)
    course = np.fft.irfft(size[:, None] * np.fft.rfft(rng.normal(size=(len(t), 3)), axis=0), len(t), axis=0)
    course *= SHAKING_RAD / course.std()
    for begin, turn in zip(begins, turns, strict=True):
        s = (t - begin) / turn.duration_s
        inside = (s > 0.0) & (s < 1.0)
        shaking[inside] = (rng.uniform(0.3, 1.7) * np.sin(np.pi * s[inside]) ** 2)[:, None] * course[inside]
    rate, force = true_samples(body * Rotation.from_rotvec(shaking), 1.0 / HZ, LATITUDE)
    errors = drawn_errors(grade, rng, asymmetry=False)
    gyro, accel = readings(rate if filtered else rate[:, 4:5], force, errors, grade, 1.0 / HZ, rng)
    time = (np.arange(len(gyro)) + (0.0 if filtered else -0.5 + 4.5 / 8)) / HZ
    truth = np.array([errors.get(name, 0.0) for name in NAMES])
    return srt.Recording(time, gyro, accel, srt.Site(GRAVITY_M_S2, latitude_rad=LATITUDE)), truth


@pytest.mark.parametrize("estimator", ["least-squares", "ekf", "graph"])
@pytest.mark.parametrize("seed", range(2))
def test_motion_too_fast_for_the_sample_rate_is_named_and_in_the_sigmas(seed, estimator):
    recording, truth = shaken(seed, filtered=False)
    found = srt.calibrate(recording, estimator)
    assert found.judgement.word in ("sound", "partial"), found.judgement
    assert "motion too fast for the sample rate" in found.judgement.reason
    assert any("too slow for these turns" in warning for warning in found.warnings)
    assert 0.2 < found.diagnostics.undersampling.share < 0.8
    off = (found.errors.vector - truth)[found.observed]
    statistic = off @ np.linalg.solve(found.covariance[np.ix_(found.observed, found.observed)], off)
    assert statistic < chi2.ppf(1.0 - 0.01 / 6, int(found.observed.sum()))


def test_averages_of_the_same_motion_have_no_such_error():
    found = srt.calibrate(shaken(0, filtered=True)[0])
    assert found.diagnostics.undersampling is None
    assert found.judgement.word in ("sound", "partial"), found.judgement
