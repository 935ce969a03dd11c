"""imucal's Ferraris calibration in the words of this project, and the comparison that is made with it.

A small form of ``benchmarks/honesty.py rivals``, which calibrates 20 units on three fixtures.
"""

import numpy as np
import pytest
import rivals
from accuracy_trials import SITE, normal_errors
from ferraris import (
    TABLE_1_FACES,
    TABLE_1_TURN_RAD,
    TABLE_1_TURNS,
    TURN_RAD,
    Take,
    ferraris_motions,
    imucal_errors,
    signal_regions,
)
from studies import rms

from sims.physics.fixture import FixtureDraw, earth_rate_ned, rotation
from sims.physics.imu import read_out
from sims.physics.motion import RateProfile
from sims.physics.table_motion import table1_motion
from srt.sensor_errors import GROUP_SLICES, SensorErrors

RATE_HZ = 50.0
DWELL_S = 2.0
PROFILE = RateProfile(1.0, 10.0)
SLACK_S = PROFILE.rate_rad_s / PROFILE.accel_rad_s2 + 2.0 / RATE_HZ
"""Excess of a rotation's duration over its angle at full rate: half of both ramps, and fractions of samples."""
NORTH = abs(earth_rate_ned(SITE.latitude_rad)[0])


def unit(seed=3):
    """Every error that imucal knows, of 1e-3; gyro bias up to 1 mrad/s."""
    vector = normal_errors(np.random.default_rng(seed), 1e-3, 1e-3).vector.copy()
    for group in ("gyro_asymmetry", "accel_asymmetry"):
        vector[GROUP_SLICES[group]] = 0.0
    return SensorErrors(vector)


def by_ferraris(truth, **fixture):
    motions = ferraris_motions(site=SITE, face_s=DWELL_S, profile=PROFILE, sample_rate_hz=RATE_HZ, **fixture)
    faces, turns = (Take(read_out(m, truth), m.windows) for m in motions)
    regions = signal_regions(faces, turns, face_s=DWELL_S)
    return imucal_errors(regions, sample_rate_hz=RATE_HZ, gravity_m_s2=SITE.gravity_m_s2)


def by_table_1(truth, **fixture):
    motion = table1_motion(site=SITE, dwell_s=DWELL_S, sample_rate_hz=RATE_HZ, **fixture)
    take = Take(read_out(motion, truth), motion.windows)
    regions = signal_regions(take, take, face_s=2.0 * DWELL_S, face_picks=TABLE_1_FACES, turn_picks=TABLE_1_TURNS)
    return imucal_errors(regions, sample_rate_hz=RATE_HZ, gravity_m_s2=SITE.gravity_m_s2, turn_rad=TABLE_1_TURN_RAD)


AS_MOUNTED = {"U": None}
TURNED = {"U": rotation([0.1, -0.1, 0.15]), "fixture_draw": FixtureDraw(mounting=np.array([3e-3, -4e-3, 5e-3]))}


@pytest.mark.parametrize("fixture", [AS_MOUNTED, TURNED], ids=["MARS as mounted", "MARS turned, mounting off"])
@pytest.mark.parametrize("calibrate", [by_ferraris, by_table_1])
def test_the_truth_comes_back_from_a_perfect_fixture_on_an_earth_at_rest(calibrate, fixture):
    """All signs, units and frames of the conversion: nothing but rounding is left.

    A sum over some 1,000 samples of 1 rad/s or g rounds to 1e-13 at most; a hundred times that is allowed.
    """
    pytest.importorskip("imucal")
    truth = unit()
    found = calibrate(truth, earth_rate=False, **fixture)
    np.testing.assert_allclose(found.vector, truth.vector, rtol=0.0, atol=1e-11)


def test_earths_rate_limits_imucal_to_a_microradian():
    """Its turns are about the vertical or about east, its faces pairs about east, so that next to nothing is left.

    Vertical rate ends in K_ga and is taken off exactly, wherever up is. The horizontal rate turns with full turns and
    averages out over their plateau; over what a turn lasts longer, SLACK_S, it adds at most NORTH times that, and K_ga
    (which holds up to NORTH / g off its diagonal) as much again. Symmetric parts count twice in an orthogonality.
    """
    pytest.importorskip("imucal")
    truth = unit()
    d = np.abs(by_ferraris(truth).vector - truth.vector)
    left = NORTH * SLACK_S / TURN_RAD
    assert d[GROUP_SLICES["gyro_scale"]].max() < 2.0 * left
    assert d[GROUP_SLICES["gyro_orthogonality"]].max() < 4.0 * left
    assert d[GROUP_SLICES["accel_misalignment"]].max() < 4.0 * left
    # The faces hold no turn. What the accelerometers share with the gyros is the frame, turned by at most as much,
    # which enters their scale times their misalignments; the Earth's rate cancels in the mean of the faces.
    assert d[GROUP_SLICES["accel_scale"]].max() < 4.0 * left * 5e-3
    assert d[GROUP_SLICES["gyro_bias"]].max() < 1e-15
    assert d[GROUP_SLICES["accel_bias"]].max() < 1e-12


def test_one_unit_of_the_comparison():
    """One unit on one fixture: what is claimed of the fixture shows.

    At 5 mrad imucal's accelerometer misalignments have sigmas above 2 mrad and ours below 0.05 mrad (tactical noise):
    a ratio below 10 would take six of imucal's within a quarter of their sigma.
    """
    for package in ("imucal", "gtsam", "filterpy"):
        pytest.importorskip(package)
    asymmetries = [GROUP_SLICES[group] for group in rivals.ASYMMETRIES]
    for population in rivals.POPULATIONS:
        rows = rivals.beside_imucal((population, 5), 0, rivals.METHODS)
        size = {m: rms(score.error[GROUP_SLICES["accel_misalignment"]]) for m, score in rows.items()}
        for method in (rivals.IMUCAL, rivals.IMUCAL_SAME):
            assert size[method] > 10.0 * size["closed-form"]
        # The graph that is told of no asymmetry is no method for units that have one.
        assert (rivals.HELD in rows) == (population == rivals.NO_ASYMMETRY)
        for method, score in rows.items():
            of_none = method in (rivals.HELD, rivals.IMUCAL, rivals.IMUCAL_SAME)
            assert score.status == ("partial" if method == rivals.HELD else "converged")
            assert all(np.isnan(score.error[part]).all() == of_none for part in asymmetries)


def test_both_tests_take_the_same_time():
    """To the whole seconds of six faces; three half turns lead from face to face."""
    _, (table_1, faces, turns), face_s = rivals.takes(rivals.FIRST_SEED, 1e-3, rivals.NO_ASYMMETRY)
    regions = signal_regions(faces, turns, face_s=face_s)
    turning_s = sum(len(regions[f"gyr_{axis}_rot"]) for axis in "xyz") / rivals.SAMPLE_RATE_HZ
    ferraris_s = 6.0 * face_s + turning_s + 3.0 * rivals.PROFILE.duration_s(np.pi)
    assert 0.0 <= len(table_1.recording.time) / rivals.SAMPLE_RATE_HZ - ferraris_s < 6.5
