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
    from collections.abc import Callable, Sequence

    from srt.types import Array, Indices, Mask

_MAX_PHASE = 0.5
"""Largest product of half interval and bandwidth, rad; larger intervals are subdivided."""

_BLOCK = 2048
"""Number of intervals per quadrature call, chosen so that the data fit into the processor's cache."""

_GRID = np.linspace(-1.0, 1.0, 33)
"""Grid on which the interpolating polynomial is searched for changes of sign."""


class Integrals(NamedTuple):
    """Per-sample integrals in B, each of shape (n, 3): rad and m/s."""

    angle: Array
    angle_abs: Array
    velocity: Array
    velocity_abs: Array


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """Consecutive samples of a motion in closed form.

    Attributes
    ----------
    n_samples : int
    breaks_s : ndarray, shape (m + 1,), s
        Borders of the pieces, as time since the start of the episode; the first is 0, the last at or after its end.
    moving : ndarray of bool, shape (m,)
        False: rate and specific force are constant over the piece.
    bandwidth_rad_s : float
        Highest angular frequency of the integrand while moving, rad/s.
    evaluate : callable
        ``(piece, time) -> (k, n, 6)``: rate (rad/s) and specific force (m/s²) in B for pieces of shape (k,
        1) and times of shape (k, n).
    first_piece : int
        Number of the first piece in ``evaluate``; episodes with the same function are evaluated together.
    """

    n_samples: int
    breaks_s: Array
    moving: Mask
    bandwidth_rad_s: float
    evaluate: Callable[[Indices, Array], Array]
    first_piece: int = 0


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
    """Intervals between sample edges and breaks of an episode: left ends, widths, pieces, first of each sample."""

    left: Array
    width: Array
    piece: Indices
    first: Indices
    moving: Mask


def integrate(episodes: Sequence[Episode], interval_s: float) -> Integrals:
    """Integrate rate, specific force and their absolute values over every sample of consecutive episodes.

    Parameters
    ----------
    episodes : sequence of Episode
    interval_s : float
        Sample interval, s.
    """
    cut = [_intervals(episode, interval_s) for episode in episodes]
    ends = np.cumsum([len(c.left) for c in cut])
    # Episodes of one motion and bandwidth share a quadrature call, as its cost is mainly per call.
    groups: dict[tuple[object, float], list[int]] = {}
    for k, episode in enumerate(episodes):
        groups.setdefault((episode.evaluate, episode.bandwidth_rad_s), []).append(k)
    parts = [_integrated([episodes[k] for k in members], [cut[k] for k in members]) for members in groups.values()]
    values = parts[0]
    if len(parts) > 1:
        order = [np.arange(ends[k] - len(cut[k].left), ends[k]) for members in groups.values() for k in members]
        values = np.concatenate(parts)[np.argsort(np.concatenate(order))]
    starts = [c.first + end - len(c.left) for c, end in zip(cut, ends.tolist(), strict=True)]
    first = np.concatenate(starts)
    total = values[first]
    # Only a few samples are divided; their parts follow in order.
    is_rest = np.ones(len(values), dtype=np.bool_)
    is_rest[first] = False
    rest = np.flatnonzero(is_rest)
    np.add.at(total, np.searchsorted(first, rest, side="right") - 1, values[rest])
    angle, velocity, angle_abs, velocity_abs = (np.ascontiguousarray(total[:, a : a + 3]) for a in (0, 3, 6, 9))
    return Integrals(angle, angle_abs, velocity, velocity_abs)


def _intervals(episode: Episode, interval_s: float) -> _Intervals:
    """Divide the samples of an episode where the formula of the motion changes."""
    edges = np.arange(episode.n_samples + 1) * interval_s
    inside = episode.breaks_s[(episode.breaks_s > 0.0) & (episode.breaks_s < edges[-1])]
    place = np.searchsorted(edges, inside)
    new = edges[place] != inside
    points = np.insert(edges, place[new], inside[new])
    is_edge = np.insert(np.ones(len(edges), dtype=bool), place[new], False)
    width = np.diff(points)
    # An interval between neighbouring edges is one whole sample; its exact width avoids the rounding of the edges.
    width[is_edge[:-1] & is_edge[1:]] = interval_s
    left = points[:-1]
    piece = np.searchsorted(episode.breaks_s, left + 0.5 * width, side="right") - 1
    return _Intervals(left, width, piece, np.flatnonzero(is_edge[:-1]), episode.moving[piece])


