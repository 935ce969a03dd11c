"""Random walk and reading error of the six channels from the stationary windows, behind a sensor's low-pass filter too.

Within a window the Allan variance of averages over τ is ``N²/τ + 3 q²/τ²`` for white noise N (random walk of the
integral) and an error q of every reading of the integral (quantization ε has q = ε/√12). Both are fitted to the octaves
of τ. A low-pass filter hides white noise in short averages. It correlates neighbouring readings, and the variance of a
sum of n readings with autocovariance r, ``n Σ r(k) − Σ |k| r(k)``, is a straight line in n beyond the memory of the
filter, whatever its form. There the Allan variance is ``N²/τ − c/τ²``, and N is the noise of window means.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from srt.noise.allan import MODEL_DOUBT, PULSE_DOUBT
from srt.noise.nonnegative import nonnegative_least_squares

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from srt.recording.recording import Recording
    from srt.types import Array, Indices

_FIT_PASSES: Final = 40
"""Largest number of passes of the fit of random walk and reading error, each weighted by the fit before it."""
_SETTLED: Final = 1e-3
"""Relative change of the fitted variances below which another pass is not needed."""
_POOL_ABOVE: Final = 0.2
"""Relative 1-sigma of N² above which the three axes of a triad are fitted together."""
_PIECE: Final = 1 << 13
"""Samples averaged together, a power of two: six columns and their halves fit into a processor's cache of 1 MiB."""
_LEAST_SHARE: Final = 1e-12
"""Lower limit of N² over its 1-sigma, so that the relative 1-sigma of a vanishing N² is finite."""
_FALSE_ALARM: Final = 1e-4
"""Probability of the residuals of a triad below which white noise and reading errors alone are contradicted."""
_ENOUGH: Final = 0.05
"""Probability of the residuals above which the memory of a filter counts as passed."""
_FEWEST_OCTAVES: Final = 3
"""Fewest octaves beyond the memory of a filter: two unknowns, and one to test them."""
MEDIAN: Final = math.pi / 2.0
"""Variance of a median over that of the mean, of normal numbers."""
SIGNIFICANT: Final = 3.09
"""Standard deviations by which variances differ at least if they count as different: p = 1e-3."""


@dataclass(frozen=True, slots=True, eq=False)
class RandomWalk:
    """White noise and reading errors of the six channels, in units of the readings.

    Attributes
    ----------
    white : ndarray, shape (6,)
        Random walk of the integral, times √s; behind a filter, that of long averages.
    edge : ndarray, shape (6,)
        1-sigma error of one reading of the integral, times s; zero behind a filter that hides it.
    filter_s : ndarray, shape (2,), s
        Averaging time beyond which a low-pass filter of the gyros and of the accelerometers does not show; zero if
        there is none.
    """

    white: Array
    edge: Array
    filter_s: Array


@dataclass(frozen=True, eq=False)
class _Octaves:
    """Averaging times, s, and numbers of differences, shape (m,); Allan variances by channel, shape (6, m)."""

    tau: Array
    differences: Array
    variance: Array

    def of(self, columns: slice) -> _Octaves:
        """The same of some channels."""
        return replace(self, variance=self.variance[columns])

    @cached_property
    def fits(self) -> Callable[[int, bool], list[_Fit]]:
        """Fits of the channels from an octave on, with drift or without; each is made once."""
        tau, count = self.tau, self.differences
        return cache(
            lambda first, drifting: [_fit_one(tau, count, own, first, drifting=drifting) for own in self.variance]
        )


class _Fit(NamedTuple):
    """N² and q² of one Allan variance, the relative 1-sigma of N², deviance of the residuals."""

    squares: Array
    doubt: float
    deviance: float


def random_walk(recording: Recording, windows: Indices) -> RandomWalk:
    """Random walk and reading error of the six channels from the octaves of the Allan variance of the windows.

    Parameters
    ----------
    windows : ndarray of int, shape (W, 2)
        First sample and one past the last.
    """
    key = octaves_key(windows)
    octaves = recording.memo(key, lambda: allan_octaves([recording], [windows])[0])
    triads = [_triad(recording, windows, octaves, columns) for columns in (slice(0, 3), slice(3, 6))]
    squares = np.array([fit.squares for fits, _ in triads for fit in fits])
    return RandomWalk(np.sqrt(squares[:, 0]), np.sqrt(squares[:, 1]), np.array([filter_s for _, filter_s in triads]))


def _triad(recording: Recording, windows: Indices, octaves: _Octaves, columns: slice) -> tuple[list[_Fit], float]:
    """Fits of the three axes of a triad, and the averaging time beyond its filter; zero without a filter."""
    octaves = octaves.of(columns)
    first, drifting = _beyond_filter(octaves)
    if first:
        typical = _typical(recording, windows).of(columns)
        if _differ(octaves, typical, first):  # motion in single windows looks like a filter
            first, drifting = _beyond_filter(typical)
            octaves = typical if first else octaves
    fits = octaves.fits(first, drifting)
    # Where quantization hides the white noise of an axis, the three axes of a triad are fitted together.
    if any(fit.doubt > _POOL_ABOVE for fit in fits):
        count, mean = 3.0 * octaves.differences, octaves.variance.mean(axis=0)
        fits = [_fit_one(octaves.tau, count, mean, first, drifting=drifting)] * 3
    return fits, float(octaves.tau[first]) if first else 0.0


