"""Protocols and corrections already applied, in recording.toml."""

import numpy as np
import pytest
from log_samples import IMU_MESSAGES, US, VALUES, ff, note, read

import srt
from srt.exceptions import InputError
from srt.recording import autopilots
from srt.recording.applied import AppliedCorrection
from srt.recording.protocol import load_protocol, protocol_from_dict, protocol_names

SHIPPED = {
    "six-face-tumble", "24-face-tumble", "rate-table", "7-positions", "9-positions", "11-positions", "19-positions",
    "two-axis-table", "ferraris", "hand-turned", "table-1",
}  # fmt: skip


def test_shipped_protocols_are_read_and_last_as_long_as_asked():
    assert set(protocol_names()) == SHIPPED
    for name in protocol_names():
        protocol = load_protocol(name)
        assert protocol.description
        assert protocol.lasting(900.0).total_s == pytest.approx(900.0, rel=1e-12)


def test_nineteen_positions_are_those_of_the_literature():
    protocol = load_protocol("19-positions")
    turns = [("xyz"[int(np.argmax(axis))], round(np.degrees(a))) for s in protocol.steps for axis, a in s.rotations]
    assert turns == [
        *[("y", 90)] * 3, *[("y", -90)] * 3, ("z", 90), *[("x", 90)] * 3, *[("x", -90)] * 3, *[("z", 90)] * 2,
        *[("z", -90)] * 3,
    ]  # fmt: skip
    assert protocol.total_s == 60.0 + 18 * 9.0 + 60.0 + 17 * 20.0


@pytest.mark.parametrize(
    ("name", "stated"),
    [
        *((name, True) for name in ("table-1", "six-face-tumble", "ferraris", "two-axis-table")),
        *((name, False) for name in ("7-positions", "11-positions", "19-positions")),
    ],
)
def test_protocols_of_the_fixture_run_on_it(name, stated):
    """Without a stated axis along the outer axis, one is found with which the fixture can run all steps."""
    protocol = load_protocol(name)
    assert protocol.states_attitudes is stated
    assert len(protocol.on_fixture()) == len(protocol.steps)


def test_the_axis_along_the_outer_axis_is_found_for_each_placing():
    steps = {"down": "z"}, {"rotations": [["x", 90.0]]}, {"down": "x"}, {"rotations": [["y", 90.0], ["z", -90.0]]}
    assert [(down, outer) for down, outer, _ in protocol(*steps).on_fixture()] == [
        ("z", "x"),
        ("z", "x"),
        ("x", "y"),
        ("x", "y"),
    ]


def protocol(*steps, **main):
    return protocol_from_dict({"step": list(steps), **main}, name="mine")


LEVEL = {"down": "z", "along_outer": "y"}


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ([{"down": "z"}, {"rotations": [["x", 90.0], ["y", 90.0]]}], r"step 2 .*leave \[fixture\] out"),
        ([{"down": [1.0, 1.0, 0.0], "along_outer": "y"}], "step 1 .*down is not an IMU axis"),
        ([{"down": "x", "along_outer": "z"}], "step 1 .*z is the inner axis"),
        ([{"down": "y", "along_outer": "y"}], "step 1 .*y is vertical"),
        ([LEVEL, {"rotations": [["x", 90.0]]}], r"step 2 .*turn \+90° about x.*neither the inner axis"),
        ([LEVEL, {"rotations": [["z", 45.0]]}, {"rotations": [["z", 45.0]]}], "step 3 .*none lies along the outer"),
        ([LEVEL, {"rotations": [[[1.0, 1.0, 0.0], 90.0]]}], "step 2 .*between those of the IMU"),
    ],
)
def test_a_step_that_no_fixture_can_run_is_named(steps, said):
    with pytest.raises(InputError, match=f"(?i){said}"):
        protocol(*steps).on_fixture()


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({}, "no step"),
        ({"step": [{"rotations": [["z", 90.0]]}]}, "continues from no pose"),
        ({"step": [{"down": "w"}]}, "step\\[1\\].down"),
        ({"step": [{"down": "z", "rotation": []}]}, "did you mean rotations"),
        ({"step": [{"down": "z", "rotations": [["z", 0.0]]}]}, "not zero"),
        ({"step": [{"down": "z", "turn_s": 3.0}]}, "is a pose"),
        ({"step": [{"id": "1", "down": "z"}]}, "Table 1 defines"),
        ({"step": [{"down": "z", "rotations": [["z", 900.0]], "stated_rate_deg_s": 10.0}]}, "rate_sigma_ppm"),
        (
            {"rate_sigma_ppm": 5.0, "step": [{"down": "z", "rotations": [["z", 9.0]], "stated_rate_deg_s": 99.0}]},
            "less than a third",
        ),
        ({"step": [{"down": "z", "repeat": 0}]}, "repeat"),
        ({"rest_s": -1.0, "step": [{"down": "z"}]}, "rest_s"),
    ],
)
def test_a_malformed_protocol_is_refused_in_one_sentence(document, said):
    with pytest.raises(InputError, match=said) as refused:
        protocol_from_dict(document, name="mine")
    assert "\n" not in str(refused.value)


