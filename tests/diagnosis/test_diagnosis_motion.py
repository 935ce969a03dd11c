"""Faults of labels, stillness and turns, measured and told apart."""

import math
from dataclasses import replace
from functools import cache, partial

import injected_faults.execution  # noqa: F401 - registers its injections
import numpy as np
import pytest
import recorded_sets
from diagnosing import WithoutRecognition, case_of, examine_stages
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from injected_faults.injection import GRADES, INJECTIONS

from sims.physics.sequences import TABLE_1
from srt.diagnosis.faults import FAULTS
from srt.estimation.options import Options
from srt.exceptions import InputError
from srt.recording.recording import Fixture, Recording, SequenceLabel, Site
from srt.sequences.stationary_windows import find_turns

STAGES = ("sequences", "windows", "motion")
IDS = tuple(TABLE_1)
SEED = 320_000
FOLDER = recorded_sets.data_folder()


def findings(recording, options=None):
    return examine_stages(recording, STAGES, options=options)


case = partial(case_of, seed=SEED)


def named(fault, grade="navigation-rlg", severity=None):
    """The finding of a fault that was put in; it must be the first one."""
    found = findings(INJECTIONS[fault].recording(case(grade), severity))
    assert found
    assert found[0].fault == fault
    return found[0]


# --- sequences and labels --------------------------------------------------------------------------------------------


@cache
def with_moves():
    return case("tactical-fog").changed(schedule={"moves": "recorded"}).recording


@settings(max_examples=6, deadline=None)
@given(st.floats(0.5, 5.0), st.sampled_from([-1.0, 1.0]))
def test_the_shift_of_labels_is_told(size, sign):
    recording = with_moves()
    inner = recording.sequences[1:-1]  # the outermost windows have no room to be shifted
    moved = tuple(
        replace(
            label,
            start_static_s=tuple(t + sign * size for t in label.start_static_s),
            end_static_s=tuple(t + sign * size for t in label.end_static_s),
        )
        for label in inner
    )
    first = findings(recording.with_sequences(moved))[0]
    assert first.fault == "labels_shifted"
    # The smallest shift that brings them to rest: there are 0.2 s of settling before a window, and both the stillness
    # found and the shift go by steps of 0.1 s.
    assert sign * first.details["shift"] == pytest.approx(size - 0.1, abs=0.35)
    assert 0 < first.details["count"] <= first.details["of"] == 2 * len(inner)


def test_one_window_beside_the_stillness_is_told_with_its_own_shift():
    recording = with_moves()
    label = recording.sequences[6]
    a, b = label.start_static_s
    beside = replace(label, start_static_s=(a + 3.0, b + 1.5))
    sequences = (*recording.sequences[:6], beside, *recording.sequences[7:])
    first = findings(recording.with_sequences(sequences))[0]
    assert first.fault == "labels_shifted"
    assert first.details["count"] == 1
    assert first.details["shift"] == pytest.approx(1.5, abs=0.35)


@settings(max_examples=15, deadline=None)
@given(st.permutations(IDS))
def test_any_exchange_of_labels_is_told_with_the_right_names(order):
    assume(tuple(order) != IDS)
    recording = case("consumer-mems").recording
    labels = tuple(replace(label, id=name) for label, name in zip(recording.sequences, order, strict=True))
    first = findings(recording.with_sequences(labels))[0]
    pairs = [(wrong, right) for wrong, right in zip(order, IDS, strict=True) if wrong != right]
    assert first.fault == "labels_exchanged"
    assert first.details["labelled"] == ", ".join(wrong for wrong, _ in pairs)
    assert first.details["found"] == ", ".join(right for _, right in pairs)
    assert first.details["count"] == len(pairs)


def test_a_pair_exchanged_is_no_wrong_direction_and_one_of_it_alone_is():
    recording = case("industrial-mems").recording
    both = {"1": "1a", "1a": "1"}
    exchanged = tuple(replace(s, id=both.get(s.id, s.id)) for s in recording.sequences)
    assert findings(recording.with_sequences(exchanged))[0].fault == "labels_exchanged"
    # Sequence 1 turned as 1a is, and no other one there to have changed places with.
    alone = tuple(replace(s, id=both.get(s.id, s.id)) for s in recording.sequences if s.id != "1")
    first = findings(recording.with_sequences(alone))[0]
    assert first.fault == "wrong_direction"
    assert first.details["expected"] == pytest.approx(360.0)
    assert first.details["found"] == pytest.approx(-360.0, abs=1.0)  # raw: 500 ppm, fixture 1 mrad
    assert first.sentence.startswith("Sequence 1 was rotated in the wrong sense (by -3")


@pytest.mark.parametrize("severity", [2.0, 10.0, 90.0])
def test_a_wrong_angle_is_told_within_the_fixture(severity):
    finding = named("wrong_angle", severity=severity)
    error = abs(finding.details["found"]) - abs(finding.details["expected"])
    # Each turn has an error of 1 mrad of its own, 0.06°; six sigmas of two of them.
    assert abs(error) == pytest.approx(severity, abs=0.5)
    assert finding.details["count"] == 1


