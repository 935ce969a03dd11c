"""Integrals of the analytic platform against those of ideal turns, at several sample rates and on the turning Earth."""

import numpy as np
import pytest
from ideal_table_1 import G, paused_table_1
from platform_streams import EPS, PERFECT

import sims
from srt.model.analytic_platform import integrate_attitude
from srt.model.gyro_stream import gyro_stream
from srt.model.rotation_integrals import ideal_rotations
from srt.model.table1 import SEQUENCES
from srt.recording.recording import Site
from srt.sensor_errors import SensorErrors
from srt.sequences.preparation import prepare

# --- weights of windows, eq. 21 --------------------------------------------------------------------------------------

WINDOW_S = 4.0


@pytest.fixture(scope="module")
def recordings():
    """Table 1 without the Earth's rate, at several sample rates; a pause after every leg."""

    def make(rate_hz):
        motion = paused_table_1(WINDOW_S, site=Site(G), sample_rate_hz=rate_hz, earth_rate=False)
        return sims.read_out(motion, SensorErrors())

    return make


@pytest.mark.parametrize("average", ["linear", "overlapping"])
def test_window_weights_reproduce_eq_21(recordings, average):
    """Integrated windows add T [I + F (C_End − I)] with F = 1/2 to ∫ F Ĉ dt, and 2T/3 to the variance."""
    recording = recordings(100.0)
    data = prepare(recording, recording.sequences, average)
    still = np.zeros(len(data.windows.duration_s), dtype=bool)
    integrals = {}
    for name, flags in (("held", still), ("integrated", ~still)):
        stream, _, _ = data.stream(flags)
        integrals[name], _ = integrate_attitude(stream, PERFECT, np.zeros((data.K, 3)), with_noise=True)
    held, integrated = integrals["held"], integrals["integrated"]
    C = held.C_end
    expected = WINDOW_S * (np.eye(3) + 0.5 * (C - np.eye(3)))
    rounding = 4 * EPS * 400 * WINDOW_S
    np.testing.assert_allclose(integrated.time - held.time, expected, rtol=0, atol=rounding)
    np.testing.assert_allclose(integrated.weight_s - held.weight_s, WINDOW_S, rtol=0, atol=64 * rounding)
    np.testing.assert_allclose(integrated.C_end, C, rtol=0, atol=64 * EPS)
    # At rest nothing but the bias acts.
    np.testing.assert_allclose(integrated.rate, held.rate, rtol=0, atol=64 * rounding)
    # Sum over channels: ∫ F² dt, the same for every component. Of a ramp sampled n times it is T/3 (1 − 1/4n²).
    n = round(WINDOW_S * 100)
    variance = np.einsum("kaab->ka", integrated.noise)
    rotation_s = (data.rotation[:, 1] - data.rotation[:, 0]) / 100.0
    # A triangular weighting has an S-shaped F, whose squared integral is 23/60 T in the limit.
    share = {"linear": (1.0 - 0.25 / n**2) / 3.0, "overlapping": 23.0 / 60.0}[average]
    both = 2.0 * WINDOW_S * share
    # Ĉ of a sample is the mean of both ends: its square falls short by (ω dt)²/4 at most while turning.
    tolerance = rotation_s[:, None] * 0.01**2 / 4 + (1e-9 if average == "linear" else 2 * WINDOW_S / n)
    assert np.all(np.abs(variance - (rotation_s[:, None] + both)) <= tolerance)


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0, 1000.0])
def test_recorded_integrals_are_the_ideal_ones(recordings, rate_hz):
    """Angles are exact; times differ by ramps and pauses, over which Ĉ is known."""
    recording = recordings(rate_hz)
    data = prepare(recording, recording.sequences)
    stream, _, _ = data.stream(np.zeros(len(data.windows.duration_s), dtype=bool))
    found, _ = integrate_attitude(stream, PERFECT, np.zeros((data.K, 3)), with_noise=True)
    ideal = ideal_rotations(list(SEQUENCES.values()))
    angle = np.array([np.abs(s.angles_rad).sum() for s in SEQUENCES.values()])
    # (ω dt)²/12 of the angle for the mean of both ends; rounding for what does not depend on it.
    share = (1.0 / rate_hz) ** 2 / 12.0 * angle
    np.testing.assert_allclose(found.C_end, ideal.C_end, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.angle, ideal.angle, rtol=0, atol=1e-12)
    for name in ("rate", "abs_rate"):
        difference = np.abs(getattr(found, name) - getattr(ideal, name)).reshape(data.K, -1).max(axis=1)
        assert np.all(difference <= share + 1e-12), name
    # Ramps of 0.1 s and pauses of 0.1 s after each leg, and the last sample's rest.
    legs = np.array([len(s.rotations) for s in SEQUENCES.values()])
    half = 0.5 / rate_hz
    longer = legs * 0.1 + (legs - 1) * 0.1 + 2.0 * half
    np.testing.assert_allclose(found.weight_s, ideal.weight_s + longer - half, rtol=0, atol=half + 1e-9)
    for name in ("time", "noise"):
        difference = np.abs(getattr(found, name) - getattr(ideal, name)).reshape(data.K, -1).max(axis=1)
        assert np.all(difference <= longer + share), name


