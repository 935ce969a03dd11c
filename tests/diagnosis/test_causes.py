"""Faults that once were told as another one: each is named by its own cause."""

from dataclasses import replace
from functools import cache

import injected_faults.execution
import injected_faults.logger
import injected_faults.site_and_drift  # noqa: F401 - registers its injections
import numpy as np
import pytest
from diagnosing import every_second_grade, examine_stages, grades_and_faults
from faults import foreign_unit
from injected_faults.injection import GRADES, INJECTIONS, Case
from scipy.ndimage import uniform_filter1d

import srt
from srt.constants import DEG
from srt.sequences.clipping import clipping_levels


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


@pytest.mark.parametrize("grade", every_second_grade(1))
def test_a_dead_band_is_no_latitude(grade):
    threshold = 0.01 if grade != "consumer-mems" else 0.08
    gyro = recording(grade).gyro
    gyro = np.sign(gyro) * np.where(np.abs(gyro) > threshold * per_reading(grade), np.abs(gyro), 0.0)
    assert causes(replace(recording(grade), gyro=gyro))[0] == "gyro_dead_band"


def test_a_dead_band_that_readings_seldom_reach_is_told():
    """At rest the bias of the gyro lies beyond it, so that few readings are zero."""
    gyro = recording("consumer-mems").gyro.copy()
    axis = int(np.argmax(np.abs(np.median(gyro, axis=0))))
    small = np.abs(gyro[:, axis]) < np.sort(np.abs(gyro[:, axis]))[300]
    gyro[small, axis] = 0.0
    assert 100 < np.count_nonzero(small) <= 300
    assert causes(replace(recording("consumer-mems"), gyro=gyro))[0] == "gyro_dead_band"


@cache
def foreign(grade, by_hand):
    """Unit of a generator that shares nothing with the checks, with bias."""
    return foreign_unit(grade, 5_151, np.random.default_rng(5_151), by_hand=by_hand)[0].recording


def banded(unit, sensor, *, count, band):
    """Readings rounded to a count (or not), and less by a band, both in units of their noise; zero below the band."""
    x = getattr(unit, sensor)
    rows = unit.window_indices(*unit.sequences[0].start_static_s)
    noise = float(np.median(np.std(np.diff(x[rows], axis=0), axis=0))) / np.sqrt(2.0)
    lsb, band = (count or 1.0) * noise, band * noise
    read = np.rint(x / lsb) * lsb if count else x
    return replace(unit, **{sensor: np.sign(read) * np.maximum(np.abs(read) - band, 0.0)})


@pytest.mark.parametrize(("count", "band"), [(0.0, 0.1), (0.0, 0.7), (1.0, 1.0), (0.25, 0.25), (0.25, 1.0)])
@pytest.mark.parametrize(
    ("grade", "sensor", "by_hand"),
    [("industrial-mems", "gyro", True), ("tactical-fog", "gyro", False), ("industrial-mems", "accel", False)],
)
def test_a_dead_band_subtracted_below_the_noise_is_told(grade, sensor, by_hand, count, band):
    """The readings leave no gap, and their median is not zero."""
    found = examine_stages(banded(foreign(grade, by_hand), sensor, count=count, band=band), ["channels"])
    assert found[0].fault == f"{sensor}_dead_band"
    details, expected = found[0].details, found[0].details["expected"]
    assert details["count"] > 2 * expected
    assert (expected > 0) == (count > 0.0)
    assert "below its noise" in found[0].sentence


@pytest.mark.parametrize("count", [1.0, 0.4])
def test_a_dead_band_of_one_count_is_told(count):
    unit = banded(foreign("industrial-mems", False), "gyro", count=count, band=0.0)
    lsb = float(np.abs(unit.gyro[unit.gyro != 0.0]).min())
    found = examine_stages(replace(unit, gyro=np.where(np.abs(unit.gyro) < 1.5 * lsb, 0.0, unit.gyro)), ["channels"])
    assert found[0].fault == "gyro_dead_band"
    assert (found[0].details["threshold"], found[0].details["step"]) == pytest.approx((2.0 * lsb, lsb))


def test_a_bias_hides_a_dead_band_of_coarse_readings_alone():
    """Readings that reach zero in rotations alone show it if they are fine."""
    unit = foreign("consumer-mems", False)
    fine, coarse = (examine_stages(banded(unit, "gyro", count=n, band=0.5), ["channels"]) for n in (0.0, 0.5))
    assert [finding.fault for finding in fine] == ["gyro_dead_band"]
    assert coarse == ()


