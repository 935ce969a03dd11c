"""Gravity, latitude and heading as stated against one another and against the Earth's rate at rest."""

import math
from dataclasses import replace
from functools import cache

import injected_faults.site_and_drift  # noqa: F401 - registers its injections
import numpy as np
import pytest
from accuracy_trials import fixture_errors
from diagnosing import WithoutRecognition, case_of, findings_of_stage
from hypothesis import given, settings
from hypothesis import strategies as st

import sims
from sims.physics.imu import ImuModel
from srt.constants import DEG, DEG_PER_H, EARTH_RATE_RAD_S, normal_gravity_m_s2
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.site import ANOMALY_M_S2, HEIGHTS_M
from srt.recording.recording import Fixture, Recording, SequenceLabel, Site
from srt.sensor_errors import SensorErrors

SEED = 300_000
LATITUDE_RAD = 45.0 * DEG


def findings(recording):
    return findings_of_stage(WithoutRecognition(recording), "site")


@cache
def case(grade):
    made = case_of(grade, SEED)
    assert made.recording.site.latitude_rad == pytest.approx(LATITUDE_RAD)
    return made


def test_the_other_hemisphere():
    recording = case("navigation-rlg").recording
    (finding,) = findings(replace(recording, site=replace(recording.site, latitude_rad=-LATITUDE_RAD)))
    assert finding.sentence.startswith("The gyros measure the Earth rate of 4")
    assert finding.sentence.endswith("latitude, but -45° is stated: correct latitude_deg (north is positive).")
    assert abs(finding.details["found"] - 45.0) < 4.5 * finding.details["sigma"]
    assert finding.details["sigma"] < 0.5


@pytest.mark.parametrize("off_deg", [-120.0, 30.0, 180.0])
def test_heading(off_deg):
    """The heading that is found is the true one, whichever way and however far the stated one is off."""
    recording = case("navigation-rlg").recording
    (finding,) = findings(replace(recording, fixture=replace(recording.fixture, heading_rad=off_deg * DEG)))
    assert finding.fault == "north"
    assert abs(math.remainder(finding.details["found"], 360.0)) < 4.5 * finding.details["sigma"]
    assert finding.details["sigma"] < 0.5
    assert f"but {off_deg:g}° is stated: correct heading_deg" in finding.sentence


def test_wrong_latitude_and_heading_are_both_named():
    recording = case("navigation-rlg").recording
    recording = replace(
        recording,
        site=replace(recording.site, latitude_rad=-LATITUDE_RAD),
        fixture=replace(recording.fixture, heading_rad=90.0 * DEG),
    )
    assert [f.fault for f in findings(recording)] == ["latitude", "north"]


def unit_on_a_table(tilt_rad, latitude_rad=LATITUDE_RAD):
    """A unit with white noise of 0.01 °/√h and 20 µg/√Hz on a table that leans, which states 1 mrad, at 45°."""
    rng = np.random.default_rng((SEED, 7))
    draw = fixture_errors(rng, 1e-3)
    motion = sims.table1_motion(
        site=Site(normal_gravity_m_s2(LATITUDE_RAD, 0.0), latitude_rad=LATITUDE_RAD),
        sample_rate_hz=50.0,
        fixture_draw=replace(draw, base=np.array([*tilt_rad, 0.0])),
        stated_fixture=Fixture(0.0),
    )
    imu = ImuModel(gyro_noise=0.01 * DEG / 60.0, accel_noise=2e-4)
    recording = sims.read_out(motion, SensorErrors(rng.normal(0.0, 1e-3, 27)), imu, rng)
    return replace(recording, site=replace(recording.site, latitude_rad=latitude_rad))


