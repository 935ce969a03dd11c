"""Streams: corrected lines and packets are those of the arrays, and no damage to one ends the stream."""

import io
import json
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from stream_cases import CALIBRATION, RNG, TIME, TRUE, N, Y, corrector, csv, numbers

import srt
from srt.cli.stream import parse_address
from srt.stacks.stream_correction import Counts
from srt.stacks.text_lines import LineCorrector, bounded_lines

HEADER = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"


@pytest.fixture
def told():
    return []


def test_lines_are_corrected_as_arrays_are(told):
    lines = LineCorrector(corrector(told))
    found = numbers([lines.correct(line) for line in csv()])
    # Numbers in full, and one sample corrected by the same operations as many: the same bits.
    np.testing.assert_array_equal(found, np.column_stack([TIME, TRUE]))
    assert told == []


def test_columns_by_name_and_other_columns(told):
    lines = LineCorrector(corrector(told))
    assert lines.correct("frame,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z,note\n").startswith("frame,acc_x")
    row = lines.correct(",".join(["7", *map(repr, Y[0, 3:].tolist()), *map(repr, Y[0, :3].tolist()), "bump"])).split(
        ","
    )
    assert (row[0], row[-1]) == ("7", "bump")
    np.testing.assert_array_equal(np.array(row[1:7], dtype=float), np.r_[TRUE[0, 3:], TRUE[0, :3]])


def test_json_lines_and_covariance(told):
    lines = LineCorrector(corrector(told, covariance=True), covariance=True)
    found = json.loads(
        lines.correct(json.dumps({"time": 1.0, "gyro": Y[0, :3].tolist(), "accel": Y[0, 3:].tolist(), "id": 3}))
    )
    np.testing.assert_array_equal([*found["gyro"], *found["accel"]], TRUE[0])
    expected = np.sqrt(np.diag(srt.Applier(CALIBRATION).sample_covariance(Y[0, :3], Y[0, 3:])))
    np.testing.assert_array_equal(found["sigma"], expected)
    assert found["id"] == 3
    named = dict(zip(HEADER.split(",")[1:], Y[1].tolist(), strict=True))
    np.testing.assert_array_equal([json.loads(lines.correct(json.dumps(named)))[key] for key in named], TRUE[1])


def test_units_and_increments(told):
    dt = 0.01
    lines = LineCorrector(corrector(told, dt=dt), units={"gyro": "deg"})
    y = np.column_stack([np.degrees(Y[:, :3]) * dt, Y[:, 3:] * dt])
    found = numbers([lines.correct(line) for line in csv(y)])[:, 1:]
    # Conversion there and back: four roundings of values below 0.5.
    np.testing.assert_allclose(found[:, :3], np.degrees(TRUE[:, :3]) * dt, rtol=0, atol=4e-14)
    np.testing.assert_allclose(found[:, 3:], TRUE[:, 3:] * dt, rtol=0, atol=1e-15)


def test_damage_is_counted_and_the_stream_goes_on(told):
    lines = LineCorrector(corrector(told))
    good = csv()
    bad = [
        "",
        "1,2,3",
        "0.5,nan,0,0,0,0,9.8",
        "1,a,0,0,0,0,9",
        '{"gyro": [1, 2]}',
        '{"gyro"',
        "\x00",
        "9" * 5000,
        "{" * 50,
    ]
    found = [lines.correct(line) for line in [*good[:3], *bad, *good[3:]]]
    assert [line for line in found if not line] == [""] * len(bad)
    corrected = [line for line in found if line]
    np.testing.assert_array_equal(numbers(corrected), np.column_stack([TIME, TRUE]))
    counts = lines._corrector.counts
    assert counts["malformed"] == len(bad) - 1  # an empty line is none
    assert counts["corrected"] == N
    # Each cause is told once: lines 7, 10 and 12 are like lines 6, 5 and 9.
    assert [sentence.partition(" is no")[0] for sentence in told] == [f"line {n}" for n in (5, 6, 8, 9, 11)]


