"""Interface of the solvers (Kalman filter, factor graph) of the linearised joint model, and the iteration's state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from srt.estimation.drift_model import DriftSearch
from srt.result.diagnostics import Diagnostics
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from srt.joint.block_solution import BlockSolution
    from srt.joint.joint_model import JointModel
    from srt.joint.joint_state import JointState
    from srt.joint.linearisation import Linearisation
    from srt.model.prior import Prior
    from srt.types import Array, Mask


@dataclass(frozen=True, slots=True, eq=False)
class LinearSolution:
    """Solution of the linearised joint model.

    Attributes
    ----------
    delta : ndarray, shape (n,)
        Correction of all columns.
    correction : ndarray, shape (27,)
        Correction of the reported parameters.
    covariance : ndarray, shape (27, 27)
        Covariance of the reported parameters.
    whole : BlockSolution, optional
        Solution of all columns, where the solver has it.
    """

    delta: Array
    correction: Array
    covariance: Array
    whole: BlockSolution | None = None


class JointSolver(ABC):
    """Solver of the linearised joint model.

    Attributes
    ----------
    name : str
        Name of the estimator.
    prior : Prior or None
        Prior of the sensor errors. With one, every parameter can be estimated; without one, the measurements must
        determine all that are free.
    """

    name: str
    prior: Prior | None = None

    @property
    def settled(self) -> bool:
        """True if the iteration may stop once the correction is negligible."""
        return True

    def weights(self) -> dict[tuple[str, int], float]:
        """Weights of the measurements by kind and number; empty if all are 1."""
        return {}

    def restart(self) -> None:  # noqa: B027 - optional
        """Discard results derived from earlier measurements, as the measurements have changed."""

    @abstractmethod
    def solve(self, point: Linearisation) -> LinearSolution:
        """Solve the linearised joint model."""

    def diagnostics(self, joint: JointModel) -> Diagnostics:  # noqa: ARG002 - optional
        """Further results of the solver."""
        return Diagnostics()


@dataclass(slots=True, eq=False)
class IterationState:
    """Progress of an iteration.

    Attributes
    ----------
    joint : JointModel
        Model of the next linearisation: that of the last one, with what its solution changes.
    state : JointState
        Present estimate.
    free : ndarray of bool, shape (27,)
        Parameters that are estimated.
    point : Linearisation
        Last linearisation.
    covariance : ndarray, shape (27, 27)
    corrections : list of float
        Largest correction of every iteration, accelerometer bias in g.
    refits : list of int
        See :class:`srt.estimation.iterations.Iterations`.
    status, message : str
    whole : tuple of Linearisation, Prior or None, BlockSolution
        Last linearisation and prior, and the solution of all columns that follows from them.
    unmodelled_drift : DriftSearch
        Drift that the residuals of the last search show.
    """

    joint: JointModel
    state: JointState
    free: Mask
    point: Linearisation | None = None
    covariance: Array | None = None
    corrections: list[float] | None = None
    refits: list[int] = field(default_factory=list)
    status: str = "not_converged"
    message: str = ""
    whole: tuple[Linearisation, Prior | None, BlockSolution] | None = None
    unmodelled_drift: DriftSearch = field(default_factory=DriftSearch)

    @classmethod
    def at_start(cls, joint: JointModel, fixed: Mask) -> IterationState:
        """Iteration of a model from its initial estimate, with fixed parameters at their values."""
        return cls(joint, joint.with_fixed_values(joint.start, fixed), ~fixed)

    @property
    def sigma(self) -> Array:
        """Standard deviations of the parameters, shape (27,); zero without a solution."""
        if self.covariance is None:
            return np.zeros(N_PARAMETERS)
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))
