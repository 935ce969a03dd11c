"""Ferraris' calibration on the two-axis fixture, computed by imucal, with the results in this project's parameters.

Six faces stand still, each axis up and down; then every axis is turned by full turns. The method takes the fixture for
the truth: vertical is exactly along an axis in every face, every turn is exactly about an axis, by exactly the angle
asked for. What it finds (Ferraris, Grimaldi and Parvis 1995, as the package imucal computes it) corrects readings by::

    f = R_a⁻¹ K_a⁻¹ (f̃ − b_a),      ω = R_g⁻¹ K_g⁻¹ (ω̃ − K_ga f − b_g)

in the fixture's axes F: K diagonal, rows of R of unit length. The reading model of this project has ω̃ = Mg ω + κ_Bias
in MARS axes B, in which Mg is symmetric. So K_g R_g = Mg C_BF and K_a R_a = Ma C_BF: the polar decomposition of the
first gives Mg and C_BF, and with that the second gives Ma. A turn that all of F has in common, as by the mounting,
drops out. K_ga has no place in the reading model; besides g-sensitivity it takes up the vertical part of the Earth's
rate.

The turns about x and y are made about the outer axis. With the heading 0 that points east, so that no Earth rate lies
along it; the six faces come in pairs half a turn about east apart, in whose mean the Earth's rate cancels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.linalg import polar

from sims.physics.fixture import FixtureDraw, draw_fixture
from sims.physics.sequences import TABLE_1, TurnSequence
from sims.physics.table_motion import Schedule, run_schedule
from srt.constants import DEG
from srt.sensor_errors import SensorErrors

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sims.physics.motion import RateProfile
    from sims.physics.true_motion import TrueMotion
    from srt.recording.recording import Recording
    from srt.types import Array

    Picks = Mapping[str, tuple[tuple[int, int], ...]]

TURNS_PER_AXIS: Final = 3
"""Full turns about each axis: the rotation errors of the fixture then weigh a third."""
TURN_RAD: Final = TURNS_PER_AXIS * 2.0 * math.pi
"""Angle turned about each axis, rad."""
TURN_WAIT_S: Final = 1.0
"""Rest before and after a turn, s; not used as a face."""

# The two faces of z are seen at two headings half a turn apart. Then the Earth's horizontal rate does not end in K_ga,
# which would take it for a g-sensitivity and subtract it from the turns about z, whose axis is vertical.
FACE_SEQUENCES: Final = (
    TurnSequence("faces x", "x", "y", (("y", 180.0),)),
    TurnSequence("faces y", "y", "x", (("x", 180.0),)),
    TurnSequence("face -z", "z", "y", (("z", 180.0),)),
    TurnSequence("face +z", "z", "y", (("y", 180.0),)),
    TurnSequence("face +z turned", "z", "y", (("z", 180.0), ("y", 180.0))),
)
FACES: Final[Picks] = {
    "x_a": ((0, 0),),
    "x_p": ((0, 1),),
    "y_a": ((1, 0),),
    "y_p": ((1, 1),),
    "z_a": ((2, 0), (2, 1)),
    "z_p": ((3, 1), (4, 1)),
}
"""Sequence and window (0 before its rotations, 1 after) that show each face. ``x_p`` has x up, ``x_a`` down."""

TURN_SEQUENCES: Final = (
    TurnSequence("turns x", "y", "x", (("x", 360.0 * TURNS_PER_AXIS),)),
    TurnSequence("turns y", "x", "y", (("y", 360.0 * TURNS_PER_AXIS),)),
    TurnSequence("turns z", "z", "y", (("z", 360.0 * TURNS_PER_AXIS),)),
)
TURNS: Final = (0, 1, 2)
"""Sequences that turn x, y and z."""

_IDS = tuple(TABLE_1)
TABLE_1_FACES: Final[Picks] = {
    f"{axis}_{face}": tuple((_IDS.index(name), window) for name in names)
    for axis, names in {"x": ("9", "12"), "y": ("7", "10"), "z": ("8", "11")}.items()
    for window, face in enumerate("ap")
}
"""Windows of Table 1 that serve as faces: those before and after half turns that turn an axis over."""

TABLE_1_TURNS: Final = tuple(_IDS.index(name) for name in ("2", "1", "3"))
TABLE_1_TURN_RAD: Final = 2.0 * math.pi
"""Angle of the turns of Table 1, rad."""


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """A recording, and the still windows that were before and after each of its turns, s."""

    recording: Recording
    windows: tuple[tuple[tuple[float, float], tuple[float, float]], ...]

    def still(self, picks: tuple[tuple[int, int], ...], seconds: float) -> tuple[Array, Array]:
        """Samples of a face, as long as asked for and equally from each window: gyro, accel, shape (n, 3)."""
        count = round(seconds / self.recording.nominal_interval_s / len(picks))
        inside = [self.recording.window_indices(*self.windows[sequence][window]) for sequence, window in picks]
        assert all(part.stop - part.start >= count for part in inside), "a window is shorter than its share of the face"
        samples = np.concatenate([np.arange(part.start, part.start + count) for part in inside])
        return self.recording.gyro[samples], self.recording.accel[samples]

    def turning(self, sequence: int) -> tuple[Array, Array]:
        """Samples between the two windows of a sequence: gyro, accel, shape (n, 3)."""
        (_, begin), (end, _) = self.windows[sequence]
        samples = self.recording.window_indices(begin, end)
        return self.recording.gyro[samples], self.recording.accel[samples]


def face_seconds(total_s: float, profile: RateProfile) -> float:
    """Duration of each of the six faces for a total duration of all faces and rotations, s."""
    legs = [angle for s in (*FACE_SEQUENCES[:3], *TURN_SEQUENCES) for _, angle in s.fixture_legs()]
    return (total_s - sum(profile.duration_s(angle) for angle in legs)) / len(FACES)


def ferraris_motions(
    *,
    face_s: float,
    profile: RateProfile,
    fixture_draw: FixtureDraw | None = None,
    rotation_sigma_rad: float = 0.0,
    rng: np.random.Generator | None = None,
    **run: Any,
) -> tuple[TrueMotion, TrueMotion]:
    """Execute Ferraris' faces (:data:`FACE_SEQUENCES`) and turns (:data:`TURN_SEQUENCES`) on the fixture.

    Base, mounting and axes are those of ``fixture_draw``. Starts and rotations, which are other ones here, are drawn by
    ``rng`` with a sigma of ``rotation_sigma_rad``. ``run`` are arguments of
    :func:`sims.physics.table_motion.run_schedule`.
    """
    generator = np.random.default_rng(0) if rng is None else rng  # without one, sigma zero leaves nothing of it
    motions = []
    for sequences, dwell_s in ((FACE_SEQUENCES, face_s), (TURN_SEQUENCES, TURN_WAIT_S)):
        executed = draw_fixture(generator, sequences, rotation_sigma_rad=rotation_sigma_rad)
        draw = replace(fixture_draw or FixtureDraw(), starts=executed.starts, legs=executed.legs)
        motions.append(run_schedule(Schedule(sequences, profile, dwell_s=dwell_s), fixture_draw=draw, **run))
    return motions[0], motions[1]


def signal_regions(
    faces: Take, turns: Take, *, face_s: float, face_picks: Picks = FACES, turn_picks: tuple[int, ...] = TURNS
) -> dict[str, Array]:
    """Arrays by the names of imucal's ``FerrarisSignalRegions``, each of shape (n, 3): deg/s and m/s²."""
    regions = {}
    for face, picks in face_picks.items():
        regions[f"gyr_{face}"], regions[f"acc_{face}"] = faces.still(picks, face_s)
    for axis, sequence in zip("xyz", turn_picks, strict=True):
        regions[f"gyr_{axis}_rot"], regions[f"acc_{axis}_rot"] = turns.turning(sequence)
    return {name: samples / DEG if name.startswith("gyr") else samples for name, samples in regions.items()}


