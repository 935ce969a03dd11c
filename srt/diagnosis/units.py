"""Units, count values and sample rate: factors of the readings against labels and gravity.

Most wrong units are factors far beyond the scale errors of an uncalibrated IMU (50 %), so the nearest one is named.
Wrong ranges (powers of two) and sample rates lie within these errors. The axes tell them apart: scale errors differ
from axis to axis, a wrong factor does not. If one axis disagrees with itself over the rotations and poses, labels or
windows are wrong, and nothing is said about factors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG, DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.diagnosis.axes import gravity_relation, manoeuvre_readings
from srt.diagnosis.clipping import clipped_parts
from srt.diagnosis.findings import check, finding
from srt.diagnosis.rotation_readings import rotation_angles
from srt.diagnosis.site import earth_rate_factor
from srt.diagnosis.triad_fits import accel_fit
from srt.model.table1 import AXES
from srt.sequences.plausibility import LEGAL_RATIO
from srt.sequences.wrong_units import WRONG_UNITS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.sequences.wrong_units import WrongUnit
    from srt.types import Array, Sensor


_G: Final = STANDARD_GRAVITY_M_S2


_MATCH: Final = math.log(1.8)
"""Logarithm of the distance within which a factor is recognised through the errors of an uncalibrated IMU."""
_BOTH: Final = math.log(1.7)
"""Logarithm of the ratio within which gyros and accelerometers share one factor: scale errors of ±25 % make 1.67."""
_TIGHT: Final = 0.07
"""Logarithm of the distance within which whole numbers are a unit and not counts: mg are often logged without decimals,
and pulses of a fraction of an arc second are whole numbers of deg/h (but not all of them)."""
_POWERS: Final = tuple(k for k in range(-4, 5) if k)
"""Exponents of two between the ranges of one IMU: a factor of 16 at most (125 to 2000 °/s, 2 to 32 g)."""
_POWER_DISTANCE: Final = 0.04
"""Logarithm of the distance of the mean factor from a power of two: 1e-5 of uncalibrated MEMS (1.5 % 1-sigma) exceed
it, 1e-4 of units with errors of tens of per cent are within it by chance."""
_POWER_SCATTER: Final = 0.05
"""Largest scatter of the logarithms of the axes about that mean."""
_COMMON_SIGMAS: Final = 8.0
"""Common factor over the scatter of the axes that is significant together with :data:`_COMMON`: independent errors
exceed it in 0.5 % of all units, but with errors above 5 % only in those off by tens of per cent."""
_COMMON: Final = 0.05
"""Logarithm of a common scale error that no class of units has: uncalibrated MEMS are within 3 % (2-sigma)."""
_COMMON_SIGMAS_ALONE: Final = 57.7
"""Common factor over the scatter that is significant alone, p = 1e-4: Student's t with two degrees of freedom exceeds
100, over √3."""
_EARTH_LEAST: Final = 0.005
"""Smallest common scale error that the Earth rate confirms."""
_EARTH_SIGMAS: Final = 5.0
"""Deviation of the Earth rate that is no chance, p = 6e-7."""
_GRAVITY_VARIATION: Final = 0.01
"""Largest relative difference of gravity on the Earth's surface (9.76 to 9.84 m/s²) from 9.80 m/s²."""
_WHOLE: Final = 1e-6
"""Largest distance from a whole number, by rounding."""
_READINGS: Final = 4000
"""Readings from which a common step is taken."""
_COARSEST_COUNT: Final = 16
"""Largest common divisor of raw counts, of which some low bits may be constant; larger ones are pulses in a unit."""
_FEWEST_COUNTS: Final = 10.0
"""Range of the readings in counts, below which whole numbers are chance."""
_MOST_COUNTS: Final = 2.0**52
"""Range above which every double is a whole number."""


