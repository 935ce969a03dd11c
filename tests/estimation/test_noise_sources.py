"""Sources of the measurement covariance one by one, against differences of the simulator or of the samples.

A mutation of one source changes its own test: an alignment error times zero, or a sign of a window's edge.
"""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from injected_faults.injection import Case
from scipy.stats import chi2

import srt
from sims.physics.fixture import FixtureDraw
from sims.physics.imu import ImuModel, read_out
from sims.physics.table_motion import table1_motion
from srt.closed_form import measurement_covariance
from srt.constants import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, EARTH_RATE_RAD_S, MICRO_G
from srt.estimation import error_sources
from srt.estimation.error_sources import shared_edges
from srt.estimation.options import Options
from srt.estimation.srt_measurements import SrtProcessor
from srt.model import analytic_platform
from srt.model.rotations import rotation_matrix
from srt.recording.recording import Fixture, Site
from srt.sensor_errors import N_PARAMETERS, NAMES, SensorErrors
from srt.sequences.checked_preparation import prepare_checked

SEQUENCES = ("1", "7", "13")
K = len(SEQUENCES)
DWELL_S = 4.0
RATE_HZ = 400.0
"""Rate at which attitude integration has errors below 1e-12 rad."""
SITE = Site(9.80665, 5e-6, 0.8)
FIXTURE = Fixture(0.3, 1e-3, 1e-3, wobble_sigma_rad=1e-3)
PERFECT = SensorErrors(np.zeros(N_PARAMETERS))
QUIET = ImuModel(
    gyro_noise=0.002 * DEG_PER_SQRT_H,
    accel_noise=5.0 * MICRO_G,
    gyro_quantization=0.5 * ARCSEC,
    accel_quantization=1e-5,
    gyro_bias_instability=0.002 * DEG_PER_H,
    accel_bias_instability=2.0 * MICRO_G,
)


@cache
def motion(sequences=SEQUENCES):
    return table1_motion(
        site=SITE, sequences=sequences, sample_rate_hz=RATE_HZ, stated_fixture=FIXTURE, heading_rad=0.3, dwell_s=DWELL_S
    )


def processed(recording):
    """Prepared data and measurements of a recording, compensated with no errors and processed with a true mounting."""
    data = prepare_checked(recording, recording.sequences, "linear")
    return data, SrtProcessor(data, Options()).process(PERFECT, with_noise=True)


def simulated(site=SITE, draw=None):
    """Measurement vector of a noise-free unit at a site, on a fixture with a draw of errors; the site is as stated."""
    run = table1_motion(
        site=site, sequences=SEQUENCES, sample_rate_hz=RATE_HZ, stated_fixture=FIXTURE, heading_rad=0.3,
        dwell_s=DWELL_S, fixture_draw=draw,
    )  # fmt: skip
    return processed(read_out(run.stated_as(site=SITE), PERFECT, ImuModel(), np.random.default_rng(0)))[1].z


@cache
def quiet():
    return processed(read_out(motion(), PERFECT, QUIET, np.random.default_rng(1)))


def effects(data, measurements, name):
    """Effect of all shared unit draws of a source on the measurements, shape (n_z, S)."""
    source = measurement_covariance.disturbances(measurements, data, np.zeros(3))[name]
    return measurement_covariance.effect(measurement_covariance.projection(measurements, data, np.zeros(3)), source)


def covariance(data, measurements, name):
    """Covariance of the measurements by a source, shape (n_z, n_z)."""
    source = measurement_covariance.disturbances(measurements, data, np.zeros(3))[name]
    projected = measurement_covariance.projection(measurements, data, np.zeros(3))
    return measurement_covariance.covariance(projected, [source])


@cache
def noise_free():
    return processed(read_out(motion(), PERFECT, ImuModel(), np.random.default_rng(0)))


