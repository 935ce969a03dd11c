"""Units that take a moment: on a fixture, through the command of the simulator, by hand, and of random readings."""

import accuracy_trials
import numpy as np

import srt
from sims.physics.table_motion import table1_motion
from srt.cli import main
from srt.model.rotations import rotation_matrix
from srt.result.calibration import Calibration
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Provenance, StatedSite
from srt.sensor_errors import N_PARAMETERS, SensorErrors

SCENARIO = """
seed = {seed}
imu = {{ from = "navigation-rlg" }}
fixture = {{ from = "lab-1mrad" }}
site = {{ from = "latitude-45" }}
schedule = {{ dwell_s = {dwell_s}, rate_rad_s = 3.0, acceleration_rad_s2 = 30.0, settle_s = 0.1, leg_dwell_s = 0.2 }}
recording = {{ sample_rate_hz = {sample_rate_hz}, {recording} }}
"""
U = rotation_matrix(np.array([0.0, 0.1, -0.05]))
VECTOR = np.random.default_rng(3).uniform(-0.02, 0.02, N_PARAMETERS)


def on_fixture(rng, sigma_rad=1e-3, *, site=accuracy_trials.SITE, sample_rate_hz=50.0, **options):
    """Run Table 1 with alignment and rotations off by ``sigma_rad`` (one sigma), which the fixture states."""
    return table1_motion(
        site=site,
        sample_rate_hz=sample_rate_hz,
        fixture_draw=accuracy_trials.fixture_errors(rng, sigma_rad),
        stated_fixture=srt.Fixture(0.0, sigma_rad, sigma_rad),
        **options,
    )


def simulated(folder, *, seed=3, dwell_s=4.0, sample_rate_hz=100.0, recording='format = "npz", serial = "SN-7"'):
    """Simulate a recording with its truth; the scenario lies beside its folder."""
    file = folder.with_suffix(".toml")
    file.write_text(SCENARIO.format(seed=seed, dwell_s=dwell_s, sample_rate_hz=sample_rate_hz, recording=recording))
    assert main(["simulate", str(file), "-o", str(folder), "-q"]) == 0
    return folder


def calibrated(**changes):
    given = {
        "status": "converged",
        "errors": SensorErrors(VECTOR),
        "U": U,
        "site": StatedSite(gravity_m_s2=9.81),
        "noise": NoiseFigures(gyro_noise_rad_per_sqrt_s=np.full(3, 1e-6), accel_noise_m_s2_sqrt_s=np.full(3, 1e-4)),
        "provenance": Provenance(serial="SN-7", data_sha256="0" * 64, software="test", applied={"system": "none"}),
    }
    return Calibration("closed-form", message="Done.", covariance=np.eye(N_PARAMETERS) * 1e-10, **(given | changes))


def recorded(folder, kind="rate", samples_format="npz", **changes):
    """Write 3 s of random rates, and of specific forces that hold gravity, of the calibrated unit."""
    rng = np.random.default_rng(4)
    n, dt = 300, 0.01
    scale = dt if kind == "increment" else 1.0
    given = {
        "time": np.arange(1, n + 1) * dt,
        "gyro": rng.normal(size=(n, 3)) * scale,
        "accel": (rng.normal(size=(n, 3)) - np.array([0.0, 0.0, 9.8])) * scale,
        "site": srt.Site(9.80665, latitude_rad=0.7),
        "kind": kind,
        "serial": "SN-7",
    }
    srt.write_recording(srt.Recording(**(given | changes)), folder, samples_format=samples_format)
    return folder
