"""Preintegration of corrected readings by gtsam, compared with the true trajectory.

Between two keyframes gtsam sums readings to a rotation, a velocity and a position in the body axes of the first one,
gravity left out. Seen from inertial space, with C the attitude, r the position, v the velocity and γ the gravitation::

    ΔR = C0ᵀ C1,    ΔV = C0ᵀ (v1 − v0 − ∫γ dt),    ΔP = C0ᵀ (r1 − r0 − v0 T − ∬γ dt dt)

which is exact on a turning Earth: no Earth rate or Coriolis term is left out.

gtsam holds the attitude over a sample while the sample's specific force is added. In a turn of 0.2 rad/s at 100 Hz that
alone costs 0.01 m/s². What it gets here are therefore rotation vectors and velocity changes with the motion inside the
sample accounted for (python-ins: coning, sculling, rotation), divided by the interval. And of its variants the one
named Manifold: the default one errs in large turns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from trajectories import Motion, pyins_modules

from srt.exceptions import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.types import Array


SEGMENT_S: Final = 10.0
"""Time between two keyframes."""


class Deltas(NamedTuple):
    """Changes over k segments, in the axes of each segment's start: shapes (k, 3, 3), (k, 3) in m/s, (k, 3) in m."""

    rotation: Array
    velocity: Array
    position: Array


def gtsam_module() -> Any:
    """Import gtsam.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import gtsam
    except ModuleNotFoundError as error:
        if error.name != "gtsam":
            raise
        raise MissingExtraError("gtsam", "examples", "Preintegration (leave it out with --no-gtsam)") from None
    return gtsam


def segment_starts(motion: Motion, every_s: float) -> list[int]:
    """First samples of the segments: one every so many seconds, from the end of the standstill on."""
    length = round(SEGMENT_S / motion.interval_s)
    first, step = motion.still.stop, round(every_s / motion.interval_s)
    return list(range(first, len(motion.angle) - length + 1, step))


def preintegrate(increments: Any, starts: Sequence[int]) -> Deltas:
    """Run gtsam over the segments.

    Parameters
    ----------
    increments : pandas.DataFrame
        Increments of python-ins: dt, rotation vectors and velocity changes.
    starts : sequence of int
    """
    gtsam = gtsam_module()
    dt = np.asarray(increments["dt"])
    rates = increments.iloc[:, 1:4].to_numpy() / dt[:, None]
    forces = increments.iloc[:, 4:7].to_numpy() / dt[:, None]
    parameters = gtsam.PreintegrationParams.MakeSharedU(0.0)  # no gravity: the deltas do without
    length = round(SEGMENT_S / dt[0])
    rows = []
    for a in starts:
        summed = gtsam.PreintegratedImuMeasurementsManifold(parameters, gtsam.imuBias.ConstantBias())
        for i in range(a, a + length):  # gtsam takes samples one at a time
            summed.integrateMeasurement(forces[i], rates[i], dt[i])
        rows.append((summed.deltaRij().matrix(), summed.deltaVij(), summed.deltaPij()))
    return Deltas(*(np.array(column) for column in zip(*rows, strict=True)))


def true_deltas(motion: Motion, starts: Sequence[int]) -> Deltas:
    """Take the same changes from the true trajectory."""
    pyins = pyins_modules()
    time = np.asarray(motion.trajectory.index, dtype=np.float64)
    lla = motion.trajectory[["lat", "lon", "alt"]].to_numpy(copy=True)
    lla[:, 1] += np.degrees(pyins.earth.RATE) * time  # longitude counted from inertial space
    C_in = pyins.transform.mat_en_from_ll(lla[:, 0], lla[:, 1])
    C_nb = pyins.transform.mat_from_rph(motion.trajectory[["roll", "pitch", "heading"]].to_numpy())
    C_ib = C_in @ C_nb
    r = pyins.transform.lla_to_ecef(lla)
    v_n = motion.trajectory[["VN", "VE", "VD"]].to_numpy()
    v = np.einsum("nij,nj->ni", C_in, v_n) + np.cross([0.0, 0.0, pyins.earth.RATE], r)
    gravitation = pyins.earth.gravitation_ecef(lla)
    dt, length = motion.interval_s, round(SEGMENT_S / motion.interval_s)
    index = np.asarray(starts)[:, None] + np.arange(length + 1)
    pulled = gravitation[index]
    # Gravitation is smooth: over 10 s the trapezium errs by less than 1e-9 m/s² of its mean.
    means = 0.5 * (pulled[:, 1:] + pulled[:, :-1])
    gained = np.cumsum(means, axis=1) * dt
    moved = (np.sum(gained[:, :-1], axis=1) + 0.5 * gained[:, -1]) * dt
    a, b = index[:, 0], index[:, -1]
    to_start = np.swapaxes(C_ib[a], 1, 2)
    velocity = v[b] - v[a] - gained[:, -1]
    position = r[b] - r[a] - v[a] * (length * dt) - moved
    return Deltas(
        to_start @ C_ib[b], np.einsum("kij,kj->ki", to_start, velocity), np.einsum("kij,kj->ki", to_start, position)
    )


def delta_errors(found: Deltas, true: Deltas) -> Array:
    """Sizes of the errors of each segment, shape (k, 3): rotation in rad, velocity in m/s, position in m."""
    left = np.swapaxes(true.rotation, 1, 2) @ found.rotation
    # The sine keeps small angles, which the arc cosine of the trace would lose to rounding.
    axial = 0.5 * np.stack(
        [left[:, 2, 1] - left[:, 1, 2], left[:, 0, 2] - left[:, 2, 0], left[:, 1, 0] - left[:, 0, 1]], axis=1
    )
    angle = np.arctan2(np.linalg.norm(axial, axis=1), 0.5 * (np.trace(left, axis1=1, axis2=2) - 1.0))
    return np.column_stack(
        [
            angle,
            np.linalg.norm(found.velocity - true.velocity, axis=1),
            np.linalg.norm(found.position - true.position, axis=1),
        ]
    )
