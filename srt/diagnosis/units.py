"""Units, value of a count and sample rate: factors of the readings against labels and gravity.

Units are factors of their own, mostly far beyond what an uncalibrated unit (half of scale error) could read, so that
the nearest one is named. Ranges (powers of two) and sample rates lie among what such a unit may read, and are told by
how alike its axes are: errors of its making differ from axis to axis, a wrong factor does not.

A unit may be off by half before it is calibrated, and differently by axis; a wrong unit or rate is off by one factor
on all of them. So what matters beside the factor is how alike the axes are, and whether one axis agrees with itself
over all turns and poses: where it does not, labels or windows are wrong and nothing is said about scales.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG, DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.diagnosis.axes import gravity_relation, manoeuvre_readings
from srt.diagnosis.clipping import clipped_parts
from srt.diagnosis.findings import check, finding
from srt.sequences.plausibility import LEGAL_RATIO

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.types import Array


_G: Final = STANDARD_GRAVITY_M_S2


@dataclass(frozen=True, slots=True)
class _Unit:
    """One wrong unit: what readings are multiplied by, what they are, and what they are declared as."""

    fault: str
    factor: float
    unit: str
    declared: str
    rates_only: bool = True


_GYRO_UNITS: Final = (
    _Unit("gyro_degrees", 1.0 / DEG, "degrees", "radians", rates_only=False),
    _Unit("gyro_radians", DEG, "radians", "degrees", rates_only=False),
    _Unit("gyro_per_hour", 1.0 / DEG_PER_H, "deg/h", "rad/s"),
    _Unit("gyro_per_hour", DEG / DEG_PER_H, "deg/h", "deg/s"),
    _Unit("gyro_per_hour", DEG_PER_H / DEG, "deg/s", "deg/h"),
    _Unit("gyro_per_hour", DEG_PER_H, "rad/s", "deg/h"),
)
_ACCEL_UNITS: Final = (
    _Unit("accel_g", 1.0 / _G, "g", "m/s²", rates_only=False),
    _Unit("accel_g", 1e-3, "g", "mg"),
    _Unit("accel_mg", 1e3 / _G, "mg", "m/s²", rates_only=False),
    _Unit("accel_mg", 1e3, "mg", "g"),
    _Unit("accel_m_s2", _G, "m/s²", "g", rates_only=False),
    _Unit("accel_m_s2", 1e-3 * _G, "m/s²", "mg"),
)
_MATCH: Final = math.log(1.8)
"""Within this a factor is recognised through the errors of an uncalibrated unit."""
_BOTH: Final = math.log(1.7)
"""Within this gyros and accelerometers are off by one and the same factor: errors of a quarter either way make 1.67."""
_TIGHT: Final = 0.07
"""Within this whole numbers are a unit rather than counts: mg are often logged without decimals, and pulses of a part
of an arc second are whole numbers of deg/h (but not every whole number)."""
_POWERS: Final = tuple(k for k in range(-4, 5) if k)
"""Ranges of one unit are 16 apart at most (125 to 2000 °/s, 2 to 32 g)."""
_NEAR_POWER: Final = 0.04
_LIKE_POWER: Final = 0.05
"""How near to a power of two (logarithms), and how alike: of uncalibrated MEMS (1.5 % one sigma) 1e-5 differ by more,
of units off by tens of per cent 1e-4 look like it by chance."""
_SPREADS: Final = 8.0
"""Common factor over the spread of the axes, from which it is no chance: of three independent errors the mean is so
large in 0.5 % of all units, whatever their class, but with the next figure only in those off by tens of per cent."""
_COMMON: Final = 0.05
"""Common scale error that no class of units has: sensitivities of uncalibrated MEMS are given to 3 % (two sigma)."""
_SURE: Final = 57.7
"""Likewise for 1e-4 of all units: Student's t of two degrees of freedom is beyond 100, over √3."""
_ON_EARTH: Final = 0.01
"""Gravity differs by no more than this from 9.80 m/s² anywhere on the Earth's surface (9.76 to 9.84)."""
_WHOLE: Final = 1e-6
_READINGS: Final = 4000
_FEWEST_COUNTS: Final = 10.0
_MOST_COUNTS: Final = 2.0**52


