"""A calibration in the formats of others: written, read back, applied by their formula, and what that leaves said.

Formats are in :mod:`srt.exporters.registry`, the work is done by :mod:`srt.exporters.exporting`.
"""

from __future__ import annotations

from srt.exporters.exporting import Exported, Loaded, export, load, save
from srt.exporters.preintegration import gtsam_preintegration
from srt.exporters.registry import exporter, exporters
from srt.exporters.residual import Readings, Residual
from srt.exporters.source import Settings

__all__ = [
    "Exported",
    "Loaded",
    "Readings",
    "Residual",
    "Settings",
    "export",
    "exporter",
    "exporters",
    "gtsam_preintegration",
    "load",
    "save",
]
