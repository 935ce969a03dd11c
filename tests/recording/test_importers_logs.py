"""Logs of autopilots and telephones, written by the formats' own libraries, come back sample by sample."""

import zipfile

import numpy as np
import pytest
from log_samples import IMU_COLUMNS, IMU_MESSAGES, OTHER, STAMPS, US, VALUES, N, assert_same, ff, note, read

from srt.exceptions import InputError
from srt.recording.importer_registry import find_importer, import_file
from srt.recording.importers import child_process

pytestmark = pytest.mark.usefixtures("forked_readers")

# PX4


def test_sensor_combined_comes_back(tmp_path):
    ff.write_ulog(tmp_path / "a.ulg", [("sensor_combined", 0, ff.COMBINED, ff.combined(US, VALUES))])
    imported = read(tmp_path / "a.ulg")
    assert_same(imported)
    assert imported.time[0] == 1.0
    assert imported.serial == "000100000000"
    assert note(imported, "PX4 has calibrated")


def test_accelerometers_with_their_own_stamps_are_brought_to_the_gyros(tmp_path):
    # Exact in 32-bit floats, and linear in time: a reading 1 ms earlier is smaller by a fifth of a step.
    ramp = np.outer(np.arange(N), np.full(6, 5.0))
    columns = ff.combined(US, ramp, -1000)
    columns["accelerometer_timestamp_relative"][3] = 0x7FFFFFFF  # PX4's word for no reading yet
    ff.write_ulog(tmp_path / "a.ulg", [("sensor_combined", 0, ff.COMBINED, columns)])
    imported = read(tmp_path / "a.ulg")
    # The samples on both sides of the missing reading have none close by, and the last one none after it.
    kept = np.r_[0:2, 4 : N - 1]
    np.testing.assert_array_equal(imported.gyro, ramp[kept, :3])
    # Readings of up to 115 and stamps of a microsecond in 0.1 s: rounding of about 115 · 1e-15.
    np.testing.assert_allclose(imported.accel, ramp[kept, 3:] + 1.0, rtol=0, atol=1e-11)
    assert note(imported, "1 samples without an accelerometer reading dropped")


def increments(**changes):
    return {
        "timestamp": US + np.uint64(300),
        "timestamp_sample": US,
        **ff.triad("delta_angle", VALUES[:, :3]),
        **ff.triad("delta_velocity", VALUES[:, 3:]),
        "delta_angle_dt": np.full(N, 5000),
        "delta_velocity_dt": np.full(N, 5000),
        **changes,
    }


def test_vehicle_imu_gives_increments(tmp_path):
    ff.write_ulog(tmp_path / "a.ulg", [("vehicle_imu", 0, ff.VEHICLE_IMU, increments())])
    imported = read(tmp_path / "a.ulg")
    assert imported.kind == "increment"
    assert_same(imported)
    assert imported.time[0] == 1.0  # the sample's stamp, not the message's


def test_velocity_increments_over_another_time_are_scaled_with_a_note(tmp_path):
    spans = np.full(N, 5000)
    spans[7] = 4000
    ff.write_ulog(tmp_path / "a.ulg", [("vehicle_imu", 0, ff.VEHICLE_IMU, increments(delta_velocity_dt=spans))])
    imported = read(tmp_path / "a.ulg")
    factor = np.where(np.arange(N) == 7, 1.25, 1.0)[:, None]
    np.testing.assert_array_equal(imported.accel, VALUES[:, 3:] * factor)
    assert note(imported, "in 1 of 24 samples")


@pytest.mark.parametrize("every", [2, 100])
def test_increments_of_a_log_with_a_part_of_the_messages_are_read_as_rates(tmp_path, every):
    """5 ms of 10 ms, or of the 500 ms of PX4's default: as increments they would be too small by that ratio."""
    spans = {"delta_angle_dt": np.full(N, 5000), "delta_velocity_dt": np.full(N, 4000)}
    columns = increments(timestamp_sample=US[0] + every * (US - US[0]), **spans)
    ff.write_ulog(tmp_path / "a.ulg", [("vehicle_imu", 0, ff.VEHICLE_IMU, columns)])
    imported = read(tmp_path / "a.ulg", topic="vehicle_imu")
    assert imported.kind == "rate"
    assert imported.units["gyro"].startswith("rad/s")
    np.testing.assert_allclose(imported.gyro, VALUES[:, :3] / 0.005, rtol=4 * np.finfo(float).eps)
    np.testing.assert_allclose(imported.accel, VALUES[:, 3:] / 0.004, rtol=4 * np.finfo(float).eps)
    assert note(imported, "read as mean rates over their own intervals. A calibration needs a log of every message")


