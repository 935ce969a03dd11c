"""Jacobians of joint estimation: rotations, the measurements of windows and turns, and the whole linearised problem.

Measurements are held against the simulator's own geometry, Jacobians against differences of what they linearise: the
functions of the model by small rotations of scipy's, the system by playing the recording back at other points, and
what a reading error at a window's edge does by putting it into the samples. The factors of the graph are held against
the rows of the system.
"""

from dataclasses import replace

import numpy as np
import pytest
from jacobian_cases import CASES, EPS, HZ, RATE, VARIANTS, G, make, simulated_motions

from srt.estimation.error_sources import shared_edges
from srt.joint.iteration import apply_correction
from srt.joint.linear_system import FIXTURE, N_ERRORS
from srt.joint.linearisation import linearise
from srt.joint.recording_opening import open_joint_model
from srt.model import analytic_platform
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.noise import markov_drift
from srt.sensor_errors import GROUP_SLICES


@pytest.fixture(scope="module")
def motions():
    return simulated_motions()


def unwhitened_residuals(system):
    """Residuals of every kind of rows in their own units."""
    return {
        rows.kind: np.linalg.solve(system.whitening[rows.kind], system.b[rows.index][..., None])[..., 0]
        for rows in system.rows
    }


def unwhitened(system):
    """Residuals and Jacobians of every kind of rows in their own units."""
    A, residuals = system.A.toarray(), unwhitened_residuals(system)
    return {
        rows.kind: (residuals[rows.kind], np.linalg.solve(system.whitening[rows.kind], A[rows.index]))
        for rows in system.rows
    }


STEPS = {"base": 1e-4, "mounting": 1e-4, "non_orthogonality": 1e-4, "gravity": 1e-3, "earth_rate": 1e-6}
STEPS |= {"attitude": 1e-4, "bias": 1e-7, "table_rate": 1e-3}
ERROR_STEPS = np.full(N_ERRORS, 1e-5)
ERROR_STEPS[GROUP_SLICES["accel_bias"]] = 1e-4


def step_of(name, i):
    return float(ERROR_STEPS[i]) if name == "errors" else STEPS[name]


def allowed(case, kind, name, shape):
    """Largest difference between the Jacobian's rows of a kind, columns of a name, and numerical differences.

    Every central difference is off by step² times the third derivative (over 6, left as margin) and by the rounding of
    the residual over the step. In addition:

    * Ĉ of a sample is the mean of its ends, (ω dt)²/12 off its integral;
    * a bias of one sequence's own is taken off the compensated rate by the mean slope of both signs, a common one by
      the slope of the sign that rules: an asymmetry apart;
    * the compensated bias deviation moves with the matrices, a product of two errors;
    * the Earth's own left Jacobian stands to first order.
    """
    gyro, accel = gyro_triad(case.errors), accel_triad(case.errors)
    D = np.linalg.norm(gyro.inverses, 2, axis=(1, 2)).max()
    D_accel = np.linalg.norm(accel.inverses, 2, axis=(1, 2)).max()
    two_sided = np.linalg.norm(gyro.inverses - np.linalg.inv(gyro.matrix), 2, axis=(1, 2)).max()
    deviation = np.linalg.norm(case.state.bias_deviation, axis=1).max()
    ω = 1e-4
    seconds = case.system.compensated.duration_s.max()
    angle = RATE * seconds
    h = np.array([step_of(name, i) for i in range(shape[-1])])
    # Left when the residual turns with a vector of the size given, by the angle h.
    turning = {"force": G, "rate": ω, "turn": 2.0, "start": 4.0, "end": 4.0, "base": 1.0, "mounting": 1.0}
    turning = (turning | {"heading": 2.0, "stated_rate": ω}).get(kind, 0.0)
    rounding = {"force": G * D_accel, "rate": 1e-2 * D, "turn": 10.0}.get(kind, 10.0) * 10.0 * EPS / h
    own = two_sided * (name == "bias" and case.joint.bias_walks)
    size = D * (seconds if name == "bias" else angle)
    of_errors = {
        "force": 3.0 * G * D_accel**4 * h**2,
        "rate": 3.0 * ω * D**4 * h**2 + D**2 * deviation + own,
        "turn": size * ((RATE / HZ) ** 2 / 12.0 + (h * size) ** 2) + (D**2 * deviation + own) * seconds,
        "stated_rate": 3.0 * RATE * D**4 * h**2,
    }
    of_earth = {"turn": seconds * ((ω * seconds) ** 2 + (h * seconds) ** 2)}
    for of_turn in (of_errors, of_earth):
        of_turn["heading"] = of_turn["turn"]
    left = {"errors": of_errors, "bias": of_errors, "earth_rate": of_earth}.get(name, {}).get(kind, 0.0)
    if name in {"attitude", "base", "mounting", "non_orthogonality"}:
        left = turning * h**2
    return left + rounding


