"""Exported files read back as pre-calibrations, and refused when they are truncated or edited."""

import importlib
import json
from dataclasses import replace

import numpy as np
import pytest
from exporter_formulas import (
    EXACT,
    FORMULAS,
    HOLD_G_SENSITIVITY,
    IMPORTED,
    SINGLE,
    TARGETS,
    biases_of,
    calibrated,
    mm,
    motion,
    yaml,
)
from g_sensitive import with_g_sensitivity

import srt
from srt import exporters
from srt.exporters import export, load, save
from srt.result.diagnostics import Diagnostics
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors


@pytest.mark.parametrize("target", IMPORTED)
def test_a_file_comes_back_as_a_pre_calibration(tmp_path, target):
    rng = np.random.default_rng(12)
    item = exporters.exporter(target)
    for frame in item.frames:
        calibration = calibrated(rng)
        path = tmp_path / f"unit{item.suffixes[0]}"
        made = export(calibration, target, frame=frame)
        places = save(made, path)
        assert all(place.exists() for place in places)
        found = load(path, target)
        expected = calibration.errors.vector.copy()
        for group in found.absent:
            expected[GROUP_SLICES[group]] = 0.0
        assert ("gyro_bias" in found.absent) == (not item.biases)
        within = 20.0 * SINGLE if target == "vectornav" else EXACT
        np.testing.assert_allclose(found.errors.vector, expected, rtol=0, atol=within)
        np.testing.assert_allclose(found.U, made.C_FB.T, rtol=0, atol=within)
        prior = importlib.import_module("srt.model.prior").Prior.from_sigma(np.full(N_PARAMETERS, 1e-3), found.errors)
        assert prior.mean == found.errors


@pytest.mark.parametrize("target", [name for name in TARGETS if name not in IMPORTED])
def test_incomplete_file_is_refused_as_pre_calibration(tmp_path, target):
    with pytest.raises(srt.InputError, match="not a pre-calibration"):
        load(tmp_path / "unit", target)


