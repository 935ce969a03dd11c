"""Factors of the graph: residuals and Jacobians of the shared model in gtsam's terms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np

from estimators.linear_system import whiten
from srt.model import measurement_model as model

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.types import Array, Indices

    Linearised = tuple[Array, list[Array]]


def gaussians(covariances: Array) -> list[Any]:
    """Noise models of covariances (n, d, d) by their square roots, the upper triangles of which are what gtsam reads.

    Neither by the covariance, which gtsam inverts (a start attitude's spans eight decades), nor as a diagonal one,
    which it takes for a hard constraint where a sigma is below 1e-8 (as gyro biases in rad/s are).
    """
    roots = np.linalg.qr(whiten(covariances), mode="r")
    return [gtsam.noiseModel.Gaussian.SqrtInformation(root, False) for root in roots]


def gaussian(covariance: Array) -> Any:
    """Noise model of one covariance, as :func:`gaussians`."""
    return gaussians(covariance[None])[0]


class ErrorFunction:
    """Residual of a factor: constant Jacobians of some variables, and a function of the others.

    Parameters
    ----------
    linear : list of (key, ndarray)
        Variables that enter linearly, as a correction.
    keys : list of key
        The others.
    function : callable
        ``(values) -> (residual, Jacobians)`` without the linear terms; with ``scaled`` its last Jacobian multiplies
        the linear ones.
    """

    def __init__(
        self, linear: list[tuple[int, Array]], keys: list[int], function: Callable[..., Any], *, scaled: bool = False
    ) -> None:
        self.linear, self.evaluate, self.scaled = linear, function, scaled
        self.keys = [key for key, _ in linear] + keys

    def function(self, this: Any, values: Any, jacobians: Any) -> Array:  # noqa: ARG002 - gtsam's signature
        """Error function of a gtsam.CustomFactor over :attr:`keys`."""
        residual, by_others = self.evaluate(values)
        scale = by_others.pop() if self.scaled else None
        for i, (key, J) in enumerate(self.linear):
            J_now = J if scale is None else scale @ J
            residual = residual + J_now @ values.atVector(key)
            if jacobians is not None:
                jacobians[i] = np.asfortranarray(J_now)
        if jacobians is not None:
            for i, J in enumerate(by_others):
                jacobians[len(self.linear) + i] = np.asfortranarray(J)
        return np.ascontiguousarray(residual)


class FactorGroup(ABC):
    """All factors of one kind: what depends on attitudes and site, computed for any of them at once.

    gtsam asks factor by factor, and a model made for arrays spends its time on overhead then. :meth:`prepare` computes
    all before a linearisation; what is asked for until :meth:`forget` is looked up.
    """

    def __init__(self, count: int) -> None:
        self._rows = np.arange(count)
        self._prepared: tuple[Array, list[list[Array]]] | None = None

    @abstractmethod
    def keys(self, row: int) -> list[int]:
        """Variables of a factor that do not enter linearly."""

    @abstractmethod
    def evaluate(self, values: Any, rows: Indices) -> tuple[Array, list[list[Array]]]:
        """Residuals (n, d) of some factors, and the Jacobians of each by the variables of :meth:`keys`."""

    def prepare(self, values: Any) -> None:
        """Compute all factors; only these values may be asked for until :meth:`forget`."""
        self._prepared = self.evaluate(values, self._rows)

    def forget(self) -> None:
        """Compute each factor when it is asked for."""
        self._prepared = None

    def at(self, row: int, values: Any) -> Linearised:
        """Residual and Jacobians of one factor."""
        residuals, jacobians = self._prepared or self.evaluate(values, self._rows[row : row + 1])
        at = row if self._prepared else 0
        return residuals[at], list(jacobians[at])


def _matrices(values: Any, keys: Indices) -> Array:
    return np.stack([values.atRot3(key).matrix() for key in keys.tolist()])


class _Earth:
    """The Earth's rate of every factor: known, and in some chains a variable besides."""

    def __init__(self, known: Array, keys: list[int | None]) -> None:
        self.known, self.keys = known, keys

    def rate(self, values: Any, rows: Indices) -> Array:
        out = self.known[rows].copy()
        for i, row in enumerate(rows.tolist()):
            key = self.keys[row]
            if key is not None:
                out[i] += values.atVector(key)
        return out


class WindowFactors(FactorGroup):
    """Force (m/s²) and rate (rad/s) of windows: attitude, then gravity if free, then the Earth's rate if unknown.

    Parameters
    ----------
    force, rate : ndarray, shape (n, 3)
    attitudes : ndarray of int, shape (n,)
        Variables.
    gravity : float, m/s²
    gravity_key : int or None
        Variable of its correction.
    known : ndarray, shape (n, 3), rad/s
    earth_keys : list of (int or None)
        Variables of the rest of the Earth's rate.
    """

    def __init__(
        self,
        force: Array,
        rate: Array,
        attitudes: Indices,
        gravity: float,
        gravity_key: int | None,
        known: Array,
        earth_keys: list[int | None],
    ) -> None:
        super().__init__(len(force))
        self.force, self.rate, self.attitudes = force, rate, attitudes
        self.gravity, self.gravity_key, self.earth = gravity, gravity_key, _Earth(known, earth_keys)

    def keys(self, row: int) -> list[int]:
        """Of a window."""
        keys = (int(self.attitudes[row]), self.gravity_key, self.earth.keys[row])
        return [key for key in keys if key is not None]

    def evaluate(self, values: Any, rows: Indices) -> tuple[Array, list[list[Array]]]:
        """Of windows."""
        attitude = _matrices(values, self.attitudes[rows])
        g = self.gravity + (0.0 if self.gravity_key is None else float(values.atVector(self.gravity_key)[0]))
        r_force, force_by_attitude, by_gravity = model.specific_force_residual(self.force[rows], attitude, g)
        r_rate, rate_by_attitude, by_earth = model.angular_rate_residual(
            self.rate[rows], attitude, self.earth.rate(values, rows)
        )
        by_attitude = np.concatenate([force_by_attitude, rate_by_attitude], axis=1)
        of_gravity = np.concatenate([by_gravity, np.zeros_like(by_gravity)], axis=1)[:, :, None]
        of_earth = np.concatenate([np.zeros_like(by_earth), by_earth], axis=1)
        jacobians = [
            [by_attitude[i]]
            + ([] if self.gravity_key is None else [of_gravity[i]])
            + ([] if self.earth.keys[row] is None else [of_earth[i]])
            for i, row in enumerate(rows.tolist())
        ]
        return np.concatenate([r_force, r_rate], axis=1), jacobians


class RotationFactors(FactorGroup):
    """Rotations between two windows, rad: their attitudes, the Earth's rate if unknown, and what scales linear terms.

    Parameters
    ----------
    turned : ndarray, shape (n, 3, 3)
    starts, ends : ndarray of int, shape (n,)
        Variables.
    known : ndarray, shape (n, 3), rad/s
    earth_keys : list of (int or None)
    duration_s : ndarray, shape (n,)
    """

    def __init__(
        self,
        rotation: Array,
        starts: Indices,
        ends: Indices,
        known: Array,
        earth_keys: list[int | None],
        duration_s: Array,
    ) -> None:
        super().__init__(len(rotation))
        self.rotation, self.starts, self.ends, self.duration_s = rotation, starts, ends, duration_s
        self.earth = _Earth(known, earth_keys)

    def keys(self, row: int) -> list[int]:
        """Of a turn."""
        keys = (int(self.starts[row]), int(self.ends[row]), self.earth.keys[row])
        return [key for key in keys if key is not None]

    def evaluate(self, values: Any, rows: Indices) -> tuple[Array, list[list[Array]]]:
        """Of turns."""
        start, end = _matrices(values, self.starts[rows]), _matrices(values, self.ends[rows])
        earth = self.earth.rate(values, rows)
        r, by_start, by_end, by_turned, by_earth = model.rotation_residual(
            self.rotation[rows], start, end, earth, self.duration_s[rows]
        )
        jacobians = [
            [by_start[i], by_end[i], *([] if self.earth.keys[row] is None else [by_earth[i]]), by_turned[i]]
            for i, row in enumerate(rows.tolist())
        ]
        return r, jacobians


class StartFactors(FactorGroup):
    """Start attitudes on the fixture, rad: attitude, base, mounting.

    Parameters
    ----------
    nominal : ndarray, shape (n, 3, 3)
    attitudes : ndarray of int, shape (n,)
        Variables.
    base, mounting : int
        Variables.
    heading_rad : float
    """

    def __init__(self, nominal: Array, attitudes: Indices, base: int, mounting: int, heading_rad: float) -> None:
        super().__init__(len(nominal))
        self.nominal, self.attitudes, self.base, self.mounting = nominal, attitudes, base, mounting
        self.heading_rad = heading_rad

    def keys(self, row: int) -> list[int]:
        """Of a start."""
        return [int(self.attitudes[row]), self.base, self.mounting]

    def evaluate(self, values: Any, rows: Indices) -> tuple[Array, list[list[Array]]]:
        """Of starts."""
        base, mounting = (values.atRot3(key).matrix() for key in (self.base, self.mounting))
        attitude = _matrices(values, self.attitudes[rows])
        r, *jacobians = model.start_attitude_residual(attitude, self.nominal[rows], base, mounting, self.heading_rad)
        return r, [[J[i] for J in jacobians] for i in range(len(rows))]


def heading(keep: Array, key: int) -> Callable[[Any], Linearised]:
    """Turn about the vertical since an attitude."""

    def evaluate(values: Any) -> Linearised:
        now = values.atRot3(key).matrix()
        turn = keep @ now.T
        return np.array([0.5 * (turn[0, 1] - turn[1, 0])]), [now[2][None]]

    return evaluate
