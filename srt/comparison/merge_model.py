"""Linear model of several recordings of one unit, and its generalised least-squares estimate.

Every recording r measured the same 27 errors x, in the MARS frame that the gyros themselves define, so that values
can be compared whatever the mounting::

    y_r = x + b_r + c_r + e_r

e_r is the error of one recording. c_r is common to recordings: gravity where the same value was stated, and parameters
fixed because no recording observed them; averaging does not reduce it. b_r is the variation between recordings, such as
the bias from turn-on to turn-on: one variance per group of parameters, by restricted maximum likelihood
(:mod:`srt.noise.variance_components`). From few recordings, that variance is uncertain: for a group of three parameters
and n recordings, its relative 1-sigma is √(2 / 3(n − 1)), 58 % from three.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import chdtrc

from srt.conditioning import scaled_root
from srt.exceptions import InputError
from srt.model.prior import prior_sigma
from srt.noise.variance_components import RestrictedLikelihood
from srt.ranking import rounded
from srt.result.repeatability import (
    Deviation,
    GroupRepeatability,
    MergedRecording,
    OmittedRecording,
    ParameterRepeatability,
    Repeatability,
)
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.result.calibration import Calibration
    from srt.types import Array, Indices


GROUP_OF: Final = np.array([list(GROUP_SLICES).index(name.rpartition("_")[0]) for name in NAMES])
"""Number of the group that each parameter belongs to."""

_LEAST_VARIANCE: Final = 1e-6
"""Variance between recordings, over the smallest variance within, that counts as zero: rounding of the likelihood."""


@dataclass(frozen=True, slots=True, eq=False)
class StackedEstimates:
    """Observed parameters of all recordings, n rows in all."""

    y: Array  # shape (n,), SI
    parameter: Indices  # shape (n,): index of the parameter of each row
    recording: Indices  # shape (n,): number of its recording
    own: Array  # shape (n, n); covariance of the recordings' own errors
    common: dict[str, Array]  # shape (n, n); covariance of the common errors, by source

    @property
    def covariance(self) -> Array:
        """Covariance of all errors within recordings, shape (n, n)."""
        return np.asarray(self.own + sum(self.common.values()))

    @property
    def design(self) -> Array:
        """X of y = X x, shape (n, 27)."""
        return np.asarray(np.eye(N_PARAMETERS)[self.parameter])

    def rows(self, recording: int) -> Indices:
        """Rows of a recording."""
        return np.flatnonzero(self.recording == recording)

    def between(self, group: int) -> Array:
        """Root of the covariance of unit variance between recordings in a group, shape (n, parameters of the group)."""
        return np.eye(len(self.parameter))[:, GROUP_OF[self.parameter] == group]


def stack_estimates(calibrations: Sequence[Calibration]) -> StackedEstimates:
    """Stack the observed parameters of calibrations, with the covariance of all of them.

    Raises InputError: a parameter whose sigma is zero.
    """
    observed = [np.flatnonzero(c.observed) for c in calibrations]
    for c, at in zip(calibrations, observed, strict=True):
        exact = at[np.diag(c.covariance)[at] <= 0.0]
        if len(exact):
            raise InputError(f"The sigma of {NAMES[exact[0]]} is zero in one calibration: no weight can be computed.")
    common: dict[str, Array] = {}
    own = [c.covariance[np.ix_(at, at)] for c, at in zip(calibrations, observed, strict=True)]
    for source, effects in (("gravity", _gravity(calibrations)), ("held_values", _held_values(calibrations))):
        roots = [root[at] for root, at in zip(effects, observed, strict=True)]
        stacked = np.concatenate(roots)
        if stacked.any():
            common[source] = stacked @ stacked.T
            own = [P - root @ root.T for P, root in zip(own, roots, strict=True)]
    return StackedEstimates(
        np.concatenate([c.errors.vector[at] for c, at in zip(calibrations, observed, strict=True)]),
        np.concatenate(observed),
        np.repeat(np.arange(len(calibrations)), [len(at) for at in observed]),
        block_diag(*own),
        common,
    )


def _gravity(calibrations: Sequence[Calibration]) -> list[Array]:
    """Effect of the error of gravity on every calibration, one column per stated gravity, shape (27, m) each."""
    stated = [c.site.gravity_m_s2 for c in calibrations]
    columns = list(dict.fromkeys(stated))
    out = []
    for c, gravity in zip(calibrations, stated, strict=True):
        root = np.zeros((N_PARAMETERS, len(columns)))
        if c.noise.gravity_effect is not None:
            root[:, columns.index(gravity)] = c.noise.gravity_effect
        elif "gravity" in c.contributions:
            # Older files give only its size: the effect is the same for the three scale factors.
            scale = GROUP_SLICES["accel_scale"]
            root[scale, columns.index(gravity)] = c.contributions["gravity"][scale]
        out.append(root)
    return out


def _held_values(calibrations: Sequence[Calibration]) -> list[Array]:
    """Symmetric roots of the covariance due to fixed values, so that equal values correlate."""
    unit = prior_sigma()
    out = []
    for c in calibrations:
        P = c.noise.held_values_covariance
        P = np.diag(_sizes(c, "held_values") ** 2) if P is None else P
        values, vectors = np.linalg.eigh(P / np.outer(unit, unit))
        out.append(unit[:, None] * (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
    return out


def _sizes(calibration: Calibration, source: str) -> Array:
    return np.asarray(calibration.contributions.get(source, np.zeros(N_PARAMETERS)), dtype=np.float64)


def between_sigma(stack: StackedEstimates) -> Array:
    """One sigma of the differences between recordings, by group, shape (8,), SI."""
    R, X = stack.covariance, stack.design
    X = X[:, X.any(axis=0)]
    twice = np.bincount(stack.parameter, minlength=N_PARAMETERS)[stack.parameter] > 1
    groups = np.unique(GROUP_OF[stack.parameter[twice]])
    sizes = np.zeros(len(GROUP_SLICES))
    if len(groups):
        left = stack.y - X @ estimate(stack.y, X, R)[0]
        found = RestrictedLikelihood(left, X, R, tuple(stack.between(g) for g in groups)).variances()
        sizes[groups] = np.sqrt(found)
        # A variance below a millionth of the other variance is rounding of the likelihood: zero.
        for g in groups:
            least = _LEAST_VARIANCE * np.diag(R)[GROUP_OF[stack.parameter] == g].min()
            sizes[g] = sizes[g] if sizes[g] ** 2 > least else 0.0
    return sizes


def estimate(y: Array, X: Array, R: Array) -> tuple[Array, Array, float]:
    """Generalised least squares.

    Returns
    -------
    weights @ y : ndarray, shape (p,)
    weights : ndarray, shape (p, n)
    statistic : float
        Weighted square sum of the residuals.

    Raises InputError if R is not positive definite.
    """
    try:
        L, scale = scaled_root(R)
    except np.linalg.LinAlgError:
        raise InputError("The covariance of a calibration is not positive definite, and cannot be merged.") from None
    whitener = solve_triangular(L, np.diag(scale), lower=True)
    A = whitener @ X
    size = np.linalg.norm(A, axis=0)
    Q, triangle = np.linalg.qr(A / size)
    weights = solve_triangular(triangle, Q.T @ whitener) / size[:, None]
    left = whitener @ y
    left = left - Q @ (Q.T @ left)
    return weights @ y, weights, float(left @ left)


def repeatability(
    stack: StackedEstimates,
    used: Mapping[str, Calibration],
    left_out: Mapping[str, str],
    merged: Array,
    sizes: Array,
    agreement: tuple[float, int, float | None],
) -> Repeatability:
    """Table of the repeatability.

    Parameters
    ----------
    left_out : mapping of str to str
        Status of the recordings that were not used.
    merged : ndarray, shape (27,)
    sizes : ndarray, shape (8,)
        One sigma between recordings, by group.
    agreement : (float, int, float or None)
        Chi-square of all, degrees of freedom, probability.
    """
    statistic, freedom, probability = agreement
    return Repeatability(
        recordings=tuple(_recording(title, c) for title, c in used.items()),
        left_out=tuple(OmittedRecording(name=title, status=status) for title, status in left_out.items()),
        chi_square=statistic,
        degrees_of_freedom=freedom,
        probability=probability,
        groups=tuple(_group(stack, name, float(size)) for name, size in zip(GROUP_SLICES, sizes, strict=True)),
        parameters=tuple(_parameter(stack, list(used), i, float(merged[i])) for i in np.unique(stack.parameter)),
    )


def _recording(title: str, calibration: Calibration) -> MergedRecording:
    temperature = calibration.temperature
    return MergedRecording(
        name=title,
        estimator=calibration.estimator,
        status=calibration.status,
        date=calibration.provenance.date,
        temperature_c=None if temperature is None else temperature.mean_c,
        temperature_range_c=None if temperature is None else temperature.range_c,
        data_sha256=calibration.provenance.data_sha256,
        held=tuple(calibration.fixed),
        U=calibration.U,
        U_sigma=calibration.U_sigma_rad,
    )


def _group(stack: StackedEstimates, name: str, size: float) -> GroupRepeatability:
    rows = np.flatnonzero(np.isin(stack.parameter, np.arange(len(NAMES))[GROUP_SLICES[name]]))
    statistic, freedom = _agreement(stack, rows)[:2]
    return GroupRepeatability(
        group=name,
        chi_square=statistic,
        degrees_of_freedom=freedom,
        probability=_probability(statistic, freedom),
        between_sigma=size,
    )


def _parameter(stack: StackedEstimates, titles: list[str], i: int, merged: float) -> ParameterRepeatability:
    rows = np.flatnonzero(stack.parameter == i)
    values = dict(zip(stack.recording[rows].tolist(), stack.y[rows].tolist(), strict=True))
    sigma = np.sqrt(np.diag(stack.covariance)[rows])
    sigmas = dict(zip(stack.recording[rows].tolist(), sigma.tolist(), strict=True))
    statistic, freedom, mean, normalised = _agreement(stack, rows)
    farthest = int(np.argmax(rounded(np.abs(normalised))))  # of two recordings, both deviate alike
    return ParameterRepeatability(
        name=NAMES[i],
        values=tuple(values.get(r) for r in range(len(titles))),
        sigmas=tuple(sigmas.get(r) for r in range(len(titles))),
        weighted_mean=float(mean[0]),
        merged=merged,
        spread=float(np.std(stack.y[rows], ddof=1)) if freedom else None,
        chi_square=statistic,
        degrees_of_freedom=freedom,
        probability=_probability(statistic, freedom),
        largest_deviation=(
            Deviation(recording=titles[stack.recording[rows[farthest]]], sigmas=float(normalised[farthest]))
            if freedom
            else None
        ),
    )


def _agreement(stack: StackedEstimates, rows: Indices) -> tuple[float, int, Array, Array]:
    """Chi-square of some rows about their weighted means, degrees of freedom, means, deviations over their sigma."""
    if not len(rows):
        return 0.0, 0, np.zeros(0), np.zeros(0)
    X = stack.design[rows]
    X = X[:, X.any(axis=0)]
    R = stack.covariance[np.ix_(rows, rows)]
    mean, weights, statistic = estimate(stack.y[rows], X, R)
    left = stack.y[rows] - X @ mean
    # The residuals of the best linear estimate have the covariance R − X P Xᵀ.
    variance = np.diag(R - X @ weights @ R @ weights.T @ X.T)
    there = variance > 1e-12 * np.diag(R)
    normalised = np.where(there, left / np.sqrt(np.where(there, variance, 1.0)), 0.0)
    return statistic, len(rows) - X.shape[1], mean, normalised


def _probability(statistic: float, freedom: int) -> float | None:
    return float(chdtrc(freedom, statistic)) if freedom else None
