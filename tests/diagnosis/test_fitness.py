"""Fitness of a recording for a calibration, told in one line before any iteration."""

import json

import numpy as np
import pytest
from foreign_motion import GRADES, drawn_errors, hand_turns, recording
from scipy.spatial.transform import Rotation

import sims
import srt
from sims.physics.imu import ImuModel
from srt.diagnosis.staged_diagnosis import StagedDiagnosis
from srt.exceptions import DataError
from srt.result.verdict import FAILED
from srt.sensor_errors import SensorErrors

SEED = 20261128
GRAVITY = srt.Site(9.81)


def fitness(unit):
    staged = StagedDiagnosis(unit)
    staged.before_calibration()
    return staged.fitness()


def resting(hz, seconds, **more):
    """A consumer unit on a shelf, whose biases warm up over twenty minutes."""
    rng = np.random.default_rng((SEED, 1))
    time = np.arange(1, round(hz * seconds) + 1) / hz
    warm = -np.expm1(-time / 1200.0)[:, None]
    gyro = rng.normal(0.0, 2e-4, (len(time), 3)) + warm * [1e-3, -5e-4, 1.5e-3]
    accel = rng.normal(0.0, 5e-3, (len(time), 3)) + warm * [0.05, 0.1, -0.05] - [0.0, 0.0, 9.81]
    return srt.Recording(time, gyro, accel, GRAVITY, **more)


