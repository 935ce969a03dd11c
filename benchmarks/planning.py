"""Plans of the shipped plan files: worst ratio over its bound, and a search with many times as many trials.

``python benchmarks/planning.py`` prints the table of docs/planning.md, with the CPU time of a plan over the numpy load.
``--search 60`` adds the ratio of a search with sixty times the trials, some ten minutes a plan. Names select plan
files.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import TYPE_CHECKING

from numpy_load import beside_load, cpu_time

import srt
from sims.scenarios.library import names
from sims.scenarios.plan_file import load_plan_file
from srt.planning.planner import Planner, table_1_plan

if TYPE_CHECKING:
    from srt.planning.plan import Plan
    from srt.planning.task import PlanTask


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=names("plan"))
    parser.add_argument("--search", type=float, default=0.0, help="multiple of the trials")
    arguments = parser.parse_args()
    print("| plan file | plan | Table 1 | better by | bound | ratio / bound | sequences | loads | long search |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in arguments.names:
        task = load_plan_file(name).task()
        plans = []
        seconds, load_s = beside_load(partial(cpu_time, partial(keep, plans, task)), 1)
        plan = plans[0]
        rival = table_1_plan(task.fixture, task.conditions, plan.targets, plan.total_s, task.limits)
        long = ""
        if arguments.search:
            planner = Planner(task.fixture, task.conditions, plan.targets, task.limits)
            design = planner.continuous(task.total_s)
            long = f"{planner.integer_plan(design, task.total_s, arguments.search).ratio / plan.bound:.3f}"
        gain = 100.0 * (1.0 - plan.ratio / rival.ratio)
        print(
            f"| `{name}` | {plan.ratio:.3f} | {rival.ratio:.3f} | {gain:.0f} % | {plan.bound:.3f} "
            f"| {plan.ratio / plan.bound:.3f} | {len(plan.candidates)} | {seconds / load_s:.0f} | {long} |",
            flush=True,
        )


def keep(plans: list[Plan], task: PlanTask) -> None:
    plans.append(srt.plan(task))


if __name__ == "__main__":
    main()
