"""Faults and defects of generators that are no part of the simulator, and false alarms."""

from dataclasses import replace

import numpy as np
import pytest
from faults import KINDS as INJECTED
from faults import case_of, severity_at
from foreign_faults import KINDS, trial
from honesty import STUDIES
from honesty_recordings import DEFECTS
from injected_faults.injection import GRADES, Case
from scipy import stats

import srt
from srt.diagnosis import false_alarms
from srt.diagnosis.staged_diagnosis import diagnose
from srt.noise import drift_forms
from srt.sequences import clipping, vibration

SEED = 20261410


def injected(kind, grade, rung, severity=None):
    """Recording of the unit of a grade and a step, of a severity or of the stated one halved ``rung`` times."""
    made = INJECTED[kind]
    if severity is None:
        made = replace(made, severity={grade: made.severity.get(grade, next(iter(made.severity.values())))})
        steps = (severity_at(made, grade, step) for step in range(rung, -1, -1))
        severity = next(step for step in steps if step is not None)
    return made.recording(case_of(grade, SEED + 10 * GRADES.index(grade) + rung), severity)


def first_cause(kind, *unit):
    """First cause named, a note if it is the right one; that of the refusal where the recording is not made."""
    try:
        found = diagnose(injected(kind, *unit), INJECTED[kind].options)
    except srt.InputError as error:
        return error.fault
    first = found.first or next((f for f in found.findings if f.fault in INJECTED[kind].causes), None)
    return first and first.fault


def case(kind, grade, rung=0, *, slow=True):
    return pytest.param(kind, grade, rung, marks=[pytest.mark.slow] if slow else [])


@pytest.mark.parametrize(
    ("kind", "grade", "rung"),
    [
        case("one accelerometer limited", "navigation-rlg", 1, slow=False),  # pulses held at one limit of one axis
        case("one accelerometer limited", "navigation-rlg", 0),
        case("gyro_wrapped", "industrial-mems", 1, slow=False),  # ramps wrap within their slope
        case("gyro_wrapped", "navigation-rlg", 1),
        case("unsigned words", "consumer-mems", 0),
        case("unsigned words", "tactical-fog", 1),
        case("one axis of another range", "industrial-mems", 0, slow=False),
        case("one axis in degrees", "navigation-rlg", 0),
        case("gyro_dead_band", "navigation-rlg", 1),  # two pulses
        case("sample_rate", "navigation-rlg", 2, slow=False),  # 2.4 %: the Earth rate is off by the same factor
        case("clock fast", "navigation-rlg", 2),
        case("latitude", "navigation-rlg", 0),
        case("accel_lsb", "navigation-rlg", 1, slow=False),  # the Earth rate contradicts a wrong sample rate
        case("time_unit", "tactical-fog", 1),  # 31.6 times: near g, but equal on all axes
        case("stamps in minutes", "industrial-mems", 0, slow=False),  # 60 times is near 57.3, degrees
        case("every second increment dropped", "tactical-fog", 0, slow=False),
        case("time_unit and gyro_lsb", "navigation-rlg", 2),  # an unknown clock and an unknown factor together
        case("one axis in degrees", "consumer-mems", 0),
        case("gyros high-passed", "consumer-mems", 2, slow=False),  # decays that look like shifted labels
        case("gyros high-passed", "navigation-rlg", 0),
        case("gravity removed", "tactical-fog", 0, slow=False),
        case("negative readings cut off", "industrial-mems", 0, slow=False),
        case("sign bit and magnitude", "navigation-rlg", 0, slow=False),
        case("sign bit and magnitude", "tactical-fog", 1),
        case("gyro_wrapped", "tactical-fog", 2, slow=False),  # three times in a ramp
        case("accel_wrapped", "industrial-mems", 2),
        case("longitude for latitude", "tactical-fog", 0),
        case("gyro_counts", "consumer-mems", 0, slow=False),  # 65.5 counts for 1 deg/s: within the range of a clock
        case("gyro_one_polarity", "consumer-mems", 0),  # a dead band, too
        case("samples_lost", "tactical-fog", 0),  # one rotation is an outlier, no step
        case("labels of a fast clock", "navigation-rlg", 0),
        case("time of the labels from the start", "consumer-mems", 0),
    ],
)
def test_named_first(kind, grade, rung):
    assert first_cause(kind, grade, rung) in INJECTED[kind].causes


