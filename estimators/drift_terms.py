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
    DriftSearch,
    DriftTerm,
    Unmodelled,
    candidates,
    change,
    most_significant,
)
from srt.estimation.drift_search import gyro_courses, gyro_statistics
from srt.estimation.error_sources import accel_drift, by_drift
from srt.model.sensor_model import gyro_triad
from srt.noise.drift_forms import LINEAR, WALK, Statistics, variance_component
from srt.result.verdict import MISFIT_PROBABILITY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from estimators.block_solution import BlockSolution
    from estimators.joint_model import JointModel
    from estimators.solver import IterationState
    from srt.estimation.drift_model import Sensor
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
        """Drift of the raw channels of a sensor in all "windows" (W, 3) or "parts" of rotations (K, P, 3)."""
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


def search(joint: JointModel, iteration: IterationState, solution: BlockSolution, freedom: int) -> DriftSearch:
    """Search the residuals of a joint solution for bias drift that it does not model."""
    state, compensated, data = iteration.linearisation_point, iteration.compensated, joint.data
    assert state is not None
    assert compensated is not None
    keys = candidates(data, joint.drift.terms)
    # Rates at rest with their bias and with the drift that is modelled.
    slope = np.asarray(np.linalg.inv(gyro_triad(state.errors).matrix), dtype=np.float64)
    rest = joint.rest_rate(state, compensated) + joint.drift.raw("gyro", state.drift, "windows") @ slope.T

    def of_accel(courses: Array) -> Statistics:
        return _force_statistics(solution, by_drift(compensated.force_slope, courses), freedom)

    def of_gyro(courses: Mapping[str, Array]) -> dict[str, Statistics]:
        return gyro_statistics(data, slope, rest, joint.integrated, joint.drift.terms, courses)

    def by_window(sensor: Sensor) -> Statistics:
        if sensor == "gyro":
            return of_gyro({"each": np.eye(len(rest))})["each"]
        return _force_statistics(solution, np.eye(3 * len(rest)).reshape(len(rest), 3, -1), freedom)

    found: dict[tuple[Sensor, str], Statistics] = {
        (sensor, form): of_accel(data.drift_shapes[form].tested.windows) for sensor, form in keys if sensor == "accel"
    }
    found |= {("gyro", form): statistics for form, statistics in of_gyro(gyro_courses(data, keys)).items()}
    present = Unmodelled(joint.unmodelled_sigma.rotation, joint.unmodelled_sigma.force, joint.drift.terms)
    return most_significant(
        found, len(keys), present, {form: shape.windows for form, shape in data.drift_shapes.items()}, by_window
    )


def shows_instability(joint: JointModel, iteration: IterationState, solution: BlockSolution, freedom: int) -> bool:
    """True if the residuals show a bias instability of the accelerometers beyond that of the noise model.

    Three quarters of the residuals are those of gyros and rotations. The chi-square of all therefore does not show an
    instability that closed form and least squares notice.
    """
    assert iteration.compensated is not None
    effect = accel_drift(joint.data, iteration.compensated.force_slope, joint.data.noise.accel_limit)
    return variance_component(_force_statistics(solution, effect, freedom)).p_value < MISFIT_PROBABILITY


def _force_statistics(solution: BlockSolution, effect: Array, freedom: int) -> Statistics:
    """Statistics of coefficients with an ``effect`` on the specific forces of the windows, shape (W, 3, q)."""
    system, residual = solution.system, solution.residual
    rows = system.rows_of("force").index.ravel()
    white = (-system.whitening["force"] @ effect).reshape(len(rows), -1)
    by_columns = np.asarray(system.A[rows].T @ white)
    information = white.T @ white - by_columns.T @ solution.with_columns(by_columns)
    return Statistics(white.T @ residual[rows], information, float(residual @ residual), freedom)
