"""Speed of everything in one table: estimators in memory, commands as processes, length of a recording.

``python benchmarks/speed.py`` prints it as Markdown; ``--only PART ...`` takes parts of it, or others: inspection of
an hour at 1 kHz, a stream. ``--long`` adds 20 million samples, or takes a million lines of a stream in place of
100,000. ``--rounds N`` takes medians of N. Times are CPU times on one core. Each has its ratio to a fixed numpy load
that runs right before it, so that a busy or another machine matters less. benchmarks/README.md says what the rows are.
"""

import os
import socket
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import accuracy_trials
import harness
import numpy as np
import recorded_sets
from numpy_load import Row, beside_load, cpu_time, numpy_load

import sims
import srt
from sims.physics.imu import read_out
from sims.physics.sequences import TABLE_1
from sims.physics.table_motion import table1_motion
from srt.comparison.estimator_comparison import default_estimators
from srt.diagnosis import diagnose
from srt.model.analytic_platform import integrate_attitude
from srt.model.gyro_stream import gyro_stream
from srt.model.platform_steps import COMPILED_RECORDINGS, many_recordings
from srt.model.sensor_model import gyro_triad
from srt.noise.noise_model import noise_model
from srt.reports.figures.inspection import inspection_figure
from srt.reports.inspection import inspect
from srt.sensor_errors import N_PARAMETERS
from srt.sequences.preparation import prepare
from srt.sequences.recognition import recognise

DEFAULT_PARTS = ("memory", "processes", "length")
ROUNDS = 7
"""Repeats of each timing; figures are medians."""
SAMPLE_RATE_HZ = 200.0
PEERS = {"Xsens MTi from its file": "imu_tk in C++: 4.0 loads"}
"""Other tools on the same work. imu_tk took 0.66 of this command as it was in November 2026, which took 6.1 loads."""


def sum_once(recording: srt.Recording) -> float:
    """One read of all samples: no calibration can be faster."""
    return float(recording.gyro.sum() + recording.accel.sum())


def process_time(arguments: list[str], environment: dict[str, str] | None = None) -> float:
    """CPU time of a process with its start and its own processes, s.

    Installed modules are compiled once, also where writing of bytecode has been turned off.

    Raises
    ------
    RuntimeError
        If it ends with an error.
    """
    before = os.times()
    own = {**os.environ, "PYTHONDONTWRITEBYTECODE": "", **(environment or {})}
    done = subprocess.run(arguments, capture_output=True, text=True, check=False, env=own)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)} ended with {done.returncode}: {done.stderr[-500:]}")
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def in_memory(rounds: int) -> list[Row]:
    """Estimators on samples in memory, with and without checks, with and without drift, and one iteration alone."""
    recording, truth = accuracy_trials.noisy_recording(1, "navigation", sample_rate_hz=SAMPLE_RATE_HZ)
    n = len(recording.time)
    read_s = cpu_time(lambda: [sum_once(recording) for _ in range(100)]) / 100
    rows = []

    def add(name: str, call: Callable[[], object], *, limit: float | None = read_s) -> None:
        seconds, load_s = beside_load(lambda: cpu_time(call), rounds)
        rows.append(Row(name, seconds, load_s, limit, PEERS.get(name, "")))

    def fresh() -> srt.Recording:
        # Derived values are stored with a recording: a copy computes them again.
        return replace(recording)

    names, left_out = default_estimators(recording)
    for name in names:
        add(f"{name}, {n} samples, 17 sequences", lambda name=name: srt.calibrate(fresh(), name, checks=False))
    for name, reason in left_out.items():
        print(f"{name} left out: {reason}", file=sys.stderr)
    add("closed-form with all checks", lambda: srt.calibrate(fresh(), "closed-form"))
    for times in (1, 4):
        drifting, quiet = with_and_without_drift(times)
        for name in [name for name in ("ekf", "graph") if name in names]:
            for what, each, bias in (("with", drifting, "auto"), ("without", quiet, "pooled")):
                title = f"{name}, {17 * times} sequences at 50 Hz, {what} bias instability"
                choices = {"estimator": name, "checks": False, "gyro_bias": bias}
                add(title, lambda each=each, choices=choices: srt.calibrate(replace(each), **choices), limit=None)
    spans = np.linspace(0, n, 18).astype(int)
    spans = np.stack([spans[:-1], spans[1:]], axis=1)
    stream = gyro_stream(recording.gyro, recording.interval_s, spans, spans, rates=True)
    triad, earth = gyro_triad(truth), np.zeros((17, 3))
    sample = noise_model(recording, spans).gyro_sample(recording.nominal_interval_s)
    # As one recording, and as one of a campaign, where numba compiles the steps if it is installed.
    for what, count in (("", 1), (", of a campaign", COMPILED_RECORDINGS)):
        with many_recordings(count):
            one = partial(integrate_attitude, stream, triad, earth, sample_noise_rad=sample)
            add(f"one iteration with Jacobian, all {n} samples integrated{what}", one)
    windows = prepare(recording, recording.sequences).windows.samples
    count = int(np.diff(windows, axis=1).sum())
    add(f"noise fit of {count} samples at rest", lambda: noise_model(recording, windows))
    folder = recorded_sets.data_folder()
    if folder is not None:
        xsens = recorded_sets.xsens_mti(folder)
        add("Xsens MTi in memory, windows and turns found", lambda: srt.calibrate(replace(xsens), checks=False))
    return rows


