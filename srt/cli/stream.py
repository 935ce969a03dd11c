"""Streams of ``srt apply``: standard input to standard output, and datagrams from one UDP address to another."""

from __future__ import annotations

import errno
import io
import socket
import sys
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click

from srt.cli.messages import output_errors, say, warn
from srt.cli.unit_type import ACCEL_UNITS, GYRO_UNITS, Unit
from srt.exceptions import DataError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from srt.result.calibration import Calibration
    from srt.stacks.stream_correction import Counts, StreamCorrector
    from srt.stacks.text_lines import LineCorrector

STANDARD: Final = "-"
_LARGEST_DATAGRAM: Final = 65536

OPTIONS: Final = (
    click.option("--from", "source", metavar="ADDRESS", help="Correct datagrams that arrive there: udp:HOST:PORT."),
    click.option("--to", "target", metavar="ADDRESS", help="Send corrected datagrams there: udp:HOST:PORT."),
    click.option("--covariance", is_flag=True, help="Stream: append the 1-sigma of each value by the calibration."),
    click.option(
        "--gyro-unit", type=Unit(GYRO_UNITS), help="Stream: unit of the gyros.  [default: by the names, or rad/s]"
    ),
    click.option("--accel-unit", type=Unit(ACCEL_UNITS), help="Stream: unit.  [default: by the names, or m/s^2]"),
    click.option("--increments-s", type=float, metavar="SECONDS", help="Stream: increments of this duration."),
    click.option("--gyro-lsb", metavar="LSB", help="Lines of counts, RAW_IMU: value of one count, as '1/131 deg/s'."),
    click.option("--accel-lsb", metavar="LSB", help="Lines of counts, RAW_IMU: value of one, as '1/16384 g'."),
    click.option("--gyro-offset", metavar="COUNTS", help="Gyro counts at zero rate; one number or three."),
    click.option("--accel-offset", metavar="COUNTS", help="Accelerometer counts at zero force, likewise."),
    click.option("--gyro-range-deg-s", type=float, help="Stream: range of the gyros; samples at its end are told."),
    click.option("--accel-range-g", type=float, help="Stream: range of the accelerometers, likewise."),
    click.option("--timeout-s", type=float, help="End after this time without datagrams.  [default: never]"),
)
"""Options of ``srt apply`` that describe a stream."""


