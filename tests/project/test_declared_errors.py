"""A further sensor error is a row of one list: the copy of the package here has two groups of three more."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
ROWS = """\
    ParameterGroup(
        "accel_quadratic", _AXES, ("λxx2", "λyy2", "λzz2"), "s^2/m", "µg/g²", 1e6 * _G, lambda f: _each(f**2),
        1.0 / _G, 1e-3, 1e-3, "poses at many inclinations", "accel\\nquadr.", 1e-6, True, "accel_quadratic * v^2",
    ),
    ParameterGroup(
        "gyro_cubic", _AXES, ("κx3", "κy3", "κz3"), "s^2", "ppm s²", 1e6, lambda w: _each(w**3),
        1.0, 1e-3, 1e-3, "turns at many rates", "gyro\\ncubic", 1e-6, True, "gyro_cubic * v^3",
    ),
"""
EFFECT = """\
def _each(values):
    return values[..., None] * np.eye(3)


"""
CHILD = """\
import json, sys
from dataclasses import replace
from pathlib import Path
import numpy as np
import sims, srt
from srt.exporters.conversion import export
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.result.applier import Applier
from srt.sensor_errors import GROUP_SLICES, NAMES

folder = Path(sys.argv[1])
simulated = sims.simulate(sims.load_scenario("free-mems"))
truth = np.array(simulated.truth.vector)
truth[GROUP_SLICES["accel_quadratic"]] = 2e-4, -3e-4, 1e-4
truth[GROUP_SLICES["gyro_cubic"]] = 5e-4, -4e-4, 3e-4
rate = gyro_triad(simulated.truth).compensate(simulated.recording.gyro)
force = accel_triad(simulated.truth).compensate(simulated.recording.accel)
recording = replace(
    simulated.recording,
    gyro=simulated.recording.gyro + rate**3 * truth[GROUP_SLICES["gyro_cubic"]],
    accel=simulated.recording.accel + force**2 * truth[GROUP_SLICES["accel_quadratic"]],
    data_sha256=None,
)
found = {name: srt.calibrate(recording, name) for name in ("least-squares", "ekf", "graph")}
first = found["least-squares"]
first.save(folder / "unit.json")
loaded = srt.load_calibration(folder / "unit.json")
exact = replace(loaded, errors=type(loaded.errors)(truth))
model, true = (gyro_triad(exact.errors), accel_triad(exact.errors)), np.random.default_rng(1).normal(size=(2, 500, 3))
readings = model[0].read(true[0]) + true[1] @ exact.g_sensitivity.T, model[1].read(true[1])
applied = exact.apply(*readings)
single = Applier(exact).apply_sample(readings[0][7], readings[1][7])
fixture = sims.simulate(sims.load_scenario("industrial-mems"))
closed = srt.calibrate(fixture.recording, "closed-form")
print(json.dumps({
    "names": NAMES,
    "off": {name: ((c.errors.vector - truth) / c.sigma).tolist() for name, c in found.items()},
    "words": {name: c.judgement.word for name, c in found.items()},
    "text": str(first),
    "file": json.loads((folder / "unit.json").read_text()),
    "loaded": bool(np.array_equal(loaded.errors.vector, first.errors.vector)),
    "applied": float(np.abs(np.array(applied) - true).max()),
    "single": float(np.abs(np.array(single) - true[:, 7]).max()),
    "losses": {target: export(first, target).losses for target in ("kalibr", "ros2", "c-header", "gtsam")},
    "certificate": str(srt.certificate(folder / "unit.json")),
    "closed": [closed.judgement.word, closed.fixed],
    "figure": len(srt.plot(first).axes),
}))
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("declared")
    shutil.copytree(ROOT / "srt", folder / "srt", ignore=shutil.ignore_patterns("__pycache__"))
    path = folder / "srt" / "sensor_errors.py"
    text = path.read_text(encoding="utf-8")
    last = '    ParameterGroup(\n        "gyro_bias"'
    assert text.count(last) == text.count("def _place(") == 1
    text = text.replace(last, ROWS + last).replace("def _place(", EFFECT + "def _place(")
    path.write_text(text, encoding="utf-8")
    (folder / "child.py").write_text(CHILD, encoding="utf-8")  # its folder comes before all others on the path
    done = subprocess.run(
        [sys.executable, folder / "child.py", folder],
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_it_is_estimated_by_all_joint_estimators(made):
    for name, off in made["off"].items():
        assert len(off) == 33
        # 33 normals, family-wise 1 %
        assert np.abs(off).max() < 3.6, name
    assert set(made["words"].values()) == {"sound"}


def test_it_is_printed_saved_loaded_and_certified(made):
    for name in ("accel_quadratic_x", "gyro_cubic_z"):
        assert name in made["text"]
        assert name.replace("_", " ") in made["certificate"]
        assert name in [row["name"] for row in made["file"]["parameters"]]
    assert "Readings have gyro_cubic * v^3 besides." in made["file"]["formula"]
    assert made["loaded"]


def test_each_unit_of_its_errors_has_panels_in_the_figure(made):
    assert made["figure"] == 2 * (4 + 2) + 2  # values and sigmas of six units, convergence and residuals


def test_readings_are_corrected_to_rounding(made):
    assert max(made["applied"], made["single"]) < 1e-14


def test_formats_without_it_say_so(made):
    for losses in made["losses"].values():
        assert {"accel quadratic", "gyro cubic"} <= set(losses)


def test_the_closed_form_has_no_formula_of_it(made):
    word, fixed = made["closed"]
    assert word == "sound"
    assert [name for name in made["names"] if name in fixed] == made["names"][24:30]
    assert set(fixed.values()) == {"the closed form has no formula of it; taken as zero"}
