"""Vibration in the windows: false alarms on white noise, size and frequency, and its removal from the measurements."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from injected_faults.disturbances import vibrating
from scipy.integrate import quad
from scipy.stats import binom, gamma

from sims.physics.imu import ImuModel, read_out
from sims.physics.table_motion import table1_motion
from srt.constants import ARCSEC, DEG_PER_SQRT_H, MICRO_G
from srt.estimation.options import Options
from srt.estimation.srt_measurements import SrtProcessor
from srt.recording.recording import ImuNoise, Site
from srt.sensor_errors import N_PARAMETERS, SensorErrors
from srt.sequences import vibration as lines
from srt.sequences.checked_preparation import prepare_checked

SITE = Site(9.80665, 5e-6, 0.8)
ANGLE_RAD, FORCE_M_S2, HZ = 5e-5, 0.03, 23.3
DIRECTION = np.array([0.48, -0.6, 0.64])
FINE = ImuModel(gyro_noise=1e-4 * DEG_PER_SQRT_H, accel_noise=0.1 * MICRO_G)
PERFECT = SensorErrors(np.zeros(N_PARAMETERS))
ASYMMETRIC = SensorErrors.from_dict({f"{s}_asymmetry_{a}": 1e-4 for s in ("gyro", "accel") for a in "xyz"})


@cache
def motion():
    return table1_motion(site=SITE, sequences=("1", "7", "13"), sample_rate_hz=100.0, heading_rad=0.3, dwell_s=6.0)


def prepared(recording):
    return prepare_checked(recording, recording.sequences, "linear")


@cache
def vibrating_unit(errors, kind):
    shaken = vibrating(motion(), HZ, ANGLE_RAD * DIRECTION, FORCE_M_S2 * DIRECTION[::-1], phase_rad=1.0)
    recordings = [read_out(m, errors, FINE, np.random.default_rng(3), kind=kind) for m in (shaken, motion())]
    return [prepared(recording) for recording in recordings]


def test_a_bin_of_white_noise_stands_out_as_rarely_as_stated():
    """Ratios above the limit for p = 1e-3: as many as the larger of two means of gamma variables lets through."""
    x = np.random.default_rng(20261122).standard_normal((400, 600, 3))
    ratio = np.stack([lines._spectra(window)[1] for window in x])
    tested = ratio[:, lines._LOWEST : -lines._NEIGHBOURS]  # bins with both sides of their own
    m, p = float(lines._NEIGHBOURS), 1e-3
    limit = m * ((p / 3.0) ** (-1.0 / m) - 1.0)
    level = gamma(m, scale=1.0 / m)
    single = quad(lambda u: np.exp(-limit * u) * 2.0 * level.cdf(u) * level.pdf(u), 0.0, np.inf)[0]
    assert 3.0 * single < p
    above = int(np.count_nonzero(tested > limit))
    # Neighbouring bins share their level, which a factor of two in the variance covers generously.
    assert binom.ppf(1e-4, tested.size, 3.0 * single) / 2.0 < above < 2.0 * binom.isf(1e-4, tested.size, 3.0 * single)


@pytest.mark.parametrize("n", [63, 64])
def test_the_highest_bins_stand_out_no_more_often_than_stated(n):
    """Bins whose neighbours are mirrored, and half the sampling rate where n is even."""
    windows, p, m = 20_000, 1e-2, float(lines._NEIGHBOURS)
    x = np.random.default_rng((20261123, n)).standard_normal((windows, n, 3))
    above = np.count_nonzero(lines._spectra(x)[1] > m * ((p / 3.0) ** (-1.0 / m) - 1.0), axis=0)[lines._LOWEST :]
    assert above.max() <= binom.isf(0.01 / len(above), windows, p)


@pytest.mark.parametrize("one_in", lines._SHARES)
@pytest.mark.parametrize("windows", [4, 34, 200])
def test_the_limit_gives_the_false_alarm_probability(windows, one_in):
    """Of all bins and both sensors: more than a share of the windows above the limit, by the binomial distribution."""
    tests, m = 1000, float(lines._NEIGHBOURS)
    single = 3.0 * (1.0 + lines._limit(windows, tests, one_in) / m) ** -m
    assert tests * binom.sf(windows // one_in, windows, single) == pytest.approx(lines.FALSE_ALARM, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_slow_pulses_are_no_vibration(seed):
    """A quiet ring laser gyro at rest counts pulses at an even rate, which is a line of less than a pulse."""
    imu = replace(FINE, gyro_quantization=0.5 * ARCSEC, accel_quantization=1e-5)
    recording = read_out(motion(), PERFECT, imu, np.random.default_rng(seed), kind="increment")
    assert prepared(recording).vibration is None


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_size_and_frequency(kind):
    data, still = vibrating_unit(PERFECT, kind)
    assert still.vibration is None
    line = data.vibration
    # A tenth of a bin is the spacing of the frequencies that are tried.
    assert line.frequency_hz == pytest.approx(HZ, abs=0.06 / 6.0)
    processor = SrtProcessor(data, Options()).process(PERFECT)
    rate = line.amplitude("gyro", processor.gyro)
    np.testing.assert_allclose(rate, np.tile(2.0 * np.pi * HZ * ANGLE_RAD * np.abs(DIRECTION), (6, 1)), rtol=0.01)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_vibration_is_removed_from_rotations_and_means(kind):
    """Measurements of a quiet asymmetric unit equal those without vibration to a fiftieth of its effect."""
    shaken, still = vibrating_unit(ASYMMETRIC, kind)
    found, expected = (SrtProcessor(data, Options()).process(ASYMMETRIC).z for data in (shaken, still))
    K = shaken.K
    change = np.abs(found - expected)
    # Without correction: g times the angle at two edges; 0.64 of the amplitude times the asymmetry.
    assert change[: 2 * K].max() < 0.02 * SITE.gravity_m_s2 * ANGLE_RAD
    assert change[-3:].max() < 0.02 * 0.64e-4 * 2.0 * np.pi * HZ * ANGLE_RAD * np.abs(DIRECTION).min()


@pytest.mark.parametrize("course", ["grows", "decays", "pauses at the edges", "is absent at first"])
@pytest.mark.parametrize("hz", [3.1, HZ])
def test_a_vibration_that_is_not_steady_is_removed(hz, course):
    """In four of six windows: no measurement is off by a tenth of what the mean amplitude at its edges would leave."""
    still = read_out(motion(), PERFECT, FINE, np.random.default_rng(3), kind="rate")
    windows = [w for label in still.sequences for w in (label.start_static_s, label.end_static_s)]
    edges, angle = np.concatenate([[0.0], still.time]), np.zeros((still.time.size + 1, 3))
    for begin, end in windows[:4]:
        s = (edges - begin) / (end - begin)
        size = {
            "grows": np.maximum(s, 0.0) ** 2 * (s <= 1.0),
            "decays": np.exp(-4.0 * s) * (s >= 0.0),
            "pauses at the edges": np.sin(np.pi * s) ** 2 * ((s >= 0.0) & (s <= 1.0)),
            "is absent at first": np.clip(4.0 * s - 2.0, 0.0, 1.0) * (s <= 1.0),
        }[course]
        angle += (ANGLE_RAD * size * np.sin(2.0 * np.pi * hz * (edges - begin)))[:, None] * DIRECTION
    tilt = np.cross(0.5 * (angle[1:] + angle[:-1]), still.accel)
    shaken = replace(still, gyro=still.gyro + np.diff(angle, axis=0) / still.interval_s, accel=still.accel - tilt)
    data = prepared(shaken)
    assert data.vibration is not None
    found, expected = (SrtProcessor(d, Options()).process(PERFECT).z for d in (data, prepared(still)))
    assert np.abs(found - expected)[: 2 * data.K].max() < 0.1 * 0.5 * SITE.gravity_m_s2 * ANGLE_RAD


@pytest.mark.parametrize("windows", [(), (4, 7), (1, 2, 4, 5, 7, 8, 10)])
def test_a_vibration_in_a_quarter_of_the_windows_is_found(windows):
    """A motor that runs for some of 24 windows; in two of them, it is no vibration of the test."""
    still = read_out(
        table1_motion(site=SITE, sample_rate_hz=50.0, dwell_s=6.0), PERFECT, FINE, np.random.default_rng(3)
    )
    spans = [w for label in still.sequences[:12] for w in (label.start_static_s, label.end_static_s)]
    gyro = still.gyro.copy()
    for k in windows:
        rows = still.window_indices(*spans[k])
        gyro[rows] += ANGLE_RAD * HZ * np.sin(2.0 * np.pi * HZ * still.time[rows])[:, None] * DIRECTION
    unit = replace(still, gyro=gyro).with_sequences(still.sequences[:12])
    assert (prepared(unit).vibration is not None) == (len(windows) > 6)


def test_rectified_mean():
    u = 2.0 * np.pi * (np.arange(100_000) + 0.5) / 100_000
    mean, amplitude = np.array([0.0, 0.3, -0.9, 1.5, 0.2]), np.array([1.0, 1.0, 1.0, 1.0, 0.0])
    expected = np.abs(mean[:, None] + amplitude[:, None] * np.sin(u)).mean(axis=1) - np.abs(mean)
    np.testing.assert_allclose(lines.rectified(mean, amplitude), expected, atol=1e-9)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_vibration_is_no_noise(kind):
    """Noise that is not stated, of a vibrating unit: white noise is found to 3.5 sigma, and no quantization with it.

    1-sigma of the white noise: 1/√(2 n) for the n samples of the windows, and 1.5 times that beside a quantization.
    """
    unit = ImuModel(gyro_noise=0.05 * DEG_PER_SQRT_H, accel_noise=50.0 * MICRO_G)
    shaken = vibrating(motion(), HZ, ANGLE_RAD * DIRECTION, FORCE_M_S2 * DIRECTION[::-1], phase_rad=1.0)
    recording = read_out(shaken, PERFECT, unit, np.random.default_rng(4), kind=kind)
    data = prepared(replace(recording, noise=ImuNoise()))
    assert data.vibration is not None
    n = int(np.diff(data.windows.samples, axis=1).sum())
    tolerance = 3.5 * 1.5 / np.sqrt(2.0 * n)
    np.testing.assert_allclose(data.noise.gyro_white, unit.gyro_noise, rtol=tolerance)
    np.testing.assert_allclose(data.noise.accel_white, unit.accel_noise, rtol=tolerance)
    # q² is a third of dt² times what the n/2 differences of neighbours show beyond white noise: as in the fit, √(3/m).
    chance = 3.5 * 1.5 / 3.0 * np.sqrt(6.0 / n) * recording.nominal_interval_s
    assert np.all(data.noise.gyro_edge**2 < chance * unit.gyro_noise**2)
    assert np.all(data.noise.accel_edge**2 < chance * unit.accel_noise**2)


def test_a_line_of_one_gyro_is_of_the_unit_where_the_attitudes_tell():
    """A table that turns in the room moves all channels; in one attitude, either would look like the other."""
    still = read_out(motion(), PERFECT, FINE, np.random.default_rng(5))
    beat = ANGLE_RAD * np.sin(2.0 * np.pi * HZ * still.time)[:, None] * np.array([0.0, 1.0, 0.0])
    data = prepared(replace(still, gyro=still.gyro + beat))
    force = data.windows.accel_mean
    sensor, share = data.vibration.of_unit(force)
    assert sensor == "gyro"
    np.testing.assert_allclose(share, [0.0, 1.0, 0.0], atol=0.01)
    assert data.vibration.of_unit(np.broadcast_to(force[0], force.shape)) is None
    assert vibrating_unit(PERFECT, "rate")[0].vibration.of_unit(force) is None
