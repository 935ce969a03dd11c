"""Candidate causes of a wrong scale: the ratios of a triad that no sound unit has, and what may have caused them.

The readings of a triad have a wrong scale if their ratio to the truth is impossible for an IMU (scale-factor errors may
be tens of per cent), or if all axes have a common factor that independent scale-factor errors do not explain. All
causes that are possible for such a ratio are compared by likelihood (:mod:`srt.diagnosis.scale_causes`). If the ratios
of one axis differ between rotations or poses, labels or windows are wrong, and no cause of a wrong scale is reported.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import DEG, DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.diagnosis.scale_causes import ScaleCause, most_likely
from srt.diagnosis.scale_ratios import UNKNOWN, stationary_force_scatter
from srt.diagnosis.stationary_rates import earth_rate_factor
from srt.model.table1 import AXES
from srt.sequences.plausibility import LEGAL_RATIO
from srt.sequences.wrong_units import WRONG_UNITS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.scale_ratios import ScaleRatios
    from srt.result.diagnostics import RunnerUp
    from srt.sequences.wrong_units import WrongUnit
    from srt.types import Array, Sensor

    Scales = tuple[ScaleRatios, ScaleRatios]

_G: Final = STANDARD_GRAVITY_M_S2


_MATCH: Final = math.log(1.8)
"""Largest distance of a ratio from a known factor, as a logarithm: allows for the errors of an uncalibrated IMU."""
_BOTH: Final = math.log(1.7)
"""Largest distance between the factors of gyros and accelerometers, as a logarithm, at which they count as equal:
scale-factor errors of ±25 % make a ratio of 1.67."""
_TIGHT: Final = 0.07
"""Largest distance from the factor of a unit, as a logarithm, at which whole numbers are readings in that unit and not
counts: readings in mg are often logged without decimals, and pulses of a fraction of an arc second can be whole numbers
of deg/h."""
_PRIORS: Final = {
    "unit": 1e-2,
    "other unit": 1e-3,
    "kind": 1e-2,
    "kind of one": 1e-3,
    "counts": 1e4,
    "range": 1e-2,
    "clock": 1e-2,
    "thinned": 1e-3,
    "time": 1e-3,
    "factor": 1e-3,
}
"""Prior probabilities of the kinds of causes, relative to no fault. Only their ratios matter. A scale ratio that is
known to 1 % outweighs them.

