"""Unlabelled turns of a generator that shares nothing with simulator or estimators: errors match their sigmas."""

from functools import lru_cache

import numpy as np
import pytest
from foreign_fixture import LATITUDE_DEG, on_fixture, table_1
from foreign_motion import (
    DEG,
    GRADES,
    GRAVITY_M_S2,
    NINETEEN_START_DEG,
    PROFILES,
    Grade,
    angle_share,
    drawn_errors,
    hand_turns,
    nineteen_positions,
    recording,
    windows,
)
from scipy.stats import chi2

import srt
from srt.sensor_errors import GROUP_SLICES, NAMES
from srt.sequences.stationary_windows import find_windows

SEED = 20261122


def half_of_the_grid(full):
    """Combinations of grade and profile, all of them or every second one: half the profiles of each grade."""
    return [
        (grade, profile)
        for g, grade in enumerate(GRADES)
        for p, profile in enumerate(PROFILES)
        if full or (g + p) % 2 == 0
    ]


@lru_cache(maxsize=16)
def unit(seed, grade, profile):
    """A recording without labels and the true errors of its unit, shape (27,)."""
    rng = np.random.default_rng((SEED, seed))
    errors = drawn_errors(GRADES[grade], rng)
    turns = hand_turns(rng, shortest_s=0.5, longest_s=30.0)
    unlabelled = recording(turns, 5.0, errors, GRADES[grade], rng, profile=profile)
    return unlabelled, np.array([errors.get(name, 0.0) for name in NAMES])


def normalised(seed, grade, profile, estimator="least-squares"):
    """Normalised errors of one unit, NaN where a parameter is not observed."""
    unlabelled, truth = unit(seed, grade, profile)
    found = srt.calibrate(unlabelled, estimator, checks=False)
    assert found.status in ("converged", "partial"), found.message
    z = np.full(len(NAMES), np.nan)
    z[found.observed] = (found.errors.vector - truth)[found.observed] / found.sigma[found.observed]
    return z


@pytest.mark.parametrize(
    "units", [pytest.param(1, id="small"), pytest.param(20, id="full", marks=pytest.mark.campaign)]
)
def test_errors_of_hand_turned_units_match_their_sigmas(units):
    """Turns of 0.5-30 s, four profiles, four grades: the rms of each parameter in its family-wise 1 % band."""
    grades, profiles = list(GRADES), list(PROFILES)
    z = np.array(
        [
            normalised(1000 * grades.index(grade) + 100 * profiles.index(profile) + number, grade, profile)
            for grade, profile in half_of_the_grid(units > 1)[:: 1 if units > 1 else 2]
            for number in range(units)
        ]
    )
    # Where the excess noise is estimated from the recording itself, its own uncertainty widens the errors: Student's
    # factor for the 44 degrees of freedom that 24 turns leave.
    widening = 44 / 42
    for i, name in enumerate(NAMES):
        column = z[np.isfinite(z[:, i]), i]
        n, tail = len(column), 0.01 / (2 * len(NAMES))
        assert chi2.ppf(tail, n) <= np.sum(column**2) <= chi2.isf(tail, n) * widening, name


def angles_in_windows(samples, turns, rests, profile):
    """Angle turned inside each found window, rad, and its length, s; ``rests`` are those before and after each turn."""
    begins, ends = np.array(rests).T
    found = find_windows(samples)
    first, last = samples.time[found[:, 0]] - 0.01, samples.time[found[:, 1] - 1]
    inside = np.zeros(len(found))
    whole = ends - begins > 1.0  # those between the turns of a sequence are none
    assert np.count_nonzero(whole) == len(found)
    for w, rest in enumerate(np.flatnonzero(whole)):
        for turn, t in ((rest, last[w] - ends[rest]), (rest - 1, begins[rest] - first[w])):
            if 0 <= turn < len(turns):  # profiles are symmetric: the end of a turn is its start, backward
                share = angle_share(profile, np.array([t / turns[turn].duration_s]))
                inside[w] += abs(turns[turn].angle_rad) * float(share[0])
    return inside, last - first


@pytest.mark.parametrize(
    ("grade", "profile"),
    [
        pytest.param(*pair, marks=[] if pair in half_of_the_grid(full=False) else pytest.mark.slow)
        for pair in half_of_the_grid(full=True)
    ],
)
def test_windows_hold_no_end_of_a_turn(grade, profile):
    """The angle turned inside a found window is less than six sigma of the unit's noise over it."""
    rng = np.random.default_rng((SEED, 7))
    turns = hand_turns(rng, shortest_s=0.5, longest_s=30.0)
    samples = recording(turns, 5.0, {}, GRADES[grade], rng, profile=profile)
    inside, duration_s = angles_in_windows(samples, turns, windows(turns, 5.0), profile)
    assert np.all(inside < 6.0 * GRADES[grade].gyro_rad_per_sqrt_s * np.sqrt(duration_s))


FINE = Grade(0.001 * DEG / 60.0, 10e-6 * 9.80665, 3e-5, 1.5e-4, 0.2 * DEG / 3600.0, 2e-3)
"""Unit of the comparison with PSINS: 0.001 °/√h and 10 µg/√Hz."""


@lru_cache(maxsize=8)
def nineteen(seed, grade, noise, profile):
    """A recording of the 19-position test without labels, and the true errors of its unit, shape (27,)."""
    rng = np.random.default_rng((SEED, seed))
    errors = drawn_errors(grade, rng, asymmetry=False)
    turns, first_rest_s = nineteen_positions()
    unlabelled = recording(turns, first_rest_s, errors, noise, rng, profile=profile, start_deg=NINETEEN_START_DEG)
    return unlabelled, np.array([errors.get(name, 0.0) for name in NAMES])


