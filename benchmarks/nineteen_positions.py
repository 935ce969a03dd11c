"""19-position test (Xie Bo 2011) without labels, for ``honesty.py``: recordings, and their Cramér-Rao bound.

Recordings by ``benchmarks/foreign_motion.py``: 18 rotations of 90 degrees in 9 s with soft ends, rests of 20 s (60 s at
first), 100 Hz, 0.001 °/√h and 10 µg/√Hz, heading unknown; without and with quadratic terms, lever arms and lag of the
accelerometers. The bound is computed from the motion alone (``benchmarks/motion_bound.py``).
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from foreign_motion import (
    DEG,
    GRAVITY_M_S2,
    NINETEEN_START_DEG,
    PSINS_EXTRAS,
    Grade,
    drawn_errors,
    nineteen_positions,
    recording,
)
from honesty_recordings import truth_of
from motion_bound import Chain, Conditions, Leg, motion_bound
from scipy.spatial.transform import Rotation

from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    import srt

SEED = 20261122
GRADE = Grade(0.001 * DEG / 60.0, 10e-6 * 9.80665, 3e-5, 1.5e-4, 0.2 * DEG / 3600.0, 2e-3)
LATITUDE_RAD = 34.0 * DEG
GRAVITY_SIGMA_M_S2 = 5e-6
CASES = {  # extras, parameters fixed
    "no extras": (None, ("gyro_asymmetry", "accel_asymmetry")),
    # At 1 g, |f| takes up what a quadratic term adds.
    "quadratic terms, lever arms, lag": (PSINS_EXTRAS, ("gyro_asymmetry",)),
}


@cache
def bound(fixed: tuple[str, ...]) -> np.ndarray:
    """Cramér-Rao bound of the 27 errors, 1-sigma, zero for those that are fixed."""
    turns, first_rest_s = nineteen_positions()
    chain = Chain(
        Rotation.from_euler("ZYX", NINETEEN_START_DEG, degrees=True),
        [first_rest_s, *(turn.rest_s for turn in turns)],
        [[Leg(np.array(turn.axis), turn.angle_rad, turn.duration_s)] for turn in turns],
    )
    conditions = Conditions(
        GRADE.gyro_rad_per_sqrt_s, GRADE.accel_m_s2_sqrt_s, GRAVITY_M_S2, GRAVITY_SIGMA_M_S2, LATITUDE_RAD
    )
    return motion_bound([chain], conditions, [n for n in NAMES if not n.startswith(fixed)])


def unit_of(case: str, number: int, *, noise: bool = True) -> tuple[srt.Recording, np.ndarray]:
    """One unit of a case, and its errors."""
    rng = np.random.default_rng((SEED, number))
    errors, grade = drawn_errors(GRADE, rng, asymmetry=False), GRADE if noise else None
    turned = {"start_deg": NINETEEN_START_DEG, "extras": CASES[case][0]}
    return recording(*nineteen_positions(), errors, grade, rng, **turned), truth_of(errors)
