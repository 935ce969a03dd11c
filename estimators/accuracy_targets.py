"""Accuracy targets: whether sigmas meet them, and from which sequence on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import STANDARD_GRAVITY_M_S2
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.types import Array


PROMISE_BELOW: Final = 0.05
"""Sigma of every parameter (accelerometer bias in g) below which the linearised sigmas are to be believed."""
PARAMETER_UNITS: Final = np.ones(N_PARAMETERS)
"""What parameters are measured in where they are compared with each other: accelerometer bias in g, all else SI."""
PARAMETER_UNITS[GROUP_SLICES["accel_bias"]] = STANDARD_GRAVITY_M_S2


def judge_targets(sigma: Array, targets: Mapping[str, float]) -> tuple[bool, bool, str | None]:
    """Whether sigmas are small enough to be believed, whether they meet the targets, and which is farthest from it.

    Parameters
    ----------
    sigma : ndarray, shape (27,), SI
    targets : mapping of str to float
        Sigma wanted by parameter, SI.
    """
    promised = bool(np.all(sigma / PARAMETER_UNITS < PROMISE_BELOW))
    if not targets:
        return promised, False, None
    ratio = {name: float(sigma[INDEX[name]]) / wanted for name, wanted in targets.items()}
    worst = max(ratio, key=lambda name: ratio[name])
    return promised, promised and ratio[worst] <= 1.0, worst


def targets_met(sequences: list[str], sigma: Array, targets: Mapping[str, float]) -> dict[str, Any]:
    """From which sequence on all targets are met.

    Parameters
    ----------
    sequences : list of str
        In the order of processing.
    sigma : ndarray, shape (number of sequences, 27), SI
        After each.
    targets : mapping of str to float
        Sigma wanted by parameter, SI.

    Returns
    -------
    dict
        ``met_after``: id of the first sequence after which all are met and promised, None if never; ``limiting``: the
        parameter farthest from its target at the end, and ``shortfall``: its sigma over the target.
    """
    met_after, limiting = None, None
    for name, row in zip(sequences, sigma, strict=True):
        _, met, limiting = judge_targets(row, targets)
        if met and met_after is None:
            met_after = name
    short = None if limiting is None else float(sigma[-1, INDEX[limiting]]) / targets[limiting]
    return {"wanted": dict(targets), "met_after": met_after, "limiting": limiting, "shortfall": short}
