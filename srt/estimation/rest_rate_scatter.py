"""Statistics of the rates at rest: their noise, the scatter of the gyro biases between sequences, and its use.

Every sequence has a rest rate of its own, the mean over its windows; the pooled rate is that of the whole test.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.estimation.drift_model import centred_course, gyro_statistics
from srt.estimation.error_sources import earth_rate_sigma, raw_rate_variance
from srt.estimation.g_sensitivity import MODE as G_SENSITIVE
from srt.noise.drift_forms import likelihood_gain, variance_component, variance_components
from srt.noise.variance_components import expected_variance
from srt.result.verdict import MISFIT_PROBABILITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.estimation.drift_model import DriftTerm
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


_POINTS: Final = 500
"""Points of the integral over a standard deviation."""
_SCATTER_PROBABILITY: Final = 1e-3
"""p-value of chi-square below which the biases of the sequences differ by more than their noise."""
_LEAST_SHOWN: Final = float(chdtri(1, 2.0 * MISFIT_PROBABILITY))
"""Chi-square of the rates at rest from which they can show a bias instability."""


def bias_gain(measurements: SrtMeasurements, data: PreparedRecording, mode: str, wander: Array) -> Array:
    """Share of a sequence's own rest rate that is used as its bias, shape (..., 3).

    For biases that differ between sequences by σ and rest rates with noise s, the best linear estimate takes the share
    σ² / (σ² + s²) of a sequence's own deviation. Where a bias instability is stated, the share minimises the remaining
    drift in the rotations, because the bias keeps drifting after the window.
    """
    if mode not in ("auto", G_SENSITIVE):
        return np.full(3, 1.0 if mode == "per-sequence" else 0.0)
    if data.K < 2:
        return np.zeros(3)
    own = rest_rate_variance(measurements, data)
    if data.noise.gyro_flicker is not None:
        of_windows, of_turns = data.drift.window_covariance, data.drift.turn_covariance
        deviation = measurements.share - measurements.pool
        shared = float(np.mean(np.sum((of_turns - measurements.pool @ of_windows) * deviation, axis=1)))
        size = np.einsum("...ab,...b->...a", measurements.gyro.inverse**2, data.noise.gyro_flicker**2)
        variance = size * float(np.mean(np.sum(deviation @ of_windows * deviation, axis=1))) + own
        return np.asarray(np.clip(size * shared / np.maximum(variance, 1e-300), 0.0, 1.0))
    return np.asarray(wander**2 / np.maximum(wander**2 + own, 1e-300))


def gyro_instability(
    data: PreparedRecording, slope: Array, rest: Array, integrated: Mask, present: Sequence[DriftTerm], owner: Indices
) -> tuple[float, float] | None:
    """Expected bias instability of the gyros, rad/s, and its gain; None if the rates at rest do not show it.

    The gain is that of :func:`srt.noise.drift_forms.likelihood_gain`. The instability is not shown either where a bias
    of each sequence is more likely.

    Parameters
    ----------
    data, slope, rest, integrated, present
        As in :func:`srt.estimation.drift_model.gyro_statistics`.
    owner : ndarray of int, shape (W,)
        Sequence of each window.
    """
    courses = {"instability": data.window_drift, "sequences": np.eye(data.K)[owner]}
    found = gyro_statistics(data, slope, rest, integrated, present, courses)
    # The likelihood ratio is at most what the best coefficients explain, and these no more than all residuals.
    if found["instability"].chi_square < _LEAST_SHOWN:
        return None
    flicker = variance_component(found["instability"])
    if flicker.p_value > MISFIT_PROBABILITY or flicker.ratio < variance_component(found["sequences"]).ratio:
        return None
    rates = found["instability"]
    gain = likelihood_gain(flicker.ratio, 1, rates.chi_square, rates.freedom)
    return math.sqrt(expected_variance(rates, 0.0, (0.0, math.inf))), gain


def may_be_unstable(data: PreparedRecording, slope: Array, rest: Array, integrated: Mask) -> Mask:
    """False for units in which :func:`gyro_instability` is not significant, shape (units,); for all at once.

    Where the rates of the windows differ in noise, it is not told before, and all are True. Parameters are those of
    that function, with a leading axis of units in ``slope`` and ``rest``.
    """
    out = np.ones(len(rest), dtype=np.bool_)
    if data.noise.gyro_flicker is not None or integrated.any():
        return out
    noise = raw_rate_variance(data.noise, data.windows.duration_s) @ np.swapaxes(slope**2, -1, -2)
    variance = noise[:, :1] + earth_rate_sigma(data.recording) ** 2
    if np.any(noise != noise[:, :1]):
        return out
    left, (values, vectors) = centred_course(data, data.window_drift)
    from_mean = rest - rest.mean(axis=1, keepdims=True)
    along = ((left @ vectors).T @ from_mean / variance).reshape(len(rest), -1)
    p_value = variance_components((values[:, None] / variance).reshape(along.shape), along)[1]
    return np.asarray((np.sum(from_mean**2 / variance, axis=(1, 2)) >= _LEAST_SHOWN) & (p_value <= MISFIT_PROBABILITY))


def window_rate_variance(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Noise variance of the compensated mean rate of every window, shape (..., W, 3), (rad/s)²."""
    D2 = measurements.gyro.inverse**2
    return np.asarray(raw_rate_variance(data.noise, data.windows.duration_s) @ np.swapaxes(D2, -1, -2))


