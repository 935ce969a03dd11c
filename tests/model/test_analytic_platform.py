"""Attitude integration against motions whose attitude is known in closed form."""

import math
from itertools import pairwise

import numpy as np
import pytest
from platform_streams import EPS, PERFECT, legs
from scipy.spatial.transform import Rotation

from srt.model import analytic_platform
from srt.model.analytic_platform import integrate_attitude
from srt.model.gyro_stream import gyro_stream
from srt.model.sensor_model import Triad, gyro_triad
from srt.sensor_errors import SensorErrors

# --- integration of motions known in closed form --------------------------------------------------------------------


def one_stream(increments, dt, **more):
    """Increments of shape (n, 3) as one sequence."""
    n = len(increments)
    whole = np.array([[0, n]])
    return gyro_stream(np.asarray(increments), dt, whole, whole, rates=False, **more)


@pytest.mark.parametrize("angle_per_sample", [1e-6, 0.01, 0.2, 0.3, 1.0, 3.0])
def test_constant_body_rate_is_exact_for_any_angle_per_sample(angle_per_sample):
    u = np.array([0.36, -0.48, 0.8])
    n = 500
    found, _ = integrate_attitude(one_stream(np.tile(u * angle_per_sample, (n, 1)), 0.02), PERFECT, np.zeros((1, 3)))
    expected = Rotation.from_rotvec(u * angle_per_sample * n).as_matrix()
    # The sum of n angles is known to n/2 of their rounding errors, in ours and in the reference.
    np.testing.assert_allclose(found.C_end[0], expected, rtol=0, atol=(16 + n * angle_per_sample) * EPS)
    np.testing.assert_allclose(found.angle[0], u * angle_per_sample * n, rtol=n * EPS)


