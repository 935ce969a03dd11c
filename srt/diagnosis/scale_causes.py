"""Causes of wrong scales, compared by likelihood: factors on gyros, accelerometers and clock.

The readings of a triad have a wrong scale if their ratio to the truth is impossible for an IMU (scale-factor errors may
be tens of per cent), or if all axes have a common factor that independent scale-factor errors do not explain. All
causes that are possible for such a ratio are compared by likelihood. If the ratios of one axis differ between rotations
or poses, labels or windows are wrong, and no cause of a wrong scale is reported.

The measurements are the ratios of reading to truth of the three gyros and of the three accelerometers, and the Earth
rate in the stationary windows. A cause shifts the logarithms of the ratios by a known amount (another unit) or by an
unknown one (a sample rate). The Earth rate is measured with the gyro scale factors from the rotations, so that a factor
on the gyros cancels: only a wrong clock changes it. The remaining deviations of the ratios are the scale-factor errors
of the unit. They are modelled as normal and independent from axis to axis; the likelihood is averaged over their
unknown standard deviation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import log_softmax, logsumexp

from srt.constants import DEG, DEG_PER_H, EARTH_RATE_RAD_S, STANDARD_GRAVITY_M_S2
from srt.diagnosis.cause_comparison import CLOSE
from srt.diagnosis.false_alarms import limit
from srt.diagnosis.scale_ratios import UNKNOWN, stationary_force_scatter
from srt.model.table1 import AXES
from srt.result.diagnostics import RunnerUp
from srt.sequences.plausibility import LEGAL_RATIO
from srt.sequences.wrong_units import WRONG_UNITS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.scale_ratios import ScaleRatios
    from srt.diagnosis.stationary_rates import EarthRate
    from srt.sequences.wrong_units import WrongUnit
    from srt.types import Array, Sensor

    Scales = tuple[ScaleRatios, ScaleRatios]

FREQUENT: Final = 1e-2
RARE: Final = 1e-3
"""Prior probabilities of causes, relative to no fault. Only their ratios matter: a scale ratio that is known to 1 %
outweighs them."""
_ROUNDING: Final = 1e-4
"""Smallest standard deviation of the logarithm of a ratio: labels and windows are not more accurate."""
_GRID: Final = np.geomspace(_ROUNDING, 1.0, 25)
"""Standard deviations of the scale-factor errors of a unit over which the likelihood is averaged."""
_USUAL: Final = 0.02
"""Standard deviation of scale-factor errors above which the prior weight falls with its square: uncalibrated MEMS."""
_LOG_WEIGHT: Final = log_softmax(-np.log1p(np.square(_GRID / _USUAL)))
GRAVITY_SIGMA: Final = 0.0035
"""Relative standard deviation of the stated gravity: 0.4 of its variation over the Earth (9.76 to 9.84 m/s²)."""
# Limits of factors are limits of their logarithms.
_MATCH: Final = math.log(1.8)
"""Largest distance of a ratio from a known factor, and of two such ratios from each other: allows for the errors of an
uncalibrated IMU, of which ±25 % make a ratio of 1.67."""
_EQUAL: Final = 0.05
"""Largest scatter of axes with a common factor, and smallest such factor for a finding at :data:`_COMMON_SIGMAS`:
uncalibrated MEMS are within 3 % (2-sigma)."""
_POWER_DISTANCE: Final = 0.04
"""Largest distance of the mean factor of a triad from a power of two, or of a whole number of thinned increments. For
uncalibrated MEMS (1.5 %, 1-sigma), 1e-5 of the units exceed it. Of units with errors of tens of per cent, 1e-4 are
within it by chance."""
_COMMON_SIGMAS: Final = 8.0
"""Smallest common factor over the scatter of the axes for a finding together with :data:`_EQUAL`. Independent errors
exceed it in 0.5 % of all units, but exceed both only in units with errors of tens of per cent."""
_COMMON_SIGMAS_ALONE: Final = limit("t", 2, both_sides=True, shared=1e-4) / math.sqrt(3.0)
"""Smallest common factor over the scatter of the axes for a finding whatever its size: √3 times this ratio is
distributed as t with two degrees of freedom."""
_LEAST_COMMON: Final = 0.005
"""Smallest common factor that equal axes or the Earth rate may show."""
_EARTH_SIGMAS: Final = 5.0
"""Smallest deviation of the Earth rate for a finding, in sigma: p = 6e-7."""
_EVEN: Final = 0.4
"""Ratio of the smallest to the largest stretch of the specific force by the accelerometers, and of that to the
magnitude of the readings, below which they do not follow gravity: scale errors of 40 % make 0.43."""
_LARGEST: Final = 16
"""Largest ratio between the measuring ranges of one IMU (125 to 2000 °/s, 2 to 32 g), largest number of increments of
which one is kept, and largest common divisor of raw counts (constant lowest bits); that of pulses is larger."""
_COUNTS: Final = math.log(1e9)
"""Width of the range of counts per SI unit."""
_WHOLE: Final = 1e-6
"""Largest distance from a whole number, due to rounding, and probability of such readings in another unit."""
_FEWEST_COUNTS: Final = 10.0
"""Smallest range of the readings, in counts: with a smaller range, all readings may be whole numbers by chance."""
USUAL_S: Final = (1e-4, 0.11)
"""Usual sampling intervals, s: 10 kHz to a little less than 10 Hz."""
_THOUSANDTHS: Final = tuple(enumerate(("milliseconds", "microseconds", "nanoseconds"), 1))
TIME_UNITS: Final = (
    *((1e3**-n, unit, "seconds") for n, unit in _THOUSANDTHS),
    *((1e3**n, "seconds", unit) for n, unit in _THOUSANDTHS),
    (60.0, "minutes", "seconds"),
    (1.0 / 60.0, "sixtieths of a second", "seconds"),
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
    unknown part, its range and the factor by which it contributes to ``clock``. ``prior`` is relative to that of no
    fault; ``details`` are the values for the message of each fault.
    """

    faults: tuple[str, ...] = ()
    gyro: float | Array = 0.0
    accel: float | Array = 0.0
    clock: float = 0.0
    unknown: Mapping[str, tuple[float, float]] = field(default_factory=dict)
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


