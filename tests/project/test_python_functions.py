"""The functions of ``srt`` give what the commands give, from files, recordings and arrays; objects print as tables."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import sims
import srt
from srt.cli import main
from srt.result.json_file import json_text

SCENARIO = {
    "seed": 5,
    "imu": {"from": "navigation-rlg"},
    "fixture": {"from": "lab-1mrad"},
    "site": {"from": "latitude-45"},
    "schedule": {"dwell_s": 3.0, "rate_rad_s": 3.0, "acceleration_rad_s2": 30.0, "settle_s": 0.1, "leg_dwell_s": 0.2},
    "recording": {"sample_rate_hz": 50.0, "serial": "SN-9"},
}
GYRO_LSB, ACCEL_LSB = 1e-5, 1e-4  # rad/s and m/s² per count: below the noise of a sample
ONES = np.ones((9, 3))
STATED = {
    "latitude_deg": 45.0,
    "gravity_m_s2": 9.80665,
    "heading_deg": 0.0,
    "alignment_sigma_mrad": 1.0,
    "rotation_sigma_mrad": 1.0,
    "gyro_noise_deg_per_sqrt_h": 0.002,
    "accel_noise_ug_per_sqrt_hz": 5.0,
    "serial": "SN-9",
}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Write a log of counts, without labels."""
    folder = tmp_path_factory.mktemp("log")
    recording = sims.simulate(sims.scenario_from_dict(SCENARIO)).recording
    counts = np.hstack([recording.gyro / GYRO_LSB, recording.accel / ACCEL_LSB]).round()
    names = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
    np.savetxt(
        folder / "unit.csv",
        np.column_stack([recording.time, counts]),
        fmt="%.10g",
        delimiter=",",
        header=names,
        comments="",
    )
    return folder / "unit.csv"


def options(stated):
    return [text for name, value in stated.items() for text in ("--" + name.replace("_", "-"), str(value))]


@pytest.fixture(scope="module")
def recording(log):
    return srt.read(str(log), time_unit="s", gyro_lsb=GYRO_LSB, accel_lsb="1e-4 m/s^2", **STATED)


@pytest.fixture(scope="module")
def folder(log):
    """Convert the log with the command."""
    said = options({**STATED, "time_unit": "s", "gyro_lsb": GYRO_LSB, "accel_lsb": "1e-4 m/s^2"})
    assert main(["convert", str(log), "-o", str(log.parent / "rec"), "-q", *said]) == 0
    return log.parent / "rec"


@pytest.fixture(scope="module")
def unit(recording):
    return srt.calibrate(recording)


def same(a, b):
    return (
        all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("time", "gyro", "accel"))
        and (a.site, a.fixture, a.noise, a.serial) == (b.site, b.fixture, b.noise, b.serial)
    )  # fmt: skip


def test_reading_a_log_of_counts_gives_what_the_command_writes(recording, folder):
    assert same(recording, srt.read(folder))
    assert srt.load_recording is srt.import_file is srt.read


def test_calibration_by_path_arrays_and_frame_is_that_of_the_command(log, recording, folder, unit, tmp_path, shell):
    shell("calibrate", folder, "-o", tmp_path / "unit.json", "-q")
    written = srt.load_calibration(tmp_path / "unit.json")
    samples = {"gyro_lsb": GYRO_LSB, "accel_lsb": ACCEL_LSB, "time_unit": "s"}
    arrays = (recording.time, recording.gyro, recording.accel)
    found = (
        unit,
        srt.calibrate(folder),
        srt.calibrate(log, **samples, **STATED),
        srt.calibrate(arrays, **STATED),
        srt.calibrate({"time": arrays[0], "gyro": arrays[1], "accel": arrays[2]}, like=recording),
        srt.calibrate(srt.to_frame(recording), like=folder),
    )
    for calibration in found:
        np.testing.assert_array_equal(calibration.errors.vector, written.errors.vector)
        np.testing.assert_array_equal(calibration.covariance, written.covariance)
        assert calibration.warnings == written.warnings


