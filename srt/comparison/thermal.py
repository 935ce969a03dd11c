"""Sensor errors over temperature from several tests of one unit, each at a temperature of its own (soak points).

The model is that of :mod:`srt.comparison.merge_model` with curves in place of constants. For parameter k in test r::

    y_kr = Σ_j c_kj T_j(τ_r) + b_kr + (what tests have in common) + e_kr

T_j are Chebyshev polynomials. c_k0 is free; c_kj has the prior sigma s ρ^(j−1), so that orders which the tests cannot
show, as that between two soak points, are in the sigmas. b_kr is the repeatability between tests and the hysteresis
that heating and cooling leave. The sizes s and b are those of a group of parameters, expected over their restricted
likelihood; of groups that were tested at one temperature alone they are those of other units. Tests that all come from
one side cannot show hysteresis, so that :data:`_HYSTERESIS` of s is added to a later visit.

Ramps at rest (:mod:`srt.comparison.temperature_ramp`) have rows of the same kind: readings in visits of intervals of
temperature, with the effect of all errors on them and an unknown constant for each channel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import block_diag

from srt.arguments import require_type
from srt.comparison.merge import (
    check_members,
    common_mounting,
    joint_provenance,
    require_names,
    shared_statements,
    whole_temperature,
)
from srt.comparison.merge_model import GROUP_OF, estimate, stack_estimates
from srt.comparison.temperature_ramp import is_ramp, ramp_visits
from srt.estimation.calibration_builder import partial_or_converged
from srt.estimation.goodness_of_fit import chi_square_probability
from srt.exceptions import DataError, InputError
from srt.noise.variance_components import RestrictedLikelihood
from srt.recording.recording import Recording
from srt.result.calibration import Calibration
from srt.result.consistency import Consistency
from srt.result.thermal_errors import ThermalErrors
from srt.result.verdict import USABLE
from srt.sensor_errors import GROUP_SLICES, GROUPS, N_PARAMETERS, NAMES, SensorErrors, by_parameter

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from srt.comparison.temperature_ramp import RampVisits
    from srt.types import Array, Indices

ESTIMATOR: Final = "thermal"
ORDER: Final = 4
"""Highest order of the polynomials: curves of real units are cubic to a few per cent of their span."""
_DECAY: Final = 0.35
"""Expected ratio of the size of one order to that of the one before: 19 to 42 % of the span of real units is curved."""
_HYSTERESIS: Final = 0.16
"""Expected hysteresis over the size of the linear term, of a later visit from a random side.

