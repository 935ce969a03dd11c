"""Repeatability of the parameters over recordings of one unit: values, scatter, chi-square test."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc

from srt.comparison.merge_model import estimate
from srt.result.repeatability import (
    Deviation,
    GroupRepeatability,
    MergedRecording,
    OmittedRecording,
    ParameterRepeatability,
    Repeatability,
)
from srt.sensor_errors import GROUP_SLICES, NAMES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.comparison.merge_model import StackedEstimates
    from srt.result.calibration import Calibration
    from srt.types import Array, Indices


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
        held=tuple(calibration.held),
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
    farthest = int(np.argmax(np.abs(normalised)))
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
