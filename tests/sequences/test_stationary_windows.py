"""Stationary windows, and their matching to a protocol."""

from dataclasses import replace
from functools import cache

import accuracy_trials
import numpy as np
import pytest

import sims
import srt
from sims.physics.free_motion import free_motion, random_attitude, random_turns
from sims.physics.imu import ImuModel, read_out
from sims.physics.table_motion import table1_motion
from sims.scenarios.scenario import scenario_from_dict
from srt.constants import DEG, DEG_PER_SQRT_H, MICRO_G
from srt.exceptions import DataError, InputError
from srt.recording.protocol import load_protocol, protocol_names
from srt.sensor_errors import SensorErrors
from srt.sequences.protocol_matching import protocol_labels
from srt.sequences.stationary_windows import find_turns, find_windows
from srt.sequences.window_means import average_windows

G = 9.80665

UNITS = {
    "noise-free": ImuModel(),
    "navigation": accuracy_trials.GRADES["navigation"],
    "consumer": ImuModel(gyro_noise=0.6 * DEG_PER_SQRT_H, accel_noise=300.0 * MICRO_G),
    "coarse": ImuModel(gyro_noise=0.3 * DEG_PER_SQRT_H, accel_noise=100.0 * MICRO_G, gyro_resolution=1e-3),
}
BIASED = SensorErrors.from_dict({"gyro_bias_x": 1.0 * DEG, "gyro_bias_y": -0.7 * DEG, "gyro_scale_z": 0.3})


def overlap(found, true):
    return max(0.0, min(found[1], true[1]) - max(found[0], true[0])) / (true[1] - true[0])


