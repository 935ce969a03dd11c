"""The border of the command line: limits of machine and Python, closed streams, signals, and hostile names."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import srt
from srt.cli import main
from srt.recording.atomic_file import atomic_path, remove_leftovers
from srt.recording.samples import Samples, write_samples

pytestmark = pytest.mark.usefixtures("plain_layout")

POSIX = pytest.mark.skipif(os.name == "nt", reason="signals and streams of POSIX")
SRT = [sys.executable, "-m", "srt.cli"]


def run(*arguments, **options):
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **options}
    return subprocess.run([*SRT, *arguments], timeout=120, check=False, **options)


def one_sentence(done, code):
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.startswith("srt: ")
    assert done.stderr.count("\n") == 1


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile")
    assert main(["simulate", "noise-free", "-o", str(folder / "unit"), "-q"]) == 0
    return folder / "unit"


@POSIX
def test_escape_codes_of_names_and_serials_do_not_reach_the_terminal(recording, tmp_path, shell):
    folder = tmp_path / "u\x1b]0;owned\x07"
    recording.rename(folder)
    text = (folder / "recording.toml").read_text(encoding="utf-8")
    (folder / "recording.toml").write_text(text.replace("[recording]", '[recording]\nserial = "\\u001b[31mX"', 1))
    try:
        said = [*shell("inspect", folder), *shell("calibrate", folder)]
        said += shell("calibrate", folder, "-o", folder / "\x1b.txt", code=2)
    finally:
        (folder / "recording.toml").write_text(text)
        folder.rename(recording)
    assert not {"\x1b", "\x07"} & set("".join(said))
    assert "\\x1b[31mX" in said[0] + said[2]


@POSIX
@pytest.mark.parametrize("name", [pytest.param(r"$\input{x}$", marks=pytest.mark.slow), "not-utf8-\udcff-$\\input{x}$"])
def test_names_do_not_break_the_plot(recording, tmp_path, name, shell):
    folder, plot = tmp_path / name, tmp_path / "x.png"
    folder.symlink_to(recording)
    shell("calibrate", folder, "-q", "--plot", plot)
    shell("inspect", folder, "-q", "--plot", plot)
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_a_foreign_matplotlib_backend_does_no_harm(recording, tmp_path):
    done = run(
        "inspect", str(recording), "-q", "--plot", str(tmp_path / "x.png"), env={**os.environ, "MPLBACKEND": "nonsense"}
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_output_is_one_sentence():
    with Path("/dev/full").open("w") as full:
        one_sentence(run("list", "formats", stdout=full), 2)


@POSIX
@pytest.mark.parametrize("arguments", ["list formats", "--version", "calibrate {unit} -o {result}"])
def test_what_a_closed_output_loses_is_one_sentence(recording, tmp_path, arguments):
    """The result that a file holds is whole: no other output goes to the number of the closed stream."""
    result = tmp_path / "unit.json"
    command = f"{sys.executable} -m srt.cli {arguments.format(unit=recording, result=result)} >&-"
    done = subprocess.run(["/bin/sh", "-c", command], capture_output=True, text=True, check=False)
    lines = done.stderr.splitlines()
    assert (done.returncode, len(lines)) == (2, 1)
    assert lines[0].startswith("srt: Standard output cannot be written")
    assert "{result}" not in arguments or srt.load_calibration(result).status == "converged"


@POSIX
def test_a_closed_output_does_not_stop_what_prints_nothing(recording):
    command = f"{sys.executable} -m srt.cli calibrate {recording} -q >&-"
    done = subprocess.run(["/bin/sh", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@POSIX
def test_a_deleted_working_directory_is_one_sentence(tmp_path):
    script = f"mkdir gone && cd gone && rmdir ../gone && {sys.executable} -P -m srt.cli calibrate unit"
    done = subprocess.run(["/bin/sh", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    one_sentence(done, 2)


@POSIX
def test_a_deleted_working_directory_is_the_cause_of_what_cannot_be_read(recording, tmp_path):
    """Readers of samples ask for the working directory even for absolute paths."""
    script = f"mkdir gone && cd gone && rmdir ../gone && {sys.executable} -P -m srt.cli calibrate {recording} -q"
    done = subprocess.run(["/bin/sh", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert done.returncode == 0 or done.stderr.startswith("srt: The working directory does not exist any more")


@pytest.mark.parametrize("command", ["simulate", "robustness", "plan"])
def test_long_keys_are_refused_at_once_by_every_command_that_reads_toml(command, tmp_path, refused):
    """Python's own reader takes minutes for this line."""
    file = tmp_path / "x.toml"
    file.write_text(".".join(["a"] * 100_000) + " = 1\n")
    began = time.monotonic()
    assert "has more than 32 parts" in refused(command, file, "-o", tmp_path / "out.toml")
    assert time.monotonic() - began < 10.0


