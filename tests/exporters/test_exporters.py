"""Files for other tools: read by other code than ours, applied by the tools' formulas, and refused when spoiled.

The formulas are typed here a second time, from the tools' own statements, over plain JSON, YAML and text.
"""

import json
import math

import numpy as np
import pytest
from exporter_formulas import CASES, EXACT, FORMULAS, SINGLE, U, biases_of, calibrated, mm, motion, px4

from srt import exporters
from srt.exporters import Readings, export
from srt.model.rotations import rotation_matrix
from srt.model.sensor_model import accel_triad, gyro_triad

LOSSY = ("px4", "ardupilot", "gtsam", "kf-gins")


def ours(calibration, readings, C):
    w, f = calibration.apply(readings.gyro, readings.accel)
    return mm(C, w), mm(C, f)


def lengths(a, b):
    d = np.linalg.norm(a - b, axis=1)
    return d.max(), math.sqrt(np.mean(d**2))


@pytest.mark.parametrize(("target", "frame"), [case for case in CASES if case[0] not in LOSSY])
def test_the_linear_part_comes_back_whole(target, frame):
    """The tool's formula and our own correction agree for a unit without asymmetry, in the reported axes."""
    rng = np.random.default_rng(5)
    for _ in range(10):
        calibration, readings = calibrated(rng), motion(rng)
        made = export(calibration, target, readings=readings, frame=frame)
        np.testing.assert_allclose(made.C_FB @ made.C_FB.T, np.eye(3), rtol=0, atol=1e-15 * 10)
        assert np.linalg.det(made.C_FB) > 0.0
        np.testing.assert_allclose(rotation_matrix(made.turn_mrad * 1e-3), made.C_FB, rtol=0, atol=1e-14)
        expected = ours(calibration, readings, made.C_FB)
        found = FORMULAS[target](made.texts, readings.gyro, readings.accel, biases_of(calibration))
        within = EXACT
        if target == "vectornav":
            # Twelve constants of at most 1/0.6, each off by half a unit of single precision, times 33 m/s² of reading
            # less bias on three axes; the bias itself adds 0.1 of the same.
            within = SINGLE * 3.0 * (33.0 / 0.6 + 0.1 / 0.6)
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=within)


def test_axes_are_those_that_were_asked_for():
    calibration = calibrated(np.random.default_rng(1))
    Ma = accel_triad(calibration.errors).matrix
    assert np.abs(np.triu(Ma, 1)).max() > 0.01
    np.testing.assert_array_equal(export(calibration, "pyins").C_FB, np.eye(3))
    np.testing.assert_allclose(export(calibration, "pyins", frame="table").C_FB, U.T, rtol=0, atol=1e-15)
    for target, zero in (("kalibr", np.triu), ("openvins", np.triu), ("basalt", np.triu), ("imu_tk", np.tril)):
        C = export(calibration, target, frame="accel").C_FB
        off = zero(Ma @ C.T, 1 if zero is np.triu else -1)
        assert np.abs(off).max() < 1e-15 * 10
        assert np.all(np.diag(Ma @ C.T) > 0.0)


@pytest.mark.parametrize(
    ("target", "frame", "fit"),
    [(*case, fit) for case in CASES for fit in (False, True) if not (fit and exporters.exporter(case[0]).asymmetry)],
)
def test_the_reported_loss_is_the_actual_loss(target, frame, fit):
    """Residuals are measured here by the formulas of this file, asymmetry and all."""
    rng = np.random.default_rng(6)
    calibration = calibrated(rng, asymmetry=True, size=0.02)
    readings = motion(rng)
    item = exporters.exporter(target)
    made = export(calibration, target, readings=readings, frame=frame, asymmetry="fit" if fit else "leave")
    expected = ours(calibration, readings, made.C_FB)
    rows = {row.title: row for row in made.residuals}
    assert ("biases given beside it" in rows) == (not item.biases)
    assert ("asymmetry alone" in rows) == (not item.asymmetry)
    none = np.zeros(3), np.zeros(3)
    given = {"this file": none}
    if not item.biases and not fit:
        given["biases given beside it"] = biases_of(calibration)
    for title, bias in given.items():
        found = FORMULAS[target](made.texts, readings.gyro, readings.accel, bias)
        row = rows[title]
        for (worst, rms), (said_max, said_rms) in zip(
            map(lengths, found, expected), ((row.gyro_max, row.gyro_rms), (row.accel_max, row.accel_rms)), strict=True
        ):
            # Half a unit of the last of twelve digits, and rounding where nothing is lost.
            np.testing.assert_allclose([said_max, said_rms], [worst, rms], rtol=1e-9, atol=EXACT)
    if item.asymmetry:
        assert rows["this file"].accel_max < EXACT
    else:
        assert "scale-factor asymmetry" in made.losses
        # 2 % of at least 20 m/s², which some sample of 200 has on some axis, and no more than 2 % of 30 on three.
        assert 0.01 < rows["asymmetry alone"].accel_max < 3.0