@pytest.mark.parametrize("peak", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("name", list(UNITS))
def test_free_turns_are_found(name, peak):
    rng = np.random.default_rng(17)
    motion = free_motion(
        random_turns(rng, 12, smallest_rad=0.8, largest_rad=2.0),
        site=accuracy_trials.SITE,
        attitude=random_attitude(rng),
        peak_rate_rad_s=peak,
        dwell_s=4.0,
        sample_rate_hz=100.0,
    )
    recording = read_out(motion, BIASED, UNITS[name], rng)
    turns = find_turns(recording)
    assert len(turns) == len(motion.windows)
    for turn, (before, after) in zip(turns, motion.windows, strict=True):
        # The windows found lie inside rest, but for slow onsets that no sensor of the grade could tell from rest.
        assert overlap(turn.start_static_s, before) > 0.7
        assert overlap(turn.end_static_s, after) > 0.7


@pytest.mark.parametrize("seed", [70002, 70003, 70004])
def test_drift_within_the_stated_bias_instability_ends_no_window(seed):
    """Fibre-optic unit at 50 Hz, accelerometers of 50 µg instability: a window of 10 s was cut to 8.2 s."""
    Case = pytest.importorskip("injected_faults.injection", exc_type=ImportError).Case
    recording = Case("tactical-fog", seed, {"recording": {"sample_rate_hz": 50.0}}).recording.with_sequences(())
    assert (np.diff(find_windows(recording)).min() / 50.0) > 9.9


def test_windows_of_the_seventeen_sequences():
    motion = table1_motion(site=accuracy_trials.SITE, sample_rate_hz=100.0, dwell_s=5.0)
    recording = read_out(motion, BIASED, UNITS["navigation"], np.random.default_rng(3)).with_sequences(())
    windows = find_windows(recording)
    true = [w for pair in motion.windows for w in pair]
    assert len(windows) == len(true)
    found = [(recording.time[a], recording.time[b - 1]) for a, b in windows]
    assert min(overlap(f, t) for f, t in zip(found, true, strict=True)) > 0.9


def test_a_recording_without_turns_is_refused():
    rng = np.random.default_rng(4)
    n = 4000
    still = srt.Recording(
        np.arange(1, n + 1) * 0.01,
        1e-3 * rng.standard_normal((n, 3)),
        np.array([0.0, 0.0, -9.8]) + 1e-2 * rng.standard_normal((n, 3)),
        accuracy_trials.SITE,
    )
    with pytest.raises(srt.DataError, match=r"rests in one attitude for 40 s"):
        srt.calibrate(still)


def test_a_recording_without_rest_is_refused():
    n = 4000
    t = np.arange(1, n + 1) * 0.01
    gyro = np.stack([np.sin(2.1 * t), np.cos(1.7 * t), np.sin(1.3 * t + 1.0)], axis=1)
    accel = 9.8 * np.stack([np.sin(t), np.cos(t), 0.0 * t], axis=1)
    with pytest.raises(srt.DataError):
        srt.calibrate(srt.Recording(t, gyro, accel, accuracy_trials.SITE))


def test_a_bump_between_two_rests_in_one_pose_makes_no_turn():
    rng = np.random.default_rng(8)
    turns = np.array([[1.2, 0.0, 0.0], [0.004, 0.0, 0.0], [0.0, 1.3, 0.0]])
    motion = free_motion(turns, site=accuracy_trials.SITE, dwell_s=4.0, peak_rate_rad_s=0.5, sample_rate_hz=100.0)
    recording = read_out(motion, SensorErrors(), UNITS["navigation"], rng)
    assert len(find_turns(recording)) == 2


def test_a_recording_of_one_block_has_no_windows():
    """Ten samples make one block, between whose activities there is no valley."""
    rng = np.random.default_rng(5)
    short = srt.Recording(
        0.01 * np.arange(10), rng.normal(0.0, 1e-3, (10, 3)), rng.normal(0.0, 1e-2, (10, 3)) + G, srt.Site(G)
    )
    with pytest.raises(srt.DataError, match="No stationary window of at least"):
        find_windows(short)


def test_gaps_that_leave_no_window_are_named():
    rng = np.random.default_rng(6)
    time = 0.01 * np.arange(4000)
    kept = np.arange(4000) % 50 < 45
    rest = srt.Recording(
        time[kept], rng.normal(0.0, 1e-3, (kept.sum(), 3)), rng.normal(0.0, 1e-2, (kept.sum(), 3)) + G, srt.Site(G)
    )
    with pytest.raises(srt.DataError, match="A gap ends a window, and the recording has 79"):
        find_windows(rest)


ON_FIXTURE = ("six-face-tumble", "ferraris", "table-1", "two-axis-table")
SETTLE_S = 0.2


@cache
def simulated(name: str, grade: str = "tactical-fog", *, fixture: bool = False) -> sims.Simulation:
    tables = {
        "seed": 3,
        "imu": {"from": grade},
        "site": {"from": "latitude-45"},
        "protocol": {"from": name, "settle_s": SETTLE_S},
        "recording": {"sample_rate_hz": 100.0},
    }
    return sims.simulate(scenario_from_dict(tables | ({"fixture": {"from": "lab-1mrad"}} if fixture else {})))


def unlabelled(name: str, of: str | None = None, **how) -> srt.Recording:
    """Recording of one protocol that states another, or its own."""
    return replace(simulated(name, **how).recording, sequences=(), protocol=load_protocol(of or name))


def content(label):
    return label.pose, label.id, label.down, label.along_outer, len(label.rotations), label.rate


@pytest.mark.parametrize("grade", [pytest.param("tactical-fog", marks=pytest.mark.slow), "consumer-mems"])
@pytest.mark.parametrize(
    ("name", "fixture"), [*((n, False) for n in protocol_names()), *((n, True) for n in ON_FIXTURE)]
)
def test_labels_are_those_of_the_simulator(name, fixture, grade):
    recording = unlabelled(name, grade=grade, fixture=fixture)
    assert recording.protocol is not None
    found, true = protocol_labels(recording, recording.protocol), simulated(name, grade, fixture=fixture).recording
    assert [content(label) for label in found] == [content(label) for label in true.sequences]
    for label, expected in zip(found, true.sequences, strict=True):
        # Rest begins when the settling does; the last moment of a turn may be too slow to see.
        for window in ("start_static_s", "end_static_s"):
            assert getattr(label, window) == pytest.approx(getattr(expected, window), abs=SETTLE_S + 0.3)
        if label.steady_s is not None:
            assert expected.steady_s[0] <= label.steady_s[0] < label.steady_s[1] <= expected.steady_s[1]


@pytest.mark.parametrize("name", ["rate-table", "7-positions"])
def test_a_protocol_without_attitudes_labels_a_recording_that_states_a_fixture(name):
    """The attitudes on the fixture are not known then, and are not used."""
    recording = replace(unlabelled(name, grade="consumer-mems"), fixture=srt.Fixture(0.0))
    assert recording.protocol is not None
    found, true = protocol_labels(recording, recording.protocol), simulated(name, "consumer-mems").recording
    assert [content(label) for label in found] == [content(label) for label in true.sequences]


@pytest.mark.parametrize(
    ("name", "of", "said"),
    [
        ("7-positions", "11-positions", r"step 3 .*from [\d.]+ to [\d.]+ s the gyros turn by|step \d+ .*"),
        ("six-face-tumble", "24-face-tumble", "step 2 .*no rest after"),
        ("9-positions", "two-axis-table", r"step 2 .*turn \+540° about y.*gyros turn by"),
        ("24-face-tumble", "19-positions", "step 2 .*interrupted"),
    ],
)
def test_a_motion_that_contradicts_its_protocol_names_the_step(name, of, said):
    recording = unlabelled(name, of)
    with pytest.raises(DataError, match=f"The motion contradicts {said}") as refused:
        srt.calibrate(recording)
    assert "\n" not in str(refused.value)


def test_a_recording_that_ends_early_names_the_step_that_is_missing():
    whole = unlabelled("19-positions")
    half = whole.time < 0.5 * whole.time[-1]
    recording = replace(whole, time=whole.time[half], gyro=whole.gyro[half], accel=whole.accel[half])
    with pytest.raises(DataError, match=r"step \d+ .*the recording ends after the rest"):
        srt.calibrate(recording)


def test_a_protocol_that_the_fixture_cannot_run_is_refused():
    with pytest.raises(InputError, match=r"Step 1 .*cannot run on a two-axis fixture"):
        simulated("rate-table", fixture=True)


def test_the_folder_keeps_the_protocol_and_the_labels(tmp_path):
    for name in ("rate-table", "six-face-tumble"):
        folder = tmp_path / name
        true = simulated(name).recording
        srt.write_recording(true, folder, samples_format="npz")
        read = srt.load_recording(folder).sequences
        assert [content(label) for label in read] == [content(label) for label in true.sequences]
        for label, written in zip(read, true.sequences, strict=True):
            assert label.start_static_s == pytest.approx(written.start_static_s, rel=1e-12)
            assert label.steady_s == written.steady_s
        srt.write_recording(unlabelled(name), folder, samples_format="npz", overwrite=True)
        again = srt.load_recording(folder)
        assert again.protocol is not None
        assert again.protocol.name == name
        assert not again.sequences


@pytest.mark.parametrize("kind", ["rate", "increment"])
@pytest.mark.parametrize("steps", [[0.1, 0.083, 0.117, 0.091, 0.109, 0.128], [0.1, 0.1, 0.1, 0.1]])
def test_mean_of_a_window_weights_samples_by_their_duration(kind, steps):
    """By hand: the angle of the samples after the first over their time, where the halves differ in length and rate."""
    dt, rate = np.array(steps), np.arange(1.0, 1.0 + len(steps)) ** 2
    readings = (rate if kind == "rate" else rate * dt)[:, None] * [1.0, 0.0, -2.0]
    recording = srt.Recording(time=np.cumsum(dt), gyro=readings, accel=readings, site=srt.Site(G), kind=kind)
    (found,) = average_windows([recording], [np.array([[1, len(dt)]])], "linear")
    mean = float(rate[1:] @ dt[1:]) / float(dt[1:].sum())
    for average in (found.gyro_mean, found.accel_mean):
        np.testing.assert_allclose(average, [[mean, 0.0, -2.0 * mean]], rtol=1e-12)
