"""White noise of the sensors as the stationary windows show it, against the figure that is stated.

The two-sample (Allan) variance of averages over τ is, for a unit that keeps what it states,
``A(τ) = N²/τ + 3 q²/τ² + B²`` (white noise N, reading error q, bias instability B). Pairs of neighbouring averages of
every octave of τ are independent for white noise, so that their weighted sum gives N² with a chi-square of its own.

Averages over less than :data:`SHORTEST_S` are not looked at, as filters and coarse words rule them, not N. A window
far noisier than the others, as when a lorry passes, is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri

from srt.noise.from_windows import smallest_step

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.diagnosis.evidence import Evidence
    from srt.sequences.preparation import PlaybackData

    Array = NDArray[np.float64]

Sensor = Literal["gyro", "accel"]

SHORTEST_S: Final = 0.05
"""Shortest averages that tell of the random walk, s."""
_LEAST_AVERAGES: Final = 16
"""Per window; in shorter windows single samples have to do."""
_DOUBT: Final = 0.5
"""Relative doubt of what pulses and bias instability add: neither is white, so it does not average out."""
_OUTLIER_PROBABILITY: Final = 1e-6
_MOST_OUTLIERS: Final = 0.3
_RESOLUTION_SAMPLES: Final = 4000
_COARSE: Final = 0.5


@dataclass(frozen=True, slots=True)
class ShownNoise:
    """White noise of one triad against the one stated, SI.

    Attributes
    ----------
    stated : float
        rad/√s or m/s²·√s.
    found : ndarray, shape (4,)
        Of x, y, z, and of all three.
    more, less : ndarray, shape (4,)
        Probability that a unit with the stated noise shows as much, or as little.
    """

    stated: float
    found: Array
    more: Array
    less: Array


def shown_noise(evidence: Evidence, sensor: Sensor) -> ShownNoise | None:
    """Noise of a triad at rest; None where none is stated, or the windows cannot show it."""
    data = evidence.data
    stated = getattr(evidence.recording.noise, f"{sensor}_noise")
    if data is None or stated is None:
        return None
    dt = evidence.dt
    step = _step(evidence, data, sensor)
    if np.any(step > _COARSE * stated / np.sqrt(dt)):
        return None  # words so coarse that the noise does not move them as it would move finer ones
    powers = _powers(evidence, data, sensor)
    if powers is None:
        return None
    tau, power, pairs = powers
    kept = ~_noisy(power, pairs)
    total, count = power[kept].sum(axis=0), pairs[kept].sum(axis=0)  # (octaves, 3), (octaves,)
    used = count > 0
    tau, total, count = tau[used], total[used], count[used]
    if len(tau) == 0 or np.any(total.sum(axis=0) == 0.0):
        return None  # a reading that never changes shows no noise, not that there is none
    edge = getattr(data.noise, f"{sensor}_edge")
    instability = getattr(evidence.recording.noise, f"{sensor}_bias_instability") or 0.0
    other = 3.0 * edge**2 / tau[:, None] ** 2 + instability**2 + step**2 * dt / 12.0 / tau[:, None]
    found, more, less = np.empty(4), np.empty(4), np.empty(4)
    for i in range(4):
        channels = slice(i, i + 1) if i < 3 else slice(0, 3)
        m = (count * (1 if i < 3 else 3)).astype(np.float64)
        shown = total[:, channels].sum(axis=1) / m
        beside = other[:, channels].mean(axis=1)
        expected = stated**2 / tau + beside
        variance = 2.0 * expected**2 / m + (_DOUBT * beside) ** 2
        weight = 1.0 / (tau * variance)
        information = float(np.sum(weight / tau))
        found[i] = np.sqrt(max(0.0, float(weight @ (shown - beside)) / information))
        # A weighted sum of squares is nearly a chi-square with as many degrees of freedom as give it its variance.
        mean = float(weight @ expected) / information
        freedom = 2.0 * mean**2 * information
        at = float(weight @ shown) / information / mean * freedom
        more[i], less[i] = chdtrc(freedom, at), chdtr(freedom, at)
    return ShownNoise(float(stated), found, more, less)


def _step(evidence: Evidence, data: PlaybackData, sensor: Sensor) -> Array:
    """Rounding of single readings that is no pulse of a running sum, as a rate, shape (3,)."""
    if getattr(data.noise, f"{sensor}_edge").any():
        return np.zeros(3)
    table = getattr(evidence.recording, sensor)
    samples = data.windows.samples
    stride = max(1, int((samples[:, 1] - samples[:, 0]).sum()) // _RESOLUTION_SAMPLES)
    return smallest_step(np.concatenate([table[a:b:stride] for a, b in samples.tolist()])) * evidence.per_rate


def _powers(evidence: Evidence, data: PlaybackData, sensor: Sensor) -> tuple[Array, Array, NDArray[np.intp]] | None:
    """Half squared differences of neighbouring averages.

    Returns
    -------
    tau : ndarray, shape (octaves,), s
    power : ndarray, shape (W, octaves, 3)
        Sums over the pairs of a window.
    pairs : ndarray of int, shape (W, octaves)
        Their number.
    """
    table = getattr(evidence.recording, sensor)
    samples = data.windows.samples
    lengths = samples[:, 1] - samples[:, 0]
    longest = int(np.ceil(SHORTEST_S / evidence.dt - 1e-6))
    block = max(1, min(longest, int(np.median(lengths)) // _LEAST_AVERAGES))
    octaves = int(np.log2(max(1, int(lengths.max()) // block)))
    if octaves < 1:
        return None
    power, pairs = np.zeros((len(samples), octaves, 3)), np.zeros((len(samples), octaves), dtype=np.intp)
    for w, (a, b) in enumerate(samples.tolist()):
        n = (b - a) // block
        x = table[a : a + n * block].reshape(n, block, 3).mean(axis=1) * evidence.per_rate
        for octave in range(octaves):
            m = len(x) // 2
            if m == 0:
                break
            even, odd = x[0 : 2 * m : 2], x[1 : 2 * m : 2]
            power[w, octave] = 0.5 * np.sum((odd - even) ** 2, axis=0)
            pairs[w, octave] = m
            x = 0.5 * (even + odd)
    tau = block * evidence.dt * np.exp2(np.arange(octaves, dtype=np.float64))
    return tau, power, pairs


def _noisy(power: Array, pairs: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Windows with more power in some octave than chance gives any, by the median window, shape (W,)."""
    freedom = np.maximum(3.0 * pairs, 1.0)
    summed = power.sum(axis=2)
    out = np.zeros(len(power), dtype=np.bool_)
    for octave in range(power.shape[1]):
        has = pairs[:, octave] > 0
        # Half of all windows have more than chdtri(freedom, 1/2).
        scale = np.median(summed[has, octave] / chdtri(freedom[has, octave], 0.5))
        out |= has & (summed[:, octave] > scale * chdtri(freedom[:, octave], _OUTLIER_PROBABILITY / pairs.size))
    return out if out.mean() <= _MOST_OUTLIERS else np.zeros(len(out), dtype=np.bool_)
