"""Files that mean harm: headers that promise terabytes, ways out of the folder, objects, damaged structure."""

import importlib
import io
import re
import struct
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from table_files import ACCEL, COLUMNS, EUROC, GYRO, SI_TIME, TIME, N, assert_readings, write_rows

import srt
from srt.exceptions import InputError
from srt.recording.folder import load_recording as load_folder
from srt.recording.import_options import ImportOptions
from srt.recording.importer_registry import import_file
from srt.recording.importers import child_process

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
fuzz = importlib.import_module("fuzz")

SI = ImportOptions(**SI_TIME)
TOML = """
[recording]
samples = "{samples}"
gyro_unit = "rad/s"
accel_unit = "m/s^2"
{more}
[site]
gravity_m_s2 = 9.81
"""


def refusal(path, options=SI, name="auto"):
    with pytest.raises(InputError) as caught:
        import_file(path, options, name)
    return _one_sentence(caught)


def recording(folder, samples, more="", units=True):
    text = TOML.format(samples=samples, more=more)
    if not units:
        text = "\n".join(line for line in text.splitlines() if "_unit" not in line)
    (folder / "recording.toml").write_text(text)
    return folder


def recording_refusal(folder):
    with pytest.raises(InputError) as caught:
        srt.load_recording(folder)
    return _one_sentence(caught)


def _one_sentence(caught):
    message = str(caught.value)
    assert "\n" not in message
    return message


def npy_header(shape, descr="<f8"):
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"shape": shape, "fortran_order": False, "descr": descr})
    return out.getvalue()


# The same files through the importers and as samples of a recording.


