"""Results of a process whose kernels its environment selects: words, and values in units of their sigma, as JSON.

``python process_results.py NAME [SEED]`` prints the results of a subject; with a seed, the inputs differ by rounding.
"""

import json
import sys
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from foreign_motion import GRADES, drawn_errors, hand_turns, recording
from threadpoolctl import threadpool_info

import sims
import srt
from sims.scenarios.plan_file import load_plan_file
from srt.planning import annealing
from srt.planning.plan import PlanLimits

SHORT = PlanLimits(shortest_window_s=4.0, longest_window_s=30.0, largest_turn_deg=360, most_legs=2, most_sequences=12)
PLANS = ("short plan", "navigation-equal", "tactical-gyro-heavy")
SCHEDULE = {"dwell_s": 4.0, "rate_rad_s": 2.0, "acceleration_rad_s2": 20.0}
SCENARIOS = {
    "recorded moves": {"imu": "tactical-fog", "fixture": "lab-1mrad", "schedule": SCHEDULE | {"moves": "recorded"}},
    "exchanged labels": {"imu": "navigation-rlg", "fixture": "lab-1mrad", "schedule": SCHEDULE},
    "protocol by hand": {"imu": "industrial-mems", "protocol": "hand-turned"},
}
RECORDINGS = (*SCENARIOS, "turns in hand")
SUBJECTS = (*PLANS, *RECORDINGS)


def simulated(name):
    """Recording of a subject; that of the turns in hand is by another generator, and has no labels."""
    if name == "turns in hand":
        rng = np.random.default_rng(20261130)
        turns = hand_turns(rng, shortest_s=1.0, longest_s=4.0, count=18, rest_s=3.0)
        return recording(turns, 5.0, drawn_errors(GRADES["consumer"], rng), GRADES["consumer"], rng, hz=50.0)
    tables = {key: {"from": value} if isinstance(value, str) else value for key, value in SCENARIOS[name].items()}
    common = {"seed": 41, "site": {"from": "latitude-45"}, "recording": {"sample_rate_hz": 50.0}}
    found = sims.simulate(sims.scenario_from_dict(common | tables)).recording
    if name != "exchanged labels":
        return found
    first, second, *others = found.sequences
    return found.with_sequences((replace(first, id=second.id), replace(second, id=first.id), *others))


def off_by_rounding(values, seed):
    """Values that differ in the last bit, at random; the same without a seed."""
    sign = 0.0 if seed is None else np.random.default_rng(seed).choice([-1.0, 1.0], np.shape(values))
    return values * (1.0 + np.finfo(float).eps * sign)


def of_plan(name, seed):
    short = name == "short plan"
    task = load_plan_file("tactical-equal" if short else name).task()
    if short:
        task = replace(task, total_s=300.0, limits=SHORT)
    with patch.object(annealing, "TRIALS", annealing.TRIALS // 8 if short else annealing.TRIALS):
        plan = srt.plan(replace(task, targets=off_by_rounding(task.targets, seed)))
    words = [str(plan), *map(str, plan.candidates)]
    return words, [*plan.windows_s.ravel().tolist(), *np.log(plan.sigma[np.isfinite(plan.sigma)]).tolist()]


def of_recording(name, seed):
    """Recognition, diagnosis and calibration; values in sigmas, and logarithms of the sigmas."""
    unit = simulated(name)
    unit = replace(unit, gyro=off_by_rounding(unit.gyro, seed), accel=off_by_rounding(unit.accel, seed))
    seen, found = srt.recognise(unit), srt.calibrate(unit, checks=False)
    words = [seen.summary, str(seen.windows.tolist()), *(f.sentence for f in srt.diagnose(unit).findings), str(found)]
    words += [found.message, *found.warnings]
    sigma = found.sigma[found.observed]
    return words, [*(found.errors.vector[found.observed] / sigma).tolist(), *np.log(sigma).tolist()]


def results(name, seed=None):
    """Words, and values that are to be the same within 1e-6."""
    return (of_plan if name in PLANS else of_recording)(name, seed)


if __name__ == "__main__":
    words, values = results(sys.argv[1], *map(int, sys.argv[2:]))
    kernels = [library["architecture"] for library in threadpool_info() if library["internal_api"] == "openblas"]
    print(json.dumps({"kernels": kernels, "words": words, "values": values}))
