"""Wrong statements of a file: units, kind of samples, count values, sample rates and axes."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from injected_faults.changes import restamped, sign, with_sensor
from injected_faults.injection import GRADES, Case, injection
from srt.constants import DEG, DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.recording.recording import Recording
from srt.types import Array

_G: Final = STANDARD_GRAVITY_M_S2


def _as_rates(case: Case) -> Recording:
    """Recording as rates for any grade, because some units apply only to rates."""
    return case.recording if case.recording.kind == "rate" else case.changed(recording={"kind": "rate"}).recording


def _at_rate(case: Case, rate_hz: float) -> Recording:
    """Recording at the sample rate ``rate_hz``."""
    sampled = round(1.0 / case.recording.nominal_interval_s, 6)
    return case.recording if rate_hz == sampled else case.changed(recording={"sample_rate_hz": rate_hz}).recording


# --- kinds and units -------------------------------------------------------------------------------------------------


@injection("increments_as_rates", 100.0, "Hz")
def increments_as_rates(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Increments at the sample rate ``severity`` are declared as rates."""
    recording = _at_rate(case, severity)
    per_sample = recording.nominal_interval_s if recording.kind == "rate" else 1.0
    return replace(recording, kind="rate", gyro=recording.gyro * per_sample, accel=recording.accel * per_sample)