The value for counts applies to whole numbers, which have a probability of 1e-6 for other causes (:data:`_WHOLE`)."""
_CLOCKS: Final = 2.0 * math.log(100.0)
_FACTORS: Final = 2.0 * math.log(16.0)
_COUNTS: Final = math.log(1e9)
"""Widths of the ranges of the logarithms of unknown factors: of the clock, of a triad, and of counts per SI unit."""
_RATE: Final = "the sample rate is more likely {rate:.5g} Hz than {stated:.5g} Hz; correct sample_rate_hz"
_STAMPS: Final = "the clock of the time stamps, or the value of a count, is wrong by this factor; check both"
"""Advice on a wrong sample rate, as stated and as the time stamps have it."""
TIME_UNITS: Final = (
    (1e-3, "milliseconds", "seconds"),
    (1e-6, "microseconds", "seconds"),
    (1e-9, "nanoseconds", "seconds"),
    (1e3, "seconds", "milliseconds"),
    (1e6, "seconds", "microseconds"),
    (1e9, "seconds", "nanoseconds"),
    (60.0, "minutes", "seconds"),
    (1.0 / 60.0, "sixtieths of a second", "seconds"),
)
"""Factor that corrects the time stamps, their true unit, and the declared one."""
USUAL_S: Final = (1e-4, 0.11)
"""Usual sampling intervals, s: 10 kHz to a little less than 10 Hz."""
_UNUSUAL: Final = 1e-3
"""Prior probability of other sampling intervals, relative to usual ones."""
_MOST_THINNED: Final = 16
"""Largest number of increments of which one is kept."""
_POWERS: Final = tuple(k for k in range(-4, 5) if k)
"""Logarithms to base 2 of the ratios between the measuring ranges of one IMU: at most a factor of 16 (125 to 2000 °/s,
2 to 32 g)."""
_POWER_DISTANCE: Final = 0.04
"""Largest distance of the mean factor of a triad from a power of two, as a logarithm. For uncalibrated MEMS (1.5 %,
1-sigma), 1e-5 of the units exceed it. Of units with errors of tens of per cent, 1e-4 are within it by chance."""
_EVEN: Final = 0.4
"""Ratio of the smallest to the largest stretch of the specific force by the accelerometers, and of that to the
magnitude of the readings, below which they do not follow gravity: scale errors of 40 % make 0.43."""
_POWER_SCATTER: Final = 0.05
"""Largest standard deviation of the logarithms of the three axes about their mean for a common factor."""
_COMMON_SIGMAS: Final = 8.0
"""Smallest common factor, as a logarithm over the scatter of the axes, for a finding together with :data:`_COMMON`.
Independent errors exceed it in 0.5 % of all units, but exceed both only in units with errors of tens of per cent."""
_COMMON: Final = 0.05
"""Smallest common factor, as a logarithm, for a finding: uncalibrated MEMS are within 3 % (2-sigma)."""
_COMMON_SIGMAS_ALONE: Final = 57.7
"""Smallest common factor, as a logarithm over the scatter of the axes, for a finding whatever its size: p = 1e-4, where
Student's t with two degrees of freedom, which is √3 times this ratio, exceeds 100."""
_LEAST_COMMON: Final = 0.005
"""Smallest common factor, as a logarithm, that equal axes or the Earth rate may show."""
_EARTH_SIGMAS: Final = 5.0
"""Smallest deviation of the Earth rate for a finding, in sigma: p = 6e-7."""
_GRAVITY_VARIATION: Final = 0.01
"""Largest relative difference between two values of gravity on the Earth's surface (9.76 to 9.84 m/s²), rounded up."""
_WHOLE: Final = 1e-6
"""Largest distance from a whole number, due to rounding."""
_READINGS: Final = 4000
"""Number of readings from which a common step is taken."""
_COARSEST_COUNT: Final = 16
"""Largest common divisor of raw counts, whose lowest bits may be constant; a larger divisor is that of pulses."""
_FEWEST_COUNTS: Final = 10.0
"""Smallest range of the readings, in counts: with a smaller range, all readings may be whole numbers by chance."""
_MOST_COUNTS: Final = 2.0**52
"""Largest range of the readings, in counts: above it, every double is a whole number."""


def scale_cause(evidence: Evidence, scales: Scales | None = None) -> tuple[ScaleCause, RunnerUp | None]:
    """Most likely cause of the ratios of both triads, and the second most likely if it is nearly as likely.

    Parameters
    ----------
    evidence : Evidence
    scales : (ScaleRatios, ScaleRatios), optional
        Ratios of gyros and accelerometers; by default those of the readings.
    """
    gyro, accel = scales or (evidence.gyro_scales, evidence.accel_scales)
    if _without_gravity(evidence, accel):
        details = {"found": accel.typical * evidence.recording.site.gravity_m_s2}
        return ScaleCause(("gravity_absent",), details={"gravity_absent": details}), None
    if stationary_force_scatter(evidence.manoeuvres) > _MATCH and not accel.axis_scatter < _POWER_SCATTER:
        accel = UNKNOWN  # the specific force differs much between the windows: they are not stationary
    odd = {"gyro": _is_odd(evidence, "gyro", gyro, accel), "accel": _is_odd(evidence, "accel", accel, gyro)}
    if not any(odd.values()):
        return ScaleCause(), None
    sound = [ScaleCause()]
    by_gyro = (list(_of_one_triad(evidence, "gyro", gyro)) or sound) if odd["gyro"] else sound
    by_accel = (list(_of_one_triad(evidence, "accel", accel)) or sound) if odd["accel"] else sound
    causes = [*_of_both(evidence, gyro, accel), *(one & other for one in by_gyro for other in by_accel)]
    timed: Sensor = "gyro" if evidence.recording.kind == "rate" else "accel"
    if odd[timed]:
        clock = list(_of_clock(evidence, gyro if timed == "gyro" else accel))
        beside = by_accel if timed == "gyro" else by_gyro
        causes += [one & other for one in clock for other in beside]
    return most_likely(causes, gyro, accel, evidence.earth_rate)


