"""Errors of calibrations of units that are known: over their sigmas, a bound, or those of another method.

``python benchmarks/honesty.py STUDY --units N`` prints a Markdown table, a row for each cell and estimator; ``--only
WORD ...`` takes the cells with these words. NEES is over the number of observed parameters, 1 if all sigmas are true;
the band is that of the whole table (family-wise 1 %). The exit code is 1 if a cell lies beyond the limit of its study.

noise-free         worst errors of the closed form: perfect fixture, fixture errors, large sensor errors (biases in g)
simulated          noise of three grades on the fixture, stated, estimated, or with an effect that nothing models
efficiency         noise of three grades on the 1 mrad fixture: rms over the Cramér-Rao bound, that of each parameter
                   with the reported sigma over the bound, innovations of the filter (docs/design/efficiency.md)
fixture            the same over the Cramér-Rao bound, with axes out of square, by the accuracy of the rotations
fixture-moves      the same with recorded moves
nineteen-positions the 19-position test, no labels, over the bound, without and with what the model does not have
silent-errors      errors that gave wrong results without a word
hand, hand-stated  turned by hand, no labels: rms of the normalised errors; no noise stated, or the white noise
hand-drift         turned by hand, with drifts
worse-than-stated  fixture, biases or readings worse than stated, through ``srt calibrate``; what the result names
unstated-noise     nothing stated, of units without and with bias instability, and all stated; on a fixture, by hand
protocols          shipped protocols in equal time, over their bound, with asymmetries fixed and estimated
rivals             17 sequences by our estimators beside faces and full turns by imucal (docs/rivals.md)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import harness
import numpy as np
import studies
from accuracy_trials import GRADES as SIMULATED_GRADES
from accuracy_trials import NOISE_FREE, noise_free
from foreign_motion import DRIFT_FORMS, PROFILES
from foreign_motion import GRADES as HAND_GRADES
from honesty_trials import (
    NINETEEN_POSITIONS,
    SILENT_ERRORS,
    SIMULATED,
    by_hand,
    drift_by_hand,
    efficient,
    nineteen_positions,
    on_the_fixture,
    silent_errors,
    simulated,
    unstated_noise,
    worse_than_stated,
)
from protocols import ASYMMETRIES, PROTOCOLS, by_protocol
from rivals import FIXTURES_MRAD, METHODS, POPULATIONS, beside_imucal
from scipy.special import ndtri
from scipy.stats import binom, chi2
from studies import ESTIMATORS, Cell, Rows, Score, counts, pooled_nees, rms
from worse_recordings import CASES, STATEMENTS

from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, NAMES, SYMBOLS

Trial = Callable[[Cell, int, list[str]], Rows]
"""Scores of one unit of a cell, by estimator or by rule."""
SILENT_LIMIT = 1.15
"""Mean NEES over 27 that is allowed where an error is neither named nor inconsistent."""
COVERAGE = (0.935, 0.965)
"""Limits of the share of errors within their 95 % interval."""
MEAN_RMS, LARGEST_RMS = 1.02, 1.05
"""Limits of the rms of the errors of a parameter over the bound: mean of all, and largest."""
LARGEST_RATIO, ACCUSED_SHARE, DISAGREEING_SHARE = 1.03, 0.01, 0.015
"""Largest rms of the errors over the bound, and largest shares of sound units that are accused, and that disagree."""
Scores = list[Score]


def usable(scores: Scores, what: Callable[[Score], Any] = lambda s: s.z) -> np.ndarray:
    """Normalised errors, or something else, of the usable scores."""
    return np.array([what(s) for s in scores if s.usable])


def sensor_errors(scores: Scores) -> np.ndarray:
    """Errors without those of the gyro bias, shape (n, 24)."""
    return np.array([s.error[: GROUP_SLICES["gyro_bias"].start] for s in scores])


def largest(values: np.ndarray) -> float:
    return float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else np.nan


def band(scores: Scores, tests: int) -> float:
    """Upper end of the band of the pooled NEES."""
    freedom = sum(s.freedom for s in scores if s.usable)
    return float(chi2.isf(0.01 / tests, freedom) / freedom) if freedom else np.nan


def worst_rms(scores: Scores) -> float:
    z = usable(scores)
    return max((rms(column) for column in z.T if np.isfinite(column).any()), default=np.nan)


def rms_limit(scores: Scores, tests: int) -> float:
    """Largest rms of the normalised errors of one parameter, family-wise 1 %."""
    return float(np.sqrt(chi2.isf(0.01 / (2 * len(NAMES) * tests), len(scores)) / len(scores)))


def rms_of_group(group: str) -> Callable[[Scores, int], str]:
    """Rms of the normalised errors of a group."""
    return lambda scores, _: f"{rms(usable(scores)[:, GROUP_SLICES[group]]):.2f}"


def of_most(values: np.ndarray) -> float:
    """Root mean square; NaN if a third or more is NaN."""
    return rms(values) if 3 * np.isfinite(values).sum() > 2 * values.size else np.nan


def digits(value: float) -> str:
    """Text of three digits or more, without an exponent; a dash for NaN."""
    return "–" if np.isnan(value) else f"{value:.3g}" if value < 999.5 else f"{value:.0f}"


def error_of_group(group: str) -> Callable[[Scores, int], str]:
    """Rms error of a group in its display unit, with its ratio to the bound where that is known."""
    part = GROUP_SLICES[group]
    factors = np.array(DISPLAY_FACTORS)[part]

    def column(scores: Scores, _tests: int) -> str:
        bound = scores[0].bound
        error = of_most(usable(scores, lambda s: s.error)[:, part] * factors)
        limit = np.nan if bound is None else of_most(bound[part] * factors)
        ratio = "–" if np.isnan(error) else f"{error / limit:.2f}"
        return digits(error) + ("" if np.isnan(limit) else f" ({ratio} of {digits(limit)})")

    return column


def accel_orthogonality(scores: Scores, _tests: int) -> str:
    """Rms error of the angles between the accelerometers, µrad, to first order: it depends on no frame."""
    xy, xz, yx, yz, zx, zy = usable(scores, lambda s: s.error)[:, GROUP_SLICES["accel_misalignment"]].T
    return digits(1e6 * rms(np.array([xy + yx, yz + zy, zx + xz])))


def over_bound(scores: Scores) -> float:
    """Rms of the errors over the bound, all parameters and units together."""
    return rms(np.array([s.error / s.bound for s in scores]))


def rms_over_bound(scores: Scores) -> np.ndarray:
    """The same of each parameter, shape (27,)."""
    return np.sqrt(np.mean([(s.error / s.bound) ** 2 for s in scores], axis=0))


def parameter_over_bound(i: int) -> Callable[[Scores, int], str]:
    """Rms of the error and of the sigma of a parameter over its bound."""

    def column(scores: Scores, _tests: int) -> str:
        own = rms(np.array([s.sigma[i] / s.bound[i] for s in scores]))
        bound = scores[0].bound[i] * DISPLAY_FACTORS[i]
        return f"{rms_over_bound(scores)[i]:.2f}, {own:.2f} of {bound:#.3g} {DISPLAY_UNITS[i]}"

    return column


def extreme(which: Callable[[np.ndarray], Any]) -> Callable[[Scores, int], str]:
    """Smallest or largest rms over the bound, with its parameter."""

    def column(scores: Scores, _tests: int) -> str:
        ratio = rms_over_bound(scores)
        return f"{ratio[which(ratio)]:.3f} ({SYMBOLS[which(ratio)]})"

    return column


def covered(scores: Scores) -> np.ndarray:
    """Share of the errors of each unit within their 95 % interval."""
    return (np.abs(usable(scores)) < ndtri(0.975)).mean(axis=1)


def innovations(scores: Scores, _tests: int) -> str:
    """Variance of the innovations, which is 1, and their correlation with the next one, which is 0."""
    series = [np.concatenate(s.innovations) for s in scores if s.innovations]
    if not series:
        return "-"
    squares = sum(v @ v for v in series)
    next_one = sum(v[1:] @ v[:-1] for v in series) / squares
    return f"{squares / sum(map(len, series)):.3f}, {next_one:.4f}"


def parameter_rms(scores: Scores, _tests: int) -> str:
    """Smallest and largest rms of the normalised errors of one parameter."""
    each = [rms(column) for column in usable(scores).T if np.isfinite(column).any()]
    return f"{min(each):.2f}-{max(each):.2f}" if each else "-"


ERRORS = {group: f"{group}, {DISPLAY_UNITS[part.start]}" for group, part in GROUP_SLICES.items()}
"""Columns of the errors of the groups."""
COLUMNS: dict[str, Callable[[Scores, int], str]] = {
    "status": lambda scores, _: counts(s.status.replace("_", " ") for s in scores),
    "verdict": lambda scores, _: counts(s.word.replace("_", " ") for s in scores),
    "what is named": lambda scores, _: counts(what for s in scores for what in sorted(set(s.faults))),
    "NEES / n": lambda scores, _: f"{pooled_nees(scores):.2f}",
    "NEES/27": lambda scores, _: f"{np.nanmean([s.nees / s.freedom for s in scores]):.2f}",
    "band": lambda scores, tests: f"≤ {band(scores, tests):.2f}",
    "named": lambda scores, _: f"{np.mean([s.named for s in scores]):.0%}",
    "inconsistent": lambda scores, _: f"{np.mean([s.status == 'inconsistent' for s in scores]):.0%}",
    "accel. named": lambda scores, _: str(sum("accel" in s.drift for s in scores)),
    "gyro named": lambda scores, _: str(sum("gyro" in s.drift for s in scores)),
    "scale, ppm": lambda scores, _: f"{1e6 * max(usable(scores, lambda s: s.scale_sigma), default=np.nan):.0f}",
    "rms": lambda scores, _: f"{rms(usable(scores)):.2f}",
    "rms over bound": lambda scores, _: f"{over_bound(scores):.3f}",
    "mean over bound": lambda scores, _: f"{rms_over_bound(scores).mean():.3f}",
    "smallest over bound": extreme(np.argmin),
    "largest over bound": extreme(np.argmax),
    "covered": lambda scores, _: f"{covered(scores).mean():.3f}",
    "innovations": innovations,
    **{symbol: parameter_over_bound(i) for i, symbol in enumerate(SYMBOLS)},
    "accused": lambda scores, _: str(sum(s.status == "inconsistent" for s in scores)),
    "disagree": lambda scores, _: str(sum(s.named for s in scores)),
    "rms by parameter": parameter_rms,
    **{group: rms_of_group(group) for group in GROUP_SLICES},
    **{name: error_of_group(group) for group, name in ERRORS.items()},
    "accel_orthogonality, µrad": accel_orthogonality,
    "s": lambda scores, _: f"{np.median([s.seconds for s in scores]):.3f}",
    "worst": lambda scores, _: f"{largest(sensor_errors(scores)):.2e}",
    "rms of all": lambda scores, _: f"{rms(sensor_errors(scores)):.1e}",
    "worst accel. scale": lambda scores, _: f"{largest(sensor_errors(scores)[:, GROUP_SLICES['accel_scale']]):.1e}",
    "iterations": lambda scores, _: f"{min(s.playbacks for s in scores)}-{max(s.playbacks for s in scores)}",
    "distance": lambda scores, _: digits(max(s.distance for s in scores)),
    "worst rms": lambda scores, _: f"{worst_rms(scores):.2f}",
    "allowed": lambda scores, tests: f"{rms_limit(scores, tests):.2f}",
    "largest": lambda scores, _: f"{largest(usable(scores)):.1f}",
}
"""Columns of the tables, from the scores of a cell and the number of tests of the table."""


def silent_and_wrong(scores: Scores, _tests: int) -> bool:
    """True if units that are told nothing have a NEES above the limit by more than chance."""
    silent = [s.nees / s.freedom for s in scores if not s.named and s.status != "inconsistent"]
    # The mean of chi-square / 27 over the silent units scatters by the root.
    limit = SILENT_LIMIT + 3.5 * np.sqrt(2.0 / 27.0 / max(len(silent), 1))
    return len(silent) > 0.05 * len(scores) and bool(np.mean(silent) > limit)


def not_in_band(scores: Scores, tests: int) -> bool:
    """True if the pooled NEES of the usable results is above the band, or no result is usable."""
    return not pooled_nees(scores) <= band(scores, tests)


def off_the_bound(scores: Scores, tests: int) -> bool:
    """True if errors, NEES, or sound units in which something contradicts are beyond their limits, family-wise 1 %."""
    chance, n, freedom = 0.01 / (4 * tests), len(scores), sum(s.freedom for s in scores)
    # The rms of n errors has a relative standard error of 1/√(2 n).
    largest_ratio = LARGEST_RATIO * (1.0 - ndtri(chance) / np.sqrt(2.0 * freedom))
    low, high = chi2.ppf([0.5 * chance, 1.0 - 0.5 * chance], freedom)
    return (
        over_bound(scores) > largest_ratio
        or not low < sum(s.nees for s in scores) < high
        or sum(s.status == "inconsistent" for s in scores) > binom.isf(chance, n, ACCUSED_SHARE)
        or sum(s.named for s in scores) > binom.isf(chance, n, DISAGREEING_SHARE)
    )


def missed(scores: Scores, *, efficient: bool) -> list[str]:
    """Criteria of sigmas, and of an efficient estimator, that are missed by more than 3.5 standard errors."""
    n, ratio, inside = len(scores), rms_over_bound(scores), covered(scores)
    one = 1.0 / np.sqrt(2.0 * n)  # relative, of an rms
    # Errors of one unit are correlated, units are not: what each unit adds to the mean, to first order.
    by_unit = np.array([((s.error / s.bound) ** 2 / (2.0 * ratio)).mean() for s in scores])
    of_mean, of_share = (x.std(ddof=1) / np.sqrt(n) for x in (by_unit, inside))
    excess = {  # over a limit, and its standard error
        "NEES / 27": (abs(np.mean([s.nees for s in scores]) / 27.0 - 1.0), np.sqrt(2.0 / 27.0 / n)),
        "coverage": (max(COVERAGE[0] - inside.mean(), inside.mean() - COVERAGE[1]), of_share),
        # An estimator better than the bound would say that the bound is wrong.
        "smallest": (1.0 - ratio.min(), one),
    }
    if efficient:
        excess |= {
            "mean": (ratio.mean() - MEAN_RMS, of_mean),
            "largest": (ratio.max() - LARGEST_RMS, LARGEST_RMS * one),
        }
    status = ["status"] if any(s.status != "converged" for s in scores) else []
    return status + [name for name, (over, error) in excess.items() if over > 3.5 * error]


@dataclass(frozen=True)
class Study:
    """Cells and what is done in each: ``trial`` of a unit, the columns, and when a cell is beyond its limit.

    ``beyond`` holds for all estimators, or for those that are ``limited`` to it, ``unsound`` for all.
    """

    head: tuple[str, ...]
    cells: list[Cell]
    trial: Trial
    columns: tuple[str, ...]
    beyond: Callable[[Scores, int], bool] = lambda _scores, _tests: False
    estimators: tuple[str, ...] = ("least-squares",)
    limited: tuple[str, ...] = ()
    unsound: Callable[[Scores, int], bool] = lambda _scores, _tests: False

    def having(self, words: tuple[str, ...]) -> list[Cell]:
        """Cells that have one of the words that are values of their parts, for each part that has such words."""
        parts = [{str(cell[i]) for cell in self.cells} for i in range(len(self.head))]
        unknown = set(words).difference(*parts)
        if unknown:
            raise SystemExit(
                f"no cell has {', '.join(sorted(unknown))}; there are {', '.join(sorted(set().union(*parts)))}"
            )
        asked = [part & set(words) or part for part in parts]
        return [cell for cell in self.cells if all(str(x) in ask for x, ask in zip(cell, asked, strict=True))]


NAMED_DRIFT = ("status", "NEES / n", "band", "accel. named", "gyro named")
HAND = ("status", *GROUP_SLICES, "worst rms", "allowed", "largest")
HAND_CELLS: list[Cell] = list(product(HAND_GRADES, PROFILES))
MEMS = ("industrial", "consumer")


def far_off(scores: Scores, tests: int) -> bool:
    return not worst_rms(scores) <= rms_limit(scores, tests)


SHOWN_BY_POSES = ("gyro_scale", "gyro_orthogonality", "accel_bias", "accel_scale", "accel_misalignment")
FIXTURE = {
    "head": ("grade", "axes, mrad from square", "rotations, mrad"),
    "cells": list(product(SIMULATED_GRADES, (0, 1, 3), (0.05, 0.3, 1))),
    "columns": ("rms over bound", "NEES/27", "accused", "disagree", *ERRORS.values()),
    "beyond": off_the_bound,
    "estimators": ESTIMATORS,
    "limited": ("ekf", "graph"),
}
STUDIES = {
    "noise-free": Study(
        ("case",), [(name,) for name in NOISE_FREE], noise_free,
        ("status", "worst", "rms of all", "worst accel. scale", "iterations", "distance"), estimators=("closed-form",),
    ),
    "simulated": Study(
        ("grade", "case"), list(product(SIMULATED_GRADES, SIMULATED)), simulated,
        ("rms by parameter", *GROUP_SLICES, "NEES/27"), estimators=("closed-form",),
    ),
    "efficiency": Study(
        ("grade",), [(grade,) for grade in SIMULATED_GRADES], efficient,
        ("mean over bound", "smallest over bound", "largest over bound", "NEES/27", "covered", "innovations", *SYMBOLS),
        lambda scores, _: bool(missed(scores, efficient=True)), ESTIMATORS, ("graph", "ekf"),
        lambda scores, _: bool(missed(scores, efficient=False)),
    ),
    "fixture": Study(trial=partial(on_the_fixture, moves="skipped"), **FIXTURE),
    "fixture-moves": Study(trial=partial(on_the_fixture, moves="recorded"), **FIXTURE),
    "nineteen-positions": Study(
        ("case",), [(case,) for case in NINETEEN_POSITIONS], nineteen_positions,
        (*(name for group, name in ERRORS.items() if group in SHOWN_BY_POSES), "s"),
        estimators=("least-squares", "graph", "ekf"),
    ),
    "silent-errors": Study(
        ("error",), [(name,) for name in SILENT_ERRORS], silent_errors, ("NEES/27", "named", "inconsistent"),
        silent_and_wrong, ESTIMATORS,
    ),
    "hand": Study(("grade", "profile"), HAND_CELLS, partial(by_hand, stated=False), HAND, far_off),
    "hand-stated": Study(("grade", "profile"), HAND_CELLS, partial(by_hand, stated=True), HAND, far_off),
    "hand-drift": Study(
        ("grade", "drift", "mg, °/h"),
        [
            (grade, *drift)
            for grade in MEMS
            for drift in (("linear", "0, 0"), *product(DRIFT_FORMS, ("0.1, 10", "4, 300", "10, 1000")))
        ],
        drift_by_hand, (*NAMED_DRIFT, "scale, ppm"), not_in_band,
    ),
    "worse-than-stated": Study(
        ("case",), [(name,) for name in CASES], worse_than_stated, ("NEES / n", "largest", "verdict", "what is named"),
        estimators=ESTIMATORS,
    ),
    "unstated-noise": Study(
        ("motion", "grade", "stated, unit"), list(product(("fixture", "hand"), HAND_GRADES, STATEMENTS)),
        unstated_noise, ("NEES / n", "verdict"), estimators=ESTIMATORS,
    ),
    "protocols": Study(
        ("protocol", "asymmetries"), list(product(PROTOCOLS, ASYMMETRIES)), by_protocol, ("status", *ERRORS.values()),
    ),
    "rivals": Study(
        ("units", "fixture, mrad"), list(product(POPULATIONS, FIXTURES_MRAD)), beside_imucal,
        ("status", *ERRORS.values(), "accel_orthogonality, µrad", "s"), estimators=METHODS,
    ),
}  # fmt: skip


def main(
    study: str,
    *,
    units: int = 20,
    first: int = 0,
    estimators: tuple[str, ...] = (),
    only: tuple[str, ...] = (),
    jobs: int = 2,
) -> int:
    chosen = STUDIES[study]
    cells, estimators = chosen.having(only), estimators or chosen.estimators
    tests, beyond = len(cells) * len(estimators), 0
    print(f"{units} units a cell\n")
    print(*studies.markdown((*chosen.head, "by", *chosen.columns), (), len(chosen.head) + 1), sep="\n", flush=True)
    for cell in cells:
        tasks = [(cell, unit, estimators) for unit in range(first, first + units)]
        done = list(harness.in_processes(jobs, chosen.trial, tasks))
        for name in done[0]:
            scores = [rows[name] for rows in done]
            limited = not chosen.limited or name in chosen.limited
            beyond += chosen.unsound(scores, tests) or (limited and chosen.beyond(scores, tests))
            figures = [COLUMNS[column](scores, tests) for column in chosen.columns]
            print(f"| {' | '.join(map(str, (*cell, name, *figures)))} |", flush=True)
    return int(beyond > 0)


if __name__ == "__main__":
    harness.run(main, __doc__, study=STUDIES, estimators=sorted({*ESTIMATORS, *METHODS}))
