"""Certificates: the calibration of one unit, for the user of the unit, as HTML and as PDF."""

from srt.reports.certificate.acceptance_limits import AcceptanceLimits, load_acceptance_limits
from srt.reports.certificate.calibration_file import CalibrationFile, calibration_file
from srt.reports.certificate.content import Certificate, make_certificate

__all__ = [
    "AcceptanceLimits",
    "CalibrationFile",
    "Certificate",
    "calibration_file",
    "load_acceptance_limits",
    "make_certificate",
]
