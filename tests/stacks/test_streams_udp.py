"""Streams of datagrams through the command: lines and MAVLink."""

import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from stream_cases import CALIBRATION, TRUE, Y, csv, numbers

# The unit is that of lines of text; messages define their own.
COUNTS = "--gyro-lsb=1/131 deg/s", "--gyro-offset=12", "--accel-lsb=1/4096 g", "--gyro-unit=deg/s"


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
    # A datagram of the largest size, whose answers do not fit into one.
    many = [",".join(f"{value:.6f}" for value in range(7))] * 1000
    link.send("\n".join(many).encode())
    received = b""
    while received.count(b"\n") < len(many):
        received += link.socket.recv(65536)
    assert set(received.decode().splitlines()) == {received.decode().partition("\n")[0]}
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
    link = Link(tmp_path, *COUNTS)

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
