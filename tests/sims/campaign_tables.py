"""Tables of trials with known results, for the tests of the reports of a robustness campaign."""

from functools import cache
from itertools import product

import pyarrow as pa

from sims.robustness.trial_table import Header
from srt.sensor_errors import DISPLAY_FACTORS, NAMES


def header(**changes):
    given = {
        "name": "study",
        "description": "How far from true?",
        "seed": 7,
        "trials": 1,
        "grid": {},
        "random": {},
        "estimators": ("closed-form",),
        "noisy": True,
        "replay": "srt robustness study.toml --replay ",
    }
    return Header(**(given | changes))


def table(rows, types=None):
    """Rows as a campaign leaves them: what an outcome does not have is null."""
    complete = []
    for k, row in enumerate(rows):
        whole = {"point": 0, "replicate": k, "seed": 1000 + k, "estimator": "closed-form", "outcome": "converged"}
        whole |= row
        ran = whole["outcome"] not in ("no_imu", "refused")
        whole = {"status": whole["outcome"], "message": None, "playbacks": 4 if ran else None} | whole
        whole = {"distance": 0.5 if whole["outcome"] == "converged" else None, "simulate_s": 0.5} | whole
        whole = {"calibrate_s": None if whole["outcome"] == "no_imu" else 0.25} | whole
        whole = {"largest": 2.0 if ran else None} | whole
        whole = {"nees": 27.0 if ran else None, "observed": 27 if ran else None} | whole
        for name, factor in zip(NAMES, DISPLAY_FACTORS, strict=True):
            values = {"truth": 0.0, "error": 1.0 / factor, "sigma": 1.0 / factor} if ran else {}
            whole = {f"{stem}_{name}": values.get(stem) for stem in ("truth", "error", "sigma")} | whole
        complete.append(whole)
    return pa.Table.from_pylist(complete)


def grid_rows(grid, estimators, trials, outcome):
    """Every point, trial and estimator; ``outcome(estimator, number, **settings)`` says what became of it."""
    return [
        {"point": p, "replicate": k, "estimator": name, **settings, "outcome": outcome(name, k, **settings)}
        for p, settings in enumerate(dict(zip(grid, v, strict=True)) for v in product(*grid.values()))
        for k in range(trials)
        for name in estimators
    ]


SCALES = {"scale_percent": [1.0, 10.0, 50.0], "misalignment_mrad": [1.0, 100.0, 300.0, 500.0]}


def staircase(name, number, scale_percent, misalignment_mrad):
    """Fail from scale 50 on if misaligned by 100 or more, and at 500; one unit of 300, 50 is no IMU."""
    if (scale_percent, misalignment_mrad, number) == (50.0, 300.0, 0):
        return "no_imu"
    hard = (scale_percent >= 50.0 and misalignment_mrad >= 100.0) or misalignment_mrad >= 500.0
    return "wrong_minimum" if hard and name == "closed-form" else "converged"


@cache
def staircase_study():
    told = header(trials=4, grid=SCALES, estimators=("closed-form", "graph"))
    return table(grid_rows(SCALES, told.estimators, 4, staircase)), told


def noisy_rows(n, size, held=()):
    """Errors of ± their sigma but for those in ``size``, which are as many sigmas."""
    rows = []
    for k in range(n):
        row = {"nees": 27.0 * (1.0 + 0.001 * (-1) ** k)}
        for name, factor in zip(NAMES, DISPLAY_FACTORS, strict=True):
            row[f"error_{name}"] = (-1) ** k * size.get(name, 1.0) / factor
        rows.append(row | {f"{stem}_{name}": None for stem in ("error", "sigma") for name in held})
    return rows