@pytest.mark.parametrize(
    ("kind", "grade", "severity"),
    [
        case("labels_shifted", "navigation-rlg", 0.037, slow=False),  # a line in the spectrum of the windows
        case("labels_shifted", "consumer-mems", 0.016),  # 4 sigma of one parameter
        case("windows reach into the rotations", "tactical-fog", 0.037, slow=False),  # refused by the angle in a window
        case("windows reach into the rotations", "industrial-mems", 0.14),  # noise
        case("labels of a fast clock", "tactical-fog", 0.000625),  # a high-pass filter
        case("gyro_axis_delayed", "industrial-mems", 40.0, slow=False),  # a noisy window
        case("gyros low-passed", "industrial-mems", 60.0),  # an oscillating fixture
        case("samples_duplicated", "navigation-rlg", 24.0, slow=False),  # spikes, or lost samples
        case("last value held at a lost sample", "navigation-rlg", 30.0),
        case("clock set by GPS", "industrial-mems", 30.0, slow=False),  # labels in the gap
        case("gap bridged by a line", "industrial-mems", 0.6),  # shifted labels
        case("dead band of accelerometers", "consumer-mems", 16000.0, slow=False),  # a noisy window
        case("bit of a converter stuck", "navigation-rlg", 10.0, slow=False),  # vibration
        case("unsigned words", "navigation-rlg", 1.0),  # one polarity
    ],
)
def test_named_first_at_a_severity(kind, grade, severity):
    assert first_cause(kind, grade, 1, severity) in INJECTED[kind].causes


@pytest.mark.parametrize(
    ("kind", "size", "number"),
    [
        ("gravity removed", 1.4, 9),  # increments; refused without a cause before any window is found
        ("gravity removed", 0.96, 48),  # a wrong angle
        ("gravity removed", 0.75, 148),  # g
        ("gyros high-passed", 3.7, 115),  # one window of stillness
        ("gyros high-passed", 13.4, 139),  # creep
        ("gyros high-passed", 4.1, 165),
        ("gyro wire broken", 0.21, 81),  # a wrong angle
        ("accel wire broken", 0.31, 108),  # a noisy window
        ("accel wire broken", 0.36, 185),  # missing sequences
        ("gyro of one polarity", 1.0, 44),  # a missing sequence
        ("gyro of one polarity", 1.0, 160),  # a flipped axis
        ("accel of one polarity", 1.0, 153),
        ("accel wire broken, noisy", 0.5, 73),  # a noisy window
        ("dead band subtracted", 2.12, 46),  # spikes
        ("accel saturated, noisy", 0.68, 25),  # a factor of the accelerometers
        ("gyro saturated, noisy", 0.63, 81),  # a sample rate
    ],
)
def test_drawn_fault_is_first(kind, size, number):
    recording = trial(KINDS[kind], size, (20261144, number)).recording()
    found = diagnose(recording)
    assert found.first.fault in KINDS[kind].causes.split()
    assert found.judgement is None or found.judgement.word != "sound"


def test_parts_of_rotations_that_jitter_overlap():
    recording = trial(KINDS["jitter"], 0.0763, (20261147, 192)).recording()
    assert srt.calibrate(recording).judgement.word == "doubtful"


@pytest.mark.parametrize("kind", ["sensors askew in their housing", "gyro scale drifts"])
def test_mixed_pulses_are_no_dead_band(kind):
    recording = injected(kind, "navigation-rlg", 1)
    assert "gyro_dead_band" not in {f.fault for f in diagnose(recording, calibrating=False).findings}


