"""Allan deviation against noise of known figures, its pooling, and what it refuses."""

import subprocess
import sys
from math import sqrt

import accuracy_trials
import numpy as np
import pytest
from scipy.special import bdtr, chdtri
from scipy.stats import norm

import sims
import srt
from srt.noise import allan
from srt.noise.allan import CHANNELS, TERMS, allan_deviation, interval

RATE = 100.0
WALK, FLAT = 1, 2


def recording(gyro, accel, kind="rate"):
    return srt.Recording(np.arange(1, len(gyro) + 1) / RATE, gyro, accel, accuracy_trials.SITE, kind)


def white(rng, n, walk):
    return rng.standard_normal((n, 3)) * walk * sqrt(RATE)


def windows_of(*lengths):
    edges = np.cumsum([0, *lengths])
    return np.stack([edges[:-1], edges[1:]], axis=1)


def simulated(model, dwell_s, rng):
    """Two rests of a simulated unit, with the indices of their samples."""
    where = {"site": accuracy_trials.SITE, "sample_rate_hz": RATE, "earth_rate": False}
    motion = sims.table1_motion(sequences=("7",), dwell_s=dwell_s, **where)
    read = sims.read_out(motion, srt.SensorErrors(), model, rng)
    label = read.sequences[0]
    spans = [read.window_indices(*w) for w in (label.start_static_s, label.end_static_s)]
    return read, np.array([(s.start, s.stop) for s in spans])


def test_deviations_of_white_noise_scatter_as_chi_square():
    """Every octave of every channel; n / 2m disjoint differences are independent, overlapping ones tell no less."""
    walk = np.array([1e-4] * 3 + [2e-3] * 3)
    model = sims.ImuModel(gyro_noise=walk[0], accel_noise=walk[3])
    read, windows = simulated(model, 100.0, np.random.default_rng(1))
    found = allan_deviation(read, windows)
    ratio = found.deviation**2 * found.tau_s / walk[:, None] ** 2
    freedom = np.sum(windows[:, 1] - windows[:, 0]) / (2.0 * RATE * found.tau_s)
    freedom = np.maximum(np.floor(freedom), 1.0)
    # 6 channels, some 11 octaves, both sides: 1e-6 each makes 1e-4 for the test to fail by chance.
    assert np.all(ratio < chdtri(freedom, 1e-6) / freedom)
    assert np.all(ratio > chdtri(freedom, 1.0 - 1e-6) / freedom)


def test_pooled_overlapping_variances_are_the_definition():
    rng = np.random.default_rng(2)
    lengths = (3300, 4100)
    read = recording(white(rng, sum(lengths), 1e-3) + 0.1, white(rng, sum(lengths), 1e-2) + 9.8)
    windows = windows_of(*lengths)
    found = allan_deviation(read, windows)
    values = np.concatenate([read.gyro, read.accel], axis=1)
    for i, tau in enumerate(found.tau_s):
        m = round(tau * RATE)
        total, weight = np.zeros(6), 0.0
        for a, b in windows:
            angle = np.concatenate([np.zeros((1, 6)), np.cumsum(values[a:b], axis=0)]) / RATE
            second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
            if (b - a) / m >= 5:  # shorter windows do not count
                total += (b - a) / m * np.mean(second**2, axis=0) / (2.0 * tau**2)
                weight += (b - a) / m
        np.testing.assert_allclose(found.deviation[:, i] ** 2, total / weight, rtol=1e-8)


def covered(value, low, high, truth):
    return int(np.sum((low <= truth) & (truth <= high))), int(np.sum(np.isfinite(value)))


def test_intervals_of_random_walk_cover_it():
    """60 channels of 95 %; 90 % would fall below the bound once in a million: octaves are not quite independent."""
    rng = np.random.default_rng(3)
    hits = total = 0
    for _ in range(10):
        found = allan_deviation(recording(white(rng, 6000, 1e-3), white(rng, 6000, 1e-3)), windows_of(6000))
        inside, seen = covered(found.value[:, WALK], found.value_low[:, WALK], found.value_high[:, WALK], 1e-3)
        hits, total = hits + inside, total + seen
    assert total == 60
    assert bdtr(hits, 60, 0.9) > 1e-6