def test_the_loss_covers_all_directions_if_no_recording_is_given():
    rng = np.random.default_rng(7)
    calibration = calibrated(rng, size=0.02)
    made = export(calibration, "px4")
    gyro, accel = made.readings.gyro, made.readings.accel
    w, f = calibration.apply(gyro, accel)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(f, axis=1), 9.80665, rtol=0, atol=1e-12)
    for v, size in ((w, 1.0), (f, 9.80665)):
        # Of n points spread by equal areas the mean is below 1/n and the second moments are a third to the same order.
        np.testing.assert_allclose(v.mean(axis=0) / size, 0.0, atol=5e-3)
        np.testing.assert_allclose(v.T @ v / len(v) / size**2, np.eye(3) / 3.0, atol=5e-3)
    assert len(np.unique(f.round(9), axis=0)) == 1000
    found = px4(made.texts, gyro, accel, None)
    worst, rms = lengths(found[0], w)
    assert made.residuals[0].gyro_max == pytest.approx(worst, rel=1e-9)
    assert made.residuals[0].gyro_rms == pytest.approx(rms, rel=1e-9)


def test_the_factors_of_an_autopilot_are_the_best_that_factors_can_be():
    """Least squares of true on measured force over all directions, axis by axis."""
    calibration = calibrated(np.random.default_rng(8))
    Ma = accel_triad(calibration.errors).matrix
    text = export(calibration, "ardupilot").texts[""]
    p = dict(line.split(",") for line in text.splitlines() if not line.startswith("#"))
    directions = np.vstack([np.eye(3), -np.eye(3)])  # second moments as of the sphere
    measured = mm(Ma, directions)
    best = [np.linalg.lstsq(measured[:, [i]], directions[:, i], rcond=None)[0][0] for i in range(3)]
    found = [float(p[f"INS_ACCSCAL_{x}"]) for x in "XYZ"]
    np.testing.assert_allclose(found, best, rtol=1e-7, atol=0.0)  # single precision


def test_a_fit_is_the_best_line_through_each_channel():
    rng = np.random.default_rng(29)
    calibration = calibrated(rng, asymmetry=True, size=0.02)
    rate, force = rng.uniform(-1.0, 2.0, (300, 3)), rng.uniform(-5.0, 8.0, (300, 3))
    rate[:, 0] = 0.5  # a channel that does not move but by rounding has no slope
    triads = gyro_triad(calibration.errors), accel_triad(calibration.errors)
    readings = Readings(triads[0].read(rate), triads[1].read(force), "turning mostly one way")
    document = json.loads(export(calibration, "pyins", readings=readings, asymmetry="fit").texts[""])
    for sensor, triad, v in (("gyro", triads[0], rate), ("accel", triads[1], force)):
        lines = [np.polyfit(x, np.abs(x), 1) if np.ptp(x) > 0.0 else (0.0, np.abs(x).mean()) for x in v.T]
        slope, offset = np.transpose(lines)
        found = document[sensor]
        # Rounding of the corrected readings (1e-15 of 8) is all that stands between the two.
        expected = triad.matrix + np.diag(triad.asymmetry * slope)
        np.testing.assert_allclose(found["transform"], expected, rtol=0, atol=EXACT)
        np.testing.assert_allclose(found["bias"], triad.bias + triad.asymmetry * offset, rtol=0, atol=EXACT)
