"""Eqs. 1-2 as the data processing evaluates them: the Earth's rate, the vertical, the rest rates, the orientation of
MARS.

Derivatives are blind to what is a constant of the errors; here the values themselves are held against the truth.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from ideal_table_1 import G, component_rows, paused_table_1, player_of

import sims
from srt.constants import EARTH_RATE_RAD_S
from srt.recording.recording import SequenceLabel, Site
from srt.sensor_errors import SensorErrors

LATITUDE, HEADING = 0.8, 0.4
WINDOW_S = 2.0
RATE_HZ = 100.0
NONE = SensorErrors()


def motion_of(draw=None, U=None, *, earth_rate=True, sequences=tuple(sims.TABLE_1)):
    return paused_table_1(
        WINDOW_S,
        sequences=sequences,
        site=Site(G, latitude_rad=LATITUDE if earth_rate else None),
        sample_rate_hz=RATE_HZ,
        heading_rad=HEADING,
        fixture_draw=draw,
        U=U,
        earth_rate=earth_rate,
    )


def longest_s(data):
    return (data.rotation[:, 1] - data.rotation[:, 0]).max() / RATE_HZ + 2 * WINDOW_S


# At 100 Hz a ramp's corner inside a sample hides β̈ ω_e dt³/12 = 6e-11 rad of coning; 16 corners at most in a sequence.
ATTITUDE = 16 * 10.0 * EARTH_RATE_RAD_S / RATE_HZ**3 / 12.0
ROUNDING = 1e-14 * G


@pytest.mark.parametrize("window_attitude", ["held", "integrated"])
@pytest.mark.parametrize("nominal_vertical", [False, True])
def test_a_faultless_unit_measures_nothing(window_attitude, nominal_vertical):
    """All measurements of an error-free unit on an error-free fixture are zero on the rotating Earth."""
    data, player = player_of(sims.read_out(motion_of(), NONE), window_attitude=window_attitude)
    played = player.process(NONE, nominal_vertical=nominal_vertical)
    assert np.abs(played.z[: 2 * data.K]).max() < G * ATTITUDE
    assert np.abs(played.z[2 * data.K : -3]).max() < ROUNDING
    # A wrong sign of the Earth's rate would leave 2 ω_e over a second and more.
    assert 2 * G * EARTH_RATE_RAD_S > 1e3 * G * ATTITUDE
    # Rest: the Earth is gone from every window, at the end of each turn too.
    assert np.abs(played.rest_rate).max() < EARTH_RATE_RAD_S * ATTITUDE + 1e-16
    np.testing.assert_allclose(played.earth_rate @ [0, 0, 0], 0.0)
    np.testing.assert_allclose(np.linalg.norm(played.earth_rate, axis=1), EARTH_RATE_RAD_S, rtol=1e-12)


def test_earth_rate_and_acceleration_are_the_true_ones():
    motion = motion_of()
    data, player = player_of(sims.read_out(motion, NONE))
    played = player.process(NONE)
    ned = EARTH_RATE_RAD_S * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)])
    start = motion.attitudes[:, 0]
    np.testing.assert_allclose(played.earth_rate, np.einsum("kab,a->kb", start, ned), rtol=0, atol=1e-18)
    np.testing.assert_allclose(played.acceleration, -G * start[:, 2], rtol=0, atol=G * ATTITUDE)
    np.testing.assert_allclose(
        played.window_attitude[data.end], np.einsum("kba,kbc->kac", start, motion.attitudes[:, 1]), atol=ATTITUDE
    )
    np.testing.assert_array_equal(played.window_attitude[data.start], np.broadcast_to(np.eye(3), (data.K, 3, 3)))


@pytest.mark.parametrize("level", [(0.01, 0.0, 0.0), (0.0, -0.02, 0.0), (0.006, 0.008, 0.0)])
def test_the_measured_vertical_takes_the_tilt_out_of_the_earth_rate(level):
    """A base out of level by 10 mrad: with the nominal vertical ω_e is as much off, with the measured one it is right.

    The smallest rotation from the nominal to the measured vertical is the tilt itself; the base then has its north
    exactly, for the draw turns about level axes.
    """
    draw = sims.FixtureDraw(base=np.array(level))
    motion = motion_of(draw)
    data, player = player_of(sims.read_out(motion, NONE))
    ned = EARTH_RATE_RAD_S * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)])
    true = np.einsum("kab,a->kb", motion.attitudes[:, 0], ned)
    measured, nominal = (player.process(NONE, nominal_vertical=flag) for flag in (False, True))
    np.testing.assert_allclose(measured.earth_rate, true, rtol=0, atol=1e-16)
    tilt = np.linalg.norm(level)
    off = np.linalg.norm(nominal.earth_rate - true, axis=1)
    assert np.all(off > 0.3 * tilt * EARTH_RATE_RAD_S)
    assert np.abs(measured.z[: 2 * data.K]).max() < G * ATTITUDE
    # Left in by the nominal one: the tilt's ω_e over the sequence, g of it.
    assert np.abs(nominal.z[: 2 * data.K]).max() < G * tilt * (EARTH_RATE_RAD_S * longest_s(data) + tilt)
    # g − |f| knows no tilt; û · f + g with the nominal vertical is g tilt²/2 off, with the measured one not.
    assert np.abs(measured.z[2 * data.K : -3]).max() < ROUNDING


def test_down_of_the_paper_with_a_tilted_base():
    tilt = 0.01
    recording = sims.read_out(motion_of(sims.FixtureDraw(base=np.array([tilt, 0.0, 0.0]))), NONE)
    data, player = player_of(recording, down="paper")
    nominal = player.process(NONE, nominal_vertical=True).z[2 * data.K : -3]
    # û from the fixture at the start; at the end it is carried on by the attitude, so that the tilt is the same.
    np.testing.assert_allclose(nominal, G * tilt**2 / 2, rtol=tilt**2, atol=G * tilt * 2 * ATTITUDE + 1e-3 * 5e-4 * G)
    measured = player.process(NONE).z[2 * data.K : -3]
    assert np.abs(measured).max() < ROUNDING + G * ATTITUDE**2 + 1e-12
    # And it sees an accelerometer's scale with the same sign as ours.
    truth = SensorErrors.from_dict({"accel_scale_z": 1e-5})
    level = sims.read_out(motion_of(), truth)
    by_definition = {}
    for down in ("paper", "tilt-immune"):
        data, player = player_of(level, down=down)
        by_definition[down] = player.process(NONE).z[component_rows(data)["1", "start"]]
    assert by_definition["paper"] == pytest.approx(-1e-5 * G, rel=1e-8)
    assert by_definition["tilt-immune"] == pytest.approx(-1e-5 * G, rel=1e-8)


def test_orientation_of_mars_is_read_off_the_axes_and_verticals():
    """A body turned by any U on the table: found from one iteration, without the Earth exactly."""
    U = sims.rotation([0.4, -0.3, 0.5])
    _, player = player_of(sims.read_out(motion_of(U=U, earth_rate=False), NONE))
    for guess in (U, np.eye(3)):
        played = player.process(NONE, U=guess)
        np.testing.assert_allclose(played.U, U, rtol=0, atol=1e-12)
    # On the Earth: its rate over the turns is taken off to the accuracy that it is known to (the guess's error).
    _, player = player_of(sims.read_out(motion_of(U=U), NONE))
    np.testing.assert_allclose(player.process(NONE, U=U).U, U, rtol=0, atol=EARTH_RATE_RAD_S * 0.1)


def test_rest_rates_pool_and_share():
    """A bias that differs in one sequence, seen as that sequence's own; the rest as the pool's."""
    motion = motion_of(earth_rate=False)
    recording = sims.read_out(motion, NONE)
    data, _ = player_of(recording)
    bias = np.array([2e-6, -1e-6, 3e-6])
    extra = np.array([1e-6, 2e-6, -4e-6])
    k = 6
    gyro = recording.gyro + bias
    # From the start of sequence k's start window to the end of its end window.
    first, last = data.windows.samples[data.start[k], 0], data.windows.samples[data.end[k], 1]
    gyro[first:last] += extra
    data, player = player_of(replace(recording, gyro=gyro))
    played = player.process(NONE)
    pooled = bias + extra / data.K  # windows of equal length, two of 34
    np.testing.assert_allclose(played.z[-3:], pooled, rtol=0, atol=1e-16)
    expected = np.zeros((data.K, 3))
    expected[k] = extra
    np.testing.assert_allclose(played.bias_by_sequence, expected - extra / data.K, rtol=0, atol=1e-16)
    # With the pooled bias and each sequence's own taken off, the turns are right again.
    found = NONE.plus(np.concatenate([np.zeros(24), pooled]))
    again = player.process(found, bias_offset=played.bias_by_sequence)
    assert np.abs(again.z[: 2 * data.K]).max() < 1e-12 * G
    assert np.abs(player.process(found).z[: 2 * data.K]).max() > 1e-6 * G


def test_turns_that_share_their_windows():
    """Each pose ends one turn and starts the next: a window belongs to the turn it starts, the last one to its end."""
    turns = sims.random_turns(np.random.default_rng(2), 4)
    motion = sims.free_motion(
        turns, site=Site(G, latitude_rad=LATITUDE), sample_rate_hz=RATE_HZ, dwell_s=WINDOW_S, earth_rate=False
    )
    labels = tuple(SequenceLabel(first, second) for first, second in motion.windows)
    # Without latitude the Earth's rate is taken as none, as it is here.
    recording = replace(sims.read_out(motion, NONE), site=Site(G), fixture=None).with_sequences(labels)
    data, player = player_of(recording)
    played = player.process(NONE)
    np.testing.assert_array_equal(data.end[:-1], data.start[1:])
    np.testing.assert_array_equal(played.window_sequence, [0, 1, 2, 3, 3])
    expected = [np.eye(3)] * 4 + [played.integrals.C_end[3]]
    np.testing.assert_array_equal(played.window_attitude, expected)
    np.testing.assert_allclose(played.share.sum(axis=1), 1.0, rtol=1e-15)
    assert np.all((played.share > 0.0).sum(axis=1) == 2)
    assert np.abs(played.z).max() < 1e-11 * G
    # The two directions of every turn are horizontal, orthonormal and right-handed with down.
    down = -played.force[data.start] / G
    for b, d in zip(played.basis, down, strict=True):
        np.testing.assert_allclose(np.vstack([b, d]) @ np.vstack([b, d]).T, np.eye(3), atol=1e-12)
        assert np.linalg.det(np.vstack([b, d])) > 0.0


def test_free_turns_take_off_the_vertical_part_of_the_earth_rate():
    """Free rotations, whose heading is unknown, are corrected for the vertical part of the Earth rate."""
    turns = sims.random_turns(np.random.default_rng(3), 3)
    motion = sims.free_motion(turns, site=Site(G, latitude_rad=LATITUDE), sample_rate_hz=RATE_HZ, dwell_s=WINDOW_S)
    labels = tuple(SequenceLabel(first, second) for first, second in motion.windows)
    recording = replace(sims.read_out(motion, NONE), fixture=None).with_sequences(labels)
    data, player = player_of(recording)
    played = player.process(NONE)
    down = -played.force[data.start] / G
    expected = -EARTH_RATE_RAD_S * math.sin(LATITUDE) * down
    np.testing.assert_allclose(played.earth_rate, expected, rtol=0, atol=1e-16)
    # What is left at rest is the northern part.
    np.testing.assert_allclose(
        np.linalg.norm(played.rest_rate[data.start], axis=1),
        EARTH_RATE_RAD_S * math.cos(LATITUDE),
        rtol=1e-9,
    )
