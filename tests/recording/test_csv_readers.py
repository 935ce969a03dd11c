"""CSV by pyarrow and by numpy: the same bits, and the same refusals."""

import sys

import numpy as np
import pytest

from srt.exceptions import InputError
from srt.recording import text_tables
from srt.recording.import_options import ImportOptions
from srt.recording.importer_registry import import_file
from srt.recording.samples import ACCEL_COLUMNS, GYRO_COLUMNS, read_samples

HEADER = ",".join(("time", *GYRO_COLUMNS, *ACCEL_COLUMNS))
arrow_csv = pytest.importorskip("pyarrow.csv")


@pytest.fixture
def by_pyarrow(monkeypatch):
    """Count of the files that pyarrow has read; it reads small ones too."""
    read, calls = arrow_csv.read_csv, []

    def counted(*args, **kwargs):
        calls.append(args)
        table = read(*args, **kwargs)
        calls.append("read")
        return table

    monkeypatch.setattr(text_tables, "_PYARROW_BYTES", 0)
    monkeypatch.setattr(arrow_csv, "read_csv", counted)
    return calls


def by_numpy(path, read=None):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "pyarrow", None)
        return (read or outcome)(path)


def outcome(path):
    try:
        samples = read_samples(path)
    except InputError as error:
        return str(error)
    return [samples.column(name).tobytes() for name in samples.names]


def imported(path):
    """Samples of a log in ns, °/s and g, whose stamps are counted from the first as whole numbers."""
    try:
        found = import_file(path, ImportOptions(gyro_unit="deg/s", accel_unit="g", time_unit="ns"), "csv")[1]
    except InputError as error:
        return str(error)
    return [found.time.tobytes(), found.gyro.tobytes(), found.accel.tobytes(), found.notes]


def written(path, cells, header=HEADER, end="\n", mark=","):
    path.write_bytes(end.join([header, *(mark.join(row) for row in cells)]).encode() + end.encode())
    return path


def random_cells(rows, seed):
    """Numbers of any magnitude in several notations, some of them halfway between two doubles."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 1 << 63, (rows, 6), dtype=np.uint64) | (rng.integers(0, 2, (rows, 6), dtype=np.uint64) << 63)
    values = bits.view(np.float64)
    values = np.where(np.isfinite(values), values, 1.5)
    formats = ("{!r}", "{:.17g}", "{:.5e}", "{:.40e}", "{:.3f}", "{:.0f}", "{:.800e}")
    numbers = [[str(formats[(i + j) % 7]).format(float(v)) for j, v in enumerate(row)] for i, row in enumerate(values)]
    halfway = ["9007199254740993", "9007199254740993.00000000000000000001", "2.4703282292062327208e-324", "1e-400"]
    numbers[0][:4] = halfway
    return [[f"{0.01 * (i + 1):.2f}", *row] for i, row in enumerate(numbers)]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_both_readers_give_the_same_bits(tmp_path, by_pyarrow, end):
    path = written(tmp_path / "a.csv", random_cells(3000, 1), end=end)
    assert outcome(path) == by_numpy(path)
    assert "read" in by_pyarrow


ROWS = [[f"{0.01 * (i + 1):.2f}", "1", "2.5", "-3", "0", "1e-3", "-9.8"] for i in range(50)]


def spoiled(row, column, text):
    return [[text if (i, j) == (row, column) else cell for j, cell in enumerate(cells)] for i, cells in enumerate(ROWS)]


SPOILED = [
    *(
        spoiled(7, 3, text)
        for text in (
            "nan", "NaN", "inf", "-Infinity", "", " 1", "1 ", "+1", "1.", ".5", "1_000", "0x10", "1e400", "1d5",
            "NULL", "NA", '"1.5"', '"1,5"', "1#", "#", "1;2", "é", "nan(1)", "1e", "--1", "true", "1\t",
        )
    ),
    [*ROWS[:9], ["# a comment, with commas"], *ROWS[9:]],
    [*ROWS[:9], [""], *ROWS[9:]],
    [*ROWS[:9], ["   "], *ROWS[9:]],
    [*ROWS[:9], ROWS[9][:-1], *ROWS[10:]],
    [*ROWS[:9], [*ROWS[9], "5"], *ROWS[10:]],
    [*ROWS[:9], ["#1", *ROWS[9][1:]], *ROWS[10:]],
]  # fmt: skip


@pytest.mark.parametrize("cells", SPOILED)
@pytest.mark.parametrize("others", [False, True])
@pytest.mark.usefixtures("by_pyarrow")
def test_both_readers_accept_and_refuse_alike(tmp_path, cells, others):
    header = HEADER
    if others:  # unused columns, two of one name, before and behind
        header, cells = f"note,{header},note", [["x", *row, "7"] if len(row) > 1 else row for row in cells]
    path = written(tmp_path / "a.csv", cells, header)
    assert outcome(path) == by_numpy(path)


@pytest.mark.parametrize("start", [b"\xef\xbb\xbf", b"# a log\n\n# gyro_x is east\n", b"\n\n"])
def test_both_readers_find_the_first_row(tmp_path, by_pyarrow, start):
    path = written(tmp_path / "a.csv", ROWS)
    path.write_bytes(start + path.read_bytes())
    assert outcome(path) == by_numpy(path)
    assert ("read" in by_pyarrow) == (b"#" not in start)


def stamped(cells):
    """Rows with nanoseconds since 1970 in place of seconds: whole numbers beyond the digits of a double."""
    return [[f"1700000000{k:08d}7" if len(row) > 1 else row[0], *row[1:]] for k, row in enumerate(cells)]


@pytest.mark.parametrize("cells", SPOILED)
@pytest.mark.parametrize("mark", [",", ";", "\t"])
@pytest.mark.usefixtures("by_pyarrow")
def test_both_readers_accept_and_refuse_logs_alike(tmp_path, cells, mark):
    path = written(tmp_path / "a.txt", stamped(cells), HEADER.replace(",", mark), mark=mark)
    assert imported(path) == by_numpy(path, imported)


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_whole_stamps_stay_whole_by_both_readers(tmp_path, by_pyarrow, mark):
    path = written(tmp_path / "a.txt", stamped(random_cells(300, 2)), HEADER.replace(",", mark), mark=mark)
    found = imported(path)
    assert found == by_numpy(path, imported)
    np.testing.assert_array_equal(np.frombuffer(found[0]), np.arange(300) * 10 / 1e9)
    assert "read" in by_pyarrow


def test_pyarrow_is_not_asked_for_small_files(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert isinstance(outcome(written(tmp_path / "a.csv", ROWS)), list)
