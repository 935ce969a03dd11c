"""Efficiency of the estimators: errors of simulated units over the Cramér-Rao bound (docs/design/efficiency.md).

Each unit is noisy (:func:`accuracy_trials.fixture_recording`: 1 mrad fixture, gravity drawn with its sigma, noise
stated, one bias for the test) and calibrated by several estimators. The bound (:mod:`sims.accuracy.bound`) is
independent of them: an estimator whose errors reach it uses all the information in the recording.

The claims are :func:`criteria`, each with its limits and the standard error at the number of units. A criterion fails
beyond a limit by more than 3.5 standard errors.

``python benchmarks/efficiency.py`` runs 2,000 units of each grade; ``--units N`` that many, ``--grade NAME ...`` some
grades, ``--workers N`` in N processes. ``honesty.py fixture`` studies fixtures whose axes lean, and recorded moves. The
exit code is 1 if a criterion fails.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import TYPE_CHECKING, Final, NamedTuple

import harness
import numpy as np
from accuracy_trials import GRADES, IN_G, SITE, Trial, fixture_recording, normalised, run, score
from studies import markdown

import srt
from sims.accuracy.bound import bayesian_bound
from sims.physics.sequences import TABLE_1, table_sequences
from sims.physics.table_motion import Schedule
from srt.constants import DEG_PER_H
from srt.model.prior import Prior
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, N_PARAMETERS, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from sims.physics.table_motion import Moves
    from srt.types import Array


ESTIMATORS: Final = ("graph", "ekf", "least-squares", "closed-form")
LIMITS: Final = {"graph": (1.02, 1.05), "ekf": (1.05, 1.10)}
"""Limits of the error's rms over the bound: the mean over the parameters, and the largest of them."""
COVERAGE: Final = (0.935, 0.965)
"""Limits of the share of errors within their 95 % interval."""
STANDARD_ERRORS: Final = 3.5
"""Allowance beyond a limit, standard errors: p = 5e-4 of a two-sided test."""
_TWO_SIDED_95: Final = 1.959964
"""Half width of the 95 % interval of a normal error, sigma."""
_GYRO_BIAS_RAD_S: Final = 10.0 * DEG_PER_H
"""Half width of the uniform distribution of the gyro bias."""


@cache
def bound_si(grade: str, rotation_sigma_rad: float = 1e-3, moves: Moves = "skipped") -> Array:
    """Cramér-Rao bound (1 sigma, SI) at zero errors, shape (27,), for :func:`accuracy_trials.fixture_recording`."""
    alignment = ("level_sigma_rad", "north_sigma_rad", "mounting_sigma_rad", "non_orthogonality_sigma_rad")
    rotations = {"rotation_sigma_rad": rotation_sigma_rad, "wobble_sigma_rad": 1e-2 * rotation_sigma_rad}
    return bayesian_bound(
        Schedule(table_sequences(tuple(TABLE_1)), moves=moves),
        site=SITE,
        imu=GRADES[grade],
        fixture_sigma=dict.fromkeys(alignment, 1e-3) | rotations,
        sample_rate_hz=100.0,
    ).sigma


def bound_sigma(grade: str) -> Array:
    """The same on the 1 mrad fixture, accelerometer bias in g."""
    return np.asarray(bound_si(grade) / IN_G)


def prior_of_units() -> Prior:
    """Prior that the units are drawn from; the gyro bias, which is uniform, is represented by its sigma."""
    sigma = 1e-3 * IN_G
    sigma[GROUP_SLICES["gyro_bias"]] = _GYRO_BIAS_RAD_S / math.sqrt(3.0)
    return Prior.from_sigma(sigma)


class UnitTrials(NamedTuple):
    """Calibrations of one unit, and the filter's innovations of every sequence, of unit variance if its model holds."""

    trials: Mapping[str, Trial]
    innovations: tuple[Array, ...] = ()


