"""Severities of a fault by the shift that it causes: the least of three moves one parameter by 3 to 5 sigma.

A kind, a grade and a unit fix where and on which axis a fault is injected; only its severity is varied. The search
calibrates the same unit with and without the fault, by least squares without checks, and bisects the severity.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # injected_faults

from injected_faults import execution, foreign_operators, logger, site_and_drift  # noqa: F401 - they register
from injected_faults.injection import GRADES, INJECTIONS, VARIANTS, Case, Injection

import srt
from srt.exceptions import DataError, InputError
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from srt.result.calibration import Calibration

LEAST_ONE: Final = ("sequences", "samples", "columns", "channels", "windows")
"""Severity units that are counts: a step halves them, rounded up; one is the last."""
FACTORS: Final = ("times", "times the noise")
"""Severity units that are factors: a step takes the square root."""
SHARES: Final = ("of the planned length",)
"""Severity units that are a remaining share of the whole: a step halves the missing part."""
ALL_OR_NOTHING: Final = ("", "-")
"""Severity units of a fault that is present or absent: there is no smaller severity."""
SEVERITIES: Final = 3
UNSCALED: Final = (*ALL_OR_NOTHING, "Hz", "counts per SI unit")
"""Severity units of a setting: a smaller one is another setting, and no smaller fault."""
LEAST_SHIFT: Final = (3.0, 5.0)
"""Range of the shift of one parameter at the least severity, in sigma."""
LARGEST: Final = 8.0
"""Largest severity of the search, in units of the stated one."""
LARGEST_FACTOR: Final = 16.0
"""Largest severity of the search where it is a factor: beyond, no sensor, clock or count value is that wrong."""
LARGEST_BIT: Final = 10.0
"""Highest bit that readings of a signed word of 16 bits pass several times."""
SMALLEST: Final = 2.0**-16
"""Smallest severity of the search, in units of the stated one."""
MOVES_TRUTH: Final[dict[str, tuple[str, ...]]] = {
    "gyro_lsb": ("gyro",),
    "accel_lsb": ("accel",),
    "gyro_factor": ("gyro",),
    "accel_factor": ("accel",),
    "one axis of another range": ("gyro", "accel"),
    "gyro_bias_drift": ("gyro_bias",),
    "gyro bias steps": ("gyro_bias",),
    "accel_bias_drift": ("accel_bias",),
    "wrong_angle and accel_bias_drift": ("accel_bias",),
    "accelerometer bias steps": ("accel_bias",),
    "accelerometer scale drifts": ("accel_scale",),
    "gyro scale drifts": ("gyro_scale",),
    "gyro_scale_drift": ("gyro_scale",),
    "offset subtracted twice": ("gyro_bias",),
    "low bits lost": ("gyro_bias", "accel_bias"),
    "bit of a converter stuck": ("gyro_bias", "accel_bias"),
    "bit_stuck": ("gyro_bias", "accel_bias"),
    "mounted at 45 deg": ("gyro", "accel"),
    "sensors askew in their housing": ("gyro", "accel"),
    "accelerometer board askew": ("accel",),
}
"""Parameters that a fault changes in truth, by the beginning of their names: calibration finds them, and should."""
KINDS: Final = {**INJECTIONS, **VARIANTS}
"""Faults of the catalogue, and their variants."""
OTHER_RECORDING: Final = (
    "samples dropped, stamps closed up",
    "labels of a fast clock",
    "time of the labels from the start",
)
"""Variants injected into a recording with the moves between sequences: their twin is the one without severity."""


def severity_at(injection: Injection, grade: str, rung: int) -> float | None:
    """Severity after ``rung`` halvings of the stated one; None if there is no such step."""
    stated = injection.severity[grade]
    if rung == 0:
        return stated
    if injection.unit in ALL_OR_NOTHING:
        return None
    if injection.unit in LEAST_ONE:
        left = math.ceil(stated / 2.0**rung)
        return float(left) if left < math.ceil(stated / 2.0 ** (rung - 1)) else None
    if injection.unit in FACTORS:
        return float(stated ** (0.5**rung))
    if injection.unit in SHARES:
        return 1.0 - (1.0 - stated) / 2.0**rung
    return stated / 2.0**rung


class Units:
    """One unit of each grade and severity, and its calibration without a fault."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.case, self.clean, self._twin = cache(self._case), cache(self._clean), cache(self._new_twin)

    def _case(self, grade: str, rung: int) -> Case:
        return Case(grade, self.seed + 10 * GRADES.index(grade) + rung)

    def _clean(self, grade: str, rung: int) -> Calibration:
        return srt.calibrate(self.case(grade, rung).recording, checks=False)

    def shift(self, found: Calibration, injection: Injection, grade: str, rung: int) -> tuple[float, str]:
        """Largest shift of a parameter against the recording without the fault, in sigma, and its name.

        The larger sigma of the two counts: what the result itself states as doubt is not in silence.
        """
        clean = self._twin(injection.fault, grade, rung)
        known = found.observed & clean.observed
        known &= [not name.startswith(MOVES_TRUTH.get(injection.fault, ())) for name in NAMES]
        shifts = np.zeros(len(NAMES))
        sigma = np.maximum(found.sigma, clean.sigma)[known]
        shifts[known] = np.abs(found.errors.vector - clean.errors.vector)[known] / sigma
        return float(shifts.max()), NAMES[int(shifts.argmax())]

    def _new_twin(self, kind: str, grade: str, rung: int) -> Calibration:
        """Calibration of the same injection with no severity, which draws the same noise, where there is such."""
        injection = KINDS[kind]
        none = 1.0 if injection.unit in (*FACTORS, *SHARES) else 0.0
        variant = injection.fault in VARIANTS and injection.fault not in OTHER_RECORDING
        if variant or (injection.unit in (*ALL_OR_NOTHING, *LEAST_ONE) and injection.fault not in VARIANTS):
            return self.clean(grade, rung)
        try:
            recording = injection.recording(self.case(grade, rung), none)
        except InputError:
            return self.clean(grade, rung)
        return srt.calibrate(recording, checks=False, options=injection.options)

    def shift_at(self, injection: Injection, grade: str, severity: float) -> float:
        """Largest shift of the unit of the least severity, in sigma; infinite where nothing is calibrated."""
        try:
            recording = injection.recording(self.case(grade, SEVERITIES - 1), severity)
            found = srt.calibrate(recording, checks=False, options=injection.options)
        except (DataError, InputError):
            return math.inf
        return self.shift(found, injection, grade, SEVERITIES - 1)[0]


