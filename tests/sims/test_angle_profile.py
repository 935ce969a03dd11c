"""Angles of the fixture over time: rate, acceleration and ringing of a rotation."""

import math

import numpy as np
import pytest

import sims
from sims.physics.motion import angle_profile


def turned_by(start, axis, angle, profile):
    """One leg from a start, and its oscillation."""
    turned = angle_profile(np.array([start]), np.array([[axis]]), np.array([[angle]]), profile)
    return turned.with_ringings(np.zeros(1, dtype=int), 0.01)


def sides(turned, axis):
    """Angle and rate of an axis before and after each border."""
    borders = turned.begin_s[1:]
    piece = np.arange(len(borders))
    return zip(*(turned.angle(axis, own, borders[np.newaxis]) for own in (piece, piece + 1)), strict=True)


@pytest.mark.parametrize(("angle", "rate"), [(2.0 * math.pi, 1.0), (-0.5, 1.0), (0.05, 1.0), (-1e-4, 2.0)])
def test_profile_reaches_its_angle_without_jumps(angle, rate):
    profile = sims.RateProfile(rate, 10.0)
    turned = turned_by((0.2, -0.1), 1, angle, profile)
    assert turned.coefficients[:, 0, -1].tolist() == [0.2, -0.1 + angle]
    assert turned.legs_end_s == pytest.approx(profile.duration_s(angle), rel=1e-15)
    assert turned.begin_s[-1] == turned.legs_end_s
    for axis in (0, 1):
        for left, right in sides(turned, axis):
            np.testing.assert_allclose(left, right, rtol=0.0, atol=5e-15)
    assert np.abs(turned.angle(1, np.arange(len(turned.end_s) - 1), turned.end_s[np.newaxis, :-1])[1]).max() <= rate * (
        1.0 + 1e-12
    )


@pytest.mark.parametrize(("angle", "duration", "peak"), [(1.0, 2.5, 0.5), (0.4, 1.3, 0.5), (0.16, 0.8, 0.4)])
def test_duration_and_peak_rate(angle, duration, peak):
    # By hand, for 0.5 rad/s and 1 rad/s²: from 0.25 rad on a plateau, angle/0.5 + 0.5 s; below, 2 √angle.
    profile = sims.RateProfile(0.5, 1.0)
    assert profile.duration_s(angle) == pytest.approx(duration, rel=1e-14)
    turned = turned_by((0.0, 0.0), 0, angle, profile)
    rate = turned.angle(0, np.array([1]), turned.begin_s[np.newaxis, 1:2])[1]
    assert rate[0, 0] == pytest.approx(peak, rel=1e-14)


def test_ringing_starts_smoothly_and_dies_away():
    ringing = sims.RateProfile(1.0, 10.0, settling_rad=1e-3, settling_hz=5.0, settling_decay_s=0.1)
    turned = turned_by((0.0, 0.0), 0, 1.0, ringing)
    for (left, right), atol in zip(sides(turned, 0), (2e-15, 1e-14), strict=True):
        np.testing.assert_allclose(left, right, atol=atol)
    # The rate is the derivative of the angle: central differences, error h²/6 times the third derivative.
    t = turned.legs_end_s + np.linspace(0.01, 0.5, 50)[:, np.newaxis]
    last = np.array([len(turned.kind) - 2])
    h = 1e-5
    difference = (turned.angle(0, last, t + h)[0] - turned.angle(0, last, t - h)[0]) / (2.0 * h)
    np.testing.assert_allclose(turned.angle(0, last, t)[1], difference, atol=1e-3 * (2 * math.pi * 15.0) ** 3 * h**2)
    assert 2e-4 < np.abs(turned.angle(0, last, t)[0] - 1.0).max() <= 1e-3
    assert turned.kind[-1] == 0
