"""What sequences tell about the sensor errors: the shared measurement model for rotations that are yet to be made.

Measurements of a sequence, ten numbers: the change of horizontal specific force along two directions, the down part of
both windows, and the rate at rest in both windows. Unknowns: the 27 sensor errors, and what the whole test has in
common, gravity and north. What a sequence has of its own (noise, its gyro bias about the test's, the heading that its
start attitude is off by) is noise of its ten numbers, so that the information of a test is the sum over its sequences.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import EARTH_RATE_RAD_S, STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError
from srt.model import measurement_model as model
from srt.model.rotation_integrals import ideal_rotations
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.model.table1 import AXES
from srt.noise.bias_instability import CORRELATION_TIMES_S, adjoining_covariance, common_variance, shares_within
from srt.planning.candidates import down_axis, outer_axis
from srt.planning.stand import INNER
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from srt.model.rotation_integrals import RotationIntegrals
    from srt.planning.candidates import Candidate
    from srt.planning.stand import Stand
    from srt.types import Array, Indices


GRAVITY: Final = N_PARAMETERS
NORTH: Final = N_PARAMETERS + 1
N_UNKNOWNS: Final = N_PARAMETERS + 2
COMPONENTS: Final = (
    "horizontal 1", "horizontal 2", "down at start", "down at end",
    *(f"rate {axis} at {end}" for end in ("start", "end") for axis in AXES),
)  # fmt: skip
N_ROWS: Final = len(COMPONENTS)
OWN_DRIFT: Final = shares_within(60.0)
"""Share of every process of the drift that counts as a sequence's own while sequences are chosen; the rest counts as
the bias of the test. Neighbouring sequences are less than this time apart, sequences that go together may be more."""
LEAST_DRIFT: Final = np.array([tau <= 10.0 for tau in CORRELATION_TIMES_S], dtype=np.float64)
"""Likewise where a bound is wanted: only what is surely new in every sequence."""
_H, _DOWN, _START_RATE, _END_RATE = slice(0, 2), slice(2, 4), slice(4, 7), slice(7, 10)
SOURCES: Final = (
    "gyro_noise",
    "gyro_quantization",
    "gyro_bias_instability",
    "accel_noise",
    "accel_quantization",
    "accel_bias_instability",
    "earth_rate_alignment",
    "gravity",
)


@dataclass(frozen=True, slots=True)
class Conditions:
    """Unit, site and fixture as far as they limit the accuracy; SI, one sigma, the same for all axes.

    Attributes
    ----------
    gyro_white, accel_white : float
        Random walk of the integral, rad/√s and m/s²·√s.
    gyro_edge, accel_edge : float
        Error of one reading of the integral, rad and m/s.
    gyro_instability, accel_instability : float
        Floor of the Allan deviation of the bias, rad/s and m/s².
    test_s : float
        About how long the test will be, s: for the drift within it.
    latitude_rad, heading_rad : float
        Of the site; of the table x axis, clockwise from north.
    gravity_m_s2, gravity_sigma_m_s2 : float
    alignment_sigma_rad, rotation_sigma_rad : float
        Error of north for the whole test, and of the inner angle at the start of every sequence.

    Raises
    ------
    InputError
        A figure that is negative or not finite, or gyros or accelerometers without any noise.
    """

    gyro_white: float
    accel_white: float
    gyro_edge: float = 0.0
    accel_edge: float = 0.0
    gyro_instability: float = 0.0
    accel_instability: float = 0.0
    latitude_rad: float = math.pi / 4.0
    heading_rad: float = 0.0
    test_s: float = 900.0
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2
    gravity_sigma_m_s2: float = 5e-6
    alignment_sigma_rad: float = 1e-3
    rotation_sigma_rad: float = 1e-3

    def __post_init__(self) -> None:
        signed = {"latitude_rad", "heading_rad"}
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not math.isfinite(value) or (value < 0.0 and name not in signed):
                raise InputError(f"{name} of the plan's conditions is {value!r}: give a number not below zero.")
        for sensor in ("gyro", "accel"):
            if getattr(self, f"{sensor}_white") == 0.0 == getattr(self, f"{sensor}_edge"):
                raise InputError(
                    f"The {sensor} noise of the unit is zero: without noise every test is perfect, and none can be "
                    "planned; state the unit's noise."
                )

    def earth_rate_base(self) -> Array:
        """The Earth's rate in components of the fixture's base, shape (3,), rad/s."""
        north = EARTH_RATE_RAD_S * math.cos(self.latitude_rad)
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return np.array([north * c, -north * s, -EARTH_RATE_RAD_S * math.sin(self.latitude_rad)])

    def drift_variance(self) -> Array:
        """Variance of each parameter that no test takes away, shape (27,): the bias of a test is not the unit's."""
        out = np.zeros(N_PARAMETERS)
        common = common_variance(1.0 - OWN_DRIFT, self.test_s)
        for sensor, floor in (("gyro", self.gyro_instability), ("accel", self.accel_instability)):
            out[GROUP_SLICES[f"{sensor}_bias"]] = floor**2 * common
        return out

    def prior(self) -> Array:
        """Information on the unknowns before the test, shape (N_UNKNOWNS,): none on the sensor errors."""
        out = np.zeros(N_UNKNOWNS)
        least = 1e-12  # what is stated to be exact is nearly so
        out[GRAVITY] = 1.0 / max(self.gravity_sigma_m_s2, least) ** 2
        out[NORTH] = 1.0 / max(self.alignment_sigma_rad, least) ** 2
        return out