def with_and_without_drift(times: int) -> tuple[srt.Recording, srt.Recording]:
    """Table 1 a number of times over, of a unit with bias instability, as stated, and of one without."""
    rng = np.random.default_rng(3)
    gyro, accel = accuracy_trials.INSTABILITY["navigation"]
    still = accuracy_trials.GRADES["navigation"]
    drifting = replace(still, gyro_bias_instability=gyro, accel_bias_instability=accel)
    motion = table1_motion(site=accuracy_trials.SITE, sample_rate_hz=50.0, sequences=tuple(TABLE_1) * times)
    errors = accuracy_trials.normal_errors(rng)
    with_drift, without = (read_out(motion, errors, imu, rng) for imu in (drifting, still))
    return with_drift, without


def processes(rounds: int) -> Iterator[Row]:
    """Commands as processes: start, imports, files, all checks, result, figures."""
    recording, _ = accuracy_trials.noisy_recording(1, "navigation", sample_rate_hz=SAMPLE_RATE_HZ)
    command = [sys.executable, "-m", "srt.cli"]
    with tempfile.TemporaryDirectory() as directory:
        at = Path(directory)
        for kind in ("npz", "csv"):
            srt.write_recording(recording, at / kind, samples_format=kind)
        # Digits of a log in floating point: a quantized reading has fewer, and is read faster.
        rng = np.random.default_rng(0)
        dithered = replace(recording, gyro=recording.gyro + 1e-9 * rng.standard_normal(recording.gyro.shape))
        srt.write_recording(dithered, at / "digits")
        unlabelled = ["simulate", "navigation-rlg", "-q", "-o", str(at / "unlabelled")]
        process_time([*command, *unlabelled])
        result, page = str(at / "unit.json"), str(at / "unit.html")
        process_time([*command, "calibrate", str(at / "npz"), "-o", result, "-q"])
        commands = {
            "Python and numpy alone": [sys.executable, "-c", "import numpy"],
            "import srt, to load and apply": [sys.executable, "-c", "import srt; srt.load_calibration, srt.Applier"],
            "srt --help": [*command, "--help"],
            "srt list": [*command, "list"],
            "srt calibrate, NPZ": [*command, "calibrate", str(at / "npz"), "-q"],
            "srt calibrate, CSV": [*command, "calibrate", str(at / "csv"), "-q"],
            "srt calibrate, CSV of 17 digits": [*command, "calibrate", str(at / "digits"), "-q"],
            "srt calibrate, unlabelled, 183 k samples": [*command, "calibrate", str(at / "unlabelled"), "-q"],
            "srt compare of all": [*command, "compare", str(at / "npz"), "-q"],
            "srt certificate": [*command, "certificate", result, str(at / "npz"), "-o", page, "-q"],
            "srt simulate demo": [*command, "simulate", "demo", "-o", str(at / "demo"), "--overwrite", "-q"],
            "srt plan tactical-equal": [*command, "plan", "tactical-equal", "-q"],
        }
        folder = recorded_sets.data_folder()
        if folder is not None:
            srt.write_recording(recorded_sets.xsens_mti(folder), at / "xsens")
            commands["Xsens MTi from its file"] = [*command, "calibrate", str(at / "xsens"), "-q"]
        for name, arguments in commands.items():
            seconds, load_s = beside_load(partial(process_time, arguments), rounds)
            yield Row(name, seconds, load_s, peer=PEERS.get(name, ""))
        completion = {"_SRT_COMPLETE": "bash_complete", "COMP_WORDS": "srt cal", "COMP_CWORD": "1"}
        seconds, load_s = beside_load(partial(process_time, command, completion), rounds)
        yield Row("completion in the shell", seconds, load_s)