@pytest.mark.parametrize(("variant", "size"), CASES)
def test_system_against_played_back_differences(motions, variant, size):
    """Every column but the edges', whose unknowns are in no residual."""
    case = make(motions, VARIANTS[variant], size)
    joint, system = case.joint, case.system
    found = unwhitened(system)
    of_data = np.isin(
        np.arange(len(system.active)), np.concatenate([system.columns.of("errors"), system.columns.of("bias")])
    )
    moved = joint.compensate(apply_correction(case.state, system.columns, np.where(of_data, 0.0, 1e-2)))
    for name in ("force", "rate", "rotation"):  # the other unknowns do not change the compensated data
        np.testing.assert_array_equal(getattr(moved, name), getattr(system.compensated, name))

    def residuals(delta):
        state = apply_correction(case.state, system.columns, delta)
        compensated = joint.compensate(state) if delta[of_data].any() else system.compensated
        return unwhitened_residuals(linearise(joint, state, compensated, system.free, case.prior))

    seen = set()
    for name in ("errors", "bias", *FIXTURE, "gravity", "table_rate", "earth_rate", "attitude"):
        columns = system.columns.of(name)
        if not columns.size:
            continue
        expected = {kind: np.empty((*r.shape, len(columns))) for kind, (r, _) in found.items()}
        for i, column in enumerate(columns.tolist()):
            delta = np.zeros(len(system.active))
            delta[column] = step = step_of(name, i)
            plus, minus = residuals(delta), residuals(-delta)
            for kind, out in expected.items():
                out[..., i] = (plus[kind] - minus[kind]) / (2.0 * step)
        for kind, (_, J) in found.items():
            block, tolerance = J[..., columns], allowed(case, kind, name, (len(columns),))
            worst = np.unravel_index(np.argmax(np.abs(block - expected[kind]) - tolerance), block.shape)
            assert np.all(np.abs(block - expected[kind]) <= tolerance), (kind, name, worst, block[worst])
            if block.any():
                seen.add((kind, name))
                # So that nothing of the size of a coefficient could hide.
                assert np.abs(block).max() > 10.0 * np.max(tolerance), (kind, name)
    assert {("force", "attitude"), ("rate", "attitude"), ("turn", "attitude"), ("turn", "errors")} <= seen
    if VARIANTS[variant].fixture_states and not VARIANTS[variant].free:
        assert {(kind, n) for kind in ("start", "end") for n in ("attitude", *FIXTURE)} <= seen
        assert {("force", "gravity"), ("gravity", "gravity"), *zip(FIXTURE, FIXTURE, strict=True)} <= seen
    if VARIANTS[variant].rates:
        names = "errors", "bias", "table_rate", "earth_rate", "attitude"
        assert {("table_rate", "table_rate"), *(("stated_rate", name) for name in names)} <= seen
        assert {("heading", name) for name in ("errors", "bias", "earth_rate", "attitude")} <= seen
    if VARIANTS[variant].prior:
        assert {("prior", "errors"), ("prior", "bias")} <= seen
    if VARIANTS[variant].walk:
        assert ("walk", "bias") in seen
    if not (VARIANTS[variant].heading and VARIANTS[variant].latitude):
        assert {(k, "earth_rate") for k in ("rate", "turn", "earth_rate:0")} <= seen


def test_priors_have_the_means_and_sigmas_stated(motions):
    case = make(motions, VARIANTS["all"], "large")
    residuals, whitening = unwhitened_residuals(case.system), case.system.whitening
    np.testing.assert_allclose(residuals["prior"][0], case.state.errors.vector - case.prior.mean.vector, atol=64 * EPS)
    W = whitening["prior"][0]
    np.testing.assert_allclose(W.T @ W @ case.prior.covariance, np.eye(W.shape[1]), atol=1e-12)
    sigma = case.joint.data.recording.fixture.alignment_sigma_rad
    for kind in FIXTURE:
        np.testing.assert_allclose(np.abs(whitening[kind][0]), np.eye(len(whitening[kind][0])) / sigma, rtol=1e-12)