@pytest.mark.parametrize("as_recording", [False, True])
class TestPromises:
    """A few bytes that promise what no memory holds."""

    def refused(self, path, as_recording):
        return recording_refusal(recording(path.parent, path.name)) if as_recording else refusal(path)

    def test_npz_header(self, tmp_path, as_recording):
        path = tmp_path / "samples.npz"
        np.savez(path, **{name: column for name, column in COLUMNS.items() if name != "gyro_x"})
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("gyro_x.npy", npy_header((1 << 40,)) + bytes(64))
        assert "8796093022208 bytes" in self.refused(path, as_recording)

    def test_npz_that_swells(self, tmp_path, as_recording):
        """The archive's own list says how large a part becomes; it cannot be more than deflate can make of it."""
        path = tmp_path / "samples.npz"
        with zipfile.ZipFile(path, "w") as archive:
            for name in COLUMNS:
                archive.writestr(f"{name}.npy", npy_header((1 << 30,)) + bytes(64))
        data = bytearray(path.read_bytes())
        for at in range(len(data)):
            if data[at : at + 4] == b"PK\x01\x02":
                data[at + 24 : at + 28] = struct.pack("<I", 0xFFFFFFF0)
        path.write_bytes(bytes(data))
        assert "4294967280 bytes" in self.refused(path, as_recording)

    def test_npz_of_objects(self, tmp_path, as_recording):
        path = tmp_path / "samples.npz"
        np.savez(path, **{**COLUMNS, "gyro_x": np.array([{}] * N, dtype=object)}, allow_pickle=True)
        message = self.refused(path, as_recording)
        refused = "not a readable NPZ file (array gyro_x holds Python objects)"
        assert (refused if as_recording else "no column was recognised as gyro_x") in message

    def test_hdf5_that_was_never_filled(self, tmp_path, as_recording):
        h5py = pytest.importorskip("h5py")
        path = tmp_path / "samples.h5"
        with h5py.File(path, "w") as file:
            for name in COLUMNS:
                file.create_dataset(name, shape=(1 << 40,), chunks=(1 << 10,), dtype="f8")
        assert "8796093022208 bytes" in self.refused(path, as_recording)

    def test_hdf5_of_one_dataset_under_all_names(self, tmp_path, as_recording):
        """It may be read once; as all columns together it is more than a file of that size can mean."""
        h5py = pytest.importorskip("h5py")
        path, rows = tmp_path / "samples.h5", 6 << 20
        with h5py.File(path, "w") as file:
            first, *others = COLUMNS
            file.create_dataset(first, data=np.zeros(rows), chunks=(1 << 20,), compression="gzip", compression_opts=1)
            for name in others:
                file[name] = file[first]
        # A search of the file meets each dataset once.
        said = "its arrays are 3" if as_recording else "no column was recognised as time"
        assert said in self.refused(path, as_recording)

    @pytest.mark.parametrize("way", ["external link", "soft link", "virtual", "external storage"])
    def test_hdf5_that_leads_elsewhere(self, tmp_path, as_recording, way):
        h5py = pytest.importorskip("h5py")
        path, other = tmp_path / "samples.h5", tmp_path / "other.h5"
        with h5py.File(other, "w") as file:
            file["gyro_x"] = COLUMNS["gyro_x"]
        (tmp_path / "raw.bin").write_bytes(COLUMNS["gyro_x"].tobytes())
        with h5py.File(path, "w") as file:
            for name, column in COLUMNS.items():
                if name != "gyro_x":
                    file[name] = column
            if way == "external link":
                file["gyro_x"] = h5py.ExternalLink(str(other), "/gyro_x")
            elif way == "soft link":
                file["gyro_x"] = h5py.SoftLink("/gyro_y")
            elif way == "virtual":
                layout = h5py.VirtualLayout(shape=(N,), dtype="f8")
                layout[:] = h5py.VirtualSource(str(other), "gyro_x", shape=(N,))
                file.create_virtual_dataset("gyro_x", layout)
            else:
                where = [(str(tmp_path / "raw.bin"), 0, 8 * N)]
                file.create_dataset("gyro_x", shape=(N,), dtype="f8", external=where)
        message = self.refused(path, as_recording)
        if "link" in way and not as_recording:
            assert "no column was recognised as gyro_x" in message  # links are not even listed
        else:
            assert "gyro_x is " in message
            assert "copy the data there" in message

    def test_parquet_of_endless_zeros(self, tmp_path, as_recording):
        """Run lengths make a billion zeros of a few bytes, which is more than a file of that size can mean."""
        pa = pytest.importorskip("pyarrow")
        parquet = pytest.importorskip("pyarrow.parquet")
        path = tmp_path / "samples.parquet"
        rows = 1 << 22
        parquet.write_table(pa.table({"time": np.zeros(rows)}), path, row_group_size=rows, data_page_size=1 << 30)
        assert f"{8 * rows} bytes" in self.refused(path, as_recording)

    def test_parquet_of_runs_in_all_columns(self, tmp_path, as_recording):
        """Each column alone may be read; all together are more than a file of that size can mean."""
        path, rows = tmp_path / "samples.parquet", 6 << 20
        write_parquet(path, dict.fromkeys(COLUMNS, np.zeros(rows, "i1")), "x" * (1 << 16), row_group_size=rows)
        assert f"{8 * rows * 7} bytes" in self.refused(path, as_recording)

    def test_parquet_page_that_swells(self, tmp_path, as_recording):
        """A page of ten values whose header states a gigabyte, for which the library would reserve memory."""
        path = tmp_path / "samples.parquet"
        write_parquet(path, {"time": np.arange(10.0)}, use_dictionary=False, compression="zstd")
        data = path.read_bytes()
        assert data[4:7] == b"\x15\x00\x15"  # kind of the page, and the type of the next field, its size
        assert data[8] < 128 < data[7]  # that takes two bytes, or else the next line cuts more
        path.write_bytes(data[:7] + varint(2 << 30) + data[9:])
        assert f"{1 << 30} bytes" in self.refused(path, as_recording)

    def test_parquet_page_with_an_endless_list(self, tmp_path, as_recording):
        path = tmp_path / "samples.parquet"
        write_parquet(path, {"time": np.arange(10.0)}, use_dictionary=False)
        data = path.read_bytes()
        # A list of booleans in the place of the page's kind, its number of elements in ten bytes.
        path.write_bytes(data[:4] + b"\x19\xf1" + b"\xff" * 8 + b"\x7f" + data[5:])
        assert "a list is longer than the file" in self.refused(path, as_recording)

    @pytest.mark.parametrize(("places", "said"), [(1, "its groups have 300 rows of 301"), (99, "has 300 rows of 301")])
    def test_parquet_that_states_another_number_of_rows(self, tmp_path, as_recording, places, said):
        path = tmp_path / "samples.parquet"
        write_parquet(path, {name: np.arange(300.0) for name in COLUMNS}, use_dictionary=False)
        pages, mark, foot = path.read_bytes().rpartition(b"\x15\x04\x19")  # first bytes of the metadata: version 2
        path.write_bytes(pages + mark + foot.replace(varint(2 * 300), varint(2 * 301), places))
        assert said in self.refused(path, as_recording)