@injection("rates_as_increments", 100.0, "Hz")
def rates_as_increments(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Rates at the sample rate ``severity`` are declared as increments."""
    recording = _at_rate(case, severity)
    per_sample = 1.0 if recording.kind == "rate" else recording.nominal_interval_s
    return replace(recording, kind="increment", gyro=recording.gyro / per_sample, accel=recording.accel / per_sample)


def _wrong_unit(fault: str, sensor: str, factors: tuple[float, ...], *, rates: bool) -> None:
    """Register readings in a unit other than declared; ``rates`` is True if one of the units applies only to rates."""

    @injection(fault, 1.0, "")
    def wrong_unit(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        recording = _as_rates(case) if rates else case.recording
        return with_sensor(recording, sensor, getattr(recording, sensor) * float(rng.choice(factors)))


_wrong_unit("gyro_degrees", "gyro", (1.0 / DEG,), rates=False)
_wrong_unit("gyro_radians", "gyro", (DEG,), rates=False)
_wrong_unit("gyro_per_hour", "gyro", (1.0 / DEG_PER_H, DEG / DEG_PER_H), rates=True)
_wrong_unit("gyro_milli", "gyro", (1e3,), rates=False)
_wrong_unit("accel_g", "accel", (1.0 / _G, 1e-3), rates=True)
_wrong_unit("accel_mg", "accel", (1e3 / _G, 1e3), rates=True)
_wrong_unit("accel_m_s2", "accel", (_G, 1e-3 * _G), rates=True)
_wrong_unit("gyro_other_unit", "gyro", (60.0 / (2.0 * np.pi),), rates=True)
_wrong_unit("accel_other_unit", "accel", (100.0, 1.0 / 0.3048), rates=True)


def _other_kind(fault: str, sensor: str) -> None:
    """Register readings of one sensor that are increments declared as rates, or the reverse."""

    @injection(fault, 1.0, "")
    def other_kind(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        recording, interval = case.recording, case.recording.nominal_interval_s
        factor = interval if recording.kind == "rate" else 1.0 / interval
        return with_sensor(recording, sensor, getattr(recording, sensor) * factor)


_other_kind("gyro_kind", "gyro")
_other_kind("accel_kind", "accel")


@injection("gravity_absent", 1.0, "")
def gravity_absent(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The readings are those of the unit less those of a better one in the same motion."""
    better = replace(case, grade="tactical-fog" if case.grade == "navigation-rlg" else "navigation-rlg")
    kind = case.recording.kind
    reference = better.changed(recording={"kind": kind}).recording
    return replace(case.recording, accel=case.recording.accel - reference.accel)


def _counts(fault: str, sensor: str, per_unit: Mapping[str, float], declared: tuple[float, ...]) -> None:
    """Register raw counts, declared in a physical unit.

    ``per_unit`` are the counts per SI unit of the readings, by grade; ``declared`` are the SI values of the units that
    are declared for rates. Increments use the first one.
    """

    @injection(fault, per_unit, "counts per SI unit")
    def counts(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        recording = case.recording
        units = declared if recording.kind == "rate" else declared[:1]
        values = np.round(getattr(recording, sensor) * severity) * float(rng.choice(units))
        return with_sensor(recording, sensor, values)


# By grade: pulses of 0.5" and 10 µm/s; 24-bit words over the range of increments in 10 ms; 16-bit words over the range
# of rates; the data sheet of the chip.
_counts(
    "gyro_counts",
    "gyro",
    dict(zip(GRADES, (7200.0 / DEG, 2.0**23 / (375.0 * DEG * 0.01), 2.0**15 / (400.0 * DEG), 65.5 / DEG), strict=True)),
    (1.0, DEG),
)
_counts(
    "accel_counts",
    "accel",
    dict(zip(GRADES, (1e5, 2.0**23 / (10.0 * _G * 0.01), 2.0**15 / (10.0 * _G), 8192.0 / _G), strict=True)),
    (1.0, _G),
)


_AS_SAMPLE_RATE: Final = (
    "The gyros do not resolve the Earth rate, so that a common factor of all gyros is not distinguished from a wrong "
    "sample rate."
)


def _one_factor(kind: str, sensor: str, severity: float, also: tuple[str, ...], unseen: Mapping[str, str]) -> None:
    """Register readings multiplied by one factor on all axes of a triad, or divided by it.

    A count value of another measuring range is a factor of 2, that of another unit any factor.
    """

    @injection(f"{sensor}_{kind}", severity, "times", also=also, unseen=unseen)
    def one_factor(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        factor = severity ** sign(rng)
        return with_sensor(case.recording, sensor, getattr(case.recording, sensor) * factor)


_one_factor("lsb", "gyro", 2.0, ("gyro_factor",), {})
_one_factor("lsb", "accel", 2.0, ("accel_factor",), {})
_one_factor("factor", "gyro", 1.25, (), {"consumer-mems": _AS_SAMPLE_RATE})
_one_factor("factor", "accel", 1.25, (), {})


@injection("increments_thinned", 1.0, "")
def increments_thinned(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Of every two to four increments one is kept, and the others are dropped instead of summed."""
    recording, step = case.recording, int(rng.integers(2, 5))
    per_sample = recording.nominal_interval_s if recording.kind == "rate" else 1.0
    rows = np.arange(int(rng.integers(step)), len(recording.time), step)
    return replace(
        recording,
        kind="increment",
        time=recording.time[rows],
        gyro=recording.gyro[rows] * per_sample,
        accel=recording.accel[rows] * per_sample,
    )


@injection("sample_rate", dict(zip(GRADES, (1.1, 1.1, 1.1, 1.4), strict=True)), "times")
def sample_rate(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Stamps and labels were computed with a sample rate that is wrong by the factor ``severity`` or its inverse."""
    factor = severity ** sign(rng)
    return restamped(case.recording, lambda time: time / factor)


# --- axes ------------------------------------------------------------------------------------------------------------


def _flip(rng: np.random.Generator) -> Array:
    signs = np.ones(3)
    signs[rng.integers(3)] = -1.0
    return np.diag(signs)


def _swap(rng: np.random.Generator) -> Array:
    i, j = rng.choice(3, 2, replace=False)
    axes = np.eye(3)
    axes[[i, j]] = axes[[j, i]]
    return axes


def _any(rng: np.random.Generator, handed: float) -> Array:
    """Random signed permutation of the axes other than identity, right-handed (``handed`` 1) or left-handed (-1)."""
    while True:
        axes: Array = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)[:, np.newaxis]
        simple = np.array_equal(axes, np.eye(3))
        if not simple and np.linalg.det(axes) * handed > 0.0:
            return axes


def _renamed(recording: Recording, gyro: Array | None, accel: Array | None) -> Recording:
    return replace(
        recording,
        gyro=recording.gyro if gyro is None else recording.gyro @ gyro.T,
        accel=recording.accel if accel is None else recording.accel @ accel.T,
    )


def _one_triad(fault: str, sensor: str, draw: Callable[[np.random.Generator], Array]) -> None:
    """Register the axes of one sensor renamed by a matrix."""

    @injection(fault, 1.0, "")
    def one_triad(case: Case, severity: float, rng: np.random.Generator) -> Recording:
        return with_sensor(case.recording, sensor, getattr(case.recording, sensor) @ draw(rng).T)


# The gyros output the rate of the world relative to the unit, the accelerometers gravity instead of specific force;
# one sensor is mounted upside down; two columns are exchanged.
for _fault, _draw in (("sign_convention", lambda rng: -np.eye(3)), ("axis_flipped", _flip), ("axes_swapped", _swap)):
    for _sensor in ("gyro", "accel"):
        _one_triad(f"{_sensor}_{_fault}", _sensor, _draw)


@injection("left_handed", 1.0, "")
def left_handed(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Both triads use a left-handed frame; the sense of rotations follows the right-hand or the left-hand rule.

    All axes reversed together with the left-hand rule is excluded: it is equivalent to ``accel_sign_convention``.
    """
    axes = _any(rng, -1.0)
    by_left_hand = rng.random() < 0.5 and not np.array_equal(axes, -np.eye(3))
    return _renamed(case.recording, -axes if by_left_hand else axes, axes)


@injection("frame_turned", 1.0, "")
def frame_turned(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit is mounted in an orientation other than the one that the sequences assume."""
    axes = _any(rng, 1.0)
    return _renamed(case.recording, axes, axes)


@injection("frames_disagree", 1.0, "")
def frames_disagree(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """Gyros and accelerometers are rotated relative to each other by multiples of 90°."""
    axes = _any(rng, 1.0)
    return _renamed(case.recording, axes, None) if rng.random() < 0.5 else _renamed(case.recording, None, axes)
