"""MAVLink packets: what goes out for each message, version and signature, and no damage that ends a stream."""

import numpy as np
import pytest
from stream_cases import Y, corrector

from srt.stacks.mavlink import MavlinkCorrector
from srt.stacks.stream_correction import Counts

common = pytest.importorskip("pymavlink.dialects.v20.common")


@pytest.fixture
def told():
    return []


def test_random_packets_end_nothing(told):
    """Noise, damaged messages and messages of other lengths; a good one after each is corrected."""
    sender, link = common.MAVLink(None), MavlinkCorrector(corrector(told))
    rng = np.random.default_rng(9)
    good = bytes(common.MAVLink_highres_imu_message(1, *Y[0, 3:], *Y[0, :3], *[0.0] * 7, 63).pack(sender))
    answer = link.correct(good)
    for _ in range(400):
        packet = bytearray(rng.integers(0, 256, int(rng.integers(1, 300)), dtype=np.uint8).tobytes())
        if rng.random() < 0.7:
            packet = bytearray(good) if rng.random() < 0.5 else packet
            packet[0] = 0xFD if rng.random() < 0.5 else 0xFE
            at = int(rng.integers(1, len(packet))) if len(packet) > 1 else 0
            packet[at] ^= int(rng.integers(1, 256))
        link.correct(bytes(packet))
        assert link.correct(good) == answer


def corrected_packet(told, message, *, raw=None, version_1=False, key=None):
    """Answer to a message of system 7, component 3, with sequence number 9: the packet, and the message in it."""
    sender = common.MAVLink(None, srcSystem=7, srcComponent=3)
    sender.seq = 9
    if key is not None:
        sender.signing.secret_key, sender.signing.sign_outgoing = key, True
    kind, *values = message
    packed = getattr(common, f"MAVLink_{kind}_message")(*values).pack(sender, force_mavlink1=version_1)
    packet = b"".join(MavlinkCorrector(corrector(told), raw).correct(bytes(packed)))
    return packet, common.MAVLink(None).decode(bytearray(packet)) if packet else None


SIX = (1, -2, 3, 4, -5, 6)
ONE_EACH = Counts((1.0,) * 6, (0.0,) * 6)
OF_IMU = {
    "first": (("scaled_imu", 500, *SIX, 0, 0, 0, 0), 0),
    "second": (("scaled_imu2", 500, *SIX, 0, 0, 0, 0), 1),
    "third": (("scaled_imu3", 500, *SIX, 0, 0, 0, 0), 2),
    "raw first": (("raw_imu", 500_000, *SIX, 0, 0, 0, 0, 0), 0),
    "raw fourth": (("raw_imu", 500_000, *SIX, 0, 0, 0, 3, 0), 3),
    "highres first": (("highres_imu", 500_000, *map(float, SIX), *[0.0] * 7, 63, 0), 0),
    "highres third": (("highres_imu", 500_000, *map(float, SIX), *[0.0] * 7, 63, 2), 2),
}


@pytest.mark.parametrize("case", OF_IMU)
@pytest.mark.parametrize("version_1", [False, True])
def test_a_corrected_message_keeps_imu_sender_and_version(told, case, version_1):
    message, imu = OF_IMU[case]
    packet, out = corrected_packet(told, message, raw=ONE_EACH, version_1=version_1)
    if version_1 and imu:
        # The packet of MAVLink 1 has no place for the number of the IMU.
        assert packet == b""
        assert "send MAVLink 2" in told[0]
        return
    assert told == []
    assert packet[0] == (0xFE if version_1 else 0xFD)
    assert (out.get_type(), out.id, out.time_usec, out.fields_updated) == ("HIGHRES_IMU", imu, 500_000, 63)
    assert (out.get_srcSystem(), out.get_srcComponent(), out.get_seq()) == (7, 3, 9)
    if version_1:
        assert packet[1] == 62  # bytes of the message without its extension


@pytest.mark.parametrize("kind", ["scaled_imu", "scaled_imu2", "scaled_imu3"])
def test_the_magnetometer_of_scaled_messages_goes_on(told, kind):
    _, out = corrected_packet(told, (kind, 500, *SIX, 210, -20, 430, 0))
    # mgauss in, gauss out, as floats of 32 bits
    np.testing.assert_allclose([out.xmag, out.ymag, out.zmag], [0.21, -0.02, 0.43], rtol=2.0**-24)
    assert out.fields_updated == 63 | 0b111 << 6


def test_a_signed_message_goes_out_unsigned_and_this_is_told(told):
    packet, out = corrected_packet(told, OF_IMU["first"][0], key=b"k" * 32)
    assert out.get_type() == "HIGHRES_IMU"
    assert packet[2] == 0
    assert len(told) == 1
    assert "sent without a signature" in told[0]
    told.clear()
    # A message without readings of an IMU is passed unchanged, with its signature.
    packet, _ = corrected_packet(told, ("heartbeat", 2, 3, 0, 0, 4, 3), key=b"k" * 32)
    assert packet[2] == 1
    assert "sent without" not in told[0]


def test_messages_of_other_dialects_are_not_lost_ones(told):
    """Their sequence numbers count, though pymavlink does not decode them."""
    other = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    sender, link = common.MAVLink(None, srcSystem=7, srcComponent=3), MavlinkCorrector(corrector(told))
    beat = common.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    for number, message in enumerate((beat, other.MAVLink_ahrs_message(*[0.0] * 7), beat)):
        sender.seq = number
        assert link.correct(bytes(message.pack(sender)))
    assert link._corrector.counts["lost"] == 0
