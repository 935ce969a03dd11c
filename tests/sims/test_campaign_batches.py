"""Batches of a campaign: units of one motion as arrays, with the results of each by itself."""

import gc
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from small_campaign import TIMES, numbers, same, small_campaign

import srt
from sims import simulate
from sims.robustness import run
from sims.robustness.run import LARGEST_BATCH, OWN_MOTIONS, batch_size, run_campaign
from sims.robustness.trial import run_batch, run_trial
from srt.closed_form import estimator, iteration
from srt.closed_form.estimator import estimate_units
from srt.closed_form.iteration import iterate_units
from srt.comparison.parallel import Engine
from srt.estimation.options import Options
from srt.exceptions import DataError
from srt.sensor_errors import NAMES

ONE_MOTION = "\ntrials_per_motion = 100"


def by_batches(campaign, size):
    tasks = list(campaign.tasks)
    return list(chain(*chain(*(run_batch(campaign, tasks[a : a + size]) for a in range(0, len(tasks), size)))))


def assert_alike(one, other):
    """Numbers equal to rounding: errors to 1e-12 and 1e-9 sigma, all that are no numbers exactly."""
    assert one.keys() == other.keys()
    for name in set(one) - {*TIMES, "nees", "largest", "distance"}:
        if name.startswith("error_"):
            assert other[name] == pytest.approx(one[name], rel=0, abs=1e-12, nan_ok=True)
        elif name.startswith("sigma_"):
            assert other[name] == pytest.approx(one[name], rel=1e-7, abs=1e-12, nan_ok=True)
        else:
            assert other[name] == one[name]


def test_batches_of_any_size_give_the_same(tmp_path):
    """Units of ±50 % and 0.3 rad, of which some cannot be calibrated, and some lack sequences."""
    extra = "missing_sequences = { choices = [0, 0, 0, 2] }\n"
    campaign = small_campaign(tmp_path, trials="6" + ONE_MOTION, extra=extra)
    campaign = replace(campaign, grid={"scale_percent": (50, 90), "misalignment_mrad": (300,)})
    one, three, all_of_them = (by_batches(campaign, size) for size in (1, 5, 12))
    assert {"converged", "no_imu"} <= {row["outcome"] for row in one}
    for row, *others in zip(one, three, all_of_them, strict=True):
        for other in others:
            assert_alike(row, other)


def assert_as_alone(recording, found):
    alone = srt.calibrate(recording, "closed-form", checks=False)
    assert (found.status, found.message, found.corrections == ()) == (alone.status, alone.message, False)
    np.testing.assert_array_equal(found.observed, alone.observed)
    off = (found.errors.vector - alone.errors.vector)[alone.observed]
    assert np.abs(off / alone.sigma[alone.observed]).max(initial=0.0) < 1e-9
    np.testing.assert_allclose(found.sigma, alone.sigma, rtol=1e-9)
    return alone.status


def test_disputed_results_are_those_of_single_runs(tmp_path):
    """A wrong label, g-sensitivity, noise above the stated one, a change of scale, and a sequence that lacks."""
    campaign = small_campaign(tmp_path, trials="12" + ONE_MOTION)
    campaign.scenario["recording"] |= {"noise": True, "state_noise": True}
    recordings = [simulate(campaign.unit(0, k)[0]).recording for k in range(10)]
    rng = np.random.default_rng(20261126)
    first, second = recordings[1].sequences[:2]
    swapped = (replace(first, id=second.id), replace(second, id=first.id), *recordings[1].sequences[2:])
    recordings[1] = recordings[1].with_sequences(swapped)
    noise = 1e-3 * rng.standard_normal(recordings[3].accel.shape)
    recordings[3] = replace(recordings[3], accel=recordings[3].accel + noise)
    recordings[5] = replace(recordings[5], gyro=recordings[5].gyro + 1e-5 * recordings[5].accel[:, [1, 2, 0]])
    factor = np.where(recordings[7].time < recordings[7].sequences[4].end_static_s[0] - 0.2, 1.0, 1.002)
    recordings[7] = replace(recordings[7], gyro=recordings[7].gyro * factor[:, None])
    recordings[8] = recordings[8].with_sequences(recordings[8].sequences[3:])
    found = estimate_units(recordings, [Options()] * len(recordings))
    statuses = {assert_as_alone(*pair) for pair in zip(recordings, found, strict=True)}
    assert {"converged", "partial", "inconsistent"} <= statuses


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["", ONE_MOTION], ids=["each", "one"])
def test_a_batch_leaves_no_recording_in_memory(tmp_path, motion):
    """Without the collector of circular references, which counts objects, not bytes."""
    campaign = small_campaign(tmp_path, trials="8" + motion)
    by_batches(campaign, 4)
    gc.collect()
    gc.disable()
    try:
        before = sum(isinstance(own, srt.Recording) for own in gc.get_objects())
        by_batches(campaign, 4)
        after = sum(isinstance(own, srt.Recording) for own in gc.get_objects())
    finally:
        gc.enable()
    assert after == before