@pytest.mark.parametrize(
    ("variant", "size"), [pytest.param("all", "zero", marks=pytest.mark.slow), ("all", "large"), ("free", "large")]
)
def test_edge_columns_against_errors_in_the_samples(motions, variant, size):
    """A reading of the angle at a window's edge that is off: the sample before has it more, the one after has it less.

    Away from the data it was taken from, the problem's residual is minus what its unknown takes off.
    """
    case = make(motions, VARIANTS[variant], size)
    joint, system = case.joint, case.system
    data = joint.data
    edges = shared_edges(data)
    assert edges.max() + 1 == 2 * data.K
    found = unwhitened(system)
    dt, e = 1.0 / HZ, 1e-8
    gyro = gyro_triad(case.errors)
    D = np.linalg.norm(gyro.inverses, 2, axis=(1, 2)).max()
    two_sided = np.linalg.norm(gyro.inverses - np.linalg.inv(gyro.matrix), 2, axis=(1, 2)).max()
    # The angle of the first sample of a turn: the error comes before, within and after it.
    within = 10.0 * dt**2 * D

    def residuals(sample, axis, size):
        rates = data.recording.gyro.copy()
        rates[sample - 1, axis] += size / dt
        rates[sample, axis] -= size / dt
        other = open_joint_model(replace(data.recording, gyro=rates), joint.options)
        return unwhitened_residuals(linearise(other, case.state, other.compensate(case.state), system.free, case.prior))

    sigma = data.noise.gyro_edge
    for w, side in np.argwhere(edges >= 0).tolist():
        sample = int(data.windows.samples[w, side])
        columns = system.columns.of("edge")[3 * edges[w, side] :][:3]
        for axis, column in enumerate(columns.tolist()):
            plus, minus = residuals(sample, axis, e), residuals(sample, axis, -e)
            for kind in ("force", "rate", "turn"):
                J = found[kind][1][..., column] / sigma[axis]
                expected = -(plus[kind] - minus[kind]) / (2.0 * e)
                scale = 1.0 / data.windows.duration_s.min() if kind == "rate" else 1.1
                rounding = 1e-14 * (0.1 if kind == "rate" else G) / e
                tolerance = scale * (D * within + two_sided) + rounding
                assert np.abs(J - expected).max() <= tolerance, (kind, w, side, axis)
                assert kind == "force" or np.abs(J).max() > 20.0 * tolerance


@pytest.mark.parametrize(
    ("variant", "size"),
    [
        *(pytest.param(*each, marks=pytest.mark.slow) for each in (("drift", "zero"), ("rates, drift", "large"))),
        ("drift", "large"),
    ],
)
def test_drift_columns_against_drift_in_the_samples(motions, variant, size, monkeypatch):
    """Steps of the bias from window to part of a turn to window, of every draw, in the samples: the same covariance.

    With two parts of each turn, which is as good a test as twelve and faster. Away from the data it was taken from,
    the problem's residual is minus what its unknown takes off.
    """
    monkeypatch.setattr(analytic_platform, "_PARTS", (2, 2))
    monkeypatch.setattr("srt.sequences.preparation._values_of_schedule", lambda _: {})
    monkeypatch.setattr(markov_drift, "CARRIED_S", 0.0)  # every process has a state: no approximation is left
    case = make(motions, VARIANTS[variant], size)
    joint, system = case.joint, case.system
    data, draws = joint.data, joint.data.drift
    windows = data.windows.samples
    ends = analytic_platform.equal_parts(data.rotation, draws.parts.shape[1])
    spans = [*windows.tolist(), *np.stack([ends[:, :-1], ends[:, 1:]], axis=2).reshape(-1, 2).tolist()]
    values = np.concatenate([draws.windows, draws.parts.reshape(-1, draws.parts.shape[2])])
    found = unwhitened(system)
    kinds = [kind for kind in ("force", "rate", "turn", "heading", "stated_rate") if kind in found]
    drift = np.concatenate([system.columns.of(name) for name in system.columns if "drift" in name])
    prior = np.concatenate(
        [found[rows.kind][1].reshape(-1, len(system.active)) for rows in system.rows if "drift" in rows.kind]
    )
    columns = np.concatenate([found[kind][1][..., drift].reshape(-1, len(drift)) for kind in kinds])
    columns = columns @ np.linalg.inv(prior[:, drift])

    def residuals(instability, sensor, axis):
        table = getattr(data.recording, sensor).copy()
        for (a, b), value in zip(spans, instability.tolist(), strict=True):
            table[a:b, axis] += value
        other = open_joint_model(replace(data.recording, **{sensor: table}), joint.options)
        rows = unwhitened_residuals(linearise(other, case.state, other.compensate(case.state), system.free, case.prior))
        return np.concatenate([rows[kind].ravel() for kind in kinds])

    effects = []
    for sensor, step in (("gyro", 1e-8), ("accel", 1e-6)):
        floor = {"gyro": data.noise.gyro_flicker, "accel": data.noise.accel_flicker}[sensor]
        for axis in range(3):
            for draw in np.eye(values.shape[1]):
                instability = step * values @ draw
                change = residuals(instability, sensor, axis) - residuals(-instability, sensor, axis)
                effects.append(change * floor[axis] / (2.0 * step))
    effects = np.array(effects).T
    expected, own = effects @ effects.T, columns @ columns.T
    unit = np.sqrt(np.diag(expected))
    assert np.all(unit > 0.0)
    # Ĉ of a sample is the mean of its ends, 1e-5 off; where the sign of a channel changes within a turn, an asymmetry
    # takes the drift by another slope there than the mean of both.
    gyro = gyro_triad(case.errors)
    two_sided = np.linalg.norm(gyro.inverses - np.linalg.inv(gyro.matrix), 2, axis=(1, 2)).max()
    tolerance = 1e-4 + 2.0 * two_sided
    assert np.all(np.abs(own - expected) <= tolerance * np.outer(unit, unit))
