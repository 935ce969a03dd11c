"""Streams and accuracies that the tests of the analytic platform share."""

from __future__ import annotations

import numpy as np

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
