"""Compensation inverts the reading model exactly; composition and gauge; ten readings worked by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import sims
from sims.physics.imu import noise_free_increments
from srt.exceptions import DataError
from srt.model.analytic_platform import integrate_attitude
from srt.model.gyro_stream import gyro_stream
from srt.model.sensor_model import (
    MIN_SINGULAR_VALUE,
    SIGNS,
    Triad,
    accel_triad,
    compose,
    errors_from_triads,
    gyro_triad,
    octants,
    outside_model,
    to_mars,
)
from srt.sensor_errors import GROUP_SLICES, GROUPS, N_PARAMETERS, SensorErrors

EPS = np.finfo(float).eps
G = 9.80665

# --- ten readings worked by hand ------------------------------------------------------------------------------------

# Errors of a group for x, y and z, or for the pairs in the order of their names; what is true, and what is read:
# decimals that a pencil can check.
HAND_WORKED = {
    "1: 1.01 · 2": ({"gyro_scale": (0.01, 0, 0)}, (2, 0, 0), (2.02, 0, 0)),
    "2: 1.01 · (−3) + 0.002 · 3": (
        {"gyro_scale": (0, 0.01, 0), "gyro_asymmetry": (0, 0.002, 0)}, (0, -3, 0), (0, -3.024, 0),
    ),
    "3: κxy = κyx = 0.01": ({"gyro_orthogonality": (0.02, 0, 0)}, (1, 2, 0), (1.02, 2.01, 0)),
    # x 1 − 0.02 · 2, y −1 + 0.01 · 2, z 2 − 0.02 · 1 + 0.01 · (−1)
    "4: κyz = 0.01, κzx = −0.02": ({"gyro_orthogonality": (0, 0.02, -0.04)}, (1, -1, 2), (0.96, -0.98, 1.97)),
    # x 1.1 + 0.1 · (−2) + 0.1 · 3 + 0.01 · 1 + 0.001;  y 0.9 · (−2) + 0.1 · 1 + 0.1 · 3 + 0.02 · 2 − 0.002;
    # z 1.2 · 3 + 0.1 · 1 + 0.1 · (−2) − 0.01 · 3 + 0.003
    "5: all errors of gyros": (
        {
            "gyro_scale": (0.1, -0.1, 0.2), "gyro_asymmetry": (0.01, 0.02, -0.01),
            "gyro_orthogonality": (0.2, 0.2, 0.2), "gyro_bias": (0.001, -0.002, 0.003),
        },
        (1, -2, 3), (1.211, -1.362, 3.473),
    ),
    "6: biases, z down": ({"accel_bias": (0.1, -0.2, 0.3)}, (0, 0, -9.8), (0.1, -0.2, -9.5)),
    "7: −1.001 · 10 + 0.0005 · 10": (
        {"accel_scale": (0, 0, 0.001), "accel_asymmetry": (0, 0, 0.0005)}, (0, 0, -10), (0, 0, -10.005),
    ),
    "8: 1.001 · 10 + 0.0005 · 10": (
        {"accel_scale": (0, 0, 0.001), "accel_asymmetry": (0, 0, 0.0005)}, (0, 0, 10), (0, 0, 10.015),
    ),
    # x 10 + 0.003 · (−10), z −0.002 · 10
    "9: x leans toward y, z toward x": (
        {"accel_misalignment": (0.003, 0, 0, 0, -0.002, 0)}, (10, -10, 0), (9.97, -10, -0.02),
    ),
    # x 1.01 · 1 + 0.1 · (−2) + 0.2 · 3 + 0.01 · 1 + 1;  y 1.02 · (−2) − 0.1 · 1 + 0.3 · 3 − 0.02 · 2 − 1;
    # z 0.97 · 3 + 0.4 · 1 − 0.2 · (−2) + 0.03 · 3 + 0.5
    "10: all errors of accelerometers": (
        {
            "accel_scale": (0.01, 0.02, -0.03), "accel_misalignment": (0.1, 0.2, -0.1, 0.3, 0.4, -0.2),
            "accel_asymmetry": (0.01, -0.02, 0.03), "accel_bias": (1.0, -1.0, 0.5),
        },
        (1, -2, 3), (2.42, -2.28, 4.3),
    ),
}  # fmt: skip


def by_group(groups):
    vector = np.zeros(N_PARAMETERS)
    for group, values in groups.items():
        vector[GROUP_SLICES[group]] = values
    return SensorErrors(vector)


@pytest.mark.parametrize(("groups", "true", "reading"), HAND_WORKED.values(), ids=HAND_WORKED)
def test_readings_worked_by_hand(groups, true, reading):
    errors = by_group(groups)
    of_gyros = next(iter(groups)).startswith("gyro")
    triad = gyro_triad(errors) if of_gyros else accel_triad(errors)
    # At most six terms of at most 10, each good to a rounding error.
    tolerance = 6 * 10 * EPS
    np.testing.assert_allclose(triad.read(true), reading, rtol=0, atol=tolerance)
    np.testing.assert_allclose(triad.compensate(reading), true, rtol=0, atol=4 * tolerance)
    # The simulator has matrices of its own; the other sensor reads nothing.
    both = np.array([[true], np.zeros((1, 3))][:: 1 if of_gyros else -1], dtype=float)
    motion = SimpleNamespace(
        interval=1.0, angle=both[0], angle_abs=np.abs(both[0]), velocity=both[1], velocity_abs=np.abs(both[1])
    )
    found = noise_free_increments(motion, errors)[:: 1 if of_gyros else -1]
    np.testing.assert_allclose(found[0][0], reading, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(found[1][0], 0.0)


def test_hand_worked_readings_use_every_error():
    used = np.sum([by_group(groups).vector != 0.0 for groups, _, _ in HAND_WORKED.values()], axis=0)
    assert (used > 0).all()


# --- apply then compensate is the identity --------------------------------------------------------------------------


def legal(triad):
    """True if the reading model has one inverse: every octant's matrix is right-handed and not nearly singular."""
    slopes = triad.matrix + SIGNS[:, :, None] * np.diag(triad.asymmetry)
    smallest = np.linalg.svd(slopes, compute_uv=False)[:, -1].min()
    return smallest > MIN_SINGULAR_VALUE and np.linalg.det(slopes).min() > 0.0