@pytest.mark.parametrize(
    ("profile", "estimator"),
    [
        ("raised-cosine", "least-squares"),
        ("raised-cosine", "ekf"),
        ("trapezoid", "graph"),
        *(pytest.param("trapezoid", name, marks=pytest.mark.slow) for name in ("least-squares", "ekf")),
        pytest.param("raised-cosine", "graph", marks=pytest.mark.slow),
    ],
)
def test_nineteen_positions_without_labels_and_without_noise(profile, estimator):
    """The 19-position test (Xie Bo 2011) with soft ends, heading unknown: 0.05 ppm, 0.1 µrad and 1 µg."""
    pytest.importorskip({"graph": "gtsam", "ekf": "filterpy"}.get(estimator, "numpy"))
    unlabelled, truth = nineteen(19, GRADES["tactical"], None, profile)
    found = srt.calibrate(unlabelled, estimator, hold=("gyro_asymmetry", "accel_asymmetry"), checks=False)
    difference = np.abs(found.errors.vector - truth)
    observed = found.observed
    for group, limit in (
        ("gyro_scale", 0.05e-6),
        ("gyro_orthogonality", 0.1e-6),
        ("accel_misalignment", 0.1e-6),
        ("accel_bias", 9.81e-6),
    ):
        part = GROUP_SLICES[group]
        assert np.all(difference[part][observed[part]] < limit), group


@pytest.mark.parametrize(
    "units", [pytest.param(2, id="small"), pytest.param(100, id="full", marks=pytest.mark.campaign)]
)
@pytest.mark.parametrize("estimator", ["least-squares", "graph"])
def test_nineteen_positions_with_noise(estimator, units):
    """0.001 °/√h and 10 µg/√Hz, no labels: the rms of each error group in the family-wise 1 % band of its sigma."""
    pytest.importorskip("gtsam" if estimator == "graph" else "numpy")
    z = []
    for number in range(units):
        unlabelled, truth = nineteen(1900 + number, FINE, FINE, "raised-cosine")
        found = srt.calibrate(unlabelled, estimator, hold=("gyro_asymmetry", "accel_asymmetry"), checks=False)
        z.append(np.where(found.observed, (found.errors.vector - truth) / np.nan_to_num(found.sigma, nan=1.0), np.nan))
    tail = 0.01 / (2 * len(NAMES))
    for i, name in enumerate(NAMES):
        column = np.array(z)[:, i]
        if np.all(np.isfinite(column)):
            assert chi2.ppf(tail, units) <= np.sum(column**2) <= chi2.isf(tail, units), name


def with_pulses(motion, errors, pulse_arcsec, rng, profile="raised-cosine"):
    """Recording without labels whose gyros count pulses and carry the remainder over, as rates; the fixture: 1 mrad."""
    samples, pulse = motion.sampled(errors, FINE, rng, hz=100.0, profile=profile), pulse_arcsec * DEG / 3600.0
    counts = np.rint(np.cumsum(samples["gyro"], axis=0) * 0.01 / pulse)
    gyro = np.diff(counts, axis=0, prepend=np.zeros((1, 3))) * pulse / 0.01
    site = srt.Site(GRAVITY_M_S2, latitude_rad=LATITUDE_DEG * DEG)
    return srt.Recording(samples["time"], gyro, samples["accel"], site, fixture=srt.Fixture(0.0, 1e-3, 1e-3))


@pytest.mark.parametrize("pulse_arcsec", [0.75, 3.0])
@pytest.mark.parametrize("profile", ["raised-cosine", "trapezoid"])
def test_windows_hold_no_turn_below_the_pulses(profile, pulse_arcsec):
    """Pulses far above the noise hide the start of a slow turn: not a pulse of it is inside a window."""
    rng = np.random.default_rng((SEED, 7500))
    motion = on_fixture(list(table_1())[:6], rng, rest_s=8.0, rate_rad_s=0.1, sigma_rad=1e-3)
    samples = with_pulses(motion, {}, pulse_arcsec, rng, profile)
    inside, _ = angles_in_windows(samples, motion.turns, motion.rests(), profile)
    assert inside.max() < pulse_arcsec * DEG / 3600.0


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares"])
def test_pulses_far_above_the_noise_are_sound(estimator):
    """An axis without a rate reads zero for a whole window: neither stuck nor truncated, and errors match sigmas."""
    for number in range(2):
        rng = np.random.default_rng((SEED, 7600 + number))
        errors = drawn_errors(FINE, rng)
        motion = on_fixture(table_1(), rng, rest_s=13.5, rate_rad_s=0.6, sigma_rad=1e-3)
        found = srt.calibrate(with_pulses(motion, errors, 0.75, rng), estimator)
        assert found.judgement.word == "sound", found.judgement.reason
        z = (found.errors.vector - np.array([errors.get(name, 0.0) for name in NAMES])) / found.sigma
        squares = z @ np.linalg.solve(found.covariance / np.outer(found.sigma, found.sigma), z)
        assert chi2.sf(squares, len(NAMES)) > 0.01 / 4, number


def test_counts_that_carry_over_are_not_truncated():
    """Pulses of a steady rate that noise does not change: two values in a window, which show no width of zero."""
    rng = np.random.default_rng((SEED, 7709))
    motion = on_fixture(list(table_1())[:5], rng, rest_s=13.5, rate_rad_s=1.5, sigma_rad=1e-3)
    named = {finding.cause.name for finding in srt.diagnose(with_pulses(motion, {}, 3.0, rng)).findings}
    assert named <= {"sequence_missing"}