def _without_gravity(evidence: Evidence, accel: ScaleRatios) -> bool:
    """True if the stationary specific force is far below gravity, and no multiple of that of the poses.

    In a wrong unit it is a multiple, with one magnitude, and a matrix that stretches all directions alike.
    """
    if evidence.data is None or evidence.accel_fit.rank < 3 or accel.typical >= LEGAL_RATIO["accel"][0]:
        return False
    stretch = np.linalg.svd(evidence.accel_fit.matrix, compute_uv=False)
    varies = stationary_force_scatter(evidence.manoeuvres) > _POWER_SCATTER
    uneven = stretch[2] < _EVEN * stretch[0] or accel.axis_scatter > _POWER_SCATTER
    return (varies and uneven) or bool(stretch[0] < _EVEN * accel.typical)


def _is_legal(sensor: Sensor, scales: ScaleRatios) -> bool:
    low, high = LEGAL_RATIO[sensor]
    return low < scales.typical < high


def _is_odd(evidence: Evidence, sensor: Sensor, scales: ScaleRatios, other: ScaleRatios) -> bool:
    """True if no sound unit has the ratio of a triad, or the factor that its axes have in common."""
    if not scales.known or not scales.by_axis:
        return scales.known and not _is_legal(sensor, scales)
    if not _is_legal(sensor, scales) or _one_axis(sensor, scales) is not None or _power_of_two(scales) is not None:
        return True
    # The stated gravity may be wrong within the variation over the Earth's surface.
    shift = abs(scales.common) - (_GRAVITY_VARIATION if sensor == "accel" else 0.0)
    if shift > max(_LEAST_COMMON, _COMMON_SIGMAS_ALONE * scales.scatter) or (
        shift > _COMMON and shift > _COMMON_SIGMAS * scales.scatter
    ):
        return True
    return (sensor == "gyro") == (evidence.recording.kind == "rate") and _confirmed_by_earth(evidence, scales, other)


def _confirmed_by_earth(evidence: Evidence, scales: ScaleRatios, other: ScaleRatios) -> bool:
    """True if the measured Earth rate is wrong by the common factor of the triad that depends on the clock.

    The clock is wrong then: no scale-factor error of a unit has this effect.
    """
    earth = earth_rate_factor(evidence.earth_rate)
    if earth is None or abs(scales.common) < _LEAST_COMMON or not other.known:
        return False
    expected = math.exp(-scales.common if evidence.recording.kind == "rate" else scales.common)
    doubt = math.hypot(earth.sigma, scales.scatter * expected)
    return abs(earth.value - 1.0) > _EARTH_SIGMAS * earth.sigma and abs(earth.value - expected) < 3.0 * doubt


# --- possible causes -------------------------------------------------------------------------------------------------