def test_an_angle_that_the_fixture_allows_is_not_told():
    recording = INJECTIONS["wrong_angle"].recording(case("navigation-rlg"), 0.2)
    assert findings(recording) == ()


def test_missing_sequences_are_named_with_what_they_would_show():
    recording = case("tactical-fog").recording
    without = recording.with_sequences(tuple(s for s in recording.sequences if s.id not in ("1a", "9")))
    (finding,) = findings(without)
    lost = {"gyro_asymmetry_y", "accel_misalignment_zx", "accel_scale_x", "accel_asymmetry_x"}
    assert set(finding.details["parameters"].split(", ")) == lost
    assert finding.sentence.startswith("Sequences 1a, 9 are missing (the recording has 15 of 17)")
    # What is held on request is not missed.
    (finding,) = findings(without, Options(asymmetry=False))
    assert set(finding.details["parameters"].split(", ")) == lost - {"gyro_asymmetry_y"}
    six = recording.with_sequences(tuple(s for s in recording.sequences if s.id not in ("1a", "2a", "3a")))
    assert findings(six, Options(asymmetry=False)) == ()


def test_repeated_sequences_are_a_note():
    finding = named("sequence_repeated", severity=2.0)
    assert finding.effect == "note"
    assert finding.details["sequences"].count("(2 times)") == 2


@pytest.mark.parametrize("share", [0.01, 0.15, 0.2, 0.45])
def test_a_short_window_is_told_with_its_time(share):
    finding = named("window_short", severity=share)
    # To a sample of 10 ms on either side.
    assert finding.details["duration"] == pytest.approx(10.0 * share, abs=0.03)
    assert finding.details["typical"] == pytest.approx(10.0, abs=0.03)


# --- stillness -------------------------------------------------------------------------------------------------------


def test_ringing_is_told_in_all_windows_that_have_it():
    finding = named("unsettled", "tactical-fog")
    assert finding.details["count"] == 33  # nothing was turned before the first window
    assert finding.details["amplitude"].endswith("mrad/s")


@pytest.mark.parametrize("grade", GRADES)
def test_a_bump_is_told_with_its_angle(grade):
    finding = named("bump", grade, severity=2.0)
    # A knock is over in 0.3 s, about two blocks; of its angle what is resolved, to six sigmas of the noise of half a
    # second (0.12 mrad for the noisiest gyros) and scale factors of 1.5 %.
    assert finding.details["angle_mrad"] == pytest.approx(2.0, abs=0.9 if grade == "consumer-mems" else 0.3)


def test_a_step_that_the_accelerometers_deny_is_no_bump():
    recording = case("tactical-fog").recording
    a, b = recording.sequences[4].start_static_s
    rows = recording.window_indices(a + 0.5 * (b - a), a + 0.5 * (b - a) + 0.2)
    gyro = recording.gyro.copy()
    gyro[rows, 1] += 1e-3 / (rows.stop - rows.start)
    assert "bump" not in [f.fault for f in findings(replace(recording, gyro=gyro))]


@pytest.mark.parametrize("grade", ["navigation-rlg", "tactical-fog"])
def test_creep_is_told_with_its_rate(grade):
    finding = named("creep", grade)
    # Six sigmas of a drift over 10 s: 0.6 and 15 µrad/s (accelerometers alone).
    sigma = {"navigation-rlg": 0.6, "tactical-fog": 15.0}[grade]
    assert finding.details["rate_urad_s"] == pytest.approx(INJECTIONS["creep"].severity[grade], abs=6.0 * sigma)


def test_a_noisy_window_is_told_with_its_factor():
    finding = named("noisy_window", "industrial-mems", severity=4.0)
    # White noise alone: a variance from 2000 differences is known to 3 %, its root to 1.6 %; six sigmas.
    assert finding.details["ratio"] == pytest.approx(4.0, rel=0.1)
    assert finding.details["sensor"] in ("gyros", "accelerometers")


@pytest.mark.skipif(FOLDER is None, reason="the recorded sets are not at hand")
def test_a_real_bump_is_seen_by_both_units_that_were_turned_together():
    """Windows that are found end before the bump; a window that is labelled across it is named."""
    told = []
    for unit in (0, 1):
        recording = recorded_sets.mpu9150(FOLDER, unit)
        labels = find_turns(recording)
        at = next(k for k, label in enumerate(labels) if label.start_static_s[0] > 8.0)
        first = labels[at]
        assert first.start_static_s[1] < 14.0
        across = replace(first, start_static_s=(first.start_static_s[0], 14.5))
        found = findings(recording.with_sequences((across, *labels[at + 1 :])))
        told.append(next(f.details for f in found if f.fault == "bump"))
    # Started by hand within a fraction of a second of one another; scale factors agree to a few per cent.
    assert told[0]["time"] == pytest.approx(told[1]["time"], abs=0.3)
    assert told[0]["angle_mrad"] == pytest.approx(told[1]["angle_mrad"], rel=0.15)