def test_an_unknown_name_and_too_little_time_are_refused():
    with pytest.raises(InputError, match="did you mean 19-positions"):
        load_protocol("19-position")
    with pytest.raises(InputError, match="leaves no rest"):
        load_protocol("rate-table").lasting(100.0)


OFFSET, SCALE = np.array([0.35, -0.52, 0.21]), np.array([0.981, 1.027, 1.009])
PX4 = {
    "SENS_BOARD_ROT": 10,
    "CAL_ACC1_ID": 2753036,
    "CAL_GYRO1_ID": 2818058,
    **{f"CAL_ACC1_{a}OFF": float(v) for a, v in zip("XYZ", OFFSET, strict=True)},
    **{f"CAL_ACC1_{a}SCALE": float(v) for a, v in zip("XYZ", SCALE, strict=True)},
    **{f"CAL_GYRO1_{a}OFF": 0.01 for a in "XYZ"},
}
ARDUPILOT = {
    "AHRS_ORIENTATION": 14,
    **{f"INS_ACCOFFS_{a}": float(v) for a, v in zip("XYZ", OFFSET, strict=True)},
    **{f"INS_ACCSCAL_{a}": float(v) for a, v in zip("XYZ", SCALE, strict=True)},
    **{f"INS_GYROFFS_{a}": 0.01 for a in "XYZ"},
}
# Roll 180°, yaw 270°.
ORIENTATION_14 = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def test_parameters_that_change_within_the_log_are_not_carried(tmp_path):
    topics = [("sensor_combined", 0, ff.COMBINED, ff.combined(US, VALUES))]
    ff.write_ulog(tmp_path / "a.ulg", topics, PX4)
    assert read(tmp_path / "a.ulg").applied.instance == 1
    ff.write_ulog(tmp_path / "b.ulg", topics, PX4, ((int(US[3]), "CAL_ACC1_YOFF", 0.3),))
    changed = read(tmp_path / "b.ulg")
    assert changed.applied is None
    assert note(changed, "CAL_ACC1_YOFF changed within the log")
    ff.write_ulog(tmp_path / "c.ulg", topics, {**PX4, "CAL_ACC0_ID": 77, "CAL_GYRO0_ID": 78})
    assert note(read(tmp_path / "c.ulg"), "does not state which of PX4's calibrations")


def test_text_logs_and_axis_maps_carry_it(tmp_path):
    messages = [ff.parameter_message(ARDUPILOT, text=True), *IMU_MESSAGES]
    ff.write_dataflash_text(tmp_path / "a.log", messages)
    applied = read(tmp_path / "a.log").applied
    np.testing.assert_array_equal(applied.accel_offset, OFFSET)  # written in full
    np.testing.assert_array_equal(applied.rotation, ORIENTATION_14)
    turned = read(tmp_path / "a.log", map_gyro="y,-x,z", map_accel="y,-x,z").applied
    np.testing.assert_array_equal(turned.rotation, np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) @ ORIENTATION_14)
    assert read(tmp_path / "a.log", map_gyro="y,-x,z", map_accel="x,y,z").applied is None


