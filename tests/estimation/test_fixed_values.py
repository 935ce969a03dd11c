"""Parameters that a recording does not show: their values, the count of the others, and the verdict "partial".

The recordings are those of a generator that shares nothing with the estimators (``benchmarks/foreign_motion.py``).
"""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from foreign_fixture import on_fixture, table_1, write
from foreign_motion import DEG, GRADES, Turn, drawn_errors, recording
from scipy.stats import chi2

import srt
from srt.model.prior import Prior, prior_sigma
from srt.sensor_errors import DISPLAY_FACTORS, GROUP_SLICES, INDEX, NAMES, SensorErrors

SEED = 20261201
UNITS = 6
SHORT = ("1", "1a", "2", "2a", "3", "3a", "7", "8", "9")
"""Sequences that show scale factors, and not all non-orthogonalities and misalignments."""


@cache
def flight(seed):
    """A vehicle that is level but for its tilts of some degrees: two to four turns, mostly about the vertical."""
    rng = np.random.default_rng((SEED, 1, seed))
    errors = drawn_errors(GRADES["consumer"], rng)
    turns = [
        Turn(tuple(rng.normal(size=3) * [0.15, 0.15, 1.0]), rng.uniform(0.3, 2.0), rng.uniform(3.0, 10.0), 5.0)
        for _ in range(int(rng.integers(2, 5)))
    ]
    return recording(turns, 5.0, errors, GRADES["consumer"], rng, profile="hand", start_deg=(20.0, 1.0, -2.0)), errors


def on_the_fixture(folder, ids, seed=0, fixture=None):
    """Table 1 in parts on a fixture of 1 mrad, as a folder; and the errors of the unit."""
    rng = np.random.default_rng((SEED, 2, seed))
    errors = drawn_errors(GRADES["tactical"], rng)
    motion = on_fixture(ids, rng, rest_s=10.0, rate_rad_s=60.0 * DEG, sigma_rad=1e-3)
    keys = {"heading_deg": 0.0, "alignment_sigma_mrad": 1.0, "rotation_sigma_mrad": 1.0}
    tables = {"fixture": keys if fixture is None else fixture}
    write(folder, motion.sampled(errors, GRADES["tactical"], rng), tables, motion.labels(0.1))
    return errors


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """All of Table 1, of the unit of seed 0."""
    folder = tmp_path_factory.mktemp("table-1") / "unit"
    on_the_fixture(folder, table_1())
    return folder


@cache
def short(seed):
    """Recording and errors of a short test."""
    with TemporaryDirectory() as folder:
        errors = on_the_fixture(Path(folder) / str(seed), SHORT, seed)
        return srt.load_recording(Path(folder) / str(seed)), errors


@cache
def flight_result(seed):
    return srt.calibrate(flight(seed)[0], force=True)  # most are not fit: they show biases of the gyros alone


def test_a_flight_log_is_partial_and_what_it_does_not_show_is_zero():
    squares, freedom = 0.0, 0
    for seed in range(UNITS):
        found, (_, errors) = flight_result(seed), flight(seed)
        seen = found.observed
        assert 0 < seen.sum() < 12
        assert found.judgement.word == "partial", found.judgement
        assert "Not observed, though such a recording should show them: " in found.judgement.reason
        assert np.all(found.errors.vector[~seen] == 0.0)
        off = (found.errors.vector - [errors.get(name, 0.0) for name in NAMES])[seen]
        squares += float(off @ np.linalg.solve(found.covariance[np.ix_(seen, seen)], off))
        freedom += int(seen.sum())
    # The sigmas hold wide priors of what is fixed: an upper limit, 1 %.
    assert squares < chi2.ppf(0.99, freedom)


def test_the_command_counts_what_a_flight_log_shows_and_warns(tmp_path, shell):
    unit, _ = flight(0)
    write(tmp_path / "log", {"time": unit.time, "gyro": unit.gyro, "accel": unit.accel}, {})
    assert (
        "Fit to calibrate: no (nothing but biases is observable; " in shell("calibrate", tmp_path / "log", code=1).err
    )
    out, err = shell("calibrate", tmp_path / "log", "-o", tmp_path / "unit.json", "--force")
    observed = int(srt.load_calibration(tmp_path / "unit.json").observed.sum())
    assert f"least-squares, {observed} of 27 measured" in " ".join(out.split("Time base")[0].split())
    assert "Verdict: Partial. Not observed, though" in " ".join(out.split())
    assert "Sound" not in out
    assert "log: the verdict is partial; fixed, not observed: " in err


