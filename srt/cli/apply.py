"""``srt apply``: correction of a recording by a calibration, and the same correction as a C header."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from srt.cli.grouped_command import GroupedCommand
from srt.cli.messages import show, warn
from srt.cli.output_paths import SAMPLES_FORMATS, check_file, check_recording_target, recording_folder
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.cli.recording_arguments import check_median_force
from srt.cli.stream import NAMES, STANDARD, run_stream, stream_options
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.diagnosis.corrected_rest import CorrectedRest
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

HEADER_SUFFIXES = (".h",)
_USUAL = (
    "output", "frame", "samples_format", "c_header", "source", "target", "gyro_unit", "accel_unit", "overwrite",
    "quiet",
)  # fmt: skip
"""Options of the short help."""


@click.command("apply", cls=GroupedCommand, usual=_USUAL)
@click.argument("calibration_file", metavar="CALIBRATION", type=PATH)
@click.argument("recording_path", metavar="[RECORDING]", required=False, type=PATH)
@click.option("-o", "--output", type=PATH, help="Folder to write; made if absent.")
@click.option(
    "--frame", type=click.Choice(("mars", "table")), default="mars", show_default=True, help="Axes of the result."
)
@click.option("--samples-format", type=click.Choice(SAMPLES_FORMATS), help="Default: as in RECORDING.")
@click.option("--c-header", type=PATH, metavar="FILE.h", help="Also write the correction as C99.")
@stream_options
@click.option("--force", is_flag=True, help="Accept an inconsistent calibration, any serial, readings and rest.")
@click.option("--trust", is_flag=True, help="Accept a calibration file that was changed after it was written.")
@overwrite_option(folder=True)
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
def apply(
    calibration_file: Path,
    recording_path: Path | None,
    output: Path | None,
    frame: str,
    samples_format: str | None,
    c_header: Path | None,
    force: bool,
    trust: bool,
    overwrite: bool,
    quiet: bool,
    **stream: Any,
) -> int:
    """Correct RECORDING by CALIBRATION, the JSON file that 'srt calibrate -o' wrote.

    With - for RECORDING, lines of CSV or JSON are corrected from standard input to standard output as they come; with
    --from and --to, datagrams with such lines or with MAVLink (HIGHRES_IMU, SCALED_IMU, RAW_IMU).

    The folder then holds the recording with corrected samples, in SI units, in MARS axes (those of the calibration)
    or in axes of the table-mounted frame. With --c-header alone, RECORDING and -o are left out.

    Exit codes: 0 success; 1 readings that are increments stated as rates, or the reverse, or a stream without a sample;
    2 wrong usage, unreadable input, or a calibration that does not fit the recording.
    """
    streamed = stream["source"] is not None or str(recording_path) == STANDARD
    check_stream(stream, recording_path, output, c_header, streamed=streamed)
    if streamed:
        calibration = load_fit(calibration_file, force=force, trust=trust)
        warn_of_unmeasured(calibration, calibration_file)
        return run_stream(calibration, frame, stream, check_size=not force)
    check_places(recording_path, output, c_header, overwrite=overwrite)
    calibration = load_fit(calibration_file, force=force, trust=trust)
    header = None
    if c_header is not None:
        from srt.exporters.c_header import c99_header

        header = c99_header(calibration)
    corrected, source_format, rests = None, "", None
    if recording_path is not None:
        from srt.recording.folder import load_recording

        recording = load_recording(recording_path)
        source_format = samples_suffix(recording_path)
        if not force:
            check_match(calibration, recording, calibration_file, recording_path)
            usual = at_mean_temperature(calibration, recording)
            rests = check_rests(usual, recording, calibration_file, recording_path)
        corrected = correct(calibration, recording, frame, check=not force)
    # All checks are done: the results are written.
    written = []
    if corrected is not None and output is not None:
        from srt.recording.writing import write_recording

        samples_format = samples_format or source_format
        write_recording(corrected, output, samples_format=samples_format, overwrite=overwrite)
        written.append(f"{output}: recording.toml, samples.{samples_format}")
    if header is not None and c_header is not None:
        from srt.recording.atomic_file import atomic_write_text

        atomic_write_text(c_header, header)
        written.append(str(c_header))
    warn_of_unmeasured(calibration, calibration_file)
    if not quiet:
        if corrected is not None:
            show_correction(corrected, frame, rests, compared=not force)
        for place in written:
            show(f"Written to {place}")
    return 0


def show_correction(corrected: Recording, frame: str, rests: CorrectedRest | None, *, compared: bool) -> None:
    """Print the number of samples and, if they were compared, the differences at rest."""
    from srt.reports.tables import wrap

    axes = "MARS axes" if frame == "mars" else "axes of the table-mounted frame"
    show(f"{corrected.time.size} samples ({corrected.kind}) corrected, in {axes}")
    if compared:
        show("\n".join(wrap(f"Check: {rests or 'no stationary window was found'}")))


def check_stream(
    stream: Mapping[str, Any], recording: Path | None, output: Path | None, c_header: Path | None, *, streamed: bool
) -> None:
    """Refuse options of a stream without one, and options of a recording with one. Raises InputError."""
    if not streamed:
        stated = [name for name in NAMES if stream[name]]
        if stated:
            option = {"source": "from", "target": "to"}.get(stated[0], stated[0].replace("_", "-"))
            raise InputError(f"--{option} describes a stream: give - for RECORDING, or --from ADDRESS.")
        return
    if output is not None or c_header is not None or (recording is not None and stream["source"] is not None):
        raise InputError("A stream goes to standard output or to --to: leave out RECORDING, -o and --c-header.")
    if stream["source"] is None and stream["target"] is not None:
        raise InputError("--to sends datagrams that arrive at --from ADDRESS: add it.")


def check_places(recording: Path | None, output: Path | None, c_header: Path | None, *, overwrite: bool) -> None:
    """Check paths and combinations before data are read.

    Parameters
    ----------
    recording, output, c_header : Path or None
        As on the command line.

    Raises
    ------
    InputError
    """
    if (recording is None) != (output is None):
        raise InputError(
            "RECORDING and the option -o go together: name the recording, and the folder to write; for a stream of "
            f"lines of CSV or JSON, write '- < {recording or 'LINES'}' in place of both."
        )
    if recording is None and c_header is None:
        raise InputError(
            "There is nothing to write: give RECORDING and -o DIR, or --c-header FILE.h, or - for lines of CSV or JSON "
            "on standard input."
        )
    if output is not None and recording is not None:
        check_output(output, recording, overwrite=overwrite)
    check_file(c_header, HEADER_SUFFIXES, "The header")


def check_output(folder: Path, recording: Path, *, overwrite: bool) -> None:
    """Check the folder of the result before data are read.

    Raises
    ------
    InputError
        The folder of the recording itself; one that is not empty, unless overwriting is allowed; one that cannot be
        created.
    """
    if folder.resolve() == recording_folder(recording).resolve():
        raise InputError(f"The folder {folder} holds the recording itself: name another.")
    check_recording_target(folder, overwrite=overwrite)


def load_fit(path: Path, *, force: bool, trust: bool) -> Calibration:
    """Load a calibration that can be applied.

    Parameters
    ----------
    force : bool
        Accept any status.
    trust : bool
        Accept a file that was changed after it was written.

    Raises
    ------
    InputError
        A file that cannot be read, or without values; unless forced, a status other than "converged" and "partial", or
        errors outside the sensor model.
    """
    from srt.model.sensor_model import outside_model
    from srt.result.calibration import load_calibration
    from srt.result.verdict import USABLE

    calibration = load_calibration(path, trust=trust)
    if not calibration.has_values:
        raise InputError(
            f"The calibration {path} has the status {calibration.status} and no values: give one that converged."
        )
    if force:
        return calibration
    if calibration.status not in USABLE:
        raise InputError(
            f"The calibration {path} has the status {calibration.status}: give one that converged, or add --force."
        )
    reason = outside_model(calibration.errors)
    if reason is not None:
        raise InputError(
            f"The calibration {path} says {calibration.status}, but {reason}: it was edited; calibrate again, "
            "or add --force."
        )
    return calibration


def warn_of_unmeasured(calibration: Calibration, calibration_file: Path) -> None:
    """Print a warning that names the parameters which are passed on without a measurement; nothing if all have one."""
    if calibration.fixed:
        from srt.reports.text.calibration import held_summary, passed_on

        warn(f"{calibration_file}: {passed_on(calibration)}; fixed, not observed: {held_summary(calibration)}.")


def check_match(calibration: Calibration, recording: Recording, calibration_file: Path, recording_path: Path) -> None:
    """Raise InputError for the recording of another unit; a serial that is not stated matches any."""
    serial = calibration.provenance.serial
    if None not in (serial, recording.serial) and serial != recording.serial:
        raise InputError(
            f"The calibration {calibration_file} is of the unit {serial}, but the recording {recording_path} of "
            f"{recording.serial}: name that unit's calibration, or add --force."
        )


def at_mean_temperature(calibration: Calibration, recording: Recording) -> Calibration:
    """Calibration at the mean temperature of a recording, if it is one over temperature. Raises InputError."""
    if calibration.thermal is None:
        return calibration
    if recording.temperature is None:
        raise InputError(
            "The errors of this calibration depend on temperature, and the recording has none: record it with the "
            "samples, state temperature_c in recording.toml, or take the errors of one temperature "
            "('srt thermal UNIT.json --at T -o UNIT-T.json')."
        )
    calibration.thermal.require_inside(recording.temperature, "The recording")
    return calibration.at(float(recording.temperature.mean()))


def check_rests(
    calibration: Calibration, recording: Recording, calibration_file: Path, recording_path: Path
) -> CorrectedRest | None:
    """Compare a recording at rest before and after the correction; None if it has no stationary window.

    Raises InputError if the correction makes it clearly worse, and DataError for accelerometers in a wrong unit.
    """
    from srt.diagnosis.corrected_rest import corrected_rest

    check_median_force(recording)
    found = corrected_rest(calibration, recording)
    if found is not None and found.worse:
        raise InputError(
            f"{recording_path}: {calibration_file} makes it worse ({found}): it is the calibration of another unit, or "
            "this one has changed; name the unit's own, or add --force."
        )
    return found


def correct(calibration: Calibration, recording: Recording, frame: Any, *, check: bool) -> Recording:
    """Correct a recording.

    Parameters
    ----------
    frame : "mars" or "table"
    check : bool
        Refuse readings whose size fits the other kind of samples.

    Returns
    -------
    Recording
        Corrected samples with the pulses of the readings, and without the stated ranges, which apply to raw readings.

    Raises
    ------
    InputError
        No table frame, or errors that cannot be inverted.
    DataError
        Increments given as rates or the reverse, or accelerometers in a wrong unit.
    """
    from dataclasses import replace

    from srt.noise.quantization import reading_steps
    from srt.result.applier import Applier

    increments = recording.kind == "increment"
    dt = recording.interval_s if increments else None
    if check:
        check_median_force(recording)
    if calibration.thermal is None:
        gyro, accel = Applier(calibration, frame=frame).apply(recording.gyro, recording.accel, dt=dt)
    else:
        at_mean_temperature(calibration, recording)
        choices = {"kind": recording.kind, "dt": dt, "frame": frame, "temperature_c": recording.temperature}
        gyro, accel = calibration.apply(recording.gyro, recording.accel, **choices)
    # The correction mixes the steps of three axes, so that corrected readings do not show their pulses any more.
    steps = reading_steps(recording).reshape(2, 3).max(axis=1).tolist()
    pulses = zip(("gyro_quantization", "accel_quantization"), steps, strict=True)
    unstated = {key: pulse for key, pulse in pulses if pulse and getattr(recording.noise, key) is None}
    noise = replace(recording.noise, gyro_range=None, accel_range=None, **unstated)
    # These readings have had more than the correction that the logger applied.
    return replace(recording, gyro=gyro, accel=accel, noise=noise, applied=None)


def samples_suffix(recording: Path) -> str:
    """Format of the samples of a recording; CSV if there is no writer for it."""
    import tomllib

    from srt.recording.folder import TOML_NAME
    from srt.recording.samples import SAMPLES_FORMATS

    with (recording_folder(recording) / TOML_NAME if recording.is_dir() else recording).open("rb") as file:
        suffix = Path(tomllib.load(file)["recording"]["samples"]).suffix.lower().lstrip(".")
    return suffix if suffix in SAMPLES_FORMATS else "csv"
