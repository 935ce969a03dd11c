"""Simulated runs that the tests of disturbances share."""

import math
from dataclasses import fields

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import sims
from srt.recording.recording import Site

LATITUDE = math.radians(45.0)
SITE = Site(9.80665, 5e-6, LATITUDE)
IDS = ("7", "13", "6")
TILT = np.array([1e-3, -2e-3, 0.5e-3])
U = Rotation.from_rotvec([0.2, -0.1, 0.3])


def draw(size=2e-3):
    return sims.draw_fixture(
        np.random.default_rng(5),
        sims.table_sequences(IDS),
        level_sigma_rad=size,
        north_sigma_rad=size,
        mounting_sigma_rad=size,
        non_orthogonality_sigma_rad=size,
        rotation_sigma_rad=size,
    )


def run(turn=U, fixture_draw=None, **changes):
    settings_of_run = {"sequences": IDS, "sample_rate_hz": 50.0, "dwell_s": 1.0, "settle_s": 0.5, "heading_rad": 0.4}
    return sims.table1_motion(
        site=SITE, fixture_draw=fixture_draw or draw(), U=turn.as_matrix(), **(settings_of_run | changes)
    )


MOTION = run()


def untouched(motion, before):
    return all(np.array_equal(getattr(motion, name), array) for name, array in before.items())


def snapshot(thing):
    return {
        f.name: np.array(value)
        for f in fields(thing)
        if isinstance(value := getattr(thing, f.name), np.ndarray) and not f.name.startswith("_")
    }


small = st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=3)
