"""Samples that the tests of the importers of logs write and read."""

import importlib
import sys
from pathlib import Path

import numpy as np

from srt.recording.import_options import ImportOptions
from srt.recording.importer_registry import import_file

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
ff = importlib.import_module("foreign_files")

N = 24
STAMPS, VALUES = ff.samples(N)
OTHER = -VALUES
US = ((STAMPS - STAMPS[0]) // 1000 + 1_000_000).astype(np.uint64)
SECONDS = 0.005 * np.arange(N)

IMU_COLUMNS = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
IMU_MESSAGES = [("IMU", "QBffffff", IMU_COLUMNS, ff.imu_rows(US, VALUES))]


def read(path, **options):
    return import_file(path, ImportOptions(**options))[1]


def assert_same(imported, values=VALUES, seconds=SECONDS):
    """Readings to the last bit; stamps to the rounding of a number of a few seconds."""
    np.testing.assert_array_equal(imported.gyro, values[:, :3])
    np.testing.assert_array_equal(imported.accel, values[:, 3:])
    # One rounding of an integer's quotient: half a unit in the last place of 2 s, 2.2e-16 s.
    np.testing.assert_allclose(imported.time - imported.time[0], seconds, rtol=0, atol=1e-15)


def note(imported, part):
    return any(part in each for each in imported.notes)