@check(
    "increments_as_rates",
    "rates_as_increments",
    "gyro_degrees",
    "gyro_radians",
    "gyro_per_hour",
    "gyro_milli",
    "gyro_counts",
    "accel_g",
    "accel_mg",
    "accel_m_s2",
    "accel_counts",
    "gyro_lsb",
    "accel_lsb",
)
def wrong_units(evidence: Evidence) -> Iterator[Finding]:
    """Test for one factor on all readings of a triad: of both triads together, then of each."""
    gyro, accel = gyro_scale_ratios(evidence), accel_scale_ratios(evidence)
    if stationary_force_scatter(evidence) > _MATCH:
        accel = ScaleRatios(math.nan, np.full(3, np.nan), math.nan)  # the windows are not stationary
    kind = _wrong_kind(evidence, gyro, accel)
    if kind is not None:
        yield kind
        return
    rates = evidence.recording.kind == "rate"
    sensors: tuple[tuple[Sensor, ScaleRatios, tuple[float, ...]], ...] = (
        ("gyro", gyro, (1.0, DEG, DEG_PER_H)[: 3 if rates else 2]),
        ("accel", accel, (1.0, _G, 1e-3 * _G)[: 3 if rates else 1]),
    )
    for sensor, scales, wholes in sensors:
        low, high = LEGAL_RATIO[sensor]
        if not scales.known or low < scales.typical < high:
            power = _power_of_two(scales)
            if power is not None and not (power < 1.0 and _mostly_clipped(evidence, sensor)):
                yield _wrong_count(sensor, math.exp(scales.common), power)
            elif power is None and scales.known:
                yield from _one_axis(evidence, sensor, scales)
            continue
        off = math.log(scales.typical)
        units = (u for u in WRONG_UNITS[sensor] if u.fault and (rates or not u.rates_only))
        nearest = min(units, key=lambda u: abs(off - math.log(u.factor)))
        distance = abs(off - math.log(nearest.factor))
        step = _common_step(getattr(evidence.recording, sensor), wholes)
        if (0 < step <= _COARSEST_COUNT and distance > _TIGHT) or (step == 1 and sensor == "gyro"):
            yield finding(f"{sensor}_counts", **_fields(evidence, sensor, scales, None))
            continue
        power = _power_of_two(scales)
        if power is not None and abs(scales.common - math.log(power)) < distance:
            yield _wrong_count(sensor, math.exp(scales.common), power)
        elif distance < _MATCH:
            yield finding(nearest.fault, **_fields(evidence, sensor, scales, nearest))


def _wrong_count(sensor: str, ratio: float, power: float, axis: int | None = None) -> Finding:
    """Finding of a wrong count value, of all axes or of one."""
    name = {"gyro": "gyro", "accel": "accelerometer"}[sensor]
    who = f"All {name} axes read" if axis is None else f"{name.capitalize()} {AXES[axis]} reads"
    return finding(f"{sensor}_lsb", who=who, ratio=ratio, power=power)


def _one_axis(evidence: Evidence, sensor: str, scales: ScaleRatios) -> Iterator[Finding]:
    """Find one axis in another unit or range than the other two, which are right."""
    if not scales.by_axis or scales.axis_scatter > _POWER_SCATTER:
        return
    logarithm = np.log(scales.axes)
    for axis in range(3):
        off, ratio = float(logarithm[axis]), float(scales.axes[axis])
        if np.abs(np.delete(logarithm, axis)).max() > _POWER_SCATTER or abs(off) < 0.5 * math.log(2.0):
            continue
        power = min(_POWERS, key=lambda k: abs(off - k * math.log(2.0)))
        units = (u for u in WRONG_UNITS[sensor] if u.fault and not u.rates_only)
        nearest = min(units, key=lambda u: abs(off - math.log(u.factor)))
        if abs(off - power * math.log(2.0)) < _POWER_DISTANCE:
            yield _wrong_count(sensor, ratio, 2.0**power, axis)
        elif abs(off - math.log(nearest.factor)) < _POWER_SCATTER:
            one = replace(scales, typical=ratio)
            fields = _fields(evidence, sensor, one, nearest)
            yield finding(nearest.fault, **{**fields, **({"title": f"gyro {AXES[axis]}"} if sensor == "gyro" else {})})


def _mostly_clipped(evidence: Evidence, sensor: str) -> bool:
    """True if a triad saturates in most sequences, which makes all its readings too small."""
    clipped = {k for k, parts in clipped_parts(evidence) for part in parts if part.channel.startswith(sensor)}
    return evidence.data is not None and (None in clipped or len(clipped) > 0.5 * evidence.data.K)


def _wrong_kind(evidence: Evidence, gyro: ScaleRatios, accel: ScaleRatios) -> Finding | None:
    """Fault of increments declared as rates, or the reverse: both triads are off by the sampling interval."""
    if not (gyro.known and accel.known):
        return None
    rates = evidence.recording.kind == "rate"
    factor = math.log(evidence.dt) if rates else -math.log(evidence.dt)
    turned, rest = math.log(gyro.typical), math.log(accel.typical)
    low, high = LEGAL_RATIO["gyro"]
    illegal = not low < gyro.typical < high
    if not illegal or abs(turned - rest) > _BOTH or max(abs(turned - factor), abs(rest - factor)) > _MATCH:
        return None
    return finding(
        "increments_as_rates" if rates else "rates_as_increments",
        accel=accel.typical * evidence.recording.site.gravity_m_s2,
        turn=gyro.typical,
        interval=evidence.dt,
    )


