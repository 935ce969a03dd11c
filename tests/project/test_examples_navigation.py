"""The navigation example: its reading model and courses without python-ins, a one-minute form of all of it with."""

import importlib
import math
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import sims
import srt
from sims.physics.imu import noise_free_increments
from srt.sensor_errors import N_PARAMETERS

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = ("trajectories", "preintegration", "navigation", "drift_report")
DT = 0.01


@pytest.fixture(scope="module")
def example():
    """Import the example's modules, which are no part of any package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXAMPLES))
        yield SimpleNamespace(**{name: importlib.import_module(name) for name in NAMES})
        for name in NAMES:
            sys.modules.pop(name, None)


def motion(example, angle, velocity, dt=DT):
    trajectory = SimpleNamespace(index=dt * np.arange(len(angle) + 1))
    return example.trajectories.Motion(trajectory, dt, angle, velocity)


def faultless_unit(example, errors):
    """A unit without noise whose calibration found its errors exactly."""
    calibration = srt.Calibration("", "converged", "", errors, np.zeros((N_PARAMETERS, N_PARAMETERS)))
    return example.navigation.CalibratedUnit(errors, sims.ImuModel(), calibration)


def drawn_errors(seed=1):
    return srt.SensorErrors(np.random.default_rng(seed).normal(0.0, 0.01, N_PARAMETERS))


def test_readings_equal_the_simulators_but_for_changes_of_sign_within_a_sample(example):
    true = sims.table1_motion(site=srt.Site(9.8, latitude_rad=0.8), sequences=("6",), sample_rate_hz=100.0, dwell_s=1.0)
    errors = drawn_errors()
    found = example.navigation.sensed(
        motion(example, true.angle, true.velocity, true.interval), faultless_unit(example, errors), None
    )
    expected = noise_free_increments(true, errors)
    rectified = (true.angle_abs - np.abs(true.angle), true.velocity_abs - np.abs(true.velocity))
    for group, value, reading, gap in zip(("gyro", "accel"), found, expected, rectified, strict=True):
        asymmetry = [errors[f"{group}_asymmetry_{axis}"] for axis in "xyz"]
        # Sums of four terms below 1, each rounded to 1e-16.
        np.testing.assert_allclose(value + asymmetry * gap, reading, rtol=0.0, atol=1e-15)


def test_forms_without_noise(example):
    rng = np.random.default_rng(3)
    n = 4000  # 30 s of standstill, 10 s of motion
    angle, velocity = 0.01 * rng.normal(size=(n, 3)), 0.1 * rng.normal(size=(n, 3))
    moving = motion(example, angle, velocity)
    assert moving.still == slice(0, 3000)
    angle[moving.still], velocity[moving.still] = (1e-7, 0.0, -1e-7), (0.0, 0.001, -0.098)
    unit = faultless_unit(example, drawn_errors())
    unit = replace(unit, calibration=replace(unit.calibration, errors=drawn_errors(4)))
    raw = example.navigation.sensed(moving, unit, None)
    forms = example.navigation.forms_of(moving, unit, raw)
    assert list(forms) == list(example.navigation.FORMS) == list(example.drift_report.LINES)
    for k, true in enumerate((angle, velocity)):
        # Rounding of the inverse of a matrix near the identity.
        np.testing.assert_allclose(forms["perfect"][k], true, rtol=0.0, atol=1e-15)
        for form in ("raw, zeroed", "calibrated, zeroed"):
            at_rest = forms[form][k][moving.still] - true[moving.still]
            np.testing.assert_allclose(at_rest, 0.0, atol=1e-15)
        # Errors of 1 % of readings of 0.01 and 0.1 are left elsewhere, and other ones in each form.
        for form, other in (("raw", "calibrated"), ("raw, zeroed", "calibrated, zeroed")):
            assert np.max(np.abs(forms[form][k] - true)) > 1e-5
            assert np.max(np.abs(forms[form][k] - forms[other][k])) > 1e-5


@pytest.mark.parametrize("name", ["aircraft", "car"])
def test_course(example, name):
    vehicle = example.trajectories.VEHICLES[name]
    for quantity in ("speed_m_s", "path_deg"):
        assert math.isclose(sum(s.change for s in vehicle.cycle if s.quantity == quantity), 0.0, abs_tol=1e-12)
    assert all(s.start_s >= 0.0 and s.start_s + s.duration_s <= vehicle.cycle_s for s in vehicle.cycle)
    course = example.trajectories.course_of(name, 20.0, 20.0)
    assert len(course.time) == 20 * 60 * 20 + 1
    still = course.time <= example.trajectories.STANDSTILL_S
    assert not np.any(course.velocity_n[still])
    assert not np.any(course.roll_pitch_heading_deg[still])
    acceleration = np.gradient(course.velocity_n, course.time, axis=0)
    force = acceleration - [0.0, 0.0, 9.81]
    assert np.max(np.linalg.norm(force, axis=1)) < 2.0 * 9.81  # a consumer unit ends at 4 g
    roll, pitch, heading = np.radians(course.roll_pitch_heading_deg).T
    sideways = np.column_stack(
        [
            np.sin(roll) * np.sin(pitch) * np.cos(heading) - np.cos(roll) * np.sin(heading),
            np.sin(roll) * np.sin(pitch) * np.sin(heading) + np.cos(roll) * np.cos(heading),
            np.sin(roll) * np.cos(pitch),
        ]
    )
    felt = np.abs(np.sum(sideways * force, axis=1))
    if name == "aircraft":
        # Rocking of 0.5° turns a force of at most 1.5 g (0.13 m/s²); a path of 5.5° leaves g sin 46° (1 - cos 5.5°)
        # (0.03), and 1.2 s² of slopes over steps of 0.05 s differ from their derivative by less than 0.01.
        assert np.max(felt) < 0.17
    else:
        assert np.max(felt) > 3.0  # a car corners


def test_refusals(example, tmp_path, capsys):
    with pytest.raises(srt.InputError, match="no vehicle 'tram'"):
        example.trajectories.course_of("tram", 1.0, 100.0)
    with pytest.raises(srt.InputError, match="stood still"):
        example.trajectories.course_of("car", 0.5, 100.0)
    out = str(tmp_path / "out")
    for option in ("--units", "--minutes", "--rate"):
        assert example.navigation.main([option, "0", "--out", out]) == 2
        assert f"{option} is 0" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_without_python_ins_it_says_what_to_install(example, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyins", None)
    assert example.navigation.main(["--out", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "needs the package 'python-ins'" in printed.err
    assert "pip install 'strapdown-rotation-test[examples]'" in printed.err
    assert printed.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 3.0])
def test_delta_errors(example, angle):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    turn, start = sims.rotation(angle * axis), sims.rotation(np.array([0.4, -2.0, 1.0]))
    Deltas = example.preintegration.Deltas
    true = Deltas(start[None], np.zeros((1, 3)), np.ones((1, 3)))
    found = Deltas((start @ turn)[None], np.array([[0.0, 3.0, 4.0]]), np.array([[1.0, 1.0, 3.0]]))
    # Rounding of products of rotations.
    np.testing.assert_allclose(example.preintegration.delta_errors(found, true), [[angle, 5.0, 2.0]], atol=1e-15)


def test_tables(example):
    DriftResult = example.navigation.DriftResult
    time = np.linspace(0.0, 600.0, 31)
    outcome = DriftResult(time)
    for form, rate in zip(example.navigation.FORMS, (20.0, 10.0, 1.0, 4.0, 0.5), strict=True):
        outcome.drifts[form] = [factor * rate * time for factor in (0.9, 1.0, 1.3)]
        outcome.deltas[form] = [np.full((4, 3), rate)]
    text = example.drift_report.tables({("car", "tactical"): outcome}, [1.0, 10.0])
    assert "| car | tactical | 12 km | 6.0 km | 600 m | 2.4 km | 300 m |" in text
    assert "| car | tactical | 20 | 20 | 2.5 | 2.5 |" in text
    assert "| car | tactical | 20000 / 1000 / 500 | 20 / 1.0 / 0.50 | 20 / 1.0 / 0.50 |" in text


MICRO_G = 9.80665e-6


@pytest.mark.parametrize("name", ["aircraft", "car"])
def test_exact_readings_navigate_to_the_truth(example, name):
    pytest.importorskip("pyins")
    moving = example.trajectories.motion_of(example.trajectories.course_of(name, 2.0, 100.0))
    exact = example.navigation.increments_of(moving, (moving.angle, moving.velocity))
    for held in (True, False):
        time, drift = example.navigation.navigate(moving, exact, held_altitude=held)
        np.testing.assert_allclose(time, np.arange(0.0, 121.0, 20.0))
        # What navigator and course do to each other stays below an accelerometer error of 1 µg.
        assert np.all(drift <= 0.5 * MICRO_G * time**2 + 1e-8)
    pytest.importorskip("gtsam")
    starts = example.preintegration.segment_starts(moving, 20.0)
    assert starts == [3000, 5000, 7000, 9000, 11000]
    found = example.preintegration.preintegrate(exact, starts)
    errors = example.preintegration.delta_errors(found, example.preintegration.true_deltas(moving, starts))
    # Below a gyro error of 0.01 °/h and an accelerometer error of 1 µg over the 10 s.
    assert np.all(errors <= [math.radians(0.01 / 3600.0) * 10.0, MICRO_G * 10.0, 0.5 * MICRO_G * 100.0])


@pytest.mark.slow
def test_one_minute(example, tmp_path, capsys):
    pytest.importorskip("pyins")
    pytest.importorskip("gtsam")
    arguments = ["--minutes", "1", "--units", "1", "--grades", "navigation", "--vehicles", "car", "--out"]
    texts = []
    for folder in ("first", "second"):
        assert example.navigation.main([*arguments, str(tmp_path / folder)]) == 0
        texts.append((tmp_path / folder / "navigation-tables.md").read_text(encoding="utf-8"))
        assert capsys.readouterr().out == texts[-1] + "\n"
        assert (tmp_path / folder / "navigation-drift.png").stat().st_size < 150_000
    assert texts[0] == texts[1]
    ratio = float(texts[0].split("| car | navigation |")[2].split("|")[0])
    # Horizontal accelerometer biases of 1000 µg (one sigma), calibrated to better than 10 µg: a ratio below 10 asks
    # for both biases within 100 µg, one unit in 150.
    assert ratio > 10.0
