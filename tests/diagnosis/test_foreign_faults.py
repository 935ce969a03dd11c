"""Faults and defects of generators that are no part of the simulator, and false alarms."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from faults import KINDS as INJECTED
from faults import case_of, causes_of, foreign_unit, outcome_of, severity_at
from foreign_motion import GRADES as FOREIGN_GRADES
from foreign_motion import drawn_errors, hand_turns, recording, windows
from injected_faults.injection import GRADES, Case
from scipy import stats
from scipy.signal import lfilter

import srt
from srt.diagnosis import false_alarms
from srt.diagnosis.staged_diagnosis import diagnose
from srt.noise import drift_forms
from srt.sensor_errors import NAMES
from srt.sequences import clipping, vibration

SEED = 20261410
SLOW = pytest.mark.slow


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


def case(kind, grade, rung=0, *, marks=pytest.mark.campaign):
    return pytest.param(kind, grade, rung, marks=marks)


@pytest.mark.parametrize(
    ("kind", "grade", "rung"),
    [
        case("one accelerometer limited", "navigation-rlg", 1, marks=()),  # pulses held at one limit of one axis
        case("one accelerometer limited", "navigation-rlg", 0),
        case("gyro_wrapped", "industrial-mems", 1, marks=SLOW),  # ramps wrap within their slope
        case("gyro_wrapped", "navigation-rlg", 1),
        case("unsigned words", "consumer-mems", 0),
        case("unsigned words", "tactical-fog", 1),
        case("one axis of another range", "industrial-mems", 0, marks=()),
        case("one axis in degrees", "navigation-rlg", 0),
        case("gyro_dead_band", "navigation-rlg", 1, marks=SLOW),  # two pulses
        case("sample_rate", "navigation-rlg", 2, marks=()),  # 2.4 %: the Earth rate is off by the same factor
        case("clock fast", "navigation-rlg", 2),
        case("latitude", "navigation-rlg", 0),
        case("accel_lsb", "navigation-rlg", 1, marks=SLOW),  # the Earth rate contradicts a wrong sample rate
        case("time_unit", "tactical-fog", 1),  # 31.6 times: near g, but equal on all axes
        case("stamps in minutes", "industrial-mems", 0, marks=()),  # 60 times is near 57.3, degrees
        case("every second increment dropped", "tactical-fog", 0, marks=SLOW),
        case("time_unit and gyro_lsb", "navigation-rlg", 2),  # an unknown clock and an unknown factor together
        case("one axis in degrees", "consumer-mems", 0),
        case("gyros high-passed", "consumer-mems", 2, marks=()),  # decays that look like shifted labels
        case("gyros high-passed", "navigation-rlg", 0),
        case("gravity removed", "tactical-fog", 0, marks=SLOW),
        case("negative readings cut off", "industrial-mems", 0, marks=()),
        case("sign bit and magnitude", "navigation-rlg", 0, marks=SLOW),
        case("sign bit and magnitude", "tactical-fog", 1),
        case("gyro_wrapped", "tactical-fog", 2, marks=()),  # three times in a ramp
        case("accel_wrapped", "industrial-mems", 2),
        case("longitude for latitude", "tactical-fog", 0),
        case("gyro_counts", "consumer-mems", 0, marks=SLOW),  # 65.5 counts for 1 deg/s: within the range of a clock
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
        case("labels_shifted", "navigation-rlg", 0.037, marks=()),  # a line in the spectrum of the windows
        case("labels_shifted", "consumer-mems", 0.016),  # 4 sigma of one parameter
        case("windows reach into the rotations", "tactical-fog", 0.037, marks=SLOW),  # refused by the angle in a window
        case("windows reach into the rotations", "industrial-mems", 0.14),  # noise
        case("labels of a fast clock", "tactical-fog", 0.000625),  # a high-pass filter
        case("gyro_axis_delayed", "industrial-mems", 40.0, marks=()),  # a noisy window
        case("gyros low-passed", "industrial-mems", 60.0),  # an oscillating fixture
        case("samples_duplicated", "navigation-rlg", 24.0, marks=SLOW),  # spikes, or lost samples
        case("last value held at a lost sample", "navigation-rlg", 30.0),
        case("clock set by GPS", "industrial-mems", 30.0, marks=()),  # labels in the gap
        case("gap bridged by a line", "industrial-mems", 0.6),  # shifted labels
        case("dead band of accelerometers", "consumer-mems", 16000.0, marks=SLOW),  # a noisy window
        case("bit of a converter stuck", "navigation-rlg", 10.0, marks=()),  # vibration
        case("unsigned words", "navigation-rlg", 1.0),  # one polarity
    ],
)
def test_named_first_at_a_severity(kind, grade, severity):
    assert first_cause(kind, grade, 1, severity) in INJECTED[kind].causes


RLG, FOG, INDUSTRIAL, CONSUMER = GRADES
OF_FOREIGN_UNITS = [
    *(
        (kind, grade, grade in (RLG, INDUSTRIAL))
        for kind in ("gravity removed", "gyros high-passed", "gyro_one_polarity")
        for grade in GRADES[: 3 if kind == "gyro_one_polarity" else 4]
    ),
    *(
        (kind, grade, grade in (FOG, CONSUMER))
        for kind in ("wire of an axis broken", "accel_one_polarity", "dead band of gyros, subtracted")
        for grade in GRADES
    ),
    ("wire of an axis broken, noisy", RLG, True),
    ("wire of an axis broken, noisy", INDUSTRIAL, True),
    ("saturated, with noise", FOG, False),
    ("saturated, with noise", CONSUMER, False),
]
"""Kind, grade, and truth of a unit turned by hand; every second grade has no labels."""


@pytest.mark.parametrize(
    ("kind", "grade", "by_hand"),
    [
        pytest.param(*row, marks=((), pytest.mark.slow, (), pytest.mark.campaign)[n % 4])
        for n, row in enumerate(OF_FOREIGN_UNITS)
    ],
)
def test_a_fault_of_foreign_units_is_first(kind, grade, by_hand):
    number = GRADES.index(grade)
    case, _ = foreign_unit(grade, SEED, np.random.default_rng((SEED, number)), by_hand=by_hand)
    unit = INJECTED[kind].recording(case)
    found = diagnose(unit.with_sequences(()) if number % 2 else unit)
    assert found.first.fault in causes_of(kind)


def test_parts_of_rotations_that_jitter_overlap():
    case, _ = foreign_unit(CONSUMER, SEED, np.random.default_rng((SEED, 5)), by_hand=True)
    found = srt.calibrate(INJECTED["stamp_jitter"].recording(case).with_sequences(()))
    assert found.diagnostics.faults[0].fault == "stamp_jitter"


@pytest.mark.parametrize("kind", ["sensors askew in their housing", "gyro scale drifts"])
def test_mixed_pulses_are_no_dead_band(kind):
    unit = injected(kind, "navigation-rlg", 1)
    assert "gyro_dead_band" not in {f.fault for f in diagnose(unit, calibrating=False).findings}


@pytest.mark.campaign
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


LOW_PASSED_S = 0.05


def clipped(unit, rests, _rng):
    """Two turns exceed the range of the gyros: it is 0.8 of the second largest rate of any turn."""
    turns = [unit.gyro[unit.window_indices(a[1], b[0])] for a, b in pairwise(rests)]
    limit = 0.8 * np.sort([np.abs(turn).max() for turn in turns])[-2]
    return replace(unit, gyro=np.clip(unit.gyro, -limit, limit))


@pytest.mark.parametrize("axes", [[1], [0, 1, 2]], ids=["y", "all"])
@pytest.mark.parametrize("profile", ["raised-cosine", pytest.param("trapezoid", marks=pytest.mark.slow), "hand"])
def test_a_limit_below_the_noise_is_saturation(profile, axes):
    """Rates that stop at 0.8 of the second largest of a turn; gravity turns on, and 0.2 °/s of noise lie on top."""
    rng, grade = np.random.default_rng((SEED, 59)), FOREIGN_GRADES["industrial"]
    turned = hand_turns(rng, shortest_s=1.5, count=18)
    unit = recording(turned, 5.0, drawn_errors(grade, rng), grade, rng, profile=profile)
    turns = [np.abs(unit.gyro[unit.window_indices(a[1], b[0])]).max(axis=0) for a, b in pairwise(windows(turned, 5.0))]
    most = 0.8 * np.sort(turns, axis=0)[-2][axes].min()
    gyro = unit.gyro.copy()
    gyro[:, axes] = np.clip(gyro[:, axes], -most, most)
    gyro += rng.normal(0.0, np.deg2rad(0.2), gyro.shape)
    for given, named in ((unit, None), (replace(unit, gyro=gyro), "gyro_clipped")):
        found = diagnose(given, calibrating=False)
        assert (found.first and found.first.fault) == named
    assert found.first.effect == "exit 1"  # no turn can be left out


@pytest.mark.parametrize("seed", [2, 12, 16, 42, 50])
def test_the_fastest_turn_of_a_coarse_unit_is_no_saturation(seed):
    """At constant rates, the largest readings are those of one turn, whose ratio to gravity has errors of its own."""
    rng, grade = np.random.default_rng((78, seed)), FOREIGN_GRADES["consumer"]
    turned = hand_turns(rng, shortest_s=1.5, count=15, rest_s=5.0)
    unit = recording(turned, 5.0, drawn_errors(grade, rng), grade, rng, profile="constant-rate", hz=50.0)
    assert diagnose(unit, calibrating=False).findings == ()


@pytest.mark.parametrize(("profile", "seed"), [("raised-cosine", 1), ("raised-cosine", 4), ("hand", 1)])
def test_accelerometers_cut_at_zero_show_no_filter_of_the_gyros(profile, seed):
    """They read zero in rotations, too, as if the unit were at rest, while the rates fall."""
    rng, grade = np.random.default_rng((59, seed)), FOREIGN_GRADES["consumer"]
    turned = hand_turns(rng, count=12, shortest_s=1.0, longest_s=3.0, rest_s=1.5)
    unit = recording(turned, 3.0, drawn_errors(grade, rng), grade, rng, profile=profile, hz=50.0)
    found = diagnose(replace(unit, accel=np.maximum(unit.accel, 0.0)), calibrating=False)
    assert "gyro_high_passed" not in {finding.fault for finding in found.findings}


@pytest.mark.parametrize("time_s", [60.0, 120.0])
def test_a_warm_up_of_the_gyros_is_no_filter(time_s):
    """Each rest shows the decay of a filter; but the rates continue from rest to rest, whatever rotates."""
    rng, grade = np.random.default_rng((78, 3)), FOREIGN_GRADES["industrial"]
    turned = hand_turns(rng, shortest_s=1.5, count=15, rest_s=5.0)
    unit = recording(turned, 5.0, drawn_errors(grade, rng), grade, rng, profile="constant-rate", hz=50.0)
    bias = np.outer(0.05 * np.exp(-unit.time / time_s), [1.0, 0.5, -0.3])
    found = diagnose(replace(unit, gyro=unit.gyro + bias), calibrating=False)
    assert [finding.fault for finding in found.findings] == ["gyro_bias_drift"]


def test_readings_of_gravity_that_drift_are_not_without_gravity():
    """A unit at rest, whose stamps are read in a wrong unit: a warm-up of 6 % takes four seconds."""
    rng = np.random.default_rng(SEED)
    time = np.arange(1, 8401) * 5e-4
    accel = np.outer(1.03 - 0.015 * time, [0.1, -0.1, -9.5]) + rng.normal(0.0, 1e-2, (len(time), 3))
    unit = srt.Recording(time, rng.normal(0.0, 1e-3, accel.shape), accel, srt.Site(9.81))
    assert diagnose(unit, calibrating=False).findings == ()


def shaken(unit, rests, rng):
    """A shake of all axes between two rests, at the rails of 16 bits."""
    at = int(np.searchsorted(unit.time, 0.5 * sum(rests[len(rests) // 2])))
    t, read = np.arange(130)[:, None] / 100.0, {}
    for sensor, size, largest in (("gyro", 60.0, np.deg2rad(2000.0)), ("accel", 80.0, 4.0 * 9.80665)):
        x, count = getattr(unit, sensor).copy(), largest / 32767
        waves = np.sin(2.0 * np.pi * 4.0 * t + rng.uniform(0.0, 6.0, 3))
        x[at - 65 : at + 65] += np.sin(np.pi * t / t[-1]) * size * waves
        read[sensor] = np.clip(np.round(x / count), -32767, 32767) * count
    return replace(unit, **read)


def thinned(unit, _rests, _rng):
    """One increment of 4 ms, every 500 ms."""
    rows = np.arange(124, len(unit.time), 125)
    gyro, accel = 0.004 * unit.gyro[rows], 0.004 * unit.accel[rows]
    return replace(unit, time=unit.time[rows], gyro=gyro, accel=accel, kind="increment")


def of_an_autopilot(unit, _rests, rng):
    """Stamps to 4 ms, one sample of 400 lost, and a gap of up to half a second in thirty seconds."""
    keep = rng.random(len(unit.time)) > 1.0 / 400.0
    for at in rng.uniform(unit.time[0], unit.time[-1], round(unit.time[-1] / 30.0)):
        keep[unit.window_indices(at, at + rng.uniform(0.05, 0.5))] = False
    stamps = np.round(unit.time / 0.004) * 0.004
    return replace(unit, time=stamps[keep], gyro=unit.gyro[keep], accel=unit.accel[keep])


def low_passed(unit, _rests, _rng):
    """Outputs filtered by the sensor, first order."""
    share = -np.expm1(-unit.nominal_interval_s / LOW_PASSED_S)
    read = {
        sensor: lfilter([share], [1.0, share - 1.0], x, axis=0, zi=(1.0 - share) * x[:1])[0]
        for sensor, x in (("gyro", unit.gyro), ("accel", unit.accel))
    }
    return replace(unit, **read)


@pytest.mark.parametrize(
    ("change", "named", "hz"),
    [
        (clipped, "gyro_clipped", 100.0),
        (shaken, "gyro_clipped", 100.0),
        (lambda unit, *_: replace(unit, accel=0.5 * unit.accel), "accel_lsb", 100.0),
        (lambda unit, *_: replace(unit, gyro=2.0 * unit.gyro), "gyro_lsb", 100.0),
        (thinned, "increments_thinned", 250.0),
        (of_an_autopilot, "gap_in_sequence", 200.0),
        (low_passed, "", 100.0),
    ],
    ids=["clipped", "shaken", "accelerometer count", "gyro count", "thinned", "autopilot", "low-passed"],
)
def test_a_defect_is_named_or_harmless(change, named, hz):
    """Consumer units turned by hand; all three axes of a shake hold their extremes at once, and show no noise there."""
    rng, grade = np.random.default_rng((20261123, 4)), FOREIGN_GRADES["consumer"]
    errors = drawn_errors(grade, rng)
    turned = hand_turns(rng, shortest_s=1.5, count=9 if change is clipped else 24)
    unit = change(recording(turned, 5.0, errors, grade, rng, hz=hz), windows(turned, 5.0), rng)
    truth = np.array([errors.get(name, 0.0) for name in NAMES])
    found = outcome_of(lambda: unit, (), truth)
    assert not named or found.first == named
    # Of at most 27 normal errors of ten recordings, one in a hundred has one beyond 4.2 sigma.
    assert found.word == "failed" or found.error <= 4.2
