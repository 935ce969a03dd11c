"""A turn is accused only if the others agree without it."""

from dataclasses import replace

import pytest
from unmodelled_effects import drawn

import srt

SEED = 20261205
LOST_S = 0.05


def without_some_rates(recording, turns):
    """Gyros that read nothing for a twentieth of a second in the first half of turns."""
    gyro = recording.gyro.copy()
    for k in turns:
        (_, begin), (end, _) = recording.sequences[k].start_static_s, recording.sequences[k].end_static_s
        at = begin + 0.4 * (end - begin)
        gyro[(recording.time > at) & (recording.time < at + LOST_S)] = 0.0
    return replace(recording, gyro=gyro)


@pytest.mark.parametrize(("place", "number"), [("hand", 1), ("hand", 2), ("fixture", 0)])
def test_the_turn_that_lost_samples_is_accused(place, number):
    """A neighbour about the same axis is predicted worse than the first: only fits without either tell them apart."""
    recording = drawn("none", place, number, SEED)[0]
    found = srt.calibrate(without_some_rates(recording, [6]), estimator="least-squares", force=True)
    assert found.judgement.word == "failed"
    assert found.consistency.contradicting.title == (recording.sequences[6].id or "turn 7")
    assert f"--without-turn {recording.sequences[6].id or 7}" in found.message


@pytest.mark.parametrize(("place", "number"), [("hand", 1), ("fixture", 0)])
def test_of_two_wrong_turns_none_is_accused_alone(place, number):
    recording = without_some_rates(drawn("none", place, number, SEED)[0], [6, 12])
    found = srt.calibrate(recording, estimator="least-squares", force=True)
    assert found.judgement.word in ("doubtful", "failed")
    assert found.consistency.contradicting is None
