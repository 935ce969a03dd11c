"""Recordings and limits that the tests of agreement between estimators share."""

from dataclasses import dataclass

import numpy as np
import pytest
from dense_solution import solve
from threadpoolctl import threadpool_limits

from srt.closed_form import iteration as closed_form_iteration
from srt.joint import iteration as joint_iteration
from srt.joint.iteration import iterate
from srt.joint.linearisation import linearise
from srt.joint.solver import IterationState, JointSolver, LinearSolution
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

EPS = np.finfo(float).eps
G = 9.80665
ALL = np.ones(N_PARAMETERS, dtype=bool)
AGREE = 1e-9
"""Tolerances of a sigma and of a correlation."""
RESOLVED = (1e-18, 1e-9)
"""Largest negligible correction, absolute and in sigmas."""


def iterated_to_rounding():
    """Iterate to rounding wherever the criterion is read, in one thread: these matrices gain nothing from more."""
    with pytest.MonkeyPatch.context() as patch, threadpool_limits(limits=1, user_api="blas"):
        for module in (closed_form_iteration, joint_iteration):
            patch.setattr(module, "CONVERGED_CORRECTION", RESOLVED[0])
            patch.setattr(module, "CONVERGED_SIGMAS", RESOLVED[1])
        yield


IN_G = np.ones(N_PARAMETERS)
IN_G[GROUP_SLICES["accel_bias"]] = G


class SolveStep(JointSolver):
    """The linearised problem solved at once, with numpy alone."""

    name = "solve"

    def __init__(self, prior=None):
        self.prior = prior

    def solve(self, point):
        solution = solve(linearise(point.joint, point.state, point.compensated, point.free, self.prior))
        E = point.columns.parameter_map()
        spread = E @ solution.root
        return LinearSolution(solution.delta, E @ solution.delta, spread @ spread.T)


@dataclass(frozen=True)
class Found:
    """Estimate and covariance of the 27 parameters."""

    x: np.ndarray
    P: np.ndarray

    @property
    def sigma(self):
        return np.sqrt(np.diag(self.P))


def difference(a, b):
    """Largest difference of two results: estimates in sigmas, covariances scaled to correlations."""
    return (
        float(np.abs((a.x - b.x) / b.sigma).max()),
        float(np.abs((a.P - b.P) / np.outer(b.sigma, b.sigma)).max()),
    )


def jointly(joint, step, converged=RESOLVED):
    iteration = IterationState(joint, joint.start, ALL.copy())
    iteration = iterate(step, iteration, converged=converged)
    assert iteration.status == "converged"
    assert iteration.free.all()
    return Found(iteration.state.errors.vector, iteration.covariance)
