"""Time of ``srt apply CALIBRATION -`` per line: parsing, correction and writing apart, latency and memory.

``python benchmarks/stream.py [--samples 1000000]`` runs the command with a million lines through pipes, one line at a
time, each answer awaited (latency), and measures its memory at a tenth of the run and at the end.
"""

import argparse
import io
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from srt.result.calibration import Calibration
from srt.sensor_errors import N_PARAMETERS, SensorErrors
from srt.stacks.stream_correction import StreamCorrector, StreamOptions
from srt.stacks.text_lines import LineCorrector


def unit() -> Calibration:
    vector = np.random.default_rng(1).normal(0.0, 0.01, N_PARAMETERS)
    return Calibration("", "converged", "", SensorErrors(vector), np.eye(N_PARAMETERS) * 1e-8)


def lines(n: int) -> list[str]:
    rng = np.random.default_rng(2)
    values = np.column_stack([np.arange(n) * 0.005, rng.normal(size=(n, 3)), 9.8 * rng.normal(size=(n, 3))])
    return [",".join(f"{v:.9g}" for v in row) + "\n" for row in values.tolist()]


def memory_kib(pid: int) -> int:
    """Resident memory of a process, KiB; 0 where the system does not tell."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    return int(text.split("VmRSS:")[1].split()[0])


def steps(texts: list[str]) -> dict[str, float]:
    """CPU time of a line, µs: all of it in the process, and its parts alone."""
    corrector = StreamCorrector(unit(), "mars", StreamOptions(), print)
    whole, out = LineCorrector(corrector), io.StringIO()
    parsed = []

    def parse() -> None:
        parsed[:] = [tuple(map(float, text.split(","))) for text in texts]

    def correct() -> None:
        for values in parsed:
            corrector.correct(values[1:])

    def everything() -> None:
        out.seek(0)
        for text in texts:
            out.write((whole.correct(text) or "") + "\n")

    spans = {}
    for name, call in (("parsing", parse), ("correction", correct), ("parsing, correction and text", everything)):
        began = time.process_time()
        call()
        spans[name] = 1e6 * (time.process_time() - began) / len(texts)
    return spans


def latencies(texts: list[str], folder: Path) -> tuple[np.ndarray, int, int]:
    """Time from a line written to its answer read, s, through the pipes of the command; memory early and late, KiB."""
    unit().save(folder / "unit.json")
    command = [sys.executable, "-m", "srt.cli", "apply", str(folder / "unit.json"), "-"]
    spans = np.empty(len(texts))
    early = 0
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, bufsize=1
    ) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        for i, text in enumerate(texts):
            began = time.perf_counter()
            child.stdin.write(text)
            child.stdout.readline()
            spans[i] = time.perf_counter() - began
            if i == len(texts) // 10:
                early = memory_kib(child.pid)
        late = memory_kib(child.pid)
        child.stdin.close()
    return spans, early, late


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000)
    texts = lines(parser.parse_args().samples)
    for name, span in steps(texts[:200_000]).items():
        print(f"{name}: {span:.2f} µs a line")
    with tempfile.TemporaryDirectory() as folder:
        spans, early, late = latencies(texts, Path(folder))
    median, high = 1e6 * np.percentile(spans[100:], (50, 99))
    print(f"{len(texts)} lines through the command: latency median {median:.0f} µs, 99th percentile {high:.0f} µs")
    print(f"memory {early / 1024:.1f} MiB after a tenth, {late / 1024:.1f} MiB at the end")


if __name__ == "__main__":
    main()
