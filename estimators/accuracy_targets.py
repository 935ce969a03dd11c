"""Accuracy targets: comparison of standard deviations with requested ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation.iterations import PARAMETER_UNITS
from srt.ranking import significant
from srt.result.diagnostics import Targets
from srt.sensor_errors import INDEX

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.types import Array


RELIABLE_BELOW: Final = 0.05
"""Linearised standard deviations are reliable if all of them (accelerometer bias in g) are below this."""


def compare_with_targets(sigma: Array, targets: Mapping[str, float]) -> tuple[bool, bool, str | None]:
    """Compare standard deviations with targets.

    Parameters
    ----------
    sigma : ndarray, shape (27,), SI
    targets : mapping of str to float
        Requested standard deviation by parameter, SI.

    Returns
    -------
    reliable, met : bool
        True if linearised standard deviations are reliable; true if they also meet all targets.
    limiting : str or None
        Parameter with the largest ratio of sigma to target; None without targets.
    """
    reliable = bool(np.all(sigma / PARAMETER_UNITS < RELIABLE_BELOW))
    if not targets:
        return reliable, False, None
    ratio = {name: float(sigma[INDEX[name]]) / wanted for name, wanted in targets.items()}
    worst = max(ratio, key=lambda name: significant(ratio[name]))
    return reliable, reliable and ratio[worst] <= 1.0, worst


def targets_met(sequences: list[str], sigma: Array, targets: Mapping[str, float]) -> Targets:
    """First sequence after which all targets are met.

    Parameters
    ----------
    sequences : list of str
        Ids in the order of processing.
    sigma : ndarray, shape (number of sequences, 27), SI
        Standard deviations after each sequence.
    targets : mapping of str to float
        Requested standard deviation by parameter, SI.
    """
    met_after, limiting = None, None
    for name, row in zip(sequences, sigma, strict=True):
        _, met, limiting = compare_with_targets(row, targets)
        if met and met_after is None:
            met_after = name
    short = None if limiting is None else float(sigma[-1, INDEX[limiting]]) / targets[limiting]
    return Targets(wanted=targets, met_after=met_after, limiting=limiting, shortfall=short)
