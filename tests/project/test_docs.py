"""Pages of the documentation, its notebook and its pictures."""

import importlib
import os
import re
import shutil
from itertools import pairwise
from pathlib import Path

import click
import matplotlib as mpl
import numpy as np
import pictures
import pytest
import sympy as sp
from matplotlib.image import imread
from test_errata_papers import BIAS_EFFECTS

import sims
import srt
from sims.scenarios import plan_file, scenario
from sims.scenarios.toml_table import LibraryTable
from srt.cli.app import app
from srt.recording import schema
from srt.result.calibration import STATUSES

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TEXTS = {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in [*PAGES, *ROOT.glob("*.md")]}
COMMAND = re.compile(r"(?:`|^    |^\$ )srt ([a-z][a-z-]*)((?:\\\n|[^`\n])*)", re.M)
LINK = re.compile(r"\[[^]\n]*\]\(([^)\s]+)\)")
DOTTED = re.compile(r"\b(?:srt|sims|estimators)(?:\.(?!(?:md|html|toml|json|py)\b)[A-Za-z_]\w*)+")
"""Dotted names of modules, classes and functions."""
PATH = re.compile(r"(?<![\w/])(?:srt|sims|estimators|benchmarks|tests|examples|configs)/[\w./-]*\w")
"""Paths of files and folders of the repository."""


