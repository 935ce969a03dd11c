"""Unlabelled recordings labelled by their protocol; motions that contradict it."""

from dataclasses import replace
from functools import cache

import pytest

import sims
import srt
from sims.scenarios.scenario import scenario_from_dict
from srt.exceptions import DataError, InputError
from srt.recording.protocol import load_protocol, protocol_names
from srt.sequences.protocol_matching import protocol_labels

ON_FIXTURE = ("six-face-tumble", "ferraris", "table-1", "two-axis-table")
SETTLE_S = 0.2


@cache
def simulated(name: str, grade: str = "tactical-fog", *, fixture: bool = False) -> sims.Simulation:
    tables = {
        "seed": 3,
        "imu": {"from": grade},
        "site": {"from": "latitude-45"},
        "protocol": {"from": name, "settle_s": SETTLE_S},
        "recording": {"sample_rate_hz": 100.0},
    }
    return sims.simulate(scenario_from_dict(tables | ({"fixture": {"from": "lab-1mrad"}} if fixture else {})))


def unlabelled(name: str, of: str | None = None, **how) -> srt.Recording:
    """Recording of one protocol that states another, or its own."""
    return replace(simulated(name, **how).recording, sequences=(), protocol=load_protocol(of or name))


def content(label):
    return label.pose, label.id, label.down, label.along_outer, len(label.rotations), label.rate


@pytest.mark.parametrize("grade", [pytest.param("tactical-fog", marks=pytest.mark.slow), "consumer-mems"])
@pytest.mark.parametrize(
    ("name", "fixture"), [*((n, False) for n in protocol_names()), *((n, True) for n in ON_FIXTURE)]
)
def test_labels_are_those_of_the_simulator(name, fixture, grade):
    recording = unlabelled(name, grade=grade, fixture=fixture)
    assert recording.protocol is not None
    found, true = protocol_labels(recording, recording.protocol), simulated(name, grade, fixture=fixture).recording
    assert [content(label) for label in found] == [content(label) for label in true.sequences]
    for label, expected in zip(found, true.sequences, strict=True):
        # Rest begins when the settling does; the last moment of a turn may be too slow to see.
        for window in ("start_static_s", "end_static_s"):
            assert getattr(label, window) == pytest.approx(getattr(expected, window), abs=SETTLE_S + 0.3)
        if label.steady_s is not None:
            assert expected.steady_s[0] <= label.steady_s[0] < label.steady_s[1] <= expected.steady_s[1]


@pytest.mark.parametrize("name", ["rate-table", "7-positions"])
def test_a_protocol_without_attitudes_labels_a_recording_that_states_a_fixture(name):
    """The attitudes on the fixture are not known then, and are not used."""
    recording = replace(unlabelled(name, grade="consumer-mems"), fixture=srt.Fixture(0.0))
    assert recording.protocol is not None
    found, true = protocol_labels(recording, recording.protocol), simulated(name, "consumer-mems").recording
    assert [content(label) for label in found] == [content(label) for label in true.sequences]


@pytest.mark.parametrize(
    ("name", "of", "said"),
    [
        ("7-positions", "11-positions", r"step 3 .*from [\d.]+ to [\d.]+ s the gyros turn by|step \d+ .*"),
        ("six-face-tumble", "24-face-tumble", "step 2 .*no rest after"),
        ("9-positions", "two-axis-table", r"step 2 .*turn \+540° about y.*gyros turn by"),
        ("24-face-tumble", "19-positions", "step 2 .*interrupted"),
    ],
)
def test_a_motion_that_contradicts_its_protocol_names_the_step(name, of, said):
    recording = unlabelled(name, of)
    with pytest.raises(DataError, match=f"The motion contradicts {said}") as refused:
        srt.calibrate(recording)
    assert "\n" not in str(refused.value)


def test_a_recording_that_ends_early_names_the_step_that_is_missing():
    whole = unlabelled("19-positions")
    half = whole.time < 0.5 * whole.time[-1]
    recording = replace(whole, time=whole.time[half], gyro=whole.gyro[half], accel=whole.accel[half])
    with pytest.raises(DataError, match=r"step \d+ .*the recording ends after the rest"):
        srt.calibrate(recording)


def test_a_protocol_that_the_fixture_cannot_run_is_refused():
    with pytest.raises(InputError, match=r"Step 1 .*cannot run on a two-axis fixture"):
        simulated("rate-table", fixture=True)


def test_the_folder_keeps_the_protocol_and_the_labels(tmp_path):
    for name in ("rate-table", "six-face-tumble"):
        folder = tmp_path / name
        true = simulated(name).recording
        srt.write_recording(true, folder, samples_format="npz")
        read = srt.load_recording(folder).sequences
        assert [content(label) for label in read] == [content(label) for label in true.sequences]
        for label, written in zip(read, true.sequences, strict=True):
            assert label.start_static_s == pytest.approx(written.start_static_s, rel=1e-12)
            assert label.steady_s == written.steady_s
        srt.write_recording(unlabelled(name), folder, samples_format="npz", overwrite=True)
        again = srt.load_recording(folder)
        assert again.protocol is not None
        assert again.protocol.name == name
        assert not again.sequences