def scaled(injection: Injection, stated: float, times: float) -> float:
    """Severity of ``times`` the stated one; of a factor the power, of a share the missing part."""
    if injection.unit in FACTORS:
        return float(stated**times)
    if _share(injection):
        return 1.0 - (1.0 - stated) * times
    if injection.unit in LEAST_ONE:
        return float(max(1, round(stated * times)))
    return stated * times


def _share(injection: Injection) -> bool:
    return injection.unit in SHARES or injection.unit.startswith("of the largest")


def largest(injection: Injection, stated: float) -> float:
    """Largest severity of the search, in units of the stated one."""
    if injection.unit in FACTORS:
        return max(1.0, min(LARGEST, math.log(LARGEST_FACTOR) / math.log(stated)))
    if _share(injection):
        return 0.95 / (1.0 - stated)
    if injection.unit == "bit":
        return LARGEST_BIT / stated
    return 1.0 if injection.unit == "deg" or injection.unit.startswith("of the") else LARGEST


def stated_severity(injection: Injection, grade: str) -> float:
    """Stated severity; that of the first grade with one where the fault cannot be seen in this grade."""
    return injection.severity.get(grade, next(iter(injection.severity.values())))


def halvings(injection: Injection, grade: str) -> tuple[float, ...]:
    """The stated severity, its half and its quarter; where there is no smaller one, the same with other draws."""
    stated = stated_severity(injection, grade)
    out = [stated]
    for rung in range(1, SEVERITIES):
        smaller = severity_at(replace(injection, severity={grade: stated}), grade, rung)
        out.append(out[-1] if smaller is None else smaller)
    return tuple(out)


def severities(injection: Injection, units: Units, grade: str) -> tuple[bool, tuple[float, ...]]:
    """Truth of harm, and three severities: the largest, the geometric mean, and the least (3 to 5 sigma).

    A kind that moves no parameter by 3 sigma does no harm. It has the stated severity, its half and its quarter, as a
    kind that is refused at every severity.
    """
    stated = stated_severity(injection, grade)
    least = least_times(injection, units, grade)
    if not least:
        return least is not None, halvings(injection, grade)
    most = min(max(1.0, 2.0 * least), max(1.0, largest(injection, stated)))
    return True, tuple(scaled(injection, stated, times) for times in (most, math.sqrt(most * least), least))


def least_times(injection: Injection, units: Units, grade: str) -> float | None:
    """Least severity that moves one parameter by 3 to 5 sigma, in units of the stated one.

    None if the largest moves none by that much, and 0 if no severity has a result. A count has steps: then it is the
    least severity found beyond.
    """
    stated = stated_severity(injection, grade)
    if injection.unit in UNSCALED:
        return 0.0 if units.shift_at(injection, grade, stated) >= LEAST_SHIFT[0] else None
    limit, times, finite = largest(injection, stated), 1.0, False
    below, above = 0.0, math.inf
    for _ in range(14):
        shift = units.shift_at(injection, grade, scaled(injection, stated, times))
        finite |= math.isfinite(shift)
        if shift >= LEAST_SHIFT[0]:
            above = times
        else:
            below = times
        if LEAST_SHIFT[0] <= shift <= LEAST_SHIFT[1] or (math.isinf(above) and below >= limit):
            break
        times = _next((below, above, limit), shift)
        if times < SMALLEST or (math.isfinite(above) and above / max(below, SMALLEST) < 1.1):
            break
        tried = [scaled(injection, stated, bound) for bound in (below, above) if math.isfinite(bound)]
        if injection.unit in LEAST_ONE and scaled(injection, stated, times) in tried:
            break
    if math.isinf(above):
        return None
    return above if finite else 0.0


def _next(bounds: tuple[float, float, float], shift: float) -> float:
    """Next severity of the search: in proportion to the shift, or the geometric mean of the bounds."""
    below, above, limit = bounds
    wanted = math.sqrt(LEAST_SHIFT[0] * LEAST_SHIFT[1]) / max(shift, 1e-3)
    if math.isinf(above):
        return min(limit, below * max(2.0, wanted))
    if below == 0.0:
        return above * (0.25 if math.isinf(shift) else min(0.5, max(wanted, 0.02)))
    return math.sqrt(below * above)
