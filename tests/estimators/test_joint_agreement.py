"""Closed form, Kalman filter, factor graph, least squares and brute force on one linear problem: the same answer.

On a planet that does not turn, with a faultless fixture, the 68 components of Table 1 and the rest rates are all that a
recording says of a unit, and every estimator that takes the same of them must find the same. Two things keep double
precision from showing it on any data: what is of second order in the noise, relative to it, is as large as the noise,
and the rounding of angles of some radians, 1e-16 each, is seen through sigmas. Noise of 1e-8 leaves 1e-8 of a sigma
both ways. The recordings here therefore state a noise of 1e-4, which sets the weights and the sigmas, and hold a
ten-millionth of it: second order is 1e-11 of a sigma then, rounding too, and the estimates still move by 1e-7.
"""

import math
import sys
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import sims
from srt.closed_form import iteration
from srt.closed_form.formulas import SelectedFormulas
from srt.estimation.initial_estimates import initial_estimate
from srt.estimation.options import Options
from srt.model.prior import Prior
from srt.model.table1 import AXES
from srt.recording.recording import Fixture, ImuNoise, Site
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors
from srt.sequences.checked_preparation import prepare_checked

pytest.importorskip("filterpy")
pytest.importorskip("gtsam")
from ideal_table_1 import paused_table_1
from linear_problems import AGREE, EPS, IN_G, Found, G, SolveStep, difference, iterated_to_rounding, jointly

from estimators.graph import GraphSolver
from estimators.kalman_filter import KalmanSolver
from srt.joint.joint_model import JointModel
from srt.joint.least_squares import BlockSolver

# --- a planet that does not turn ------------------------------------------------------------------------------------


resolved = pytest.fixture(scope="module", autouse=True)(iterated_to_rounding)


@pytest.fixture
def still_planet(monkeypatch):
    """No Earth rate in any module that reads one; not quite none, as it is divided by."""
    read = [
        m for name, m in sys.modules.items() if name.startswith(("srt.", "estimators.")) and name != "srt.constants"
    ]
    for module in read:
        if hasattr(module, "EARTH_RATE_RAD_S"):
            monkeypatch.setattr(module, "EARTH_RATE_RAD_S", 1e-30)


OPTIONS = Options(gyro_bias="pooled", fixture_states=False, max_playbacks=12)
SMALL, SHARE = 1e-4, 1e-7
"""Stated noise, rad/√s and g √s; share of it that the data hold."""
RATE, PAUSE_S = 1.0, 0.05


@cache
def motion(sample_rate_hz, dwell_s):
    """Table 1 on a faultless fixture, a pause between two rotations so that no sample holds parts of both."""
    return paused_table_1(
        dwell_s,
        PAUSE_S,
        site=Site(G, 1e-15, math.radians(45.0)),
        sample_rate_hz=sample_rate_hz,
        stated_fixture=Fixture(0.0, 1e-12, 1e-12),
        earth_rate=False,
    )


def record(seed, *, noise, share, errors=1e-11, sample_rate_hz=200.0, dwell_s=2.0):
    """A recording that states a noise and holds a share of it; also its true errors."""
    rng = np.random.default_rng(seed)
    truth = errors * rng.standard_normal(N_PARAMETERS) * IN_G
    imu = sims.ImuModel(gyro_noise=noise * share, accel_noise=noise * share * G)
    recording = sims.read_out(motion(sample_rate_hz, dwell_s), SensorErrors(truth), imu, rng)
    return replace(recording, noise=ImuNoise(noise, noise * G, 0.0, 0.0, 0.0, 0.0)), truth


def by_play_back(data, solver):
    """The srt package's iteration with one of its solvers."""
    found = iteration.iterate(data, OPTIONS, solver, *initial_estimate(data, OPTIONS))
    assert found.status == "converged"
    return Found(found.errors.vector, found.covariance)


