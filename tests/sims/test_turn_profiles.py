"""Profiles of turns: rates, angles and ramps."""

import math
from typing import get_args

import numpy as np
import pytest

import sims
from sims.physics.free_motion import free_motion, random_durations, random_turns
from sims.physics.motion import angle_profile
from sims.physics.turn_profiles import ProfileName, peak_factor, turn_profile
from sims.scenarios.scenario import scenario_from_dict
from sims.scenarios.simulation import simulate
from srt.exceptions import InputError
from srt.recording.recording import Site

PROFILES = get_args(ProfileName)
SITE = Site(9.8, latitude_rad=0.7)
EPS = np.finfo(float).eps


def motion(profile, turns, durations, **changes):
    given = {"site": SITE, "dwell_s": 1.0, "sample_rate_hz": 100.0, "rng": np.random.default_rng(4)} | changes
    return free_motion(np.array(turns), profile=profile, durations_s=np.array(durations), **given)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("duration", [0.5, 3.0, 30.0])
def test_the_angle_runs_from_zero_to_the_whole_and_the_rate_is_its_derivative(profile, duration):
    made = turn_profile(profile, 2.0, duration, np.random.default_rng(1))
    s = np.linspace(0.0, 1.0, 20_001)
    angle, slope = made.evaluate(2.0, s)
    assert angle[[0, -1]] == pytest.approx([0.0, 2.0], abs=8 * EPS)
    # Central differences: third derivative times h²/6; at most (bandwidth)³ of the angle of 2 rad.
    h = s[1]
    inside = np.all([np.abs(s[1:-1] - border) > 2 * h for border in made.borders], axis=0) | (not made.borders)
    allowed = 2.0 * max(made.bandwidth, 1.0) ** 3 * h**2 / 6.0 + 8 * EPS / h
    assert np.abs((angle[2:] - angle[:-2]) / (2.0 * h) - slope[1:-1])[inside].max() < allowed
    assert np.abs(slope).max() <= 2.0 * made.peak * (1.0 + 8 * EPS)
    if profile != "recorded-hand":  # whose peak is a bound
        assert np.abs(slope).max() == pytest.approx(2.0 * peak_factor(profile), rel=1e-6)


def test_rates_at_the_ends():
    ends = {name: turn_profile(name, 1.0, 2.0, np.random.default_rng(1)).evaluate(1.0, np.array([0.0, 1.0]))[1]
            for name in PROFILES}  # fmt: skip
    np.testing.assert_allclose(ends.pop("constant-rate"), 1.0)
    for slope in ends.values():
        np.testing.assert_allclose(slope, 0.0, atol=4 * EPS)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("duration", [0.5, 30.0])
def test_integrals_do_not_depend_on_the_sample_rate(profile, duration):
    """Samples at 50 Hz are sums of twenty at 1000 Hz; the whole angle about the axis is that of the turn."""
    turns = random_turns(np.random.default_rng(3), 2)
    coarse, fine = (motion(profile, turns, [duration] * 2, sample_rate_hz=rate) for rate in (50.0, 1000.0))
    for name in ("angle", "angle_abs", "velocity", "velocity_abs"):
        whole = getattr(fine, name)[: 20 * len(coarse.time)].reshape(-1, 20, 3).sum(axis=1)
        # Rounding of edges in time, up to 60 s, times a rate of at most 8 rad/s or a force of 9.8 m/s².
        np.testing.assert_allclose(getattr(coarse, name), whole, rtol=0, atol=10.0 * 64.0 * EPS)
    still = motion(profile, turns[:1], [duration], earth_rate=False)
    # Each of up to 3,200 samples is rounded.
    np.testing.assert_allclose(still.angle.sum(axis=0), turns[0], rtol=0, atol=3200 * EPS)


def test_attitudes_do_not_depend_on_the_profile():
    turns = random_turns(np.random.default_rng(3), 3)
    ends = [motion(name, turns, [0.7, 3.0, 9.0]).attitudes for name in PROFILES]
    for other in ends[1:]:
        np.testing.assert_array_equal(other, ends[0])


def test_a_hand_differs_from_turn_to_turn_and_repeats_with_its_seed():
    turns = [[0.0, 0.0, 2.0]] * 2
    first, again = (motion("recorded-hand", turns, [2.0, 2.0]) for _ in range(2))
    np.testing.assert_array_equal(first.angle, again.angle)
    (_, a), (_, b) = first.windows
    rate = first.angle[:, 2] / first.interval
    one, two = (rate[(first.time > end[1]) & (first.time < start[0])] for end, start in first.windows)
    count = min(len(one), len(two))
    assert a != b
    # Fluctuations are 15 % of the mean rate of 1 rad/s, and the tremor 0.05 rad/s, two components of each.
    assert 0.02 < np.std(one[:count] - two[:count]) < 0.6


def test_durations_are_log_uniform_within_their_limits():
    drawn = random_durations(np.random.default_rng(2), 4000, 0.5, 30.0)
    assert 0.5 <= drawn.min() < drawn.max() <= 30.0
    # The median of a log-uniform draw is the geometric mean; 5 standard errors of its logarithm.
    error = math.log(60.0) * 0.5 / math.sqrt(4000)
    assert abs(math.log(np.median(drawn)) - math.log(math.sqrt(15.0))) < 5 * error


def scenario(**free):
    tables = {"seed": 1, "imu": {"from": "perfect"}, "site": {"from": "latitude-45"}}
    return scenario_from_dict({**tables, "recording": {"noise": False}, "free": {"turns": 4, "dwell_s": 1.0, **free}})


@pytest.mark.parametrize("profile", PROFILES)
def test_a_scenario_takes_every_profile_and_durations(profile):
    run = simulate(scenario(profile=profile, turn_duration_s=[0.5, 3.0]))
    lasted = [second[0] - first[1] for first, second in run.windows]
    assert len(lasted) == 4
    assert 0.5 <= min(lasted) <= max(lasted) <= 3.0 + 1.0 / 200.0


@pytest.mark.parametrize(
    ("free", "said"),
    [
        ({"profile": "jerky"}, "free.profile is 'jerky'"),
        ({"turn_duration_s": [3.0, 1.0]}, "longest turn first"),
        ({"turn_duration_s": [0.1, 1.0]}, "not below 0.5"),
        ({"turn_duration_s": [1.0, 40.0]}, "not above 30"),
        ({"turn_duration_s": [1.0, 2.0], "peak_rate_rad_s": 1.0}, "either peak_rate_rad_s or turn_duration_s"),
    ],
)
def test_mistakes_are_one_sentence(free, said):
    with pytest.raises(InputError, match=said):
        scenario(**free)


def test_wrong_arguments_are_refused():
    with pytest.raises(InputError, match="no turn profile 'jerky'"):
        motion("jerky", [[0.0, 0.0, 1.0]], [1.0])
    with pytest.raises(InputError, match="pass a numpy"):
        motion("recorded-hand", [[0.0, 0.0, 1.0]], [1.0], rng=None)
    for durations in ([1.0, 2.0], [0.0]):
        with pytest.raises(InputError, match="a positive one for each of 1 turns"):
            motion("quintic", [[0.0, 0.0, 1.0]], durations)


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