def increments_of(rate, dt, n):
    """Integrals over n intervals of a rate given as a function of time, by 8-point Gauss quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    t = (np.arange(n)[:, None] + 0.5 * (nodes + 1.0)) * dt
    return 0.5 * dt * np.einsum("nqa,q->na", rate(t), weights)


def one_by_one(increments):
    """Attitude after rotations by the bare increments, without any coning term."""
    C = Rotation.identity()
    for step in Rotation.from_rotvec(increments):
        C = C * step
    return C.as_matrix()


def test_integral_of_a_turn_about_the_earths_axis_points_to_its_middle():
    """Rates of turn and Earth add up: ∫ Ĉ dt turns by half the angle on the Earth, ∫ exp(iωt) dt = T e^(iωT/2) sinc.

    The Earth's mean turn is that at the middle of the sequence; any other share of it would turn the integral.
    """
    n, dt, rate, earth = 1000, 0.01, 0.3, 1e-3
    found, _ = integrate_attitude(
        one_stream(np.tile([0.0, 0.0, (rate + earth) * dt], (n, 1)), dt), PERFECT, np.array([[0.0, 0.0, earth]])
    )
    C = found.time[0]
    np.testing.assert_allclose(np.arctan2(C[1, 0], C[0, 0]), 0.5 * rate * n * dt, rtol=n * EPS)
    np.testing.assert_allclose(Rotation.from_matrix(found.C_end[0]).as_rotvec()[2], rate * n * dt, rtol=n * EPS)


def test_earth_rate_in_a_turning_body_at_50_hz():
    """The coning that the Earth's rate makes in a turning body: 1.5e-8 rad without its term, below 1e-11 with it.

    One turn about y in 8 s that starts and ends gently: β(t) = 2π (τ − sin(2πτ)/2π), τ = t/T. The body then stands
    as it did, so that its attitude on the Earth is known.
    """
    earth = 7.292115e-5 * np.array([math.cos(0.8), 0.0, -math.sin(0.8)])
    duration, dt = 8.0, 0.02
    n = round(duration / dt)

    def rate(t):
        τ = t / duration
        β, β_dot = 2 * np.pi * τ - np.sin(2 * np.pi * τ), 2 * np.pi / duration * (1 - np.cos(2 * np.pi * τ))
        x = np.cos(β) * earth[0] - np.sin(β) * earth[2]  # R_y(β)ᵀ ω_e
        z = np.sin(β) * earth[0] + np.cos(β) * earth[2]
        return np.stack([x, β_dot, z], axis=-1)

    increments = increments_of(rate, dt, n)
    found, _ = integrate_attitude(one_stream(increments, dt), PERFECT, earth[None])
    assert np.abs(found.C_end[0] - np.eye(3)).max() < 1e-11
    earth_back = Rotation.from_rotvec(-earth * duration).as_matrix()
    without = np.abs(earth_back @ one_by_one(increments) - np.eye(3)).max()
    # Per radian turned (β̇ dt)²/12 · ω_e/β̇: at the mean rate of 0.8 rad/s over 2π it is 1.2e-8 rad.
    assert 0.5e-8 < without < 3e-8
    np.testing.assert_allclose(found.angle[0], [0.0, 2 * math.pi, 0.0], rtol=0, atol=1e-12)


def coning_rate(amplitude, frequency, duration):
    """Rate of a body whose rotation vector runs around a cone that opens and closes: a(t) [cos Wt, sin Wt, 0]."""

    def rate(t):
        a = amplitude * np.sin(np.pi * t / duration) ** 2
        a_dot = amplitude * np.pi / duration * np.sin(2 * np.pi * t / duration)
        u = np.stack([np.cos(frequency * t), np.sin(frequency * t), 0 * t], axis=-1)
        u_dot = frequency * np.stack([-u[..., 1], u[..., 0], 0 * t], axis=-1)
        phi, phi_dot = a[..., None] * u, a_dot[..., None] * u + a[..., None] * u_dot
        # ω = φ̇ − (1 − cos φ)/φ² φ×φ̇ + (φ − sin φ)/φ³ φ×(φ×φ̇); with |φ| = a its series avoids 0/0.
        a2 = (a**2)[..., None]
        first = np.cross(phi, phi_dot)
        one = 1 / 2 - a2 * (1 / 24 - a2 * (1 / 720 - a2 / 40320))
        two = 1 / 6 - a2 * (1 / 120 - a2 * (1 / 5040 - a2 / 362880))
        return phi_dot - one * first + two * np.cross(phi, first)

    return rate


def test_classical_coning_converges_with_the_sixth_power_of_the_interval():
    """Each interval is wrong by its seventh power, so that half the interval leaves a 64th of the drift."""
    amplitude, frequency, duration = 0.2, 2 * math.pi, 4.0
    rate = coning_rate(amplitude, frequency, duration)
    errors, bare = [], []
    counts = (100, 200, 400)
    for n in counts:
        increments = increments_of(rate, duration / n, n)
        found, _ = integrate_attitude(one_stream(increments, duration / n), PERFECT, np.zeros((1, 3)))
        errors.append(np.abs(found.C_end[0] - np.eye(3)).max())
        bare.append(np.abs(one_by_one(increments) - np.eye(3)).max())
    for (coarse, fine), n in zip(pairwise(errors), counts, strict=False):
        # Next in size is a relative (2 W dt)²: the correction reaches over two intervals on either side.
        assert coarse / fine == pytest.approx(64.0, rel=(2.0 * frequency * duration / n) ** 2)
    for coarse, fine, n in zip(bare[:-1], bare[1:], counts, strict=False):
        # Without the term it is the second power.
        assert coarse / fine == pytest.approx(4.0, rel=(frequency * duration / n) ** 2)
    # W a²/2 · (W dt)²/6 of drift without the term. A sin² envelope has a mean a² of 3/8 of the peak's, two thirds of it
    # at W and a sixth each at W (1 ± 1/4), and the drift goes with the cube; sin a is not a: a² of it.
    drift = duration * frequency * 0.375 * amplitude**2 / 2 * (frequency * duration / counts[0]) ** 2 / 6
    drift *= 2 / 3 + (1.25**3 + 0.75**3) / 6
    assert bare[0] == pytest.approx(drift, rel=amplitude**2)
    assert errors[0] < (frequency * duration / counts[0]) ** 4 * bare[0]


# --- streams --------------------------------------------------------------------------------------------------------


def random_recording(n, seed=0, size=0.02):
    """Smoothly varying increments that never commute."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(size=(n, 3)), axis=0)
    return size * np.sin(walk / 20.0 + [0.0, 1.0, 2.0])


