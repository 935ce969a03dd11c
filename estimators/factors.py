"""Factors of the graph: residuals and Jacobians of the measurement model as gtsam expects them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np

from srt.joint.linear_system import whiten
from srt.model import measurement_model as model

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.joint.stated_rates import StatedRates
    from srt.types import Array, Indices

    Linearised = tuple[Array, list[Array]]


def gaussians(covariances: Array) -> list[Any]:
    """Noise models of covariances (n, d, d), each by the upper triangular square root of its information.

    gtsam would invert a covariance, which loses digits: that of a start attitude spans eight decades. It treats a
    diagonal model with a sigma below 1e-8 (gyro biases in rad/s) as a hard constraint. It reads only the upper triangle
    of a root.
    """
    roots = np.linalg.qr(whiten(covariances), mode="r")
    return [gtsam.noiseModel.Gaussian.SqrtInformation(root, False) for root in roots]


def gaussian(covariance: Array) -> Any:
    """Noise model of one covariance; see :func:`gaussians`."""
    return gaussians(covariance[None])[0]


class ErrorFunction:
    """Error function of a factor: linear in some variables, nonlinear in the others.

    Parameters
    ----------
    linear : list of (key, ndarray)
        Variables that enter linearly as a correction, with their constant Jacobians.
    keys : list of key
        The other variables.
    function : callable
        ``(values) -> (residual, Jacobians)`` without the linear terms.
    scaled : bool
        The last Jacobian of ``function`` multiplies the linear terms.
    """

    def __init__(
        self, linear: list[tuple[int, Array]], keys: list[int], function: Callable[..., Any], *, scaled: bool = False
    ) -> None:
        self.linear, self.evaluate, self.scaled = linear, function, scaled
        self.keys = [key for key, _ in linear] + keys

    def function(self, this: Any, values: Any, jacobians: Any) -> Array:  # noqa: ARG002 - gtsam's signature
        """Error and Jacobians of a gtsam.CustomFactor over :attr:`keys`."""
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
    """All factors of one kind, whose nonlinear parts are evaluated together.

    gtsam evaluates one factor at a time, which is slow with array functions. :meth:`prepare` evaluates all factors
    before a linearisation; until :meth:`forget`, each call returns a stored result.
    """

    def __init__(self, count: int) -> None:
        self._rows = np.arange(count)
        self._prepared: tuple[Array, list[list[Array]]] | None = None

    @abstractmethod
    def keys(self, row: int) -> list[int]:
        """Variables of a factor that enter nonlinearly."""

    @abstractmethod
    def evaluate(self, values: Any, rows: Indices) -> tuple[Array, list[list[Array]]]:
        """Residuals (n, d) of some factors, and the Jacobians of each with respect to :meth:`keys`."""

    def prepare(self, values: Any) -> None:
        """Evaluate all factors at these values, and store the results until :meth:`forget`."""
        self._prepared = self.evaluate(values, self._rows)

    def forget(self) -> None:
        """Evaluate each factor on demand."""
        self._prepared = None

    def at(self, row: int, values: Any) -> Linearised:
        """Residual and Jacobians of one factor."""
        residuals, jacobians = self._prepared or self.evaluate(values, self._rows[row : row + 1])
        at = row if self._prepared else 0
        return residuals[at], list(jacobians[at])


def _matrices(values: Any, keys: Indices) -> Array:
    return np.stack([values.atRot3(key).matrix() for key in keys.tolist()])


class EarthRate:
    """Earth's rate of every factor: a known part and, in some level frames, a variable.

    Parameters
    ----------
    known : ndarray, shape (n, 3), rad/s
    keys : list of (int or None)
        Variables of the unknown part.
    """

    def __init__(self, known: Array, keys: list[int | None]) -> None:
        self.known, self.keys = known, keys

    def rate(self, values: Any, rows: Indices) -> Array:
        """Earth's rate of some factors, shape (n, 3), rad/s."""
        out = self.known[rows].copy()
        for i, row in enumerate(rows.tolist()):
            key = self.keys[row]
            if key is not None:
                out[i] += values.atVector(key)
        return out


