"""Command line: imports, help, exit codes, tables, and random command lines."""

import io
import json
import math
import os
import re
import subprocess
import sys
from typing import get_args

import click
import fuzz_arguments
import pytest

import srt.estimation.options
from srt.cli import app as application
from srt.cli import main
from srt.cli.app import COMMANDS
from srt.cli.calibrate import CHOICES
from srt.cli.output_paths import SAMPLES_FORMATS as FORMATS
from srt.cli.path_type import NamedPath
from srt.cli.progress import bar
from srt.recording.file_guards import memory_is_limited
from srt.recording.samples import SAMPLES_FORMATS
from srt.reports.tables import decimals_for, fixed

HEAVY = ("numpy", "scipy", "matplotlib", "rich", "pydantic", "pandas", "gtsam", "filterpy", "h5py", "pyarrow", "numba",
         "allantools")  # fmt: skip
LIGHT = ("calibrate", "simulate", "demo", "inspect", "compare")


def python(code: str, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False, **options
    )


def imported_by(code: str) -> set[str]:
    done = python(f"import json, sys\n{code}\nprint(json.dumps(sorted(sys.modules)), file=sys.stderr)")
    assert done.returncode == 0, done.stderr
    return {name.partition(".")[0] for name in json.loads(done.stderr)}


def test_a_calibration_loads_what_it_runs(tmp_path, shell):
    """Labelled sequences need neither extras nor the heavy parts of scipy, which take a third of the time."""
    shell("simulate", "demo", "-o", tmp_path / "unit", "-q")
    command = f"from srt.cli import main\nassert main(['calibrate', {str(tmp_path / 'unit')!r}, '-q']) == 0"
    done = python(f"import json, sys\n{command}\nprint(json.dumps(sorted(sys.modules)), file=sys.stderr)")
    assert done.returncode == 0, done.stderr
    loaded = set(json.loads(done.stderr.splitlines()[-1]))
    assert not loaded & {"scipy.optimize", "scipy.sparse", "scipy.spatial", "scipy.stats", "scipy.signal", *HEAVY[2:]}


def test_the_library_imports_neither_extras_nor_the_command_line():
    loaded = imported_by("import srt\nsrt.calibrate, srt.Recording")
    assert not loaded & {"gtsam", "filterpy", "pandas", "matplotlib", "click", "rich", "pydantic", "h5py", "pyarrow"}


@pytest.mark.parametrize("arguments", ["--help", "--version", *(f"{name} --help" for name in LIGHT)])
def test_help_imports_nothing_heavy(arguments):
    # Where memory is limited, the buffers of the linear algebra are reserved first.
    reserved = {"numpy", "scipy"} if memory_is_limited() else set()
    imported = imported_by(f"from srt.cli import main\nassert main({arguments.split()!r}) == 0")
    assert not (imported - reserved) & set(HEAVY)


def test_help_lists_every_command_with_its_line(shell):
    out, err = shell("--help")
    assert err == ""
    words = " ".join(out.split())  # lines end where the terminal does
    for name, (_, line) in COMMANDS.items():
        assert f"  {name} " in out
        assert f" {name} {line}" in words


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_of_the_table_can_be_loaded(name, shell):
    assert f"Usage: srt {name}" in shell(name, "--help").out


