"""Thresholds of the likelihood ratio for intervals that hold 95 % also where they become upper limits.

The interval of a coefficient is the set of values whose −2 ln(likelihood ratio) against the best admissible fit is
below a threshold: the 95 % quantile of that ratio if the tested value is the true one (the unified approach of Feldman
and Cousins, Phys. Rev. D 57, 1998, 3873). Far from zero and with many observations it is the quantile of chi-square
with 1 degree of freedom.

Quantization and white noise show in many coefficients of the record: the estimate is a normal number, cut at zero.
Flicker noise, random walk and ramp show in few, compete for them and may all be zero: the quantile is that of simulated
records of the terms fitted with the tested value, white noise fitted beside them, quantization known.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import ndtr

if TYPE_CHECKING:
    from srt.types import Array, Indices

RECORDS: Final = 399
"""Simulated records of a threshold: its error changes the probability of an interval by 1.1 % (1 sigma)."""

_WHITE: Final = 1
"""Column of white noise in a design."""
SLOW: Final = (2, 3)
"""Columns of flicker noise and random walk."""
_PASSES: Final = 10
"""Iterations of a weighted fit that starts at the truth: twice as many change no threshold by 1e-4."""
_SINGLE_BINS: Final = 24
"""Coefficients of the record that are simulated one by one."""
_BINS_PER_E: Final = 5
"""Bins per factor e beyond them."""


def normal_threshold(size: float, confidence: float) -> float:
    """Quantile of the likelihood ratio of a normal estimate cut at zero.

    Parameters
    ----------
    size : float
        Value tested, in standard deviations of the estimate.
    """
    from scipy.optimize import brentq  # a heavy import that figures and tables of noise do without

    def outside(q: float) -> float:
        # An estimate below zero is cut: its ratio is that of zero.
        lower = -q if q <= size else -(size**2 + q**2) / (2.0 * size) if size > 0.0 else -np.inf
        return float(ndtr(-q) + ndtr(lower)) - (1.0 - confidence)

    return float(brentq(outside, 0.0, 10.0)) ** 2


class Bins(NamedTuple):
    """Bins of the cosine coefficients of a record.

    Attributes
    ----------
    number, uu : ndarray, shape (b,)
        Number of coefficients, and the sum of squares of the ramp's transform.
    design : ndarray, shape (b, 4)
        Mean variance by each term of coefficient 1.
    """

    number: Array
    uu: Array
    design: Array


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRecords:
    """Records of standard normal noise, as sums over bins of coefficients.

    Attributes
    ----------
    squares, along : ndarray, shape (r, b)
        Sum of squares, and the component along the ramp.
    """

    bins: Bins
    squares: Array
    along: Array

    @classmethod
    def draw(cls, bins: Bins, rng: np.random.Generator) -> SimulatedRecords:
        """Draw records for the bins of a spectrum, several of its bins in one."""
        edges = _edges(bins.number)
        total, uu, design = (
            np.add.reduceat(own, edges) for own in (bins.number, bins.uu, bins.design * bins.number[:, None])
        )
        along = rng.standard_normal((RECORDS, len(total)))
        others = np.where(total > 1.0, rng.chisquare(np.maximum(total - 1.0, 1.0), along.shape), 0.0)
        return cls(Bins(total, uu, design / total[:, None]), along**2 + others, along)

    def term_threshold(self, squares: Array, tested: int, confidence: float) -> float:
        """Quantile of the restricted likelihood ratio of a slow term.

        Parameters
        ----------
        squares : ndarray, shape (4,)
            Squared coefficients, true in the records, that of the tested term included.
        tested : int
            Column of the term.
        """
        other = [k for k in SLOW if k != tested]
        return _quantile(self._loss(squares, other, True) - self._loss(squares, list(SLOW), True), confidence)

    def ramp_threshold(self, squares: Array, ramp: float, confidence: float) -> float:
        """Quantile of the likelihood ratio of the size of a ramp, whose sign is unknown.

        Parameters
        ----------
        squares : ndarray, shape (4,)
            Squared coefficients, true in the records.
        ramp : float
            Size tested. The records have no ramp: with the opposite sign it is twice that away.
        """
        slow = list(SLOW)
        tested = np.minimum(self._loss(squares, slow, False, 0.0), self._loss(squares, slow, False, 2.0 * ramp))
        return _quantile(tested - self._loss(squares, slow, False), confidence)

    def _loss(self, squares: Array, free: list[int], restricted: bool, ramp: float | None = None) -> Array:
        """−2 ln(likelihood) of the best fit to each record, the ramp fixed if stated, shape (r,)."""
        count, uu, design = self.bins
        true = design @ squares
        cc, cu = self.squares * true, self.along * np.sqrt(true * uu)
        A = design[:, [_WHITE, *free]]
        products = (A[:, :, None] * A[:, None, :]).reshape(len(A), -1)
        squares = squares.copy()
        squares[[_WHITE, *free]] = 0.0
        fixed = design @ squares
        variance = np.broadcast_to(true, cc.shape)
        slope: float | Array
        spread: float | Array
        for step in range(_PASSES + 1):
            slope, spread = (0.0 if ramp is None else ramp), 0.0
            if ramp is None:
                spread = 1.0 / ((1.0 / variance) @ uu)[:, None]
                slope = (cu / variance).sum(axis=1, keepdims=True) * spread
            power = cc - 2.0 * slope * cu + slope**2 * uu
            if step == _PASSES:
                break
            if restricted:
                power = power + spread * uu
            weight = count / variance**2
            G = (weight @ products).reshape(-1, A.shape[1], A.shape[1])
            found = _admissible(G, (weight * (power / count - fixed)) @ A)
            variance = np.maximum(found @ A.T + fixed, 1e-3 * variance)
        loss = (count * np.log(variance) + power / variance).sum(axis=1)
        return np.asarray(loss - np.log(spread)[:, 0] if restricted else loss)


def _edges(count: Array) -> Indices:
    """First of the bins that are taken together."""
    first = np.concatenate([[1.0], 1.0 + np.cumsum(count)[:-1]])
    last = float(first[-1])
    wanted = np.arange(1.0, _SINGLE_BINS)
    if last > _SINGLE_BINS:
        steps = max(2, ceil(_BINS_PER_E * log(last / _SINGLE_BINS)))
        wanted = np.concatenate([wanted, np.geomspace(_SINGLE_BINS, last, steps)])
    return np.unique(np.searchsorted(first, wanted[wanted <= last])).astype(np.intp)


def _quantile(ratio: Array, confidence: float) -> float:
    """Order statistic that a further ratio exceeds with the stated probability."""
    return float(np.sort(ratio)[ceil(confidence * (len(ratio) + 1)) - 1])


def _admissible(G: Array, g: Array) -> Array:
    """Minimum of ½ xᵀG x − gᵀx by record, x of two or three, all but the first not negative; shape (r, 2) or (r, 3)."""
    lead = G[:, 0, 1:] / G[:, :1, 0]
    # The first unknown is eliminated.
    H = G[:, 1:, 1:] - lead[:, :, None] * G[:, :1, 1:]
    h = g[:, 1:] - lead * g[:, :1]
    x = np.maximum(h, 0.0) / np.diagonal(H, axis1=1, axis2=2)
    if h.shape[1] == 2:
        determinant = H[:, 0, 0] * H[:, 1, 1] - H[:, 0, 1] * H[:, 1, 0]
        both = np.stack(
            [H[:, 1, 1] * h[:, 0] - H[:, 0, 1] * h[:, 1], H[:, 0, 0] * h[:, 1] - H[:, 1, 0] * h[:, 0]], axis=1
        )
        both /= determinant[:, None]
        # Where one of them would be negative, the one that alone takes more from the sum of squares.
        gain = x * h
        alone = x * np.stack([gain[:, 0] >= gain[:, 1], gain[:, 0] < gain[:, 1]], axis=1)
        x = np.where((both >= 0.0).all(axis=1, keepdims=True), both, alone)
    return np.concatenate([g[:, :1] / G[:, :1, 0] - (lead * x).sum(axis=1, keepdims=True), x], axis=1)
