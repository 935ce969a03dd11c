"""Uncertainty of fixed parameters, which enters the covariance of the estimated ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.constants import EARTH_RATE_RAD_S
from srt.model.prior import PRIOR_SIGMA, prior_sigma
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


def fixed_sigma(data: PreparedRecording, options: Options) -> Array:
    """1-sigma of every parameter's initial value, for the case that it is fixed, shape (27,), SI.

    Values given by the user, and asymmetries fixed on request, count as exact. An initial estimate from the fixture is
    as accurate as the fixture (its accelerometer bias also absorbs the neglected asymmetry). Otherwise the prior sigma
    applies.
    """
    if isinstance(options.start, SensorErrors):
        return np.zeros(N_PARAMETERS)
    sigma = prior_sigma()
    fixture = data.recording.fixture
    if options.start == "auto" and fixture is not None and data.nominal is not None:
        accuracy = float(np.hypot(fixture.alignment_sigma_rad, fixture.rotation_sigma_rad))
        for group in ("gyro_scale", "gyro_orthogonality", "accel_scale", "accel_misalignment"):
            sigma[GROUP_SLICES[group]] = accuracy
        sigma[GROUP_SLICES["accel_bias"]] = data.gravity * float(np.hypot(accuracy, PRIOR_SIGMA["accel_asymmetry"]))
        sigma[GROUP_SLICES["gyro_bias"]] = EARTH_RATE_RAD_S
    exact = [INDEX[name] for name in options.fixed_names if "asymmetry" in name]
    sigma[exact] = 0.0
    return sigma


def reason_on_request(name: str, sigma: Array) -> str:
    """Reason text of a parameter that the user fixed."""
    return "fixed on request" + (", taken as exact" if sigma[INDEX[name]] == 0.0 else "")