@pytest.mark.parametrize("noise", [False, True])
def test_units_with_a_motion_each_are_those_of_single_runs(tmp_path, noise):
    """The errors of the fixture change the number of samples; biases that wander, by noise, the times that matter."""
    campaign = small_campaign(tmp_path, trials=6)
    campaign.scenario["recording"]["noise"] = noise
    campaign.scenario["fixture"] |= {"rotation_sigma_mrad": 20.0, "stated_rotation_sigma_mrad": 20.0}
    recordings = [simulate(campaign.unit(1, k)[0]).recording for k in range(6)]
    assert len({len(recording.time) for recording in recordings}) > 1
    for recording, own in zip(recordings, estimate_units(recordings, [Options()] * 6), strict=True):
        if noise:
            assert_as_alone(recording, own)
            continue
        alone = srt.calibrate(recording, "closed-form", checks=False)
        assert (own.status, own.message) == (alone.status, alone.message)
        np.testing.assert_allclose(own.errors.vector, alone.errors.vector, rtol=0, atol=1e-12)
        np.testing.assert_allclose(own.sigma, alone.sigma, rtol=1e-7)


def test_a_unit_that_cannot_be_calibrated_leaves_the_others(tmp_path):
    """The error that a single run raises stands in its place."""
    campaign = small_campaign(tmp_path, trials="3" + ONE_MOTION)
    recordings = [simulate(campaign.unit(0, k)[0]).recording for k in range(3)]
    recordings[1] = recordings[1].with_sequences(())
    first, refused, last = estimate_units(recordings, [Options()] * 3)
    assert isinstance(refused, DataError)
    assert "labelled sequences" in str(refused)
    assert (first.status, last.status) == ("converged", "converged")


def test_a_unit_that_fails_among_others_fails_alone(tmp_path, monkeypatch):
    campaign = small_campaign(tmp_path, trials="3" + ONE_MOTION)
    simulations = [simulate(campaign.unit(0, k)[0]) for k in range(3)]
    recordings, given = [s.recording for s in simulations], [Options(start=s.truth) for s in simulations]
    failing = simulations[1].truth.vector

    def units(data, options, formulas, start, *rest, **stated):
        if np.any(np.all(start == failing, axis=1)):
            raise np.linalg.LinAlgError("of one unit")
        return iterate_units(data, options, formulas, start, *rest, **stated)

    monkeypatch.setattr(iteration, "iterate_units", units)
    monkeypatch.setattr(estimator, "iterate_units", units)
    first, failed, last = estimate_units(recordings, given)
    assert isinstance(failed, np.linalg.LinAlgError)
    assert (first.status, last.status) == ("converged", "converged")


def test_a_failure_that_no_unit_has_alone_is_told(tmp_path, monkeypatch):
    """Units together must not be slow for a defect that none of them shows."""
    campaign = small_campaign(tmp_path, trials="2" + ONE_MOTION)
    recordings = [simulate(campaign.unit(0, k)[0]).recording for k in range(2)]

    def defect(*args, **stated):
        raise ValueError("of all")

    monkeypatch.setattr(estimator, "iterate_units", defect)
    with pytest.raises(ValueError, match="of all"):
        estimate_units(recordings, [Options()] * 2)


@pytest.mark.slow
def test_a_campaign_runs_in_batches(tmp_path, monkeypatch):
    """Every trial once, the same to the bit with one worker and with two, and to rounding by itself."""
    campaign = small_campaign(tmp_path, trials="24" + ONE_MOTION)
    assert batch_size(campaign) == 3
    assert batch_size(replace(campaign, trials=10_000)) == LARGEST_BATCH
    least_squares = replace(campaign.estimators[0], name="least-squares")
    assert batch_size(replace(campaign, trials=10_000, estimators=(least_squares,))) == 1
    assert batch_size(replace(campaign, trials=10_000, trials_per_motion=1)) == OWN_MOTIONS
    sizes = []

    def counted(campaign, tasks):
        sizes.append(len(tasks))
        return run_batch(campaign, tasks)

    monkeypatch.setattr(run, "run_batch", counted)
    table = run_campaign(campaign, tmp_path / "one")
    assert sizes == [3] * 16
    monkeypatch.undo()
    assert same(table, run_campaign(campaign, tmp_path / "two", engine=Engine(2)))
    rows = {(row["point"], row["replicate"]): row for row in numbers(table)}
    assert len(rows) == campaign.size
    (alone,) = run_trial(campaign, (1, 7))
    for name in NAMES:
        assert rows[1, 7][f"error_{name}"] == pytest.approx(alone[f"error_{name}"], rel=0, abs=1e-12)
