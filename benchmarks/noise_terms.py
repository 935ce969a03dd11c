"""Coverage of the intervals of ``srt noise`` over simulated logs of six channels with all five noise terms.

The generator shares nothing with the fit: white noise and a random walk by sums, 1/f noise by Kasdin's fractional
difference with a warm-up of three records, quantization by rounding of the integral. Each channel draws where its
terms cross, so that a short log resolves some of them and a long one most.

    python benchmarks/noise_terms.py [--logs 200] [--lengths 600 10800 86400] [--seed 21]

"""

from __future__ import annotations

import time

import harness
import numpy as np
from scipy.signal import fftconvolve

import srt
from srt.noise.noise_terms import ALL_TERMS, noise_terms

SAMPLES = 30_000
"""Samples of a log, so that 24 hours take no longer than 10 minutes; the rate follows."""


def coefficients(rng: np.random.Generator, dt: float) -> np.ndarray:
    """ε, N, B, K, R of one channel with N = 1: pulses of 1.5 sigma of a sample's angle, and where the terms cross."""
    flat, walk, ramp = np.exp(rng.uniform(np.log([30.0, 300.0, 3e3]), np.log([1e3, 3e4, 3e5])))
    B = 1.0 / np.sqrt(flat)
    K = B * np.sqrt(3.0 / walk)
    return np.array([1.5 * np.sqrt(dt), 1.0, B, K, rng.choice((-1.0, 1.0)) * K * np.sqrt(2.0 / (3.0 * ramp))])


def flicker(rng: np.random.Generator, n: int) -> np.ndarray:
    """1/f noise of spectral density 1/(2 π f dt) dt, by the fractional difference of order 1/2."""
    k = np.arange(1, 4 * n)
    response = np.concatenate([[1.0], np.cumprod((k - 0.5) / k)])
    return fftconvolve(rng.standard_normal(4 * n), response)[3 * n : 4 * n]


def channel(rng: np.random.Generator, terms: np.ndarray, n: int, dt: float) -> np.ndarray:
    """Rates of one channel, means over dt."""
    pulse, N, B, K, R = terms
    rate = N / np.sqrt(dt) * rng.standard_normal(n)
    # B²/(4 ln 2 f) against σ²/(2 π f): σ² = π B²/(2 ln 2)
    rate += B * np.sqrt(np.pi / (2.0 * np.log(2.0))) * flicker(rng, n)
    rate += np.cumsum(K * np.sqrt(dt) * rng.standard_normal(n)) + R * dt * np.arange(n)
    angle = np.concatenate([[0.0], np.cumsum(rate * dt)]) + rng.uniform(0.0, pulse)
    return np.diff(pulse * np.floor(angle / pulse)) / dt


def trial(rng: np.random.Generator, length_s: float) -> tuple[np.ndarray, np.ndarray]:
    """One log: covered and resolved, shape (6, 5)."""
    dt = length_s / SAMPLES
    truth = np.array([coefficients(rng, dt) for _ in range(6)])
    x = np.stack([channel(rng, terms, SAMPLES, dt) for terms in truth], axis=1)
    t = dt * np.arange(1, SAMPLES + 1)
    found = noise_terms(srt.Recording(t, x[:, :3], x[:, 3:], srt.Site(9.8)), (0, SAMPLES), rng)
    low = np.where(found.resolved, found.low, -np.inf)
    # The sign of a ramp counts only where it is resolved.
    value = np.where(found.resolved, truth, np.abs(truth))
    return (low <= value) & (value <= found.high), found.resolved.astype(bool)


def coverage(held: np.ndarray, counted: np.ndarray) -> str:
    """Share of the intervals that hold the truth, and the 95 % band of 95 % in as many; held, counted of shape (k, 6).

    The channels of a log have noise of their own, and share the simulated records behind their thresholds: the band is
    that of the scatter between logs where it is wider than the binomial one.
    """
    number = counted.sum()
    if not number:
        return "      -              "
    surplus = ((held - 0.95) * counted).sum(axis=1)
    half = 1.96 * np.sqrt(max(0.95 * 0.05 * number, surplus.var() * len(held))) / number
    return f"{(held & counted).sum() / number:.3f} ({0.95 - half:.3f}-{min(0.95 + half, 1.0):.3f})"


def main(*, logs: int = 200, lengths: tuple[float, ...] = (600.0, 10800.0, 86400.0), seed: int = 21) -> None:
    print(f"{logs} logs of 6 channels, seed {seed}: truths held, with the 95 % band of 95 %", flush=True)
    for length in lengths:
        rng = np.random.default_rng([seed, round(length)])
        start = time.process_time()
        covered, resolved = map(np.array, zip(*(trial(rng, length) for _ in range(logs)), strict=True))
        spent = (time.process_time() - start) / logs
        print(f"{length:.0f} s ({spent:.2f} s of computing time a log)")
        print("                   resolved  all                  intervals            upper limits")
        for t, term in enumerate(ALL_TERMS):
            held, seen = covered[..., t], resolved[..., t]
            parts = [coverage(held, counted) for counted in (np.ones_like(seen), seen, ~seen)]
            print(f"{term.title:18s}    {seen.mean():.3f}  {'  '.join(parts)}", flush=True)


if __name__ == "__main__":
    harness.run(main, __doc__)