def rest_rate_variance(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Noise variance of one sequence's rest rate, averaged over sequences, shape (..., 3), (rad/s)²."""
    own = measurements.share[~data.is_move]
    return np.asarray(np.mean(own**2 @ window_rate_variance(measurements, data), axis=-2))


def excess_variance(rates: Array, expected: Array, noise: Array | None = None) -> Array:
    """Variance of biases between sequences beyond what their noise explains, shape (..., 3), (rad/s)².

    Parameters
    ----------
    rates : ndarray, shape (..., K, 3), rad/s
        Rest rate of each sequence.
    expected : ndarray, shape (..., 3), (rad/s)²
        Variance by noise alone. An axis has no excess if noise explains its rates (chi-square, p > 1e-3) with or
        without the sequence that deviates most.
    noise : ndarray, shape (..., 3), (rad/s)², optional
        Variance by the noise of the gyros alone. If given, as no figure is stated, an axis without excess has what is
        expected of the three axes together beyond it.
    """
    n = rates.shape[-2] - 1

    def scatters(values: Array) -> Mask:
        m = values.shape[-2] - 1
        squares = np.sum((values - values.mean(axis=-2, keepdims=True)) ** 2, axis=-2)
        return np.asarray(squares > expected * chdtri(m, _SCATTER_PROBABILITY))

    wanders, near = scatters(rates), rates
    if n > 2:
        # A varying bias shows in many sequences; a deviation of one sequence alone is a fault of that sequence.
        order = np.argsort(np.abs(rates - np.median(rates, axis=-2, keepdims=True)), axis=-2)
        near = np.take_along_axis(rates, order, axis=-2)[..., :-1, :]
        wanders &= scatters(near)
    own = np.where(wanders, np.var(rates, axis=-2, ddof=1) - expected, 0.0)
    # The gyros of a unit are alike: if two scatter, the third does too, although its biases happen to lie closer.
    alike = np.where(np.count_nonzero(wanders, axis=-1) == 2, own.mean(axis=-1), 0.0)
    if noise is not None:
        shown = np.where(scatters(rates), np.var(near, axis=-2, ddof=1), np.var(rates, axis=-2, ddof=1))
        alike = np.maximum(alike, _expected_excess(shown, n, noise))
    return np.asarray(np.where(wanders, own, alike[..., None]))


def _expected_excess(shown: Array, n: int, expected: Array) -> Array:
    """Expected variance beyond noise that the axes share, from variances (..., 3) with n degrees of freedom each.

    The prior is uniform in its root.
    """
    size = np.sqrt(
        expected.mean(axis=-1) * math.sqrt(2.0 / (3.0 * n)) + np.maximum(shown - expected, 0.0).mean(axis=-1)
    )
    root = size[..., None] * np.geomspace(1e-2, 1e2, _POINTS)
    variance = root[..., None] ** 2 + expected[..., None, :]
    log = -0.5 * n * np.sum(np.log(variance) + shown[..., None, :] / variance, axis=-1)
    weight = np.exp(log - log.max(axis=-1, keepdims=True)) * root  # geometric spacing
    return np.asarray(np.sum(weight * root**2, axis=-1) / weight.sum(axis=-1))
