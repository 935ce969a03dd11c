"""Time stamps that are dates or durations, in tables, files and frames, and tables that end in empty rows."""

from datetime import UTC, datetime

import numpy as np
import pytest
from table_files import ACCEL, COLUMNS, GYRO, SI, SI_TIME, STAMPS, TIME, N, write_rows

import srt
from srt.exceptions import InputError
from srt.recording.import_options import ImportOptions
from srt.recording.importer_registry import import_file

STEPS = (STAMPS - STAMPS[0]) / 1e9
HEADER = ",".join(COLUMNS)
ROWS = [",".join(map(repr, row)) for row in np.column_stack([GYRO, ACCEL]).tolist()]


def dates(zone="", mark="T", point="."):
    """The stamps with all nine digits of their fraction."""
    moments = [datetime.fromtimestamp(stamp // 10**9, tz=UTC) for stamp in STAMPS.tolist()]
    return [
        f"{moment:%Y-%m-%d}{mark}{moment:%H:%M:%S}{point}{stamp % 10**9:09d}{zone}"
        for moment, stamp in zip(moments, STAMPS.tolist(), strict=True)
    ]


def write_dated(path, cells, separator=","):
    rows = [f"{cell},{row}".replace(",", separator) for cell, row in zip(cells, ROWS, strict=True)]
    path.write_text("\n".join([HEADER.replace(",", separator), *rows, ""]))


@pytest.mark.parametrize("style", [{}, {"zone": "Z"}, {"mark": " "}, {"zone": "+00:00"}, {"zone": "z", "mark": "t"}])
def test_dates_of_a_table_keep_every_nanosecond(tmp_path, style):
    write_dated(tmp_path / "a.csv", dates(**style))
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(**SI))
    np.testing.assert_array_equal(imported.time, STEPS)
    np.testing.assert_array_equal(imported.accel, ACCEL)
    assert any(f"{STAMPS[0]} ns (2014-06-24" in note for note in imported.notes)


def test_dates_with_short_fractions_and_time_zones(tmp_path):
    """Clocks put back in autumn: the zone tells the hours apart."""
    cells = [f"20241027T02595{k}.5+0200" for k in range(10)] + [f"2024-10-27T02:00:{k:02d}.5+01:00" for k in range(30)]
    write_dated(tmp_path / "a.csv", cells)
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(**SI, sample_rate_hz=1.0))
    np.testing.assert_array_equal(imported.time, np.arange(N))


def test_dates_with_a_decimal_comma(tmp_path):
    text = [row.replace(".", ",") for row in (row.replace(",", ";") for row in ROWS)]
    rows = [f"{cell};{row}" for cell, row in zip(dates(point=","), text, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join([HEADER.replace(",", ";"), *rows, ";;;;;;", ""]))
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(**SI))
    np.testing.assert_array_equal(imported.time, STEPS)
    np.testing.assert_array_equal(imported.gyro, GYRO)


@pytest.mark.parametrize(
    ("cells", "options", "sentence"),
    [
        ([*dates()[:-1], "2014-06-31T00:00:00"], {}, r"line 41, column 1 \(time\): '2014-06-31T00:00:00' was found, bu"
         "t a date by ISO 8601 is expected"),
        ([*dates()[:-1], "12.5"], {}, "line 41, .* '12.5' was found, but a date by ISO 8601 is expected"),
        (dates(), {"time_unit": "s"}, "--time-unit is given, but the time stamps are dates or durations: leave it out"),
        (["12:30 h", *dates()[1:]], {}, "line 2, .* '12:30 h' was found, but a number is expected"),
    ],
)  # fmt: skip
def test_dates_that_are_wrong(tmp_path, cells, options, sentence):
    write_dated(tmp_path / "a.csv", cells)
    with pytest.raises(InputError, match=sentence):
        import_file(tmp_path / "a.csv", ImportOptions(**SI, **options))


@pytest.mark.parametrize("end", [",,,,,,\n", " , , , , , , \r\n\n", '"","","","","","",""\n', ",,,,,,"])
@pytest.mark.parametrize("count", [1, 20_000])
def test_empty_rows_at_the_end(tmp_path, end, count):
    """20 000 are more than the part of the file that is searched first."""
    write_rows(tmp_path / "a.csv", HEADER, COLUMNS.values())
    with (tmp_path / "a.csv").open("a", newline="") as file:
        file.write(end if count == 1 else f"{end.rstrip()}\n" * (count - 1) + end)
    _, imported = import_file(tmp_path / "a.csv", ImportOptions(**SI_TIME))
    np.testing.assert_array_equal(imported.time, TIME)
    np.testing.assert_array_equal(imported.accel, ACCEL)


