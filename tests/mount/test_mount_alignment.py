"""Mount alignment, Savage 2020 §10: its equations, what the stand does to it, its sigmas, and what it refuses."""

import json
import math
from dataclasses import replace

import accuracy_trials
import numpy as np
import pytest
from mount_motion import (
    LEVEL_AND_NOSE_DOWN_RAD,
    MountErrors,
    draw_mount_errors,
    mount_matrix,
    simulate_mount,
)
from small_units import on_fixture

import srt
from sims.physics.imu import ImuModel, read_out
from srt.exceptions import DataError, InputError
from srt.model.rotations import rotation_matrix, rotation_vector
from srt.mount.alignment import MountAlignment, align_mount, load_mount_alignment, mount_from_calibration
from srt.mount.poses import mount_from_recording
from srt.result.calibration import Calibration
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

G = 9.80665
SITE = srt.Site(G, latitude_rad=0.8)
ANGLES = np.array([0.03, -0.05, 0.08])
QUIET = ImuModel(gyro_noise=1e-9, accel_noise=1e-8)
"""Noise of 1e-9 rad in a mean over 2 s. Weights that matter need it: readings that never change tell no noise."""
QUARTER = 0.5 * math.pi
PAIR = (0.0, -QUARTER, QUARTER)
_IN_G = np.ones(N_PARAMETERS)
_IN_G[GROUP_SLICES["accel_bias"]] = G


def calibrated(errors=None, covariance=None, **changes):
    vector = np.zeros(N_PARAMETERS) if errors is None else errors
    P = np.eye(N_PARAMETERS) * 1e-12 if covariance is None else covariance
    return Calibration("closed-form", "converged", "Done.", SensorErrors(vector), P, **changes)


def error(mount, angles=ANGLES):
    """η of Ĉ_bm = C_bm exp(η×), rad."""
    return rotation_vector((mount_matrix(angles).T @ mount.matrix)[None])[0]


def aligned(draw=None, pitch_rad=LEVEL_AND_NOSE_DOWN_RAD, imu=None, **sigmas):
    """Simulate stands, noise-free by default, and align by them."""
    motion = simulate_mount(ANGLES, site=SITE, pitch_rad=pitch_rad, draw=draw, heading_rad=0.4, dwell_s=2.0)
    recording = read_out(motion, SensorErrors(), imu, np.random.default_rng(5))
    return mount_from_recording(recording, calibrated(), **sigmas)


def from_forces(force, **changes):
    n = 3 * len(force)
    given = {"level_sigma_rad": 1e-4, "axis_sigma_rad": 1e-4} | changes
    return align_mount(force, {"accel_noise": np.eye(n) * (1e-6 * G) ** 2}, **given)


class TestSection10:
    """The paper gives words; in small angles they are three readings."""

    angles = np.array([2e-6, -3e-6, 5e-6])
    # What the small angles leave out are their products.
    tolerance = 3e-11 * G

    def reading(self, pitch_rad):
        motion = simulate_mount(self.angles, site=SITE, pitch_rad=(pitch_rad, 0.3), dwell_s=1.0, labelled=False)
        return motion.velocity[10] / motion.interval

    def test_horizontal_outputs_on_the_level_mount_are_two_misalignments(self):
        roll, pitch, _ = self.angles
        np.testing.assert_allclose(self.reading(0.0), [G * pitch, -G * roll, -G], rtol=0, atol=self.tolerance)

    def test_y_output_with_x_vertical_is_the_third(self):
        _, pitch, yaw = self.angles
        np.testing.assert_allclose(self.reading(-QUARTER), [-G, G * yaw, -G * pitch], rtol=0, atol=self.tolerance)

    def test_the_estimate_is_those_three_readings(self):
        level, down = self.reading(0.0), self.reading(-QUARTER)
        mount = from_forces(np.stack([level, down]))
        expected = [-level[1] / G, level[0] / G, down[1] / G]
        np.testing.assert_allclose(mount.angles_rad, expected, rtol=0, atol=self.tolerance / G)


