"""Bias instability as Markov states in the joint estimators, against its dense covariance."""

from dataclasses import replace

import numpy as np
import pytest
from accuracy_trials import GRADES, INSTABILITY, SITE, noisy_recording

from sims.physics.imu import read_out
from sims.physics.sequences import TABLE_1
from sims.physics.table_motion import table1_motion
from srt.estimation.error_sources import by_drift, slopes
from srt.estimation.options import Options
from srt.model import measurement_model as model
from srt.model.analytic_platform import integrate_attitude
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.sensor_errors import N_PARAMETERS, SensorErrors

pytest.importorskip("filterpy")
from estimators.kalman_filter import run_filter
from estimators.nuisance_elimination import eliminate_nuisances
from srt.estimation.observability import default_prior
from srt.joint.block_solution import BlockSolution
from srt.joint.initial_attitudes import placed
from srt.joint.linearisation import linearise
from srt.joint.recording_opening import open_joint_model

ALL = np.ones(N_PARAMETERS, dtype=bool)


def linearised(recording, prior=None):
    """Joint model, state and system at the initial estimate."""
    joint = open_joint_model(recording, Options())
    state, compensated = placed(joint, joint.start)
    return joint, state, linearise(joint, state, compensated, ALL, prior)


def dense_sigma(joint, state, system):
    """Sigmas from the covariance of all rows with the dense covariance of the drift, which has no states there."""
    data, compensated = joint.data, system.compensated
    integrals, _ = integrate_attitude(
        joint.processor.stream, gyro_triad(state.errors), np.zeros((data.K, 3)), with_noise=True
    )
    triads = gyro_triad(state.errors), accel_triad(state.errors)
    by = slopes(*triads, compensated.rate, compensated.force, integrals)
    gyro, accel, drift = data.noise.gyro_flicker, data.noise.accel_flicker, data.drift
    start, end = state.attitude[data.start], state.attitude[data.end]
    by_rotation = model.rotation_residual(
        compensated.rotation, start, end, joint.earth_rate(state)[data.start], compensated.duration_s
    )[3]
    effects = {
        "rate": -by_drift(by.rate * gyro, drift.windows),
        "turn": by_rotation @ by_drift(integrals.time_parts * gyro, drift.parts),
        "force": -by_drift(by.force * accel, data.window_drift),
    }
    R = np.eye(len(system.b))
    for sources in (("rate", "turn"), ("force",)):
        Y = np.zeros((len(system.b), effects[sources[0]].shape[2]))
        for kind in sources:
            Y[system.rows_of(kind).index] = system.whitening[kind] @ effects[kind]
        R += Y @ Y.T
    kept = np.concatenate([rows.index.ravel() for rows in system.rows if "drift" not in rows.kind])
    used = system.active.copy()
    used[[i for name in system.columns if "drift" in name for i in system.columns.of(name)]] = False
    H = system.A.toarray()[np.ix_(kept, np.flatnonzero(used))]
    scale = np.linalg.norm(H, axis=0)
    H = H / scale
    P = np.linalg.inv(H.T @ np.linalg.solve(R[np.ix_(kept, kept)], H)) / np.outer(scale, scale)
    E = system.columns.parameter_map()[:, used]
    return np.sqrt(np.diag(E @ P @ E.T))


@pytest.mark.parametrize("grade", ["navigation", "tactical"])
def test_sigmas_are_those_of_the_dense_covariance(grade):
    """2 % is allowed; what differs is the covariance of fast processes between sequences, 0.2 % of a variance."""
    joint, state, system = linearised(noisy_recording(1, grade, sample_rate_hz=50.0, instability=True)[0])
    found, expected = np.sqrt(np.diag(BlockSolution(system).covariance)), dense_sigma(joint, state, system)
    np.testing.assert_allclose(found, expected, rtol=2e-3)
    # The drift matters: without it the sigmas are smaller by more than that.
    quiet = linearised(noisy_recording(1, grade, sample_rate_hz=50.0)[0])[2]
    assert np.any(np.sqrt(np.diag(BlockSolution(quiet).covariance)) < 0.9 * found)


def long_recording(times):
    """Table 1 several times over, with drift."""
    gyro, accel = INSTABILITY["navigation"]
    imu = replace(GRADES["navigation"], gyro_bias_instability=gyro, accel_bias_instability=accel)
    motion = table1_motion(site=SITE, sample_rate_hz=50.0, sequences=tuple(TABLE_1) * times)
    return read_out(motion, SensorErrors(np.zeros(N_PARAMETERS)), imu, np.random.default_rng(1))


def test_number_of_states_does_not_grow_with_the_test():
    """Nine states of a triad (10, 100 and 1000 s) are handed on, whatever the number of sequences."""
    for times in (1, 3):
        joint, state, system = linearised(long_recording(times))
        assert {len(part.after) for part in eliminate_nuisances(system)[:-1]} == {18}
        filtered = run_filter(joint, system, state, default_prior())
        with_prior = linearise(joint, state, system.compensated, ALL, default_prior())
        solution = BlockSolution(with_prior)
        sigma = np.sqrt(np.diag(solution.covariance))
        assert np.abs((filtered.covariance - solution.covariance) / np.outer(sigma, sigma)).max() < 1e-8
        assert np.abs(filtered.delta - solution.delta).max() < 1e-8 * np.abs(solution.delta).max()
