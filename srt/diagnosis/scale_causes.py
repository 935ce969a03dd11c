"""Causes of wrong scales, compared by likelihood: factors on gyros, accelerometers and clock.

Here a wrong value of a count (``gyro_lsb``, ``accel_lsb``: a power of two) competes with a wrong unit.

The measurements are the ratios of reading to truth of the three gyros and of the three accelerometers, and the Earth
rate in the stationary windows. A cause shifts the logarithms of the ratios by a known amount (another unit) or by an
unknown one (a sample rate). The Earth rate is measured with the gyro scale factors from the rotations, so that a factor
on the gyros cancels: only a wrong clock changes it. The remaining deviations of the ratios are the scale-factor errors
of the unit. They are modelled as normal and independent from axis to axis; the likelihood is averaged over their
unknown standard deviation. The most likely cause is a fault if its likelihood ratio to a sound unit exceeds one limit,
or if no sound unit has such ratios. If the ratios of one axis differ between rotations or poses, labels or windows are
wrong: the ratios then hardly distinguish the causes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import chain, product
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import log_softmax, voigt_profile

from srt.constants import EARTH_RATE_RAD_S
from srt.diagnosis.cause_comparison import CLOSE
from srt.diagnosis.triad_fits import RAW_SCALE, UNKNOWN, stationary_force_scatter
from srt.model.table1 import AXES
from srt.ranking import ranked
from srt.recording.schema import ACCEL_UNITS, GYRO_UNITS
from srt.recording.schema import TIME_UNITS as SECONDS
from srt.result.diagnostics import RunnerUp
from srt.sequences.plausibility import LEGAL_RATIO
from srt.sequences.wrong_units import WRONG_UNITS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.stationary_rates import EarthRate
    from srt.diagnosis.triad_fits import ScaleRatios
    from srt.sequences.wrong_units import WrongUnit
    from srt.types import Array, Mask, Sensor

FREQUENT: Final = 5e-3
RARE: Final = 5e-4
"""Prior probabilities of causes, relative to no fault. A cause is a fault if its likelihood ratio to no fault exceeds
that which makes a rare one as probable: at most so many sound units have errors that look like a wrong factor."""
_ROUNDING: Final = 1e-4
"""Smallest standard deviation of the logarithm of a ratio: labels and windows are not more accurate."""
_GRID: Final = np.geomspace(_ROUNDING, 1.0, 25)
"""Standard deviations of the scale-factor errors of a unit over which the likelihood is averaged."""
_LOG_WEIGHT: Final = log_softmax(-2.0 * np.log1p(np.square(_GRID / RAW_SCALE)))
"""Prior weights of them: they fall with the fourth power above the errors of uncalibrated MEMS, which are also the
half-width of the Cauchy distribution of an unknown factor (H. Jeffreys, Theory of Probability, 5.2)."""
GRAVITY_SIGMA: Final = 0.0035
"""Relative standard deviation of the stated gravity: 0.4 of its variation over the Earth (9.76 to 9.84 m/s²)."""
_MATCH: Final = math.log(LEGAL_RATIO["gyro"][1])
"""Largest distance of the logarithm of a ratio from that of a known factor, and of two such ratios from each other: the
errors of an uncalibrated IMU."""
_EQUAL: Final = 0.05
"""Largest scatter of ratios, and largest distance from a known factor, of an IMU that is not far off its nominal scale:
uncalibrated MEMS are within 3 % (2-sigma)."""
_EVEN: Final = 0.4
"""Smallest stretch of the specific force by the accelerometers, relative to the magnitude of the readings, below which
they do not follow gravity: scale errors of 40 % make 0.43."""
_LARGEST: Final = 16
"""Largest ratio between the measuring ranges of one IMU (125 to 2000 °/s, 2 to 32 g), largest number of increments of
which one is kept, and largest common divisor of raw counts (constant lowest bits); that of pulses is larger."""
_WHOLE: Final = 1e-6
"""Largest distance from a whole number, due to rounding, and probability of such readings in another unit."""
USUAL_S: Final = (1e-4, 0.11)
"""Usual sampling intervals, s: 10 kHz to a little less than 10 Hz."""
_SMALL: Final = (("ms", "milliseconds"), ("us", "microseconds"), ("ns", "nanoseconds"))
TIME_UNITS: Final = (
    (60.0, "minutes", "seconds"),
    (1.0 / 60.0, "sixtieths of a second", "seconds"),
    *((SECONDS[short], unit, "seconds") for short, unit in _SMALL),
    *((1.0 / SECONDS[short], "seconds", unit) for short, unit in _SMALL),
)
"""Factor that corrects the time stamps, their true unit, and the declared one."""
_RATE: Final = "the sample rate is more likely {rate:.5g} Hz than {stated:.5g} Hz; correct sample_rate_hz"
_STAMPS: Final = "the clock of the time stamps, or the value of a count, is wrong by this factor; check both"
"""Advice on a wrong sample rate, as stated and as the time stamps have it."""


@dataclass(frozen=True, slots=True, eq=False)
class ScaleCause:
    """Cause of the scales of both triads: one fault, one fault of each triad, or none for a sound unit.

    ``gyro`` and ``accel``, float or shape (3,), are the known parts of the logarithm of reading over truth; ``clock``
    is the logarithm of the stated interval over the true one. ``unknown`` gives, for each triad whose logarithm has an
    unknown part, the factor by which that contributes to ``clock``. ``prior`` is relative to that of no fault;
    ``details`` are the values for the message of each fault.
    """

    faults: tuple[str, ...] = ()
    gyro: float | Array = 0.0
    accel: float | Array = 0.0
    clock: float = 0.0
    unknown: Mapping[str, float] = field(default_factory=dict)
    prior: float = 1.0
    details: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __and__(self, other: ScaleCause) -> ScaleCause:
        """Both causes together."""
        return ScaleCause(
            self.faults + other.faults,
            self.gyro + other.gyro,
            self.accel + other.accel,
            self.clock + other.clock,
            {**self.unknown, **other.unknown},
            self.prior * other.prior,
            self.details | other.details,
        )


def scores(causes: Sequence[ScaleCause], gyro: ScaleRatios, accel: ScaleRatios, earth: EarthRate | None) -> Array:
    """Logarithms of the posterior probabilities of C causes, given all measurements, up to a constant, shape (C,)."""
    clock = np.array([cause.clock for cause in causes])[:, None, None]
    total, doubt = np.zeros((2, *clock.shape))
    for axis, (sensor, scales, common) in enumerate((("gyro", gyro, 0.0), ("accel", accel, GRAVITY_SIGMA))):
        if not scales.known:
            continue
        shift = np.array([np.broadcast_to(getattr(cause, sensor), 3) for cause in causes])
        unknown = np.array([cause.unknown.get(sensor, math.nan) for cause in causes])[:, None]
        own, mean, variance = _terms(scales, shift, math.hypot(common, scales.common_sigma), np.isfinite(unknown))
        on_clock = np.nan_to_num(unknown)
        total = total + np.expand_dims(own, 2 - axis)
        clock = clock + np.expand_dims(on_clock * mean, 2 - axis)
        doubt = doubt + np.expand_dims(on_clock**2 * variance, 2 - axis)
    if earth is not None:
        total = total + _earth_term(clock, doubt, *earth[:3])
    prior = np.log([cause.prior for cause in causes])
    return np.asarray(prior + np.logaddexp.reduce(np.logaddexp.reduce(total, axis=-1), axis=-1))


def _terms(scales: ScaleRatios, shift: Array, common: float, unknown: Mask) -> tuple[Array, Array, Array]:
    """Log-likelihoods (C, m) of a triad, mean deviations (C, 1) of its ratios from the shifts, and their variance (m,).

    They are for the m standard deviations of the scale-factor errors; ``shift`` has shape (C, 3). ``common`` is the
    standard deviation of an error that all axes have; to it, ``unknown``, shape (C, 1), adds an unknown factor.
    """
    n = len(scales.logarithms)
    left = scales.logarithms - shift[:, :n]
    mean = left.mean(axis=1, keepdims=True)
    s2 = _GRID**2 + (scales.axis_scatter if math.isfinite(scales.axis_scatter) else 1.0) ** 2 + _ROUNDING**2
    v = s2 / n + common**2
    square = np.sum((left - mean) ** 2, axis=1, keepdims=True)
    own = -0.5 * ((n - 1) * np.log(2.0 * np.pi * s2) + square / s2) + _LOG_WEIGHT
    known = -0.5 * (np.log(2.0 * np.pi * v) + mean**2 / v)
    return own + np.where(unknown, np.log(voigt_profile(mean, np.sqrt(v), RAW_SCALE)), known), mean, v


def _earth_term(clock: Array, doubt: Array, found: Array, sigma: Array, true: Array) -> Array:
    """Log-likelihood of the measured Earth rate, for the logarithm of the clock factor and its variance (any shape)."""
    # A stated interval that is too short raises all rates and their noise.
    sigma = sigma * np.maximum(1.0, np.exp(-clock))[..., None]
    expected = np.exp(-clock)[..., None] * true / sigma
    left = found / sigma - expected
    size, along = np.sum(expected**2, axis=-1), np.sum(expected * left, axis=-1)
    square = np.sum(left**2, axis=-1) - along**2 * doubt / (1.0 + doubt * size)
    normal = -0.5 * (square + np.log1p(doubt * size)) - np.sum(np.log(math.sqrt(2.0 * math.pi) * sigma), axis=-1)
    # For a wrong latitude, as frequent as another frequent fault, the Earth rate does not distinguish the causes.
    anywhere = math.log(FREQUENT / (math.pi * (2.0 * EARTH_RATE_RAD_S) ** 2))
    return np.asarray(np.logaddexp(normal, anywhere))


# --- possible causes -------------------------------------------------------------------------------------------------


def scale_cause(evidence: Evidence, gyro: ScaleRatios, accel: ScaleRatios) -> tuple[ScaleCause, RunnerUp | None]:
    """Most likely cause of the ratios of both triads, and the second most likely if it is nearly as likely."""
    if _without_gravity(evidence, accel):
        details = {"found": accel.typical * evidence.recording.site.gravity_m_s2}
        return ScaleCause(("gravity_absent",), details={"gravity_absent": details}), None
    if stationary_force_scatter(evidence.manoeuvres) > _MATCH and not accel.axis_scatter < _EQUAL:
        accel = UNKNOWN  # the specific force differs much between the windows: they are not stationary
    if not (gyro.known or accel.known):
        return ScaleCause(), None
    triads: dict[Sensor, ScaleRatios] = {"gyro": gyro, "accel": accel}
    # The clock acts on the gyros of rates, and on the accelerometers of increments.
    timed: Sensor
    other: Sensor
    timed, other = ("gyro", "accel") if evidence.recording.kind == "rate" else ("accel", "gyro")
    single = {sensor: _of_one_triad(evidence, sensor, triad) for sensor, triad in triads.items()}
    pairs = chain(product(*single.values()), product(_of_clock(evidence, timed, triads[timed]), single[other]))
    causes = [*_of_both(evidence, gyro, accel), *(one & two for one, two in pairs)]
    # The scale factors of saturated gyros, with which the Earth rate is measured, are those of part of the rotations.
    measured = len(causes) > 1 and not _clipped(evidence, "gyro")
    by_score = scores(causes, gyro, accel, evidence.earth_rate if measured else None)
    order = ranked(by_score, scale=1.0)
    best, lower = causes[order[0]], by_score[order[0]] - by_score
    sound = [k for k, cause in enumerate(causes) if not cause.faults]
    if sound and lower[sound[0]] < math.log(best.prior / RARE):
        return ScaleCause(), None
    for k in order.tolist():
        if causes[k].faults[:1] not in ((), best.faults[:1]):
            return best, RunnerUp(causes[k].faults[0], float(lower[k])) if lower[k] < CLOSE else None
    return best, None


def _without_gravity(evidence: Evidence, accel: ScaleRatios) -> bool:
    """True if the stationary specific force is far below gravity, and no multiple of that of the poses.

    In a wrong unit it is a multiple, with one magnitude, and a matrix that stretches all directions alike.
    """
    if evidence.data is None or evidence.accel_fit.rank < 3 or accel.typical >= LEGAL_RATIO["accel"][0]:
        return False
    least = np.linalg.norm(evidence.accel_fit.matrix, ord=-2)  # smallest singular value
    scatter = min(accel.axis_scatter, stationary_force_scatter(evidence.manoeuvres))
    return bool(least < _EVEN * accel.typical) or scatter > _EQUAL


def _is_legal(sensor: Sensor, scales: ScaleRatios) -> bool:
    low, high = LEGAL_RATIO[sensor]
    return low < scales.typical < high


def _of_one_triad(evidence: Evidence, sensor: Sensor, scales: ScaleRatios) -> list[ScaleCause]:
    """Possible causes of the ratios of only one triad: a sound one, unless none has such a ratio, or those below."""
    if not scales.known:
        return [ScaleCause()]
    usual = 1.0 if _is_usual(evidence.dt) else RARE
    legal = _is_legal(sensor, scales)
    wrong = (() if legal else _other_units(evidence, sensor, scales), _other_scales(evidence, sensor, scales))
    causes = [replace(cause, prior=usual * cause.prior) for cause in chain(*wrong)]
    return [ScaleCause(), *causes] if legal or not causes else causes


def _cause(sensor: Sensor, prior: float, fault: str, shift: float | Array, details: Any, **more: Any) -> ScaleCause:
    more[sensor] = shift
    return ScaleCause((fault,), prior=prior, details={fault: details}, **more)


def _other_units(evidence: Evidence, sensor: Sensor, scales: ScaleRatios) -> Iterator[ScaleCause]:
    """Counts, units or the kind of one triad."""
    rates, dt = evidence.recording.kind == "rate", evidence.dt
    off = math.log(scales.typical)
    near = [(abs(off - math.log(u.factor)), u) for u in WRONG_UNITS[sensor] if rates or not u.rates_only]
    step = _common_step(evidence, sensor)
    # Readings in mg are often logged without decimals, and pulses of a fraction of an arc second can be whole numbers
    # of deg/h: near the factor of a unit, whole numbers are readings in that unit.
    if (0 < step <= _LARGEST and min(d for d, _ in near) > _EQUAL) or (step == 1 and sensor == "gyro"):
        fields = _fields(evidence, sensor, scales.typical, None)
        yield _cause(sensor, FREQUENT / _WHOLE, f"{sensor}_counts", 0.0, fields, unknown={sensor: 0.0})
        return
    for d, unit in near:
        if d < _MATCH:
            prior = RARE if unit.fault.endswith("other_unit") else FREQUENT
            fields = _fields(evidence, sensor, scales.typical, unit)
            yield _cause(sensor, prior, unit.fault, math.log(unit.factor), fields)
    of_interval = math.log(dt) if rates else -math.log(dt)
    if abs(off - of_interval) < _MATCH:
        found, declared, remedy = ("increments", "rates", "divide") if rates else ("rates", "increments", "multiply")
        kind = {"ratio": scales.typical, "interval": dt, "found": found, "declared": declared, "remedy": remedy}
        yield _cause(sensor, RARE, f"{sensor}_kind", of_interval, kind)


def _other_scales(evidence: Evidence, sensor: Sensor, scales: ScaleRatios) -> Iterator[ScaleCause]:
    """Measuring range or any other factor of a triad; range or unit of one axis, of which the other two are right."""
    logarithms = scales.logarithms
    axis = int(np.argmax(np.abs(logarithms)))
    if _has_common_factor(scales):
        clipped, ratio = _clipped(evidence, sensor), math.exp(scales.common)
        # Saturation in most sequences makes the measured angles too small.
        mostly = evidence.data is not None and (None in clipped or len(clipped) > 0.5 * evidence.data.K)
        power = _nearest_power(scales.common)
        if power is not None and (power > 1.0 or not mostly):
            yield _cause(sensor, FREQUENT, f"{sensor}_lsb", math.log(power), _wrong_count(sensor, ratio, power))
        if not clipped and abs(scales.common) < math.log(_LARGEST):
            common = {"ratio": ratio, "spread": scales.spread}
            yield _cause(sensor, RARE, f"{sensor}_factor", 0.0, common, unknown={sensor: 0.0})
    elif scales.by_axis and max(scales.axis_scatter, *np.abs(np.delete(logarithms, axis))) < _EQUAL:
        own, only = float(logarithms[axis]), np.eye(3)[axis]
        if (power := _nearest_power(own)) is not None:
            fields = _wrong_count(sensor, math.exp(own), power, axis)
            yield _cause(sensor, FREQUENT, f"{sensor}_lsb", math.log(power) * only, fields)
        for unit in WRONG_UNITS[sensor]:
            if not unit.rates_only and abs(own - math.log(unit.factor)) < _EQUAL:
                fields = _fields(evidence, sensor, math.exp(own), unit)
                fields |= {"title": f"gyro {AXES[axis]}"} if sensor == "gyro" else {}
                yield _cause(sensor, FREQUENT, unit.fault, math.log(unit.factor) * only, fields)


def _of_both(evidence: Evidence, gyro: ScaleRatios, accel: ScaleRatios) -> Iterator[ScaleCause]:
    """Possible causes that change both triads: increments declared as rates, the reverse, or thinned increments."""
    rates, dt = evidence.recording.kind == "rate", evidence.dt
    shift = math.log(dt) if rates else -math.log(dt)
    triads = [triad for triad in (gyro, accel) if triad.known]
    near = np.ptp([shift, *(math.log(triad.typical) for triad in triads)]) <= _MATCH
    if near and len(triads) == 2 and not _is_legal("gyro", gyro):
        fault = "increments_as_rates" if rates else "rates_as_increments"
        found = accel.typical * evidence.recording.site.gravity_m_s2
        details = {"accel": found, "turn": gyro.typical, "interval": dt}
        yield ScaleCause((fault,), shift, shift, prior=FREQUENT, details={fault: details})
    count = round(math.exp(-sum(triad.common for triad in triads) / len(triads)))
    if rates or count < 2:
        return
    shift = -math.log(count)
    equal = all(triad.by_axis and abs(triad.common - shift) < _EQUAL for triad in triads)
    # Without a rotation: the interval is longer than that of any IMU, but interval / count is not.
    late = not gyro.known and dt > USUAL_S[1] and _is_usual(dt / count)
    if (equal and len(triads) == 2 and count <= _LARGEST) or late:
        details = {"count": count, "ratio": math.exp(triads[0].common)}
        yield ScaleCause(("increments_thinned",), shift, shift, prior=RARE, details={"increments_thinned": details})


def _of_clock(evidence: Evidence, timed: Sensor, scales: ScaleRatios) -> Iterator[ScaleCause]:
    """Possible causes in the clock, from the ratios of the triad that depends on it."""
    if not scales.known:
        return
    rates, dt = evidence.recording.kind == "rate", evidence.dt
    sense = 1.0 if rates else -1.0
    for factor, unit, declared in TIME_UNITS:
        left = math.log(scales.typical) + sense * math.log(factor)
        power = 1.0 if abs(left) <= _MATCH else _nearest_power(left)
        if power is None or not _is_usual(dt * factor):
            continue
        why = f"and {'rotation angles are' if rates else 'gravity is'} {scales.typical:.3g} times the expected value"
        shift: dict[str, Any] = {timed: math.log(power) - sense * math.log(factor)}
        yield ScaleCause(
            ("time_unit", f"{timed}_lsb")[: 1 if power == 1.0 else 2],
            clock=-math.log(factor),
            prior=RARE * (1.0 if power == 1.0 else FREQUENT),
            details={
                "time_unit": {"interval": dt, "why": why, "unit": unit, "declared": declared},
                f"{timed}_lsb": _wrong_count(timed, math.exp(left), power),
            },
            **shift,
        )
    stated, ratio = 1.0 / dt, math.exp(scales.common)
    rate = stated * ratio**sense
    if not (_has_common_factor(scales) and _is_usual(1.0 / rate)) or (rates and _clipped(evidence, "gyro")):
        return
    details = {
        "sensor": "gyros" if rates else "accelerometers",
        "ratio": ratio,
        "spread": scales.spread,
        "rate": rate,
        "stated": stated,
        "advice": _STAMPS if evidence.recording.sample_rate_hz is None else _RATE.format(rate=rate, stated=stated),
    }
    yield ScaleCause(("sample_rate",), unknown={str(timed): sense}, prior=FREQUENT, details={"sample_rate": details})


def _is_usual(interval_s: float) -> bool:
    return USUAL_S[0] <= interval_s <= USUAL_S[1]


def _clipped(evidence: Evidence, sensor: Sensor) -> set[int | None]:
    """Numbers of the sequences in which a triad saturates; None for the whole recording."""
    return {k for k, parts in evidence.clipped_parts for part in parts if part.channel.startswith(sensor)}


def _has_common_factor(scales: ScaleRatios) -> bool:
    return scales.by_axis and scales.scatter < _EQUAL


def _nearest_power(off: float) -> float | None:
    """Power of two nearest to a factor, from its logarithm; None if it is no factor of the ranges of one IMU."""
    power = 2.0 ** round(off / math.log(2.0))
    return power if power != 1.0 and 1.0 / _LARGEST <= power <= _LARGEST else None


def _wrong_count(sensor: Sensor, ratio: float, power: float, axis: int | None = None) -> dict[str, Any]:
    """Fields of the message on a wrong count value, for all axes or for one."""
    name = {"gyro": "gyro", "accel": "accelerometer"}[sensor]
    who = f"All {name} axes read" if axis is None else f"{name.capitalize()} {AXES[axis]} reads"
    return {"who": who, "ratio": ratio, "power": power}


def _fields(evidence: Evidence, sensor: Sensor, ratio: float, unit: WrongUnit | None) -> dict[str, Any]:
    """Fields of the message on a wrong unit; its title is the sequence with the first rotation that is compared."""
    gravity = evidence.recording.site.gravity_m_s2
    names = {} if unit is None else {"unit": unit.unit, "declared": unit.declared}
    if sensor == "accel":
        return {"found": ratio * gravity, "expected": gravity, **names}
    title = "free rotations"
    if evidence.data is not None and len(evidence.rotations.nominal):
        title = evidence.title(int(evidence.rotations.sequence[0]))
    return {"ratio": ratio, "title": title, **names}


def _common_step(evidence: Evidence, sensor: Sensor) -> int:
    """Greatest common divisor of the readings in the first unit in which they are whole numbers; 0 if there is none."""
    table, units = (evidence.some[0], GYRO_UNITS) if sensor == "gyro" else (evidence.some[1], ACCEL_UNITS)
    for unit in units[evidence.recording.kind].values():
        numbers = table / unit
        nearest = np.rint(numbers)
        # Above 2⁵² = 1/ε, every double is a whole number.
        if np.abs(numbers - nearest).max() < _WHOLE and 0.0 < np.ptp(nearest) < 1.0 / np.finfo(float).eps:
            return int(np.gcd.reduce(nearest.astype(np.int64), axis=None))
    return 0