class TestExact:
    """Angles of noise-free data on an error-free stand are right to rounding, at any size and pitch."""

    @pytest.mark.parametrize(
        "pitch_rad", [LEVEL_AND_NOSE_DOWN_RAD, (0.0, QUARTER), (0.0, -1.3), (-1.8, 0.0), PAIR, PAIR * 2]
    )
    @pytest.mark.parametrize("scale", [0.0, 1e-3, 1.0])
    def test_the_angles_of_the_simulator_are_found(self, pitch_rad, scale):
        angles = scale * np.array([0.2, -0.15, 0.25])
        errors = np.random.default_rng(8).uniform(-0.02, 0.02, N_PARAMETERS)
        motion = simulate_mount(angles, site=SITE, pitch_rad=pitch_rad, heading_rad=2.0, dwell_s=1.0)
        mount = mount_from_recording(read_out(motion, SensorErrors(errors)), calibrated(errors))
        # Means of 100 samples, compensated and turned: some tens of roundings of 2e-16.
        np.testing.assert_allclose(error(mount, angles), 0.0, rtol=0, atol=1e-14)
        np.testing.assert_allclose(mount.angles_rad, angles, rtol=0, atol=1e-14)
        found = [math.radians(stand["pitch_deg"]) for stand in mount.poses]
        np.testing.assert_allclose(found, pitch_rad, rtol=0, atol=1e-12)

    @pytest.mark.parametrize("kind", ["rate", "increment"])
    @pytest.mark.parametrize("labelled", [True, False])
    def test_stands_are_found_without_labels(self, kind, labelled):
        motion = simulate_mount(ANGLES, site=SITE, pitch_rad=PAIR, dwell_s=4.0, labelled=labelled)
        imu = ImuModel(gyro_noise=1e-6, accel_noise=1e-6)
        recording = read_out(motion, SensorErrors(), imu, np.random.default_rng(2), kind=kind)
        mount = mount_from_recording(recording, calibrated())
        assert [stand["pose"] for stand in mount.poses] == ["level", "nose_down", "nose_up"]
        # Each row is the noise of a mean over 4 s over g, or at most twice that; six sigma.
        assert np.abs(error(mount)).max() < 6.0 * 2.0 * 1e-6 / math.sqrt(4.0) / G


class TestErrorsOfTheStand:
    """Errors of the stand of size s act as derived, to their squares: some (2 s)²."""

    size = 1e-4
    tolerance = (2.0 * size) ** 2

    @pytest.mark.parametrize("pitch", [-QUARTER, QUARTER, -1.3, 1.3])
    @pytest.mark.parametrize(
        ("draw", "eta"),
        [
            (MountErrors(level=np.array([1.0, 0.0])), lambda _: [-1.0, 0.0, 0.0]),
            (MountErrors(level=np.array([0.0, 1.0])), lambda _: [0.0, -1.0, 0.0]),
            (MountErrors(square=1.0), lambda _: [0.0, 0.0, 1.0]),
            (MountErrors(tilt=1.0), lambda theta: [0.0, 0.0, -math.tan(0.5 * theta)]),
        ],
    )
    def test_levelling_squareness_and_tilt(self, draw, eta, pitch):
        small = MountErrors(self.size * draw.level, self.size * draw.tilt, self.size * draw.square)
        found = error(aligned(small, (0.0, pitch)))
        np.testing.assert_allclose(found, self.size * np.array(eta(pitch)), rtol=0, atol=self.tolerance)

    @pytest.mark.parametrize("pitch", [-QUARTER, QUARTER])
    @pytest.mark.parametrize("off", [-0.05, 0.2])
    def test_a_wrong_pitch_touches_no_angle(self, pitch, off):
        mount = aligned(MountErrors(pitch=np.array([0.0, off])), (0.0, pitch))
        np.testing.assert_allclose(error(mount), 0.0, rtol=0, atol=1e-14)

    def test_nose_down_and_nose_up_together_are_free_of_the_tilt(self):
        mount = aligned(MountErrors(tilt=1e-3), PAIR, QUIET)
        # What is left is the tilt's square.
        assert np.abs(error(mount)).max() < 2.0 * 1e-6
        assert mount.sources["axis_tilt"].max() < 2.0 * 1e-6
        # One pitched stand takes the whole of it; the angles are up to 0.1 rad, which mixes them by as much.
        np.testing.assert_allclose(aligned(None, imu=QUIET).sources["axis_tilt"][2], 1e-3, rtol=0.1)

    def test_the_sources_add_up(self):
        mount = aligned(None, PAIR)
        total = np.sqrt(sum(sigma**2 for sigma in mount.sources.values()))
        np.testing.assert_allclose(total, mount.sigma_rad, rtol=1e-12)


