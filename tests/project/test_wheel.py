"""The wheel, installed beside numpy and scipy alone: it is complete, it loads, applies and calibrates.

``tests/data/calibration-v1.json`` is a file of format version 1 as version 0.1.0 writes it, but for its line breaks: 26
parameters of rounded numbers, one held, and U the identity.
"""

import email
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import sims
import srt
from srt.recording.recording import Fixture, Site

ROOT = Path(__file__).parents[2]
PACKAGES = {"srt": "srt", "estimators": "estimators", "sims": "sims", "configs": "sims/configs"} | {
    "configs/protocol": "srt/protocols"
}
"""Folders of the tree, and where the wheel has them."""
FILES = ("strapdown_srt.py", "pyproject.toml", "README.md", "LICENSE", "MANIFEST.in", "CHANGELOG.md", "CITATION.cff")
"""Files beside these folders of which a distribution is built; the first is in the wheel."""
OF_TESTS = ("tests", "benchmarks", "docs", "examples", "packaging")
"""Folders that only the source distribution has, which the tests need."""
COMMANDS = ("srt", "strapdown-srt")
CALIBRATION = ROOT / "tests" / "data" / "calibration-v1.json"
ALONE = ("numpy", "scipy")
OLDEST_SETUPTOOLS = 77

APPLY = """
import json, sys, sysconfig
from pathlib import Path
import numpy as np
import srt
calibration = srt.load_calibration(sys.argv[1])
readings = np.load(sys.argv[2])
gyro, accel = calibration.apply(readings["gyro"], readings["accel"])
np.savez(sys.argv[3], gyro=gyro, accel=accel)
site = Path(sysconfig.get_path("purelib"))
files = [Path(m.__file__) for m in sys.modules.values() if getattr(m, "__file__", None)]
print(json.dumps(sorted({f.relative_to(site).parts[0] for f in files if f.is_relative_to(site)})))
"""
CALIBRATE = """
import sys
import srt
srt.calibrate(srt.load_recording(sys.argv[1])).save(sys.argv[2])
"""


def run(*arguments: object) -> str:
    """Run a program without what the environment of the tests would add, and give its output."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [str(a) for a in arguments], env=environment, capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def source(tmp_path_factory):
    """Copy of the tree: what an earlier build left in it must not get into a distribution."""
    source = tmp_path_factory.mktemp("source")
    for name in (*PACKAGES, *OF_TESTS):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True)
    for name in FILES:
        shutil.copy(ROOT / name, source)
    return source


def build_wheel(source, out):
    """Build a wheel from a folder or a source distribution."""
    # setuptools of the environment where it is new enough, that no index is needed; else pip fetches one to build with.
    here = int(version("setuptools").partition(".")[0]) >= OLDEST_SETUPTOOLS
    isolation = ["--no-build-isolation"] if here else []
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", *isolation, "-w", out, source)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="session")
def wheel(source, tmp_path_factory):
    return build_wheel(source, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def sdist(source, tmp_path_factory):
    """Build the source distribution."""
    if int(version("setuptools").partition(".")[0]) < OLDEST_SETUPTOOLS:
        pytest.skip("setuptools is too old to build here")
    out = tmp_path_factory.mktemp("sdist")
    code = (
        f"import os; os.chdir({str(source)!r}); from setuptools import build_meta; build_meta.build_sdist({str(out)!r})"
    )
    run(sys.executable, "-c", code)
    (built,) = out.glob("*.tar.gz")
    return built


def site_packages(python: Path) -> Path:
    return Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())


def new_environment(folder: Path) -> Path:
    """Make an environment without any package, pip included, and give its interpreter."""
    venv.create(folder, symlinks=os.name != "nt")
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


@pytest.fixture(scope="session")
def alone(wheel, tmp_path_factory):
    """Give the interpreter of an environment that holds the wheel, numpy and scipy as they are installed here."""
    python = new_environment(tmp_path_factory.mktemp("alone"))
    run(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-index", "--no-deps", wheel)
    site, here = site_packages(python), Path(sysconfig.get_path("platlib"))
    for name in ALONE:
        for part in (name, f"{name}.libs"):
            if (here / part).exists():
                (site / part).symlink_to(here / part, target_is_directory=True)
    return python


def test_the_wheel_holds_all_modules_and_data_of_the_tree(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    wanted = {
        f"{place}/{path.relative_to(ROOT / folder).as_posix()}"
        for folder, place in PACKAGES.items()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert held == {*wanted, FILES[0]}


@pytest.mark.slow
def test_the_source_distribution_has_the_tests_and_builds_the_same_wheel(source, sdist, wheel, tmp_path):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert sdist.name == f"strapdown_rotation_test-{project['version']}.tar.gz"
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"PKG-INFO", *FILES} <= names
    assert {path.relative_to(source).as_posix() for name in OF_TESTS for path in (source / name).rglob("*")} <= names
    again = build_wheel(sdist, tmp_path)

    def held(path: Path) -> dict[str, bytes]:
        with zipfile.ZipFile(path) as built:
            return {name: built.read(name) for name in built.namelist() if not name.endswith("/RECORD")}

    assert held(again) == held(wheel)


def test_its_metadata_is_ready_for_an_index(wheel):
    """Fields that an index shows, and no addresses."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        text = archive.read(name).decode()
    metadata = email.message_from_string(text)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert metadata["Name"] == project["name"]
    assert metadata["Version"] == project["version"]
    assert metadata["Summary"] == project["description"]
    assert metadata["Requires-Python"] == project["requires-python"]
    assert metadata["License-Expression"] == "MIT"
    assert metadata["License-File"] == "LICENSE"
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata.get_all("Classifier") == project["classifiers"]
    assert metadata.get_payload().startswith("# ")
    for address in ("Home-page", "Download-URL", "Project-URL", "Author", "Author-email"):
        assert metadata[address] is None
    assert project["classifiers"] == sorted(project["classifiers"])


