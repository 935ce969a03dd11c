"""Logs of robots and autopilots: files written by the formats' own libraries come back sample by sample."""

import importlib
import os
import sqlite3
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from srt.exceptions import InputError, MissingExtraError
from srt.recording.import_options import ImportOptions
from srt.recording.imported_samples import to_recording
from srt.recording.importer_registry import find_importer, import_file
from srt.recording.importers import child_process
from srt.recording.recording import Site

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
ff = importlib.import_module("foreign_files")

N = 24
STAMPS, VALUES = ff.samples(N)
OTHER = -VALUES
US = ((STAMPS - STAMPS[0]) // 1000 + 1_000_000).astype(np.uint64)
SECONDS = 0.005 * np.arange(N)
STEP_NS = 5_000_000

IMU_COLUMNS = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
IMU_MESSAGES = [("IMU", "QBffffff", IMU_COLUMNS, ff.imu_rows(US, VALUES))]


def read(path, **options):
    return import_file(path, ImportOptions(**options))[1]


def assert_same(imported, values=VALUES, seconds=SECONDS):
    """Readings to the last bit; stamps to the rounding of a number of a few seconds."""
    np.testing.assert_array_equal(imported.gyro, values[:, :3])
    np.testing.assert_array_equal(imported.accel, values[:, 3:])
    # One rounding of an integer's quotient: half a unit in the last place of 2 s, 2.2e-16 s.
    np.testing.assert_allclose(imported.time - imported.time[0], seconds, rtol=0, atol=1e-15)


def note(imported, part):
    return any(part in each for each in imported.notes)


# ROS bags


@pytest.mark.parametrize("compression", ["", "bz2", "lz4"])
def test_a_ros_1_bag_comes_back(tmp_path, compression):
    ff.write_bag1(tmp_path / "imu.bag", {"/imu": (STAMPS, VALUES, "")}, compression)
    imported = read(tmp_path / "imu.bag")
    assert_same(imported)
    assert imported.kind == "rate"
    assert imported.time[0] == 0.0
    assert note(imported, f"counted from the first stamp, {STAMPS[0]} ns")
    assert to_recording(imported, Site(9.81)).nominal_interval_s == pytest.approx(0.005, abs=1e-15)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("compression", ["", "message", "file"])
def test_a_ros_2_bag_comes_back_from_its_folder(tmp_path, storage, compression):
    ff.write_bag2(tmp_path / "bag", {"/imu": (STAMPS, VALUES, "")}, storage, compression)
    assert_same(read(tmp_path / "bag"))


@pytest.mark.parametrize(("storage", "compression"), [("mcap", ""), ("mcap", "storage"), ("sqlite3", "message")])
def test_a_ros_2_bag_comes_back_from_its_one_file(tmp_path, storage, compression):
    ff.write_bag2(tmp_path / "bag", {"/imu": (STAMPS, VALUES, "")}, storage, compression)
    (file,) = (each for each in (tmp_path / "bag").iterdir() if each.name != "metadata.yaml")
    assert_same(read(file))
    if storage == "mcap":
        # Known by its content, whatever it is called.
        assert_same(read(file.rename(tmp_path / "renamed.log")))


@pytest.mark.parametrize("compression", ["", "storage"])
def test_an_mcap_file_without_profile_comes_back(tmp_path, compression):
    """The profile is optional in MCAP; recorders other than ROS's leave it empty."""
    ff.write_bag2(tmp_path / "bag", {"/imu": (STAMPS, VALUES, "")}, "mcap", compression)
    data = (tmp_path / "bag" / "bag.mcap").read_bytes()
    # After the magic and nine bytes stand the profile and the library, each with its length before it.
    start = 17
    library = data[start + 12 : start + 12 + int.from_bytes(data[start + 8 : start + 12], "little")]
    assert data[start : start + 8] == b"\x04\0\0\0ros2"
    for profile in (b"", b"ros1", b"x"):
        named = library.ljust(len(library) + 4 - len(profile))
        header = b"".join(len(each).to_bytes(4, "little") + each for each in (profile, named))
        (tmp_path / "a.mcap").write_bytes(data[:start] + header + data[start + len(header) :])
        if profile:
            with pytest.raises(InputError, match=r"a\.mcap is not a readable ROS 2 bag .*Profile is not ros2"):
                read(tmp_path / "a.mcap")
        else:
            assert_same(read(tmp_path / "a.mcap"))


def test_one_of_several_topics_is_chosen_and_the_others_are_named(tmp_path):
    path = tmp_path / "imu.bag"
    ff.write_bag1(path, {"/b": (STAMPS, VALUES, ""), "/a": (STAMPS[:9], OTHER[:9], "")})
    imported = read(path)
    assert_same(imported)
    assert note(imported, "Several IMUs there: /a (9), /b (24); topic /b was read")
    assert_same(read(path, topic="/a"), OTHER[:9], SECONDS[:9])
    with pytest.raises(InputError, match=r"holds no IMU topic /c.*: use one of those there, /a \(9\), /b \(24\)"):
        read(path, topic="/c")


@pytest.mark.parametrize("topic", [None, "/gyro,/accel"])
def test_sensors_with_a_topic_each_are_joined_at_the_gyros_stamps(tmp_path, topic):
    # Readings that are linear in time: interpolation between them is exact but for rounding.
    ramp = np.outer(SECONDS, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) + 1.0
    shift = 0.001
    ff.write_bag1(
        tmp_path / "imu.bag",
        {"/gyro": (STAMPS, ramp, "accel"), "/accel": (STAMPS[:20] - round(shift * 1e9), ramp[:20], "gyro")},
    )
    imported = read(tmp_path / "imu.bag", topic=topic)
    # The last accelerometer reading is before gyro sample 19; those from there on have none after them.
    assert len(imported.time) == 19
    np.testing.assert_array_equal(imported.gyro, ramp[:19, :3])
    # Rounding: readings of up to 2, a few operations of 2.2e-16 each; stamps relative to 0.1 s.
    np.testing.assert_allclose(imported.accel, ramp[:19, 3:] + shift * np.array([4.0, 5.0, 6.0]), rtol=0, atol=1e-14)
    assert note(imported, "interpolation")
    assert note(imported, "5 gyro samples without accelerometer readings around them dropped")


def test_a_topic_without_a_sensor_asks_for_both(tmp_path):
    ff.write_bag1(tmp_path / "imu.bag", {"/gyro": (STAMPS, VALUES, "accel")})
    with pytest.raises(InputError, match=r"topic /gyro hold no accelerometers: .* --topic GYRO,ACCEL"):
        read(tmp_path / "imu.bag")
    ff.write_bag1(tmp_path / "b.bag", {"/gyro": (STAMPS, VALUES, "accel"), "/accel": (STAMPS, VALUES, "gyro")})
    with pytest.raises(InputError, match="topic /accel hold no gyros: name another"):
        read(tmp_path / "b.bag", topic="/accel,/gyro")


def test_messages_without_stamps_take_the_times_of_recording(tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(tmp_path / "imu.bag") as writer:
        connection = writer.add_connection("/imu", ff.IMU, typestore=store)
        raw = ff.imu_messages(store, np.zeros(N, dtype=np.int64), VALUES, ros1=True)
        for stamp, message in zip(STAMPS.tolist(), raw, strict=True):
            writer.write(connection, stamp, message)
    imported = read(tmp_path / "imu.bag")
    assert_same(imported)
    assert note(imported, "have no stamps")


def test_late_messages_are_put_in_order_and_a_clock_set_back_is_refused(tmp_path):
    order = np.r_[0:5, 6, 5, 7:N]
    ff.write_bag1(tmp_path / "late.bag", {"/imu": (STAMPS[order], VALUES[order], "")})
    imported = read(tmp_path / "late.bag")
    # The bag's own index sorts by time already; header stamps that disagree with it are what is left to sort.
    assert_same(imported)

    us = US.astype(np.int64)[order]
    ff.write_dataflash(tmp_path / "late.bin", [("IMU", "QBffffff", IMU_COLUMNS, ff.imu_rows(us, VALUES[order]))])
    imported = read(tmp_path / "late.bin")
    assert_same(imported)
    assert note(imported, "IMU [0]: 1 samples that arrived late were put in order")

    back = US.astype(np.int64) + 10_000_000
    back[12:] -= 5_000_000
    ff.write_dataflash(tmp_path / "back.bin", [("IMU", "QBffffff", IMU_COLUMNS, ff.imu_rows(back, VALUES))])
    with pytest.raises(InputError, match="goes back"):
        to_recording(read(tmp_path / "back.bin"), Site(9.81))


def test_a_bag_without_imu_lists_its_topics(tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
        writer.write(connection, 1, bytes(4))
    with pytest.raises(InputError, match=r"no topic of type sensor_msgs/msg/Imu \(topics: /text \(std_msgs/msg/Str"):
        read(tmp_path / "a.bag")


def test_definitions_of_other_topics_do_no_harm_and_a_foreign_imu_is_refused(tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    code = "float64 x\nstring EVIL=__import__('os').abort()\n)(]["
    with Writer(tmp_path / "a.bag") as writer:
        own = writer.add_connection("/imu", ff.IMU, typestore=store)
        writer.add_connection("/odd", "odd_msgs/msg/Odd", msgdef=code, md5sum="0" * 32)
        for stamp, message in zip(STAMPS.tolist(), ff.imu_messages(store, STAMPS, VALUES, ros1=True), strict=True):
            writer.write(own, stamp, message)
    assert_same(read(tmp_path / "a.bag"))

    with Writer(tmp_path / "b.bag") as writer:
        own = writer.add_connection("/imu", ff.IMU, msgdef="float64 x", md5sum="0" * 32)
        writer.write(own, 1, bytes(8))
    with pytest.raises(InputError, match="topic /imu has another definition of sensor_msgs/Imu than ROS"):
        read(tmp_path / "b.bag")


@pytest.mark.parametrize("where", ["../outside.mcap", "/outside.mcap", "a/../../outside.mcap", "..", "link.mcap"])
def test_a_bag_reads_nothing_outside_its_folder(tmp_path, where):
    ff.write_bag2(tmp_path / "bag", {"/imu": (STAMPS, VALUES, "")})
    (tmp_path / "bag" / "bag.mcap").rename(tmp_path / "outside.mcap")
    if where == "link.mcap":
        (tmp_path / "bag" / "link.mcap").symlink_to(tmp_path / "outside.mcap")
    metadata = tmp_path / "bag" / "metadata.yaml"
    name = where if where != "/outside.mcap" else str(tmp_path / "outside.mcap")
    metadata.write_text(metadata.read_text().replace("bag.mcap", name))
    refusal = {"link.mcap": "'link.mcap', which lies outside the bag", "..": "is not a readable .*[Ii]s a directory"}
    with pytest.raises(InputError, match=refusal.get(where, "files are missing: .*/bag/outside.mcap")):
        read(tmp_path / "bag")


def test_a_bag_that_lacks_a_file_is_refused(tmp_path):
    ff.write_bag2(tmp_path / "bag", {"/imu": (STAMPS, VALUES, "")})
    (tmp_path / "bag" / "bag.mcap").unlink()
    with pytest.raises(InputError, match=r"files are missing: .*bag\.mcap"):
        read(tmp_path / "bag")


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE VIEW schema AS WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT 1 FROM c) SELECT n FROM c",
        "CREATE TABLE other (a, b AS (zeroblob(1000000000)))",
        "CREATE TRIGGER t AFTER INSERT ON topics BEGIN DELETE FROM topics; END",
    ],
)
def test_a_database_that_computes_is_refused(tmp_path, statement):
    ff.write_bag2(tmp_path / "bag", {"/imu": (STAMPS, VALUES, "")}, "sqlite3")
    database = sqlite3.connect(tmp_path / "bag" / "bag.db3")
    if "VIEW schema" in statement:
        database.execute("DROP TABLE IF EXISTS schema")
    database.execute(statement)
    database.commit()
    database.close()
    with pytest.raises(InputError, match="that computes"):
        read(tmp_path / "bag")


def test_the_path_of_a_database_may_not_look_like_an_address(tmp_path):
    ff.write_bag2(tmp_path / "bag", {"/imu": (STAMPS, VALUES, "")}, "sqlite3")
    folder = (tmp_path / "bag").rename(tmp_path / "run #3")
    with pytest.raises(InputError, match="rename it"):
        read(folder)


# Guards


def allocate(path, options):
    return np.ones(1 << 40)


def loop(path, options):
    while True:
        pass


def crash(path, options):
    os.abort()


def fail(path, options):
    raise KeyError("a defect of the reader")


def shout(path, options):
    print("not an answer")
    os.write(1, b"not an answer")
    os.write(2, b"not an answer")
    raise InputError(f"{path} holds nothing.")


def in_child(name, path):
    return child_process.read_in_child(f"{__name__}:{name}", path, ImportOptions())


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="limits of a process are Linux's")
def test_a_reader_without_end_is_stopped_with_a_sentence(tmp_path, monkeypatch, capfd):
    path = tmp_path / "a"
    path.write_bytes(bytes(100))
    with pytest.raises(InputError, match=rf"{path} takes more than 512 MiB of memory to read, .* copy it again"):
        in_child("allocate", path)
    with pytest.raises(InputError, match=rf"{path} ended its reader \(exit code -6\): it is damaged"):
        in_child("crash", path)
    monkeypatch.setattr(child_process, "TIME_ALLOWANCE_S", 1)
    with pytest.raises(InputError, match=rf"{path} takes more than 2 s to read, .*: it is damaged"):
        in_child("loop", path)
    assert capfd.readouterr() == ("", "")