On the worst axis of a real unit heating and cooling differ by up to 0.46 of that size, and by half as much on average.
A visit from the other side is off by the difference, one from the same side by none: 0.46 / 2 / √2 = 0.16.
"""
_APART_K: Final = 1.0
"""Distance of temperatures that count as two."""
_SHOWN: Final = 3.0
"""Size of a coefficient, in its sigma, from which the tests show it."""
_SIZES: Final = 16
"""Values of each size for which the likelihood is computed."""


def calibrate_thermal(
    tests: Sequence[Recording | Calibration | str | PathLike[str]],
    estimator: str = "auto",
    *,
    names: Sequence[str] | None = None,
    **options: Any,
) -> Calibration:
    """Calibrate a unit over temperature from tests at several temperatures.

    Parameters
    ----------
    tests : sequence of Recording, path of one, or Calibration
        Of one unit, at two temperatures or more.
    estimator : str
        Of recordings.
    names : sequence of str, optional
        Names of the tests; default their numbers.
    **options
        Of :func:`srt.calibrate`, for recordings.

    Returns
    -------
    Calibration
        Estimator "thermal"; its errors and sigmas are those at the middle of the range, ``at(temperature)`` gives those
        at another temperature of the range.

    Raises
    ------
    InputError
        Fewer than two tests, temperatures that are not known or all alike, different units, one recording twice.
    DataError
        If fewer than two converged, or a recording cannot be used.
    """
    from srt.procedure import calibrate
    from srt.recording.reading import read

    require_type("Thermal calibration", "a list of recordings or calibrations", tests, list, tuple)
    given = [test if isinstance(test, Calibration) else read(test) for test in tests]
    titles = [str(n + 1) for n in range(len(given))] if names is None else list(names)
    require_names(titles, len(given))
    ramps = {t: each for t, each in zip(titles, given, strict=True) if isinstance(each, Recording) and is_ramp(each)}
    found = {
        t: each if isinstance(each, Calibration) else calibrate(each, estimator, **options)
        for t, each in zip(titles, given, strict=True)
        if t not in ramps
    }
    if ramps and not found:
        raise InputError(
            f"{', '.join(ramps)} shows the unit at rest, and changes alone: add a test with turns at one temperature."
        )
    check_members(list(found.values()), list(found), least=1 if ramps else 2)
    for title, each in found.items():
        if each.temperature is None:
            raise InputError(
                f"The temperature of {title} is not known: record it with the samples, or state temperature_c in "
                "recording.toml, and calibrate again."
            )
    used = [each for each in found.values() if each.status in USABLE]
    left = [f"{t} ({each.status.replace('_', ' ')})" for t, each in found.items() if each not in used]
    if len(used) + len(ramps) < 2 or not used:
        raise DataError(f"Fewer than two tests can be used; left out: {', '.join(left)}.")
    visits = [ramp_visits(ramp, used[0].errors) for ramp in ramps.values()]
    temperature = np.array([each.temperature.mean_c for each in used if each.temperature is not None])
    spread = np.concatenate([temperature, *(each.temperature for each in visits)])
    if np.ptp(spread) < _APART_K:
        raise InputError(
            f"All tests were at {temperature.mean():.1f} °C: a curve needs temperatures that are apart; merge them "
            "(srt calibrate --merge) for one temperature."
        )
    return _calibration(used, temperature, visits, left)


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Measurements of tests and ramps: n values, each of an error at a temperature.

    Attributes
    ----------
    y : ndarray, shape (n,)
    effect : ndarray, shape (n, 27)
        Derivative with respect to the errors at the temperature.
    temperature : ndarray, shape (n,), °C
    parameter : ndarray of int, shape (n,)
        Error whose repeatability they have.
    offset : ndarray, shape (n, q)
        Effect of unknown constants of ramps.
    covariance : ndarray, shape (n, n)
    """

    y: Array
    effect: Array
    temperature: Array
    parameter: Indices
    offset: Array
    covariance: Array


def _rows(used: list[Calibration], temperature: Array, ramps: list[RampVisits]) -> _Rows:
    """Rows of all tests and ramps."""
    stack = stack_estimates(used)
    parts = [
        _Rows(
            stack.y,
            stack.design,
            temperature[stack.recording],
            stack.parameter,
            np.zeros((len(stack.y), 0)),
            stack.covariance,
        )
    ]
    channels = np.concatenate([np.arange(N_PARAMETERS)[GROUP_SLICES[name]] for name in ("gyro_bias", "accel_bias")])
    for ramp in ramps:
        n = len(ramp.temperature)
        parts.append(
            _Rows(
                ramp.readings.ravel(),
                np.tile(ramp.effect, (n, 1)),
                np.repeat(ramp.temperature, 6),
                np.tile(channels, n),
                np.tile(np.eye(6), (n, 1)),
                np.diag(ramp.sigma.ravel() ** 2),
            )
        )
    return _Rows(
        np.concatenate([part.y for part in parts]),
        np.concatenate([part.effect for part in parts]),
        np.concatenate([part.temperature for part in parts]),
        np.concatenate([part.parameter for part in parts]),
        block_diag(*(part.offset for part in parts)),
        block_diag(*(part.covariance for part in parts)),
    )


def distinct(temperature: Array) -> int:
    """Number of temperatures that are apart."""
    return 1 + int(np.sum(np.diff(np.sort(temperature)) >= _APART_K))