def score(cause: ScaleCause, gyro: ScaleRatios, accel: ScaleRatios, earth: EarthRate | None) -> float:
    """Logarithm of the posterior probability of a cause, given all measurements, up to a constant."""
    total, clock, doubt = np.zeros((1, 1)), np.full((1, 1), cause.clock), np.zeros((1, 1))
    for axis, (sensor, scales, shift, common) in enumerate(
        (("gyro", gyro, cause.gyro, 0.0), ("accel", accel, cause.accel, GRAVITY_SIGMA))
    ):
        width, on_clock = cause.unknown.get(sensor, (None, 0.0))
        own, mean, variance = np.expand_dims(_terms(scales, shift, width, common), 2 - axis)
        total = total + own
        clock, doubt = clock + on_clock * mean, doubt + on_clock**2 * variance
    by_earth = 0.0 if earth is None else _earth_term(clock, doubt, *earth)
    return math.log(cause.prior) + float(logsumexp(total + by_earth))


def _terms(scales: ScaleRatios, shift: float | Array, width: float | None, common: float) -> Array:
    """Log-likelihood of a triad, mean deviation of its ratios from the shift, and variance of that mean.

    Shape (3, m), for the m standard deviations of the scale-factor errors; ``common`` is the standard deviation of an
    error that all axes have. If ``width`` is given, the shift has an unknown part, uniformly distributed over it.
    """
    if not scales.known:
        return np.zeros((3, 1))
    left = scales.logarithms - shift
    n, mean = len(left), float(left.mean())
    s2 = _GRID**2 + (scales.axis_scatter if math.isfinite(scales.axis_scatter) else 1.0) ** 2 + _ROUNDING**2
    v = s2 / n + common**2
    own = -0.5 * ((n - 1) * np.log(2.0 * np.pi * s2) + float(np.sum((left - mean) ** 2)) / s2) + _LOG_WEIGHT
    of_mean = -0.5 * (np.log(2.0 * np.pi * v) + mean**2 / v) if width is None else -math.log(width)
    return np.stack([own + of_mean, np.full(len(v), mean), v])


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


