"""Moves between labelled sequences, in readings made by hand."""

from dataclasses import replace

import numpy as np
import pytest

import srt
from srt.exceptions import InputError
from srt.recording.recording import Fixture, Recording, SequenceLabel
from srt.sequences.moves import recorded_moves
from srt.sequences.recognition import leave_out
from srt.sequences.stationary_windows import MIN_TURN_RAD

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
