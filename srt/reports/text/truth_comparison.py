"""Text of the comparison of a calibration with the truth of a simulated unit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.stats import norm

from srt.reports.tables import wrap
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from srt.result.calibration import Calibration
    from srt.sensor_errors import SensorErrors

PROBABILITY: Final = 0.95
"""Probability that the largest of the normalised errors stays below the bound that is stated."""


def largest_error_text(calibration: Calibration, truth: SensorErrors) -> str:
    """Sentences, wrapped, on the largest normalised error and the bound that chance explains.

    The bound x solves (2Φ(x) − 1)^n = 0.95. That is exact for n independent normal errors; for correlated ones the
    probability of staying below it is at least as large (Šidák's inequality).
    """
    seen = np.flatnonzero(calibration.observed)
    ratio = np.abs(calibration.errors.vector - truth.vector)[seen] / calibration.sigma[seen]
    n, worst = len(seen), int(np.argmax(ratio))
    bound = float(norm.ppf(0.5 + 0.5 * PROBABILITY ** (1.0 / n)))
    agrees = "agrees with the truth" if ratio[worst] <= bound else "does not agree with the truth at the 95 % level"
    return "\n".join(
        wrap(
            f"The largest error is {ratio[worst]:.2f} sigma ({NAMES[seen[worst]]}); the largest of {n} "
            f"normal draws stays below {bound:.2f} sigma in {PROBABILITY:.0%} of all runs or more, "
            f"so this run {agrees}."
        )
    )
