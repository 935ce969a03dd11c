"""Clipped readings are found whatever range is stated, on fixtures and in free recordings; sound ones raise nothing."""

from dataclasses import replace

import numpy as np
import pytest
from foreign_motion import GRADES as HAND_GRADES
from foreign_motion import drawn_errors, hand_turns
from foreign_motion import recording as hand_recording
from injected_faults.injection import GRADES, Case

import srt
from srt.constants import DEG
from srt.sequences.clipping import clipped_samples, clipping_levels

SEED = 20261122


@pytest.fixture(scope="module")
def fixture_recording():
    return Case("tactical-fog", 900).recording


@pytest.fixture(scope="module")
def hand():
    rng = np.random.default_rng((SEED, 1))
    grade = HAND_GRADES["consumer"]
    return hand_recording(hand_turns(rng), 5.0, drawn_errors(grade, rng), grade, rng, profile="hand")


def channels(recording):
    return {c.channel for c in clipped_samples(recording, slice(0, len(recording.time)))}


@pytest.mark.parametrize("stated_deg_s", [None, 400.0])
def test_gyros_held_inside_the_stated_range(fixture_recording, stated_deg_s):
    noise = replace(
        fixture_recording.noise, gyro_range=None if stated_deg_s is None else stated_deg_s * DEG, gyro_quantization=None
    )
    limit = 0.95 * fixture_recording.nominal_interval_s  # increments
    wrong = replace(fixture_recording, gyro=np.clip(fixture_recording.gyro, -limit, limit), noise=noise)
    assert channels(wrong) == {"gyro_x", "gyro_y", "gyro_z"}
    with pytest.raises(srt.DataError) as caught:
        srt.calibrate(wrong)
    assert caught.value.fault == "gyro_clipped" or "range" in str(caught.value)


@pytest.mark.parametrize("level", [9.7, 9.79])
def test_accelerometers_held_below_gravity(fixture_recording, level):
    limit = level * fixture_recording.nominal_interval_s
    wrong = replace(fixture_recording, accel=np.clip(fixture_recording.accel, -limit, limit))
    assert any(name.startswith("accel") for name in channels(wrong))
    assert {f.fault for f in srt.diagnose(wrong, calibrating=False).findings} & {"accel_clipped", "gravity"}


def test_rails_that_a_shake_reaches_for_single_samples(hand):
    lsb = 2000.0 * DEG / 32768
    counts = np.round(hand.gyro / lsb)
    counts[[3000, 3100, 3200], 0] = 32767
    counts[[3050, 3150], 0] = -32768
    assert channels(replace(hand, gyro=counts * lsb)) == {"gyro_x"}
    assert channels(replace(hand, gyro=np.round(hand.gyro / lsb) * lsb)) == set()


@pytest.mark.parametrize("units", [1, pytest.param(20, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("grade", GRADES)
def test_nothing_is_found_in_sound_fixture_recordings(grade, units):
    for seed in range(units):
        levels = clipping_levels(Case(grade, seed).recording)
        stated = Case(grade, seed).recording.noise
        if stated.gyro_range is None:
            assert np.isinf(levels.high[:3]).all()
        assert channels(Case(grade, seed).recording) == set()


@pytest.mark.parametrize("profile", ["raised-cosine", "trapezoid", "constant-rate", "hand"])
@pytest.mark.parametrize("grade", HAND_GRADES)
def test_nothing_is_found_in_sound_hand_recordings(grade, profile):
    rng = np.random.default_rng((SEED, 2))
    turns = hand_turns(rng, count=12)
    made = hand_recording(turns, 5.0, {}, HAND_GRADES[grade], rng, profile=profile)
    assert channels(made) == set()
    quantum = 0.25 * np.median(np.abs(np.diff(made.gyro, axis=0)), axis=0)
    assert channels(replace(made, gyro=np.round(made.gyro / quantum) * quantum)) == set()
