"""Mount alignment of a unit with bias instability: the sigmas match the errors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mount_motion import LEVEL_AND_NOSE_DOWN_RAD, draw_mount_errors, mount_matrix, simulate_mount

import srt
from sims.physics.imu import ImuModel, read_out
from srt.model.rotations import rotation_vector
from srt.mount.poses import mount_from_recording
from srt.result.calibration import Calibration
from srt.sensor_errors import N_PARAMETERS, SensorErrors

G = 9.80665
SITE = srt.Site(G, latitude_rad=0.8)
ANGLES = np.array([0.03, -0.05, 0.08])
QUARTER = 0.5 * math.pi
PITCHES = (LEVEL_AND_NOSE_DOWN_RAD, (0.0, QUARTER), (0.0, -QUARTER, QUARTER), (0.0, -1.4, 0.0, 1.4))
SIGMAS = {"level_sigma_rad": 1e-4, "axis_sigma_rad": 1e-4}


@pytest.mark.parametrize("count", [24, pytest.param(200, marks=pytest.mark.campaign)])
def test_instability_is_one_drift_over_the_poses(count):
    """100 µg of instability exceed levelling and noise: biases of the poses are one drift about that of the unit."""
    rng = np.random.default_rng(20261123)
    instability = 1e-4 * G
    imu = ImuModel(accel_noise=1e-5, gyro_noise=1e-6, accel_bias_instability=instability)
    unit = Calibration("closed-form", "converged", "Done.", SensorErrors(), np.eye(N_PARAMETERS) * 1e-12)
    nees = []
    for i in range(count):
        pitch_rad = PITCHES[i % len(PITCHES)]
        draw = draw_mount_errors(rng, pitch_rad, **SIGMAS, pitch_sigma_rad=2e-3)
        motion = simulate_mount(
            ANGLES, site=SITE, pitch_rad=pitch_rad, draw=draw, dwell_s=20.0, settle_s=1.0, sample_rate_hz=50.0
        )
        recording = read_out(motion, SensorErrors(), imu, rng)
        stated = replace(recording, noise=replace(recording.noise, accel_bias_instability=instability))
        mount = mount_from_recording(stated, unit, **SIGMAS)
        eta = rotation_vector((mount_matrix(ANGLES).T @ mount.matrix)[None])[0]
        nees.append(eta @ np.linalg.solve(mount.rotation_covariance, eta))
    # The mean of chi-squares of 3 degrees of freedom has the standard error sqrt(6 / count).
    assert abs(np.mean(nees) - 3.0) < 3.5 * math.sqrt(6.0 / count)
