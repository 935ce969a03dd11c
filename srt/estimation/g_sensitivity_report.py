"""Report of gyro g-sensitivity: its estimate with sigmas, and a test for it where it is not estimated.

The test uses the change of the rest rate from the start to the end window of each sequence, so that a bias that varies
between sequences cancels. For each gyro an F-test compares a fit by a constant and the change of the specific force
with a fit by the constant alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtrc, fdtrc

from srt.constants import DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.estimation.error_sources import earth_rate_sigma, raw_rate_variance
from srt.estimation.g_sensitivity import LEAST_FORCE_VARIATION, MODE
from srt.result.diagnostics import GSensitivity, RestRateScatter

if TYPE_CHECKING:
    from srt.estimation.g_sensitivity import RestRates
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask


FALSE_ALARM_PROBABILITY: Final = 1e-3
"""Probability of reporting a g-sensitivity that is not there, for the three gyros together."""
_LEAST_FREEDOM: Final = 3
"""Degrees of freedom from which the F-test is made."""
_EARTH_SIGMAS: Final = 3.0
"""Effect over the sigma of the Earth rate below which a g-sensitivity is not distinguishable from it."""
_ESTIMATED: Final = (
    "The gyros are g-sensitive, and without it the residuals contradict the noise: the g-sensitivity was estimated too "
    "(diagnostics.g_sensitivity). 'srt apply' corrects it; what applies the 27 errors alone does not."
)
_DEG_PER_H_PER_G: Final = STANDARD_GRAVITY_M_S2 / DEG_PER_H


def estimated_g_sensitivity(
    data: PreparedRecording, rest: RestRates, matrix: Array, covariance: Array, wander: Array
) -> GSensitivity:
    """Estimated g-sensitivity with its sigmas and the scatter of the rest rates.

    Parameters
    ----------
    data : PreparedRecording
    rest : RestRates
        With Γ f subtracted.
    matrix : ndarray, shape (3, 3), rad/s per m/s²
    covariance : ndarray, shape (9, 9)
        Covariance of the elements of the matrix by rows.
    wander : ndarray, shape (3,), rad/s
        1-sigma of a sequence's gyro bias about the mean of the test (sensor axes), if no instability is stated.
    """
    pool, gyro = rest.pool, rest.gyro
    left, deviation = rest.rate - pool @ rest.rate, rest.force - pool @ rest.force
    followed = np.linalg.solve(gyro.matrix, matrix)
    sigma = np.sqrt(np.diag(covariance)).reshape(3, 3)
    return GSensitivity(
        matrix=matrix,
        sigma=sigma,
        covariance=covariance,
        matrix_deg_per_h_per_g=matrix * _DEG_PER_H_PER_G,
        sigma_deg_per_h_per_g=sigma * _DEG_PER_H_PER_G,
        not_seen_along=rest.poses.unobserved,
        rest_rate_scatter_rad_s=RestRateScatter(
            before=np.sqrt(pool @ (left + deviation @ followed.T) ** 2),
            after=np.sqrt(pool @ left**2),
            expected=np.sqrt(_expected_scatter(data, rest, wander)),
        ),
    )


def _expected_scatter(data: PreparedRecording, rest: RestRates, wander: Array) -> Array:
    """Variance of the rest rates about their mean, after Γ is fitted, by noise and bias instability, (3,), (rad/s)²."""
    slope, flicker = rest.gyro.inverse**2, data.noise.gyro_flicker
    # Deviations from mean and fit, as combinations of the rates of the windows.
    C = np.eye(len(rest.rate)) - rest.force @ rest.poses.weights.T
    C -= rest.pool @ C
    own = raw_rate_variance(data.noise, data.windows.duration_s) @ slope.T
    same = rest.sequence[:, None] == rest.sequence
    between, size = (same, wander) if flicker is None else (data.drift.window_covariance, flicker)
    return np.asarray(rest.pool @ (C**2 @ own) + rest.pool @ np.sum(C @ between * C, axis=1) * (slope @ size**2))


def warnings(unobserved: Array | None, size: float | None, *, automatic: bool) -> tuple[str, ...]:
    """Warnings: Γ estimated unasked, not observable in a direction, or significant and not estimated.

    Parameters
    ----------
    unobserved : ndarray, shape (m, 3), or None
        Unit vectors along which Γ is not observable; None if it is not estimated.
    size : float, rad/s per m/s², or None
        Significant g-sensitivity that is not estimated.
    automatic : bool
        True if the options do not ask for an estimate.
    """
    if unobserved is not None:
        told = (_ESTIMATED,) if automatic else ()
        if not len(unobserved):
            return told
        along = " and ".join("(" + ", ".join(f"{x:.2f}" for x in axis) + ")" for axis in unobserved)
        return (
            *told,
            f"Gyro g-sensitivity along {along} is not observable: the specific force varies by less than "
            f"{LEAST_FORCE_VARIATION:g} g in this direction. It is set to zero, and no sigma includes its error. Add "
            "sequences with these axes up and down.",
        )
    if size is None:
        return ()
    return (
        f"The gyros are g-sensitive: the rest rates depend on the specific force by up to "
        f"{size * _DEG_PER_H_PER_G:.2g} °/h/g (F-test, p < {FALSE_ALARM_PROBABILITY:g}). The sigmas do not include it; "
        f"estimate it with --gyro-bias {MODE} (gyro_bias={MODE!r}).",
    )


def _significant(data: PreparedRecording, root: Array, change: Array, rate: Array) -> tuple[float | None, int]:
    """Largest significant element of Γ in weighted rates (n, 3), or None, and the number of directions of the force.

    The gyros are tested one by one, and together by Fisher's product of the probabilities.
    """
    constant = root / np.linalg.norm(root)
    change, rate = (v - constant @ (constant.T @ v) for v in (change, rate))
    left, singular, right = np.linalg.svd(change, full_matrices=False)
    seen = singular > LEAST_FORCE_VARIATION * data.gravity * np.linalg.norm(root)
    count, freedom = int(seen.sum()), len(rate) - 1 - int(seen.sum())
    if count == 0 or freedom < _LEAST_FREEDOM:
        return None, count
    by_force = left[:, seen].T @ rate
    explained, rest = np.sum(by_force**2, axis=0), np.sum((rate - left[:, seen] @ by_force) ** 2, axis=0)
    with np.errstate(divide="ignore"):
        F = np.divide(explained / count, rest / freedom, out=np.zeros(3), where=explained > 0.0)
    p = np.maximum(fdtrc(count, freedom, F), np.finfo(float).tiny)
    significant = 2.0 * min(3.0 * p.min(), chdtrc(6, -2.0 * np.log(p).sum())) <= FALSE_ALARM_PROBABILITY
    size = float(np.abs((right[seen].T / singular[seen]) @ by_force).max())
    return size if significant else None, count


def significant_g_sensitivity(
    data: PreparedRecording, force: Array, rest_rate: Array, integrated: Mask
) -> float | None:
    """Largest element of Γ, rad/s per m/s², if the F-test finds it significant, else None.

    An Earth-rate error has a part fixed to the vertical, which looks like g-sensitivity: an effect below 3 sigma of the
    Earth rate is not significant.

    Parameters
    ----------
    data : PreparedRecording
    force : ndarray, shape (W, 3), m/s²
        Compensated specific force of the windows.
    rest_rate : ndarray, shape (W, 3), rad/s
        Compensated rate of the windows less the Earth rate.
    integrated : ndarray of bool, shape (W,)
        Windows in which the unit moved.
    """
    at_rest = ~(integrated[data.start] | integrated[data.end])
    if integrated.all():  # integrated on request, not because they moved
        at_rest[:] = True
    start, end = data.start[at_rest], data.end[at_rest]
    T = data.windows.duration_s
    root = np.sqrt(T[start] * T[end] / (T[start] + T[end]))[:, None]
    changes = (root * (values[end] - values[start]) for values in (force, rest_rate))
    size, directions = _significant(data, root, *changes)
    if size is None and directions < 3:  # single poses, or rotations about the vertical: only the sequences differ
        rest, root = ~integrated, np.sqrt(T)[:, None]
        size, _ = _significant(data, root[rest], (root * force)[rest], (root * rest_rate)[rest])
    if size is None:
        return None
    doubt = _EARTH_SIGMAS * earth_rate_sigma(data.recording)
    return size if size * data.gravity > doubt else None
