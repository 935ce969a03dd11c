"""Asymmetries that were estimated, their significance, and what the result would be without them.

With the estimates a of a group of asymmetries and the covariance P, chi-square aᵀ P_aa⁻¹ a tests that all are zero. If
they are, the other parameters are ``x − P_xa P_aa⁻¹ a`` with the covariance ``P_xx − P_xa P_aa⁻¹ P_ax``: the estimate
with a fixed at zero, without another iteration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtrc

from srt.result.diagnostics import AsymmetryTest, Estimate
from srt.sensor_errors import GROUP_SLICES, NAMES

if TYPE_CHECKING:
    from srt.sensor_errors import SensorErrors
    from srt.types import Array, Mask

_AFFECTED: Final = {"gyro_asymmetry": ("gyro_scale",), "accel_asymmetry": ("accel_bias", "accel_scale")}
"""Groups that are reported without the asymmetries: those that |ω| and |f| resemble."""


def asymmetry_choice(errors: SensorErrors, covariance: Array, observed: Mask) -> dict[str, AsymmetryTest]:
    """Test of each group of asymmetries, and the estimates without it, by group; none where none is estimated.

    Parameters
    ----------
    errors : SensorErrors
    covariance : ndarray, shape (27, 27), SI
    observed : ndarray of bool, shape (27,)
    """
    out = {}
    for group, affected in _AFFECTED.items():
        a = np.flatnonzero(observed & np.isin(np.arange(len(NAMES)), np.r_[GROUP_SLICES[group]]))
        x = np.concatenate([np.r_[GROUP_SLICES[name]] for name in affected])
        x = x[observed[x]]
        sigma = np.sqrt(np.diag(covariance))
        if not len(a) or not np.all(sigma[a] > 0.0):
            continue
        unit = sigma[np.concatenate([a, x])]
        C = covariance[np.ix_(np.r_[a, x], np.r_[a, x])] / np.outer(unit, unit)
        z, n = errors.vector[a] / sigma[a], len(a)
        gain = np.linalg.solve(C[:n, :n], C[:n, n:]).T
        statistic = float(z @ np.linalg.solve(C[:n, :n], z))
        value = errors.vector[x] - sigma[x] * (gain @ z)
        left = sigma[x] * np.sqrt(np.maximum(1.0 - np.einsum("xa,ax->x", gain, C[:n, n:]), 0.0))
        out[group] = AsymmetryTest(
            estimated=tuple(NAMES[i] for i in a),
            chi_square=statistic,
            degrees_of_freedom=n,
            probability=float(chdtrc(n, statistic)),
            without={
                NAMES[i]: Estimate(value=float(v), sigma=float(s)) for i, v, s in zip(x, value, left, strict=True)
            },
        )
    return out
