"""Units, counts, axes and names of the columns of an imported table."""

from dataclasses import replace

import numpy as np
import pytest
from table_files import ACCEL, COLUMNS, EUROC, GYRO, RNG, SI_TIME, TIME, N, assert_readings, write_rows, write_stamped

import srt
from srt.constants import DEG, STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError
from srt.recording import importer_registry
from srt.recording.import_options import (
    SENSOR_UNITS,
    ImportOptions,
    parse_axis_map,
    parse_columns,
    parse_lsb,
    parse_offset,
)
from srt.recording.importer_registry import IMPORTERS, find_importer, import_file
from srt.recording.importers import channels
from srt.recording.importers.channels import meaning_of

# Units and counts.


@pytest.mark.parametrize(
    ("header", "given", "gyro", "accel"),
    [
        ("time [s],gx (dps),gy (dps),gz (dps),ax (g),ay (g),az (g)", {}, DEG, STANDARD_GRAVITY_M_S2),
        (
            "time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s,acc_x_mg,acc_y_mg,acc_z_mg",
            {},
            DEG,
            1e-3 * STANDARD_GRAVITY_M_S2,
        ),
        ("t,wx,wy,wz,ax,ay,az", {**SI_TIME, "gyro_unit": "dps", "accel_unit": "m/s2"}, DEG, 1.0),
        (
            "%time,field.angular_velocity.x,field.angular_velocity.y,field.angular_velocity.z,"
            "field.linear_acceleration.x,field.linear_acceleration.y,field.linear_acceleration.z",
            SI_TIME,
            1.0,
            1.0,
        ),
    ],
)
def test_units_of_header_and_options(tmp_path, header, given, gyro, accel):
    write_rows(tmp_path / "a.csv", header, [TIME, *GYRO.T, *ACCEL.T])
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(**given))
    assert_readings(imported, GYRO * gyro, ACCEL * accel, TIME)


@pytest.mark.parametrize("missing", [("gyro",), ("accel",), ("time",), ("gyro", "accel", "time")], ids="-".join)
def test_a_unit_is_never_guessed(tmp_path, missing):
    write_rows(tmp_path / "a.csv", ",".join(COLUMNS), COLUMNS.values())
    options = {name: value for name, value in SI_TIME.items() if not name.startswith(missing)}
    said = f"the unit of {', '.join(missing)}: give " + ".*".join(f"--{name}-unit" for name in missing)
    with pytest.raises(InputError, match=said):
        import_file(tmp_path / "a.csv", ImportOptions(**options))


def test_a_given_unit_overrides_the_format_with_a_note(tmp_path):
    write_stamped(tmp_path / "a.csv", EUROC)
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(gyro_unit="deg/s"))
    np.testing.assert_array_equal(imported.gyro, GYRO * DEG)
    assert "The file states rad/s for gyro; read as deg/s, as stated by the user." in imported.notes


def test_degrees_of_windows_programs_and_decimal_commas(tmp_path):
    rows = "".join(
        ";".join(f"{v!r}".replace(".", ",") for v in row) + "\r\n"
        for row in np.column_stack([*COLUMNS.values()]).tolist()
    )
    header = "Zeit;Gyro X (°/s);Gyro Y (°/s);Gyro Z (°/s);Acc X (m/s²);Acc Y (m/s²);Acc Z (m/s²)\r\n"
    (tmp_path / "a.csv").write_bytes(("Titel: Messung\r\n\r\n" + header + rows).encode("latin-1"))
    _, found = import_file(tmp_path / "a.csv")
    np.testing.assert_array_equal(found.gyro, GYRO * DEG)
    assert found.notes[-1] == "Decimal commas were found, and read as points."
    options = ImportOptions(decimal_comma=True, columns={"time": "zeit"}, time_unit="s")
    _, imported = import_file(tmp_path / "a.csv", options)
    assert_readings(imported, GYRO * DEG, ACCEL, TIME)


