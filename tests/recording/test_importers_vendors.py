"""Logs of vendors' programs and telephone apps, as these write them; readings and stamps come back."""

import numpy as np
import pytest
from log_samples import SECONDS, STAMPS, VALUES, N, assert_same, ff, note, read

from srt.exceptions import InputError
from srt.recording.importer_registry import find_importer, import_file
from srt.recording.importers.channels import COLUMN_NAMES, _meanings, register_column_names

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
    path.write_text("\n".join(lines) + "\n")
    damaged = read(path, **lsb)
    assert len(damaged.gyro) == N - 2
    assert note(damaged, "1 damaged messages")  # the other one has no end, and is no message


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


def test_xsens_and_adis_tables_by_their_names(tmp_path):
    xsens = tmp_path / "MT_0.txt"
    rows = ["\t".join(map(repr, (i, *row[3:], *row[:3]))) for i, row in enumerate(VALUES.tolist())]
    head = [
        "// Start Time: Unknown",
        "// Update Rate: 200.0Hz",
        "PacketCounter\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z",
    ]
    xsens.write_text("\n".join([*head, *rows, ""]))
    imported = read(xsens, gyro_unit="rad/s", accel_unit="m/s^2", sample_rate_hz=200.0)
    np.testing.assert_array_equal(np.hstack([imported.gyro, imported.accel]), VALUES)
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


def test_a_program_adds_names(tmp_path, monkeypatch):
    for key, names in list(COLUMN_NAMES.items()):
        monkeypatch.setitem(COLUMN_NAMES, key, names)
    register_column_names("gyro", "wombat")
    register_column_names("accel", "wallaby")
    path = tmp_path / "a.csv"
    head = ",".join(["time", *(f"wombat_{a}" for a in "xyz"), *(f"wallaby_{a}" for a in "xyz")])
    rows = [",".join(map(repr, (t, *row))) for t, row in zip(SECONDS.tolist(), VALUES.tolist(), strict=True)]
    path.write_text("\n".join([head, *rows, ""]))
    assert_same(read(path, gyro_unit="rad/s", accel_unit="m/s^2", time_unit="s"))
    monkeypatch.undo()
    _meanings.cache_clear()
