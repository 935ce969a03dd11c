"""``srt export``: a calibration in the format of another tool, with the remaining difference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from srt.cli.apply import check_match, load_fit, warn_of_unmeasured
from srt.cli.grouped_command import GroupedCommand
from srt.cli.messages import announce, say, show, warn
from srt.cli.names import Name
from srt.cli.output_paths import check_directory, check_file, make_directory
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.exceptions import InputError, SrtError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from srt.exporters.conversion import ExportedCalibration
    from srt.exporters.correction_difference import Readings
    from srt.exporters.file_format import Exporter
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration


_USUAL = (
    "targets",
    "output",
    "recording",
    "frame",
    "topic",
    "gyro_random_walk",
    "accel_random_walk",
    "applied",
    "list",
)
"""Options of the short help."""


def _list(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if not wanted or context.resilient_parsing:
        return
    from srt.exporters import exporters
    from srt.reports.tables import text_table

    rows = [(name, item.title, ", ".join(item.frames)) for name, item in exporters().items()]
    show(text_table(("target", "what is written", "axes"), rows, "lll"))
    context.exit()


@click.command("export", cls=GroupedCommand, usual=_USUAL)
@click.argument("calibration_file", metavar="CALIBRATION", type=PATH)
@click.option(
    "--to",
    "targets",
    required=True,
    multiple=True,
    type=Name("targets"),
    metavar="TARGET",
    help="Format to write; see --list. Repeatable.",
)
@click.option("-o", "--output", type=PATH, help="File to write, or a folder for several; default: only the report.")
@click.option("--recording", type=PATH, help="Raw readings on which the difference is measured.")
@click.option(
    "--frame", type=click.Choice(("mars", "table", "accel")), help="Axes of the file, where there is a choice."
)
@click.option("--fit-asymmetry", is_flag=True, help="Fit the scale factors to the motion of RECORDING.")
@click.option("--topic", help="Topic of the readings, for formats that name it.  [default: /imu0]")
@click.option("--rate-hz", type=float, help="Sample rate; default: the recording's.")
@click.option("--gyro-random-walk", type=float, help="Random walk of the gyro biases, rad/s^2/sqrt(Hz).")
@click.option("--accel-random-walk", type=float, help="Random walk of the accelerometer biases, m/s^3/sqrt(Hz).")
@click.option("--prefix", help="Prefix of the names in a C header.  [default: imu]")
@click.option("--precision", type=click.Choice(("double", "float")), help="Numbers of a C header.")
@click.option("--samples", type=click.Choice(("both", "rate", "increment")), help="Functions of a C header.")
@click.option("--namespace", help="Namespace of C++ around a C header.")
@click.option("--inflate", type=float, help="Factor on noise densities and random walks.  [default: 1]")
@click.option("--instance", type=int, help="Number of the IMU of an autopilot, from 0; default: that of the log.")
@click.option(
    "--applied",
    metavar="FORMAT:FILE",
    help="Correction that the readings had before they were logged, or none; default: that in the recording.",
)
@click.option("--temperature", type=float, metavar="°C", help="Errors at it, of a calibration over temperature.")
@click.option("--force", is_flag=True, help="Accept an inconsistent calibration and any serial.")
@click.option("--trust", is_flag=True, help="Accept a calibration file that was changed after it was written.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No report.")
@click.option("--list", is_flag=True, is_eager=True, expose_value=False, callback=_list, help="Show the targets.")
def export(
    calibration_file: Path,
    targets: tuple[str, ...],
    output: Path | None,
    quiet: bool,
    **choices: Any,
) -> int:
    """Write CALIBRATION, the JSON file of 'srt calibrate -o', in the format of another tool.

    The file is read back and applied by the formula of the tool to the recording (or to 1 rad/s and 1 g in all
    directions); the difference from 'srt apply' is shown.

    An autopilot or a unit may have corrected the readings before they were logged. The parameters or registers that
    are written replace its own and include their correction. Where the recording does not state that correction,
    --applied names its file (px4:vehicle.params); 'none' says that the log holds uncorrected readings.

    Exit codes: 0 success; 1 a file that does not reproduce the calibration; 2 wrong usage, unreadable input, or a
    calibration that the format cannot represent.
    """
    from srt.exporters.registry import exporter

    chosen = {name: exporter(name) for name in targets}
    if len(chosen) == 1:
        return export_one(calibration_file, targets[0], output, quiet=quiet, **choices)
    if output is not None:
        if output.suffix:
            raise InputError(
                f"Files for several tools go to a folder, and {output} is called like a file: name another."
            )
        check_directory(output)
        make_directory(output)
    for number, (name, item) in enumerate(chosen.items()):
        if number and not quiet:
            show()
        place = None if output is None else output / f"{name}{item.suffixes[0]}"
        # An option of other formats alone is not for this one; one of no format is refused by the first.
        others = {option for other in chosen.values() for option in other.options} - item.options
        fitting: dict[str, Any] = {option: None if option in others else value for option, value in choices.items()}
        export_one(calibration_file, name, place, quiet=quiet, **fitting)
    return 0


def export_one(
    calibration_file: Path,
    target: str,
    output: Path | None,
    *,
    recording: Path | None,
    frame: str | None,
    fit_asymmetry: bool,
    applied: str | None,
    temperature: float | None,
    force: bool,
    trust: bool,
    quiet: bool,
    **settings: Any,
) -> int:
    """Write a calibration in the format of one tool; parameters as the options of the command."""
    from srt.exporters.applied_file import applied_of
    from srt.exporters.conversion import export as make
    from srt.exporters.conversion import save
    from srt.exporters.export_model import ExportSettings
    from srt.exporters.registry import exporter

    chosen = exporter(target)
    if output is not None:
        _check_output(chosen, output, calibration_file)
    if fit_asymmetry and recording is None:
        raise InputError("--fit-asymmetry needs the motion to fit to: add --recording DIR.")
    calibration = load_fit(calibration_file, force=force, trust=trust)
    if temperature is not None:
        calibration = calibration.at(temperature)
    if calibration.thermal is not None:
        return _export_curves(calibration, target, output, instance=settings["instance"] or 0, quiet=quiet)
    readings, measured_rate = None, None
    if recording is not None:
        readings, measured_rate = _readings(calibration, calibration_file, recording, force=force)
    if settings["rate_hz"] is None and "rate_hz" in chosen.options:
        settings["rate_hz"] = measured_rate
    made = make(
        calibration,
        target,
        readings=readings,
        frame=frame,
        asymmetry="fit" if fit_asymmetry else "leave",
        settings=ExportSettings(**settings),
        applied=None if applied is None else applied_of(applied, settings["instance"]),
    )
    written = () if output is None else save(made, output)
    warn_of_unmeasured(calibration, calibration_file)
    warn_of_unknown(made)
    if not quiet:
        from srt.reports.text.exported_calibration import export_text

        show(export_text(made))
        show("".join(f"\nWritten to {place}" for place in written) or "\nNothing is written: add -o FILE.")
    return 0


def _export_curves(calibration: Calibration, target: str, output: Path | None, *, instance: int, quiet: bool) -> int:
    """Write the offsets of a calibration over temperature as the parameters of an autopilot."""
    from srt.exporters.thermal_offsets import thermal_file
    from srt.recording.atomic_file import atomic_write_text
    from srt.reports.text.thermal import thermal_file_text

    made = thermal_file(calibration, target, instance)
    if output is not None:
        atomic_write_text(output, made.text)
    if not quiet:
        show(thermal_file_text(made))
        show("\nNothing is written: add -o FILE." if output is None else f"\nWritten to {output}")
    return 0


def write_targets(
    calibration: Calibration, folder: Path, targets: Sequence[str], recording: Recording, *, quiet: bool
) -> int:
    """Write a calibration in the formats of other tools, as kalibr.yaml; give the worst exit code.

    A format that cannot hold it, or of which nothing is measured, is told on standard error; the others are written.

    Parameters
    ----------
    recording : Recording
        Raw readings on which the differences are measured.
    """
    from srt.exporters.conversion import export as make
    from srt.exporters.conversion import save
    from srt.exporters.correction_difference import Readings
    from srt.exporters.export_model import ExportSettings
    from srt.exporters.registry import exporter
    from srt.reports.text.exported_calibration import export_summary

    codes = [0]
    empty = [target for target in targets if not exporter(target).measured(calibration.observed)]
    if empty:
        warn(
            f"{', '.join(empty)} {'was' if len(empty) == 1 else 'were'} not written: the log is too short or has too "
            "few turns, so that nothing of what such a file holds (scale factors, misalignments) is measured; record "
            "20 to 30 turns between rests."
        )
    readings = Readings.of(recording, "the recording")
    for target in (each for each in targets if each not in empty):
        chosen = exporter(target)
        rate_hz = 1.0 / recording.nominal_interval_s if "rate_hz" in chosen.options else None
        try:
            made = make(calibration, target, readings=readings, settings=ExportSettings(rate_hz=rate_hz))
            written = save(made, target_path(folder, chosen))
        except SrtError as error:
            say(f"{target} was not written: {error}")
            codes.append(error.exit_code)
            continue
        warn_of_unknown(made)
        if not quiet:
            show(f"\n{export_summary(made)}")
        announce(*written, quiet=quiet)
    return max(codes)


def writable_targets(targets: Sequence[str], recording: Recording) -> tuple[tuple[str, ...], int]:
    """Targets whose files do not lack the correction that the log was made under; exit code for the others.

    Those are told on standard error. Raises InputError if no target is left.
    """
    from srt.exporters.conversion import replaced_correction
    from srt.exporters.registry import exporter

    kept, refused = [], {}
    for target in targets:
        try:
            replaced_correction(exporter(target), recording.applied)
        except InputError as error:
            refused[target] = error
        else:
            kept.append(target)
    if refused and not kept:
        raise next(iter(refused.values()))
    for target, reason in refused.items():
        say(f"{target} will not be written: {reason}")
    return tuple(kept), InputError.exit_code if refused else 0


def target_path(folder: Path, chosen: Exporter) -> Path:
    """Path of the file of a format beside a calibration, as kalibr.yaml."""
    return folder / f"{chosen.name}{chosen.suffixes[0]}"


def warn_of_unknown(made: ExportedCalibration) -> None:
    """Print a warning that names the values which the format requires and nothing states; nothing if there are all."""
    if made.unknown:
        warn(f"{made.format.title}: left out of the file, as they are not known: {'; '.join(made.unknown)}.")


def _check_output(chosen: Exporter, output: Path, calibration: Path) -> None:
    from srt.exporters.conversion import part_paths

    for place in part_paths(chosen, output).values():
        if place.resolve() == calibration.resolve():
            raise InputError(f"{place} is the calibration itself: name another file.")
        check_file(place, chosen.suffixes, f"The {chosen.name} file")


def _readings(
    calibration: Calibration, calibration_file: Path, path: Path, *, force: bool
) -> tuple[Readings, float | None]:
    from srt.exporters.correction_difference import Readings
    from srt.recording.folder import load_recording

    recording = load_recording(path)
    if not force:
        check_match(calibration, recording, calibration_file, path)
    return Readings.of(recording, str(path)), 1.0 / recording.nominal_interval_s