def stream_options(command: Any) -> Any:
    """Decorate a command with the options of a stream."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command


NAMES: Final = (
    "source", "target", "covariance", "gyro_unit", "accel_unit", "increments_s", "gyro_lsb", "accel_lsb",
    "gyro_offset", "accel_offset", "gyro_range_deg_s", "accel_range_g", "timeout_s",
)  # fmt: skip
"""Names of :data:`OPTIONS` as arguments of a function."""


class Address(NamedTuple):
    """UDP address."""

    host: str
    port: int


def parse_address(text: str) -> Address:
    """Read "udp:HOST:PORT". Raises InputError."""
    kind, _, rest = text.partition(":")
    host, colon, port = rest.rpartition(":")
    if kind != "udp" or not colon or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"The address {text!r} is not udp:HOST:PORT, as udp:127.0.0.1:14550: correct it.")
    return Address(host.strip("[]"), int(port))


def run_stream(calibration: Calibration, frame: Any, given: dict[str, Any], *, check_size: bool) -> int:
    """Correct a stream until it ends; counts of lost, malformed and doubtful samples go to standard error.

    Parameters
    ----------
    frame : "mars" or "table"
    given : dict
        Values of :data:`OPTIONS` by name.
    check_size : bool
        Tell of specific forces whose median is not near gravity.

    Returns
    -------
    int
        0; lost, malformed and doubtful samples are counted and never end a stream.

    Raises
    ------
    InputError
        Wrong options, or an address that cannot be used.
    DataError
        No sample was corrected.
    """
    from srt.constants import DEG, STANDARD_GRAVITY_M_S2
    from srt.stacks.stream_correction import CORRECTED, StreamCorrector, StreamOptions
    from srt.stacks.text_lines import LineCorrector

    ranges = [
        None if given[name] is None else given[name] * si
        for name, si in (("gyro_range_deg_s", DEG), ("accel_range_g", STANDARD_GRAVITY_M_S2))
    ]
    gravity = (calibration.site.gravity_m_s2 or STANDARD_GRAVITY_M_S2) if check_size else None
    options = StreamOptions(
        given["increments_s"], ranges[0], ranges[1], gravity=gravity, covariance=given["covariance"]
    )
    raw = stated_counts(given)
    corrector = StreamCorrector(calibration, frame, options, warn)
    units = {sensor: given[f"{sensor}_unit"] for sensor in ("gyro", "accel") if given[f"{sensor}_unit"]}
    lines = LineCorrector(corrector, units=units, covariance=given["covariance"], counts=raw)
    try:
        if given["source"] is None:
            _standard(lines)
        else:
            _datagrams(corrector, lines, raw, given)
    except KeyboardInterrupt:
        # A stream has no other end.
        pass
    finally:
        say(corrector.summary())
    if not corrector.counts[CORRECTED]:
        raise DataError("No sample of the stream was corrected: send lines of CSV or JSON, or MAVLink by --from.")
    return 0


def stated_counts(given: dict[str, Any]) -> Counts | None:
    """Scale of counts in SI units by the options; None without them.

    Raises
    ------
    InputError
        The value of a count for one sensor alone, an offset without it, or a text that is no number.
    """
    from srt.recording.import_options import parse_lsb, parse_offset
    from srt.stacks.stream_correction import Counts

    stated = [name for name in ("gyro_lsb", "accel_lsb", "gyro_offset", "accel_offset") if given[name] is not None]
    if not stated:
        return None
    if not {"gyro_lsb", "accel_lsb"} <= set(stated):
        raise InputError("Counts need the value of one for both sensors: give --gyro-lsb and --accel-lsb.")
    unit = [*parse_lsb(given["gyro_lsb"], "gyro"), *parse_lsb(given["accel_lsb"], "accel")]
    zero = [*parse_offset(given["gyro_offset"] or "0", "gyro"), *parse_offset(given["accel_offset"] or "0", "accel")]
    return Counts(tuple(unit), tuple(zero))


def _standard(lines: LineCorrector) -> None:
    if isinstance(sys.stdin, io.TextIOWrapper):
        # Bytes that are no text spoil their line alone.
        sys.stdin.reconfigure(errors="replace")
    from srt.stacks.text_lines import bounded_lines

    write, flush = sys.stdout.write, sys.stdout.flush
    for line in bounded_lines(sys.stdin):
        corrected = lines.correct(line)
        with output_errors():
            write(corrected + "\n")
            flush()


def _datagrams(corrector: StreamCorrector, lines: LineCorrector, raw: Counts | None, given: dict[str, Any]) -> None:
    source, target = parse_address(given["source"]), given["target"]
    if target is None:
        raise InputError("Corrected datagrams need an address to go to: add --to udp:HOST:PORT.")
    address = parse_address(target)
    if address == source:
        raise InputError(f"The stream would receive its own datagrams at {target}: use another port.")
    from srt.stacks.stream_correction import NOT_SENT

    correct = _datagram_corrector(corrector, lines, raw)
    try:
        family, *_ = socket.getaddrinfo(source.host, source.port, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, socket.SOCK_DGRAM) as link:
            link.bind(source)
            link.settimeout(given["timeout_s"])
            for packet in _received(link):
                for count, reason in _unsent(link, correct(packet), address):
                    corrector.event(NOT_SENT, f"a corrected datagram could not be sent ({reason})", count)
    except OSError as error:
        raise InputError(
            f"The stream from {given['source']} to {target} cannot be used ({error.strerror or error}): check both."
        ) from None


def _unsent(link: socket.socket, answers: list[bytes], address: Address) -> Iterator[tuple[int, str]]:
    """Send answers as one datagram, or in halves where it is too long; the number not sent, and the reason."""
    if not answers:
        return
    try:
        link.sendto(b"".join(answers), address)
    except OSError as error:
        if error.errno == errno.EMSGSIZE and len(answers) > 1:
            half = len(answers) // 2
            yield from _unsent(link, answers[:half], address)
            yield from _unsent(link, answers[half:], address)
        else:
            yield len(answers), error.strerror or str(error)


def _received(link: socket.socket) -> Iterator[bytes]:
    while True:
        try:
            yield link.recv(_LARGEST_DATAGRAM)
        except TimeoutError:
            return
        except ConnectionRefusedError:
            # Nobody listens at the target yet.
            continue


def _datagram_corrector(
    corrector: StreamCorrector, lines: LineCorrector, raw: Counts | None
) -> Callable[[bytes], list[bytes]]:
    """Function of a datagram, which gives its answers: MAVLink by its first byte, else lines of text."""
    from srt.stacks import mavlink

    link: list[mavlink.MavlinkCorrector] = []

    def correct(packet: bytes) -> list[bytes]:
        if packet[:1] and packet[0] in mavlink.MARKS:
            if not link:
                link.append(mavlink.MavlinkCorrector(corrector, raw))
            return link[0].correct(packet)
        # Lines end as those of standard input do.
        text = io.StringIO(packet.decode("utf-8", "replace"), newline=None)
        return [f"{lines.correct(line)}\n".encode() for line in text]

    return correct