def _of_one_triad(evidence: Evidence, sensor: Sensor, scales: ScaleRatios) -> Iterator[ScaleCause]:
    """Possible causes of the ratios of only one triad: unit, counts, measuring range, one axis, or any factor."""
    rates = evidence.recording.kind == "rate"

    def cause(kind: str, fault: str, shift: float | Array, details: dict[str, Any], **more: Any) -> ScaleCause:
        prior = _PRIORS[kind] * _usual(evidence.dt)
        return ScaleCause((fault,), *_shifts(sensor, shift), prior=prior, details={fault: details}, **more)

    if not _is_legal(sensor, scales):
        off = math.log(scales.typical)
        near = [
            (abs(off - math.log(unit.factor)), unit) for unit in WRONG_UNITS[sensor] if rates or not unit.rates_only
        ]
        distance = min(d for d, _ in near)
        wholes = (1.0, *((DEG, DEG_PER_H) if sensor == "gyro" else (_G, 1e-3 * _G)))
        step = _common_step(getattr(evidence.recording, sensor), wholes[: 3 if rates else 2 if sensor == "gyro" else 1])
        if (0 < step <= _COARSEST_COUNT and distance > _TIGHT) or (step == 1 and sensor == "gyro"):
            # The readings are whole numbers, which other units make only with a negligible probability.
            fields = _fields(evidence, sensor, scales, None)
            yield cause("counts", f"{sensor}_counts", 0.0, fields, unknown={sensor: (_COUNTS, 0.0)})
            return
        for d, unit in near:
            if d < _MATCH:
                kind = "other unit" if unit.fault.endswith("other_unit") else "unit"
                yield cause(kind, unit.fault, math.log(unit.factor), _fields(evidence, sensor, scales, unit))
        of_interval = math.log(evidence.dt) * (1.0 if rates else -1.0)
        if abs(off - of_interval) < _MATCH:
            kinds = ("increments", "rates", "divide") if rates else ("rates", "increments", "multiply")
            names = dict(zip(("found", "declared", "remedy"), kinds, strict=True))
            details = {"ratio": scales.typical, "interval": evidence.dt, **names}
            yield cause("kind of one", f"{sensor}_kind", of_interval, details)
    count = round(1.0 / scales.typical)
    # Thinned increments without a rotation: the interval is longer than that of any IMU, but interval / count is not.
    if sensor == "accel" and not rates and count >= 2 and USUAL_S[0] <= evidence.dt / count <= USUAL_S[1] < evidence.dt:
        alone: dict[str, Any] = {"increments_thinned": {"count": count, "ratio": scales.typical}}
        shift = _shifts(sensor, math.log(scales.typical))
        yield ScaleCause(("increments_thinned",), *shift, prior=_PRIORS["thinned"], details=alone)
    power = _power_of_two(scales)
    clipped = _clipped(evidence, sensor)
    if power is not None and not (power < 1.0 and _mostly_clipped(evidence, clipped)):
        yield cause("range", f"{sensor}_lsb", math.log(power), _wrong_count(sensor, math.exp(scales.common), power))
    elif power is None and (one := _one_axis(sensor, scales)) is not None:
        axis, factor, other = one
        fault, details = f"{sensor}_lsb", _wrong_count(sensor, float(scales.axes[axis]), factor, axis)
        if other is not None:
            fault = other.fault
            details = _fields(evidence, sensor, replace(scales, typical=float(scales.axes[axis])), other)
            details |= {"title": f"gyro {AXES[axis]}"} if sensor == "gyro" else {}
        yield cause("range", fault, math.log(factor) * np.eye(3)[axis], details)
    elif _has_common_factor(scales, _FACTORS) and not clipped:
        details = {"ratio": math.exp(scales.common), "spread": _spread(scales)}
        yield cause("factor", f"{sensor}_factor", 0.0, details, unknown={sensor: (_FACTORS, 0.0)})


