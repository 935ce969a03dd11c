"""Angles of the fixture over time: rate, acceleration and ringing of a rotation."""

import math

import numpy as np
import pytest

import sims
from sims.physics.motion import JoinedProfile, angle_profile


def angles(profile, piece, time):
    """Angles and rates of one episode."""
    joined = JoinedProfile()
    joined.append(profile)
    return joined.angles(piece, time)


@pytest.mark.parametrize(("angle", "rate"), [(2.0 * math.pi, 1.0), (-0.5, 1.0), (0.05, 1.0), (-1e-4, 2.0)])
def test_profile_reaches_its_angle_without_jumps(angle, rate):
    profile = sims.RateProfile(rate, 10.0)
    turned = angle_profile((0.2, -0.1), [(1, angle)], profile)
    assert turned.end_rad == (0.2, -0.1 + angle)
    assert turned.legs_end_s == pytest.approx(profile.duration_s(angle), rel=1e-15)
    borders = turned.breaks_s[1:-1]
    before = angles(turned, np.arange(len(borders))[:, np.newaxis], borders[:, np.newaxis])
    after = angles(turned, np.arange(1, len(borders) + 1)[:, np.newaxis], borders[:, np.newaxis])
    for left, right in zip(before, after, strict=True):
        np.testing.assert_allclose(left, right, rtol=0.0, atol=5e-15)
    assert np.abs(before[1]).max() <= rate * (1.0 + 1e-12)


@pytest.mark.parametrize(("angle", "duration", "peak"), [(1.0, 2.5, 0.5), (0.4, 1.3, 0.5), (0.16, 0.8, 0.4)])
def test_duration_and_peak_rate(angle, duration, peak):
    # By hand, for 0.5 rad/s and 1 rad/s²: from 0.25 rad on a plateau, angle/0.5 + 0.5 s; below, 2 √angle.
    profile = sims.RateProfile(0.5, 1.0)
    assert profile.duration_s(angle) == pytest.approx(duration, rel=1e-14)
    turned = angle_profile((0.0, 0.0), [(0, angle)], profile)
    rate = angles(turned, np.array([[1]]), np.array([[turned.breaks_s[1]]]))[1]
    assert rate[0, 0, 0] == pytest.approx(peak, rel=1e-14)


def test_ringing_starts_smoothly_and_dies_away():
    ringing = sims.RateProfile(1.0, 10.0, settling_rad=1e-3, settling_hz=5.0, settling_decay_s=0.1)
    turned = angle_profile((0.0, 0.0), [(0, 1.0)], ringing)
    borders = turned.breaks_s[1:-1]
    piece = np.arange(len(borders))[:, np.newaxis]
    left = angles(turned, piece, borders[:, np.newaxis])
    right = angles(turned, piece + 1, borders[:, np.newaxis])
    np.testing.assert_allclose(left[0], right[0], atol=2e-15)
    np.testing.assert_allclose(left[1], right[1], atol=1e-14)
    # The rate is the derivative of the angle: central differences, error h²/6 times the third derivative.
    t = turned.legs_end_s + np.linspace(0.01, 0.5, 50)[np.newaxis]
    last = np.array([[len(turned.moving) - 2]])
    h = 1e-5
    difference = (angles(turned, last, t + h)[0] - angles(turned, last, t - h)[0]) / (2.0 * h)
    np.testing.assert_allclose(angles(turned, last, t)[1], difference, atol=1e-3 * (2 * math.pi * 15.0) ** 3 * h**2)
    assert 2e-4 < np.abs(angles(turned, last, t)[0] - 1.0)[..., 0].max() <= 1e-3
    assert not turned.moving[-1]