@POSIX
def test_leftovers_of_a_killed_run_are_removed_by_the_next(tmp_path, shell):
    """Killed between the writing of a temporary file and its renaming; the file of a living process remains."""
    folder = tmp_path / "unit"
    folder.mkdir()
    script = (
        "import os, signal, sys\nfrom pathlib import Path\nfrom srt.recording.atomic_file import atomic_path\n"
        "with atomic_path(sys.argv[1]) as temporary:\n temporary.write_bytes(b'x')\n"
        " os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", script, str(folder / "samples.npz")], check=False)
    (left,) = folder.iterdir()
    assert left.name.startswith(".samples.")
    with atomic_path(tmp_path / "unit" / "other.npz") as living:
        living.write_bytes(b"y")
        assert list(folder.iterdir()) == [living]  # the first writing to the folder removed the leftover
        remove_leftovers(folder)
        assert living.exists()
    (folder / "other.npz").unlink()
    subprocess.run([sys.executable, "-c", script, str(folder / "samples.npz")], check=False)
    assert len(list(folder.iterdir())) == 1
    shell("simulate", "noise-free", "-o", folder, "-q")  # a folder with leftovers alone is empty
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


@POSIX
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP] if os.name != "nt" else [])
def test_termination_leaves_nothing_behind(tmp_path, number):
    # The command leaves a signal alone that it inherits as ignored (nohup does that to SIGHUP): here none is.
    inherited = signal.signal(number, signal.SIG_DFL)
    process = subprocess.Popen(
        [*SRT, "robustness", "quick", "--workers", "1", "-o", str(tmp_path / "x")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    signal.signal(number, inherited)
    line = process.stderr.readline()
    time.sleep(0.5)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + number, line + err
    assert "Traceback" not in err
    assert "Interrupted: finished trials are kept" in err


def test_everything_that_is_shipped_is_listed(shell):
    out = shell("list").out
    for name in ("consumer-mems", "tactical-equal", "quick", "least-squares", "rosbag1", "kalibr"):
        assert f"\n {name} " in out
    assert max(map(len, out.splitlines())) <= 80
    assert shell("list", "plans").out.startswith("Plans\n")


@POSIX
@pytest.mark.parametrize(("left_mib", "code"), [(1000, 0), (20, 2)])
def test_too_little_memory_for_the_linear_algebra_is_a_sentence(left_mib, code):
    """OpenBLAS asks for its buffers again and again, for ever, where a limit refuses them."""
    script = (
        "import resource, sys, numpy as np, scipy.linalg.blas as blas\n"
        "from srt.cli.border import guarded\n"
        "used = int(open('/proc/self/status').read().split('VmData:')[1].split()[0]) << 10\n"
        f"resource.setrlimit(resource.RLIMIT_DATA, (used + ({left_mib} << 20),) * 2)\n"
        "sys.exit(guarded(lambda: int(blas.dgemm(1.0, np.eye(200), np.eye(200))[0, 0]) - 1))"
    )
    if not os.path.exists("/proc/self/status"):  # noqa: PTH110
        pytest.skip("the memory of a process is read from /proc")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == code, done.stderr
    assert (done.stderr == "") if code == 0 else ("There is not enough memory" in done.stderr)


@POSIX
def test_too_little_memory_for_pyarrow_is_a_sentence(tmp_path):
    """Its own code ends the process where a limit refuses memory, or calls the file damaged."""
    if not os.path.exists("/proc/self/status"):  # noqa: PTH110
        pytest.skip("the memory of a process is read from /proc")
    pytest.importorskip("pyarrow")
    path = tmp_path / "samples.parquet"
    write_samples(path, Samples(np.eye(3), np.eye(3), np.arange(3.0)))
    script = (
        "import resource, sys\n"
        "from srt.cli.border import guarded\n"
        "from srt.recording.samples import read_samples\n"
        "used = int(open('/proc/self/status').read().split('VmData:')[1].split()[0]) << 10\n"
        "resource.setrlimit(resource.RLIMIT_DATA, (used + (220 << 20),) * 2)\n"
        f"sys.exit(guarded(lambda: len(read_samples({str(path)!r}).time)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, "does not fit into memory" in done.stderr) == (2, True), done.stderr
