"""Sensor errors over temperature from several tests of one unit, each at a temperature of its own (soak points).

The model is that of :mod:`srt.comparison.merge_model` with curves in place of constants. For parameter k in test r::

    y_kr = Σ_j c_kj T_j(τ_r) + b_kr + (what tests have in common) + e_kr

T_j are Chebyshev polynomials. c_k0 is free; c_kj has the prior sigma s ρ^(j−1), so that orders which the tests cannot
show, as that between two soak points, are in the sigmas. b_kr is the repeatability between tests and the hysteresis
that heating and cooling leave. The sizes s and b are those of a group of parameters, expected over their restricted
likelihood. Tests that all come from one side cannot show hysteresis, so that :data:`_HYSTERESIS` of s is added to a
later visit.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import block_diag

from srt.arguments import require_type
from srt.comparison.merge import (
    check_members,
    common_mounting,
    joint_provenance,
    shared_statements,
    whole_temperature,
)
from srt.comparison.merge_model import GROUP_OF, StackedEstimates, estimate, stack_estimates
from srt.estimation.calibration_builder import partial_or_converged
from srt.estimation.goodness_of_fit import chi_square_probability
from srt.exceptions import DataError, InputError
from srt.noise.variance_components import RestrictedLikelihood
from srt.result.calibration import Calibration
from srt.result.consistency import Consistency
from srt.result.thermal_errors import ThermalErrors
from srt.result.verdict import USABLE
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from srt.recording.recording import Recording
    from srt.types import Array, Indices

ESTIMATOR: Final = "thermal"
ORDER: Final = 4
"""Highest order of the polynomials: curves of real units are cubic to a few per cent of their span."""
_DECAY: Final = 0.35
"""Expected ratio of the size of one order to that of the one before: 19 to 42 % of the span of real units is curved."""
_HYSTERESIS: Final = 0.15
"""Expected hysteresis over the size of the linear term: of a real unit heating and cooling differ by up to 0.46 of it.