def test_the_conda_recipe_follows_the_project():
    """The recipe itself is not run: conda-build is not among the tools of the tests."""
    yaml = pytest.importorskip("yaml")
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "meta.yaml").read_text(encoding="utf-8"))
    whole = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = whole["project"]
    assert recipe["package"] == {"name": project["name"], "version": project["version"]}
    assert recipe["source"]["path"].endswith(f"/strapdown_rotation_test-{project['version']}.tar.gz")
    wanted = {f"python {project['requires-python']}", *(each.replace(">=", " >=") for each in project["dependencies"])}
    assert set(recipe["requirements"]["run"]) == wanted
    (backend,) = whole["build-system"]["requires"]
    assert set(recipe["requirements"]["host"]) == {
        f"python {project['requires-python']}",
        "pip",
        backend.replace(">=", " >="),
    }
    assert recipe["build"]["entry_points"] == [f"{name} = {place}" for name, place in project["scripts"].items()]
    assert recipe["about"] == {
        "summary": project["description"],
        "license": project["license"],
        "license_file": "LICENSE",
    }


def test_the_version_is_one():
    """A source tree whose version has changed since it was installed has the old one in its metadata."""
    number = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert srt.__version__ == version("strapdown-rotation-test")
    assert f'\nversion: "{number}"\n' in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert changes.split("\n## ")[1].splitlines()[0] == number