def test_each_cause_is_told_at_its_first_line_and_then_by_its_count(told):
    lines = LineCorrector(corrector(told))
    huge = f'{{"gyro": [1{"0" * 400}, 0, 0], "accel": [0, 0, 9]}}'
    bad = ["1,2,3", "1,2,3,4", "0.5,nan,0,0,0,0,9.8", "1,a,0,0,0,0,9", '{"gyro": [0, 0, 0], "t": 1}', '{"gyro_x": 1}',
           '{"gyro": [1, 2], "accel": 3}', '{"gyro"', huge]  # fmt: skip
    for line in [csv()[0], *bad, *bad]:
        lines.correct(line)
    said = [sentence.partition(" is no sample (")[2].partition(")")[0] for sentence in told]
    keys = "but gyro and accel, or gyro_x to accel_z, are expected"
    assert said[:2] == [
        "it has 3 columns, and those before have 7",
        "'nan' was found, but a finite number is expected",
    ]
    assert said[2:6] == [
        f'its keys are "gyro", "t", {keys}',
        f'its keys are "gyro_x", {keys}',
        "gyro and accel are not lists of three numbers",
        "it begins as an object of JSON, and is none: it was cut off or damaged",
    ]
    assert said[6].startswith("1000")
    assert told[7].endswith("(10 samples are malformed so far)")
    assert len(told) == 8


