"""Calibration of inertial measurement units by Savage's improved strapdown rotation test (SRT).

Conventions, everywhere in this package:

* B: IMU body frame = MARS frame, in which the gyro scale and misalignment matrix is symmetric. B_Strt, B_End: B frozen
  to the Earth at the start / end of a sequence. T: table-mounted body frame, z along the fixture's inner axis.
  NED: local north, east, down. ``C_ab`` takes b-components to a-components.
* Specific force f at rest points up: f = −g u_dwn. Gravity g is a positive magnitude.
* SI units inside (rad, rad/s, m/s², s); names in files and options carry their unit (``latitude_deg``).
* Sensor model: ``ω̃ = Mg ω + κ_Asym ∘ |ω| + κ_Bias``, ``f̃ = Ma f + λ_Asym ∘ |f| + λ_Bias``; :mod:`srt.sensor_errors`
  lists the 27 errors.
* Arrays of samples have the shape (n, 3), states (27,), covariances (27, 27).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from srt.comparison.comparison_run import compare
    from srt.comparison.fleet import calibrate_fleet
    from srt.comparison.merge import merge_calibrations
    from srt.comparison.thermal import calibrate_thermal
    from srt.diagnosis import diagnose
    from srt.estimation.options import Options
    from srt.estimation.registry import estimators
    from srt.exceptions import DataError, InputError, MissingExtraError, SrtError
    from srt.mount.alignment import mount_from_calibration
    from srt.mount.poses import mount_from_recording
    from srt.planning.monitoring.followed_test import FollowedTest
    from srt.planning.task import plan
    from srt.presentation import plot, to_frame
    from srt.procedure import calibrate, noise_terms
    from srt.recording.reading import read
    from srt.recording.reading import read as import_file
    from srt.recording.reading import read as load_recording
    from srt.recording.recording import Fixture, ImuNoise, Recording, SequenceLabel, Site
    from srt.recording.writing import write_recording
    from srt.reports.certificate.issue import certificate
    from srt.reports.inspection import inspect
    from srt.result.applier import Applier
    from srt.result.calibration import Calibration, load_calibration
    from srt.sensor_errors import INDEX, NAMES, SensorErrors
    from srt.sequences.recognition import recognise
    from srt.sequences.stationary_windows import find_turns

_HOME = {
    "Applier": "result.applier",
    "diagnose": "diagnosis",
    "import_file": "recording.reading:read",
    "compare": "comparison.comparison_run",
    "calibrate_fleet": "comparison.fleet",
    "calibrate_thermal": "comparison.thermal",
    "certificate": "reports.certificate.issue",
    "inspect": "reports.inspection",
    "mount_from_calibration": "mount.alignment",
    "mount_from_recording": "mount.poses",
    "noise_terms": "procedure",
    "FollowedTest": "planning.monitoring.followed_test",
    "plan": "planning.task",
    "plot": "presentation",
    "to_frame": "presentation",
    "read": "recording.reading",
    "merge_calibrations": "comparison.merge",
    "recognise": "sequences.recognition",
    "Calibration": "result.calibration",
    "load_calibration": "result.calibration",
    "calibrate": "procedure",
    "estimators": "estimation.registry",
    "DataError": "exceptions",
    "InputError": "exceptions",
    "MissingExtraError": "exceptions",
    "SrtError": "exceptions",
    "Options": "estimation.options",
    "Fixture": "recording.recording",
    "ImuNoise": "recording.recording",
    "Recording": "recording.recording",
    "SequenceLabel": "recording.recording",
    "Site": "recording.recording",
    "load_recording": "recording.reading:read",
    "write_recording": "recording.writing",
    "find_turns": "sequences.stationary_windows",
    "INDEX": "sensor_errors",
    "NAMES": "sensor_errors",
    "SensorErrors": "sensor_errors",
}
"""Module of each public name, and its name there if another.

Modules load on first use, so that `srt --help` does not import numpy."""

__all__ = [
    "INDEX",
    "NAMES",
    "Applier",
    "Calibration",
    "DataError",
    "Fixture",
    "FollowedTest",
    "ImuNoise",
    "InputError",
    "MissingExtraError",
    "Options",
    "Recording",
    "SensorErrors",
    "SequenceLabel",
    "Site",
    "SrtError",
    "calibrate",
    "calibrate_fleet",
    "calibrate_thermal",
    "certificate",
    "compare",
    "diagnose",
    "estimators",
    "find_turns",
    "import_file",
    "inspect",
    "load_calibration",
    "load_recording",
    "merge_calibrations",
    "mount_from_calibration",
    "mount_from_recording",
    "noise_terms",
    "plan",
    "plot",
    "read",
    "recognise",
    "to_frame",
    "write_recording",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("strapdown-rotation-test")
    if name not in _HOME:
        raise AttributeError(f"module 'srt' has no attribute {name!r}")
    module, _, attribute = _HOME[name].partition(":")
    value = getattr(import_module(f"srt.{module}"), attribute or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
