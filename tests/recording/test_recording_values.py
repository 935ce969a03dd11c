"""A recording in memory: what it refuses, what it copies, and which samples a window holds."""

import math
import pickle
from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from srt.constants import DEG
from srt.exceptions import InputError
from srt.recording.recording import Fixture, ImuNoise, Recording, SequenceLabel, Site

SITE = Site(9.80665, latitude_rad=0.8)


def make(n=1000, dt=0.01, **changes):
    rng = np.random.default_rng(3)
    fields = {
        "time": dt * np.arange(1, n + 1),
        "gyro": rng.standard_normal((n, 3)),
        "accel": rng.standard_normal((n, 3)),
        "site": SITE,
    }
    return Recording(**(fields | changes))


def altered(column, row, value, n=1000):
    recording = make(n)
    array = getattr(recording, column).copy()
    array[row] = value
    return {column: array}


@pytest.mark.parametrize(
    ("changes", "fragments"),
    [
        ({"kind": "speed"}, ["'speed'", "'rate' or 'increment'"]),
        ({"gyro": np.zeros((1000, 2))}, ["gyro", "(1000, 2)", "(n, 3)"]),
        ({"gyro": np.zeros(3000)}, ["gyro", "(3000,)", "(n, 3)"]),
        ({"time": np.zeros((1000, 1))}, ["time", "(1000, 1)", "(n,)"]),
        ({"accel": np.zeros((999, 3))}, ["accel holds 999", "time 1000"]),
        ({"temperature": np.zeros(5)}, ["temperature holds 5", "1000"]),
        ({"gyro": [["a", "b", "c"]] * 1000}, ["gyro", "does not consist of numbers"]),
        (altered("gyro", (41, 1), np.nan), ["gyro_y", "sample 42 of 1000", "0.42 s", "nan", "1 such"]),
        (altered("accel", (7, 2), -np.inf), ["accel_z", "sample 8", "0.08 s", "-inf"]),
        (altered("time", 9, np.nan), ["Column time", "sample 10", "nan"]),
        ({"temperature": np.full(1000, np.inf)}, ["Column temperature", "sample 1 ", "inf", "1000 such"]),
        (altered("time", 500, 5.0), ["time", "sample 501", "repeats 5 s", "remove repeated"]),
        (altered("time", 500, 1.0), ["time", "sample 501", "goes back from 5 s"]),
        ({"sample_rate_hz": 0.0}, ["sample_rate_hz", "positive"]),
        ({"sample_rate_hz": math.nan}, ["sample_rate_hz", "nan"]),
        ({"time": np.ones(1), "gyro": np.zeros((1, 3)), "accel": np.zeros((1, 3))}, ["1 samples", "at least 2"]),
    ],
)
def test_bad_samples_are_refused_in_one_sentence(changes, fragments):
    with pytest.raises(InputError) as caught:
        make(**changes)
    message = str(caught.value)
    assert all(fragment in message for fragment in fragments), message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("build", "fragments"),
    [
        (lambda: Site(1.0), ["1 m/s²", "9.5", "10.1"]),
        (lambda: Site(-9.81), ["-9.81", "positive"]),
        (lambda: Site(math.nan), ["nan"]),
        (lambda: Site(9.8, gravity_sigma_m_s2=0.0), ["gravity_sigma", "0", "positive"]),
        (lambda: Site(9.8, latitude_rad=1.6), ["1.6", "90 in degrees"]),
        (lambda: Site(9.8, latitude_rad=math.nan), ["nan"]),
        (lambda: Fixture(heading_rad=7.0), ["heading", "7", "360 in degrees"]),
        (lambda: Fixture(alignment_sigma_rad=-1e-3), ["alignment", "-0.001"]),
        (lambda: Fixture(rotation_sigma_rad=math.inf), ["rotation", "inf"]),
        (lambda: ImuNoise(gyro_noise=0.0), ["gyro_noise", "from 1e-09"]),
        (lambda: Fixture(rotation_sigma_rad=1e-303), ["rotation_sigma_mrad", "from 1e-09 to 3200 in mrad"]),
        (lambda: ImuNoise(gyro_range=1e-9 * DEG), ["gyro_range_deg_s", "from 0.01 to 1e+06 in °/s"]),
        (lambda: Site(10**400), ["Gravity is 1000", "9.5"]),
        (lambda: Fixture(heading_rad=10**5000), ["heading_rad is an integer of more than 4300 digits"]),
        (lambda: ImuNoise(accel_quantization=-1.0), ["accel_quantization", "-1"]),
        (lambda: ImuNoise(gyro_range=math.nan), ["gyro_range", "nan"]),
        (lambda: SequenceLabel((2.0, 1.0), (3.0, 4.0), "7"), ["'7'", "start_static_s", "[2, 1]"]),
        (lambda: SequenceLabel((0.0, 1.0), (3.0, math.nan)), ["free turn", "end_static_s"]),
        (lambda: SequenceLabel((0.0, 3.0), (2.0, 4.0)), ["3 s", "2 s", "rotation"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), down="w"), ["'w'", "x, y, z, -x, -y, -z"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), along_outer="+x"), ["'+x'", "x, y, z, -x, -y, -z"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), down=""), ["''", "no IMU axis"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), rotations=(("-x", 1.0),)), ["'-x'", "the angle's sign"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), down="-x", along_outer="x"), ["axis x", "both"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), "1", down="-z"), ["'1'", "another way"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), rotations=(("u", 1.0),)), ["'u'"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), rotations=(("x", math.inf),)), ["angle"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), down="x", along_outer="x"), ["axis x", "both"]),
        (lambda: SequenceLabel((0.0, 1.0), (2.0, 3.0), "15"), ["'15'", "Table 1", "along_outer"]),
    ],
)
def test_bad_facts_are_refused_in_one_sentence(build, fragments):
    with pytest.raises(InputError) as caught:
        build()
    assert all(fragment in str(caught.value) for fragment in fragments), str(caught.value)


