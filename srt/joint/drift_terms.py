"""Biases that vary within a recording as unknowns of the joint model: forms of drift, and gyro g-sensitivity.

The effects on forces, rates and rotations are linear in the coefficients. Rotations are integrated with the mean drift
of each, because a drift of hundreds of degrees per hour is not linear in the attitude, and without Γ f in every sample
(:mod:`srt.estimation.g_sensitivity`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation.drift_model import (
    DriftEstimate,
    DriftTerm,
    change,
)
from srt.estimation.error_sources import by_drift
from srt.noise.drift_forms import LINEAR, WALK

if TYPE_CHECKING:
    from srt.estimation.error_sources import Slopes
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices


_WIDE_G_SENSITIVITY: Final = 1e-2
"""Prior sigma of an element of Γ, rad/s per m/s²: 6 °/s/g, tens of times that of the worst consumer gyros."""


class DriftTerms:
    """Selected forms of drift, each with three coefficients for every function of the form, after those of Γ.

    Parameters
    ----------
    data : PreparedRecording
    terms : tuple of DriftTerm
    force_axes : ndarray, shape (n, 3), optional
        Unit vectors in B along which gyro g-sensitivity is estimated, three coefficients for each; default none.
    """

    def __init__(
        self, data: PreparedRecording, terms: tuple[DriftTerm, ...] = (), force_axes: Array | None = None
    ) -> None:
        self.data, self.terms, self.force_axes = data, terms, force_axes
        first = 0 if force_axes is None else 3 * len(force_axes)
        self.of_force = slice(0, first)
        """Coefficients of the g-sensitivity."""
        sizes = [3 * data.drift_shapes[term.form].windows.shape[1] for term in terms]
        stops = (first + np.cumsum(sizes, dtype=np.intp)).tolist()
        self.slices = [slice(stop - size, stop) for stop, size in zip(stops, sizes, strict=True)]
        self.size = first + sum(sizes)
        """Number of coefficients."""

    @property
    def sigma(self) -> Array:
        """Prior standard deviations of all coefficients."""
        of_drift = np.repeat([term.sigma for term in self.terms], [s.stop - s.start for s in self.slices])
        return np.concatenate([np.full(self.of_force.stop, _WIDE_G_SENSITIVITY), of_drift])

    def of_forms(self, coefficients: Array) -> Array:
        """Coefficients of the forms of drift, with zeros in place of those of Γ."""
        out = coefficients.copy()
        out[self.of_force] = 0.0
        return out

    @property
    def freely_estimated(self) -> int:
        """Number of coefficients with a wide prior, which is no measurement; that of a random walk is one."""
        of_drift = sum(s.stop - s.start for t, s in zip(self.terms, self.slices, strict=True) if t.form != WALK)
        return int(self.of_force.stop + of_drift)

    @property
    def g_sensitivity_map(self) -> Array:
        """Elements of Γ by rows (gyros before compensation, axes of B) from its coefficients, shape (9, 3 n)."""
        assert self.force_axes is not None
        return np.asarray(np.einsum("bd,nc->bcnd", np.eye(3), self.force_axes).reshape(9, -1))

    def g_sensitivity(self, coefficients: Array) -> Array:
        """Γ, shape (3, 3), rad/s per m/s²; zero where it is not estimated."""
        if self.force_axes is None:
            return np.zeros((3, 3))
        return np.asarray((self.g_sensitivity_map @ coefficients[self.of_force]).reshape(3, 3))

    def of(self, sensor: str) -> list[tuple[DriftTerm, slice]]:
        """Terms of a sensor, with their coefficients."""
        return [(t, s) for t, s in zip(self.terms, self.slices, strict=True) if t.sensor == sensor]

    def raw(self, sensor: str, coefficients: Array, of: str) -> Array:
        """Drift of the raw channels in "windows" (W, 3), their "halves" (W, 2, 3) or "parts" of rotations (K, P, 3)."""
        shapes = self.data.drift_shapes
        shape = (*getattr(shapes[LINEAR], of).shape[:-1], 3)
        parts = [getattr(shapes[t.form], of) @ coefficients[s].reshape(-1, 3) for t, s in self.of(sensor)]
        return np.asarray(sum(parts, np.zeros(shape)))

    def jacobian(self, sensor: str, of: str, slope: Array, members: Indices | slice = slice(None)) -> Array:
        """Effect of all coefficients on windows (n, d, size) or, by parts (n, P, d, 3), on rotations; default: all."""
        out = np.zeros((len(slope), slope.shape[-2], self.size))
        for term, at in self.of(sensor):
            shape = getattr(self.data.drift_shapes[term.form], of)[members]
            out[:, :, at] = by_drift(slope, shape)
        return out

    def add_g_sensitivity(
        self, effect: dict[str, Array], by: Slopes, force: Array, stated: tuple[Array, Array]
    ) -> None:
        """Add the effect of Γ to that of the drift on the "rate" of windows with this specific force, and on rotations.

        ``stated`` are the derivatives of stated rates by the raw channels, and their specific forces, (R, 2, 3).
        """
        if self.force_axes is None:
            return
        assert by.integrals.velocity is not None
        effect["rate"][:, :, self.of_force] = by_drift(by.rate, force @ self.force_axes.T)
        turn = np.einsum("kabc,nc->kanb", by.integrals.velocity, self.force_axes)
        effect["turn"][:, :, self.of_force] = turn.reshape(len(turn), 3, -1)
        by_raw, along = stated[0], stated[1] @ self.force_axes.T
        effect["stated_rate"][:, :, self.of_force] = np.einsum("rhb,rhn->rhnb", by_raw, along).reshape(
            *by_raw.shape[:2], self.of_force.stop
        )

    def estimates(self, coefficients: Array) -> tuple[DriftEstimate, ...]:
        """Drift of every term over the recording."""
        return tuple(
            DriftEstimate(
                t.sensor,
                t.form,
                change(t.form, coefficients[s].reshape(-1, 3), self.data.drift_shapes[t.form].windows),
                modelled=True,
            )
            for t, s in zip(self.terms, self.slices, strict=True)
        )