def test_version(shell):
    assert shell("--version").out.startswith("srt, strapdown-rotation-test ")


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        (["calibrat"], ["no command 'calibrat'", "did you mean calibrate?"]),
        (["xyz"], ["no command 'xyz'", "srt --help"]),
        (["calibrate", ""], ["RECORDING", "the path is empty", "srt calibrate --help"]),
        (["simulate", "demo", "-o", ""], ["--output", "the path is empty"]),
        (["export", "x.json", "--to", "kalibr", "-o", ""], ["--output", "the path is empty"]),
        (["export", "x.json", "--to", "kalibr", "-o", "."], [". is a folder", ".yaml"]),
        (["plan", "navigation-equal", "--total-time", "1e300"], ["--total-time is 1e+300", "at most 100000"]),
        (["watch", "x", "--every", "1e300"], ["--every", "0.1<=x<=3600"]),
        (["align-mount", "x", "--calibration", "c.json", "--level-sigma-mrad", "1e300"], ["at most 3200"]),
        (["merge", "a", "b"], ["no command 'merge'", "did you mean calibrate --merge?"]),
        (["calibrate", "x", "-o", "unit-7"], ["The result cannot be written as unit-7", "as unit-7.json."]),
        (["--verbose"], ["--verbose"]),
        (["calibrate"], ["RECORDING", "srt calibrate --help"]),
        (["calibrate", "x", "--step", "big"], ["--step", "'jacobian', 'coefficients'"]),
        (["calibrate", "x", "--max-playbacks", "0"], ["--max-playbacks", "0"]),
        (["calibrate", "x", "--estimator", "magic"], ["no estimator 'magic'", "closed-form", "least-squares"]),
        (["calibrate", "x", "--hold", "gyro_scal"], ["gyro_scal", "gyro_scale"]),
        (["calibrate", "x", "--plot", "x.gif"], ["x.gif", ".png", ".svg"]),
        (["calibrate", "x", "--truth", "absent.json"], ["absent.json", "No such file"]),
        (["simulate", "demo"], ["--output"]),
        (["simulate", "demoo", "-o", "x"], ["demoo", "demo", "tactical-fog"]),
        (["simulate", "demo", "-o", "x", "--seed", "-1"], ["--seed", "-1"]),
        (["simulate", "demo", "-o", "x", "--format", "xls"], ["xls", "parquet"]),
    ],
)
def test_wrong_usage_is_one_sentence_and_2(arguments, fragments, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("srt: ")
    assert err.count("\n") == 1
    assert err.endswith(".\n")
    for fragment in fragments:
        assert fragment in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["convert", "calibrate", "apply", "export"])
def test_the_help_has_the_usual_options_and_another_all(command, shell):
    found = application.app.get_command(click.Context(application.app), command)
    options = {p.name: max(p.opts, key=len) for p in found.params if isinstance(p, click.Option)}
    assert set(found.usual) <= set(options)
    short = shell(command, "--help").out.partition("Options:")[2]
    whole = shell(command, "--help-all").out
    assert all(f"{name} " in whole for name in options.values())
    shown = [name for name in options.values() if f"  {name} " in short or f", {name} " in short]
    assert {options[name] for name in found.usual} == set(shown)
    assert len(shown) <= 12
    assert "--help " in short


def test_every_path_of_every_command_is_of_the_type_that_refuses_an_empty_one():
    for name in COMMANDS:
        command = application.app.get_command(None, name)
        paths = [each for each in command.params if isinstance(each.type, click.Path)]
        assert all(isinstance(each.type, NamedPath) for each in paths), name


def test_no_command_shows_the_help_and_is_wrong_usage(shell):
    assert "Commands:" in shell(code=2).err


def test_choices_are_those_of_the_library():
    """They are written out in the command, so that its help need not import numpy; here is why that is safe."""
    types = {
        "average": srt.estimation.options.Average,
        "down": srt.estimation.options.Down,
        "window_attitude": srt.estimation.options.WindowAttitude,
        "gyro_bias": srt.estimation.options.GyroBias,
        "step": srt.estimation.options.Step,
        "loss": srt.estimation.options.Loss,
        "filter": srt.estimation.options.Filter,
    }
    assert {name: get_args(kind) for name, kind in types.items()} | {"start": ("auto", "zero")} == CHOICES
    for name, allowed in CHOICES.items():
        for value in allowed:
            srt.estimation.options.Options(**{name: value})
    assert set(FORMATS) == set(SAMPLES_FORMATS)