def test_white_noise_has_no_flat_part_and_no_pulses():
    """A term is kept by chance once in a thousand; of 180 chances four or more come once in 25,000 tests."""
    rng = np.random.default_rng(4)
    found = [
        allan_deviation(recording(white(rng, 6000, 1e-3), white(rng, 6000, 1e-3)), windows_of(6000)) for _ in range(10)
    ]
    others = np.concatenate([f.value[:, [0, FLAT, 3]] for f in found])
    assert np.isfinite(others).sum() <= 3
    bounds = np.concatenate([f.bound for f in found])
    # The lowest deviation is that of the longest average, 1e-3 / √10.24 s here; its limit lies above it in 97.5 %.
    assert np.mean(bounds > 1e-3 / sqrt(10.24)) > 0.9


def test_pulses_are_told_from_random_walk():
    """Pulses of the integral, dithered by noise: ε within its interval, N within its own, in all channels."""
    pulse, walk = 2e-5, 1e-4
    model = sims.ImuModel(gyro_noise=walk, accel_noise=walk, gyro_quantization=pulse, accel_quantization=pulse)
    read, windows = simulated(model, 200.0, np.random.default_rng(5))
    # Accelerometers of 9.8 m/s² pass whole pulses by the thousand in a sample; the horizontal ones none.
    found = allan_deviation(read, windows)
    assert np.all(np.isfinite(found.value[:, :2]))
    # 40 000 samples: the pulses' variance is known to 2 %, doubted to a half for their lines; three such bounds.
    np.testing.assert_allclose(found.value[:, 0], pulse, rtol=0.5)
    np.testing.assert_allclose(found.value[:, WALK], walk, rtol=0.15)


def test_bias_instability_is_found_where_the_curve_is_flat():
    """Flicker with a floor as high as the noise of 6 s averages; windows of 300 s.

    Octaves of 20 to 60 s have 300/40 · 2 windows · 1.2 ≈ 18 degrees of freedom each, four flat octaves half as many
    independent ones: √(2/36)/2 = 12 % of one channel's figure, 5 % of the mean of six. Five of these, and 10 % for
    a flicker made of four processes a decade apart.
    """
    floor, walk = 4e-4, 1e-3
    model = sims.ImuModel(gyro_noise=walk, accel_noise=walk, gyro_bias_instability=floor, accel_bias_instability=floor)
    read, windows = simulated(model, 300.0, np.random.default_rng(6))
    found = allan_deviation(read, windows)
    seen = found.value[:, FLAT]
    assert np.isfinite(seen).sum() >= 5
    assert np.nanmean(seen) == pytest.approx(floor, rel=0.35)
    assert np.all(found.bound[~np.isfinite(seen)] > floor)
    figures = found.figures()
    key = "gyro_bias_instability_deg_per_h"
    assert figures["gyro_x"][key]["low"] < figures["gyro_x"][key]["value"] < figures["gyro_x"][key]["high"]


def test_long_logs_are_thinned_without_a_trace(monkeypatch):
    """The same samples with and without averaging in blocks: from block to block the octaves agree as chance allows."""
    rng = np.random.default_rng(7)
    read = recording(white(rng, 60_000, 1e-3), white(rng, 60_000, 1e-3))
    whole = allan_deviation(read, windows_of(60_000))
    monkeypatch.setattr(allan, "_MOST_SAMPLES", 1 << 12)
    thinned = allan_deviation(read, windows_of(60_000))
    np.testing.assert_allclose(thinned.tau_s[: len(whole.tau_s)], whole.tau_s)
    ratio = thinned.deviation / whole.deviation[:, : thinned.deviation.shape[1]]
    # Long averages are the same up to how finely they overlap; short ones come from a part of the samples.
    parts = np.where(thinned.tau_s * RATE < 16 * 8, 1 << 12, 60_000)
    freedom = np.maximum(parts / (2.0 * RATE * thinned.tau_s), 1.0)
    assert np.all(np.abs(ratio - 1.0) < 5.0 * np.sqrt(0.5 / freedom))