STEP = 1e-3
"""Angle of the differences, rad: their relative error is STEP² / 6."""
EARTH_ANGLE = EARTH_RATE_RAD_S * 25.0
"""Rotation of the Earth during the longest sequence, rad."""
POSE_DRAWS = (
    lambda at: FixtureDraw(starts=np.stack([at, 0.0 * at], axis=1)),
    lambda at: FixtureDraw(starts=np.stack([0.0 * at, at], axis=1)),
    lambda at: FixtureDraw(wobble=np.stack([at, 0.0 * at], axis=1)),
)
"""Errors of the start poses, by their size in every sequence."""
ALIGNMENT = {
    "level x": lambda e: FixtureDraw(base=np.array([e, 0.0, 0.0])),
    "level y": lambda e: FixtureDraw(base=np.array([0.0, e, 0.0])),
    "north": lambda e: FixtureDraw(base=np.array([0.0, 0.0, e])),
    "non-orthogonality": lambda e: FixtureDraw(non_orthogonality=e),
} | {
    f"{axis} {k}": lambda e, k=k, i=i: POSE_DRAWS[i](e * np.eye(K)[k])
    for k in range(K)
    for i, axis in enumerate(("inner angle", "outer angle", "wobble"))
}


@pytest.mark.parametrize("name", ALIGNMENT)
def test_alignment_against_the_simulator(name):
    """Errors of base, axes and start angles act through the Earth's rate; with the vertical measured, north alone."""
    column = effects(*noise_free(), "earth_rate_alignment")[:, list(ALIGNMENT).index(name)]
    e = ALIGNMENT[name]
    found = (simulated(draw=e(STEP)) - simulated(draw=e(-STEP))) / (2.0 * STEP) * FIXTURE.alignment_sigma_rad
    # The sign of a draw is arbitrary. The largest column is that of north.
    size = np.abs(effects(*noise_free(), "earth_rate_alignment")).max()
    # The rest rates neglect the Earth's rotation squared; so do the windows, for a tilt that is undone by the end.
    allowed = EARTH_ANGLE**2 * size
    if name.startswith("wobble"):
        allowed += (EARTH_RATE_RAD_S * DWELL_S) ** 2 / 8.0 * SITE.gravity_m_s2 * FIXTURE.wobble
    assert min(np.abs(found - column).max(), np.abs(found + column).max()) <= allowed
    if name in ("north", "wobble 1"):  # the inner axis is horizontal in sequence 7: the wobble is a heading there
        assert np.abs(column).max() > 0.25 * size


def test_gravity_against_the_simulator():
    step = 1e-3
    sites = [replace(SITE, gravity_m_s2=SITE.gravity_m_s2 + sign * step) for sign in (1.0, -1.0)]
    plus, minus = (simulated(site) for site in sites)
    found = (plus - minus) / (2.0 * step) * SITE.gravity_sigma_m_s2
    column = effects(*noise_free(), "gravity")[:, 0]
    # Stated gravity is the nominal one: a true excess is an error of the opposite sign.
    np.testing.assert_allclose(found, -column, atol=1e-6 * np.abs(column).max())


def test_edges_of_windows_against_the_samples():
    """An angle moved across the edge of a window changes the rest rate and the rotation with opposite signs.

    The edge error of a rotation's start and that of its end are shared with the windows beside it: the difference and
    not the sum of both effects is left, which a wrong sign would show.
    """
    recording = read_out(motion(), PERFECT, ImuModel(gyro_quantization=1.0 * ARCSEC), np.random.default_rng(2))
    data, measurements = processed(recording)
    edges = shared_edges(data)
    columns = effects(data, measurements, "gyro_quantization")
    columns = columns.reshape(len(columns), -1, 3)
    dt, e, flipped = recording.nominal_interval_s, 1e-8, 0
    for w, samples in enumerate(data.windows.samples.tolist()):
        for side, sample in enumerate(samples):
            if w in (data.end if side else data.start):
                continue  # beyond it begins another sequence, whose window would change, too
            for axis in range(3):
                z = []
                for sign in (1.0, -1.0):
                    gyro = recording.gyro.copy()
                    gyro[sample - 1, axis] += sign * e / dt
                    gyro[sample, axis] -= sign * e / dt
                    z.append(processed(replace(recording, gyro=gyro))[1].z)
                found = (z[0] - z[1]) / (2.0 * e) * data.noise.gyro_edge[axis]
                column = columns[:, edges[w, side], axis]
                for rows in (slice(0, 2 * K), slice(len(found) - 3, None)):  # rotations and rest rates
                    size = np.abs(columns[rows]).max()
                    # One sample of a rotation of 1 rad/s turns the axes by 0.01 rad.
                    assert np.abs(found - column)[rows].max() <= 0.02 * size, (w, side, axis)
                    flipped += np.abs(found + column)[rows].max() > 0.5 * size
    # A wrong sign of any kind of edge would be seen: at starts and ends of rotations, and in the rest rates.
    assert flipped >= 6 * K