@pytest.mark.parametrize("latitude_deg", [45.0, 40.0])
@pytest.mark.parametrize("tilt_rad", [(0.05, 0.0), (0.0, -0.05), (-0.03, 0.04)])
def test_a_table_that_leans_is_no_matter_of_the_place(tilt_rad, latitude_deg):
    """The accelerometers show the vertical; a latitude that is wrong besides is found."""
    found = {f.fault: f for f in findings(unit_on_a_table(tilt_rad, latitude_deg * DEG))}
    if latitude_deg == 45.0:
        assert found == {}
    else:
        assert found["latitude"].details["found"] == pytest.approx(45.0, abs=4.5 * found["latitude"].details["sigma"])
        assert "north" not in found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("first_s", [0.2, 1.0])
def test_rates_that_are_zeroed_at_the_start_of_each_rest_have_no_place(first_s, seed):
    """Rests zeroed beside noise: the rate that is left is near zero, and no latitude or heading is more likely."""
    recording = case("tactical-fog").recording
    gyro = recording.gyro.copy()
    rng = np.random.default_rng((SEED, seed))
    noise = rng.normal(0.0, 0.05 * DEG / 60.0 * math.sqrt(recording.nominal_interval_s), gyro.shape)
    gyro += noise * (1.0 if recording.kind == "increment" else 1.0 / recording.nominal_interval_s)
    for label in recording.sequences:
        for window in (label.start_static_s, label.end_static_s):
            rows = recording.window_indices(*window)
            gyro[rows] -= gyro[rows][: round(first_s / recording.nominal_interval_s)].mean(axis=0)
    found = {f.fault for f in findings(replace(recording, gyro=gyro))}
    assert found == {"earth_rate_absent"} if first_s == 1.0 else found <= {"earth_rate_absent"}


@pytest.mark.parametrize("grade", ["tactical-fog", "industrial-mems"])
def test_noise_stated_too_low_raises_nothing(grade):
    """The scatter of the windows decides, not the noise that is stated."""
    recording = case(grade).recording
    noise = replace(recording.noise, gyro_noise=0.1 * recording.noise.gyro_noise, gyro_bias_instability=None)
    assert findings(replace(recording, noise=noise)) == []


@settings(max_examples=50, deadline=None)
@given(
    latitude_deg=st.floats(-90.0, 90.0),
    height_m=st.floats(HEIGHTS_M[1], HEIGHTS_M[0]),
    anomaly=st.floats(-1.0, 1.0),
)
def test_gravity_of_every_place_on_land_fits_its_latitude(latitude_deg, height_m, anomaly):
    gravity = normal_gravity_m_s2(latitude_deg * DEG, height_m) + 0.999 * anomaly * ANOMALY_M_S2
    assert not [f for f in findings(still(Site(gravity, latitude_rad=latitude_deg * DEG))) if f.fault == "gravity"]


@settings(max_examples=50, deadline=None)
@given(
    latitude_deg=st.floats(-90.0, 90.0),
    beyond=st.floats(1.01 * 5e-6 * limit("normal", both_sides=True), 1e-2),
    high=st.booleans(),
)
def test_gravity_beyond_every_height_does_not(latitude_deg, beyond, high):
    """Its standard deviation is 5e-6 if none is stated, and deviates by less than the limit but for false alarms."""
    height, sign = (HEIGHTS_M[1], 1.0) if high else (HEIGHTS_M[0], -1.0)
    gravity = normal_gravity_m_s2(latitude_deg * DEG, height) + sign * (ANOMALY_M_S2 + beyond)
    assert [f.fault for f in findings(still(Site(gravity, latitude_rad=latitude_deg * DEG)))] == ["gravity"]


def test_gravity_with_a_large_stated_sigma_fits():
    site = Site(9.80665 + 0.05, latitude_rad=LATITUDE_RAD, gravity_sigma_m_s2=0.02)
    assert findings(still(site)) == []


def still(site):
    """Two samples of nothing."""
    return Recording([0.0, 0.01], np.zeros((2, 3)), np.zeros((2, 3)), site)