unit = st.floats(-0.5, 0.5, allow_subnormal=False)


@st.composite
def triads(draw):
    """Gyro or accelerometer triads with up to 50 % of every error, taken back until they are invertible."""
    triad_of = draw(st.sampled_from([gyro_triad, accel_triad]))
    vector = draw(arrays(np.float64, N_PARAMETERS, elements=unit))
    while not legal(triad_of(SensorErrors(vector))):
        vector = 0.8 * vector
    return triad_of(SensorErrors(vector))


# Components that try the octant borders: zeros of both signs, nothing but rounding, and ordinary ones.
components = st.one_of(
    st.sampled_from([0.0, -0.0, 1e-300, -1e-300, 1e-17, -1e-17, 1e-9, -1e-9]),
    st.floats(-20.0, 20.0, allow_subnormal=False),
)
vectors = arrays(np.float64, (5, 3), elements=components)


def rounding(triad, v):
    """Bound of the error of compensate(read(v)).

    With γ = n·eps/2 for a sum of n terms: reading has 5 products and sums, γ₅ (|M| + |S|)|v| + |b|; taking the bias
    off one more; the inverse of a 3 × 3 matrix and its product bring a backward error of some 2·3·eps/2 each. In sum
    below 8 eps · ‖D‖ · (‖(|M| + |S|)|v|‖ + ‖b‖) with D the worst inverse slope: 8 · cond · eps of the value.
    """
    absolute = np.abs(triad.matrix) + np.diag(np.abs(triad.asymmetry))
    D = np.linalg.norm(triad.inverses, 2, axis=(1, 2)).max()
    sizes = np.linalg.norm(np.abs(v) @ absolute.T, axis=-1) + np.linalg.norm(triad.bias)
    return 8.0 * EPS * D * sizes


@given(triads(), vectors)
@settings(max_examples=150, deadline=None)
def test_compensate_inverts_read(triad, v):
    found = triad.compensate(triad.read(v))
    assert np.all(np.linalg.norm(found - v, axis=1) <= rounding(triad, v))


@given(triads(), vectors)
@settings(max_examples=100, deadline=None)
def test_read_inverts_compensate(triad, y):
    """Onto: every reading has a value that reads so."""
    v = triad.compensate(y)
    slope = np.linalg.norm(np.abs(triad.matrix) + np.diag(np.abs(triad.asymmetry)), 2)
    assert np.all(np.linalg.norm(triad.read(v) - y, axis=1) <= slope * rounding(triad, v) + 8 * EPS * 20)


@given(triads())
@settings(max_examples=100, deadline=None)
def test_compensation_on_the_borders_of_octants(triad):
    """Values on the axes, on the planes between them and a rounding error off."""
    grid = np.array(np.meshgrid(*[[-1.0, -EPS, 0.0, EPS, 1.0]] * 3)).reshape(3, -1).T
    found = triad.compensate(triad.read(grid))
    assert np.all(np.linalg.norm(found - grid, axis=1) <= rounding(triad, grid))
    # One at a time or all together, in any shape.
    single = triad.compensate(triad.read(grid[7]))
    assert np.linalg.norm(single - grid[7]) <= rounding(triad, grid[7])
    np.testing.assert_array_equal(triad.compensate(triad.read(grid).reshape(5, 25, 3)), found.reshape(5, 25, 3))