@pytest.mark.parametrize("target", TARGETS)
def test_a_truncated_file_is_refused(target):
    """Wherever it is cut, short of losing nothing but blanks at its end."""
    item = exporters.exporter(target)
    made = export(calibrated(np.random.default_rng(13)), target)
    for part in item.parts:
        text = made.texts[part]
        body = len(text.rstrip())
        for length in {*range(0, body, max(body // 60, 1)), body - 1}:
            with pytest.raises(srt.InputError) as caught:
                item.read({**made.texts, part: text[:length]})
            assert "\n" not in str(caught.value)


def spoil(text, old, new):
    assert old in text
    return text.replace(old, new, 1)


def rewritten(key, change):
    """Change one field of a YAML file, by its path."""

    def edit(text):
        head, _, body = text.partition("imu0:")
        document = yaml.safe_load("imu0:" + body)
        at = document["imu0"]
        *path, last = key.split(".")
        for step in path:
            at = at[step]
        if change is None:
            del at[last]
        else:
            at[last] = change(at[last])
        return head + yaml.safe_dump(document)

    return edit


def entry(i, j, value):
    def change(matrix):
        matrix[i][j] = value
        return matrix

    return change


def gyro_matrix(S):
    """Edit of a Basalt file: its correction of the gyros is I + S."""

    def edit(text):
        document = json.loads(text)
        document["value0"]["calib_gyro_bias"][3:] = S.T.ravel().tolist()
        return json.dumps(document)

    return edit


@pytest.mark.parametrize(
    ("target", "part", "edit", "fragment"),
    [
        ("kalibr", "", rewritten("accelerometers.M", entry(0, 2, 0.01)), "would be dropped silently"),
        ("kalibr", "", rewritten("gyroscopes.M", entry(0, 1, 1e-6)), "would be dropped silently"),
        ("kalibr", "", rewritten("gyroscopes.C_gyro_i", entry(0, 1, 0.3)), "no rotation"),
        ("kalibr", "", rewritten("gyroscopes.C_gyro_i", lambda C: (-np.array(C)).tolist()), "no rotation"),
        ("kalibr", "", rewritten("gyroscopes.A", entry(1, 1, float("nan"))), "not finite"),
        ("kalibr", "", rewritten("gyroscopes.A", lambda _: [1.0, 2.0]), "shape"),
        ("kalibr", "", rewritten("gyroscopes.A", lambda _: "none"), "3 by 3"),
        ("kalibr", "", rewritten("gyroscopes.M", None), "no imu0.gyroscopes.M"),
        ("kalibr", "", rewritten("accelerometers.M", entry(2, 2, 0.0)), "no inverse"),
        ("kalibr", "", rewritten("model", lambda _: "scale-misalignment-size-effect"), "model"),
        ("kalibr", "", lambda text: "- 1\n- 2\n", "no fields by name"),
        ("openvins", "", rewritten("Tw", entry(0, 1, 0.01)), "would be dropped silently"),
        ("openvins", "", rewritten("Ta", entry(1, 2, 0.01)), "would be dropped silently"),
        ("openvins", "", rewritten("model", lambda _: "rpng"), "not upper-triangular"),
        ("openvins", "", rewritten("model", lambda _: "mine"), "one of kalibr"),
        ("openvins", "", rewritten("R_IMUtoACC", entry(0, 0, 1.1)), "no rotation"),
        ("basalt", "", lambda text: spoil(text, '"calib_accel_bias": [', '"calib_accel_bias": [0.0, '), "shape"),
        ("basalt", "", gyro_matrix(-np.eye(3)), "calib_gyro_bias has no inverse"),
        ("imucal", "", lambda text: spoil(text, '"from_gyr_unit": "deg/s"', '"from_gyr_unit": "rad/s"'), "deg/s"),
        ("imucal", "", lambda text: spoil(text, '"2.0.0"', '"1.0.0"'), "_format_version"),
        ("imucal", "", lambda text: spoil(text, '"Ferraris"', '"Magnetometer"'), "cal_type"),
        ("imu_tk", "_acc", lambda text: spoil(text, "0 1 ", "0.1 1 "), "upper-triangular"),
        ("imu_tk", "_gyro", lambda text: spoil(text, "1 ", "2 "), "unit diagonal"),
        ("imu_tk", "_gyro", lambda text: text + "7\n", "shape"),
        ("pyins", "", lambda text: "[]", "no fields by name"),
        ("vectornav", "", lambda text: spoil(text, "VNWRG,25,1", "VNWRG,25,2"), "checksum"),
        ("vectornav", "", lambda text: text.split("\r\n")[0] + "\r\n", "register 25"),
        ("px4", "", lambda text: spoil(text, "CAL_ACC0_YSCALE\t0", "CAL_ACC0_YSCALE\tinf0"), "CAL_ACC0_YSCALE"),
        ("ardupilot", "", lambda text: spoil(text, "INS_ACCOFFS_Y", "INS_ACCOFFS_T"), "INS_ACCOFFS_X"),
        ("ros2", "", lambda text: spoil(text, "asymmetry: [", "asymmetry: [1.0, "), "shape"),
        ("ros2", "", lambda text: spoil(text, "correction: [1", "correction: [2"), "was edited"),
    ],
)
def test_an_edited_file_is_refused(target, part, edit, fragment):
    calibration = calibrated(np.random.default_rng(14), size=0.01)
    vector = calibration.errors.vector.copy()
    # Signs that the edits of this table count on.
    vector[GROUP_SLICES["accel_scale"]] = [-0.001, 0.002, -0.003]
    vector[GROUP_SLICES["gyro_scale"]] = [-0.004, -0.002, 0.001]
    texts = export(replace(calibration, errors=SensorErrors(vector)), target).texts
    with pytest.raises(srt.InputError, match=fragment):
        exporters.exporter(target).read({**texts, part: edit(texts[part])})


G_SENSITIVITY = np.array([[2e-4, -5e-5, 1e-4], [3e-5, -1e-4, 8e-5], [-6e-5, 4e-5, 1.5e-4]])


def g_sensitive(rng):
    return calibrated(rng, diagnostics=with_g_sensitivity(G_SENSITIVITY))


@pytest.mark.parametrize("target", HOLD_G_SENSITIVITY)
def test_g_sensitivity_is_written_and_read_back(target, tmp_path):
    """The target's formula recovers ω from ω̃ = Mg ω + Γ f + b, and the file gives Γ back."""
    rng = np.random.default_rng(16)
    calibration, readings = g_sensitive(rng), motion(rng)
    made = export(calibration, target, readings=readings)
    plain = replace(calibration, diagnostics=Diagnostics())
    _, force = plain.apply(readings.gyro, readings.accel)
    expected, _ = plain.apply(readings.gyro - mm(G_SENSITIVITY, force), readings.accel)
    found, _ = FORMULAS[target](made.texts, readings.gyro, readings.accel, biases_of(calibration))
    np.testing.assert_allclose(found, mm(made.C_FB, expected), rtol=0, atol=EXACT)
    assert "g-sensitivity" not in made.losses
    assert made.residuals[-1].gyro_max < EXACT
    if not made.format.imports:
        return
    again = load(save(made, tmp_path / f"unit{made.format.suffixes[0]}")[0], target)
    np.testing.assert_allclose(again.g_sensitivity, G_SENSITIVITY, rtol=0, atol=1e-12)
    size = [*range(*GROUP_SLICES["gyro_scale"].indices(N_PARAMETERS))]
    np.testing.assert_allclose(again.errors.vector[size], calibration.errors.vector[size], rtol=0, atol=1e-12)
    if made.format.biases:
        np.testing.assert_allclose(again.errors.vector, calibration.errors.vector, rtol=0, atol=1e-12)


@pytest.mark.parametrize("target", [name for name in TARGETS if name not in HOLD_G_SENSITIVITY])
def test_g_sensitivity_that_a_format_does_not_hold_is_a_loss(target):
    assert "g-sensitivity" in export(g_sensitive(np.random.default_rng(17)), target).losses


def test_a_format_without_g_sensitivity_reads_as_zero(tmp_path):
    (path,) = save(export(calibrated(np.random.default_rng(15)), "openvins"), tmp_path / "unit.yaml")
    np.testing.assert_array_equal(load(path, "openvins").g_sensitivity, np.zeros((3, 3)))


def test_files_that_are_not_there_or_no_text(tmp_path):
    with pytest.raises(srt.InputError, match="cannot be read"):
        load(tmp_path / "unit.json", "pyins")
    (tmp_path / "unit.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(srt.InputError, match="no text"):
        load(tmp_path / "unit.json", "pyins")


def test_a_flipped_axis_is_no_pre_calibration(tmp_path):
    path = tmp_path / "unit.json"
    save(export(calibrated(np.random.default_rng(16)), "pyins"), path)
    document = json.loads(path.read_text())
    document["gyro"]["transform"][0] = [-v for v in document["gyro"]["transform"][0]]
    path.write_text(json.dumps(document))
    with pytest.raises(srt.SrtError, match="left-handed"):
        load(path, "pyins")


def test_kf_gins_gets_states_their_sigmas_and_noise():
    """Keys and units of its published configuration: °/h, mGal, ppm, °/√h, m/s/√h."""
    calibration = calibrated(np.random.default_rng(40), size=0.001)
    found = yaml.safe_load(export(calibration, "kf-gins").texts[""])
    states = [
        "initgyrbias",
        "initaccbias",
        "initgyrscale",
        "initaccscale",
        "initbgstd",
        "initbastd",
        "initsgstd",
        "initsastd",
    ]
    assert list(found) == [*states, "imunoise"]
    sigma = np.sqrt(np.diag(calibration.covariance))
    units = (("initbgstd", "gyro_bias", np.radians(1.0) / 3600.0), ("initbastd", "accel_bias", 1e-5),
             ("initsgstd", "gyro_scale", 1e-6), ("initsastd", "accel_scale", 1e-6))  # fmt: skip
    for name, group, unit in units:
        np.testing.assert_allclose(found[name], sigma[GROUP_SLICES[group]] / unit, rtol=1e-12)
    # Scale factors of rows with misalignments of 1e-3 differ from the diagonal by 1e-6.
    np.testing.assert_allclose(found["initgyrscale"], calibration.errors.group("gyro_scale") * 1e6, rtol=0, atol=5.0)
    assert found["imunoise"]["arw"] == pytest.approx([np.degrees(2e-6) * 60.0] * 3)
    assert found["imunoise"]["vrw"] == pytest.approx([3e-4 * 60.0] * 3)
