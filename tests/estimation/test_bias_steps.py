"""Drift is told from faults of moves, windows and sequences; a step of a bias is a form of drift."""

import numpy as np
import pytest
from worse_recordings import CASES, unit_of

import srt
from srt.noise.bias_steps import LEAST_WINDOWS, step_shapes, within_span
from srt.noise.drift_forms import Intervals
from srt.sensor_errors import NAMES


def error_over_sigma(found, errors):
    truth = np.array([errors.get(name, 0.0) for name in NAMES])
    return np.abs((found.errors.vector - truth)[found.observed] / found.sigma[found.observed])


@pytest.mark.parametrize(
    ("case", "seed", "named"),
    [
        ("fixture, accelerometer step of 0.4 mg", 0, {("accel", "step at 123.5 s")}),
        ("fixture, gyro step of 30 °/h", 0, {("gyro", "step at 123.5 s")}),
        ("hand, accelerometer step of 0.4 mg", 0, {("accel", "step at 55.1 s")}),
        ("hand, gyro step of 30 °/h", 0, {("gyro", "step at 55.1 s")}),
        ("hand, 500 s, linear, 8 mg and 570 °/h", 0, {("accel", "linear"), ("gyro", "linear")}),
        ("hand, 500 s, linear, 8 mg and 570 °/h", 1, {("accel", "linear"), ("gyro", "linear")}),
        ("navigation on a fixture, warm-up of 1 mg", 1, {("accel", "warm-up")}),
    ],
)
def test_drift_is_named_and_nothing_else_accused(case, seed, named):
    """Sound, moves and windows kept. The largest of 27 normalised errors exceeds 4.2 with a probability of 7e-4."""
    unit, errors = unit_of(CASES[case], seed)
    found = srt.calibrate(unit, "least-squares")
    assert {(row.sensor, row.form) for row in found.diagnostics.drift} == named
    assert found.judgement.word == "sound"
    assert not found.provenance.voided
    assert not any("moved in the stationary windows" in warning for warning in found.warnings)
    assert error_over_sigma(found, errors).max() < 4.2


def intervals_of_windows(W):
    """Windows of 10 s, a rotation of two parts of 5 s after each."""
    start = 20.0 * np.arange(W)
    parts = (start[:-1, None] + [[10.0, 15.0]]).ravel()
    halves = (start[:, None] + [[0.0, 5.0]]).ravel()
    starts = np.concatenate([start, parts, halves])
    ends = starts + np.repeat([10.0, 5.0, 5.0], [W, 2 * (W - 1), 2 * W])
    return Intervals(starts, ends, W, (W - 1, 2), None)


def test_shapes_of_steps_are_means_of_steps():
    """Some coefficients give a sampled step in a rotation, and in the first and the second half of a window."""
    W = 12
    intervals = intervals_of_windows(W)
    shapes = step_shapes(intervals)
    assert len(shapes) == W - 2 * LEAST_WINDOWS + 1 + 2 * (W - 2 * LEAST_WINDOWS)
    for at, name in ((111.0, "step at 115.0 s"), (121.5, "step at 122.5 s"), (128.0, "step at 127.5 s")):
        mean = np.clip((intervals.end - at) / (intervals.end - intervals.start), 0.0, 1.0)
        mean = mean - mean[:W].mean()
        shape = shapes[name]
        rows = (shape.windows, shape.parts.reshape(-1, 2), shape.halves.reshape(-1, 2))
        # In a rotation the mean over its parts alone acts, up to the change of attitude between them.
        parts = mean[W : -2 * W].reshape(-1, 2)
        kept = np.abs(parts[:, 0] - parts[:, 1]) < 1e-12
        use = np.concatenate([np.ones(W, bool), np.repeat(kept, 2), np.ones(2 * W, bool)])
        found = np.linalg.lstsq(np.concatenate(rows)[use], mean[use], rcond=None)[0]
        assert np.abs(np.concatenate(rows)[use] @ found - mean[use]).max() < 1e-12
        assert found[0] == pytest.approx(1.0)
        assert shape.of("accel").windows.shape[1] == (1 if at == 111.0 else 2)
        assert within_span(np.outer(found, [1.0, 2.0, 0.0]).ravel()) <= 0.5 + 1e-12