def calibrate_unit(
    seed: int,
    *,
    grade: str,
    estimators: Collection[str] = ESTIMATORS,
    innovations_every: int = 1,
    sample_rate_hz: float = 100.0,
) -> UnitTrials:
    """Calibrate one noisy unit by several estimators.

    Innovations come from a second filter whose prior is the distribution of the units. With the default, very wide
    prior the first innovations would be far smaller than their sigma. It runs for every ``innovations_every``-th seed.
    """
    recording, truth = fixture_recording(seed, grade, sample_rate_hz=sample_rate_hz)
    trials = {name: score(srt.calibrate(recording, name, checks=False), truth) for name in estimators}
    if seed % innovations_every:
        return UnitTrials(trials)
    informed = srt.calibrate(recording, "ekf", prior=prior_of_units(), checks=False)
    rows = informed.diagnostics.filter or ()
    return UnitTrials(trials, tuple(row.innovations for row in rows))


class Criterion(NamedTuple):
    """A figure with its standard error at this number of units, and the limits between which it is claimed to be."""

    name: str
    value: float
    standard_error: float
    low: float
    high: float

    @property
    def holds(self) -> bool:
        """True within the limits, or beyond one by at most 3.5 standard errors."""
        allowed = STANDARD_ERRORS * self.standard_error
        return self.low - allowed <= self.value <= self.high + allowed


class Efficiency(NamedTuple):
    """Errors of one estimator over all units of a grade.

    ``rms`` and ``own``, shape (27,), are the rms of the error and of the reported sigma over the bound; ``mean`` is
    that of ``rms``, ``nees`` is over 27, ``coverage`` the share of errors within their 95 % interval.
    """

    units: int
    rms: Array
    own: Array
    mean: float
    mean_error: float
    nees: float
    coverage: float
    coverage_error: float
    converged: float


def efficiency(trials: Sequence[Trial], bound: Array) -> Efficiency:
    """Summarise the trials of one estimator; ``bound`` is that of :func:`bound_sigma`."""
    n = len(trials)
    squared = (np.array([t.error for t in trials]) / bound) ** 2
    rms = np.sqrt(squared.mean(axis=0))
    own = np.sqrt(np.mean([(t.sigma / bound) ** 2 for t in trials], axis=0))
    # Errors of one unit are correlated, units are not: what each unit adds to the mean, to first order.
    by_unit = (squared / (2.0 * rms)).mean(axis=1)
    covered = (np.abs(normalised(trials)) < _TWO_SIDED_95).mean(axis=1)
    return Efficiency(
        n,
        rms,
        own,
        float(rms.mean()),
        float(by_unit.std(ddof=1)) / math.sqrt(n),
        float(np.mean([t.nees for t in trials])),
        float(covered.mean()),
        float(covered.std(ddof=1)) / math.sqrt(n),
        float(np.mean([t.status == "converged" for t in trials])),
    )


def criteria(name: str, found: Efficiency) -> list[Criterion]:
    """Criteria of an estimator: sigmas match errors; rms not below the bound, and near it if in :data:`LIMITS`."""
    one = 1.0 / math.sqrt(2.0 * found.units)  # relative, of an rms
    low, high = int(np.argmin(found.rms)), int(np.argmax(found.rms))
    of_nees = math.sqrt(2.0 / N_PARAMETERS / found.units)
    out = [
        Criterion(f"{name}: share converged", found.converged, 0.0, 1.0, 1.0),
        Criterion(f"{name}: NEES / 27", found.nees, of_nees, 1.0, 1.0),
        Criterion(f"{name}: coverage of 95 % intervals", found.coverage, found.coverage_error, *COVERAGE),
        # An estimator better than the bound would say that the bound is wrong.
        Criterion(f"{name}: rms / bound, smallest ({SYMBOLS[low]})", float(found.rms[low]), one, 1.0, math.inf),
    ]
    if name in LIMITS:
        mean, largest = LIMITS[name]
        out += [
            Criterion(f"{name}: rms / bound, mean", found.mean, found.mean_error, -math.inf, mean),
            Criterion(
                f"{name}: rms / bound, largest ({SYMBOLS[high]})",
                float(found.rms[high]),
                largest * one,
                -math.inf,
                largest,
            ),
        ]
    return out


