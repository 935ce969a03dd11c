"""Failures that the fuzzer found in the readers of recordings, each as the smallest file that shows it."""

import io
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from foreign_files import samples, write_phyphox

import srt
from srt.exceptions import InputError
from srt.recording.importer_registry import import_file

NAMES = ("time", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
TOML = """[recording]
samples = "{name}"
gyro_unit = "rad/s"
accel_unit = "m/s^2"
[site]
gravity_m_s2 = 9.81
"""


def refused(folder):
    with pytest.raises(InputError) as caught:
        srt.load_recording(folder)
    text = str(caught.value)
    assert len(text.splitlines()) == 1
    # A path, a sentence, and what was found: twelve names of sixty characters at most.
    assert len(text) < 1500
    return text


@pytest.mark.parametrize("text", ["[recording]\n{key} = 1\n[site]\n", "[recording]\n[site]\n[{key}]\n"])
@pytest.mark.parametrize("key", ["A" * 5000, '"a\\nb"'])
def test_keys_that_no_sentence_holds(tmp_path, text, key):
    (tmp_path / "recording.toml").write_text(text.format(key=key))
    assert "is no known" in refused(tmp_path)


@pytest.mark.parametrize("name", ["A" * 5000, "time\fgyro_x", "gyro\x1e_x"])
def test_column_names_that_no_sentence_holds(tmp_path, name):
    (tmp_path / "recording.toml").write_text(TOML.format(name="a.csv"))
    (tmp_path / "a.csv").write_text(",".join((name, *NAMES[2:])) + "\n" + ",".join("1" * 6) + "\n")
    assert "has no column time" in refused(tmp_path)


def test_an_npy_header_without_end(tmp_path):
    (tmp_path / "recording.toml").write_text(TOML.format(name="a.npz"))
    member = io.BytesIO()
    np.save(member, np.zeros(4))
    damaged = member.getvalue().replace(b"(4,), }", b"(4,),  ")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for name in NAMES:
            archive.writestr(f"{name}.npy", damaged)
    assert "is not a readable NPZ file" in refused(tmp_path)


def test_an_encrypted_member(tmp_path):
    (tmp_path / "recording.toml").write_text(TOML.format(name="a.npz"))
    np.savez(tmp_path / "a.npz", **dict.fromkeys(NAMES, np.zeros(4)))
    data = bytearray((tmp_path / "a.npz").read_bytes())
    for signature, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(signature) + flags] |= 1  # the flag of encryption, bit 0
    (tmp_path / "a.npz").write_bytes(data)
    assert "is not a readable NPZ file (File" in refused(tmp_path)


@pytest.mark.parametrize("rate", ["200..0", ".", "1.2.3"])
def test_an_update_rate_that_is_no_number(tmp_path, rate):
    rows = "".join(f"{k}\t" + "\t".join("1" * 6) + "\n" for k in range(4))
    names = "\t".join(["PacketCounter", *(f"{part}_{a}" for part in ("Acc", "Gyr") for a in "XYZ")])
    (tmp_path / "MT_0.txt").write_text(f"// Update Rate: {rate}Hz\n{names}\n{rows}")
    assert import_file(tmp_path / "MT_0.txt")[1].sample_rate_hz is None


def test_a_table_of_phyphox_that_does_not_decompress(tmp_path, shell):
    path = tmp_path / "log.zip"
    write_phyphox(path, *samples(200))
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("Gyroscope.csv").header_offset + 30 + len("Gyroscope.csv")
    data[start : start + 40] = bytes(40)
    path.write_bytes(data)
    assert "is not a readable phyphox export (" in shell("convert", path, "-o", tmp_path / "out", code=2).err


def write_circle(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", libver="earliest") as file:
        for name in NAMES:
            file.create_dataset(name, data=np.arange(4.0))
    data = bytearray(path.read_bytes())
    node = data.index(b"TREE")
    data[node + 6 : node + 8] = bytes(2)  # a node without entries ...
    data[node + 16 : node + 24] = node.to_bytes(8, "little")  # ... whose next is itself
    path.write_bytes(data)


def test_an_hdf5_file_that_leads_back_to_itself(tmp_path):
    write_circle(tmp_path / "a.h5")
    (tmp_path / "recording.toml").write_text(TOML.format(name="a.h5"))
    # In a process of its own, which can be ended: the library does not come back from such a file.
    code = f"import srt; srt.load_recording({str(tmp_path)!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert "leads back to itself" in done.stderr
    with pytest.raises(InputError, match="leads back to itself"):
        import_file(tmp_path / "a.h5")
