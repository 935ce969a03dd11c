"""Speed and memory figures: medians, and ratios to one read of the samples in the same run, on one core.

``python benchmarks/speed.py`` runs all; ``--long`` adds 20 million samples.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import accuracy_trials
import numpy as np
import recorded_sets

import srt
from sims.physics.imu import read_out
from sims.physics.sequences import TABLE_1
from sims.physics.table_motion import table1_motion
from srt.comparison.estimator_comparison import default_estimators, run_estimators
from srt.model.analytic_platform import gyro_stream, integrate_attitude
from srt.model.sensor_model import gyro_triad

REPEATS = 15
"""Repeats of each timing; figures are medians."""


def timed(call: Callable[[], object], repeats: int = REPEATS, clock: Callable[[], float] = time.perf_counter) -> float:
    """Median time, s; wall time by default."""
    spans = []
    for _ in range(repeats):
        began = clock()
        call()
        spans.append(clock() - began)
    return float(np.median(spans))


def table_1() -> None:
    recording, _ = accuracy_trials.noisy_recording(1, "navigation", sample_rate_hz=200.0)
    srt.calibrate(recording, checks=False)
    whole = timed(lambda: srt.calibrate(recording, checks=False))
    playbacks = len(srt.calibrate(recording, checks=False).corrections)
    read = timed(lambda: (recording.gyro.sum(), recording.accel.sum()))
    print(
        f"closed form, 17 sequences, {len(recording.time)} samples at 200 Hz: {whole * 1e3:.1f} ms "
        f"({playbacks} iterations), {whole / read:.0f} times summing the samples once"
    )


def side_by_side() -> None:
    recording, _ = accuracy_trials.noisy_recording(1, "navigation", sample_rate_hz=200.0)
    names, left_out = default_estimators(recording)
    run_estimators(recording, names)
    spans = [run_estimators(recording, names)[1] for _ in range(REPEATS)]
    medians = {name: float(np.median([span[name] for span in spans])) for name in names}
    each = ", ".join(f"{name} {median * 1e3:.0f} ms" for name, median in medians.items())
    together = float(np.median([sum(span.values()) for span in spans]))
    print(f"the estimators side by side, {len(recording.time)} samples at 200 Hz: {together:.2f} s ({each})")
    for name, reason in left_out.items():
        print(f"  {name} left out: {reason}")


def with_drift() -> None:
    """Joint estimation with and without stated bias instability, Table 1 once and four times over; CPU time."""
    rng = np.random.default_rng(3)
    gyro, accel = accuracy_trials.INSTABILITY["navigation"]
    imu = replace(accuracy_trials.GRADES["navigation"], gyro_bias_instability=gyro, accel_bias_instability=accel)
    for times in (1, 4):
        motion = table1_motion(site=accuracy_trials.SITE, sample_rate_hz=50.0, sequences=tuple(TABLE_1) * times)
        drifting = read_out(motion, accuracy_trials.normal_errors(rng), imu, rng)
        still = replace(drifting.noise, gyro_bias_instability=None, accel_bias_instability=None)
        quiet = replace(drifting, noise=still)
        for name in ("ekf", "graph"):
            spans = [
                timed(partial(srt.calibrate, r, name, checks=False, gyro_bias=bias), 5, time.process_time)
                for r, bias in ((drifting, "auto"), (quiet, "pooled"))
            ]
            print(
                f"{name}, {17 * times} sequences: {spans[0]:.2f} s with bias instability, {spans[1]:.2f} s without, "
                f"ratio {spans[0] / spans[1]:.2f}"
            )


def play_back() -> None:
    recording, truth = accuracy_trials.noisy_recording(1, "navigation", sample_rate_hz=200.0)
    n = len(recording.time)
    spans = np.linspace(0, n, 18).astype(int)
    spans = np.stack([spans[:-1], spans[1:]], axis=1)
    stream = gyro_stream(recording.gyro, recording.interval_s, spans, spans, rates=True)
    earth = np.zeros((17, 3))
    triad = gyro_triad(truth)
    one = timed(lambda: integrate_attitude(stream, triad, earth))
    read = timed(lambda: (recording.gyro.sum(axis=0), recording.accel.sum(axis=0)))
    print(
        f"one iteration with Jacobian: {one / n * 1e9:.0f} ns per integrated sample, "
        f"{one / read:.1f} times reading all columns once ({read / n * 1e9:.0f} ns)"
    )


def free_recording() -> None:
    folder = recorded_sets.data_folder()
    if folder is None:
        print("recorded sets not found: xsens_mti not timed")
        return
    recording = recorded_sets.xsens_mti(folder)
    arrays = recording.time, recording.gyro, recording.accel

    def whole() -> object:
        fresh = srt.Recording(*arrays, recording.site)
        return srt.calibrate(fresh, checks=False)

    whole()
    print(f"xsens_mti, {len(recording.time)} samples from arrays, segmentation included: {timed(whole) * 1e3:.0f} ms")


def scaling(sizes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    for n in sizes:
        recording = long_recording(n, rng)
        tracemalloc.start()
        began = time.perf_counter()
        calibration = srt.calibrate(recording, "closed-form", checks=False)
        span = time.perf_counter() - began
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        samples = sum(a.nbytes for a in (recording.time, recording.gyro, recording.accel))
        print(
            f"{len(recording.time):>9d} samples: {span:6.2f} s, {span / len(recording.time) * 1e9:4.0f} ns per sample, "
            f"peak memory {1.0 + peak / samples:.2f} times the samples ({calibration.status})"
        )


def long_recording(n: int, rng: np.random.Generator) -> srt.Recording:
    """The 17 sequences at the sample rate that gives about n samples."""
    rate = n / 456.0
    recording, _ = accuracy_trials.noisy_recording(
        int(rng.integers(1 << 30)), "tactical", sample_rate_hz=float(round(rate))
    )
    return recording


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--long", action="store_true", help="up to 20 million samples")
    arguments = parser.parse_args()
    table_1()
    side_by_side()
    with_drift()
    play_back()
    free_recording()
    scaling((100_000, 1_000_000, 20_000_000) if arguments.long else (100_000, 1_000_000))


if __name__ == "__main__":
    main()
