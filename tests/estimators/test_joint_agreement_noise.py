"""Filter, factor graph and dense solution agree on the full model, with navigation noise and drifting biases."""

import math
from dataclasses import replace

import numpy as np
import pytest
from accuracy_trials import noisy_recording

from srt.constants import EARTH_RATE_RAD_S
from srt.estimation.options import Options

pytest.importorskip("filterpy")
pytest.importorskip("gtsam")
from linear_problems import AGREE, ALL, EPS, IN_G, RESOLVED, Found, SolveStep, difference, iterated_to_rounding, jointly

from estimators.graph import GraphSolver
from estimators.kalman_filter import KalmanSolver, run_filter
from srt.estimation.observability import default_prior
from srt.joint.iteration import iterate
from srt.joint.joint_model import JointModel
from srt.joint.recording_opening import open_joint_model
from srt.joint.solver import IterationState

resolved = pytest.fixture(scope="module", autouse=True)(iterated_to_rounding)


# --- the turning Earth ----------------------------------------------------------------------------------------------


def navigation_problem(seed, **unit):
    recording, _ = noisy_recording(seed, "navigation", sample_rate_hz=50.0, **unit)
    return lambda: open_joint_model(recording, Options(max_playbacks=30))


def rounding(found):
    """Rounding of an angle of one radian, in sigmas of the best known parameter but the gyro biases."""
    return EPS / (found.sigma / IN_G)[:24].min()


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_full_model_with_navigation_noise(seed):
    """Fixture, gravity and attitudes estimated; the filter has its weak default prior, a third of full scale."""
    make = navigation_problem(seed)
    dense, graph = jointly(make(), SolveStep()), jointly(make(), GraphSolver("squared", None))
    informed, ekf = jointly(make(), SolveStep(default_prior())), jointly(make(), KalmanSolver(default_prior()))
    for a, b in ((graph, dense), (ekf, informed)):
        estimate, covariance = difference(a, b)
        assert estimate <= AGREE + rounding(dense)
        assert covariance <= AGREE
    # Effect of a prior of covariance P₀ about zero, to first order: −P P₀⁻¹ x, and −P P₀⁻¹ P.
    pull = dense.P @ np.linalg.solve(default_prior().covariance, np.column_stack([dense.x, dense.P]))
    expected = Found(dense.x - pull[:, 0], dense.P - pull[:, 1:])
    shift = difference(dense, expected)
    assert shift[0] < 2e-5
    assert difference(ekf, expected)[0] <= 1e-3 * shift[0] + AGREE + rounding(dense)
    # The point of linearisation moves with it, too.
    assert difference(ekf, dense)[1] <= 2.0 * shift[1] + AGREE


@pytest.mark.slow
def test_full_model_where_the_bias_drifts():
    """A stated instability of both sensors: filter, graph and dense solution at one, iterated to the end."""
    make = navigation_problem(1, instability=True)
    joint = make()
    assert not joint.bias_walks
    dense, graph = jointly(make(), SolveStep()), jointly(make(), GraphSolver("squared", None))
    informed, ekf = jointly(make(), SolveStep(default_prior())), jointly(make(), KalmanSolver(default_prior()))
    for a, b in ((graph, dense), (ekf, informed)):
        assert max(difference(a, b)) <= AGREE + rounding(b)
    # A parameter that drifts is known less well.
    still = navigation_problem(1)()
    assert np.all(dense.sigma > jointly(still, SolveStep()).sigma)


def test_filter_and_dense_solution_where_the_bias_walks(monkeypatch):
    """One pass of the filter at a point is the dense solution there; iterated, they differ in where they linearise.

    The filter's attitudes go with the last bias of its walk, and the headings of sequences whose own bias was another
    are off by the difference over the Earth's horizontal rate. The Jacobian is off by that share, and what is found.
    """
    recording, _ = noisy_recording(1, "navigation", sample_rate_hz=50.0, instability=True)
    # A scatter of the rest rates that no statement explains, as the windows' own would show it.
    quiet = replace(recording, noise=replace(recording.noise, gyro_bias_instability=None))

    monkeypatch.setattr(JointModel, "with_bias_scatter", lambda self, *_: self)
    joint = open_joint_model(quiet, Options(max_playbacks=30))
    joint = joint.with_choice(bias_scatter=np.full(3, recording.noise.gyro_bias_instability))
    assert joint.bias_walks
    iteration = IterationState(joint, joint.start, ALL.copy())
    iteration = iterate(KalmanSolver(default_prior()), iteration, converged=RESOLVED)
    once = run_filter(joint, iteration.point.system, iteration.point.state, default_prior())
    dense = SolveStep(default_prior()).solve(iteration.point)
    a, b = (Found(r.correction, r.covariance) for r in (once, dense))
    assert max(difference(a, b)) <= AGREE + rounding(b)
    ekf = Found(iteration.state.errors.vector, iteration.covariance)
    smooth = IterationState(joint, joint.start, ALL.copy())
    smooth = iterate(SolveStep(default_prior()), smooth, converged=RESOLVED)
    found = Found(smooth.state.errors.vector, smooth.covariance)
    spread = np.ptp(smooth.state.bias_deviation, axis=0).max()
    assert spread > 0.0
    # At biases that differ between the sequences, what is left of each step is part of the prediction.
    at_biases = smooth.point
    once = run_filter(joint, at_biases.system, at_biases.state, default_prior())
    dense = SolveStep(default_prior()).solve(at_biases)
    a, b = (Found(r.correction, r.covariance) for r in (once, dense))
    assert max(difference(a, b)) <= AGREE + rounding(b)
    heading = spread / (EARTH_RATE_RAD_S * math.cos(math.radians(45.0)))
    assert AGREE < max(difference(ekf, found)) <= heading
