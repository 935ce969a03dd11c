"""Correction of one sample at a time, with counts of lost, malformed and doubtful ones."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from srt.exceptions import InputError
from srt.result.applier import Applier
from srt.sequences.plausibility import size_cause

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from srt.result.calibration import Calibration
    from srt.result.provenance import Temperature
    from srt.result.triad_inverse import Vector

CORRECTED: Final = "corrected"
MALFORMED: Final = "malformed"
MISTAKEN: Final = "answered wrongly"
CHANGED: Final = "after which the number of columns is another"
LOST: Final = "lost"
CLIPPED: Final = "at the end of the range"
OTHER_TEMPERATURE: Final = "outside the temperature of the test"
IMPLAUSIBLE: Final = "of implausible size"
TOO_FAST: Final = "faster than any gyro measures"
NOT_ADVANCING: Final = "with a time that does not advance"
NOT_SENT: Final = "not sent"
UNSIGNED: Final = "signed, sent without a signature"
OVERRIDDEN: Final = "lines of names whose unit is overridden"
PASSED_ON: Final = "without an IMU, passed on"

_CLIPPED_FROM: Final = 0.999
"""Fraction of the range from which a reading is clipped: one part in a thousand of noise or rounding below it."""
_FASTEST: Final = 1000.0
"""Rate that no gyro measures, rad/s: those for spinning projectiles end at 50 000 °/s, 873 rad/s."""
_BLOCK: Final = 500
"""Samples whose median size is judged: a few seconds, more than half of which no shock or free fall fills."""
_TIMES_TOLD: Final = (1, 10, 100, 1000, 10**4, 10**5, 10**6)
"""Counts at which an event is told, so that a broken sensor does not fill the disk with sentences."""
_CAUSES: Final = 20
"""Causes that are told at their first event, for the same reason."""


class Counts(NamedTuple):
    """Scale of raw counts: gyro x, y, z, then accelerometer x, y, z."""

    unit: tuple[float, ...]  # value of one count
    zero: tuple[float, ...]  # counts at zero input

    def readings(self, counts: Iterable[float]) -> tuple[float, ...]:
        """Readings of six counts, in the unit of ``unit``."""
        return tuple((n - zero) * unit for n, unit, zero in zip(counts, self.unit, self.zero, strict=True))


@dataclass(frozen=True, slots=True)
class StreamOptions:
    """Description of the samples of a stream.

    Raises InputError: values that are not positive.
    """

    dt: float | None = None  # duration of increments, s; None for rates
    gyro_range: float | None = None  # rad/s
    accel_range: float | None = None  # m/s²
    temperature_margin_c: float = 10.0  # distance from the temperatures of the test that is told
    gravity: float | None = None  # m/s², near which the median specific force is expected; None: no sizes are checked
    covariance: bool = False  # True: each corrected sample comes with its 1-sigma by the calibration

    def __post_init__(self) -> None:
        for name in ("dt", "gyro_range", "accel_range", "temperature_margin_c", "gravity"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputError(f"The {name} of the stream is {value:g}: give a positive number, or leave it out.")


class StreamCorrector:
    """Correct samples, in SI units, and count events.

    Parameters
    ----------
    frame : "mars" or "table"
    tell : callable
        Takes a sentence on an event; called at the 1st, 10th, 100th ... of a kind.

    Attributes
    ----------
    counts : Counter
        Number of samples by event.
    interval_s : float or None
        Sampling interval, where the stream states times.
    """

    __slots__ = (
        "_applier", "_causes", "_fastest", "_options", "_ranges", "_squares", "_tell", "_temperature", "counts",
        "interval_s",
    )  # fmt: skip

    def __init__(
        self, calibration: Calibration, frame: Any, options: StreamOptions, tell: Callable[[str], None]
    ) -> None:
        self._applier = Applier(calibration, frame=frame, block=1)
        self._options = options
        self._tell = tell
        self._temperature = _tested(calibration.temperature, options.temperature_margin_c)
        seconds = 1.0 if options.dt is None else options.dt
        ranges = [
            math.inf if r is None else _CLIPPED_FROM * r * seconds for r in (options.gyro_range, options.accel_range)
        ]
        self._ranges = ranges[0], ranges[1]
        self._fastest = math.inf if options.gravity is None else _FASTEST * seconds
        self._squares: list[float] = []
        self._causes = {""}  # that were told
        self.counts: Counter[str] = Counter({CORRECTED: 0})
        self.interval_s = options.dt

    @property
    def increments(self) -> bool:
        """True for samples of increments, False for rates."""
        return self._options.dt is not None

    def correct(self, values: tuple[float, ...], temperature: float | None = None) -> tuple[float, ...]:
        """Correct one sample.

        Parameters
        ----------
        values : tuple of 6 floats
            Gyro x, y, z and accelerometer x, y, z.
        temperature : float, °C, optional

        Returns
        -------
        tuple of 6 floats
            Followed by their six 1-sigma where the options ask for them.

        Raises InputError: values that are not finite.
        """
        gx, gy, gz, ax, ay, az = values
        gyro: Vector = (gx, gy, gz)
        accel: Vector = (ax, ay, az)
        (p, q, r), (u, v, w) = self._applier.apply_sample(gyro, accel, dt=self._options.dt)
        largest_rate, largest_force = self._ranges
        rate = max(map(abs, gyro))
        if rate > self._fastest:
            self._tell_rate(rate / (self._options.dt or 1.0))
        if rate >= largest_rate or max(map(abs, accel)) >= largest_force:
            self.event(CLIPPED, "a reading is at the end of its range, and its correction is not true")
        if self._options.gravity is not None:
            squares = self._squares
            squares.append(accel[0] * accel[0] + accel[1] * accel[1] + accel[2] * accel[2])
            if len(squares) == _BLOCK:
                self._check_size()
        if temperature is not None and self._temperature is not None:
            low, high = self._temperature
            if not low <= temperature <= high:
                self.event(
                    OTHER_TEMPERATURE,
                    f"a sample has {temperature:.1f} °C, and the calibration holds {low:.1f} to {high:.1f} °C",
                )
        self.counts[CORRECTED] += 1
        corrected = (p, q, r, u, v, w)
        return corrected + self._sigma(gyro, accel) if self._options.covariance else corrected

    def event(self, kind: str, sentence: str, count: int = 1, cause: str = "") -> None:
        """Count an event, and tell it if it is among the first of its kind, or the first with its cause."""
        before = self.counts[kind]
        self.counts[kind] += count
        new = cause not in self._causes and len(self._causes) < _CAUSES
        if new:
            self._causes.add(cause)
        if new or any(before < times <= self.counts[kind] for times in _TIMES_TOLD):
            total = "" if self.counts[kind] == 1 else f" ({self.counts[kind]} samples are {kind} so far)"
            self._tell(f"{sentence}{total}")

    def summary(self) -> str:
        """Counts in one sentence, at the end of the stream."""
        if 0 < self.counts[CORRECTED] < _BLOCK:
            self._check_size()
        return ", ".join(f"{count} {kind}" for kind, count in self.counts.items() if count or kind == CORRECTED)

    def _check_size(self) -> None:
        """Tell of samples whose median specific force is not near gravity, as in the motion of any vehicle."""
        squares, gravity = self._squares, self._options.gravity
        if gravity is None or not squares:
            return
        force = math.sqrt(sorted(squares)[len(squares) // 2]) / (self._options.dt or 1.0)
        cause = size_cause(force, gravity, self.interval_s)
        if cause is not None:
            self.event(
                IMPLAUSIBLE,
                f"the accelerometers read {force:.4g} m/s² in the median, but about {gravity:.4g} is expected: {cause}"
                "; state the units of both sensors (--gyro-unit, --accel-unit), the value of counts with its "
                "unit (--gyro-lsb, --accel-lsb) or --increments-s",
                len(squares),
            )
        squares.clear()

    def _tell_rate(self, rate: float) -> None:
        self.event(
            TOO_FAST,
            f"the gyros read {rate:.4g} rad/s, which no gyro measures: state their unit (--gyro-unit), the value of "
            "counts with its unit, as --gyro-lsb '1/131 deg/s' (a number without a unit is in rad/s), or "
            "--increments-s",
        )

    def _sigma(self, gyro: Vector, accel: Vector) -> tuple[float, ...]:
        covariance = self._applier.sample_covariance(gyro, accel, dt=self._options.dt)
        return tuple(np.sqrt(np.diag(covariance)).tolist())


def _tested(temperature: Temperature | None, margin: float) -> tuple[float, float] | None:
    """Temperatures at which the calibration holds, °C."""
    if temperature is None:
        return None
    mean, half = temperature.mean_c, 0.5 * temperature.range_c
    return mean - half - margin, mean + half + margin
