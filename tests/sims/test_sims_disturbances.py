"""Disturbances of a simulated test, each against the same disturbance made in another way."""

import math
from dataclasses import replace

import numpy as np
import pytest
from disturbed_runs import MOTION, SITE, draw, run, small, snapshot, untouched
from hypothesis import given, settings
from hypothesis import strategies as st
from injected_faults.disturbances import accel_bias_step, lose_samples, noisier_window, wrong_angle
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import sims
from srt.recording.recording import Recording
from srt.sensor_errors import SensorErrors

NONE = SensorErrors()


ERRORS = SensorErrors(np.random.default_rng(1).standard_normal(27) * 1e-3)
RECORDING = sims.read_out(MOTION, ERRORS, sims.ImuModel(gyro_noise=1e-4, accel_noise=1e-3), np.random.default_rng(2))
INCREMENTS = replace(
    RECORDING, gyro=RECORDING.gyro * MOTION.interval, accel=RECORDING.accel * MOTION.interval, kind="increment"
)
EITHER = pytest.mark.parametrize("recording", [RECORDING, INCREMENTS], ids=["rate", "increment"])


def inside(recording, start_s, end_s):
    half = 0.5 * (recording.time[1] - recording.time[0])
    return (recording.time > start_s + half) & (recording.time <= end_s + half)


@EITHER
@pytest.mark.parametrize("sensors", [("gyro",), ("accel",), ("gyro", "accel")])
def test_lost_samples_lie_on_a_line_between_the_neighbours(recording, sensors):
    start = MOTION.windows[0][0][1] + 0.3
    before = snapshot(recording)
    out = lose_samples(recording, start, 0.2, sensors)
    assert untouched(recording, before)
    lost = inside(recording, start, start + 0.2)
    assert lost.sum() == 10
    for name in ("gyro", "accel"):
        values, original = getattr(out, name), getattr(recording, name)
        np.testing.assert_array_equal(values[~lost], original[~lost])
        if name not in sensors:
            np.testing.assert_array_equal(values, original)
            continue
        for axis in range(3):
            expected = np.interp(recording.time[lost], recording.time[~lost], original[~lost, axis])
            np.testing.assert_allclose(values[lost, axis], expected, rtol=1e-12, atol=1e-15)


def test_default_is_to_lose_gyro_samples_and_a_hash_of_other_samples_goes():
    recording = replace(RECORDING, data_sha256="0" * 64)
    out = lose_samples(recording, 0.2, 0.1)
    assert not np.array_equal(out.gyro, recording.gyro)
    np.testing.assert_array_equal(out.accel, recording.accel)
    assert out.data_sha256 is None
    assert (out.site, out.fixture, out.sequences, out.kind) == (SITE, recording.fixture, recording.sequences, "rate")