def used_components(data):
    """Horizontal and Down components that the closed form uses, shapes (K, 2) and (W,)."""
    used = np.abs(SelectedFormulas(data, OPTIONS).selection).sum(axis=0) > 0.0
    K = data.K
    return used[: 2 * K].reshape(K, 2), used[2 * K : -3]


def horizontal_basis(data, f_start):
    """Nominal axes of each sequence, made horizontal."""
    down = -f_start / np.linalg.norm(f_start, axis=1, keepdims=True)
    axes = np.stack([np.eye(3)[[i for i in range(3) if AXES[i] != s.down]] for s in data.catalogue])
    return axes - np.einsum("kia,ka->ki", axes, down)[..., None] * down[:, None, :]


def blind(monkeypatch, data, horizontal, down, big):
    """Give the problem's windows a noise of one sigma ``big`` along what is not to be used.

    A horizontal component lives in the end window, as the start window's only levels its attitude. A variance 1e12
    times the others' leaves 1e-12 of the information.
    """
    play = JointModel.compensate

    def compensated(self, state):
        out = play(self, state)
        unused = np.zeros((len(out.force), 3, 3))
        basis = horizontal_basis(data, out.force[data.start])
        for k, i in np.argwhere(~horizontal).tolist():
            b = out.rotation[k].T @ basis[k, i]
            unused[data.end[k]] += np.outer(b, b)
        for w in np.flatnonzero(~down).tolist():
            u = out.force[w] / np.linalg.norm(out.force[w])
            unused[w] += np.outer(u, u)
        out.force_noise["unused"] = big**2 * unused
        return out

    monkeypatch.setattr(JointModel, "compensate", compensated)


# --- brute force ----------------------------------------------------------------------------------------------------