def length(lengths: tuple[int, ...]) -> Iterator[Row]:
    """The closed form on longer recordings; names hold the time of a sample and the memory over that of the samples."""
    rng = np.random.default_rng(0)
    for n in lengths:
        recording, _ = accuracy_trials.noisy_recording(
            int(rng.integers(1 << 30)), "tactical", sample_rate_hz=float(round(n / 456.0))
        )
        load_s = cpu_time(numpy_load)
        seconds = cpu_time(partial(srt.calibrate, replace(recording), "closed-form", checks=False))
        read_s = cpu_time(partial(sum_once, recording))
        _, peak = traced(partial(srt.calibrate, replace(recording), "closed-form", checks=False))
        name = (
            f"closed-form, {len(recording.time):,} samples: {seconds / len(recording.time) * 1e9:.0f} ns each, "
            f"memory {1.0 + peak / nbytes(recording):.2f} of the samples"
        )
        yield Row(name, seconds, load_s, read_s)


def an_hour() -> srt.Recording:
    """Table 1 six times at 1 kHz, with the moves between the sequences, without labels."""
    scenario = sims.load_scenario("navigation-rlg")
    schedule = scenario.schedule.model_copy(update={"repeats": 6, "dwell_s": 10.8})
    recording = scenario.recording.model_copy(update={"sample_rate_hz": 1000.0})
    return sims.simulate(scenario.model_copy(update={"schedule": schedule, "recording": recording})).recording


def inspection(rounds: int) -> Iterator[Row]:
    """Inspection of a long log without reading it, over one sum of its columns, and its memory."""
    recording = an_hour()
    read_s = cpu_time(lambda: (recording.gyro.sum(axis=0), recording.accel.sum(axis=0)))
    found = inspect(replace(recording))
    what = f"{len(recording.time):,} samples"
    for name, call in {
        "inspection with recognition": inspect,
        "recognition alone": recognise,
        "diagnosis alone": partial(diagnose, calibrating=False),
        "figure of the inspection": lambda fresh: inspection_figure(fresh, found),
    }.items():
        seconds, load_s = beside_load(lambda call=call: cpu_time(lambda: call(replace(recording))), min(rounds, 3))
        yield Row(f"{name}, {what}", seconds, load_s, read_s)
    load_s = cpu_time(numpy_load)
    seconds, memory = traced(lambda: inspect(replace(recording)))
    yield Row(f"the same traced: memory {1.0 + memory / nbytes(recording):.2f} of the samples", seconds, load_s, read_s)


def nbytes(recording: srt.Recording) -> int:
    """Bytes of the samples."""
    return sum(a.nbytes for a in (recording.time, recording.gyro, recording.accel))


def traced(call: Callable[[], object]) -> tuple[float, int]:
    """CPU time of a call while its memory is traced, which takes time, and its peak of bytes."""
    tracemalloc.start()
    seconds = cpu_time(call)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return seconds, peak


def memory_mib(pid: int) -> float:
    """Resident memory of a process, MiB."""
    return int(Path(f"/proc/{pid}/status").read_text(encoding="ascii").split("VmRSS:")[1].split()[0]) / 1024


