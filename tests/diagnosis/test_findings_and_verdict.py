"""Findings, their verdict, their document, and the procedure that runs the checks."""

from dataclasses import replace
from pathlib import Path

import accuracy_trials
import numpy as np
import pytest
from foreign_motion import GRADES, drawn_errors, hand_turns, windows
from foreign_motion import recording as by_hand
from injected_faults.injection import Case
from recorded_sets import data_folder
from scipy.signal import butter, lfilter, lfilter_zi
from scipy.spatial.transform import Rotation
from worse_recordings import unstated_unit

import srt
from srt.constants import DEG
from srt.diagnosis.document import document
from srt.diagnosis.evidence import Evidence
from srt.diagnosis.faults import STAGES
from srt.diagnosis.units import scales_of_result
from srt.estimation.options import Options
from srt.exceptions import DataError
from srt.procedure import calibrate
from srt.result.verdict import DOUBTFUL, SOUND

SEED = 20264201
FOLDER = data_folder()


def spike(unit):
    """One gyro reading off by 0.5 rad/s in a window."""
    gyro = unit.gyro.copy()
    gyro[np.searchsorted(unit.time, np.mean(unit.sequences[5].start_static_s)), 0] += 0.5
    return replace(unit, gyro=gyro)


def spike_in_a_rotation(unit):
    gyro = unit.gyro.copy()
    gyro[np.searchsorted(unit.time, unit.sequences[2].start_static_s[1]) + 100, 1] += 0.05
    return replace(unit, gyro=gyro)


def filled(unit, share):
    """40 samples of a rotation that lie on the line, or hold the value, next to the gap."""
    first = int(np.searchsorted(unit.time, unit.sequences[7].start_static_s[1])) + 40
    gyro, accel = unit.gyro.copy(), unit.accel.copy()
    for x in (gyro, accel):
        x[first : first + 40] = x[first - 1] + share[:, None] * (x[first + 40] - x[first - 1])
    return replace(unit, gyro=gyro, accel=accel)


def interpolated(unit):
    return filled(unit, np.arange(1, 41) / 41.0)


def stalled(unit):
    return filled(unit, np.zeros(40))


def bit_6_stuck(unit):
    """Gyro x as words of 25 bits, 1 µrad/s a count."""
    words = np.rint(unit.gyro * 1e6).astype(np.int64) + 2**24
    words[:, 0] |= 1 << 6
    return replace(unit, gyro=(words - 2**24) * 1e-6)


@pytest.mark.parametrize(
    ("fault", "change"),
    [
        ("spikes", spike),
        ("spikes", spike_in_a_rotation),
        ("samples_interpolated", interpolated),
        ("samples_stuck", stalled),
        ("bit_stuck", bit_6_stuck),
    ],
)
def test_wrong_samples_are_never_sound(fault, change):
    unit, _ = unstated_unit(0, "fixture", "tactical")
    found = srt.calibrate(change(unit))
    assert found.diagnostics.faults[0].fault == fault
    assert found.judgement.word != SOUND


def test_right_samples_are_sound():
    unit, _ = unstated_unit(0, "fixture", "tactical")
    assert srt.calibrate(unit).judgement.word == SOUND


def test_interpolated_samples_of_a_sequence_that_is_left_out_are_not_in_the_result():
    unit, _ = unstated_unit(0, "fixture", "tactical")
    found = srt.calibrate(interpolated(unit), without_turns=(unit.sequences[7].id,))
    assert "samples_interpolated" not in {fault.fault for fault in found.diagnostics.faults}


def test_a_turn_is_left_out_by_its_number():
    unit, _ = unstated_unit(0, "fixture", "tactical")
    number = unit.sequences[7].id
    left = srt.calibrate(unit, "least-squares", checks=False, without_turns=(int(number),))
    assert number not in {row.sequence for row in left.consistency.sequences}


def test_repeated_samples_are_the_cause_of_shifted_labels():
    """60 samples written twice, each with a stamp of its own: the labels lag by up to 1.2 s."""
    unit, _ = unstated_unit(0, "fixture", "tactical")
    n = len(unit.time)
    rows = np.sort(np.append(np.arange(n), np.random.default_rng(SEED).choice(n, 60, replace=False)))
    time = unit.time[0] + unit.nominal_interval_s * np.arange(len(rows))
    with pytest.raises(DataError, match="The labels are late by") as refused:
        srt.calibrate(replace(unit, time=time, gyro=unit.gyro[rows], accel=unit.accel[rows]))
    assert refused.value.fault == "samples_duplicated"