def varint(code):
    """Integer of Thrift's compact protocol; the code of a positive one is twice its value."""
    return bytes([code & 127 | 128]) + varint(code >> 7) if code > 127 else bytes([code])


def write_parquet(path, columns, padding="", **options):
    pa = pytest.importorskip("pyarrow")
    table = pa.table(columns).replace_schema_metadata({"padding": padding})
    pytest.importorskip("pyarrow.parquet").write_table(table, path, **options)


# MATLAB files.


def saved(content, **options):
    out = io.BytesIO()
    scipy.io.savemat(out, content, **options)
    return out.getvalue()


def test_matlab_data_of_an_unknown_type(tmp_path):
    """A type that is no type leads the library's parser out of its memory, which ends the child alone."""
    data = bytearray(saved({"time": TIME, "gyro": GYRO, "accel": ACCEL}))
    at = data.rindex(struct.pack("<II", 9, 24 * N))  # tag of the last array's doubles
    data[at : at + 4] = struct.pack("<I", 0x7FFF)
    (tmp_path / "a.mat").write_bytes(bytes(data))
    assert re.search(r"ended its reader \(exit code -?\d+\)|is not a readable MATLAB file", refusal(tmp_path / "a.mat"))


@pytest.mark.parametrize("code", [3, 16, 17, 5])
def test_matlab_objects_give_samples_of_the_rest_or_a_sentence(tmp_path, code):
    """Objects, function handles, opaque types and sparse matrices by the class of an array."""
    for content in ({"gyro": GYRO}, {"imu": {"gyro": GYRO}}):
        data = bytearray(saved(content))
        flags = data.index(struct.pack("<IIII", 6, 8, 6, 0))
        data[flags + 8] = code
        (tmp_path / "a.mat").write_bytes(bytes(data))
        text = refusal(tmp_path / "a.mat")
        assert re.search(r"no array|is not a readable MATLAB|ended its reader|no column was recognised|damaged", text)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="limits of a process are Linux's")
def test_matlab_compressed_that_swells(tmp_path):
    """A variable of a gigabyte in a megabyte."""
    element = struct.pack("<IIIIIIII", 6, 8, 6, 0, 5, 8, 1 << 27, 1) + struct.pack("<HH4s", 1, 1, b"a\0\0\0")
    length = 8 << 27
    packer = zlib.compressobj(1)  # the quickest: zeros shrink to a thousandth at any level
    packed = packer.compress(
        struct.pack("<II", 14, len(element) + 8 + length) + element + struct.pack("<II", 9, length)
    )
    packed += b"".join(packer.compress(bytes(1 << 20)) for _ in range(length >> 20)) + packer.flush()
    (tmp_path / "a.mat").write_bytes(saved({})[:128] + struct.pack("<II", 15, len(packed)) + packed)
    assert re.search(r"takes more than \d+ MiB of memory", refusal(tmp_path / "a.mat"))


