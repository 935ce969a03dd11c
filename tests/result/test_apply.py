"""Correction of readings: exact, the same for arrays and single samples, without allocation, with covariance."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from g_sensitive import with_g_sensitivity
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import block_diag

import srt
from srt.model.rotations import rotation_matrix
from srt.model.sensor_model import MIN_SINGULAR_VALUE, SIGNS, Triad, accel_triad, gyro_triad
from srt.result import triad_inverse as module
from srt.result.applier import Applier
from srt.result.calibration import Calibration
from srt.sensor_errors import N_PARAMETERS, SensorErrors

EPS = np.finfo(float).eps
U = rotation_matrix(np.array([0.1, -0.2, 0.15]))


def calibrated(vector, *, covariance=None, turned=U):
    zero = np.zeros((N_PARAMETERS, N_PARAMETERS))
    return Calibration(
        "closed-form",
        "converged",
        "Converged.",
        SensorErrors(vector),
        zero if covariance is None else covariance,
        U=turned,
    )


def triads_of(calibration):
    return gyro_triad(calibration.errors), accel_triad(calibration.errors)


def legal(triad):
    slopes = triad.matrix + SIGNS[:, :, None] * np.diag(triad.asymmetry)
    return np.linalg.svd(slopes, compute_uv=False).min() > MIN_SINGULAR_VALUE and np.linalg.det(slopes).min() > 0.0


@st.composite
def calibrations(draw):
    """Up to 50 % of every error, taken back until the readings have one inverse."""
    vector = draw(arrays(np.float64, N_PARAMETERS, elements=st.floats(-0.5, 0.5, allow_subnormal=False)))
    while not all(legal(triad) for triad in triads_of(calibrated(vector))):
        vector = 0.8 * vector
    return calibrated(vector)


# Zeros of both signs, nothing but rounding, and ordinary components.
components = st.one_of(
    st.sampled_from([0.0, -0.0, 1e-300, -1e-300, 1e-17, -1e-17, 1e-9, -1e-9]),
    st.floats(-20.0, 20.0, allow_subnormal=False),
)
vectors = arrays(np.float64, (7, 3), elements=components)


def rounding(triad, v, dt=1.0):
    """8 · condition number · machine epsilon of the value, the bias counted with it."""
    slopes = triad.matrix + SIGNS[:, :, None] * np.diag(triad.asymmetry)
    largest, smallest = (f(np.linalg.svd(slopes, compute_uv=False)) for f in (np.max, np.min))
    return 8.0 * EPS * (largest / smallest) * (np.linalg.norm(v, axis=-1) + np.linalg.norm(triad.bias) * dt / largest)


@given(calibrations(), vectors, vectors)
@settings(max_examples=150, deadline=None)
def test_apply_after_reading_is_the_identity(calibration, rate, force):
    for dt in (None, 0.01):
        scale = 1.0 if dt is None else dt
        true = rate * scale, force * scale
        # An increment is the reading of the mean rate, times its duration.
        readings = [
            Triad(t.matrix, t.asymmetry, t.bias * scale).read(v)
            for t, v in zip(triads_of(calibration), true, strict=True)
        ]
        found = Applier(calibration, block=4).apply(*readings, dt=dt)
        for triad, v, value in zip(triads_of(calibration), true, found, strict=True):
            assert np.all(np.linalg.norm(value - v, axis=1) <= rounding(triad, v, scale))


@given(calibrations(), vectors, vectors, st.sampled_from(["mars", "table"]), st.sampled_from([None, 0.01]))
@settings(max_examples=100, deadline=None)
def test_one_sample_is_the_array_to_the_last_bit(calibration, gyro, accel, frame, dt):
    applier = Applier(calibration, frame=frame, block=4)
    whole = applier.apply(gyro, accel, dt=dt)
    for i in range(len(gyro)):
        for g, a in ((gyro[i], accel[i]), (gyro[i].tolist(), tuple(accel[i].tolist()))):
            np.testing.assert_array_equal(np.array(applier.apply_sample(g, a, dt=dt)), [whole[0][i], whole[1][i]])
    np.testing.assert_array_equal(applier.apply(gyro[2], accel[2], dt=dt)[1], whole[1][2])


@given(calibrations())
@settings(max_examples=100, deadline=None)
def test_borders_of_octants(calibration):
    """Values on the axes, on the planes between them and a rounding error off, through arrays and one at a time."""
    grid = np.array(np.meshgrid(*[[-1.0, -EPS, 0.0, EPS, 1.0]] * 3)).reshape(3, -1).T
    readings = [triad.read(grid) for triad in triads_of(calibration)]
    applier = Applier(calibration)
    found = applier.apply(*readings)
    for triad, value in zip(triads_of(calibration), found, strict=True):
        assert np.all(np.linalg.norm(value - grid, axis=1) <= rounding(triad, grid))
    singles = [applier.apply_sample(g, a) for g, a in zip(*readings, strict=True)]
    np.testing.assert_array_equal(np.swapaxes(np.array(singles), 0, 1), found)


def test_search_that_does_not_end_looks_at_every_octant(monkeypatch):
    """If a single step is allowed, every sample whose first octant was wrong is solved by the search of all octants."""
    rng = np.random.default_rng(2)
    vector = np.zeros(N_PARAMETERS)
    while not (vector.any() and all(legal(triad) for triad in triads_of(calibrated(vector)))):
        vector = rng.uniform(-0.35, 0.35, N_PARAMETERS)
    calibration = calibrated(vector)
    monkeypatch.setattr(module, "STEPS", 1)
    true = rng.normal(size=(2000, 3))
    readings = [triad.read(true) for triad in triads_of(calibration)]
    taken = []
    look = module._least_inconsistent
    monkeypatch.setattr(module, "_least_inconsistent", lambda *a: taken.append(a) or look(*a))
    applier = Applier(calibration, block=500)
    found = applier.apply(*readings)
    assert taken
    for triad, value in zip(triads_of(calibration), found, strict=True):
        assert np.all(np.linalg.norm(value - true, axis=1) <= rounding(triad, true))
    singles = np.array([applier.apply_sample(g, a) for g, a in zip(*readings, strict=True)])
    np.testing.assert_array_equal(np.swapaxes(singles, 0, 1), found)


@given(calibrations(), vectors)
@settings(max_examples=50, deadline=None)
def test_agrees_with_the_compensation_of_the_estimators(calibration, y):
    found = Applier(calibration).apply(y, y)
    for triad, value in zip(triads_of(calibration), found, strict=True):
        expected = triad.compensate(y)
        assert np.all(np.linalg.norm(value - expected, axis=1) <= 2.0 * rounding(triad, expected) + 8 * EPS)


@pytest.fixture(scope="module")
def unit():
    rng = np.random.default_rng(8)
    root = rng.normal(size=(N_PARAMETERS, N_PARAMETERS)) * 1e-5
    return calibrated(rng.uniform(-0.05, 0.05, N_PARAMETERS), covariance=root @ root.T)


@pytest.fixture(scope="module")
def readings():
    rng = np.random.default_rng(9)
    return rng.normal(size=(1000, 3)), 10.0 * rng.normal(size=(1000, 3))


def test_table_frame_is_the_transpose_of_u(unit, readings):
    mars, table = (unit.apply(*readings, frame=frame) for frame in ("mars", "table"))
    for m, t in zip(mars, table, strict=True):
        np.testing.assert_allclose(t, m @ unit.U, rtol=0.0, atol=1e-14)


def test_durations_per_sample(unit, readings):
    dt = np.linspace(0.001, 0.1, len(readings[0]))
    found = unit.apply(*(r * dt[:, None] for r in readings), kind="increment", dt=dt)
    for value, rate in zip(found, unit.apply(*readings), strict=True):
        np.testing.assert_allclose(value, rate * dt[:, None], rtol=0.0, atol=1e-14)


def test_other_numbers_are_taken_as_they_are(unit, readings):
    whole = tuple(np.round(100.0 * r) for r in readings)
    expected = unit.apply(*whole)
    for given_as in (
        lambda r: r.astype(np.int16),
        lambda r: r.astype(np.float32),
        lambda r: r.tolist(),
        np.asfortranarray,
    ):
        for value, wanted in zip(unit.apply(*map(given_as, whole)), expected, strict=True):
            np.testing.assert_array_equal(value, wanted)


def test_no_samples(unit):
    gyro, accel = unit.apply(np.empty((0, 3)), np.empty((0, 3)))
    assert gyro.shape == accel.shape == (0, 3)


def test_output_arrays(unit, readings):
    expected = unit.apply(*readings)
    # In place, strided, columns of one table, one sample.
    own = tuple(r.copy() for r in readings)
    assert unit.apply(*own, out=own)[0] is own[0]
    table = np.hstack(readings)
    halves = table[:, :3], table[:, 3:]
    unit.apply(*halves, out=halves)
    strided = tuple(np.full((2000, 6), np.nan)[::2, ::2] for _ in range(2))
    unit.apply(*readings, out=strided)
    for found in (own, halves, strided):
        np.testing.assert_array_equal(found, expected)
    one = np.empty(3), np.empty(3)
    unit.apply(readings[0][5], readings[1][5], out=one)
    np.testing.assert_array_equal(one, [expected[0][5], expected[1][5]])
    lists = [0.0] * 3, np.empty(3)
    values = Applier(unit).apply_sample(readings[0][5], readings[1][5], out=lists)
    np.testing.assert_array_equal(lists, one)
    np.testing.assert_array_equal(values, one)


def test_output_arrays_that_do_not_fit_are_refused_with_nothing_written(unit, readings):
    n = len(readings[0])

    def zeros(shape=(n, 3), dtype=np.float64):
        return np.zeros(shape, dtype=dtype)

    frozen = zeros()
    frozen.flags.writeable = False
    long = np.zeros((n + 1, 3))
    same = zeros()
    for inputs, out, fragment in (
        (readings, (zeros(), zeros((n, 2))), "out for accel has the shape"),
        (readings, (zeros((n + 1, 3)), zeros()), "out for gyro has the shape"),
        (readings, (zeros(dtype=np.float32), zeros()), "float64"),
        (readings, (zeros(), zeros(dtype=int)), "float64"),
        (readings, (zeros().tolist(), zeros()), "float64"),
        (readings, (zeros(), frozen), "written"),
        (readings, (zeros(),), "out holds 1"),
        (readings, (same, same), "overlaps"),
        ((long[:-1], readings[1]), (long[1:], zeros()), "overlaps its readings"),
        ((readings[0], same), (same, zeros()), "overlaps the accelerometers"),
    ):
        with pytest.raises(srt.InputError, match=fragment):
            unit.apply(*inputs, out=out)
        assert all(not np.any(target) for target in out)


def test_bad_readings_are_refused_with_nothing_written(unit, readings):
    gyro, accel = readings
    out = np.zeros_like(gyro), np.zeros_like(accel)
    bad = accel.copy()
    bad[-1, 2] = np.nan
    infinite = gyro.copy()
    infinite[3] = [np.inf, -np.inf, 0.0]
    for arguments, options, fragment in (
        ((gyro, bad), {}, "accel readings hold values that are not finite"),
        ((infinite, accel), {}, "gyro readings hold values that are not finite"),
        ((gyro, accel[:-1]), {}, "The gyro readings have the shape"),
        ((gyro[:, :2], accel[:, :2]), {}, "is expected"),
        ((gyro[None], accel[None]), {}, "is expected"),
        ((gyro + 1j, accel), {}, "gyro has complex numbers"),
        (([["a", "b", "c"]], [[1.0, 2.0, 3.0]]), {}, "gyro does not consist of numbers"),
        (([[1.0, 2.0, 3.0], [1.0]], accel), {}, "not numbers"),
        ((gyro, accel), {"dt": 0.0}, "positive"),
        ((gyro, accel), {"dt": np.nan}, "positive"),
        ((gyro, accel), {"dt": np.full(len(gyro), np.inf)}, "positive"),
        ((gyro, accel), {"dt": "fast"}, "dt does not consist of numbers"),
        ((gyro, accel), {"dt": np.ones(3)}, "does not go with"),
    ):
        kind = {"kind": "increment"} if "dt" in options else {}
        fits = {} if np.shape(arguments[0][0]) != (3,) or len(arguments[0]) != len(gyro) else {"out": out}
        with pytest.raises(srt.InputError, match=fragment) as caught:
            unit.apply(*arguments, **options, **kind, **fits)
        assert str(caught.value).count("\n") == 0
    assert not np.any(out)
    # Large is not infinite, even if the sum of all is.
    large = np.full((40, 3), 1e307)
    assert np.isfinite(unit.apply(large, large)).all()


@pytest.mark.parametrize(
    ("gyro", "accel", "dt"),
    [
        ([0.0, math.nan, 0.0], [0.0] * 3, None),
        ([0.0] * 3, [0.0, 0.0, math.inf], None),
        ([0.0] * 2, [0.0] * 3, None),
        (np.zeros((1, 3)), np.zeros((1, 3)), None),
        ("abc", [0.0] * 3, None),
        (1.0, [0.0] * 3, None),
        ([0.0] * 3, [0.0] * 3, 0.0),
        ([0.0] * 3, [0.0] * 3, math.nan),
    ],
)
def test_bad_single_samples_are_refused(unit, gyro, accel, dt):
    with pytest.raises(srt.InputError):
        Applier(unit).apply_sample(gyro, accel, dt=dt)


def test_calibrations_that_cannot_be_applied_are_refused(unit):
    vector = np.zeros(N_PARAMETERS)
    vector[3] = 1.2  # asymmetry of more than the scale factor: x and −x/11 read the same
    with pytest.raises(srt.InputError, match="no unique inverse"):
        Applier(calibrated(vector))
    with pytest.raises(srt.InputError, match="no table frame"):
        Applier(calibrated(0.1 * vector, turned=None), frame="table")
    with pytest.raises(srt.InputError, match="no rotation"):
        Applier(calibrated(0.1 * vector, turned=1.1 * U), frame="table")
    with pytest.raises(srt.InputError, match="must be 'mars' or 'table'"):
        Applier(unit, frame="body")
    with pytest.raises(srt.InputError, match="at least one sample"):
        Applier(unit, block=0)


UFUNC_BUFFER = 8 * np.getbufsize() if np.lib.NumpyVersion(np.__version__) < "2.3.0" else 0
"""Bytes that numpy before 2.3 allocates once for a ufunc over strided arrays longer than its buffer."""


@pytest.mark.parametrize("frame", ["mars", "table"])
@pytest.mark.parametrize("kind", ["rate", "increment", "increments of uneven length"])
def test_arrays_are_corrected_without_allocation(unit, frame, kind):
    """Simultaneous allocations are views and copies of the block's few samples that need a second step."""
    applier = Applier(unit, frame=frame, block=256)
    rng = np.random.default_rng(4)
    peaks = []
    for n in (256, 64 * 256 + 17):
        gyro, accel = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
        out = np.empty((n, 3)), np.empty((n, 3))
        dt = {"rate": None, "increment": 0.01}.get(kind, np.full(n, 0.01))
        applier.apply(gyro, accel, dt=dt, out=out)
        tracemalloc.start()
        applier.apply(gyro, accel, dt=dt, out=out)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # One column of the long recording would be 128 kB.
    assert peaks[1] < peaks[0] + 16_000 + UFUNC_BUFFER
    assert peaks[1] < 50_000 + UFUNC_BUFFER