def test_causes_without_end_do_not_fill_the_disk(told):
    lines = LineCorrector(corrector(told))
    for n in range(200):
        lines.correct(json.dumps({chr(97 + n % 26) * (n // 26 + 1): 0}))
    assert len(told) < 25


def test_units_of_the_names_are_those_of_the_lines(told):
    """As convert reads them: time in ms, deg/s and g; the answers are in the same units."""
    lines = LineCorrector(corrector(told))
    names = "time [ms],gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s],accel_x [g],accel_y [g],accel_z [g]"
    y = np.column_stack([np.degrees(Y[:, :3]), Y[:, 3:] / 9.80665])
    for _ in range(2):  # names may come again, as in each datagram
        assert lines.correct(names) == names
        found = numbers([lines.correct(line) for line in csv(y, 1e3 * TIME)])[:, 1:]
        # Conversion there and back: four roundings of values below 200.
        np.testing.assert_allclose(found[:, :3], np.degrees(TRUE[:, :3]), rtol=0, atol=1e-13)
        np.testing.assert_allclose(found[:, 3:], TRUE[:, 3:] / 9.80665, rtol=0, atol=1e-14)
    assert lines._corrector.interval_s == pytest.approx(0.01, rel=1e-9)
    assert json.loads(lines.correct('{"gyro": [0, 0, 0], "accel": [0, 0, 9.8]}'))["accel"][2] > 9.0  # SI
    assert [sentence for sentence in told if "time goes" not in sentence] == []


@pytest.mark.parametrize(
    ("names", "options", "said"),
    [
        ("gyro_x_raw,gyro_y_raw,gyro_z_raw,accel_x,accel_y,accel_z", {}, "state counts for gyro: give --gyro-lsb"),
        ("dtheta_x,dtheta_y,dtheta_z,dv_x,dv_y,dv_z", {}, "state increments: give --increments-s SECONDS"),
        ("gyro_x [rad],gyro_y [rad],gyro_z [rad],accel_x,accel_y,accel_z", {}, "does not fit samples of kind rate"),
        ("gyro_x [rpm],gyro_y [rpm],gyro_z [rpm],accel_x,accel_y,accel_z", {},
         "the name gyro_x [rpm] states rpm, which is not one of the known units rad/s, deg/s, deg/h: convert"),
        ("gyro_x_mg,gyro_y_mg,gyro_z_mg,accel_x,accel_y,accel_z", {}, "gyro_x_mg states mg, which is not one of"),
        ("gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z [foo]", {}, "accel_z [foo] states foo, which is not one of the"),
        ("gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z [g]", {}, "different units (g, none): state one unit"),
        ("gyro_x [deg/s],gyro_y,gyro_z,accel_x,accel_y,accel_z", {}, "different units (deg/s, none): state one unit"),
        ("t,rate 1,rate 2,rate 3,accel_x,accel_y,accel_z", {}, "(columns found: t, rate 1, rate 2, rate 3, accel_x"),
        ("gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s],a_x,a_y,a_z", {"counts": Counts((1.0,) * 6, (0.0,) * 6)},
         "state deg/s for gyro, but --gyro-lsb is given: leave it out"),
    ],
)  # fmt: skip
def test_lines_below_names_that_are_not_understood_are_refused(told, names, options, said):
    """Their columns may be in any order and unit; names that are understood end this."""
    lines = LineCorrector(corrector(told), **options)
    row = ",".join(["0"] * (names.count(",") + 1))
    assert [lines.correct(line) for line in (names, row, row)] == ["", "", ""]
    assert said in told[0]
    assert "accel_z, or send lines" in told[0] or "name the columns" not in told[0]  # the sentence is whole
    assert lines._corrector.counts["malformed"] == 3
    assert lines.correct(HEADER)
    assert lines.correct("0.01,0,0,0,0,0,9.8")


def test_a_given_unit_overrides_that_of_the_names(told):
    lines = LineCorrector(corrector(told), units={"gyro": "rad/s"})
    answer = lines.correct("time,gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s],accel_x,acc_y,accel_z")
    assert answer == "time,gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s],accel_x,acc_y,accel_z"
    np.testing.assert_array_equal(numbers([lines.correct(csv()[0])])[0, 1:], TRUE[0])
    assert told == ["the names state deg/s for gyro; read as rad/s, as given"]


@pytest.mark.parametrize(
    ("names", "options", "answered"),
    [
        ("wx [rpm],wy [rpm],wz [rpm]", {}, "gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s]"),
        ("gyro_x_raw,gyro_y_raw,gyro_z_raw", {"counts": Counts((1.0,) * 6, (0.0,) * 6)},
         "gyro_x [deg/s],gyro_y [deg/s],gyro_z [deg/s]"),
        ("gyro_x_dps,gyro_y_dps,gyro_z_dps", {}, "gyro_x_dps,gyro_y_dps,gyro_z_dps"),
    ],
)  # fmt: skip
def test_the_names_that_go_out_state_the_unit_of_the_answers(told, names, options, answered):
    lines = LineCorrector(corrector(told), units={"gyro": "deg/s"}, **options)
    assert lines.correct(f"{names},accel_x,accel_y,accel_z,note") == f"{answered},accel_x,accel_y,accel_z,note"


@pytest.mark.parametrize(
    ("first", "lost", "counted"),
    [
        ("0.0,0,0,0,0,9", 0, {"answered wrongly": 1, "malformed": 1}),
        ("0.0,0,0,0,0,0,9.8,24", 2, {"answered wrongly": 1, "malformed": 3}),
        ("time,gyro_x,gyro_y,gyro_z,accel_x,acc", 0, {"malformed": 2}),
    ],
)
def test_a_damaged_first_line_does_not_lose_those_that_follow(told, first, lost, counted):
    lines = LineCorrector(corrector(told))
    lines.correct(first)
    found = [lines.correct(line) for line in [*csv()[:3], "0.5,1,2,3,4,5", *csv()[3:]]]
    np.testing.assert_array_equal(numbers(line for line in found if line), np.column_stack([TIME, TRUE])[lost:])
    assert lines._corrector.counts == {"corrected": N - lost, **counted}
    assert any(sentence.startswith("line 1 ") for sentence in told)


def test_another_number_of_columns_is_believed_if_three_lines_in_succession_have_it(told):
    lines = LineCorrector(corrector(told))
    short = "0.0,0,0,0,0,9"
    found = [bool(lines.correct(line)) for line in [short, short, *csv()[:2], short, *csv()[2:6], short]]
    assert found == [True, True, False, False, True, False, False, True, True, False]
    assert "the lines have 7 columns from line 8 on, and had 6 before" in told


@pytest.mark.parametrize(
    "line",
    [
        '{"gyro": "123", "accel": [0, 0, 9]}',
        '{"gyro": [true, false, 0], "accel": [0, 0, 9]}',
        '{"gyro": [0, 0, "1"], "accel": [0, 0, 9]}',
        '{"gyro": [0, 0, 0], "accel": [0, 0, 9], "temperature": NaN}',
        '{"gyro": [0, 0, 0], "accel": [0, 0, 9], "other": NaN}',
        '{"gyro": [0, 0, 0], "accel": [0, 0, 9], "other": 1e999}',
        '{"accel": [0, 0, 9]}',
        "[0, 0, 0, 0, 0, 9.8]",
        "1_0.5,0,0,0,0,0,9.8",
        "0,0,0,0,0,1_0.5,9.8",
        "0,0,0,0,0,0,9.8,nan",
        '{"gyro": ' + "[" * 3000,
        '{"gyro": [1' + "0" * 400 + ', 0, 0], "accel": [0, 0, 9]}',
        '{"gyro": "abc", "accel": "def"}',
        '{"gyro": {"x": 1}, "accel": null}',
        '{"gyro": [1, 2, 3, 4], "accel": [1, 2]}',
        "1e999,0,0,0,0,0,9.8",
        "0,0,0,0,0,0,9.8,9,9,9",
    ],
)
def test_hostile_lines_are_malformed(told, line):
    lines = LineCorrector(corrector(told))
    assert lines.correct("0,0,0,0,0,0,9.8")
    assert lines.correct(line) == ""
    assert lines._corrector.counts["malformed"] == 1
    assert told[0].startswith("line 2 is no sample (")


def test_lost_samples_clipping_and_temperature_are_told(told):
    lines = LineCorrector(corrector(told, gyro_range=5.0, accel_range=30.0))
    kept = np.r_[0:10, 14:N]
    for line in csv(Y[kept], TIME[kept]):
        lines.correct(line)
    assert lines._corrector.counts["lost"] == 4
    assert "4 samples are missing before 0.15" in told[0]
    high = Y.copy()
    high[:, 0] = 5.0
    lines.correct(csv(high, TIME + TIME[-1])[0])
    assert "end of its range" in told[1]
    hot = LineCorrector(corrector(told))
    hot.correct(csv()[0] + ",24.9")
    assert len(told) == 2
    for line in csv()[1:13]:
        hot.correct(line + ",60.0")
    assert "60.0 °C, and the calibration holds 14.0 to 36.0 °C" in told[2]
    assert "10 samples are outside the temperature" in told[3]
    assert len(told) == 4
    assert "12 outside the temperature of the test" in hot._corrector.summary()


def test_the_command_answers_each_line(tmp_path):
    CALIBRATION.save(tmp_path / "unit.json")
    command = [sys.executable, "-m", "srt.cli", "apply", str(tmp_path / "unit.json"), "-"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1
    ) as child:
        child.stdin.write(HEADER + "\n")
        assert child.stdout.readline() == HEADER + "\n"
        for line, expected in zip(csv()[:5], TRUE, strict=False):
            child.stdin.write(line + "\n")
            # The answer comes before the next line is written.
            np.testing.assert_array_equal(numbers([child.stdout.readline()])[0, 1:], expected)
        child.stdin.flush()
        for without_sample in (b"\xff\xfe,1,2\n", b"nonsense\n", b"\n"):
            child.stdin.buffer.write(without_sample)
            child.stdin.buffer.flush()
            assert child.stdout.readline() == "\n"
        child.stdin.write("# a comment\n")
        assert child.stdout.readline() == "# a comment\n"
        child.stdin.write(csv()[5] + "\n")
        np.testing.assert_array_equal(numbers([child.stdout.readline()])[0, 1:], TRUE[5])
        child.stdin.close()
        assert "6 corrected, 2 malformed" in child.stderr.read()
        assert child.wait() == 0


def test_a_stream_without_a_sample_fails(tmp_path, monkeypatch, shell):
    CALIBRATION.save(tmp_path / "unit.json")
    for text in ("Zeit,Drehrate X,Drehrate Y,Drehrate Z,accel_x,accel_y,accel_z\n0,0,0,0,0,0,9.8\n", ""):
        monkeypatch.setattr(sys, "stdin", io.StringIO(text))
        errors = shell("apply", tmp_path / "unit.json", "-", code=1).err
        assert errors.endswith(
            "srt: No sample of the stream was corrected: send lines of CSV or JSON, or MAVLink by --from.\n"
        )


def test_a_line_without_end_does_not_fill_the_memory():
    """32 MB of digits without a line break; the line after them is corrected."""
    lines, text = LineCorrector(corrector([])), io.StringIO("9" * (32 << 20) + "\n0.01,0,0,0,0,0,9.8")
    tracemalloc.start()
    answers = [lines.correct(line) for line in bounded_lines(text)]
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    assert answers[0] == ""
    assert answers[1].startswith("0.01,")
    assert lines._corrector.counts["malformed"] == 1


def test_the_command_corrects_lines_of_counts(tmp_path, monkeypatch, shell):
    """Counts with a zero in, deg/s and m/s² out: the same as the library makes of the readings."""
    counts = np.column_stack([RNG.integers(-9000, 9000, (5, 3)), RNG.integers(-16384, 16384, (5, 3))])
    zero = np.array([12, -7, 3, 30, 30, 30])
    CALIBRATION.save(tmp_path / "unit.json")
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(",".join(map(str, row)) for row in counts.tolist())))
    gyro = ["--gyro-unit", "deg/s", "--gyro-lsb", "1/131 deg/s", "--gyro-offset", "12,-7,3"]
    accel = ["--accel-lsb", "1/16384 g", "--accel-offset", "30"]
    found = numbers(shell("apply", tmp_path / "unit.json", "-", "--force", *gyro, *accel).out.splitlines())
    unit = np.repeat([np.radians(1.0 / 131.0), 9.80665 / 16384.0], 3)
    rate, force = np.hsplit((counts - zero) * unit, 2)
    true = np.column_stack([np.degrees(CALIBRATION.apply(rate, force)[0]), CALIBRATION.apply(rate, force)[1]])
    np.testing.assert_allclose(found, true, rtol=1e-13, atol=1e-13)  # rounding of conversions there and back


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["-", "-o", "out"], "leave out RECORDING, -o"),
        (["rec", "--covariance"], "--covariance describes a stream"),
        (["--from", "udp:127.0.0.1:99999", "--to", "udp:127.0.0.1:1"], "is not udp:HOST:PORT"),
        (["--from", "udp:127.0.0.1:14550"], "add --to"),
        (["--to", "udp:127.0.0.1:14550"], "--to describes a stream"),
        (["-", "--to", "udp:127.0.0.1:14550"], "--from ADDRESS"),
        (["--from", "udp:127.0.0.1:14550", "--to", "udp:127.0.0.1:14550"], "its own datagrams"),
        (["-", "--gyro-unit", "deg"], "does not fit samples of kind rate"),
        (["-", "--gyro-lsb", "1e-6"], "give --gyro-lsb and --accel-lsb"),
        (["-", "--accel-offset", "12"], "give --gyro-lsb and --accel-lsb"),
        (["-", "--gyro-lsb", "1", "--accel-lsb", "1/4 parsec"], "--accel-lsb: the unit 'parsec'"),
        (["-", "--increments-s", "-1"], "dt of the stream is -1"),
        (["--from", "udp:127.0.0.1:14550", "--to", "udp:127.0.0.1:14551", "--gyro-lsb", "1"], "--accel-lsb"),
    ],
)
def test_wrong_usage(tmp_path, arguments, fragment, shell):
    CALIBRATION.save(tmp_path / "unit.json")
    assert fragment in shell("apply", tmp_path / "unit.json", *arguments, code=2).err