def most_likely(
    causes: Iterable[ScaleCause], gyro: ScaleRatios, accel: ScaleRatios, earth: EarthRate | None
) -> tuple[ScaleCause, RunnerUp | None]:
    """Most likely cause, and the second most likely one with another first fault, if it is nearly as likely."""
    ranked = sorted(((score(cause, gyro, accel, earth), cause) for cause in causes), key=lambda row: -row[0])
    top, best = ranked[0]
    for value, other in ranked:
        if other.faults[:1] not in ((), best.faults[:1]):
            return best, RunnerUp(other.faults[0], top - value) if top - value < CLOSE else None
    return best, None


# --- possible causes -------------------------------------------------------------------------------------------------


def scale_cause(evidence: Evidence, scales: Scales | None = None) -> tuple[ScaleCause, RunnerUp | None]:
    """Most likely cause of the ratios of both triads, and the second most likely if it is nearly as likely.

    ``scales`` are the ratios of gyros and accelerometers; by default those of the readings.
    """
    gyro, accel = scales or (evidence.gyro_scales, evidence.accel_scales)
    if _without_gravity(evidence, accel):
        details = {"found": accel.typical * evidence.recording.site.gravity_m_s2}
        return ScaleCause(("gravity_absent",), details={"gravity_absent": details}), None
    if stationary_force_scatter(evidence.manoeuvres) > _MATCH and not accel.axis_scatter < _EQUAL:
        accel = UNKNOWN  # the specific force differs much between the windows: they are not stationary
    timed, other = _timed(evidence)
    triads: dict[Sensor, ScaleRatios] = {"gyro": gyro, "accel": accel}
    odd = {sensor: _is_odd(evidence, sensor, triads) for sensor in triads}
    if not any(odd.values()):
        return ScaleCause(), None
    of_one = {
        sensor: list(_of_one_triad(evidence, sensor, triads[sensor]) if wrong else ()) or [ScaleCause()]
        for sensor, wrong in odd.items()
    }
    pairs = [(one, two) for one in of_one["gyro"] for two in of_one["accel"]]
    if odd[timed]:
        pairs += [(one, two) for one in _of_clock(evidence, triads[timed]) for two in of_one[other]]
    causes = [*_of_both(evidence, gyro, accel), *(one & two for one, two in pairs)]
    return most_likely(causes, gyro, accel, evidence.earth_rate)


def _timed(evidence: Evidence) -> tuple[Sensor, Sensor]:
    """Triad whose ratios depend on the clock (gyros of rates, accelerometers of increments), and the other one."""
    return ("gyro", "accel") if evidence.recording.kind == "rate" else ("accel", "gyro")


def _without_gravity(evidence: Evidence, accel: ScaleRatios) -> bool:
    """True if the stationary specific force is far below gravity, and no multiple of that of the poses.

    In a wrong unit it is a multiple, with one magnitude, and a matrix that stretches all directions alike.
    """
    if evidence.data is None or evidence.accel_fit.rank < 3 or accel.typical >= LEGAL_RATIO["accel"][0]:
        return False
    stretch = np.linalg.svd(evidence.accel_fit.matrix, compute_uv=False)
    varies = stationary_force_scatter(evidence.manoeuvres) > _EQUAL
    uneven = stretch[2] < _EVEN * stretch[0] or accel.axis_scatter > _EQUAL
    return (varies and uneven) or bool(stretch[0] < _EVEN * accel.typical)


def _is_legal(sensor: Sensor, scales: ScaleRatios) -> bool:
    low, high = LEGAL_RATIO[sensor]
    return low < scales.typical < high


