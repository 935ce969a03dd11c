"""Recordings without a fault, of all grades, protocols, profiles and forms of processing, for ``faults.py clean``.

Each is drawn from its number: grade of the unit, kind of test (17 sequences on the fixture, a shipped protocol on a
fixture or without one, or turns by hand in one of the profiles), sample rate, labels, and what was done to the
readings: nothing, our own correction (``srt apply``), a moving average, or rounding of 1e-12 that takes them off their
grid. By design all checks together raise a finding in at most 1e-4 of the recordings.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from protocols import PROTOCOLS
from scipy.ndimage import uniform_filter1d

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # injected_faults

from injected_faults.injection import GRADES

import srt
from sims.physics.turn_profiles import ProfileName
from sims.scenarios.scenario import scenario_from_dict
from sims.scenarios.simulation import simulate
from srt.exceptions import DataError, InputError
from srt.recording.protocol import load_protocol

if TYPE_CHECKING:
    from srt.recording.recording import Recording, SequenceLabel

EXPECTED = ("sequence_repeated", "sequence_missing")
"""Findings that are true of a sound recording: a protocol of fewer sequences, or of repeated ones."""
FORMS = ("as recorded", "corrected", "filtered", "off the grid")
"""Processing of the readings."""


def tables(rng: np.random.Generator, number: int) -> tuple[dict[str, Any], str]:
    """Scenario of a recording, and its title."""
    grade = str(rng.choice(GRADES))
    kind = "increment" if grade in ("navigation-rlg", "tactical-fog") else "rate"
    rate = float(rng.choice([50.0, 100.0]))
    values: dict[str, Any] = {
        "seed": number,
        "imu": {"from": grade},
        "site": {"from": "latitude-45"},
        "recording": {"sample_rate_hz": rate, "kind": kind},
    }
    test = str(rng.choice(["sequences", "protocol", "turns"]))
    if test == "sequences":
        values["fixture"] = {"from": "lab-1mrad"}
        values["schedule"] = {
            "dwell_s": float(rng.choice([5.0, 10.0])),
            "rate_rad_s": float(rng.choice([0.5, 1.0])),
            "acceleration_rad_s2": float(rng.choice([2.0, 10.0])),
            "settle_s": 0.2,
            "moves": str(rng.choice(["recorded", "skipped"])),
        }
        what = f"17 sequences, moves {values['schedule']['moves']}"
    elif test == "protocol":
        name = str(rng.choice(PROTOCOLS))
        with suppress(InputError):  # some protocols cannot run on a fixture
            load_protocol(name).on_fixture()
            values["fixture"] = {"from": "lab-1mrad"}
        values["protocol"] = {"from": name}
        what = name
    else:
        profile = str(rng.choice(get_args(ProfileName)))
        values["free"] = {"turns": 18, "dwell_s": 4.0, "profile": profile}
        what = f"turns by hand, {profile}"
    return values, f"{grade}, {rate:g} Hz, {what}"


def narrowed(label: SequenceLabel, one: float) -> SequenceLabel:
    """Label with windows shorter by one sample at both ends: the filter spreads the motion beside them by as much."""
    (start, end), (begin, last) = label.start_static_s, label.end_static_s
    return replace(label, start_static_s=(start + one, end - one), end_static_s=(begin + one, last - one))


def processed(recording: Recording, form: str, rng: np.random.Generator) -> Recording:
    """Recording after one form of processing."""
    if form == "corrected":
        applier = srt.Applier(srt.calibrate(recording, checks=False))
        interval = {"dt": recording.interval_s} if recording.kind == "increment" else {}
        gyro, accel = applier.apply(recording.gyro, recording.accel, **interval)[:2]
        return replace(recording, gyro=np.asarray(gyro), accel=np.asarray(accel))
    if form == "filtered":
        cuts = recording.gaps
        gyro, accel = (
            np.concatenate([uniform_filter1d(part, 3, axis=0, mode="nearest") for part in np.split(table, cuts)])
            for table in (recording.gyro, recording.accel)
        )
        noise = replace(recording.noise, gyro_noise=None, accel_noise=None)  # the filter changes it
        filtered = replace(recording, gyro=gyro, accel=accel, noise=noise)
        return filtered.with_sequences(
            tuple(narrowed(label, recording.nominal_interval_s) for label in recording.sequences)
        )
    if form == "off the grid":
        gyro, accel = (table + rng.normal(0.0, 1e-12, table.shape) for table in (recording.gyro, recording.accel))
        return replace(recording, gyro=gyro, accel=accel)
    return recording


def clean_recording(number: int, seed: int) -> tuple[str, list[str], str]:
    """Title of a recording, the findings in it, and the verdict; a refusal counts as a finding."""
    rng = np.random.default_rng([seed, number])
    values, title = tables(rng, number)
    form = str(rng.choice(FORMS))
    labelled = bool(rng.random() < 0.5)
    raw = simulate(scenario_from_dict(values)).recording
    title = f"{number}: {title}, {form}, {'with' if labelled else 'without'} labels"
    try:
        recording = processed(raw, form, rng)
    except (DataError, InputError) as error:
        return f"{title} ({error})", ["not calibrated"] if form != "corrected" else [], "none"
    # Poses placed one by one, without the moves between them, have nothing to be recognised by.
    if not labelled and not (recording.gaps.size and "protocol" in values):
        recording = recording.with_sequences(())
    found = srt.diagnose(recording)
    word = "none" if found.judgement is None else found.judgement.word
    return title, [finding.fault for finding in found.findings if finding.fault not in EXPECTED], word
