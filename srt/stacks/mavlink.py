"""Samples as MAVLink messages: HIGHRES_IMU, SCALED_IMU and RAW_IMU in, HIGHRES_IMU out, others as they came.

RAW_IMU and SCALED_IMU hold integers of 16 bits, of mrad/s and mg in SCALED_IMU and of the sensor's own unit in RAW_IMU,
which cannot hold a correction; what is sent on is a HIGHRES_IMU of the same sender and time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from srt.constants import STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError, MissingExtraError
from srt.stacks.stream_correction import LOST, MALFORMED, PASSED_ON, Counts

if TYPE_CHECKING:
    from srt.stacks.stream_correction import StreamCorrector

MARKS: Final = (0xFD, 0xFE)
"""First bytes of packets of MAVLink 2 and 1."""

_GYRO: Final = ("xgyro", "ygyro", "zgyro")
_ACCEL: Final = ("xacc", "yacc", "zacc")
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
_INSTANCE: Final = {"SCALED_IMU2": 1, "SCALED_IMU3": 2}
_UPDATED: Final = 0b111111
"""Bits of fields_updated for the six readings."""
_TEMPERATURE_UPDATED: Final = 1 << 12


class MavlinkCorrector:
    """Correct packets of one link.

    Parameters
    ----------
    corrector : StreamCorrector
        In SI units.
    raw : Counts, optional
        Counts of RAW_IMU, in SI units; without them RAW_IMU is malformed.

    Raises
    ------
    MissingExtraError
        Without pymavlink.
    """

    __slots__ = ("_corrector", "_counts", "_dialect", "_link", "_sequence")

    def __init__(self, corrector: StreamCorrector, raw: Counts | None = None) -> None:
        try:
            from pymavlink.dialects.v20 import common
        except ModuleNotFoundError:
            raise MissingExtraError("pymavlink", "formats", "A MAVLink stream") from None
        self._dialect: Any = common
        self._link: Any = self._decoder()
        self._corrector = corrector
        self._counts = dict(_SAMPLES) if raw is None else {**_SAMPLES, "RAW_IMU": raw}
        self._sequence: dict[tuple[int, int], int] = {}

    def correct(self, packet: bytes) -> bytes:
        """Correct the messages of a packet.

        Parameters
        ----------
        packet : bytes
            Datagram, with any number of messages.

        Returns
        -------
        bytes
            Messages to send on; empty if none is whole.
        """
        messages = self._link.parse_buffer(bytearray(packet)) or []
        # A datagram does not end in the middle of a message: what is left of one would spoil the next.
        if self._link.buf_len() > 0:
            self._corrector.event(MALFORMED, "a packet ends within a message")
            self._link = self._decoder()
        return b"".join(self._message(message) for message in messages)

    def _decoder(self) -> Any:
        link = self._dialect.MAVLink(None)
        link.robust_parsing = True
        return link

    def _message(self, message: Any) -> bytes:
        name = message.get_type()
        if name == "BAD_DATA":
            self._corrector.event(MALFORMED, "a packet is no MAVLink message, or its checksum is wrong")
            return b""
        self._count_lost(message)
        if name == "RAW_IMU" and name not in self._counts:
            self._corrector.event(
                MALFORMED, "RAW_IMU states no unit: give --gyro-lsb and --accel-lsb, or send HIGHRES_IMU or SCALED_IMU"
            )
            return b""
        if name not in self._counts:
            self._corrector.event(PASSED_ON, f"the message {name} holds no IMU")
            return bytes(message.get_msgbuf())
        return self._sample(message, name)

    def _sample(self, message: Any, name: str) -> bytes:
        values = self._counts[name].readings(getattr(message, field) for field in (*_GYRO, *_ACCEL))
        highres = name == "HIGHRES_IMU"
        temperature = self._temperature(message, highres=highres)
        try:
            corrected = self._corrector.correct(values, temperature)
        except InputError as error:
            self._corrector.event(MALFORMED, f"{name}: {str(error).rstrip('.')}")
            return b""
        out = message if highres else self._empty(message, name, temperature)
        for field, value in zip((*_GYRO, *_ACCEL), corrected, strict=False):
            setattr(out, field, value)
        # The sender stays that of the message.
        header = message.get_header()
        self._link.srcSystem, self._link.srcComponent, self._link.seq = (
            header.srcSystem,
            header.srcComponent,
            header.seq,
        )
        return bytes(out.pack(self._link))

    def _temperature(self, message: Any, *, highres: bool) -> float | None:
        if highres:
            return float(message.temperature) if message.fields_updated & _TEMPERATURE_UPDATED else None
        # 0 stands for an unknown one; 0.00 °C is sent as 0.01 °C.
        hundredths = getattr(message, "temperature", 0)
        return 0.01 * hundredths if hundredths else None

    def _empty(self, message: Any, name: str, temperature: float | None) -> Any:
        """HIGHRES_IMU without magnetometer and pressure."""
        stamp = message.time_usec if hasattr(message, "time_usec") else 1000 * message.time_boot_ms
        updated = _UPDATED | (0 if temperature is None else _TEMPERATURE_UPDATED)
        instance = getattr(message, "id", _INSTANCE.get(name, 0))
        readings = [0.0] * 12
        return self._dialect.MAVLink_highres_imu_message(stamp, *readings, temperature or 0.0, updated, instance)

    def _count_lost(self, message: Any) -> None:
        """Count the messages of a sender that its sequence numbers leave out."""
        header = message.get_header()
        sender = header.srcSystem, header.srcComponent
        before = self._sequence.get(sender)
        self._sequence[sender] = header.seq
        missing = 0 if before is None else (header.seq - before - 1) % 256
        # One number back is a repeated or late packet, not 255 lost ones.
        if 0 < missing < 128:
            self._corrector.event(LOST, f"{missing} messages of system {sender[0]} are missing", missing)