class BruteForce:
    """The components of Table 1 and the rest rates from the raw samples, and their sigmas, by hand.

    Compensation by fixed-point iteration, attitude by scipy's rotations of the samples multiplied in pairs: exact, as
    every sample turns about one axis. Then scipy's least squares with differences of fourth order. Where the attitude
    error φ is g q √T_rot, white, every component has one sigma, and none are correlated.
    """

    def __init__(self, recording, data):
        self.data, self.dt = data, recording.nominal_interval_s
        noise, T = recording.noise, data.windows.duration_s
        lengths = data.rotation[:, 1] - data.rotation[:, 0]
        self.samples = np.zeros((data.K, 1 << int(lengths.max() - 1).bit_length(), 3))
        self.moving = np.arange(self.samples.shape[1]) < lengths[:, None]
        for k, (first, last) in enumerate(data.rotation.tolist()):
            self.samples[k, : last - first] = recording.gyro[first:last]
        self.turning_s = lengths * self.dt
        window = noise.accel_noise / np.sqrt(T)
        turn = G * noise.gyro_noise * np.sqrt(self.turning_s)
        both = np.sqrt(turn**2 + window[data.start] ** 2 + window[data.end] ** 2)
        self.sigma = np.concatenate([np.repeat(both, 2), window, np.repeat(noise.gyro_noise / np.sqrt(T), 3)])
        self.rotation = {}

    @staticmethod
    def matrices(x):
        e = SensorErrors(x).as_dict()
        xy, yz, zx = (0.5 * e[f"gyro_orthogonality_{pair}"] for pair in ("xy", "yz", "zx"))
        Mg, Ma = np.array([[0.0, xy, zx], [xy, 0.0, yz], [zx, yz, 0.0]]) + np.eye(3), np.eye(3)
        for i, a in enumerate(AXES):
            Mg[i, i] += e[f"gyro_scale_{a}"]
            for j, b in enumerate(AXES):
                Ma[i, j] += e[f"accel_scale_{a}" if i == j else f"accel_misalignment_{a}{b}"]
        return Mg, Ma

    @staticmethod
    def compensate(readings, M, asymmetry, bias):
        inverse = np.linalg.inv(M).T
        v = (readings - bias) @ inverse
        for _ in range(4):  # asymmetries of 1e-3 at most: 1e-15 after four
            v = (readings - bias - asymmetry * np.abs(v)) @ inverse
        return v

    def rotations(self, Mg, asymmetry, bias):
        """C_End of every sequence; kept, as accelerometer errors do not change it."""
        key = (Mg.tobytes(), asymmetry.tobytes(), bias.tobytes())
        if key not in self.rotation:
            angle = self.compensate(self.samples, Mg, asymmetry, bias) * self.dt * self.moving[..., None]
            C = Rotation.from_rotvec(angle.reshape(-1, 3)).as_matrix().reshape(*angle.shape[:2], 3, 3)
            while C.shape[1] > 1:
                C = C[:, 0::2] @ C[:, 1::2]
            self.rotation = {key: C[:, 0]}
        return self.rotation[key]

    def residuals(self, x):
        data = self.data
        Mg, Ma = self.matrices(x)
        asymmetry, bias = x[GROUP_SLICES["gyro_asymmetry"]], x[GROUP_SLICES["gyro_bias"]]
        C = self.rotations(Mg, asymmetry, bias)
        mean = data.windows.accel_mean
        f = self.compensate(mean, Ma, x[GROUP_SLICES["accel_asymmetry"]], x[GROUP_SLICES["accel_bias"]])
        f_start, f_end = f[data.start], np.einsum("kab,kb->ka", C, f[data.end])
        change = np.einsum("kia,ka->ki", horizontal_basis(data, f_start), f_end - f_start)
        rest = self.compensate(data.windows.gyro_mean, Mg, asymmetry, bias)
        return np.concatenate([change.ravel(), G - np.linalg.norm(f, axis=1), rest.ravel()]) / self.sigma

    def jacobian(self, x):
        """Steps of 1e-4 g or rad: some 1e-3 rad over the largest turn, of which (1e-3)⁴ and 1e-15 / 1e-4 are left."""
        h = np.full(N_PARAMETERS, 1e-4) * IN_G
        h[GROUP_SLICES["gyro_bias"]] = 1e-5
        out = []
        for i in range(N_PARAMETERS):
            d = h[i] * np.eye(N_PARAMETERS)[i]
            r = [self.residuals(x + m * d) for m in (-2.0, -1.0, 1.0, 2.0)]
            out.append((r[0] - 8.0 * r[1] + 8.0 * r[2] - r[3]) / (12.0 * h[i]))
        return np.stack(out, axis=1)

    def solve(self, x, J, rows):
        """Least squares of some rows, in units of the sigmas; the problem is linear, and one Jacobian serves."""
        sigma = np.sqrt(np.diag(np.linalg.inv(J[rows].T @ J[rows])))
        found = least_squares(
            lambda u: self.residuals(u * sigma)[rows],
            x / sigma,
            jac=lambda _: J[rows] * sigma,
            method="lm",
            xtol=4.0 * EPS,
            ftol=4.0 * EPS,
        )
        spread = sigma[:, None] * np.linalg.inv(np.linalg.qr(J[rows] * sigma, mode="r"))
        return Found(found.x * sigma, spread @ spread.T)

    def sampling(self, found, J, rows):
        """Largest error of correlations from the sampling of the estimators' Jacobian.

        Ĉ of a sample is taken as the mean of its ends, s = (ω dt)² / 12 short across the axis: no derivative of a
        horizontal component is off by more than s g times the turn in rad, or in s for a bias. To first order the
        covariance P = (JᵀJ)⁻¹ then is off by P (δJᵀ J + Jᵀ δJ) P.
        """
        data = self.data
        angle = np.array([np.abs(s.angles_rad).sum() for s in data.catalogue])
        off = np.zeros_like(J)
        share = (RATE * self.dt) ** 2 / 12.0
        off[: 2 * data.K, :9] = np.repeat(share * G * angle, 2)[:, None]
        off[: 2 * data.K, GROUP_SLICES["gyro_bias"]] = np.repeat(share * G * self.turning_s, 2)[:, None]
        off = (off / self.sigma[:, None])[rows]
        gain = np.abs(found.P @ J[rows].T)
        one_side = gain @ off @ np.abs(found.P)
        return (one_side + one_side.T) / np.outer(found.sigma, found.sigma)


