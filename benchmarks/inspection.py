"""Time and memory of the inspection of a one-hour log at 1 kHz, without reading it; 3 s are allowed.

``python benchmarks/inspection.py``; ``--still`` takes an hour at rest instead of one with rotations, ``--profile``
prints the time by function.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import cProfile
import pstats
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import sims
import srt
from srt.diagnosis import diagnose
from srt.diagnosis.inspection import inspect
from srt.reports.figures.inspection import inspection_figure
from srt.sequences.recognition import recognise

RATE_HZ = 1000.0
DURATION_S = 3600.0
ALLOWED_S = 3.0
"""Time allowed for the inspection, s."""
REPEATS = 3
"""Runs of which the median is printed."""


def with_turns() -> srt.Recording:
    """Recording of Table 1 six times, with the moves between the sequences, without labels."""
    scenario = sims.load_scenario("navigation-rlg")
    schedule = scenario.schedule.model_copy(update={"repeats": 6, "dwell_s": 10.8})
    recording = scenario.recording.model_copy(update={"sample_rate_hz": RATE_HZ})
    return sims.simulate(scenario.model_copy(update={"schedule": schedule, "recording": recording})).recording


def still() -> srt.Recording:
    """Recording of one hour at rest."""
    n = round(DURATION_S * RATE_HZ)
    rng = np.random.default_rng(1)
    imu = sims.load_scenario("industrial-mems").imu.noise.si()
    gyro = imu["gyro_noise"] * np.sqrt(RATE_HZ) * rng.standard_normal((n, 3))
    accel = imu["accel_noise"] * np.sqrt(RATE_HZ) * rng.standard_normal((n, 3)) + np.array([0.0, 0.0, 9.80665])
    return srt.Recording(np.arange(1, n + 1) / RATE_HZ, gyro, accel, srt.Site(9.80665))


def fresh(recording: srt.Recording) -> srt.Recording:
    """Copy of a recording without cached results."""
    return replace(recording)


def timed(call: Callable[[srt.Recording], object], recording: srt.Recording) -> str:
    """Median wall time and processor time, each run on a fresh copy."""
    spans = []
    for _ in range(REPEATS):
        given = fresh(recording)
        began = time.perf_counter(), time.process_time()
        call(given)
        spans.append((time.perf_counter() - began[0], time.process_time() - began[1]))
    wall, processor = np.median(spans, axis=0)
    return f"{wall:.2f} s ({processor:.2f} s of one core)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--still", action="store_true", help="an hour at rest")
    parser.add_argument("--profile", action="store_true", help="print the time by function")
    arguments = parser.parse_args()
    recording = still() if arguments.still else with_turns()
    n = len(recording.time)
    print(f"{n} samples at {RATE_HZ:g} Hz, {recording.time[-1] - recording.time[0]:.0f} s, kind {recording.kind}")
    if arguments.profile:
        profile = cProfile.Profile()
        profile.runcall(inspect, fresh(recording))
        pstats.Stats(profile).sort_stats("cumulative").print_stats(45)
        return
    began = time.perf_counter()
    inspection = inspect(fresh(recording))
    first = time.perf_counter() - began
    read = timed(lambda r: (r.gyro.sum(axis=0), r.accel.sum(axis=0)), recording)
    print(f"inspection with recognition: {timed(inspect, recording)}, {ALLOWED_S:g} s are allowed")
    print(f"  the first time, imports included: {first:.2f} s")
    if not arguments.still:
        print(f"  recognition alone {timed(recognise, recording)}")
    print(f"  diagnosis alone {timed(lambda r: diagnose(r, calibrating=False), recording)}")
    print(f"  figure {timed(lambda r: inspection_figure(r, inspection), recording)}")
    print(f"  one sum over all columns {read}")
    print(f"  {inspection.summary}")
    given = fresh(recording)
    tracemalloc.start()
    inspect(given)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    samples = sum(a.nbytes for a in (recording.time, recording.gyro, recording.accel))
    print(f"peak memory beyond the samples {peak / 1e6:.0f} MB, {peak / samples:.2f} times theirs")


if __name__ == "__main__":
    main()