A visit from the other side is off by all of the difference, one from the same side by none."""
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

    require_type("Thermal calibration", "a list of recordings or calibrations", tests, list, tuple)
    found = [test if isinstance(test, Calibration) else calibrate(test, estimator, **options) for test in tests]
    titles = [str(n + 1) for n in range(len(found))] if names is None else list(names)
    check_members(found, titles)
    for title, each in zip(titles, found, strict=True):
        if each.temperature is None:
            raise InputError(
                f"The temperature of {title} is not known: record it with the samples, or state temperature_c in "
                "recording.toml, and calibrate again."
            )
    used = [each for each in found if each.status in USABLE]
    left = [f"{t} ({each.status.replace('_', ' ')})" for t, each in zip(titles, found, strict=True) if each not in used]
    if len(used) < 2:
        raise DataError(f"Fewer than two tests can be used; left out: {', '.join(left)}.")
    temperature = np.array([each.temperature.mean_c for each in used if each.temperature is not None])
    if np.ptp(temperature) < _APART_K:
        raise InputError(
            f"All tests were at {temperature.mean():.1f} °C: a curve needs temperatures that are apart; merge them "
            "(srt calibrate --merge) for one temperature."
        )
    return _calibration(used, temperature, left)


def distinct(temperature: Array) -> int:
    """Number of temperatures that are apart."""
    return 1 + int(np.sum(np.diff(np.sort(temperature)) >= _APART_K))


def _calibration(used: list[Calibration], temperature: Array, left: list[str]) -> Calibration:
    stack = stack_estimates(used)
    low, high = float(temperature.min()), float(temperature.max())
    reduced = (2.0 * temperature - low - high) / (high - low)
    curves = np.asarray(chebyshev.chebvander(reduced, ORDER)[stack.recording], dtype=np.float64)
    seen = np.unique(stack.parameter)
    size, visit = _sizes(stack, curves)
    prior = size[:, None] * _DECAY ** np.arange(ORDER)
    coefficients, covariance, statistic = _fit(stack, curves, seen, prior, visit)
    degree = _degree(coefficients, covariance, prior, min(ORDER, distinct(temperature) - 1))
    vector = used[0].errors.vector.copy()
    coefficients[0] = np.where(np.isin(np.arange(N_PARAMETERS), seen), coefficients[0], vector)
    later = np.hypot(visit, _HYSTERESIS * size)
    thermal = ThermalErrors(low, high, tuple(temperature.tolist()), coefficients, covariance, later, degree)
    fixed = {name: used[0].fixed[name] for i, name in enumerate(NAMES) if i not in seen}
    message = f"Curves over {low:.1f} to {high:.1f} °C from {len(used)} tests."
    status, message = partial_or_converged(message, fixed)
    freedom = len(stack.y) - len(seen)
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
        warnings=tuple(_warnings(used, temperature, left, note)),
        thermal=thermal,
    )
    middle = whole.at(0.5 * (low + high))
    return replace(whole, errors=middle.errors, covariance=middle.covariance, contributions=middle.contributions)


def _sizes(stack: StackedEstimates, curves: Array) -> tuple[Array, Array]:
    """Expected size of the linear terms and of the visits, by parameter, shapes (27,), SI; zero where none is seen."""
    size, visit = np.zeros((2, len(GROUP_SLICES)))
    R, decay = stack.covariance, _DECAY ** np.arange(ORDER)
    for g in np.unique(GROUP_OF[stack.parameter]):
        rows = np.flatnonzero(GROUP_OF[stack.parameter] == g)
        own = stack.parameter[rows]
        members = np.unique(own)
        unit = (own[:, None] == members).astype(np.float64)
        if len(rows) == len(members):
            continue
        away = stack.y[rows] - unit @ (unit.T @ stack.y[rows] / unit.sum(axis=0))
        root = (unit[:, :, None] * (curves[rows, 1:] * decay)[:, None]).reshape(len(rows), -1)
        likelihood = RestrictedLikelihood(away, unit, R[np.ix_(rows, rows)], (root, np.eye(len(rows))))
        sigma = float(np.sqrt(np.median(np.diag(R)[rows])))
        grid = np.geomspace(0.1 * sigma, 3.0 * max(float(np.abs(away).max()), sigma), _SIZES)
        cases = np.array([(s**2, b**2) for s in grid for b in grid])
        log = np.array([likelihood.logarithm(case) for case in cases])
        weight = np.exp(log - log.max())
        size[g], visit[g] = weight @ np.sqrt(cases) / weight.sum()
    seen = np.isin(np.arange(N_PARAMETERS), stack.parameter)
    return np.where(seen, size[GROUP_OF], 0.0), np.where(seen, visit[GROUP_OF], 0.0)


def _fit(
    stack: StackedEstimates, curves: Array, seen: Indices, prior: Array, visit: Array
) -> tuple[Array, Array, float]:
    """Coefficients (D + 1, 27), their covariance, and the weighted square sum of the residuals, priors included.

    ``prior`` is the sigma of the coefficients of order 1 and more, shape (27, D), ``visit`` that of a visit, (27,).
    """
    place = np.searchsorted(seen, stack.parameter)
    count, orders = len(seen), curves.shape[1]
    X = np.zeros((len(stack.y), orders, count))
    X[np.arange(len(stack.y)), :, place] = curves
    priors = prior[seen].T.ravel()
    shown = np.concatenate([np.ones(count, dtype=bool), priors > 0.0])
    at_zero = np.eye(orders * count)[count:][priors > 0.0]
    design = np.concatenate([X.reshape(len(stack.y), -1), at_zero])[:, shown]
    noise = stack.covariance + np.diag(visit[stack.parameter] ** 2)
    R = block_diag(noise, np.diag(priors[priors > 0.0] ** 2))
    y = np.concatenate([stack.y, np.zeros(len(at_zero))])
    values, weights, statistic = estimate(y, design, R)
    where = (np.arange(orders)[:, None] * N_PARAMETERS + seen).ravel()[shown]
    coefficients = np.zeros(orders * N_PARAMETERS)
    coefficients[where] = values
    covariance = np.zeros((len(coefficients), len(coefficients)))
    P = weights @ R @ weights.T
    covariance[np.ix_(where, where)] = 0.5 * (P + P.T)
    return coefficients.reshape(orders, N_PARAMETERS), covariance, statistic


def _degree(coefficients: Array, covariance: Array, prior: Array, largest: int) -> Array:
    """Highest order that the tests show of each parameter, shape (27,); at most ``largest``."""
    variance = np.diag(covariance).reshape(coefficients.shape)[1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        # A prior shrinks an estimate and its variance alike.
        measured = 1.0 - variance / prior.T**2
        size = np.abs(coefficients[1:]) / np.sqrt(variance * measured)
    shown = np.nan_to_num(size) > _SHOWN
    shown[largest:] = False
    orders = np.arange(1, len(coefficients))[:, None]
    return np.asarray((shown * orders).max(axis=0), dtype=np.float64)


def _warnings(used: list[Calibration], temperature: Array, left: list[str], note: str) -> list[str]:
    out = [note] if note else []
    if left:
        out.append(f"Left out: {', '.join(left)}.")
    number = distinct(temperature)
    if number <= ORDER:
        out.append(
            f"{number} temperatures show curves of degree {number - 1} at most; what is of a higher degree between "
            "them is in the sigmas, as large as in other units."
        )
    wide = max(each.temperature.range_c for each in used if each.temperature is not None)
    if wide > 0.25 * np.ptp(temperature):
        out.append(f"The temperature changed by {wide:.1f} K in a test, which counts as if it had been constant.")
    return out
