"""False ramps of ``srt noise`` by the size of the walk, for two choices of the walk behind the threshold of a ramp.

The interval of a ramp includes zero where the likelihood ratio of no ramp is below a threshold, which depends on the
bias random walk of the unit. The walk is not known. It is either fitted without a ramp, as in ``srt noise``, or with
one (restricted likelihood). Logs of channels without a ramp, and those of benchmarks/noise_terms.py, 10 minutes each.

    python benchmarks/ramp_thresholds.py [--logs 60] [--seed 31]
"""

from __future__ import annotations

import argparse
import time

import noise_terms as simulated
import numpy as np
from scipy.optimize import minimize_scalar

from srt.noise import noise_terms as fit
from srt.noise.allan import CONFIDENCE
from srt.noise.likelihood_thresholds import SimulatedRecords

LENGTH_S = 600.0
CROSSINGS = (10.0, 1.0, 0.3, 0.1)
"""Times at which a walk equals the white noise in Allan deviation, in lengths of the log."""
SEED = 31


def ramps(rng: np.random.Generator, truth: np.ndarray, dt: float) -> np.ndarray:
    """Ramps found in the channels of one log: shape (6, 2), the walk fitted without and with a ramp."""
    n = simulated.SAMPLES
    edges, u = fit._bins(n), fit._ramp(n, dt)
    design = fit._design(0.5 * np.pi * np.arange(1, n) / n, n, dt)
    design = np.stack([fit._mean(column, edges) for column in design.T], axis=1)
    count = np.diff(np.append(edges, n - 1)).astype(np.float64)
    records = SimulatedRecords.draw(count, fit._sum(u**2, edges), design, rng)
    found = []
    for terms in truth:
        x = simulated.channel(rng, terms, n, dt)
        spectrum = fit._spectrum(x - x.mean(), edges, design, u)
        best, without = fit._likeliest(spectrum), fit._likeliest(spectrum, ramp=0.0)
        doubt = float(np.sqrt(best.ramp_variance))
        likeliest = minimize_scalar(
            lambda ramp, known=spectrum: fit._likeliest(known, ramp=ramp).loss,
            bounds=(best.ramp - 2.0 * doubt, best.ramp + 2.0 * doubt),
            method="bounded",
            options={"xatol": 0.01 * doubt},
        )
        ratio = without.loss - likeliest.fun
        found.append([ratio > records.ramp_threshold(each.squares, 0.0, CONFIDENCE) for each in (without, best)])
    return np.array(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    dt, start = LENGTH_S / simulated.SAMPLES, time.process_time()
    print(f"{given.logs} logs of 6 channels, seed {given.seed}: ramps found, walk fitted without and with a ramp")
    for crossing in (None, *CROSSINGS):
        rng = np.random.default_rng([given.seed, round(10.0 * (crossing or 0.0))])
        shares = []
        for _ in range(given.logs):
            if crossing is None:
                truth = np.array([simulated.coefficients(rng, dt) for _ in range(6)])
            else:
                terms = [1.5 * np.sqrt(dt), 1.0, 0.0, np.sqrt(3.0) / (crossing * LENGTH_S), 0.0]
                truth = np.array([terms] * 6)
            shares.append(ramps(rng, truth, dt))
        case = "all terms" if crossing is None else f"walk crossing at {crossing:g} lengths"
        without, best = 100.0 * np.mean(shares, axis=(0, 1))
        print(f"{case:32s} {without:5.1f} % {best:5.1f} %", flush=True)
    print(f"{time.process_time() - start:.0f} s of computing time")


if __name__ == "__main__":
    main()
