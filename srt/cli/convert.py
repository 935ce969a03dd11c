"""``srt convert``: conversion of a log in another format to a recording."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final, Self

import click

from srt.cli.grouped_command import GroupedCommand, RenamedOption
from srt.cli.messages import show, warn
from srt.cli.output_paths import SAMPLES_FORMATS, check_recording_target
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.cli.recording_arguments import check_median_force, median_force
from srt.cli.unit_type import ACCEL_UNITS, GYRO_UNITS, Unit
from srt.exceptions import DataError, InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from srt.recording.recording import Recording


class _TypedNumber(float):
    """Number whose text is as it was typed: zeros at its end say how exact it is."""

    typed: str

    def __new__(cls, typed: str) -> Self:
        """Make the number of a text."""
        number = super().__new__(cls, typed)
        number.typed = typed
        return number

    def __str__(self) -> str:
        return self.typed


class _Typed(click.types.FloatParamType):
    """Number that keeps its text."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> _TypedNumber:
        super().convert(value, param, ctx)
        return _TypedNumber(value)


_TIME_UNITS = ("s", "ms", "0.1ms", "us", "ns")

_READING = (
    "kind", "time_unit", "gyro_unit", "accel_unit", "sample_rate_hz", "topic", "instance", "delimiter",
    "decimal_comma", "skip", "variable", "map_gyro", "map_accel",
)  # fmt: skip


def _list_formats(ctx: click.Context, param: click.Parameter, value: bool) -> None:  # noqa: ARG001 - click's
    if not value or ctx.resilient_parsing:
        return
    from srt.recording.importer_registry import IMPORTERS, importer
    from srt.reports.tables import text_table

    rows = []
    for name in IMPORTERS:
        each = importer(name)
        rows.append([name, each.title, " ".join(each.suffixes), each.extra or ""])
    show(text_table(["format", "what it is", "files", "extra"], rows, "llll"))
    ctx.exit()


_READ = [
    click.option("--format", "name", default="auto", show_default=True, metavar="FORMAT", help="Format of SOURCE."),
    click.option("--columns", metavar="MAP", help="time,gyro,accel in order, or gyro_x=NAME,... or gyro_x=4,..."),
    click.option("--gyro-unit", type=Unit((*GYRO_UNITS, "counts")), help="Unit, if the file does not state it."),
    click.option("--accel-unit", type=Unit((*ACCEL_UNITS, "counts")), help="Unit, if the file does not state it."),
    click.option("--time-unit", type=Unit(_TIME_UNITS), help="Unit, if the file does not state it."),
    click.option("--kind", type=click.Choice(("rate", "increment")), help="Kind of the samples; default: rate."),
    click.option("--sample-rate-hz", type=float, help="Sample rate; it replaces time stamps."),
    click.option(
        "--gyro-lsb",
        metavar="LSB",
        help="Value of one count: '1/131 deg/s', or a number in rad/s (rad); three for x,y,z.",
    ),
    click.option(
        "--accel-lsb",
        metavar="LSB",
        help="Value of one count: '1/16384 g', or a number in m/s^2 (m/s); three for x,y,z.",
    ),
    click.option("--gyro-offset", metavar="COUNTS", help="Gyro counts at zero rate; one number or three."),
    click.option("--accel-offset", metavar="COUNTS", help="Accelerometer counts at zero force; one number or three."),
    click.option("--map-gyro", metavar="AXES", help="Gyro axes of the file that become x, y, z, as x,-y,z."),
    click.option("--map-accel", metavar="AXES", help="Accelerometer axes, likewise."),
    click.option("--topic", help="Topic of the IMU in a bag."),
    click.option("--instance", type=click.IntRange(min=0), help="Number of the IMU in a log, from 0."),
    click.option("--variable", help="Array, struct or group of a MATLAB, HDF5 or NPZ file."),
    click.option("--delimiter", metavar="MARK", help="Delimiter: tab, semicolon, comma, pipe, blank, or a character."),
    click.option("--decimal-comma", is_flag=True, help="The text file writes 1,5 for 1.5."),
    click.option("--skip", type=click.IntRange(min=0), default=0, help="Lines to skip at the top of a text file."),
]