def _integrated(episodes: Sequence[Episode], cut: Sequence[_Intervals]) -> Array:
    """Integrals over the intervals of episodes that share ``evaluate`` and bandwidth, shape (k, 12)."""
    left, width, _, _, moving = (np.concatenate(column) for column in zip(*cut, strict=True))
    piece = np.concatenate([c.piece + e.first_piece for c, e in zip(cut, episodes, strict=True)])
    begin = np.concatenate([e.breaks_s[c.piece] for c, e in zip(cut, episodes, strict=True)])
    evaluate = episodes[0].evaluate
    values = np.empty((len(left), 12))
    still_pieces, where, row = np.unique(piece[~moving], return_index=True, return_inverse=True)
    if len(still_pieces):
        constant = evaluate(still_pieces[:, np.newaxis], begin[~moving][where][:, np.newaxis])[:, 0]
        still = np.flatnonzero(~moving)
        rates = np.hstack([constant, np.abs(constant)])[row]
        rates *= width[still, np.newaxis]
        values[still] = rates
    turning = np.flatnonzero(moving)
    for rows in np.split(turning, range(_BLOCK, len(turning), _BLOCK)) if len(turning) else ():
        values[rows] = _quadrature(episodes[0], piece[rows], left[rows], width[rows])
    return values


def _quadrature(episode: Episode, piece: Indices, left: Array, width: Array) -> Array:
    """Integrals of the six components and of their absolute values over moving intervals, shape (k, 12).

    ``episode`` is one of the episodes with this motion and bandwidth.
    """
    phase = 0.5 * episode.bandwidth_rad_s * float(width.max())
    parts = max(1, math.ceil(phase / _MAX_PHASE))
    if parts > 1:
        width = np.repeat(width / parts, parts)
        left = np.repeat(left, parts) + np.tile(np.arange(parts), len(left)) * width
        piece = np.repeat(piece, parts)
    basis = _basis(node_count(phase / parts))
    half = 0.5 * width
    time = left[:, np.newaxis] + half[:, np.newaxis] * (1.0 + basis.nodes)
    samples = episode.evaluate(piece[:, np.newaxis], time)
    integral = np.einsum("knc,n->kc", samples, basis.weights)
    absolute = np.abs(integral)

    by_node = np.ascontiguousarray(np.swapaxes(samples, 0, 1))  # reductions over the first axis are ten times as fast
    low, high = by_node.min(axis=0), by_node.max(axis=0)
    spread = high - low
    # One spread beyond the nodes covers the ends of the interval and an extremum between two nodes.
    rows, columns = np.nonzero((low - spread < 0.0) & (high + spread > 0.0))
    absolute[rows, columns] = _absolute_integral(samples[rows, :, columns], basis)
    result = np.hstack([integral, absolute]) * half[:, np.newaxis]
    return np.asarray(result.reshape(-1, parts, 12).sum(axis=1))


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
    coefficients = samples @ basis.to_coefficients
    primitive = coefficients @ basis.to_primitive
    on_grid = coefficients @ basis.to_grid
    sums = primitive @ basis.primitive_to_grid
    cells = np.abs(np.diff(sums, axis=1))

    item, cell = np.nonzero(np.signbit(on_grid[:, :-1]) != np.signbit(on_grid[:, 1:]))
    left, right = _GRID[cell], _GRID[cell + 1]
    y_left, y_right = on_grid[item, cell], on_grid[item, cell + 1]
    root = left + (right - left) * y_left / np.where(y_left == y_right, 1.0, y_left - y_right)
    polynomial, slope = coefficients[item], coefficients[item] @ basis.to_slope
    for _ in range(4):  # the secant start is within 1e-4 of a cell; Newton doubles the digits
        powers = legendre.legvander(root, len(basis.nodes) - 1)
        value = np.einsum("pd,pd->p", powers, polynomial)
        d = np.einsum("pd,pd->p", powers[:, :-1], slope)
        root = np.clip(root - np.divide(value, d, out=np.zeros_like(d), where=d != 0.0), left, right)
    at_root = np.einsum("pd,pd->p", legendre.legvander(root, len(basis.nodes)), primitive[item])
    cells[item, cell] = np.abs(at_root - sums[item, cell]) + np.abs(sums[item, cell + 1] - at_root)
    return np.asarray(cells.sum(axis=1))