def test_counts(tmp_path):
    counts = RNG.integers(0, 65536, size=(N, 6))
    write_rows(tmp_path / "a.csv", ",".join(COLUMNS), [TIME, *counts.T])
    options = ImportOptions(
        time_unit="s",
        gyro_lsb=parse_lsb("1/131 deg/s", "gyro"),
        accel_lsb=parse_lsb("1/415,1/413,1/415 m/s^2", "accel"),
        gyro_offset=parse_offset("32768", "gyro"),
        accel_offset=parse_offset("33123,33276,32360", "accel"),
    )
    _, imported = import_file(tmp_path / "a.csv", options)
    # Multiplying by a rounded quotient differs from dividing by one rounding of each.
    np.testing.assert_allclose(imported.gyro, (counts[:, :3] - 32768) / 131 * DEG, rtol=1e-15)
    expected = (counts[:, 3:] - [33123, 33276, 32360]) / [415.0, 413.0, 415.0]
    np.testing.assert_allclose(imported.accel, expected, rtol=1e-15)
    assert imported.units["accel"].startswith(
        "counts (as given) of 0.00240964 0.00242131 0.00240964 m/s², zero at 33123"
    )
    with pytest.raises(InputError, match="are counts: state the value of one count with --accel-lsb"):
        import_file(tmp_path / "a.csv", replace(options, accel_lsb=None, accel_unit="counts"))


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (parse_lsb, "0"),
        (parse_lsb, "1/0"),
        (parse_lsb, "1,2"),
        (parse_lsb, "1 furlong"),
        (parse_lsb, "1 mg"),
        (parse_lsb, "inf"),
        (parse_offset, "one"),
        (parse_offset, "1,2,3,4"),
    ],
)
def test_bad_counts(parse, text):
    with pytest.raises(InputError, match="--gyro-"):
        parse(text, "gyro")


@pytest.mark.parametrize(
    ("text", "sensor", "value"),
    [
        ("0.061 mg", "accel", 0.061e-3 * STANDARD_GRAVITY_M_S2),
        ("0.061mg/LSB", "accel", 0.061e-3 * STANDARD_GRAVITY_M_S2),
        ("2 m s-2 per digit", "accel", 2.0),
        ("2 g*s", "accel", 2.0 * STANDARD_GRAVITY_M_S2),
        ("1e-3 m·s⁻²", "accel", 1e-3),
        ("1/8, 1/8, 1/8 °/s/LSB", "gyro", DEG / 8),
        ("0.125 degrees per second", "gyro", DEG / 8),
        ("0.125dps", "gyro", DEG / 8),
        ("0.125", "gyro", 0.125),
        ("0.1 arcsec", "gyro", 0.1 * DEG / 3600.0),
        ("10 ug", "accel", 10e-6 * STANDARD_GRAVITY_M_S2),
        ("10 µg/LSB", "accel", 10e-6 * STANDARD_GRAVITY_M_S2),
    ],
)
def test_a_value_of_a_count_as_data_sheets_write_it(text, sensor, value):
    # Factors and their products round once each.
    np.testing.assert_allclose(parse_lsb(text, sensor), [value] * 3, rtol=4 * np.finfo(float).eps)


def test_every_unit_of_a_reading_is_one_of_a_count():
    for sensor, units in SENSOR_UNITS.items():
        for unit in [*units["rate"], *units["increment"]]:
            factor = {**units["rate"], **units["increment"]}[unit]
            assert parse_lsb(f"1 {unit}", sensor) == (factor,) * 3
            assert ImportOptions(**{f"{sensor}_unit": unit})


def test_increments_are_first_class(tmp_path):
    header = "time [s],dtheta_x [deg],dtheta_y [deg],dtheta_z [deg],dv_x [m/s],dv_y [m/s],dv_z [m/s]"
    write_rows(tmp_path / "a.csv", header, [TIME, *GYRO.T, *ACCEL.T])
    _, imported = import_file(tmp_path / "a.csv")
    assert imported.kind == "increment"
    np.testing.assert_array_equal(imported.gyro, GYRO * DEG)
    write_rows(tmp_path / "b.csv", ",".join(COLUMNS), COLUMNS.values())
    options = ImportOptions(kind="increment", gyro_unit="rad/s", accel_unit="m/s", time_unit="s")
    with pytest.raises(InputError, match="rad/s of the gyro readings does not fit samples of kind increment"):
        import_file(tmp_path / "b.csv", options)