def test_a_stream_gathers_its_spans():
    gyro = random_recording(30)
    spans, rotation = np.array([[5, 15], [20, 25]]), np.array([[7, 12], [20, 25]])
    stream = gyro_stream(gyro, 0.01, spans, rotation, rates=False)
    np.testing.assert_array_equal(stream.increments, np.concatenate([gyro[5:15], gyro[20:25]]).T)
    np.testing.assert_array_equal(stream.starts, [0, 10, 15])
    np.testing.assert_array_equal(stream.rotation, [[2, 7], [10, 15]])
    np.testing.assert_array_equal(stream.interval_s, 0.01)
    # Intervals of their own, and a stream shorter than the smoothing.
    interval = np.linspace(0.01, 0.02, 30)
    stream = gyro_stream(gyro, interval, spans, rotation, rates=True)
    inside = np.r_[5:15, 20:25]
    np.testing.assert_array_equal(stream.interval_s, interval[inside])
    np.testing.assert_array_equal(stream.increments, gyro[inside].T * interval[inside])
    assert stream.smooth.shape == (3, 15)


def test_samples_beside_a_span_do_not_matter():
    """Beyond its edges may lie a gap, or another sequence: no coning term reaches across."""
    gyro = random_recording(40)
    spans = np.array([[5, 15], [15, 22], [30, 31], [32, 34]])
    earth = np.zeros((4, 3))
    found, _ = integrate_attitude(gyro_stream(gyro, 0.01, spans, spans, rates=False), PERFECT, earth)
    other = 10.0 * np.random.default_rng(3).normal(size=gyro.shape)
    for k, (a, b) in enumerate(spans.tolist()):
        mixed = other.copy()
        mixed[a:b] = gyro[a:b]
        alone, _ = integrate_attitude(gyro_stream(mixed, 0.01, spans, spans, rates=False), PERFECT, earth)
        np.testing.assert_allclose(alone.C_end[k], found.C_end[k], rtol=0, atol=32 * EPS)
    single = Rotation.from_rotvec(gyro[30]).as_matrix()
    np.testing.assert_allclose(found.C_end[2], single, rtol=0, atol=32 * EPS)
    pair = (Rotation.from_rotvec(gyro[32]) * Rotation.from_rotvec(gyro[33])).as_matrix()
    np.testing.assert_allclose(found.C_end[3], pair, rtol=0, atol=32 * EPS)


@pytest.mark.parametrize(
    "profile",
    [
        np.full(50, 0.02),  # from full rate to full rate
        0.02 * np.sin(np.linspace(0.02, np.pi - 0.02, 50)),
        0.004 * (25.0 - np.abs(np.arange(50) - 24.5)),  # ramps that end and begin at the edge of a sample
    ],
    ids=["steps", "sines", "ramps"],
)
def test_a_kink_between_legs_invents_no_coning(profile):
    """About one axis at a time the attitude is the product of the legs, exactly, however abruptly they change."""
    increments = legs((0, profile), (1, profile), (2, -profile), (1, 2 * profile))
    found, _ = integrate_attitude(one_stream(increments, 0.01), PERFECT, np.zeros((1, 3)))
    total = profile.sum()
    expected = (
        Rotation.from_rotvec([total, 0, 0])
        * Rotation.from_rotvec([0, total, 0])
        * Rotation.from_rotvec([0, 0, -total])
        * Rotation.from_rotvec([0, 2 * total, 0])
    ).as_matrix()
    np.testing.assert_allclose(found.C_end[0], expected, rtol=0, atol=(16 + 4 * len(increments)) * EPS)


