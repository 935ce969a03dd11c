"""Sequences that start from any attitude of the fixture: simulated, written, read back and calibrated.

By quarter turns the fixture has 16 attitudes: x, -x, y or -y along the outer axis, and four axes down with each.
"""

import math
from dataclasses import replace
from functools import cache
from itertools import product

import accuracy_trials
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sims
import srt
from sims.physics.imu import read_out
from srt.model.table1 import SIGNED_AXES, RotationSequence, axis_vector
from srt.recording.folder import load_recording
from srt.recording.writing import write_recording
from srt.sensor_errors import SensorErrors
from srt.sequences.manoeuvres import end_attitude
from srt.sequences.preparation import nominal_attitude, sequence_of_label

HEADING = 0.7
STARTS = [
    (down, along) for down, along in product(SIGNED_AXES, ("x", "y", "-x", "-y")) if down.strip("-") != along.strip("-")
]
PROFILE = sims.RateProfile(3.0, 30.0)
LEG_DWELL_S = 0.1
"""A pause between two rotations, so that no sample holds parts of both: their order would be lost in it."""


def opposite(axis):
    return axis[1:] if axis.startswith("-") else f"-{axis}"


def turns(along):
    """Rotations about every IMU axis that the fixture can execute one after the other from a start attitude."""
    here, there = (along.strip("-"), "y" if along.strip("-") == "x" else "x")
    return ((here, 180.0), ("z", -90.0), (there, 90.0), ("z", 180.0), (there, -270.0), ("z", 30.0))


@cache
def all_starts():
    """Every start attitude once, on a faultless fixture, each sequence with turns about all three IMU axes."""
    sequences = tuple(sims.TurnSequence(f"{down}/{along}", down, along, turns(along)) for down, along in STARTS)
    schedule = sims.Schedule(sequences, PROFILE, dwell_s=0.5, leg_dwell_s=LEG_DWELL_S)
    return sims.run_schedule(schedule, site=accuracy_trials.SITE, sample_rate_hz=50.0, heading_rad=HEADING)


def test_there_are_sixteen():
    assert len(STARTS) == 16
    assert {(s.down, s.along_outer) for s in sims.TABLE_1.values()} <= set(STARTS)


