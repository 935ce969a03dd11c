"""Bias instability as Markov states: the processes of :mod:`srt.noise.bias_instability` in steps of time.

Each process x of correlation time τ is Markov: given its value at the start of a step, its mean over any interval of
the step and its value at the end do not depend on what was before. A step of the sum of processes therefore is

    ``m = A x + L u``,    ``x⁺ = Φ x + B u + Γ w``

for the means m over the intervals, with the states x scaled to unit variance and u, w white with unit variance.
Processes faster than :data:`CARRIED_S` have no state: their values in different steps count as uncorrelated.

With correlation times a decade apart, the spectrum of the sum ripples about ``1 / f`` by the factor
``1 ± 2 / cosh(π² / ln 10)``, which is 5.5 % or 2.8 % of a standard deviation. A decade inside the range of the
correlation times it lacks another 2 %, and more outside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.noise.bias_instability import PROCESS_VARIANCE, flicker_covariance, regular_root

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.types import Array


CARRIED_S: Final = 5.0
"""Shortest correlation time, s, of a process with a state.

The means of a process of 1 s over adjoining windows of 10 s have a covariance of 1 % of its variance, 0.2 % of the sum.
"""


@dataclass(frozen=True, slots=True, eq=False)
class MarkovSteps:
    """K steps of the drift of one channel with an Allan floor of one.

    Attributes
    ----------
    by_state : ndarray, shape (K, n, M)
        A: means over the n intervals by the M states at the start.
    decay : ndarray, shape (K, M)
        Diagonal of Φ.
    root : ndarray, shape (K, n + M, n + M)
        Lower triangular root of the covariance of means and final states, given the states at the start.
    """

    by_state: Array
    decay: Array
    root: Array


def carried(times_s: Sequence[float]) -> tuple[float, ...]:
    """Correlation times of the processes with a state."""
    return tuple(tau for tau in times_s if tau >= CARRIED_S)


def markov_steps(start: Array, end: Array, span: tuple[Array, Array], times_s: Sequence[float]) -> MarkovSteps:
    """Steps of the drift.

    Parameters
    ----------
    start, end : ndarray, shape (K, n), s
        Intervals of the averages in each step.
    span : (ndarray, ndarray), shape (K,), s
        Times of the states before and after each step.
    times_s : sequence of float, s
        Correlation times of all processes.
    """
    (K, n), states = start.shape, carried(times_s)
    M, sigma = len(states), math.sqrt(PROCESS_VARIANCE)
    first, last = (np.column_stack([span[0], edge, span[1]]) for edge in (start, end))
    C, gain = np.zeros((K, n + M, n + M)), np.zeros((K, n + M, M))
    for tau in times_s:
        c = flicker_covariance(first, last, (tau,)) / PROCESS_VARIANCE
        if tau not in states:
            C[:, :n, :n] += PROCESS_VARIANCE * c[:, 1:-1, 1:-1]
            continue
        j = states.index(tau)
        at, unit = np.append(np.arange(n), n + j), np.append(np.full(n, sigma), 1.0)
        given = c[:, 1:, 0]
        C[:, at[:, None], at] += np.outer(unit, unit) * (c[:, 1:, 1:] - given[:, :, None] * given[:, None, :])
        gain[:, at, j] = unit * given
    decay = np.einsum("kmm->km", gain[:, n:])
    return MarkovSteps(gain[:, :n], decay, regular_root(C))
