"""Sound recordings raise nothing: filtered, corrected and coarse ones that once did, and many draws of one channel."""

from dataclasses import replace

import numpy as np
import pytest
from clean_recordings import drawn
from clean_recordings import main as clean_study
from faults import clean_recording
from foreign_motion import GRADES, Turn, drawn_errors, recording, windows
from scipy.ndimage import uniform_filter1d
from scipy.special import chdtri

import srt
from srt.diagnosis.staged_diagnosis import diagnose
from srt.result.verdict import SOUND
from srt.sequences.clipping import _limits_seen, _Triad

SEED = 20261124
SLOW = pytest.mark.slow
LEAST = 0.2


def case(seed, number, *, marks=pytest.mark.campaign):
    return pytest.param(seed, number, marks=marks)


@pytest.mark.parametrize(
    ("seed", "number"),
    [
        case(20261201, 34, marks=()),  # bump: blocks of two filtered samples are correlated
        case(2026, 638),  # bump: corrected pulses, whose smallest step is the crosstalk of another axis
        case(2026, 891),
        case(20261201, 102, marks=SLOW),  # labels shifted: poses without a rotation, and the noise of pulses
        case(20261201, 132),  # short window: a core chosen for its small scatter, and filtered readings
        case(20261201, 136, marks=()),
        case(2026, 40, marks=SLOW),  # noise: corrected pulses without a single pulse in the windows
        case(2026, 341),  # wrong angle: one rotation, and a gyro scale factor of 1 %
        case(2026, 299),  # noise of a window: the filter moves the rotation into it
        case(2026, 948),
        case(20261201, 397),
        case(20261203, 385),  # short window: few means that scatter little by chance
        case(20261301, 157, marks=()),  # labels shifted: noise of filtered poses
        case(20261301, 324),  # count value: rest not found, as corrected pulses have a quieter tenth
        case(20261301, 456),  # axis stuck: a steady rate of a whole number of pulses
        case(20261301, 619, marks=SLOW),
        case(20261301, 945),  # bump: correlated blocks, whose scatter the median under-states
        case(20261303, 950),  # spikes: corrected pulses
        case(20261303, 1676, marks=()),  # wrapped: single pulses at rest
        case(20261302, 555, marks=SLOW),  # creep: residuals that a robust fit passes through
        case(20262700, 1295, marks=()),  # oscillation: power of filtered readings, which are correlated
        case(20262900, 2430),  # noise of gyros: windows of two sequences that free rotations match by chance
        case(20262910, 106, marks=SLOW),  # axis stuck: no pulse in a whole window
        case(20262920, 818),  # axis stuck: a rotation at a whole number of pulses for each sample
        case(20262920, 1735, marks=()),  # axis stuck: filtered pulses until the rotation slows down
        case(20262800, 1879),  # creep: a window of 5 s among those of 30 and 90 s
        case(7, 72, marks=SLOW),  # short window: rests of a protocol in which sequences are recognised by chance
        case(7, 19),
        case(20261126, 916, marks=()),  # dead accelerometer: a turn about its axis, with biases of 0.1 g
        case(20261126, 15, marks=SLOW),  # dead gyro: ten turns of a rate table with scale errors
        case(20262301, 823, marks=()),  # a bit stuck: poses alone, in few places of the range
        case(20261150, 925, marks=SLOW),  # a high-pass filter: steady runs that begin in a rotation about the vertical
    ],
)
def test_recordings_that_raised_a_finding(seed, number):
    assert clean_recording(number, seed)[1] == []


@pytest.mark.parametrize(
    ("seed", "number"),
    [
        (1, 5),  # six faces one by one: the rates at rest follow gravity from pose to pose, not within one
        (20261148, 7),  # a rate table: rotations about the vertical
        (20261148, 22),
    ],
)
def test_g_sensitive_gyros_in_single_poses_are_sound(seed, number):
    assert clean_recording(number, seed)[1:] == ([], "sound")


