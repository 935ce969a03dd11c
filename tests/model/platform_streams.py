"""Streams and accuracies that the tests of the analytic platform share."""

import numpy as np

from srt.model.gyro_stream import gyro_stream
from srt.model.sensor_model import Triad

EPS = np.finfo(float).eps
PERFECT = Triad(np.eye(3), np.zeros(3), np.zeros(3))


def legs(*ramps):
    """Increments of one leg after the other, each about its own axis, without a pause."""
    parts = []
    for axis, sizes in ramps:
        part = np.zeros((len(sizes), 3))
        part[:, axis] = sizes
        parts.append(part)
    return np.concatenate(parts)


def random_stream(*, weighted):
    """Smooth rotations with kinks and pauses, and noise of 20 µrad: 17 sequences, some of one and two samples."""
    rng = np.random.default_rng(7)
    n = 5000
    increments = 0.02 * np.sin(np.cumsum(rng.normal(size=(n, 3)), axis=0) / 20.0 + [0.0, 1.0, 2.0])
    for first in range(0, n, 500):
        increments[first : first + 200, first // 500 % 3] = 0.0
        increments[first + 200 : first + 300] = 0.0
    increments[700:710] *= 40.0
    increments += 2e-5 * rng.normal(size=(n, 3))
    edges = np.unique(np.concatenate([[0, 1, 3, n], rng.integers(10, n, 14)]))
    spans = np.stack([edges[:-1], edges[1:]], axis=1)
    rotation = np.stack([spans[:, 0] + np.diff(spans)[:, 0] // 4, spans[:, 1] - np.diff(spans)[:, 0] // 4], axis=1)
    F = rng.uniform(size=n) if weighted else None
    return gyro_stream(increments, 0.01, spans, rotation if weighted else spans, rates=False, F=F)
