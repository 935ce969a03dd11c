"""Stamps, channels and ranges: what a logger does to a recording, named; sound and odd recordings left alone."""

from dataclasses import replace
from functools import partial

import injected_faults.logger  # noqa: F401 - registers its injections
import numpy as np
import pytest
from diagnosing import WithoutRecognition, case_of, examine_stages, grades_and_faults
from hypothesis import given, settings
from hypothesis import strategies as st
from injected_faults.disturbances import tilt_step
from injected_faults.injection import GRADES, INJECTIONS, Case
from worse_recordings import unstated_unit

import srt
from sims.physics.imu import read_out
from srt.diagnosis import faults
from srt.diagnosis.channels import CHANNELS
from srt.exceptions import SrtError
from srt.recording.recording import Recording, SequenceLabel, Site

SEED = 320_000
STAGES = ("timing", "channels", "units", "frames")
ON_READING = tuple(fault.name for fault in faults.STAGES["file"].faults)


def examine(recording):
    """Findings of the stages tested here, the first cause first."""
    return examine_stages(recording, STAGES)


case = partial(case_of, seed=SEED)


@pytest.mark.parametrize("seed", range(5))
def test_vibration_in_flight_does_not_wrap(seed):
    """A level log that vibrates by 4 m/s²: readings jump between their extremes, and to a lesser extent everywhere."""
    rng, n = np.random.default_rng((SEED, seed)), 10_000
    force = rng.normal([0.0, 0.0, 9.8], 4.0, (n, 3))
    flight = Recording(0.01 * np.arange(n), rng.normal(0.0, 0.05, (n, 3)), force, Site(9.8))
    assert not [finding for finding in examine(flight) if finding.fault.endswith("wrapped")]


@grades_and_faults(ON_READING)
def test_error_of_a_refused_recording_names_the_fault(fault, grade):
    with pytest.raises(SrtError) as refused:
        INJECTIONS[fault].recording(case(grade))
    assert refused.value.fault == fault


# --- what the sentences say ------------------------------------------------------------------------------------------


def rows_of(label, recording):
    return recording.window_indices(*label.start_static_s).start, recording.window_indices(*label.end_static_s).stop


def test_a_gap_is_placed_and_measured():
    recording = case("industrial-mems").recording
    first, last = rows_of(recording.sequences[6], recording)
    cut = slice((first + last) // 2, (first + last) // 2 + 30)
    keep = np.ones(len(recording.time), dtype=bool)
    keep[cut] = False
    broken = replace(recording, time=recording.time[keep], gyro=recording.gyro[keep], accel=recording.accel[keep])
    (finding,) = examine(broken)
    assert finding.details["duration"] == pytest.approx(0.3, abs=1e-9)
    assert finding.details["time"] == pytest.approx(recording.time[cut.stop], abs=1e-9)
    assert finding.sentence.startswith("Sequence 4: samples are missing for 0.3 s before")
    assert "warning" in finding.effect


def test_gaps_between_sequences_are_no_fault():
    recording = case("industrial-mems").recording
    assert recording.gaps.size == 16
    assert examine(recording) == ()


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (
            1e3,
            "10 s apart, but 5e-06 to 0.5 s is expected: the time stamps look like milliseconds, declared as seconds; "
            "correct time_unit (key of recording.toml, or argument)",
        ),
        (1e6, "look like microseconds, declared as seconds"),
        (
            1e-3,
            "1e-05 s apart, and rotation angles are 0.001 times the expected value: the time stamps look like seconds",
        ),
        (1e-6, "look like seconds, declared as microseconds"),
    ],
)
def test_a_time_unit_is_told_by_its_factor(factor, said):
    recording = case("industrial-mems").recording
    labels = tuple(
        SequenceLabel(
            tuple(factor * np.array(label.start_static_s)), tuple(factor * np.array(label.end_static_s)), label.id
        )
        for label in recording.sequences
    )
    (finding,) = examine(replace(recording, time=factor * recording.time, sequences=labels))
    assert said in finding.sentence


def test_jitter_is_measured():
    recording = case("tactical-fog").recording
    # Uniform over ±0.2 intervals: one sigma is 0.4/√12 = 0.115, known to 1/√(2·46000) = 0.3 %.
    late = np.random.default_rng(4).uniform(-0.2, 0.2, len(recording.time))
    (finding,) = examine(replace(recording, time=recording.time + 0.01 * late))
    assert finding.fault == "stamp_jitter"
    assert finding.details["jitter"] == pytest.approx(0.4 / np.sqrt(12.0), rel=0.03)