CASES = {
    # level, axis, calibration (rad, g), noise of the accelerometers: each with another one that rules.
    "stand": (1e-4, 2e-4, 1e-6, 1e-6),
    "calibration": (1e-6, 1e-6, 1e-4, 1e-6),
    "noise": (2e-5, 1e-5, 1e-5, 3e-3),
}


def statistics(case, count, rng):
    """NEES of every draw, shape (count,), and errors of the angles over their sigmas, (count, 3)."""
    level, axis, accuracy, white = CASES[case]
    root = rng.standard_normal((N_PARAMETERS, N_PARAMETERS)) / math.sqrt(N_PARAMETERS)
    L = accuracy * _IN_G[:, None] * root
    nees, normal, errors = np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    for i in range(count):
        angles = rng.uniform(-0.2, 0.2, 3)
        pitch_rad = (LEVEL_AND_NOSE_DOWN_RAD, (0.0, QUARTER), PAIR, (0.0, -1.4, 0.0, 1.4))[i % 4]
        draw = draw_mount_errors(rng, pitch_rad, level_sigma_rad=level, axis_sigma_rad=axis, pitch_sigma_rad=2e-3)
        truth = rng.uniform(-1e-2, 1e-2, N_PARAMETERS)
        motion = simulate_mount(
            angles, site=SITE, pitch_rad=pitch_rad, draw=draw, heading_rad=rng.uniform(0.0, 6.0),
            dwell_s=2.0, settle_s=0.1, peak_rate_rad_s=3.0, sample_rate_hz=50.0,
        )  # fmt: skip
        imu = ImuModel(accel_noise=white, gyro_noise=1e-6)
        recording = read_out(motion, SensorErrors(truth), imu, rng)
        unit = calibrated(truth + L @ rng.standard_normal(N_PARAMETERS), L @ L.T)
        mount = mount_from_recording(recording, unit, level_sigma_rad=level, axis_sigma_rad=axis)
        eta = error(mount, angles)
        nees[i] = eta @ np.linalg.solve(mount.rotation_covariance, eta)
        errors[i] = mount.angles_rad - angles
        normal[i] = errors[i] / mount.sigma_rad
    return nees, normal, errors


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("count", [30, pytest.param(500, marks=pytest.mark.campaign)])
def test_the_sigmas_are_true(case, count):
    nees, normal, errors = statistics(case, count, np.random.default_rng([17, count, list(CASES).index(case)]))
    # The mean of chi-squares of 3 (of 1) degrees of freedom has the standard error sqrt(6/N) (sqrt(2/N)): 3.5 of it.
    assert abs(nees.mean() - 3.0) < 3.5 * math.sqrt(6.0 / count)
    np.testing.assert_allclose(np.mean(normal**2, axis=0), 1.0, rtol=0, atol=3.5 * math.sqrt(2.0 / count))
    np.testing.assert_allclose(np.mean(normal, axis=0), 0.0, rtol=0, atol=3.5 / math.sqrt(count))
    if case == "stand":
        # Roll and pitch to the accuracy of the levelling: an rms of N draws scatters by 1/sqrt(2 N). The angles are
        # up to 0.2 rad, by which roll takes in yaw's error (2.2e-4 at most): up to 0.2 of it.
        rms = np.sqrt(np.mean(errors[:, :2] ** 2, axis=0))
        allowed = math.hypot(1e-4, 0.2 * 2.9e-4)
        assert np.all(rms < allowed * (1.0 + 3.5 / math.sqrt(2.0 * count)))