@given(triads(), vectors)
@settings(max_examples=100, deadline=None)
def test_sensitivity_is_the_slope_of_the_compensation(triad, v):
    v = v + np.where(v < 0.0, -1.0, 1.0)  # away from the borders, where there is no slope
    reading = triad.read(v)
    # Piecewise linear: within an octant a difference of any size is exact. D · step must not reach the border.
    D = np.linalg.norm(triad.inverses, 2, axis=(1, 2)).max()
    step = 0.5 / D
    for j, d in enumerate(step * np.eye(3)):
        slope = (triad.compensate(reading + d) - triad.compensate(reading - d)) / (2 * step)
        error = np.linalg.norm(slope - triad.sensitivity(v)[:, :, j], axis=1)
        assert np.all(error <= 2 * rounding(triad, v) / step)


def test_stream_of_gyro_samples_is_compensated_as_exactly():
    """Integration compensates increments by blocks, with up to 30 % of scale, asymmetry and orthogonality error."""
    rng = np.random.default_rng(31)
    checked = 0
    for _ in range(60):
        vector = np.zeros(N_PARAMETERS)
        vector[:9] = rng.uniform(-0.3, 0.3, 9)
        triad = gyro_triad(SensorErrors(vector))
        if not legal(triad):
            continue
        # One sample per sequence: what it turned is its compensated increment.
        true = rng.normal(size=(400, 3)) * 10.0 ** rng.uniform(-4.0, 0.0, (400, 3))
        spans = np.stack([np.arange(400), np.arange(1, 401)], axis=1)
        stream = gyro_stream(triad.read(true), 0.01, spans, spans, rates=True)
        found = integrate_attitude(stream, triad, np.zeros((400, 3)))[0].angle / 0.01
        assert np.all(np.linalg.norm(found - true, axis=1) <= 2 * rounding(triad, true))
        checked += 1
    assert checked > 30


# --- composition ----------------------------------------------------------------------------------------------------


def random_errors(rng, size, asymmetry):
    vector = size * rng.uniform(-1.0, 1.0, N_PARAMETERS)
    if not asymmetry:
        vector[GROUP_SLICES["gyro_asymmetry"]] = vector[GROUP_SLICES["accel_asymmetry"]] = 0.0
    return SensorErrors(vector)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_composed_errors_compensate_like_both_in_turn(seed):
    """Exactly, without asymmetry: D(δ) D(x) y = D(x ∘ δ) y up to the gauge's rotation."""
    rng = np.random.default_rng(seed)
    errors, delta = random_errors(rng, 0.25, False), random_errors(rng, 0.15, False)
    composed, U = compose(errors, delta.vector)
    reading = rng.normal(size=(10, 3))
    for triad_of in (gyro_triad, accel_triad):
        twice = triad_of(delta).compensate(triad_of(errors).compensate(reading))
        once = triad_of(composed).compensate(reading)
        bound = rounding(triad_of(errors), twice) + rounding(triad_of(delta), twice)
        D = np.prod([np.linalg.norm(np.linalg.inv(triad_of(e).matrix), 2) for e in (errors, delta)])
        np.testing.assert_array_less(np.linalg.norm(once - twice @ U.T, axis=1), 8 * D * bound + 8 * EPS)
    np.testing.assert_allclose(U @ U.T, np.eye(3), atol=8 * EPS)
    assert np.linalg.det(U) > 0.0


def test_composed_asymmetry_holds_to_first_order():
    """Halving all errors quarters what is left: it is of second order, an asymmetry seen through a misalignment."""
    rng = np.random.default_rng(3)
    errors, delta = random_errors(rng, 1.0, True), random_errors(rng, 1.0, True)
    reading = rng.normal(size=(50, 3))
    reading += np.sign(reading)  # no component changes its sign on the way
    for triad_of in (gyro_triad, accel_triad):
        left = []
        for t in (2e-3, 1e-3):
            x, d = SensorErrors(t * errors.vector), SensorErrors(t * delta.vector)
            composed, U = compose(x, d.vector)
            twice = triad_of(d).compensate(triad_of(x).compensate(reading))
            left.append(np.abs(triad_of(composed).compensate(reading) - twice @ U.T).max())
        # The next order is t times some units: below 3 %.
        assert left[0] / left[1] == pytest.approx(4.0, rel=0.03)
        assert left[1] < 50 * (1e-3) ** 2


def test_errors_and_triads_are_two_forms_of_the_same():
    errors = random_errors(np.random.default_rng(2), 0.5, True)
    again = errors_from_triads(gyro_triad(errors), accel_triad(errors))
    np.testing.assert_allclose(again.vector, errors.vector, rtol=0, atol=2 * EPS)  # (1 + x) − 1


