"""Quantization step of readings that also carry noise far below it, as those of a corrected recording do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.noise.noise_model import smallest_step

if TYPE_CHECKING:
    from srt.types import Array


_GAP: Final = 20.0
"""Ratio of two successive sizes of differences that separates steps from noise."""
_FEWEST_SMALL: Final = 10
"""Differences below the gap at least: of normal noise 1e-13 of the stretches show such a gap."""
_FEWEST_LARGE: Final = 3
"""Differences above the gap at least: a spike makes two."""


def quantization_step(readings: Array) -> Array:
    """Step between readings, by column.

    Compensation mixes the steps of three axes and rounds, so that the smallest difference of corrected readings is no
    step: the steps are the differences above a wide gap in the sizes of all.

    Parameters
    ----------
    readings : ndarray, shape (n, 3)

    Returns
    -------
    ndarray, shape (3,)
        Smallest difference if there is no gap; zero for constant columns.
    """
    step = smallest_step(readings)
    size = np.sort(np.abs(np.diff(readings, axis=0)), axis=0)
    lower, upper = size[_FEWEST_SMALL - 1 : -_FEWEST_LARGE], size[_FEWEST_SMALL : len(size) - _FEWEST_LARGE + 1]
    for column in range(size.shape[1]):
        above = upper[upper[:, column] > _GAP * lower[:, column], column]
        if above.size:
            step[column] = max(float(step[column]), float(above[-1]))
    return step
