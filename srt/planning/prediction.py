"""Accuracy that a list of sequences will have: covariance, by source, and what each sequence is there for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.planning.information import GRAVITY, N_UNKNOWNS, NORTH, Signatures
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srt.planning.candidates import Candidate
    from srt.planning.information import Conditions
    from srt.planning.stand import Stand

    Array = NDArray[np.float64]

NEXT_TO_NOTHING: Final = 1e-9
"""Information on every unknown that is always there, in units of its target: nothing is quite unknown, so that
matrices have inverses; a sigma of more than a thousand targets is none."""
_UNSEEN: Final = 1e3
_NEEDED: Final = 1.02


def units(targets: Array) -> Array:
    """Size of every unknown to compute in, shape (N_UNKNOWNS,): its target, or a usual accuracy."""
    usual = np.full(N_UNKNOWNS, 1e-6)
    usual[GROUP_SLICES["accel_bias"]] = 1e-5
    usual[GROUP_SLICES["gyro_bias"]] = 1e-7
    usual[GRAVITY], usual[NORTH] = 1e-5, 1e-3
    usual[:N_PARAMETERS] = np.where(np.isfinite(targets), targets, usual[:N_PARAMETERS])
    return usual


def prior_information(conditions: Conditions, scale: Array, known: Array | None = None) -> Array:
    """Information before the test in units of ``scale``, shape (N_UNKNOWNS, N_UNKNOWNS).

    Parameters
    ----------
    conditions : Conditions
    scale : ndarray, shape (N_UNKNOWNS,)
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), optional
        Information that there already is, SI, gravity and north included.
    """
    before = np.diag(conditions.prior()) if known is None else known
    return np.asarray(before * np.outer(scale, scale) + NEXT_TO_NOTHING * np.eye(N_UNKNOWNS))


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Accuracy of a test.

    Attributes
    ----------
    covariance : ndarray, shape (27, 27), SI
    sigma : ndarray, shape (27,), SI
        Infinite where the test tells nothing.
    sources : dict of str to ndarray, shape (27,)
        One sigma by source; their squares add up.
    needed_for : tuple of tuple of (str, float)
        For each sequence, the parameters whose sigma would grow most without it, and by which factor (infinite: it
        alone shows them); at most three.
    """

    covariance: Array
    sigma: Array
    sources: dict[str, Array]
    needed_for: tuple[tuple[tuple[str, float], ...], ...]

    def limiting(self, k: int) -> tuple[str, float]:
        """Largest source of a parameter, and its share of the variance."""
        name = max(self.sources, key=lambda s: float(self.sources[s][k]))
        total = sum(float(v[k]) ** 2 for v in self.sources.values())
        return name, float(self.sources[name][k]) ** 2 / total if total > 0.0 else math.nan


def predict(
    candidates: Sequence[Candidate],
    windows_s: Array,
    stand: Stand,
    conditions: Conditions,
    targets: Array | None = None,
    known: Array | None = None,
) -> Prediction:
    """Predict the accuracy of the best linear estimate from these sequences.

    Parameters
    ----------
    candidates : sequence of Candidate
    windows_s : ndarray, shape (n, 2)
        Length of the start and of the end window, s.
    stand : Stand
    conditions : Conditions
    targets : ndarray, shape (27,), optional
        Wanted sigma, SI; NaN: none. Only the weights of ``needed_for`` depend on it.
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), optional
        Information that there already is.
    """
    signatures = Signatures(candidates, stand, conditions)
    wanted = np.full(N_PARAMETERS, math.nan) if targets is None else targets
    scale = units(wanted)
    by_source = signatures.covariances(windows_s[:, 0], windows_s[:, 1])
    R = np.asarray(sum(by_source.values()))
    d = 1.0 / np.sqrt(np.einsum("naa->na", R))
    weight = np.linalg.inv(R * d[:, :, None] * d[:, None, :]) * d[:, :, None] * d[:, None, :]
    H = signatures.H * scale
    WH = weight @ H
    each = np.swapaxes(H, 1, 2) @ WH
    prior = prior_information(conditions, scale, known)
    P = _inverse(prior + each.sum(axis=0))
    sources = {}
    for name, part in by_source.items():
        noise = np.einsum("nap,nab,nbq->pq", WH, part, WH, optimize=True)
        sources[name] = np.sqrt(np.maximum(np.diag(P @ noise @ P), 0.0)) * scale
    before = conditions.prior() * scale**2
    for name, k in (("earth_rate_alignment", NORTH), ("gravity", GRAVITY)):
        shared = np.abs(P[:, k]) * math.sqrt(before[k]) * scale
        sources[name] = np.hypot(sources.get(name, 0.0), shared)
    if known is not None:
        rest = known * np.outer(scale, scale) - np.diag(before)
        sources["test_so_far"] = np.sqrt(np.maximum(np.diag(P @ rest @ P), 0.0)) * scale
    seen = (np.sqrt(np.diag(P)) < _UNSEEN)[:N_PARAMETERS]
    drift = conditions.drift_variance()
    for sensor in ("gyro", "accel"):
        part = np.zeros(N_UNKNOWNS)
        part[GROUP_SLICES[f"{sensor}_bias"]] = np.sqrt(drift[GROUP_SLICES[f"{sensor}_bias"]])
        sources[f"{sensor}_bias_instability"] = np.hypot(sources[f"{sensor}_bias_instability"], part)
    covariance = (P * np.outer(scale, scale))[:N_PARAMETERS, :N_PARAMETERS] + np.diag(drift)
    return Prediction(
        covariance,
        np.where(seen, np.sqrt(np.diag(covariance)), math.inf),
        {name: np.where(seen, values[:N_PARAMETERS], math.inf) for name, values in sources.items()},
        tuple(_needed_for(prior + each.sum(axis=0) - one, P, wanted) for one in each),
    )


def _needed_for(without: Array, P: Array, targets: Array) -> tuple[tuple[str, float], ...]:
    """Parameters whose sigma grows most without a sequence; among those with a target if there are any."""
    counted = np.flatnonzero(np.isfinite(targets)) if np.isfinite(targets).any() else np.arange(N_PARAMETERS)
    rest = np.sqrt(np.maximum(np.diag(_inverse(without)), 0.0))[counted]
    growth = np.where(rest > _UNSEEN, math.inf, rest / np.sqrt(np.diag(P))[counted])
    growth = np.where(np.sqrt(np.diag(P))[counted] > _UNSEEN, 1.0, growth)
    first = np.argsort(-growth, kind="stable")[:3]
    return tuple((NAMES[counted[i]], float(growth[i])) for i in first if growth[i] > _NEEDED)


def _inverse(M: Array) -> Array:
    d = 1.0 / np.sqrt(np.diag(M))
    return np.asarray(np.linalg.inv(M * np.outer(d, d)) * np.outer(d, d))
