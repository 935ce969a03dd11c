"""Every sequence against the others, from the linear model of the last play-back.

What a sequence alone brings are its two horizontal components and the down components of windows that no other one
uses. Leaving it out takes its windows out of the pooled rest rate too, and where a sequence's bias is taken off in
part, the pooled rate that is left decides how much. Noise is taken as it was found with all sequences; so is the
knowledge of north, which a gap in a chain of free turns would lower.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from srt.verdict import Evidence, LeftOut, against_others

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.iteration import Solution
    from srt.options import Options
    from srt.sequences.preparation import PlaybackData

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]
    Indices = NDArray[np.intp]
    Owned = tuple[Indices, Indices]

# By name, as the estimators are: what judges the closed form is no concern of the others.
_MAKERS: Final = {"closed-form": "srt.verdict_formulas", "least-squares": "srt.verdict_weights"}


class Maker(Protocol):
    """What each of those modules has as ``without_sequences``."""

    def __call__(self, data: PlaybackData, options: Options, solution: Solution, owned: list[Owned]) -> list[LeftOut]:
        """Estimate without each sequence."""


def evidence_of(
    estimator: str, data: PlaybackData, options: Options, solution: Solution, held: Mask
) -> tuple[Evidence, ...]:
    """Judge every sequence of a solution by play-back.

    Parameters
    ----------
    estimator : str
        "closed-form" or "least-squares"; of others nothing is known.
    data : PlaybackData
    options : Options
    solution : Solution
    held : ndarray of bool, shape (27,)

    Returns
    -------
    tuple of Evidence
        In the order of the sequences; empty where the linear model is singular.
    """
    if estimator not in _MAKERS or held.all():
        return ()
    without_sequences: Maker = import_module(_MAKERS[estimator]).without_sequences
    H, owned = np.where(held, 0.0, solution.playback.H), owned_by_sequences(data)
    try:
        against = against_others(solution.playback.z, H, solution.measurement_covariance, [rows for rows, _ in owned])
        without = without_sequences(data, options, solution, owned)
    except np.linalg.LinAlgError:
        return ()
    return tuple(Evidence(*row) for row in zip(data.ids, data.occurrences, against, without, strict=True))


def owned_by_sequences(data: PlaybackData) -> list[Owned]:
    """Rows of z that a sequence alone brings, and the windows that no other one uses."""
    used = np.bincount(data.start, minlength=len(data.windows.duration_s))
    used += np.bincount(data.end, minlength=len(used))
    out = []
    for k in range(data.K):
        own = np.array([w for w in (int(data.start[k]), int(data.end[k])) if used[w] == 1], dtype=np.intp)
        out.append((np.concatenate([[2 * k, 2 * k + 1], 2 * data.K + own]).astype(np.intp), own))
    return out


def pools_left(data: PlaybackData, solution: Solution, owned: list[Owned]) -> Array:
    """Weights of the windows in the pooled rest rate without each sequence, shape (K, W); zeros if none is left."""
    pools = np.tile(solution.playback.pool, (data.K, 1))
    for pool, (_, windows) in zip(pools, owned, strict=True):
        pool[windows] = 0.0
    total = pools.sum(axis=1, keepdims=True)
    left = total > 1e-9
    return np.asarray(np.where(left, pools / np.where(left, total, 1.0), 0.0))