def _calibration(used: list[Calibration], temperature: Array, ramps: list[RampVisits], left: list[str]) -> Calibration:
    rows = _rows(used, temperature, ramps)
    ends = [*temperature.tolist(), *(end for ramp in ramps for end in ramp.range_c)]
    low, high = min(ends), max(ends)
    reduced = (2.0 * rows.temperature - low - high) / (high - low)
    curves = np.asarray(chebyshev.chebvander(reduced, ORDER), dtype=np.float64)
    seen = np.flatnonzero([each.any() for each in np.transpose([c.observed for c in used])])
    size, visit = _sizes(rows, curves, seen, 0.5 * (high - low))
    prior = size[:, None] * _DECAY ** np.arange(ORDER)
    coefficients, covariance, statistic = _fit(rows, curves, seen, prior, visit)
    shown = np.full(N_PARAMETERS, distinct(temperature) - 1)
    both_ways = np.zeros(N_PARAMETERS, dtype=np.bool_)
    for name in ("gyro_bias", "accel_bias") if ramps else ():
        shown[GROUP_SLICES[name]] = ORDER
        both_ways[GROUP_SLICES[name]] = any(ramp.both_ways for ramp in ramps)
    degree = _degree(coefficients, covariance, prior, np.minimum(shown, ORDER))
    vector = used[0].errors.vector.copy()
    coefficients[0] = np.where(np.isin(np.arange(N_PARAMETERS), seen), coefficients[0], vector)
    later = np.hypot(visit, np.where(both_ways, 0.0, _HYSTERESIS) * size)
    thermal = ThermalErrors(low, high, tuple(temperature.tolist()), coefficients, covariance, later, degree)
    fixed = {name: used[0].fixed[name] for i, name in enumerate(NAMES) if i not in seen}
    count = f"{len(used)} test{'s' * (len(used) > 1)}" + f" and {len(ramps)} at rest" * bool(ramps)
    message = f"Curves over {low:.1f} to {high:.1f} °C from {count}."
    status, message = partial_or_converged(message, fixed)
    freedom = len(rows.y) - len(seen) - rows.offset.shape[1]
    U, U_sigma, note = common_mounting(used)
    whole = Calibration(
        estimator=ESTIMATOR,
        status=status,
        message=message,
        errors=SensorErrors(vector),
        covariance=np.zeros((N_PARAMETERS, N_PARAMETERS)),
        fixed=fixed,
        U=U,
        U_sigma_rad=U_sigma,
        site=shared_statements([each.site for each in used]),
        alignment=shared_statements([each.alignment for each in used]),
        temperature=whole_temperature(used),
        provenance=joint_provenance(used),
        consistency=Consistency(
            chi_square=statistic,
            degrees_of_freedom=freedom,
            probability=chi_square_probability(statistic, freedom),
        ),
        warnings=tuple(_warnings(used, temperature, left, note, ramps)),
        thermal=thermal,
    )
    middle = whole.at(0.5 * (low + high))
    return replace(whole, errors=middle.errors, covariance=middle.covariance, contributions=middle.contributions)


def _sizes(rows: _Rows, curves: Array, seen: Indices, half_range_k: float) -> tuple[Array, Array]:
    """Expected size of the linear terms and of the visits, by parameter, shapes (27,), SI; zero where none is seen.

    They are those of a group, or of each channel where ramps show it.
    """
    usual = by_parameter("per_kelvin") * half_range_k
    size, visit = usual.copy(), _HYSTERESIS * usual
    of_ramp = np.unique(rows.parameter[rows.offset.any(axis=1)])
    cells = [np.flatnonzero(g == GROUP_OF) for g in range(len(GROUPS))]
    for cell in [each for each in cells if not np.isin(each, of_ramp).any()] + [np.array([k]) for k in of_ramp]:
        at, members = np.flatnonzero(np.isin(rows.parameter, cell)), np.intersect1d(cell, seen)
        if members.size and distinct(rows.temperature[at]) > 1:
            size[cell], visit[cell] = _expected(rows, curves, at, members)
    known = np.isin(np.arange(N_PARAMETERS), seen)
    return np.where(known, size, 0.0), np.where(known, visit, 0.0)