def _typical(recording: Recording, windows: Indices) -> _Octaves:
    """Octaves of the median window, which motion in single windows leaves alone, unlike the sum over windows."""
    table = [allan_octaves([recording], [windows[w : w + 1]])[0] for w in range(len(windows))]
    tau = max((each.tau for each in table), key=len)
    variance, numbers = np.full((len(table), 6, len(tau)), np.nan), np.zeros((len(table), len(tau)))
    for row, number, each in zip(variance, numbers, table, strict=True):
        m = len(each.tau)
        # The median of a mean of m squares is smaller than its expected value.
        row[:, :m] = each.variance / (chdtri(each.differences, 0.5) / each.differences)
        number[:m] = each.differences
    return _Octaves(tau, numbers.sum(axis=0) / MEDIAN, np.nanmedian(variance, axis=0))


def _differ(octaves: _Octaves, typical: _Octaves, first: int) -> bool:
    """True if the windows together have more noise than the median window, from an octave on."""
    sigma = np.sqrt(2.0 / octaves.differences + 2.0 / typical.differences)
    return bool(np.any((octaves.variance > typical.variance * (1.0 + SIGNIFICANT * sigma))[:, first:]))


def _beyond_filter(octaves: _Octaves) -> tuple[int, bool]:
    """First octave beyond the memory of a triad's filter, zero without one, and whether the bias drifts in the windows.

    White noise, reading errors and bias instability (a flat part) are the model without a filter. Only if it is
    contradicted, and short averages have less variance than longer ones explain, does the sensor have a filter.
    """
    tau = octaves.tau
    live = np.flatnonzero(octaves.variance.max(axis=1) > 0.0).tolist()
    short, best = False, (0.0, 0, False)
    for first in range(len(tau) - _FEWEST_OCTAVES + 1 if live else 0):
        for drifting in (False, True)[: len(tau) - first - _FEWEST_OCTAVES + 1]:
            fits = [octaves.fits(first, drifting)[axis] for axis in live]
            freedom = len(live) * (len(tau) - first - 2 - drifting)
            agreement = float(chdtrc(freedom, sum(fit.deviance for fit in fits)))
            if first and np.median([fit.doubt for fit in fits]) > _POOL_ABOVE * len(fits) ** 0.5:
                continue  # too few long averages
            short = short or _falls_short(octaves, first, fits)
            best = max(best, (agreement, first, drifting))
            if agreement > (_ENOUGH if first else _FALSE_ALARM):
                # A deviation of the first octave that the test does not resolve would bias N by as much as its sigma.
                beyond = first + (first + _FEWEST_OCTAVES + drifting < len(tau))
                return (beyond, drifting) if first and short else (0, False)
    return best[1:] if short else (0, False)


def _falls_short(octaves: _Octaves, first: int, fits: list[_Fit]) -> bool:
    """True if a variance of short averages is less than the white noise of longer ones explains."""
    variance = octaves.variance
    live = variance[variance.max(axis=1) > 0.0, :first]
    white = np.array([fit.squares[0] for fit in fits])
    sigma = np.hypot(np.array([fit.doubt for fit in fits])[:, None], np.sqrt(2.0 / octaves.differences[:first]))
    return bool((live * octaves.tau[:first] < (1.0 - SIGNIFICANT * sigma) * white[:, None]).any())


def octaves_key(windows: Indices) -> Hashable:
    """Name of the octaves of windows among the derived values of a recording."""
    return "octaves", windows.tobytes()


