"""Efficiency of the estimators: errors of many simulated units against the Bayesian Cramér-Rao bound.

One trial is a noisy unit (:func:`sims.accuracy.campaigns.noisy_recording`: 1 mrad fixture, gravity drawn with its
sigma, noise stated, one bias for the test) that several estimators calibrate. The bound (:mod:`sims.accuracy.bound`)
knows nothing of them: an estimator whose errors reach it uses all that the recording holds.

What is claimed are :func:`criteria`, each with the limits of the claim and the standard error at the number of units:
it fails where it is beyond a limit by more than 3.5 standard errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import srt
from sims.accuracy.bound import bayesian_bound
from sims.accuracy.campaigns import GRADES, IN_G, SITE, Trial, noisy_recording, normalised, score
from sims.physics.sequences import TABLE_1, table_sequences
from sims.physics.table_motion import Schedule
from srt.constants import DEG_PER_H
from srt.model.prior import Prior
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from srt.types import Array


ESTIMATORS: Final = ("graph", "ekf", "least-squares", "closed-form")
LIMITS: Final = {"graph": (1.02, 1.05), "ekf": (1.05, 1.10)}
"""Of the error's rms over the bound: its mean over the parameters, and the largest of them."""
COVERAGE: Final = (0.935, 0.965)
"""Share of the errors that lie within their 95 % interval."""
STANDARD_ERRORS: Final = 3.5
_TWO_SIDED_95: Final = 1.959964
_GYRO_BIAS_RAD_S: Final = 10.0 * DEG_PER_H
_FIXTURE_SIGMA: Final = {
    "level_sigma_rad": 1e-3,
    "north_sigma_rad": 1e-3,
    "mounting_sigma_rad": 1e-3,
    "non_orthogonality_sigma_rad": 0.0,
    "rotation_sigma_rad": 1e-3,
}


@cache
def bound_sigma(grade: str) -> Array:
    """Least sigma of each parameter, shape (27,), accelerometer bias in g: of a unit and a fixture without errors."""
    bound = bayesian_bound(
        Schedule(table_sequences(tuple(TABLE_1))),
        site=SITE,
        imu=GRADES[grade],
        fixture_sigma=_FIXTURE_SIGMA,
        sample_rate_hz=100.0,
    )
    return np.asarray(bound.sigma / IN_G)


def prior_of_units() -> Prior:
    """What the units are drawn from; of the gyro bias, which is uniform, by its sigma."""
    sigma = 1e-3 * IN_G
    sigma[GROUP_SLICES["gyro_bias"]] = _GYRO_BIAS_RAD_S / math.sqrt(3.0)
    return Prior.from_sigma(sigma)


@dataclass(frozen=True, slots=True, eq=False)
class Unit:
    """Outcome of one unit.

    Attributes
    ----------
    trials : dict of str to Trial
        By estimator.
    innovations : tuple of ndarray
        Of every sequence in the order of time, decorrelated and of unit variance if the filter's model holds; empty if
        they were not asked for.
    """

    trials: Mapping[str, Trial]
    innovations: tuple[Array, ...] = ()


def unit(
    seed: int,
    *,
    grade: str,
    estimators: Collection[str] = ESTIMATORS,
    innovations_every: int = 1,
    sample_rate_hz: float = 100.0,
) -> Unit:
    """Calibrate one noisy unit by several estimators.

    Innovations come from a filter of their own, which starts from what the units are drawn from: with the default
    prior, next to no knowledge, those that only replace it are far smaller than their sigma. It runs for every
    ``innovations_every``-th seed.
    """
    recording, truth = noisy_recording(seed, grade, sample_rate_hz=sample_rate_hz)
    trials = {name: score(srt.calibrate(recording, name, checks=False), truth) for name in estimators}
    if seed % innovations_every:
        return Unit(trials)
    informed = srt.calibrate(recording, "ekf", prior=prior_of_units(), checks=False)
    rows: list[dict[str, Any]] = informed.diagnostics["filter"]
    return Unit(trials, tuple(np.array(row["innovations"]) for row in rows))


@dataclass(frozen=True, slots=True)
class Criterion:
    """A figure, and the limits between which it is claimed to be.

    Attributes
    ----------
    name : str
    value : float
    standard_error : float
        Of the value at the number of units that it comes from.
    low, high : float
        Limits of the claim.
    """

    name: str
    value: float
    standard_error: float
    low: float
    high: float

    @property
    def holds(self) -> bool:
        """Whether the value is within the limits, or beyond one by no more than 3.5 standard errors."""
        allowed = STANDARD_ERRORS * self.standard_error
        return self.low - allowed <= self.value <= self.high + allowed


@dataclass(frozen=True, slots=True, eq=False)
class Efficiency:
    """Errors of one estimator over the units of a grade.

    Attributes
    ----------
    units : int
    rms : ndarray, shape (27,)
        Of the error, over the bound.
    own : ndarray, shape (27,)
        Rms of the sigma that the estimator reports, over the bound.
    mean, mean_error : float
        Mean of ``rms`` over the parameters, and its standard error.
    nees : float
        Normalised estimation error squared over 27, mean.
    coverage, coverage_error : float
        Share of all errors within their 95 % interval, and its standard error.
    converged : float
        Share of the units.
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
    """What is claimed of an estimator: honest sigmas, not below the bound, and near it if :data:`LIMITS` has it."""
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


def innovation_criteria(units: Iterable[Unit]) -> list[Criterion]:
    """White innovations of unit variance: pooled, from each to the next of a recording, and sequence by sequence."""
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


def summarise(grade: str, units: Sequence[Unit]) -> tuple[dict[str, Efficiency], list[Criterion]]:
    """Efficiency of each estimator, and all criteria, over the units of a grade."""
    found = {name: efficiency([u.trials[name] for u in units], bound_sigma(grade)) for name in units[0].trials}
    claims = [criterion for name, e in found.items() for criterion in criteria(name, e)]
    return found, claims + innovation_criteria(units)
