"""Noise terms by maximum likelihood: coverage of intervals, record lengths, the command, exports that use them."""

import contextlib
import io
import json
from dataclasses import replace

import noise_terms as simulated
import numpy as np
import pytest

import srt
from srt.cli import main
from srt.exporters import ExportSettings, export
from srt.noise.likelihood_thresholds import normal_threshold
from srt.noise.noise_terms import ALL_TERMS, noise_terms
from srt.result.noise_figures import LogNoise, NoiseFigures
from srt.result.provenance import Provenance, StatedSite
from srt.sensor_errors import SensorErrors

pytest.importorskip("allantools")

LENGTH_S = 10800.0
DT = LENGTH_S / simulated.SAMPLES
NAMES = [term.name for term in ALL_TERMS]


def log(channels, dt=DT):
    x = np.stack(channels, axis=1)
    return srt.Recording(dt * np.arange(1, len(x) + 1), x[:, :3], x[:, 3:], srt.Site(9.8))


def three(rng, terms, n=simulated.SAMPLES, dt=DT):
    """Gyros with noise; constant channels have no terms."""
    return log([simulated.channel(rng, np.array(terms), n, dt) for _ in range(3)] + 3 * [np.zeros(n)], dt)


@pytest.mark.parametrize("length_s", [LENGTH_S, *(pytest.param(t, marks=pytest.mark.slow) for t in (600.0, 86400.0))])
@pytest.mark.parametrize("count", [1, pytest.param(10, marks=pytest.mark.campaign)])
def test_intervals_cover_as_stated(length_s, count):
    """A twentieth of benchmarks/noise_terms.py, and one log by default: within 3.5 standard errors of 95 %.

    Ramps may be covered more often: a random walk that a short log does not resolve looks like them.
    """
    rng = np.random.default_rng([1, round(length_s)])
    covered = np.array([simulated.trial(rng, length_s)[0] for _ in range(count)])
    shares = covered.mean(axis=(0, 1))
    error = 3.5 * np.sqrt(0.95 * 0.05 / (6 * count))
    # A count is a whole number.
    assert np.all(shares >= 0.95 - error - 1.0 / (6 * count))
    assert np.all(shares[:-1] <= 0.95 + error + 1.0 / (6 * count))
    assert covered.mean() >= 0.95 - error / np.sqrt(len(ALL_TERMS))


def test_thresholds_hold_by_simulation():
    """A normal estimate cut at zero: the ratio exceeds the threshold with 5 %, wherever the value is."""
    rng = np.random.default_rng(9)
    for size in (0.0, 0.3, 1.0, 1.8, 3.0, 30.0):
        estimate = size + rng.standard_normal(40_000)
        ratio = (estimate - size) ** 2 - np.minimum(estimate, 0.0) ** 2
        outside = np.mean(ratio > normal_threshold(size, 0.95))
        assert abs(outside - 0.05) < 3.5 * np.sqrt(0.05 * 0.95 / 40_000)


@pytest.mark.parametrize(
    ("term", "coefficients"),
    [("random_walk", [0, 1, 0, 0, 0]), ("bias_random_walk", [0, 1, 0, 1e-2, 0]), ("rate_ramp", [0, 1, 0, 0, 1e-4])],
)
def test_estimates_have_the_known_limits(term, coefficients):
    """White noise to N²·√(2/n); a walk alone well above white noise; a ramp in white noise to N √(12/T³)."""
    k = NAMES.index(term)
    rng = np.random.default_rng(2)
    terms = list(coefficients)
    terms[0] = 1e-6  # no pulses to speak of
    found = noise_terms(three(rng, terms), (0, simulated.SAMPLES))
    assert found.resolved[:3, k].all()
    half = 0.5 * (found.high - found.low)[:3, k]
    if term == "random_walk":
        expected = 1.96 * 0.5 * np.sqrt(2.0 / simulated.SAMPLES)
        # With pulses and flicker to be told from it, the interval is wider than that of white noise alone.
        assert np.all(half > 0.97 * expected)
        assert np.all(half < 3.0 * expected)
    if term == "rate_ramp":
        # A walk that is not resolved widens the interval.
        assert np.all(half > 0.97 * 1.96 * np.sqrt(12.0 / LENGTH_S**3))
    assert np.all(np.abs(found.value[:3, k] - coefficients[k]) < 3.5 / 1.96 * 1.3 * half)


@pytest.mark.slow
def test_a_term_is_known_after_the_length_that_it_needs():
    """Predicted from a log that resolves it: at that length the relative half-width is a half, on the mean of six."""
    rng = np.random.default_rng(3)
    terms = [1e-6, 1.0, 0.0, 4e-3, 0.0]
    k = NAMES.index("bias_random_walk")
    long = noise_terms(three(rng, terms), (0, simulated.SAMPLES))
    needed = float(np.median(long.needed_s[:3, k]))
    n = round(needed / DT)
    assert 100 < n < simulated.SAMPLES
    widths = []
    for _ in range(2):
        found = noise_terms(three(rng, terms, n), (0, n))
        widths += (0.5 * (found.high - found.low) / terms[k])[:3, k].tolist()
    # A grid of lengths with steps of 29 %, an expansion for small widths: within a factor of 1.7.
    assert 0.3 < np.median(widths) < 0.85


