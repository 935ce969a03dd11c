"""Predicted accuracy of a list of sequences: covariance, noise sources, and parameters that depend on each sequence."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.noise.bias_instability import correlation_times, flicker_covariance
from srt.planning.conditions import GRAVITY, N_UNKNOWNS, NORTH
from srt.planning.information import N_ROWS, Signatures, equilibrated_inverse, target_variances
from srt.planning.timetable import window_borders
from srt.ranking import ranked
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.planning.candidates import Candidate
    from srt.planning.conditions import Conditions
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.planning.selection import AccuracyCriterion
    from srt.types import Array, Indices


WEAK_PRIOR: Final = 1e-9
"""Information on every unknown before the test, in units of its target: it keeps matrices invertible. It corresponds to
a sigma of 3e4 targets, far beyond the limit of an observed parameter."""
OBSERVED_LIMIT: Final = 1e3
"""Sigma over target up to which a parameter counts as observed."""
_LEAST_GROWTH: Final = 1.02
"""Smallest growth factor of sigma without a sequence for which a parameter is listed as depending on it."""
_MOST_LISTED: Final = 3
"""Parameters listed for one sequence."""


def unknown_scales(targets: Array) -> Array:
    """Unit in which each unknown is computed, shape (N_UNKNOWNS,), SI: its target, or a typical accuracy."""
    usual = np.full(N_UNKNOWNS, 1e-6)  # dimensionless and rad: 1 ppm, 1 µrad
    usual[GROUP_SLICES["accel_bias"]] = 1e-5  # m/s²
    usual[GROUP_SLICES["gyro_bias"]] = 1e-7  # rad/s
    usual[GRAVITY], usual[NORTH] = 1e-5, 1e-3  # m/s², rad
    usual[:N_PARAMETERS] = np.where(np.isfinite(targets), targets, usual[:N_PARAMETERS])
    return usual


def prior_information(conditions: Conditions, scale: Array, known: Array | None = None) -> Array:
    """Information before the test in units of ``scale``, shape (N_UNKNOWNS, N_UNKNOWNS).

    Parameters
    ----------
    scale : ndarray, shape (N_UNKNOWNS,)
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), optional
        Information from earlier measurements, SI, gravity and north included.
    """
    before = np.diag(conditions.prior()) if known is None else known
    return np.asarray(before * np.outer(scale, scale) + WEAK_PRIOR * np.eye(N_UNKNOWNS))


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted accuracy of a test.

    Attributes
    ----------
    covariance : ndarray, shape (27, 27), SI
    sigma : ndarray, shape (27,), SI
        Infinite where the test does not observe the parameter.
    sources : dict of str to ndarray, shape (27,)
        1-sigma contribution of each noise source; the squares add up to the variance.
    needed_for : tuple of tuple of (str, float)
        For each sequence, the parameters whose sigma would grow most without it, and the factor (infinite: no other
        sequence observes them); at most three.
    """

    covariance: Array
    sigma: Array
    sources: dict[str, Array]
    needed_for: tuple[tuple[tuple[str, float], ...], ...]

    def limiting(self, k: int) -> tuple[str, float]:
        """Largest noise source of a parameter, and its share of the variance."""
        name = max(self.sources, key=lambda s: float(self.sources[s][k]))
        total = sum(float(v[k]) ** 2 for v in self.sources.values())
        return name, float(self.sources[name][k]) ** 2 / total if total > 0.0 else math.nan


def predict(
    candidates: Sequence[Candidate],
    windows_s: Array,
    fixture: FixtureKinematics,
    conditions: Conditions,
    targets: Array | None = None,
    known: Array | None = None,
) -> Prediction:
    """Predict the accuracy of the best linear estimate from sequences that are run in this order without loss of time.

    Parameters
    ----------
    windows_s : ndarray, shape (n, 2)
        Length of the start and of the end window, s.
    targets : ndarray, shape (27,), optional
        Target sigma, SI; NaN: none. Only ``needed_for`` depends on it.
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), optional
        Information from earlier measurements, SI.
    """
    signatures = Signatures(candidates, fixture, conditions)
    wanted = np.full(N_PARAMETERS, math.nan) if targets is None else targets
    scale = unknown_scales(wanted)
    n = len(signatures)
    H = signatures.H.reshape(n * N_ROWS, -1) * scale
    which, moves_s = np.arange(n), [fixture.move_s(a.end_deg, b.start_deg) for a, b in pairwise(candidates)]
    R, within, common = _whole_covariance(signatures, which, windows_s, np.array(moves_s))
    WH = _weighted(R, H)
    prior = prior_information(conditions, scale, known)
    P = equilibrated_inverse(prior + H.T @ WH)
    gain = P @ WH.T
    by_sequence = gain.reshape(-1, n, N_ROWS)
    shares = {name: np.einsum("pka,kab,pkb->p", by_sequence, B, by_sequence) for name, B in within.items()}
    shares |= {name: np.einsum("pa,pa->p", gain @ B, gain) for name, B in common.items()}
    sources = {name: np.sqrt(np.maximum(share, 0.0)) * scale for name, share in shares.items()}
    before = conditions.prior() * scale**2
    for name, k in (("earth_rate_alignment", NORTH), ("gravity", GRAVITY)):
        shared = np.abs(P[:, k]) * math.sqrt(before[k]) * scale
        sources[name] = np.hypot(sources.get(name, 0.0), shared)
    if known is not None:
        rest = known * np.outer(scale, scale) - np.diag(before)
        sources["test_so_far"] = np.sqrt(np.maximum(np.diag(P @ rest @ P), 0.0)) * scale
    seen = (np.sqrt(np.diag(P)) < OBSERVED_LIMIT)[:N_PARAMETERS]
    covariance = (P * np.outer(scale, scale))[:N_PARAMETERS, :N_PARAMETERS]
    return Prediction(
        covariance,
        np.where(seen, np.sqrt(np.diag(covariance)), math.inf),
        {name: np.where(seen, values[:N_PARAMETERS], math.inf) for name, values in sources.items()},
        _needs(signatures, windows_s, scale, prior, wanted),
    )


