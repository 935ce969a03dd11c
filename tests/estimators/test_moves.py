"""Recorded moves between sequences: measurements of every estimator but the closed form."""

import json
from dataclasses import replace
from functools import cache

import accuracy_trials
import numpy as np
import pytest

import srt
from srt.cli.calibrate import CHOICES
from srt.joint.recording_opening import contradicting_move
from srt.model.prior import Prior
from srt.recording.recording import SequenceLabel
from srt.result.diagnostics import Diagnostics
from srt.result.noise_figures import NoiseFigures
from srt.sensor_errors import GROUP_SLICES
from srt.sequences.moves import recorded_moves

pytest.importorskip("filterpy")
pytest.importorskip("gtsam")

ESTIMATORS = ["least-squares", "ekf", "graph"]


@cache
def moved():
    return accuracy_trials.fixture_recording(21, "tactical", moves="recorded", sample_rate_hz=50.0)


@cache
def found(estimator, **options):
    return srt.calibrate(moved()[0], estimator, checks=False, **options)


def messages(calibration):
    return [w for w in calibration.warnings if "not checked for faults" not in w]


def in_move(recording, number):
    """Samples of the motion of a move, without those next to its windows."""
    move = recorded_moves(recording, recording.sequences)[number]
    return slice(*np.searchsorted(recording.time, [move.start_static_s[1] + 0.5, move.end_static_s[0] - 0.2]))


def test_moves_are_free_turns_between_the_windows():
    recording, _ = moved()
    moves = recorded_moves(recording, reversed(recording.sequences))
    pairs = zip(recording.sequences[:-1], recording.sequences[1:], strict=True)
    expected = [SequenceLabel(a.end_static_s, b.start_static_s) for a, b in pairs]
    # 14 starts as 13 does, but 13 ends elsewhere: between all sequences of Table 1 the unit turns.
    assert list(moves) == expected


def test_there_is_no_move_in_a_gap_without_a_turn_or_beside_a_free_turn():
    recording, _ = moved()
    first, second, *others = recording.sequences
    skipped, _ = accuracy_trials.fixture_recording(21, "tactical", sample_rate_hz=50.0)
    assert not recorded_moves(skipped, skipped.sequences)
    # Put end to end, as one recording without gaps: no sample turns between two sequences.
    dt = skipped.nominal_interval_s
    number = np.searchsorted(skipped.time, [s.start_static_s[0] + 0.5 * dt for s in skipped.sequences])
    shift = [skipped.time[n] - dt - dt * n for n in number]
    joined = replace(
        skipped,
        time=dt * np.arange(1, len(skipped.time) + 1),
        sequences=tuple(
            replace(
                s,
                start_static_s=tuple(t - by for t in s.start_static_s),
                end_static_s=tuple(t - by for t in s.end_static_s),
            )
            for s, by in zip(skipped.sequences, shift, strict=True)
        ),
    )
    assert not joined.gaps.size
    assert not recorded_moves(joined, joined.sequences)
    assert not recorded_moves(replace(recording, fixture=None), recording.sequences)
    turn = SequenceLabel(first.end_static_s, second.start_static_s)
    assert len(recorded_moves(recording, (first, turn, second, *others))) == len(others)
    lost = np.ones(len(recording.time), dtype=bool)
    lost[in_move(recording, 3)] = False
    cut = replace(recording, time=recording.time[lost], gyro=recording.gyro[lost], accel=recording.accel[lost])
    assert len(recorded_moves(cut, cut.sequences)) == len(recording.sequences) - 2


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_moves_are_used_unless_they_are_to_be_ignored(estimator):
    """The gyros' asymmetry gains most: a move turns in one sense only."""
    _, truth = moved()
    with_moves, without = found(estimator), found(estimator, ignore_moves=True)
    ratio = with_moves.sigma / without.sigma
    assert ratio[GROUP_SLICES["gyro_asymmetry"]].max() < 0.95
    assert ratio[GROUP_SLICES["gyro_orthogonality"]].max() < 0.9
    assert ratio.max() < 1.01
    for calibration in (with_moves, without):
        assert calibration.status == "converged"
        assert not messages(calibration)
        error = calibration.errors.vector - truth.vector
        assert error @ np.linalg.solve(calibration.covariance, error) < 60.1  # chi-square of 27: 1 in 4000