def test_biases_of_sequences_carry_errors_of_rates_into_rotations():
    """Rates of single windows changed in the samples; each sequence takes a share of its own rest rate as its bias."""
    recording, gain, step = noise_free()[0].recording, np.array([0.3, 0.6, 0.9]), 1e-6

    def vector(gyro):
        data = prepare_checked(replace(recording, gyro=gyro), recording.sequences, "linear")
        processor = SrtProcessor(data, Options())
        offset = gain * processor.process(PERFECT).bias_by_sequence
        return processor.process(PERFECT, bias_offset=offset).z

    data, measurements = noise_free()
    for w, (a, b) in enumerate(data.windows.samples.tolist()):
        expected = measurement_covariance.projection(measurements, data, gain)["rate"][:, w]
        for axis in range(3):
            plus, minus = recording.gyro.copy(), recording.gyro.copy()
            plus[a:b, axis] += step
            minus[a:b, axis] -= step
            found = (vector(plus) - vector(minus)) / (2.0 * step)
            # The Earth's rotation over a sequence, and rounding of attitudes over the step.
            atol = 2.0 * EARTH_ANGLE * np.abs(expected).max() + 1e-13 / step
            np.testing.assert_allclose(found, expected[:, axis], rtol=0, atol=atol)
            rotations = np.abs(expected[: 2 * K, axis]).max()
            assert rotations > 10.0 * atol or rotations == 0.0


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_drift_against_the_samples(sensor, monkeypatch):
    """Covariance of the drift from steps of the bias in all windows and in three parts of every rotation."""
    monkeypatch.setattr(analytic_platform, "_PARTS", (2, 3))
    monkeypatch.setattr("srt.sequences.preparation._values_of_schedule", lambda _: {})
    recording = read_out(motion(), PERFECT, QUIET, np.random.default_rng(3))
    data, measurements = processed(recording)
    table, floor = (
        (recording.gyro, data.noise.gyro_flicker) if sensor == "gyro" else (recording.accel, data.noise.accel_flicker)
    )
    samples, draws = data.windows.samples, data.drift
    ends = analytic_platform.equal_parts(data.rotation, draws.parts.shape[1])
    spans = [*samples.tolist(), *np.stack([ends[:, :-1], ends[:, 1:]], axis=2).reshape(-1, 2).tolist()]
    values = np.concatenate([draws.windows, draws.parts.reshape(-1, draws.parts.shape[2])])
    if sensor == "accel":
        values, spans = data.window_drift, spans[: len(samples)]
    step, columns = {"gyro": 1e-8, "accel": 1e-6}[sensor], []
    for axis in range(3):
        for course in values.T:
            z = []
            for sign in (1.0, -1.0):
                changed = table.copy()
                for (a, b), value in zip(spans, course.tolist(), strict=True):
                    changed[a:b, axis] += sign * step * value
                z.append(processed(replace(recording, **{sensor: changed}))[1].z)
            columns.append((z[0] - z[1]) / (2.0 * step) * floor[axis])
    found, G = np.array(columns).T, effects(data, measurements, f"{sensor}_bias_instability")
    expected, covariance = found @ found.T, G @ G.T
    unit = np.sqrt(np.diag(expected))
    # The Earth turns the drift and, by the measured vertical, the Earth's rate turns with that of the accelerometers.
    blocks = np.split(unit, [2 * K, len(unit) - 3])  # horizontal, down, rates at rest
    size = np.concatenate([np.full(len(part), part.max()) for part in blocks])
    # Specific forces act on the rates at rest through the Earth's rate alone, which is neglected.
    seen = G.any(axis=1)
    assert np.all((np.abs(covariance - expected) <= 2.0 * EARTH_ANGLE * np.outer(size, size))[np.ix_(seen, seen)])
    assert np.all(unit[: 2 * K] > 0.0)