def test_a_knock_is_no_noise():
    """One reading of 100 sigma amid 200 s doubles the shortest variance and more; the rest before and after stays."""
    rng = np.random.default_rng(11)
    gyro, accel = white(rng, 20_000, 1e-3), white(rng, 20_000, 1e-2)
    gyro[9000, 1] += 100.0 * 1e-3 * sqrt(RATE)
    found = allan_deviation(recording(gyro, accel), windows_of(20_000))
    assert found.windows == 2
    assert found.total_s == pytest.approx(200.0, abs=0.5)
    # 20 000 samples: 0.5 % of a deviation, five of these.
    assert found.deviation[1, 0] * sqrt(found.tau_s[0]) == pytest.approx(1e-3, rel=0.025)


def test_increments_show_what_rates_show():
    rng = np.random.default_rng(8)
    gyro, accel = white(rng, 6000, 1e-3), white(rng, 6000, 1e-2) + 9.8
    rates = allan_deviation(recording(gyro, accel), windows_of(6000))
    increments = allan_deviation(recording(gyro / RATE, accel / RATE, "increment"), windows_of(6000))
    np.testing.assert_allclose(increments.deviation, rates.deviation, rtol=1e-9)
    np.testing.assert_allclose(increments.value, rates.value, rtol=1e-6)


def test_a_channel_that_never_changes_has_no_figures():
    rng = np.random.default_rng(9)
    gyro, accel = white(rng, 6000, 1e-3), white(rng, 6000, 1e-2)
    gyro[:, 1] = 0.01
    accel[:, 2] = 9.8
    found = allan_deviation(recording(gyro, accel), windows_of(6000))
    dead = np.array([c in ("gyro_y", "accel_z") for c in CHANNELS])
    np.testing.assert_array_equal(np.isnan(found.deviation).all(axis=1), dead)
    np.testing.assert_array_equal(np.isnan(found.value).all(axis=1), dead)
    assert found.figures()["gyro_y"] == {}


def test_figures_carry_the_names_of_the_recording_file():
    from srt.recording.schema import IMU_KEYS

    keys = {key.name: key.factor for key in IMU_KEYS}
    for term in TERMS[:3]:
        for key, scale in zip(term.keys, term.scales, strict=True):
            assert keys[key] == pytest.approx(scale)


def test_short_rest_is_refused():
    rng = np.random.default_rng(10)
    read = recording(white(rng, 2000, 1e-3), white(rng, 2000, 1e-3))
    with pytest.raises(srt.DataError, match=r"lasts 20 s, but .* 30 s"):
        allan_deviation(read, windows_of(2000))


def test_confidence_is_what_the_tables_say():
    low, high = interval(np.array([1.0]), np.array([1e6]))
    # A million degrees of freedom are normal: ± 1.96 √(2/ν)/2 of the deviation.
    half = norm.ppf(0.975) * sqrt(0.5 / 1e6)
    assert low[0] == pytest.approx(1.0 - half, abs=0.01 * half)
    assert high[0] == pytest.approx(1.0 + half, abs=0.01 * half)


def test_an_absent_allantools_says_what_to_install():
    code = (
        "import sys; sys.modules['allantools'] = None\n"
        "import numpy as np, srt\nfrom srt.noise.allan import allan_deviation\n"
        "x = np.random.default_rng(0).standard_normal((4000, 3))\n"
        "r = srt.Recording(np.arange(1, 4001) / 100, x, x, srt.Site(9.8))\n"
        "try:\n    allan_deviation(r, np.array([[0, 4000]]))\nexcept srt.MissingExtraError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert "pip install 'strapdown-rotation-test[allan]'" in done.stdout