def test_defaults_are_those_of_the_library():
    from srt.cli.calibrate import calibrate

    defaults = {p.name: p.default for p in calibrate.params}
    options = srt.estimation.options.Options()
    for name in (*CHOICES, "max_playbacks"):
        assert defaults[name] == getattr(options, name)


def test_an_absent_click_is_one_sentence():
    done = python("import sys\nsys.modules['click'] = None\nfrom srt.cli import main\nsys.exit(main(['--help']))")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("srt: The command line needs the package 'click'")
    assert "pip install 'strapdown-rotation-test[cli]'" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("command", ["calibrate", "inspect"])
def test_an_absent_matplotlib_is_noticed_before_the_work(command):
    done = python(
        "import sys\nsys.modules['matplotlib'] = None\n"
        f"from srt.cli import main\nsys.exit(main([{command!r}, 'absent', '--plot', 'x.png']))"
    )
    assert done.returncode == 2
    assert done.stderr.startswith("srt: A plot needs the package 'matplotlib'")
    assert done.stderr.count("\n") == 1


@pytest.fixture
def broken(monkeypatch):
    """Give a command that does what it is told."""

    def install(act):
        @click.command("demo")
        def command():
            act()

        monkeypatch.setattr(application.LazyGroup, "get_command", lambda self, ctx, name: command)

    return install


def test_an_unexpected_error_keeps_its_traceback(broken):
    def act():
        raise ZeroDivisionError("a defect")

    broken(act)
    with pytest.raises(ZeroDivisionError):
        main(["demo"])


def test_interrupted_is_130_and_quiet(broken, shell):
    def act():
        raise KeyboardInterrupt

    broken(act)
    assert shell("demo", code=130) == ("", "\n")


@pytest.mark.parametrize(("error", "code"), [(srt.DataError("No."), 1), (srt.InputError("No."), 2)])
def test_known_errors_have_their_codes(broken, error, code, shell):
    def act():
        raise error

    broken(act)
    assert shell("demo", code=code) == ("", "srt: No.\n")


