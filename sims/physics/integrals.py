"""Integrals of rate and specific force over sample intervals, exact to rounding, for motion analytic in time.

Every sample interval is divided where the formula of the motion changes (ramp corners) and integrated by
Gauss-Legendre quadrature; at rest, one evaluation suffices. The number of nodes follows from the bandwidth, so
that the polynomial through the nodes equals the integrand to rounding. If a component changes sign, its
absolute value is integrated from the same polynomial, between its roots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import legendre

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.types import Array, Indices

_MAX_PHASE = 0.5
"""Largest product of half interval and bandwidth, rad; larger intervals are subdivided."""

_BLOCK = 1024
"""Number of intervals per quadrature call, chosen so that the data fit into the processor's cache."""

_GRID = np.linspace(-1.0, 1.0, 33)
"""Grid on which the interpolating polynomial is searched for changes of sign."""


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Recorded samples of a motion in closed form, in m pieces of one formula each, in the order of time.

    Pieces without a gap between them form an episode, which begins on a sample edge; its time counts from there.

    Attributes
    ----------
    first_sample : ndarray of int, shape (m,)
        Number of the episode's first sample; samples count from 0, without those in gaps.
    n_samples : ndarray of int, shape (m,)
        Number of the episode's samples; 0 in an episode that is not recorded.
    begin_s, end_s : ndarray, shape (m,), s
        Borders of the piece; those after the end of the episode are cut off.
    kind : ndarray of int, shape (m,)
        0: rate and specific force are constant over the piece. Only pieces of one kind are evaluated together.
    bandwidth_rad_s : float
        Highest angular frequency of the integrand while moving, rad/s.
    evaluate : callable
        ``(piece, time) -> (3, 2, n, k)``: components in B of rate (rad/s) and specific force (m/s²) for pieces of shape
        (k,) and times of shape (n, k).
    """

    first_sample: Indices
    n_samples: Indices
    begin_s: Array
    end_s: Array
    kind: Indices
    bandwidth_rad_s: float
    evaluate: Callable[[Indices, Array], Array]


def ranges(first: Indices, stop: Indices) -> tuple[Indices, Indices]:
    """Whole numbers of consecutive ranges: number of the range, and number in it, shape (sum of the lengths,) each."""
    count = np.maximum(stop - first, 0)
    own = np.repeat(np.arange(len(count)), count)
    return own, np.arange(len(own)) + (first - np.cumsum(count) + count)[own]


def node_count(phase: float) -> int:
    """Gauss nodes for which the interpolation error of exp(i·bandwidth·t) is below 1e-17.

    Parameters
    ----------
    phase : float
        Bandwidth times half the interval, rad.
    """
    error, nodes = 2.0, 0
    while error > 1e-17 or nodes < 4:
        nodes += 1
        # Interpolation at n Gauss nodes: |f⁽ⁿ⁾| / n! times the monic Legendre polynomial, at most about
        # 2^(1-n) here.
        error = phase**nodes / math.factorial(nodes) * 2.0 ** (1 - nodes)
    return nodes


class _Intervals(NamedTuple):
    """Intervals between sample edges and borders of pieces, in the order of time, shape (k,) each."""

    piece: Indices
    sample: Indices
    left: Array
    width: Array

    def evaluated(self, rows: Indices, nodes: Array, pieces: Pieces) -> Array:
        """Rate and specific force at n nodes of some of the intervals, shape (6, n, rows)."""
        time = self.left[rows] + 0.5 * self.width[rows] * (1.0 + nodes[:, np.newaxis])
        return pieces.evaluate(self.piece[rows], time).reshape(6, *time.shape)


def integrate(pieces: Pieces, interval_s: float) -> Array:
    """Integrate rate, specific force and their absolute values over every sample.

    Parameters
    ----------
    pieces : Pieces
    interval_s : float
        Sample interval, s.

    Returns
    -------
    ndarray, shape (12, samples)
        Rate, rad, and specific force, m/s, of axis x, y and z of B; then the integrals of the absolute values.
    """
    phase = 0.5 * pieces.bandwidth_rad_s * interval_s
    parts = max(1, math.ceil(phase / _MAX_PHASE))
    exact = _basis(node_count(phase / parts))
    # A polynomial of degree n - 1 is integrated by half as many nodes; three show an extremum between two of them.
    basis = _basis(max(3, (len(exact.nodes) + 1) // 2))
    own = _intervals(pieces, interval_s, parts)
    first = np.diff(own.sample, prepend=-1) > 0
    count = int(np.count_nonzero(first))
    # Only a few samples are divided: their further intervals follow after one interval of every sample.
    place = np.where(first, own.sample, count - 1 + np.cumsum(~first))
    values = np.empty((12, len(place)))
    integral, absolute = np.split(values, 2)
    doubtful = [np.zeros((2, 0), dtype=np.intp)]
    kind = pieces.kind[own.piece]
    still = np.flatnonzero(kind == 0)
    constant = pieces.evaluate(np.arange(len(pieces.kind)), pieces.begin_s[np.newaxis]).reshape(6, -1)
    integral[:, place[still]] = constant[:, own.piece[still]] * own.width[still]
    for moving in (1, 2, 3):
        rows = np.flatnonzero(kind == moving)
        for block in (rows[at : at + _BLOCK] for at in range(0, len(rows), _BLOCK)):
            samples = own.evaluated(block, basis.nodes, pieces)
            integral[:, place[block]] = basis.weights @ samples * (0.5 * own.width[block])
            low, high = samples.min(axis=1), samples.max(axis=1)
            # One spread beyond the nodes covers the ends of the interval and an extremum between two nodes.
            component, row = np.nonzero((2.0 * low < high) & (2.0 * high > low))
            doubtful.append(np.stack([component, block[row]]))
    np.abs(integral, out=absolute)
    component, row = np.concatenate(doubtful, axis=1)
    rows, number = np.unique(row, return_inverse=True)
    samples = own.evaluated(rows, exact.nodes, pieces)[component, :, number]
    absolute[component, place[row]] = _absolute_integral(samples, exact) * (0.5 * own.width[row])
    np.add.at(values.T, own.sample[~first], values.T[count:])
    return values[:, :count]


def _intervals(pieces: Pieces, interval_s: float, parts: int) -> _Intervals:
    """Divide the samples where the formula of the motion changes, and every interval into equal parts."""
    end = pieces.n_samples * interval_s
    begin, end = np.minimum(pieces.begin_s, end), np.minimum(pieces.end_s, end)

    def next_edge(time: Array) -> Indices:
        """Number of the first sample edge at or after a time; the quotient alone may be off by its rounding."""
        edge = np.ceil(time / interval_s)
        edge += edge * interval_s < time
        edge -= (edge - 1.0) * interval_s >= time
        return edge.astype(np.intp)

    after = next_edge(begin)
    piece, number = ranges(after - (after * interval_s > begin), next_edge(end))
    left_edge, right_edge = number * interval_s, (number + 1) * interval_s
    left, right = np.maximum(left_edge, begin[piece]), np.minimum(right_edge, end[piece])
    # An interval between neighbouring edges is one whole sample; its exact width avoids the rounding of the edges.
    width = np.where((left == left_edge) & (right == right_edge), interval_s, right - left) / parts
    sample = pieces.first_sample[piece] + number
    if parts > 1:
        piece, sample, width = np.repeat(piece, parts), np.repeat(sample, parts), np.repeat(width, parts)
        left = np.repeat(left, parts) + np.tile(np.arange(parts), len(left)) * width
    return _Intervals(piece, sample, left, width)


class _Basis(NamedTuple):
    """Gauss nodes and weights, and matrices between node values, Legendre coefficients and grid values."""

    nodes: Array
    weights: Array
    to_coefficients: Array
    to_slope: Array
    to_primitive: Array
    to_grid: Array
    primitive_to_grid: Array


@cache
def _basis(count: int) -> _Basis:
    """Legendre basis of n Gauss nodes; each matrix multiplies rows from the right."""
    nodes, weights = legendre.leggauss(count)
    norm = (2.0 * np.arange(count) + 1.0) / 2.0
    matrices = (
        weights[:, np.newaxis] * legendre.legvander(nodes, count - 1) * norm,
        legendre.legder(np.eye(count), axis=1),
        legendre.legint(np.eye(count), axis=1),
        legendre.legvander(_GRID, count - 1).T,
        legendre.legvander(_GRID, count).T,
    )
    return _Basis(nodes, weights, *(np.asarray(matrix, dtype=np.float64) for matrix in matrices))


def _absolute_integral(samples: Array, basis: _Basis) -> Array:
    """Integral over [-1, 1] of the absolute value of the polynomials through Gauss nodes.

    Parameters
    ----------
    samples : ndarray, shape (p, n)
        Values at the nodes.
    basis : _Basis
        Legendre basis of n nodes.

    Returns
    -------
    ndarray, shape (p,)
    """
    absolute = np.abs(samples @ basis.weights)
    coefficients = samples @ basis.to_coefficients
    on_grid = coefficients @ basis.to_grid
    negative = np.signbit(on_grid)
    changing = np.flatnonzero(np.any(negative[:, :-1] != negative[:, 1:], axis=1))
    coefficients, on_grid, negative = coefficients[changing], on_grid[changing], negative[changing]
    primitive = coefficients @ basis.to_primitive
    sums = primitive @ basis.primitive_to_grid
    cells = np.abs(np.diff(sums, axis=1))

    item, cell = np.nonzero(negative[:, :-1] != negative[:, 1:])
    left, right = _GRID[cell], _GRID[cell + 1]
    y_left, y_right = on_grid[item, cell], on_grid[item, cell + 1]
    root = left + (right - left) * y_left / np.where(y_left == y_right, 1.0, y_left - y_right)
    polynomial, slope = coefficients[item], coefficients[item] @ basis.to_slope
    for _ in range(4):  # the secant start is within 1e-4 of a cell; Newton doubles the digits
        powers = legendre.legvander(root, len(basis.nodes) - 1)
        value = np.einsum("pd,pd->p", powers, polynomial)
        d = np.einsum("pd,pd->p", powers[:, :-1], slope)
        step = np.divide(value, d, out=np.zeros_like(d), where=d != 0.0)
        root = np.clip(root - step, left, right)
        if np.abs(step).max(initial=0.0) < 1e-6:  # the error of the integral is below its square
            break
    at_root = np.einsum("pd,pd->p", legendre.legvander(root, len(basis.nodes)), primitive[item])
    cells[item, cell] = np.abs(at_root - sums[item, cell]) + np.abs(sums[item, cell + 1] - at_root)
    absolute[changing] = cells.sum(axis=1)
    return np.asarray(absolute)
