"""Factors of the graph: residuals and Jacobians of the measurement model as gtsam expects them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np

from srt.joint.linear_system import whiten

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srt.types import Array, Indices

    Keys = Sequence[int | None]
    Linearised = tuple[Array, list[Array]]
    Term = tuple[Keys, Array]


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


def matrices(values: Any, keys: Indices) -> Array:
    """Rotation matrices of variables, shape (n, 3, 3)."""
    return np.stack([values.atRot3(key).matrix() for key in keys.tolist()])


@dataclass(slots=True, eq=False)
class FactorGroup:
    """All n factors of one kind: linear in some variables, nonlinear in the others.

    gtsam evaluates one factor at a time, which is slow with array functions. :meth:`prepare` evaluates all factors
    before a linearisation; until :meth:`forget`, each call returns a stored result.

    Attributes
    ----------
    keys : list of sequences of (int or None), n each
        Variables that enter nonlinearly, slot by slot; None where a factor has no variable there.
    evaluate : callable
        ``(values, rows) -> (residuals (m, d), Jacobians (m, d, w) slot by slot)`` of m factors, without linear terms.
    linear : list of (sequence of (int or None), ndarray)
        Variables that enter linearly as a correction, with their constant Jacobians (n, d, w).
    scaled : bool
        ``evaluate`` gives one more Jacobian, which multiplies the linear terms.
    """

    keys: list[Keys]
    evaluate: Callable[[Any, Indices], Linearised]
    linear: list[Term]
    scaled: bool = False
    _prepared: Linearised | None = field(default=None, init=False)

    def prepare(self, values: Any) -> None:
        """Evaluate all factors at these values, and store the results until :meth:`forget`."""
        self._prepared = self.evaluate(values, np.arange(len(self.keys[0])))

    def forget(self) -> None:
        """Evaluate each factor on demand."""
        self._prepared = None

    def factor(self, row: int, noise: Any) -> Any:
        """One factor, as gtsam takes it."""
        linear = [(key, J[row]) for keys, J in self.linear if (key := keys[row]) is not None]
        slots = [slot for slot, keys in enumerate(self.keys) if keys[row] is not None]

        def function(_: Any, values: Any, jacobians: Any) -> Array:
            residuals, by_slot = self._prepared or self.evaluate(values, np.array([row]))
            at = row if self._prepared else 0
            residual = residuals[at]
            for i, (key, constant) in enumerate(linear):
                J = by_slot[-1][at] @ constant if self.scaled else constant
                residual = residual + J @ values.atVector(key)
                if jacobians is not None:
                    jacobians[i] = np.asfortranarray(J)
            if jacobians is not None:
                for i, slot in enumerate(slots):
                    jacobians[len(linear) + i] = np.asfortranarray(by_slot[slot][at])
            return np.ascontiguousarray(residual)

        keys = [key for key, _ in linear] + [key for keys in self.keys if (key := keys[row]) is not None]
        return gtsam.CustomFactor(noise, keys, function)
