"""Certificates: the calibration of one unit, for the user of the unit, as HTML and as PDF."""

from srt.reports.certificate.acceptance_limits import AcceptanceLimits, load_acceptance_limits
from srt.reports.certificate.calibration_file import CalibrationFile, load_calibration_file
from srt.reports.certificate.content import Certificate, make_certificate

__all__ = [
    "AcceptanceLimits",
    "CalibrationFile",
    "Certificate",
    "load_acceptance_limits",
    "load_calibration_file",
    "make_certificate",
]
