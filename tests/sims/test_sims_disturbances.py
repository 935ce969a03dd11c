"""A tilt step of a simulated test, against the run of a body that is mounted otherwise."""

import math

import numpy as np
import pytest
from injected_faults.disturbances import tilt_step
from scipy.spatial.transform import Rotation

import sims
from srt.recording.recording import Site

IDS = ("7", "13", "6")
TILT = np.array([1e-3, -2e-3, 0.5e-3])
U = Rotation.from_rotvec([0.2, -0.1, 0.3])
DRAW = sims.draw_fixture(
    np.random.default_rng(5),
    sims.table_sequences(IDS),
    level_sigma_rad=2e-3,
    north_sigma_rad=2e-3,
    mounting_sigma_rad=2e-3,
    non_orthogonality_sigma_rad=2e-3,
    rotation_sigma_rad=2e-3,
)


def run(turn):
    return sims.table1_motion(
        site=Site(9.80665, 5e-6, math.radians(45.0)),
        sequences=IDS,
        sample_rate_hz=50.0,
        dwell_s=1.0,
        settle_s=0.5,
        heading_rad=0.4,
        fixture_draw=DRAW,
        U=turn.as_matrix(),
    )


MOTION = run(U)
# In the second piece's start window, turn (at full rate and in a ramp) and end window, and in a turn of the last.
TIMES = {
    "start window": MOTION.windows[1][0][0] + 0.51,
    "turn": MOTION.windows[1][0][1] + 1.03,
    "ramp": MOTION.windows[1][0][1] + 0.05,
    "end window": MOTION.windows[1][1][0] + 0.51,
    "last piece": MOTION.windows[2][0][1] + 5.03,
}


@pytest.mark.parametrize("time_s", TIMES.values(), ids=TIMES)
def test_after_a_tilt_step_the_run_is_that_of_a_body_mounted_otherwise(time_s):
    stepped = tilt_step(MOTION, time_s, 100.0 * TILT)
    # A body turned by v in its mount: U becomes Exp(-v) U, for the whole of the run.
    mounted = run(Rotation.from_rotvec(-100.0 * TILT) * U)
    k = int(np.flatnonzero((MOTION.time - MOTION.interval < time_s) & (time_s < MOTION.time))[0])
    stop = min([s for s in MOTION.piece_starts if s > k] + [len(MOTION.time)])
    after = np.zeros(len(MOTION.time), dtype=bool)
    after[k + 1 : stop] = True
    before = ~after
    before[k] = False
    for name in ("angle", "velocity"):
        found = getattr(stepped, name)
        np.testing.assert_array_equal(found[before], getattr(MOTION, name)[before])
        np.testing.assert_allclose(found[after], getattr(mounted, name)[after], rtol=0.0, atol=2e-15)
    ends = np.array(MOTION.windows)[:, :, 1]
    moved = (ends > time_s) & (ends < MOTION.time[stop - 1] + 1e-9)
    np.testing.assert_allclose(stepped.attitudes[moved], mounted.attitudes[moved], rtol=0.0, atol=2e-15)
    np.testing.assert_array_equal(stepped.attitudes[~moved], MOTION.attitudes[~moved])