# Axes, channels, options.


def test_axis_maps(tmp_path):
    write_rows(tmp_path / "a.csv", ",".join(COLUMNS), COLUMNS.values())
    options = ImportOptions(map_gyro="y,x,-z", map_accel="x,y,-z", **SI_TIME)
    _, imported = import_file(tmp_path / "a.csv", options)
    assert_readings(imported, GYRO[:, [1, 0, 2]] * [1, 1, -1], ACCEL * [1, 1, -1])
    assert any("The axis maps change the handedness of one triad: right if" in note for note in imported.notes)


@pytest.mark.parametrize("text", ["x,y", "x,x,z", "x,y,w", "--x,y,z", "x,y,z,z", ""])
def test_bad_axis_maps(text):
    with pytest.raises(InputError, match=r"--map-gyro is .* each once"):
        parse_axis_map(text)


def test_a_column_is_not_read_twice(tmp_path):
    """Channels without a column count from the first column, whatever others are named."""
    (tmp_path / "x.csv").write_text("t,wx,wy,wz,fx,fy,fz\n" + "1,2,3,4,5,6,7\n" * 20)
    with pytest.raises(InputError, match="column 1 would be read as time and as gyro_x"):
        srt.read(tmp_path / "x.csv", columns=parse_columns("time=t,gyro,accel"), gravity_m_s2=9.8)


def test_column_maps():
    assert parse_columns("time,-,gyro,accel") == {
        "time": 1, "gyro_x": 3, "gyro_y": 4, "gyro_z": 5, "accel_x": 6, "accel_y": 7, "accel_z": 8,
    }  # fmt: skip
    assert parse_columns("gyro=w, time=t") == {"gyro": "w", "time": "t"}
    assert parse_columns("gyro_x=4") == {"gyro_x": 4}
    for text in ("time,time", "gyro,gyro_x", "time="):
        with pytest.raises(InputError, match="--columns"):
            parse_columns(text)
    with pytest.raises(InputError, match="did you mean gyro_x"):
        ImportOptions(columns=parse_columns("gyr_x=4"))


@pytest.mark.parametrize(
    ("name", "channel", "unit"),
    [
        ("w_RS_S_y [rad s^-1]", "gyro_y", "rad/s"),
        ("Acc X (top)", "accel_x", None),
        ("gyr_z", "gyro_z", None),
        ("timestamp_ns", "time", "ns"),
        ("Temperature (°C)", "temperature", None),
        ("accel_x_m_s2", "accel_x", "m/s^2"),
        ("orientation.x", None, None),
        ("mag_x", None, None),
        ("scaledGyroX", "gyro_x", None),
        ("scaledAccelZ", "accel_z", None),
        ("UncompAcc Y [m/s^2]", "accel_y", "m/s^2"),
        ("X_ACCL", "accel_x", None),
        ("z_gyro (deg/s)", "gyro_z", "deg/s"),
        ("VelInc_X", "accel_x", None),
        ("xg", None, None),
    ],
)
def test_names_of_columns(name, channel, unit):
    found = meaning_of(name)
    assert (None if found is None else (found.channel, found.unit)) == (None if channel is None else (channel, unit))


