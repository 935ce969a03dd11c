"""Samples of a foreign file in SI units, with notes on all assumptions and changes."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, NotStatedError, clipped
from srt.recording.import_options import SENSOR_UNITS, TRIADS, ImportOptions, counts_text, option, parse_axis_map
from srt.recording.recording import Kind, Recording, Site, require_bounded
from srt.recording.samples import TEMPERATURE, TIME
from srt.recording.schema import COUNTS, TIME_UNITS, UNITS
from srt.recording.timing import GAP_STEPS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from srt.recording.applied import AppliedCorrection
    from srt.recording.import_options import Triple
    from srt.types import Array, Indices, Mask

REBASE_BEYOND_S: Final = 1e6
"""Stamps above this, s, are counted from the first: a double holds smaller ones to 0.2 ns."""

_SI: Final = {"rate": {"gyro": "rad/s", "accel": "m/s²"}, "increment": {"gyro": "rad", "accel": "m/s"}}

_LONGEST_LIST: Final = 300  # characters of the names of columns in a message
_COUNTER: Final = 2**32
"""Number of values of the counter of many loggers."""
_MOST_LOST: Final = 1000.0
"""Intervals that a counter may jump over as it overflows; stamps in disorder jump anywhere."""
_PLAUSIBLE_EPOCH_S = (9e8, 7e9)  # stamps, s, that a note shows as a date since 1970: the years 1998 to 2191


@dataclass(frozen=True, slots=True)
class StatedUnits:
    """Units that a format or the header of a file states, as in ``recording.toml``; None: the user states them."""

    gyro: str | None = None
    accel: str | None = None
    time: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ImportedSamples:
    """Result of a reader.

    Attributes
    ----------
    gyro : ndarray, shape (n, 3)
        rad/s for kind "rate", rad for "increment".
    accel : ndarray, shape (n, 3)
        m/s² for "rate", m/s for "increment".
    kind : "rate" or "increment"
    time : ndarray, shape (n,), s, or None
        None: the file has no stamps.
    sample_rate_hz : float or None
        Stated by the file or the user.
    temperature : ndarray, shape (n,), °C, or None
    serial, date : str or None
        None: the file does not state them.
    units : mapping of str to str
        Unit of "gyro", "accel" and "time" in the file, and its origin: the file or the user.
    notes : tuple of str
        Sentences on assumptions, dropped samples and changes.
    applied : AppliedCorrection or None
        Correction that the system that wrote the log had applied; None: not known.
    unread : tuple of str
        Names of columns that are not read.
    """

    gyro: Array
    accel: Array
    kind: Kind = "rate"
    time: Array | None = None
    sample_rate_hz: float | None = None
    temperature: Array | None = None
    serial: str | None = None
    date: str | None = None
    units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    applied: AppliedCorrection | None = None
    unread: tuple[str, ...] = ()


def samples_in_si(
    options: ImportOptions,
    *,
    gyro: NDArray[Any],
    accel: NDArray[Any],
    time: NDArray[Any] | None,
    stated: StatedUnits,
    kind: Kind | None = None,
    sample_rate_hz: float | None = None,
    temperature: NDArray[Any] | None = None,
    notes: tuple[str, ...] = (),
    **others: Any,
) -> ImportedSamples:
    """Convert arrays to SI: the last step of every reader.

    Parameters
    ----------
    options : ImportOptions
        A unit given here overrides the stated one, with a note.
    gyro, accel : ndarray, shape (n, 3)
        In the units of the file.
    time : ndarray, shape (n,), or None
        Integers stay exact: they are counted from the first one before the conversion to seconds. Dates and durations
        of NumPy state their unit.
    stated, kind, sample_rate_hz
        By the format or the header of the file.
    temperature : ndarray, shape (n,), °C, optional
    **others
        Serial, date and applied correction, where the file states them.

    Raises InputError for a unit that is not stated or that does not fit the kind, a kind that the format does not have,
    arrays of different lengths.
    """
    if None not in (kind, options.kind) and kind != options.kind:
        raise InputError(
            f"{option('kind')} is {options.kind}, but this format holds samples of kind {kind}: leave it out."
        )
    chosen: Kind = kind or options.kind or "rate"
    if time is not None and time.dtype.kind in "mM":
        time, unit = _ticks(time, options)
        stated = replace(stated, time=unit)
    if time is not None and options.sample_rate_hz and (options.time_unit or stated.time) not in UNITS[TIME]:
        time, notes = None, (*notes, stamps_without_unit())
    require_units(
        options, {"gyro": stated.gyro, "accel": stated.accel} | ({} if time is None else {"time": stated.time})
    )
    changes: list[str] = []
    units: dict[str, str] = {}
    arrays: dict[str, Array] = {}
    for sensor, raw, own in (("gyro", gyro, stated.gyro), ("accel", accel, stated.accel)):
        if raw.ndim != 2 or raw.shape[1] != 3 or len(raw) != len(gyro):
            raise InputError(f"The {sensor} readings have the shape {raw.shape}, but ({len(gyro)}, 3) is expected.")
        unit, units[sensor] = _unit(options, f"{sensor}_unit", own, changes)
        arrays[sensor] = np.array(raw, dtype=np.float64)
        to_si(options, sensor, unit, chosen, arrays[sensor])
        if unit == COUNTS:
            units[sensor] += counts_text(options, sensor, _SI[chosen][sensor])
    seconds = None
    if time is not None:
        if time.shape != (len(gyro),):
            raise InputError(f"There are {time.size} time stamps for {len(gyro)} samples: one for each is expected.")
        unit, units["time"] = _unit(options, "time_unit", stated.time, changes)
        seconds = seconds_of(time, unit, changes)
    elif options.time_unit is not None:
        raise InputError(f"{option('time_unit')} is given, but no time stamps are read: name their column.")
    return ImportedSamples(
        gyro=arrays["gyro"],
        accel=arrays["accel"],
        kind=chosen,
        time=seconds,
        sample_rate_hz=options.sample_rate_hz or sample_rate_hz,
        temperature=None if temperature is None else np.asarray(temperature, dtype=np.float64),
        units=units,
        notes=(*notes, *changes),
        **others,
    )


def _ticks(stamps: NDArray[Any], options: ImportOptions) -> tuple[NDArray[Any], str]:
    """Dates or durations as integers, and the unit of these. Raises InputError for a unit in the options, or a NaT."""
    if options.time_unit is not None:
        raise InputError(f"{option('time_unit')} is given, but the time stamps are dates or durations: leave it out.")
    absent = np.flatnonzero(np.isnat(stamps))
    if absent.size:
        raise InputError(f"Time stamp {absent[0] + 1} of {stamps.size} is empty (NaT): repair or remove the sample.")
    unit, count = np.datetime_data(stamps.dtype)
    if unit not in TIME_UNITS or count != 1:
        stamps, unit = stamps.astype(f"{stamps.dtype.kind}8[ns]"), "ns"
    return stamps.astype(np.int64), unit


def seconds_of(stamps: NDArray[Any], unit: str, notes: list[str]) -> Array:
    """Convert stamps, shape (n,), to seconds, counted from the first where they are too large for a double.

    A sentence is appended to the notes in this case.
    """
    factor = TIME_UNITS[unit]
    # Division by a power of ten rounds once; the reciprocal of a power of ten is no double.
    divisor = round(1.0 / factor)
    if stamps.dtype.kind in "iu":
        stamps = _counted_on(stamps.astype(np.int64), notes)  # differences of unsigned integers may overflow
    if stamps.size and REBASE_BEYOND_S < abs(float(stamps[0])) * factor < np.inf:
        first = stamps[0]
        start = float(first) * factor
        epoch = ""
        if _PLAUSIBLE_EPOCH_S[0] < start < _PLAUSIBLE_EPOCH_S[1]:
            moment = datetime.datetime.fromtimestamp(start, tz=datetime.UTC)
            epoch = f" ({moment:%Y-%m-%d %H:%M:%S} UTC, if since 1970)"
        notes.append(f"Time is counted from the first stamp, {first} {unit}{epoch}.")
        stamps = stamps - first
    return np.asarray(stamps / divisor, dtype=np.float64)


def _counted_on(stamps: NDArray[Any], notes: list[str]) -> NDArray[Any]:
    """Stamps, shape (n,), of a counter of 32 bits without its overflows, with a note; others as they are.

    An overflow is told from stamps in disorder by its size: but for some samples, that of the whole counter.
    """
    steps = np.diff(stamps)
    back = steps < 0
    if not back.any() or stamps.min() < 0 or stamps.max() >= _COUNTER:
        return stamps
    if np.any(steps[back] + _COUNTER > _MOST_LOST * max(float(np.median(steps)), 1.0)):
        return stamps
    times = f"{int(back.sum())} times" if back.sum() > 1 else "once"
    notes.append(f"The 32-bit counter of the time stamps overflowed {times}, and is counted on.")
    return np.asarray(stamps + _COUNTER * np.concatenate(([0], np.cumsum(back))))


def stamps_without_unit() -> str:
    """Note on stamps that a stated rate replaces."""
    return f"The time stamps are not used: their unit is not stated, and {option('sample_rate_hz')} is."


def join_streams(gyro_time: Array, accel_time: Array, accel: Array, notes: list[str]) -> tuple[slice | Indices, Array]:
    """Interpolate accelerometer readings, shape (m, 3), linearly to the stamps of the gyros, where the stamps differ.

    Both stamps, s, are of the same clock and strictly increasing; sentences on the changes are appended to the notes.

    Returns
    -------
    kept : slice or ndarray of int, shape (k,)
        Gyro samples between two accelerometer readings; gaps of that stream stay gaps.
    accel : ndarray, shape (k, 3)

    Raises InputError for streams without time in common, or stamps that do not increase.
    """
    if gyro_time.shape == accel_time.shape and np.array_equal(gyro_time, accel_time):
        return slice(None), accel
    for name, time in (("gyro", gyro_time), ("accelerometer", accel_time)):
        if time.size < 2 or not np.all(time[1:] > time[:-1]):
            raise InputError(
                f"The {name} readings cannot be joined with the others: "
                "at least 2 time stamps that increase are needed."
            )
    steps = np.diff(accel_time)
    after = np.searchsorted(accel_time, gyro_time, side="left")
    inside = (gyro_time >= accel_time[0]) & (gyro_time <= accel_time[-1])
    across = steps[np.clip(after, 1, accel_time.size - 1) - 1]
    exact = accel_time[np.minimum(after, accel_time.size - 1)] == gyro_time
    longest = GAP_STEPS * max(float(np.median(steps)), float(np.median(np.diff(gyro_time))))
    kept = np.flatnonzero(inside & ((across <= longest) | exact))
    if kept.size < 2:
        raise InputError(
            f"The gyro readings ({gyro_time[0]:g} to {gyro_time[-1]:g} s) and the accelerometer readings "
            f"({accel_time[0]:g} to {accel_time[-1]:g} s) have no time in common: check that "
            "they are from one recording."
        )
    notes.append("Accelerometer readings were brought to the time stamps of the gyros by linear interpolation.")
    if kept.size < gyro_time.size:
        notes.append(f"{gyro_time.size - kept.size} gyro samples without accelerometer readings around them dropped.")
    at = gyro_time[kept]
    return kept, np.column_stack([np.interp(at, accel_time, column) for column in accel.T])


def without_repeats(imported: ImportedSamples) -> ImportedSamples:
    """Drop records that a logger wrote twice: stamp and readings equal those of the record before.

    A repeated stamp with other readings stays, and the recording refuses it: it is not known which one is right.
    """
    time = imported.time
    keep = None if time is None else first_of_repeats(time, imported.gyro, imported.accel)
    if time is None or keep is None:
        return imported
    temperature = imported.temperature
    return replace(
        imported,
        time=time[keep],
        gyro=imported.gyro[keep],
        accel=imported.accel[keep],
        temperature=None if temperature is None else temperature[keep],
        notes=(*imported.notes, f"{(~keep).sum()} repeated samples (same stamp, same readings) dropped."),
    )


def first_of_repeats(stamps: NDArray[Any], *readings: Array) -> Mask | None:
    """Mask, shape (n,), of the records that do not repeat the one before, stamp and readings; None if none does."""
    same = stamps[1:] == stamps[:-1]
    for values in readings if same.any() else ():
        same &= np.all(values[1:] == values[:-1], axis=1)
    return np.concatenate(([True], ~same)) if same.any() else None


def in_imu_axes(imported: ImportedSamples, options: ImportOptions) -> ImportedSamples:
    """Convert samples to the axes of the IMU by the axis maps of the options, with notes."""
    changes: dict[str, Any] = {}
    notes = list(imported.notes)
    maps = [parse_axis_map(getattr(options, f"map_{sensor}"), f"map_{sensor}") for sensor in TRIADS]
    handedness = [1.0 if matrix is None else float(np.linalg.det(matrix)) for matrix in maps]
    for sensor, matrix in zip(TRIADS, maps, strict=True):
        if matrix is not None:
            # Adding zero turns the -0.0 of a sign change into 0.0.
            changes[sensor] = getattr(imported, sensor) @ matrix.T + 0.0
            notes.append(f"{sensor} x, y, z are {getattr(options, f'map_{sensor}')} of the file.")
    if handedness[0] * handedness[1] < 0.0:
        notes.append(
            "The axis maps change the handedness of one triad: right if two of its axes are exchanged in the file, or "
            "one has the wrong sign; srt inspect checks it."
        )
    if not changes:
        return imported
    applied = imported.applied
    if applied is not None:
        # A rotation of both triads together is one more rotation of the log's axes; anything else it cannot state.
        if options.map_gyro == options.map_accel and maps[0] is not None and handedness[0] > 0.0:
            applied = replace(applied, rotation=maps[0] @ applied.rotation)
        else:
            applied = None
            notes.append("The calibration of the log is not carried, as the axis maps are no common rotation.")
    return replace(imported, **changes, notes=tuple(notes), applied=applied)


def to_recording(
    imported: ImportedSamples, site: Site, *, temperature_c: float | None = None, **others: Any
) -> Recording:
    """Make a recording of imported samples; without stamps, the rate gives them, and the first interval starts at 0.

    ``temperature_c`` is that of all samples, if the file has none. ``others`` are further fields of
    :class:`~srt.recording.recording.Recording`; those that are not None override the file's. Raises InputError: neither
    stamps nor a rate, or samples that a recording refuses.
    """
    time, rate = imported.time, imported.sample_rate_hz
    if time is None:
        if rate is None:
            way = "name the column of time"
            if imported.unread:
                found = clipped(", ".join(map(clipped, imported.unread)), _LONGEST_LIST)
                way += f", as {option('columns')} '{TIME}={clipped(imported.unread[0])}' (columns not read: {found})"
            raise NotStatedError(
                f"There are no time stamps: give the rate with {option('sample_rate_hz')} (sample_rate_hz in "
                f"recording.toml), or {way}.",
                missing=["sample_rate_hz"],
            )
        time = np.arange(1, len(imported.gyro) + 1) / rate
    temperature = imported.temperature
    if temperature is None and temperature_c is not None:
        temperature = np.broadcast_to(np.float64(temperature_c), time.shape)
    known = {name: getattr(imported, name) for name in ("gyro", "accel", "kind", "serial", "date", "applied")}
    known |= {name: value for name, value in others.items() if value is not None}
    recording = Recording(time=time, site=site, sample_rate_hz=rate, temperature=temperature, **known)
    require_bounded(recording)
    return recording


def of_channels(table: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Arguments of :func:`samples_in_si` from arrays by channel, each sensor whole, shape (n, 3), or by its axes."""
    arrays: dict[str, Any] = {TIME: table.get(TIME), TEMPERATURE: table.get(TEMPERATURE)}
    for sensor, channels in TRIADS.items():
        found = table[sensor] if sensor in table else np.column_stack([table[name] for name in channels])
        arrays[sensor] = np.asarray(found, dtype=np.float64)
    return arrays