@pytest.mark.parametrize("mark", [";", "\t", " ", " | "])
def test_other_separators_are_told_as_such(told, mark):
    lines = LineCorrector(corrector(told))
    for line in (HEADER.replace(",", mark), csv()[0].replace(",", mark), csv()[0].replace(",", mark)):
        assert lines.correct(line) == ""
    reason = "its columns are separated by other marks, but commas, and points in numbers, are expected"
    assert told == [f"line 1 is no sample ({reason})"]
    assert lines.correct(csv()[0])


def test_the_command_takes_all_spellings_of_a_unit(tmp_path, monkeypatch, shell):
    CALIBRATION.save(tmp_path / "unit.json")
    answers = []
    for unit in ("dps", "deg/s"):
        monkeypatch.setattr(sys, "stdin", io.StringIO("0.01,1,2,3,0,0,9.8\n"))
        answers.append(shell("apply", tmp_path / "unit.json", "-", "--gyro-unit", unit).out)
    assert answers[0] == answers[1]


def test_addresses():
    assert parse_address("udp:127.0.0.1:14550") == ("127.0.0.1", 14550)
    assert parse_address("udp:[::1]:80") == ("::1", 80)


@pytest.mark.parametrize(
    ("scale", "options", "fragment"),
    [
        (1.0 / 9.80665, {}, "g"),
        (16384.0 / 9.80665, {}, "counts"),
        (1e5, {}, "counts"),
        (0.01, {}, "increments per sample, declared as rates"),
        (1.0, {"dt": 0.01}, "rates, declared as increments"),
        (0.01, {"dt": 0.01}, None),
        (1.0, {}, None),
        (1.5, {}, None),
    ],
)
def test_an_implausible_size_is_told_once_with_its_cause(told, scale, options, fragment):
    n = 700
    rest = np.tile([0.01, 0.02, -0.03, *(scale * np.array([0.3, -0.2, 9.8]))], (n, 1))
    lines = LineCorrector(corrector(told, gravity=9.80665, **options))
    for line in csv(rest, 0.01 * np.arange(n)):
        lines.correct(line)
    lines._corrector.summary()
    if fragment is None:
        assert told == []
    else:
        assert len(told) == 1
        assert fragment in told[0].partition("expected: ")[2]
        assert lines._corrector.counts["of implausible size"] == 500


