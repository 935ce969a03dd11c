"""Catalogue of the faults of a recording, each with its check, by the stages in which the checks run.

A fault can cause findings of faults that are listed after it: degrees read as radians also look like clipping, and lost
samples look like a wrong angle. Of several findings, the first in this order is therefore reported as the cause.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from srt.diagnosis import (
    axes,
    channels,
    decays,
    imu_properties,
    joined_units,
    sensor_synchronisation,
    sequences,
    site,
    timing,
    units,
    window_disturbances,
    words,
)
from srt.diagnosis.findings import Check, Fault

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.diagnosis.findings import Finding


class Stage(NamedTuple):
    """Stage of the checks: its title, and the faults that it finds."""

    title: str
    faults: tuple[Fault, ...]

    def checks(self, *, of_result: bool) -> tuple[Check, ...]:
        """Checks of the stage: those that use a calibration of the recording, or those that do not."""
        return tuple({f.check: None for f in self.faults if f.check is not None and f.needs_result == of_result})


def _on_reading(name: str, title: str, criterion: str) -> Fault:
    return Fault(name, title, criterion, "{message}", "exit 2")


STAGES: Final = {
    "file": Stage(
        "Refused on reading",
        (
            _on_reading("not_finite", "A reading is not a finite number", "every reading"),
            _on_reading("time_backwards", "Time stamps decrease", "steps of the time stamps"),
            _on_reading("time_repeats", "A time stamp repeats", "steps of the time stamps"),
            _on_reading(
                "rate_contradicts_stamps",
                "The stated sample rate contradicts the time stamps",
                "sample_rate_hz against the mean step of the time stamps",
            ),
        ),
    ),
    "timing": Stage("Time stamps", (timing.TIME_UNIT, timing.STAMP_JITTER, timing.CLOCK_DRIFT, timing.GAP_IN_SEQUENCE)),
    "channels": Stage(
        "Channels and logger",
        (
            *channels.CHANNEL_DEAD.values(),
            channels.COLUMNS_REPEAT,
            channels.SENSORS_EXCHANGED,
            decays.GYRO_HIGH_PASSED,
            decays.GRAVITY_REMOVED,
            channels.SAMPLES_STUCK,
            channels.SAMPLES_DUPLICATED,
            *channels.STUCK.values(),
            *words.ONE_POLARITY.values(),
            words.DEAD_BAND["gyro"],
            channels.SAMPLES_INTERPOLATED,
            words.DEAD_BAND["accel"],
            *words.TRUNCATED.values(),
            words.BIT_STUCK,
            *channels.AXIS_STUCK.values(),
            *words.WRAPPED.values(),
            channels.SPIKES,
        ),
    ),
    "units": Stage("Units, scales and ranges", (*units.SCALES.values(), *units.CLIPPED.values())),
    "frames": Stage(
        "Axes and frames",
        (
            *axes.SIGN_CONVENTION.values(),
            *axes.AXIS_FLIPPED.values(),
            *axes.AXES_SWAPPED.values(),
            axes.LEFT_HANDED,
            axes.FRAME_TURNED,
            axes.FRAMES_DISAGREE,
        ),
    ),
    "sequences": Stage(
        "Sequences and labels",
        (
            sequences.LABELS_SHIFTED,
            sequences.LABELS_EXCHANGED,
            sequences.WRONG_DIRECTION,
            joined_units.UNITS_JOINED,
            sequences.WRONG_ANGLE,
            sequences.SEQUENCE_MISSING,
            sequences.SEQUENCE_REPEATED,
            sequences.WINDOW_SHORT,
        ),
    ),
    "windows": Stage(
        "Stationary windows",
        (
            window_disturbances.UNSETTLED,
            window_disturbances.VIBRATION,
            window_disturbances.SPECTRAL_LINE,
            window_disturbances.BUMP,
            window_disturbances.CREEP,
            window_disturbances.NOISY_WINDOW,
            decays.ACCEL_SETTLING,
        ),
    ),
    "motion": Stage(
        "Rotations",
        (
            sensor_synchronisation.SENSOR_TIME_OFFSET,
            *sensor_synchronisation.AXIS_DELAYED.values(),
            sensor_synchronisation.SAMPLES_LOST,
        ),
    ),
    "site": Stage("Site", (site.GRAVITY, site.EARTH_RATE_ABSENT, site.LATITUDE, site.NORTH)),
    "unit": Stage(
        "IMU",
        (
            imu_properties.TEMPERATURE_UNIT,
            imu_properties.TEMPERATURE_DRIFT,
            imu_properties.GYRO_BIAS_DRIFT,
            joined_units.GYRO_SCALE_DRIFT,
            imu_properties.ACCEL_BIAS_DRIFT,
            *imu_properties.NOISE.values(),
            imu_properties.ASYMMETRY_OMITTED,
        ),
    ),
}
"""Stages in the order in which they run."""

FAULTS: Final = {fault.name: fault for stage in STAGES.values() for fault in stage.faults}
"""All faults by name, each before the faults that it causes."""

_RANK: Final = {name: rank for rank, name in enumerate(FAULTS)}


def sort_by_cause(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sort findings in the order of the catalogue: each fault before the faults that it causes."""
    return tuple(sorted(findings, key=lambda finding: _RANK[finding.fault]))
