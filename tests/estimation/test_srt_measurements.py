"""Corrections in the processing of a recording: estimated g-sensitivity and Earth rate; 19 positions without labels."""

import accuracy_trials
import numpy as np
import pytest
from honesty_trials import NINETEEN_POSITIONS, nineteen_positions, unit_of_nineteen
from studies import rms

import srt
from sims import simulate
from sims.physics.imu import ImuModel, read_out
from sims.physics.sequences import TABLE_1
from sims.physics.table_motion import table1_motion
from sims.robustness.campaign import load_campaign
from sims.robustness.trial import score
from srt.constants import EARTH_RATE_RAD_S
from srt.estimation.iterations import PARAMETER_UNITS
from srt.estimation.options import Options
from srt.estimation.srt_measurements import SrtProcessor
from srt.model.rotations import rotation_vector
from srt.sensor_errors import GROUP_SLICES, NAMES, SensorErrors
from srt.sequences.moves import recorded_moves
from srt.sequences.preparation import prepare

OPTIONS = Options(gyro_bias="g-sensitive")


@pytest.fixture(scope="module")
def unit():
    """Processor of a recording, and the true sensor errors."""
    recording, truth = accuracy_trials.fixture_recording(5, "navigation", sample_rate_hz=50.0)
    return SrtProcessor(prepare(recording, recording.sequences, OPTIONS.average), OPTIONS), truth


def test_an_error_of_the_rates_acts_through_the_g_sensitivity_that_it_mimics(unit):
    """Rates that are off by 1e-6 rad/s change the estimate of Γ, and the rotations that are compensated with it."""
    processor, truth = unit
    rng = np.random.default_rng(1)
    before = processor.process(truth)
    off = 1e-6 * rng.standard_normal((len(before.pool), 3, 1))
    followed, (_, phi) = before.poses.fit(off[..., 0]), before.after_g_sensitivity(off)
    after = processor.process(truth, g_sensitivity=before.gyro.matrix @ followed)
    K = processor.data.K
    expected = np.einsum("kia,ka->ki", before.attitude_effect, phi[:, :, 0]).ravel()
    # The start frame turns with the Earth: integrals take it at its mean, and â as if at rest, each to that angle.
    turned = EARTH_RATE_RAD_S * before.integrals.weight_s.max()
    change = after.z[: 2 * K] - before.z[: 2 * K]
    np.testing.assert_allclose(change, expected, rtol=0, atol=2.0 * turned * np.abs(expected).max())


def test_an_earth_rate_that_is_added_turns_the_start_frame_backwards(unit):
    """dĈ/dt = Ĉ (ω̂×) − (ω̂e×) Ĉ ([P] eq. 2): an offset of 1e-7 rad/s turns Ĉ_End by minus that times the duration."""
    processor, truth = unit
    offset = 1e-7 * np.random.default_rng(2).standard_normal((processor.data.K, 3))
    before, after = (processor.process(truth, earth_rate_offset=o) for o in (0.0, offset))
    turned = rotation_vector(after.integrals.C_end @ np.swapaxes(before.integrals.C_end, 1, 2))
    expected = -offset * before.integrals.weight_s[:, None]
    # The Earth turns by 3e-3 rad meanwhile, which turns the direction of the change.
    np.testing.assert_allclose(turned, expected, rtol=0, atol=3e-3 * np.abs(expected).max())


def test_what_the_next_iteration_takes_from_this_one_is_that_of_the_corrected_errors(unit):
    """U and the rates at rest after a correction: what is neglected has its square, so a quarter at half of it."""
    processor, truth = SrtProcessor(unit[0].data, Options()), unit[1].vector
    off = []
    for size in (3e-2, 1.5e-2):
        correction = size * PARAMETER_UNITS * np.random.default_rng(3).uniform(-1.0, 1.0, len(NAMES))
        before = processor.process((truth - correction)[None], U=np.eye(3)[None])
        ahead = processor.after(before, correction[None])
        after = processor.process(truth[None], U=ahead.U)
        assert np.abs(after.U - before.U).max() > 0.1 * size
        off.append([np.abs(after.U - ahead.U).max(), np.abs(after.rest_rate - ahead.rest_rate).max()])
    ratio = np.array(off[0]) / off[1]
    assert np.all((ratio > 3.0) & (ratio < 5.0))


