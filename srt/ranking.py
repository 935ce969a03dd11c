"""Order of computed values that rounding errors do not change.

Values that are equal by symmetry, such as the benefit of two mirrored sequences, differ in their last digits, and
which one is larger depends on the processor. They are compared after rounding; of equals, the first comes first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from srt.types import Array, Indices

_STEP: Final = 1e-6
"""Step to which keys are rounded, relative to the largest: 1e4 times the scatter of keys from well-posed systems."""


def rounded(keys: Array, *, axis: int | None = -1, scale: Array | float | None = None) -> Array:
    """Keys rounded to 1e-6 of a scale, by default of the largest finite size along ``axis`` (None: of all).

    A scale is needed where all keys may be differences of nearly equal values, which are nothing but rounding errors.
    """
    if scale is None:
        scale = np.max(np.abs(keys), axis=axis, keepdims=True, where=np.isfinite(keys), initial=0.0)
    step = _STEP * np.asarray(scale, dtype=np.float64)
    step = np.where(step > 0.0, step, 1.0)
    return np.asarray(np.round(keys / step) * step)


def ranked(keys: Array, *, axis: int = -1, scale: Array | float | None = None) -> Indices:
    """Positions by falling key, NaN last; keys that are equal once `rounded` keep their order."""
    return np.argsort(-rounded(keys, axis=axis, scale=scale), axis=axis, kind="stable")


def significant(value: float) -> float:
    """Value to six significant digits: a key for max, min and sorted, which keep the order of equals."""
    return float(f"{value:.6g}")
