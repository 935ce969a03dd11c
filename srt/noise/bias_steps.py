"""Steps of a bias as forms of drift, see :mod:`srt.noise.drift_forms`.

The time of a step is known to the span that holds it: that between two successive windows, or half a window. Its form
has two functions: a ramp from zero to one across the span, and one that is constant in it and zero elsewhere. Together
they describe a step at any time in the span: the mean bias of the rotation or of the half window is free.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.noise.drift_forms import mean_zero

if TYPE_CHECKING:
    from srt.noise.drift_forms import DriftShape, Intervals
    from srt.types import Array

STEP: Final = "step"
"""First word of the names of these forms: "step at 123.4 s"."""
LEAST_WINDOWS: Final = 4
"""Fewest windows on each side of a step: two sequences on a fixture. Fewer that differ are disturbed windows."""
LARGEST_SHARE: Final = 1.0
"""Largest :func:`within_span` of a step, twice the true limit for noise; beyond it, one window is disturbed."""


def step_shapes(intervals: Intervals) -> dict[str, DriftShape]:
    """Shapes of steps in all spans between windows, and in all halves of windows, by form."""
    W = intervals.windows
    order = np.argsort(intervals.start[:W], kind="stable")
    first, last = intervals.start[:W][order], intervals.end[:W][order]
    spans = [(last[i - 1], first[i]) for i in range(LEAST_WINDOWS, W - LEAST_WINDOWS + 1)]
    for w in order[LEAST_WINDOWS : W - LEAST_WINDOWS].tolist():
        halves = slice(2 * w - 2 * W, 2 * w - 2 * W + 2 or None)
        spans += zip(intervals.start[halves], intervals.end[halves], strict=True)
    middle, out = 0.5 * (intervals.start + intervals.end), {}
    for a, b in spans:
        if b > a:
            values = np.column_stack([np.clip((middle - a) / (b - a), 0.0, 1.0), (middle > a) & (middle < b)])
            values[:W] = values[-2 * W :].reshape(W, 2, 2).mean(axis=1)
            out[f"{STEP} at {0.5 * (a + b):.1f} s"] = mean_zero(values, intervals)
    return out


def within_span(amplitude: Array) -> float:
    """Difference of the bias in a span from the mean of those before and after it, as a share of the step.

    It is at most a half if the span holds the step. ``amplitude`` are the coefficients of both functions, shape (6,),
    or of the ramp, shape (3,).
    """
    jump, *inside = amplitude.reshape(-1, 3)
    return float(np.linalg.norm(inside) / np.linalg.norm(jump)) if inside else 0.0
