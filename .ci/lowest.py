"""Runs a core part of the tests against the lower bounds of pyproject.toml, and in installations without extras.

``python .ci/lowest.py`` (or ``make lowest``) makes one new virtual environment for each row of ``INSTALLATIONS``,
installs the project with every declared requirement at its lower bound, and runs the row's tests in it. Dependencies of
dependencies are as new as pip finds them. ``--only NAME`` runs one row, ``--keep FOLDER`` keeps the environments.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import tomllib
import venv
from dataclasses import dataclass
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
TEST_TOOLS = ("pytest", "pytest-xdist", "hypothesis", "sympy")


@dataclass(frozen=True)
class Installation:
    """Extras to install, packages that must be absent, and the tests to run."""

    extras: str
    absent: tuple[str, ...]
    tests: tuple[str, ...]


NUMPY_AND_SCIPY_TESTS = (
    "tests/model",
    "tests/mount",
    "tests/noise/test_accuracy_analysis.py",
    "tests/noise/test_bias_instability.py",
    "tests/noise/test_noise.py",
    "tests/estimation/test_accuracy.py",
    "tests/result",
    "tests/sequences/test_foreign_turns.py",
    "tests/sequences/test_stationary_windows.py",
)
INSTALLATIONS = {
    "lowest": Installation(
        "all",
        (),
        (
            "tests/model",
            "tests/noise",
            "tests/estimation",
            "tests/sequences",
            "tests/result",
            "tests/mount",
            "tests/recording",
            "tests/estimators/test_joint_agreement.py",
            "tests/comparison",
        ),
    ),
    "core": Installation("", ("gtsam", "filterpy", "pydantic", "h5py", "matplotlib"), NUMPY_AND_SCIPY_TESTS),
    "no-gtsam": Installation("cli,ekf,io,plot,sims", ("gtsam",), ("tests/estimators", "tests/comparison")),
    "no-filterpy": Installation("cli,graph,io,plot,sims", ("filterpy",), ("tests/estimators", "tests/comparison")),
}


def lower_bounds() -> list[str]:
    """Every requirement of pyproject.toml, pinned to its lower bound: lines of a constraints file."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    texts = [*project["dependencies"], *(t for extra in project["optional-dependencies"].values() for t in extra)]
    pins = set()
    for requirement in map(Requirement, texts):
        if requirement.name == project["name"]:
            continue
        bounds = [part.version for part in requirement.specifier if part.operator == ">="]
        if len(bounds) != 1:
            raise SystemExit(f"pyproject.toml: {requirement} has {len(bounds)} lower bounds, one is expected")
        pins.add(f"{requirement.name}=={bounds[0]}")
    return sorted(pins)


def run(*command: object) -> int:
    """Run a command in the root of the project and give its exit code."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    print("$", *command, flush=True)
    done = subprocess.run([str(part) for part in command], cwd=ROOT, env=environment, check=False)  # noqa: S603
    return done.returncode


def check(name: str, folder: Path) -> bool:
    """Make the environment of an installation in a folder and run its tests; True if all pass."""
    wanted = INSTALLATIONS[name]
    venv.create(folder, clear=True, with_pip=True, symlinks=os.name != "nt")
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    pins = folder / "lower-bounds.txt"
    pins.write_text("\n".join(lower_bounds()) + "\n", encoding="utf-8")
    project = f".[{wanted.extras}]" if wanted.extras else "."
    if run(python, "-m", "pip", "install", "--quiet", "-c", pins, "-e", project, *TEST_TOOLS):
        return False
    absent = f"import importlib.util as u, sys; sys.exit(any(u.find_spec(m) for m in {wanted.absent!r}))"
    if run(python, "-c", absent):
        print(f"{name}: one of {', '.join(wanted.absent)} is installed", file=sys.stderr)
        return False
    # Old packages may use what a newer dependency of theirs deprecates.
    return run(python, "-m", "pytest", "-q", "-n", "2", "-W", "default::DeprecationWarning", *wanted.tests) == 0


def main() -> int:
    """Check the installations and give the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", choices=list(INSTALLATIONS))
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    arguments = parser.parse_args()
    names = arguments.only or INSTALLATIONS
    with tempfile.TemporaryDirectory() as scratch:
        failed = [name for name in names if not check(name, (arguments.keep or Path(scratch)) / name)]
    print("failed: " + ", ".join(failed) if failed else "all installations pass")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