def test_a_short_stream_is_judged_at_its_end(told):
    lines = LineCorrector(corrector(told, gravity=9.80665))
    lines.correct("0,0,0,0,0,0,1.0")
    assert "1 of implausible size" in lines._corrector.summary()
    assert "1 of implausible size" in lines._corrector.summary()
    assert len(told) == 1


def test_free_fall_for_less_than_half_of_the_samples_is_plausible(told):
    y = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 9.8], (500, 1))
    y[100:340, 5] = 0.0
    lines = LineCorrector(corrector(told, gravity=9.80665))
    for line in csv(y, 0.01 * np.arange(500)):
        lines.correct(line)
    assert told == []


def test_time_that_does_not_advance_is_told_and_losses_after_it_are_seen(told):
    lines = LineCorrector(corrector(told))
    stamps = np.array([0.01, 0.02, 0.03, 0.01, 0.02, 0.02, 0.03, 0.06])
    for line in csv(Y[:8], stamps):
        assert lines.correct(line)
    counts = lines._corrector.counts
    assert (counts["with a time that does not advance"], counts["lost"]) == (2, 2)
    assert "line 4: the time goes from 0.03 to 0.01 s" in told[0]


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        (["--gyro-lsb", "131"], "the gyros read 9.872e+05 rad/s, which no gyro measures: state their unit"),
        (["--gyro-lsb", "1/131 deg/s"], None),
        (["--gyro-lsb", "131", "--force"], None),
        (["--gyro-lsb", "131", "--increments-s", "1"], "(a number without a unit is in rad/s)"),
    ],
)
def test_the_command_tells_of_a_value_of_counts_without_its_unit(tmp_path, monkeypatch, extra, said, shell):
    CALIBRATION.save(tmp_path / "unit.json")
    monkeypatch.setattr(sys, "stdin", io.StringIO("0.01,0,0,7536,0,0,-16384\n"))
    errors = shell("apply", tmp_path / "unit.json", "-", "--accel-lsb", "1/16384 g", *extra).err
    assert ("1 faster than any gyro measures" in errors) == (said is not None)
    assert said is None or said in errors


@pytest.mark.parametrize(("extra", "said"), [([], True), (["--force"], False), (["--accel-unit", "g"], False)])
def test_the_command_tells_of_accelerometers_in_g(tmp_path, monkeypatch, extra, said, shell):
    CALIBRATION.save(tmp_path / "unit.json")
    monkeypatch.setattr(sys, "stdin", io.StringIO("0.01,1,2,3,0,0,1\n0.02,1,2,3,0,0,1\n"))
    errors = shell("apply", tmp_path / "unit.json", "-", *extra).err
    assert ("but about 9.807 is expected: " in errors) == said
    assert ("2 of implausible size" in errors) == said
