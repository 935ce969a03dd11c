"""Results as pandas tables, in the units that the column or a column beside it names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import optional
from srt.recording.import_options import TRIADS
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, NAMES, SYMBOLS

with optional("pandas", "pandas", "A table of pandas"):
    import pandas as pd

if TYPE_CHECKING:
    from srt.comparison.estimator_comparison import Comparison
    from srt.recording.recording import Recording
    from srt.reports.certificate.content import Certificate
    from srt.reports.inspection import Inspection
    from srt.result.calibration import Calibration

_FACTORS: Final = np.array(DISPLAY_FACTORS)


def samples_frame(recording: Recording) -> pd.DataFrame:
    """Samples of a recording, SI, with the channels of a table of samples as columns; :func:`srt.read` takes it."""
    columns: dict[str, Any] = {"time": recording.time}
    for sensor, channels in TRIADS.items():
        columns |= dict(zip(channels, getattr(recording, sensor).T, strict=True))
    if recording.temperature is not None:
        columns["temperature"] = recording.temperature
    return pd.DataFrame(columns)


def parameter_frame(calibration: Calibration) -> pd.DataFrame:
    """Parameters of a calibration by name: symbol, value, sigma, unit, and the reason of fixed ones."""
    return frame_by_parameter(
        symbol=list(SYMBOLS),
        value=calibration.values * _FACTORS,
        sigma=calibration.as_written.sigma * _FACTORS,
        unit=list(DISPLAY_UNITS),
        fixed=[calibration.as_written.fixed.get(name, "") for name in NAMES],
    )


def comparison_frame(comparison: Comparison) -> pd.DataFrame:
    """Parameters by name: value and sigma of every estimator, and differences over their expected sigma."""
    columns: dict[str, Any] = {"unit": list(DISPLAY_UNITS)}
    for name, calibration in comparison.calibrations.items():
        columns[f"{name} value"] = calibration.values * _FACTORS
        columns[f"{name} sigma"] = calibration.sigma * _FACTORS
    columns |= {f"{name} difference / sigma": pair.normalised for name, pair in comparison.differences.items()}
    return frame_by_parameter(**columns)


def certificate_frame(certificate: Certificate) -> pd.DataFrame:
    """Table of the parameters of a certificate, as its texts."""
    table = certificate.parameters
    return pd.DataFrame(table.texts, columns=list(table.head)).set_index("parameter")


def manoeuvre_frame(inspection: Inspection) -> pd.DataFrame:
    """Manoeuvres of an inspection: times, rotations, fastest rate, and the sequence that was recognised."""
    rows = [
        {
            "start_s": turn.start_s,
            "end_s": turn.end_s,
            "rotations": ", ".join(f"{leg.angle_deg:+.1f}° {leg.axis or 'oblique'}" for leg in turn.parts),
            "fastest_deg_s": turn.fastest_deg_s,
            "sequence": turn.sequence,
            "labelled": turn.labelled,
        }
        for turn in inspection.turns
    ]
    names = ["start_s", "end_s", "rotations", "fastest_deg_s", "sequence", "labelled"]
    return pd.DataFrame(rows, columns=names)


def frame_by_parameter(**columns: Any) -> pd.DataFrame:
    """Table with a row for every parameter, by name."""
    return pd.DataFrame(columns, index=pd.Index(NAMES, name="parameter"))
