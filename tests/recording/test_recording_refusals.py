"""A good folder, spoiled in one way: what the sentence must name."""

import numpy as np
import pytest

from srt.exceptions import InputError
from srt.recording.folder import load_recording

HEADER = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
ROWS = [f"{0.01 * i:.2f},0.1,0.2,0.3,0.01,0.02,{9.8 + 1e-9 * (i % 7):.9f}" for i in range(1, 801)]
TOML = """[recording]
samples = "samples.csv"
kind = "rate"
gyro_unit = "rad/s"
accel_unit = "m/s^2"
time_unit = "s"

[site]
latitude_deg = 45.0
gravity_m_s2 = 9.80665

[fixture]
heading_deg = 0.0

[imu]
gyro_noise_deg_per_sqrt_h = 0.002

[[sequence]]
id = "1"
start_static_s = [0.0, 1.0]
end_static_s = [2.0, 3.0]

[[sequence]]
id = "2"
start_static_s = [4.0, 5.0]
end_static_s = [6.0, 7.0]
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "samples.csv").write_text("\n".join([HEADER, *ROWS]) + "\n")
    (tmp_path / "recording.toml").write_text(TOML)
    return tmp_path


def refusal(path):
    with pytest.raises(InputError) as caught:
        load_recording(path)
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_code == 2
    return message


def test_the_good_folder_is_good(folder):
    assert len(load_recording(folder).sequences) == 2


@pytest.mark.parametrize(
    ("old", "new", "fragments"),
    [
        # structure
        ("[recording]", "[recording", ["not valid TOML", "line 1"]),
        ("[site]", "[sites]", ["[sites]", "did you mean site?"]),
        ("[recording]\n", "[imu2]\n", ["[imu2]"]),
        ("[site]\nlatitude_deg = 45.0\ngravity_m_s2 = 9.80665\n", "", ["[site] is missing"]),
        ("[site]\n", "[[site]]\n", ["site is [", "a section of keys"]),
        ("[[sequence]]", "[sequence]", ["not valid TOML"]),
        # keys
        ("latitude_deg", "latitud_deg", ["site.latitud_deg", "did you mean latitude_deg?", "height_m"]),
        ("heading_deg", "heading", ["fixture.heading", "did you mean heading_deg?"]),
        ("gyro_noise_deg_per_sqrt_h", "noise", ["imu.noise", "gyro_noise_deg_per_sqrt_h"]),
        ("start_static_s = [4", "start_static = [4", ["sequence[2].start_static", "did you mean start_static_s?"]),
        ('samples = "samples.csv"\n', "", ["recording.samples is missing"]),
        ('gyro_unit = "rad/s"\n', "", ["the unit of gyro", "recording.gyro_unit", "deg/h", "counts"]),
        ('accel_unit = "m/s^2"\n', "", ["the unit of accel", "recording.accel_unit", "mg"]),
        ("end_static_s = [6.0, 7.0]", "", ["sequence[2].end_static_s is missing"]),
        # types and ranges
        ("latitude_deg = 45.0", "latitude_deg = 91", ["site.latitude_deg is 91", "-90 to 90 in degrees"]),
        ("latitude_deg = 45.0", 'latitude_deg = "45"', ['site.latitude_deg is the text "45"', "a number"]),
        ("latitude_deg = 45.0", "latitude_deg = true", ["site.latitude_deg is True"]),
        ("latitude_deg = 45.0", "latitude_deg = nan", ["site.latitude_deg is nan"]),
        ("gravity_m_s2 = 9.80665", "gravity_m_s2 = 1.0", ["site.gravity_m_s2 is 1.0", "9.5 to 10.1 in m/s²"]),
        ("gravity_m_s2 = 9.80665", "", ["gravity_m_s2", "height_m", "normal gravity"]),
        ("latitude_deg = 45.0\ngravity_m_s2 = 9.80665", "height_m = 5", ["without site.latitude_deg"]),
        ("heading_deg = 0.0", "heading_deg = [1]", ["fixture.heading_deg is [1]"]),
        ("heading_deg = 0.0", "alignment_sigma_mrad = 0", ["alignment_sigma_mrad is 0", "from 1e-09 to 3200 in mrad"]),
        ("sqrt_h = 0.002", "sqrt_h = -0.002", ["gyro_noise_deg_per_sqrt_h is -0.002", "°/√h"]),
        ("sqrt_h = 0.002", "sqrt_h = 1" + "0" * 400, ["gyro_noise_deg_per_sqrt_h is 1000", "..."]),
        ('kind = "rate"', 'kind = "rates"', ['recording.kind is the text "rates"', '"increment"']),
        ('time_unit = "s"', 'time_unit = "min"', ['"min"', '"ms"']),
        ('time_unit = "s"', "sample_rate_hz = 0", ["sample_rate_hz is 0", "positive number of at most 1e+06 in Hz"]),
        ('time_unit = "s"', "sample_rate_hz = 200", ["sample_rate_hz is 200", "0.01 s per sample"]),
        ('time_unit = "s"', "serial = 5", ["recording.serial is 5", "a text in quotes"]),
        ('id = "2"', "id = 2", ["sequence[2].id is 2", "a text in quotes"]),
        ("[4.0, 5.0]", "[4.0]", ["sequence[2].start_static_s is [4.0]", "[from, to]"]),
        ("[4.0, 5.0]", "[5.0, 4.0]", ["sequence[2]", "[5, 4]", "starts before it ends"]),
        ("[6.0, 7.0]", "[6.0, 70.0]", ["'2'", "end_static_s is [6, 70]", "from 0 to 8 s"]),
        ('id = "2"', 'id = "99"', ["sequence[2]", "'99'", "Table 1", "rotations"]),
        ('id = "2"', 'rotations = [["y", "1"]]', ["sequence[2].rotations", '[["y", 180.0]']),
        ('id = "2"', 'rotations = [["w", 1]]', ["sequence[2].rotations"]),
        ('id = "2"', "rotations = 5", ["sequence[2].rotations is 5"]),
        ('id = "2"', 'down = "w"', ["sequence[2].down", '"x", "y", "z", "-x", "-y", "-z"']),
        ('id = "2"', 'along_outer = "+z"', ["sequence[2].along_outer", '"+z"', '"-z"']),
        ('id = "2"', 'down = "-x"\nalong_outer = "x"', ["sequence[2]", "axis x", "name two axes"]),
        ('id = "2"', 'rotations = [["-x", 90.0]]', ["sequence[2].rotations", '[["y", 180.0]']),
        # units
        ('"rad/s"', '"deg"', ["unit deg of the gyro", "kind rate", "deg/s", "recording.gyro_unit"]),
        ('"rad/s"', '"rpm"', ['gyro_unit is the text "rpm"', '"deg/s"']),
        ('"m/s^2"', '"m/s"', ["unit m/s of the accel", "mg", "recording.accel_unit"]),
        ('kind = "rate"', 'kind = "increment"', ["unit rad/s of the gyro", "kind increment", "recording.kind"]),
        ('"rad/s"', '"counts"', ["value of one count", "recording.gyro_lsb"]),
        ('time_unit = "s"', "gyro_lsb = 0.1", ["recording.gyro_lsb is given", "recording.gyro_unit is rad/s"]),
        ('time_unit = "s"', "accel_lsb = 0", ["accel_lsb is 0", "other than 0"]),
        ('time_unit = "s"', "gyro_offset_counts = [1, 2]", ["gyro_offset_counts is [1, 2]", "list of three"]),
        # samples
        ('"samples.csv"', '"sample.csv"', ["no samples file", "sample.csv"]),
        ('"samples.csv"', '"recording.toml"', ["'.toml'", ".csv, .npz, .parquet, .h5"]),
        ('"samples.csv"', '""', ["recording.samples is", "a text in quotes"]),
    ],
)
def test_recording_toml(folder, old, new, fragments):
    assert old in TOML
    (folder / "recording.toml").write_text(TOML.replace(old, new))
    message = refusal(folder)
    assert all(fragment in message for fragment in fragments), message
    assert str(folder) in message


def spoil(line, column, text):
    """The samples with one cell changed; line numbers as an editor shows them."""
    rows = [HEADER, *ROWS]
    cells = rows[line - 1].split(",")
    cells[column] = text
    rows[line - 1] = ",".join(cells)
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("content", "fragments"),
    [
        ("", ["is empty", "header row"]),
        ("\n\n", ["is empty"]),
        (HEADER + "\n", ["ends after its header row"]),
        (HEADER + "\n\n# nothing\n", ["ends after its header row"]),
        ("\n".join(ROWS), ["row of numbers", "column names"]),
        (spoil(1, 4, "acc_x"), ["no column accel_x", "did you mean acc_x?", "found: time"]),
        (spoil(1, 0, "t"), ["no column time"]),
        (spoil(1, 1, "time"), ["no column gyro_x"]),
        (spoil(1, 6, "accel_z,time"), ["column time more than once"]),
        (HEADER.replace(",", ";") + "\n1;2;3;4;5;6;7\n", ["separated by semicolons"]),
        (HEADER.replace(",", "\t") + "\n1\t2\n", ["separated by tabs"]),
        (spoil(17, 2, "abc"), ["line 17", "gyro_y", "'abc'", "a number is expected"]),
        (spoil(17, 2, ""), ["line 17", "gyro_y", "an empty cell"]),
        (spoil(17, 2, "1_000"), ["line 17", "gyro_y", "'1_000'"]),
        (spoil(17, 2, "0,2"), ["line 17", "8 cells", "header has 7", "decimal points"]),
        (spoil(17, 2, "nan"), ["gyro_y", "sample 16 of 800", "0.16 s", "nan"]),
        (spoil(17, 2, "1e999"), ["gyro_y", "sample 16", "inf"]),
        (spoil(17, 0, "0.15"), ["Column time", "sample 16", "repeats 0.15 s"]),
        (spoil(17, 0, "0.02"), ["Column time", "sample 16", "goes back from 0.15 s"]),
        ("\n".join([HEADER, *ROWS, "8.01,0.1,0.2"]), ["cut off in its last line"]),
        ("\n".join([HEADER, *ROWS, "8.01,0.1,0.200000000"]), ["line 802", "3 cells", "seems cut off"]),
        ("\n".join([HEADER, *ROWS, "8.01,0.1,0.2\n"]), ["line 802", "3 cells", "seems cut off"]),
        ("\n".join([HEADER, *ROWS, "8.01,0.1,0.2,0.3,0.01,0.02,-"]), ["cut off in its last line"]),
        ("\n".join([HEADER, *ROWS, "8.01,0.1,0.2,0.3,0.01,0.02,9.8000"]), ["cut off in its last line"]),
        ("\n".join([HEADER, *ROWS[:5], "8.01,0.1,0.2,0.3,0.01,0.02,-"]), ["line 7", "accel_z", "'-'"]),
        # other columns make numpy look at some cells only
        (spoil(1, 6, "accel_z,note"), ["line 2", "7 cells", "header has 8"]),
        (
            "\n".join([HEADER + ",note", *(r + ",x" for r in ROWS[:9]), ROWS[9] + ",x,y", ROWS[10] + ",x"]) + "\n",
            ["line 11", "9 cells", "header has 8"],
        ),
        (b"\xff\xfe\x00binary\x00", ["not a text file in UTF-8"]),
        (HEADER.encode() + b"\n1,2,3,4,5,6,\xff\n", ["not a text file in UTF-8"]),
        (HEADER + "\n1,2,3,4,5,6,7\n", ["1 samples", "at least 2"]),
    ],
)
def test_samples_csv(folder, content, fragments):
    data = content if isinstance(content, bytes) else content.encode()
    (folder / "samples.csv").write_bytes(data)
    message = refusal(folder)
    assert all(fragment in message for fragment in fragments), message
    assert str(folder) in message


def use(folder, name):
    (folder / "recording.toml").write_text(TOML.replace("samples.csv", name))
    return folder / name


def table(**changes):
    values = np.loadtxt(ROWS, delimiter=",")
    columns = {name: values[:, i] for i, name in enumerate(HEADER.split(","))}
    columns.update(changes)
    return {name: column for name, column in columns.items() if column is not None}


def write_npz(path, columns):
    np.savez(path, **columns)


def write_parquet(path, columns):
    pa = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.parquet").write_table(pa.table(columns), path)


def write_hdf5(path, columns):
    with pytest.importorskip("h5py").File(path, "w") as file:
        for name, column in columns.items():
            file.create_dataset(name, data=column)


BINARY = [("samples.npz", write_npz), ("samples.parquet", write_parquet), ("samples.h5", write_hdf5)]


@pytest.mark.parametrize(("name", "write"), BINARY)
def test_binary_formats_cut_off_or_damaged(folder, name, write):
    path = use(folder, name)
    write(path, table())
    whole = path.read_bytes()
    load_recording(folder)
    for data in (b"", b"rubbish", whole[:100], whole[: len(whole) // 2], whole[:-10]):
        path.write_bytes(data)
        message = refusal(folder)
        assert "not a readable" in message, message
        assert str(path) in message
    places = 10 if name.endswith("parquet") else 40  # parquet is read by a process of its own
    for at in range(50, len(whole), len(whole) // places):
        # A byte changed in the values can pass where the format has no checksum; nothing else may come out.
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        try:
            load_recording(folder)
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.parametrize(("name", "write"), BINARY)
@pytest.mark.parametrize(
    ("changes", "fragments"),
    [
        ({"gyro_z": None}, ["no column gyro_z", "found: "]),
        ({"gyro_z": None, "gyro_zz": np.zeros(800)}, ["did you mean gyro_zz?"]),
        ({"gyro_z": np.full(800, "a").astype("S1")}, ["gyro_z", "type", "number"]),
        ({"gyro_z": np.where(np.arange(800) == 4, np.nan, 0.0)}, ["gyro_z", "sample 5 ", "nan"]),
    ],
)
def test_binary_formats_with_bad_columns(folder, name, write, changes, fragments):
    write(use(folder, name), table(**changes))
    message = refusal(folder)
    assert all(fragment in message for fragment in fragments), message


@pytest.mark.parametrize(("name", "write"), [BINARY[0], BINARY[2]])
def test_columns_of_unequal_length_or_shape(folder, name, write):
    write(use(folder, name), table(accel_x=np.zeros(799)))
    assert "accel_x holds 799 samples, but time 800" in refusal(folder)
    write(use(folder, name), table(accel_x=np.zeros((800, 2))))
    assert "accel_x" in refusal(folder)
    write(use(folder, name), table(accel_x=np.zeros(800, dtype=complex)))
    assert "complex" in refusal(folder)


def test_a_single_array_is_no_archive(folder):
    path = use(folder, "samples.npz")
    with path.open("wb") as file:
        np.save(file, np.zeros((5, 7)))
    assert "one array per column" in refusal(folder)


def test_an_absent_value_in_parquet_is_found(folder):
    write_parquet(use(folder, "samples.parquet"), table(accel_y=[None, *[0.0] * 799]))
    assert "accel_y: sample 1 " in refusal(folder)


def test_a_group_in_hdf5_is_no_column(folder):
    h5py = pytest.importorskip("h5py")
    path = use(folder, "samples.h5")
    write_hdf5(path, table(gyro_x=None))
    with h5py.File(path, "a") as file:
        file.create_group("gyro_x")
    assert "gyro_x is a group" in refusal(folder)


def test_paths(folder, tmp_path):
    assert "There is no recording" in refusal(folder / "absent")
    assert "name the folder that holds recording.toml" in refusal(folder / "samples.csv")
    (folder / "empty").mkdir()
    assert "holds no recording.toml" in refusal(folder / "empty")
    (folder / "recording.toml").write_bytes(b"\xff\xfe")
    assert "not valid TOML" in refusal(folder)
