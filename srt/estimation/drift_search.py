"""Search for a bias drift in the residuals of a solution, and its estimated size."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from srt.estimation import measurement_covariance
from srt.estimation.drift_model import (
    DriftEstimate,
    DriftSearch,
    candidates,
    change,
    gyro_courses,
    gyro_statistics,
    most_significant,
)
from srt.estimation.error_sources import raw_rate_variance
from srt.estimation.goodness_of_fit import chi_square, is_misfit
from srt.estimation.rest_rate_scatter import bias_gain
from srt.noise.drift_forms import LINEAR, WALK, residual_statistics

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.estimation.drift_model import DriftTerm, Sensor
    from srt.estimation.iteration import Solution
    from srt.estimation.options import Options
    from srt.noise.drift_forms import Statistics
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask


def search(data: PreparedRecording, options: Options, solution: Solution, fixed: Mask) -> DriftSearch:
    """Search the residuals of a solution for bias drift that it does not model.

    Parameters
    ----------
    data : PreparedRecording
    options : Options
    solution : Solution
    fixed : ndarray of bool, shape (27,)
        Parameters that are not estimated.
    """
    measurements = solution.measurements
    if measurements.integrals.time_parts is None:
        return DriftSearch()
    keys = candidates(data, ())
    scale = 1.0 / np.sqrt(np.diag(solution.measurement_covariance))
    try:
        L = np.linalg.cholesky(solution.measurement_covariance * np.outer(scale, scale))
    except np.linalg.LinAlgError:  # far outside the model the covariance is not positive definite
        return DriftSearch()
    forms = [key for key in keys if key[0] == "accel"]

    def of_accel(*effects: Array) -> list[Statistics]:
        columns = [measurements.z[:, None], measurements.H[:, ~fixed], *effects]
        white = solve_triangular(L, np.concatenate(columns, axis=1) * scale[:, None], lower=True)
        z, H, *parts = np.split(white, np.cumsum([c.shape[1] for c in columns])[:-1], axis=1)
        return residual_statistics(z[:, 0], H, *parts)

    def of_gyro(courses: Mapping[str, Array]) -> dict[str, Statistics]:
        m = measurements
        return gyro_statistics(data, m.gyro.inverse, m.rest_rate, m.integrated, (), courses)

    def by_window(sensor: Sensor) -> Statistics:
        if sensor == "gyro":
            return of_gyro({"each": np.eye(len(measurements.pool))})["each"]
        return of_accel(measurement_covariance.force_errors(measurements, data))[0]

    found = dict(zip(forms, of_accel(*_effects(data, options, solution, forms, tested=True)), strict=True))
    found |= {("gyro", form): statistics for form, statistics in of_gyro(gyro_courses(data, keys)).items()}
    courses = {form: shape.windows for form, shape in data.drift_shapes.items()}
    return most_significant(found, len(keys), (), solution.excess.force, courses, by_window)


def explaining_drift(
    data: PreparedRecording, options: Options, solution: Solution, fixed: Mask
) -> tuple[DriftTerm, ...]:
    """Smooth drift of the accelerometers that is significant and explains the residuals; else empty."""
    found = search(data, options, solution, fixed).terms
    terms = tuple(t for t in found if t.sensor == "accel" and t.form != WALK)
    R = solution.measurement_covariance
    effects = _effects(data, options, solution, terms)
    for term, effect in zip(terms, effects, strict=True):
        R = R + term.sigma**2 * effect @ effect.T
    statistic, freedom = chi_square(solution, fixed, R)
    return () if is_misfit(statistic, freedom - sum(effect.shape[1] for effect in effects)) else terms


def estimates(
    data: PreparedRecording, options: Options, solution: Solution, fixed: Mask, terms: tuple[DriftTerm, ...]
) -> tuple[DriftEstimate, ...]:
    """Estimated drift of terms that a solution does not model."""
    if not terms:
        return ()
    gyro = _gyro_coefficients(data, solution, [term for term in terms if term.sensor == "gyro"])
    R, z, H = solution.measurement_covariance, solution.measurements.z, solution.measurements.H[:, ~fixed]
    effects = _effects(data, options, solution, terms)
    for term, effect in zip(terms, effects, strict=True):
        R = R + term.sigma**2 * effect @ effect.T
    scale = 1.0 / np.sqrt(np.diag(R))
    factor = cho_factor(R * np.outer(scale, scale), lower=True)
    H, unit = H * scale[:, None], np.linalg.norm(H * scale[:, None], axis=0)
    H = H[:, unit > 0.0] / unit[unit > 0.0]
    weighted = cho_solve(factor, np.column_stack([H, z * scale]))
    x = np.linalg.solve(H.T @ weighted[:, :-1], H.T @ weighted[:, -1])
    left = (weighted[:, -1] - weighted[:, :-1] @ x) * scale
    out = []
    for term, effect in zip(terms, effects, strict=True):
        coefficients = (term.sigma**2 * effect.T @ left).reshape(-1, 3)
        if term.sensor == "gyro":
            coefficients = gyro[term.form]
        size = change(term.form, coefficients, data.drift_shapes[term.form].windows)
        out.append(DriftEstimate(term.sensor, term.form, size, modelled=False))
    return tuple(out)


def _gyro_coefficients(data: PreparedRecording, solution: Solution, terms: list[DriftTerm]) -> dict[str, Array]:
    """Coefficients of each form of gyro drift from the rest rates, rad/s; the rotations are far less sensitive.

    The shape of each is (number of functions of the form, 3). Those of a random walk have a prior, without which they
    would reproduce the noise of every window.
    """
    if not terms:
        return {}
    rest, shapes = solution.measurements.rest_rate, [data.drift_shapes[term.form].windows for term in terms]
    A = np.concatenate([np.ones((len(rest), 1)), *shapes], axis=1)
    noise = np.sqrt(raw_rate_variance(data.noise, data.windows.duration_s).mean(axis=1))[:, None]
    prior = [np.full(shape.shape[1], t.form == WALK) / t.sigma for t, shape in zip(terms, shapes, strict=True)]
    rows = np.diag(np.concatenate([[0.0], *prior]))
    right = np.concatenate([rest / noise, np.zeros((len(rows), 3))])
    found = np.linalg.lstsq(np.concatenate([A / noise, rows]), right)[0]
    ends = np.cumsum([1, *(shape.shape[1] for shape in shapes)])
    return {term.form: found[a:b] for term, a, b in zip(terms, ends[:-1], ends[1:], strict=True)}


def used_bias_gain(data: PreparedRecording, options: Options, solution: Solution) -> Array:
    """Weight of a sequence's own rest rate in its bias, per axis, shape (3,); see ``bias_gain``."""
    compensated = np.sqrt(solution.measurements.gyro.inverse**2 @ solution.wander**2)
    return bias_gain(solution.measurements, data, options.gyro_bias, compensated)


def possible_drift_covariance(
    data: PreparedRecording, options: Options, solution: Solution, found: DriftSearch
) -> Array:
    """Covariance of the parameters by a possible linear drift of the accelerometers, shape (27, 27)."""
    if found.possible == 0.0:
        return np.zeros((len(solution.gain), len(solution.gain)))
    root = found.possible * solution.gain @ _effects(data, options, solution, [("accel", LINEAR)])[0]
    return np.asarray(root @ root.T)


def _effects(
    data: PreparedRecording,
    options: Options,
    solution: Solution,
    forms: Sequence[tuple[Any, ...]],
    *,
    tested: bool = False,
) -> list[Array]:
    """Effect of a unit value of each coefficient of forms on the measurements, shape (n_z, 3 × functions of the form).

    A form is given by its sensor and its name, which may be followed by others. With ``tested``, only the functions
    that the test of the form uses.
    """
    gain = used_bias_gain(data, options, solution)
    draws = (
        measurement_covariance.drift_form(solution.measurements, data, sensor, form, tested=tested)
        for sensor, form, *_ in forms
    )
    return [measurement_covariance.project(solution.measurements, data, each, gain) for each in draws]