def test_poles_full_turns_and_perfect_sensors_are_legal():
    Site(9.8, latitude_rad=-math.pi / 2)
    Fixture(heading_rad=2 * math.pi)
    ImuNoise(gyro_quantization=0.0, accel_bias_instability=0.0)


def test_labels_may_repeat_what_table_1_says_or_define_their_own():
    SequenceLabel((0.0, 1.0), (2.0, 3.0), "7", "y", "x", (("x", math.pi),))
    label = SequenceLabel([0, 1], [2, 3], "mine", "y", "x", [["x", 1]])
    assert label == SequenceLabel((0.0, 1.0), (2.0, 3.0), "mine", "y", "x", (("x", 1.0),))
    assert hash(label) is not None


@pytest.mark.parametrize(
    ("start", "end", "fragment"),
    [
        ((-1.0, 2.0), (3.0, 4.0), "start_static_s is [-1, 2], but the samples run from 0 to 10 s"),
        ((0.0, 2.0), (9.0, 11.0), "end_static_s is [9, 11]"),
        ((0.0, 2.0), (9.0, 9.004), "holds no sample"),
    ],
)
def test_windows_must_lie_within_the_samples(start, end, fragment):
    with pytest.raises(InputError) as caught:
        make(sequences=(SequenceLabel(start, end),))
    assert fragment in str(caught.value)


def test_arrays_are_read_only_views_without_a_copy():
    time, gyro, accel = np.arange(1.0, 101.0), np.zeros((100, 3)), np.zeros((100, 3))
    recording = Recording(time, gyro, accel, SITE)
    for mine, given_ in ((recording.time, time), (recording.gyro, gyro), (recording.accel, accel)):
        assert np.shares_memory(mine, given_)
        assert given_.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            mine[0] = 1.0
    assert np.shares_memory(recording.with_sequences(()).gyro, gyro)


def test_other_arrays_become_contiguous_float64():
    recording = make(100, gyro=np.zeros((3, 100), dtype=np.float32).T, accel=[[1, 2, 3]] * 100)
    for array in (recording.gyro, recording.accel):
        assert array.dtype == np.float64
        assert array.flags.c_contiguous


def test_values_whose_sum_overflows_are_still_finite():
    make(gyro=np.full((1000, 3), 1e308))