def test_constant_channels_and_short_logs():
    rng = np.random.default_rng(4)
    channels = [simulated.channel(rng, np.array([1e-6, 1.0, 0.0, 0.0, 0.0]), 2000, 0.1) for _ in range(6)]
    for still in (1, 3, 4):
        channels[still] = np.full(2000, 0.3)
    record = log(channels, 0.1)
    found = noise_terms(record, (0, 2000))
    assert np.isnan(found.value[1]).all()
    assert found.figures()["gyro_y"] == {}
    with pytest.raises(srt.DataError, match="lasts 10 s"):
        noise_terms(record, (0, 100))
    increments = srt.Recording(record.time, record.gyro * 0.1, record.accel * 0.1, srt.Site(9.8), kind="increment")
    np.testing.assert_allclose(noise_terms(increments, (0, 2000)).value, found.value, rtol=1e-6, atol=1e-12)


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    """Half an hour of a MEMS unit at 50 Hz on a shelf: N, K and pulses in SI, as a recording."""
    folder = tmp_path_factory.mktemp("shelf")
    rng = np.random.default_rng(5)
    n, dt = 90_000, 0.02
    gyro = [simulated.channel(rng, np.array([2e-5, 1e-4, 0.0, 2e-6, 0.0]), n, dt) for _ in range(3)]
    accel = [simulated.channel(rng, np.array([1e-4, 1e-3, 0.0, 3e-5, 0.0]), n, dt) for _ in range(3)]
    x = np.stack([*gyro, *accel], axis=1) + np.array([0.01, -0.02, 0.005, 0.1, -0.1, 9.8])
    recording = srt.Recording(dt * np.arange(1, n + 1), x[:, :3], x[:, 3:], srt.Site(9.8), serial="SN-7")
    srt.write_recording(recording, folder / "rec", samples_format="npz")
    calibration = srt.Calibration(
        "hand",
        "converged",
        "Done.",
        SensorErrors(np.full(27, 1e-3)),
        1e-12 * np.eye(27),
        provenance=Provenance(serial="SN-7"),
    )
    calibration.save(folder / "unit.json")
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main(["noise", str(folder / "rec"), "--into", str(folder / "unit.json"), "--json",
                     str(folder / "n.json"), "--plot", str(folder / "n.png")]) == 0  # fmt: skip
    (folder / "n.txt").write_text(out.getvalue(), encoding="utf-8")
    return folder


def test_the_command_finds_what_was_put_in(shelf):
    out = (shelf / "n.txt").read_text(encoding="utf-8")
    for part in ("30 min at rest, 50 Hz", "random walk, °/√h", "Allan fit", "record"):
        assert part in out
    *table, written = out.splitlines()
    assert max(map(len, table)) <= 100
    assert "n.json" in written
    found = json.loads((shelf / "n.json").read_text())["channels"]
    N = np.degrees(1e-4) * 60.0
    for axis in "xyz":
        row = found[f"gyro_{axis}"]["gyro_noise_deg_per_sqrt_h"]
        # The interval has a half-width of 1.96 sigma: 4 sigma for six such figures.
        assert abs(row["value"] - N) < 2.1 * (row["high"] - row["low"]) / 2.0
    assert (shelf / "n.png").read_bytes().startswith(b"\x89PNG")


def test_exports_have_no_empty_noise_field(shelf, capfd):
    pytest.importorskip("yaml")
    calibration = srt.load_calibration(shelf / "unit.json")
    channels = calibration.noise.terms.channels
    key = "gyro_bias_random_walk_deg_per_h_per_sqrt_h"
    worst = max(row[key].get("value", row[key].get("below")) for name, row in channels.items() if name in
                ("gyro_x", "gyro_y", "gyro_z"))  # fmt: skip
    made = export(calibration, "kalibr", settings=ExportSettings(rate_hz=50.0, inflate=5.0))
    assert made.unknown == ()
    yaml = pytest.importorskip("yaml")
    flat = yaml.safe_load(made.texts["-imu"])
    # 1 °/h/√h in rad/s/√s
    assert flat["gyroscope_random_walk"] == pytest.approx(5.0 * worst * np.radians(1.0) / 3600.0 / 60.0)
    assert "multiplied by 5 (--inflate)" in made.texts["-imu"]
    assert flat["gyroscope_noise_density"] == pytest.approx(5e-4, rel=0.2)
    line = ["export", str(shelf / "unit.json"), "--to", "openvins", "--rate-hz", "50", "-o", str(shelf / "o.yaml")]
    assert main(line) == 0
    assert capfd.readouterr().err == ""
    assert "multiplied by 1 (--inflate)" in (shelf / "o.yaml").read_text()


