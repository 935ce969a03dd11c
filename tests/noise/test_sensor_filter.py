"""White noise behind the low-pass filter of a sensor, with filters of scipy.signal: the noise of window means."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from foreign_motion import GRADES, drawn_errors, hand_turns, recording, windows
from scipy.signal import butter, firwin, lfilter, lfilter_zi
from scipy.stats import chi2

import srt
from srt.noise.noise_model import noise_model
from srt.sensor_errors import GROUP_SLICES, NAMES

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