@pytest.mark.skipif(os.name == "nt", reason="pipes of POSIX")
def test_a_reader_that_leaves_is_no_error():
    process = subprocess.Popen(
        [sys.executable, "-m", "srt.cli", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.close()
    assert process.wait(60) == 141
    assert process.stderr.read() == b""
    process.stderr.close()


@pytest.mark.parametrize("whole_files", range(3))
def test_an_interrupt_leaves_nothing_half_written(tmp_path, monkeypatch, whole_files, shell):
    """Ctrl-C comes when all of a file is written, but it is yet to get its name."""
    sync, done = os.fsync, []

    def interrupted(descriptor):
        if len(done) == whole_files:
            raise KeyboardInterrupt
        done.append(descriptor)
        sync(descriptor)

    monkeypatch.setattr("srt.recording.atomic_file.os.fsync", interrupted)
    folder = tmp_path / "x"
    assert shell("simulate", "noise-free", "-o", folder, code=130) == ("", "\n")
    left = {path.name for path in folder.iterdir()} if folder.exists() else set()
    # Whole files only, and recording.toml, without which there is no recording, after its samples.
    order = ["samples.npz", "recording.toml", "truth.json"]
    assert left == set(order[: len(left)])


@pytest.mark.parametrize(
    ("command", "present", "earlier"),
    [
        ("inspect", "--output", "--json"), ("noise", "--output", "--json"),
        ("convert", "--samples-format", "--to"), ("simulate", "--samples-format", "--format"),
    ],
)  # fmt: skip
def test_earlier_names_of_options_are_accepted_and_not_shown(command, present, earlier, shell, refused):
    found = application.app.get_command(click.Context(application.app), command)
    (option,) = [p for p in found.params if present in p.opts]
    assert earlier in option.opts
    lines = shell(command, "--help-all" if command == "convert" else "--help").out.splitlines()
    assert any(f"{present} " in line for line in lines)
    assert not any(earlier in line.replace(",", " ").split()[:2] for line in lines)
    extra = ["-o", "out"] if command in ("convert", "simulate") else []
    err = refused(command, "absent", earlier, "x" if command in ("inspect", "noise") else "npz", *extra)
    assert "No such option" not in err


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arguments")
    fuzz_arguments.laboratory(folder)
    return folder


@pytest.mark.parametrize("indices", [range(12, 25), pytest.param(range(1000), marks=pytest.mark.campaign)])
def test_random_command_lines_have_no_defect(laboratory, tmp_path, monkeypatch, indices):
    monkeypatch.chdir(tmp_path)
    runs = fuzz_arguments.runs(laboratory, tmp_path / "runs", 20261123, indices, 10.0)
    assert [(words, defect) for words, defect, _ in runs if defect] == []


@pytest.mark.parametrize("instruction", ["bash_complete", "nonsense_source"])
def test_a_request_of_completion_without_its_words_is_a_sentence(monkeypatch, capfd, instruction):
    monkeypatch.setenv("_SRT_COMPLETE", instruction)
    for name in ("COMP_WORDS", "COMP_CWORD"):
        monkeypatch.delenv(name, raising=False)
    code = main([])
    out, err = capfd.readouterr()
    assert (code, out) in ((1, ""), (2, ""))
    assert err.count("\n") == (1 if code == 2 else 0)


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("calibrate --estimator c", "closed-form"), ("compare x --estimator gr", "graph"),
        ("export x --to k", "kalibr"), ("simulate free-", "free-mems"), ("robustness qui", "quick"),
        ("calibrate x --protocol tab", "table-1"),
    ],
)  # fmt: skip
def test_a_shell_completes_what_is_shipped_or_installed(monkeypatch, shell, words, offered):
    monkeypatch.setenv("_SRT_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", f"srt {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    found = shell(code=0).out.splitlines()
    assert f"plain,{offered}" in found
    assert ("file," in "".join(found)) == (words.split()[0] in ("simulate", "robustness") or "protocol" in words)


@pytest.mark.parametrize("command", ["robustness", "inspect", "calibrate"])
def test_every_command_shows_all_its_options(command, shell):
    assert "--quiet" in shell(command, "--help-all").out


def test_an_estimator_may_be_named_in_capitals(shell, tmp_path):
    assert "There is no recording" in shell("calibrate", tmp_path / "x", "--estimator", "EKF", code=2).err
    assert "no estimator 'EKG'" in shell("calibrate", tmp_path, "--estimator", "EKG", code=2).err


def test_the_time_beside_a_bar_is_that_which_is_left(monkeypatch):
    rich = pytest.importorskip("rich.console")
    written = io.StringIO()
    console = rich.Console(file=written, force_terminal=True, width=80)
    monkeypatch.setattr("srt.cli.progress._console", lambda: console)
    with bar("units", 4) as move:
        move(1, 4, "units")
    assert re.search(r"\d+/4\S* +\S*-?:[-\d]+:[-\d]+\S* left", written.getvalue())


def test_no_standard_error_stops_no_command(monkeypatch, tmp_path, shell):
    monkeypatch.setattr("sys.stderr", None)
    shell("simulate", "noise-free", "-o", tmp_path / "unit", "-q")
    shell("demo", "-o", tmp_path / "unit" / "recording.toml", code=2)


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [
        (132.414, 2, "132.41"), (-0.004, 2, "0.00"), (-0.0, 6, "0.000000"), (-1.2e-9, 6, "-1.2e-09"),
        (2.5e8, 1, "2.500e+08"), (math.nan, 3, "-"),
    ],
)  # fmt: skip
def test_numbers(value, decimals, text):
    assert fixed(value, decimals) == text
    for sigma, expected in ((1234.0, 0), (10.0, 0), (9.9, 1), (0.0081, 4), (1e-9, 6), (0.0, 6), (math.inf, 6)):
        assert decimals_for(sigma) == expected