def test_increments_with_lost_messages_and_jitter_stay_increments(tmp_path):
    """A lost message is a gap; the increments between the others still add up to the angle."""
    stamps = US.astype(np.int64) + np.where(np.arange(N) < 9, 0, 50_000) + 400 * (-1) ** np.arange(N)
    spans = np.diff(stamps, prepend=stamps[0] - 5000)
    spans[9] = 5000
    columns = increments(timestamp_sample=stamps, delta_angle_dt=spans, delta_velocity_dt=spans)
    ff.write_ulog(tmp_path / "a.ulg", [("vehicle_imu", 0, ff.VEHICLE_IMU, columns)])
    imported = read(tmp_path / "a.ulg")
    assert imported.kind == "increment"
    np.testing.assert_array_equal(imported.gyro, VALUES[:, :3])
    np.testing.assert_array_equal(imported.accel, VALUES[:, 3:])


def drivers():
    return [
        ("sensor_gyro", 0, ff.SENSOR, driver(VALUES[:, :3], 31.5)),
        ("sensor_accel", 0, ff.SENSOR, driver(VALUES[:, 3:], 40.0)),
    ]


def driver(values, celsius):
    names = ("timestamp", "timestamp_sample", "x", "y", "z", "temperature")
    return dict(zip(names, (US, US, *values.T, np.full(N, celsius)), strict=True))


def test_driver_topics_come_back_with_the_gyros_temperature(tmp_path):
    ff.write_ulog(tmp_path / "a.ulg", drivers())
    imported = read(tmp_path / "a.ulg")
    assert_same(imported)
    np.testing.assert_array_equal(imported.temperature, np.full(N, 31.5))
    assert not note(imported, "interpolation")


def test_topic_and_instance_choose(tmp_path):
    both = [("sensor_combined", i, ff.COMBINED, ff.combined(US, v)) for i, v in ((0, VALUES), (1, OTHER))]
    ff.write_ulog(tmp_path / "a.ulg", [*both, *drivers()])
    imported = read(tmp_path / "a.ulg")
    assert note(imported, "has the instances 0, 1; 0 was read")
    assert note(imported, "Read from sensor_combined; sensor_gyro would be read with --topic")
    assert_same(read(tmp_path / "a.ulg", instance=1), OTHER)
    assert not note(read(tmp_path / "a.ulg", topic="sensor_gyro"), "PX4 has calibrated")
    with pytest.raises(InputError, match="no instance 2: use one of 0, 1"):
        read(tmp_path / "a.ulg", instance=2)
    with pytest.raises(InputError, match=r"did you mean sensor_gyro\?"):
        read(tmp_path / "a.ulg", topic="sensor_gyr")
    with pytest.raises(InputError, match=r"holds no samples of vehicle_imu \(found: sensor_accel \[0\]"):
        read(tmp_path / "a.ulg", topic="vehicle_imu")


def subscription(number, name):
    """Length, "A" for added, instance, number, name."""
    return (len(name) + 3).to_bytes(2, "little") + b"A" + bytes([0]) + number.to_bytes(2, "little") + name.encode()


@pytest.mark.parametrize(
    ("definitions", "refusal"),
    [
        ({"bomb": "big[60000] a;", "big": "double[60000] x;"}, r"takes more than (64 MiB of memory|3 s) to read"),
        ({"bomb": "b x;", "b": "bomb x;"}, "is not a readable ULog .*recursion"),
        ({"bomb": "uint8_t[60000] x;"}, "holds no samples of sensor_combined"),
    ],
)
def test_definitions_that_unfold_without_end_are_refused(tmp_path, monkeypatch, definitions, refusal):
    from pyulog import ULog

    monkeypatch.setattr(child_process, "MEMORY_ALLOWANCE", 64 << 20)
    # Close to the limit on memory, Python may search for garbage until the time is used up.
    monkeypatch.setattr(child_process, "TIME_ALLOWANCE_S", 2)
    log = ULog(None)
    for name, definition in definitions.items():
        log.message_formats[name] = ULog.MessageFormat(f"{name}:{definition}".encode(), None)
    log.write_ulog(str(tmp_path / "a.ulg"))
    with (tmp_path / "a.ulg").open("ab") as file:
        file.write(b"".join(subscription(number, "bomb") for number in range(5)))
    with pytest.raises(InputError, match=refusal):
        read(tmp_path / "a.ulg")


