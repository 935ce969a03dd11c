"""``srt align-mount``: how the sensor axes stand in the mount."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from srt.cli.apply import check_match, load_fit
from srt.cli.output import check_file, warn
from srt.exceptions import InputError

if TYPE_CHECKING:
    from srt.mount.alignment import MountAlignment

RESULT_SUFFIXES = (".json",)

SOURCE_LABELS = {
    "accel_noise": "acc. noise",
    "calibration": "calibration",
    "levelling": "levelling",
    "axis_tilt": "axis tilt",
    "squareness": "axis square",
    "fixture": "fixture",
}
POSE_LABELS = {"level": "level", "nose_down": "pitched, x down", "nose_up": "pitched, x up"}


@click.command("align-mount")
@click.argument("recording_path", metavar="[RECORDING]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--calibration",
    "calibration_file",
    required=True,
    metavar="UNIT.json",
    type=click.Path(path_type=Path),
    help="Calibration of the unit.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE.json", help="Result.")
@click.option(
    "--level-sigma-mrad",
    type=float,
    metavar="MRAD",
    help="One sigma of the mount's levelling; default 1, or √2 of the recording's alignment_sigma_mrad.",
)
@click.option(
    "--axis-sigma-mrad",
    type=float,
    metavar="MRAD",
    help="One sigma of the axis, tilt and squareness to the mount; default 1, or alignment_sigma_mrad.",
)
@click.option("--force", is_flag=True, help="Whatever the calibration's status and the serial.")
@click.option("-q", "--quiet", is_flag=True, help="No table; warnings and errors only.")
def align_mount(
    recording_path: Path | None,
    calibration_file: Path,
    output: Path | None,
    level_sigma_mrad: float | None,
    axis_sigma_mrad: float | None,
    force: bool,
    quiet: bool,
) -> int:
    """Find the three angles between the sensor axes and the mount.

    RECORDING holds the raw readings of the unit on a levelled mount (z down) and pitched by about 90 degrees (x down
    or up), standing still in each; labels are not needed, and stands may repeat. Without RECORDING the angles are
    those that the calibration's own test found on its two-axis fixture, to the fixture's accuracy.

    Exit codes: 0 success; 1 the recording cannot support a result; 2 wrong usage, unreadable input, or a calibration
    that does not fit the recording.
    """
    if output is not None:
        check_file(output, RESULT_SUFFIXES, "The mount alignment")
        if output.resolve() == calibration_file.resolve():
            raise InputError(f"{output} is the calibration itself, which shall stay as it is: name another file.")
    sigmas = {"--level-sigma-mrad": level_sigma_mrad, "--axis-sigma-mrad": axis_sigma_mrad}
    for name, value in sigmas.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise InputError(f"{name} is {value:g}, but a positive number of milliradians is expected.")
        if value is not None and recording_path is None:
            raise InputError(f"{name} belongs to a stand: name the RECORDING of it, or leave the option out.")
    calibration = load_fit(calibration_file, force=force)
    if recording_path is None:
        from srt.mount.alignment import mount_from_calibration

        mount = mount_from_calibration(calibration)
    else:
        import srt
        from srt.mount.poses import mount_from_recording

        recording = srt.load_recording(recording_path)
        if not force:
            check_match(calibration, recording, calibration_file, recording_path)
        level, axis = (None if value is None else 1e-3 * value for value in sigmas.values())
        mount = mount_from_recording(recording, calibration, level_sigma_rad=level, axis_sigma_rad=axis)
    if output is not None:
        mount.save(output)
    for sentence in mount.warnings:
        warn(sentence)
    if not quiet:
        click.echo(report(mount))
        click.echo(
            "\nNothing was written: -o FILE.json keeps the result." if output is None else f"\nWritten: {output}"
        )
    return 0


def report(mount: MountAlignment) -> str:
    """Write a mount alignment as text: the angles with their sigmas by source, and the stands."""
    import numpy as np

    from srt.mount.alignment import ANGLES
    from srt.reports.text.tables import decimals_for, fixed, text_table

    rows = []
    by_source = np.array(list(mount.sources.values()))
    for i, name in enumerate(ANGLES):
        value, sigma = 1e3 * float(mount.angles_rad[i]), 1e3 * float(mount.sigma_rad[i])
        places = decimals_for(sigma)
        parts = [fixed(1e3 * float(s), max(places, 3)) for s in by_source[:, i]]
        rows.append([name, fixed(value, places), fixed(sigma, places), *parts])
    headers = ["mrad", "angle", "sigma", *(SOURCE_LABELS.get(name, name).replace(" ", "\n") for name in mount.sources)]
    text = ["Sensor axes in the mount", text_table(headers, rows, "l" + "r" * (len(headers) - 1))]
    if mount.stands:
        stands = [
            [
                POSE_LABELS[stand["pose"]],
                f"{stand['start_s']:.2f}",
                f"{stand['end_s']:.2f}",
                f"{stand['pitch_deg']:+.3f}",
                fixed(1e6 * stand["residual_rad"], 1),
            ]
            for stand in mount.stands
        ]
        text.append(text_table(["stand", "from s", "to s", "pitch °", "left µrad"], stands, "lrrrr"))
    else:
        text.append("From the play-back of the two-axis test (U): as accurate as the fixture's alignment.")
    return "\n\n".join(text)
