"""Settings of an export, its refusals, and the tools that open the exported files."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from exporter_formulas import NOISE, TARGETS, ardupilot, calibrated, motion, px4, yaml

import srt
from srt import exporters
from srt.exporters import ExportSettings, Readings, export, gtsam_preintegration, load, save
from srt.model.sensor_model import gyro_triad
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Provenance, Temperature
from srt.sensor_errors import GROUP_SLICES, SensorErrors


def changed(calibration, **groups):
    vector = calibration.errors.vector.copy()
    for group, values in groups.items():
        vector[GROUP_SLICES[group]] = values
    return replace(calibration, errors=SensorErrors(vector))


@pytest.mark.parametrize(
    ("target", "options", "groups", "fragment"),
    [
        ("px4", {"frame": "accel"}, {}, "takes mars or table"),
        ("imucal", {"settings": ExportSettings(topic="/imu")}, {}, "no place for topic"),
        ("kalibr", {"settings": ExportSettings(instance=1)}, {}, "no place for instance"),
        ("pyins", {"asymmetry": "fit"}, {}, "no recording to fit to"),
        ("pyins", {"asymmetry": "half"}, {}, "asymmetry is"),
        ("ardupilot", {}, {"accel_bias": 4.0}, "parameters go to 3.5"),
        ("ardupilot", {}, {"accel_scale": -0.3}, "from 0.8 to 1.2"),
        ("ardupilot", {}, {"accel_bias": 0.0}, "never calibrated"),
        ("ardupilot", {}, {"gyro_bias": 0.0}, "never calibrated"),
        ("ardupilot", {"settings": ExportSettings(instance=3)}, {}, "for 0 to 2"),
        ("px4", {"settings": ExportSettings(instance=4)}, {}, "0 to 3"),
        ("px4", {"settings": ExportSettings(instance=7)}, {}, "0 to 3"),
        ("pyins", {}, {"gyro_scale": -1.5}, "cannot be exported"),
        ("pyins", {}, {"gyro_asymmetry": 1.5}, "no unique inverse"),
    ],
)
def test_refused(target, options, groups, fragment):
    with pytest.raises(srt.InputError, match=fragment):
        export(changed(calibrated(np.random.default_rng(17), size=0.02), **groups), target, **options)


def test_no_table_axes_without_a_fixture():
    with pytest.raises(srt.InputError, match="no table frame"):
        export(calibrated(np.random.default_rng(18), U=None), "pyins", frame="table")


@pytest.mark.parametrize(
    ("gyro", "accel", "fragment"),
    [
        (np.zeros((4, 2)), np.zeros((4, 3)), "shape"),
        (np.zeros((4, 3)), np.zeros((5, 3)), "as many of both"),
        (np.zeros((0, 3)), np.zeros((0, 3)), "one at least"),
        (np.full((4, 3), np.nan), np.zeros((4, 3)), "finite"),
    ],
)
def test_readings_that_cannot_be_used(gyro, accel, fragment):
    with pytest.raises(srt.InputError, match=fragment):
        Readings(gyro, accel, "bad")


@pytest.mark.parametrize(
    "wrong", [{"rate_hz": 0.0}, {"gyro_random_walk": math.nan}, {"topic": "a b"}, {"topic": ""}, {"instance": -1}]
)
def test_settings_that_cannot_be(wrong):
    with pytest.raises(srt.InputError):
        ExportSettings(**wrong)


def test_increments_are_compared_as_rates():
    rng = np.random.default_rng(19)
    calibration, dt = calibrated(rng), 0.01
    rates = motion(rng)
    time = dt * np.arange(1, len(rates.gyro) + 1)
    recording = srt.Recording(time, rates.gyro * dt, rates.accel * dt, srt.Site(9.8), kind="increment")
    made = export(calibration, "px4", readings=Readings.of(recording))
    expected = export(calibration, "px4", readings=rates)
    # Stamps of 2 s are right to 2e-16, their differences to 4e-14 of 0.01 s.
    assert made.residuals[0].gyro_rms == pytest.approx(expected.residuals[0].gyro_rms, rel=1e-10)


def test_noise_and_rate_go_into_the_file_where_known():
    calibration = calibrated(np.random.default_rng(20))
    stated = ExportSettings(topic="/imu/raw", rate_hz=250.0, gyro_random_walk=1e-5, accel_random_walk=2e-4)
    made = export(calibration, "kalibr", settings=stated)
    imu = yaml.safe_load(made.texts[""])["imu0"]
    assert made.unknown == ()
    found = {key: imu[key] for key in imu if "_" in key or key in ("rostopic",)}
    assert found == {
        "T_i_b": np.eye(4).tolist(),
        "accelerometer_noise_density": 3e-4,
        "accelerometer_random_walk": 2e-4,
        "gyroscope_noise_density": 2e-6,
        "gyroscope_random_walk": 1e-5,
        "update_rate": 250.0,
        "rostopic": "/imu/raw",
        "time_offset": 0.0,
    }
    without = export(replace(calibration, noise=NoiseFigures()), "openvins")
    assert len(without.unknown) == 5
    assert "noise_density" not in without.texts[""]
    # A number with an exponent and no point is a word in YAML 1.1.
    assert "1.0e-05" in made.texts[""]


def test_the_instance_of_an_autopilot_is_in_the_names():
    calibration = calibrated(np.random.default_rng(21), size=0.02)
    for target, formula, n in (("px4", px4, 1), ("ardupilot", ardupilot, "2")):
        made = export(calibration, target, settings=ExportSettings(instance=1))
        w, _ = formula(made.texts, np.zeros((1, 3)), np.zeros((1, 3)), None, n)
        np.testing.assert_allclose(w[0], -calibration.errors.group("gyro_bias"), rtol=1e-6)


def test_a_file_that_reads_back_differently_is_removed(tmp_path, monkeypatch):
    """A disk that changes one digit of a file which is still a valid one."""
    made = export(calibrated(np.random.default_rng(22)), "imu_tk")
    (tmp_path / "unit_acc.calib").write_text("mine")
    path_type = type(tmp_path)
    whole = path_type.read_bytes
    monkeypatch.setattr(path_type, "read_bytes", lambda self: whole(self)[:-2] + b"1\n")
    with pytest.raises(srt.DataError, match="does not read back"):
        save(made, tmp_path / "unit.calib")
    monkeypatch.undo()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("unit_acc.calib", "mine")]


@pytest.mark.parametrize(("sensor", "name"), [("gyro", "gyro"), ("accel", "accelerometer")])
def test_a_writer_that_is_wrong_is_found_out(monkeypatch, sensor, name):
    """A bias off by 1e-9 (SI), which no message of a reader would show."""
    item = exporters.exporter("pyins")

    def write(model):
        document = json.loads(item.write(model)[""])
        document[sensor]["bias"][1] += 1e-9
        return {"": json.dumps(document)}

    monkeypatch.setattr("srt.exporters.conversion.exporter", lambda _: replace(item, write=write))
    with pytest.raises(srt.DataError, match=f"The {name} correction"):
        export(calibrated(np.random.default_rng(28)), "pyins")


def test_texts_of_a_file_cannot_break_out_of_its_comments():
    made = export(calibrated(np.random.default_rng(23), provenance=Provenance(serial="a\nimu1: [}\u2028")), "kalibr")
    assert list(yaml.safe_load(made.texts[""])) == ["imu0"]
    made.texts[""].encode("ascii")


@pytest.mark.parametrize("target", sorted(set(TARGETS) - {"vectornav", "imu_tk"}))
def test_files_state_the_temperature_of_the_test(target):
    """All but the files that hold commands or numbers alone."""
    changes = {"temperature": Temperature(25.04, 1.5)}
    rng = np.random.default_rng(29)
    for temperature, fragment in ((changes, "mean 25.0 degC, range 1.5 degC"), ({}, "not stated")):
        text = export(calibrated(rng, **temperature), target).texts[""]
        assert f"temperature: {fragment}" in " ".join(text.split())


def test_gtsam_gets_noise_bias_and_gravity():
    package = pytest.importorskip("gtsam")
    calibration = calibrated(np.random.default_rng(24))
    params, bias = gtsam_preintegration(calibration, readings="raw")
    assert type(params) is package.PreintegrationParams
    np.testing.assert_array_equal(params.n_gravity, [0.0, 0.0, -9.81])
    np.testing.assert_allclose(
        params.getGyroscopeCovariance(), np.diag(np.square(NOISE["gyro_noise_rad_per_sqrt_s"])), rtol=1e-15
    )
    np.testing.assert_allclose(
        params.getAccelerometerCovariance(), np.diag(np.square(NOISE["accel_noise_m_s2_sqrt_s"])), rtol=1e-15
    )
    assert params.getIntegrationCovariance().max() < 1e-6
    np.testing.assert_array_equal(bias.gyroscope(), calibration.errors.group("gyro_bias"))
    np.testing.assert_array_equal(bias.accelerometer(), calibration.errors.group("accel_bias"))

    params, bias = gtsam_preintegration(
        calibration, readings="corrected", up=False, gravity_m_s2=9.8, gyro_random_walk=1e-5, accel_random_walk=1e-4
    )
    assert type(params) is package.PreintegrationCombinedParams
    np.testing.assert_array_equal(params.n_gravity, [0.0, 0.0, 9.8])
    np.testing.assert_array_equal(bias.vector(), np.zeros(6))
    np.testing.assert_allclose(params.getBiasOmegaCovariance(), 1e-10 * np.eye(3), rtol=1e-15)
    np.testing.assert_allclose(params.getBiasAccCovariance(), 1e-8 * np.eye(3), rtol=1e-15)
    # Noise of the corrected readings, from the definition.
    D = np.linalg.inv(gyro_triad(calibration.errors).matrix)
    expected = D @ np.diag(np.square(NOISE["gyro_noise_rad_per_sqrt_s"])) @ D.T
    np.testing.assert_allclose(params.getGyroscopeCovariance(), expected, rtol=1e-12, atol=1e-30)


@pytest.mark.parametrize(
    ("options", "fragment"),
    [
        ({"readings": "both"}, "readings is"),
        ({"gyro_random_walk": 1e-5}, "or neither"),
        ({"gyro_random_walk": -1.0, "accel_random_walk": 1.0}, "random walk"),
        ({"gravity_m_s2": -9.8}, "Gravity is"),
    ],
)
def test_gtsam_refusals(options, fragment):
    pytest.importorskip("gtsam")
    with pytest.raises(srt.InputError, match=fragment):
        gtsam_preintegration(calibrated(np.random.default_rng(26)), **({"readings": "raw"} | options))


def test_gtsam_needs_the_noise():
    pytest.importorskip("gtsam")
    with pytest.raises(srt.InputError, match="white noise"):
        gtsam_preintegration(calibrated(np.random.default_rng(27), noise=NoiseFigures()), readings="raw")


def test_kalibr_gets_the_flat_file_of_its_option_imu(tmp_path):
    """Keys of Kalibr's ImuParameters, at the top level; its parser is not installable here."""
    settings = ExportSettings(topic="/imu/raw", rate_hz=250.0, gyro_random_walk=1e-5, accel_random_walk=2e-4)
    result, flat = save(export(calibrated(np.random.default_rng(32)), "kalibr", settings=settings), tmp_path / "k.yaml")
    assert (result.name, flat.name) == ("k.yaml", "k-imu.yaml")
    found = yaml.safe_load(flat.read_text(encoding="utf-8"))
    noise = {"accelerometer_noise_density", "gyroscope_noise_density"}
    walks = {"accelerometer_random_walk": 2e-4, "gyroscope_random_walk": 1e-5}
    assert set(found) == {*noise, *walks, "rostopic", "update_rate"}
    assert found["rostopic"] == "/imu/raw"
    assert {name: found[name] for name in walks} == walks
    flat.unlink()
    assert load(result, "kalibr").absent
