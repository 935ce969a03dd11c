"""Calibration, readings and their correction for the tests of streams."""

import numpy as np
from g_sensitive import with_g_sensitivity

import srt
from srt.result.provenance import Temperature
from srt.sensor_errors import N_PARAMETERS, SensorErrors
from srt.stacks.stream_correction import StreamCorrector, StreamOptions

RNG = np.random.default_rng(1)
CALIBRATION = srt.Calibration(
    "hand",
    "converged",
    "Done.",
    SensorErrors(RNG.normal(0.0, 0.01, N_PARAMETERS)),
    1e-8 * np.eye(N_PARAMETERS),
    temperature=Temperature(25.0, 2.0),
    diagnostics=with_g_sensitivity(RNG.normal(0.0, 1e-4, (3, 3))),
)
N = 40
Y = np.column_stack([RNG.normal(size=(N, 3)), 9.8 * RNG.normal(size=(N, 3))])
TRUE = np.hstack(CALIBRATION.apply(Y[:, :3], Y[:, 3:]))
TIME = 0.01 * np.arange(1, N + 1)


def corrector(told, **options):
    return StreamCorrector(CALIBRATION, "mars", StreamOptions(**options), told.append)


def csv(values=Y, stamps=TIME):
    """Lines of time and readings."""
    return [",".join(map(repr, (t, *row))) for t, row in zip(stamps.tolist(), values.tolist(), strict=True)]


def numbers(lines):
    """Cells of lines, shape (n, m)."""
    return np.array([[float(cell) for cell in line.split(",")] for line in lines])