def _is_odd(evidence: Evidence, sensor: Sensor, triads: dict[Sensor, ScaleRatios]) -> bool:
    """True if no sound unit has the ratio of a triad, or the factor that its axes have in common."""
    scales, (timed, other) = triads[sensor], _timed(evidence)
    if not (scales.by_axis and _is_legal(sensor, scales)):
        return scales.known and not _is_legal(sensor, scales)
    shift = abs(scales.common) - (3.0 * GRAVITY_SIGMA if sensor == "accel" else 0.0)
    return (
        shift > max(_LEAST_COMMON, _COMMON_SIGMAS_ALONE * scales.scatter)
        or shift > max(_EQUAL, _COMMON_SIGMAS * scales.scatter)
        or (_has_common_factor(scales) and _nearest_power(scales.common) is not None)
        or _one_axis(sensor, scales) is not None
        or (sensor == timed and triads[other].known and _confirmed_by_earth(evidence, scales))
    )


def _confirmed_by_earth(evidence: Evidence, scales: ScaleRatios) -> bool:
    """True if the measured Earth rate is wrong by the common factor of the triad that depends on the clock.

    The clock is wrong then: no scale-factor error of a unit has this effect.
    """
    earth = evidence.earth_rate_factor
    if earth is None or abs(scales.common) < _LEAST_COMMON:
        return False
    expected = math.exp(-scales.common if evidence.recording.kind == "rate" else scales.common)
    doubt = math.hypot(earth.sigma, scales.scatter * expected)
    return abs(earth.value - 1.0) > _EARTH_SIGMAS * earth.sigma and abs(earth.value - expected) < 3.0 * doubt


def _of_one_triad(evidence: Evidence, sensor: Sensor, scales: ScaleRatios) -> Iterator[ScaleCause]:
    """Possible causes of the ratios of only one triad: unit, counts, measuring range, one axis, or any factor."""
    rates, dt = evidence.recording.kind == "rate", evidence.dt
    usual = 1.0 if _is_usual(dt) else RARE

    def cause(prior: float, fault: str, shift: float | Array, details: dict[str, Any], **more: Any) -> ScaleCause:
        more[sensor] = shift
        return ScaleCause((fault,), prior=prior * usual, details={fault: details}, **more)

    if not _is_legal(sensor, scales):
        off = math.log(scales.typical)
        near = [(abs(off - math.log(u.factor)), u) for u in WRONG_UNITS[sensor] if rates or not u.rates_only]
        step = _common_step(evidence, sensor)
        # Readings in mg are often logged without decimals, and pulses of a fraction of an arc second can be whole
        # numbers of deg/h: near the factor of a unit, whole numbers are readings in that unit.
        if (0 < step <= _LARGEST and min(d for d, _ in near) > _EQUAL) or (step == 1 and sensor == "gyro"):
            fields = _fields(evidence, sensor, scales.typical, None)
            yield cause(FREQUENT / _WHOLE, f"{sensor}_counts", 0.0, fields, unknown={sensor: (_COUNTS, 0.0)})
            return
        for d, unit in near:
            if d < _MATCH:
                prior = RARE if unit.fault.endswith("other_unit") else FREQUENT
                yield cause(prior, unit.fault, math.log(unit.factor), _fields(evidence, sensor, scales.typical, unit))
        of_interval = math.log(dt) if rates else -math.log(dt)
        if abs(off - of_interval) < _MATCH:
            found, declared = ("increments", "rates") if rates else ("rates", "increments")
            details = {"ratio": scales.typical, "interval": dt, "found": found, "declared": declared}
            details["remedy"] = "divide" if rates else "multiply"
            yield cause(RARE, f"{sensor}_kind", of_interval, details)
    clipped = _clipped(evidence, sensor)
    equal = _has_common_factor(scales)
    if equal and (power := _nearest_power(scales.common)) is not None:
        # Saturation in most sequences makes the measured angles too small.
        mostly = evidence.data is not None and (None in clipped or len(clipped) > 0.5 * evidence.data.K)
        if power > 1.0 or not mostly:
            details = _wrong_count(sensor, math.exp(scales.common), power)
            yield cause(FREQUENT, f"{sensor}_lsb", math.log(power), details)
    elif (one := _one_axis(sensor, scales)) is not None:
        axis, factor, other = one
        ratio = float(scales.axes[axis])
        fault, details = f"{sensor}_lsb", _wrong_count(sensor, ratio, factor, axis)
        if other is not None:
            fault, details = other.fault, _fields(evidence, sensor, ratio, other)
            details |= {"title": f"gyro {AXES[axis]}"} if sensor == "gyro" else {}
        yield cause(FREQUENT, fault, math.log(factor) * np.eye(3)[axis], details)
    elif equal and abs(scales.common) < math.log(_LARGEST) and not clipped:
        details = {"ratio": math.exp(scales.common), "spread": scales.spread}
        yield cause(RARE, f"{sensor}_factor", 0.0, details, unknown={sensor: (2.0 * math.log(_LARGEST), 0.0)})


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
    equal = all(_has_common_factor(triad) and abs(triad.common - shift) < _POWER_DISTANCE for triad in triads)
    # Without a rotation: the interval is longer than that of any IMU, but interval / count is not.
    late = not gyro.known and dt > USUAL_S[1] and _is_usual(dt / count)
    if (equal and len(triads) == 2 and count <= _LARGEST) or late:
        details = {"count": count, "ratio": math.exp(triads[0].common)}
        yield ScaleCause(("increments_thinned",), shift, shift, prior=RARE, details={"increments_thinned": details})