def test_the_closed_form_is_the_papers():
    used, ignored = found("closed-form"), found("closed-form", ignore_moves=True)
    np.testing.assert_array_equal(used.errors.vector, ignored.errors.vector)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_labelled_moves_are_the_moves_found(estimator):
    """Fixture and free turns mix: the same turns, labelled by the user, give the same result."""
    recording, _ = moved()
    moves = recorded_moves(recording, recording.sequences)
    labelled = recording.with_sequences((*recording.sequences, *moves))
    by_user = srt.calibrate(labelled, estimator, checks=False)
    reference = found(estimator)
    # The scatter of the rates at rest is tested over the windows of sequences alone, or of free turns, too.
    np.testing.assert_allclose(by_user.sigma[:24], reference.sigma[:24], rtol=1e-3)
    assert np.abs((by_user.errors.vector - reference.errors.vector) / reference.sigma)[:24].max() < 0.05


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("factor", [1.005, 0.5])
def test_a_move_that_contradicts_is_left_out_and_listed(estimator, factor):
    """Half a percent of a quarter turn is 80 sigma; half of it is found before the iteration."""
    recording, _ = moved()
    gyro = recording.gyro.copy()
    for number in (4, 9):
        gyro[in_move(recording, number)] *= factor
    calibration = srt.calibrate(replace(recording, gyro=gyro), estimator, checks=False)
    assert calibration.status == "converged"
    void = [w for w in messages(calibration) if w.startswith("The move at") and "is void" in w]
    assert len(void) == len(messages(calibration)) == 2
    assert all(("from the start attitude of the next" in w) == (factor == 0.5) for w in void)
    reference = found(estimator)
    # Two moves of sixteen carry an eighth of their information.
    assert np.abs((calibration.errors.vector - reference.errors.vector) / reference.sigma).max() < 1.5
    assert (calibration.sigma / reference.sigma).max() < 1.2


def test_no_move_is_left_out_for_a_sequence_or_by_chance():
    """Of ten groups the first is a move; a chi-square of 30 for 8 degrees of freedom has p = 2e-4."""
    sound, is_move = [(8.0, 8)] * 9, np.arange(10) == 0
    assert set(contradicting_move([(100.0, 8), *sound], is_move)) == {0}
    assert not contradicting_move([(30.0, 8), *sound], is_move)
    assert not contradicting_move([*sound, (100.0, 8)], is_move)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_saturated_move_is_void(estimator):
    recording, _ = moved()
    limit = 1.2
    gyro, noise = recording.gyro.copy(), replace(recording.noise, gyro_range=limit)
    part = in_move(recording, 4)
    axis = int(np.argmax(np.abs(gyro[part]).max(axis=0)))
    top = np.abs(gyro[part, axis]) > 0.5
    gyro[part, axis] = np.where(top, np.sign(gyro[part, axis]) * limit, gyro[part, axis])
    calibration = srt.calibrate(replace(recording, gyro=gyro, noise=noise), estimator, checks=False)
    assert calibration.status == "converged"
    (void,) = messages(calibration)
    assert void.startswith("The move at")


OPTIONS = [
    *({name: value} for name, values in CHOICES.items() for value in values[1:]),
    {"asymmetry": False},
    {"hold": ("accel_bias_x",)},
    {"fixture_states": False},
    {"prior": Prior.from_sigma(np.full(27, 0.1))},
    {"ignore_moves": True},
    {"live": True},
    {"targets": {"gyro_scale": 1e-4}},
]


@pytest.mark.parametrize(
    "estimator",
    ["closed-form", *(pytest.param(e, marks=[pytest.mark.slow] * (e != "least-squares")) for e in ESTIMATORS)],
)
def test_every_result_can_be_written_as_strict_json(estimator, tmp_path):
    """Steps without degrees of freedom have no p-value: None, and never NaN."""
    few = replace(moved()[0], sequences=moved()[0].sequences[:3])
    written = 0
    for option in OPTIONS:
        try:
            result = srt.calibrate(few, estimator, checks=False, **option)
        except srt.InputError as error:
            if "has no option" not in str(error):
                raise
            continue
        result.save(tmp_path / "unit.json")
        assert srt.load_calibration(tmp_path / "unit.json").to_dict() == json.loads(json.dumps(result.to_dict()))
        written += 1
    assert written >= 8


def test_the_gain_of_unused_moves_is_that_of_the_sigmas():
    closed = srt.calibrate(moved()[0], "closed-form")
    ratio = found("least-squares").sigma / closed.sigma
    assert closed.diagnostics.sigma_with_moves == (pytest.approx(ratio.min()), pytest.approx(ratio.max()))
    assert 0.0 < ratio.min() < ratio.max() < 1.0
    assert srt.calibrate(moved()[0], "least-squares").diagnostics.sigma_with_moves is None


def test_a_result_that_json_cannot_hold_is_not_made():
    result = found("graph")
    tests = (result.diagnostics.sequences[0], replace(result.diagnostics.sequences[1], probability=float("nan")))
    with pytest.raises(srt.InputError, match=r"diagnostics\.sequences\.1\.probability is nan"):
        replace(result, diagnostics=Diagnostics(sequences=tests))
    with pytest.raises(srt.InputError, match=r"diagnostics\.mine is a set"):
        replace(result, diagnostics=Diagnostics(further={"mine": {1.0}}))
    with pytest.raises(srt.InputError, match=r"noise\.gravity_effect\.1 is inf"):
        replace(result, noise=NoiseFigures(gravity_effect=np.array([1.0, np.inf])))
    with pytest.raises(srt.InputError, match="covariance"):
        replace(result, covariance=np.full((27, 27), np.inf))
