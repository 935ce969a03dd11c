"""Refusal of noise terms where the readings at rest contradict them, or change within the window.

Truth is the noise that is made here, by sums and filters of normal numbers.
"""

import json
from functools import partial

import numpy as np
import pytest
from scipy.signal import butter, lfilter
from scipy.stats import binom

import srt
from srt.cli import main
from srt.noise import noise_terms as fit
from srt.noise.noise_agreement import FALSE_ALARM, contradiction
from srt.noise.noise_terms import ALL_TERMS, noise_terms

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
def test_the_command_refuses_such_noise(tmp_path, capfd, maker):
    assert main(["noise", str(log(tmp_path / "rest", maker))]) == 1
    out, err = capfd.readouterr()
    assert "is not that of a unit at rest. " in err
    assert "times the noise at" in err
    assert "angular random walk" not in out


def test_one_channel_without_figures_leaves_those_of_the_others(tmp_path, capfd):
    folder = log(tmp_path / "rest", low_pass, clean, clean)
    assert main(["noise", str(folder), "-o", str(tmp_path / "noise.json")]) == 0
    out = " ".join(capfd.readouterr().out.split())
    assert "No terms of gyro x: the window has" in out
    channels = json.loads((tmp_path / "noise.json").read_text())["channels"]
    assert channels["gyro_x"] == {} == channels["accel_x"]
    for name in ("gyro_y", "gyro_z"):
        found = channels[name]["gyro_noise_deg_per_sqrt_h"]
        # The true value, 1e-4 rad/√s, within 3.5 half-widths over 1.96.
        true = np.degrees(WHITE * np.sqrt(DT)) * 60.0
        assert abs(found["value"] - true) < 3.5 / 1.96 * 0.5 * (found["high"] - found["low"])


def test_a_clean_log_keeps_its_figures(tmp_path):
    found = noise_terms(srt.load_recording(log(tmp_path / "rest", clean, walking, drifting)), (0, SAMPLES))
    assert not found.refused
    assert found.resolved[:, WALK].all()


@pytest.mark.parametrize("maker", [clean, walking, drifting, flickering])
def test_clean_channels_are_refused_no_more_often_than_stated(maker):
    """300 channels each; binomial, at most once in 250 tests by chance for each of the four makers."""
    n, units = 5000, 300
    rng = np.random.default_rng((SEED, 2))
    edges = fit._bins(n)
    design = fit._design(0.5 * np.pi * np.arange(1, n) / n, n, DT)
    binned = np.stack([fit._mean(column, edges) for column in design.T], axis=1)
    u = fit._ramp(n, DT)
    refused = 0
    for _ in range(units):
        x = WHITE * maker(rng, n)
        best = fit._likeliest(fit._spectrum(x - x.mean(), edges, binned, u))
        without_ramp = x - best.ramp * DT * np.arange(n)
        refused += contradiction(without_ramp, DT, partial(fit._variance, squares=best.squares, dt=DT)) is not None
    assert refused <= binom.ppf(1.0 - 0.0025, units, FALSE_ALARM)
