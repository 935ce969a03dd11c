"""Export of calibrations to the formats of other software, import from them, and the error of the conversion.

The formats are in :mod:`srt.exporters.registry`, the conversion in :mod:`srt.exporters.conversion`.
"""

from __future__ import annotations

from srt.exporters.conversion import ExportedCalibration, ImportedCalibration, export, load, save
from srt.exporters.correction_difference import CorrectionDifference, Readings
from srt.exporters.export_model import ExportSettings
from srt.exporters.preintegration import gtsam_preintegration
from srt.exporters.registry import exporter, exporters

__all__ = [
    "CorrectionDifference",
    "ExportSettings",
    "ExportedCalibration",
    "ImportedCalibration",
    "Readings",
    "export",
    "exporter",
    "exporters",
    "gtsam_preintegration",
    "load",
    "save",
]
