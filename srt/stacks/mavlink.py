"""Samples as MAVLink messages: HIGHRES_IMU, SCALED_IMU and RAW_IMU in, HIGHRES_IMU out, others as they came.

RAW_IMU and SCALED_IMU hold integers of 16 bits, of mrad/s and mg in SCALED_IMU and of the sensor's own unit in RAW_IMU,
which cannot hold a correction; what is sent on is a HIGHRES_IMU of the same sender, time, IMU and version of MAVLink.
A signature covers the readings and needs the key of the link: corrected messages are not signed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from srt.constants import STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError, optional
from srt.stacks.stream_correction import LOST, MALFORMED, PASSED_ON, UNSIGNED, Counts

if TYPE_CHECKING:
    from srt.stacks.stream_correction import StreamCorrector

MARKS: Final = (0xFD, 0xFE)
"""First bytes of packets of MAVLink 2 and 1."""
_SENDER: Final = {0xFD: 4, 0xFE: 2}
"""Byte of the sequence number by first byte; the numbers of system and component follow."""
_SIGNED: Final = 0x01
"""Bit of the third byte of a packet of MAVLink 2."""

_GYRO: Final = ("xgyro", "ygyro", "zgyro")
_ACCEL: Final = ("xacc", "yacc", "zacc")
_FIELD: Final = ("xmag", "ymag", "zmag")
_MILLI_G: Final = 1e-3 * STANDARD_GRAVITY_M_S2
_ZERO: Final = (0.0,) * 6
_SCALED: Final = Counts((*(1e-3,) * 3, *(_MILLI_G,) * 3), _ZERO)
_SAMPLES: Final = {
    "HIGHRES_IMU": Counts((1.0,) * 6, _ZERO),
    "SCALED_IMU": _SCALED,
    "SCALED_IMU2": _SCALED,
    "SCALED_IMU3": _SCALED,
}
"""SI units per unit of the messages."""
_INSTANCE: Final = {"SCALED_IMU": 0, "SCALED_IMU2": 1, "SCALED_IMU3": 2}
"""Number of the IMU, from 0, by messages without a field for it."""
_UPDATED: Final = 0b111111
"""Bits of fields_updated for the six readings."""
_MAGNETOMETER_UPDATED: Final = 0b111 << 6
_TEMPERATURE_UPDATED: Final = 1 << 12


class MavlinkCorrector:
    """Correct packets of one link.

    Parameters
    ----------
    corrector : StreamCorrector
        In SI units.
    raw : Counts, optional
        Counts of RAW_IMU, in SI units; without them RAW_IMU is malformed.

    Raises MissingExtraError without pymavlink.
    """

    __slots__ = ("_corrector", "_counts", "_dialect", "_link", "_sequence")

    def __init__(self, corrector: StreamCorrector, raw: Counts | None = None) -> None:
        with optional("pymavlink", "formats", "A MAVLink stream"):
            from pymavlink.dialects.v20 import common
        self._dialect: Any = common
        self._link: Any = self._decoder()
        self._corrector = corrector
        self._counts = dict(_SAMPLES) if raw is None else {**_SAMPLES, "RAW_IMU": raw}
        self._sequence: dict[tuple[int, int], int] = {}

    def correct(self, packet: bytes) -> list[bytes]:
        """Correct the messages of a packet.

        Parameters
        ----------
        packet : bytes
            Datagram, with any number of messages.

        Returns
        -------
        list of bytes
            Messages to send on; empty if none is whole.
        """
        messages = self._link.parse_buffer(bytearray(packet)) or []
        # A datagram does not end in the middle of a message: what is left of one would spoil the next.
        if self._link.buf_len() > 0:
            self._corrector.event(MALFORMED, "a packet ends within a message")
            self._link = self._decoder()
        return [answer for answer in map(self._message, messages) if answer]

    def _decoder(self) -> Any:
        link = self._dialect.MAVLink(None)
        link.robust_parsing = True
        return link

    def _message(self, message: Any) -> bytes:
        name = message.get_type()
        if name == "BAD_DATA":
            self._corrector.event(MALFORMED, "a packet is no MAVLink message, or its checksum is wrong")
            return b""
        packet = bytes(message.get_msgbuf())
        self._count_lost(*_sender(packet))
        if name == "RAW_IMU" and name not in self._counts:
            self._corrector.event(
                MALFORMED, "RAW_IMU states no unit: give --gyro-lsb and --accel-lsb, or send HIGHRES_IMU or SCALED_IMU"
            )
            return b""
        if name not in self._counts:
            self._corrector.event(PASSED_ON, f"the message {name} holds no IMU")
            return packet
        return self._sample(message, name, packet)

    def _sample(self, message: Any, name: str, packet: bytes) -> bytes:
        # Where a message has no field "id", pymavlink's attribute of this name is the number of the message.
        instance = _INSTANCE.get(name, message.id)
        version_1 = packet[0] == MARKS[1]
        if version_1 and instance:
            self._corrector.event(
                MALFORMED,
                f"{name} is not of the first IMU, which HIGHRES_IMU of MAVLink 1 cannot state: send MAVLink 2",
            )
            return b""
        values = self._counts[name].readings(getattr(message, field) for field in (*_GYRO, *_ACCEL))
        highres = name == "HIGHRES_IMU"
        temperature = self._temperature(message, highres=highres)
        try:
            corrected = self._corrector.correct(values, temperature)
        except InputError as error:
            self._corrector.event(MALFORMED, f"{name}: {str(error).rstrip('.')}")
            return b""
        if not version_1 and packet[2] & _SIGNED:
            self._corrector.event(
                UNSIGNED,
                "a signed message was corrected and is sent without a signature, as the key of the link is not known "
                "here: let the receiver accept unsigned HIGHRES_IMU, or sign after the correction",
            )
        kind = self._highres_imu(version_1=version_1)
        known = message.to_dict() if highres else _others(message, temperature)
        known |= dict(zip((*_GYRO, *_ACCEL), corrected, strict=False)) | {"id": instance}
        out = kind(*(known.get(field, 0.0) for field in kind.fieldnames))
        # The sender stays that of the message.
        self._link.seq, self._link.srcSystem, self._link.srcComponent = _sender(packet)
        return bytes(out.pack(self._link))

    def _temperature(self, message: Any, *, highres: bool) -> float | None:
        if highres:
            return float(message.temperature) if message.fields_updated & _TEMPERATURE_UPDATED else None
        # 0 stands for an unknown one; 0.00 °C is sent as 0.01 °C.
        hundredths = getattr(message, "temperature", 0)
        return 0.01 * hundredths if hundredths else None

    def _highres_imu(self, *, version_1: bool) -> Any:
        """Class of the message; that of MAVLink 1 has no number of the IMU, and is loaded with the first packet."""
        if not version_1:
            return self._dialect.MAVLink_highres_imu_message
        from pymavlink.dialects.v10 import common

        return common.MAVLink_highres_imu_message

    def _count_lost(self, number: int, system: int, component: int) -> None:
        """Count the messages of a sender that its sequence numbers leave out."""
        before = self._sequence.get((system, component))
        self._sequence[system, component] = number
        missing = 0 if before is None else (number - before - 1) % 256
        # One number back is a repeated or late packet, not 255 lost ones.
        if 0 < missing < 128:
            self._corrector.event(LOST, f"{missing} messages of system {system} are missing", missing)


def _others(message: Any, temperature: float | None) -> dict[str, Any]:
    """Fields of HIGHRES_IMU, beside the readings, that SCALED_IMU and RAW_IMU state.

    The magnetometer of SCALED_IMU is in mgauss, that of HIGHRES_IMU in gauss; RAW_IMU states no unit for it. No
    field at all stands for no magnetometer.
    """
    microseconds = message.time_usec if hasattr(message, "time_usec") else 1000 * message.time_boot_ms
    field = {} if message.get_type() == "RAW_IMU" else {name: 1e-3 * getattr(message, name) for name in _FIELD}
    updated = _UPDATED | (0 if temperature is None else _TEMPERATURE_UPDATED)
    updated |= _MAGNETOMETER_UPDATED if any(field.values()) else 0
    return {**field, "time_usec": microseconds, "temperature": temperature or 0.0, "fields_updated": updated}


def _sender(packet: bytes) -> tuple[int, int, int]:
    """Sequence number, system and component of a packet; pymavlink leaves them out where it does not know a message."""
    at = _SENDER[packet[0]]
    return packet[at], packet[at + 1], packet[at + 2]
