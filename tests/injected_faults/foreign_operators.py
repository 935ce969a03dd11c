"""Faults of operators, mountings, labels and sites in forms other than those of the catalogue, and pairs of faults.

They were written without knowledge of the checks, like the variants of ``injected_faults.foreign_loggers``.
"""

from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

import injected_faults.execution
import injected_faults.foreign_loggers
import injected_faults.logger
import injected_faults.site_and_drift  # noqa: F401 - these modules register their injections on import
from injected_faults.changes import moved_labels, sign, with_sensor
from injected_faults.injection import INJECTIONS, Case, FaultyCase, variant
from sims.physics.imu import accel_matrix, gyro_matrix
from srt.constants import DEG
from srt.recording.recording import Recording, SequenceLabel


def _turned(recording: Recording, gyro: Rotation | None, accel: Rotation | None) -> Recording:
    return replace(
        recording,
        gyro=recording.gyro if gyro is None else recording.gyro @ gyro.as_matrix().T,
        accel=recording.accel if accel is None else recording.accel @ accel.as_matrix().T,
    )


# --- labels ----------------------------------------------------------------------------------------------------------


@variant("labels of a fast clock", 0.02, "of the rate", "labels_shifted", "sample_rate")
def labels_of_a_fast_clock(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The clock of the labels runs faster or slower than that of the samples."""
    first, factor = case.recording.time[0], 1.0 + sign(rng) * severity
    recording = case.changed(schedule={"moves": "recorded"}).recording
    return recording.with_sequences(moved_labels(recording.sequences, lambda time: first + factor * (time - first)))


@variant("windows reach into the rotations", 0.5, "s", "labels_shifted", "noisy_window", "unsettled")
def windows_too_long(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The start window of each label ends too late and the end window begins too early: both include rotation."""
    slow = severity * rng.uniform(0.9, 1.1)

    def longer(label: SequenceLabel) -> SequenceLabel:
        (first, second), (third, last) = label.start_static_s, label.end_static_s
        return replace(label, start_static_s=(first, second + slow), end_static_s=(third - slow, last))

    return case.recording.with_sequences(tuple(longer(label) for label in case.recording.sequences))


@variant("labels of the next sequences", 1.0, "sequences", "labels_exchanged", "labels_shifted", "wrong_direction")
def labels_of_the_next(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One sequence is missing in the list of labels, so that each later sequence has the name of the next one."""
    labels = case.recording.sequences
    names = [label.id for label in labels]
    left_out = int(rng.integers(2, len(names) - 3))
    step = max(1, round(severity))
    names = names[:left_out] + names[left_out + step :] + names[left_out : left_out + step]
    return case.recording.with_sequences(
        tuple(replace(label, id=name) for label, name in zip(labels, names, strict=True))
    )


@variant("time of the labels from the start", 400.0, "s", "labels_shifted")
def labels_from_the_start(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The stamps of the samples count from switch-on, the labels from the start of the recording."""
    late = severity * rng.uniform(0.9, 1.1)
    recording = case.changed(schedule={"moves": "recorded"}).recording
    return replace(recording, time=recording.time + late)


# --- mounting --------------------------------------------------------------------------------------------------------


@variant("mounted at 45 deg", 45.0, "deg", "frame_turned")
def mounted_askew(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit is mounted on the table with a rotation by 45° about one axis."""
    turn = Rotation.from_rotvec(sign(rng) * severity * DEG * np.eye(3)[int(rng.integers(3))])
    return _turned(case.recording, turn, turn)


@variant("sensors askew in their housing", 3.0, "deg")
def sensors_askew(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Both triads are rotated together in the housing, by up to ``severity`` degrees about each axis."""
    turn = Rotation.from_rotvec(severity * DEG * rng.uniform(-1.0, 1.0, 3))
    return _turned(case.recording, turn, turn)


@variant("accelerometer board askew", 30.0, "deg", "frames_disagree")
def accelerometer_board_askew(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The accelerometers are rotated relative to the gyros, about one axis."""
    turn = Rotation.from_rotvec(sign(rng) * severity * DEG * np.eye(3)[int(rng.integers(3))])
    return _turned(case.recording, None, turn)


@variant("mounted anew in the middle", 90.0, "deg", "units_joined", "frame_turned", "labels_exchanged")
def mounted_anew(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit is taken off the table between two sequences and mounted in another orientation."""
    recording, simulation = case.recording, case.simulation
    count = len(recording.sequences)
    label = recording.sequences[int(rng.integers(count // 4, 3 * count // 4))]
    rows = slice(recording.window_indices(*label.end_static_s).stop, len(recording.time))
    turn = Rotation.from_rotvec(sign(rng) * severity * DEG * np.eye(3)[int(rng.integers(3))]).as_matrix() - np.eye(3)
    # The motion in case axes is rotated; the sensor matrices in case axes stay the same.
    motion, factor = simulation.motion, 1.0 if recording.kind == "increment" else 1.0 / simulation.motion.interval
    gyro, accel = recording.gyro.copy(), recording.accel.copy()
    gyro[rows] += factor * motion.angle[rows] @ (gyro_matrix(simulation.truth) @ turn).T
    accel[rows] += factor * motion.velocity[rows] @ (accel_matrix(simulation.truth) @ turn).T
    return replace(recording, gyro=gyro, accel=accel)


@variant("east, north, up for north, east, down", 1.0, "", "frame_turned")
def east_north_up(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Both triads use axes right, forward and up, where forward, right and down are expected."""
    axes = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return replace(case.recording, gyro=case.recording.gyro @ axes.T, accel=case.recording.accel @ axes.T)


@variant("two axes reversed", 1.0, "", "frame_turned", "frames_disagree")
def two_axes_reversed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Two columns of one triad, or of both, have the wrong sign."""
    signs = -np.ones(3)
    signs[int(rng.integers(3))] = 1.0
    gyro, accel = ((True, True), (True, False), (False, True))[int(rng.integers(3))]
    recording = case.recording
    return replace(
        recording,
        gyro=recording.gyro * signs if gyro else recording.gyro,
        accel=recording.accel * signs if accel else recording.accel,
    )


@variant("columns one further", 1.0, "", "gyro_axes_swapped", "frames_disagree", "frame_turned")
def columns_one_further(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The columns of one triad are shifted cyclically by one or two places."""
    sensor, step = str(rng.choice(["gyro", "accel"])), int(rng.integers(1, 3))
    values = np.roll(getattr(case.recording, sensor), step, axis=1)
    return with_sensor(case.recording, sensor, values)


# --- site ------------------------------------------------------------------------------------------------------------


def _sited(case: Case, **changes: Any) -> Recording:
    return replace(case.recording, site=replace(case.recording.site, **changes))


@variant("southern latitude", 1.0, "", "latitude")
def southern_latitude(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The latitude has the wrong sign."""
    assert case.recording.site.latitude_rad is not None
    return _sited(case, latitude_rad=-case.recording.site.latitude_rad)


@variant("longitude for latitude", 1.0, "", "latitude")
def longitude_for_latitude(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Longitude and latitude are exchanged."""
    return _sited(case, latitude_rad=float(rng.uniform(-20.0, 20.0)) * DEG)


@variant("gravity of another country", 0.04, "m/s^2", "gravity")
def gravity_of_another_country(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The stated gravity is that of a place much nearer to the equator or to a pole."""
    return _sited(case, gravity_m_s2=case.recording.site.gravity_m_s2 + sign(rng) * severity)


@variant("table faces the other way", 180.0, "deg", "north")
def table_faces_the_other_way(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The stated heading is wrong by half a turn, as if it were that of the opposite axis of the table."""
    fixture = case.recording.fixture
    assert fixture is not None
    assert fixture.heading_rad is not None
    heading = fixture.heading_rad + sign(rng) * severity * DEG
    return replace(case.recording, fixture=replace(fixture, heading_rad=heading))


# --- pairs -----------------------------------------------------------------------------------------------------------

PAIRS: Final = (
    ("gyro_degrees", "gyro_axis_flipped"),
    ("accel_axes_swapped", "accel_lsb"),
    ("sample_rate", "spikes"),
    ("gap_in_sequence", "samples_stuck"),
    ("time_unit", "gyro_lsb"),
    ("gyro_milli", "left_handed"),
    ("gyro_wrapped", "spikes"),
    ("accel_sign_convention", "gyro_channel_dead"),
    ("frame_turned", "gap_in_sequence"),
    ("stamp_jitter", "samples_duplicated"),
    ("labels_shifted", "gyro_radians"),
    ("wrong_angle", "accel_bias_drift"),
    ("latitude", "accel_stuck"),
    ("gyro_clipped", "north"),
)
"""Pairs of faults of the catalogue; the second fault is put into the recording that has the first one."""


def _pair(first: str, second: str) -> None:
    @variant(
        f"{first} and {second}", 1.0, "times the stated ones", *INJECTIONS[first].causes, *INJECTIONS[second].causes
    )
    def pair(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """Recording with two faults; raises InputError if the construction detects one of them."""
        one, other = INJECTIONS[first], INJECTIONS[second]
        faulty = one.apply(case, _scaled(first, case.grade, severity), rng)
        later = FaultyCase(case.grade, case.seed, case.changes, faulty)
        return other.apply(later, _scaled(second, case.grade, severity), rng)


def _scaled(fault: str, grade: str, share: float) -> float:
    """Stated severity of a fault, scaled by ``share``: a factor is raised to that power.

    A grade without a stated severity gets that of the best grade that has one. Severities that are counts or have no
    unit are not scaled.
    """
    injection = INJECTIONS[fault]
    stated = injection.severity.get(grade, next(iter(injection.severity.values())))
    if injection.unit in ("", "-", "Hz", "samples", "sequences", "columns") or injection.unit.startswith("counts"):
        return stated
    if injection.unit.startswith("of the largest"):
        return 1.0 - (1.0 - stated) * share
    return stated**share if "times" in injection.unit else stated * share


for _first, _second in PAIRS:
    _pair(_first, _second)
