"""Units that HDF5 files state for their datasets, and structs of NaveGo."""

import numpy as np
import pytest
import scipy.io
from table_files import ACCEL, GYRO, SI, TIME, N, assert_readings

from srt.constants import DEG, STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError
from srt.recording.import_options import ImportOptions
from srt.recording.importer_registry import import_file

ARRAYS = {"time": TIME, "gyro": GYRO, "accel": ACCEL}


def write_units(path, units, arrays=ARRAYS, attribute="units"):
    with pytest.importorskip("h5py").File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
            if name in units:
                file[name].attrs[attribute] = units[name]


def said(path, sentence, **options):
    with pytest.raises(InputError, match=sentence):
        import_file(path, ImportOptions(**options))


@pytest.mark.parametrize("attribute", ["units", "unit"])
@pytest.mark.parametrize(
    ("units", "factors"),
    [
        ({"time": "s", "gyro": "deg/s", "accel": "g"}, (1.0, DEG, STANDARD_GRAVITY_M_S2)),
        ({"time": "seconds since 1970-01-01", "gyro": "rad s-1", "accel": "m s-2"}, (1.0, 1.0, 1.0)),
        ({"time": np.bytes_("s"), "gyro": ["degrees per second"], "accel": "m/s²"}, (1.0, DEG, 1.0)),
    ],
)
def test_units_of_datasets(tmp_path, attribute, units, factors):
    write_units(tmp_path / "a.h5", units, attribute=attribute)
    _, imported = import_file(tmp_path / "a.h5")
    for values, expected, factor in zip(
        (imported.time, imported.gyro, imported.accel), (TIME, GYRO, ACCEL), factors, strict=True
    ):
        np.testing.assert_array_equal(values, expected * factor)
    assert all(text.endswith("(as in the file)") for text in imported.units.values())


def test_units_of_datasets_that_contradict(tmp_path):
    path = tmp_path / "a.h5"
    write_units(path, {"time": "s", "gyro": "deg/s", "accel": "m/s^2"})
    _, imported = import_file(path, ImportOptions(gyro_unit="rad/s"))
    np.testing.assert_array_equal(imported.gyro, GYRO)
    assert "The file states deg/s for gyro; read as rad/s, as stated by the user." in imported.notes
    named = {"time": TIME, "gyro [rad/s]": GYRO, "accel": ACCEL}
    write_units(path, {"time": "s", "gyro [rad/s]": "deg/s"}, named)
    said(path, r"the name of gyro \[rad/s\] states rad/s, but its attribute states deg/s: correct one of them")
    apart = {"time": TIME, "accel": ACCEL, **{f"gyro_{axis}": GYRO[:, i] for i, axis in enumerate("xyz")}}
    write_units(path, {"gyro_x": "deg/s", "gyro_y": "rad/s", "gyro_z": "deg/s"}, apart)
    said(path, r"the gyro columns state different units \(deg/s, rad/s\)")
    write_units(path, {"gyro": "rad", "accel": "m/s", "time": "s"})
    said(path, "rad of the gyro readings does not fit samples of kind rate")
    assert import_file(path, ImportOptions(kind="increment"))[1].kind == "increment"


def test_units_of_datasets_that_are_not_known(tmp_path):
    path = tmp_path / "a.h5"
    write_units(path, {"time": "fortnights", "gyro": "furlongs", "accel": 3.0})
    said(
        path, r"the unit of gyro \(its text 'furlongs' is not known\), accel, time \(its text 'fortnights' is not known"
    )
    _, imported = import_file(path, ImportOptions(**SI, time_unit="s"))
    np.testing.assert_array_equal(imported.gyro, GYRO)
    assert "The file states furlongs for gyro; read as rad/s, as stated by the user." in imported.notes


def test_the_unit_of_a_temperature_is_told(tmp_path):
    write_units(
        tmp_path / "a.h5",
        {"time": "s", "gyro": "rad/s", "accel": "m/s^2", "temperature": "K"},
        {**ARRAYS, "temperature": np.full(N, 293.0)},
    )
    assert "Temperature is read in °C; the file states K." in import_file(tmp_path / "a.h5")[1].notes


# NaveGo

STRUCT = {
    "t": TIME[:, None], "fb": ACCEL, "wb": GYRO, "freq": 128.0, "ini_align": np.zeros((1, 3)),
    "gb_sta": np.ones((1, 3)), "name": "unit",
}  # fmt: skip


def write_navego_73(path, structs):
    with pytest.importorskip("h5py").File(path, "w", userblock_size=512) as file:
        for struct, fields in structs.items():
            for name, values in fields.items():
                if name != "name":
                    file[f"{struct}/{name}"] = np.atleast_2d(values).T
                    file[f"{struct}/{name}"].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("write", [scipy.io.savemat, write_navego_73])
def test_structs_of_navego(tmp_path, write):
    path = tmp_path / "a.mat"
    write(path, {"imu1": STRUCT})
    importer, imported = import_file(path)
    assert (importer.name, imported.kind) == ("matlab", "rate")
    assert_readings(imported, GYRO, ACCEL, TIME)
    assert imported.units["gyro"].startswith("rad/s")
    assert imported.units["accel"].startswith("m/s^2")
    np.testing.assert_array_equal(import_file(path, ImportOptions(gyro_unit="deg/s"))[1].gyro, GYRO * DEG)
    write(path, {"imu1": {name: value for name, value in STRUCT.items() if name != "t"}})
    imported = import_file(path)[1]
    assert (imported.time, imported.sample_rate_hz) == (None, 128.0)
    write(path, {"imu1": {**STRUCT, "wb": -GYRO}, "imu2": STRUCT})
    said(path, r"holds several IMUs \(imu1, imu2\): name one with --variable")
    np.testing.assert_array_equal(import_file(path, ImportOptions(variable="imu2"))[1].gyro, GYRO)