@pytest.mark.parametrize("count", [0.0, 2.0, 1.0, 0.25, 0.05])
@pytest.mark.parametrize("by_hand", [False, True])
@pytest.mark.parametrize("grade", GRADES)
def test_rounded_readings_have_no_dead_band(grade, by_hand, count):
    unit = foreign(grade, by_hand)
    coarse = banded(banded(unit, "gyro", count=count, band=0.0), "accel", count=count, band=0.0)
    assert examine_stages(coarse, ["channels"]) == ()


def test_a_frozen_or_lost_reading_of_zero_is_no_dead_band():
    """An axis that reads zero for 10 s, and samples written as zeros, are other faults."""
    unit = foreign("industrial-mems", False)
    gyro, accel = unit.gyro.copy(), unit.accel.copy()
    gyro[2000:2500, 1] = 0.0
    gyro[3000:9000:97] = accel[3000:9000:97] = 0.0
    found = {finding.fault for finding in examine_stages(replace(unit, gyro=gyro, accel=accel), ["channels"])}
    assert found
    assert not found & {"gyro_dead_band", "accel_dead_band"}


def test_samples_filled_by_straight_lines_have_no_dead_band():
    """They lie between the steps of the readings, of which the first one above zero is no threshold."""
    gyro, accel = (getattr(recording("consumer-mems"), name).copy() for name in ("gyro", "accel"))
    rows = np.arange(4000, 4320)
    for values in (gyro, accel):
        values[rows] = values[rows[0]] + np.linspace(0.0, 1.0, len(rows))[:, None] * (
            values[rows[-1]] - values[rows[0]]
        )
    faulty = replace(recording("consumer-mems"), gyro=gyro, accel=accel)
    assert "gyro_dead_band" not in causes(faulty)
    assert causes(faulty)[0] == "samples_interpolated"


@pytest.mark.parametrize("place", [0.02, 0.5, 0.98])
@pytest.mark.parametrize("grade", every_second_grade(0))
def test_one_spike_shifts_no_label(grade, place):
    label = recording(grade).sequences[7]
    rows = recording(grade).window_indices(*label.end_static_s)
    gyro = recording(grade).gyro.copy()
    gyro[rows.start + round(place * (rows.stop - rows.start)), 2] += 5.0 * per_reading(grade)
    found = causes(replace(recording(grade), gyro=gyro))
    assert found[0] == "spikes"
    assert "labels_shifted" not in found


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
@pytest.mark.parametrize("grade", every_second_grade(1))
def test_words_that_overflow_are_no_axis_map(grade, sensor):
    readings = getattr(recording(grade), sensor)
    count = np.abs(readings).max() / 40_000.0  # of 32,767 that a word of 16 bits holds
    words = np.rint(readings / count).astype(np.int64).astype(np.int16)
    found = causes(replace(recording(grade), **{sensor: words * count}))
    assert found[0] == f"{sensor}_wrapped"


@pytest.mark.parametrize("share", [0.571, 0.6, 0.629])
def test_words_that_overflow_between_pulses_have_no_dead_band(share):
    """The range is no multiple of a pulse, so that readings that overflow lie between those that do not."""
    gyro = recording("navigation-rlg").gyro
    half = share * np.abs(gyro).max()
    found = causes(replace(recording("navigation-rlg"), gyro=(gyro + half) % (2.0 * half) - half))
    assert found[0] == "gyro_wrapped"
    assert "gyro_dead_band" not in found


@pytest.mark.parametrize("grade", every_second_grade(0))
@pytest.mark.parametrize("unit", [1.0, DEG])
def test_thousandths_of_a_unit_are_no_counts(grade, unit):
    """Readings in mrad/s or m°/s with three decimals, declared in rad/s or °/s."""
    milli = np.round(1e3 * recording(grade).gyro / unit, 3)
    assert causes(replace(recording(grade), gyro=milli * unit)) == ["gyro_milli"]


@pytest.mark.parametrize("grade", GRADES)
def test_a_corrected_recording_is_sound(grade):
    """With its labels and without."""
    raw = recording(grade)
    applier = srt.Applier(srt.calibrate(raw, checks=False))
    interval = raw.interval_s if raw.kind == "increment" else None
    corrected = applier.apply(raw.gyro, raw.accel, **({} if interval is None else {"dt": interval}))
    corrected = replace(raw, gyro=np.asarray(corrected[0]), accel=np.asarray(corrected[1]))
    assert causes(corrected) == []
    assert causes(corrected.with_sequences(())) == []


def test_corrected_pulses_that_recur_together_are_not_clipped():
    """Equal pulses of all axes give equal corrected readings, off any grid, and often at their largest value."""
    changes = {"recording": {"sample_rate_hz": 50.0, "kind": "increment"}, "schedule": {"moves": "recorded"}}
    raw = Case("navigation-rlg", 35, changes).recording
    gyro, accel = srt.Applier(srt.calibrate(raw, checks=False)).apply(raw.gyro, raw.accel, dt=raw.interval_s)[:2]
    levels = clipping_levels(replace(raw, gyro=np.asarray(gyro), accel=np.asarray(accel)))
    assert not np.isfinite(levels.high).any()
    assert not np.isfinite(levels.low).any()