def test_an_empty_row_between_samples_is_named(tmp_path):
    write_rows(tmp_path / "a.csv", HEADER, COLUMNS.values())
    lines = (tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "a.csv").write_text("\n".join([*lines[:5], ",,,,,,", *lines[5:], ",,,,,,", ""]))
    with pytest.raises(InputError, match=r"line 6, column 1 \(time\): an empty cell was found"):
        import_file(tmp_path / "a.csv", ImportOptions(**SI_TIME))
    # A cut-off line before empty rows is one, too.
    (tmp_path / "a.csv").write_text("\n".join([*lines[:-1], "1,2", ",,,,,,", ""]))
    with pytest.raises(InputError, match="line 41: 2 cells were found"):
        import_file(tmp_path / "a.csv", ImportOptions(**SI_TIME))


# Frames and arrays.

FORCE = np.abs(ACCEL) + 5.0


def frame(**index):
    pd = pytest.importorskip("pandas")
    named = {f"gyro_{a}": GYRO[:, i] for i, a in enumerate("xyz")} | {
        f"accel_{a}": FORCE[:, i] for i, a in enumerate("xyz")
    }
    return pd.DataFrame(named, **index)


def stamped(kind):
    pd = pytest.importorskip("pandas")
    seconds = pd.to_timedelta(STAMPS - STAMPS[0], unit="ns")
    return {
        "dates": lambda: pd.DatetimeIndex(STAMPS.astype("M8[ns]")),
        "dates of a zone": lambda: pd.DatetimeIndex(STAMPS.astype("M8[ns]"), tz="UTC").tz_convert("Europe/Rome"),
        "durations": lambda: seconds,
        "seconds": lambda: pd.Index(STEPS, name="time"),
    }[kind]()


KINDS = ["dates", "dates of a zone", "durations", "seconds"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("place", ["index", "column"])
def test_a_frame_with_its_time(kind, place):
    table = frame(index=stamped(kind)) if place == "index" else frame().assign(time=stamped(kind))
    recording = srt.read(table, gravity_m_s2=9.8)
    np.testing.assert_array_equal(recording.time, STEPS)
    np.testing.assert_array_equal(recording.accel, FORCE)


@pytest.mark.parametrize("kind", KINDS[:3])
@pytest.mark.parametrize("name", [None, "time", "stamp"])
def test_a_frame_with_its_time_written_to_parquet(tmp_path, kind, name):
    pytest.importorskip("pyarrow")
    frame(index=stamped(kind).rename(name)).to_parquet(tmp_path / "a.parquet")
    _, imported = import_file(tmp_path / "a.parquet", ImportOptions(**SI))
    np.testing.assert_array_equal(imported.time, STEPS)


def test_stamps_of_a_frame_that_are_no_time(tmp_path):
    pd = pytest.importorskip("pandas")
    for index in (pd.RangeIndex(N), pd.Index(STEPS), pd.Index(STEPS, name="value")):
        with pytest.raises(InputError, match="There are no time stamps"):
            srt.read(frame(index=index), gravity_m_s2=9.8)
    table = frame().assign(time=TIME).set_index(stamped("dates"))
    np.testing.assert_array_equal(srt.read(table, gravity_m_s2=9.8).time, TIME)  # a column goes before the index
    absent = STAMPS.astype("M8[ns]")
    absent[3] = "NaT"
    for stamps, options, sentence in (
        (absent, {}, r"Time stamp 4 of 40 is empty \(NaT\)"),
        (STAMPS.astype("M8[ns]"), {"time_unit": "ms"}, "time_unit= is given, but the time stamps are dates"),
    ):
        with pytest.raises(InputError, match=sentence):
            srt.read({"time": stamps, "gyro": GYRO, "accel": FORCE}, gravity_m_s2=9.8, **options)


def test_all_wrong_names_of_a_frame_are_named_at_once():
    table = frame().rename(columns={"gyro_x": "wx", "accel_y": "ay"})
    with pytest.raises(InputError, match=r"there is no gyro and no accel and no channel is called .*'ay' .*'wx'"):
        srt.read(table, gravity_m_s2=9.8)