@pytest.mark.slow
@pytest.mark.parametrize("grade", ["navigation-rlg", "tactical-fog"])
def test_earth_rate_of_sound_units_confirms_no_sample_rate(grade):
    for seed in range(SEED, SEED + 8):
        assert diagnose(Case(grade, seed).recording, calibrating=False).findings == ()


PER_RECORDING = 1e-4
"""Probability by design of any finding, or of a drift in the calibration, in a recording without a fault."""
IN_WINDOWS = ("rotation", "oscillation", "bumps", "creep", "noise")
OVER_SEQUENCES = ("lost samples", "lags", "settling", "joined units", "drift of scale factors")
OF_SAMPLES = ("repeated samples", "spikes", "truncation")
OF_RATES = ("absent Earth rate", "latitude", "north", "drift of bias", "noise of gyros", "noise of accelerometers")
OF_RESULT = ("moves that contradict a closed form",)


def test_all_checks_together_raise_a_finding_in_one_of_10000_recordings():
    tests = len((*IN_WINDOWS, *OVER_SEQUENCES, *OF_SAMPLES, *OF_RATES, *OF_RESULT))
    total = tests * false_alarms.FALSE_ALARM + vibration.FALSE_ALARM + drift_forms.FALSE_ALARM
    total += 12 * (clipping._CHANCE + 0.5**clipping._PILE)
    assert 0.5 * PER_RECORDING < total <= PER_RECORDING


@pytest.mark.parametrize(
    ("name", "freedom", "distribution"),
    [
        ("normal", (), stats.norm()),
        ("t", (7.0,), stats.t(7.0)),
        ("chi-square", (3.0,), stats.chi2(3.0)),
        ("F", (1.0, 40.0), stats.f(1.0, 40.0)),
    ],
)
def test_a_statistic_exceeds_its_limit_with_its_share_of_the_false_alarms(name, freedom, distribution):
    """Quantiles are inverted by iteration: 1e-9 of the probability."""
    alone = distribution.sf(false_alarms.limit(name, *freedom))
    assert alone == pytest.approx(false_alarms.FALSE_ALARM, rel=1e-9)
    one_of_six = distribution.sf(false_alarms.limit(name, *freedom, tests=3, both_sides=True, shared=1e-3))
    assert one_of_six == pytest.approx(1e-3 / 6.0, rel=1e-9)


def test_limits_have_the_shape_of_the_degrees_of_freedom():
    freedom = np.array([[2.0, 5.0, 9.0]])
    assert false_alarms.limit("chi-square", freedom).shape == freedom.shape


@pytest.mark.parametrize("quantile", [0.5, 0.9])
def test_sigma_from_a_quantile_scatters_as_its_degrees_of_freedom_state(quantile):
    """2000 sigmas from 400 values: their mean within four of its sigmas, their variance within 4 sqrt(2 / 2000)."""
    n, trials = 400, 2000
    found = false_alarms.robust_sigma(np.random.default_rng(5).normal(0.0, 3.0, (trials, n)), 1, quantile) / 3.0
    variance = 0.5 / false_alarms.robust_freedom(n, quantile)
    # The median of so many magnitudes is biased by less than 1 / n.
    assert found.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(variance / trials) + 1.0 / n)
    assert found.var() == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / trials))


def outcome(name, unit):
    return STUDIES["defects"].trial((name,), unit, [])["default"]


@pytest.mark.parametrize("name", [name for name in DEFECTS if name not in {"none", "none, 9 turns"}])
def test_a_defect_is_named_or_harmless(name):
    found = outcome(name, 0)
    assert set(DEFECTS[name].named) <= set(found.faults)
    if found.usable:
        # Of at most 27 normal errors of ten recordings, one in a hundred has one beyond 4.2 sigma.
        assert np.nanmax(np.abs(found.z)) <= 4.2
    else:
        assert found.status == "refused"
        assert found.faults


def test_a_shake_on_all_axes_is_clipped():
    """All three axes hold their extremes at once, and show no noise there."""
    assert outcome("shake at ±32767", 4).faults[0] == "gyro_clipped"
