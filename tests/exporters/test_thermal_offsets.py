"""Offsets over temperature in the parameters of PX4 and ArduPilot: their own formulas, real sets, what is left out."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from soaked_units import Unit

import srt
from srt.cli import main
from srt.exceptions import InputError
from srt.exporters.thermal_offsets import OffsetCurves, read_ardupilot, read_px4, thermal_file, write_ardupilot
from srt.sensor_errors import GROUP_SLICES

DATA = Path(os.environ.get("SRT_RECORDED_DATA", Path(__file__).parents[3] / "shared" / "data"))
SETS = DATA / "thermal" / "ins_tcal_sets.json"
TEMPERATURES = np.linspace(-20.0, 60.0, 33)


@pytest.fixture(scope="module")
def unit():
    rng = np.random.default_rng(20261203)
    return srt.calibrate_thermal(Unit(rng).tests(rng))


def values(text):
    """Numbers of a parameter file in single precision, by name, as the autopilots have them."""
    lines = [re.split(r"[\t,]", line) for line in text.splitlines() if not line.startswith("#")]
    return {(row[2] if len(row) == 5 else row[0]): np.float32(row[3] if len(row) == 5 else row[1]) for row in lines}


def px4(p, T, sensor):
    """Offset of PX4: X0 + X1 Δ + X2 Δ² + X3 Δ³ plus CAL_*_OFF."""
    name, cal = (f"TC_{'G' if sensor == 'gyro' else 'A'}0", "GYRO" if sensor == "gyro" else "ACC")
    delta = min(max(T, p[f"{name}_TMIN"]), p[f"{name}_TMAX"]) - p[f"{name}_TREF"]
    return np.array([
        sum(float(p[f"{name}_X{j}_{axis}"]) * float(delta) ** j for j in range(4)) + float(p[f"CAL_{cal}0_{letter}OFF"])
        for axis, letter in enumerate("XYZ")
    ])  # fmt: skip


def ardupilot(p, T, sensor):
    """Offset of ArduPilot: P(clip(T) − 35) − P(clip(CALTEMP) − 35) plus the offset."""
    key = "GYR" if sensor == "gyro" else "ACC"
    low, high = float(p["INS_TCAL1_TMIN"]), float(p["INS_TCAL1_TMAX"])
    now, then = (float(np.clip(x, low, high)) - 35.0 for x in (T, p[f"INS_{key}1_CALTEMP"]))
    return np.array([
        sum(1e-6 * float(p[f"INS_TCAL1_{key}{j}_{axis}"]) * (now**j - then**j) for j in (1, 2, 3))
        + float(p[f"INS_{key}OFFS_{axis}"])
        for axis in "XYZ"
    ])  # fmt: skip


@pytest.mark.parametrize(("target", "formula"), [("px4", px4), ("ardupilot", ardupilot)])
def test_the_autopilots_own_formula_reproduces_the_curves(unit, target, formula):
    """To the printed residual: what a cubic does not follow, and single precision."""
    made = thermal_file(unit, target)
    found = values(made.text)
    for s, sensor in enumerate(("gyro", "accel")):
        for T in (*TEMPERATURES, -40.0, 80.0):
            inside = float(np.clip(T, -20.0, 60.0))
            expected = unit.thermal.values(inside)[GROUP_SLICES[f"{sensor}_bias"]]
            off = np.abs(formula(found, T, sensor) - expected)
            # Between the temperatures of the table: a fraction of the residual.
            assert np.all(off <= 1.02 * made.residual[s] + 1e-9), (T, off, made.residual[s])
    # The fourth order of curves that are cubic is noise: within their sigmas.
    assert np.all(made.residual[1] < unit.at(20.0).sigma[GROUP_SLICES["accel_bias"]])
    assert np.any(made.step > 0.0) == (target == "px4")
    assert np.all(made.lost > 0.0)
    read = {"px4": read_px4, "ardupilot": read_ardupilot}[target](made.text)
    np.testing.assert_array_equal(read.at(TEMPERATURES), made.curves.at(TEMPERATURES))


@pytest.mark.skipif(not SETS.exists(), reason="the recorded sets are not part of the project")
def test_real_sets_are_read_and_written_to_single_precision():
    for number, given in enumerate(json.loads(SETS.read_text(encoding="utf-8"))):
        text = "".join(f"INS_TCAL1_{key},{value!r}\n" for key, value in given.items())
        text += "".join(f"INS_{key}1_CALTEMP,35\n" for key in ("GYR", "ACC"))
        text += "".join(f"INS_{key}OFFS_{axis},0.5\n" for key in ("GYR", "ACC") for axis in "XYZ")
        curves = read_ardupilot(text)
        again = values(write_ardupilot(curves))
        for key, value in given.items():
            if key != "ENABLE":
                assert again[f"INS_TCAL1_{key}"] == np.float32(value), (number, key)
        for T in (given["TMIN"], 20.0, given["TMAX"]):
            for s, sensor in enumerate(("gyro", "accel")):
                # CALTEMP moves to the nearer end where 35 °C is outside: the same curve by other numbers.
                np.testing.assert_allclose(ardupilot(again, T, sensor), curves.at(T)[s], rtol=1e-5, atol=1e-6)


def test_files_that_lack_a_parameter_and_other_targets_are_refused(unit, tmp_path, capsys):
    text = thermal_file(unit, "px4").text
    with pytest.raises(InputError, match="no TC_G0_X2_1 in the file"):
        read_px4(text.replace("TC_G0_X2_1", "TC_G0_X9_1"))
    unit.save(tmp_path / "unit.json")
    assert main(["export", str(tmp_path / "unit.json"), "--to", "kalibr"]) == 2
    assert "add --temperature T" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "unit.json"), "--to", "kalibr", "--temperature", "21", "-q"]) == 0
    place = tmp_path / "tc.params"
    assert main(["export", str(tmp_path / "unit.json"), "--to", "px4", "-o", str(place)]) == 0
    assert "Not held: scale factors" in capsys.readouterr().out
    assert place.read_text(encoding="utf-8") == text


def test_offsets_are_constant_outside_the_range():
    curves = OffsetCurves(0.0, 40.0, 20.0, np.ones((2, 4, 3)))
    np.testing.assert_array_equal(curves.at(-5.0), curves.at(0.0))
    np.testing.assert_array_equal(curves.at(np.array([41.0, 90.0]))[:, 0], curves.at(40.0))