def _expected(rows: _Rows, curves: Array, at: Indices, members: Indices) -> tuple[float, float]:
    """Size of the linear terms of like parameters and of their visits, expected over their likelihood in some rows."""
    own, offset = rows.effect[np.ix_(at, members)], rows.offset[at]
    constant = np.hstack([own, offset[:, offset.any(axis=0)]])
    away = rows.y[at] - constant @ np.linalg.lstsq(constant, rows.y[at], rcond=None)[0]
    root = (own[:, :, None] * (curves[at, 1:] * _DECAY ** np.arange(ORDER))[:, None]).reshape(len(at), -1)
    R = rows.covariance[np.ix_(at, at)]
    likelihood = RestrictedLikelihood(away, constant, R, (root, np.eye(len(at))))
    sigma = float(np.sqrt(np.median(np.diag(R))))
    grid = np.geomspace(0.1 * sigma, 3.0 * max(float(np.abs(away).max()), sigma), _SIZES)
    cases = np.array([(s**2, b**2) for s in grid for b in grid])
    log = np.array([likelihood.logarithm(case) for case in cases])
    weight = np.exp(log - log.max())
    size, visit = weight @ np.sqrt(cases) / weight.sum()
    return float(size), float(visit)


def _fit(rows: _Rows, curves: Array, seen: Indices, prior: Array, visit: Array) -> tuple[Array, Array, float]:
    """Coefficients (D + 1, 27), their covariance, and the weighted square sum of the residuals, priors included.

    ``prior`` is the sigma of the coefficients of order 1 and more, shape (27, D), ``visit`` that of a visit, (27,).
    """
    n, count, orders, unknown = len(rows.y), len(seen), curves.shape[1], rows.offset.shape[1]
    X = (curves[:, :, None] * rows.effect[:, None, seen]).reshape(n, -1)
    priors = prior[seen].T.ravel()
    at_zero = np.eye(orders * count + unknown)[count : orders * count]
    design = np.concatenate([np.hstack([X, rows.offset]), at_zero])
    R = block_diag(rows.covariance + np.diag(visit[rows.parameter] ** 2), np.diag(priors**2))
    values, weights, statistic = estimate(np.concatenate([rows.y, np.zeros(len(priors))]), design, R)
    P = weights @ R @ weights.T
    where = (np.arange(orders)[:, None] * N_PARAMETERS + seen).ravel()
    coefficients = np.zeros(orders * N_PARAMETERS)
    coefficients[where] = values[: len(where)]
    covariance = np.zeros((len(coefficients), len(coefficients)))
    covariance[np.ix_(where, where)] = 0.5 * (P + P.T)[: len(where), : len(where)]
    return coefficients.reshape(orders, N_PARAMETERS), covariance, statistic


def _degree(coefficients: Array, covariance: Array, prior: Array, largest: Array) -> Array:
    """Highest order that the tests show of each parameter, shape (27,); at most ``largest``, (27,)."""
    variance = np.diag(covariance).reshape(coefficients.shape)[1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        # A prior shrinks an estimate and its variance alike.
        measured = 1.0 - variance / prior.T**2
        size = np.abs(coefficients[1:]) / np.sqrt(variance * measured)
    orders = np.arange(1, len(coefficients))[:, None]
    shown = (np.nan_to_num(size) > _SHOWN) & (orders <= largest)
    return np.asarray((shown * orders).max(axis=0), dtype=np.float64)


def _warnings(
    used: list[Calibration], temperature: Array, left: list[str], note: str, ramps: list[RampVisits]
) -> list[str]:
    out = [note] if note else []
    if left:
        out.append(f"Left out: {', '.join(left)}.")
    if ramps:
        out.append(
            "A unit at rest in one attitude shows the sum of accelerometer bias and, along the vertical, scale factor "
            "over temperature as one: other attitudes have the sigma of scale factors of other units."
        )
    number = distinct(temperature)
    if number <= ORDER:
        few = f"{number} temperatures show curves of degree {number - 1} at most" if number > 1 else "One temperature"
        what = "; what is of a higher degree between them" if number > 1 else " shows no curve; what others do"
        out.append(f"{few}{what} is in the sigmas, as large as in other units.")
    wide = max(each.temperature.range_c for each in used if each.temperature is not None)
    if wide > 0.25 * np.ptp(temperature) > 0.0:
        out.append(f"The temperature changed by {wide:.1f} K in a test, which counts as if it had been constant.")
    return out
