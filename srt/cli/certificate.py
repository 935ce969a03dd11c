"""``srt certificate``: certificate of a calibrated unit, as HTML and as PDF."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from srt.cli.messages import say, show, warn
from srt.cli.output_paths import check_directory, check_file, make_directory
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH
from srt.exceptions import DataError, InputError

PAGE: Final = ".html"
_NO_FOLDER: Final = (".pdf", ".htm", ".json", ".toml", ".txt", ".png", ".svg")
"""Endings of names that are files, not folders."""


@click.command()
@click.argument("calibration_file", metavar="CALIBRATION", type=PATH)
@click.argument("recording_path", metavar="[RECORDING]", required=False, type=PATH)
@click.option(
    "-o",
    "--output",
    type=PATH,
    help="FILE.html, or a folder; default: CALIBRATION-certificate.html in the working directory.",
)
@click.option("--limits", type=PATH, metavar="FILE.toml", help="Limits that the unit must meet.")
@click.option("--against", type=PATH, metavar="OLD.json", help="An earlier calibration of the same unit.")
@click.option("--lab", type=PATH, metavar="FILE.toml", help="Laboratory, equipment, conditions.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No summary; warnings and errors only.")
def certificate(
    calibration_file: Path,
    recording_path: Path | None,
    output: Path | None,
    limits: Path | None,
    against: Path | None,
    lab: Path | None,
    quiet: bool,
) -> int:
    """Make a certificate of the unit that CALIBRATION is of, as one page of HTML and a PDF beside it.

    CALIBRATION is the JSON file that 'srt calibrate -o' wrote, unchanged. With its RECORDING, which the digest of the
    samples identifies, the certificate shows attitude and acceleration over the test.

    FILE.toml has the sections [value] and [sigma], with keys such as gyro_scale_ppm, accel_misalignment_urad,
    accel_bias_ug, gyro_bias_deg_per_h, or gyro_scale_x_ppm for one parameter: the largest absolute value, and the
    largest sigma.

    Exit codes: 0 success; 1 a limit is not met, or limits are given and the verdict on the calibration is doubtful (the
    certificate is written and says so), or the verdict is failed; 2 wrong usage, unreadable or edited input, or a
    recording or an earlier calibration of another unit.
    """
    from srt.reports.tables import wrap
    from srt.result.verdict import DOUBTFUL

    page, document = check_places(calibration_file, output)
    import srt
    import srt.reports.certificate.html_page
    import srt.reports.certificate.pdf  # a missing extra is reported before the samples are read
    from srt.recording.folder import read_document
    from srt.reports.certificate.issue import write_certificate

    if recording_path is not None:
        read_document(recording_path)  # a log in another format is to be converted
    made = srt.certificate(calibration_file, recording_path, limits=limits, against=against, laboratory=lab)
    make_directory(page.parent)
    write_certificate(made, page)
    if not made.source.serial:
        warn(f"{calibration_file}: the certificate names no unit: state serial in recording.toml, and calibrate again.")
    if made.change is not None and made.change.names:
        warn(f"{calibration_file}: changed significantly: {', '.join(made.change.names)}.")
    if not quiet:
        show("\n".join(line for sentence in made.summary for line in wrap(sentence)))
        show(f"Written: {page}, {document}")
    if made.failed:
        from srt.sensor_errors import INDEX, SYMBOLS

        names = ", ".join(f"{name} ({SYMBOLS[INDEX[name]]})" for name in made.failed)
        say(f"{calibration_file}: the limits of {limits} are not met by {names}.")
        return DataError.exit_code
    if made.outcome == DOUBTFUL:
        say(f"{calibration_file}: the limits of {limits} cannot be passed by a doubtful calibration.")
        return DataError.exit_code
    return 0


def check_places(calibration_file: Path, output: Path | None) -> tuple[Path, Path]:
    """Paths of the page and of the PDF, checked before data are read.

    Parameters
    ----------
    output : Path or None
        As on the command line.

    Returns
    -------
    page, document : Path

    Raises
    ------
    InputError
    """
    name = f"{calibration_file.stem}-certificate{PAGE}"
    if output is None:
        page = Path(name)
    elif output.suffix.lower() == PAGE and not output.is_dir():
        page = output
    elif output.suffix.lower() in _NO_FOLDER and not output.is_dir():
        raise InputError(
            f"The certificate cannot be written as {output}: name a file that ends in {PAGE}, or a folder."
        )
    else:
        check_directory(output)
        page = output / name
    document = page.with_suffix(".pdf")
    if page.parent.is_dir() or output is None or page == output:
        check_file(page, (PAGE,), "The certificate")
        check_file(document, (".pdf",), "The certificate")
    return page, document
