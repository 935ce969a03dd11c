"""Every fault named first by the checks of its stages, and sound recordings left alone: one unit of each grade.

``benchmarks/faults.py`` runs 200 of each.
"""

from dataclasses import dataclass

import injected_faults.execution
import injected_faults.logger
import injected_faults.site_and_drift  # noqa: F401 - these modules register their injections on import
import pytest
from diagnosing import case_of, examine_stages, grades_and_faults
from injected_faults.injection import GRADES, INJECTIONS

from srt.diagnosis.faults import STAGES


@dataclass(frozen=True)
class Group:
    """Stages that are examined together, and those of their faults that show in their evidence."""

    stages: tuple[str, ...]
    seed: int
    faults: tuple[str, ...]
    calibrating: bool = True

    def examine(self, recording, options=None):
        return examine_stages(recording, self.stages, options=options, calibrating=self.calibrating)


def names(*stages, clipped=False):
    """Names of the faults of stages, of clipped readings alone or of all others."""
    return tuple(f.name for stage in stages for f in STAGES[stage].faults if f.name.endswith("clipped") == clipped)


GROUPS = {
    "samples": Group(
        ("timing", "channels", "units", "frames"),
        320_000,
        (*names("timing", "channels"), *names("units", clipped=True)),
    ),
    "scales": Group(("units", "frames"), 330_000, names("units", "frames"), calibrating=False),
    "motion": Group(
        ("sequences", "windows", "motion"),
        320_000,
        (
            *("labels_shifted", "labels_exchanged", "wrong_direction", "wrong_angle", "sequence_missing"),
            *("sequence_repeated", "window_short", "vibration", "spectral_line", "unsettled", "bump", "creep"),
            "noisy_window",
            *("sensor_time_offset", "samples_lost"),
        ),
    ),
    "site": Group(("site",), 300_000, ("gravity", "latitude", "north")),
    "unit": Group(
        ("unit",),
        310_000,
        (
            *("temperature_unit", "temperature_drift", "gyro_bias_drift", "accel_bias_drift", "gyro_noise"),
            *("accel_noise", "asymmetry_omitted"),
        ),
    ),
}
BY_FAULT = {fault: name for name, group in GROUPS.items() for fault in group.faults}


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("name", GROUPS)
def test_a_sound_recording_raises_nothing(name, grade):
    group = GROUPS[name]
    assert group.examine(case_of(grade, group.seed).recording) == ()


@grades_and_faults(BY_FAULT)
def test_each_fault_is_named_first(fault, grade):
    injection, group = INJECTIONS[fault], GROUPS[BY_FAULT[fault]]
    if grade in injection.unseen and BY_FAULT[fault] not in ("motion", "unit"):
        assert grade not in injection.severity
        pytest.skip(injection.unseen[grade])
    assert grade in injection.severity
    found = group.examine(injection.recording(case_of(grade, group.seed)), injection.options)
    assert found[0].fault == fault
    assert len(found) == 1 or BY_FAULT[fault] not in ("site", "unit")
