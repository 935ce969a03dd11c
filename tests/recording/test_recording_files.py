"""Files of a recording, and what overwriting leaves of them."""

import errno
import hashlib
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from failing_calls import FailingCalls
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from srt.constants import ARCSEC, DEG, STANDARD_GRAVITY_M_S2, normal_gravity_m_s2
from srt.exceptions import InputError, MissingExtraError
from srt.recording.folder import load_recording
from srt.recording.recording import Fixture, ImuNoise, Recording, SequenceLabel, Site
from srt.recording.samples import SAMPLES_FORMATS, Samples, read_samples, write_samples
from srt.recording.writing import write_recording

REQUIRES = {"parquet": "pyarrow", "h5": "h5py"}
FORMATS = [
    pytest.param(name, marks=pytest.mark.skipif(not __import__("importlib").util.find_spec(package), reason=package))
    if (package := REQUIRES.get(name))
    else name
    for name in SAMPLES_FORMATS
]

LABELS = (
    SequenceLabel((0.0, 1.0), (2.0, 3.0), "1a"),
    SequenceLabel((3.0, 4.0), (5.0, 6.0), "mine", "z", "y", (("y", math.pi), ("z", -math.pi / 2))),
    SequenceLabel((5.0, 6.0), (7.125, 8.0)),
)


def make(n=1000, **changes):
    rng = np.random.default_rng(7)
    fields = {
        "time": 0.01 * np.arange(1, n + 1),
        "gyro": rng.standard_normal((n, 3)) * 10.0 ** rng.integers(-9, 3, (n, 3)),
        "accel": rng.standard_normal((n, 3)),
        "site": Site(9.80665, 3e-6, math.radians(45.0)),
        "fixture": Fixture(math.radians(30.0), 0.5e-3, 2e-3),
        "noise": ImuNoise(*rng.uniform(1e-7, 1e-3, 6).tolist(), *rng.uniform(1.0, 9.0, 2).tolist()),
        "sequences": LABELS,
        "temperature": rng.uniform(20.0, 30.0, n),
        "serial": 'SN "1" \\ é\t',
        "date": "2024-05-01",
    }
    return Recording(**(fields | changes))


def assert_same(a, b):
    for name in ("time", "gyro", "accel"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    if a.temperature is None:
        assert b.temperature is None
    else:
        np.testing.assert_array_equal(a.temperature, b.temperature)
        assert a.temperature.strides == b.temperature.strides
    for name in ("site", "fixture", "sequences", "kind", "sample_rate_hz", "serial", "date"):
        assert getattr(a, name) == getattr(b, name), name
    for name in ImuNoise.__slots__:
        x, y = getattr(a.noise, name), getattr(b.noise, name)
        # A value may have no counterpart in the file's unit that converts to all its bits.
        assert x == y or x == pytest.approx(y, rel=3e-16, abs=0.0), name


@pytest.mark.parametrize("samples_format", FORMATS)
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"kind": "increment", "fixture": None, "sequences": (), "temperature": None, "serial": None},
        {"sample_rate_hz": 100.0, "temperature": np.broadcast_to(21.5, 1000), "date": None},
        {"site": Site(9.78), "fixture": Fixture(heading_rad=None), "noise": ImuNoise()},
    ],
)
def test_a_written_recording_is_read_back(tmp_path, samples_format, changes):
    recording = make(**changes)
    write_recording(recording, tmp_path / "new" / "rec", samples_format=samples_format)
    again = load_recording(tmp_path / "new" / "rec")
    assert_same(recording, again)
    samples = tmp_path / "new" / "rec" / f"samples.{samples_format}"
    assert again.data_sha256 == hashlib.sha256(samples.read_bytes()).hexdigest()
    assert again.source == str(tmp_path / "new" / "rec")
    assert_same(again, load_recording(tmp_path / "new" / "rec" / "recording.toml"))
    # a second round changes nothing at all, noise included
    write_recording(again, tmp_path / "second", samples_format=samples_format)
    assert load_recording(tmp_path / "second").noise == again.noise
    assert sorted(p.name for p in samples.parent.iterdir()) == ["recording.toml", samples.name]


finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.mark.parametrize("samples_format", FORMATS)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_any_float_reads_back_to_the_last_bit(samples_format, data):
    n = data.draw(st.integers(1, 40))
    samples = Samples(
        data.draw(arrays(np.float64, (n, 3), elements=finite)),
        data.draw(arrays(np.float64, (n, 3), elements=finite)),
        data.draw(arrays(np.float64, (n,), elements=finite)),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"t.{samples_format}"
        write_samples(path, samples)
        again = read_samples(path)
    for name in samples.names:
        assert samples.column(name).tobytes() == again.column(name).tobytes()


@settings(max_examples=25, deadline=None)
@given(
    latitude=st.floats(-90.0, 90.0),
    heading=st.floats(-360.0, 360.0),
    sigma=st.floats(1e-3, 1e3),
    angle=st.floats(-720.0, 720.0),
    serial=st.text(min_size=1).filter(lambda s: s.isprintable()),
)
def test_facts_given_in_the_units_of_the_file_read_back_exactly(latitude, heading, sigma, angle, serial):
    recording = make(
        10,
        site=Site(9.8, latitude_rad=latitude * DEG),
        fixture=Fixture(heading * DEG, sigma * 1e-3, sigma * 1e-3),
        noise=ImuNoise(gyro_quantization=sigma * ARCSEC),
        sequences=(SequenceLabel((0.0, 0.02), (0.07, 0.1), "q", "x", "z", (("y", angle * DEG),)),),
        temperature=None,
        serial=serial,
    )
    with tempfile.TemporaryDirectory() as folder:
        write_recording(recording, folder)
        assert_same(recording, load_recording(folder))


CSV = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z\n"


def write_folder(folder, header="", rows="1,1,2,3,4,5,6\n2,7,8,9,10,11,12\n", *, site="gravity_m_s2 = 9.8", more=""):
    folder.mkdir(exist_ok=True)
    (folder / "samples.csv").write_text(CSV + rows)
    (folder / "recording.toml").write_text(f'[recording]\nsamples = "samples.csv"\n{header}\n[site]\n{site}\n{more}\n')
    return folder


@pytest.mark.parametrize(
    ("header", "gyro", "accel"),
    [
        ('gyro_unit = "rad/s"\naccel_unit = "m/s^2"', 1.0, 1.0),
        ('gyro_unit = "deg/s"\naccel_unit = "g"', math.pi / 180, 9.80665),
        ('gyro_unit = "deg/h"\naccel_unit = "mg"', math.pi / 180 / 3600, 9.80665e-3),
        ('kind = "increment"\ngyro_unit = "rad"\naccel_unit = "m/s"', 1.0, 1.0),
        ('kind = "increment"\ngyro_unit = "deg"\naccel_unit = "m/s"', math.pi / 180, 1.0),
    ],
)
def test_units(tmp_path, header, gyro, accel):
    recording = load_recording(write_folder(tmp_path, header))
    np.testing.assert_allclose(recording.gyro, gyro * np.array([[1, 2, 3], [7, 8, 9]]), rtol=1e-15)
    np.testing.assert_allclose(recording.accel, accel * np.array([[4, 5, 6], [10, 11, 12]]), rtol=1e-15)


def test_counts(tmp_path):
    header = (
        'gyro_unit = "counts"\ngyro_lsb = [0.5, 0.25, -1]\ngyro_offset_counts = 1\n'
        'accel_unit = "counts"\naccel_lsb = 0.5\naccel_offset_counts = [4, 4.5, 0]'
    )
    recording = load_recording(write_folder(tmp_path, header))
    np.testing.assert_array_equal(recording.gyro, [[0.0, 0.25, -2.0], [3.0, 1.75, -8.0]])
    np.testing.assert_array_equal(recording.accel, [[0.0, 0.25, 3.0], [3.0, 3.25, 6.0]])
    alone = header.replace('gyro_unit = "counts"\n', "").replace('accel_unit = "counts"\n', "")
    np.testing.assert_array_equal(load_recording(write_folder(tmp_path, alone)).gyro, recording.gyro)


SI = 'gyro_unit = "rad/s"\naccel_unit = "m/s^2"\n'


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
def test_time_units(tmp_path, unit, factor):
    recording = load_recording(write_folder(tmp_path, f'{SI}time_unit = "{unit}"'))
    np.testing.assert_allclose(recording.time, [factor, 2 * factor], rtol=1e-15)


def test_gravity_given_or_normal(tmp_path):
    given = load_recording(write_folder(tmp_path, SI)).site
    assert given == Site(9.8, 5e-6, None, gravity_sigma_origin="assumed")
    site = load_recording(write_folder(tmp_path, SI, site="latitude_deg = 45\nheight_m = 100")).site
    gravity = normal_gravity_m_s2(math.pi / 4, 100.0)
    assert site == Site(gravity, 5e-4, math.pi / 4, gravity_sigma_origin="assumed")
    # WGS 84 at 45°: 9.806199 m/s² at height 0, less 3.086e-6 per metre
    assert site.gravity_m_s2 == pytest.approx(9.806199 - 3.086e-4, abs=2e-6)
    site = load_recording(
        write_folder(tmp_path, SI, site="latitude_deg = 45\nheight_m = 0\ngravity_sigma_m_s2 = 1e-4")
    ).site
    assert (site.gravity_sigma_m_s2, site.gravity_sigma_origin) == (1e-4, None)


def test_absent_keys_are_unknown(tmp_path):
    recording = load_recording(write_folder(tmp_path, SI))
    assert recording.fixture is None
    assert recording.noise == ImuNoise()
    assert recording.sequences == ()
    assert recording.kind == "rate"
    assert recording.temperature is recording.serial is recording.date is recording.sample_rate_hz is None
    recording = load_recording(write_folder(tmp_path, SI, more="[fixture]"))
    assert recording.fixture == Fixture(heading_rad=None)


def test_imu_section_in_si(tmp_path):
    more = """[imu]
gyro_noise_deg_per_sqrt_h = 0.002
accel_noise_ug_per_sqrt_hz = 20
gyro_quantization_arcsec = 0.5
accel_quantization_m_s = 1e-5
gyro_bias_instability_deg_per_h = 0.003
accel_bias_instability_ug = 5.0
gyro_range_deg_s = 400.0
accel_range_g = 10.0
"""
    noise = load_recording(write_folder(tmp_path, SI, more=more)).noise
    assert noise.gyro_noise * math.sqrt(40.0) == pytest.approx(3.7e-6, rel=0.01)  # Savage 2020, §9: 3.7 µrad in 40 s
    assert noise.accel_noise == pytest.approx(20e-6 * STANDARD_GRAVITY_M_S2)
    assert noise.gyro_quantization == pytest.approx(0.5 * math.pi / 180 / 3600)
    assert noise.accel_quantization == 1e-5
    assert noise.gyro_bias_instability == pytest.approx(0.003 * math.pi / 180 / 3600)
    assert noise.accel_bias_instability == pytest.approx(5e-6 * STANDARD_GRAVITY_M_S2)
    assert noise.gyro_range == pytest.approx(math.radians(400))
    assert noise.accel_range == pytest.approx(10 * STANDARD_GRAVITY_M_S2)


def test_columns_in_any_order_with_others_between(tmp_path):
    folder = write_folder(tmp_path, SI)
    (folder / "samples.csv").write_text(
        "\ufeffaccel_z, note,gyro_x,gyro_y,gyro_z,time,accel_x,accel_y,temperature\r\n"
        "6,first,1,2,3,1,4,5,20\r\n\r\n12,second,7,8,9,2,10,11,22\r\n",
        encoding="utf-8",
    )
    recording = load_recording(folder)
    np.testing.assert_array_equal(recording.gyro, [[1, 2, 3], [7, 8, 9]])
    np.testing.assert_array_equal(recording.accel, [[4, 5, 6], [10, 11, 12]])
    np.testing.assert_array_equal(recording.temperature, [20, 22])


@pytest.mark.parametrize(
    "text",
    [
        "# a logger's remark\n\n" + CSV + "1,1,2,3,4,5,6\n2,7,8,9,10,11,12",
        "# " + CSV + "1,1,2,3,4,5,6\n# a remark, within\n2,7,8,9,10,11,12\n\n",
        '"time","gyro_x","gyro_y","gyro_z","accel_x","accel_y","accel_z"\n"1",1,2,3,4,5,6\n2,7,8,9,10,11,12\n',
    ],
)
def test_csv_as_programs_write_it(tmp_path, text):
    folder = write_folder(tmp_path, SI)
    (folder / "samples.csv").write_text(text)
    np.testing.assert_array_equal(load_recording(folder).accel, [[4, 5, 6], [10, 11, 12]])


def test_a_rate_makes_the_time_where_no_column_does(tmp_path):
    folder = write_folder(tmp_path, SI + "sample_rate_hz = 200\ntemperature_c = 25")
    (folder / "samples.csv").write_text(CSV.replace("time,", "") + "1,2,3,4,5,6\n7,8,9,10,11,12\n")
    recording = load_recording(folder)
    np.testing.assert_allclose(recording.time, [0.005, 0.01])
    assert recording.temperature.tolist() == [25.0, 25.0]


def test_writing_refuses_a_folder_in_use_and_leaves_it_alone(tmp_path):
    folder = write_folder(tmp_path / "r", SI)
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    with pytest.raises(InputError, match="holds files already"):
        write_recording(make(), folder)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    write_recording(make(), folder, samples_format="npz", overwrite=True)
    assert_same(load_recording(folder), make())


def test_writing_refuses_other_targets(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file"):
        write_recording(make(), tmp_path / "file")
    with pytest.raises(InputError, match=r"Cannot write .*choose a place"):
        write_recording(make(), tmp_path / "file" / "below")
    with pytest.raises(InputError, match=r"'parket' \(did you mean parquet\?\)"):
        write_recording(make(), tmp_path / "new", samples_format="parket")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(("extension", "package"), [("parquet", "pyarrow"), ("h5", "h5py")])
def test_an_absent_package_is_named_with_what_to_install(tmp_path, monkeypatch, extension, package):
    monkeypatch.setitem(sys.modules, package, None)
    path = tmp_path / f"samples.{extension}"
    path.write_bytes(b"anything")
    with pytest.raises(MissingExtraError, match=rf"'{package}'.*strapdown-rotation-test\[io\]"):
        read_samples(path)
    with pytest.raises(MissingExtraError, match=package):
        write_recording(make(), tmp_path / "new", samples_format=extension)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("samples_format", [f for f in FORMATS if f != "csv"])
def test_a_flipped_bit_changes_no_sample_in_silence(tmp_path, samples_format):
    """Places in the data, and as many in the structure at both ends: refused, or read as they were written."""
    places = 15 if samples_format == "parquet" else 60  # parquet is read by a process of its own
    written = make()
    samples = Samples(written.gyro, written.accel, written.time, None)
    path = tmp_path / f"samples.{samples_format}"
    write_samples(path, samples)
    content = path.read_bytes()
    rng = np.random.default_rng(20261122)
    ends = np.r_[0:2000, len(content) - 2000 : len(content)]
    refused = 0
    for place in np.r_[rng.integers(len(content), size=places), rng.choice(ends, places)]:
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            found = read_samples(path, time_required=True)
        except InputError:
            refused += 1
        else:
            assert all(np.array_equal(found.column(name), samples.column(name)) for name in samples.names)
    assert refused >= places  # every flip in the data is noticed; one in an unused byte of the structure need not be


@pytest.mark.skipif(os.name == "nt", reason="limit of file sizes")
@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_a_full_disk_is_one_error_and_the_interpreter_ends_as_usual(tmp_path, suffix):
    """HDF5 ended it with a segmentation fault, because its open file could not be written."""
    if suffix == ".h5":
        pytest.importorskip("h5py")
    code = (
        "import resource\nimport numpy as np\nfrom srt.exceptions import InputError\n"
        "from srt.recording.samples import Samples, write_samples\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))\n"
        f"try: write_samples({str(tmp_path / ('x' + suffix))!r}, Samples(np.ones((9999, 3)), np.ones((9999, 3))))\n"
        "except InputError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "File too large" in done.stdout
    assert list(tmp_path.iterdir()) == []


OLD, NEW = 40, 60
ZIP_LEFT_OPEN = (
    pytest.mark.filterwarnings("ignore:Exception ignored in.*ZipFile:pytest.PytestUnraisableExceptionWarning")
    if np.lib.NumpyVersion(np.__version__) < "2.2.0"
    else lambda test: test
)
"""Before 2.2, numpy leaves the archive of a failed ``savez`` open: its destructor writes to a closed file."""


def recording(n):
    rng = np.random.default_rng(n)
    return Recording(0.01 * np.arange(1, n + 1), rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), Site(9.8))


def folder_with_old(path, samples_format):
    write_recording(recording(OLD), path, samples_format=samples_format)
    (path / "notes.txt").write_text("kept")
    return {p.name: p.read_bytes() for p in path.iterdir()}


def failing_writes(tmp_path, prepare, **options):
    """Writes of which one call after the other fails, and one of which none does: folder, error, calls, what was."""
    failing = 0
    while True:
        folder = tmp_path / str(failing)
        before, error = prepare(folder), None
        with pytest.MonkeyPatch.context() as patch:
            layer = FailingCalls(patch, folder, failing)
            try:
                write_recording(recording(NEW), folder, **options)
            except InputError as refused:
                error = refused
        assert error is not None or np.array_equal(load_recording(folder).gyro, recording(NEW).gyro)
        yield folder, error, layer, before
        if len(layer.calls) <= failing:
            break
        failing += 1


@ZIP_LEFT_OPEN
@pytest.mark.parametrize("samples_format", SAMPLES_FORMATS)
def test_each_failing_call_leaves_a_complete_recording(tmp_path, samples_format):
    failed, options = [], {"samples_format": samples_format, "overwrite": True}
    for folder, error, layer, before in failing_writes(
        tmp_path, lambda f: folder_with_old(f, samples_format), **options
    ):
        load_recording(folder)
        now = {p.name: p.read_bytes() for p in folder.iterdir()}
        assert now["notes.txt"] == b"kept"
        if error is not None:
            assert "No space left" in str(error)
            assert {name: now[name] for name in before} == before
            failed.append(layer.failed)
    # Opening, syncing and renaming the samples, and the same for recording.toml, end with an error.
    assert set(failed) >= {"open", "fsync", "replace"}
    assert samples_format != "csv" or "write" in failed
    assert len(failed) >= 5
    assert error is None
    assert sorted(now) == ["notes.txt", "recording.toml", f"samples.{samples_format}"]


def test_nothing_is_left_of_a_first_write_that_fails(tmp_path):
    failed = 0
    for folder, error, layer, _ in failing_writes(tmp_path, lambda folder: None):
        # Where the removal of a temporary file is the call that fails, the file stays.
        assert error is None or layer.failed == "unlink" or not folder.exists()
        failed += layer.failed != "none"
    assert failed > 5


def test_a_file_system_without_links_keeps_the_new_recording_under_another_name(tmp_path, monkeypatch):
    folder_with_old(tmp_path, "csv")

    def unsupported(*_args, **_kwargs):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", unsupported)
    for n, name in ((NEW, "samples-2.csv"), (NEW + 1, "samples.csv")):
        write_recording(recording(n), tmp_path, overwrite=True)
        assert len(load_recording(tmp_path).gyro) == n
        assert sorted(p.name for p in tmp_path.iterdir()) == ["notes.txt", "recording.toml", name]
