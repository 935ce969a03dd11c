"""Streams: corrected lines and packets are those of the arrays, and no damage to one ends the stream."""

import io
import json
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from stream_cases import CALIBRATION, RNG, TIME, TRUE, N, Y, corrector

import srt
from srt.cli.stream import parse_address
from srt.stacks.text_lines import LineCorrector

HEADER = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"


@pytest.fixture
def told():
    return []


def csv(values=Y, stamps=TIME):
    return [",".join(map(repr, (t, *row))) for t, row in zip(stamps.tolist(), values.tolist(), strict=True)]


def numbers(lines):
    return np.array([[float(cell) for cell in line.split(",")] for line in lines])


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
    lines = LineCorrector(corrector(told, gyro_unit=(float(np.radians(1.0)),) * 3, dt=dt))
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
    assert told[0].startswith("line 5 is no sample")
    assert len(told) == 1


@pytest.mark.parametrize(
    "line",
    [
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


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        return link.getsockname()[1]


class Link:
    """The command between two sockets."""

    def __init__(self, folder, *options):
        CALIBRATION.save(folder / "unit.json")
        self.inside = free_port()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(30.0)
        addresses = "--from", f"udp:127.0.0.1:{self.inside}", "--to", f"udp:127.0.0.1:{self.socket.getsockname()[1]}"
        command = [sys.executable, "-m", "srt.cli", "apply", str(folder / "unit.json"), *addresses, *options]
        self.child = subprocess.Popen([*command, "--timeout-s", "1.5"], stderr=subprocess.PIPE, text=True)

    def send(self, packet):
        self.socket.sendto(packet, ("127.0.0.1", self.inside))

    def wait(self, packet):
        """Send until the command answers: it takes a second to start."""
        self.socket.settimeout(0.2)
        for _ in range(150):
            self.send(packet)
            try:
                answer = self.socket.recv(65536)
            except OSError:
                continue
            time.sleep(0.3)
            self.socket.setblocking(False)
            try:
                while True:
                    self.socket.recv(65536)
            except BlockingIOError:
                self.socket.settimeout(30.0)
                return answer
        raise AssertionError("no answer")

    def end(self):
        with self.child.stderr as stream:
            errors = stream.read()
        assert self.child.wait() == 0
        self.socket.close()
        return errors


def test_lines_through_udp(tmp_path):
    link = Link(tmp_path)
    link.wait(b"0,0,0,0,0,0,9.8\n")
    link.send(("\n".join(csv()[:3]) + "\n").encode())
    found = numbers(link.socket.recv(65536).decode().splitlines())
    np.testing.assert_array_equal(found[:, 1:], TRUE[:3])
    link.send(b"garbage\n\n")
    assert link.socket.recv(65536) == b"\n\n"
    link.send(csv()[3].encode())
    np.testing.assert_array_equal(numbers([link.socket.recv(65536).decode()])[0, 1:], TRUE[3])
    assert "1 malformed" in link.end()


def readings(message):
    """Rates and specific forces of a HIGHRES_IMU message."""
    return np.array([message.xgyro, message.ygyro, message.zgyro, message.xacc, message.yacc, message.zacc])


def assert_corrected(found, gyro, accel):
    """Compare with the calibration; fields are floats of 32 bits: half a unit in the last place, and rounding."""
    np.testing.assert_allclose(found, np.hstack(CALIBRATION.apply(gyro, accel)), rtol=2.0**-24 + 1e-13)


def test_mavlink_through_udp(tmp_path):
    common = pytest.importorskip("pymavlink.dialects.v20.common")
    sender = common.MAVLink(None, srcSystem=7, srcComponent=3)
    reader = common.MAVLink(None)
    link = Link(tmp_path, "--gyro-lsb", "1/131 deg/s", "--gyro-offset", "12", "--accel-lsb", "1/4096 g")

    def packed(message):
        data = bytes(message.pack(sender))
        sender.seq = (sender.seq + 1) % 256
        return data

    def highres(y):
        return common.MAVLink_highres_imu_message(
            123456, *y[3:], *y[:3], 0.1, 0.2, 0.3, 1000.0, 1.0, 2.0, 25.0, 0x103F, 2
        )

    def answer():
        (message,) = reader.parse_buffer(link.socket.recv(65536))
        return message, readings(message)

    link.wait(packed(highres(Y[0])))
    sender.seq = 100
    link.send(packed(highres(Y[1])))
    message, values = answer()
    y32 = Y[1].astype(np.float32).astype(float)
    assert_corrected(values, y32[:3], y32[3:])
    assert (message.get_srcSystem(), message.get_srcComponent(), message.id, message.time_usec) == (7, 3, 2, 123456)
    assert message.xmag == pytest.approx(0.1, rel=1e-6)

    counts = np.array([100, -2000, 3, 4096, -17, 31])
    scaled = common.MAVLink_scaled_imu_message(500, *counts[3:].tolist(), *counts[:3].tolist(), 0, 0, 0, 4000)
    link.send(packed(scaled))
    message, values = answer()
    assert_corrected(values, counts[:3] * 1e-3, counts[3:] * 9.80665e-3)
    assert (message.get_type(), message.time_usec, message.temperature) == ("HIGHRES_IMU", 500_000, 40.0)

    raw = common.MAVLink_raw_imu_message(600, *counts[3:].tolist(), *counts[:3].tolist(), 0, 0, 0)
    link.send(packed(raw))
    message, values = answer()
    assert_corrected(values, (counts[:3] - 12) * np.radians(1.0 / 131.0), counts[3:] * 9.80665 / 4096.0)

    beat = common.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    link.send(packed(beat))
    assert reader.parse_buffer(link.socket.recv(65536))[0].get_type() == "HEARTBEAT"
    damaged = bytearray(packed(highres(Y[2])))
    damaged[20] ^= 0xFF
    link.send(bytes(damaged))
    link.send(packed(highres(Y[2]))[:30])
    link.send(packed(highres(np.r_[np.nan, Y[2, 1:]])))
    sender.seq = (sender.seq + 5) % 256
    link.send(packed(highres(Y[3])))
    _, values = answer()
    y32 = Y[3].astype(np.float32).astype(float)
    assert_corrected(values, y32[:3], y32[3:])
    errors = link.end()
    assert "3 malformed" in errors
    # Two packets were damaged beyond their numbers, and five numbers skipped; the one of NaN was whole.
    assert re_count(errors, "lost") >= 7
    assert "40.0 °C" in errors


def re_count(text, kind):
    return int(text.rsplit(f" {kind}", 1)[0].rsplit(" ", 1)[1])


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
    rest = scale * np.tile([0.01, 0.02, -0.03, 0.3, -0.2, 9.8], (n, 1))
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


@pytest.mark.parametrize(("extra", "said"), [([], True), (["--force"], False), (["--accel-unit", "g"], False)])
def test_the_command_tells_of_accelerometers_in_g(tmp_path, monkeypatch, extra, said, shell):
    CALIBRATION.save(tmp_path / "unit.json")
    monkeypatch.setattr(sys, "stdin", io.StringIO("0.01,1,2,3,0,0,1\n0.02,1,2,3,0,0,1\n"))
    errors = shell("apply", tmp_path / "unit.json", "-", *extra).err
    assert ("but about 9.807 is expected: " in errors) == said
    assert ("2 of implausible size" in errors) == said