def variances_of_test(criterion: AccuracyCriterion, which: Indices, windows_s: Array, moves_s: Array) -> Array:
    """Variances over squared targets of the sequences of a criterion, run in an order, by the covariance of all.

    Parameters
    ----------
    which : ndarray of int, shape (n,)
    windows_s : ndarray, shape (n, 2), s
    moves_s : ndarray, shape (n - 1,), s
        Time between the sequences.

    Returns
    -------
    ndarray, shape (q,)
    """
    own = criterion.signatures
    H = own.H[which].reshape(len(which) * N_ROWS, -1) * criterion.scale
    R, _, _ = _whole_covariance(own, which, windows_s, moves_s)
    M = criterion.prior + H.T @ _weighted(R, H)
    return target_variances(M, criterion.targets, np.zeros(len(criterion.targets)))[0]


def _weighted(R: Array, H: Array) -> Array:
    """``R⁻¹ H`` for a covariance whose rows have different units."""
    d = 1.0 / np.sqrt(np.diag(R))
    return np.asarray(np.linalg.solve(R * np.outer(d, d), H * d[:, None]) * d[:, None])


def _whole_covariance(
    signatures: Signatures, which: Indices, windows_s: Array, moves_s: Array
) -> tuple[Array, dict[str, Array], dict[str, Array]]:
    """Covariance of all measurements of a test: n sequences in their order, without loss of time.

    Bias instability is one process over the whole test, correlated over all windows and rotations; the other sources
    act within sequences. Parameters as those of :func:`variances_of_test`.

    Returns
    -------
    covariance : ndarray, shape (10 n, 10 n)
    within : dict of str to ndarray, shape (n, 10, 10)
        Parts within sequences by source.
    common : dict of str to ndarray, shape (10 n, 10 n)
        Parts by bias instability.
    """
    c, n = signatures.conditions, len(which)
    within = signatures.covariances(windows_s[:, 0], windows_s[:, 1], which, drift=False)
    borders = window_borders(signatures.between_windows_s[which], windows_s, moves_s)
    K = flicker_covariance(borders[:, :3].ravel(), borders[:, 1:].ravel(), correlation_times(float(borders[-1, 3])))
    K = K.reshape(n, 3, n, 3)
    common = {}
    for sensor, floor, by_bias, intervals in (
        ("gyro", c.gyro_instability, signatures.by_bias, slice(None)),
        ("accel", c.accel_instability, signatures.by_force, slice(None, None, 2)),
    ):
        of_biases = floor**2 * K[:, intervals, :, intervals]
        by_axis = (_by_biases(of_biases, by_bias[which][..., axis]) for axis in range(3))
        common[f"{sensor}_bias_instability"] = np.asarray(sum(by_axis))
    R = np.asarray(sum(common.values())).reshape(n, N_ROWS, n, N_ROWS)
    R[np.arange(n), :, np.arange(n)] += np.asarray(sum(within.values()))
    return R.reshape(n * N_ROWS, -1), within, common


def _by_biases(K: Array, effect: Array) -> Array:
    """Covariance of the measurements by the biases of one axis.

    Parameters
    ----------
    K : ndarray, shape (n, i, n, i)
        Covariance of the biases in i intervals of n sequences.
    effect : ndarray, shape (n, i, 10)
        Derivatives of the measurements of a sequence.

    Returns
    -------
    ndarray, shape (10 n, 10 n)
    """
    n, i = effect.shape[:2]
    # One product for each sequence instead of one for each pair: a large matrix by a small one.
    left = (np.swapaxes(effect, 1, 2) @ K.reshape(n, i, n * i)).reshape(n * N_ROWS, n, i)
    return np.asarray((left.transpose(1, 0, 2) @ effect).transpose(1, 0, 2).reshape(n * N_ROWS, -1))


def _needs(
    signatures: Signatures, windows_s: Array, scale: Array, prior: Array, targets: Array
) -> tuple[tuple[tuple[str, float], ...], ...]:
    """Parameters that depend on each sequence, with the drift model that is used while sequences are chosen."""
    rows = signatures.whitened(windows_s[:, 0], windows_s[:, 1]) * scale
    each = np.swapaxes(rows, 1, 2) @ rows
    M = prior + each.sum(axis=0)
    P = equilibrated_inverse(M)
    return tuple(_needed_for(M - one, P, targets) for one in each)


def _needed_for(without: Array, P: Array, targets: Array) -> tuple[tuple[str, float], ...]:
    """Parameters whose sigma grows most without a sequence; only those with a target, if there are any."""
    counted = np.flatnonzero(np.isfinite(targets)) if np.isfinite(targets).any() else np.arange(N_PARAMETERS)
    rest = np.sqrt(np.maximum(np.diag(equilibrated_inverse(without)), 0.0))[counted]
    growth = np.where(rest > OBSERVED_LIMIT, math.inf, rest / np.sqrt(np.diag(P))[counted])
    growth = np.where(np.sqrt(np.diag(P))[counted] > OBSERVED_LIMIT, 1.0, growth)
    first = ranked(growth)[:_MOST_LISTED]
    return tuple((NAMES[counted[i]], float(growth[i])) for i in first if growth[i] > _LEAST_GROWTH)