def test_stamps_in_bursts_are_jitter_and_no_gaps():
    recording = case("industrial-mems").recording
    n = len(recording.time)
    burst = 0.1 * np.ceil(np.arange(1, n + 1) / 10) + 0.001 * (np.arange(n) % 10)
    (finding,) = examine(replace(recording, time=burst, sequences=()))
    assert finding.fault == "stamp_jitter"
    # Nine steps of 1 ms and one of 91 ms: one sample in 10 ms.
    assert finding.details["interval"] == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize("channel", [0, 2, 4])
def test_a_dead_column_is_named_with_its_value(channel):
    recording = case("consumer-mems").recording
    columns = np.hstack([recording.gyro, recording.accel])
    columns[:, channel] = 0.25
    finding = examine(replace(recording, gyro=columns[:, :3], accel=columns[:, 3:]))[0]
    assert finding.details["channel"] == CHANNELS[channel]
    assert finding.details["value"] == 0.25


def test_a_column_named_twice_is_seen_through_another_unit():
    recording = case("tactical-fog").recording
    gyro = recording.gyro.copy()
    gyro[:, 1] = np.radians(recording.accel[:, 2])
    finding = examine(replace(recording, gyro=gyro))[0]
    assert (finding.details["channel"], finding.details["other"]) == ("gyro_y", "accel_z")


@pytest.mark.parametrize(
    ("sensors", "fault"), [("gyro accel", "samples_stuck"), ("gyro", "gyro_stuck"), ("accel", "accel_stuck")]
)
def test_a_run_of_repeats_is_placed_and_counted(sensors, fault):
    recording = case("industrial-mems").recording
    first, _ = rows_of(recording.sequences[3], recording)
    held = slice(first + 700, first + 740)
    for sensor in sensors.split():
        values = getattr(recording, sensor).copy()
        values[held] = values[held.start - 1]
        recording = replace(recording, **{sensor: values})
    (finding,) = examine(recording)
    assert finding.fault == fault
    assert finding.details["count"] == 41  # the reading that is held, and forty that hold it
    assert finding.details["time"] == pytest.approx(recording.time[held.start - 1])
    assert finding.details["sequence"] == "sequence 1a"


def test_a_spike_is_placed_and_counted():
    recording = case("navigation-rlg").recording
    first, _ = rows_of(recording.sequences[7], recording)
    accel = recording.accel.copy()
    accel[[first + 300, first + 700], 1] += [0.02, -0.05]
    (finding,) = examine(replace(recording, accel=accel))
    assert finding.details["channel"] == "accel_y"
    assert finding.details["count"] == 2
    assert finding.details["time"] == pytest.approx(recording.time[first + 700])
    assert "5 m/s²" in finding.sentence  # 0.05 m/s in 0.01 s, known to a sample's noise: 5 µg/√Hz is 5e-4 m/s²
    assert finding.sentence.endswith("repeat sequence 5.")
    # Accelerometer readings of rotations enter no result; what they say of lost samples is not used.
    accel = recording.accel.copy()
    accel[first + 1200, 1] -= 0.5
    assert examine(replace(recording, accel=accel)) == ()