def driven(seconds=400.0, hz=50.0):
    """A unit in a car: stretches of 20 s with a turn about the vertical, and stops of 8 s with the engine running."""
    rng = np.random.default_rng((SEED, 2))
    time = np.arange(1, round(hz * seconds) + 1) / hz
    place = time % 28.0 - 8.0
    moving = place > 0.0
    turn = np.where((place > 7.0) & (place < 13.0), np.sin(np.pi * (place - 7.0) / 6.0) ** 2, 0.0)
    yaw = 0.5 * turn * np.sign(np.sin(time // 28.0 + 0.5))
    forward = np.where(moving, 2.0 * np.sin(2.0 * np.pi * place / 20.0), 0.0)
    shaken = np.where(moving, 1.0, 0.02)[:, None]
    gyro = rng.normal(0.0, 1.0, (len(time), 3)) * (2e-3 + 0.02 * moving[:, None]) + np.outer(yaw, [0.0, 0.0, 1.0])
    accel = np.stack([forward, 6.0 * yaw, np.full(len(time), -9.81)], axis=1)
    return srt.Recording(time, gyro, accel + shaken * rng.normal(0.0, 0.5, accel.shape), GRAVITY)


def tumbling(*, wandering):
    """A unit that turns about all axes all the time; wandering, it also turns at a nearly steady rate for seconds."""
    rng = np.random.default_rng(1 if wandering else (SEED, 5))
    time = np.arange(1, (20001 if wandering else 10001)) / 100.0
    phase = np.outer(time, [0.62, 0.94, 0.46]) + rng.uniform(0.0, 6.0, 3)
    if wandering:
        phase = np.cumsum(rng.normal(0.0, 0.05, (len(time), 3)), axis=0)
    rate = 1.5 * np.sin(phase - phase.mean(axis=0))
    angle = Rotation.from_rotvec(0.01 * rate)
    body = [Rotation.identity()]
    for step in angle:
        body.append(body[-1] * step)
    force = Rotation.concatenate(body[1:]).inv().apply([0.0, 0.0, -9.81])
    noise = rng.normal(0.0, 1.0, (2, len(time), 3))
    return srt.Recording(time, rate + 1e-3 * noise[0], force + 0.02 * noise[1], GRAVITY)


def turned(count):
    rng, grade = np.random.default_rng((SEED, 3)), GRADES["industrial"]
    return recording(hand_turns(rng, count=count, shortest_s=1.5), 5.0, drawn_errors(grade, rng), grade, rng)


LOGS = {
    "ten seconds": (lambda: resting(100.0, 10.0), "the unit rests in one attitude for 10 s, which shows noise"),
    "a warm-up": (
        lambda: resting(2.0, 4200.0, temperature=np.linspace(20.0, 70.0, 8400)),
        "the unit rests in one attitude for 70 min, at 20 to 70 °C, which shows noise",
    ),
    "a slow warm-up": (lambda: resting(1.0, 4200.0), "the log is too slow to follow a rotation"),
    "tumbling": (lambda: tumbling(wandering=False), "no turn lies between two rests of 1 s or more: record rests"),
    "wandering": (
        lambda: tumbling(wandering=True),
        "quiet windows the specific force turns by more than 6°, so that the unit never rests: record rests",
    ),
    "a drive": (driven, "as in a vehicle, which shows no scale factor: record rests in many attitudes"),
}


@pytest.mark.parametrize("log", LOGS)
def test_a_log_that_shows_no_scale_factor_is_not_calibrated(log):
    """No iteration runs; the sentence says what the log is."""
    make, said = LOGS[log]
    unit = make()
    assert said in str(fitness(unit))
    assert str(fitness(unit)).startswith("Fit to calibrate: no (")
    iterations = []
    with pytest.raises(DataError) as refused:
        srt.calibrate(unit, progress=lambda *step: iterations.append(step))
    assert iterations == []
    assert len(str(refused.value)) < 400
    if log == "a slow warm-up":
        assert "the unit rests in one attitude for 70 min, which shows no scale factor at any rate" in str(
            refused.value
        )
    else:
        assert str(refused.value) == f"{fitness(unit)}."


@pytest.mark.parametrize(("count", "word"), [(1, "no"), (6, "partly"), (18, "yes")])
def test_the_fitness_of_turns_by_hand_is_that_of_the_result(count, word):
    unit = turned(count)
    fit = fitness(unit)
    assert fit.word == word
    found = srt.calibrate(unit, force=True)
    assert (found.judgement.word == FAILED or bool(found.diagnostics.not_shown)) == (word != "yes")


@pytest.mark.parametrize("ids", [("1", "2", "3"), ("7", "8", "9", "13", "14"), tuple(str(n) for n in range(1, 15))])
def test_the_fitness_of_sequences_is_that_of_the_result(ids):
    rng = np.random.default_rng((SEED, 4))
    site = srt.Site(9.80665, latitude_rad=0.8)
    motion = sims.table1_motion(site=site, sequences=ids, sample_rate_hz=50.0, stated_fixture=srt.Fixture(0.0))
    imu = ImuModel(gyro_noise=1e-6, accel_noise=2e-4)
    unit = sims.read_out(motion, SensorErrors(rng.normal(0.0, 1e-3, 27)), imu, rng)
    fit = fitness(unit)
    found = srt.calibrate(unit)
    assert fit.word == ("partly" if found.diagnostics.not_shown else "yes")
    for name in found.diagnostics.not_shown or ():
        assert name.rsplit("_", 1)[0] in fit.reason


@pytest.mark.slow
def test_the_commands_begin_with_the_fitness(tmp_path, shell):
    for name, unit in (("by-hand", turned(18)), ("drive", driven())):
        srt.write_recording(unit, tmp_path / name, samples_format="npz")
    out, err = shell("calibrate", tmp_path / "by-hand")
    assert out.splitlines()[0] == "Fit to calibrate: yes"
    assert "Fit to calibrate" not in shell("calibrate", tmp_path / "by-hand", "-q").out
    out, err = shell("calibrate", tmp_path / "drive", code=1)
    assert out == ""
    assert err.startswith("srt: Fit to calibrate: no (in the ")
    assert err.count("\n") == 1
    out, err = shell("inspect", tmp_path / "drive", "-o", tmp_path / "drive.json")
    assert out.startswith("Fit to calibrate: no (in the ")
    fit = json.loads((tmp_path / "drive.json").read_text(encoding="utf-8"))["fit"]
    assert fit["word"] == "no"
    assert " ".join(out.split()).startswith(f"Fit to calibrate: no ({fit['reason']})")