class TestResult:
    def test_attitude_output_becomes_that_of_the_mount(self):
        motion = simulate_mount(ANGLES, site=SITE, heading_rad=0.7, dwell_s=1.0)
        mount = mount_from_recording(read_out(motion, SensorErrors()), calibrated())
        C_nm = mount.attitude(motion.attitudes[0])
        assert C_nm.shape == (2, 3, 3)
        c, s = math.cos(0.7), math.sin(0.7)
        level = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        x_down = level @ [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
        np.testing.assert_allclose(C_nm, [level, x_down], rtol=0, atol=1e-13)

    def test_attitudes_of_another_shape_are_refused(self):
        with pytest.raises(InputError, match=r"\(\.\.\., 3, 3\)"):
            MountAlignment(np.eye(3), np.eye(3)).attitude(np.zeros(3))

    def test_the_covariance_of_the_angles_is_that_of_the_rotation(self):
        C = mount_matrix([0.3, -0.4, 0.5])
        mount = MountAlignment(C, np.diag([1.0, 4.0, 9.0]))
        step = 1e-6
        J = np.stack(
            [
                (MountAlignment(C @ rotation_matrix(e), np.eye(3)).angles_rad - mount.angles_rad) / step
                for e in step * np.eye(3)
            ],
            axis=1,
        )
        # A forward difference: its error is the step times a second derivative of about one.
        np.testing.assert_allclose(J @ mount.rotation_covariance @ J.T, mount.covariance, rtol=0, atol=9.0 * 1e-5)

    def test_a_written_file_is_read_back_unchanged(self, tmp_path):
        mount = aligned(None, PAIR)
        mount.save(tmp_path / "mount.json")
        found = load_mount_alignment(tmp_path / "mount.json")
        for name in ("matrix", "covariance", "angles_rad"):
            np.testing.assert_array_equal(getattr(found, name), getattr(mount, name))
        assert found.poses == mount.poses
        assert found.method == "stands"
        assert found.provenance == mount.provenance
        assert {k: v.tolist() for k, v in found.sources.items()} == {k: v.tolist() for k, v in mount.sources.items()}

    @pytest.mark.parametrize(
        ("change", "fragment"),
        [
            (lambda d: d.update(format="srt-calibration"), "no mount alignment"),
            (lambda d: d.update(version=2), "version is 2"),
            (lambda d: d.pop("matrix"), "not a complete mount alignment"),
            (lambda d: d["matrix"][0].__setitem__(0, 2.0), "no rotation"),
            (lambda d: d["covariance"][0].__setitem__(1, 1.0), "covariance is no symmetric"),
            (lambda d: d["angles"][1].update(value=0.5), "pitch does not agree"),
            (lambda d: d["angles"][2].update(sigma=0.5), "sigma of its yaw"),
            (lambda d: d["angles"].reverse(), "angles are not"),
        ],
    )
    def test_files_that_were_edited_are_refused(self, tmp_path, change, fragment):
        path = tmp_path / "mount.json"
        aligned().save(path)
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))
        with pytest.raises(InputError, match=fragment):
            load_mount_alignment(path)

    @pytest.mark.parametrize(
        ("text", "fragment"), [(None, "cannot be read"), ("{", "not valid JSON"), ("[]", "no mount")]
    )
    def test_files_that_are_none_are_refused(self, tmp_path, text, fragment):
        if text is not None:
            (tmp_path / "mount.json").write_text(text)
        with pytest.raises(InputError, match=fragment):
            load_mount_alignment(tmp_path / "mount.json")