@pytest.mark.parametrize("step", [193, pytest.param(23, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("options", [{}, {"do_compression": True}, {"format": "4"}])
def test_matlab_cut_off_anywhere(tmp_path, monkeypatch, options, step):
    """The rest is either whole variables or a sentence."""
    monkeypatch.setattr(child_process, "spawn", fuzz.Fork)
    whole = saved({"time": TIME, "gyro": GYRO, "accel": ACCEL}, **options)
    path = tmp_path / "a.mat"
    for size in range(1, len(whole), step):
        path.write_bytes(whole[:size])
        assert str(path) in refusal(path)


def test_matlab_dimensions_that_the_data_do_not_fill(tmp_path):
    data = bytearray(saved({"gyro": GYRO}))
    at = data.index(struct.pack("<ii", N, 3))
    data[at : at + 8] = struct.pack("<ii", 1 << 30, 1 << 30)
    (tmp_path / "a.mat").write_bytes(bytes(data))
    assert "is not a readable MATLAB file" in refusal(tmp_path / "a.mat")


# Recordings whose samples are in a foreign format, or elsewhere.


def euroc(path):
    write_rows(path, EUROC, [10**18 + 15_625_000 * np.arange(N), *GYRO.T, *ACCEL.T])


def test_recording_of_foreign_samples(tmp_path):
    euroc(tmp_path / "imu.txt")
    loaded = srt.load_recording(recording(tmp_path, "imu.txt", 'serial = "S1"\ntemperature_c = 21.0', units=False))
    assert_readings(loaded, GYRO, ACCEL, np.arange(N) / 64.0)
    assert (loaded.serial, loaded.temperature[0]) == ("S1", 21.0)
    assert len(loaded.data_sha256) == 64


def test_foreign_samples_that_do_not_say_their_units(tmp_path):
    np.savetxt(tmp_path / "imu.txt", np.column_stack([*COLUMNS.values()]), header=",".join(COLUMNS), delimiter=",")
    message = recording_refusal(recording(tmp_path, "imu.txt", units=False))
    assert "give recording.gyro_unit, one of" in message
    loaded = srt.load_recording(recording(tmp_path, "imu.txt", 'time_unit = "s"'))
    np.testing.assert_array_equal(loaded.gyro, GYRO)


def test_samples_outside_the_folder(tmp_path):
    folder = tmp_path / "recording"
    folder.mkdir()
    np.savez(tmp_path / "samples.npz", **COLUMNS)
    (folder / "link.npz").symlink_to(tmp_path / "samples.npz")
    for name in ("../samples.npz", str(tmp_path / "samples.npz"), "link.npz", "absent/../../samples.npz"):
        message = recording_refusal(recording(folder, name))
        assert "leads out of the recording's folder" in message
        assert name in message
    (folder / "loop.npz").symlink_to(folder / "loop.npz")
    for name in ("loop.npz", "a\\u0000b.csv", "n" * 300 + ".csv", "n" * 300 + ".bag"):
        recording_refusal(recording(folder, name))
    (folder / "imu0").mkdir()
    euroc(tmp_path / "data.csv")
    (folder / "imu0" / "data.csv").symlink_to(tmp_path / "data.csv")
    assert "leads out of the recording's folder" in recording_refusal(recording(folder, "imu0"))
    # Inside, whatever the way: the folder itself may be reached by a link.
    np.savez(folder / "samples.npz", **COLUMNS)
    (tmp_path / "other").symlink_to(folder)
    loaded = srt.load_recording(recording(tmp_path / "other", "../recording/samples.npz"))
    np.testing.assert_array_equal(loaded.time, TIME)


def test_a_foreign_file_for_a_recording_folder(tmp_path):
    def refusal(path):
        with pytest.raises(InputError) as caught:
            load_folder(path)
        return _one_sentence(caught)

    euroc(tmp_path / "imu.csv")
    advice = (
        f"convert the file (EuRoC CSV): srt convert {tmp_path / 'imu.csv'} -o DIR, with --latitude-deg and --height-m"
    )
    assert advice in refusal(tmp_path / "imu.csv")
    assert "keeps such a recording as FOLDER/recording" in refusal(tmp_path / "imu.csv")
    (tmp_path / "imu0").mkdir()
    euroc(tmp_path / "imu0" / "data.csv")
    assert "convert the folder (EuRoC CSV)" in refusal(tmp_path / "imu0")
    (tmp_path / "x.bin").write_bytes(bytes(100))
    assert "name another file" in refusal(tmp_path / "x.bin")


def test_a_foreign_file_needs_its_gravity(tmp_path):
    euroc(tmp_path / "imu.csv")
    assert "Gravity is not known: give it with gravity_m_s2=" in recording_refusal(tmp_path / "imu.csv")
