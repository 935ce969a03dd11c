"""Latency and memory of ``srt apply CALIBRATION -``.

``python benchmarks/stream.py [--samples 1000000] [--packets 200000]`` runs the command with a million lines through
pipes, one line at a time, each answer awaited (latency), and measures its memory at a tenth of the run and at the end;
then with MAVLink packets (HIGHRES_IMU in and out) over UDP on this computer, in the same way.
"""

import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import harness
import numpy as np

from srt.result.calibration import Calibration
from srt.sensor_errors import N_PARAMETERS, SensorErrors

COMMAND = [sys.executable, "-m", "srt.cli", "apply"]


def unit() -> Calibration:
    vector = np.random.default_rng(1).normal(0.0, 0.01, N_PARAMETERS)
    return Calibration("", "converged", "", SensorErrors(vector), np.eye(N_PARAMETERS) * 1e-8)


def lines(n: int) -> list[str]:
    rng = np.random.default_rng(2)
    values = np.column_stack([np.arange(n) * 0.005, rng.normal(size=(n, 3)), 9.8 * rng.normal(size=(n, 3))])
    return [",".join(f"{v:.9g}" for v in row) + "\n" for row in values.tolist()]


def memory_mib(pid: int) -> float:
    """Resident memory of a process, MiB; NaN where the system does not tell."""
    try:
        return int(Path(f"/proc/{pid}/status").read_text().split("VmRSS:")[1].split()[0]) / 1024
    except OSError:
        return float("nan")


def latencies(what: str, pid: int, inputs: Iterable, n: int, answered: Callable[[object], None]) -> None:
    """Time from an input sent to its answer received; memory of the command early and at the end."""
    spans, early = np.empty(n), 0.0
    for i, each in enumerate(inputs):
        began = time.perf_counter()
        answered(each)
        spans[i] = time.perf_counter() - began
        if i == n // 10:
            early = memory_mib(pid)
    median, high = 1e6 * np.percentile(spans[100:], (50, 99))
    print(f"{n} {what}: latency median {median:.0f} µs, 99th percentile {high:.0f} µs")
    print(f"memory {early:.1f} MiB after a tenth, {memory_mib(pid):.1f} MiB at the end", flush=True)


def by_pipes(texts: list[str], file: str) -> None:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*COMMAND, file, "-"], **pipes, text=True, bufsize=1) as child:

        def answered(text: str) -> None:
            child.stdin.write(text)
            child.stdout.readline()

        latencies("lines through the command", child.pid, texts, len(texts), answered)
        child.stdin.close()


def packets(n: int) -> Iterator[bytes]:
    """HIGHRES_IMU of one sender at 200 Hz."""
    from pymavlink.dialects.v20 import common

    link = common.MAVLink(None, srcSystem=1, srcComponent=1)
    rng = np.random.default_rng(3)
    for i in range(n):
        readings = (9.8 * rng.standard_normal(3)).tolist() + rng.standard_normal(3).tolist()
        yield link.highres_imu_encode(5000 * i, *readings, *[0.0] * 6, 25.0, 0b111111).pack(link)
        link.seq = (link.seq + 1) % 256


def by_mavlink(n: int, file: str) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as answers, socket.socket(type=socket.SOCK_DGRAM) as sender:
        with socket.socket(type=socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            source = free.getsockname()
        answers.bind(("127.0.0.1", 0))
        answers.settimeout(0.2)
        into, out = (f"udp:{host}:{port}" for host, port in (source, answers.getsockname()))

        def answered(packet: bytes) -> None:
            sender.sendto(packet, source)
            answers.recv(4096)

        with subprocess.Popen([*COMMAND, file, "--from", into, "--to", out], stderr=subprocess.DEVNULL) as child:
            try:
                for _ in range(300):
                    with suppress(TimeoutError):
                        answered(next(packets(1)))
                        break
                else:
                    raise SystemExit("The command answers no packet.")
                answers.settimeout(10.0)
                latencies("MAVLink packets over UDP", child.pid, packets(n), n, answered)
            finally:
                child.terminate()


def main(*, samples: int = 1_000_000, packets: int = 200_000) -> None:
    texts = lines(samples)
    with tempfile.TemporaryDirectory() as folder:
        file = f"{folder}/unit.json"
        unit().save(Path(file))
        by_pipes(texts, file)
        by_mavlink(packets, file)


if __name__ == "__main__":
    harness.run(main, __doc__)