@pytest.fixture(scope="module", params=["csv", "npz"])
def read_back(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("signed") / "recording"
    write_recording(read_out(all_starts(), SensorErrors()), folder, samples_format=request.param)
    return load_recording(folder)


def test_labels_are_read_back(read_back):
    assert read_back.sequences == all_starts().labels
    assert [(s.down, s.along_outer) for s in read_back.sequences] == STARTS


def test_the_label_says_the_attitude_that_the_simulator_had(read_back):
    """Both attitudes are products of at most nine rotations, at the start and after each rotation; rounding of each."""
    heading = Rotation.from_euler("z", HEADING).as_matrix()
    for label, (start, end) in zip(read_back.sequences, all_starts().attitudes, strict=True):
        sequence = sequence_of_label(label)
        nominal = heading @ nominal_attitude(sequence)
        np.testing.assert_allclose(nominal, start, atol=5e-15, err_msg=label.id)
        np.testing.assert_allclose(nominal @ end_attitude(sequence), end, atol=2e-14, err_msg=label.id)


@pytest.mark.parametrize(
    ("axis", "vector", "horizontal"),
    [
        ("x", [1, 0, 0], ("y", "z")),
        ("y", [0, 1, 0], ("x", "z")),
        ("z", [0, 0, 1], ("x", "y")),
        ("-x", [-1, 0, 0], ("y", "z")),
        ("-y", [0, -1, 0], ("x", "z")),
        ("-z", [0, 0, -1], ("x", "y")),
    ],
)
def test_an_axis_with_its_sign(axis, vector, horizontal):
    assert axis in SIGNED_AXES
    assert axis_vector(axis).tolist() == vector
    assert RotationSequence("A", axis, "y", math.nan, math.nan, ()).horizontal == horizontal


def mirrored(sequence, number):
    """The same rotations of a sequence from its own start, or after half a turn of one fixture axis or of both."""
    half_inner, half_outer = number % 2, number // 2
    down, along = sequence.down, sequence.along_outer
    if half_inner:
        down, along = down if down == "z" else opposite(down), opposite(along)
    if half_outer:
        down = opposite(down)
    return sims.TurnSequence(f"{sequence.id} of {down}/{along}", down, along, sequence.rotations)


@cache
def unit(shift):
    """Table 1 with its starts turned over, another way from sequence to sequence; errors of 1e-3."""
    rng = np.random.default_rng(2100 + shift)
    sequences = tuple(mirrored(s, (k + shift) % 4) for k, s in enumerate(sims.TABLE_1.values()))
    schedule = sims.Schedule(sequences, PROFILE, dwell_s=2.0, leg_dwell_s=LEG_DWELL_S)
    motion = sims.run_schedule(schedule, site=accuracy_trials.SITE, sample_rate_hz=100.0, heading_rad=HEADING)
    truth = accuracy_trials.normal_errors(rng, 1e-3, math.radians(1.0))
    return read_out(motion, truth), truth


def test_the_units_start_from_all_attitudes_that_table_1_can_be_turned_over_to():
    starts = {(s.down, s.along_outer) for shift in range(4) for s in unit(shift)[0].sequences}
    assert starts == set(STARTS)


@pytest.mark.parametrize(
    ("estimator", "shift"),
    [
        pytest.param(name, shift, marks=[] if (e + shift) % 2 == 0 else pytest.mark.slow)
        for e, name in enumerate(("least-squares", "ekf", "graph"))
        for shift in range(4)
    ],
)
def test_a_noise_free_unit_is_recovered(estimator, shift):
    """Within 1e-8, which is claimed of every noise-free unit on a perfect fixture (test_accuracy), and said nothing of.

    A sign read wrongly leaves the nominal vertical or north turned by half a turn, an error of the order of one.
    """
    if estimator == "graph":
        pytest.importorskip("gtsam")
    recording, truth = unit(shift)
    calibration = srt.calibrate(recording, estimator)
    assert calibration.status == "converged"
    assert calibration.observed.all()
    assert np.abs(accuracy_trials.error_in_quoted_units(calibration, truth)[:24]).max() < 1e-8
    # Only that noise-free data have no noise: no turn, pole or axis is found to contradict its label.
    assert all("raised to the lower limit" in warning for warning in calibration.warnings), calibration.warnings


@pytest.mark.parametrize("estimator", ["least-squares", "ekf", "graph"])
def test_axes_not_square_do_no_harm(estimator):
    """Axis non-orthogonality, as for Table 1 (test_joint_robustness), from starts whose tilts differ in sign.

    Noise-free data with the noise stated. Least squares misjudges a start attitude, by the lean at most, and with it
    the Earth's rate: 1 mrad of 7.3e-5 rad/s over the 40 s of the longest sequence is 2.9 µrad, less than the angle
    random walk of 0.002 °/√h in that time, 3.7 µrad (Savage 2020, section 9).
    """
    if estimator == "graph":
        pytest.importorskip("gtsam")
    rng = np.random.default_rng(2120)
    truth = accuracy_trials.normal_errors(rng, 1e-3, math.radians(1.0))
    sequences = tuple(mirrored(s, k % 4) for k, s in enumerate(sims.TABLE_1.values()))
    sigmas = ("level_sigma_rad", "north_sigma_rad", "mounting_sigma_rad", "rotation_sigma_rad")
    draw = sims.draw_fixture(rng, sequences, **dict.fromkeys(sigmas, 1e-3))

    def calibrated(lean_rad):
        motion = sims.run_schedule(
            sims.Schedule(sequences, leg_dwell_s=LEG_DWELL_S),
            site=accuracy_trials.SITE,
            sample_rate_hz=50.0,
            fixture_draw=replace(draw, non_orthogonality=lean_rad),
        )
        return srt.calibrate(
            replace(read_out(motion, truth), noise=accuracy_trials.GRADES["navigation"].stated()), estimator
        )

    square, leaning = calibrated(0.0), calibrated(1e-3)
    assert leaning.status == "converged"
    assert not any("noise explains" in warning for warning in leaning.warnings), leaning.warnings
    assert np.abs((leaning.errors.vector - square.errors.vector) / square.sigma).max() < 1.0
    # Sigmas hang on the attitudes, which differ by 1e-3 rad; ten times that is allowed.
    np.testing.assert_allclose(leaning.sigma, square.sigma, rtol=0.01)


def test_the_closed_form_takes_those_of_table_1_and_names_the_others():
    """Sequences from other attitudes beside Table 1 change nothing in it; alone they are none of its own."""
    rng = np.random.default_rng(2110)
    truth = accuracy_trials.normal_errors(rng, 1e-3, math.radians(1.0))
    others = (mirrored(sims.TABLE_1["8"], 3), mirrored(sims.TABLE_1["7"], 1))
    schedule = sims.Schedule((*sims.TABLE_1.values(), *others), PROFILE, dwell_s=2.0, leg_dwell_s=LEG_DWELL_S)
    recording = read_out(sims.run_schedule(schedule, site=accuracy_trials.SITE, sample_rate_hz=100.0), truth)
    calibration = srt.calibrate(recording, "closed-form")
    assert calibration.status == "converged"
    assert np.abs(accuracy_trials.error_in_quoted_units(calibration, truth)[:24]).max() < 1e-8
    assert any("'8 of -z/-x'" in w and "'7 of -y/-x'" in w for w in calibration.warnings)
    with pytest.raises(srt.DataError, match="least-squares"):
        srt.calibrate(recording.with_sequences(recording.sequences[-2:]), "closed-form")