def anchors(text):
    """Anchors of the headings of a page, as GitHub and MyST make them."""
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    titles = re.findall(r"^#+ +(.*)$", prose, re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", TEXTS)
def test_links_have_targets(page):
    for target in LINK.findall(re.sub(r"^```.*?^```$|`[^`\n]*`", "", TEXTS[page], flags=re.M | re.S)):
        if re.match(r"[a-z]+://", target):
            continue
        path, _, anchor = target.partition("#")
        file = ((ROOT / page).parent / path).resolve() if path else ROOT / page
        assert file.exists(), f"{page}: {target}"
        if anchor:
            assert anchor in anchors(file.read_text(encoding="utf-8")), f"{page}: {target}"


def test_every_page_is_in_a_table_of_contents():
    """A page outside every table of contents makes `make docs` fail; found here without a build."""
    named = set()
    for page in PAGES:
        for toctree in re.findall(r"^```\{toctree\}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S):
            entries = [line for line in toctree.splitlines() if line and not line.startswith(":")]
            patterns = [re.sub(r".*<(.*)>$", r"\1", entry) + ".md" for entry in entries]
            named |= {file.resolve() for p in patterns for file in (page.parent / p).parent.glob(Path(p).name)}
    assert named == set(PAGES) - {DOCS / "index.md"}


@pytest.mark.parametrize("page", TEXTS)
def test_commands_and_options_that_are_named_exist(page):
    context = click.Context(app)
    for name, rest in COMMAND.findall(TEXTS[page]):
        command = app.get_command(context, name)
        assert command is not None, f"{page}: srt {name}"
        known = {option for p in command.params for option in (*p.opts, *p.secondary_opts)} | {"--help"}
        unknown = set(re.findall(r"(?<!\S)--[a-z][a-z0-9-]*", rest)) - known
        assert not unknown, f"{page}: srt {name} {unknown}"


def resolves(name):
    """Import the longest module of a dotted name, and look up the attributes after it."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        return all((value := getattr(value, part, None)) is not None for part in parts[count:])
    return False


@pytest.mark.parametrize("page", TEXTS)
def test_modules_and_files_that_are_named_exist(page):
    dotted = set(DOTTED.findall(TEXTS[page]))
    assert not sorted(name for name in dotted if not resolves(name))
    bases = (ROOT, (ROOT / page).parent)
    assert not sorted(path for path in PATH.findall(TEXTS[page]) if not any((b / path).exists() for b in bases))


def test_the_front_page_shows_the_figures_of_the_readme():
    shown = [
        re.findall(r"^Converged after.*?^```", TEXTS[page], re.M | re.S) for page in ("docs/index.md", "README.md")
    ]
    assert shown[0] == shown[1] != []


def test_the_reference_holds_the_whole_library():
    reference = "".join(text for page, text in TEXTS.items() if page.startswith("docs/reference/"))
    documented = {
        name.rpartition(".")[2]
        for name in re.findall(
            r"^\.\. (?:auto(?:function|class|exception)|py:data|py:function):: (\S+)", reference, re.M
        )
    }
    tables = {"TABLE_1", "Scenario"}  # named in the text: a table of the paper, and a model of the TOML keys
    assert (set(srt.__all__) | set(sims.__all__)) - tables <= documented
    assert all(f"`{name}`" in reference or f"sims.{name}" in reference for name in tables)


def first_column(page, heading, part=""):
    """Code in the first column of the table under a heading; with ``part``, the first one after that heading."""
    text = TEXTS[page][TEXTS[page].index(f"\n## {part}\n") if part else 0 :]
    section = re.search(rf"^#+ {re.escape(heading)}\n(.*?)(?=^#|\Z)", text, re.M | re.S)[1]
    rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("|")]
    return {name for row in rows for name in re.findall(r"`(\w+)`", row)}


@pytest.mark.parametrize("section", schema.SECTIONS)
def test_the_page_of_files_lists_the_keys_of_a_recording(section):
    heading = "`[[sequence]]`" if section == "sequence" else f"`[{section}]`"
    poses = schema.POSE_KEYS if section == "sequence" else ()
    assert first_column("docs/reference/files.md", heading) == {k.name for k in (*schema.SECTIONS[section], *poses)}


def test_the_recording_on_the_page_of_files_can_be_read(tmp_path):
    block = re.search(r"^```toml\n(\[recording\].*?)^```$", TEXTS["docs/reference/files.md"], re.M | re.S)[1]
    (tmp_path / "recording.toml").write_text(block)
    rows = [f"{100 * k},12,-7,3,0,0,16384" for k in range(1, 271)]
    (tmp_path / "samples.csv").write_text("\n".join(["time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z", *rows]))
    recording = srt.load_recording(tmp_path)
    assert not recording.gyro.any()
    assert recording.sequences[0].id == "1"
    np.testing.assert_allclose(recording.accel[0], [0.0, 0.0, 9.80665], rtol=1e-6)  # the value of a count has 7 digits


def test_the_page_of_files_lists_the_keys_of_a_calibration():
    unit = srt.Calibration("hand", "converged", "", srt.SensorErrors(), np.zeros((27, 27)))
    assert first_column("docs/reference/files.md", "Calibration") == set(unit.to_dict()) | set(STATUSES)


PLAN_SECTIONS = {
    "`[stand]`": set(plan_file.StandConfig.model_fields) - {"inner", "outer"},
    "`[stand.inner]`, `[stand.outer]`": set(plan_file.AxisConfig.model_fields),
    "`[targets]`": set(plan_file.TargetsConfig.model_fields),
    "`[plan]`": set(plan_file.PlanOptions.model_fields),
}


@pytest.mark.parametrize("heading", PLAN_SECTIONS)
def test_the_page_of_files_lists_the_keys_of_a_plan_file(heading):
    assert first_column("docs/reference/files.md", heading) == PLAN_SECTIONS[heading]


SCENARIO_TABLES = {
    "imu": scenario.ImuConfig,
    "imu.noise": scenario.NoiseConfig,
    "imu.errors": scenario.ErrorSizes,
    "fixture": scenario.FixtureConfig,
    "site": scenario.SiteConfig,
    "errors": scenario.ErrorsConfig,
    "schedule": scenario.ScheduleConfig,
    "free": scenario.FreeConfig,
    "protocol": scenario.ProtocolConfig,
    "recording": scenario.RecordingConfig,
}


def test_the_page_of_files_has_all_tables_of_a_scenario():
    tables = {name for name in scenario.Scenario.model_fields if name not in {"description", "seed", "motion_seed"}}
    assert tables == {name.partition(".")[0] for name in SCENARIO_TABLES}


@pytest.mark.parametrize("table", SCENARIO_TABLES)
def test_the_page_of_files_lists_the_keys_of_a_scenario(table):
    model = SCENARIO_TABLES[table]
    keys = {"from" if key == "source" else key for key in model.model_fields}
    keys |= {"from"} if issubclass(model, LibraryTable) else set()
    assert first_column("docs/reference/files.md", f"`[{table}]`", "Scenario") == keys


# --- equations -----------------------------------------------------------------------------------------------------


def expression(derivation, text):
    """Read an expression as it is printed: a space, or nothing, multiplies."""
    names = {str(s): s for s in derivation.PARAMETERS.values()}
    names |= {"g": derivation.g, "r": derivation.RATE, "T": derivation.T_MEAS, "F": derivation.F_MEAS, "π": sp.pi}
    tokens = re.findall(r"[κλμυ][xyz]+|[grTFπ]|\d+|[-+/()]", text.replace("−", "-"))
    assert "".join(tokens) == text.replace("−", "-").replace(" ", "")
    out = ""
    for before, this in pairwise(["(", *tokens]):
        out += this if before in "(+-/" or this in ")+-/" else f"*{this}"
    return sp.expand(sp.sympify(out, locals=names))


def table(page, first):
    """Rows of the table whose head begins with these words."""
    lines = TEXTS[page].split(f"| {first} |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_page_of_signatures_is_what_the_derivation_gives(derivation):
    rows = table("docs/theory/measurement.md", "seq.")
    assert [row[0] for row in rows] == list(derivation.TABLE_1)
    for name, axes, turns, delta, start, end in rows:
        down, along, _, rotations = derivation.TABLE_1[name]
        assert axes == f"{down} / {along}"
        repeats = 2 if turns.endswith("twice") else 1
        listed = [(int(a.replace("−", "-")), axis) for a, axis in re.findall(r"([+−]\d+) ([xyz])", turns)]
        assert tuple(listed * repeats) == tuple(rotations)
        found = derivation.signature(name)
        shown = {c.strip()[0]: expression(derivation, c.strip()[2:].strip()) for c in delta.split(";")}
        assert shown == {axis: e for axis, e in found.delta_a.items() if e != 0}
        assert expression(derivation, start) == found.down["start"]
        assert expression(derivation, end) == found.down["end"]


def test_the_page_of_errata_agrees_with_their_tests(derivation):
    source = (ROOT / "tests" / "model" / "test_errata_papers.py").read_text(encoding="utf-8")
    named = re.findall(r"`(test_\w+)`", TEXTS["docs/theory/errata.md"])
    assert {name.split("_")[2] for name in named} == set("123456")
    assert all(f"def {name}(" in source for name in named)
    names = {str(s): s for s in derivation.PARAMETERS.values()}
    names |= {"g": derivation.g, "r": derivation.RATE, "T": derivation.T_MEAS, "F": derivation.F_MEAS}
    rows = table("docs/theory/errata.md", "sequence")
    for (sequence, *shown), (tested, _, _, *stated) in zip(rows, BIAS_EFFECTS, strict=True):
        assert sequence == tested
        for text, truth in zip(shown, stated, strict=True):
            assert (text == "–") == (truth is None)
            if truth is not None:
                assert sp.expand(sp.sympify(truth, locals=names)) == expression(derivation, text)


def test_every_benchmark_is_explained():
    text = (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(\w+\.py)`", text))
    assert named | {"speed.py"} == {p.name for p in (ROOT / "benchmarks").glob("*.py")}


@pytest.mark.slow
def test_notebook_runs(tmp_path, monkeypatch):
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    pytest.importorskip("pyins")
    for file in (ROOT / "examples").glob("*.py"):
        shutil.copy(file, tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(tmp_path)]))
    for folder in ("IPYTHONDIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(folder, str(tmp_path / folder.lower()))
    notebook = nbformat.read(ROOT / "examples" / "from_log_to_navigation.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "clear the outputs before committing"
    nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", ())]
    text = "".join(out.get("text", "") for out in outputs)
    logged, corrected = (float(found) for found in re.findall(r": (\d+) m from the true position", text))
    assert corrected < 0.5 * logged
    rms = float(re.search(r"rms of error over sigma: ([\d.]+)", text)[1])
    assert 0.5 < rms < 1.55  # chi-square of 27 degrees of freedom with correlated errors: as in the demo's test
    pages = [out["data"].get("text/html", "") for out in outputs if "data" in out]
    assert any("gyro_scale_x" in page for page in pages)


@pytest.mark.parametrize("name", pictures.PICTURES)
def test_pictures_are_those_of_the_present_software(name, tmp_path):
    if f"Matplotlib version{mpl.__version__}".encode() not in (pictures.FOLDER / name).read_bytes():
        pytest.skip("drawn by another version of matplotlib, whose letters differ")
    pictures.save_figure(pictures.PICTURES[name](), tmp_path / name)
    drawn, shown = imread(tmp_path / name), imread(pictures.FOLDER / name)
    assert drawn.shape == shown.shape, "run python benchmarks/pictures.py"
    differing = np.any(drawn != shown, axis=2)
    # Estimates that differ by rounding may move the edge of a mark by a pixel; a number that changed moves more.
    assert differing.mean() < 1e-4, "run python benchmarks/pictures.py"


@pytest.mark.parametrize("page", ["docs/index.md", "docs/tutorial.md", "docs/robustness.md", "README.md"])
def test_the_first_pages_show_the_pictures(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    shown = {"README.md": ["fixture.png", "convergence.png"], "docs/robustness.md": ["convergence.png"]}
    for name in shown.get(page, ["fixture.png", "calibration.png"]):
        assert f"images/{name})" in text