@pytest.mark.parametrize("count", [50, 500])
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_many_spikes_are_no_quantization_steps(sensor, count):
    unit, _ = unstated_unit(0, "fixture", "industrial")
    rest = np.concatenate([np.arange(*rows_of(label, unit)) for label in unit.sequences])
    at = np.random.default_rng(59).choice(rest, count, replace=False)
    values = getattr(unit, sensor).copy()
    values[at, 1] += 10.0
    findings = srt.diagnose(replace(unit, **{sensor: values}), calibrating=False).findings
    assert findings[0].fault == "spikes"
    assert findings[0].details["count"] > 0.5 * count  # neighbouring spikes hide each other


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_spikes_of_one_size_in_each_twentieth_reading_are_no_quantization_steps(sensor):
    """In a quarter of a window, more than a tenth of the differences can contain one."""
    unit, _ = unstated_unit(0, "fixture", "industrial")
    windows = [unit.window_indices(*span) for s in unit.sequences for span in (s.start_static_s, s.end_static_s)]
    rest = np.concatenate([np.arange(w.start, w.stop) for w in windows])
    rng, values = np.random.default_rng(60), getattr(unit, sensor).copy()
    at, sigma = rng.choice(rest, len(rest) // 20, replace=False), np.std(np.diff(values[:100, 1])) / np.sqrt(2.0)
    values[at, 1] += 100.0 * sigma * rng.choice([-1.0, 1.0], len(at))
    assert srt.diagnose(replace(unit, **{sensor: values}), calibrating=False).findings[0].fault == "spikes"


@pytest.mark.parametrize("readings", [2, 5])
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_a_burst_at_rest_is_placed_with_its_length(sensor, readings):
    unit, _ = unstated_unit(0, "fixture", "industrial")
    first, last = rows_of(unit.sequences[3], unit)
    at = first + (last - first) // 10
    values = getattr(unit, sensor).copy()
    values[at : at + readings, 2] += 100.0 * np.std(np.diff(values[first : first + 100, 2]))
    finding = srt.diagnose(replace(unit, **{sensor: values}), calibrating=False).findings[0]
    assert finding.fault == "spikes"
    assert finding.details["count"] == readings
    assert finding.details["time"] == pytest.approx(unit.time[at])
    assert f"for {readings} samples" in finding.sentence


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_knock_that_turns_the_unit_is_no_spike(grade, axis):
    """A slip within one sample is a single reading in the gyros, too: gravity, or the other gyros, tell it."""
    simulation = case(grade).simulation
    vector = np.full(3, 1e-3)
    vector[axis] = 8e-3
    slipped = tilt_step(simulation.motion, simulation.windows[7][0][0] + 5.0, vector)
    recording = read_out(
        slipped, simulation.truth, simulation.imu, np.random.default_rng(1), kind=case(grade).recording.kind
    )
    assert examine(recording) == ()


def test_clipping_is_seen_without_a_stated_range_where_readings_are_noisy():
    simulation = case("industrial-mems").simulation
    limited = replace(simulation.imu, gyro_range=0.8)
    recording = read_out(simulation.motion, simulation.truth, limited, np.random.default_rng(1))
    finding = examine(replace(recording, noise=replace(recording.noise, gyro_range=None)))[0]
    assert finding.fault == "gyro_clipped"
    assert finding.details["limit"] == pytest.approx(0.8)


def test_readings_beyond_the_stated_range_are_not_clipped():
    recording = case("industrial-mems").recording
    assert examine(replace(recording, noise=replace(recording.noise, gyro_range=0.5))) == ()


# --- silence ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sequences", [["1"], ["7"], ["9", "9", "9", "9"], ["2", "3", "13"]])
@pytest.mark.parametrize("site", ["latitude-45", "still-earth", "arctic"])
def test_readings_without_noise_are_sound(sequences, site):
    """Repeated rows, constant or proportional columns and repeated extremes of noise-free readings are no faults."""
    faultless = Case("navigation-rlg", SEED).changed(
        imu={"from": "perfect"},
        fixture={"from": "perfect"},
        site={"from": site},
        schedule={"sequences": sequences, "dwell_s": 4.0},
        recording={"kind": "rate"},
    )
    assert examine(faultless.recording) == ()


@pytest.mark.parametrize("rate_hz", [20.0, 50.0])
def test_pulses_repeat_by_nature(rate_hz):
    """Pulses are few at rest and even in a rotation: readings repeat in all windows and rotations, without a fault."""
    assert examine(case("navigation-rlg").changed(recording={"sample_rate_hz": rate_hz}).recording) == ()


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.floats(40.0, 1e4), channel=st.integers(0, 5))
def test_a_spike_is_found_where_it_is(seed, size, channel):
    """Forty sigmas are found whatever channel and sample: a third is more than the slopes of the neighbours differ by.

    The largest difference of the slopes has some 2.8 sigmas of the noise; the deviation is found from 7.5 times 1.39.
    """
    recording = case("tactical-fog").recording
    rng = np.random.default_rng(seed)
    first, _ = rows_of(recording.sequences[0], recording)
    row = first + int(rng.integers(10, 900))
    columns = np.hstack([recording.gyro, recording.accel])
    sigma = np.std(np.diff(columns[first : first + 900, channel])) / np.sqrt(2.0)
    columns[row, channel] += size * sigma
    found = WithoutRecognition(replace(recording, gyro=columns[:, :3], accel=columns[:, 3:])).spikes
    assert (found.sample.tolist(), found.channel.tolist()) == ([row], [channel])