def test_rates_at_rest_are_taken_apart():
    """A unit without noise but with g-sensitivity, on a perfect fixture.

    The Earth's rate comes out to that of the raw gyro matrix, which the Earth's rate over a turn (6 s of 7e-5 rad/s)
    puts off by 5e-4 / 2π of itself; so does the g-sensitivity, of which the part like the unit matrix is known.
    """
    gamma = 1e-4 * np.random.default_rng(1).standard_normal((3, 3))  # rad/s per g upon the downward vertical
    g = 9.80665
    motion = sims.table1_motion(
        site=Site(g, latitude_rad=LATITUDE_RAD), sample_rate_hz=100.0, heading_rad=0.3, stated_fixture=Fixture(0.3)
    )
    imu = ImuModel(gyro_g_sensitivity=-gamma / g)
    fit = WithoutRecognition(sims.read_out(motion, SensorErrors(), imu)).stationary_rate_fit
    down, level = -EARTH_RATE_RAD_S * math.sin(LATITUDE_RAD), EARTH_RATE_RAD_S * math.cos(LATITUDE_RAD)
    found = fit.g_sensitivity + (fit.vertical - down) * np.eye(3)
    np.testing.assert_allclose(found, gamma, rtol=0.0, atol=2e-4 * EARTH_RATE_RAD_S)
    np.testing.assert_allclose(
        fit.horizontal, level * np.array([math.cos(0.3), -math.sin(0.3)]), rtol=0.0, atol=2e-4 * EARTH_RATE_RAD_S
    )
    assert np.abs(fit.drift).max() < 2e-4 * EARTH_RATE_RAD_S


def label(a, b, **more):
    return SequenceLabel(a, b, **more)


def odd_recordings():
    """Recordings of which nothing can be said."""
    rng = np.random.default_rng(2)
    time = 0.01 * np.arange(1, 2001)
    noise = 1e-3 * rng.standard_normal((2000, 3))
    gravity = np.tile([0.0, 0.0, -9.8], (2000, 1)) + noise
    site, fixture = Site(9.8, latitude_rad=LATITUDE_RAD), Fixture(0.0)
    free = (label((0.0, 5.0), (7.0, 12.0)), label((7.0, 12.0), (14.0, 19.0)))
    one = (label((0.0, 5.0), (12.0, 17.0), id="1"),)
    tiny = tuple(label((t, t + 0.02), (t + 1.0, t + 1.02), id=i) for t, i in ((0.0, "1"), (2.0, "7"), (4.0, "9")))
    all_short = tuple(
        label((t, t + 0.02), (t + 0.5, t + 0.52), id=i) for t, i in zip(np.arange(17.0), sims.TABLE_1, strict=True)
    )
    plain = Recording(time, noise, gravity, site, fixture=fixture)
    late = np.where(time > 10.0, time + 5.0, time)
    return {
        "without labels": plain,
        "free": replace(plain, fixture=None, sequences=free),
        "one sequence": plain.with_sequences(one),
        "windows of two samples": plain.with_sequences(tiny),
        "all sequences, two samples each": plain.with_sequences(all_short),
        "dead": replace(plain, gyro=np.zeros((2000, 3)), accel=np.zeros((2000, 3)), sequences=all_short),
        "no latitude": replace(plain, site=Site(9.8), sequences=all_short),
        "no heading": replace(plain, fixture=Fixture(None), sequences=all_short),
        "a gap": replace(plain, time=late, sequences=one),
    }


@pytest.mark.parametrize("name", odd_recordings())
def test_nothing_is_said_of_odd_recordings(name):
    assert findings(odd_recordings()[name]) == []


def test_a_knock_in_one_window_is_no_matter_of_the_place():
    """A rate of 20 °/h in one window, as a knock of 1 mrad leaves, is left out of the fit."""
    recording = case("navigation-rlg").recording
    gyro = recording.gyro.copy()
    gyro[recording.window_indices(*recording.sequences[5].start_static_s)] += (
        20.0 * DEG_PER_H * recording.nominal_interval_s
    )
    assert findings(replace(recording, gyro=gyro)) == []
