"""Agreement of stated and seen noise, and the filter of a sensor."""

import json
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from foreign_motion import GRADES, drawn_errors, hand_turns, recording, windows
from scipy.signal import butter, firwin, lfilter, lfilter_zi
from scipy.stats import binom, chi2

import srt
from srt.noise import noise_terms as fit
from srt.noise.noise_agreement import FALSE_ALARM, contradiction
from srt.noise.noise_model import noise_model
from srt.noise.noise_terms import ALL_TERMS, noise_terms
from srt.sensor_errors import GROUP_SLICES, NAMES

SEED, DT, SAMPLES = 20261206, 0.01, 20_000
WHITE = 1e-3
WALK = [term.name for term in ALL_TERMS].index("random_walk")


def clean(rng, n=SAMPLES):
    return rng.normal(size=n)


def low_pass(rng, n=SAMPLES, cutoff_hz=5.0):
    return lfilter(*butter(2, cutoff_hz * 2.0 * DT), rng.normal(size=n))


def interpolated(rng, n=SAMPLES):
    return np.interp(np.arange(n), np.arange(0, n + 10, 10), rng.normal(size=n // 10 + 1))


def repeated(rng, n=SAMPLES):
    return np.repeat(rng.normal(size=n // 10), 10)


def disturbed(rng, n=SAMPLES):
    """A fan that runs for a quarter of the time."""
    return rng.normal(size=n) * np.where((np.arange(n) > 0.5 * n) & (np.arange(n) < 0.75 * n), 3.0, 1.0)


def shaken(rng, n=SAMPLES):
    return rng.normal(size=n) + 3.0 * np.sin(2.0 * np.pi * 17.3 * DT * np.arange(n) + rng.uniform(0.0, 6.0))


def walking(rng, n=SAMPLES):
    return rng.normal(size=n) + 0.01 * np.cumsum(rng.normal(size=n))


def drifting(rng, n=SAMPLES):
    return rng.normal(size=n) + 5.0 * np.arange(n) / n


def flickering(rng, n=SAMPLES):
    """Power spectral density 1/|f| that meets that of the white noise at 1 Hz."""
    f = np.maximum(np.fft.rfftfreq(n, DT), 0.5 / (n * DT))
    return rng.normal(size=n) + np.fft.irfft(np.fft.rfft(rng.normal(size=n)) / np.sqrt(f), n)


def log(folder, *makers):
    """A log at rest whose channels have the noise of the makers in turn."""
    rng = np.random.default_rng((SEED, 1))
    channels = np.stack([WHITE * makers[c % len(makers)](rng) for c in range(6)], axis=1)
    time = DT * np.arange(1, SAMPLES + 1)
    folder.mkdir()
    columns = {f"{sensor}_{a}": channels[:, 3 * s + i] for s, sensor in enumerate(("gyro", "accel"))
               for i, a in enumerate("xyz")}  # fmt: skip
    columns["accel_z"] = columns["accel_z"] + 9.81
    np.savez(folder / "samples.npz", time=time, **columns)
    (folder / "recording.toml").write_text(
        '[recording]\nsamples = "samples.npz"\ngyro_unit = "rad/s"\naccel_unit = "m/s^2"\n[site]\ngravity_m_s2 = 9.81\n'
    )
    return folder


@pytest.mark.parametrize("maker", [low_pass, interpolated, repeated, disturbed, shaken])
def test_noise_that_is_not_that_of_the_unit_is_refused(tmp_path, maker):
    """The random walk of a clean log, 1e-4 rad/√s, lay up to eight times above the limit from a filtered one."""
    with pytest.raises(srt.DataError, match="is not that of a unit at rest"):
        noise_terms(srt.load_recording(log(tmp_path / "rest", maker)), (0, SAMPLES))


@pytest.mark.parametrize("maker", [partial(low_pass, cutoff_hz=25.0), disturbed, shaken])
def test_the_command_refuses_such_noise(tmp_path, maker, shell):
    out, err = shell("noise", log(tmp_path / "rest", maker), code=1)
    assert "is not that of a unit at rest. " in err
    assert "times the noise at" in err
    assert "angular random walk" not in out


@pytest.mark.slow
def test_one_channel_without_figures_leaves_those_of_the_others(tmp_path, shell):
    folder = log(tmp_path / "rest", low_pass, clean, clean)
    out = " ".join(shell("noise", folder, "-o", tmp_path / "noise.json").out.split())
    assert "No terms of gyro x: the window has" in out
    channels = json.loads((tmp_path / "noise.json").read_text())["channels"]
    assert channels["gyro_x"] == {} == channels["accel_x"]
    for name in ("gyro_y", "gyro_z"):
        found = channels[name]["gyro_noise_deg_per_sqrt_h"]
        # The true value, 1e-4 rad/√s, within 3.5 half-widths over 1.96.
        true = np.degrees(WHITE * np.sqrt(DT)) * 60.0
        assert abs(found["value"] - true) < 3.5 / 1.96 * 0.5 * (found["high"] - found["low"])


@pytest.mark.slow
def test_a_clean_log_keeps_its_figures(tmp_path):
    found = noise_terms(srt.load_recording(log(tmp_path / "rest", clean, walking, drifting)), (0, SAMPLES))
    assert not found.refused
    assert found.resolved[:, WALK].all()


@pytest.mark.parametrize("maker", [clean, walking, drifting, flickering])
def test_clean_channels_are_refused_no_more_often_than_stated(maker):
    """300 channels each; binomial, at most once in 250 tests by chance for each of the four makers."""
    n, units = 5000, 300
    rng = np.random.default_rng((SEED, 2))
    edges, u = fit._edges(n), fit._ramp(n, DT)
    bins = fit._bins(edges, u, DT)
    refused = 0
    for _ in range(units):
        x = WHITE * maker(rng, n)
        best = fit._likeliest(fit._spectrum(x - x.mean(), edges, u, bins))
        without_ramp = x - best.ramp * DT * np.arange(n)
        refused += contradiction(without_ramp, DT, partial(fit._variance, squares=best.squares, dt=DT)) is not None
    assert refused <= binom.ppf(1.0 - 0.0025, units, FALSE_ALARM)


HZ = 100.0
WINDOWS, REST_S = 34, 10.0


def first_order(tau_s: float) -> tuple[list[float], list[float]]:
    decay = float(np.exp(-1.0 / (HZ * tau_s)))
    return [1.0 - decay], [1.0, -decay]


FILTERS = {
    "moving average of 3": (np.ones(3) / 3.0, [1.0]),
    "5 ms": first_order(0.005),
    "20 ms": first_order(0.02),
    "50 ms": first_order(0.05),
    "Butterworth, 10 Hz": butter(4, 10.0, fs=HZ),
    "31 taps, 15 Hz": (firwin(31, 15.0, fs=HZ), [1.0]),
}
"""Numerators and denominators; the gain at zero frequency is one, so that means over long windows are unchanged."""


def at_rest(seed: int, name: str | None = None) -> tuple[srt.Recording, np.ndarray]:
    """Unit white noise of six channels, filtered, and 34 windows of 10 s."""
    rng = np.random.default_rng(seed)
    length, start = round(HZ * REST_S), 500
    x = rng.standard_normal((WINDOWS * length + start, 6)) * np.sqrt(HZ)
    if name is not None:
        x = lfilter(*FILTERS[name], x, axis=0)
    x = x[start:]
    bounds = length * np.arange(WINDOWS)[:, None] + [0, length]
    return srt.Recording(np.arange(1, len(x) + 1) / HZ, x[:, :3], x[:, 3:], srt.Site(9.8, 1e-3)), bounds


@pytest.mark.parametrize("name", FILTERS)
def test_noise_of_window_means_behind_a_filter(name):
    """N² within 3.5 standard errors: √(3/m) for the m averages over the time from which the filter does not show."""
    found = noise_model(*at_rest(20261123, name))
    assert np.all(found.filter_s > 0.0)
    for white, filter_s in ((found.gyro_white, found.filter_s[0]), (found.accel_white, found.filter_s[1])):
        m = WINDOWS * REST_S / (2.0 * filter_s)
        np.testing.assert_allclose(white**2, 1.0, rtol=3.5 * np.sqrt(3.0 / m))
    # A filter has no bias instability; the windows must neither show it nor bound it far above that of white noise.
    assert np.all(found.accel_flicker == 0.0)
    assert np.all(found.accel_unseen < 0.5)


def test_nothing_is_lost_without_a_filter():
    """All octaves are used: N to 3.5 standard errors of the 17 000 differences of single samples."""
    found = noise_model(*at_rest(20261124))
    assert not found.filter_s.any()
    np.testing.assert_allclose(np.r_[found.gyro_white, found.accel_white], 1.0, atol=3.5 * 0.5 * np.sqrt(3.0 / 17000.0))


def test_motion_in_some_windows_is_no_filter():
    """Hand tremor in 6 of 34 windows: long averages of all windows together have 5.4 times the variance of the others.

    Single samples have 2 % more, and the median window none. No filter is found: N stays that of the short averages.
    """
    log, bounds = at_rest(20261125)
    gyro = log.gyro.copy()
    for number, (a, b) in enumerate(bounds[::6].tolist()):
        gyro[a:b] += 5.0 * lfilter(*first_order(0.1), at_rest(number)[0].gyro[: b - a], axis=0)
    found = noise_model(replace(log, gyro=gyro), bounds)
    assert found.filter_s[0] == 0.0
    # Octaves of 1, 2, 4 and 8 samples have 2, 5, 15 and 45 % more, with a half to a sixteenth of the weight.
    assert np.all(found.gyro_white**2 < 1.2)


def filtered_unit(seed: int, name: str) -> tuple[srt.Recording, np.ndarray]:
    """Hand-turned industrial unit behind a filter, windows labelled clear of its memory, and the true errors."""
    rng = np.random.default_rng((20261123, seed))
    errors = drawn_errors(GRADES["industrial"], rng, asymmetry=False)
    turns = hand_turns(rng, shortest_s=1.0, longest_s=8.0, rest_s=6.0)
    unit = recording(turns, 8.0, errors, GRADES["industrial"], rng)
    b, a = FILTERS[name]
    gyro, accel = (
        lfilter(b, a, x, axis=0, zi=lfilter_zi(b, a)[:, None] * x[:200].mean(axis=0))[0]
        for x in (unit.gyro, unit.accel)
    )
    rests = [(begin + 0.6, end - 0.05) for begin, end in windows(turns, 8.0)]
    labels = tuple(srt.SequenceLabel(start, end) for start, end in pairwise(rests))
    truth = np.array([errors.get(parameter, 0.0) for parameter in NAMES])
    return replace(unit, gyro=gyro, accel=accel).with_sequences(labels), truth


@pytest.mark.parametrize("units", [2, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["moving average of 3", "50 ms"])
def test_sigmas_of_filtered_units(name, units):
    """NEES of all parameters and of the gyro biases alone, which the noise of the windows determines.

    Upper limits only (family-wise 1e-3): no noise is stated, so that sigmas contain a bound of the bias instability.
    """
    bias = GROUP_SLICES["gyro_bias"]
    total, freedom, biases = 0.0, 0, 0.0
    for seed in range(units):
        unit, truth = filtered_unit(seed, name)
        held = ("gyro_asymmetry", "accel_asymmetry")
        found = srt.calibrate(unit, "least-squares", checks=False, hold=held)
        seen = np.flatnonzero(found.observed)
        error, sigma = (found.errors.vector - truth)[seen], found.sigma[seen]
        correlation = found.covariance[np.ix_(seen, seen)] / np.outer(sigma, sigma)
        total += float(error / sigma @ np.linalg.solve(correlation, error / sigma))
        freedom += len(seen)
        biases += float(np.sum(((found.errors.vector - truth)[bias] / found.sigma[bias]) ** 2))
    assert total < chi2.isf(2.5e-4, freedom)
    assert biases < chi2.isf(2.5e-4, 3 * units)