@check(
    "increments_as_rates",
    "rates_as_increments",
    "gyro_degrees",
    "gyro_radians",
    "gyro_per_hour",
    "gyro_counts",
    "accel_g",
    "accel_mg",
    "accel_m_s2",
    "accel_counts",
    "gyro_lsb",
    "accel_lsb",
)
def wrong_units(evidence: Evidence) -> Iterator[Finding]:
    """One factor on all readings of a triad: first of both together, then of each."""
    gyro, accel = gyro_scale_ratios(evidence), accel_scale_ratios(evidence)
    if stationary_force_scatter(evidence) > _MATCH:
        accel = ScaleRatios(math.nan, np.full(3, np.nan), math.nan)  # windows in motion: nothing is known of rest
    kind = _wrong_kind(evidence, gyro, accel)
    if kind is not None:
        yield kind
        return
    rates = evidence.recording.kind == "rate"
    for sensor, scales, units, wholes in (
        ("gyro", gyro, _GYRO_UNITS, (1.0, DEG, DEG_PER_H)[: 3 if rates else 2]),
        ("accel", accel, _ACCEL_UNITS, (1.0, _G, 1e-3 * _G)[: 3 if rates else 1]),
    ):
        if not scales.known or LEGAL_RATIO[0] < scales.typical < LEGAL_RATIO[1]:
            power = _power_of_two(scales)
            if power is not None:
                yield finding(f"{sensor}_lsb", ratio=math.exp(scales.common), power=power)
            continue
        off = math.log(scales.typical)
        nearest = min((u for u in units if rates or not u.rates_only), key=lambda u: abs(off - math.log(u.factor)))
        distance = abs(off - math.log(nearest.factor))
        step = _common_step(getattr(evidence.recording, sensor), wholes)
        if (step and distance > _TIGHT) or (step == 1 and sensor == "gyro"):
            yield finding(f"{sensor}_counts", **_fields(evidence, sensor, scales, None))
            continue
        power = _power_of_two(scales)
        if power is not None and abs(scales.common - math.log(power)) < distance:
            yield finding(f"{sensor}_lsb", ratio=math.exp(scales.common), power=power)
        elif distance < _MATCH:
            yield finding(nearest.fault, **_fields(evidence, sensor, scales, nearest))


def _wrong_kind(evidence: Evidence, gyro: ScaleRatios, accel: ScaleRatios) -> Finding | None:
    """Increments and rates taken for each other: both triads are off by the sampling interval."""
    if not (gyro.known and accel.known):
        return None
    rates = evidence.recording.kind == "rate"
    factor = math.log(evidence.dt) if rates else -math.log(evidence.dt)
    turned, rest = math.log(gyro.typical), math.log(accel.typical)
    illegal = not LEGAL_RATIO[0] < gyro.typical < LEGAL_RATIO[1]
    if not illegal or abs(turned - rest) > _BOTH or max(abs(turned - factor), abs(rest - factor)) > _MATCH:
        return None
    return finding(
        "increments_as_rates" if rates else "rates_as_increments",
        accel=accel.typical * evidence.recording.site.gravity_m_s2,
        turn=gyro.typical,
        interval=evidence.dt,
    )


def _fields(evidence: Evidence, sensor: str, scales: ScaleRatios, unit: _Unit | None) -> dict[str, object]:
    gravity = evidence.recording.site.gravity_m_s2
    names = {} if unit is None else {"unit": unit.unit, "declared": unit.declared}
    if sensor == "accel":
        return {"found": scales.typical * gravity, "expected": gravity, **names}
    return {"ratio": scales.typical, "title": _first_turn(evidence), **names}


def _first_turn(evidence: Evidence) -> str:
    """What sentences call the first turn that was compared."""
    if evidence.data is None:
        return "free turns"
    numbers, _, _ = evidence.rotation_angles
    return evidence.title(int(numbers[0])) if len(numbers) else "free turns"


