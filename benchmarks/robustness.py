"""Speed and memory of campaigns: trials per second and core, CPU time of each part, two workers against one.

``python benchmarks/robustness.py`` runs 17 sequences at 100 Hz with noise through the closed form, each trial in a
motion of its own and all in one; ``--memory`` runs 10,000 short trials and prints the memory of all processes on the
way. Ratios are of runs that take turns, so that a machine busy with other work moves them less.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import psutil
from rich.console import Console

import srt
from sims.robustness.campaign import Campaign, EstimatorChoice, load_campaign
from sims.robustness.run import run_campaign
from sims.robustness.trial import run_trial
from sims.scenarios.simulation import simulate
from srt.comparison.parallel import Engine
from srt.estimation.options import Options
from srt.model.platform_steps import COMPILED_RECORDINGS

console = Console(width=120)
ROUNDS = 5
"""Rounds of a comparison; figures are their medians."""
MIB = 2.0**20


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


def per_trial(campaign: Campaign, trials: int) -> float:
    """CPU seconds of one trial in this process, mean: every tenth also computes the fixed point."""
    spent = []
    for k in range(trials + 1):
        began = time.thread_time()
        run_trial(campaign, (k % len(campaign.points), k // len(campaign.points)))
        spent.append(time.thread_time() - began)
    return statistics.mean(spent[1:])  # the first one imports


def parts(campaign: Campaign, trials: int) -> dict[str, float]:
    """CPU milliseconds of the parts of a trial, medians."""
    rows: dict[str, list[float]] = {"simulate": [], "calibrate": [], "again from the true errors": []}
    for k in range(trials):
        scenario, _ = campaign.unit(0, k)
        t0 = time.thread_time()
        simulation = simulate(scenario)
        t1 = time.thread_time()
        srt.calibrate(simulation.recording, "closed-form", checks=False)
        t2 = time.thread_time()
        srt.calibrate(simulation.recording, "closed-form", start=simulation.truth, checks=False)
        t3 = time.thread_time()
        for row, spent in zip(rows.values(), (t1 - t0, t2 - t1, t3 - t2), strict=True):
            row.append(1e3 * spent)
    return {name: statistics.median(row) for name, row in rows.items()}


def wall(campaign: Campaign, workers: int, folder: Path) -> float:
    began = time.perf_counter()
    run_campaign(campaign, folder, engine=Engine(workers), fresh=True)
    return time.perf_counter() - began


def speed(trials: int) -> None:
    for name, campaign in (("17 sequences, 100 Hz, noise", full()), ("50 Hz, 2 s of dwell, 2 rad/s", lean())):
        for motions, size in (("a motion each", 1), ("one motion", trials + 1)):
            for checked in (True, False):
                # As many trials as numba needs to be worth its start.
                chosen = replace(campaign, fixed_point=checked, trials_per_motion=size, trials=COMPILED_RECORDINGS)
                each = per_trial(chosen, trials)
                what = f"{motions}, {'fixed point checked' if checked else 'status believed'}"
                per_s = 1.0 / each
                console.print(f"{name}, {what}: {per_s:.1f} trials per second and core ({1e3 * each:.1f} ms of CPU)")
        shares = ", ".join(f"{part} {spent:.1f} ms" for part, spent in parts(campaign, trials).items())
        console.print(f"  of which, with a motion each, {shares}")


def workers(trials: int) -> None:
    campaign = replace(full(), trials=trials)
    one, two = [], []
    with tempfile.TemporaryDirectory() as folder:
        wall(replace(campaign, trials=4), 2, Path(folder) / "warm")  # starts the processes, which then stay
        for _ in range(ROUNDS):
            one.append(wall(campaign, 1, Path(folder) / "one"))
            two.append(wall(campaign, 2, Path(folder) / "two"))
    ratio = statistics.median(a / b for a, b in zip(one, two, strict=True))
    console.print(
        f"{trials} trials: one worker {statistics.median(one):.2f} s, two {statistics.median(two):.2f} s; "
        f"two against one {ratio:.2f} (median of {ROUNDS} rounds; {os.cpu_count()} cores)"
    )


def memory(trials: int) -> None:
    campaign = lean()
    campaign = replace(campaign, trials=-(-trials // len(campaign.points)))
    me = psutil.Process()

    def look(done: int, size: int) -> None:
        if done and done % (size // 10) == 0:
            used = [me.memory_info().rss, *(child.memory_info().rss for child in me.children(recursive=True))]
            mine, largest = used[0] / MIB, max(used[1:], default=0.0) / MIB
            console.print(f"{done} trials: this process {mine:.0f} MiB, the largest worker {largest:.0f} MiB")

    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        run_campaign(campaign, Path(folder), engine=Engine(2), progress=look)
        spent = time.perf_counter() - began
    console.print(f"{campaign.size} trials in {spent:.0f} s on two workers ({campaign.size / spent:.1f} per second)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=60, help="of each figure (default 60)")
    parser.add_argument("--memory", action="store_true", help="10,000 trials instead, and what they hold")
    arguments = parser.parse_args()
    if arguments.memory:
        memory(10_000)
        return
    speed(arguments.trials)
    workers(arguments.trials)


if __name__ == "__main__":
    main()