def _of_clock(evidence: Evidence, scales: ScaleRatios) -> Iterator[ScaleCause]:
    """Possible causes in the clock, from the known ratios of the triad that depends on it."""
    rates, dt, timed = evidence.recording.kind == "rate", evidence.dt, _timed(evidence)[0]
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
    unknown = {str(timed): (math.log(USUAL_S[1] / USUAL_S[0]), sense)}
    yield ScaleCause(("sample_rate",), unknown=unknown, prior=FREQUENT, details={"sample_rate": details})


def _is_usual(interval_s: float) -> bool:
    return USUAL_S[0] <= interval_s <= USUAL_S[1]


def _clipped(evidence: Evidence, sensor: Sensor) -> set[int | None]:
    """Numbers of the sequences in which a triad saturates; None for the whole recording."""
    return {k for k, parts in evidence.clipped_parts for part in parts if part.channel.startswith(sensor)}


def _has_common_factor(scales: ScaleRatios) -> bool:
    return scales.by_axis and scales.scatter < _EQUAL


def _nearest_power(off: float) -> float | None:
    """Power of two between the measuring ranges of one IMU, from the logarithm of a factor; None if it is none."""
    power = 2.0 ** round(off / math.log(2.0))
    near = power != 1.0 and 1.0 / _LARGEST <= power <= _LARGEST and abs(off - math.log(power)) < _POWER_DISTANCE
    return power if near else None


def _one_axis(sensor: Sensor, scales: ScaleRatios) -> tuple[int, float, WrongUnit | None] | None:
    """Axis in another unit or range than the other two, which are right; its factor; and its unit, None for a range."""
    if not scales.by_axis or scales.axis_scatter > _EQUAL:
        return None
    off = scales.logarithms
    # The other two axes are right: only one axis differs from 1.
    axis = int(np.argmax(np.abs(off)))
    if np.abs(np.delete(off, axis)).max() > _EQUAL:
        return None
    if (power := _nearest_power(float(off[axis]))) is not None:
        return axis, power, None
    for unit in WRONG_UNITS[sensor]:
        if not unit.rates_only and abs(off[axis] - math.log(unit.factor)) < _EQUAL:
            return axis, unit.factor, unit
    return None


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
    table = evidence.some[("gyro", "accel").index(sensor)]
    units = {"gyro": (1.0, DEG, DEG_PER_H), "accel": (1.0, STANDARD_GRAVITY_M_S2, 1e-3 * STANDARD_GRAVITY_M_S2)}[sensor]
    for unit in units if evidence.recording.kind == "rate" else units[:2]:
        numbers = table / unit
        nearest = np.rint(numbers)
        # Above 2⁵² = 1/ε, every double is a whole number.
        if np.abs(numbers - nearest).max() < _WHOLE and _FEWEST_COUNTS <= np.ptp(nearest) < 1.0 / np.finfo(float).eps:
            return int(np.gcd.reduce(nearest.astype(np.int64), axis=None))
    return 0