def test_a_foreign_topic_of_the_same_name_is_refused(tmp_path):
    columns = {"timestamp": US, "x": VALUES[:, 0]}
    ff.write_ulog(tmp_path / "a.ulg", [("sensor_combined", 0, "uint64_t timestamp;float x;", columns)])
    with pytest.raises(InputError, match=r"sensor_combined has no field gyro_rad\[0\]"):
        read(tmp_path / "a.ulg")


# Sensor Logger


@pytest.mark.parametrize("folder", [False, True])
@pytest.mark.parametrize("gyro", ["Gyroscope", "GyroscopeUncalibrated"])
def test_sensor_logger_comes_back_from_its_archive_and_its_folder(tmp_path, folder, gyro):
    path = tmp_path / "2023-11-14.zip"
    ff.write_sensor_logger(path, STAMPS, VALUES, ("TotalAcceleration", gyro), folder=folder)
    assert find_importer(path).name == "sensor-logger"
    imported = read(path)
    assert_same(imported)
    assert imported.units["gyro"].startswith("rad/s")
    assert imported.units["accel"].startswith("m/s^2")
    assert note(imported, f"Accelerometers from TotalAcceleration.csv, gyros from {gyro}.csv")


def test_sensor_logger_of_unknown_unit_asks_for_it(tmp_path):
    path = tmp_path / "a.zip"
    ff.write_sensor_logger(path, STAMPS, VALUES, ("AccelerometerUncalibrated", "GyroscopeUncalibrated"))
    with pytest.raises(InputError, match="the unit of accel: give --accel-unit"):
        read(path)
    np.testing.assert_array_equal(read(path, accel_unit="g").accel, VALUES[:, 3:] * 9.80665)
    ff.write_sensor_logger(path, STAMPS, VALUES, ("Accelerometer", "Gyroscope"))
    with pytest.raises(InputError, match=r"no acceleration with gravity \(expected: TotalAcceleration.csv or Acc"):
        read(path)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match=r"a\.zip is not a readable archive of Sensor Logger"):
        import_file(path, name="sensor-logger")