@given(st.integers(1, 150), st.integers(1, 40), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_losing_samples_of_straight_lines_or_twice_changes_nothing(first, count, seed):
    rng = np.random.default_rng(seed)
    # Stamps that scatter, as of a logger: the line is one in time, not in the sample's number.
    time = np.cumsum(rng.uniform(0.008, 0.012, 200))
    lines = rng.standard_normal((1, 3)) + rng.standard_normal((1, 3)) * time[:, np.newaxis]
    recording = Recording(time, lines, rng.standard_normal((200, 3)), SITE)
    half = 0.5 * recording.nominal_interval_s
    start, duration = time[first] - half - 1e-4, time[first + count - 1] - time[first] + 2e-4
    out = lose_samples(recording, start, duration, ("gyro", "accel"))
    np.testing.assert_allclose(out.gyro, lines, rtol=0.0, atol=1e-13)
    again = lose_samples(out, start, duration, ("gyro", "accel"))
    np.testing.assert_allclose(again.accel, out.accel, rtol=0.0, atol=1e-13)
    assert (out.accel != recording.accel).any(axis=1).sum() == count


def test_losing_for_no_time_changes_nothing():
    out = lose_samples(RECORDING, 0.5, 0.0)
    np.testing.assert_array_equal(out.gyro, RECORDING.gyro)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_a_bias_step_is_the_reading_of_a_unit_with_another_bias(kind):
    step = np.array([1e-3, -2e-3, 5e-4])
    added = SensorErrors.from_dict({f"accel_bias_{a}": s for a, s in zip("xyz", step, strict=True)})
    biased = SensorErrors(ERRORS.vector + added.vector)
    plain, other = (sims.read_out(MOTION, errors, kind=kind) for errors in (ERRORS, biased))
    start, end = MOTION.windows[0][1][0] + 0.3, MOTION.windows[2][0][0] + 0.5  # over two gaps
    before = snapshot(plain)
    out = accel_bias_step(plain, start, end, step)
    assert untouched(plain, before)
    rows = inside(plain, start, end)
    assert 0 < rows.sum() < len(rows)
    np.testing.assert_array_equal(out.gyro, plain.gyro)
    np.testing.assert_array_equal(out.accel[~rows], plain.accel[~rows])
    np.testing.assert_allclose(out.accel[rows], other.accel[rows], rtol=0.0, atol=1e-14)


def test_a_bias_step_in_increments_goes_by_each_samples_own_interval():
    time = np.cumsum(np.random.default_rng(4).uniform(0.005, 0.015, 100))
    recording = Recording(time, np.zeros((100, 3)), np.zeros((100, 3)), SITE, "increment")
    out = accel_bias_step(recording, time[9] + 0.004, time[59] + 0.004, [1.0, 2.0, 3.0])
    summed = out.accel.sum(axis=0)
    first, last = np.flatnonzero(out.accel[:, 0])[[0, -1]]
    np.testing.assert_allclose(summed, (time[last] - time[first - 1]) * np.array([1.0, 2.0, 3.0]), rtol=1e-12)


@given(st.floats(0.0, 3.0), st.floats(0.1, 3.0), small)
@settings(max_examples=30, deadline=None)
def test_opposite_bias_steps_cancel(start, duration, step):
    out = accel_bias_step(RECORDING, start, start + duration, step)
    back = accel_bias_step(out, start, start + duration, np.negative(step))
    np.testing.assert_allclose(back.accel, RECORDING.accel, rtol=0.0, atol=4e-15)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_noise_of_a_window_is_the_factor_times_the_stated_one(kind):
    still = sims.free_motion(np.array([[1.0, 0.0, 0.0]]), site=SITE, dwell_s=40.0, sample_rate_hz=100.0)
    densities = (2e-4, 3e-3)
    recording = sims.read_out(still, NONE, sims.ImuModel(*densities), np.random.default_rng(3), kind=kind)
    before = snapshot(recording)
    rng = np.random.default_rng(4)
    out = noisier_window(recording, (2.0, 38.0), 3.0, *densities, rng)
    assert untouched(recording, before)
    rows = inside(recording, 2.0, 38.0) & (still.time < 39.0)
    exact = sims.read_out(still, NONE, kind=kind)
    n = 3 * rows.sum()
    low, high = np.sqrt(chi2.ppf([1e-6, 1.0 - 1e-6], n) / n)
    added = []
    for name, density in zip(("gyro", "accel"), densities, strict=True):
        values, original = getattr(out, name), getattr(recording, name)
        np.testing.assert_array_equal(values[~rows], original[~rows])
        sigma = 3.0 * density * (0.1 if kind == "increment" else 10.0)  # √dt of 100 Hz, or one over it
        assert low < np.sqrt(np.mean((values - getattr(exact, name))[rows] ** 2)) / sigma < high
        added.append((values - original)[rows].ravel())
    assert abs(np.corrcoef(*added)[0, 1]) < 5.0 / math.sqrt(n)
    repeated = noisier_window(recording, (2.0, 38.0), 3.0, *densities, np.random.default_rng(4))
    np.testing.assert_array_equal(repeated.gyro, out.gyro)
    assert not np.array_equal(noisier_window(recording, (2.0, 38.0), 3.0, *densities, rng).gyro, out.gyro)


def test_a_factor_of_one_or_no_noise_adds_nothing():
    one = noisier_window(RECORDING, MOTION.windows[0][0], 1.0, 1e-4, 1e-3, np.random.default_rng(1))
    no_gyro = noisier_window(RECORDING, MOTION.windows[0][0], 2.0, 0.0, 1e-3, np.random.default_rng(1))
    np.testing.assert_array_equal(one.gyro, RECORDING.gyro)
    np.testing.assert_array_equal(one.accel, RECORDING.accel)
    np.testing.assert_array_equal(no_gyro.gyro, RECORDING.gyro)
    assert not np.array_equal(no_gyro.accel, RECORDING.accel)


def test_a_wrong_angle_turns_the_end_attitude_about_the_axis_of_its_leg():
    # Sequence 13 turns 180° about IMU z, then 180° about IMU y: the error of its second leg is one about y.
    plain = draw()
    legs = [leg.copy() for leg in plain.legs]
    wrong = wrong_angle(plain, 1, 1, 0.01)
    for leg, kept in zip(plain.legs, legs, strict=True):
        np.testing.assert_array_equal(leg, kept)
    motions = [
        run(Rotation.identity(), replace(d, mounting=np.zeros(3), non_orthogonality=0.0), earth_rate=False)
        for d in (plain, wrong)
    ]
    np.testing.assert_array_equal(motions[1].attitudes[[0, 2]], motions[0].attitudes[[0, 2]])
    np.testing.assert_array_equal(motions[1].attitudes[1, 0], motions[0].attitudes[1, 0])
    relative = Rotation.from_matrix(motions[0].attitudes[1, 1].T @ motions[1].attitudes[1, 1]).as_rotvec()
    # The outer axis is y of the body at the inner angle zero; here it is 180° and what was executed wrongly.
    inner = math.pi + plain.starts[1, 0] + plain.legs[1][0]
    expected = 0.01 * np.array([math.sin(inner), math.cos(inner), 0.0])
    np.testing.assert_allclose(relative, expected, rtol=0.0, atol=1e-14)
    sums = [m.angle[m.piece_starts[1] : m.piece_starts[2]].sum(axis=0) for m in motions]
    np.testing.assert_allclose(sums[1] - sums[0], expected, rtol=0.0, atol=1e-12)


@given(st.integers(0, 2), st.floats(-0.1, 0.1), st.data())
@settings(max_examples=30, deadline=None)
def test_opposite_wrong_angles_cancel(sequence, error, data):
    plain = draw()
    leg = data.draw(st.integers(0, len(plain.legs[sequence]) - 1))
    wrong = wrong_angle(plain, sequence, leg, error)
    assert sum(int(np.sum(a != b)) for a, b in zip(plain.legs, wrong.legs, strict=True)) <= 1
    assert wrong.legs[sequence][leg] - plain.legs[sequence][leg] == pytest.approx(error, abs=1e-17)
    back = wrong_angle(wrong, sequence, leg, -error)
    for a, b in zip(plain.legs, back.legs, strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-16)
