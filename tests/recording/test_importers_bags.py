"""ROS bags written by the formats' own libraries come back sample by sample."""

import re
import sqlite3

import numpy as np
import pytest
from log_samples import IMU_COLUMNS, OTHER, SECONDS, STAMPS, US, VALUES, N, assert_same, ff, note, read

from srt.exceptions import InputError
from srt.recording.imported_samples import to_recording
from srt.recording.recording import Site

pytestmark = pytest.mark.usefixtures("forked_readers")

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


@pytest.mark.parametrize(
    ("where", "refusal"),
    [
        *((where, "files are missing: .*/bag/outside.mcap") for where in ("../outside.mcap", "a/../../outside.mcap")),
        ("/outside.mcap", "files are missing: .*/bag/outside.mcap"),
        ("bag.mcap", r"files are missing: .*bag\.mcap"),
        ("..", "is not a readable .*[Ii]s a directory"),
        ("link.mcap", "'link.mcap', which lies outside the bag"),
        ("message_count: imu", "is not a readable ROS 2 bag"),
    ],
)
def test_a_bag_reads_nothing_outside_its_folder(tmp_path, where, refusal):
    """Nor what is not there, nor a number of messages that is none."""
    ff.write_bag2(tmp_path / "bag", {"/imu": (STAMPS, VALUES, "")})
    (tmp_path / "bag" / "bag.mcap").rename(tmp_path / "outside.mcap")
    if where == "link.mcap":
        (tmp_path / "bag" / "link.mcap").symlink_to(tmp_path / "outside.mcap")
    metadata = tmp_path / "bag" / "metadata.yaml"
    name = where if where != "/outside.mcap" else str(tmp_path / "outside.mcap")
    pattern = r"message_count: \d+" if where.startswith("message") else r"bag\.mcap"
    metadata.write_text(re.sub(pattern, name, metadata.read_text()))
    with pytest.raises(InputError, match=refusal):
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
