"""Check of a correction at rest: it must bring specific force nearer to gravity, and the rate nearer to the Earth's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG_PER_H, EARTH_RATE_RAD_S
from srt.diagnosis.false_alarms import limit
from srt.exceptions import DataError
from srt.result.applier import Applier
from srt.sequences.rest_detection import longest_rest
from srt.sequences.stationary_windows import find_windows
from srt.sequences.window_means import average_windows

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.types import Array, Indices

_CHANGE: Final = 0.2
"""Worsening that is accepted, relative to the size of the correction: a unit's errors change with time.

By simulation of units with normal errors, 20,000 for each case, in 1 to 17 attitudes: the calibration of another unit
with errors of the same size is refused in 85 of 100 cases; that of the unit itself in at most 1 of 100 if its errors
have changed by a tenth, and in 2 to 10 of 100 if by three tenths.
"""


@dataclass(frozen=True, slots=True)
class CorrectedRest:
    """Medians over the stationary windows, before and after a correction.

    Attributes
    ----------
    windows : int
    force : (float, float)
        Difference of specific force from gravity, m/s².
    rate : (float, float)
        Difference of the rate from that of the Earth, °/h.
    largest : (float, float)
        Worsening of either that is accepted, in the same units.
    """

    windows: int
    force: tuple[float, float]
    rate: tuple[float, float]
    largest: tuple[float, float]

    @property
    def worse(self) -> bool:
        """True if the correction makes specific force or rate clearly worse."""
        pairs = zip((self.force, self.rate), self.largest, strict=True)
        return any(after - before > most for (before, after), most in pairs)

    def __str__(self) -> str:
        return (
            f"median differences at rest, before and after (windows: {self.windows}): specific force from gravity "
            f"{self.force[0]:.3g} and {self.force[1]:.3g} m/s², rate from the Earth's {self.rate[0]:.3g} and "
            f"{self.rate[1]:.3g} °/h"
        )


def corrected_rest(calibration: Calibration, recording: Recording) -> CorrectedRest | None:
    """Compare the stationary windows of a recording before and after a correction; None without such a window.

    The worsening that is accepted is that by the uncertainty of the calibration, the noise of the windows and that of
    gravity (twice, as it may make one look better and the other worse), and a part of the size of the correction.
    """
    samples = _windows(recording)
    if samples is None:
        return None
    applier, site = Applier(calibration), recording.site
    windows = average_windows([recording], [samples], "linear")[0]
    raw = windows.gyro_mean, windows.accel_mean
    covariance = applier.sample_covariance(*raw)
    faces = site.gravity_m_s2 * np.vstack([np.eye(3), -np.eye(3)])
    # Readings of a perfect unit show the size of the correction.
    size = applier.apply(np.zeros((6, 3)), faces)
    after = applier.apply(*raw)
    rows = (
        (slice(0, 3), 0.0, EARTH_RATE_RAD_S, DEG_PER_H, windows.gyro_halves, 0.0),
        (slice(3, 6), site.gravity_m_s2, site.gravity_m_s2, 1.0, windows.accel_halves, 2.0 * site.gravity_sigma_m_s2),
    )
    found, largest = [], []
    for k, (part, ideal, true, unit, halves, sigma) in enumerate(rows):
        before, left = (float(np.median(np.abs(_norm(values) - true))) / unit for values in (raw[k], after[k]))
        along = after[k] / np.maximum(_norm(after[k]), 1e-300)[:, None]
        variance = np.einsum("wi,wij,wj->w", along, covariance[:, part, part], along)
        variance += np.sum((halves[:, 0] - halves[:, 1]) ** 2, axis=1) / 4.0
        correction = float(np.sqrt(np.mean((_norm(size[k]) - ideal) ** 2)))
        chance = float(limit("normal") * np.sqrt(np.median(variance) + sigma**2))
        found.append((before, left))
        largest.append((chance + _CHANGE * correction) / unit)
    return CorrectedRest(len(samples), found[1], found[0], (largest[1], largest[0]))


def _windows(recording: Recording) -> Indices | None:
    try:
        return find_windows(recording)
    except DataError:  # fewer than two
        rest = longest_rest(recording)
        return None if rest is None else np.array([rest], dtype=np.intp)


def _norm(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1))
