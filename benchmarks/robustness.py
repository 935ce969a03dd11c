"""Speed and memory of campaigns: trials per second and core, CPU time of each part, two workers against one.

``python benchmarks/robustness.py`` runs 17 sequences at 100 Hz with noise, and short noise-free ones, through the
closed form, each trial in a motion of its own and all in one, one trial after the other and in batches. The fixed
numpy load of ``benchmarks/numpy_load.py`` stands beside. ``--trials N`` are those of each figure. ``--memory N`` runs N
short trials in this process and prints the peak of its memory; ``--equal N`` compares N units of ±50 % and 0.3 rad with
single runs. Ratios are of runs that take turns, so that a machine busy with other work moves them less.
"""

import math
import os
import resource
import statistics
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

import harness
import numpy as np
from numpy_load import cpu_time, numpy_load

import srt
from sims.robustness.campaign import Campaign, EstimatorChoice, load_campaign
from sims.robustness.run import LARGEST_BATCH, batched, run_campaign
from sims.robustness.trial import run_batch
from sims.scenarios.simulation import simulate
from srt.comparison.parallel import Engine
from srt.estimation.options import Options
from srt.model.platform_steps import COMPILED_RECORDINGS
from srt.sensor_errors import NAMES

ROUNDS = 5
"""Rounds of a comparison; figures are their medians."""


def full() -> Campaign:
    """All sequences at 100 Hz, all noise of a tactical unit, closed form."""
    campaign = load_campaign("honesty")
    grid = {"grade": ("tactical-fog",), "scale_percent": (1.0,)}
    return replace(campaign, grid=grid, estimators=(EstimatorChoice("closed-form", "closed-form", Options()),))


def lean() -> Campaign:
    """Two seconds of dwell, 2 rad/s, 50 Hz: as a map of convergence needs."""
    campaign = load_campaign("quick")
    schedule = {**campaign.scenario["schedule"], "dwell_s": 2.0, "rate_rad_s": 2.0}
    recording = {**campaign.scenario.get("recording", {}), "sample_rate_hz": 50.0}
    return replace(campaign, scenario={**campaign.scenario, "schedule": schedule, "recording": recording})


def per_trial(campaign: Campaign, trials: int, batch: int) -> float:
    """CPU seconds of one trial in this process, mean: every tenth also computes the fixed point."""
    tasks = islice(campaign.tasks, 1, None)
    run_batch(campaign, [(0, 0)])  # the first one imports
    began = time.thread_time()
    for own in batched(islice(tasks, trials), batch):
        run_batch(campaign, own)
    return (time.thread_time() - began) / trials


def parts(campaign: Campaign, trials: int) -> dict[str, float]:
    """CPU milliseconds of the parts of a trial, medians."""
    rows: dict[str, list[float]] = {"simulate": [], "calibrate": [], "from the true errors": [], "with all checks": []}
    for k in range(trials):
        scenario, _ = campaign.unit(0, k)
        t0 = time.thread_time()
        simulation = simulate(scenario)
        t1 = time.thread_time()
        srt.calibrate(simulation.recording, "closed-form", checks=False)
        t2 = time.thread_time()
        srt.calibrate(simulation.recording, "closed-form", start=simulation.truth, checks=False)
        t3 = time.thread_time()
        with suppress(srt.SrtError):  # units far from those of a data sheet have faults
            srt.calibrate(replace(simulation.recording), "closed-form")
        t4 = time.thread_time()
        for row, spent in zip(rows.values(), (t1 - t0, t2 - t1, t3 - t2, t4 - t3), strict=True):
            row.append(1e3 * spent)
    return {name: statistics.median(row) for name, row in rows.items()}


def wall(campaign: Campaign, workers: int, folder: Path) -> float:
    began = time.perf_counter()
    run_campaign(campaign, folder, engine=Engine(workers), fresh=True)
    return time.perf_counter() - began