def imucal_errors(
    regions: Mapping[str, Array], *, sample_rate_hz: float, gravity_m_s2: float, turn_rad: float = TURN_RAD
) -> SensorErrors:
    """Sensor errors by imucal in MARS axes, from :func:`signal_regions`; it knows no asymmetries."""
    import imucal

    method = imucal.FerrarisCalibration(grav=gravity_m_s2, expected_angle=turn_rad / DEG)
    found = method.compute(imucal.FerrarisSignalRegions(**regions), sample_rate_hz, "m/s^2", "deg/s")
    return mars_errors(found.K_g @ found.R_g, found.K_a @ found.R_a, found.b_g * DEG, found.b_a)


def mars_errors(gyro_matrix: Array, accel_matrix: Array, gyro_bias: Array, accel_bias: Array) -> SensorErrors:
    """Sensor errors in MARS axes of triads that read ``M v + bias`` (SI) for v in any common orthogonal axes."""
    assert np.linalg.det(gyro_matrix) > 0.0, "a flipped axis: the gyro matrix is symmetric and positive in no frame"
    turn, Mg = polar(gyro_matrix, side="left")  # gyro_matrix = Mg @ turn
    Ma = accel_matrix @ turn.T
    values = {f"gyro_orthogonality_{'xyz'[i]}{'xyz'[j]}": 2.0 * Mg[i, j] for i, j in ((0, 1), (1, 2), (2, 0))}
    for i, a in enumerate("xyz"):
        values |= {f"gyro_scale_{a}": Mg[i, i] - 1.0, f"accel_scale_{a}": Ma[i, i] - 1.0}
        values |= {f"gyro_bias_{a}": gyro_bias[i], f"accel_bias_{a}": accel_bias[i]}
        values |= {f"accel_misalignment_{a}{b}": Ma[i, j] for j, b in enumerate("xyz") if i != j}
    return SensorErrors.from_dict({name: float(value) for name, value in values.items()})