def test_rectified_noise_is_what_the_documentation_says(unit):
    """Asymmetry s leaves −s σ √(2/π) of the noise σ of a resting channel, unless the mean is corrected instead."""
    vector = np.zeros(N_PARAMETERS)
    vector[3:6] = 0.01
    sigma, n = 1.7e-3, 200_000
    noise = np.random.default_rng(3).normal(0.0, sigma, (n, 3))
    left = Applier(calibrated(vector)).apply(noise, noise)[0].mean(axis=0) - noise.mean(axis=0)
    assert left == pytest.approx(-0.01 * sigma * math.sqrt(2.0 / math.pi), rel=0.05)
    assert left[0] * srt.sensor_errors.DISPLAY_FACTORS[-1] == pytest.approx(-2.8, rel=0.05)


@pytest.mark.parametrize("frame", ["mars", "table"])
@pytest.mark.parametrize("dt", [None, 0.02])
def test_covariance_of_a_sample_is_that_of_drawn_calibrations(unit, frame, dt):
    scale = 1.0 if dt is None else dt
    gyro, accel = (
        np.array([[0.5, -1.0, 2.0], [-2.0, 0.3, 0.1]]) * scale,
        np.array([[1.0, 5.0, -9.0], [9.0, 1, 3]]) * scale,
    )
    rng = np.random.default_rng(6)
    draws = rng.multivariate_normal(unit.errors.vector, unit.covariance, 400, method="cholesky")
    values = [np.hstack(Applier(calibrated(d), frame=frame, block=2).apply(gyro, accel, dt=dt)) for d in draws]
    found = Applier(unit, frame=frame).sample_covariance(gyro, accel, dt=dt)
    assert found.shape == (2, 6, 6)
    for i in range(2):
        expected = np.cov(np.array(values)[:, i].T)
        sigma = np.sqrt(np.diag(expected))
        # 168 numbers of the four cases, 1 % in all: 4.1 standard errors, √(2/400) of a variance.
        assert np.abs((found[i] - expected) / np.outer(sigma, sigma)).max() < 4.1 * math.sqrt(2.0 / len(draws))
    single = Applier(unit, frame=frame).sample_covariance(gyro[1], accel[1], dt=dt)
    np.testing.assert_allclose(single, found[1], rtol=1e-12)