def _common_step(table: Array, units: tuple[float, ...]) -> int:
    """Greatest whole number of which all readings are multiples, in one of some units; 0 if they are not whole."""
    some = table[:: max(1, len(table) // _READINGS)]
    for unit in units:
        numbers = some / unit
        nearest = np.rint(numbers)
        if np.abs(numbers - nearest).max() < _WHOLE and _FEWEST_COUNTS <= np.ptp(nearest) < _MOST_COUNTS:
            return int(np.gcd.reduce(nearest.astype(np.int64), axis=None))
    return 0


def _power_of_two(scales: ScaleRatios) -> float | None:
    """Power of two that all axes are off by alike."""
    if not scales.by_axis:
        return None
    nearest = min(_POWERS, key=lambda k: abs(scales.common - k * math.log(2.0)))
    off = abs(scales.common - nearest * math.log(2.0))
    return 2.0**nearest if off < _NEAR_POWER and scales.unlike < _LIKE_POWER else None


@check("sample_rate")
def sample_rate(evidence: Evidence) -> Iterator[Finding]:
    """All axes of the triad that is multiplied or divided by the interval are off by one factor, no power of two."""
    rates = evidence.recording.kind == "rate"
    scales = gyro_scale_ratios(evidence) if rates else accel_scale_ratios(evidence)
    if not scales.by_axis or not LEGAL_RATIO[0] < scales.typical < LEGAL_RATIO[1]:
        return
    common, unlike = scales.common, scales.unlike
    if not rates:
        # Stated gravity may be wrong, but not by more than gravity differs.
        common = math.copysign(max(abs(common) - _ON_EARTH, 0.0), common)
    sure = abs(common) > _SURE * unlike or (abs(common) > _COMMON and abs(common) > _SPREADS * unlike)
    if not sure or _power_of_two(scales) is not None:
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
"""Sigma over median absolute deviation of a normal distribution."""


@dataclass(frozen=True, slots=True, eq=False)
class ScaleRatios:
    """Reading over truth of one triad.

    Attributes
    ----------
    typical : float
        Of the whole triad, by the median; NaN if nothing tells.
    axes : ndarray, shape (3,)
        By sensor axis; NaN where nothing tells.
    scatter : float
        One sigma by which the logarithm of one turn's or pose's ratio differs from that of its axis.
    """

    typical: float
    axes: Array
    scatter: float

    @property
    def known(self) -> bool:
        """Whether the triad has a positive, finite ratio."""
        return math.isfinite(self.typical) and self.typical > 0.0

    @property
    def by_axis(self) -> bool:
        """Whether each axis has one."""
        return bool(np.all(np.isfinite(self.axes)) and np.all(self.axes > 0.0))

    @property
    def common(self) -> float:
        """Mean logarithm of the three axes."""
        return float(np.mean(np.log(self.axes)))

    @property
    def unlike(self) -> float:
        """One sigma of the logarithm of an axis about the others, the scatter within axes included."""
        return math.hypot(float(np.std(np.log(self.axes), ddof=1)), self.scatter)


_RELATION_SIGMA: Final = 0.02
"""Of the logarithm of an axis, by the turning of gravity: pushes of a hand, and misalignment."""
_AGREE: Final = 0.2
_UNSEEN: Final = np.full(3, np.nan)
NOTHING: Final = ScaleRatios(float("nan"), _UNSEEN, float("nan"))


def gyro_scale_ratios(evidence: Evidence) -> ScaleRatios:
    """Turned against stated angles; of free turns, the gyros against the turning of gravity.

    Magnitudes only, each counted for the gyro that read most of it: whatever the axes, their signs and the sense of
    single turns, and by medians, so that a few wrong labels do not matter.
    """
    by_labels = _by_labels(evidence)
    if evidence.has_labels and by_labels.known:
        return by_labels
    relation = gravity_relation(evidence)
    if relation is None:
        return by_labels
    axes = 1.0 / np.linalg.norm(relation, axis=0)
    by_gravity = ScaleRatios(float(np.median(axes)), axes, _RELATION_SIGMA)
    # Whoever counts turns in right angles may take half a turn for a quarter.
    agree = by_labels.known and abs(math.log(by_labels.typical / by_gravity.typical)) < _AGREE
    return by_labels if agree else by_gravity


def _by_labels(evidence: Evidence) -> ScaleRatios:
    if evidence.data is None:
        return NOTHING
    _, nominal, turned = evidence.rotation_angles
    if len(nominal) == 0:
        return NOTHING
    ratio = np.linalg.norm(turned, axis=1) / np.linalg.norm(nominal, axis=1)
    most = np.argmax(np.abs(turned), axis=1)
    axes = np.array([np.median(ratio[most == i]) if np.any(most == i) else np.nan for i in range(3)])
    if not np.all(ratio > 0.0):
        return ScaleRatios(float(np.median(ratio)), axes, math.inf)
    off = np.abs(np.log(ratio / axes[most]))
    fixture = evidence.recording.fixture
    executed = 0.0 if fixture is None else fixture.rotation_sigma_rad / math.pi
    return ScaleRatios(float(np.median(ratio)), axes, math.hypot(_MAD * float(np.median(off)), executed))


def accel_scale_ratios(evidence: Evidence) -> ScaleRatios:
    """Specific force at rest against gravity; by axis where the stated poses span space."""
    turns = manoeuvre_readings(evidence)
    if turns is None or len(turns.force) == 0:
        return NOTHING
    gravity = evidence.recording.site.gravity_m_s2
    ratio = np.linalg.norm(turns.force, axis=1) / gravity
    typical = float(np.median(ratio))
    if not np.all(ratio > 0.0):
        return ScaleRatios(typical, _UNSEEN, math.inf)
    fit = None if evidence.data is None else evidence.accel_fit
    if fit is None or fit.rank < 3:
        return ScaleRatios(typical, _UNSEEN, _MAD * float(np.median(np.abs(np.log(ratio / typical)))))
    axes = np.linalg.norm(fit.matrix, axis=1)
    off = np.median(np.abs(fit.residual), axis=0) / (gravity * typical)
    return ScaleRatios(typical, axes, _MAD * float(off.max()))


def stationary_force_scatter(evidence: Evidence) -> float:
    """Logarithm of the upper over the lower quartile of specific force at rest; infinite without rest."""
    turns = manoeuvre_readings(evidence)
    if turns is None or len(turns.force) == 0:
        return math.inf
    low, high = np.quantile(np.linalg.norm(turns.force, axis=1), (0.25, 0.75))
    return math.log(high / low) if low > 0.0 else math.inf
