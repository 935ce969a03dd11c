"""Units, scales and ranges: messages of the causes that :mod:`srt.diagnosis.scale_causes` chooses; saturation."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.findings import Fault, Finding, by_sensor
from srt.diagnosis.gravity_rotation import block_size, force_limit, rate_limit
from srt.diagnosis.scale_causes import scale_cause
from srt.diagnosis.triad_fits import calibrated_ratios
from srt.model.table1 import AXES
from srt.noise.allan import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.scale_causes import ScaleCause
    from srt.result.diagnostics import RunnerUp
    from srt.types import Sensor


_ONE_FACTOR: Final = frozenset({"sample_rate", "gyro_factor", "accel_factor"})
"""Causes of one factor on all axes, which may be that of a unit."""


def wrong_scales(evidence: Evidence) -> Iterator[Finding]:
    """Report the most likely cause of wrong scales; a wrong time unit is reported by another check."""
    yield from scale_findings(evidence, SCALES)


def scales_of_result(evidence: Evidence) -> Iterator[Finding]:
    """Report the cause of scale factors that a calibration found, and that no unit has.

    The readings of rotations by hand show their ratios to some percent only.
    """
    before, _ = evidence.once(_cause_of_readings)
    # Other causes stop the calibration and were found before it; these are warnings: the factor may be that of a unit.
    if _ONE_FACTOR.issuperset(before.faults) and evidence.result is not None:
        found = scale_findings(evidence, SCALES, evidence.once(_cause_of_result))
        yield from (finding for finding in found if finding.fault not in before.faults)


def refuted(evidence: Evidence, finding: Finding) -> bool:
    """True for a factor that the readings seem to have, and the scale factors of their calibration have not.

    Accelerations of the hand that go with the rotations shift the ratios by 10 % and more, in all turns alike.
    """
    if finding.fault not in _ONE_FACTOR or finding.effect != "warning" or evidence.result is None:
        return False
    measured = calibrated_ratios(evidence.result, "accel" if finding.fault == "accel_factor" else "gyro")
    return measured.known and finding.fault not in evidence.once(_cause_of_result)[0].faults


def _cause_of_result(evidence: Evidence) -> tuple[ScaleCause, RunnerUp | None]:
    assert evidence.result is not None
    gyro, accel = (calibrated_ratios(evidence.result, "gyro"), calibrated_ratios(evidence.result, "accel"))
    return scale_cause(evidence, gyro, accel)


def _cause_of_readings(evidence: Evidence) -> tuple[ScaleCause, RunnerUp | None]:
    return scale_cause(evidence, evidence.gyro_scales, evidence.accel_scales)


def scale_findings(
    evidence: Evidence, faults: Mapping[str, Fault], cause: tuple[ScaleCause, RunnerUp | None] | None = None
) -> Iterator[Finding]:
    """Findings of those of the faults that are the cause of the ratios, by default of those of the readings."""
    best, runner_up = cause or evidence.once(_cause_of_readings)
    for place, name in enumerate(best.faults):
        if name not in faults:
            continue
        limited = _limited(evidence, "accel" if name == "accel_factor" else "gyro") if name in _ONE_FACTOR else None
        yield limited or Finding(faults[name], best.details[name], runner_up if place == 0 else None)


def _limited(evidence: Evidence, sensor: Sensor) -> Finding | None:
    """Saturation of a triad below its noise, which has the effect of one factor on rotation angles or on gravity."""
    recording, turns, blocks = evidence.recording, evidence.manoeuvres, evidence.turning_blocks
    if turns is None or blocks is None or not len(turns.spans):
        return None
    found = rate_limit(blocks) if sensor == "gyro" else force_limit(turns, blocks)
    if found is None:
        return None
    axis, value, at = found
    # No sequence can be left out: what noise hides of the limit is in all of them.
    return replace(CLIPPED[sensor], effect="exit 1").found(
        channel=f"{sensor}_{AXES[axis]}",
        limit=value,
        count=len(at) * block_size(recording),
        time=float(recording.time[at[0]]),
        sequence=evidence.place_title(int(at[0])),
    )


_BY_LABELS: Final = "ratio of measured to labelled rotation angles"
_BY_GRAVITY: Final = "ratio of stationary specific force to gravity"
_BY_BOTH: Final = "gravity and rotation angles: both are the expected value"
_TURNED: Final = "The measured rotation angles are {ratio:.4g} times the expected ones ({title})"
_AT_REST: Final = "At rest the accelerometers read {found:.4g} m/s², but {expected:.4g} m/s² is expected"
_UNIT: Final = "the {}readings look like {{unit}}, declared as {{declared}}; correct {}_unit."

_KINDS: Final = tuple(
    (
        f"{found}s_as_{declared}s",
        f"{found.capitalize()}s declared as {declared}s",
        f"{_BY_BOTH} {operation} the sampling interval",
        "At rest the accelerometers read {accel:.4g} m/s², and the measured rotation angles are {turn:.3g} times the "
        f"expected ones: both are about the expected value {operation} the sampling interval ({{interval:.3g}} s), as "
        f'for {found}s; set kind = "{found}".',
    )
    for found, operation, declared in (("increment", "times", "rate"), ("rate", "divided by", "increment"))
)
_THINNED: Final = (
    "increments_thinned",
    "Increments are thinned out, not summed",
    f"{_BY_BOTH} divided by the same whole number; without a rotation, gravity alone, if the interval is longer than "
    "that of any IMU",
    "The increments are {ratio:.4g} times the expected ones, which is near 1/{count}: of every {count} increments, "
    "only one was kept; sum the increments of each interval instead, and record again.",
)
_GYRO_UNITS: Final = tuple(
    (f"gyro_{name}", f"Gyro readings {title}", _BY_LABELS, f"{_TURNED}: {_UNIT.format('gyro ', 'gyro')}")
    for name, title in (
        ("degrees", "in degrees, declared in radians"),
        ("radians", "in radians, declared in degrees"),
        ("per_hour", "per hour, declared per second, or the reverse"),
        ("other_unit", "in revolutions per minute, declared in rad/s"),
    )
)
_GYRO_MILLI: Final = (
    "gyro_milli",
    "Gyro readings in thousandths of the declared unit",
    _BY_LABELS,
    f"{_TURNED}: the gyro readings look like thousandths of the declared unit (mrad/s, mdeg/s); divide them by 1000.",
)
_ACCEL_UNITS: Final = tuple(
    (f"accel_{name}", f"Accelerometer readings in {title}", _BY_GRAVITY, f"{_AT_REST}: {_UNIT.format('', 'accel')}")
    for name, title in (
        ("g", "g, declared in m/s²"),
        ("mg", "mg, declared in another unit"),
        ("m_s2", "m/s², declared in g"),
        ("other_unit", "cm/s², mm/s² or ft/s², declared in m/s²"),
    )
)
_ABSENT: Final = (
    "gravity_absent",
    "The accelerometers do not measure gravity",
    "stationary specific force: far below gravity, and not in proportion to the poses",
    "At rest the accelerometers read {found:.3g} m/s², and not in proportion to the poses: the unit outputs linear "
    "acceleration, without gravity; record the raw specific force.",
)
_RATE: Final = (
    "sample_rate",
    "Wrong sample rate",
    "rotation angles (for increments: stationary specific force) wrong by one factor on all axes, which is not a power "
    "of two",
    "All axes of the {sensor} read {ratio:.4g} times the expected value, with a scatter of only {spread:.2g} between "
    "the axes: {advice}.",
)
_COUNTS: Final = by_sensor(
    "counts",
    "Raw [gyro|accelerometer] counts declared as [rates or angles|m/s² or g]",
    f"[{_BY_LABELS}|{_BY_GRAVITY}]; readings that are whole numbers",
    f"[{_TURNED}|{_AT_REST}], and the [gyro readings|readings] are whole numbers: they look like raw counts; set "
    '[gyro|accel]_unit = "counts" and [gyro|accel]_lsb.',
    "exit 1",
    wrong_scales,
)
_LSB: Final = by_sensor(
    "lsb",
    "Wrong value of [a gyro|an accelerometer] count, or wrong [gyro|accelerometer] range",
    f"[{_BY_LABELS}|{_BY_GRAVITY}]: a power of two on all axes or on one axis",
    "{who} {ratio:.4g} times [the true rotation|gravity], which is near a factor of {power:g}: the value of a count is "
    "that of another measuring range; correct [gyro|accel]_lsb.",
    "exit 1",
    wrong_scales,
)
_ONE_KIND: Final = by_sensor(
    "kind",
    "[Gyros|Accelerometers] alone give increments, declared as rates, or the reverse",
    f"[{_BY_LABELS}|{_BY_GRAVITY}]: the sampling interval, or its inverse, while the other sensor is right",
    "The [gyro|accelerometer] readings are {ratio:.4g} times [the true rotation|gravity], and the sampling interval is "
    "{interval:.3g} s: they look like {found}, declared as {declared}, unlike those of the [accelerometers|gyros]; "
    "{remedy} them by the interval.",
    "exit 1",
    wrong_scales,
)
_FACTOR: Final = by_sensor(
    "factor",
    "All [gyros|accelerometers] have a wrong scale by one factor",
    "[rotation angles|stationary specific force], or the scale factors of the calibration, wrong by one factor on all "
    "axes, [while the Earth rate contradicts a wrong sample rate|by more than gravity varies over the Earth], and more "
    "likely so than by equal errors of a sound unit: by [1|2] % at a scatter of the axes of 0.01 %, by 3 % at 0.1 %, "
    "by 9 % at 1 %. A smaller factor 1 + ε is ε of every scale factor, and nothing tells it from errors of the unit",
    "All [gyro|accelerometer] axes read {ratio:.4g} times [the true rotation|gravity], with a scatter of only "
    "{spread:.2g} between the axes, less than that of independent scale-factor errors: the value of a count or the "
    "unit is probably wrong by this factor; check [gyro_lsb and gyro_unit|accel_lsb and accel_unit].",
    "warning",
    scales_of_result,
)


def _stopping(*rows: tuple[str, str, str, str]) -> tuple[Fault, ...]:
    return tuple(Fault(*row, "exit 1", wrong_scales) for row in rows)


SCALES: Final = {
    fault.name: fault
    for fault in (
        *_stopping(*_KINDS, _THINNED, *_GYRO_UNITS, _GYRO_MILLI),
        _COUNTS["gyro"],
        *_stopping(*_ACCEL_UNITS),
        _COUNTS["accel"],
        *_ONE_KIND.values(),
        *_stopping(_ABSENT),
        *_LSB.values(),
        Fault(*_RATE, "warning", wrong_scales),
        *(replace(fault, needs_result=True) for fault in _FACTOR.values()),
    )
}


def clipping(evidence: Evidence) -> Iterator[Finding]:
    """Find readings at the stated range, runs of the same extreme reading, or rates limited below noise."""
    clipped = evidence.clipped_parts
    for sensor in ("gyro", "accel"):
        mine = [(k, part) for k, parts in clipped for part in parts if part.channel.startswith(sensor)]
        if not mine:
            limited = _limited(evidence, "gyro") if sensor == "gyro" else None
            # As the cause of wrong scales it is told there.
            if limited is not None and not _ONE_FACTOR.intersection(evidence.once(_cause_of_readings)[0].faults):
                yield limited
            continue
        k, first = mine[0]
        at = int(np.searchsorted(evidence.recording.time, first.first_s))
        table = getattr(evidence.recording, sensor)
        others = len({number for number, _ in mine}) - 1
        where = evidence.place_title(at) if k is None else evidence.title(k)
        yield CLIPPED[sensor].found(
            channel=first.channel,
            limit=abs(float(table[at, CHANNELS.index(first.channel) % 3])) * evidence.per_rate,
            count=first.count,
            time=first.first_s,
            sequence=where + (f" (and {others} more)" if others else ""),
        )


CLIPPED: Final = by_sensor(
    "clipped",
    "[A gyro|An accelerometer] saturates",
    "readings at the stated range, or runs of the same extreme reading; below noise (exit 1), [rates of gravity that "
    "exceed the largest readings|readings that stay while gravity moves off an axis]",
    "{channel} is at the limit of its range ({limit:.4g} [rad/s|m/s²]) in {count} samples from {time:.6g} s: "
    "{sequence} cannot be used; [rotate more slowly|avoid shocks, or choose a wider range], and repeat the sequence.",
    "warning",
    clipping,
)