def test_units_of_arrays(recording):
    degrees = srt.read(
        (recording.time * 1e3, np.degrees(recording.gyro), recording.accel), gyro_unit="deg/s", time_unit="ms", **STATED
    )
    np.testing.assert_allclose(degrees.gyro, recording.gyro, rtol=1e-15)
    dt = recording.nominal_interval_s
    steps = srt.read(
        (None, recording.gyro * dt, recording.accel * dt), kind="increment", sample_rate_hz=1 / dt, **STATED
    )
    assert steps.kind == "increment"
    turned = srt.read((recording.time, recording.gyro, recording.accel), map_gyro="y,-x,z", **STATED)
    np.testing.assert_array_equal(turned.gyro[:, 1], -recording.gyro[:, 0])


def test_keyword_arguments_replace_values_of_the_recording(recording, folder):
    assert srt.read(recording) is recording
    again = srt.read(folder, gyro_noise_deg_per_sqrt_h=0.004, serial="other")
    assert again.noise.gyro_noise == pytest.approx(2.0 * recording.noise.gyro_noise)
    assert (again.serial, again.noise.accel_noise, again.site) == ("other", recording.noise.accel_noise, recording.site)
    higher = srt.read(recording, height_m=1000.0)
    assert higher.site.gravity_m_s2 < 9.806 < recording.site.gravity_m_s2


def test_inspection_and_comparison_are_those_of_the_commands(recording, folder, tmp_path, shell):
    shell("inspect", folder, "--deep", "--json", tmp_path / "i.json", "-q")
    assert json_text(srt.inspect(folder, deep=True).as_dict()) == (tmp_path / "i.json").read_text()
    names = ["closed-form", "least-squares"]
    said = [text for name in names for text in ("--estimator", name)]
    shell("compare", folder, *said, "-o", tmp_path / "c.json", "-q")
    written, found = json.loads((tmp_path / "c.json").read_text()), srt.compare(folder, names).as_dict()
    for row in (*written["estimators"], *found["estimators"]):
        row.pop("seconds")
    assert json.loads(json.dumps(found)) == {key: value for key, value in written.items() if key != "digest"}


@pytest.mark.slow
@pytest.mark.usefixtures("short_search")
def test_plan_is_that_of_the_command(tmp_path, shell):
    file = tmp_path / "small.toml"
    file.write_text(
        'imu = { from = "navigation-rlg" }\nfixture = { from = "lab-1mrad" }\nsite = { from = "latitude-45" }\n'
        "[targets]\ngyro_scale_ppm = 50.0\n"
        "[plan]\nlargest_turn_deg = 180\nmost_legs = 1\nmost_sequences = 6\ntotal_time_s = 120.0\n"
    )
    shell("plan", file, "--json", tmp_path / "p.json", "-q")
    task = sims.load_plan_file(file).task()
    named = replace(task, targets={"gyro_scale": float(task.targets[0])})
    from srt.planning.plan_document import plan_document

    for found in (srt.plan(sims.load_plan_file(file)), srt.plan(named)):
        assert json_text(plan_document(found)) == (tmp_path / "p.json").read_text()
    assert repr(found).startswith("Plan: ")
    assert list(srt.to_frame(found).loc["gyro_scale_x", ["target", "unit"]]) == [pytest.approx(50.0), "ppm"]


def test_certificate_of_objects_is_that_of_the_files(recording, folder, tmp_path, monkeypatch):
    monkeypatch.setattr("srt.reports.certificate.html_page.certificate_figures", lambda _: ())
    monkeypatch.setattr("srt.reports.certificate.pdf.certificate_figures", lambda _: ())
    unit = srt.calibrate(folder)
    unit.save(tmp_path / "unit.json")
    of_file = srt.certificate(tmp_path / "unit.json", folder)
    of_object = srt.certificate(unit, srt.read(folder))
    assert of_object.source.sha256 == of_file.source.sha256
    assert of_object.parameters == of_file.parameters
    assert of_object.course is not None
    with pytest.raises(srt.InputError, match="made in memory"):
        srt.certificate(unit, replace(recording, data_sha256=None))
    with pytest.raises(srt.InputError, match=r"ends in \.html"):
        srt.certificate(unit, output=tmp_path / "page.pdf")


