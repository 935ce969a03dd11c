"""Dependencies of the code, and the table of mutations."""

import ast
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest
from mutations import SUBJECTS, mutations_of
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
OWN = {"srt", "estimators", "sims"}
DISTRIBUTIONS = {
    "backports": "backports.zstd",
    "cv2": "opencv-python-headless",
    "fpdf": "fpdf2",
    "pyins": "python-ins",
    "markdown_it": "markdown-it-py",
    "tomli_w": "tomli-w",
    "yaml": "pyyaml",
}
"""Names of distributions that differ from the name of the import."""
LATER_STANDARD_LIBRARY = {"compression"}
"""Modules of the standard library of Python 3.14, imported where they exist."""
EXTRAS = {
    "srt": (),
    "srt/cli": ("cli",),
    "srt/comparison": ("campaign", "cluster"),
    "srt/estimation": ("ekf",),
    "srt/exporters": ("formats", "graph"),
    "srt/model": ("fast",),
    "srt/noise": ("allan",),
    "srt/recording": ("io", "formats"),
    "srt/reports": ("pandas",),
    "srt/reports/certificate": ("report",),
    "srt/reports/figures": ("plot",),
    "srt/stacks": ("graph", "formats"),
    "estimators": ("ekf", "graph"),
    "sims": (),
    "sims/robustness": ("campaign",),
    "sims/scenarios": ("sims",),
    "benchmarks": ("dev",),
    "examples": ("examples",),
    "tests": ("dev",),
}
"""Extras that a folder may import, in addition to the dependencies of the core; the longest matching folder counts."""


@cache
def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@cache
def declared(extra: str) -> frozenset[str]:
    """Distributions of an extra and of the extras that it names; the core's for an empty name."""
    lines = project()["optional-dependencies"][extra] if extra else project()["dependencies"]
    out = set()
    for requirement in map(Requirement, lines):
        if requirement.name == project()["name"]:
            out |= set().union(*map(declared, requirement.extras))
        else:
            out.add(requirement.name.lower())
    return frozenset(out)


def imported(path: Path) -> set[str]:
    """Top-level names that a file imports anywhere, by name in a string included."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add(node.module)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called in {"import_module", "importorskip"} and isinstance(node.args[0].value, str):
                names.add(node.args[0].value)
    return {name.partition(".")[0] for name in names}


def folder_of(path: Path) -> str:
    place = path.relative_to(ROOT).as_posix()
    return max((folder for folder in EXTRAS if place.startswith(f"{folder}/")), key=len)


FILES = [path for top in sorted({f.partition("/")[0] for f in EXTRAS}) for path in sorted((ROOT / top).rglob("*.py"))]
HELPERS = {"injected_faults"} | {
    path.stem for path in FILES if path.relative_to(ROOT).parts[0] in {"tests", "benchmarks", "examples"}
}
"""Modules of tests, benchmarks and examples, which import each other by their own names."""


@pytest.mark.parametrize("folder", EXTRAS)
def test_imports_are_declared(folder):
    allowed = declared("").union(*map(declared, EXTRAS[folder]))
    inside = [path for path in FILES if folder_of(path) == folder]
    assert inside
    for path in inside:
        others = imported(path) - OWN - set(sys.stdlib_module_names) - LATER_STANDARD_LIBRARY
        if folder in {"tests", "benchmarks", "examples"}:
            others -= HELPERS
        missing = {name for name in others if DISTRIBUTIONS.get(name, name).lower() not in allowed}
        assert not missing, f"{path.relative_to(ROOT)} imports {missing}, which {EXTRAS[folder]} do not declare"


def test_an_undeclared_import_is_found(tmp_path):
    file = tmp_path / "module.py"
    file.write_text("def f():\n    import lz4.frame\n    pytest.importorskip('ruamel.yaml')\n")
    assert imported(file) == {"lz4", "ruamel"}
    assert not {"lz4", "ruamel"} & declared("dev")


def modules_imported(module, path, known):
    """Modules of this distribution that a file imports anywhere, for type checking included."""
    out = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            out |= (inside & known) or {node.module}
    return (out & known) - {module}


def test_no_two_files_import_each_other():
    """No circle of imports, type checking included: files that import only files already sorted are sorted next."""
    paths = [path for top in ("srt", "estimators", "sims") for path in (ROOT / top).rglob("*.py")]
    names = {path: path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".") for path in paths}
    names = {path: name.removesuffix(".__init__") for path, name in names.items()}
    left = {name: modules_imported(name, path, set(names.values())) for path, name in names.items()}
    while ready := {name for name, imports in left.items() if not imports & left.keys()}:
        left = {name: imports for name, imports in left.items() if name not in ready}
    assert not left


def test_injected_faults_share_no_mathematics_with_the_estimators():
    """Import rules see the installed packages only."""
    files = sorted((ROOT / "tests/injected_faults").glob("*.py"))
    inside = {
        node.module
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(("srt", "estimators"))
    }
    allowed = (
        "srt.constants",
        "srt.estimation.options",
        "srt.exceptions",
        "srt.recording",
        "srt.sensor_errors",
        "srt.types",
    )
    assert len(files) > 5
    assert {name for name in inside if not name.startswith(allowed)} == set()


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_every_mutation_is_a_change_of_one_place(subject):
    """Mutants are Python, differ from the source, and from one another; the tests that must notice them exist."""
    source = (ROOT / subject.file).read_text(encoding="utf-8")
    mutants = [mutation.apply(source) for mutation in mutations_of(subject, source)]
    if not mutants:
        assert subject.functions == ["*"]  # a module without a sign
    for mutant in mutants:
        ast.parse(mutant)
    assert len({source, *mutants}) == len(mutants) + 1
    assert all((ROOT / test.split("::")[0]).exists() for test in subject.tests)