def test_a_rate_that_changes_linearly_gets_its_whole_coning_term():
    """φ = Δθ_i + Δθ_i × (Δθ_{i+1} − Δθ_{i−1}) / 24 inside; the first and the last sample have no change."""
    increments = 0.01 * np.array([1.0, -0.6, 0.8]) + np.outer(np.arange(20.0), [1e-4, 2e-4, -3e-4])
    found, _ = integrate_attitude(one_stream(increments, 0.01), PERFECT, np.zeros((1, 3)))
    change = np.zeros_like(increments)
    change[1:-1] = (increments[2:] - increments[:-2]) / 2.0
    expected = one_by_one(increments + np.cross(increments, change) / 12.0)
    np.testing.assert_allclose(found.C_end[0], expected, rtol=0, atol=64 * EPS)


def test_rates_and_increments_are_the_same_stream():
    rates = random_recording(50, size=1.0)
    spans = np.array([[3, 20], [25, 45]])
    for interval in (0.004, np.full(50, 0.004)):
        a = gyro_stream(rates, interval, spans, spans, rates=True)
        b = gyro_stream(rates * 0.004, interval, spans, spans, rates=False)
        for name in ("increments", "smooth", "interval_s"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0, atol=4 * EPS, err_msg=name)


ERRORS = gyro_triad(
    SensorErrors.from_dict(
        {
            "gyro_scale_x": 0.02,
            "gyro_orthogonality_yz": 0.03,
            "gyro_asymmetry_y": 0.01,
            "gyro_asymmetry_z": -0.02,
            "gyro_bias_x": 0.001,
        }
    )
)
FIELDS = ("C_end", "rate", "abs_rate", "time", "weight_s", "angle", "noise")


def assert_same(a, b, n):
    """Same sums in another order: rounding of n terms of an integral of size up to n · 0.02."""
    for name in FIELDS:
        atol = 4 * EPS * max(n, 64)
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-12, atol=atol, err_msg=name)


@pytest.mark.parametrize("weighted", [False, True])
def test_blocks_leave_no_trace(monkeypatch, weighted):
    """A stream of more than two blocks, as one, in blocks of other sizes, and piece by piece."""
    n = 2 * analytic_platform.BLOCK + 1000
    gyro = random_recording(n + 2)
    # Sequences that start on a border of blocks, just beside one, end on one, and reach over two.
    B = analytic_platform.BLOCK
    edges = np.array([0, 700, B - 1, B, B + 1, 2 * B, 2 * B, n])
    spans = np.stack([edges[:-1], edges[1:]], axis=1) + 1
    spans = spans[spans[:, 1] > spans[:, 0]]
    spans = np.concatenate([spans, [[1, n + 1]]])  # and one over all of them
    total = int((spans[:, 1] - spans[:, 0]).sum())
    F = np.random.default_rng(1).uniform(size=total) if weighted else None
    earth = 7e-5 * np.random.default_rng(2).normal(size=(len(spans), 3))
    stream = gyro_stream(gyro, 0.01, spans, spans, rates=False, F=F)
    found, kept = integrate_attitude(stream, ERRORS, earth, with_noise=True)
    assert kept.shape == ((3, 3, total) if weighted else (3, 3, 0))
    for block in (997, 1 << 20):
        monkeypatch.setattr(analytic_platform, "BLOCK", block)
        other, other_kept = integrate_attitude(stream, ERRORS, earth, with_noise=True)
        assert_same(other, found, n)
        np.testing.assert_allclose(other_kept, kept, rtol=0, atol=64 * EPS)
    monkeypatch.setattr(analytic_platform, "BLOCK", B)
    at = 0
    for k, span in enumerate(spans):
        length = int(span[1] - span[0])
        weights = None if F is None else F[at : at + length]
        at += length
        alone = gyro_stream(gyro, 0.01, span[None], span[None], rates=False, F=weights)
        single, _ = integrate_attitude(alone, ERRORS, earth[k : k + 1], with_noise=True)
        for name in FIELDS:
            np.testing.assert_allclose(
                getattr(single, name)[0], getattr(found, name)[k], rtol=1e-12, atol=4 * EPS * n, err_msg=name
            )