def test_a_unit_that_shows_the_vertical_as_its_smallest_component_has_two_horizontal_directions():
    """Accelerometers that read a fifth of the axis that is vertical, and 0.6 of it on the others.

    The free turns between the sequences start from known poses: an axis chosen by the readings is the vertical itself.
    """
    errors = SensorErrors(np.array([-0.8 if "accel_scale" in name else 0.6 * ("misal" in name) for name in NAMES]))
    motion = table1_motion(
        site=accuracy_trials.SITE, sample_rate_hz=50.0, sequences=tuple(TABLE_1)[:4], moves="recorded"
    )
    recording = read_out(motion, errors, ImuModel(), np.random.default_rng(3))
    moves = recorded_moves(recording, recording.sequences)
    data = prepare(recording, recording.sequences, OPTIONS.average, moves=moves)
    assert data.is_move.any()
    assert data.placed.all()
    with np.errstate(all="raise"):
        basis = SrtProcessor(data, OPTIONS).process(SensorErrors(np.zeros(len(NAMES))), nominal_vertical=True).basis
    unit_size = np.broadcast_to(np.eye(2), (data.K, 2, 2))
    np.testing.assert_allclose(basis @ np.swapaxes(basis, 1, 2), unit_size, atol=1e-12)


def test_a_solution_that_diverges_ends_without_an_overflow():
    """A unit of ±80 % and 0.1 rad, solved directly from zero: the equations at an estimate have a condition of 1e23."""
    campaign = load_campaign("convergence")
    choice = next(e for e in campaign.estimators if e.label == "closed-form, no stages")
    simulation = simulate(campaign.unit(21, 0)[0])
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        row = score(simulation, choice, fixed_point=False)
    assert row["outcome"] == "outside_model"
    assert row["message"].startswith("After iteration 3 the equations could not be solved")


PLAIN = "no extras"
NOISE_FREE = {
    "gyro_scale": 0.05e-6, "gyro_orthogonality": 0.1e-6, "accel_scale": 0.05e-6, "accel_misalignment": 0.1e-6,
    "accel_bias": 1e-6 * 9.80665,
}  # fmt: skip
"""Largest errors without noise, SI."""


def test_noise_free():
    """To 0.05 ppm, 0.1 µrad and 1 µg."""
    recording, truth = unit_of_nineteen(PLAIN, 0, noise=False)
    errors = np.abs(
        srt.calibrate(recording, "least-squares", hold=NINETEEN_POSITIONS[PLAIN][1], checks=False).errors.vector - truth
    )
    for group, largest in NOISE_FREE.items():
        assert errors[GROUP_SLICES[group]].max() < largest


@pytest.mark.parametrize("case", NINETEEN_POSITIONS)
@pytest.mark.parametrize(
    "units", [pytest.param(2, id="small"), pytest.param(100, id="full", marks=pytest.mark.campaign)]
)
def test_errors_reach_the_bound(case, units):
    """The rms of a group over the units is that of the bound within 3.5 standard errors."""
    scores = [nineteen_positions((case,), unit, ["least-squares"])["least-squares"] for unit in range(units)]
    for group in NOISE_FREE:
        at = GROUP_SLICES[group]
        # Three parameters of one unit share errors, gravity among them: only the units count as independent.
        ratio = rms(np.array([score.error[at] for score in scores])) / rms(scores[0].bound[at])
        assert ratio < 1.0 + 3.5 / np.sqrt(2.0 * units)