def speed(trials: int) -> None:
    print("| trials | motion | fixed point | batch | ms of CPU | a second and core | numpy loads |")
    print("|---|---|---|---:|---:|---:|---:|")
    for name, campaign in (("17 sequences, 100 Hz, noise", full()), ("50 Hz, 2 s of dwell, 2 rad/s", lean())):
        for motion, size in (("each", 1), ("one", trials + 1)):
            for checked in (True, False):
                # As many trials as numba needs to be worth its start.
                chosen = replace(campaign, fixed_point=checked, trials_per_motion=size, trials=COMPILED_RECORDINGS)
                for batch in (1, LARGEST_BATCH):
                    load_s, each = cpu_time(numpy_load), per_trial(chosen, trials, batch)
                    figures = f"{1e3 * each:.1f} | {1.0 / each:.1f} | {each / load_s:.3f}"
                    what = "checked" if checked else "not checked"
                    print(f"| {name} | {motion} | {what} | {batch} | {figures} |")
        shares = ", ".join(f"{part} {spent:.1f} ms" for part, spent in parts(campaign, min(trials, 20)).items())
        print(f"\n{name}, parts of a trial one after the other: {shares}\n")


def largest_difference(trials: int) -> float:
    """Largest difference of an estimate in a batch from that of a single run, in sigma."""
    campaign = lean()
    recording = {**campaign.scenario["recording"], "noise": True}
    grid = {**campaign.grid, "scale_percent": (50.0,), "misalignment_mrad": (300.0,)}
    campaign = replace(
        campaign, scenario={**campaign.scenario, "recording": recording}, grid=grid, trials=trials,
        trials_per_motion=trials, fixed_point=False,
    )  # fmt: skip
    tasks = list(campaign.tasks)
    together = chain(*(run_batch(campaign, own) for own in batched(tasks, LARGEST_BATCH)))
    outcomes, largest = Counter[str](), 0.0
    for (row,), task in zip(together, tasks, strict=True):
        outcomes[row["outcome"]] += 1
        if row["outcome"] == "no_imu":
            continue
        simulation = simulate(campaign.unit(*task)[0])
        try:
            alone = srt.calibrate(simulation.recording, "closed-form", checks=False)
            told, errors = (alone.status, alone.message), alone.errors.vector - simulation.truth.vector
        except srt.SrtError as error:
            told = None, str(error)
        if (row.get("status"), row["message"]) != told:
            print(f"trial {task}: {row['message']} in a batch, {told[1]} alone")
            largest = math.inf
        elif row["outcome"] == "converged":
            off = np.array([row[f"error_{name}"] for name in NAMES]) - errors
            largest = max(largest, float(np.nanmax(np.abs(off) / alone.sigma)))
    print(f"{trials} units of ±50 % and 0.3 rad, with noise, in batches of {LARGEST_BATCH}: {dict(outcomes)}")
    print(f"largest difference from single runs: {largest:.1e} sigma")
    return largest


def workers(trials: int) -> None:
    campaign = replace(full(), trials=trials)
    one, two = [], []
    with tempfile.TemporaryDirectory() as folder:
        wall(replace(campaign, trials=4), 2, Path(folder) / "warm")  # starts the processes, which then stay
        for _ in range(ROUNDS):
            one.append(wall(campaign, 1, Path(folder) / "one"))
            two.append(wall(campaign, 2, Path(folder) / "two"))
    ratio = statistics.median(a / b for a, b in zip(one, two, strict=True))
    print(
        f"{trials} trials: one worker {statistics.median(one):.2f} s, two {statistics.median(two):.2f} s; "
        f"two against one {ratio:.2f} (median of {ROUNDS} rounds; {os.cpu_count()} cores)"
    )


def peak_memory(trials: int) -> None:
    campaign = lean()
    campaign = replace(campaign, trials=-(-trials // len(campaign.points)), trials_per_motion=100)

    def look(done: int, size: int) -> None:
        if done == size:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            print(f"{done} trials: peak of the memory {peak:.0f} MiB")

    load_s, began = cpu_time(numpy_load), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        run_campaign(campaign, Path(folder), progress=look)
    spent = time.process_time() - began
    each = spent / campaign.size
    print(
        f"{spent:.0f} s of CPU, {1.0 / each:.1f} trials a second and core ({each / load_s:.3f} numpy loads each); "
        f"100,000 would take {1e5 * each / 60.0:.0f} minutes of CPU"
    )


def main(*, trials: int = 60, memory: int | None = None, equal: int | None = None) -> int:
    if memory is not None:
        peak_memory(memory)
    elif equal is not None:
        return int(largest_difference(equal) > 1e-9)
    else:
        speed(trials)
        workers(trials)
    return 0


if __name__ == "__main__":
    harness.run(main, __doc__)
