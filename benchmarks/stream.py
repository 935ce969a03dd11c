"""Time of ``srt apply CALIBRATION -`` per line: parsing, correction and writing apart, latency and memory.

``python benchmarks/stream.py [--samples 1000000] [--packets 200000]`` runs the command with a million lines through
pipes, one line at a time, each answer awaited (latency), and measures its memory at a tenth of the run and at the end;
then with MAVLink packets (HIGHRES_IMU in and out) over UDP on this computer, in the same way.
"""

import argparse
import io
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
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
    corrector = StreamCorrector(unit(), "mars", StreamOptions(gravity=9.80665), print)
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
            out.write(whole.correct(text) + "\n")

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


def packets(n: int) -> Iterator[bytes]:
    """HIGHRES_IMU of one sender at 200 Hz."""
    from pymavlink.dialects.v20 import common

    link = common.MAVLink(None, srcSystem=1, srcComponent=1)
    rng = np.random.default_rng(3)
    for i in range(n):
        readings = (9.8 * rng.standard_normal(3)).tolist() + rng.standard_normal(3).tolist()
        yield link.highres_imu_encode(5000 * i, *readings, *[0.0] * 6, 25.0, 0b111111).pack(link)
        link.seq = (link.seq + 1) % 256


def mavlink_latencies(n: int, folder: Path) -> tuple[np.ndarray, int, int]:
    """Time from a packet sent to its answer received, s; memory of the command early and late, KiB."""
    unit().save(folder / "unit.json")
    with socket.socket(type=socket.SOCK_DGRAM) as answers, socket.socket(type=socket.SOCK_DGRAM) as sender:
        with socket.socket(type=socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            source = free.getsockname()
        answers.bind(("127.0.0.1", 0))
        answers.settimeout(0.2)
        addresses = [f"udp:{host}:{port}" for host, port in (source, answers.getsockname())]
        command = [sys.executable, "-m", "srt.cli", "apply", str(folder / "unit.json"), "--from", addresses[0]]
        spans = np.empty(n)
        early = 0
        with subprocess.Popen([*command, "--to", addresses[1]], stderr=subprocess.DEVNULL) as child:
            try:
                _wait_until_answered(sender, answers, source)
                answers.settimeout(10.0)
                for i, packet in enumerate(packets(n)):
                    began = time.perf_counter()
                    sender.sendto(packet, source)
                    answers.recv(4096)
                    spans[i] = time.perf_counter() - began
                    if i == n // 10:
                        early = memory_kib(child.pid)
                late = memory_kib(child.pid)
            finally:
                child.terminate()
    return spans, early, late


def _wait_until_answered(sender: socket.socket, answers: socket.socket, source: tuple[str, int]) -> None:
    first = next(packets(1))
    for _ in range(300):
        sender.sendto(first, source)
        with suppress(TimeoutError):
            answers.recv(4096)
            return
    raise SystemExit("The command answers no packet.")


def show(what: str, spans: np.ndarray, early: int, late: int) -> None:
    median, high = 1e6 * np.percentile(spans[100:], (50, 99))
    print(f"{len(spans)} {what}: latency median {median:.0f} µs, 99th percentile {high:.0f} µs")
    print(f"memory {early / 1024:.1f} MiB after a tenth, {late / 1024:.1f} MiB at the end", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--packets", type=int, default=200_000)
    given = parser.parse_args()
    texts = lines(given.samples)
    for name, span in steps(texts[:200_000]).items():
        print(f"{name}: {span:.2f} µs a line")
    with tempfile.TemporaryDirectory() as folder:
        show("lines through the command", *latencies(texts, Path(folder)))
        show("MAVLink packets over UDP", *mavlink_latencies(given.packets, Path(folder)))


if __name__ == "__main__":
    main()