SOURCES = {
    "gyro_noise": {"gyro_noise": QUIET.gyro_noise},
    "gyro_quantization": {"gyro_quantization": QUIET.gyro_quantization},
    "gyro_bias_instability": {"gyro_bias_instability": QUIET.gyro_bias_instability},
    "accel_noise": {"accel_noise": QUIET.accel_noise},
    "accel_quantization": {"accel_quantization": QUIET.accel_quantization},
    "accel_bias_instability": {"accel_bias_instability": QUIET.accel_bias_instability},
}


MANY = SEQUENCES * 12


@cache
def many():
    """Motion of many sequences at 50 Hz, prepared data and measurements of a quiet unit, and those without noise."""
    run = table1_motion(
        site=SITE, sequences=MANY, sample_rate_hz=50.0, stated_fixture=FIXTURE, heading_rad=0.3, dwell_s=DWELL_S
    )
    data, measurements = processed(read_out(run, PERFECT, QUIET, np.random.default_rng(1)))
    still = processed(read_out(run, PERFECT, ImuModel(), np.random.default_rng(0)))[1].z
    return run, data, measurements, still


@pytest.mark.parametrize("units", [12, pytest.param(25, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("name", SOURCES)
def test_monte_carlo_of_one_source(name, units):
    """Units of 36 sequences with one source of noise: chi-square of the measurements, 1e-3 over the sources.

    With some 70 degrees of freedom each, 25 units show a source that is 10 % too small, 12 units one that is 15 % too
    small. Quantization has a random walk of 0.6 pulses in a window, which is part of the expected covariance: without
    it the pulses of an axis at rest do not change, and their error is not random.
    """
    run, data, measurements, still = many()
    R, imu = covariance(data, measurements, name), replace(ImuModel(), **SOURCES[name])
    if name.endswith("quantization"):
        white = {"gyro_quantization": "gyro_noise", "accel_quantization": "accel_noise"}[name]
        imu = replace(imu, **{white: 0.3 * SOURCES[name][name]})
        R = R + covariance(data, measurements, white) * (0.3 * SOURCES[name][name] / SOURCES[white][white]) ** 2
    row = np.sqrt(np.diag(R))
    scale = np.where(row > 0.0, row, 1.0)
    variance, U = np.linalg.eigh(R / np.outer(scale, scale))
    kept = variance > 1e-6 * variance[-1]
    rng, total = np.random.default_rng(20261125), 0.0
    for _ in range(units):
        recording = replace(read_out(run, PERFECT, imu, rng), noise=data.recording.noise)
        z = (processed(recording)[1].z - still) / scale
        total += float(np.sum((U[:, kept].T @ z) ** 2 / variance[kept]))
    freedom = units * int(kept.sum())
    assert chi2.ppf(1e-3 / 12.0, freedom) < total < chi2.isf(1e-3 / 12.0, freedom), total / freedom


def test_rates_of_the_windows_have_their_own_noise():
    """Ten units of 72 windows: chi-square of the window rates, of which the measurements hold the pooled mean alone."""
    run, data, measurements, _ = many()
    R = error_sources.white_noise(data, measurement_covariance.slopes_of(measurements))["gyro_noise"].own["rate"]
    imu, rng, total = replace(ImuModel(), **SOURCES["gyro_noise"]), np.random.default_rng(20261126), 0.0
    still = processed(read_out(run, PERFECT, ImuModel(), np.random.default_rng(0)))[1].rate
    for _ in range(10):
        off = processed(replace(read_out(run, PERFECT, imu, rng), noise=data.recording.noise))[1].rate - still
        total += float(np.sum(off * np.linalg.solve(R, off[:, :, None])[:, :, 0]))
    freedom = 10 * still.size
    assert chi2.ppf(5e-4, freedom) < total < chi2.isf(5e-4, freedom), total / freedom


def test_forces_of_the_windows_have_their_own_quantization():
    """Ten units of 72 windows, each with and without quantization of the same noise: chi-square of the difference."""
    run, data, measurements, _ = many()
    R = error_sources.quantization(data, measurement_covariance.slopes_of(measurements))["accel_quantization"]
    step, freedom, total = QUIET.accel_quantization, 0, 0.0
    for seed in range(10):
        coarse, fine = (
            processed(
                replace(
                    read_out(
                        run,
                        PERFECT,
                        ImuModel(accel_noise=0.3 * step, accel_quantization=quantum),
                        np.random.default_rng((20261127, seed)),
                    ),
                    noise=data.recording.noise,
                )
            )[1].force
            for quantum in (step, 0.0)
        )
        off = coarse - fine
        total += float(np.sum(off * np.linalg.solve(R.own["force"], off[:, :, None])[:, :, 0]))
        freedom += off.size
    # The errors of the edges are even and not normal: the variance of their squares is smaller.
    assert chi2.ppf(5e-4, freedom) < total < chi2.isf(5e-4, freedom), total / freedom


def test_earth_rate_over_a_sequence_is_integrated_to_the_second_order():
    """An Earth that turns a hundred times faster: 0.2 rad in a sequence, of which the third power over 24 is left."""
    _, measurements = noise_free()
    fast = replace(measurements, earth_rate=100.0 * measurements.earth_rate)
    found = measurement_covariance._of_earth_rate(fast, np.broadcast_to(np.eye(3), (K, 3, 3)))["turn"]
    for k, T in enumerate(measurements.integrals.weight_s.tolist()):
        times = (np.arange(2000) + 0.5) * T / 2000
        expected = rotation_matrix(-times[:, None] * fast.earth_rate[k]).mean(axis=0) * T
        angle = np.linalg.norm(fast.earth_rate[k]) * T
        np.testing.assert_allclose(found[k], expected, rtol=0, atol=1.1 * T * angle**3 / 24.0)


def marginal(source, kind):
    """Covariance of every measurement of a kind by itself, own and shared parts."""
    total = np.array(source.own[kind])
    for number, effect in source.shared.get(kind, ()):
        used = np.asarray(number) >= 0
        total[used] += np.broadcast_to(effect @ np.swapaxes(effect, 1, 2), total.shape)[used]
    return total


def test_shared_noise_is_a_part_of_that_of_each_measurement():
    """Whatever window and rotation share, each alone has the covariance of the model without sharing."""
    data, measurements = quiet()
    by = measurement_covariance.slopes_of(measurements)
    alone = error_sources.white_noise(data, by)["gyro_noise"]
    together = error_sources.white_noise(data, by, np.ones(len(data.windows.duration_s), dtype=bool))["gyro_noise"]
    edges = error_sources.quantization(data, by)["gyro_quantization"]
    independent = error_sources.quantization(data, by, shared=False)["gyro_quantization"]
    for kind in ("rate", "turn"):
        np.testing.assert_allclose(marginal(together, kind), alone.own[kind], rtol=1e-12, atol=1e-30)
        np.testing.assert_allclose(marginal(edges, kind), independent.own[kind], rtol=1e-12, atol=1e-30)
    # The unit has no errors: compensated rates have the noise of the readings.
    expected = np.einsum("waa->wa", alone.own["rate"] + independent.own["rate"])
    np.testing.assert_allclose(
        error_sources.raw_rate_variance(data.noise, data.windows.duration_s), expected, rtol=1e-12
    )


def test_earth_rate_of_unknown_direction():
    """Mean squares of the unknown components add up to the squared length of what has no direction."""
    recording = quiet()[0].recording
    nowhere = replace(recording, site=replace(SITE, latitude_rad=None))
    no_north = replace(recording, fixture=replace(FIXTURE, heading_rad=None))
    for stated, length in ((nowhere, EARTH_RATE_RAD_S), (no_north, EARTH_RATE_RAD_S * np.cos(SITE.latitude_rad))):
        sigma = error_sources.unknown_earth_rate(stated, placed=True)
        np.testing.assert_allclose(np.linalg.norm(sigma), length, rtol=1e-12)
    assert not error_sources.unknown_earth_rate(recording, placed=True).any()


FIXED_SIGMA_OF = {
    "closed-form": "srt.closed_form.estimator",
    "least-squares": "srt.joint.calibration_run",
    "graph": "srt.joint.calibration_run",
    "ekf": "srt.joint.calibration_run",
}
"""Module of each estimator that asks for the sigma of fixed values."""


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares", "graph", "ekf"])
def test_fixed_values_against_changed_ones(estimator, monkeypatch):
    """The contribution of a fixed value with a sigma is half the change of the result from one sigma below to above."""
    pytest.importorskip("gtsam" if estimator == "graph" else "numpy")
    pytest.importorskip("filterpy" if estimator == "ekf" else "numpy")
    case, name, size = Case("tactical-fog", 5), "gyro_orthogonality_xy", 1e-4
    at, truth = NAMES.index(name), case.simulation.truth.vector
    sigma = np.where(np.arange(N_PARAMETERS) == at, size, 0.0)
    monkeypatch.setattr(f"{FIXED_SIGMA_OF[estimator]}.fixed_sigma", lambda _data, _options: sigma)
    below, above = (
        srt.calibrate(case.recording, estimator, hold=(name,), start=SensorErrors(truth + sign * sigma), checks=False)
        for sign in (-1.0, 1.0)
    )
    change = 0.5 * np.abs(above.errors.vector - below.errors.vector)
    contribution = above.contributions["held_values"]
    others = np.arange(N_PARAMETERS) != at
    assert contribution[others].max() > 0.1 * size
    # Each of the two iterations ends within 0.01 sigma; the rest is of second order.
    assert np.all(np.abs(contribution - change)[others] <= 1e-3 * size + 0.02 * above.sigma[others])


def test_noise_of_an_integrated_window_acts_on_its_rotation_as_its_samples_do():
    """φ over a window grows from 0 to 1 times the angle: the sum of the squares, over the white noise of a sample."""
    data, measurements = quiet()
    windows = replace(data.windows, gyro_excess=np.zeros((len(data.windows.samples), 3)))
    w, excess = int(data.start[0]), 1e-12
    windows.gyro_excess[w, 1] = excess
    by = measurement_covariance.slopes_of(measurements)
    integrated = np.arange(len(windows.duration_s)) == w
    found = error_sources.excess_of_turns(replace(data, windows=windows), by, integrated)
    share = np.arange(1, round(DWELL_S * RATE_HZ) + 1) * (1.0 / (DWELL_S * RATE_HZ))
    effect = by.rate[w][:, 1]
    expected = np.sum(share**2) / RATE_HZ * excess * np.outer(effect, effect)
    np.testing.assert_allclose(found[0], expected, rtol=2e-3, atol=1e-6 * expected.max())
    assert not found[1:].any()


@pytest.mark.parametrize(("sensor", "kind"), [("gyro", "rate"), ("accel", "force")])
def test_a_noisier_window_adds_the_variance_of_its_own_mean(sensor, kind):
    """White noise of the density S has the variance S / T in a mean over T, beside that of all windows."""
    data, measurements = quiet()
    by, name = measurement_covariance.slopes_of(measurements), f"{sensor}_excess"
    w, excess = int(data.start[1]), 1e-6
    windows = replace(data.windows, **{name: np.zeros((len(data.windows.samples), 3))})
    before = error_sources.white_noise(replace(data, windows=windows), by)[f"{sensor}_noise"].own[kind]
    getattr(windows, name)[w, 1] = excess
    added = error_sources.white_noise(replace(data, windows=windows), by)[f"{sensor}_noise"].own[kind] - before
    effect = getattr(by, kind)[w][:, 1]
    np.testing.assert_allclose(added[w], excess / DWELL_S * np.outer(effect, effect), rtol=1e-6, atol=1e-9 * excess)
    assert not np.delete(added, w, axis=0).any()


def test_an_integrated_window_has_a_twelfth_of_its_noise_besides_its_mean():
    """The variance of φ by white noise S is S T / 3 over a window; its mean, of which φ has half, explains S T / 4."""
    data, measurements = quiet()
    w, excess = int(data.start[0]), 1e-6
    by, integrated = measurement_covariance.slopes_of(measurements), np.arange(len(data.windows.duration_s)) == w
    windows = replace(data.windows, gyro_excess=np.zeros((len(data.windows.samples), 3)))
    before = error_sources.white_noise(replace(data, windows=windows), by, integrated)["gyro_noise"].own["turn"]
    windows.gyro_excess[w, 1] = excess
    after = error_sources.white_noise(replace(data, windows=windows), by, integrated)["gyro_noise"].own["turn"]
    effect = by.rate[w][:, 1]
    expected = DWELL_S / 12.0 * excess * np.outer(effect, effect)
    np.testing.assert_allclose((after - before)[0], expected, rtol=1e-6, atol=1e-9 * excess)
    assert not (after - before)[1:].any()


@pytest.mark.parametrize("shared", [True, False])
def test_a_rounding_that_noise_does_not_dither_shifts_the_whole_window(shared):
    """Means of windows have its variance, whatever their length; rotations have none of it.

    The channels are turned to one another, so that a derivative is not its own transpose.
    """
    data, measurements = quiet()
    by, step = measurement_covariance.slopes_of(measurements), np.array([1e-3, 2e-3, 3e-3])
    by = by._replace(rate=by.rate @ rotation_matrix(np.array([0.3, -0.2, 0.5])))
    plain, stepped = (replace(data.noise, gyro_step=size, accel_step=size) for size in (np.zeros(3), step))
    parts = {"windows": data.windows, "start": data.start, "end": data.end}
    before, after = (
        error_sources.quantization(SimpleNamespace(noise=noise, **parts), by, shared=shared)
        for noise in (plain, stepped)
    )
    for name, kind in (("gyro_quantization", "rate"), ("accel_quantization", "force")):
        effect = getattr(by, kind) * step
        added = after[name].own[kind] - before[name].own[kind]
        np.testing.assert_allclose(added, effect @ np.swapaxes(effect, -1, -2), rtol=1e-6, atol=1e-12)
    # The errors at its two edges are shared with the rotations next to them.
    alone = np.sum(shared_edges(data) < 0, axis=1) if shared else np.full(len(by.rate), 2)
    edge = by.rate * plain.gyro_edge / data.windows.duration_s[:, None, None]
    expected = alone[:, None, None] * edge @ np.swapaxes(edge, -1, -2)
    np.testing.assert_allclose(
        before["gyro_quantization"].own["rate"], expected, rtol=1e-12, atol=1e-12 * edge.max() ** 2
    )
    turns = (found["gyro_quantization"].own["turn"] for found in (before, after))
    np.testing.assert_array_equal(*turns)
    of_means = (error_sources.raw_rate_variance(noise, data.windows.duration_s) for noise in (stepped, plain))
    np.testing.assert_allclose(np.subtract(*of_means), np.tile(step**2, (len(data.windows.duration_s), 1)), rtol=1e-6)