_STATED: Final = {
    "Site": {
        "latitude-deg": "Latitude of the site.",
        "gravity-m-s2": "Gravity at the site, positive.",
        "height-m": "Height of the site: normal gravity, with the latitude.",
        "gravity-sigma-m-s2": "1-sigma of gravity; default: that of its digits.",
    },
    "Fixture": {
        "heading-deg": "Heading of the fixture's x axis, clockwise from north.",
        "alignment-sigma-mrad": "1-sigma of levelling, north, mounting and squareness.",
        "rotation-sigma-mrad": "1-sigma of each rotation of the fixture.",
        "wobble-sigma-mrad": "1-sigma of the inner axis tilt, from pose to pose.",
    },
    "Noise of the unit": {
        "gyro-noise-deg-per-sqrt-h": "Angle random walk.",
        "accel-noise-ug-per-sqrt-hz": "Noise density of the accelerometers.",
        "gyro-quantization-arcsec": "Angle quantization.",
        "accel-quantization-m-s": "Velocity quantization.",
        "gyro-bias-instability-deg-per-h": "Bias instability of the gyros.",
        "accel-bias-instability-ug": "Bias instability of the accelerometers.",
        "gyro-range-deg-s": "Range of the gyros.",
        "accel-range-g": "Range of the accelerometers.",
    },
}
"""Keys of recording.toml as options, with their help, by groups of it."""

_SAY = [
    click.option("--like", type=PATH, metavar="RECORDING", help="Take site, fixture, imu and "
                 "sequences from this recording; options take precedence."),
    *(click.option(f"--{key}", type=_Typed() if key == "gravity-m-s2" else float, help=text)
      for keys in _STATED.values() for key, text in keys.items()),
    click.option("--applied", metavar="FORMAT:FILE", help="Correction that the readings had before they were logged, "
                 "as px4:vehicle.params or imucal:unit.json, or none; default: that in the log."),
    click.option("--serial", help="Serial of the unit."),
    click.option("--date", help="Date of the recording."),
    click.option("--temperature-c", type=float, help="Temperature of all samples, if the file has none."),
]  # fmt: skip


def _options(*groups: list[Callable[[Any], Any]]) -> Callable[[Any], Any]:
    def decorate(command: Any) -> Any:
        for each in reversed([option for group in groups for option in group]):
            command = each(command)
        return command

    return decorate


log_options: Final = _options(_READ, _SAY)
"""Decorator of a command with the options that describe a log."""

_WRITE = [
    click.option("-o", "--output", required=True, type=PATH, help="Folder to write."),
    click.option("--samples-format", cls=RenamedOption, earlier=("--to",), type=click.Choice(SAMPLES_FORMATS),
                 default="csv", show_default=True, help="Format of the samples written."),
    click.option("--force", is_flag=True, help="Write even if the accelerometers do not read gravity."),
    overwrite_option(folder=True),
    click.option("-q", "--quiet", is_flag=True, help="No summary."),
]  # fmt: skip


GROUPS: Final = {
    "Reading of the log": (*_READING, "name", "columns", "gyro_lsb", "accel_lsb", "gyro_offset", "accel_offset"),
    **{title: tuple(key.replace("-", "_") for key in keys) for title, keys in _STATED.items()},
    "Identification": ("serial", "date", "temperature_c", "applied"),
}
"""Groups of the options that describe a log, in the help."""


_USUAL = (
    "list", "columns", "gyro_unit", "accel_unit", "time_unit", "gyro_lsb", "accel_lsb", "latitude_deg", "gravity_m_s2",
    "heading_deg", "output",
)  # fmt: skip
"""Options of the short help."""


@click.command(cls=GroupedCommand, usual=_USUAL, groups=GROUPS)
@click.argument("source", type=PATH)
@click.argument("second", metavar="[SOURCE2]", required=False, type=PATH)
@click.option(
    "--list", is_flag=True, is_eager=True, expose_value=False, callback=_list_formats, help="List the formats and exit."
)
@log_options
@_options(_WRITE)
def convert(
    source: Path,
    second: Path | None,
    output: Path,
    samples_format: str,
    force: bool,
    overwrite: bool,
    quiet: bool,
    **given: Any,
) -> int:
    """Convert the log SOURCE to a recording: a folder with recording.toml and the samples, in SI units.

    SOURCE2 is the file of the gyros where each sensor has its own. The format is detected ('--list' shows all). Units
    that neither the format nor the header of the file states must be given.

    Gravity must be given: --gravity-m-s2, or --latitude-deg and --height-m, or --like another recording. With an
    option of the fixture the recording has one; without, its attitudes are unknown. State the noise of the unit if it
    is known: otherwise it is estimated from the stationary windows, without bias instability.

    Exit codes: 0 success; 1 the accelerometers do not read gravity: a unit is wrong; 2 wrong usage or unreadable input.
    """
    check_target(output, source, second, samples_format, overwrite=overwrite)
    if source.suffix == ".toml" or (source / "recording.toml").is_file():
        raise InputError(f"{source} is a recording already: name the log that it was made of, or use it as it is.")
    from srt.recording.writing import write_recording

    recording, text = read_source(source, second, given, force=force)
    # All checks are done: the recording is written.
    write_recording(recording, output, samples_format=samples_format, overwrite=overwrite)
    if not quiet:
        show(text)
        show(f"Written to {output}: recording.toml, samples.{samples_format}")
    return 0