def require_units(options: ImportOptions, stated: dict[str, str | None]) -> None:
    """Raise InputError that names all quantities whose unit, or value of a count, nobody states."""
    missing, ways, counted, names = [], [], [], []
    for quantity, unit in stated.items():
        name = f"{quantity}_unit"
        # The value of a count implies the unit "counts".
        if getattr(options, f"{quantity}_lsb", None) is not None:
            continue
        if (getattr(options, name) or unit) == COUNTS:
            counted.append(quantity)
            names.append(f"{quantity}_lsb")
        if getattr(options, name) or unit in UNITS[quantity]:
            continue
        missing.append(f"{quantity} (its text {clipped(unit)!r} is not known)" if unit else quantity)
        names.append(name)
        counts = f" (for them {option(f'{quantity}_lsb')} alone is enough)" if quantity in SENSOR_UNITS else ""
        ways.append(f"{option(name)} ({name} in recording.toml), one of {', '.join(UNITS[quantity])}{counts}")
    sentences = []
    if missing:
        sentences.append(f"The file does not state the unit of {', '.join(missing)}: give {'; and '.join(ways)}.")
    if counted:
        values = " and ".join(f"{option(f'{sensor}_lsb')} ({sensor}_lsb in recording.toml)" for sensor in counted)
        sentences.append(
            f"The {' and '.join(counted)} readings are counts: state the value of one count with {values}."
        )
    if sentences:
        raise NotStatedError(" ".join(sentences), missing=names)