def test_sensor_logger_names_its_archive_in_errors(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("Gyroscope.csv", "time,seconds_elapsed,z,y,x\n1,2,3,4,5\n2,oops,1,1,1\n")
        archive.writestr("TotalAcceleration.csv", "time,seconds_elapsed,z,y,x\n1,2,3,4,5\n2,2,1,oops,1\n")
    with pytest.raises(InputError, match=r"a\.zip/TotalAcceleration\.csv, line 3, column 4 \(y\): 'oops' was found"):
        read(path)


# ArduPilot


@pytest.mark.parametrize("write", [ff.write_dataflash, ff.write_dataflash_text])
def test_the_imu_message_comes_back(tmp_path, write):
    path = tmp_path / "log"
    write(path, IMU_MESSAGES)
    assert find_importer(path).name == "ardupilot"
    imported = read(path)
    assert_same(imported)
    assert imported.time[0] == 1.0
    assert note(imported, "ArduPilot has applied its own calibration")


@pytest.mark.parametrize("write", [ff.write_dataflash, ff.write_dataflash_text])
def test_instances_by_column_and_by_name(tmp_path, write):
    mixed = [row for pair in zip(ff.imu_rows(US, VALUES), ff.imu_rows(US, OTHER, 1), strict=True) for row in pair]
    write(tmp_path / "new", [("IMU", "QBffffff", IMU_COLUMNS, mixed)])
    old = IMU_COLUMNS.replace("I,", "")
    write(
        tmp_path / "old",
        [
            ("IMU", "Qffffff", old, ff.imu_rows(US, VALUES, None)),
            ("IMU2", "Qffffff", old, ff.imu_rows(US, OTHER, None)),
        ],
    )
    for name in ("new", "old"):
        imported = read(tmp_path / name)
        assert_same(imported)
        assert note(imported, "IMU has the instances 0, 1; 0 was read")
        assert_same(read(tmp_path / name, instance=1), OTHER)
        with pytest.raises(InputError, match="IMU has no instance 2: use one of 0, 1"):
            read(tmp_path / name, instance=2)


def test_raw_messages_are_joined_at_the_samples_own_stamps(tmp_path):
    late = US + np.uint64(700)
    messages = [
        (name, "QBQfff", f"TimeUS,I,SampleUS,{','.join(columns)}", [[t, 0, s, *row] for t, s, row in rows])
        for name, columns, rows in (
            ("GYR", ("GyrX", "GyrY", "GyrZ"), zip(late, US, VALUES[:, :3].tolist(), strict=True)),
            ("ACC", ("AccX", "AccY", "AccZ"), zip(late, US, VALUES[:, 3:].tolist(), strict=True)),
        )
    ]
    ff.write_dataflash(tmp_path / "a.bin", [*IMU_MESSAGES, *messages])
    imported = read(tmp_path / "a.bin", topic="GYR")
    assert_same(imported)
    assert imported.time[0] == 1.0
    assert note(read(tmp_path / "a.bin"), "Read from IMU; GYR would be read with --topic")


def test_a_temperature_and_scaled_columns_are_taken(tmp_path):
    rows = [[*row, 25.5] for row in ff.imu_rows(US, VALUES)]
    ff.write_dataflash(tmp_path / "a.bin", [("IMU", "QBfffffff", IMU_COLUMNS + ",T", rows)])
    np.testing.assert_array_equal(read(tmp_path / "a.bin").temperature, np.full(N, 25.5))
    # ArduPilot's letter "c" is a whole number of hundredths.
    rows = [[*row, 2550] for row in ff.imu_rows(US, VALUES)]
    ff.write_dataflash(tmp_path / "b.bin", [("IMU", "QBffffffc", IMU_COLUMNS + ",T", rows)])
    np.testing.assert_array_equal(read(tmp_path / "b.bin").temperature, np.full(N, 25.5))


def test_garbage_in_a_log_is_passed_over_in_silence(tmp_path, capfd):
    path = tmp_path / "a.bin"
    ff.write_dataflash(path, IMU_MESSAGES)
    path.write_bytes(path.read_bytes() + bytes(1000))
    assert_same(read(path))
    assert capfd.readouterr() == ("", "")


def test_a_log_without_imu_says_what_is_needed(tmp_path):
    ff.write_dataflash(tmp_path / "a.bin", [("ATT", "Qf", "TimeUS,Roll", [[1, 2.0]])])
    with pytest.raises(InputError, match=r"holds no samples in messages IMU, or GYR with ACC .*LOG_BITMASK"):
        read(tmp_path / "a.bin")


def test_a_definition_that_contradicts_itself_is_refused(tmp_path):
    ff.write_dataflash(tmp_path / "a.bin", [("IMU", "QBffffff", IMU_COLUMNS.replace("AccZ", "AccY"), [])])
    with pytest.raises(InputError, match="definition of the message IMU contradicts itself"):
        read(tmp_path / "a.bin")


def test_text_that_is_no_number_is_named(tmp_path):
    rows = ff.imu_rows(US, VALUES)
    ff.write_dataflash_text(tmp_path / "a.log", [("IMU", "QBffffff", IMU_COLUMNS, rows)])
    text = (tmp_path / "a.log").read_text()
    (tmp_path / "a.log").write_text(text.replace(repr(rows[3][4]), "oops"))
    with pytest.raises(InputError, match="column GyrZ of IMU holds 'oops', which is no number there"):
        read(tmp_path / "a.log")


def test_a_log_of_ardupilot_with_bytes_that_are_no_message_says_so(tmp_path):
    ff.write_dataflash(tmp_path / "a.bin", IMU_MESSAGES)
    data = (tmp_path / "a.bin").read_bytes()
    at = data.index(b"\xa3\x95", len(data) // 2)  # first bytes of a message
    (tmp_path / "b.bin").write_bytes(data[:at] + b"\xff\xff" + data[at + 2 :])
    assert note(read(tmp_path / "b.bin"), "of its bytes hold no messages; the others were read.")
    assert not note(read(tmp_path / "a.bin"), "The log is damaged")
