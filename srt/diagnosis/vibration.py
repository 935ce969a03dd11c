"""Vibration of the unit in the stationary windows: its frequency, its amplitude, and the bias due to asymmetry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG_PER_H, MICRO_G
from srt.diagnosis.findings import Fault
from srt.model.sensor_model import Triad

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array


_ASYMMETRY: Final = 1e-4
"""Scale-factor asymmetry for which the message states the bias: 100 ppm."""


def vibration(evidence: Evidence) -> Iterator[Finding]:
    """Report the strongest line in the spectrum of the windows."""
    data = evidence.data
    if data is None or data.vibration is None:
        return
    gyro, accel, bias = evidence.raw_triads
    none = np.zeros(3)
    # The mean of the stationary rates is the bias, because the Earth rate averages out over the poses.
    triads = Triad(gyro, none, data.windows.gyro_mean.mean(axis=0)), Triad(accel, none, bias)
    line = data.vibration
    rate, force = (line.amplitude(name, triad) for name, triad in zip(("gyro", "accel"), triads, strict=True))
    rectified = [float(_ASYMMETRY * values.max()) for values in data.rectified(*triads)]
    yield VIBRATION.found(
        frequency_hz=line.frequency_hz,
        angle_urad=1e6 * _typical(rate) / (2.0 * np.pi * line.frequency_hz),
        force_mg=_typical(force) / (1e3 * MICRO_G),
        gyro_deg_h=rectified[0] / DEG_PER_H,
        accel_ug=rectified[1] / MICRO_G,
    )


VIBRATION: Final = Fault(
    "vibration",
    "The unit vibrates in the stationary windows",
    "a spectral line at one frequency in more than half of the windows",
    "The unit vibrates at {frequency_hz:.4g} Hz in the stationary windows, with amplitudes of {angle_urad:.3g} µrad "
    "and {force_mg:.3g} mg. With a scale-factor asymmetry of 100 ppm, this causes biases of up to {gyro_deg_h:.2g} °/h"
    " and {accel_ug:.2g} µg. The calibration corrects these biases; isolate the table, or stop the source of the "
    "vibration.",
    "warning",
    vibration,
)


def _typical(amplitude: Array) -> float:
    """Median amplitude over the windows, along the direction of the vibration; the three channels are in phase."""
    return float(np.median(np.linalg.norm(amplitude, axis=1)))