def latencies(what: str, pid: int, inputs: Iterable, count: int, answered: Callable[[object], object]) -> Row:
    """Time from an input sent to its answer received; memory of the command early and at the end."""
    spans, early, load_s = np.empty(count), 0.0, cpu_time(numpy_load)
    for i, each in enumerate(inputs):
        began = time.perf_counter()
        answered(each)
        spans[i] = time.perf_counter() - began
        if i == count // 10:
            early = memory_mib(pid)
    median, high = 1e6 * np.percentile(spans[100:], (50, 99))
    memory = f"memory {early:.1f} MiB after a tenth, {memory_mib(pid):.1f} MiB at the end"
    name = f"{count:,} {what}: latency median {median:.0f} µs, 99th percentile {high:.0f} µs, {memory}"
    return Row(name, spans.sum(), load_s)


def stream(count: int) -> Iterator[Row]:
    """``srt apply`` of lines through its pipes and of MAVLink (HIGHRES_IMU) over UDP, each answer awaited."""
    rng = np.random.default_rng(2)
    readings = rng.standard_normal((count, 6)) * np.repeat([1.0, 9.8], 3)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "unit.json"
        errors = srt.SensorErrors(rng.normal(0.0, 0.01, N_PARAMETERS))
        srt.Calibration("", "converged", "", errors, np.eye(N_PARAMETERS) * 1e-8).save(file)
        command = [sys.executable, "-m", "srt.cli", "apply", str(file)]
        lines = [f"{0.005 * i:.9g}," + ",".join(f"{v:.9g}" for v in row) + "\n" for i, row in enumerate(readings)]
        yield by_pipes(command, lines)
        yield by_mavlink(command, readings)


def by_pipes(command: list[str], lines: list[str]) -> Row:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*command, "-"], **pipes, text=True, bufsize=1) as child:

        def answered(text: str) -> None:
            child.stdin.write(text)
            child.stdout.readline()

        return latencies("lines through the command", child.pid, lines, len(lines), answered)


def packets(readings: np.ndarray) -> Iterator[bytes]:
    """HIGHRES_IMU of one sender at 200 Hz."""
    from pymavlink.dialects.v20 import common

    link = common.MAVLink(None, srcSystem=1, srcComponent=1)
    for i, (*gyro, ax, ay, az) in enumerate(readings.tolist()):
        yield link.highres_imu_encode(5000 * i, ax, ay, az, *gyro, *[0.0] * 6, 25.0, 0b111111).pack(link)
        link.seq = (link.seq + 1) % 256


def by_mavlink(command: list[str], readings: np.ndarray) -> Row:
    with socket.socket(type=socket.SOCK_DGRAM) as answers, socket.socket(type=socket.SOCK_DGRAM) as sender:
        with socket.socket(type=socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            source = free.getsockname()
        answers.bind(("127.0.0.1", 0))
        answers.settimeout(0.2)
        into, out = (f"udp:{host}:{port}" for host, port in (source, answers.getsockname()))

        def answered(packet: bytes) -> bytes:
            sender.sendto(packet, source)
            return answers.recv(4096)

        with subprocess.Popen([*command, "--from", into, "--to", out], stderr=subprocess.DEVNULL) as child:
            try:
                for _ in range(300):
                    with suppress(TimeoutError):
                        answered(next(packets(readings)))
                        break
                answers.settimeout(10.0)
                return latencies("MAVLink packets", child.pid, packets(readings), len(readings), answered)
            finally:
                child.terminate()


MORE = ("inspection", "stream")


def main(*, long: bool = False, only: tuple[str, ...] = DEFAULT_PARTS, rounds: int = ROUNDS) -> None:
    print("| what | CPU time, ms | over the numpy load | over one read of the samples | peer |")
    print("|---|---|---|---|---|")
    parts = {
        "memory": partial(in_memory, rounds),
        "processes": partial(processes, rounds),
        "length": partial(length, (100_000, 1_000_000, 20_000_000) if long else (100_000, 1_000_000)),
        "inspection": partial(inspection, rounds),
        "stream": partial(stream, 1_000_000 if long else 100_000),
    }
    for name, part in parts.items():
        if name in only:
            for row in part():
                print(row.text(), flush=True)


if __name__ == "__main__":
    harness.run(main, __doc__, only=(*DEFAULT_PARTS, *MORE))