class Signatures:
    """What K sequences show: the Jacobians of their measurements, and their noise for any windows.

    Parameters
    ----------
    candidates : sequence of Candidate
    stand : Stand
    conditions : Conditions

    Attributes
    ----------
    integrals : RotationIntegrals
    own_s : ndarray, shape (K,)
        Time between the windows.
    H : ndarray, shape (K, 10, N_UNKNOWNS)
        Jacobians, SI.
    by_bias : ndarray, shape (K, 3, 10, 3)
        What a gyro bias in the start window, the turn and the end window does, s.
    by_force : ndarray, shape (K, 2, 10, 3)
        What an accelerometer bias in the start and the end window does.
    own_drift : ndarray
        Share of every process of the drift that is a sequence's own.
    """

    def __init__(self, candidates: Sequence[Candidate], stand: Stand, conditions: Conditions) -> None:
        self.candidates, self.stand, self.conditions = tuple(candidates), stand, conditions
        self.own_drift = OWN_DRIFT
        K = len(self.candidates)
        speeds = [
            np.array([math.radians(abs(turn)) / stand.axes[axis].turn_s(turn) for axis, turn in c.legs])
            for c in self.candidates
        ]
        turned = ideal_rotations([c.catalogue_sequence() for c in self.candidates], speeds)
        self.integrals = _with_wait(turned, stand.settle_s)
        self.own_s = np.array([c.own_s(stand) for c in self.candidates])
        starts = np.array([c.start_deg for c in self.candidates], dtype=int).reshape(K, 2)
        down = np.array([down_axis(i, o) for i, o in starts.tolist()], dtype=np.float64).reshape(K, 3)
        outer = np.array([outer_axis(i) for i in starts[:, INNER].tolist()], dtype=np.float64).reshape(K, 3)
        base = np.stack([np.cross(outer, down), outer, down], axis=2)  # base to B_Strt
        g, C = conditions.gravity_m_s2, self.integrals.C_end
        self._up = np.stack([-down, -np.einsum("kab,ka->kb", C, down)], axis=1)
        f_start, f_end = g * self._up[:, 0], g * self._up[:, 1]
        # The two IMU axes that are horizontal at the start, in their order.
        rows = [[i for i in range(3) if d[i] == 0.0] for d in down]
        self.basis = np.eye(3)[rows] if K else np.zeros((0, 2, 3))
        self._tilt = model.attitude_to_horizontal(self.basis, f_start)
        earth = base @ conditions.earth_rate_base()
        gyro, accel = gyro_triad(SensorErrors()), accel_triad(SensorErrors())
        H = np.zeros((K, N_ROWS, N_UNKNOWNS))
        H[:, _H, :N_PARAMETERS] = model.horizontal_jacobian(self.integrals, self.basis, f_start, f_end, accel)
        H[:, 2, :N_PARAMETERS] = model.down_jacobian(f_start, accel)
        H[:, 3, :N_PARAMETERS] = model.down_jacobian(f_end, accel)
        # The Earth's rate shows a scale factor to parts in a thousand at best: nothing to plan with.
        H[:, _START_RATE, :N_PARAMETERS] = model.rate_error_jacobian(np.zeros((K, 3)), gyro)
        H[:, _END_RATE, :N_PARAMETERS] = model.rate_error_jacobian(np.zeros((K, 3)), gyro)
        H[:, _DOWN, GRAVITY] = 1.0
        # A turn about the vertical moves the horizontal part of the Earth's rate.
        self._by_north = self._rows_of_earth_rate(np.cross(down, earth))
        H[:, :, NORTH] = self._by_north
        self.H = H
        # The inner axis stands vertical where z does: then the error of its angle is one of heading.
        self._own_heading = conditions.rotation_sigma_rad * np.abs(down[:, 2])
        self.by_bias = np.zeros((K, 3, N_ROWS, 3))
        self.by_bias[:, 0, _START_RATE] = self.by_bias[:, 2, _END_RATE] = np.eye(3)
        self.by_bias[:, 1, _H] = self._tilt @ self.integrals.time
        self.by_force = np.zeros((K, 2, N_ROWS, 3))
        self.by_force[:, 0, _H], self.by_force[:, 1, _H] = -self.basis, self.basis @ C
        self.by_force[:, 0, 2], self.by_force[:, 1, 3] = -self._up[:, 0], -self._up[:, 1]

    def with_least_drift(self) -> Signatures:
        """The same with as little drift as there surely is: no sequence can be better than so."""
        self._fixed  # noqa: B018 - computed once, for both
        other = copy(self)
        other.own_drift = LEAST_DRIFT
        return other

    def __len__(self) -> int:
        return len(self.candidates)

    def _rows_of_earth_rate(self, delta: Array) -> Array:
        """What an error of the Earth's rate in B_Strt does to the measurements, shape (K, 10)."""
        out = np.zeros((len(delta), N_ROWS))
        phi = self.integrals.weight_s[:, None] * delta
        out[:, _H] = np.einsum("kia,ka->ki", self._tilt, phi)
        out[:, _START_RATE] = delta
        out[:, _END_RATE] = np.einsum("kab,ka->kb", self.integrals.C_end, delta)
        return out

    @cached_property
    def _fixed(self) -> dict[str, Array]:
        """Covariances that do not depend on the windows, and the factors of those that do."""
        c, K = self.conditions, len(self)
        assert self.integrals.noise is not None
        tilt_T = np.swapaxes(self._tilt, 1, 2)
        turning = np.zeros((K, N_ROWS, N_ROWS))
        turning[:, _H, _H] = self._tilt @ self.integrals.noise.sum(axis=3) @ tilt_T * c.gyro_white**2
        heading = self._own_heading[:, None] * self._by_north
        return {
            "gyro_noise": turning,
            "earth_rate_alignment": heading[:, :, None] * heading[:, None, :],
            # Products of what the draws of two stretches of time do: start window, turn, end window.
            "bias": np.einsum("kiac,kjbc->kijab", self.by_bias, self.by_bias),
            "force": np.einsum("kiac,kjbc->kijab", self.by_force, self.by_force),
        }

    def covariances(self, start_s: ArrayLike, end_s: ArrayLike, which: Indices | None = None) -> dict[str, Array]:
        """Covariance of the ten measurements by source, shape (n, 10, 10) each; of drift, what is the sequence's own.

        Parameters
        ----------
        start_s, end_s : array_like, shape (n,), or one for all
            Lengths of the windows, s.
        which : ndarray of int, shape (n,), optional
            Sequences meant; default all.
        """
        c = self.conditions
        k = np.arange(len(self)) if which is None else np.asarray(which)
        T = np.stack([np.broadcast_to(np.asarray(t, dtype=np.float64), k.shape) for t in (start_s, end_s)])
        gyro = self._fixed["gyro_noise"][k]
        for rows, t in zip((_START_RATE, _END_RATE), T, strict=True):
            gyro[:, rows, rows] += (c.gyro_white**2 / t)[:, None, None] * np.eye(3)
        force, own = self._fixed["force"][k], self.own_s[k]
        lengths = np.stack([T[0], np.maximum(own, 1e-6), T[1]], axis=1)
        drifts = c.gyro_instability > 0.0 or c.accel_instability > 0.0
        drift = adjoining_covariance(lengths, self.own_drift) if drifts else np.zeros((len(k), 3, 3))
        white = np.einsum("nwwab->nwab", force)
        return {
            "gyro_noise": gyro,
            "gyro_quantization": self._edges(k, T),
            "gyro_bias_instability": c.gyro_instability**2 * np.einsum("nij,nijab->nab", drift, self._fixed["bias"][k]),
            "accel_noise": np.einsum("wn,nwab->nab", c.accel_white**2 / T, white),
            "accel_quantization": np.einsum("wn,nwab->nab", 2.0 * (c.accel_edge / T) ** 2, white),
            "accel_bias_instability": c.accel_instability**2
            * np.einsum("nij,nijab->nab", drift[:, [0, 2]][:, :, [0, 2]], force),
            "earth_rate_alignment": self._fixed["earth_rate_alignment"][k],
        }

    def _edges(self, k: Indices, T: Array) -> Array:
        """Errors of the readings of the angle at the four edges of the windows; the inner two bound the rotation."""
        if self.conditions.gyro_edge == 0.0:
            return np.zeros((len(k), N_ROWS, N_ROWS))
        edge = np.zeros((len(k), N_ROWS, 4, 3))
        for rows, first, t in zip((_START_RATE, _END_RATE), (0, 2), T, strict=True):
            edge[:, rows, first] = -np.eye(3) / t[:, None, None]
            edge[:, rows, first + 1] = np.eye(3) / t[:, None, None]
        edge[:, _H, 1] = -self._tilt[k]
        edge[:, _H, 2] = self._tilt[k] @ self.integrals.C_end[k]
        G = self.conditions.gyro_edge * edge.reshape(len(k), N_ROWS, -1)
        return np.asarray(G @ np.swapaxes(G, 1, 2))

    def whitened(self, start_s: ArrayLike, end_s: ArrayLike, which: Indices | None = None) -> Array:
        """Jacobians in units of the noise, ``L⁻¹ H`` with ``L Lᵀ`` the covariance, shape (n, 10, N_UNKNOWNS)."""
        R = np.asarray(sum(self.covariances(start_s, end_s, which).values()))
        H = self.H if which is None else self.H[which]
        # Rates and forces differ by orders of magnitude: equilibrate before the factor is taken.
        scale = 1.0 / np.sqrt(np.einsum("naa->na", R))
        L = np.linalg.cholesky(R * scale[:, :, None] * scale[:, None, :])
        return np.asarray(np.linalg.solve(L, H * scale[:, :, None]))


def _with_wait(integrals: RotationIntegrals, wait_s: float) -> RotationIntegrals:
    """Rotations with a wait behind them that the gyros integrate over, too: bias, Earth's rate and noise act on."""
    assert integrals.noise is not None
    C = integrals.C_end
    return replace(
        integrals,
        time=integrals.time + wait_s * C,
        weight_s=integrals.weight_s + wait_s,
        noise=integrals.noise + wait_s * np.einsum("kab,kcb->kacb", C, C),
    )