# --- turns -----------------------------------------------------------------------------------------------------------


@settings(max_examples=5, deadline=None)
@given(st.floats(-8.0, 8.0))
def test_the_offset_of_the_sensors_is_found_to_its_sigma(milliseconds):
    # The injection draws its own sign.
    recording = INJECTIONS["sensor_time_offset"].recording(case("industrial-mems"), milliseconds)
    lags = WithoutRecognition(recording).time_offset.by_turn
    sigma = lags.std(ddof=1) / math.sqrt(len(lags))
    # t of 11 degrees of freedom: 1e-6 of all samples lie beyond 9.5 sigmas, and 0.1 ms is what interpolation costs.
    assert abs(1e3 * lags.mean()) == pytest.approx(abs(milliseconds), abs=9.5e3 * sigma + 0.1)


def test_half_a_sample_is_told_with_its_sign():
    recording = INJECTIONS["sensor_time_offset"].recording(case("consumer-mems"))
    (finding,) = findings(recording)
    assert f"lag the gyro readings by {finding.details['offset_ms']:+.3g} ms" in finding.sentence


@pytest.mark.parametrize("samples", [1, 5, 30])
def test_lost_samples_are_told_with_place_and_duration(samples):
    finding = named("samples_lost", severity=0.01 * samples)
    duration, angle = finding.details["duration"], math.radians(finding.details["angle_deg"])
    # At 1 rad/s, but less where the loss meets the end of a turn; a longer loss than the 0.2 s looked at on both
    # sides of it is a step all the same.
    assert 0.3 * 0.01 * samples < angle < 1.1 * 0.01 * samples
    assert duration > 0.3 * 0.01 * samples


@pytest.mark.parametrize("count", [5, 7, 8])
@pytest.mark.parametrize("grade", GRADES[1:])
def test_a_test_that_has_only_begun_has_lost_no_samples(grade, count):
    """Few rotations hardly determine the accelerometers' errors, which must not pass for steps."""
    recording = case(grade).recording
    labels = recording.sequences[:count]
    rows = slice(0, recording.window_indices(*labels[-1].end_static_s).stop)
    begun = replace(
        recording, time=recording.time[rows], gyro=recording.gyro[rows], accel=recording.accel[rows], sequences=labels
    )
    assert "samples_lost" not in [finding.fault for finding in findings(begun)]


@pytest.mark.parametrize("dwell", [0.0, 1.0])
def test_turns_are_told_apart_whether_or_not_the_unit_stands_between_them(dwell):
    run = case("navigation-rlg").changed(schedule={"leg_dwell_s": dwell}).simulation
    numbers, nominal, turned = WithoutRecognition(run.recording).rotations
    assert numbers.tolist() == [k for k, s in enumerate(TABLE_1.values()) for _ in s.rotations]
    # Six sigmas: about axes 1 mrad off in three ways, angles 1 mrad off, scale factors of 100 ppm, non-orthogonality
    # and frame of 0.5 mrad; all in full turns.
    assert np.abs(turned - nominal).max() < 6.0 * 2.0 * math.pi * math.hypot(1e-3, 1e-3, 1e-3, 0.5e-3, 0.5e-3)


# --- odd recordings --------------------------------------------------------------------------------------------------

SITE = Site(9.8)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(st.data())
def test_no_recording_makes_a_check_fail(data):
    """Any readings, down to windows of two samples, give findings and never an error."""
    n = data.draw(st.integers(16, 600))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    size = data.draw(st.sampled_from([0.0, 1e-300, 1e-6, 1.0, 1e6, 1e200]))
    steps = rng.choice([1.0, 1.0, 1.0, 30.0], n)
    time = 0.01 * np.cumsum(steps)
    edges = np.sort(rng.choice(time, 16))  # between stamps, a window might hold no sample, which reading refuses
    labels = []
    for a, b, c, d in edges.reshape(4, 4).tolist():
        name = data.draw(st.sampled_from([None, "1", "4", "13"]))
        if a < b < c < d:
            labels.append(SequenceLabel((a, b), (c, d), name))
    smooth = np.cumsum(rng.standard_normal((2, n, 3)), axis=1) * size
    try:
        recording = Recording(
            time,
            np.round(smooth[0], data.draw(st.integers(0, 6))),
            smooth[1] + [0.0, 0.0, -9.8],
            SITE,
            fixture=data.draw(st.sampled_from([None, Fixture()])),
            kind=data.draw(st.sampled_from(["rate", "increment"])),
            sequences=tuple(labels),
        )
    except InputError:
        assume(False)
        return
    with np.errstate(all="ignore"):
        found = examine_stages(recording, ("timing", "channels", "units", "frames"))
        if size <= 1e6:
            found = (*found, *findings(recording))
    for finding in found:
        assert finding.sentence
        assert finding.fault in FAULTS