def _fields(evidence: Evidence, sensor: str, scales: ScaleRatios, unit: WrongUnit | None) -> dict[str, object]:
    gravity = evidence.recording.site.gravity_m_s2
    names = {} if unit is None else {"unit": unit.unit, "declared": unit.declared}
    if sensor == "accel":
        return {"found": scales.typical * gravity, "expected": gravity, **names}
    return {"ratio": scales.typical, "title": _first_turn(evidence), **names}


def _first_turn(evidence: Evidence) -> str:
    """Name in messages of the first rotation compared."""
    if evidence.data is None:
        return "free rotations"
    numbers, _, _ = rotation_angles(evidence)
    return evidence.title(int(numbers[0])) if len(numbers) else "free rotations"


def _common_step(table: Array, units: tuple[float, ...]) -> int:
    """Greatest common divisor of the readings in the first unit in which they are whole numbers; 0 if in none."""
    some = table[:: max(1, len(table) // _READINGS)]
    for unit in units:
        numbers = some / unit
        nearest = np.rint(numbers)
        if np.abs(numbers - nearest).max() < _WHOLE and _FEWEST_COUNTS <= np.ptp(nearest) < _MOST_COUNTS:
            return int(np.gcd.reduce(nearest.astype(np.int64), axis=None))
    return 0


def _power_of_two(scales: ScaleRatios) -> float | None:
    """Power of two by which all axes are off; None if there is none."""
    if not scales.by_axis:
        return None
    nearest = min(_POWERS, key=lambda k: abs(scales.common - k * math.log(2.0)))
    off = abs(scales.common - nearest * math.log(2.0))
    return 2.0**nearest if off < _POWER_DISTANCE and scales.scatter < _POWER_SCATTER else None


@check("sample_rate")
def sample_rate(evidence: Evidence) -> Iterator[Finding]:
    """Test the triad that scales with the interval: all axes are off by one factor, which is no power of two."""
    rates = evidence.recording.kind == "rate"
    scales = gyro_scale_ratios(evidence) if rates else accel_scale_ratios(evidence)
    low, high = LEGAL_RATIO["gyro" if rates else "accel"]
    if not scales.by_axis or not low < scales.typical < high:
        return
    common, scatter = scales.common, scales.scatter
    if not rates:
        # Stated gravity may be wrong, within the variation of gravity.
        common = math.copysign(max(abs(common) - _GRAVITY_VARIATION, 0.0), common)
    significant = abs(common) > _COMMON_SIGMAS_ALONE * scatter or (
        abs(common) > _COMMON and abs(common) > _COMMON_SIGMAS * scatter
    )
    # The Earth rate, if the gyros measure it, is off by the same factor: no error of a unit does that.
    earth = earth_rate_factor(evidence)
    if earth is not None and abs(scales.common) > _EARTH_LEAST:
        expected = math.exp(-scales.common if rates else scales.common)
        doubt = math.hypot(earth.sigma, scatter * expected)
        significant |= (
            abs(earth.value - 1.0) > _EARTH_SIGMAS * earth.sigma and abs(earth.value - expected) < 3.0 * doubt
        )
    if not significant or _power_of_two(scales) is not None:
        return
    if rates and any(part.channel.startswith("gyro") for _, parts in clipped_parts(evidence) for part in parts):
        return
    stated, ratio = 1.0 / evidence.dt, math.exp(scales.common)
    yield finding(
        "sample_rate",
        sensor="gyros" if rates else "accelerometers",
        ratio=ratio,
        spread=float(np.std(np.log(scales.axes), ddof=1)),
        rate=stated * ratio if rates else stated / ratio,
        stated=stated,
    )


_MAD: Final = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""


@dataclass(frozen=True, slots=True, eq=False)
class ScaleRatios:
    """Ratio of reading and truth of one triad.

    Attributes
    ----------
    typical : float
        Median of the triad; NaN if unknown.
    axes : ndarray, shape (3,)
        Ratio of each sensor axis; NaN where unknown.
    axis_scatter : float
        Standard deviation of the logarithm of the ratio of one rotation or pose about that of its axis.
    """

    typical: float
    axes: Array
    axis_scatter: float

    @property
    def known(self) -> bool:
        """True if the triad has a positive, finite ratio."""
        return math.isfinite(self.typical) and self.typical > 0.0

    @property
    def by_axis(self) -> bool:
        """True if each axis has a positive, finite ratio."""
        return bool(np.all(np.isfinite(self.axes)) and np.all(self.axes > 0.0))

    @property
    def common(self) -> float:
        """Mean logarithm of the three axes."""
        return float(np.mean(np.log(self.axes)))

    @property
    def scatter(self) -> float:
        """Standard deviation of the logarithm of an axis about the others, the scatter within axes included."""
        return math.hypot(float(np.std(np.log(self.axes), ddof=1)), self.axis_scatter)


_RELATION_SIGMA: Final = 0.02
"""Standard deviation of the logarithm of an axis by the rotation of gravity: motion by hand, and misalignment."""
_AGREE: Final = 0.2
"""Logarithm of the ratio within which labels and the rotation of gravity agree; a factor of two is 0.69."""
_UNSEEN: Final = np.full(3, np.nan)
UNKNOWN: Final = ScaleRatios(float("nan"), _UNSEEN, float("nan"))
"""Ratios of a triad of which the data tell nothing."""


def gyro_scale_ratios(evidence: Evidence) -> ScaleRatios:
    """Ratios of measured and stated angles; for free rotations, of the gyros and the rotation of gravity.

    Medians of magnitudes, each assigned to the gyro that measured most of it: wrong axes, signs, senses and a few wrong
    labels do not matter.
    """
    by_labels = _by_labels(evidence)
    if evidence.has_labels and by_labels.known:
        return by_labels
    relation = gravity_relation(evidence)
    if relation is None:
        return by_labels
    axes = 1.0 / np.linalg.norm(relation, axis=0)
    by_gravity = ScaleRatios(float(np.median(axes)), axes, _RELATION_SIGMA)
    # Angles recognised as multiples of 90° may be off by a factor of two.
    agree = by_labels.known and abs(math.log(by_labels.typical / by_gravity.typical)) < _AGREE
    return by_labels if agree else by_gravity


def _by_labels(evidence: Evidence) -> ScaleRatios:
    if evidence.data is None:
        return UNKNOWN
    _, nominal, turned = rotation_angles(evidence)
    if len(nominal) == 0:
        return UNKNOWN
    ratio = np.linalg.norm(turned, axis=1) / np.linalg.norm(nominal, axis=1)
    most = np.argmax(np.abs(turned), axis=1)
    axes = np.array([np.median(ratio[most == i]) if np.any(most == i) else np.nan for i in range(3)])
    if not np.all(ratio > 0.0):
        return ScaleRatios(float(np.median(ratio)), axes, math.inf)
    off = np.abs(np.log(ratio / axes[most]))
    fixture = evidence.recording.fixture
    fixture_scatter = 0.0 if fixture is None else fixture.rotation_sigma_rad / math.pi
    return ScaleRatios(float(np.median(ratio)), axes, math.hypot(_MAD * float(np.median(off)), fixture_scatter))


def accel_scale_ratios(evidence: Evidence) -> ScaleRatios:
    """Ratios of stationary specific force and gravity; by axis if the stated poses span space."""
    turns = manoeuvre_readings(evidence)
    if turns is None or len(turns.force) == 0:
        return UNKNOWN
    gravity = evidence.recording.site.gravity_m_s2
    ratio = np.linalg.norm(turns.force, axis=1) / gravity
    typical = float(np.median(ratio))
    if not np.all(ratio > 0.0):
        return ScaleRatios(typical, _UNSEEN, math.inf)
    fit = None if evidence.data is None else accel_fit(evidence)
    if fit is None or fit.rank < 3:
        return ScaleRatios(typical, _UNSEEN, _MAD * float(np.median(np.abs(np.log(ratio / typical)))))
    axes = np.linalg.norm(fit.matrix, axis=1)
    off = np.median(np.abs(fit.residual), axis=0) / (gravity * typical)
    return ScaleRatios(typical, axes, _MAD * float(off.max()))


def stationary_force_scatter(evidence: Evidence) -> float:
    """Logarithm of the ratio of the quartiles of the stationary specific force; infinite without stationary windows."""
    turns = manoeuvre_readings(evidence)
    if turns is None or len(turns.force) == 0:
        return math.inf
    low, high = np.quantile(np.linalg.norm(turns.force, axis=1), (0.25, 0.75))
    return math.log(high / low) if low > 0.0 else math.inf
