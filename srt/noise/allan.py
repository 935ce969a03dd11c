"""Allan deviation of a unit at rest, and the noise terms (data-sheet figures) fitted to it.

The overlapping estimates and their equivalent degrees of freedom come from allantools (extra ``allan``). The Allan
variance of averages over τ is modelled as the sum of::

    3 q²/τ²   quantization, q = ε/√12, ε the quantum of the integral (or other white errors of its readings)
    N²/τ      angular or velocity random walk
    B²        bias instability: the flat part, which data sheets quote
    K² τ/3    rate random walk: random walk of the bias

The terms are fitted by maximum likelihood for chi-square variates. A term is kept only if its removal makes the fit
significantly worse. Bias instability is identified only where the curve becomes flat; otherwise its lowest point is an
upper limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.constants import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, HOUR_S, MICRO_G
from srt.exceptions import DataError, MissingExtraError
from srt.noise.nonnegative import nonnegative_least_squares
from srt.recording.readings import six_channels

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

    from srt.recording.recording import Recording
    from srt.types import Array, Indices


CHANNELS: Final = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")

SHORTEST_WINDOW_S: Final = 30.0
"""Shortest stationary window, s; shorter ones give no more than the fit of :mod:`srt.noise.noise_model`."""

_MOST_SAMPLES: Final = 1 << 17
"""Largest number of samples per channel for the deviations; longer channels are averaged in blocks first."""
_FINE_OCTAVES: Final = 3
"""Octaves beyond the block that still use single samples: strongly overlapping averages have more information."""
_LENGTHS: Final = 5
"""Smallest number of averages in a window; with fewer, the degrees of freedom are not known."""
_KNOCK: Final = 10.0
"""Deviation of a reading, in sigma, above which it is a knock; noise does not reach it in an hour."""
_RINGING_S: Final = 0.1
"""Time before and after a knock that is excluded, s."""
_PROBE: Final = 4096
"""Number of samples from which the sigma of a window's readings is estimated."""
_SIDE_BY_SIDE: Final = 64
"""Number of rows that are compared together for the extremes of a table."""
_ROUNDING: Final = 1e-15
"""Ratio of a deviation to the reading below which it is rounding of the last bit."""


@dataclass(frozen=True, slots=True, eq=False)
class AllanDeviation:
    """Allan deviation of the six channels, and the noise terms identified in it, SI.

    Attributes
    ----------
    tau_s : ndarray, shape (m,), s
    deviation, low, high : ndarray, shape (6, m), rad/s and m/s²
        Gyro x, y, z, accelerometer x, y, z, with the limits of the 95 % interval; NaN for a constant channel.
    freedom : ndarray, shape (6, m)
        Equivalent degrees of freedom.
    value, value_low, value_high : ndarray, shape (6, 4)
        Coefficients of :data:`TERMS` (for quantization ε) and their 95 % intervals; NaN for a term not identified.
    bound : ndarray, shape (6,)
        Upper limit of the bias instability (97.5 %) where the curve does not become flat, else NaN.
    longest_s, total_s : float
        Longest stationary window, and total length of all, s.
    windows : int
        Number of windows.
    """

    tau_s: Array
    deviation: Array
    low: Array
    high: Array
    freedom: Array
    value: Array
    value_low: Array
    value_high: Array
    bound: Array
    longest_s: float
    total_s: float
    windows: int

    def fitted(self, tau_s: Array) -> Array:
        """Deviation by the identified terms, shape (6, k), for times of shape (k,), s."""
        return deviation(TERMS, self.value, tau_s)

    def figures(self) -> dict[str, dict[str, dict[str, float]]]:
        """Identified figures by channel and key, in the units of their keys, as JSON values."""
        limit = np.full(self.value.shape, np.nan)
        limit[:, FLAT] = self.bound
        return figures(TERMS, self.value, self.value_low, self.value_high, limit)


