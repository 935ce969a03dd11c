"""Motions whose ideal readings python-ins computes, a generator that others wrote: Table 1 and turns by hand.

python-ins turns attitudes against the Earth into increments of rate and specific force; the profiles of the angles are
written here, and the sensor errors are those of ``benchmarks/foreign_motion.py``. Noise-free readings must give back
the errors: to 2e-8 on the fixture, 5e-6 without one.
"""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from foreign_fixture import TABLE_1
from foreign_motion import GRADES, drawn_errors, hand_turns, readings
from scipy.spatial.transform import Rotation

import srt
from srt.recording.recording import Fixture, Recording, SequenceLabel, Site
from srt.sensor_errors import GROUP_SLICES, NAMES

for package in ("pyins", "filterpy", "gtsam"):
    pytest.importorskip(package)

pytestmark = pytest.mark.filterwarnings("ignore:Gimbal lock detected:UserWarning")

LATITUDE_DEG = 34.0
HZ = 100.0
EYE = np.eye(3)
WINDOW_S, CLEAR_S = 5.0, 0.3
"""Rests of Table 1, and what is left out next to a turn in the labels, s."""


def axis(letter):
    return EYE["xyz".index(letter)]


def turned(start, vector, duration_s):
    """Attitudes of a turn with ends that are smooth in the third derivative, first sample excluded."""
    s = np.arange(1, round(duration_s * HZ) + 1)[:, None] / round(duration_s * HZ)
    return start * Rotation.from_rotvec(s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3) * vector)


def resting(attitude, duration_s):
    return Rotation.from_quat(np.tile(attitude.as_quat(), (round(duration_s * HZ), 1)))


def ideal_increments(attitude):
    """Time and increments of an IMU at rest on the Earth at these attitudes, body to north-east-down."""
    from pyins import sim, transform

    time = np.arange(len(attitude)) / HZ
    place = np.tile([LATITUDE_DEG, 0.0, 0.0], (len(time), 1))
    rph = transform.mat_to_rph(attitude.as_matrix())
    _, imu = sim.generate_imu(time, place, rph, np.zeros((len(time), 3)), sensor_type="increment")
    return time[1:], imu.values[1:]


def unit(parts, labels, seed, fixture=None):
    """Recording of noise-free increments of a tactical unit, and its true errors."""
    from pyins import earth

    errors = drawn_errors(GRADES["tactical"], np.random.default_rng(seed))
    time, increments = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    rate, force = increments[:, :3] * HZ, increments[:, 3:] * HZ
    gyro, accel = readings(rate[:, None], force, errors, None, 1.0 / HZ, None)
    site = Site(earth.gravity(LATITUDE_DEG, 0.0), latitude_rad=np.radians(LATITUDE_DEG))
    recording = Recording(time, gyro / HZ, accel / HZ, site, "increment", fixture, sequences=tuple(labels))
    return recording, np.array([errors.get(name, 0.0) for name in NAMES])


@cache
def table_1():
    parts, labels, begin = [], [], 0.0
    for row in TABLE_1.strip().splitlines():
        name, start, *turns = row.split()
        down, outer = axis(start[0]), axis(start[2])
        attitude = Rotation.from_matrix(np.stack([np.cross(outer, down), outer, down]))
        pieces = [resting(attitude, WINDOW_S)]
        for turn in turns:
            vector = np.radians(float(turn[:-1])) * axis(turn[-1])
            pieces.append(turned(attitude, vector, 1.5 * float(np.linalg.norm(vector))))
            attitude = attitude * Rotation.from_rotvec(vector)
        pieces.append(resting(attitude, WINDOW_S))
        time, increments = ideal_increments(Rotation.concatenate(pieces))
        parts.append((begin + time, increments))
        end = begin + time[-1]
        labels.append(
            SequenceLabel(
                (begin + CLEAR_S, begin + WINDOW_S - CLEAR_S), (end - WINDOW_S + CLEAR_S, end - CLEAR_S), name
            )
        )
        begin = end + 5.0
    return unit(parts, labels, 5, Fixture(0.0, 1e-6, 1e-6))


@cache
def hand_turned(seed):
    rng = np.random.default_rng(seed)
    attitude = Rotation.from_euler("ZYX", (-91.0, 1.0, -91.0), degrees=True)
    pieces, rests, now = [resting(attitude, 5.0)], [(CLEAR_S, 5.0 - CLEAR_S)], 5.0
    for turn in hand_turns(rng, shortest_s=1.0):
        vector = turn.angle_rad * np.array(turn.axis) / np.linalg.norm(turn.axis)
        pieces.append(turned(attitude, vector, turn.duration_s))
        attitude = attitude * Rotation.from_rotvec(vector)
        pieces.append(resting(attitude, turn.rest_s))
        now += len(pieces[-2]) / HZ
        rests.append((now + CLEAR_S, now + len(pieces[-1]) / HZ - CLEAR_S))
        now += len(pieces[-1]) / HZ
    labels = [SequenceLabel(*pair) for pair in pairwise(rests)]
    return unit([ideal_increments(Rotation.concatenate(pieces))], labels, seed)


@cache
def calibrated(recording, estimator):
    return srt.calibrate(recording, estimator, checks=False)


def worst(recording, truth, estimator):
    """Largest error, accelerometer biases in g."""
    found = calibrated(recording, estimator)
    assert found.status == "converged", found.message
    off = np.abs(found.errors.vector - truth)
    off[GROUP_SLICES["accel_bias"]] /= recording.site.gravity_m_s2
    return float(off.max())


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares", "ekf", "graph"])
def test_table_1(estimator):
    assert worst(*table_1(), estimator) < 2e-8


@pytest.mark.parametrize("estimator", ["least-squares", "ekf", "graph"])
def test_turns_by_hand(estimator):
    assert worst(*hand_turned(1), estimator) < 5e-6


@pytest.mark.parametrize("estimator", ["least-squares", "ekf", "graph"])
def test_start_of_a_turn_in_a_window(estimator):
    """A window that ends 0.3 s after the next turn has begun is integrated; it is the end of the turn before it, too.

    Its two rotations refer to one attitude, and its Earth rate has a heading that no fixture states.
    """
    recording, truth = hand_turned(2)
    before, after = recording.sequences[4:6]
    (a, b), longer = before.end_static_s, 2.0 * CLEAR_S
    labels = list(recording.sequences)
    labels[4:6] = replace(before, end_static_s=(a, b + longer)), replace(after, start_static_s=(a, b + longer))
    moved = recording.with_sequences(labels)
    assert any("moved" in line for line in calibrated(moved, estimator).warnings)
    assert worst(moved, truth, estimator) < 5e-6


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_turns_by_hand_without_labels(seed):
    recording, truth = hand_turned(seed)
    assert worst(recording.with_sequences(()), truth, "least-squares") < 5e-6