def test_gtsam_gets_the_noise_the_walks_and_the_inflation(shelf):
    """The log of the unit comes before the white noise of its test, as in the file of Kalibr."""
    from dataclasses import replace

    calibration = srt.load_calibration(shelf / "unit.json")
    noise = replace(
        calibration.noise, gyro_noise_rad_per_sqrt_s=np.full(3, 1e-2), accel_noise_m_s2_sqrt_s=np.full(3, 1e-1)
    )
    calibration = replace(calibration, noise=noise, site=StatedSite(gravity_m_s2=9.8))
    plain, inflated = (
        json.loads(export(calibration, "gtsam", settings=ExportSettings(inflate=factor)).texts[""])
        for factor in (None, 3.0)
    )
    for name in ("gyroscope_covariance", "accelerometer_covariance", "bias_acc_covariance", "bias_omega_covariance"):
        np.testing.assert_allclose(np.array(inflated[name]), 9.0 * np.array(plain[name]), rtol=1e-12)
    assert "multiplied by 3 (--inflate)" in " ".join(inflated["comment"])
    channels = calibration.noise.terms.channels
    # °/√h and µg/√Hz in SI
    for name, sensor, key, unit in (
        ("gyroscope_covariance", "gyro", "gyro_noise_deg_per_sqrt_h", np.radians(1.0) / 60.0),
        ("accelerometer_covariance", "accel", "accel_noise_ug_per_sqrt_hz", 9.80665e-6),
    ):
        white = [channels[f"{sensor}_{axis}"][key]["value"] * unit for axis in "xyz"]
        np.testing.assert_allclose(plain[name], np.diag(np.square(white)), rtol=1e-12)
    yaml = pytest.importorskip("yaml")
    flat = yaml.safe_load(export(calibration, "kalibr").texts["-imu"])
    assert flat["gyroscope_noise_density"] ** 2 == pytest.approx(np.max(plain["gyroscope_covariance"]))
    assert flat["accelerometer_noise_density"] ** 2 == pytest.approx(np.max(plain["accelerometer_covariance"]))


def test_preintegration_takes_the_noise_of_the_log(shelf):
    """One reading: the covariance of its rotation is the white noise of the corrected rate, over one sample."""
    from srt.stacks.preintegration import ROTATION, preintegrate

    calibration = srt.load_calibration(shelf / "unit.json")
    channels = calibration.noise.terms.channels
    white = [np.radians(channels[f"gyro_{axis}"]["gyro_noise_deg_per_sqrt_h"]["value"]) / 60.0 for axis in "xyz"]
    summed = preintegrate(calibration, calibration.errors.group("gyro_bias")[None], np.zeros((1, 3)), 0.01)
    # The scale factors and angles are 1e-3; three of them act on each axis, twice.
    found = summed.covariance[ROTATION, ROTATION]
    np.testing.assert_allclose(np.diag(found), 0.01 * np.square(white), rtol=0.01)


def test_an_axis_without_the_term_takes_the_white_noise_of_the_test():
    from srt.noise.stated_figures import white_density, white_noise

    figure = {"value": 100.0, "low": 90.0, "high": 110.0}
    noise = NoiseFigures(
        accel_noise_m_s2_sqrt_s=np.array([1e-3, 2e-3, 3e-3]),
        terms=LogNoise(
            length_s=1800.0, samples_sha256=None, channels={"accel_y": {"accel_noise_ug_per_sqrt_hz": figure}}
        ),
    )
    np.testing.assert_allclose(white_noise(noise, "accel"), [1e-3, 9.80665e-4, 3e-3], rtol=1e-15)
    assert np.isnan(white_noise(noise, "gyro")).all()
    with pytest.raises(srt.InputError, match=r"white noise of the gyro channels: .*srt noise LOG --into"):
        white_density(noise, "gyro", np.eye(3))


def test_white_noise_of_corrected_readings():
    """Corrected x is x + y / 2, and corrected z twice z: variances and covariance of independent channels by hand."""
    from srt.noise.stated_figures import white_density

    noise = NoiseFigures(gyro_noise_rad_per_sqrt_s=np.array([1.0, 2.0, 3.0]))
    correction = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    expected = [[1.0 + 0.25 * 4.0, 0.5 * 4.0, 0.0], [0.5 * 4.0, 4.0, 0.0], [0.0, 0.0, 4.0 * 9.0]]
    np.testing.assert_allclose(white_density(noise, "gyro", correction), expected, rtol=1e-15)


def test_another_unit_and_a_moving_log_are_refused(shelf, tmp_path, refused):
    calibration = srt.load_calibration(shelf / "unit.json")
    other = replace(calibration.provenance, serial="SN-8")
    replace(calibration, provenance=other).save(tmp_path / "other.json")
    before = (tmp_path / "other.json").read_bytes()
    assert "SN-8" in refused("noise", shelf / "rec", "--into", tmp_path / "other.json")
    assert (tmp_path / "other.json").read_bytes() == before
