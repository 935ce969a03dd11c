"""Observability: selection of the parameters that a recording determines, against a weak prior."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model.prior import Prior
from srt.sensor_errors import GROUP_SLICES, GROUPS, N_PARAMETERS, MatrixElements, by_parameter

if TYPE_CHECKING:
    from srt.types import Array, Mask


# Order of admission: a parameter that is collinear with earlier ones is fixed.
_ADMISSION: Final = [
    i
    for group in sorted(GROUPS, key=lambda g: (g.omissible, g.further, g.omissible and g.sensor, g.name != "gyro_bias"))
    for i in range(N_PARAMETERS)[GROUP_SLICES[group.name]]
]

_SHARE: Final = 1.0 / 3.0
"""Share of the prior sigma below which the sigma of an observed parameter lies."""
_LARGEST_ANGLE: Final = 0.03
"""Largest sigma of an observed misalignment, rad: the covariance is linear, and squares of larger ones exceed 1e-3."""
_MATRICES: Final = np.flatnonzero([isinstance(g.effect, MatrixElements) for g in GROUPS for _ in g.suffixes])
"""Parameters of the sensor matrices."""


def admission_sigma() -> Array:
    """Prior 1-sigma that decides on observability."""
    return by_parameter("widest_sigma")


def observed_limit(admission: Array | None = None, finest: float = math.inf) -> Array:
    """Largest sigma of an observed parameter, shape (27,), if the prior has the sigma ``admission``.

    The covariance is linear. The cosine of a misalignment changes a scale factor by half its square, which must not
    exceed ``finest``, the smallest sigma of a combination of elements of the sensor matrices.
    """
    limit = _SHARE * (admission_sigma() if admission is None else admission)
    largest_angle = min(_LARGEST_ANGLE, math.sqrt(2.0 * finest))
    for group in ("gyro_orthogonality", "accel_misalignment"):
        limit[GROUP_SLICES[group]] = np.minimum(limit[GROUP_SLICES[group]], largest_angle)
    return limit


def finest_sigma(covariance: Array) -> float:
    """Smallest sigma of a combination of elements of the sensor matrices; infinite if none is estimated."""
    variance = np.diag(covariance)
    at = _MATRICES[variance[_MATRICES] > 0.0]
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance[np.ix_(at, at)])[0]), 0.0)) if at.size else math.inf


def default_prior() -> Prior:
    """Wide prior with negligible information: 1-sigma of a third of full scale, 1 % asymmetry."""
    return Prior.from_sigma(admission_sigma())


def admit(A: Array, wanted: Mask) -> Mask:
    """Mask of the parameters that whitened data determine, admitted one by one.

    Parameters
    ----------
    A : ndarray, shape (n, 27)
        Whitened Jacobian in units of the prior sigma.
    wanted : ndarray of bool, shape (27,)
        Parameters that may be admitted.

    Returns
    -------
    ndarray of bool, shape (27,)
        A parameter is admitted if its sigma, estimated jointly with those admitted before, is below observed_limit.
    """
    admitted = np.zeros(N_PARAMETERS, dtype=np.bool_)
    basis: list[Array] = []
    least = admission_sigma() / observed_limit()
    for j in _ADMISSION:
        if not wanted[j]:
            continue
        column = A[:, j].copy()
        for _ in range(2):  # twice is enough (Parlett): after one pass, nearly parallel columns have rounding errors
            for q in basis:
                column -= (q @ column) * q
        norm = float(np.linalg.norm(column))
        if norm > least[j]:
            admitted[j] = True
            basis.append(column / norm)
    return admitted