@pytest.mark.parametrize("places", [1, 30])
def test_lost_samples_are_the_cause_of_shifted_labels(places):
    """60 samples of rotations lost without a gap in the stamps: the labels lag by up to 1.2 s."""
    unit, _ = unstated_unit(0, "fixture", "tactical")
    turning = np.flatnonzero(np.linalg.norm(unit.gyro, axis=1) > 0.5)
    first = turning[(np.arange(places) + 1) * len(turning) // (places + 2)]
    # The recording goes on at rest, so that the last label stays within it.
    rows = np.delete(np.arange(len(unit.time)), first[:, None] + np.arange(60 // places))
    rows = np.append(rows, np.arange(len(unit.time) - 2, len(unit.time) - 62, -1))
    with pytest.raises(DataError, match="the labels after them are late") as refused:
        srt.calibrate(replace(unit, gyro=unit.gyro[rows], accel=unit.accel[rows]))
    assert refused.value.fault == "samples_lost"


@pytest.mark.parametrize("grade", ["navigation", "tactical"])
def test_a_low_pass_filter_does_not_shift_labels(grade):
    """At 0.8 Hz, rotations reach into the windows after them, and the noise is correlated as long."""
    unit, _ = unstated_unit(0, "fixture", grade)
    b, a = butter(1, 0.8, fs=1.0 / unit.nominal_interval_s)
    readings = np.hstack([unit.gyro, unit.accel])
    readings = lfilter(b, a, readings, axis=0, zi=lfilter_zi(b, a)[:, None] * readings[:1])[0]
    filtered = replace(unit, gyro=readings[:, :3], accel=readings[:, 3:])
    assert srt.diagnose(filtered, calibrating=False).first.fault == "unsettled"


def turned_by_hand(seed):
    """A consumer unit in 15 turns by hand: the rotation of gravity shows gyro scales to some percent."""
    rng = np.random.default_rng((SEED, 8, seed))
    errors = drawn_errors(GRADES["consumer"], rng)
    return by_hand(hand_turns(rng, count=15, rest_s=2.0), 5.0, errors, GRADES["consumer"], rng, profile="hand")


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
@pytest.mark.parametrize("labelled", [False, True])
def test_an_axis_without_input_for_half_the_test_is_named(sensor, noisy, labelled):
    """Gravity rotates about it, or onto it, and its readings do not change."""
    unit, _ = unstated_unit(0, "fixture", "consumer")
    readings = getattr(unit, sensor).copy()
    half = len(readings) // 2
    readings[half:, 1] = 0.0
    if noisy:
        readings[half:, 1] += np.random.default_rng((SEED, 3)).normal(0.0, 1e-3, len(readings) - half)
    unit = replace(unit, **{sensor: readings})
    measured = {"gyro": "in each of [0-9]+ rotations from", "accel": "in the mean of every window from"}
    with pytest.raises(DataError, match=measured[sensor] if noisy else "in all [0-9]+ samples from") as refused:
        srt.calibrate(unit if labelled else unit.with_sequences(()))
    assert refused.value.fault == f"{sensor}_channel_dead"


def test_a_gyro_of_one_polarity_is_named_without_labels():
    unit, _ = unstated_unit(0, "fixture", "industrial")
    gyro = unit.gyro.copy()
    gyro[:, 1] = np.maximum(gyro[:, 1], 0.0)
    with pytest.raises(DataError, match="no negative reading") as refused:
        srt.calibrate(replace(unit, gyro=gyro).with_sequences(()))
    assert refused.value.fault == "gyro_one_polarity"


def test_a_spike_of_a_gyro_in_a_turn_by_hand_is_named():
    unit = turned_by_hand(1)
    turning = np.flatnonzero(np.linalg.norm(unit.gyro, axis=1) > 0.5)
    at = turning[len(turning) // 2]
    gyro = unit.gyro.copy()
    gyro[at, 0] += 3.0
    found = srt.calibrate(replace(unit, gyro=gyro))
    assert found.diagnostics.faults[0].fault == "spikes"
    assert found.judgement.word != SOUND
    assert srt.inspect(replace(unit, gyro=gyro)).diagnosis.first.fault == "spikes"
    compared = srt.compare(replace(unit, gyro=gyro), ("least-squares", "graph"))
    for result in compared.calibrations.values():
        assert result.diagnostics.faults[0] == found.diagnostics.faults[0]
        assert result.judgement.word != SOUND
    # A knock there and back leaves the attitude as it is.
    gyro[at + 1, 0] -= 3.0
    assert "spikes" not in {fault.fault for fault in srt.calibrate(replace(unit, gyro=gyro)).diagnostics.faults}


@pytest.mark.skipif(FOLDER is None, reason="the recorded sets are not at hand")
@pytest.mark.parametrize("degrees", [-1.0, 1.0])
def test_a_spike_in_a_turn_of_a_recording_with_large_residuals_is_named(degrees):
    """The residuals of this unit are ten times its noise at rest, and single readings change what is modelled."""
    table = np.loadtxt(FOLDER / "mpu9150" / "imu2.log")
    unit = srt.Recording(0.01 * np.arange(len(table)), table[:, 3:6], table[:, :3], srt.Site(9.81))
    assert Evidence(unit).spikes.sample.size == 0
    for sample, axis in ((5544, 0), (9845, 2), (13437, 2)):
        gyro = unit.gyro.copy()
        gyro[sample, axis] += degrees * DEG * 100.0
        found = Evidence(replace(unit, gyro=gyro)).spikes
        assert (found.sample.tolist(), found.channel.tolist()) == ([sample], [axis])


def test_accelerometer_readings_in_turns_by_hand_are_not_accused():
    """They enter no result: the unit may have been hit."""
    unit = turned_by_hand(1)
    turning = np.flatnonzero(np.linalg.norm(unit.gyro, axis=1) > 0.5)
    accel = unit.accel.copy()
    accel[turning[10::20], 1] += 10.0
    found, clean = srt.calibrate(replace(unit, accel=accel)), srt.calibrate(unit)
    assert found.judgement.word == clean.judgement.word
    assert {fault.fault for fault in found.diagnostics.faults} == {fault.fault for fault in clean.diagnostics.faults}
    np.testing.assert_array_equal(found.errors.vector, clean.errors.vector)


@pytest.mark.parametrize("labelled", [False, True])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_knock_as_the_hand_takes_the_unit_is_no_spike(axis, labelled):
    """One reading along one axis, before the unit rotates at 0.05 rad/s: it is in no window."""
    turns = hand_turns(np.random.default_rng((SEED, 9)), shortest_s=2.0, count=15, rest_s=3.0)
    rng, grade = np.random.default_rng((SEED, 10)), GRADES["tactical"]
    unit = by_hand(turns, 5.0, drawn_errors(grade, rng), grade, rng, labelled=labelled)
    begin = np.searchsorted(unit.time, 1e-6 + windows(turns, 5.0)[4][1])
    assert np.abs(unit.gyro[begin : begin + 2]).max() < 0.05
    accel = unit.accel.copy()
    accel[begin + 1, axis] += 8.0
    found, clean = srt.calibrate(replace(unit, accel=accel)), srt.calibrate(unit)
    assert found.diagnostics.faults == clean.diagnostics.faults == ()
    assert found.judgement.word == SOUND


@pytest.mark.parametrize(("size", "word"), [(13.0, SOUND), (100.0, DOUBTFUL)])
def test_a_spike_at_rest_is_in_doubt_if_the_result_shifts(size, word):
    """13 sigma of a reading are 0.41 sigma of the mean of 1000: no sensor error shifts by more."""
    unit = Case("tactical-fog", SEED).recording
    window = unit.window_indices(*unit.sequences[4].start_static_s)
    accel, middle = unit.accel.copy(), (window.start + window.stop) // 2
    accel[middle, 1] += size * np.std(np.diff(accel[window, 1])) / np.sqrt(2.0)
    clean, found = srt.calibrate(unit), srt.calibrate(replace(unit, accel=accel))
    (spikes,) = (fault for fault in found.diagnostics.faults if fault.fault == "spikes")
    assert "a knock" in spikes.sentence
    assert spikes.sentence in found.warnings
    assert (clean.judgement.word, found.judgement.word) == (SOUND, word)
    shift = np.max(np.abs(found.errors.vector - clean.errors.vector) / clean.sigma)
    # The reading less its prediction has the noise of both, 1.4 sigma.
    limits = (size + np.array([-5.0, 5.0])) / np.sqrt(window.stop - window.start)
    assert limits[0] < spikes.details["largest_shift_sigma"] < limits[1]
    assert shift < spikes.details["largest_shift_sigma"]


@pytest.mark.skipif(FOLDER is None, reason="the recorded sets are not at hand")
@pytest.mark.parametrize("repeat", [1, 2, 4, 6])
def test_a_unit_set_down_by_hand_has_no_spikes(repeat):
    """Eight units on one board, each with jumps that at least six of them show, and no others."""
    with np.load(FOLDER / "array" / f"exp_{repeat}.npz") as board:
        time, gyro, accel = board["time_s"], board["gyro_counts"] * DEG / 16.4, board["accel_counts"] / 2048.0 * 9.81
    for unit in range(8):
        recording = srt.Recording(time, gyro[:, unit], accel[:, unit], srt.Site(9.818))
        assert Evidence(recording).spikes.sample.size == 0


@pytest.mark.slow
def test_half_a_count_value_is_refused_by_the_result():
    unit = turned_by_hand(0)
    half = replace(unit, gyro=0.5 * unit.gyro)
    evidence = Evidence(half)
    evidence.gravity_relation = None  # as if accelerations hid the rotation of gravity
    assert [finding.fault for finding in scales_of_result(evidence)] == ["gyro_lsb"]
    with pytest.raises(DataError, match=r"near a factor of 0\.5") as refused:
        srt.calibrate(half)
    assert refused.value.fault == "gyro_lsb"
    assert srt.calibrate(half, checks=False).status == "converged"
    assert srt.calibrate(half, force=True).judgement.word != SOUND


@pytest.mark.parametrize(("sensor", "factor"), [("gyro", 1.01), ("accel", 1.05)])
def test_equal_scale_errors_are_not_sound(sensor, factor):
    """Errors of 0.01 %, one sigma, do not make three axes 1 % off alike."""
    unit, _ = unstated_unit(0, "fixture", "navigation")
    found = srt.calibrate(replace(unit, **{sensor: factor * getattr(unit, sensor)}))
    assert found.diagnostics.faults[0].fault == f"{sensor}_factor"
    assert found.judgement.word != SOUND


@pytest.mark.slow
def test_time_stamps_of_a_file_are_no_sample_rate():
    """A factor of 1.3 on the gyros: with stamps, no sample rate is proposed; a stated one is."""
    unit, _ = unstated_unit(0, "fixture", "consumer")
    off = replace(unit, gyro=1.3 * unit.gyro)
    for stated, proposed in ((None, False), (50.0, True)):
        first = srt.calibrate(replace(off, sample_rate_hz=stated)).diagnostics.faults[0]
        assert first.fault == "sample_rate"
        assert ("Hz" in first.sentence) == proposed


def in_cm_s2(unit):
    return replace(unit, accel=100.0 * unit.accel)


def gyro_increments(unit):
    return replace(unit, gyro=unit.nominal_interval_s * unit.gyro)


def accel_increments(unit):
    return replace(unit, accel=unit.nominal_interval_s * unit.accel)


def without_gravity(unit):
    """Bias, misalignment and noise of the same unit remain of the force that turns with the gyros."""
    rest = unit.gyro[: np.searchsorted(unit.time, unit.sequences[0].start_static_s[1])].mean(axis=0)
    path, length = Rotation.from_rotvec((unit.gyro - rest) * unit.nominal_interval_s), 1
    while length < len(unit.time):  # products of the steps before, of twice the length each time
        path, length = Rotation.concatenate([path[:length], path[:-length] * path[length:]]), 2 * length
    up = unit.accel[:400].mean(axis=0)
    return replace(unit, accel=unit.accel - path.inv().apply(up))


@pytest.mark.parametrize("grade", ["tactical", "consumer"])
@pytest.mark.parametrize(
    ("fault", "change"),
    [
        ("accel_other_unit", in_cm_s2),
        ("gyro_kind", gyro_increments),
        ("accel_kind", accel_increments),
        ("gravity_absent", without_gravity),
    ],
)
def test_readings_in_another_unit_or_without_gravity_are_named(fault, change, grade):
    unit, _ = unstated_unit(0, "fixture", grade)
    with pytest.raises(DataError) as refused:
        srt.calibrate(change(unit))
    assert refused.value.fault == fault


def test_units_near_each_other_are_told_apart():
    """mg and cm/s², both declared as m/s², differ by 2 %, degrees and the interval of 50 Hz by 15 %."""
    unit, _ = unstated_unit(0, "fixture", "tactical")
    for changed, fault in (
        (replace(unit, accel=unit.accel / 9.80665e-3), "accel_mg"),
        (replace(unit, gyro=np.radians(unit.gyro)), "gyro_radians"),
    ):
        assert srt.inspect(changed).diagnosis.refusal.fault == fault


@pytest.fixture(scope="module")
def recording():
    return Case("tactical-fog", 900).recording


def test_a_sound_recording_gains_nothing(recording):
    examined = calibrate(recording, options=Options())
    plain = srt.calibrate(recording)
    np.testing.assert_array_equal(examined.errors.vector, plain.errors.vector)
    assert examined.diagnostics.faults == ()
    assert examined.warnings == plain.warnings


def test_a_fault_that_makes_it_senseless_refuses_it_by_name(recording):
    wrong = replace(recording, gyro=recording.gyro / DEG)
    with pytest.raises(srt.DataError, match="correct gyro_unit") as caught:
        calibrate(wrong, options=Options())
    assert caught.value.fault == "gyro_degrees"


def test_force_goes_on_to_what_the_calibration_itself_says(recording):
    wrong = replace(recording, gyro=recording.gyro / DEG)
    with pytest.raises(srt.DataError, match=r"The likely cause: .* correct gyro_unit"):
        calibrate(wrong, options=Options(), force=True)


def test_a_fault_that_is_told_stands_with_the_result(recording):
    wrong = replace(recording, site=replace(recording.site, gravity_m_s2=9.78))
    examined = calibrate(wrong, options=Options())
    (finding,) = [f for f in examined.diagnostics.faults if f.fault == "gravity"]
    assert finding.effect == "warning"
    assert finding.sentence in examined.warnings


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares"])
def test_missing_sequences_are_no_warning_of_a_result(estimator):
    """The recorded moves carry what the closed form cannot estimate; it fixes that, and names the sequence itself."""
    whole, _ = accuracy_trials.fixture_recording(21, "tactical", moves="recorded", sample_rate_hz=50.0)
    recording = replace(whole, sequences=tuple(s for s in whole.sequences if s.id not in ("6", "9")))
    result = srt.calibrate(recording, estimator)
    assert not any("cannot" in warning for warning in result.warnings)
    assert any("sequence 6 is missing" in reason for reason in result.fixed.values()) == (estimator == "closed-form")
    (found,) = [f for f in srt.inspect(recording).diagnosis.findings if f.fault == "sequence_missing"]
    assert "the closed form cannot estimate gyro_orthogonality_xy" in found.sentence
    assert "--estimator least-squares" in found.sentence


def test_faults_that_only_a_calibration_shows_are_searched_for(recording):
    truth = srt.SensorErrors.from_dict({"gyro_asymmetry_x": 2e-3})
    from accuracy_trials import GRADES

    from sims.physics.imu import read_out

    case = Case("tactical-fog", 901)
    asymmetric = read_out(case.simulation.motion, truth, GRADES["tactical"], np.random.default_rng(1))
    examined = calibrate(asymmetric, options=Options(asymmetry=False))
    assert "asymmetry_omitted" in [f.fault for f in examined.diagnostics.faults]


def test_findings_survive_the_file(recording, tmp_path):
    wrong = replace(recording, site=replace(recording.site, gravity_m_s2=9.78))
    calibrate(wrong, options=Options()).save(tmp_path / "unit.json")
    loaded = srt.load_calibration(tmp_path / "unit.json")
    assert [f.fault for f in loaded.diagnostics.faults] == ["gravity"]


@pytest.mark.parametrize("gravity_sigma", [5e-6, 0.02])
def test_gravity_that_does_not_fit_the_latitude_is_doubtful(gravity_sigma):
    """0.025 m/s² more than at any height of 45°: thousands of sigma, which a stated sigma of 0.02 m/s² covers."""
    recording = Case("navigation-rlg", 5).recording
    off = replace(recording.site, gravity_m_s2=recording.site.gravity_m_s2 + 0.025, gravity_sigma_m_s2=gravity_sigma)
    found = srt.calibrate(replace(recording, site=off))
    told = [sentence for sentence in found.warnings if sentence.startswith("Gravity is stated as")]
    doubtful = gravity_sigma < 0.01
    assert found.judgement.word == ("doubtful" if doubtful else "sound")
    assert bool(told) == doubtful
    assert all(sentence in found.judgement.reason for sentence in told)


PAGE = Path(__file__).parents[2] / "docs" / "faults.md"


def test_the_committed_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == document(), "run python -m srt.diagnosis.document"


def test_every_fault_stands_once_under_its_stage():
    *sections, last = document().split("\n## ")[1:]
    assert last.startswith("What no check sees\n")
    assert [section.splitlines()[0] for section in sections] == [stage.title for stage in STAGES.values()]
    for stage, section in zip(STAGES.values(), sections, strict=True):
        rows = [line.split(" | ") for line in section.splitlines() if line.startswith("| ")][1:]
        assert [row[1].strip("`") for row in rows] == [f.name for f in stage.faults]
        assert all(len(row) == 5 for row in rows)
