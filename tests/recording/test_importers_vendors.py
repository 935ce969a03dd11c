"""Logs of vendors' programs and telephone apps, as these write them; readings and stamps come back."""

import numpy as np
import pytest
from log_samples import SECONDS, STAMPS, VALUES, N, assert_same, ff, note, read

from srt.exceptions import InputError
from srt.recording.importer_registry import find_importer, import_file

G = 9.80665


def test_microstrain_sensor_connect(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(ff.microstrain_text(STAMPS, VALUES))
    assert find_importer(path).name == "microstrain"
    imported = read(path, time_unit="ns")
    np.testing.assert_array_equal(imported.gyro, VALUES[:, :3])
    # Division by g and multiplication: two roundings of values below 15.
    np.testing.assert_allclose(imported.accel, VALUES[:, 3:], rtol=0, atol=4e-15)
    np.testing.assert_allclose(imported.time - imported.time[0], SECONDS, rtol=0, atol=1e-15)
    with pytest.raises(InputError, match="time"):
        read(path)


def table(names, rows, mark=","):
    return "\n".join([mark.join(names), *(mark.join(map(repr, row)) for row in rows), ""])


def test_microstrain_increments(tmp_path):
    """Delta thetas in rad, delta velocities in g·s; a table that has both holds rates unless increments are wanted."""
    path = tmp_path / "a.csv"
    unit, rates, steps = "inertial-6253.76535", VALUES.tolist(), (0.005 * VALUES).tolist()
    delta = [f"{unit}:delta{part}{a}" for part in ("Theta", "Vel") for a in "XYZ"]
    rows = [(t, *s[:3], *(v / G for v in s[3:])) for t, s in zip(STAMPS.tolist(), steps, strict=True)]
    path.write_text(table(["Time", *delta], rows))
    assert find_importer(path).name == "microstrain"
    imported = read(path, time_unit="ns")
    assert imported.kind == "increment"
    np.testing.assert_array_equal(imported.gyro, 0.005 * VALUES[:, :3])
    # Division by g and multiplication: two roundings of values below 0.1.
    np.testing.assert_allclose(imported.accel, 0.005 * VALUES[:, 3:], rtol=0, atol=3e-17)
    scaled = [f"{unit}:scaled{part}{a}" for part in ("Gyro", "Accel") for a in "XYZ"]
    both = [(*row, *r[:3], *(v / G for v in r[3:])) for row, r in zip(rows, rates, strict=True)]
    path.write_text(table(["Time", *delta, *scaled], both))
    imported = read(path, time_unit="ns")
    assert imported.kind == "rate"
    np.testing.assert_array_equal(imported.gyro, VALUES[:, :3])
    assert note(imported, "rates were read, increments with --kind increment")
    imported = read(path, time_unit="ns", kind="increment")
    assert imported.kind == "increment"
    np.testing.assert_array_equal(imported.gyro, 0.005 * VALUES[:, :3])


@pytest.mark.parametrize(
    ("line", "gyro", "accel"),
    [
        (
            "%RAWIMUSA,2209,491612.254;2209,491612.253588,ea5afe00,329303960,-2512321,4410363,309705,607017,-1009773"
            "*1fb76c28",
            (-1009773, -607017, 309705),
            (4410363, 2512321, 329303960),
        ),
        (
            "%RAWIMUSXA,2209,491674.014;04,41,2209,491674.013699,ea59fe00,329308016,-2706935,4508389,196192,417138,"
            "-1000837*038422a7",
            (-1000837, -417138, 196192),
            (4508389, 2706935, 329308016),
        ),
        (
            "#RAWIMUXA,USB1,0,64.5,FINESTEERING,2209,491740.110,02000020,0dc5,16809;04,41,2209,491740.109817,ea57fe00,"
            "329394068,-2396829,4481425,321199,257329,-936077*cf9c035d",
            (-936077, -257329, 321199),
            (4481425, 2396829, 329394068),
        ),
        (
            "%RAWIMUSA,1815,407772.000;1815,407771.985103333,00000077,63811,-6290,6253,7,-31,14*2d2a4cff",
            (14, 31, 7),
            (6253, 6290, 63811),
        ),
        (
            "%RAWIMUSA,1537,361705.645;1537,361705.644826900,00000000,30387,415,-5398,-23039,-18100736,-5117*c01b540c",
            (-5117, 18100736, -23039),
            (-5398, -415, 30387),
        ),
    ],
    ids=["RAWIMUSA", "RAWIMUSXA", "RAWIMUXA", "CNS5000", "SPAN"],
)
def test_published_messages_of_novatel_units(tmp_path, line, gyro, accel):
    """Three of the OEM7 manual, two that public programs quote: CRC, and the order z, −y, x, accelerometers first."""
    path = tmp_path / "a.asc"
    path.write_text(line + "\n")
    assert find_importer(path).name == "novatel"
    imported = read(path, gyro_lsb=(1.0,) * 3, accel_lsb=(1.0,) * 3)
    np.testing.assert_array_equal(imported.gyro, [gyro])
    np.testing.assert_array_equal(imported.accel, [accel])


def test_a_message_of_a_vectornav_unit(tmp_path):
    """A message that programs for the VN-200 quote: checksum, order of the fields, temperature."""
    path = tmp_path / "a.txt"
    path.write_text(
        "$VNIMU,-00.0350,+00.4222,-00.6643,-00.015,+00.019,+09.948,+00.002066,-00.008442,-00.044656,+20.7,+084.322*66\n"
    )
    imported = read(path, sample_rate_hz=200.0)
    np.testing.assert_array_equal(imported.gyro, [[0.002066, -0.008442, -0.044656]])
    np.testing.assert_array_equal(imported.accel, [[-0.015, 0.019, 9.948]])
    np.testing.assert_array_equal(imported.temperature, [20.7])


@pytest.mark.parametrize("name", ["RAWIMUSA", "RAWIMUA", "RAWIMUSXA", "RAWIMUXA"])
def test_novatel_rawimu(tmp_path, name):
    counts = np.round(1000.0 * VALUES).astype(int)
    path = tmp_path / "a.asc"
    path.write_text(ff.novatel_text(STAMPS, counts, name))
    assert find_importer(path).name == "novatel"
    lsb = {"gyro_lsb": (2e-9,) * 3, "accel_lsb": (3e-8,) * 3}
    imported = read(path, **lsb)
    assert imported.kind == "increment"
    np.testing.assert_allclose(imported.gyro, counts[:, :3] * 2e-9, rtol=1e-15)
    np.testing.assert_allclose(imported.accel, counts[:, 3:] * 3e-8, rtol=1e-15)
    # Seconds of the week with nine decimals: half a nanosecond each.
    np.testing.assert_allclose(np.diff(imported.time), 0.005, rtol=0, atol=2e-9)
    with pytest.raises(InputError, match="--gyro-lsb"):
        read(path)
    lines = path.read_text().splitlines()
    lines[3] = lines[3].replace(",00000077,", ",00000076,")
    lines[7] = lines[7][:60]
    lines[9:11] = ["".join(lines[9:11])]  # both are whole
    path.write_text("\n".join(lines) + "\n")
    damaged = read(path, **lsb)
    assert len(damaged.gyro) == N - 2
    assert note(damaged, "2 damaged messages")


def test_vectornav_vnimu(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(ff.vectornav_text(VALUES).encode())
    assert find_importer(path).name == "vectornav"
    imported = read(path, sample_rate_hz=200.0)
    np.testing.assert_array_equal(imported.gyro, VALUES[:, :3])
    np.testing.assert_array_equal(imported.accel, VALUES[:, 3:])
    np.testing.assert_array_equal(imported.temperature, np.full(N, 25.5))
    path.write_bytes(ff.vectornav_text(VALUES).replace("VNIMU,+0.1", "VNIMU,+0.2").encode())
    with pytest.raises(InputError, match="no whole message VectorNav VNIMU"):
        import_file(path, None, "vectornav")


def test_kf_gins_increments(tmp_path):
    path = tmp_path / "imu.txt"
    seconds = 456300.0 + SECONDS
    path.write_text(
        "".join(" ".join(map(repr, (t, *row))) + "\n" for t, row in zip(seconds.tolist(), VALUES.tolist(), strict=True))
    )
    _, imported = import_file(path, None, "kf-gins")
    assert imported.kind == "increment"
    # Seconds of the week in a double: 3e-11 s.
    assert_same(imported, seconds=seconds - seconds[0])
    path.write_text("1 2 3 4 5\n" * 5)
    with pytest.raises(InputError, match="5 columns, but 7"):
        import_file(path, None, "kf-gins")


@pytest.mark.parametrize("mark", [",", ";"])
def test_phyphox(tmp_path, mark):
    path = tmp_path / "a.zip"
    ff.write_phyphox(path, STAMPS, VALUES, mark)
    assert find_importer(path).name == "phyphox"
    imported = read(path)
    np.testing.assert_array_equal(imported.gyro, VALUES[:, :3])
    np.testing.assert_array_equal(imported.accel, VALUES[:, 3:])
    np.testing.assert_allclose(imported.time, SECONDS, rtol=0, atol=1e-15)
    ff.write_sensor_logger(tmp_path / "b.zip", STAMPS, VALUES)
    assert find_importer(tmp_path / "b.zip").name == "sensor-logger"


EUROC = (
    "#timestamp [ns];w_RS_S_x [rad s^-1];w_RS_S_y [rad s^-1];w_RS_S_z [rad s^-1];a_RS_S_x [m s^-2];a_RS_S_y [m s^-2];"
    "a_RS_S_z [m s^-2]"
)


def test_euroc_saved_by_a_spreadsheet(tmp_path):
    """Semicolons, decimal commas and carriage returns; stamps in full, or rounded to six digits."""
    path = tmp_path / "data.csv"
    rows = [";".join(map(repr, (t, *row))) for t, row in zip(STAMPS.tolist(), VALUES.tolist(), strict=True)]
    path.write_text("\r\n".join([EUROC, *rows, ""]).replace(".", ","), newline="")
    assert find_importer(path).name == "euroc"
    assert_same(read(path))
    rounded = [f"{t:.5e}".replace("e", "E") for t in STAMPS.tolist()]
    rows = [";".join((t, *map(repr, row))) for t, row in zip(rounded, VALUES.tolist(), strict=True)]
    path.write_text("\r\n".join([EUROC, *rows, ""]).replace(".", ","), newline="")
    with pytest.raises(InputError, match="rounded by a spreadsheet"):
        read(path)
    imported = read(path, sample_rate_hz=200.0)
    assert imported.sample_rate_hz == 200.0
    np.testing.assert_array_equal(imported.gyro, VALUES[:, :3])


XSENS_HEAD = "// Start Time: Unknown\n// Update Rate: 200.0Hz\n// Filter Profile: human (46.1)\n"
XSENS_NAMES = [f"{part}_{a}" for part in ("Acc", "Gyr") for a in "XYZ"]


def test_xsens_by_the_update_rate(tmp_path):
    path = tmp_path / "MT_0.txt"
    rows = [(i, *row[3:], *row[:3]) for i, row in enumerate(VALUES.tolist())]
    path.write_text(XSENS_HEAD + table(["PacketCounter", *XSENS_NAMES], rows, "\t"))
    assert find_importer(path).name == "xsens"
    imported = read(path)
    assert imported.sample_rate_hz == 200.0
    np.testing.assert_array_equal(np.hstack([imported.gyro, imported.accel]), VALUES)


def test_xsens_by_its_stamps(tmp_path):
    """SampleTimeFine in ticks of 0.1 ms, across the end of its 32 bits; velocity increments beside the rates."""
    path = tmp_path / "MT_0.txt"
    names = ["PacketCounter", "SampleTimeFine", *XSENS_NAMES, *(f"VelInc_{a}" for a in "XYZ")]

    def write(tick):
        stamps = (2**32 - 50 * tick + tick * np.arange(N)) % 2**32
        rows = [(i, t, *row[3:], *row[:3], *row[3:]) for i, (t, row) in enumerate(zip(stamps.tolist(), VALUES.tolist(),
                                                                                      strict=True))]  # fmt: skip
        path.write_text(XSENS_HEAD + table(names, rows, "\t"))

    write(50)
    imported = read(path)
    np.testing.assert_array_equal(np.hstack([imported.gyro, imported.accel]), VALUES)
    # Stamps of five days, 4e5 s: 6e-11 s each.
    np.testing.assert_allclose(imported.time - imported.time[0], SECONDS, rtol=0, atol=2e-10)
    write(5000)
    with pytest.raises(InputError, match="steps of 5000, but 50 ticks"):
        read(path)


@pytest.mark.parametrize(
    "head",
    [
        "// Start Time: Unknown\n// Update Rate: 100.0Hz\n// Filter Profile: human (46.1)\n"
        "// Option Flags: AHS Disabled ICC Disabled \n// Firmware Version: 4.3.1\n",
        "// General information:\n//  MT Manager version: 2022.2.0\n//  XDA version: 2022.2.0 build 7381\n"
        "// Device information:\n//  DeviceId: 00B4D6D1\n//  ProductCode: MTW2-3A7G6\n//  Firmware Version: 4.6.0\n"
        "//  Hardware Version: 2.0.0\n// Device settings:\n//  Filter Profile: human(46.1)\n//  Update Rate: 100.0Hz\n"
        "// Coordinate system: ENU\n",
    ],
    ids=["4.3", "2022.2"],
)
def test_published_rows_of_an_awinda_unit(tmp_path, head):
    """Heads that public programs quote, and a row of a public data set: SampleTimeFine is empty there."""
    path = tmp_path / "MT_0.txt"
    names = ["SampleTimeFine", *XSENS_NAMES, *(f"Mag_{a}" for a in "XYZ"), *(f"Quat_q{i}" for i in range(4))]
    row = (
        "\t8.696773\t0.341363\t4.715198\t0.015417\t0.009366\t-0.011596\t0.886719\t0.420898\t0.468506\t0.651925"
        "\t-0.318177\t-0.399341\t-0.560611\n"
    )

    def write(counts):
        text = "".join(f"{count}\t{row}" for count in counts)
        path.write_text(head + "\t".join(["PacketCounter", *names]) + "\n" + text)

    write(range(27626, 27630))
    assert find_importer(path).name == "xsens"
    imported = read(path)
    assert (imported.time, imported.sample_rate_hz) == (None, 100.0)
    assert note(imported, "the column of time is empty")
    np.testing.assert_array_equal(imported.gyro[0], [0.015417, 0.009366, -0.011596])
    np.testing.assert_array_equal(imported.accel[0], [8.696773, 0.341363, 4.715198])
    # Radio loses packets: the counter of 16 bits shows which.
    write([65534, 65535, 0, 3])
    imported = read(path)
    np.testing.assert_allclose(imported.time, [0.0, 0.01, 0.02, 0.05], rtol=1e-15)
    # With columns of UTC, most cells of a row are empty.
    dates = [f"UTC_{part}" for part in ("Nano", "Year", "Month", "Day", "Hour", "Minute", "Second", "Valid")]
    rows = "".join(f"{i}{chr(9) * (len(dates) + 2)}1.5\t2.5\t9.5\t0.1\t0.2\t0.3\n" for i in range(3))
    path.write_text(head + "\t".join(["PacketCounter", names[0], *dates, *XSENS_NAMES]) + "\n" + rows)
    imported = read(path)
    np.testing.assert_array_equal(np.hstack([imported.accel[2], imported.gyro[2]]), [1.5, 2.5, 9.5, 0.1, 0.2, 0.3])
    path.write_text(path.read_text().replace("// Update Rate", "// Rate").replace("//  Update Rate", "// Rate"))
    with pytest.raises(InputError, match="the column of time is empty"):
        read(path)


def test_published_rows_of_telephone_apps(tmp_path):
    """Rows of Sensor Logger and phyphox as the pages of public programs show them."""
    stamps, count = ("1718030736872695300,0.0706953125", "1718030736882695300,0.0806953125"), 2
    folder = tmp_path / "logger"
    folder.mkdir()
    for name, values in (
        ("Gyroscope", "-0.32157647609710693,0.15512901544570923,0.6729803085327148"),
        ("TotalAcceleration", "9.851848602294922,1.407876968383789,-0.008374879136681557"),
    ):
        rows = "".join(f"{stamp},{values}\n" for stamp in stamps)
        (folder / f"{name}.csv").write_text("time,seconds_elapsed,z,y,x\n" + rows)
    assert find_importer(folder).name == "sensor-logger"
    imported = read(folder)
    np.testing.assert_array_equal(
        imported.gyro, [[0.6729803085327148, 0.15512901544570923, -0.32157647609710693]] * count
    )
    np.testing.assert_array_equal(
        imported.accel, [[-0.008374879136681557, 1.407876968383789, 9.851848602294922]] * count
    )
    folder = tmp_path / "phyphox"
    folder.mkdir()
    rows = (
        "9.364549000E-3,1.003170490E0,3.543418407E0,7.366958618E0\n"
        "1.136538300E-2,9.696516991E-1,3.600879431E0,7.357381821E0\n"
    )
    for name, quantity, unit in (("Accelerometer", "Acceleration", "m/s^2"), ("Gyroscope", "Gyroscope", "rad/s")):
        head = ",".join(['"Time (s)"', *(f'"{quantity} {a} ({unit})"' for a in "xyz")])
        (folder / f"{name}.csv").write_text(f"{head}\n{rows}")
    assert find_importer(folder).name == "phyphox"
    imported = read(folder)
    np.testing.assert_array_equal(imported.accel[0], [1.003170490, 3.543418407, 7.366958618])
    np.testing.assert_array_equal(imported.gyro, imported.accel)
    np.testing.assert_array_equal(imported.time, [9.364549e-3, 1.1365383e-2])


def test_adis_tables_by_their_names(tmp_path):
    adis = tmp_path / "adis.csv"
    counts = np.round(100.0 * VALUES).astype(int)
    names = [f"{axis}{sensor}_OUT" for sensor in ("GYRO", "ACCL") for axis in "XYZ"]
    adis.write_text(
        "\n".join(
            [
                ",".join(["DATA_CNTR", *names]),
                *(",".join(map(str, (i, *row))) for i, row in enumerate(counts.tolist())),
                "",
            ]
        )
    )
    imported = read(adis, gyro_lsb=(1e-3,) * 3, accel_lsb=(2e-3,) * 3, sample_rate_hz=200.0)
    np.testing.assert_allclose(imported.gyro, counts[:, :3] * 1e-3, rtol=1e-15)
    np.testing.assert_allclose(imported.accel, counts[:, 3:] * 2e-3, rtol=1e-15)