def _unit(options: ImportOptions, name: str, stated: str | None, notes: list[str]) -> tuple[str, str]:
    """Unit of a sensor or of time, and its text with its origin; a contradiction becomes a note."""
    given: str | None = getattr(options, name)
    if given is None and stated is not None:
        return stated, f"{stated} (as in the file)"
    given = given or COUNTS
    if stated is not None and given != stated:
        notes.append(
            f"The file states {stated} for {name.removesuffix('_unit')}; read as {given}, as stated by the user."
        )
    return given, f"{given} (as given)"


def to_si(options: ImportOptions, sensor: str, unit: str, kind: Kind, values: Array) -> None:
    """Convert readings in place: counts by ``gyro_lsb`` or ``accel_lsb`` less their offset, others by their unit.

    Raises InputError for a unit that does not fit the kind, or a value of counts for readings in another unit.
    """
    lsb, offset = getattr(options, f"{sensor}_lsb"), getattr(options, f"{sensor}_offset")
    factor: float | Triple = lsb
    if unit != COUNTS:
        for name, value in (("lsb", lsb), ("offset", offset)):
            if value is not None:
                raise InputError(
                    f"{option(f'{sensor}_{name}')} is given, but the {sensor} readings are in {unit}: leave it out, or "
                    f"add {option(f'{sensor}_unit')} {COUNTS}."
                )
        factors = SENSOR_UNITS[sensor][kind]
        if unit not in factors:
            raise InputError(
                f"The unit {unit} of the {sensor} readings does not fit samples of kind {kind}, for which one of "
                f"{', '.join((*factors, COUNTS))} is expected: correct {option(f'{sensor}_unit')} or {option('kind')}."
            )
        factor = factors[unit]
    if offset is not None:
        values -= offset
    if factor != 1.0:
        with np.errstate(over="ignore"):  # an infinite reading is refused with its row
            values *= factor