def test_covariance_is_the_derivatives(unit):
    """One parameter at a time, by differences of the applied correction: J P Jᵀ with P zero elsewhere."""
    gyro, accel = np.array([0.5, -1.0, 2.0]), np.array([1.0, 5.0, -9.0])
    for i in range(N_PARAMETERS):
        step = np.zeros(N_PARAMETERS)
        step[i] = 1e-6
        high, low = (np.hstack(Applier(calibrated(unit.errors.vector + d)).apply(gyro, accel)) for d in (step, -step))
        slope = (high - low) / 2e-6
        P = np.zeros((N_PARAMETERS, N_PARAMETERS))
        P[i, i] = 4.0
        found = Applier(calibrated(unit.errors.vector, covariance=P)).sample_covariance(gyro, accel)
        np.testing.assert_allclose(found, 4.0 * np.outer(slope, slope), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("frame", ["mars", "table"])
def test_covariance_through_the_g_sensitivity_is_the_derivatives(unit, frame):
    """Errors of the accelerometers reach the gyros through Γ, and so do errors of its nine elements, by rows."""
    rng = np.random.default_rng(10)
    matrix, root = rng.uniform(-0.05, 0.05, (3, 3)), 1e-5 * rng.normal(size=(9, 9))
    gyro, accel = np.array([0.5, -1.0, 2.0]), np.array([1.0, 5.0, -9.0])

    def at(vector, elements):
        stated = with_g_sensitivity(np.reshape(elements, (3, 3)))
        stated = replace(stated, g_sensitivity=replace(stated.g_sensitivity, covariance=root @ root.T))
        return Applier(replace(unit, errors=SensorErrors(vector), diagnostics=stated), frame=frame)

    centre = np.concatenate([unit.errors.vector, matrix.ravel()])
    J = [
        np.subtract(*(np.hstack(at(*np.split(c, [N_PARAMETERS])).apply(gyro, accel)) for c in (centre + d, centre - d)))
        / 2e-6
        for d in 1e-6 * np.eye(len(centre))
    ]
    P = block_diag(unit.covariance, root @ root.T)
    expected, found = np.transpose(J) @ P @ J, at(*np.split(centre, [N_PARAMETERS])).sample_covariance(gyro, accel)
    # Central differences: of second order 1e-12, and rounding of values below 10 over the step.
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-7)


def test_many_covariances_are_made_in_pieces(unit):
    rng = np.random.default_rng(1)
    gyro, accel = rng.normal(size=(2500, 3)), rng.normal(size=(2500, 3))
    found = Applier(unit).sample_covariance(gyro, accel)
    np.testing.assert_allclose(found[2400], Applier(unit).sample_covariance(gyro[2400], accel[2400]), rtol=1e-12)
    assert np.linalg.eigvalsh(found).min() > 0.0
    with pytest.raises(srt.InputError, match="shape"):
        Applier(unit).sample_covariance(gyro, accel[:-1])
