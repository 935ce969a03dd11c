"""Speed of everything in one table: estimators in memory, commands as processes, length of a recording, two workers.

``python benchmarks/speed.py`` prints it as Markdown; ``--only PART ...`` takes parts of it, or others: correction of
readings, inspection of an hour at 1 kHz, units calibrated as arrays, sizes of results (a fleet of 10,000, a million
trials). ``--long`` adds 20 million samples, ``--rounds N`` takes medians of N. Times are CPU times on one core
(``workers``: wall times). Each has its ratio to a fixed numpy load that runs right before it, so that a busy or another
machine matters less. benchmarks/README.md says what the rows are.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import accuracy_trials
import numpy as np
import recorded_sets
import robustness
from numpy_load import Row, beside_load, cpu_time, numpy_load
from speed_of_parts import correction, inspection, nbytes, sizes, traced, units_as_arrays

import srt
from sims.physics.imu import read_out
from sims.physics.sequences import TABLE_1
from sims.physics.table_motion import table1_motion
from sims.robustness.run import run_campaign
from srt.comparison.estimator_comparison import default_estimators
from srt.comparison.parallel import Engine
from srt.model.analytic_platform import integrate_attitude
from srt.model.gyro_stream import gyro_stream
from srt.model.platform_steps import COMPILED_RECORDINGS, many_recordings
from srt.model.sensor_model import gyro_triad
from srt.noise.noise_model import noise_model
from srt.sequences.preparation import prepare

MORE = {"correction": correction, "inspection": inspection, "units": units_as_arrays, "sizes": sizes}
PARTS = ("memory", "processes", "length", *MORE, "workers")
DEFAULT_PARTS = ("memory", "processes", "length", "workers")
ROUNDS = 7
"""Repeats of each timing; figures are medians."""
SAMPLE_RATE_HZ = 200.0
PEERS = {
    "Xsens MTi from its file": "imu_tk in C++: 4.0 loads",
}
"""Other tools on the same work. imu_tk took 0.66 of this command as it was in November 2026, which took 6.1 loads."""


def sum_once(recording: srt.Recording) -> float:
    """One read of all samples: no calibration can be faster."""
    return float(recording.gyro.sum() + recording.accel.sum())


def process_time(arguments: list[str], environment: dict[str, str] | None = None) -> float:
    """CPU time of a process with its start and its own processes, s.

    Raises
    ------
    RuntimeError
        If it ends with an error.
    """
    before = os.times()
    done = subprocess.run(
        arguments, capture_output=True, text=True, check=False, env={**os.environ, **(environment or {})}
    )
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


def workers(rounds: int) -> list[str]:
    """Wall time of a campaign with one worker over that with two, by joblib and by Dask where it is installed."""
    campaign = replace(robustness.full(), trials=60)
    engines: dict[str, Callable[[int], AbstractContextManager[Engine]]] = {"joblib": joblib_engine}
    if find_spec("distributed") is not None:
        engines["Dask"] = dask_engine
    lines = []
    for name, engine in engines.items():
        ratios = []
        for _ in range(rounds):
            spans = []
            for count in (1, 2):
                with engine(count) as made, tempfile.TemporaryDirectory() as folder:
                    run_campaign(replace(campaign, trials=4), Path(folder, "warm"), engine=made)
                    began = time.perf_counter()
                    run_campaign(campaign, Path(folder, "timed"), engine=made)
                    spans.append(time.perf_counter() - began)
            ratios.append(spans[0] / spans[1])
        lines.append(f"Campaign by {name}: two workers are {np.median(ratios):.2f} times one ({rounds} rounds).")
    return lines


@contextmanager
def joblib_engine(count: int) -> Iterator[Engine]:
    """Processes of joblib."""
    yield Engine(count)


@contextmanager
def dask_engine(count: int) -> Iterator[Engine]:
    """Workers of one thread on this machine, behind a scheduler of Dask."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None) as cluster:
        yield Engine(count, cluster.scheduler_address)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--long", action="store_true", help="up to 20 million samples")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=DEFAULT_PARTS, help="parts of the table")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="repeats of each timing")
    arguments = parser.parse_args()
    print("| what | CPU time, ms | over the numpy load | over one read of the samples | peer |")
    print("|---|---|---|---|---|")
    lengths = (100_000, 1_000_000, 20_000_000) if arguments.long else (100_000, 1_000_000)
    parts = {
        "memory": partial(in_memory, arguments.rounds),
        "processes": partial(processes, arguments.rounds),
        "length": partial(length, lengths),
        **{name: partial(part, arguments.rounds) for name, part in MORE.items()},
    }
    for name, part in parts.items():
        if name in arguments.only:
            for row in part():
                print(row.text(), flush=True)
    if "workers" in arguments.only:
        print("\n" + "\n".join(workers(min(arguments.rounds, 3))))


if __name__ == "__main__":
    main()
