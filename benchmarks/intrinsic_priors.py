"""Sensor errors as variables of a navigation graph: fixed at the calibration, with it as prior, and without a prior.

A vehicle moves for 90 s with satellite fixes of 0.1 m and for 30 s without. Its unit differs from its calibration by a
draw from the calibration's covariance (MEMS: 500 ppm, 0.5 mrad, 2 mm/s², 10 °/h). gtsam estimates trajectory and errors
by the factor of :mod:`srt.stacks.gtsam_factor`. The trajectory is made here, by finer steps.

    python benchmarks/intrinsic_priors.py [--runs 40]
"""

from dataclasses import dataclass

import gtsam
import harness
import numpy as np
from foreign_motion import Grade, readings
from gtsam.symbol_shorthand import E as ERRORS
from gtsam.symbol_shorthand import V, X
from scipy.spatial.transform import Rotation

from srt.result.calibration import Calibration
from srt.result.noise_figures import NoiseFigures
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors
from srt.stacks.gtsam_factor import ErrorVariable, preintegrated_factor
from srt.stacks.preintegration import PreintegratedReadings, preintegrate

G = np.array([0.0, 0.0, -9.8])
DT, SUB, KEYFRAME_S, DURATION_S, FIXES_S = 0.01, 10, 1.0, 120.0, 90.0
FIX_SIGMA_M = 0.1
NOISE = Grade(3e-5, 5e-4, 0.0, 0.0, 0.0, 0.0)
"""White noise; the errors are drawn from the covariance of the calibration."""
START_SIGMA = np.array([5e-3, 5e-3, 5e-3, 0.1, 0.1, 0.1])
SIGMA = {
    "gyro_scale": 5e-4, "gyro_asymmetry": 1e-4, "gyro_orthogonality": 5e-4, "accel_bias": 2e-3, "accel_scale": 5e-4,
    "accel_asymmetry": 1e-4, "accel_misalignment": 5e-4, "gyro_bias": 5e-5,
}  # fmt: skip
MODES = {"fixed at the calibration": 1e-4, "calibration as prior": 1.0, "no prior": 1e3}
"""Factor on the sigmas of the calibration by mode."""


@dataclass(frozen=True)
class Truth:
    """Attitudes (n + 1, 3, 3), velocities and positions (n + 1, 3) at the samples, mean rates and forces (n, 3)."""

    attitude: np.ndarray
    velocity: np.ndarray
    position: np.ndarray
    rate: np.ndarray
    force: np.ndarray


def truth() -> Truth:
    """Motion by formulas, and its means over the samples by ten steps each."""
    h = DT / SUB
    t = h * np.arange(round(DURATION_S / h) + 1)
    w = 2.0 * np.pi

    def position(s: np.ndarray) -> np.ndarray:
        return np.stack([40.0 * np.sin(w * s / 30.0), 30.0 * np.sin(w * s / 23.0), 3.0 * np.sin(w * s / 11.0)], axis=1)

    def attitude(s: np.ndarray) -> Rotation:
        angles = [0.8 * np.sin(w * s / 20.0) + 0.05 * s, 0.25 * np.sin(w * s / 9.0 + 1.0), 0.3 * np.sin(w * s / 7.0)]
        return Rotation.from_euler("ZYX", np.stack(angles, axis=1))

    periods = np.array([30.0, 23.0, 11.0])
    amplitude = np.array([40.0, 30.0, 3.0])
    velocity = amplitude * w / periods * np.cos(w * t[:, None] / periods)
    middle = t[:-1] + 0.5 * h
    acceleration = -amplitude * (w / periods) ** 2 * np.sin(w * middle[:, None] / periods)
    R = attitude(t)
    rate = (R[:-1].inv() * R[1:]).as_rotvec() / h
    force = attitude(middle).inv().apply(acceleration - G)
    mean = [values.reshape(-1, SUB, 3).mean(axis=1) for values in (rate, force)]
    return Truth(R.as_matrix()[::SUB], velocity[::SUB], position(t)[::SUB], mean[0], mean[1])


def calibration(rng: np.random.Generator) -> Calibration:
    sigma = np.empty(N_PARAMETERS)
    for group, value in SIGMA.items():
        sigma[GROUP_SLICES[group]] = value
    noise = NoiseFigures(
        gyro_noise_rad_per_sqrt_s=np.full(3, NOISE.gyro_rad_per_sqrt_s),
        accel_noise_m_s2_sqrt_s=np.full(3, NOISE.accel_m_s2_sqrt_s),
    )
    errors = SensorErrors(10.0 * sigma * rng.standard_normal(N_PARAMETERS))
    return Calibration("bench", "converged", "", errors, np.diag(sigma**2), noise=noise)


@dataclass(frozen=True)
class Estimate:
    """Position errors (k, 3), attitude errors (k, 3), errors of z over sigma, NEES of z and of the last pose."""

    position: np.ndarray
    attitude: np.ndarray
    z: np.ndarray
    nees_z: float
    nees_pose: float