def read_source(source: Path, second: Path | None, given: Mapping[str, Any], *, force: bool) -> tuple[Recording, str]:
    """Read a log by the options that describe it; the table of what was read.

    Parameters
    ----------
    given : mapping of str to object
        Options of :data:`log_options`, by the names of the parameters.
    force : bool
        Accept accelerometers that do not read gravity.

    Raises
    ------
    SrtError
        A log that cannot be read, something that has to be stated and is not, or another size than gravity.
    """
    from srt.exporters.applied_file import applied_of
    from srt.recording.reading import gravity_warning, read_log
    from srt.reports.text.imported_log import import_text

    rest = {**given, "second": second}
    name, like = rest.pop("name", "auto"), rest.pop("like", None)
    if rest.get("applied") is not None:
        rest["applied"] = applied_of(rest["applied"], rest.get("instance"))
    recording, imported, importer = read_log(source, rest, format=name, like=like)
    if not force:
        check_gravity(recording, source, rest.get("accel_lsb"), rest.get("kind"))
    doubt = gravity_warning(recording.site)
    if doubt is not None:
        warn(f"{source}: {doubt}")
    return recording, import_text(recording, imported, importer, source)


def check_target(folder: Path, source: Path, second: Path | None, samples_format: str, *, overwrite: bool) -> None:
    """Check the folder of the result before data are read.

    Raises
    ------
    InputError
        A folder that cannot be created, that is not empty, or in which the source itself would be replaced.
    """
    check_recording_target(folder, overwrite=overwrite)
    samples = (folder / f"samples.{samples_format}").resolve()
    if second is not None and source.resolve() == second.resolve():
        raise InputError(f"{source} is named twice: name the file of the other sensor, or this one alone.")
    for path in (source, second):
        if path is not None and path.resolve() == samples:
            raise InputError(f"{path} would be replaced by its own conversion: name another folder than {folder}.")


_UNIT: Final = re.compile(
    r"(?P<found>look like (?P<unit>[^,;]+), declared as [^,;]+)?; correct (?P<sensor>gyro|accel|time)_unit"
    r"(?: or kind| in recording\.toml)?"
)
_KEYS: Final = (
    (re.compile(r"set (gyro|accel)_unit = \"counts\" and \w+_lsb"), r"run again with --\1-unit counts and --\1-lsb"),
    (re.compile(r"correct (gyro|accel)_lsb"), r"run again with another --\1-lsb"),
    (re.compile(r'set kind = "(\w+)"'), r"run again with --kind \1"),
)
"""Remedies of faults in keys of recording.toml, and as options of a log."""


def log_remedy(sentence: str, kind: str | None = None) -> str:
    """Sentence of a fault whose remedy is an option of the log.

    The samples of a recording that is made of a log are in SI units: another unit in its recording.toml would be wrong.

    Parameters
    ----------
    kind : str, optional
        Kind of the samples as stated; default: rate.
    """
    from srt.recording.import_options import normal_unit

    known = {"gyro": GYRO_UNITS, "accel": ACCEL_UNITS, "time": _TIME_UNITS}

    def named(fault: re.Match[str]) -> str:
        sensor, unit = fault["sensor"], normal_unit(fault["unit"] or "")
        # Messages call both degrees per second and degrees "degrees".
        forms = (f"{unit}*s", unit.removesuffix("^2")) if kind == "increment" else (f"{unit}/s", unit)
        unit = next((form for form in forms if form in known[sensor]), "")
        if not unit:
            own = "counts and the value of the unit as --{0}-lsb" if fault["found"] else "of another value, or --kind"
            unit = "of another value" if sensor == "time" else own.format(sensor)
        return f"{fault['found'] or ''}; run again with --{sensor}-unit {unit}"

    sentence = _UNIT.sub(named, sentence)
    for key, option in _KEYS:
        sentence = key.sub(option, sentence)
    return sentence


def check_gravity(recording: Recording, source: Path, accel_lsb: str | None = None, kind: str | None = None) -> None:
    """Refuse accelerometers that do not read gravity: a unit, or the kind of the samples, is wrong.

    Parameters
    ----------
    accel_lsb, kind : str, optional
        Value of a count as stated, which is then the first cause, and kind of the samples.

    Raises
    ------
    DataError
    """
    try:
        check_median_force(recording)
    except DataError as error:
        reason = log_remedy(str(error), kind)
        if "look like" not in reason:
            reason = f"{reason.rstrip('.')}, or add --force."
        if accel_lsb is not None:
            ratio = median_force(recording) / recording.site.gravity_m_s2
            reason = (
                f"With the stated value of a count, {accel_lsb}, the accelerometers read {ratio:.3g} times gravity: "
                "correct --accel-lsb, or add --force."
            )
        raise DataError(f"{source}: {reason}", fault=error.fault) from None
