"""Recognition of turns, of manoeuvres and of the moves between them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from injected_faults.injection import GRADES, Case
from scipy.spatial.transform import Rotation
from studies import nees_of

import srt
from srt.exceptions import InputError
from srt.model.table1 import AXES, SEQUENCES
from srt.recording.recording import Fixture, Recording, SequenceLabel
from srt.sensor_errors import GROUP_SLICES, NAMES
from srt.sequences.manoeuvres import face_vector, leg_borders, quarter_turn
from srt.sequences.moves import recorded_moves
from srt.sequences.recognition import label_sequences, leave_out, recognise
from srt.sequences.stationary_windows import MIN_TURN_RAD


@cache
def standard():
    return unlabelled()


def unlabelled(grade="tactical-fog", seed=5, **sections):
    return Case(grade, seed).changed(**sections).recording.with_sequences(())


LARGE = {
    "gyro_scale": 0.3, "gyro_orthogonality": 0.1, "accel_bias": 0.5, "accel_scale": 0.3, "accel_misalignment": 0.1,
    "gyro_bias": np.deg2rad(1.0),
}  # fmt: skip
"""Largest sensor errors before calibration, SI."""


def random_order(rng):
    """All sequences of Table 1 in random order, and up to three of them once more at the end."""
    ids = np.array(list(SEQUENCES))
    again = rng.choice(ids, int(rng.integers(0, 4)))
    return tuple(str(name) for name in np.concatenate([rng.permutation(ids), again]))


def hard_test(seed):
    """Recording of a unit with errors up to 30 % and 1 °/s, at 0.1-2 rad/s, with random dwells and stops, and its ids.

    Moves between sequences are recorded, or omitted with or without a gap in the time stamps.
    """
    rng = np.random.default_rng(seed)
    order = random_order(rng)
    schedule = {
        "sequences": list(order),
        "rate_rad_s": float(np.exp(rng.uniform(np.log(0.1), np.log(2.0)))),
        "dwell_s": float(rng.uniform(5.0, 15.0)),
        "leg_dwell_s": float(rng.choice([0.0, 0.0, 0.5, 2.0])),
        "moves": str(rng.choice(["recorded", "skipped"])),
    }
    bound = np.zeros(len(NAMES))
    for group, size in LARGE.items():
        bound[GROUP_SLICES[group]] = size
    values = dict(zip(NAMES, (rng.uniform(-1.0, 1.0, len(NAMES)) * bound).tolist(), strict=True))
    errors, imu = {"draw": "none", "values": values}, {"frame_turn_sigma_mrad": 0.0}
    case = Case(GRADES[seed % len(GRADES)], seed, {"schedule": schedule, "errors": errors, "imu": imu})
    joined = schedule["moves"] == "skipped" and bool(rng.integers(2))
    return (end_to_end(case.recording) if joined else case.recording), order


def fair_test(seed, grade, *, noise=True):
    """Recording labelled by exactly its stationary windows, of a unit with the modelled noise only, and its errors.

    That is random walks and quantization; bias instability and g-sensitivity are zero. Even seeds have recorded moves;
    odd ones are joined end to end.
    """
    rng = np.random.default_rng(seed)
    order, joined = random_order(rng), bool(seed % 2)
    quiet = ("gyro_g_sensitivity_deg_per_h_per_g", "gyro_bias_instability_deg_per_h", "accel_bias_instability_ug")
    changes = {
        "imu": {"from": grade, "noise": dict.fromkeys(quiet, 0.0)},
        "schedule": {
            "sequences": list(order),
            "rate_rad_s": float(rng.uniform(0.3, 2.0)),
            "settle_s": 0.0,
            "pause_s": 0.0,
            "moves": "skipped" if joined else "recorded",
        },
        "recording": {"noise": noise},
    }
    if not noise:
        changes["fixture"] = {"from": "perfect"}
    case = Case(grade, seed, changes)
    return (end_to_end(case.recording) if joined else case.recording), case.simulation.truth


def end_to_end(recording):
    """Recording without gaps: evenly spaced time stamps, labels moved with their samples."""
    dt = recording.nominal_interval_s

    def moved(window):
        samples = recording.window_indices(*window)
        return samples.start * dt, samples.stop * dt

    labels = tuple(
        replace(label, start_static_s=moved(label.start_static_s), end_static_s=moved(label.end_static_s))
        for label in recording.sequences
    )
    return replace(recording, time=np.arange(1.0, len(recording.time) + 1) * dt, sequences=labels)


def label_effect(recording, truth):
    """Unlabelled minus labelled calibration, the sigma of the labelled one, SI, and the NEES of the other over 27."""
    labelled = srt.calibrate(recording, checks=False)
    found = srt.calibrate(recording.with_sequences(()), checks=False)
    nees = nees_of(found.errors.vector - truth.vector, found.covariance) / len(NAMES)
    return found.errors.vector - labelled.errors.vector, labelled.sigma, nees


@pytest.mark.parametrize(
    "seed",
    [
        *range(3),
        *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 16)),
        *(pytest.param(k, marks=pytest.mark.campaign) for k in range(1000, 1300)),
    ],
)
def test_any_order_with_repeats_moves_and_joins_of_units_off_by_30_percent(seed):
    recording, order = hard_test(seed)
    found = recognise(recording.with_sequences(()))
    assert found.ids == order, found.summary
    assert min(found.confidence) > 0.5
    for label, true in zip(found.labels, recording.sequences, strict=True):
        for mine, given_ in ((label.start_static_s, true.start_static_s), (label.end_static_s, true.end_static_s)):
            overlap = min(mine[1], given_[1]) - max(mine[0], given_[0])
            assert overlap > 0.5 * (given_[1] - given_[0])


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_free_labels_change_nothing(seed):
    difference, _, _ = label_effect(*fair_test(seed, "tactical-fog", noise=False))
    assert np.max(np.abs(difference)) < 1e-9


@pytest.mark.parametrize(
    "seeds", [range(100, 102), pytest.param(range(2000, 2200), marks=pytest.mark.campaign)], ids=len
)
@pytest.mark.parametrize("grade", GRADES)
def test_labels_hardly_matter(grade, seeds):
    pairs = [label_effect(*fair_test(seed, grade)) for seed in seeds]
    scaled = np.array([difference / sigma for difference, sigma, _ in pairs])
    assert np.sqrt(np.mean(scaled**2)) <= 0.25
    assert np.abs(scaled).max() <= 1.0
    # Each NEES is chi-square with 27 degrees of freedom over 27, of variance 2/27; 3.5 standard errors of the mean.
    assert abs(np.mean([nees for *_, nees in pairs]) - 1.0) < 3.5 * np.sqrt(2.0 / 27.0 / len(pairs))


def test_the_result_says_what_was_recognised():
    calibration = srt.calibrate(unlabelled())
    told = calibration.diagnostics.recognition
    assert calibration.estimator == "closed-form"
    assert [row.sequence for row in told.sequences] == list(SEQUENCES)
    assert "17 sequences of Table 1 recognised" in told.summary


def test_missing_and_repeated_sequences_are_named():
    order = [name for name in SEQUENCES if name != "8"] + ["1", "1"]
    found = recognise(unlabelled(schedule={"sequences": order}))
    assert found.missing == ("8",)
    assert found.repeated == ("1",)
    assert "1 more than once" in found.summary
    assert "8 missing" in found.summary


def test_labels_given_are_kept():
    recording = Case("tactical-fog", 5).recording
    labelled, found = label_sequences(recording)
    assert labelled is recording
    assert found is None


def test_a_recording_without_a_fixture_is_not_labelled():
    recording = replace(unlabelled(), fixture=None)
    same, found = label_sequences(recording)
    assert same is recording
    assert found is None
    assert srt.calibrate(recording).estimator == "least-squares"


def test_a_free_recording_holds_none():
    from sims.physics.free_motion import free_motion, random_attitude, random_turns
    from sims.physics.imu import ImuModel, read_out

    rng = np.random.default_rng(12)
    turns = random_turns(rng, 20, smallest_rad=0.8, largest_rad=2.5)
    motion = free_motion(turns, site=Case("tactical-fog", 1).recording.site, attitude=random_attitude(rng))
    recording = read_out(motion, srt.SensorErrors(), ImuModel(gyro_noise=1e-4, accel_noise=1e-3), rng)
    found = recognise(recording.with_sequences(()))
    assert found.labels == ()
    assert len(found.turns) == 20
    assert "none is a sequence" in found.summary


def test_a_sequence_turned_the_other_way_is_said_to_be():
    from sims.physics.sequences import TABLE_1, table_sequences
    from sims.physics.table_motion import Schedule, run_schedule

    recording = Case("tactical-fog", 5).recording
    reversed_8 = replace(table_sequences(("8",))[0], rotations=(("x", -180.0),), id="8-reversed", in_table_1=False)
    order = [reversed_8 if name == "8" else table_sequences((name,))[0] for name in TABLE_1]
    motion = run_schedule(Schedule(tuple(order)), site=recording.site, sample_rate_hz=100.0)
    from sims.physics.imu import ImuModel, read_out

    noisy = read_out(motion, srt.SensorErrors(), ImuModel(gyro_noise=1e-5, accel_noise=1e-4), np.random.default_rng(1))
    found = recognise(noisy.with_sequences(()))
    assert found.missing == ("8",)
    assert [turn.reason for turn in found.turns if turn.sequence is None] == ["it is sequence 8 turned the other way"]


SIGNED = [np.diag(s)[list(p)] for p in ((0, 1, 2), (1, 0, 2), (2, 0, 1)) for s in ((1.0, 1.0, 1.0), (-1.0, 1.0, 1.0))]


@pytest.mark.parametrize(
    ("wrong", "signs"),
    [
        pytest.param(wrong, signs, marks=[pytest.mark.slow] * ((i + k) % 2))
        for i, wrong in enumerate(SIGNED[1:])
        for k, signs in enumerate([(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (-1.0, 1.0)])
    ],
    ids=str,
)
def test_misnamed_axes_are_found(wrong, signs):
    # Gyros and accelerometers read so, times a sign; 0: read rightly. (-1, 1) is turns counted by the other hand.
    recording = standard()
    right = [sign * wrong.T if sign else np.eye(3) for sign in signs]
    gyro, accel = recording.gyro @ right[0], recording.accel @ right[1]
    found = recognise(replace(recording, gyro=gyro, accel=accel))
    assert len(found.labels) == 17
    np.testing.assert_array_equal(found.mapping[0], right[0])
    np.testing.assert_array_equal(found.mapping[1], right[1])
    with pytest.raises(srt.DataError, match=r"only if the .* axes are read as"):
        srt.calibrate(replace(recording, gyro=gyro, accel=accel), checks=False)


@settings(max_examples=30)
@given(st.integers(0, 2), st.integers(-4, 4), st.sampled_from([(a, s) for a in range(3) for s in (1, -1)]))
def test_quarter_turns_agree_with_rotations(axis, count, face):
    vector = np.zeros(3)
    vector[axis] = 0.5 * np.pi * count
    matrix = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(quarter_turn(axis, count), matrix, atol=1e-15)
    np.testing.assert_allclose(
        quarter_turn(axis, count).T @ face_vector(face), matrix.T @ face_vector(face), atol=1e-15
    )
    assert AXES[axis] in "xyz"


def marks(*runs):
    """Marks from (mark, samples) pairs."""
    return np.repeat([mark for mark, _ in runs], [samples for _, samples in runs])


@pytest.mark.parametrize(
    ("runs", "by_stops", "through_stops"),
    [
        # One rotation between two stops: all samples are its own.
        ([(-1, 10), (0, 50), (-1, 10)], [0, 70], [0, 70]),
        # Two axes without a pause: the border is the change.
        ([(0, 40), (1, 60)], [0, 40, 100], [0, 40, 100]),
        # Two axes with a pause of 20 samples: its middle.
        ([(0, 40), (-1, 20), (1, 60)], [0, 50, 120], [0, 50, 120]),
        # A stop within a rotation about one axis: two rotations, or one.
        ([(2, 40), (-1, 20), (2, 60)], [0, 50, 120], [0, 120]),
        # A transient of 1 % between two axes belongs half to either; within one axis it is ignored or divides.
        ([(0, 98), (2, 2), (1, 100)], [0, 99, 200], [0, 99, 200]),
        ([(0, 98), (2, 2), (0, 100)], [0, 99, 200], [0, 200]),
        # Nothing rotates.
        ([(-1, 30)], [0, 30], [0, 30]),
    ],
)
def test_borders_of_legs(runs, by_stops, through_stops):
    assert leg_borders(marks(*runs), through_stops=False).tolist() == by_stops
    assert leg_borders(marks(*runs), through_stops=True).tolist() == through_stops


DT = 0.01
BIAS = np.array([0.2, -0.3, 0.1])
"""Rad/s: over the 10 s of a move, more than any turn."""


def readings(turn_rad: float, kind: str = "rate") -> Recording:
    """Two sequences of 1 s of rest, 1 s of rotation and 1 s of rest; 10 s between them, in which the unit turns."""
    time = DT * np.arange(1, 1601)
    gyro = np.tile(BIAS, (1600, 1))
    gyro[(time > 1.0) & (time <= 2.0), 2] += 1.0
    gyro[(time > 14.0) & (time <= 15.0), 2] += 1.0
    gyro[(time > 3.5) & (time <= 12.5), 0] += turn_rad / 9.0
    accel = np.tile([0.0, 0.0, -9.8], (1600, 1))
    if kind == "increment":
        gyro, accel = gyro * DT, accel * DT
    labels = (SequenceLabel((0.0, 1.0), (2.0, 3.0), id="1"), SequenceLabel((13.0, 14.0), (15.0, 16.0), id="2"))
    return srt.Recording(time, gyro, accel, srt.Site(9.8), kind=kind, sequences=labels, fixture=Fixture(1e-3))


def moves_of(recording: Recording, *labels: SequenceLabel) -> int:
    return len(recorded_moves(recording, labels or recording.sequences))


@pytest.mark.parametrize("kind", ["rate", "increment"])
@pytest.mark.parametrize(("turn", "count"), [(0.0, 0), (0.9 * MIN_TURN_RAD, 0), (1.1 * MIN_TURN_RAD, 1), (-1.5, 1)])
def test_a_move_is_a_turn_whatever_the_bias(kind, turn, count):
    assert moves_of(readings(turn, kind)) == count


def test_a_bias_that_drifts_is_no_move():
    """The mean of both ends is taken off: with one end alone this ramp would be a turn of 0.3 rad."""
    still = readings(0.0)
    ramp = 0.1 * np.array([[1.0, 0.0, 0.0]]) * (still.time[:, None] - 8.0) / 16.0
    assert moves_of(replace(still, gyro=still.gyro + ramp)) == 0


def test_no_move_beside_free_turns_poses_and_windows_of_one_sample():
    moved = readings(1.5)
    first, second = moved.sequences
    assert moves_of(moved, second, first) == 1
    free = [replace(s, id=None) for s in (first, second)]
    assert moves_of(moved, free[0], second) == moves_of(moved, first, free[1]) == moves_of(moved, *free) == 0
    poses = [
        SequenceLabel.of_pose((0.0, 3.0), id="p1", down="z", along_outer="x"),
        SequenceLabel.of_pose((13.0, 16.0), id="p2", down="z", along_outer="x"),
    ]
    assert moves_of(moved, poses[0], second) == moves_of(moved, first, poses[1]) == 0
    one_sample = [replace(first, end_static_s=(2.0, 2.01)), replace(second, start_static_s=(13.99, 14.0))]
    assert moves_of(moved, one_sample[0], second) == moves_of(moved, first, one_sample[1]) == 0


def test_no_move_over_a_gap():
    moved = readings(1.5)
    kept = (moved.time < 6.0) | (moved.time > 7.0)
    cut = replace(moved, time=moved.time[kept], gyro=moved.gyro[kept], accel=moved.accel[kept])
    assert moves_of(cut) == 0


def test_no_move_passes_over_a_sequence_that_is_left_out():
    """The turn of the sequence between two others is none of a move; the others keep their places."""
    moved = readings(1.5)
    first, second = moved.sequences
    middle = SequenceLabel((3.2, 3.4), (12.6, 12.8), id="3")
    left, titles = leave_out(moved.with_sequences((first, middle, second)), ["3"])
    assert [label.number for label in left.sequences] == [1, 3]
    assert titles == (middle.title,)
    assert moves_of(left) == 0
    assert moves_of(leave_out(moved, [])[0]) == 1
    with pytest.raises(InputError, match="no turn or sequence '4' to leave out; the recording has 1, 2"):
        leave_out(moved, ["4"])
