"""Errors over temperature from tests at soak points: true sigmas, use, files, and what cannot be used."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from soaked_units import SIZES, Unit, one_test

import sims
import srt
from srt.cli import main
from srt.exceptions import InputError
from srt.recording.writing import write_recording
from srt.result.json_file import require_format
from srt.result.provenance import Temperature
from srt.sensor_errors import N_PARAMETERS

LATER = (-15.0, 0.0, 10.0, 30.0, 52.0)
"""Temperatures of later visits: between the soak points, and one of them."""


@pytest.mark.parametrize("units", [12, pytest.param(120, marks=pytest.mark.slow)])
def test_sigmas_cover_later_visits(units):
    """Visits at and between the soak points, from a random side; sigmas are not idle either."""
    rng = np.random.default_rng(20261201)
    inside, sigma, error = [], [], []
    for _ in range(units):
        unit = Unit(rng)
        found = srt.calibrate_thermal(unit.tests(rng))
        for T in LATER:
            now = found.at(T)
            off = now.errors.vector - unit.errors(T, rng.choice([-1, 1]))
            inside.append(np.abs(off) < 1.96 * now.sigma)
            sigma.append(now.sigma / SIZES)
            error.append(off / SIZES)
    # The temperatures of a unit are nearly one sample; 95 % is the middle of what is asked, 92 to 98 %.
    share, spread = np.mean(inside), 3.5 * np.sqrt(0.05 * 0.95 / (units * N_PARAMETERS))
    assert 0.92 - spread < share < 0.98 + spread
    assert np.sqrt(np.mean(np.square(sigma)) / np.mean(np.square(error))) < 1.5


@pytest.fixture(scope="module")
def unit():
    rng = np.random.default_rng(20261202)
    drawn = Unit(rng)
    return drawn, srt.calibrate_thermal(drawn.tests(rng))


def test_a_curve_is_found_and_its_degree(unit):
    """The cubic terms of the largest groups are 20 sigma and more; a degree above what five tests show is not told."""
    drawn, found = unit
    thermal = found.thermal
    assert found.judgement.word == "sound"
    assert "those at 20.0 °C, the middle of the range" in " ".join(str(found).split())
    assert (thermal.lowest_c, thermal.highest_c) == (-20.0, 60.0)
    assert thermal.degree.max() <= 4
    assert np.median(thermal.degree[SIZES > 1e-3]) == 3
    # The constant and the linear term of the series, at the soak points' middle and ends.
    error = found.at(20.0).errors.vector - drawn.powers[0]
    assert np.all(np.abs(error) < 4.0 * found.at(20.0).sigma)


def test_readings_are_corrected_at_their_own_temperature(unit):
    _, found = unit
    rng = np.random.default_rng(3)
    gyro, accel = rng.normal(size=(400, 3)), 10.0 * rng.normal(size=(400, 3))
    for T in (np.repeat([-20.0, 7.125, 60.0, -3.0], 100), np.linspace(-20.0, 60.0, 400)):
        rate, force = found.apply(gyro, accel, temperature_c=T)
        for k in (0, 123, 399):
            expected = found.at(T[k]).apply(gyro[k], accel[k])
            np.testing.assert_allclose(rate[k], expected[0], atol=1e-6)
            np.testing.assert_allclose(force[k], expected[1], atol=1e-5)
    np.testing.assert_array_equal(found.apply(gyro, accel, temperature_c=7.0)[1], found.at(7.0).apply(gyro, accel)[1])


def test_beyond_the_range_values_are_refused_or_held_with_a_larger_sigma(unit):
    _, found = unit
    with pytest.raises(InputError, match=r"70\.0 °C, but the unit was calibrated at -20\.0 to 60\.0 °C"):
        found.at(70.0)
    held, end = found.at(70.0, clip=True), found.at(60.0)
    np.testing.assert_array_equal(held.errors.vector, end.errors.vector)
    assert np.all(held.sigma > end.sigma)
    with pytest.raises(InputError, match="The readings: "):
        found.apply(np.zeros((2, 3)), np.zeros((2, 3)), temperature_c=[10.0, 80.0])


def test_files_are_of_version_2_and_hold_the_curves(unit, tmp_path):
    _, found = unit
    found.save(tmp_path / "unit.json")
    document = json.loads((tmp_path / "unit.json").read_text(encoding="utf-8"))
    assert document["version"] == 2
    with pytest.raises(InputError, match="its version is 2, but this software reads version 1"):
        require_format(document, "calibration file", "srt-calibration", 1)  # as programs of version 1 say
    again = srt.load_calibration(tmp_path / "unit.json")
    for T in LATER:
        np.testing.assert_allclose(again.at(T).covariance, found.at(T).covariance, rtol=1e-12)
        np.testing.assert_array_equal(again.at(T).errors.vector, found.at(T).errors.vector)


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        (lambda t: t[:1], "At least two"),
        (lambda t: [t[0], replace(t[1], temperature=None)], "temperature of 2 is not known"),
        (lambda t: [t[0], replace(t[1], temperature=Temperature(-19.8, 0.0))], "All tests were at"),
    ],
)
def test_what_is_no_thermal_test_is_refused(change, fragment):
    tests = Unit(np.random.default_rng(5)).tests(np.random.default_rng(5))
    with pytest.raises(InputError, match=fragment):
        srt.calibrate_thermal(change(tests))


def test_uses_that_need_one_temperature_say_so(unit):
    _, found = unit
    for use in (found.require_values, lambda: found.apply(np.zeros(3), np.zeros(3)), lambda: srt.Applier(found)):
        with pytest.raises(InputError, match="depend on temperature"):
            use()
    with pytest.raises(InputError, match="of one temperature"):
        one_test().apply(np.zeros(3), np.zeros(3), temperature_c=20.0)


def test_from_tests_to_a_corrected_recording_on_the_command_line(tmp_path, capsys, monkeypatch):
    """Two recordings and a calibration, their curves, one temperature of them, and a recording that warms up."""
    monkeypatch.chdir(tmp_path)
    drawn, rng = Unit(np.random.default_rng(9)), np.random.default_rng(10)
    tests = drawn.tests(rng)
    for n, test in enumerate(tests):
        test.save(f"test-{n}.json")
    assert main(["thermal", *(f"test-{n}.json" for n in range(5)), "-o", "unit.json", "--plot", "curves.png"]) == 0
    out = capsys.readouterr().out
    assert Path("curves.png").read_bytes()[1:4] == b"PNG"
    assert "Curves over -20.0 to 60.0 °C from 5 tests." in out
    assert max(len(line) for line in out.splitlines()) <= 80
    assert main(["thermal", "unit.json", "--at", "25", "-o", "unit-25.json", "-q"]) == 0
    found = srt.load_calibration("unit.json")
    np.testing.assert_array_equal(srt.load_calibration("unit-25.json").errors.vector, found.at(25.0).errors.vector)
    assert main(["thermal", "unit.json", "--at", "90", "-q"]) == 2
    assert "90.0 °C, but the unit was calibrated" in capsys.readouterr().err
    n = 300
    warming = np.linspace(10.0, 30.0, n)
    recording = sims.simulate(sims.load_scenario("industrial-mems")).recording
    short = replace(
        recording, time=recording.time[:n], gyro=recording.gyro[:n], accel=recording.accel[:n], sequences=(),
        temperature=warming, data_sha256=None,
    )  # fmt: skip
    write_recording(short, tmp_path / "log")
    assert main(["apply", "unit.json", "log", "-o", "corrected", "--force", "-q"]) == 0
    corrected = srt.read(tmp_path / "corrected")
    expected = found.apply(short.gyro, short.accel, temperature_c=warming)
    np.testing.assert_allclose(corrected.accel, expected[1], rtol=1e-9, atol=1e-9)
    assert main(["certificate", "unit.json"]) == 2
    assert "depend on temperature" in capsys.readouterr().err
    assert main(["export", "unit.json", "--to", "kalibr"]) == 2
    assert "add --temperature T" in capsys.readouterr().err


def test_tests_of_one_name_are_refused_and_none_is_lost(tmp_path, capsys, monkeypatch):
    """Two folders "rec" in other folders have other names; the same folder twice is no second test."""
    tests = Unit(np.random.default_rng(5)).tests(np.random.default_rng(5))
    with pytest.raises(InputError, match="its own name: cold, warm, warm"):
        srt.calibrate_thermal(tests[:3], names=["cold", "warm", "warm"])
    monkeypatch.chdir(tmp_path)
    recording = replace(sims.simulate(sims.load_scenario("industrial-mems")).recording, data_sha256=None)
    for folder, T in (("cold", -5.0), ("warm", 40.0)):
        soaked = replace(recording, gyro=recording.gyro + 1e-9 * T, temperature=np.full(recording.time.size, T))
        write_recording(soaked, Path(folder) / "rec", samples_format="npz")
    assert main(["thermal", "cold/rec", "warm/rec"]) == 0
    assert "from 2 tests" in capsys.readouterr().out
    assert main(["thermal", "cold/rec", "cold/rec"]) == 2
    assert "named twice" in capsys.readouterr().err