def _of_both(evidence: Evidence, gyro: ScaleRatios, accel: ScaleRatios) -> Iterator[ScaleCause]:
    """Possible causes that change both triads: increments declared as rates, the reverse, or thinned increments."""
    rates, dt = evidence.recording.kind == "rate", evidence.dt
    if not (gyro.known and accel.known):
        return
    if not _is_legal("gyro", gyro):
        factor = math.log(dt) if rates else -math.log(dt)
        turned, rest = math.log(gyro.typical), math.log(accel.typical)
        if abs(turned - rest) <= _BOTH and max(abs(turned - factor), abs(rest - factor)) <= _MATCH:
            fault = "increments_as_rates" if rates else "rates_as_increments"
            gravity = evidence.recording.site.gravity_m_s2
            details = {"accel": accel.typical * gravity, "turn": gyro.typical, "interval": dt}
            yield ScaleCause((fault,), factor, factor, prior=_PRIORS["kind"], details={fault: details})
    if not rates and gyro.by_axis and accel.by_axis and max(gyro.scatter, accel.scatter) < _POWER_SCATTER:
        count = max(1, round(math.exp(-0.5 * (gyro.common + accel.common))))
        off = max(abs(triad.common + math.log(count)) for triad in (gyro, accel))
        if 2 <= count <= _MOST_THINNED and off < _POWER_DISTANCE:
            fault, shift = "increments_thinned", -math.log(count)
            details = {"count": count, "ratio": math.exp(gyro.common)}
            yield ScaleCause((fault,), shift, shift, prior=_PRIORS["thinned"], details={fault: details})


def _of_clock(evidence: Evidence, scales: ScaleRatios) -> Iterator[ScaleCause]:
    """Possible causes in the clock, from the triad that depends on it: gyros of rates, accelerometers of increments."""
    rates, dt = evidence.recording.kind == "rate", evidence.dt
    timed: Sensor = "gyro" if rates else "accel"
    if not scales.known:
        return
    off = math.log(scales.typical)
    for factor, unit, declared in TIME_UNITS:
        shift = -math.log(factor) if rates else math.log(factor)
        if not USUAL_S[0] <= dt * factor <= USUAL_S[1]:
            continue
        why = f"and {'rotation angles are' if rates else 'gravity is'} {scales.typical:.3g} times the expected value"
        details: dict[str, Any] = {"interval": dt, "why": why, "unit": unit, "declared": declared}
        for power in (0, *_POWERS):
            also = power * math.log(2.0)
            if abs(off - shift - also) > (_POWER_DISTANCE if power else _MATCH):
                continue
            yield ScaleCause(
                ("time_unit", f"{timed}_lsb")[: 2 if power else 1],
                *_shifts(timed, shift + also),
                clock=-math.log(factor),
                prior=_PRIORS["time"] * (_PRIORS["range"] if power else 1.0),
                details={
                    "time_unit": details,
                    f"{timed}_lsb": _wrong_count(timed, math.exp(off - shift), 2.0**power),
                },
            )
    if not _has_common_factor(scales, _CLOCKS) or (rates and _clipped(evidence, "gyro")):
        return
    stated, ratio = 1.0 / dt, math.exp(scales.common)
    rate = stated * ratio if rates else stated / ratio
    if not USUAL_S[0] <= 1.0 / rate <= USUAL_S[1]:
        return
    details = {
        "sensor": "gyros" if rates else "accelerometers",
        "ratio": ratio,
        "spread": _spread(scales),
        "rate": rate,
        "stated": stated,
        "advice": _STAMPS if evidence.recording.sample_rate_hz is None else _RATE.format(rate=rate, stated=stated),
    }
    yield ScaleCause(
        ("sample_rate",),
        unknown={timed: (_CLOCKS, 1.0 if rates else -1.0)},
        prior=_PRIORS["clock"],
        details={"sample_rate": details},
    )


def _shifts(sensor: Sensor, shift: float | Array) -> tuple[float | Array, float | Array]:
    """Shifts of gyros and accelerometers, one of them zero."""
    return (shift, 0.0) if sensor == "gyro" else (0.0, shift)


def _usual(interval_s: float) -> float:
    """Prior probability of a sampling interval, relative to a usual one."""
    return 1.0 if USUAL_S[0] <= interval_s <= USUAL_S[1] else _UNUSUAL


def _clipped(evidence: Evidence, sensor: Sensor) -> set[int | None]:
    """Numbers of the sequences in which a triad saturates; None for the whole recording."""
    return {k for k, parts in evidence.clipped_parts for part in parts if part.channel.startswith(sensor)}


