"""Fisher information of candidate sequences: measurement model (Savage 2020, eqs. 3-5) for ideal rotations.

A sequence has ten measurements: the change of horizontal specific force along two directions, the down component in
both windows, and the mean angular rate in both windows. The unknowns are the 27 sensor errors, gravity and north.
Errors that belong to one sequence (white noise, deviation of the gyro bias from its mean, heading error of the start
attitude) enter the covariance of its ten measurements, so that the information of a test is the sum over its sequences.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.model import measurement_model as model
from srt.model.rotation_integrals import ideal_rotations
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.model.table1 import AXES
from srt.noise.bias_instability import CORRELATION_TIMES_S, adjoining_covariance
from srt.planning.candidates import down_axis, outer_axis
from srt.planning.conditions import GRAVITY, N_UNKNOWNS, NORTH, OWN_DRIFT
from srt.planning.fixture_kinematics import INNER
from srt.sensor_errors import N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from srt.model.rotation_integrals import RotationIntegrals
    from srt.planning.candidates import Candidate
    from srt.planning.conditions import Conditions
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.types import Array, Indices


COMPONENTS: Final = (
    "horizontal 1", "horizontal 2", "down at start", "down at end",
    *(f"rate {axis} at {end}" for end in ("start", "end") for axis in AXES),
)  # fmt: skip
N_ROWS: Final = len(COMPONENTS)
"""Measurements of one sequence."""
_SHORTEST_S: Final = 1e-6
"""Least length of the interval between the windows, s: the drift covariance divides by it."""
LEAST_DRIFT: Final = np.array([tau <= 10.0 for tau in CORRELATION_TIMES_S], dtype=np.float64)
"""Least share of each drift process that is noise of one sequence, for a bound: those with correlation times up to 10 s
are surely independent from sequence to sequence."""
_CACHED: Final = 512
"""Sequences whose covariances are computed at a time, so that they fit the cache."""
_H, _DOWN, _START_RATE, _END_RATE = slice(0, 2), slice(2, 4), slice(4, 7), slice(7, 10)


class Signatures:
    """Jacobians of the measurements of K sequences, and their covariances for given windows.

    Attributes
    ----------
    between_windows_s : ndarray, shape (K,)
        Time between the two windows, s.
    H : ndarray, shape (K, 10, N_UNKNOWNS)
        Jacobians of the ten measurements, SI.
    by_bias : ndarray, shape (K, 3, 10, 3)
        Derivatives with respect to the gyro bias in the start window, the rotation and the end window, s.
    by_force : ndarray, shape (K, 2, 10, 3)
        Derivatives with respect to the accelerometer bias in the start and in the end window.
    own_drift : ndarray
        Share of each drift process that counts as noise of one sequence.
    """

    def __init__(self, candidates: Sequence[Candidate], fixture: FixtureKinematics, conditions: Conditions) -> None:
        self.candidates, self.fixture, self.conditions = tuple(candidates), fixture, conditions
        self.own_drift = OWN_DRIFT
        K = len(self.candidates)
        rate, acceleration = (
            [np.array([getattr(fixture.axes[axis], key) for axis, _ in c.axis_rotations]) for c in self.candidates]
            for key in ("rate_rad_s", "acceleration_rad_s2")
        )
        turned = ideal_rotations(
            [c.catalogue_sequence() for c in self.candidates], rate, acceleration_rad_s2=acceleration
        )
        self.integrals = _with_wait(turned, fixture.settle_s)
        self.between_windows_s = np.array([c.between_windows_s(fixture) for c in self.candidates])
        starts = np.array([c.start_deg for c in self.candidates], dtype=int).reshape(K, 2)
        down, outer = down_axis(*starts.T), outer_axis(starts[:, INNER])
        base = np.stack([np.cross(outer, down), outer, down], axis=2)  # base to B_Strt
        g, C = conditions.gravity_m_s2, self.integrals.C_end
        self._up = np.stack([-down, -np.einsum("kab,ka->kb", C, down)], axis=1)
        f_start, f_end = g * self._up[:, 0], g * self._up[:, 1]
        # Horizontal directions: the two IMU axes that are horizontal at the start, in the order x, y, z.
        self.basis = np.eye(3)[np.nonzero(down == 0.0)[1].reshape(K, 2)]
        self._tilt = model.attitude_to_horizontal(self.basis, f_start)
        earth = base @ conditions.earth_rate_base()
        gyro, accel = gyro_triad(SensorErrors()), accel_triad(SensorErrors())
        H = np.zeros((K, N_ROWS, N_UNKNOWNS))
        H[:, _H, :N_PARAMETERS] = model.horizontal_jacobian(self.integrals, self.basis, f_start, f_end, accel)
        H[:, 2, :N_PARAMETERS] = model.down_jacobian(f_start, accel)
        H[:, 3, :N_PARAMETERS] = model.down_jacobian(f_end, accel)
        # Earth rate shows a gyro scale factor to 1e-3 at best: too little to plan with, so its effect is left out.
        H[:, _START_RATE, :N_PARAMETERS] = model.rate_error_jacobian(np.zeros((K, 3)), gyro)
        H[:, _END_RATE, :N_PARAMETERS] = model.rate_error_jacobian(np.zeros((K, 3)), gyro)
        H[:, _DOWN, GRAVITY] = 1.0
        # An error of north rotates the horizontal Earth rate about the vertical.
        self._by_north = self._rows_of_earth_rate(np.cross(down, earth))
        H[:, :, NORTH] = self._by_north
        self.H = H
        # Where z is vertical, so is the inner axis: the error of its angle is then a heading error.
        self._own_heading = conditions.rotation_sigma_rad * np.abs(down[:, 2])
        self.by_bias = np.zeros((K, 3, N_ROWS, 3))
        self.by_bias[:, 0, _START_RATE] = self.by_bias[:, 2, _END_RATE] = np.eye(3)
        self.by_bias[:, 1, _H] = self._tilt @ self.integrals.time
        self.by_force = np.zeros((K, 2, N_ROWS, 3))
        self.by_force[:, 0, _H], self.by_force[:, 1, _H] = -self.basis, self.basis @ C
        self.by_force[:, 0, 2], self.by_force[:, 1, 3] = -self._up[:, 0], -self._up[:, 1]

    def with_least_drift(self) -> Signatures:
        """Copy with the least drift per sequence, for a lower bound of sigma."""
        self._fixed  # noqa: B018 - computed once for both copies
        other = copy(self)
        other.own_drift = LEAST_DRIFT
        return other

    def __len__(self) -> int:
        return len(self.candidates)

    def _rows_of_earth_rate(self, delta: Array) -> Array:
        """Change of the measurements by an error of the Earth rate in B_Strt, shape (K, 10)."""
        out = np.zeros((len(delta), N_ROWS))
        phi = self.integrals.weight_s[:, None] * delta
        out[:, _H] = np.einsum("kia,ka->ki", self._tilt, phi)
        out[:, _START_RATE] = delta
        out[:, _END_RATE] = np.einsum("kab,ka->kb", self.integrals.C_end, delta)
        return out

    @cached_property
    def _fixed(self) -> dict[str, Array]:
        """Covariances that do not depend on the windows, and the constant factors of those that do."""
        c, K = self.conditions, len(self)
        assert self.integrals.noise is not None
        tilt_T = np.swapaxes(self._tilt, 1, 2)
        turning = np.zeros((K, N_ROWS, N_ROWS))
        turning[:, _H, _H] = self._tilt @ self.integrals.noise.sum(axis=3) @ tilt_T * c.gyro_white**2
        heading = self._own_heading[:, None] * self._by_north
        force = np.einsum("kiac,kjbc->kijab", self.by_force, self.by_force)
        return {
            "gyro_noise": turning,
            "earth_rate_alignment": heading[:, :, None] * heading[:, None, :],
            # Products of the derivatives for two of the intervals: start window, rotation, end window.
            "bias": np.einsum("kiac,kjbc->kijab", self.by_bias, self.by_bias).reshape(K, -1, N_ROWS**2),
            "force": force.reshape(K, -1, N_ROWS**2),
            "white_force": np.einsum("kwwab->kwab", force).reshape(K, -1, N_ROWS**2),
        }

    def covariances(
        self, start_s: ArrayLike, end_s: ArrayLike, which: Indices | slice | None = None, *, drift: bool = True
    ) -> dict[str, Array]:
        """Covariance of the ten measurements by source, shape (n, 10, 10) each; of drift, the share of one sequence.

        Parameters
        ----------
        start_s, end_s : array_like, shape (n,), or one for all
            Lengths of the windows, s.
        which : ndarray of int, shape (n,), or slice, optional
            Sequences; default: all.
        drift : bool
            False leaves the bias instabilities out.
        """
        c = self.conditions
        # A slice selects without a copy.
        k = slice(None) if which is None else which
        own = self.between_windows_s[k]
        n = len(own)
        T = np.stack([np.broadcast_to(np.asarray(t, dtype=np.float64), n) for t in (start_s, end_s)])
        gyro = self._fixed["gyro_noise"][k].copy()
        for rows, t in zip((_START_RATE, _END_RATE), T, strict=True):
            gyro[:, rows, rows] += (c.gyro_white**2 / t)[:, None, None] * np.eye(3)
        by_noise = np.stack([c.accel_white**2 / T, 2.0 * (c.accel_edge / T) ** 2]).transpose(2, 0, 1)
        accel = (by_noise @ self._fixed["white_force"][k]).reshape(n, 2, N_ROWS, N_ROWS)
        out = {
            "gyro_noise": gyro,
            "gyro_quantization": self._edges(k, T),
            "accel_noise": accel[:, 0],
            "accel_quantization": accel[:, 1],
            "earth_rate_alignment": self._fixed["earth_rate_alignment"][k],
        }
        if drift and (c.gyro_instability > 0.0 or c.accel_instability > 0.0):
            lengths = np.stack([T[0], np.maximum(own, _SHORTEST_S), T[1]], axis=1)
            of_biases = adjoining_covariance(lengths, self.own_drift)
            for sensor, floor, key, covariance in (
                ("gyro", c.gyro_instability, "bias", of_biases),
                ("accel", c.accel_instability, "force", of_biases[:, ::2, ::2]),
            ):
                # One product of a row and a matrix for each sequence: four times faster than a contraction.
                row = (floor**2 * covariance).reshape(n, 1, -1)
                out[f"{sensor}_bias_instability"] = (row @ self._fixed[key][k]).reshape(n, N_ROWS, N_ROWS)
        return out

    def _edges(self, k: Indices | slice, T: Array) -> Array:
        """Angle quantization error at the four window boundaries; the inner two also bound the rotation."""
        n = T.shape[1]
        if self.conditions.gyro_edge == 0.0:
            return np.zeros((n, N_ROWS, N_ROWS))
        edge = np.zeros((n, N_ROWS, 4, 3))
        for rows, first, t in zip((_START_RATE, _END_RATE), (0, 2), T, strict=True):
            edge[:, rows, first] = -np.eye(3) / t[:, None, None]
            edge[:, rows, first + 1] = np.eye(3) / t[:, None, None]
        edge[:, _H, 1] = -self._tilt[k]
        edge[:, _H, 2] = self._tilt[k] @ self.integrals.C_end[k]
        G = self.conditions.gyro_edge * edge.reshape(n, N_ROWS, -1)
        return np.asarray(G @ np.swapaxes(G, 1, 2))

    def whitened(
        self, start_s: ArrayLike, end_s: ArrayLike, which: Indices | None = None, *, out: Array | None = None
    ) -> Array:
        """Jacobians in units of the noise, ``L⁻¹ H`` with ``L Lᵀ`` the covariance, shape (n, 10, N_UNKNOWNS).

        ``out`` receives them if it is given.
        """
        n = len(self) if which is None else len(which)
        T = [np.broadcast_to(np.asarray(t, dtype=np.float64), n) for t in (start_s, end_s)]
        rows = np.empty((n, *self.H.shape[1:])) if out is None else out
        for first in range(0, n, _CACHED):
            part = slice(first, first + _CACHED)
            k = part if which is None else which[part]
            R = np.asarray(sum(self.covariances(T[0][part], T[1][part], k).values()))
            np.matmul(whitening(R), self.H[k], out=rows[part])
        return rows


def whitening(R: Array) -> Array:
    """Matrices ``L⁻¹`` with ``L Lᵀ`` the covariances R, shape (n, 10, 10)."""
    # Rates and specific forces differ by orders of magnitude: the covariance is equilibrated first.
    scale = 1.0 / np.sqrt(np.einsum("naa->na", R))
    # An inverse has ten right-hand sides, the Jacobian three times as many.
    return np.asarray(np.linalg.inv(np.linalg.cholesky(R * scale[:, :, None] * scale[:, None, :])) * scale[:, None, :])


def _with_wait(integrals: RotationIntegrals, wait_s: float) -> RotationIntegrals:
    """Integrals of rotations followed by a wait, in which gyro bias, Earth rate and noise are integrated as well."""
    assert integrals.noise is not None
    C = integrals.C_end
    return replace(
        integrals,
        time=integrals.time + wait_s * C,
        weight_s=integrals.weight_s + wait_s,
        noise=integrals.noise + wait_s * np.einsum("kab,kcb->kacb", C, C),
    )


def equilibrated_inverse(M: Array) -> Array:
    """Inverse of symmetric positive definite matrices, scaled to a unit diagonal first, shape (..., p, p)."""
    d = 1.0 / np.sqrt(np.einsum("...aa->...a", M))
    outer = d[..., :, None] * d[..., None, :]
    return np.asarray(np.linalg.inv(M * outer) * outer)


def target_variances(M: Array, targets: Indices, floor: Array) -> tuple[Array, Array]:
    """Variances of the targets from information of shape (..., p, p), and their columns of its inverse.

    Returns
    -------
    variances : ndarray, shape (..., q)
        With the part ``floor``, shape (q,), that no test reduces.
    columns : ndarray, shape (..., p, q)
    """
    inverse = equilibrated_inverse(M)
    return np.einsum("...aa->...a", inverse)[..., targets] + floor, inverse[..., targets]
