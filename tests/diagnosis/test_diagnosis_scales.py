"""Units, kinds, counts, sample rates and axes: factors and signed permutations, named for what they are."""

from dataclasses import replace
from functools import partial

import injected_faults.units_and_axes  # noqa: F401 - registers its injections
import numpy as np
import pytest
from diagnosing import WithoutRecognition, case_of, examine_stages, findings_of_stage
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from injected_faults.injection import GRADES, INJECTIONS, Case
from scipy.spatial.transform import Rotation

from srt.constants import DEG
from srt.diagnosis import faults
from srt.diagnosis.axes import mapping, nearest_axes
from srt.diagnosis.evidence import Evidence
from srt.diagnosis.faults import sort_by_cause
from srt.diagnosis.staged_diagnosis import diagnose
from srt.recording.import_options import parse_axis_map
from srt.recording.recording import Recording, Site

SEED = 330_000
STAGES = ("units", "frames")


def examine(recording):
    """Findings of the stages tested here, the first cause first."""
    return examine_stages(recording, STAGES, calibrating=False)


FACTORS = [f.name for f in faults.STAGES["units"].faults[:8] if not f.name.endswith(("counts", "thinned"))]
case = partial(case_of, seed=SEED)


# --- factors ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("grade", GRADES)
def test_scales_are_those_of_the_unit(grade):
    """Scales of each axis are found within a few mrad of a rotation and 1e-3 of gravity."""
    simulation = case(grade).simulation
    evidence = WithoutRecognition(simulation.recording)
    truth = simulation.truth.as_dict()
    for sensor, scales in (("gyro", evidence.gyro_scales), ("accel", evidence.accel_scales)):
        expected = [1.0 + truth[f"{sensor}_scale_{axis}"] for axis in "xyz"]
        np.testing.assert_allclose(scales.axes, expected, atol=5e-3)


def test_both_wrong_units_are_found():
    recording = case("industrial-mems").recording
    found = examine(replace(recording, gyro=recording.gyro / DEG, accel=recording.accel / 9.80665))
    assert [finding.fault for finding in found] == ["gyro_degrees", "accel_g"]
    assert "57.3 times the expected ones (sequence 1)" in found[0].sentence
    # Biases of 2 mg and scale errors of 300 ppm (one sigma) leave the median rest within 1 %.
    assert found[1].details["found"] == pytest.approx(1.0, rel=0.01)
    assert "but 9.807 m/s² is expected: the readings look like g, declared as m/s²" in found[1].sentence


@pytest.mark.parametrize("rate_hz", [57.29578, 10.0])
def test_a_kind_is_told_from_units_of_the_same_factor(rate_hz):
    """Rates at 57.3 Hz taken for increments rotate as degrees taken for radians do; gravity distinguishes them."""
    unit = case("industrial-mems").changed(recording={"sample_rate_hz": rate_hz})
    (kind,) = examine(replace(unit.recording, kind="increment"))
    assert kind.fault == "rates_as_increments"
    gyros = examine(replace(unit.recording, gyro=unit.recording.gyro / DEG))
    assert [finding.fault for finding in gyros] == ["gyro_degrees"]


def test_whole_numbers_of_mg_are_mg():
    recording = case("industrial-mems").recording
    in_mg = np.round(recording.accel / 9.80665e-3)
    assert [finding.fault for finding in examine(replace(recording, accel=in_mg))] == ["accel_mg"]


@settings(max_examples=30, deadline=None)
@given(
    errors=st.lists(st.floats(-0.25, 0.25), min_size=6, max_size=6),
    fault=st.sampled_from(FACTORS),
)
def test_units_are_told_through_the_errors_of_an_uncalibrated_unit(errors, fault):
    """A quarter of scale error, different on every axis, does not hide which unit is wrong."""
    scaled = INJECTIONS[fault].recording(case("industrial-mems"))
    gyro, accel = 1.0 + np.array(errors[:3]), 1.0 + np.array(errors[3:])
    # Equal errors of all axes may make any factor a power of two, which is another fault: g times 1.25 is 1/8 of m/s².
    assume(min(np.std(np.log(gyro)), np.std(np.log(accel))) > 0.05)
    found = examine(replace(scaled, gyro=scaled.gyro * gyro, accel=scaled.accel * accel))
    assert found[0].fault == fault


@settings(max_examples=30, deadline=None)
@given(errors=st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6))
def test_an_uncalibrated_unit_is_never_refused(errors):
    """Scale errors of tens of per cent are what a calibration is for; at most their likeness is remarked on."""
    recording = case("industrial-mems").recording
    gyro, accel = 1.0 + np.array(errors[:3]), 1.0 + np.array(errors[3:])
    for finding in examine(replace(recording, gyro=recording.gyro * gyro, accel=recording.accel * accel)):
        assert finding.effect == "warning"


@pytest.mark.parametrize(("factor", "power"), [(0.125, 0.125), (0.5, 0.5), (2.0, 2.0), (16.0, 16.0)])
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_another_range_is_told_by_its_power_of_two(sensor, factor, power):
    recording = case("consumer-mems").recording
    (finding,) = examine(replace(recording, **{sensor: factor * getattr(recording, sensor)}))
    assert finding.fault == f"{sensor}_lsb"
    assert finding.details["power"] == power


