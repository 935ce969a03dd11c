"""``srt align-mount``: angles between the sensor axes and the mount."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from srt.cli.apply import check_match, load_fit
from srt.cli.messages import show, warn
from srt.cli.output_paths import check_file
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.exceptions import InputError

if TYPE_CHECKING:
    from pathlib import Path

RESULT_SUFFIXES = (".json",)


@click.command("align-mount")
@click.argument("recording_path", metavar="[RECORDING]", required=False, type=PATH)
@click.option(
    "--calibration", "calibration_file", required=True, metavar="UNIT.json", type=PATH, help="Calibration of the unit."
)
@click.option("-o", "--output", type=PATH, metavar="FILE.json", help="Result: FILE.json.")
@click.option(
    "--level-sigma-mrad",
    type=float,
    metavar="MRAD",
    help="1-sigma of the levelling of the mount; default: 1, or √2 times alignment_sigma_mrad of the recording.",
)
@click.option(
    "--axis-sigma-mrad",
    type=float,
    metavar="MRAD",
    help="1-sigma of tilt and squareness of the axis; default: 1, or alignment_sigma_mrad of the recording.",
)
@click.option("--force", is_flag=True, help="Accept an inconsistent calibration and any serial.")
@click.option("--trust", is_flag=True, help="Accept a calibration file that was changed after it was written.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No table; warnings and errors only.")
def align_mount(
    recording_path: Path | None,
    calibration_file: Path,
    output: Path | None,
    level_sigma_mrad: float | None,
    axis_sigma_mrad: float | None,
    force: bool,
    trust: bool,
    quiet: bool,
) -> int:
    """Find the three angles between the sensor axes and the mount.

    RECORDING holds raw readings in static poses: the mount levelled (z down), and pitched by about 90 degrees (x down
    or up). Labels are not needed, and poses may repeat. Without RECORDING, the angles follow from the test on
    the two-axis fixture that gave the calibration, to the accuracy of that fixture.

    Exit codes: 0 success; 1 the recording cannot support a result; 2 wrong usage, unreadable input, or a calibration
    that does not fit the recording.
    """
    if output is not None:
        if output.resolve() == calibration_file.resolve():
            raise InputError(f"{output} is the calibration itself: name another file.")
        check_file(output, RESULT_SUFFIXES, "The mount alignment")
    from srt.recording.schema import LARGEST_SIGMA_MRAD

    sigmas = {"--level-sigma-mrad": level_sigma_mrad, "--axis-sigma-mrad": axis_sigma_mrad}
    for name, value in sigmas.items():
        if value is not None and not 0.0 < value <= LARGEST_SIGMA_MRAD:
            raise InputError(
                f"{name} is {value:g}, but a positive number of milliradians, of at most {LARGEST_SIGMA_MRAD:g}, is "
                "expected."
            )
        if value is not None and recording_path is None:
            raise InputError(f"{name} applies to static poses: name their RECORDING, or leave the option out.")
    calibration = load_fit(calibration_file, force=force, trust=trust)
    if recording_path is None:
        from srt.mount.alignment import mount_from_calibration

        mount = mount_from_calibration(calibration)
    else:
        from srt.mount.poses import mount_from_recording
        from srt.recording.folder import load_recording

        recording = load_recording(recording_path)
        if not force:
            check_match(calibration, recording, calibration_file, recording_path)
        level, axis = (None if value is None else 1e-3 * value for value in sigmas.values())
        mount = mount_from_recording(recording, calibration, level_sigma_rad=level, axis_sigma_rad=axis)
    if output is not None:
        mount.save(output)
    for sentence in mount.warnings:
        warn(sentence)
    if not quiet:
        from srt.reports.text.mount_alignment import mount_alignment_text

        show(mount_alignment_text(mount))
        show("\nNothing was written: -o FILE.json keeps the result." if output is None else f"\nWritten: {output}")
    return 0