def allan_deviation(recording: Recording, windows: Indices) -> AllanDeviation:
    """Allan deviation over octaves of averaging time, pooled over all long stationary windows.

    Parameters
    ----------
    windows : ndarray of int, shape (W, 2)
        First sample and one past the last; those shorter than :data:`SHORTEST_WINDOW_S` are left out.

    Raises
    ------
    DataError
        If no window is long enough.
    MissingExtraError
        If allantools is not installed.
    """
    dt = recording.nominal_interval_s
    # A window that was detected in blocks may be shorter by one or two samples.
    shortest = SHORTEST_WINDOW_S / dt - 2.0
    longest = float((windows[:, 1] - windows[:, 0]).max(initial=0)) * dt
    candidates = [(a, b) for a, b in windows.tolist() if b - a >= shortest]
    pieces = [piece for a, b in candidates for piece in undisturbed(recording, a, b)]
    long = np.array([(a, b) for a, b in pieces if b - a >= shortest], dtype=np.intp).reshape(-1, 2)
    if len(long) == 0:
        longest = max(((b - a) * dt for a, b in pieces), default=longest)
        raise DataError(
            f"The longest stationary window lasts {longest:.3g} s, but an Allan deviation needs {SHORTEST_WINDOW_S:g} "
            "s or more: let the unit rest for some minutes to see its bias instability."
        )
    allantools = _allantools()
    octaves, variances, counts, steps = _pooled(allantools, recording, long)
    tau: Array = np.asarray(dt * 2.0**octaves, dtype=np.float64)
    rounding = _ROUNDING**2 * np.mean(six_channels(recording, long[:, 0]) ** 2, axis=0)
    changes = variances.max(axis=1) > rounding
    design = design_matrix(tau)
    freedom = np.full(variances.shape, np.nan)
    solution, doubt = np.zeros((2, len(variances), len(TERMS)))
    for c in np.flatnonzero(changes).tolist():
        variances[c] = np.maximum(variances[c], rounding[c])
        freedom[c], solution[c], doubt[c] = _identify(allantools, design, variances[c], counts, steps)
    variances[~changes] = np.nan
    low, high = interval(variances, freedom)
    with np.errstate(divide="ignore"):
        value_low, value_high = interval(solution, 2.0 / doubt**2)
    # The flat part counts as reached where the deviation falls more slowly than τ^(-1/4).
    flat = changes & np.any(design[:, FLAT] * solution[:, FLAT, None] >= 0.5 * solution @ design.T, axis=1)
    solution[~flat, FLAT] = 0.0
    seen = np.where(solution > 0.0, 1.0, np.nan)
    spans = (long[:, 1] - long[:, 0]) * dt
    return AllanDeviation(
        tau_s=tau,
        deviation=np.sqrt(variances),
        low=low,
        high=high,
        freedom=freedom,
        value=np.sqrt(solution) * seen,
        value_low=value_low * seen,
        value_high=value_high * seen,
        bound=np.where(flat, np.nan, high.min(axis=1)),
        longest_s=float(spans.max()),
        total_s=float(spans.sum()),
        windows=len(long),
    )