def test_results_print_as_tables(recording, unit):
    shown = {
        name: repr(each) for name, each in (("recording", recording), ("unit", unit), ("look", srt.inspect(recording)))
    }
    assert re.search(r"gyro_scale_x +-?[\d.]+ +[\d.]+ +ppm", shown["unit"])
    assert re.search(r"samples +\d+ \(rate\)", shown["recording"])
    assert "Samples" in shown["look"]
    for text in shown.values():
        assert max(map(len, text.splitlines())) <= 80
    page = unit._repr_html_()
    assert page.count("<tr>") == 28
    assert '<td style="text-align:left">gyro_scale_x</td>' in page
    assert recording._repr_html_().startswith("<table>")
    assert srt.inspect(recording)._repr_html_().startswith("<pre>")


def test_frames_hold_the_values_of_the_results(recording, unit):
    frame = srt.to_frame(unit)
    assert frame.loc["gyro_scale_x", "value"] == pytest.approx(1e6 * unit.errors["gyro_scale_x"], rel=1e-15)
    np.testing.assert_allclose(frame["sigma"] / unit.sigma, srt.sensor_errors.DISPLAY_FACTORS, rtol=1e-15)
    look = srt.to_frame(srt.inspect(recording))
    assert list(look["sequence"]) == [turn.sequence for turn in srt.recognise(recording).turns]
    pair = srt.compare(recording, ["closed-form", "least-squares"])
    assert set(srt.to_frame(pair)) >= {"closed-form value", "least-squares sigma"}
    assert srt.to_frame(srt.certificate(unit)).shape == (27, 5)


def test_figures_are_made_and_written(recording, unit, tmp_path):
    figure = srt.plot(unit, tmp_path / "unit.png", title="unit")
    assert (tmp_path / "unit.png").stat().st_size > 10_000
    assert any("κ" in text.get_text() for axes in figure.axes for text in axes.get_xticklabels())


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (srt.read, r"Gravity is not known: give it with gravity_m_s2=, or latitude_deg= and height_m="),
        (lambda log: srt.read(log, gravity_m_s2=9.8), r"give gyro_unit= \(gyro_unit in recording.toml\)"),
        (lambda log: srt.read(log, gyro_units="rad/s"), r"no keyword 'gyro_units' \(did you mean gyro_unit\?\)"),
        (lambda log: srt.read(log, gravity_m_s2=9.8, gyro_lsb="one"), "gyro_lsb= is 'one'"),
        (lambda log: srt.read(log, gravity_m_s2=9.8, gyro_lsb=[1.0, 2.0]), "one finite number, or three"),
        (lambda log: srt.read(log, format="cvs", gravity_m_s2=9.8), "no format 'cvs'"),
        (lambda log: srt.read(42), "int is no recording: give the path"),
        (lambda log: srt.read({"gyro": np.ones((9, 3))}), "there is no accel"),
        (lambda log: srt.read((None, ONES[:, :2], ONES), gravity_m_s2=9.8), r"expected"),
        (lambda log: srt.read((None, "text", "text"), gravity_m_s2=9.8), "gyro does not consist of numbers"),
        (lambda log: srt.read((None, ONES, ONES), gravity_m_s2=9.8, topic="/imu"), "arrays have none"),
        (lambda log: srt.read(log.parent / "absent"), "There is no recording"),
        (lambda log: srt.calibrate(log, estimater="ekf"), "Unknown option 'estimater'"),
        (lambda log: srt.plan("lab.toml"), r"sims\.load_plan_file"),
        (lambda log: srt.to_frame(3), "no frame of a int"),
        (lambda log: srt.plot(srt.SensorErrors()), "no figure"),
    ],
)  # fmt: skip
def test_wrong_use_is_one_sentence_of_python(log, call, sentence):
    with pytest.raises(srt.InputError, match=sentence) as caught:
        call(log)
    assert "--" not in str(caught.value)


def test_a_keyword_of_a_recording_is_refused_where_the_file_states_it(folder):
    with pytest.raises(srt.InputError, match="gyro_unit is given, but the recording states it"):
        srt.read(folder, gyro_unit="deg/s")


def test_a_recording_may_be_given_by_name(recording):
    for function in (srt.find_turns, srt.recognise):
        assert function(recording=recording) is function(recording)