@pytest.mark.parametrize(
    ("clean", "handled"),
    [pytest.param(3, 1, marks=pytest.mark.slow), pytest.param(25, 10, marks=pytest.mark.campaign)],
)
def test_clean_and_handled_recordings_are_not_accused(clean, handled, tmp_path, capsys):
    """A twentieth of ``benchmarks/clean_recordings.py``, or less."""
    code = clean_study(clean=clean, handled=handled, first=8, seed=SEED, results=tmp_path / "results.jsonl")
    assert code == 0, capsys.readouterr().out


@pytest.mark.parametrize("number", [104, 184])
def test_a_tremor_of_12_hz_is_integrated_at_50_hz(number):
    """A good gyro in a shaking hand: tremor of 3 to 12 Hz in turns, whose rotations no turn contradicts."""
    tremor = drawn(number, 20261130, handled=True)
    found = srt.calibrate(tremor.recording)
    assert found.judgement.word == SOUND
    error = found.errors.vector - tremor.truth
    assert found.observed.all()
    assert error @ np.linalg.solve(found.covariance, error) < chdtri(len(error), 1e-4)


def test_a_turn_that_fades_behind_a_filter_is_no_oscillation_and_no_noise():
    """At 25 Hz a low pass of the unit carries 1 % of the last rate of a turn into the window 0.1 s after it."""
    (found,) = diagnose(drawn(50, 20261207, handled=False).recording, calibrating=False).findings
    assert found.fault == "unsettled"
    assert "rates of the turn still fade" in found.sentence
    assert diagnose(drawn(378, 20261207, handled=False).recording, calibrating=False).findings == ()


def test_knocks_in_turns_are_no_dead_gyro():
    """Two knocks of 55 m/s² over 3 samples, in turns about other axes: gravity seems to turn by 95° and back."""
    rng = np.random.default_rng((SEED, 5))
    grade = GRADES["tactical"]
    turns = [Turn(tuple(axis), sign * np.pi, 3.0, 4.0) for sign in (1.0, -1.0, 1.0) for axis in np.eye(3)]
    unit = recording(turns, 5.0, drawn_errors(grade, rng), grade, rng)
    accel = unit.accel.copy()
    for _, begin in windows(turns, 5.0)[4:6]:
        blocks = np.arange(int(100 * begin) + 20, int(100 * begin) + 280, 10)
        at = blocks[np.argmin(np.abs(accel[blocks, 0]))] + 3
        up = accel[at] / np.linalg.norm(accel[at])
        accel[at : at + 3] += 47.0 * np.cross(up, np.eye(3)[0]) - 27.0 * up
    found = diagnose(replace(unit, accel=accel), calibrating=False).findings
    assert [finding.sentence for finding in found] == []


@pytest.mark.parametrize("width", [1, 3])
def test_extremes_of_filtered_quantized_noise_are_no_limit(width):
    rng = np.random.default_rng((SEED, width))
    for _ in range(60):
        noise = rng.normal(1.0, 0.01, (20_000, 3))
        readings = uniform_filter1d(np.round(noise / 0.0065) * 0.0065, width, axis=0)
        low, high = _limits_seen(_Triad.of(readings), LEAST)
        assert np.isinf(low).all()
        assert np.isinf(high).all()


def test_full_scale_by_chance_is_no_limit():
    """Noise whose largest readings are one count below a power of two; a shake that reaches it is clipped."""
    rng = np.random.default_rng((SEED, 9))
    counts = np.round(rng.normal(2000.0, 12.0, (20_000, 3)))
    counts += 2047 - counts.max(axis=0)
    counts[[7000, 9000], 0] = 2047
    assert np.isinf(_limits_seen(_Triad.of(counts), 100.0)[1]).all()
    shaken = counts - 500
    shaken[[7000, 9000], 0] = 2047
    np.testing.assert_array_equal(_limits_seen(_Triad.of(shaken), 100.0)[1], [2047.0, np.inf, np.inf])


@pytest.mark.slow  # 200 Hz
def test_knocks_of_opposite_signs_are_no_word_that_wraps():
    """A knock deviates from the slopes beside it by 1.5 times its size, which is the range of two knocks here."""
    assert diagnose(drawn(50, 20261129, handled=True).recording, calibrating=False).refusal is None