def test_a_recording_survives_pickling_for_worker_processes():
    recording = make(sequences=(SequenceLabel((0.0, 1.0), (2.0, 3.0), "1"),))
    copy = pickle.loads(pickle.dumps(recording))  # noqa: S301 - our own bytes
    assert copy.sequences == recording.sequences
    assert copy.nominal_interval_s == recording.nominal_interval_s
    np.testing.assert_array_equal(copy.gyro, recording.gyro)


def test_readings_of_another_unit_on_the_same_motion():
    """They make the recording that the constructor makes of them, and are checked as it does."""
    labels = (SequenceLabel((0.0, 1.0), (8.0, 9.0), "1"),)
    first = make(sequences=labels, temperature=np.full(1000, 20.0), serial="first")
    first.memo("of these readings", first.gyro.sum)
    given = {"gyro": 2.0 * first.gyro, "accel": 3.0 * first.accel, "kind": "increment", "noise": ImuNoise(1e-4)}
    found, expected = first.with_readings(**given), make(sequences=labels, temperature=np.full(1000, 20.0), **given)
    for field in fields(Recording):
        if field.name != "_memo":
            np.testing.assert_array_equal(getattr(found, field.name), getattr(expected, field.name))
    assert found.window_indices(8.0, 9.0) == slice(800, 900)
    assert found.nominal_interval_s == pytest.approx(0.01, rel=1e-12)
    assert found.memo("of these readings", lambda: 0.0) == 0.0
    assert not found.gyro.flags.writeable
    for changes, fragment in (
        ({"gyro": np.zeros((999, 3))}, "gyro holds 999"),
        ({"accel": np.full((1000, 3), np.nan)}, "accel_x"),
        ({"kind": "speed"}, "'rate' or 'increment'"),
    ):
        with pytest.raises(InputError, match=fragment):
            first.with_readings(**(given | changes))


def test_window_holds_the_samples_whose_interval_lies_inside():
    recording = make()  # sample i ends at 0.01 (i + 1)
    assert recording.window_indices(0.0, 10.0) == slice(0, 1000)
    assert recording.window_indices(1.0, 2.0) == slice(100, 200)
    # half a sample of tolerance on either side: stamps in (1.004 + 0.005, 2.004 + 0.005]
    assert recording.window_indices(1.004, 2.004) == slice(100, 200)
    assert recording.window_indices(1.006, 2.006) == slice(101, 201)
    # just at the edge: a + dt/2 < t excludes the sample at 1.01, t <= b + dt/2 includes the one at 2.01
    assert recording.window_indices(1.005, 2.005) == slice(101, 201)
    assert recording.window_indices(20.0, 30.0) == slice(1000, 1000)
    assert recording.window_indices(-5.0, -1.0) == slice(0, 0)
    assert recording.window_indices(3.0, 2.0) == slice(300, 300)


@given(
    rate=st.sampled_from([50, 100, 128, 200, 333, 1000]),
    first=st.integers(0, 100_000),
    cuts=st.lists(st.integers(0, 400), min_size=2, max_size=6),
    half=st.sampled_from([0.0, 0.5]),
    noise=st.integers(0, 2**32 - 1),
)
def test_adjoining_windows_share_no_sample_and_lose_none(rate, first, cuts, half, noise):
    """Limits on samples and half-way between, with the last bits of stamps and limits disturbed."""
    rng = np.random.default_rng(noise)
    n = 401
    index = first + np.arange(n)
    time = index / rate * (1.0 + rng.uniform(-4e-16, 4e-16, n))
    recording = Recording(time, np.zeros((n, 3)), np.zeros((n, 3)), SITE)
    edges = sorted(cuts)
    limits = (first + np.array(edges) + half) / rate * (1.0 + rng.uniform(-4e-16, 4e-16, len(edges)))
    windows = [recording.window_indices(a, b) for a, b in pairwise(limits)]
    for i, window in enumerate(windows):
        # half 0: t > edge, so the sample after; half 0.5: edge + 1 is excluded, one further
        shift = 1 if half == 0.0 else 2
        assert window == slice(min(n, edges[i] + shift), min(n, edges[i + 1] + shift))
