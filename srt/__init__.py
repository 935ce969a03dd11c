"""Calibration of inertial measurement units by Savage's improved strapdown rotation test (SRT).

Conventions, everywhere in this package:

* B: IMU body frame = MARS frame, in which the gyro scale and misalignment matrix is symmetric. B_Strt, B_End: B frozen
  to the Earth at the start / end of a sequence. T: table-mounted body frame, z along the fixture's inner axis.
  NED: local north, east, down. ``C_ab`` takes b-components to a-components.
* Specific force f at rest points up: f = −g u_dwn. Gravity g is a positive magnitude.
* SI units inside (rad, rad/s, m/s², s); a name at a border carries its unit (``latitude_deg``).
* Readings: ω̃ = Mg ω + κ_Asym ∘ |ω| + κ_Bias, f̃ = Ma f + λ_Asym ∘ |f| + λ_Bias; the 27 errors and their order are in
  :mod:`srt.sensor_errors`.
* Arrays of samples have the shape (n, 3), states (27,), covariances (27, 27).
"""

from srt.calibration import Calibration, load_calibration
from srt.estimation import calibrate, estimators
from srt.exceptions import DataError, InputError, MissingExtraError, SrtError
from srt.options import Options
from srt.recording import Fixture, ImuNoise, Recording, SequenceLabel, Site
from srt.recording_io import load_recording, write_recording
from srt.sensor_errors import SensorErrors

__all__ = [
    "Calibration",
    "DataError",
    "Fixture",
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
    "estimators",
    "load_calibration",
    "load_recording",
    "write_recording",
]
