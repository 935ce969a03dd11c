"""Faults in the execution of a test: labels, sequences, stationary windows and rotations."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from injected_faults import disturbances
from injected_faults.changes import moved_labels, sign
from injected_faults.injection import Case, injection
from sims.physics.fixture import rotation
from sims.physics.imu import read_out
from sims.physics.sequences import TABLE_1
from sims.physics.table_motion import run_schedule
from sims.physics.true_motion import TrueMotion
from sims.scenarios.simulation import schedule_of
from srt.constants import DEG, MICRO_G
from srt.recording.recording import Recording
from srt.types import Array

_IDS: Final = tuple(TABLE_1)
_VIBRATION_HZ: Final = 23.0
"""Frequency of the vibration, Hz: about that of a machine at 1400 revolutions per minute."""
_VIBRATION_M_S2_PER_URAD: Final = 3e3 * MICRO_G / 5.0
"""Ratio of the amplitudes of linear and angular vibration, m/s² per µrad: 3 mg at 5 µrad."""


# --- sequences and labels --------------------------------------------------------------------------------------------


@injection("labels_shifted", 2.0, "s")
def labels_shifted(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The labels are late or early by ``severity``: they come from another clock than the samples.

    The recording includes the moves between the sequences. Windows are cut at the ends of the recording.
    """
    recording = case.changed(schedule={"moves": "recorded"}).recording
    shift = sign(rng) * severity
    low = float(recording.time[0]) - recording.nominal_interval_s
    high = float(recording.time[-1])
    return recording.with_sequences(moved_labels(recording.sequences, lambda time: np.clip(time + shift, low, high)))


