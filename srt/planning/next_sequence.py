"""The sequence to run next, from what a running test knows already."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.planning.candidates import executable, words
from srt.planning.information import GRAVITY, N_UNKNOWNS, NORTH, Signatures
from srt.planning.plan import Limits, check_targets
from srt.planning.prediction import prior_information, units
from srt.sensor_errors import N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from srt.calibration import Calibration
    from srt.planning.candidates import Candidate
    from srt.planning.information import Conditions
    from srt.planning.stand import Stand

    Array = NDArray[np.float64]

_POWER: Final = 4.0
_GRID: Final = 6
_MOSTLY: Final = 0.95
_FAR: Final = 1e4
"""Variance over the target's beyond which a parameter counts as unknown, and better or worse as no matter."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """One more sequence, and what it would do.

    Attributes
    ----------
    candidate : Candidate
    window_s : float
        Of the start and of the end window each.
    time_s : float
        With its waits, without the move to its start.
    ratio : float
        Worst sigma over target after it; infinite while a target is not seen at all.
    improved : tuple of (str, float, float)
        Parameters with a target that it improves most: sigma before (infinite: not seen) and after, SI; at most three.
    """

    candidate: Candidate
    window_s: float
    time_s: float
    ratio: float
    improved: tuple[tuple[str, float, float], ...]


def known_information(calibration: Calibration, conditions: Conditions) -> Array:
    """What a calibration knows, as information on sensor errors, gravity and north.

    Parameters
    ----------
    calibration : Calibration
        Of the test so far. Of parameters that it holds nothing is taken to be known.
    conditions : Conditions
        For the uncertainty of gravity: it is in the calibration's sigmas, and a further sequence does not lessen it.

    Returns
    -------
    ndarray, shape (N_UNKNOWNS, N_UNKNOWNS), SI

    Raises
    ------
    InputError
        A calibration in which nothing was observed.
    """
    seen = np.flatnonzero(calibration.observed)
    if seen.size == 0:
        raise InputError(
            f"The calibration of the test so far has the status {calibration.status} and observed nothing: give one "
            "of a recording that could be calibrated."
        )
    P = calibration.covariance[np.ix_(seen, seen)].copy()
    # The drift that the whole test has in common is in the sigmas of the biases, and no sequence takes it away: it is
    # added again to what is predicted.
    P[np.diag_indices_from(P)] -= np.minimum(conditions.drift_variance()[seen], _MOSTLY * np.diag(P))
    effect = np.asarray(calibration.noise.get("gravity_effect", np.zeros(N_PARAMETERS)), dtype=np.float64)[seen]
    d = np.sqrt(np.diag(P))
    rest = (P - np.outer(effect, effect)) / np.outer(d, d)
    # The accelerometer scales may be known as well as gravity alone allows: rounding must not make that less.
    values, vectors = np.linalg.eigh(rest)
    root = (vectors / np.sqrt(np.maximum(values, 1e-6 * values.max()))).T / d
    rows = np.zeros((len(seen), N_UNKNOWNS))
    rows[:, seen] = root
    # A larger gravity reads as smaller scales: the effect is stored with the sign of larger ones.
    rows[:, GRAVITY] = -root @ effect / max(conditions.gravity_sigma_m_s2, 1e-12)
    out: Array = rows.T @ rows
    out[[GRAVITY, NORTH], [GRAVITY, NORTH]] += conditions.prior()[[GRAVITY, NORTH]]
    return out


def next_sequences(
    stand: Stand,
    conditions: Conditions,
    targets: Array,
    known: Array,
    *,
    limits: Limits | None = None,
    count: int = 5,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Proposal, ...]:
    """Propose what to run next: what brings the targets nearer most for its time, the best first.

    Parameters
    ----------
    stand : Stand
    conditions : Conditions
    targets : ndarray, shape (27,), SI
        NaN: none.
    known : ndarray, shape (N_UNKNOWNS, N_UNKNOWNS)
        Information of the test so far, see :func:`known_information`.
    limits : Limits, optional
    count : int
        Of proposals: different sequences.
    progress : callable, optional
        Called with the numbers of tried and of all lengths of the windows.

    Returns
    -------
    tuple of Proposal
    """
    limits = limits or Limits()
    check_targets(targets)
    kinds = words(largest_turn_deg=limits.largest_turn_deg, most_legs=limits.most_legs)
    signatures = Signatures(executable(stand, kinds), stand, conditions)
    scale, counted = units(targets), np.flatnonzero(np.isfinite(targets))
    M = prior_information(conditions, scale, known)
    floor = conditions.drift_variance()[counted] / targets[counted] ** 2
    before = _variances(M[None], counted)[0] + floor
    best: dict[int, tuple[float, float, Array]] = {}
    grid = limits.grid_s(_GRID)
    for number, window in enumerate(grid.tolist(), start=1):
        rows = signatures.whitened(window, window) * scale
        time = signatures.own_s + 2.0 * window + stand.pause_s + stand.settle_s
        after = _variances(M + np.swapaxes(rows, 1, 2) @ rows, counted) + floor
        gain = (_mean(before[None]) - _mean(after)) / time
        for k in np.argsort(-gain)[: 40 * count].tolist():
            if k not in best or gain[k] > best[k][0]:
                best[k] = (float(gain[k]), window, after[k])
        if progress is not None:
            progress(number, len(grid))
    # Of sequences that differ in the sense of turns or in what is up alone, one.
    kinds_seen: dict[tuple[str, ...], int] = {}
    for k in sorted(best, key=lambda k: -best[k][0]):
        kinds_seen.setdefault(_kind(signatures.candidates[k]), k)
    chosen = list(kinds_seen.values())[:count]
    return tuple(
        _proposal(signatures, k, *best[k][1:], before=before, counted=counted, targets=targets) for k in chosen
    )


def _kind(candidate: Candidate) -> tuple[str, ...]:
    return candidate.down[-1], *(f"{abs(turn)}{axis}" for axis, turn in candidate.rotations)


def _proposal(
    signatures: Signatures,
    k: int,
    window: float,
    after: Array,
    *,
    before: Array,
    counted: NDArray[np.intp],
    targets: Array,
) -> Proposal:
    stand = signatures.stand
    order = np.argsort(after / before)[:3]
    wanted = targets[counted]
    improved = tuple(
        (NAMES[counted[i]], _sigma(before[i], wanted[i]), _sigma(after[i], wanted[i]))
        for i in order
        if after[i] < min(0.98 * before[i], 1e6)
    )
    time_s = float(signatures.own_s[k]) + 2.0 * window + stand.pause_s + stand.settle_s
    return Proposal(signatures.candidates[k], window, time_s, _sigma(after.max(), 1.0), improved)


def _sigma(variance: float, target: float) -> float:
    """Sigma in SI of a variance in units of the target; more than a thousand targets are none."""
    return math.inf if variance > 1e6 else math.sqrt(variance) * float(target)


def _variances(M: Array, counted: NDArray[np.intp]) -> Array:
    d = 1.0 / np.sqrt(np.einsum("naa->na", M))
    inverse = np.linalg.inv(M * d[:, :, None] * d[:, None, :])
    return np.asarray((np.einsum("naa->na", inverse) * d**2)[:, counted])


def _mean(g: Array) -> Array:
    """Log of the power mean: the farthest from their targets count most, without being all that counts."""
    g = np.minimum(g, _FAR)
    largest = g.max(axis=1, keepdims=True)
    return np.asarray(np.log(largest[:, 0]) + np.log(np.mean((g / largest) ** _POWER, axis=1)) / _POWER)