def test_a_wrong_sample_rate_says_which_is_right():
    """Gyro scales are known to their errors: 500 ppm over √3 of the rate; four times that is 1.2e-3."""
    recording = case("industrial-mems").recording
    labels = tuple(
        replace(
            label,
            start_static_s=tuple(np.array(label.start_static_s) / 1.2),
            end_static_s=tuple(np.array(label.end_static_s) / 1.2),
        )
        for label in recording.sequences
    )
    (finding,) = examine(replace(recording, time=recording.time / 1.2, sequences=labels))
    assert finding.fault == "sample_rate"
    assert finding.details["stated"] == pytest.approx(120.0)
    assert finding.details["rate"] == pytest.approx(100.0, rel=1.2e-3)


def test_saturated_gyros_are_no_sample_rate():
    """Rates cut off at 0.986 of 1 rad/s: the Earth rate, measured by their scale factors, is off as by a clock."""
    recording = Case("navigation-rlg", 1).recording
    most = 0.986 * recording.nominal_interval_s
    assert "sample_rate" not in {f.fault for f in examine(replace(recording, gyro=recording.gyro.clip(-most, most)))}


# --- axes ------------------------------------------------------------------------------------------------------------


def axes_of(order, signs):
    return np.eye(3)[list(order)] * np.array(signs)[:, None]


signed_permutations = st.builds(
    axes_of, st.permutations(range(3)), st.lists(st.sampled_from([-1.0, 1.0]), min_size=3, max_size=3)
)


@given(axes=signed_permutations)
def test_a_mapping_undoes_the_axes(axes):
    np.testing.assert_array_equal(parse_axis_map(mapping(axes)) @ axes, np.eye(3))


@settings(max_examples=40, deadline=None)
@given(gyro=signed_permutations, accel=signed_permutations)
def test_all_wrong_axes_are_found_and_their_mappings_set_them_right(gyro, accel):
    sound = case("consumer-mems").recording
    found = examine(replace(sound, gyro=sound.gyro @ gyro.T, accel=sound.accel @ accel.T))
    if np.array_equal(gyro, np.eye(3)) and np.array_equal(accel, np.eye(3)):
        assert found == ()
        return
    (finding,) = found
    assert finding.cause in faults.STAGES["frames"].faults
    told = finding.details
    sensor = finding.fault.split("_")[0]
    both = told.get("mapping", "x,y,z")
    gyro_map = told.get("gyro_mapping", "x,y,z" if sensor == "accel" else both)
    accel_map = told.get("accel_mapping", "x,y,z" if sensor == "gyro" else both)
    np.testing.assert_array_equal(parse_axis_map(gyro_map) @ gyro, np.eye(3))
    np.testing.assert_array_equal(parse_axis_map(accel_map) @ accel, np.eye(3))


def test_wrong_labels_are_no_wrong_axes():
    """Every turn labelled the other way round is a matter of labels: gravity turns as the gyros say."""
    recording = case("industrial-mems").recording
    other = {"1": "1a", "2": "2a", "3": "3a", "1a": "1", "2a": "2", "3a": "3"}
    labels = tuple(replace(label, id=other[label.id]) for label in recording.sequences if label.id in other)
    assert examine(recording.with_sequences(labels)) == ()


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 3)), np.full((3, 3), np.nan), np.ones((3, 3)), np.diag([1.0, 1.0, 0.0])]
)
def test_matrix_far_from_a_signed_permutation_gives_none(matrix):
    assert nearest_axes(matrix) is None


def test_few_sequences_tell_nothing():
    recording = case("industrial-mems").recording
    first = recording.with_sequences(recording.sequences[:1])
    assert examine(replace(first, gyro=-first.gyro)) == ()
    assert WithoutRecognition(first).gravity_relation is None


# --- without labels --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fault",
    ["gyro_degrees", "accel_g", "gyro_counts", "gyro_lsb", "gyro_axis_flipped", "accel_axes_swapped", "frame_turned"],
)
def test_without_labels_recognition_takes_their_place(fault):
    unit = case("industrial-mems").changed(schedule={"moves": "recorded"})
    recording = INJECTIONS[fault].recording(unit).with_sequences(())
    evidence = Evidence(recording)
    found = [finding for stage in STAGES for finding in findings_of_stage(evidence, stage)]
    assert sort_by_cause(found)[0].fault == fault


def test_turns_shorter_than_two_blocks_show_no_limit():
    """Turns of 90° in 0.15 s, and a factor of the accelerometers, which saturation is compared with."""
    rng, rest, turn, at = np.random.default_rng(5), 400, 15, Rotation.identity()
    rate, force = [np.zeros((rest, 3))], [np.tile([0.0, 0.0, 9.8], (rest, 1))]
    senses = (1, 1, 1, -1, 1, 1, -1, 1, 1, 1, 1, 1)
    for axis, sense in zip((0, 1, 0, 1, 0, 1, 0, 2, 1, 0, 2, 1), senses, strict=True):
        step = sense * np.eye(3)[axis] * 0.5 * np.pi / turn
        attitudes = at * Rotation.from_rotvec(np.arange(1, turn + 1)[:, None] * step)
        at = attitudes[-1]
        rate += [np.tile(step / 0.01, (turn, 1)), np.zeros((rest, 3))]
        force += [attitudes.inv().apply([0.0, 0.0, 9.8]), np.tile(at.inv().apply([0.0, 0.0, 9.8]), (rest, 1))]
    gyro, accel = rng.normal(np.concatenate(rate), 2e-3), rng.normal(1.5 * np.concatenate(force), 2e-2)
    turned = Recording(0.01 * np.arange(1, len(gyro) + 1), gyro, accel, Site(9.8))
    assert diagnose(turned).first.fault == "accel_factor"