def test_a_child_answers_with_the_readers_own_error_and_nothing_else(tmp_path, capfd):
    path = tmp_path / "a"
    path.write_bytes(bytes(100))
    with pytest.raises(InputError, match=rf"^{path} holds nothing\.$"):
        in_child("shout", path)
    with pytest.raises(RuntimeError, match="a defect of the reader"):
        in_child("fail", path)
    assert capfd.readouterr() == ("", "")


def test_limits_grow_with_the_size_of_the_file(tmp_path):
    (tmp_path / "a").write_bytes(bytes(3 << 20))
    (tmp_path / "b").write_bytes(bytes(1 << 20))
    assert child_process.limits_for(tmp_path / "a") == ((512 + 96) << 20, 35)
    assert child_process.limits_for(tmp_path) == ((512 + 128) << 20, 40)


def test_without_limits_a_note_warns(tmp_path, monkeypatch):
    monkeypatch.setattr(child_process, "spawn", importlib.import_module("fuzz").InProcess)
    monkeypatch.setitem(sys.modules, "resource", None)
    assert not child_process.impose(child_process.ProcessLimits(1 << 30, 10))
    ff.write_ulog(tmp_path / "a.ulg", [("sensor_combined", 0, ff.COMBINED, ff.combined(US, VALUES))])
    assert note(read(tmp_path / "a.ulg"), "does not limit the memory of a process")


