"""One solution of the linearised problem (Kalman filter or factor graph), and the state of the iteration."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimators.joint_model import JointModel
    from estimators.joint_state import CompensatedData, JointState
    from estimators.linear_system import LinearSystem
    from srt.model.prior import Prior
    from srt.types import Array, Mask


@dataclass(frozen=True, slots=True, eq=False)
class LinearSolution:
    """A solution of the linearised problem.

    Attributes
    ----------
    point : Point
        What the correction is to be applied to: the point of linearisation, or one with better attitudes.
    system : System
        Linearised there.
    delta : ndarray, shape (n,)
        Correction of all columns.
    correction : ndarray, shape (27,)
    covariance : ndarray, shape (27, 27)
        Of the reported parameters.
    """

    state: JointState
    system: LinearSystem
    delta: Array
    correction: Array
    covariance: Array


class Solver(ABC):
    """One solution of the linearised problem.

    Attributes
    ----------
    name : str
        Of the estimator.
    prior : Prior or None
        Of the sensor errors; with one every parameter can be estimated.
    leaning : bool
        Whether it is still open what the data show: without a prior the wide default then keeps the rest in place.
    """

    name: str
    prior: Prior | None = None
    leaning = True

    @property
    def settled(self) -> bool:
        """Whether it may end here, if the correction is negligible."""
        return True

    def weights(self) -> dict[tuple[str, int], float]:
        """Weight of each measurement, by kind and number, where it is not one."""
        return {}

    def restart(self) -> None:  # noqa: B027 - most have nothing to do
        """Begin anew, the measurements having changed."""

    @abstractmethod
    def solve(self, joint: JointModel, system: LinearSystem, state: JointState) -> LinearSolution:
        """Solve a problem linearised at a point."""

    def diagnostics(self, joint: JointModel) -> dict[str, Any]:  # noqa: ARG002 - for those that have some
        """What else the estimator reports, as JSON values."""
        return {}


@dataclass(slots=True, eq=False)
class IterationState:
    """Where an iteration stands.

    Attributes
    ----------
    point : Point
        The estimate.
    linearised_at, played, system : Point, Played, System
        The last linearisation.
    free : ndarray of bool, shape (27,)
    covariance : ndarray, shape (27, 27)
    corrections : list of float
    status, message : str
    """

    state: JointState
    free: Mask
    linearisation_point: JointState | None = None
    compensated: CompensatedData | None = None
    system: LinearSystem | None = None
    covariance: Array | None = None
    corrections: list[float] | None = None
    status: str = "not_converged"
    message: str = ""