@pytest.mark.parametrize("grade", every_second_grade(0))
def test_readings_off_their_grid_are_sound(grade):
    """A filter or a conversion leaves rounding on readings that their unit had quantized."""
    rng = np.random.default_rng(17)
    raw = recording(grade)
    gyro, accel = (table + rng.normal(0.0, 1e-12, table.shape) for table in (raw.gyro, raw.accel))
    assert causes(replace(raw, gyro=gyro, accel=accel)) == []


@pytest.mark.parametrize("grade", every_second_grade(1))
def test_filtered_readings_are_sound(grade):
    """A moving average of three samples, as in many units, without stated noise, which it changes.

    The filter runs before the logger, which does not record the moves between the sequences.
    """
    raw = recording(grade)
    pieces = np.flatnonzero(np.diff(raw.time) > 1.5 * raw.nominal_interval_s) + 1
    gyro, accel = (
        np.concatenate([uniform_filter1d(piece, 3, axis=0, mode="nearest") for piece in np.split(table, pieces)])
        for table in (raw.gyro, raw.accel)
    )
    noise = replace(raw.noise, gyro_noise=None, accel_noise=None)
    assert causes(replace(raw, gyro=gyro, accel=accel, noise=noise)) == []


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
@pytest.mark.parametrize("grade", GRADES[1:])  # pulses of the first repeat for seconds
def test_one_axis_that_freezes_is_named_alone(grade, sensor):
    """Half a second in the middle of a rotation, in which no other axis freezes."""
    label = recording(grade).sequences[12]
    first = recording(grade).window_indices(label.start_static_s[1], label.end_static_s[0]).start + 60
    readings = getattr(recording(grade), sensor).copy()
    readings[first : first + 50, 1] = readings[first - 1, 1]
    found = srt.diagnose(replace(recording(grade), **{sensor: readings}), calibrating=False).findings
    assert found[0].fault == f"{sensor}_axis_stuck"
    assert found[0].details["channel"] == f"{sensor}_y"
    assert abs(found[0].details["count"] - 50) <= 2


@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
@pytest.mark.parametrize("grade", every_second_grade(1))
def test_an_axis_held_at_its_limit_is_clipped_not_frozen(grade, share):
    """Half the rate is no wrong value of a count either; the stated range is ten times as wide."""
    limit = share * np.abs(recording(grade).gyro).max()
    found = causes(replace(recording(grade), gyro=recording(grade).gyro.clip(-limit, limit)))
    assert found[0] == "gyro_clipped"
    assert "gyro_axis_stuck" not in found


@pytest.mark.parametrize("grade", every_second_grade(0))
def test_the_clean_twin_is_sound(grade):
    assert causes(recording(grade)) == []


NEW = ("gyro_axis_delayed", "accel_axis_delayed", "accel_settling", "samples_duplicated", "units_joined")


@grades_and_faults(NEW)
def test_each_injection_is_named_first(grade, fault):
    """One unit; ``benchmarks/faults.py`` runs several severities. Times, places and sizes come from the seed."""
    if grade not in INJECTIONS[fault].severity:
        pytest.skip(INJECTIONS[fault].unseen[grade])
    injected = INJECTIONS[fault].recording(Case(grade, 5_150))
    assert causes(injected)[0] == fault


@pytest.mark.parametrize("grade", GRADES)
def test_noise_in_one_window_between_pulses_is_no_dead_band(grade):
    """Readings off the grid of the pulses, in one window alone, come as near to zero as can be."""
    assert causes(INJECTIONS["noisy_window"].recording(Case(grade, 60_000)))[0] == "noisy_window"


def test_a_converter_with_uneven_steps_is_no_truncation():
    """Odd numbers are read half as often as even ones, zero among these: so reads a real converter."""
    own, rng = recording(GRADES[2]), np.random.default_rng(20261128)
    rests = np.concatenate(
        [np.arange(*own.window_indices(*s.start_static_s).indices(10**9)[:2]) for s in own.sequences]
    )
    gyro = own.gyro - np.median(own.gyro[rests], axis=0)
    counts = gyro / (0.3 * gyro[rests].std())
    odd = np.rint(counts) % 2 != 0
    uneven = np.rint(counts) + (odd & (rng.random(counts.shape) < 0.5))
    step = 0.3 * gyro[rests].std()
    assert "gyro_truncated" not in causes(replace(own, gyro=step * uneven))
    assert "gyro_truncated" in causes(replace(own, gyro=step * np.trunc(counts)))