def test_what_is_passed_on_as_zero_is_named(tmp_path, shell, plain_page):
    unit, _ = flight(0)
    found = flight_result(0)
    assert not found.observed[GROUP_SLICES["accel_misalignment"]].any()
    found.save(tmp_path / "unit.json")
    write(tmp_path / "log", {"time": unit.time, "gyro": unit.gyro, "accel": unit.accel}, {})
    count = f"{int(found.observed.sum())} of 27 parameters are measured; passed on as zero: "
    file = str(tmp_path / "unit.json")
    for line in (
        ["apply", file, str(tmp_path / "log"), "-o", str(tmp_path / "out")],
        ["export", file, "--to", "pyins"],
    ):
        err = shell(*line, "-q").err
        assert count in err
        assert "accel_misalignment" in err.split("passed on as zero: ")[1].split(";")[0]
    out = " ".join(shell("certificate", file, "-o", tmp_path / "page.html").out.split())
    assert out.startswith(f"{int(found.observed.sum())} of 27 parameters were estimated")
    assert "Not measured, and zero in the corrections: " in out
    assert "Verdict: Partial." in out


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares"])
def test_a_fixture_gives_what_a_short_test_does_not_show(estimator):
    """The values lie within 3.5 times what levelling, mounting and two angles of 1 mrad leave of them."""
    for seed in range(3):
        unit, errors = short(seed)
        found = srt.calibrate(unit, estimator, ignore_moves=True)
        lost = [name for name in found.fixed if "orthogonality" in name or "misalignment" in name]
        assert lost
        for name in lost:
            off = abs(found.errors[name] - errors.get(name, 0.0))
            assert off < 2.0 * 3.5 * np.sqrt(4.0) * 1e-3
            sigma = 1e-3 * np.sqrt(2.0) * DISPLAY_FACTORS[INDEX[name]]
            assert f"the value is that of the fixture's nominal angles, 1-sigma {sigma:.4g} µrad" in found.fixed[name]
        assert any(found.errors[name] != 0.0 for name in lost)
        assert found.judgement.word == "partial", found.judgement


def test_a_fixture_that_saw_one_pose_does_not_determine_the_other_axes(tmp_path):
    """Sequences 1 and 1a: z down, turns about y. The start's fit divides what z reads between bias and scale."""
    on_the_fixture(tmp_path / "unit", ("1", "1a"))
    found = srt.calibrate(tmp_path / "unit", "least-squares")
    for name in ("gyro_scale_x", "gyro_scale_z", "accel_scale_y", "gyro_orthogonality_zx"):
        assert found.fixed[name].endswith("taken as zero"), found.fixed[name]
        assert found.errors[name] == 0.0
    assert found.judgement.word != "sound"


@pytest.mark.slow
def test_a_whole_test_of_table_1_is_sound_and_one_with_a_lost_sequence_is_not(whole, tmp_path):
    recorded = srt.load_recording(whole)
    found = srt.calibrate(recorded)
    assert (found.judgement.word, found.status) == ("sound", "converged")
    without = tuple(name for name in table_1() if name not in ("1a", "2a", "3a"))
    on_the_fixture(tmp_path / "linear", without)
    linear = srt.calibrate(tmp_path / "linear", asymmetry=False)
    assert (linear.judgement.word, linear.status) == ("sound", "partial")
    lost = srt.calibrate(recorded.with_sequences(tuple(s for s in recorded.sequences if s.id != "4")))
    assert lost.judgement.word == "partial"
    assert "should show them: gyro_orthogonality_yz" in lost.judgement.reason


def test_parameters_fixed_on_request_are_zero_and_not_missed():
    unit, _ = flight(1)
    found = srt.calibrate(unit, hold=("accel_scale", "accel_bias"), checks=False)
    for group in ("accel_scale", "accel_bias"):
        assert np.all(found.errors.group(group) == 0.0)
        assert group not in found.judgement.reason


def test_a_prior_gives_what_is_fixed():
    unit, errors = short(0)
    mean = SensorErrors([errors.get(name, 0.0) if "gyro_orthogonality" in name else 1e-4 for name in NAMES])
    options = {"prior": Prior.from_sigma(prior_sigma(), mean), "hold": ("gyro_orthogonality",)}
    found = srt.calibrate(unit, "ekf", checks=False, **options)
    np.testing.assert_array_equal(found.errors.group("gyro_orthogonality"), mean.group("gyro_orthogonality"))


@pytest.mark.slow
def test_the_summary_and_the_certificate_say_that_the_clock_is_taken_as_exact(whole, tmp_path, shell, plain_page):
    said = "Time base taken as exact: 1 ppm of clock is 1 ppm of every gyro scale factor."
    file = str(tmp_path / "unit.json")
    lines = shell("calibrate", whole, "-o", file).out.splitlines()
    heading = next(i for i, line in enumerate(lines) if line.endswith("measured"))
    assert lines[heading + 1] == said
    assert said in " ".join(shell("certificate", file, "-o", tmp_path / "page.html").out.split())
    stated = replace(srt.load_recording(whole), clock_sigma=1e-6)
    again = srt.calibrate(stated)
    assert "Time base" not in repr(again)
    assert again.sigma[INDEX["gyro_scale_x"]] > 1e-6