def test_the_table_of_a_recording_comes_back(tmp_path):
    rng = np.random.default_rng(15)
    applied = AppliedCorrection(
        "px4",
        2,
        17,
        18,
        rotation=autopilots.rotation_of(1.0, 2.0, 3.0),
        gyro_matrix=np.eye(3) + 0.01 * rng.normal(size=(3, 3)),
        gyro_offset=rng.normal(size=3),
        accel_matrix=np.diag(SCALE),
        accel_offset=OFFSET,
        g_sensitivity=rng.normal(size=(3, 3)),
    )
    time = np.arange(1, 11) * 0.01
    values = rng.normal(size=(10, 3))
    srt.write_recording(srt.Recording(time, values, values, srt.Site(9.8), applied=applied), tmp_path / "r")
    found = srt.load_recording(tmp_path / "r").applied
    assert found.document() == applied.document()
    toml = tmp_path / "r" / "recording.toml"
    toml.write_text(toml.read_text().replace("accel_id = 18", "accel_id = 1.5"))
    with pytest.raises(srt.InputError, match=r"imu.applied.accel_id is 1.5"):
        srt.load_recording(tmp_path / "r")


def test_device_ids_find_the_calibration_of_increments_and_drivers(tmp_path):
    """vehicle_imu names its devices; the drivers' topics are not calibrated, and have the ids that a file needs."""
    others = {"CAL_ACC0_ID": 77, "CAL_GYRO0_ID": 78, **{f"CAL_ACC0_{a}OFF": 9.0 for a in "XYZ"}}
    increments = {
        "timestamp": US, "timestamp_sample": US, **ff.triad("delta_angle", VALUES[:, :3]),
        **ff.triad("delta_velocity", VALUES[:, 3:]), "delta_angle_dt": np.full(len(US), 5000),
        "delta_velocity_dt": np.full(len(US), 5000), "accel_device_id": np.full(len(US), 2753036),
        "gyro_device_id": np.full(len(US), 2818058),
    }  # fmt: skip
    ff.write_ulog(tmp_path / "a.ulg", [("vehicle_imu", 0, ff.VEHICLE_IMU, increments)], {**PX4, **others})
    applied = read(tmp_path / "a.ulg").applied
    assert (applied.instance, applied.gyro_id, applied.accel_id) == (1, 2818058, 2753036)
    np.testing.assert_allclose(applied.accel_offset, OFFSET, rtol=2.0**-24)
    drivers = [
        (name, 0, ff.SENSOR, dict(zip(("timestamp", "timestamp_sample", "x", "y", "z", "device_id"),
                                      (US, US, *v.T, np.full(len(US), device)), strict=True)))
        for name, v, device in (("sensor_gyro", VALUES[:, :3], 2818058), ("sensor_accel", VALUES[:, 3:], 2753036))
    ]  # fmt: skip
    ff.write_ulog(tmp_path / "b.ulg", drivers, {**PX4, **others})
    applied = read(tmp_path / "b.ulg").applied
    assert set(applied.document()) <= {"system", "instance", "gyro_instance", "gyro_id", "accel_id"}
    assert (applied.system, applied.instance, applied.gyro_id) == ("px4", 1, 2818058)


@pytest.mark.parametrize(
    ("parameters", "fragment"),
    [
        ({"SENS_BOARD_ROT": 77}, "SENS_BOARD_ROT is 77, but 0 to 40"),
        ({"CAL_ACC1_XSCALE": float("nan")}, "not 9 finite numbers"),
        ({"CAL_ACC1_XSCALE": 0.0}, "has no inverse"),
        ({"CAL_GYRO1_ROT": 3}, "SENS_BOARD_ROT and CAL_GYRO1_ROT turn accelerometers and gyros differently"),
    ],
)
def test_parameters_that_cannot_be_are_not_carried(tmp_path, parameters, fragment):
    topics = [("sensor_combined", 0, ff.COMBINED, ff.combined(US, VALUES))]
    ff.write_ulog(tmp_path / "a.ulg", topics, PX4 | parameters)
    imported = read(tmp_path / "a.ulg")
    assert imported.applied is None
    assert note(imported, fragment)
