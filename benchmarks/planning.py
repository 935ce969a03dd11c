"""Gain of planned tests over Table 1, and agreement of simulated units with the prediction.

``python benchmarks/planning.py`` plans every shipped plan file and prints the worst sigma over target of the plan, of
Table 1 in the same time (best order, best windows, same moves and waits), the bound, and the time in which a plan does
what Table 1 does. ``--simulate N`` simulates N units on the schedule of the plan and on that of Table 1, each with
errors, fixture and noise of its own, calibrates them by the optimum, and prints observed errors over targets, and
predicted over observed sigma.
"""

import math
import time

import harness
import numpy as np
from studies import markdown

import sims
import srt
from sims.scenarios.library import names
from sims.scenarios.plan_file import PlanFile, load_plan_file
from srt.planning.plan import Plan
from srt.planning.planner import make_plan, table_1_plan
from srt.sensor_errors import NAMES

SEED = 41000
"""Seed of the first simulated unit."""


def make_plans(file: PlanFile) -> tuple[Plan, Plan, float]:
    """Plan, Table 1 in the same time, and the duration of planning, s."""
    began = time.perf_counter()
    stand, conditions, targets = file.stand.kinematics(), file.conditions(), file.targets.sigma()
    plan = make_plan(stand, conditions, targets, total_s=file.plan.total_time_s, limits=file.plan.limits())
    spent = time.perf_counter() - began
    return plan, table_1_plan(stand, conditions, targets, file.plan.total_time_s, file.plan.limits()), spent


def least_time(file: PlanFile, table_1: Plan) -> Plan:
    """Shortest plan with the worst ratio of Table 1."""
    targets = file.targets.sigma() * table_1.ratio
    return make_plan(file.stand.kinematics(), file.conditions(), targets, limits=file.plan.limits())


def observed_errors(file: PlanFile, plan: Plan, estimator: str, units: int, title: str) -> np.ndarray:
    """RMS error of simulated units, shape (27,), SI."""
    squares = np.zeros(len(NAMES))
    scenario = file.scenario(plan)
    for k in range(units):
        simulation = sims.simulate(scenario.model_copy(update={"seed": SEED + k}))
        found = srt.calibrate(simulation.recording, estimator, checks=False)
        if found.status != "converged":
            raise SystemExit(f"{title}: unit {SEED + k} ended {found.status}: {found.message}")
        squares += (found.errors.vector - simulation.truth.vector) ** 2
    return np.sqrt(squares / units)


def without_gravity(plan: Plan) -> np.ndarray:
    """Predicted sigma without the uncertainty of gravity, which the simulator does not draw."""
    return np.sqrt(plan.prediction.sigma**2 - plan.prediction.sources["gravity"] ** 2)


def compare(file: PlanFile, plan: Plan, table_1: Plan, estimator: str, units: int) -> None:
    targets = file.targets.sigma()
    counted = np.isfinite(targets)
    error = 1.0 / math.sqrt(2.0 * units)
    worst = []
    for title, one in (("plan", plan), ("Table 1", table_1)):
        rms = observed_errors(file, one, estimator, units, title)
        ratio = without_gravity(one) / rms
        worst.append(float((rms / targets)[counted].max()))
        k = int(np.nanargmax(np.where(counted, rms / targets, np.nan)))
        print(
            f"  {title}: {units} units by {estimator}: worst observed error {NAMES[k]} at {worst[-1]:.3f} of its "
            f"target; predicted over observed sigma {ratio[counted].min():.3f} to {ratio[counted].max():.3f} "
            f"({error:.3f} standard error each)"
        )
    print(f"  observed: the plan is {less(*worst)} better")


def less(value: float, than: float) -> str:
    """Relative difference."""
    return f"{100.0 * (1.0 - value / than):.0f} %"


def main(
    plans: tuple[str, ...] = tuple(names("plan")),
    *,
    simulate: int = 0,
    estimator: str = "least-squares",
    no_time: bool = False,
) -> None:
    """Names or paths of plan files; units simulated on each schedule; ``no_time`` leaves the least time out."""
    rows = []
    for name in plans:
        file = load_plan_file(name)
        plan, table_1, spent = make_plans(file)
        shortest = None if no_time else least_time(file, table_1)
        saved = "" if shortest is None else f"{shortest.total_s:.0f} s, {less(shortest.total_s, table_1.total_s)} less"
        rows.append([
            name, f"{plan.ratio:.3f}", f"{table_1.ratio:.3f}", less(plan.ratio, table_1.ratio), f"{plan.bound:.3f}",
            less(plan.bound, table_1.ratio), str(len(plan.candidates)), saved, f"{spent:.0f} s",
        ])  # fmt: skip
        if simulate:
            print(name)
            compare(file, plan, table_1, estimator, simulate)
    columns = "plan file", "plan", "Table 1", "better", "bound", "at most", "sequences", "time for the same", "planning"
    print(*markdown(columns, rows), sep="\n")


if __name__ == "__main__":
    harness.run(main, __doc__)