# --- the same answer ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Linear:
    """One recording of the linear problem and what all who take part in the comparison need."""

    recording: object
    data: object
    truth: np.ndarray
    brute: BruteForce
    J: np.ndarray

    def by_brute_force(self, rows):
        found = self.brute.solve(np.zeros(N_PARAMETERS), self.J, rows)
        return found, self.brute.sampling(found, self.J, rows)

    def by_joint_estimation(self, sigma):
        """The filter's prior is 1e5 times wider than the result: 1e-10 of the information."""
        prior = Prior.from_sigma(1e5 * sigma, SensorErrors(self.truth))
        steps = {
            "solve": SolveStep(),
            "least-squares": BlockSolver(),
            "graph": GraphSolver("squared", None),
            "ekf": KalmanSolver(prior),
        }
        return {name: jointly(self.joint(), step) for name, step in steps.items()}

    def joint(self):
        return JointModel(self.data, OPTIONS, initial_estimate(self.data, OPTIONS))


@pytest.fixture(params=[200.0, pytest.param(1000.0, marks=pytest.mark.campaign)])
def linear(request, still_planet):
    recording, truth = record(1, noise=SMALL, share=SHARE, sample_rate_hz=request.param)
    data = prepare_checked(recording, recording.sequences, OPTIONS.average)
    brute = BruteForce(recording, data)
    return Linear(recording, data, truth, brute, brute.jacobian(truth))


def check_agreement(results, reference, brute, sampling, truth):
    """All against one, and brute force within what the sampling of the others' Jacobian explains."""
    # In what the noise moved the estimates by, too, or agreement would be idle.
    moved = float(np.abs((reference.x - truth) / reference.sigma).max())
    limit = min(AGREE, 1e-3 * moved)
    for name, found in results.items():
        estimate, covariance = difference(found, reference)
        assert estimate <= limit, name
        assert covariance <= AGREE, name
    assert difference(reference, brute)[0] <= limit
    off = np.abs(reference.P - brute.P) / np.outer(brute.sigma, brute.sigma)
    assert np.all(off <= sampling + AGREE)


def test_estimators_agree_on_the_components_of_the_closed_form(linear, monkeypatch):
    """24 components and the pooled rest rate: closed form, all joint solvers, one dense solution and brute force."""
    data = linear.data
    horizontal, down = used_components(data)
    assert horizontal.sum() + down.sum() == 24
    closed = by_play_back(data, SelectedFormulas(data, OPTIONS))
    blind(monkeypatch, data, horizontal, down, big=1e6 * SMALL * G)
    found = linear.by_joint_estimation(closed.sigma)
    brute, sampling = linear.by_brute_force(
        np.concatenate([horizontal.ravel(), down, np.ones(3 * len(down), dtype=bool)])
    )
    check_agreement(found, closed, brute, sampling, linear.truth)


def test_estimators_agree_on_all_components(linear):
    """All 68 and the rest rates: least squares, filter, graph, dense solution and brute force; the closed form is none
    of them, and its covariance nowhere below theirs.
    """
    data = linear.data
    least = jointly(linear.joint(), SolveStep())
    found = linear.by_joint_estimation(least.sigma)
    brute, sampling = linear.by_brute_force(slice(None))
    check_agreement(found, least, brute, sampling, linear.truth)
    closed = by_play_back(data, SelectedFormulas(data, OPTIONS))
    scaled = (closed.P - least.P) / np.outer(least.sigma, least.sigma)
    assert np.linalg.eigvalsh(scaled)[0] >= -N_PARAMETERS * AGREE
    # Its price is seen: up to twice the sigma and more.
    assert (closed.sigma / least.sigma).max() > 2.0