def test_sample_rate_with_the_earth_turning():
    """50 Hz against the truth on a turning Earth: what is left of z is far below a nanorad · g."""
    for rate_hz, bound_rad in ((50.0, 1e-9), (200.0, 1e-10)):
        motion = paused_table_1(2.0, site=Site(G, latitude_rad=0.8), sample_rate_hz=rate_hz, heading_rad=0.4)
        recording = sims.read_out(motion, SensorErrors())
        data = prepare(recording, recording.sequences)
        stream, _, _ = data.stream(np.zeros(len(data.windows.duration_s), dtype=bool))
        earth = np.einsum("kba,b->ka", data.nominal, data.earth_rate_base())
        found, _ = integrate_attitude(stream, PERFECT, earth)
        truth = np.array([before.T @ after for before, after in motion.attitudes])
        # A ramp's corner inside a sample: β̈ ω_e dt³/12, 10 · 7.3e-5 · 8e-6 / 12 = 5e-10 rad at 50 Hz, twice per leg.
        assert np.abs(found.C_end - truth).max() < 16 * bound_rad


def test_attitude_and_integrals_on_the_turning_earth():
    """A body at rest but for one quick turn: Ĉ in its windows is known, and so is ∫ F Ĉ dt.

    Attitudes are exact; the integrals take the Earth's turn of a sequence by its mean, so that less than half of
    ω_e T is left of what would be all of it.
    """
    site = Site(G, latitude_rad=0.8)
    motion = paused_table_1(20.0, sequences=("7", "12", "4"), site=site, sample_rate_hz=100.0, heading_rad=0.4)
    recording = sims.read_out(motion, SensorErrors())
    data = prepare(recording, recording.sequences)
    stream, _, weights = data.stream(np.ones(6, dtype=bool))
    earth = np.einsum("kba,b->ka", data.nominal, data.earth_rate_base())
    found, attitudes = integrate_attitude(stream, PERFECT, earth, with_noise=True)
    still, _ = integrate_attitude(stream, PERFECT, np.zeros((3, 3)), with_noise=True)
    for k, (before, after) in enumerate(motion.attitudes):
        C = before.T @ after
        np.testing.assert_allclose(found.C_end[k], C, rtol=0, atol=1e-9)
        s, e = stream.starts[k : k + 2]
        first, last = stream.rotation[k]
        # Mean of a sample's ends: (ω_e dt)² is nothing. 1e-9 for ramps' corners, as above.
        np.testing.assert_allclose(attitudes[:, :, s:first], np.eye(3)[:, :, None] * np.ones(first - s), atol=1e-12)
        np.testing.assert_allclose(attitudes[:, :, last:e], C[:, :, None] * np.ones(e - last), rtol=0, atol=1e-9)
        # The truth of ∫ F Ĉ dt, sample by sample: the windows as above, the rotation from where it starts.
        F, dt = stream.F, stream.interval_s
        alone = gyro_stream(
            recording.gyro,
            recording.interval_s,
            data.rotation[k : k + 1],
            data.rotation[k : k + 1],
            rates=True,
        )
        turn, _ = integrate_attitude(alone, PERFECT, earth[k : k + 1])
        expected = turn.time[0] + np.eye(3) * (F * dt)[s:first].sum() + C * (F * dt)[last:e].sum()
        elapsed = dt[s:e].sum()
        part = 7.292115e-5 * elapsed * found.weight_s[k]
        assert np.abs(found.time[k] - expected).max() < 0.5 * part
        # And without turning the Earth back the whole of it would be left.
        assert np.abs(still.time[k] - expected).max() > np.abs(found.time[k] - expected).max()
    assert weights is not None
