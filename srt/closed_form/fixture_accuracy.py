"""Accuracy of a fixture from its start attitudes: verticals of the accelerometers against the nominal ones.

The closed form uses the change of specific force within a sequence, in which errors of the fixture cancel. They are an
error of the Earth rate all the same, and of north, which no specific force shows. A fixture whose verticals differ by
more than it is stated to is less accurate about the vertical, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.closed_form.measurement_covariance import base_axes, fixture_axes
from srt.estimation.error_sources import LARGEST_FIXTURE_RAD, NO_ERRORS, UnmodelledErrors, alignment_sigma, start_sigma
from srt.estimation.goodness_of_fit import contradicting_group, faulty_group, is_misfit
from srt.estimation.white_residuals import PredictedGroups, WhiteResiduals
from srt.model.measurement_model import force_error_jacobian
from srt.model.rotations import cross_matrix
from srt.noise.variance_components import RestrictedLikelihood
from srt.result.verdict import MISFIT_PROBABILITY

if TYPE_CHECKING:
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

_ANGLES, _WOBBLE = slice(0, 2), slice(2, 3)
"""Inner and outer angle, and wobble, among the errors of a start."""
_GROSS: Final = 4.0
"""Largest tilt of a start in the largest sigma of a fixture: a larger one is another pose."""


class _Tilts(NamedTuple):
    """Tilts of the base against the measured verticals of K starts, rad, shapes (..., 2 K) and (..., 2 K, S).

    Attributes
    ----------
    z : ndarray
        Horizontal components of the verticals.
    mounting, wobble, angles, aligned : ndarray
        By mounting, axis wobble, start angles and alignment of 1 rad.
    R : ndarray, shape (..., 2 K, 2 K)
        Covariance of z by all that is stated.
    """

    z: Array
    mounting: Array
    wobble: Array
    angles: Array
    aligned: Array
    R: Array

    @classmethod
    def of(cls, data: PreparedRecording, m: SrtMeasurements, covariance: Array) -> _Tilts:
        """Tilts of one unit, or of several; parameters are those of :func:`fixture_excess`."""
        force, to_base = m.force[..., data.start, :], np.swapaxes(base_axes(m, data), -1, -2)
        gravity = np.linalg.norm(force, axis=-1, keepdims=True)
        up, units, rows = force / gravity, force.shape[:-2], 2 * data.K

        def tilt(vectors: Array) -> Array:
            """Horizontal components in the base of vectors in B_Strt, (..., K, 3, S), shape (..., 2 K, S)."""
            return np.asarray((to_base @ vectors)[..., :2, :].reshape(*units, rows, -1))

        def of_each(own: Array) -> Array:
            return tilt(own.reshape(*units, data.K, 3, -1))

        common, executed = (tilt_axes(axes, up) for axes in fixture_axes(m, data))
        own = executed[..., None, :] * np.eye(data.K)[:, None, :, None]
        wobble, angles, stated = (
            of_each(part) for part in (own[..., _WOBBLE], own[..., _ANGLES], own * start_sigma(data.recording))
        )
        aligned = tilt(common)
        # The mounting is free: U follows the rotation axes.
        mounting = tilt(tilt_axes(np.broadcast_to(np.eye(3), (*units, data.K, 3, 3)), up))
        white, flicker = (x[..., None, :] ** 2 for x in (data.noise.accel_white, data.noise.accel_flicker))
        white = white + data.windows.accel_excess[..., data.start, :]
        variance = white * data.windows.white_factor[data.start, None] + flicker
        by_noise = tilt(_apart(np.sqrt(variance) / gravity))
        by_errors = tilt(force_error_jacobian(force, m.accel) / gravity[..., None])
        R = _squared(stated) + alignment_sigma(data.recording) ** 2 * _squared(aligned) + _squared(by_noise)
        R += by_errors @ covariance @ np.swapaxes(by_errors, -1, -2)
        return cls(tilt(up[..., None])[..., 0], mounting, wobble, angles, aligned, R)


def verticals_disagree(data: PreparedRecording, measurements: SrtMeasurements, covariance: Array) -> Mask:
    """True for units whose verticals the stated accuracy of the fixture does not explain; parameters as there.

    All are True if the covariance of any unit is singular, as far outside the model.
    """
    tilts = _Tilts.of(data, measurements, covariance)
    try:
        white = WhiteResiduals.of(tilts.z, tilts.mounting, tilts.R)
    except np.linalg.LinAlgError:
        return np.ones(len(tilts.z), dtype=np.bool_)
    tests = zip(white.chi_square.tolist(), white.freedom.tolist(), strict=True)
    return np.array([is_misfit(*test) for test in tests], dtype=np.bool_)


def fixture_excess(data: PreparedRecording, measurements: SrtMeasurements, covariance: Array) -> UnmodelledErrors:
    """Errors of start angles, alignment and wobble beyond the stated accuracy of the fixture.

    Zero if the stated accuracy explains the verticals, if one sequence alone contradicts it, if no accuracy of the
    fixture explains them, or if the sequences are too few to tell the three errors apart.

    Parameters
    ----------
    data : PreparedRecording
    measurements : SrtMeasurements
        Those of the last iteration, which converged.
    covariance : ndarray, shape (27, 27)
        Covariance of the estimate.
    """
    z, mounting, wobble, angles, aligned, R = _Tilts.of(data, measurements, covariance)
    starts = np.arange(2 * data.K).reshape(-1, 2)

    def tests(R: Array) -> tuple[list[tuple[float, int]], float, int]:
        """Chi-square of every sequence against the others, that of all, and their degrees of freedom."""
        white = WhiteResiduals.of(z, mounting, R)
        found = PredictedGroups.of(white, R, starts)
        return list(zip(found.chi_square.tolist(), found.freedom.tolist(), strict=True)), *white.test

    found = tests(R)
    if not is_misfit(*found[1:]) or faulty_group(*found) is not None or np.abs(z).max() > _GROSS * LARGEST_FIXTURE_RAD:
        return NO_ERRORS
    roots = wobble, angles, aligned
    likelihood = RestrictedLikelihood(z, mounting, R, roots)
    if not likelihood.separable:
        return NO_ERRORS
    every, tested = np.ones(3, dtype=np.bool_), np.array([False, True, True])
    excess = likelihood.significant(every, tested, MISFIT_PROBABILITY)[1]
    found = tests(R + sum(v * _squared(L) for v, L in zip(excess, roots, strict=True)))
    if excess.max() > LARGEST_FIXTURE_RAD**2 or is_misfit(*found[1:]) or contradicting_group(*found) is not None:
        return NO_ERRORS
    return UnmodelledErrors(0.0, 0.0, 0.0, *np.sqrt(excess).tolist()).of_fixture


def tilt_axes(axes: Array, up: Array) -> Array:
    """Change of the vertical by small rotations about axes (..., K, 3, S), shape (..., K, 3, S)."""
    return np.asarray(-cross_matrix(up) @ axes)


def _apart(sigma: Array) -> Array:
    """Independent errors (..., K, 3) of the channels of every sequence, shape (..., K, 3, 3 K)."""
    K = sigma.shape[-2]
    apart = sigma[..., :, None, None] * (np.eye(K)[:, None, :, None] * np.eye(3)[:, None, :])
    return np.asarray(apart.reshape(*sigma.shape, 3 * K))


def _squared(root: Array) -> Array:
    return np.asarray(root @ np.swapaxes(root, -1, -2))