@injection("labels_exchanged", 2.0, "sequences")
def labels_exchanged(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Some sequences exchange their places in the test, but the labels keep the planned order."""
    count = max(2, round(severity))
    places = rng.choice(len(_IDS), count, replace=False)
    order = list(_IDS)
    for here, there in zip(places.tolist(), np.roll(places, 1).tolist(), strict=True):
        order[here] = _IDS[there]
    return _labelled(case.changed(schedule={"sequences": tuple(order)}).recording, _IDS)


@injection("wrong_direction", 1.0, "sequences")
def wrong_direction(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """All rotations of some sequences are executed in the opposite sense."""
    turned = rng.choice(_IDS, max(1, round(severity)), replace=False).tolist()
    custom = [
        {
            "id": f"{name} reversed",
            "down": TABLE_1[name].down,
            "along_outer": TABLE_1[name].along_outer,
            "rotations": tuple((axis, -angle) for axis, angle in TABLE_1[name].rotations),
        }
        for name in turned
    ]
    order = tuple(f"{name} reversed" if name in turned else name for name in _IDS)
    return _labelled(case.changed(schedule={"sequences": order, "custom": tuple(custom)}).recording, _IDS)


@injection("wrong_angle", 2.0, "°")
def wrong_angle(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One rotation of one sequence has a wrong angle, as with a misplaced stop or an indexing table off by a tooth."""
    run = case.simulation
    assert run.fixture_draw is not None
    number = int(rng.integers(len(_IDS)))
    leg = int(rng.integers(len(TABLE_1[_IDS[number]].rotations)))
    error = sign(rng) * severity * DEG
    draw = disturbances.wrong_angle(run.fixture_draw, number, leg, error)
    config, scenario = run.scenario.schedule, run.scenario
    assert config is not None
    motion = run_schedule(
        schedule_of(config),
        site=run.motion.site,
        sample_rate_hz=scenario.recording.sample_rate_hz,
        heading_rad=0.0 if scenario.fixture is None else scenario.fixture.heading_deg * DEG,
        fixture_draw=draw,
        U=run.U,
        stated_fixture=run.motion.fixture,
        earth_rate=scenario.site.earth_rate,
        start_time_s=scenario.recording.start_time_s,
    )
    return _read(case, motion, rng)


@injection("sequence_missing", 1.0, "sequences")
def sequence_missing(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Some sequences are omitted from the test."""
    left_out = rng.choice(_IDS, max(1, round(severity)), replace=False).tolist()
    return case.changed(schedule={"sequences": tuple(name for name in _IDS if name not in left_out)}).recording


@injection("sequence_repeated", 1.0, "sequences")
def sequence_repeated(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Some sequences are executed a second time, immediately or at the end of the test."""
    order = list(_IDS)
    for name in rng.choice(_IDS, max(1, round(severity)), replace=False).tolist():
        order.insert(order.index(name) if rng.random() < 0.5 else len(order), name)
    return case.changed(schedule={"sequences": tuple(order)}).recording


@injection("window_short", 0.2, "of the planned length")
def window_short(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One stationary window is too short: the recording of its sequence begins too late or stops too early."""
    recording = case.recording
    number, at_end = int(rng.integers(len(_IDS))), bool(rng.integers(2))
    label = recording.sequences[number]
    a, b = label.end_static_s if at_end else label.start_static_s
    kept = (a, a + severity * (b - a)) if at_end else (b - severity * (b - a), b)
    lost = recording.window_indices(kept[1], b) if at_end else recording.window_indices(a, kept[0])
    keep = np.ones(len(recording.time), dtype=np.bool_)
    keep[lost] = False
    changed = replace(label, end_static_s=kept) if at_end else replace(label, start_static_s=kept)
    return replace(
        recording,
        time=recording.time[keep],
        gyro=recording.gyro[keep],
        accel=recording.accel[keep],
        sequences=(*recording.sequences[:number], changed, *recording.sequences[number + 1 :]),
        data_sha256=None,
    )


def _labelled(recording: Recording, ids: tuple[str, ...]) -> Recording:
    """Recording with the same windows, labelled with other names."""
    return recording.with_sequences(
        tuple(
            replace(label, id=name, down=None, along_outer=None, rotations=())
            for label, name in zip(recording.sequences, ids, strict=True)
        )
    )


# --- stationary windows ----------------------------------------------------------------------------------------------


@injection("unsettled", 0.5, "mrad")
def unsettled(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """A soft fixture oscillates after every rotation; the test waits only 0.2 s before the window."""
    ringing = {
        "settling_amplitude_mrad": severity,
        "settling_frequency_hz": float(rng.uniform(4.0, 12.0)),
        "settling_decay_s": float(rng.uniform(0.2, 0.6)),
    }
    return case.changed(schedule=ringing).recording


@injection("bump", 1.0, "mrad")
def bump(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """A knock makes the unit slip in its clamp; the slip takes 0.1 to 0.3 s."""
    motion = case.simulation.motion
    (a, b), _ = _window(motion, rng)
    duration = float(rng.uniform(0.1, 0.3))
    start = a + float(rng.uniform(0.15, 0.85)) * (b - a - duration)
    vector = rng.standard_normal(3)
    return _read(case, slipped(motion, start, duration, severity * 1e-3 * vector / np.linalg.norm(vector)), rng)


@injection(
    "creep",
    {"navigation-rlg": 20.0, "tactical-fog": 200.0, "industrial-mems": 200.0, "consumer-mems": 600.0},
    "µrad/s",
)
def creep(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit tilts under gravity at a constant rate during one window, as in a loose clamp."""
    motion = case.simulation.motion
    (a, b), force = _window(motion, rng)
    axis = np.cross(force, rng.standard_normal(3))
    vector = severity * 1e-6 * (b - a) * axis / np.linalg.norm(axis)
    return _read(case, slipped(motion, a, b - a, vector, steady=True), rng)


@injection("vibration", 5.0, "µrad at 23 Hz, and 3 mg")
def vibration(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """A machine shakes the table: angular vibration of ``severity``, and linear vibration in proportion to it."""
    angle, force = (x / np.linalg.norm(x) for x in rng.standard_normal((2, 3)))
    motion = disturbances.vibrating(
        case.simulation.motion,
        _VIBRATION_HZ,
        1e-6 * severity * angle,
        _VIBRATION_M_S2_PER_URAD * severity * force,
        phase_rad=float(rng.uniform(0.0, 2.0 * math.pi)),
    )
    return _read(case, motion, rng)


@injection("noisy_window", 3.0, "times the noise")
def noisy_window(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The noise of one window is ``severity`` times larger, as a fan or a passing lorry shakes the bench."""
    run = case.simulation
    window, _ = _window(run.motion, rng)
    return disturbances.noisier_window(run.recording, window, severity, run.imu.gyro_noise, run.imu.accel_noise, rng)


def _window(motion: TrueMotion, rng: np.random.Generator) -> tuple[tuple[float, float], Array]:
    """One of the stationary windows, drawn at random, and the mean specific force in it (m/s², B)."""
    windows = [window for pair in motion.windows for window in pair]
    a, b = windows[int(rng.integers(len(windows)))]
    rows = (motion.time > a + 0.5 * motion.interval) & (motion.time < b + 0.5 * motion.interval)
    return (a, b), motion.velocity[rows].mean(axis=0) / motion.interval


def slipped(
    motion: TrueMotion, start_s: float, duration_s: float, vector: Array, *, steady: bool = False
) -> TrueMotion:
    """True motion with a slip: B rotates by ``vector`` in ``duration_s``, and keeps the new attitude.

    The rotation is smooth, or at a constant rate if ``steady``. The undisturbed attitude C becomes C·Exp(s v) with s
    from 0 to 1: v·ds/dt is added to the rate, and vectors in B are rotated by Exp(-s v). The slip lasts until the next
    gap, as the unit is clamped again between sequences.
    """
    dt = motion.interval
    first = int(np.searchsorted(motion.time, start_s + 0.5 * dt))
    after = motion.piece_starts[motion.piece_starts > first]
    rows = slice(first, int(after[0]) if after.size else len(motion.time))
    ends = motion.time[rows]
    x = np.clip((np.stack([ends - dt, ends]) - start_s) / duration_s, 0.0, 1.0)
    share = x if steady else x - np.sin(2.0 * math.pi * x) / (2.0 * math.pi)
    turn = rotation(np.multiply.outer(share.mean(axis=0), vector))

    def turned(old: Array, old_absolute: Array, added: Array | float) -> tuple[Array, Array]:
        new, absolute = old.copy(), old_absolute.copy()
        new[rows] = np.einsum("ni,nij->nj", old[rows], turn) + added
        absolute[rows] = np.abs(new[rows]) + np.maximum(old_absolute[rows] - np.abs(old[rows]), 0.0)
        return new, absolute

    angle, angle_abs = turned(motion.angle, motion.angle_abs, np.multiply.outer(share[1] - share[0], vector))
    velocity, velocity_abs = turned(motion.velocity, motion.velocity_abs, 0.0)
    return replace(motion, angle=angle, angle_abs=angle_abs, velocity=velocity, velocity_abs=velocity_abs)


# --- rotations -------------------------------------------------------------------------------------------------------


def _late(motion: TrueMotion, increments: Array, late_s: float, axes: Iterable[int]) -> Array:
    """Increments with some axes delayed by ``late_s``; the samples keep their time stamps."""
    out = increments.copy()
    for piece in np.split(np.arange(len(increments)), motion.piece_starts[1:]):
        edges = np.arange(len(piece) + 1) * motion.interval
        at = np.clip(edges - late_s, 0.0, edges[-1])
        # The unit is at rest before and after the piece: there, readings equal those at its ends.
        outside = np.diff(at) < (1.0 - 1e-9) * motion.interval
        ends = np.where(np.arange(len(piece)) < len(piece) // 2, piece[0], piece[-1])
        for axis in axes:
            sums = np.concatenate([[0.0], np.cumsum(increments[piece, axis])])
            out[piece, axis] = np.diff(np.interp(at, edges, sums))
            out[piece[outside], axis] = increments[ends[outside], axis]
    return out


def _delayed(
    case: Case, quantity: str, severity_ms: float, axes: Iterable[int] | None, rng: np.random.Generator
) -> Recording:
    """Recording with the integrals of some axes, or of one drawn at random, later or earlier."""
    motion, late = case.simulation.motion, sign(rng) * severity_ms * 1e-3
    axes = [int(rng.integers(3))] if axes is None else axes
    changes: dict[str, Any] = {
        name: _late(motion, getattr(motion, name), late, axes) for name in (quantity, f"{quantity}_abs")
    }
    return _read(case, replace(motion, **changes), rng)


@injection("sensor_time_offset", 5.0, "ms")
def sensor_time_offset(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The accelerometer readings are later or earlier than the gyro readings, but have the same time stamps."""
    return _delayed(case, "velocity", severity, range(3), rng)


def _axis_delayed(sensor: str, quantity: str) -> None:
    @injection(f"{sensor}_axis_delayed", 5.0, "ms")
    def axis_delayed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        """One sensor is later or earlier than the others, as with another filter or a multiplexed converter."""
        return _delayed(case, quantity, severity, None, rng)


_axis_delayed("gyro", "angle")
_axis_delayed("accel", "velocity")


@injection("samples_lost", 0.05, "s")
def samples_lost(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The logger drops samples in a rotation, but its time stamps have no gap.

    The later time stamps of the sequence are too early, and so is the label of its end window. The rotation is about a
    horizontal axis: about the vertical, a loss does not change the specific force and is equivalent to a rotation by
    another angle.
    """
    run = case.simulation
    recording, dt = run.recording, run.motion.interval
    lost = max(1, round(severity / dt))
    number = int(rng.integers(len(_IDS)))
    label = recording.sequences[number]
    first = recording.window_indices(label.start_static_s[1], label.end_static_s[0])
    force, angle = run.motion.velocity[first] / dt, run.motion.angle[first] / dt
    gravity_turns = np.linalg.norm(np.cross(angle, force), axis=1) > 0.5 * run.motion.site.gravity_m_s2
    at = first.start + int(rng.choice(np.flatnonzero(gravity_turns[:-lost])))
    after = recording.gaps[recording.gaps > at]
    stop = int(after[0]) if after.size else len(recording.time)
    keep = np.ones(len(recording.time), dtype=np.bool_)
    keep[at : at + lost] = False
    time = recording.time.copy()
    time[at + lost : stop] -= lost * dt
    a, b = label.end_static_s
    changed = replace(label, end_static_s=(a - lost * dt, b - lost * dt))
    return replace(
        recording,
        time=time[keep],
        gyro=recording.gyro[keep],
        accel=recording.accel[keep],
        sequences=(*recording.sequences[:number], changed, *recording.sequences[number + 1 :]),
        data_sha256=None,
    )


def _read(case: Case, motion: TrueMotion, rng: np.random.Generator) -> Recording:
    """Recording of another motion by the unit of a case."""
    run = case.simulation
    stated: dict[str, Any] = {name: getattr(run.scenario.recording, name) for name in ("kind", "state_noise", "serial")}
    recording = read_out(motion, run.truth, run.imu, rng, **stated)
    labels = motion.labels if run.scenario.recording.label_sequences else ()
    return replace(recording, sequences=labels, site=run.recording.site)
