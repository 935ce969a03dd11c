"""Diagnostics with a given gyro g-sensitivity, for calibrations that are made by hand."""

import numpy as np

from srt.result.diagnostics import Diagnostics, GSensitivity, RestRateScatter


def with_g_sensitivity(matrix):
    zero = np.zeros((3, 3))
    scatter = RestRateScatter(before=zero[0], after=zero[0], expected=zero[0])
    return Diagnostics(
        g_sensitivity=GSensitivity(
            matrix=np.asarray(matrix),
            sigma=zero,
            matrix_deg_per_h_per_g=zero,
            sigma_deg_per_h_per_g=zero,
            not_seen_along=zero[:0],
            rest_rate_scatter_rad_s=scatter,
        )
    )
