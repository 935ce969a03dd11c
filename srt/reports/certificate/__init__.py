"""Certificates: what a calibration found of one unit, for the person who gets the unit with it, as HTML and as PDF."""

from srt.reports.certificate.checked import Source, load_source
from srt.reports.certificate.content import Certificate, make_certificate
from srt.reports.certificate.limits import Limits, load_limits

__all__ = ["Certificate", "Limits", "Source", "load_limits", "load_source", "make_certificate"]
