"""Faults of a laboratory, by a generator that shares nothing with the checks: units, wiring, logger, operator, fixture.

Each kind changes the plan of a test, the true motion, or the readings, of ``foreign_fixture.py`` and
``foreign_motion.py``; its size and place are drawn. :mod:`faults` measures what is said of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from foreign_fixture import LATITUDE_DEG, Motion, Trial, on_fixture, table_1
from foreign_motion import DEG, GRADES, PROFILES, START_DEG, attitudes, drawn_errors, hand_turns, true_samples
from scipy.signal import butter, lfilter, lfilter_zi
from scipy.spatial.transform import Rotation

Change = Callable[[Trial, float], None]


class Kind(NamedTuple):
    """Kind of fault: right causes, smallest and largest size, and its change of the plan, true motion, or readings.

    ``needs`` are the grades or the properties of a trial, one of which it must have.
    """

    causes: str
    low: float
    high: float
    change: Change
    stage: str = "readings"
    needs: str = ""


# --- units ----------------------------------------------------------------------------------------------------------


def scaled(t: Trial, _: float, *, gyro: float = 1.0, accel: float = 1.0) -> None:
    t.gyro, t.accel = t.gyro * gyro, t.accel * accel


def scaled_by_size(t: Trial, size: float, *, sensor: int, axes: slice | None = None) -> None:
    t.table(sensor)[:, slice(t.an_axis(), None, 3) if axes is None else axes] *= size ** t.a_sign()


def as_increments(t: Trial, size: float, *, gyro: bool = True, accel: bool = True) -> None:
    scaled(t, size, gyro=t.dt if gyro else 1.0, accel=t.dt if accel else 1.0)


def fast_clock(t: Trial, size: float, *, unit: float = 1.0) -> None:
    factor = unit * size ** t.a_sign()
    t.time = t.time * factor
    relabel(t, lambda a: a * factor)


def relabel(t: Trial, change: Callable[[float], float]) -> None:
    for label in t.labels:
        for key in ("start_static_s", "end_static_s"):
            label[key] = [change(a) for a in label[key]]


# --- wiring ---------------------------------------------------------------------------------------------------------


def mapped(t: Trial, _: float, *, sensors: tuple[int, ...], how: str) -> None:
    order, signs, i = [0, 1, 2], np.ones(3), t.an_axis()
    if how == "flip":
        signs[i] = -1.0
    elif how == "all":
        signs[:] = -1.0
    elif how == "two":
        signs[np.arange(3) != i] = -1.0
    elif how == "swap":
        order[i], order[i - 1] = order[i - 1], order[i]
    else:
        order = [1, 2, 0]
    for sensor in sensors:
        t.table(sensor)[:] = t.table(sensor)[:, order] * signs


def triads_exchanged(t: Trial, _: float) -> None:
    t.gyro, t.accel = t.accel, t.gyro


def column_twice(t: Trial, _: float, *, sensor: int) -> None:
    i = t.an_axis()
    t.table(sensor)[:, i] = t.table(sensor)[:, i - 1]


def broken_wire(t: Trial, size: float, *, sensor: int, noisy: bool) -> None:
    """From some time on, the share ``size`` of the test, one axis reads a constant, or the noise of its input."""
    i, n = t.an_axis(), len(t.time)
    first = int(t.rng.uniform(0.0, 1.0 - size) * n)
    part = slice(first, first + int(size * n))
    level = t.rng.normal(0.0, 10.0 * t.sample_noise[sensor])
    t.table(sensor)[part, i] = level
    if noisy:
        t.table(sensor)[part, i] += t.rng.normal(0.0, t.sample_noise[sensor], part.stop - part.start)


def dropouts(t: Trial, size: float, *, sensor: int) -> None:
    """Single readings of zero, while the input is not."""
    i = t.an_axis()
    for _ in range(round(size)):
        a, b = t.a_turn()
        at = a + int(np.argmax(np.abs(t.table(sensor)[a:b, i]))) + int(t.rng.integers(-3, 4))
        t.table(sensor)[at, i] = 0.0


# --- logger ---------------------------------------------------------------------------------------------------------


def lost(t: Trial, size: float, *, renumbered: bool, by_count: bool = False, places: int = 1) -> None:
    gone = np.zeros(len(t.time), dtype=bool)
    for _ in range(places):
        a, b = t.a_turn()
        n = max(1, min(round(size / t.dt), (b - a) // 2))
        first = int(t.rng.integers(a + (b - a) // 4, b - (b - a) // 4 - n // 2))
        gone[first : first + n] = True
    if renumbered and not by_count:  # the last label stays within the recording
        extended(t, 0, int(gone.sum()))
        gone = np.append(gone, np.zeros(int(gone.sum()), dtype=bool))
    t.without(gone, renumbered=renumbered, by_count=by_count)


def twice(t: Trial, size: float) -> None:
    """Every n-th sample of the turns is written again in place of the next one."""
    still = np.linalg.norm(t.rate.mean(axis=1), axis=1) < 0.02
    rows = np.flatnonzero(~still[:-1])[:: max(2, round(size))]
    for table in (t.gyro, t.accel):
        table[rows + 1] = table[rows]


def held(t: Trial, size: float, *, gyro: bool = True, accel: bool = True, line: bool = False) -> None:
    a, b = t.a_turn()
    n = min(round(size / t.dt), (b - a) - 2)
    first = a + int(t.rng.integers(0, b - a - n))
    for table, there in ((t.gyro, gyro), (t.accel, accel)):
        if there:
            ends = table[first], table[first + n] if line else table[first]
            table[first : first + n] = np.linspace(*ends, n, endpoint=False)


def jitter(t: Trial, size: float) -> None:
    t.time = t.time + np.clip(t.rng.normal(0.0, size * t.dt, len(t.time)), -0.45 * t.dt, 0.45 * t.dt)


def counted(t: Trial, sensor: int) -> tuple[np.ndarray, float]:
    """Readings of a triad in counts of a word of 16 bits that covers twice the largest reading, and the count."""
    lsb = np.abs(t.table(sensor)).max() / 2.0**14
    return np.rint(t.table(sensor) / lsb).astype(int), lsb


def bit_stuck(t: Trial, size: float, *, sensor: int) -> None:
    counts, lsb = counted(t, sensor)
    counts[:, t.an_axis()] |= 1 << round(size)
    t.table(sensor)[:] = lsb * counts


def wrapped(t: Trial, size: float, *, sensor: int) -> None:
    table = t.table(sensor)
    top = size * np.abs(table).max()
    table[:] = (table + top) % (2.0 * top) - top


def saturated(t: Trial, size: float, *, sensor: int, noisy: bool = False) -> None:
    table = t.table(sensor)
    top = size * np.abs(table).max()
    over = np.abs(table) > top
    table[:] = np.clip(table, -top, top)
    if noisy:
        table += over * t.rng.normal(0.0, t.sample_noise[sensor], table.shape)


def truncated(t: Trial, size: float, *, sensor: int) -> None:
    lsb = size * t.sample_noise[sensor]
    t.table(sensor)[:] = lsb * np.fix(t.table(sensor) / lsb)


def dead_band(t: Trial, size: float, *, subtracting: bool) -> None:
    width = size * (t.sample_noise[0] + np.abs([t.errors[f"gyro_bias_{a}"] for a in "xyz"]).max())
    shrunk = np.sign(t.gyro) * np.maximum(np.abs(t.gyro) - width, 0.0)
    t.gyro = shrunk if subtracting else np.where(np.abs(t.gyro) < width, 0.0, t.gyro)


def spikes(t: Trial, size: float, *, count: int) -> None:
    sensor, i = int(t.rng.integers(2)), t.an_axis()
    for _ in range(count):
        a, b = t.a_turn() if t.rng.random() < 0.5 else t.a_rest()
        t.table(sensor)[int(t.rng.integers(a, b)), i] += t.a_sign() * size * t.sample_noise[sensor]


def filtered(t: Trial, size: float, *, sensors: tuple[int, ...], high: bool = False) -> None:
    """Butterworth low-pass of first or second order at ``size`` Hz; high-pass of first order of ``size`` s."""
    corner, order = (1.0 / (2.0 * np.pi * size), 1) if high else (size, int(t.rng.integers(1, 3)))
    b, a = butter(order, corner, "highpass" if high else "lowpass", fs=1.0 / t.dt)
    for sensor in sensors:
        table = t.table(sensor)
        table[:] = lfilter(b, a, table, axis=0, zi=lfilter_zi(b, a)[:, None] * table[:1])[0]


def gravity_taken(t: Trial, size: float) -> None:
    slow = t.accel.copy()
    b, a = butter(1, 1.0 / (2.0 * np.pi * size), fs=1.0 / t.dt)
    t.accel = slow - lfilter(b, a, slow, axis=0, zi=lfilter_zi(b, a)[:, None] * slow[:1])[0]


def delayed(t: Trial, size: float, *, sensor: int, one: bool) -> None:
    axes = [t.an_axis()] if one else range(3)
    for i in axes:
        t.table(sensor)[:, i] = np.interp(t.time - size, t.time, t.table(sensor)[:, i])


def one_polarity(t: Trial, _: float, *, sensor: int) -> None:
    i = t.an_axis()
    t.table(sensor)[:, i] = np.maximum(t.a_sign() * t.table(sensor)[:, i], 0.0)


# --- operator -------------------------------------------------------------------------------------------------------


def extended(t: Trial, before: int, after: int) -> None:
    """Add samples of rest before and after the test, those of its ends in reverse order."""
    for name in ("gyro", "accel"):
        table = getattr(t, name)
        setattr(t, name, np.concatenate([table[before:0:-1], table, table[-2 : -2 - after : -1]]))
    t.time = t.dt * np.arange(1, len(t.gyro) + 1)


def labels_late(t: Trial, size: float) -> None:
    # A label may not reach beyond the recording: the test has more rest before and after.
    more = math.ceil(size / t.dt) + 1
    extended(t, more, more)
    shift = more * t.dt + size * t.a_sign()
    relabel(t, lambda a: a + shift)


def labels_drift(t: Trial, size: float) -> None:
    relabel(t, lambda a: a * (1.0 - size))


def names_changed(t: Trial, _: float, *, following: bool = False) -> None:
    names = [label["id"] for label in t.labels]
    i, j = t.rng.choice(len(names), 2, replace=False)
    if following:
        names = [*names[:i], *names[i + 1 :], names[i]]
    else:
        names[i], names[j] = names[j], names[i]
    for label, name in zip(t.labels, names, strict=True):
        label["id"] = name


def label_left_out(t: Trial, size: float) -> None:
    t.labels = [label for label in t.labels if label["id"] != str(round(size))]


def turned_wrong(t: Trial, size: float, *, back: bool = False) -> None:
    """The last turn of a sequence has another angle; the move after it leads to the planned start."""
    _, first, last = t.motion.sequences[int(t.rng.integers(len(t.motion.sequences) - 1))]
    while back and first != last:
        _, first, last = t.motion.sequences[int(t.rng.integers(len(t.motion.sequences) - 1))]
    turn = t.motion.turns[last]
    more = -2.0 * turn.angle_rad if back else size * DEG * t.a_sign()
    t.motion.turns[last] = replace(turn, angle_rad=turn.angle_rad + more)
    move, axis = t.motion.turns[last + 1], np.array(turn.axis) / np.linalg.norm(turn.axis)
    direct = Rotation.from_rotvec(np.array(move.axis) / np.linalg.norm(move.axis) * move.angle_rad)
    vector = (Rotation.from_rotvec(-more * axis) * direct).as_rotvec()
    angle = float(np.linalg.norm(vector))
    t.motion.turns[last + 1] = replace(move, axis=tuple(vector / angle), angle_rad=angle)


def two_units(t: Trial, _: float) -> None:
    first, accel = t.gyro, t.accel
    labels = t.labels
    t.read(drawn_errors(t.unit, t.rng))
    at = int(t.rng.uniform(0.3, 0.7) * len(first))
    t.gyro[:at], t.accel[:at], t.labels = first[:at], accel[:at], labels


def site_wrong(t: Trial, size: float, *, gravity: bool) -> None:
    if gravity:
        t.gravity += size * t.a_sign()
    else:
        t.latitude_deg = -t.latitude_deg


def noise_misstated(t: Trial, size: float) -> None:
    t.noise_factor = size ** t.a_sign()


# --- fixture and environment ----------------------------------------------------------------------------------------


def tilted(t: Trial, angle: np.ndarray) -> None:
    """Motion with a small further rotation of the body, (n + 1, 3) rad at the edges of the samples."""
    at, step = Rotation.from_rotvec(0.5 * (angle[1:] + angle[:-1])), np.diff(angle, axis=0) / t.dt
    parts = t.rate.shape[1]
    every = Rotation.from_quat(np.repeat(at.as_quat(), parts, axis=0))
    t.rate = every.inv().apply(t.rate.reshape(-1, 3)).reshape(t.rate.shape) + step[:, None]
    t.force = at.inv().apply(t.force)


def ringing(t: Trial, size: float) -> None:
    time, angle = t.edges(), np.zeros((len(t.force) + 1, 3))
    decay, frequency, axis = t.rng.uniform(0.5, 2.0), t.rng.uniform(1.5, 8.0), t.a_direction()
    for begin, _ in t.motion.rests()[1:]:
        s = np.maximum(time - begin, 0.0)
        angle += size * 1e-3 * (np.exp(-s / decay) * np.sin(2.0 * np.pi * frequency * s))[:, None] * axis
    tilted(t, angle)


def knocked(t: Trial, size: float, *, creeping: bool = False) -> None:
    a, b = t.a_rest()
    at = 0.5 * (a + b) * t.dt
    if creeping:
        course = np.clip((t.edges() - a * t.dt) / ((b - a) * t.dt), 0.0, 1.0)
    else:
        course = np.clip((t.edges() - at) / 0.15, 0.0, 1.0)
    tilted(t, course[:, None] * size * 1e-3 * t.a_direction())


def shaken(t: Trial, size: float) -> None:
    frequency = t.rng.uniform(5.0, 0.4 / t.dt)
    tilted(t, size * 1e-6 * np.sin(2.0 * np.pi * frequency * t.edges())[:, None] * t.a_direction())


def lever_arm(t: Trial, size: float) -> None:
    rate, arm = t.rate.mean(axis=1), size * t.a_direction()
    t.force = t.force + np.cross(np.gradient(rate, t.dt, axis=0), arm) + np.cross(rate, np.cross(rate, arm))


def loud(t: Trial, size: float) -> None:
    a, b = t.a_rest()
    sensor = int(t.rng.integers(2))
    t.table(sensor)[a:b] += t.rng.normal(0.0, size * t.sample_noise[sensor], (b - a, 3))


def drifting(t: Trial, size: float, *, sensor: int, step: bool = False) -> None:
    """Biases change by ``size`` sigma of the mean of a window."""
    share = t.time / t.time[-1]
    if step:
        course = (share > t.rng.uniform(0.3, 0.7)).astype(float)
    elif t.rng.random() < 0.5:
        course = share
    else:
        course = 1.0 - np.exp(-share / 0.2)
    t.moved = ("gyro_bias", "accel_bias")[sensor]
    t.table(sensor)[:] += course[:, None] * size * t.sample_noise[sensor] * math.sqrt(t.dt / 10.0) * t.a_direction()


def scale_drifting(t: Trial, size: float) -> None:
    t.moved = "gyro_scale"
    t.gyro *= 1.0 + size * (t.time / t.time[-1])[:, None]


def settling(t: Trial, size: float) -> None:
    b, a = butter(1, 1.0 / (2.0 * np.pi * 3.0), fs=1.0 / t.dt)
    slow = lfilter(b, a, t.accel, axis=0, zi=lfilter_zi(b, a)[:, None] * t.accel[:1])[0]
    t.accel = t.accel + size * (slow - t.accel)


_P = partial
_GYRO, _ACCEL, _WHOLE = {"sensor": 0}, {"sensor": 1}, slice(None)
# fmt: off
KINDS: dict[str, Kind] = {
    "gyros in deg/s": Kind("gyro_degrees", 1, 1, _P(scaled, gyro=1.0 / DEG)),
    "gyros in deg/h": Kind("gyro_per_hour", 1, 1, _P(scaled, gyro=3600.0 / DEG)),
    "gyros in mrad/s": Kind("gyro_milli", 1, 1, _P(scaled, gyro=1e3)),
    "gyros in rpm": Kind("gyro_other_unit", 1, 1, _P(scaled, gyro=30.0 / np.pi)),
    "accelerometers in g": Kind("accel_g", 1, 1, _P(scaled, accel=1.0 / 9.80665)),
    "accelerometers in mg": Kind("accel_mg", 1, 1, _P(scaled, accel=1e3 / 9.80665)),
    "accelerometers in cm/s2": Kind("accel_other_unit", 1, 1, _P(scaled, accel=100.0)),
    "accelerometers in ft/s2": Kind("accel_other_unit", 1, 1, _P(scaled, accel=1.0 / 0.3048)),
    "gyros give increments": Kind("gyro_kind", 1, 1, _P(as_increments, accel=False)),
    "accelerometers give increments": Kind("accel_kind", 1, 1, _P(as_increments, gyro=False)),
    "both give increments": Kind("increments_as_rates", 1, 1, as_increments),
    "count of gyros": Kind("gyro_lsb", 2, 2, _P(scaled_by_size, sensor=0, axes=_WHOLE)),
    "count of accelerometers": Kind("accel_lsb", 2, 2, _P(scaled_by_size, sensor=1, axes=_WHOLE)),
    "factor of gyros": Kind("gyro_factor sample_rate", 1.2, 1.7, _P(scaled_by_size, sensor=0, axes=_WHOLE)),
    "factor of accelerometers": Kind("accel_factor", 1.1, 1.7, _P(scaled_by_size, sensor=1, axes=_WHOLE)),
    "one gyro of another range": Kind("gyro_lsb", 2, 2, _P(scaled_by_size, **_GYRO)),
    "one accelerometer of another range": Kind("accel_lsb", 2, 2, _P(scaled_by_size, **_ACCEL)),
    "clock fast": Kind("sample_rate gyro_factor", 1.1, 1.6, fast_clock),
    "stamps in ms": Kind("time_unit", 1, 1, _P(fast_clock, unit=1e3)),
    "triads exchanged": Kind("sensors_exchanged", 1, 1, triads_exchanged),
    "samples lost with their stamps": Kind("gap_in_sequence", 0.1, 2, _P(lost, renumbered=False)),
    "samples lost, renumbered": Kind("samples_lost", 0.1, 2, _P(lost, renumbered=True, by_count=True)),
    "many samples lost, renumbered": Kind(
        "samples_lost", 0.02, 0.06, _P(lost, renumbered=True, by_count=True, places=30)),
    "samples lost, labels of a watch": Kind("samples_lost", 0.1, 2, _P(lost, renumbered=True), needs="labelled"),
    "many samples lost, labels of a watch": Kind(
        "samples_lost", 0.02, 0.06, _P(lost, renumbered=True, places=30), needs="labelled"),
    "samples written twice": Kind("samples_duplicated samples_lost", 10, 200, twice),
    "stall": Kind("samples_stuck", 0.3, 2, held),
    "gyros frozen": Kind("gyro_stuck", 0.3, 2, _P(held, accel=False)),
    "accelerometers frozen": Kind("accel_stuck", 0.3, 2, _P(held, gyro=False)),
    "gap bridged": Kind("samples_interpolated", 0.4, 2, _P(held, line=True)),
    "jitter": Kind("stamp_jitter", 0.05, 0.3, jitter),
    "dead band": Kind("gyro_dead_band", 2, 10, _P(dead_band, subtracting=False)),
    "dead band subtracted": Kind("gyro_dead_band", 2, 10, _P(dead_band, subtracting=True)),
    "one spike": Kind("spikes", 20, 2000, _P(spikes, count=1)),
    "five spikes": Kind("spikes", 20, 2000, _P(spikes, count=5)),
    "fifty spikes": Kind("spikes", 20, 2000, _P(spikes, count=50)),
    "low-pass of all": Kind("unsettled sensor_time_offset noisy_window", 0.5, 3, _P(filtered, sensors=(0, 1))),
    "low-pass of gyros": Kind("sensor_time_offset", 1.5, 10, _P(filtered, sensors=(0,))),
    "low-pass of accelerometers": Kind("sensor_time_offset", 1.5, 10, _P(filtered, sensors=(1,))),
    "gyros high-passed": Kind("gyro_high_passed", 3, 60, _P(filtered, sensors=(0,), high=True)),
    "gravity removed": Kind("gravity_removed", 0.5, 10, gravity_taken),
    "labels late": Kind("labels_shifted", 0.5, 5, labels_late, needs="labelled"),
    "labels of another clock": Kind("labels_shifted", 0.005, 0.02, labels_drift, needs="labelled"),
    "labels exchanged": Kind("labels_exchanged wrong_direction", 1, 1, names_changed, needs="labelled"),
    "a label forgotten": Kind(
        "labels_exchanged wrong_direction labels_shifted", 1, 1, _P(names_changed, following=True), needs="labelled"),
    "sequence left out": Kind("sequence_missing", 4, 14, label_left_out, needs="labelled"),
    "wrong angle": Kind("wrong_angle", 1, 8, turned_wrong, "plan", "labelled"),
    "wrong sense": Kind("wrong_direction labels_exchanged", 1, 1, _P(turned_wrong, back=True), "plan", "labelled"),
    "two units": Kind("units_joined accel_bias_drift gyro_bias_drift", 1, 1, two_units),
    "gravity misstated": Kind("gravity", 0.05, 0.2, _P(site_wrong, gravity=True)),
    "southern latitude": Kind("latitude", 1, 1, _P(site_wrong, gravity=False), needs="navigation tactical"),
    "noise misstated": Kind("gyro_noise accel_noise", 2, 5, noise_misstated, needs="stated"),
    "ringing": Kind("unsettled", 0.3, 3, ringing, "motion", "fixture"),
    "knock": Kind("bump", 0.3, 5, knocked, "motion"),
    "creep": Kind("creep", 1, 10, _P(knocked, creeping=True), "motion"),
    "shaken": Kind("vibration", 20, 200, shaken, "motion"),
    "lever arm": Kind("", 0.05, 0.5, lever_arm, "motion"),
    "loud window": Kind("noisy_window", 2, 8, loud),
    "gyro biases drift": Kind("gyro_bias_drift", 20, 100, _P(drifting, **_GYRO)),
    "accelerometer biases drift": Kind("accel_bias_drift", 20, 100, _P(drifting, **_ACCEL)),
    "gyro biases step": Kind("gyro_bias_drift units_joined", 20, 100, _P(drifting, **_GYRO, step=True)),
    "accelerometer biases step": Kind("accel_bias_drift units_joined", 20, 100, _P(drifting, **_ACCEL, step=True)),
    "gyro scales drift": Kind("gyro_scale_drift clock_drift", 3e-3, 2e-2, scale_drifting, needs="fixture"),
    "accelerometers settle": Kind("accel_settling", 1e-3, 1e-2, settling),
}
"""Kinds by name."""
for _n, _name in enumerate(("gyro", "accel")):
    KINDS |= {f"{_name} {kind}": row for kind, row in {
        "axis flipped": Kind(f"{_name}_axis_flipped", 1, 1, _P(mapped, sensors=(_n,), how="flip")),
        "axes swapped": Kind(f"{_name}_axes_swapped", 1, 1, _P(mapped, sensors=(_n,), how="swap")),
        "axes all flipped": Kind(f"{_name}_sign_convention", 1, 1, _P(mapped, sensors=(_n,), how="all")),
        "axes cyclic": Kind("frames_disagree", 1, 1, _P(mapped, sensors=(_n,), how="cyclic")),
        "column twice": Kind("columns_repeat", 1, 1, _P(column_twice, sensor=_n)),
        "wire broken": Kind(
            f"{_name}_axis_stuck {_name}_channel_dead", 0.2, 0.9, _P(broken_wire, sensor=_n, noisy=False)),
        "wire broken, noisy": Kind(f"{_name}_channel_dead", 0.2, 1.0, _P(broken_wire, sensor=_n, noisy=True)),
        "drop-outs": Kind("spikes", 1, 10, _P(dropouts, sensor=_n)),
        "bit stuck": Kind("bit_stuck", 4, 11, _P(bit_stuck, sensor=_n)),
        "wrapped": Kind(f"{_name}_wrapped", 0.6, 0.9, _P(wrapped, sensor=_n)),
        "saturated": Kind(f"{_name}_clipped", 0.6, 0.97, _P(saturated, sensor=_n)),
        "saturated, noisy": Kind(f"{_name}_clipped", 0.6, 0.97, _P(saturated, sensor=_n, noisy=True)),
        "truncated": Kind(f"{_name}_truncated", 0.5, 4, _P(truncated, sensor=_n)),
        "delayed": Kind("sensor_time_offset", 3e-3, 5e-2, _P(delayed, sensor=_n, one=False)),
        "axis delayed": Kind(f"{_name}_axis_delayed", 3e-3, 5e-2, _P(delayed, sensor=_n, one=True)),
        "of one polarity": Kind(f"{_name}_one_polarity", 1, 1, _P(one_polarity, sensor=_n)),
    }.items()}
# fmt: on


def trial(kind: Kind, size: float, seed: tuple[int, ...]) -> Trial:
    """Recording of a unit with the fault."""
    rng = np.random.default_rng((*seed, 1))
    needs = kind.needs.split()
    grade = str(rng.choice([name for name in GRADES if name in needs] or list(GRADES)))
    fixture = bool(rng.random() < 0.7) or bool({"fixture", "labelled"} & {*needs})
    labelled = fixture and (bool(rng.random() < 0.6) or "labelled" in needs)
    stated = bool(rng.random() < 0.5) or "stated" in needs
    dt = 1.0 / float(rng.choice([50.0, 100.0]))
    if fixture:
        rate = float(rng.uniform(40.0, 90.0)) * DEG
        motion = on_fixture(table_1(), rng, rest_s=float(rng.uniform(5.0, 12.0)), rate_rad_s=rate, sigma_rad=1e-3)
        profile = str(rng.choice(PROFILES[:2]))
    else:
        start = Rotation.from_euler("ZYX", START_DEG, degrees=True)
        motion, profile = Motion(start, 5.0, hand_turns(rng, shortest_s=1.0, rest_s=5.0)), "hand"
    t = Trial(grade, motion, fixture, labelled, stated, dt, np.random.default_rng((*seed, 2)), (*seed, 3), {})
    t.errors = drawn_errors(t.unit, rng)
    if kind.stage == "plan":
        kind.change(t, size)
    body = attitudes(motion.turns, motion.start, motion.first_rest_s, dt, profile, rng)
    t.rate, t.force = true_samples(body, dt, LATITUDE_DEG * DEG)
    if kind.stage == "motion":
        kind.change(t, size)
    t.read()
    if kind.stage == "readings":
        kind.change(t, size)
    return t


def drawn_fault(number: int, seed: int) -> tuple[str, tuple[str, ...], Trial]:
    """Title of a recording with a fault of drawn kind and size, the right causes, and the recording."""
    rng = np.random.default_rng((seed, number))
    name = str(rng.choice(list(KINDS)))
    kind = KINDS[name]
    size = float(np.exp(rng.uniform(math.log(kind.low), math.log(kind.high))))
    t = trial(kind, size, (seed, number))
    test = ("labelled " if t.labelled else "") + ("fixture" if t.fixture else "by hand")
    return f"{number}: {name} {size:.3g}, {t.grade}, {test}, {1.0 / t.dt:.0f} Hz", tuple(kind.causes.split()), t