class TestPlayback:
    """U of a test on the two-axis fixture is the mount's alignment, to the accuracy of the mounting."""

    def run(self, rng, sigma=1e-3):
        U = rotation_matrix(rng.normal(size=3) * 0.05)
        motion = on_fixture(rng, sigma, dwell_s=2.0, U=U)  # fmt: skip
        recording = read_out(motion, accuracy_trials.normal_errors(rng), accuracy_trials.GRADES["navigation"], rng)
        return U, recording, srt.calibrate(recording)

    @pytest.mark.parametrize(
        "count", [pytest.param(10, marks=pytest.mark.slow), pytest.param(100, marks=pytest.mark.campaign)]
    )
    def test_its_sigma_is_true(self, count):
        rng = np.random.default_rng([4, count])
        nees = []
        for _ in range(count):
            U, _, calibration = self.run(rng)
            mount = mount_from_calibration(calibration)
            eta = rotation_vector((U.T @ mount.matrix)[None])[0]
            nees.append(eta @ np.linalg.solve(mount.rotation_covariance, eta))
        # Standard error sqrt(6/N). The mounting is all that the sigma holds; levelling and start angles, averaged over
        # the attitudes of the test, add less than a tenth of its variance.
        assert 3.0 - 3.5 * math.sqrt(6.0 / count) < np.mean(nees) < 3.3 + 3.5 * math.sqrt(6.0 / count)

    def test_the_start_attitudes_give_the_same_as_stands(self):
        U, recording, calibration = self.run(np.random.default_rng(6))
        by_stands, by_U = mount_from_recording(recording, calibration), mount_from_calibration(calibration)
        poses = [stand["pose"] for stand in by_stands.poses]
        # Sequences 1, 1a, 4, 11 and 13 start with z down, 3, 3a, 6, 9 and 12 with x down, y along the outer axis.
        assert (poses.count("level"), poses.count("nose_down")) == (5, 5)
        away = rotation_vector((by_U.matrix.T @ by_stands.matrix)[None])[0]
        # Both are off by what the fixture does; mounting, which is the same in both, cancels. Levelling and two angles
        # per start of 1 mrad each are left: 3.5 sigma of twice that.
        assert np.linalg.norm(away) < 3.5 * 2.0 * 1e-3
        # Mounting, levelling, start angles: three of 1 mrad about each of three axes.
        assert np.linalg.norm(rotation_vector((U.T @ by_stands.matrix)[None])[0]) < 3.5 * 3.0 * 1e-3

    def test_the_answer_is_U(self):
        U = rotation_matrix(np.array([0.1, -0.2, 0.3]))
        mount = mount_from_calibration(calibrated(U=U, U_sigma_rad=2e-3))
        np.testing.assert_allclose(mount.matrix, U, rtol=0, atol=1e-15)
        np.testing.assert_allclose(mount.rotation_covariance, 4e-6 * np.eye(3), rtol=0, atol=1e-18)
        assert mount.method == "play-back"

    def test_a_calibration_without_a_fixture_is_refused(self):
        with pytest.raises(InputError, match="no table frame"):
            mount_from_calibration(calibrated())

    def test_an_edited_U_is_refused(self):
        with pytest.raises(InputError, match="no rotation"):
            mount_from_calibration(calibrated(U=1.01 * np.eye(3), U_sigma_rad=1e-3))


def recorded(pitch_rad=LEVEL_AND_NOSE_DOWN_RAD, *, labelled=True, errors=None, angles=ANGLES, draw=None):
    motion = simulate_mount(angles, site=SITE, pitch_rad=pitch_rad, draw=draw, dwell_s=2.0, labelled=labelled)
    imu = ImuModel(gyro_noise=1e-6, accel_noise=1e-6)
    return read_out(motion, SensorErrors() if errors is None else errors, imu, np.random.default_rng(1))


def kept(recording, rows):
    return replace(recording, time=recording.time[rows], gyro=recording.gyro[rows], accel=recording.accel[rows])


def moved_within_a_stand(recording):
    accel = recording.accel.copy()
    accel[100:200] += np.array([2e-3 * G, 0.0, 0.0])
    return replace(recording, accel=accel)


def clipped(recording):
    accel = np.clip(recording.accel, -0.9 * G, 0.9 * G)
    return replace(recording, accel=accel, noise=replace(recording.noise, accel_range=0.9 * G))