def test_a_module_in_the_current_folder_is_not_imported(tmp_path, monkeypatch):
    """A log may lie beside a file that has the name of a library."""
    (tmp_path / "pyulog.py").write_text("raise SystemExit('imported')")
    (tmp_path / "json.py").write_text("raise SystemExit('imported')")
    ff.write_ulog(tmp_path / "a.ulg", [("sensor_combined", 0, ff.COMBINED, ff.combined(US, VALUES))])
    monkeypatch.chdir(tmp_path)
    assert_same(read(Path("a.ulg")))


def test_an_index_that_is_read_again_and_again_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(child_process, "MEMORY_ALLOWANCE", 64 << 20)
    stamps, values = ff.samples(2000)
    path = tmp_path / "a.bag"
    ff.write_bag1(path, {"/imu": (stamps, values, "")})
    data = path.read_bytes()

    def number(at, width=4):
        return int.from_bytes(data[at : at + width], "little")

    # At the end stand the connection and the chunk, each as length, header, length, data.
    place = number(data.index(b"index_pos=") + 10, 8)
    place += 4 + number(place)
    place += 4 + number(place)
    more = 2000
    count = data.index(b"chunk_count=") + 12
    path.write_bytes(data[:count] + (1 + more).to_bytes(4, "little") + data[count + 4 :] + more * data[place:])
    # Of 24 bytes for each sample, the file would be read 2,000 times over, and all of it kept.
    with pytest.raises(InputError, match=r"takes more than \d+ MiB of memory"):
        read(path)


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_bomb_in_a_bag_is_refused(tmp_path, compression):
    """A chunk that grows to 640 MiB."""
    ff.write_bag1(tmp_path / "a.bag", {"/imu": (STAMPS, VALUES, "")}, compression)
    data = (tmp_path / "a.bag").read_bytes()
    library = importlib.import_module({"bz2": "bz2", "lz4": "lz4.frame"}[compression])
    bomb = library.compress(bytes(640 << 20)) if compression == "lz4" else 10 * library.compress(bytes(64 << 20))
    place = data.index(f"compression={compression}".encode())
    place += len(f"compression={compression}")
    # The header's last field is the size; after it stands the length of the chunk's data.
    place = data.index(b"size=", place) + 9
    length = int.from_bytes(data[place : place + 4], "little")
    index = data.index(b"index_pos=") + 10
    start = int.from_bytes(data[index : index + 8], "little") + len(bomb) - length
    data = data[:place] + len(bomb).to_bytes(4, "little") + bomb + data[place + 4 + length :]
    data = data[:index] + start.to_bytes(8, "little") + data[index + 8 :]
    (tmp_path / "a.bag").write_bytes(data)
    with pytest.raises(InputError, match=r"takes more than \d+ MiB of memory"):
        read(tmp_path / "a.bag")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """One file of every format, with the name of its importer."""
    folder = tmp_path_factory.mktemp("whole")
    ff.write_bag1(folder / "a.bag", {"/imu": (STAMPS, VALUES, "")})
    for storage, suffix in (("mcap", "mcap"), ("sqlite3", "db3")):
        ff.write_bag2(folder / storage, {"/imu": (STAMPS, VALUES, "")}, storage)
        (folder / storage / f"{storage}.{suffix}").rename(folder / f"a.{suffix}")
    ff.write_ulog(folder / "a.ulg", [("sensor_combined", 0, ff.COMBINED, ff.combined(US, VALUES))])
    ff.write_dataflash(folder / "a.bin", IMU_MESSAGES)
    return {path.name: (path.read_bytes(), find_importer(path).name) for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("kept", [0, 10, 500, -1])
@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3", "a.ulg", "a.bin"])
def test_a_file_cut_off_gives_one_sentence_or_what_is_there(tmp_path, whole, name, kept, capfd):
    data, importer = whole[name]
    (tmp_path / name).write_bytes(data[:kept])
    if name in ("a.ulg", "a.bin") and kept in (500, -1):
        # Logs end where the power was cut: all whole messages count.
        imported = import_file(tmp_path / name, None, importer)[1]
        assert 0 < len(imported.time) < N
        np.testing.assert_array_equal(imported.gyro, VALUES[: len(imported.time), :3])
    else:
        with pytest.raises(InputError, match=name) as caught:
            import_file(tmp_path / name, None, importer)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("package", "name"),
    [("rosbags", "a.bag"), ("pyulog", "a.ulg"), ("pymavlink", "a.bin")],
)
def test_an_absent_library_is_named_with_its_extra(tmp_path, whole, monkeypatch, package, name):
    (tmp_path / name).write_bytes(whole[name][0])
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=rf"'{package}'.*strapdown-rotation-test\[formats\]"):
        read(tmp_path / name)


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
        ({"bomb": "big[60000] a;", "big": "double[60000] x;"}, r"takes more than (64 MiB of memory|6 s) to read"),
        ({"bomb": "b x;", "b": "bomb x;"}, "is not a readable ULog .*recursion"),
        ({"bomb": "uint8_t[60000] x;"}, "holds no samples of sensor_combined"),
    ],
)
def test_definitions_that_unfold_without_end_are_refused(tmp_path, monkeypatch, definitions, refusal):
    from pyulog import ULog

    monkeypatch.setattr(child_process, "MEMORY_ALLOWANCE", 64 << 20)
    # Close to the limit on memory, Python may search for garbage until the time is used up.
    monkeypatch.setattr(child_process, "TIME_ALLOWANCE_S", 5)
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
    with pytest.raises(InputError, match="in what unit its accel columns are"):
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