def innovation_criteria(units: Iterable[UnitTrials]) -> list[Criterion]:
    """Criteria of white innovations of unit variance: pooled variance, lag-one correlation, NIS of each sequence."""
    runs = [u.innovations for u in units if u.innovations]
    series = [np.concatenate(run) for run in runs]
    squares, number = sum(float(v @ v) for v in series), sum(len(v) for v in series)
    products, pairs = sum(float(v[1:] @ v[:-1]) for v in series), sum(len(v) - 1 for v in series)
    nis = np.array([[float(v @ v) for v in run] for run in runs])
    freedom = np.array([len(v) for v in runs[0]])
    ratio, error = nis.mean(axis=0) / freedom, np.sqrt(2.0 / freedom / len(runs))
    worst = int(np.argmax(np.abs(ratio - 1.0) / error))
    sequence = tuple(TABLE_1)[worst]
    return [
        Criterion("innovations: variance", squares / number, math.sqrt(2.0 / number), 1.0, 1.0),
        Criterion("innovations: correlation with the next", products / squares, 1.0 / math.sqrt(pairs), 0.0, 0.0),
        Criterion(
            f"innovations: NIS / {freedom[worst]} of sequence {sequence}, furthest from 1",
            float(ratio[worst]),
            float(error[worst]),
            1.0,
            1.0,
        ),
    ]


def summarise(grade: str, units: Sequence[UnitTrials]) -> tuple[dict[str, Efficiency], list[Criterion]]:
    """Efficiency of each estimator and all criteria, over the units of a grade."""
    found = {name: efficiency([u.trials[name] for u in units], bound_sigma(grade)) for name in units[0].trials}
    claims = [criterion for name, e in found.items() for criterion in criteria(name, e)]
    return found, claims + innovation_criteria(units)


FIRST_SEED = {grade: 10_000 * (1 + i) for i, grade in enumerate(GRADES)}


def parameter_table(grade: str, found: dict[str, Efficiency]) -> Iterator[str]:
    """Rms of error and own sigma over the bound, by parameter and estimator."""
    bound, ratios = bound_si(grade), [(e.rms, e.own) for e in found.values()]
    rows = [
        [symbol, f"{bound[i] * DISPLAY_FACTORS[i]:#.3g} {DISPLAY_UNITS[i]}"]
        + [f"{value[i]:.3f}" for pair in ratios for value in pair]
        for i, symbol in enumerate(SYMBOLS)
    ]
    rows.append(["mean", "", *(f"{value.mean():.3f}" for pair in ratios for value in pair)])
    return markdown(("parameter", "bound", *(f"{n}: {what}" for n in found for what in ("rms", "sigma"))), rows)


def limits(criterion: Criterion) -> str:
    low, high = criterion.low, criterion.high
    if low == high:
        return f"{low:g}"
    if math.isinf(low) or math.isinf(high):
        return f"at most {high:g}" if math.isinf(low) else f"at least {low:g}"
    return f"{low:g} to {high:g}"


def criteria_table(claims: list[Criterion]) -> Iterator[str]:
    rows = (
        [c.name, f"{c.value:.4f}", f"{c.standard_error:.4f}", limits(c), "yes" if c.holds else "NO"] for c in claims
    )
    return markdown(("criterion", "value", "standard error", "limits", "holds"), rows)


def main(*, units: int = 2000, workers: int = 2, grade: tuple[str, ...] = tuple(GRADES)) -> int:
    missed = 0
    for name in grade:
        seeds = range(FIRST_SEED[name], FIRST_SEED[name] + units)
        found, claims = summarise(name, run(partial(calibrate_unit, grade=name), seeds, workers=workers))
        print(f"## {name}, {units} units")
        for table in (parameter_table(name, found), criteria_table(claims)):
            print("", *table, sep="\n", flush=True)
        missed += sum(not c.holds for c in claims)
    return 1 if missed else 0


if __name__ == "__main__":
    harness.run(main, __doc__, grade=GRADES)