def estimate(
    weight: float,
    true: Truth,
    unit: Calibration,
    preintegrated: list[PreintegratedReadings],
    z_true: np.ndarray,
    fixes: np.ndarray,
    start: gtsam.Pose3,
) -> Estimate:
    """Solve the graph of one mode."""
    variable = ErrorVariable(unit)
    step = round(KEYFRAME_S / DT)
    count = len(preintegrated)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose3(X(0), start, gtsam.noiseModel.Diagonal.Sigmas(START_SIGMA)))
    graph.add(gtsam.PriorFactorVector(V(0), true.velocity[0], gtsam.noiseModel.Isotropic.Sigma(3, 0.05)))
    graph.add(variable.prior(ERRORS(0), weight=weight))
    fix_noise = gtsam.noiseModel.Isotropic.Sigma(3, FIX_SIGMA_M)
    R, p, v = start.rotation().matrix(), start.translation(), true.velocity[0]
    values.insert(X(0), start)
    values.insert(V(0), v)
    values.insert(ERRORS(0), np.zeros(variable.size))
    for k, summed in enumerate(preintegrated):
        keys = X(k), V(k), X(k + 1), V(k + 1), ERRORS(0)
        graph.add(preintegrated_factor(keys, summed, variable, G))
        T = summed.duration_s
        p = p + v * T + 0.5 * G * T**2 + R @ summed.position
        v = v + G * T + R @ summed.velocity
        R = R @ summed.rotation
        if k < len(fixes):
            graph.add(gtsam.GPSFactor(X(k + 1), fixes[k], fix_noise))
            p = fixes[k]
        values.insert(X(k + 1), gtsam.Pose3(gtsam.Rot3(R), p))
        values.insert(V(k + 1), v)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    position, attitude = [], []
    for k in range(count + 1):
        pose = found.atPose3(X(k))
        position.append(pose.translation() - true.position[k * step])
        attitude.append(Rotation.from_matrix(true.attitude[k * step].T @ pose.rotation().matrix()).as_rotvec())
    P = marginal(graph.linearize(found), [X(count), ERRORS(0)])
    dz = found.atVector(ERRORS(0)) - z_true
    nees = float(dz @ np.linalg.solve(P[6:, 6:], dz))
    last = found.atPose3(X(count))
    R_true = true.attitude[-1]
    d = np.concatenate([attitude[-1], R_true.T @ (last.translation() - true.position[-1])])
    nees_pose = float(d @ np.linalg.solve(P[:6, :6], d))
    return Estimate(np.array(position), np.array(attitude), dz, nees, nees_pose)


def marginal(linear: gtsam.GaussianFactorGraph, keys: list[int]) -> np.ndarray:
    """Marginal covariance of variables by a dense QR; gtsam's Cholesky gives up on sigmas this far apart."""
    others = [key for key in sorted(linear.keys()) if key not in keys]
    ordering = gtsam.Ordering()
    for key in [*others, *keys]:
        ordering.push_back(key)
    A, _ = linear.jacobian(ordering)
    scale = np.linalg.norm(A, axis=0)
    R = np.linalg.qr(A / scale, mode="r")
    # Poses have 6 columns, velocities 3, and the errors what is left.
    n = A.shape[1] - sum(6 if gtsam.Symbol(key).chr() == ord("x") else 3 for key in others)
    inverse = np.linalg.inv(R[-n:, -n:]) / scale[-n:, None]
    return inverse @ inverse.T


def run(rng: np.random.Generator, true: Truth, modes: dict[str, float] = MODES) -> dict[str, Estimate]:
    """All modes on one draw of calibration, unit, noise and fixes."""
    unit = calibration(rng)
    z_true = rng.standard_normal(ErrorVariable(unit).size)
    errors = ErrorVariable(unit).errors(z_true).as_dict()
    gyro, accel = readings(true.rate[:, None], true.force, errors, NOISE, DT, rng)
    step = round(KEYFRAME_S / DT)
    places = true.position[step : round(FIXES_S / DT) + 1 : step]
    fixes = places + FIX_SIGMA_M * rng.standard_normal(places.shape)
    offset = START_SIGMA * rng.standard_normal(6)
    exact = gtsam.Pose3(gtsam.Rot3(true.attitude[0]), true.position[0])
    start = exact.retract(offset)
    parts = [slice(k, k + step) for k in range(0, len(gyro) // step * step, step)]
    preintegrated = [preintegrate(unit, gyro[part], accel[part], DT) for part in parts]
    given = true, unit, preintegrated, z_true, fixes, start
    return {name: estimate(weight, *given) for name, weight in modes.items()}


def main(*, runs: int = 40) -> None:
    true = truth()
    rng = np.random.default_rng(5)
    results: dict[str, list[Estimate]] = {name: [] for name in MODES}
    for _ in range(runs):
        for name, found in run(rng, true).items():
            results[name].append(found)
    fixed = round(FIXES_S / KEYFRAME_S)
    m = len(results["calibration as prior"][0].z)
    band = [m - 3.5 * np.sqrt(2.0 * m / runs), m + 3.5 * np.sqrt(2.0 * m / runs)]
    print(f"{runs} runs; NEES of {m} errors expected {m}, within {band[0]:.1f} to {band[1]:.1f}; of a pose 6")
    for name, found in results.items():
        p, a = (np.array([getattr(r, key) for r in found]) for key in ("position", "attitude"))
        rms = lambda e: np.sqrt(np.mean(np.sum(e**2, axis=-1)))  # noqa: E731
        print(
            f"{name:26s} with fixes {rms(p[:, : fixed + 1]):.3f} m, {1e3 * rms(a[:, : fixed + 1]):.2f} mrad; after 30 "
            f"s without {rms(p[:, -1]):.2f} m, {1e3 * rms(a[:, -1]):.2f} mrad; errors of the unit "
            f"{np.sqrt(np.mean([r.z**2 for r in found])):.2f} sigma; NEES {np.mean([r.nees_z for r in found]):.1f}, "
            f"pose {np.mean([r.nees_pose for r in found]):.1f}"
        )


if __name__ == "__main__":
    harness.run(main, __doc__)