def undisturbed(recording: Recording, a: int, b: int) -> list[tuple[int, int]]:
    """Parts of a window between knocks, which would add variance at all averaging times."""
    far = np.zeros(b - a, dtype=np.bool_)
    for table in (recording.gyro, recording.accel):
        part = table[a:b]
        probe = part[:: max(1, (b - a) // _PROBE)]
        middle = np.median(probe, axis=0)
        spread = 1.4826 * np.median(np.abs(probe - middle), axis=0)
        # More than half of coarse readings may be equal.
        spread = np.where(spread > 0.0, spread, np.maximum(probe.std(axis=0), _ROUNDING * np.abs(middle)))
        low, high = _extremes(part)
        beyond = np.maximum(high - middle, middle - low) > _KNOCK * spread
        for c in np.flatnonzero(beyond).tolist():
            far |= np.abs(part[:, c] - middle[c]) > _KNOCK * spread[c]
    if not far.any():
        return [(a, b)]
    margin = round(_RINGING_S / recording.nominal_interval_s)
    at = a + np.flatnonzero(far)
    starts, stops = np.append(a, at + margin + 1), np.append(at - margin, b)
    return [(lo, hi) for lo, hi in zip(starts.tolist(), stops.tolist(), strict=True) if hi > lo]


def _extremes(table: Array) -> tuple[Array, Array]:
    """Minimum and maximum of every column; rows are joined first, because short rows are slow to compare."""
    k = table.shape[1]
    whole = len(table) // _SIDE_BY_SIDE * _SIDE_BY_SIDE
    rows = table[:whole].reshape(-1, _SIDE_BY_SIDE * k)
    parts = [table[whole:]]
    if len(rows):
        parts += [rows.min(axis=0).reshape(-1, k), rows.max(axis=0).reshape(-1, k)]
    few = np.concatenate(parts)
    return few.min(axis=0), few.max(axis=0)


def _allantools() -> ModuleType:
    try:
        import allantools
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "allantools":
            raise
        raise MissingExtraError("allantools", "allan", "An Allan deviation") from None
    module: ModuleType = allantools
    return module


def _pooled(
    allantools: ModuleType, recording: Recording, windows: Indices
) -> tuple[Indices, Array, list[Array], list[Array]]:
    """Variances by octave, pooled over windows.

    Returns
    -------
    octaves : ndarray of int, shape (m,)
    variance : ndarray, shape (6, m)
    counts, steps : list of ndarray
        For each octave and the windows that reach it: number of readings of the integral, and of steps in an average.
    """
    dt = recording.nominal_interval_s
    factor = recording.rates_factor
    lengths = windows[:, 1] - windows[:, 0]
    halvings = max(0, int(np.ceil(np.log2(lengths.sum() / _MOST_SAMPLES))))
    share = min(1.0, _MOST_SAMPLES / float(lengths.sum()))
    switch = halvings + _FINE_OCTAVES if halvings else np.inf
    power: dict[int, Array] = {}
    weight: dict[int, float] = {}
    counts: dict[int, list[float]] = {}
    steps: dict[int, list[float]] = {}
    for a, b in windows.tolist():
        size = max(int(share * (b - a)), _LENGTHS)
        middle = (a + b - size) // 2
        parts = [(0, _readings(recording, middle, middle + size, 1) * factor)]
        if halvings:
            parts.append((halvings, _readings(recording, a, b, 1 << halvings) * factor))
        for begin, x in parts:
            n = x.shape[1]
            reached = np.arange(begin, begin + int(np.log2(max(n / _LENGTHS, 1.0))) + 1)
            reached = reached[reached < switch] if begin == 0 else reached[reached >= switch]
            if reached.size == 0 or n < 2 * _LENGTHS:
                continue
            averaged = 2.0 ** (reached - begin)
            rate = 1.0 / (dt * 2.0**begin)
            deviations = [allantools.oadev(row, rate=rate, data_type="freq", taus=averaged / rate)[1] for row in x]
            for octave, m, variance in zip(reached.tolist(), averaged, np.square(deviations).T, strict=True):
                # The number of averages in a window is its weight, whatever the noise.
                told = n / m
                power[octave] = power.get(octave, np.zeros(6)) + told * variance
                weight[octave] = weight.get(octave, 0.0) + told
                counts.setdefault(octave, []).append(n + 1.0)
                steps.setdefault(octave, []).append(m)
    octaves = sorted(power)
    return (
        np.array(octaves, dtype=np.intp),
        np.stack([power[o] / weight[o] for o in octaves], axis=1),
        [np.array(counts[o]) for o in octaves],
        [np.array(steps[o]) for o in octaves],
    )


def _readings(recording: Recording, a: int, b: int, block: int) -> Array:
    """Means of blocks of samples less the total mean, shape (6, n)."""
    n = (b - a) // block
    out = np.empty((6, n))
    for s, table in enumerate((recording.gyro, recording.accel)):
        x = table[a : a + n * block]
        means = x if block == 1 else np.einsum("nbc->nc", x.reshape(n, block, 3)) / block
        out[3 * s : 3 * s + 3] = (means - means.mean(axis=0)).T
    return out


def _freedom(allantools: ModuleType, counts: list[Array], steps: list[Array], alphas: list[int]) -> Array:
    """Equivalent degrees of freedom of every octave, its windows together."""
    simple = allantools.edf_simple
    return np.array(
        [
            sum(max(float(simple(n, m, alpha)), 1.0) for n, m in zip(ns.tolist(), ms.tolist(), strict=True))
            for ns, ms, alpha in zip(counts, steps, alphas, strict=True)
        ]
    )


def _identify(
    allantools: ModuleType, design: Array, variance: Array, counts: list[Array], steps: list[Array]
) -> tuple[Array, Array, Array]:
    """Degrees of freedom, squared coefficients and their relative standard deviations of one channel."""
    alphas = [TERMS[RANDOM_WALK].alpha] * len(variance)
    for _ in range(2):  # the degrees of freedom depend slightly on the dominant term of an octave
        freedom = _freedom(allantools, counts, steps, alphas)
        solution, doubt = fit_terms(design, variance, freedom)
        alphas = [TERMS[t].alpha for t in np.argmax(design * solution, axis=1).tolist()]
    return freedom, solution, doubt


CONFIDENCE: Final = 0.95
"""Probability of all confidence intervals."""


@dataclass(frozen=True, slots=True)
class Term:
    """One term of the Allan variance, ``coefficient² · factor · τ^exponent``.

    Attributes
    ----------
    name, title : str
    factor, exponent : float
    alpha : int
        Exponent of the power spectral density of such noise in the rate.
    keys : (str, str)
        Names of the figure for gyros and accelerometers, with the unit.
    units : (str, str)
        Units in tables.
    scales : (float, float)
        SI per unit.
    """

    name: str
    title: str
    factor: float
    exponent: float
    alpha: int
    keys: tuple[str, str]
    units: tuple[str, str]
    scales: tuple[float, float]


TERMS: Final = (
    Term(
        "quantization", "quantization", 0.25, -2.0, 2,
        ("gyro_quantization_arcsec", "accel_quantization_m_s"),
        ("″", "m/s"), (ARCSEC, 1.0),
    ),
    Term(
        "random_walk", "random walk", 1.0, -1.0, 0,
        ("gyro_noise_deg_per_sqrt_h", "accel_noise_ug_per_sqrt_hz"),
        ("°/√h", "µg/√Hz"), (DEG_PER_SQRT_H, MICRO_G),
    ),
    Term(
        "bias_instability", "bias instability", 1.0, 0.0, -1,
        ("gyro_bias_instability_deg_per_h", "accel_bias_instability_ug"),
        ("°/h", "µg"), (DEG_PER_H, MICRO_G),
    ),
    Term(
        "bias_random_walk", "bias random walk", 1.0 / 3.0, 1.0, -2,
        ("gyro_bias_random_walk_deg_per_h_per_sqrt_h", "accel_bias_random_walk_ug_per_sqrt_h"),
        ("°/h/√h", "µg/√h"), (DEG_PER_H / HOUR_S**0.5, MICRO_G / HOUR_S**0.5),
    ),
)  # fmt: skip
"""Noise terms; the keys are those of the section [imu] of ``recording.toml``."""

PULSES, RANDOM_WALK, FLAT = 0, 1, 2
"""Indices in :data:`TERMS`."""

_SHARED: Final = 0.5
"""Share of the degrees of freedom that a fit may count: those of all octaves add up to twice the number of samples,
because neighbouring octaves contain the same noise."""
MODEL_DOUBT: Final = 0.03
"""Relative 1-sigma of the four-slope model itself: the model is not more accurate, however long the recording."""
PULSE_DOUBT: Final = 0.5
"""Relative 1-sigma of the quantization term: the quantization error of a slow input is not white."""
_DROP: Final = 9.55
"""Loss of 2 ln(likelihood) up to which a term is left out: false-alarm probability 1e-3."""
_PASSES: Final = 60
"""Largest number of reweighted fits."""


def design_matrix(tau: Array, terms: Sequence[Term] = TERMS) -> Array:
    """Variance of every term at coefficient 1, shape (m, terms), for averaging times of shape (m,), s."""
    return np.stack([term.factor * tau**term.exponent for term in terms], axis=1)


def deviation(terms: Sequence[Term], value: Array, tau_s: Array) -> Array:
    """Allan deviation by terms with coefficients (6, terms), NaN for none, shape (6, k), for times of shape (k,), s."""
    return np.asarray(np.sqrt(np.nan_to_num(value) ** 2 @ design_matrix(tau_s, terms).T))


def figures(
    terms: Sequence[Term], value: Array, low: Array, high: Array, limit: Array
) -> dict[str, dict[str, dict[str, float]]]:
    """Figures by channel and key, in the units of their keys: value, low, high, or below where there is a limit alone.

    Parameters
    ----------
    value, low, high, limit : ndarray, shape (6, terms), SI
        NaN for what is not known.
    """
    out: dict[str, dict[str, dict[str, float]]] = {channel: {} for channel in CHANNELS}
    for c, channel in enumerate(CHANNELS):
        for t, term in enumerate(terms):
            found = {"value": value, "low": low, "high": high} if np.isfinite(value[c, t]) else {"below": limit}
            row = {name: float(own[c, t] / term.scales[c // 3]) for name, own in found.items()}
            if np.isfinite(row.get("below", 0.0)):
                out[channel][term.keys[c // 3]] = row
    return out


def interval(variance: Array, freedom: Array) -> tuple[Array, Array]:
    """Confidence limits of the root of a variance from chi-square variates; NaN where the variance is zero.

    Parameters
    ----------
    variance, freedom : ndarray
        Of one shape; degrees of freedom that are not finite give no limits.
    """
    tail = 0.5 * (1.0 - CONFIDENCE)
    known = np.where((variance > 0.0) & np.isfinite(freedom), variance, np.nan)
    nu = np.where(np.isfinite(freedom), freedom, 1.0)
    low, high = np.sqrt(known * nu / chdtri(nu, tail)), np.sqrt(known * nu / chdtri(nu, 1.0 - tail))
    return low, high


def fit_terms(design: Array, variance: Array, freedom: Array) -> tuple[Array, Array]:
    """Fit the significant terms by backward elimination; random walk, which every sensor has, is always kept.

    Parameters
    ----------
    design : ndarray, shape (m, 4)
        From :func:`design_matrix`.
    variance, freedom : ndarray, shape (m,)
        Allan variances, positive, and their equivalent degrees of freedom.

    Returns
    -------
    squares : ndarray, shape (4,)
        Squared coefficients, zero for terms left out.
    doubt : ndarray, shape (4,)
        Their relative standard deviations.
    """
    k = design.shape[1]
    kept = np.arange(k)
    solution, loss = _likeliest(design, variance, freedom, kept)
    while True:
        kept = np.flatnonzero(solution > 0.0)
        leaving = [i for i, t in enumerate(kept.tolist()) if t != RANDOM_WALK]
        if not leaving or len(kept) == 1:
            break
        trials = [_likeliest(design, variance, freedom, np.delete(kept, i)) for i in leaving]
        best = int(np.argmin([trial[1] for trial in trials]))
        # The comparison is always with the fit of all terms, so that small losses do not accumulate.
        if trials[best][1] - loss > _DROP:
            break
        solution = trials[best][0]
    doubt = np.full(k, np.inf)
    kept = np.flatnonzero(solution > 0.0)
    weighted = design[:, kept] / _sigma(design, solution, freedom)[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    covariance = np.linalg.inv((weighted / scale).T @ (weighted / scale))
    doubt[kept] = np.sqrt(np.diag(covariance)) / scale / solution[kept]
    return solution, doubt


def _likeliest(design: Array, variance: Array, freedom: Array, kept: Indices) -> tuple[Array, float]:
    """Maximum-likelihood coefficients by iterated weighted least squares, and −2 ln(likelihood)."""
    solution = np.zeros(design.shape[1])
    sigma = variance * np.hypot(np.sqrt(2.0 / (_SHARED * freedom)), MODEL_DOUBT)
    for _ in range(_PASSES):
        new = np.zeros_like(solution)
        new[kept] = nonnegative_least_squares(design[:, kept] / sigma[:, None], variance / sigma)
        if np.allclose(new, solution, rtol=1e-6, atol=0.0):
            break
        solution = new
        sigma = _sigma(design, solution, freedom)
    ratio = variance / (design @ solution)
    effective = 2.0 * ((design @ solution) / sigma) ** 2
    return solution, float(np.sum(effective * (ratio - 1.0 - np.log(ratio))))


def _sigma(design: Array, solution: Array, freedom: Array) -> Array:
    """1-sigma of every Allan variance, as the model predicts it."""
    model = design @ solution
    chance = np.hypot(np.sqrt(2.0 / (_SHARED * freedom)), MODEL_DOUBT)
    out: Array = np.hypot(model * chance, PULSE_DOUBT * design[:, PULSES] * solution[PULSES])
    return out
