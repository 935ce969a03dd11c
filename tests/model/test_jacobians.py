"""The Jacobians of z and of compensated values against differences of the data processing and the compensation.

At no errors, at tiny and at large ones.
"""

import numpy as np
import pytest
from ideal_table_1 import G, paused_table_1, player_of

import sims
from srt.model import measurement_model as model
from srt.model.sensor_model import accel_triad, gyro_triad, outside_model
from srt.recording.recording import Site
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES, SensorErrors

SAMPLE_RATE_HZ = 200.0
RATE = 1.0
WINDOW_S = 2.0
PAUSE_S = 0.05

SIZES = {
    "none": np.zeros(N_PARAMETERS),
    "tiny": np.full(N_PARAMETERS, 1e-6),
    "large": np.zeros(N_PARAMETERS),
}
for group, size in {
    "gyro_scale": 0.3,
    "gyro_asymmetry": 0.01,
    "gyro_orthogonality": 0.2,
    "accel_bias": 1.0,
    "accel_scale": 0.3,
    "accel_asymmetry": 0.01,
    "accel_misalignment": 0.2,
    "gyro_bias": 0.01,
}.items():
    SIZES["large"][GROUP_SLICES[group]] = size

STEPS = np.full(N_PARAMETERS, 1e-5)
STEPS[GROUP_SLICES["accel_bias"]] = 1e-4
STEPS[GROUP_SLICES["gyro_bias"]] = 1e-7


def draw(size):
    """Errors of a size with mixed signs; the large ones are legal, or the draw would prove nothing."""
    rng = np.random.default_rng(12)
    errors = SensorErrors(SIZES[size] * rng.uniform(0.5, 1.0, N_PARAMETERS) * rng.choice([-1.0, 1.0], N_PARAMETERS))
    assert outside_model(errors) is None
    return errors


# A body turned well away from the table: no component of rate or specific force is near zero, where |·| has no slope.
U = sims.rotation([0.4, -0.3, 0.5])


@pytest.fixture(scope="module")
def motion():
    """Table 1 on an Earth at rest, pauses between rotations so that samples hold one rotation each."""
    return paused_table_1(
        WINDOW_S,
        PAUSE_S,
        site=Site(G),
        sample_rate_hz=SAMPLE_RATE_HZ,
        heading_rad=0.5,
        U=U,
        earth_rate=False,
    )


def differences(player, errors, steps):
    """−dz/d(estimate) by central differences: what H claims an error left in the estimate does."""
    columns = []
    for i, step in enumerate(steps):
        d = step * np.eye(N_PARAMETERS)[i]
        plus, minus = (player.process(errors.plus(sign * d), U=U).z for sign in (1.0, -1.0))
        columns.append((minus - plus) / (2.0 * step))
    return np.stack(columns, axis=1)


def kink(errors):
    """Largest difference between the compensation's inverse matrices for two signs of the rates.

    Without the Earth's rate the true rate at rest is exactly zero, and a difference in the gyro's bias straddles it.
    """
    inverses = gyro_triad(errors).inverses
    return np.linalg.norm(inverses[:, None] - inverses[None], 2, axis=(2, 3)).max()


def turning(data):
    """Total angle of each sequence, and its duration with windows, per row of z."""
    angle = np.array([np.abs(s.angles_rad).sum() for s in data.catalogue])
    seconds = (data.rotation[:, 1] - data.rotation[:, 0]) / SAMPLE_RATE_HZ + 2 * WINDOW_S
    return np.repeat(angle, 2), np.repeat(seconds, 2)


@pytest.mark.parametrize("window_attitude", ["held", "integrated"])
@pytest.mark.parametrize("size", ["none", pytest.param("tiny", marks=pytest.mark.slow), "large"])
def test_playback_jacobian_without_earth_rate(motion, size, window_attitude):
    errors = draw(size)
    data, player = player_of(sims.read_out(motion, errors), window_attitude=window_attitude)
    found = player.process(errors, U=U).H
    expected = differences(player, errors, STEPS)
    angle, seconds = turning(data)
    # Slope of the compensation, D = (M + diag(s sign))⁻¹; every derivative scales with it.
    D = max(np.linalg.norm(triad(errors).inverses, 2, axis=(1, 2)).max() for triad in (gyro_triad, accel_triad))
    # Ĉ of a sample is the mean of its ends: its integral is (ω dt)²/12 off, of each radian or second of turning; a bias
    # also acts while Ĉ turns within the sample of a ramp. Central differences: step² times the cube of the angle.
    sample = (RATE * D / SAMPLE_RATE_HZ) ** 2 / 12.0
    relative = sample + (STEPS.max() * 2 * np.pi * D) ** 2
    rows = np.zeros((len(found), N_PARAMETERS))
    K = data.K
    rows[: 2 * K] = G * D * angle[:, None]
    rows[: 2 * K, GROUP_SLICES["gyro_bias"]] = G * D * seconds[:, None]
    rows[: 2 * K, 9:24] = 2.0 * G * D
    rows[2 * K : -3] = G * D
    rows[-3:] = D
    # z is known to rounding of its sums, some 1e-15 g.
    tolerance = relative * rows + 1e-14 * G / STEPS
    still = PAUSE_S * np.array([len(s.rotations) - 1 for s in data.catalogue])
    still = still + (2 * WINDOW_S if window_attitude == "integrated" else 0.0)
    tolerance[: 2 * K, GROUP_SLICES["gyro_bias"]] += G * kink(errors) * np.repeat(still, 2)[:, None]
    tolerance[-3:, GROUP_SLICES["gyro_bias"]] += kink(errors)
    worst = np.unravel_index(np.argmax(np.abs(found - expected) - tolerance), found.shape)
    assert np.all(np.abs(found - expected) <= tolerance), (worst, NAMES[worst[1]])


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("which", ["force", "rate"])
def test_compensation_jacobians(size, which):
    """Compensated value against the estimate: minus the derivative is what an error left in it does."""
    errors = draw(size)
    rng = np.random.default_rng(4)
    true = rng.uniform(0.2, 1.0, (20, 3)) * rng.choice([-1.0, 1.0], (20, 3))
    if which == "force":
        true *= G
        triad, jacobian = accel_triad, model.force_error_jacobian
    else:
        triad, jacobian = gyro_triad, model.rate_error_jacobian
    reading = triad(errors).read(true)
    found = jacobian(triad(errors).compensate(reading), triad(errors))
    D = np.linalg.norm(triad(errors).inverses, 2, axis=(1, 2)).max()
    scale = np.abs(true).max()
    for i, step in enumerate(np.full(N_PARAMETERS, 1e-4)):
        d = step * np.eye(N_PARAMETERS)[i]
        plus, minus = (triad(errors.plus(sign * d)).compensate(reading) for sign in (1.0, -1.0))
        # (I + x)⁻¹ = … − x³: step² D⁴ times the value; rounding of the value over the step.
        atol = step**2 * D**4 * scale * 3 + 1e-14 * D * scale / step
        np.testing.assert_allclose(found[:, :, i], (minus - plus) / (2 * step), rtol=0, atol=atol, err_msg=NAMES[i])