def test_attitude_after_the_rotation_is_that_of_a_stream_that_ends_there():
    """The Earth turns a hundred times faster, so that its sign shows; the second sequence starts late in the stream."""
    gyro = random_recording(700)
    spans, rotation = np.array([[0, 300], [400, 700]]), np.array([[40, 250], [420, 610]])
    earth = 7e-3 * np.random.default_rng(6).normal(size=(2, 3))
    whole = gyro_stream(gyro, 0.01, spans, rotation, rates=False, F=np.ones(600))
    found, _ = integrate_attitude(whole, ERRORS, earth)
    cut = np.stack([spans[:, 0], rotation[:, 1]], axis=1)
    expected, _ = integrate_attitude(gyro_stream(gyro, 0.01, cut, rotation, rates=False), ERRORS, earth)
    # The coning term of the last sample takes the change of the increment from both sides, or from one.
    coning = float(np.linalg.norm(gyro, axis=1).max()) ** 2 / 12.0
    np.testing.assert_allclose(found.C_turned, expected.C_end, rtol=0, atol=coning)
    assert np.abs(found.C_turned - found.C_end).max() > 0.01


def test_bias_offset_is_taken_off_the_compensated_rate():
    increments = random_recording(200)
    offset = np.array([[1e-3, -2e-3, 3e-3]])
    shifted, _ = integrate_attitude(one_stream(increments, 0.01), PERFECT, np.zeros((1, 3)), bias_offset=offset)
    direct, _ = integrate_attitude(one_stream(increments - 0.01 * offset, 0.01), PERFECT, np.zeros((1, 3)))
    np.testing.assert_allclose(shifted.C_end, direct.C_end, rtol=0, atol=64 * EPS)
    np.testing.assert_allclose(shifted.rate, direct.rate, rtol=0, atol=64 * EPS)


def test_sign_of_a_resting_noisy_channel_is_that_of_its_smoothed_rate():
    """Otherwise |ω| rectifies the noise: mean |noise| · asymmetry is a false rate."""
    rng = np.random.default_rng(3)
    n, dt, sigma = 4000, 0.01, 2e-3  # rad/s per sample
    asymmetry = 0.01
    bias = np.array([-5e-3, 5e-3, 2e-3])  # comes off before the signs are judged
    triad = Triad(np.eye(3), np.full(3, asymmetry), bias)
    drift = np.array([1e-3, -1e-3, 0.0])  # what the channels really turn at, below the noise of a sample
    rates = triad.read(drift) + sigma * rng.normal(size=(n, 3))
    whole = np.array([[0, n]])
    stream = gyro_stream(rates, dt, whole, whole, rates=True)
    white = np.full(3, sigma * math.sqrt(dt))
    without, _ = integrate_attitude(stream, triad, np.zeros((1, 3)))
    smoothed, _ = integrate_attitude(stream, triad, np.zeros((1, 3)), sample_noise_rad=white * np.sqrt(dt))
    mean = rates.mean(axis=0) - bias
    seen_without = mean - without.angle[0] / (n * dt)
    seen_smoothed = mean - smoothed.angle[0] / (n * dt)
    # What asymmetry really adds is asymmetry · |ω|. By samples it is the mean of |ω + noise|: σ √(2/π) at rest.
    rectified = asymmetry * sigma * math.sqrt(2 / math.pi)
    assert seen_without[2] > 0.8 * rectified
    # Smoothed over 20 samples the noise is √20 smaller: a quarter of that where nothing turns, and nothing where the
    # rate stands above it. A sign judged with the bias still in it would be off by 2 · 1e-3 of the asymmetry.
    assert np.all(np.abs(seen_smoothed - asymmetry * np.abs(drift)) < 0.3 * rectified)
    assert 2 * asymmetry * 1e-3 > rectified
