"""Issue of a certificate: its inputs, from files or from memory, and its two files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from srt.exceptions import InputError
from srt.recording.atomic_file import atomic_paths
from srt.recording.reading import read
from srt.reports.certificate.acceptance_limits import load_acceptance_limits
from srt.reports.certificate.calibration_file import calibration_file, changes_since
from srt.reports.certificate.content import make_certificate
from srt.reports.certificate.laboratory import load_laboratory
from srt.reports.certificate.recording_history import check_recording, recording_history
from srt.result.verdict import USABLE

if TYPE_CHECKING:
    import os

    from srt.reports.certificate.content import Certificate
    from srt.result.calibration import Calibration

    PathLike = str | os.PathLike[str]


def certificate(
    calibration: Calibration | PathLike,
    recording: Any = None,
    *,
    limits: PathLike | None = None,
    against: Calibration | PathLike | None = None,
    laboratory: PathLike | None = None,
    output: PathLike | None = None,
    **stated: Any,
) -> Certificate:
    """Certificate of a calibrated unit.

    Parameters
    ----------
    calibration : Calibration, or path-like of the file of one
    recording : Recording, path-like, or arrays, optional
        Samples of the calibration, told by their digest: the certificate shows their course.
    limits : path-like, optional
        TOML file of the limits that the unit must meet.
    against : Calibration, or path-like of the file of one, optional
        Earlier calibration of the unit.
    laboratory : path-like, optional
        TOML file of the statements of the laboratory: parties, equipment, references, conditions, coverage factor.
    output : path-like, optional
        Page to write, FILE.html; the PDF is written beside it.
    **stated
        Keywords of :func:`srt.read`.

    Raises
    ------
    InputError
        Inputs that cannot be read or do not belong together.
    DataError
        A calibration that did not converge.
    MissingExtraError
        If files are to be written, without the packages that draw and write them.
    """
    source = calibration_file(calibration)
    given = None if limits is None else load_acceptance_limits(Path(limits))
    change = None if against is None else changes_since(source, calibration_file(against))
    stated_by = None if laboratory is None else load_laboratory(Path(laboratory))
    course = None
    if recording is not None and source.calibration.status in USABLE:
        samples = read(recording, **stated)
        title = samples.source or "the recording"
        check_recording(source, samples, title)
        course = recording_history(source, samples, title)
    made = make_certificate(source, course=course, limits=given, change=change, laboratory=stated_by)
    if output is not None:
        page = Path(output)
        if page.suffix.lower() != ".html":
            raise InputError(f"The certificate cannot be written as {page}: name a file that ends in .html.")
        write_certificate(made, page)
    return made


def write_certificate(made: Certificate, page: Path) -> None:
    """Write the page, .html, and the PDF beside it, each complete or not at all, and neither unless both can be made.

    Raises SrtError.
    """
    from srt.reports.certificate.html_page import html_page
    from srt.reports.certificate.pdf import write_pdf

    text = html_page(made)
    with atomic_paths(page.with_suffix(".pdf"), page) as (document, temporary):
        write_pdf(made, document)
        temporary.write_bytes(text.encode("utf-8"))
