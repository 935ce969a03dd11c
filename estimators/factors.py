"""Factors of the graph: residuals and Jacobians of the shared model in gtsam's terms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np

from estimators.system import whiten
from srt import measurement_model as model

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
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


class Terms:
    """Residual of a factor: constant Jacobians of some variables, and a function of the others.

    Parameters
    ----------
    linear : list of (key, ndarray)
        Variables that enter linearly, as a correction.
    keys : list of key
        The others.
    function : callable
        ``(values, keys) -> (residual, Jacobians)`` without the linear terms; with ``scaled`` its last Jacobian
        multiplies the linear ones.
    """

    def __init__(
        self, linear: list[tuple[int, Array]], keys: list[int], function: Callable[..., Any], *, scaled: bool = False
    ) -> None:
        self.linear, self.others, self.evaluate, self.scaled = linear, keys, function, scaled
        self.keys = [key for key, _ in linear] + keys

    def function(self, this: Any, values: Any, jacobians: Any) -> Array:  # noqa: ARG002 - gtsam's signature
        """Error function of a gtsam.CustomFactor over :attr:`keys`."""
        residual, by_others = self.evaluate(values, self.others)
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


def pose(force: Array, rate: Array, gravity: float, known: Array, *, gravity_free: bool) -> Callable[..., Linearised]:
    """Force (3, m/s²) and rate (3, rad/s) of a window: attitude, then gravity if free, then the unknown Earth rate."""

    def evaluate(values: Any, keys: list[int]) -> Linearised:
        others = list(keys[1:])
        g = gravity + (float(values.atVector(others.pop(0))[0]) if gravity_free else 0.0)
        earth = known + values.atVector(others[0]) if others else known
        attitude = values.atRot3(keys[0]).matrix()[None]
        r_force, force_by_attitude, by_gravity = model.pose_force(force[None], attitude, g)
        r_rate, rate_by_attitude, by_earth = model.pose_rate(rate[None], attitude, earth[None])
        jacobians = [np.concatenate([force_by_attitude[0], rate_by_attitude[0]])]
        if gravity_free:
            jacobians.append(np.concatenate([by_gravity[0], np.zeros(3)])[:, None])
        if others:
            jacobians.append(np.concatenate([np.zeros((3, 3)), by_earth[0]]))
        return np.concatenate([r_force[0], r_rate[0]]), jacobians

    return evaluate


def turn(turned: Array, known: Array, duration_s: float) -> Callable[..., Linearised]:
    """Rotation between two windows, rad: their attitudes, then the unknown Earth rate; scales the linear terms."""
    T = np.array([duration_s])

    def evaluate(values: Any, keys: list[int]) -> Linearised:
        earth = known + values.atVector(keys[2]) if len(keys) > 2 else known
        start, end = (values.atRot3(key).matrix()[None] for key in keys[:2])
        r, by_start, by_end, by_turned, by_earth = model.turn(turned[None], start, end, earth[None], T)
        return r[0], [*[by_start[0], by_end[0], by_earth[0]][: len(keys)], by_turned[0]]

    return evaluate


def start(nominal: Array, heading_rad: float) -> Callable[..., Linearised]:
    """Start attitude on the fixture, rad: attitude, base, mounting."""

    def evaluate(values: Any, keys: list[int]) -> Linearised:
        attitude, base, mounting = (values.atRot3(key).matrix() for key in keys)
        r, *jacobians = model.start_attitude(attitude[None], nominal[None], base, mounting, heading_rad)
        return r[0], [J[0] for J in jacobians]

    return evaluate


def heading(keep: Array) -> Callable[..., Linearised]:
    """Turn about the vertical since an attitude."""

    def evaluate(values: Any, keys: list[int]) -> Linearised:
        now = values.atRot3(keys[0]).matrix()
        turn = keep @ now.T
        return np.array([0.5 * (turn[0, 1] - turn[1, 0])]), [now[2][None]]

    return evaluate