def test_names_of_columns_can_be_added(tmp_path, monkeypatch):
    monkeypatch.setattr(channels, "COLUMN_NAMES", dict(channels.COLUMN_NAMES))
    channels._meanings.cache_clear()
    names = "Uhr,Kreisel X [deg/s],Kreisel Y [deg/s],Kreisel Z [deg/s],dV-Neu.x,dV-Neu.y,dV-Neu.z"
    try:
        channels.register_column_names("gyro", "Kreisel")
        channels.register_column_names("accel", "dV-Neu", kind="increment")
        channels.register_column_names("time", "Uhr")
        assert meaning_of("Kreisel X [deg/s]") == channels.ColumnMeaning("gyro_x", "deg/s")
        assert meaning_of("z kreisel") == channels.ColumnMeaning("gyro_z")
        assert meaning_of("dV-Neu.x") == channels.ColumnMeaning("accel_x", None, "increment")
        write_rows(tmp_path / "a.csv", names, [TIME, *GYRO.T, *ACCEL.T])
        _, imported = import_file(tmp_path / "a.csv", ImportOptions(accel_unit="m/s^2", time_unit="s"))
        np.testing.assert_array_equal(imported.gyro, GYRO * DEG)
        for bad in (("gyros", "rot"), ("accel", "Kreisel"), ("gyro", "acc"), ("time", "-")):
            with pytest.raises(InputError, match=r"is no channel|stands for another channel"):
                channels.register_column_names(*bad)
    finally:
        monkeypatch.undo()
        channels._meanings.cache_clear()
    assert meaning_of("z kreisel") is None


def test_columns_given_by_name_number_and_stem(tmp_path):
    names = "t0,rot_x,rot_y,rot_z,p,q,r"
    write_rows(tmp_path / "a.csv", names, [TIME, *GYRO.T, *ACCEL.T])
    columns = parse_columns("time=t0,gyro=rot,accel_x=p,accel_y=6,accel_z=r")
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(columns=columns, **SI_TIME))
    assert_readings(imported, GYRO, ACCEL)
    for said, fragment in (
        ("gyro=rat", r"no column rat_x \(did you mean rot_x\?\)"),
        ("time=9", "has 7 columns, but column 9"),
        ("gyro=rat,accel_y=s", r"no column rat_x \(did you mean rot_x\?\), rat_y .*, s \(found: t0, .*\): name one"),
        (
            "gyro=rot,accel_y=q",
            r"recognised as time, accel_x, accel_z \(columns found: t0, rot_x, rot_y, rot_z, p, q, r\): give --columns "
            "'time=NAME,accel_x=NAME,accel_z=NAME' with a name found, or its number from 1, for each NAME",
        ),
    ):
        with pytest.raises(InputError, match=fragment):
            import_file(tmp_path / "a.csv", ImportOptions(columns=parse_columns(said), **SI_TIME))


def test_two_columns_for_one_channel(tmp_path):
    write_rows(tmp_path / "a.csv", "t,gx,gy,gz,ax,ay,az,wx", [TIME, *GYRO.T, *ACCEL.T, TIME])
    with pytest.raises(InputError, match="several columns may be gyro_x"):
        import_file(tmp_path / "a.csv", ImportOptions(**SI_TIME))


def test_options_that_a_format_does_not_take_are_refused(tmp_path):
    write_stamped(tmp_path / "a.csv", EUROC)
    with pytest.raises(InputError, match="--topic is given, but the format euroc"):
        import_file(tmp_path / "a.csv", ImportOptions(topic="/imu"))
    with pytest.raises(InputError, match="--kind is increment, but this format holds samples of kind rate"):
        import_file(tmp_path / "a.csv", ImportOptions(kind="increment"))
    with pytest.raises(InputError, match="--gyro-lsb is given"):
        ImportOptions(gyro_unit="rad/s", gyro_lsb=(1.0, 1.0, 1.0))
    with pytest.raises(InputError, match="did you mean"):
        ImportOptions(gyro_unit="rads/s")


# Registry, repeats, recordings.


def test_formats_by_name(tmp_path):
    (tmp_path / "a.xyz").write_bytes(b"\0\1\2" * 50)
    with pytest.raises(InputError, match=r"was not recognised: name it with --format, as one of .*euroc.*csv"):
        find_importer(tmp_path / "a.xyz")
    with pytest.raises(InputError, match="did you mean kalibr"):
        find_importer(tmp_path / "a.xyz", "kalib")
    with pytest.raises(InputError, match="There is no file"):
        find_importer(tmp_path / "absent.csv")
    for name in IMPORTERS:
        assert importer_registry.importer(name).name == name