def readings_of(document: dict, rate: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Readings of the unit of a calibration file, written out from the file's formula."""
    p = {row["name"]: row["value"] for row in document["parameters"]}

    def of(group: str) -> np.ndarray:
        return np.array([p[f"{group}_{axis}"] for axis in "xyz"])

    xy, yz, zx = (p[f"gyro_orthogonality_{pair}"] / 2 for pair in ("xy", "yz", "zx"))
    Mg = np.eye(3) + np.diag(of("gyro_scale")) + np.array([[0, xy, zx], [xy, 0, yz], [zx, yz, 0]])
    Ma = np.eye(3) + np.diag(of("accel_scale"))
    for pair in ("xy", "xz", "yx", "yz", "zx", "zy"):
        Ma["xyz".index(pair[0]), "xyz".index(pair[1])] += p[f"accel_misalignment_{pair}"]
    gyro = rate @ Mg.T + of("gyro_asymmetry") * np.abs(rate) + of("gyro_bias")
    accel = force @ Ma.T + of("accel_asymmetry") * np.abs(force) + of("accel_bias")
    return gyro, accel


def assert_loads_and_applies(python: Path, folder: Path) -> None:
    rng = np.random.default_rng(3)
    rate, force = rng.uniform(-2.0, 2.0, (200, 3)), rng.uniform(-12.0, 12.0, (200, 3))
    gyro, accel = readings_of(json.loads(CALIBRATION.read_text(encoding="utf-8")), rate, force)
    np.savez(folder / "raw.npz", gyro=gyro, accel=accel)
    names = (CALIBRATION, folder / "raw.npz", folder / "corrected.npz")
    assert {"srt", "numpy"} <= set(json.loads(run(python, "-I", "-c", APPLY, *names))) <= {"srt", *ALONE}
    with np.load(folder / "corrected.npz") as corrected:
        # A dozen operations each way on numbers up to 12 times 1.01, with matrices within 2 % of the identity.
        np.testing.assert_allclose(corrected["gyro"], rate, rtol=0, atol=64 * 2 * np.finfo(float).eps)
        np.testing.assert_allclose(corrected["accel"], force, rtol=0, atol=64 * 12 * np.finfo(float).eps)


@pytest.mark.slow
def test_it_loads_and_applies_beside_numpy_and_scipy_alone(alone, tmp_path):
    assert_loads_and_applies(alone, tmp_path)


def test_it_calibrates_beside_numpy_and_scipy_alone(alone, tmp_path):
    """The same recording gives the same result as here, where everything is installed."""
    motion = sims.table1_motion(site=Site(9.80665, latitude_rad=0.7), dwell_s=2.0, sample_rate_hz=50.0)
    recording = sims.read_out(motion, srt.SensorErrors.from_dict({"gyro_scale_x": 1e-3, "accel_bias_y": 0.01}))
    assert recording.fixture == Fixture()
    srt.write_recording(recording, tmp_path / "recording", samples_format="npz")
    run(alone, "-I", "-c", CALIBRATE, tmp_path / "recording", tmp_path / "unit.json")
    there, here = (
        srt.load_calibration(tmp_path / "unit.json"),
        srt.calibrate(srt.load_recording(tmp_path / "recording")),
    )
    assert there.status == here.status == "converged"
    # Converged to 1e-9 of scale or angle; the order of sums may differ with the threads of linear algebra.
    np.testing.assert_allclose(there.errors.vector, here.errors.vector, rtol=0, atol=1e-8)


def refused(command: list[object], **variables: str) -> str:
    """Run a command that is to end with exit code 2 and one sentence, and give the sentence."""
    environment = {**os.environ, **variables}
    done = subprocess.run(list(map(str, command)), env=environment, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    return done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_its_command_line_says_what_to_install(alone, name):
    script = alone.with_name(f"{name}.exe" if os.name == "nt" else name)
    assert "pip install 'strapdown-rotation-test[cli]'" in refused([script, "--help"])


@pytest.mark.parametrize("name", COMMANDS)
def test_its_command_line_says_which_other_module_is_named_srt(alone, name, tmp_path):
    """A module before site-packages on the path hides the package, as the subtitle library of a user does."""
    (tmp_path / "srt.py").write_text("raise SystemExit('This is not to be run.')\n")
    script = alone.with_name(f"{name}.exe" if os.name == "nt" else name)
    said = refused([script, "--help"], PYTHONPATH=str(tmp_path))
    assert str(tmp_path / "srt.py") in said
    assert str(site_packages(alone) / "srt") in said
    assert "pip uninstall srt" in said


def test_a_module_beside_the_package_hides_nothing(alone):
    """The subtitle library in the same site-packages: a package comes before a module."""
    other = site_packages(alone) / "srt.py"
    other.write_text("raise SystemExit('This is not to be run.')\n")
    try:
        for command in ([alone.with_name("strapdown-srt")], [alone, "-m", "strapdown_srt"]):
            assert "pip install 'strapdown-rotation-test[cli]'" in refused([*command, "--help"])
    finally:
        other.unlink()


@pytest.mark.slow
def test_an_installer_needs_nothing_but_numpy_and_scipy(wheel, tmp_path):
    """An installation from an index, as a user makes it, holds numpy and scipy and nothing else."""
    python = new_environment(tmp_path / "environment")
    constraints = ROOT / "constraints.txt"
    run(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "-c", constraints, wheel)
    listed = json.loads(run(sys.executable, "-m", "pip", "--python", python, "list", "--format", "json"))
    assert {package["name"] for package in listed} == {"strapdown-rotation-test", *ALONE}
    assert_loads_and_applies(python, tmp_path)