# --- gauge ----------------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_mars_reads_the_same_with_turned_axes(seed):
    """Any gyro matrix is P·U: readings of ω_T by the one are those of U ω_T by the other; so are accelerometers'."""
    rng = np.random.default_rng(seed)
    R = sims.rotation(rng.uniform(-3.0, 3.0, 3) / np.sqrt(3))  # any orientation, not only a small one
    P0 = np.eye(3) + 0.1 * rng.uniform(-1, 1, (3, 3))
    gyro = Triad(P0 @ P0.T @ R, np.zeros(3), rng.normal(size=3))
    accel = Triad(np.eye(3) + 0.3 * rng.uniform(-1, 1, (3, 3)), np.zeros(3), rng.normal(size=3))
    errors, U = to_mars(gyro, accel)
    cond = np.linalg.cond(gyro.matrix)
    np.testing.assert_allclose(U @ U.T, np.eye(3), atol=16 * EPS)
    assert np.linalg.det(U) > 0.0
    np.testing.assert_allclose(U, R, atol=32 * cond * EPS)
    P = gyro_triad(errors).matrix
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0.0
    ω = rng.normal(size=(10, 3))
    atol = 32 * EPS * max(np.linalg.norm(gyro.matrix, 2), 2.0) * np.abs(ω).max()
    np.testing.assert_allclose(gyro_triad(errors).read(ω @ U.T), gyro.read(ω), atol=atol)
    np.testing.assert_allclose(accel_triad(errors).read(ω @ U.T), accel.read(ω), atol=atol)


@pytest.mark.parametrize(
    "matrix",
    [np.diag([1.0, -1.0, 1.0]), np.eye(3)[[1, 0, 2]], np.diag([1.0, 1.0, 0.0])],
    ids=["flipped", "swapped", "dead"],
)
def test_left_handed_gyros_are_refused(matrix):
    nothing = np.zeros(3)
    with pytest.raises(DataError, match="left-handed"):
        to_mars(Triad(matrix, nothing, nothing), Triad(np.eye(3), nothing, nothing))


# --- limits ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({}, None),
        ({"gyro_scale_x": 0.5, "accel_scale_y": -0.5, "accel_misalignment_xy": 0.3}, None),
        ({"gyro_scale_x": -1.5}, "gyro matrix is not positive definite"),
        # Off-diagonal above the diagonal: x and y swapped, say.
        ({"gyro_orthogonality_xy": 2.5}, "gyro matrix is not positive definite"),
        ({"accel_scale_z": -2.0}, "accelerometer triad has the opposite handedness to the gyros"),
        ({"gyro_scale_y": -0.9}, "gyro axes are nearly coplanar (smallest singular value 0.100)"),
        ({"accel_scale_y": -0.86}, "accelerometer axes are nearly coplanar (smallest singular value 0.140)"),
        ({"accel_scale_y": -0.84}, None),
    ],
)
def test_outside_model_says_what_is_wrong(named, message):
    found = outside_model(SensorErrors.from_dict(named))
    assert found is None if message is None else message in found


def test_octants_number_the_signs():
    np.testing.assert_array_equal(octants(SIGNS), np.arange(8))
    np.testing.assert_array_equal(octants(np.zeros((1, 3))), [0])


QUADRATIC = replace(GROUPS[3], name="accel_quadratic", effect=lambda f: (f**2)[..., None] * np.eye(3))
"""A group of errors that the list does not have."""


@pytest.mark.parametrize("units", [(), (2,)])
def test_further_errors_are_read_and_compensated(units):
    rng = np.random.default_rng(20261129)
    matrix = np.eye(3) + 0.05 * rng.normal(size=(*units, 3, 3))
    further = ((QUADRATIC, 1e-3 * rng.normal(size=(*units, 3))),)
    triad = Triad(matrix, 0.01 * rng.normal(size=(*units, 3)), rng.normal(size=(*units, 3)), further)
    v = 10.0 * rng.normal(size=(*units, 40, 3))
    of_unit = [triad.of(u) for u in range(2)] if units else [triad]
    readings = np.reshape([one.read(w) for one, w in zip(of_unit, v.reshape(-1, 40, 3), strict=True)], v.shape)
    np.testing.assert_allclose(triad.compensate(readings), v, atol=1e-13)
    one, w, y = of_unit[0], v.reshape(-1, 40, 3)[0], readings.reshape(-1, 40, 3)[0]
    expected = w @ one.matrix.T + one.asymmetry * np.abs(w) + one.bias + one.further[0][1] * w**2
    np.testing.assert_allclose(y, expected, atol=1e-13)
    step = 1e-5
    differences = [(one.compensate(y + d) - one.compensate(y - d)) / (2.0 * step) for d in step * np.eye(3)]
    # The effect is of second order: central differences have rounding alone, 1e-15 of 30 over the step.
    np.testing.assert_allclose(one.sensitivity(w), np.stack(differences, axis=-1), atol=1e-8)