class TestRefusals:
    @pytest.mark.parametrize(
        ("pitch_rad", "fragment"),
        [
            ((-QUARTER, QUARTER), "None of the 2 static poses is level"),
            ((0.0, 0.3), "None of the 2 static poses is pitched by about 90°"),
            ((0.0, math.pi), "None of the 2 static poses is pitched"),
            ((0.8, 2.2), "None of the 2 static poses is level"),
        ],
    )
    def test_without_both_stands(self, pitch_rad, fragment):
        with pytest.raises(DataError, match=fragment):
            mount_from_recording(recorded(pitch_rad), calibrated())

    def test_other_attitudes_are_left_out_and_named(self):
        mount = mount_from_recording(recorded((0.0, 0.8, -QUARTER, -2.4)), calibrated())
        assert len(mount.poses) == 2
        assert any("2 stationary windows are neither" in sentence for sentence in mount.warnings)

    def test_one_stand_without_labels(self):
        recording = recorded(labelled=False)
        with pytest.raises(DataError, match="Only one stationary window of at least"):
            mount_from_recording(kept(recording, slice(0, 150)), calibrated())

    def test_a_unit_that_moved_between_two_level_stands(self):
        draw = MountErrors(pitch=np.array([0.0, 0.0, 4e-3]))
        recording = recorded((0.0, -QUARTER, 0.0), draw=draw)
        with pytest.raises(DataError, match=r"contradict one another.*moved"):
            mount_from_recording(recording, calibrated(), level_sigma_rad=1e-4)
        # Within what the levelling explains, it is a matter for a warning.
        mount = mount_from_recording(recording, calibrated(), level_sigma_rad=1e-3)
        assert any("repeat to" in sentence for sentence in mount.warnings)

    @pytest.mark.parametrize(
        ("changed", "errors", "kind", "fragment"),
        [
            (moved_within_a_stand, {}, DataError, r"is not stationary.*2 mrad"),
            (lambda r: r, {"accel_scale_z": 0.03}, DataError, "another unit"),
            (lambda r: r, {"gyro_scale_x": -2.0}, InputError, "cannot be applied"),
            (lambda r: replace(r, accel=r.accel / G), {}, DataError, "declared as m/s²"),
            (clipped, {}, DataError, r"accel_z is at the limit"),
            (lambda r: kept(r, np.r_[0:90, 110 : len(r.time)]), {}, DataError, "samples missing"),
        ],
        ids=["moved", "another unit", "no unit", "in g", "clipped", "samples missing"],
    )
    def test_readings_and_calibrations_that_do_not_fit(self, changed, errors, kind, fragment):
        unit = calibrated(SensorErrors.from_dict(errors).vector)
        with pytest.raises(kind, match=fragment):
            mount_from_recording(changed(recorded()), unit, level_sigma_rad=1e-4)

    def test_held_parameters_are_warned_of(self):
        mount = mount_from_recording(recorded(), calibrated(fixed={"accel_bias_y": "held on request"}))
        assert any("fixes accel_bias_y" in sentence for sentence in mount.warnings)

    @pytest.mark.parametrize(
        ("changes", "fragment"),
        [({"level_sigma_rad": 0.0}, "must be positive"), ({"axis_sigma_rad": math.nan}, "must be positive")],
    )
    def test_sigmas_that_are_none(self, changes, fragment):
        with pytest.raises(InputError, match=fragment):
            from_forces(np.array([[0.0, 0.0, -G], [-G, 0.0, 0.0]]), **changes)

    @pytest.mark.parametrize(
        ("force", "covariance", "kind", "fragment"),
        [
            (np.zeros((2, 2)), np.eye(4), InputError, "shape"),
            (np.array([[0.0, 0.0, -G], [np.nan, 0.0, 0.0]]), np.eye(6), InputError, "finite"),
            (np.array([[0.0, 0.0, -G], [0.0, 0.0, 0.0]]), np.eye(6), InputError, "not zero"),
            (np.array([[0.0, 0.0, -G], [-G, 0.0, 0.0]]), np.eye(5), InputError, "of shape"),
            (np.array([[0.0, 0.0, -G], [-G, 0.0, 0.0]]), np.zeros((6, 6)), InputError, "positive definite"),
            (np.array([[0.0, 0.0, -G], [-G, 0.0, 0.0], [0.0, -G, 0.0]]), np.eye(9), DataError, "neither level"),
        ],
    )
    def test_forces_that_cannot_be_used(self, force, covariance, kind, fragment):
        with pytest.raises(kind, match=fragment):
            align_mount(force, {"accel_noise": covariance}, level_sigma_rad=1e-4, axis_sigma_rad=1e-4)
