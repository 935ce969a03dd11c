"""Faults that once were told as another one: each is named by its own cause."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import srt
from sims.faults.injection import GRADES, Case
from srt.constants import DEG


@cache
def recording(grade):
    return Case(grade, 5_150).recording


def causes(changed):
    return [finding.fault for finding in srt.diagnose(changed, calibrating=False).findings]


def per_reading(grade):
    """Factor from rates to stored readings."""
    return recording(grade).nominal_interval_s if recording(grade).kind == "increment" else 1.0


@pytest.mark.parametrize("grade", GRADES[:3])  # noise and g-sensitivity of the last hide the Earth's rate
def test_gyros_zeroed_when_stationary_have_no_latitude(grade):
    gyro = recording(grade).gyro.copy()
    for label in recording(grade).sequences:
        for window in (label.start_static_s, label.end_static_s):
            rows = recording(grade).window_indices(*window)
            gyro[rows] -= gyro[rows].mean(axis=0)
    assert causes(replace(recording(grade), gyro=gyro)) == ["earth_rate_absent"]


@pytest.mark.parametrize("grade", GRADES)
def test_a_dead_band_is_no_latitude(grade):
    threshold = 0.01 if grade != "consumer-mems" else 0.08
    gyro = recording(grade).gyro
    gyro = np.sign(gyro) * np.where(np.abs(gyro) > threshold * per_reading(grade), np.abs(gyro), 0.0)
    assert causes(replace(recording(grade), gyro=gyro))[0] == "gyro_dead_band"


@pytest.mark.parametrize("place", [0.02, 0.5, 0.98])
@pytest.mark.parametrize("grade", GRADES)
def test_one_spike_shifts_no_label(grade, place):
    label = recording(grade).sequences[7]
    rows = recording(grade).window_indices(*label.end_static_s)
    gyro = recording(grade).gyro.copy()
    gyro[rows.start + round(place * (rows.stop - rows.start)), 2] += 5.0 * per_reading(grade)
    found = causes(replace(recording(grade), gyro=gyro))
    assert found[0] == "spikes"
    assert "labels_shifted" not in found


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
@pytest.mark.parametrize("grade", GRADES)
def test_words_that_overflow_are_no_axis_map(grade, sensor):
    readings = getattr(recording(grade), sensor)
    count = np.abs(readings).max() / 40_000.0  # of 32,767 that a word of 16 bits holds
    words = np.rint(readings / count).astype(np.int64).astype(np.int16)
    found = causes(replace(recording(grade), **{sensor: words * count}))
    assert found[0] == f"{sensor}_wrapped"


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("unit", [1.0, DEG])
def test_thousandths_of_a_unit_are_no_counts(grade, unit):
    """Readings in mrad/s or m°/s with three decimals, declared in rad/s or °/s."""
    milli = np.round(1e3 * recording(grade).gyro / unit, 3)
    assert causes(replace(recording(grade), gyro=milli * unit)) == ["gyro_milli"]


@pytest.mark.parametrize("grade", GRADES)
def test_a_corrected_recording_is_sound(grade):
    raw = recording(grade)
    applier = srt.Applier(srt.calibrate(raw, checks=False))
    interval = raw.interval_s if raw.kind == "increment" else None
    corrected = applier.apply(raw.gyro, raw.accel, **({} if interval is None else {"dt": interval}))
    assert causes(replace(raw, gyro=np.asarray(corrected[0]), accel=np.asarray(corrected[1]))) == []


@pytest.mark.parametrize("grade", GRADES)
def test_the_clean_twin_is_sound(grade):
    assert causes(recording(grade)) == []