class WindowFactors(FactorGroup):
    """Specific force (m/s²) and rate (rad/s) of windows, by attitude, gravity if estimated, Earth's rate if unknown.

    Parameters
    ----------
    force, rate : ndarray, shape (n, 3)
    attitudes : ndarray of int, shape (n,)
        Variables.
    gravity : float, m/s²
    gravity_key : int or None
        Variable of the correction to gravity, if estimated.
    earth : EarthRate
    """

    def __init__(
        self,
        force: Array,
        rate: Array,
        attitudes: Indices,
        gravity: float,
        gravity_key: int | None,
        earth: EarthRate,
    ) -> None:
        super().__init__(len(force))
        self.force, self.rate, self.attitudes = force, rate, attitudes
        self.gravity, self.gravity_key, self.earth = gravity, gravity_key, earth

    def keys(self, row: int) -> list[int]:
        """Variables of a window."""
        keys = (int(self.attitudes[row]), self.gravity_key, self.earth.keys[row])
        return [key for key in keys if key is not None]

    def evaluate(self, values: Any, rows: Indices) -> tuple[Array, list[list[Array]]]:
        """Residuals and Jacobians of windows."""
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
    """Rotations between two windows (rad), by their attitudes, the Earth's rate if unknown, and the measured rotation.

    Parameters
    ----------
    rotation : ndarray, shape (n, 3, 3)
    starts, ends : ndarray of int, shape (n,)
        Attitude variables.
    earth : EarthRate
    duration_s : ndarray, shape (n,)
    heading : bool
        Use only the component about the vertical.
    """

    def __init__(
        self,
        rotation: Array,
        starts: Indices,
        ends: Indices,
        earth: EarthRate,
        duration_s: Array,
        *,
        heading: bool = False,
    ) -> None:
        super().__init__(len(rotation))
        self.rotation, self.starts, self.ends, self.earth = rotation, starts, ends, earth
        self.duration_s, self.heading = duration_s, heading

    def keys(self, row: int) -> list[int]:
        """Variables of a rotation."""
        keys = (int(self.starts[row]), int(self.ends[row]), self.earth.keys[row])
        return [key for key in keys if key is not None]

    def evaluate(self, values: Any, rows: Indices) -> tuple[Array, list[list[Array]]]:
        """Residuals and Jacobians of rotations."""
        start, end = _matrices(values, self.starts[rows]), _matrices(values, self.ends[rows])
        earth = self.earth.rate(values, rows)
        found = model.rotation_residual(self.rotation[rows], start, end, earth, self.duration_s[rows])
        r, by_start, by_end, by_rotation, by_earth = model.heading_residual(found, start) if self.heading else found
        jacobians = [
            [by_start[i], by_end[i], *([] if self.earth.keys[row] is None else [by_earth[i]]), by_rotation[i]]
            for i, row in enumerate(rows.tolist())
        ]
        return r, jacobians


class StatedRateFactors(FactorGroup):
    """Mean rates of runs at a stated rate (rad/s), by the attitude at their start and the Earth's rate if unknown.

    Parameters
    ----------
    runs : StatedRates
    starts : ndarray of int, shape (R,)
        Attitude variables.
    earth : EarthRate
    table_rate : float
        Error of the table's rate in sigmas, to which a variable is the correction.
    """

    def __init__(self, runs: StatedRates, starts: Indices, earth: EarthRate, table_rate: float) -> None:
        super().__init__(len(starts))
        self.runs, self.starts, self.earth, self.table_rate = runs, starts, earth, table_rate

    def keys(self, row: int) -> list[int]:
        """Variables of a run."""
        keys = (int(self.starts[row]), self.earth.keys[row])
        return [key for key in keys if key is not None]

    def evaluate(self, values: Any, rows: Indices) -> tuple[Array, list[list[Array]]]:
        """Residuals and Jacobians of runs."""
        start, earth = _matrices(values, self.starts), self.earth.rate(values, self._rows)
        r, by_start, by_earth = self.runs.residual(start, earth, self.table_rate)
        jacobians = [
            [by_start[row], *([] if self.earth.keys[row] is None else [by_earth[row]])] for row in rows.tolist()
        ]
        return r[rows], jacobians


class FixtureAttitudeFactors(FactorGroup):
    """Start or end attitudes on the fixture (rad), by attitude, base, mounting and non-orthogonality of the axes.

    Parameters
    ----------
    nominal : ndarray, shape (n, 3, 3)
    attitudes : ndarray of int, shape (n,)
        Variables.
    fixture : (int, int, int)
        Variables of base, mounting and non-orthogonality.
    heading_rad : float
    components : slice
        Components of the residual that are used.
    """

    def __init__(
        self, nominal: Array, attitudes: Indices, fixture: tuple[int, int, int], heading_rad: float, components: slice
    ) -> None:
        super().__init__(len(nominal))
        self.nominal, self.attitudes, self.fixture = nominal, attitudes, fixture
        self.heading_rad, self.components = heading_rad, components

    def keys(self, row: int) -> list[int]:
        """Variables of an attitude on the fixture."""
        return [int(self.attitudes[row]), *self.fixture]

    def evaluate(self, values: Any, rows: Indices) -> tuple[Array, list[list[Array]]]:
        """Residuals and Jacobians of attitudes on the fixture."""
        base, mounting = (values.atRot3(key).matrix() for key in self.fixture[:2])
        angle = float(values.atVector(self.fixture[2])[0])
        attitude = _matrices(values, self.attitudes[rows])
        r, *jacobians = model.start_attitude_residual(
            attitude, self.nominal[rows], base, mounting, self.heading_rad, angle
        )
        return r[:, self.components], [[J[i, self.components] for J in jacobians] for i in range(len(rows))]


def heading(keep: Array, key: int) -> Callable[[Any], Linearised]:
    """Error function of a rotation about the vertical since an attitude."""

    def evaluate(values: Any) -> Linearised:
        now = values.atRot3(key).matrix()
        rotation = keep @ now.T
        return np.array([0.5 * (rotation[0, 1] - rotation[1, 0])]), [now[2][None]]

    return evaluate