def allan_octaves(recordings: Sequence[Recording], windows: Sequence[Indices]) -> list[_Octaves]:
    """Allan variances of non-overlapping averages by octave, of recordings with windows of equal lengths.

    The averages are formed in one pass, octave from octave, over pieces that fit into a processor's cache. A piece of
    2^k samples gives k octaves and one average; the averages of a window's pieces give the higher octaves.
    """
    channels = 6 * len(recordings)
    power: defaultdict[int, Array] = defaultdict(lambda: np.zeros(channels))
    number: defaultdict[int, int] = defaultdict(int)

    def add(x: Array, octave: int) -> Array:
        """Add the octaves of averages (w, c, n), from the given octave on; return the last averages, (w, c)."""
        while x.shape[2] >= 2:
            m = x.shape[2] // 2
            even, odd = x[:, :, 0 : 2 * m : 2], x[:, :, 1 : 2 * m : 2]
            difference = odd - even
            power[octave] += 0.5 * np.einsum("wcn,wcn->c", difference, difference)
            number[octave] += m * len(x)
            x = 0.5 * (even + odd)
            octave += 1
        return x[:, :, 0]

    by_length: defaultdict[int, list[Indices]] = defaultdict(list)
    for length, begin in zip(np.diff(windows[0])[:, 0].tolist(), np.stack(windows, axis=1)[..., 0], strict=True):
        whole = length // _PIECE * _PIECE
        if whole:
            pieces = [add(_columns(recordings, [begin + own], _PIECE), 0) for own in range(0, whole, _PIECE)]
            add(np.stack(pieces, axis=2), _PIECE.bit_length() - 1)
        if length > whole:
            by_length[length - whole].append(begin + whole)
    for n, begins in by_length.items():
        together = max(1, _PIECE // n)
        for i in range(0, len(begins), together):
            add(_columns(recordings, begins[i : i + together], n), 0)
    octaves = sorted(power)
    tau = recordings[0].nominal_interval_s * 2.0 ** np.array(octaves)
    differences = np.array([number[o] for o in octaves], dtype=np.float64)
    variance = np.stack([power[o] / number[o] for o in octaves], axis=1)
    return [_Octaves(tau, differences, own) for own in variance.reshape(len(recordings), 6, -1)]


def _columns(recordings: Sequence[Recording], begins: Sequence[Indices], n: int) -> Array:
    """Readings of pieces of n samples that begin at samples (recordings,), shape (pieces, 6 for each recording, n)."""
    out = np.empty((len(begins), 6 * len(recordings), n))
    for u, (recording, own) in enumerate(zip(recordings, np.transpose(begins).tolist(), strict=True)):
        for piece, a in zip(out[:, 6 * u : 6 * u + 6], own, strict=True):
            piece[:3], piece[3:] = recording.gyro[a : a + n].T, recording.accel[a : a + n].T
    return out


def _fit_one(tau: Array, count: Array, variance: Array, first: int = 0, *, drifting: bool = False) -> _Fit:
    """Fit of N² and q² to one Allan variance, from an octave on that a filter does not reach, zero without a filter.

    ``drifting`` adds a flat part.
    """
    if not 0.0 < variance.max() < math.inf:  # readings that are constant, or too large to be squared
        return _Fit(np.zeros(2), 0.0, 0.0)
    if len(tau) < 2:  # windows of a few samples: one octave does not separate quantization from white noise
        return _Fit(np.array([variance[0] * tau[0], 0.0]), 1.0, 0.0)
    least = 1e-9 * variance.max()  # long averages of readings that hardly change may be equal
    tau, count, variance = tau[first:], count[first:], variance[first:]
    # Beyond a filter, the part in 1/τ² may be negative: a filter takes white noise from the averages over few samples.
    signed = (1,) if first else ()
    design = np.stack([1.0 / tau, 3.0 / tau**2, np.ones_like(tau)][: 2 + drifting], axis=1)
    solution, expected = np.zeros(design.shape[1]), variance
    for _ in range(_FIT_PASSES):
        # A variance from m differences has the relative 1-sigma √(3/m) of its expected value: the last octaves have few
        # differences, and a variance that is small by chance would dominate the fit. The quantization error of a slow
        # input is no white sequence (a saw-tooth has lines), so octaves that it dominates have little weight for N.
        pulses = PULSE_DOUBT * design[:, 1] * max(solution[1], 0.0)
        sigma = np.hypot(np.maximum(variance, expected) * np.sqrt(3.0 / count) + least, pulses)
        weighted = design / sigma[:, None]
        solution = nonnegative_least_squares(weighted, variance / sigma, signed)
        before, expected = expected, design @ solution
        if np.all(np.abs(expected - before) <= _SETTLED * expected):
            break
    scale = np.linalg.norm(weighted, axis=0)
    unit = weighted / scale
    own = unit[:, 0] - unit[:, 1:] @ np.linalg.lstsq(unit[:, 1:], unit[:, 0], rcond=None)[0]
    doubt = 1.0 / (scale[0] * max(float(np.linalg.norm(own)), np.finfo(np.float64).eps))
    # Without white noise the relative 1-sigma is infinite; the limit makes it a large finite number.
    relative = float(doubt / max(solution[0], _LEAST_SHARE * doubt))
    return _Fit(
        np.maximum(solution[:2], 0.0), relative, _deviance(count, variance, np.maximum(expected, least), pulses)
    )


def _deviance(count: Array, variance: Array, expected: Array, pulses: Array) -> float:
    """−2 ln(likelihood ratio) of Allan variances of m differences, which are gamma variates, against their model."""
    freedom = 2.0 / (2.0 / count + MODEL_DOUBT**2 + (pulses / expected) ** 2)
    ratio = np.maximum(variance / expected, np.finfo(np.float64).eps)
    return float(np.sum(freedom * (ratio - 1.0 - np.log(ratio))))
