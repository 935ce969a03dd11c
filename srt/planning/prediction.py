"""Accuracy that a list of sequences will have: covariance, by source, and what each sequence is there for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.noise.bias_instability import correlation_times, flicker_covariance
from srt.planning.information import GRAVITY, N_ROWS, N_UNKNOWNS, NORTH, Signatures
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.planning.candidates import Candidate
    from srt.planning.information import Conditions
    from srt.planning.stand import Stand
    from srt.types import Array


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
    """Predict the accuracy of the best linear estimate from these sequences, run in this order without loss of time.

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
    n = len(signatures)
    H = signatures.H.reshape(n * N_ROWS, -1) * scale
    factors = _factors(signatures, windows_s)
    R = np.asarray(sum(G @ G.T for G in factors.values()))
    d = 1.0 / np.sqrt(np.diag(R))
    WH = np.linalg.solve(R * np.outer(d, d), H * d[:, None]) * d[:, None]
    prior = prior_information(conditions, scale, known)
    P = _inverse(prior + H.T @ WH)
    gain = P @ WH.T
    sources = {name: np.linalg.norm(gain @ G, axis=1) * scale for name, G in factors.items()}
    before = conditions.prior() * scale**2
    for name, k in (("earth_rate_alignment", NORTH), ("gravity", GRAVITY)):
        shared = np.abs(P[:, k]) * math.sqrt(before[k]) * scale
        sources[name] = np.hypot(sources.get(name, 0.0), shared)
    if known is not None:
        rest = known * np.outer(scale, scale) - np.diag(before)
        sources["test_so_far"] = np.sqrt(np.maximum(np.diag(P @ rest @ P), 0.0)) * scale
    seen = (np.sqrt(np.diag(P)) < _UNSEEN)[:N_PARAMETERS]
    covariance = (P * np.outer(scale, scale))[:N_PARAMETERS, :N_PARAMETERS]
    return Prediction(
        covariance,
        np.where(seen, np.sqrt(np.diag(covariance)), math.inf),
        {name: np.where(seen, values[:N_PARAMETERS], math.inf) for name, values in sources.items()},
        _needs(signatures, windows_s, scale, prior, wanted),
    )


def timetable_s(candidates: Sequence[Candidate], windows_s: Array, stand: Stand) -> Array:
    """Borders of every sequence's start window, turn and end window, shape (n, 4), s, if nobody loses time."""
    own = np.array([c.own_s(stand) for c in candidates])
    moves = [stand.move_s(a.end_deg, b.start_deg) for a, b in pairwise(candidates)]
    lengths = np.stack([windows_s[:, 0], own, windows_s[:, 1]], axis=1)
    begins = np.concatenate([[0.0], np.cumsum(lengths[:-1].sum(axis=1) + moves)])
    return np.asarray(begins[:, None] + np.concatenate([np.zeros((len(own), 1)), np.cumsum(lengths, axis=1)], axis=1))


def _factors(signatures: Signatures, windows_s: Array) -> dict[str, Array]:
    """Unit draws of every source in all measurements of the test, shape (10 n, number of draws) each.

    Drift is one process over the whole test: its covariance over all windows and turns.
    """
    c, n = signatures.conditions, len(signatures)
    out = {}
    for name, blocks in signatures.covariances(windows_s[:, 0], windows_s[:, 1]).items():
        if not name.endswith("_bias_instability"):
            whole = np.zeros((n, N_ROWS, n, N_ROWS))
            values, vectors = np.linalg.eigh(blocks)
            whole[np.arange(n), :, np.arange(n)] = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
            out[name] = whole.reshape(n * N_ROWS, -1)
    times = timetable_s(signatures.candidates, windows_s, signatures.stand)
    start, end = times[:, :3].ravel(), times[:, 1:].ravel()
    K = flicker_covariance(start, end, correlation_times(float(end[-1])))
    values, vectors = np.linalg.eigh(K)
    draws = (vectors * np.sqrt(np.maximum(values, 0.0))).reshape(n, 3, -1)
    for name, floor, effect, parts in (
        ("gyro_bias_instability", c.gyro_instability, signatures.by_bias, draws),
        ("accel_bias_instability", c.accel_instability, signatures.by_force, draws[:, [0, 2]]),
    ):
        acts = np.einsum("kiac,kid->kacd", effect, parts)
        out[name] = floor * acts.reshape(n * N_ROWS, -1)
    return out


def _needs(
    signatures: Signatures, windows_s: Array, scale: Array, prior: Array, targets: Array
) -> tuple[tuple[tuple[str, float], ...], ...]:
    """What each sequence is there for, with drift as it is counted while sequences are chosen."""
    rows = signatures.whitened(windows_s[:, 0], windows_s[:, 1]) * scale
    each = np.swapaxes(rows, 1, 2) @ rows
    M = prior + each.sum(axis=0)
    P = _inverse(M)
    return tuple(_needed_for(M - one, P, targets) for one in each)


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