def _has_common_factor(scales: ScaleRatios, width: float) -> bool:
    """True if the axes of a triad have a common factor within a range of that width."""
    return scales.by_axis and scales.scatter < _POWER_SCATTER and abs(scales.common) < 0.5 * width


def _spread(scales: ScaleRatios) -> float:
    return float(np.std(np.log(scales.axes), ddof=1))


def _wrong_count(sensor: str, ratio: float, power: float, axis: int | None = None) -> dict[str, Any]:
    """Fields of the message on a wrong count value, for all axes or for one."""
    name = {"gyro": "gyro", "accel": "accelerometer"}[sensor]
    who = f"All {name} axes read" if axis is None else f"{name.capitalize()} {AXES[axis]} reads"
    return {"who": who, "ratio": ratio, "power": power}


def _one_axis(sensor: Sensor, scales: ScaleRatios) -> tuple[int, float, WrongUnit | None] | None:
    """Axis in another unit or range than the other two, which are right; its factor; and its unit, None for a range."""
    if not scales.by_axis or scales.axis_scatter > _POWER_SCATTER:
        return None
    logarithm = np.log(scales.axes)
    for axis in range(3):
        off = float(logarithm[axis])
        if np.abs(np.delete(logarithm, axis)).max() > _POWER_SCATTER or abs(off) < 0.5 * math.log(2.0):
            continue
        power = min(_POWERS, key=lambda k: abs(off - k * math.log(2.0)))
        units = (u for u in WRONG_UNITS[sensor] if not u.rates_only)
        nearest = min(units, key=lambda u: abs(off - math.log(u.factor)))
        if abs(off - power * math.log(2.0)) < _POWER_DISTANCE:
            return axis, 2.0**power, None
        if abs(off - math.log(nearest.factor)) < _POWER_SCATTER:
            return axis, nearest.factor, nearest
    return None


def _mostly_clipped(evidence: Evidence, clipped: set[int | None]) -> bool:
    """True if a triad saturates in most sequences, which makes its measured angles too small."""
    return evidence.data is not None and (None in clipped or len(clipped) > 0.5 * evidence.data.K)


def _fields(evidence: Evidence, sensor: str, scales: ScaleRatios, unit: WrongUnit | None) -> dict[str, object]:
    gravity = evidence.recording.site.gravity_m_s2
    names = {} if unit is None else {"unit": unit.unit, "declared": unit.declared}
    if sensor == "accel":
        return {"found": scales.typical * gravity, "expected": gravity, **names}
    return {"ratio": scales.typical, "title": _first_turn(evidence), **names}


def _first_turn(evidence: Evidence) -> str:
    """Name in messages of the sequence with the first rotation that is compared."""
    if evidence.data is None:
        return "free rotations"
    numbers, _, _ = evidence.rotations
    return evidence.title(int(numbers[0])) if len(numbers) else "free rotations"


def _common_step(table: Array, units: tuple[float, ...]) -> int:
    """Greatest common divisor of the readings in the first unit in which they are whole numbers; 0 if there is none."""
    some = table[:: max(1, len(table) // _READINGS)]
    for unit in units:
        numbers = some / unit
        nearest = np.rint(numbers)
        if np.abs(numbers - nearest).max() < _WHOLE and _FEWEST_COUNTS <= np.ptp(nearest) < _MOST_COUNTS:
            return int(np.gcd.reduce(nearest.astype(np.int64), axis=None))
    return 0


def _power_of_two(scales: ScaleRatios) -> float | None:
    """Power of two that is a common factor of all axes; None if there is none."""
    if not scales.by_axis:
        return None
    nearest = min(_POWERS, key=lambda k: abs(scales.common - k * math.log(2.0)))
    off = abs(scales.common - nearest * math.log(2.0))
    return 2.0**nearest if off < _POWER_DISTANCE and scales.scatter < _POWER_SCATTER else None
