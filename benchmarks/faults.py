"""First cause named, verdict and error of recordings with a fault, and false alarms (docs/fault-detection.md).

``python benchmarks/faults.py`` injects every fault of the catalogue into 200 units of every grade, and halves its
severity while all of 40 units are named. A row of the table is printed when it is done: ``--kinds`` takes the others
after an interruption, or variants in the forms of foreign loggers and operators. ``faults.py drawn`` draws grade, test,
kind of fault and place of each recording; its units are those of a generator that shares nothing with the
simulator or the checks, on a fixture or turned by hand, with labels or without, unless the fault is one of the motion.
``faults.py clean`` draws recordings without a fault, of all grades, protocols, profiles and forms of processing; by
design, all checks together raise a finding in at most 1e-4 of them. ``--units N`` takes that many, from
``--first`` on.

A fault is harmless if nothing is named, the verdict is sound or partial, and no error is beyond 4 sigma. The exit code
is 1 if a fault of the catalogue is named in fewer than 99 % of its injections, if the right cause is first in less than
85 % of the drawn faults that do harm, if a drawn one leaves a sound result beyond 4 sigma, or if a recording without a
fault raises a finding.
"""

import math
import sys
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, get_args

import harness
import numpy as np
from foreign_fixture import on_fixture, table_1
from foreign_motion import DEG, PROFILES, drawn_errors, hand_turns
from foreign_motion import GRADES as FOREIGN_GRADES
from foreign_motion import recording as free_recording
from protocols import PROTOCOLS
from scipy.ndimage import uniform_filter1d
from studies import counts, markdown

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # injected_faults

from injected_faults import execution, foreign_operators, logger, site_and_drift  # noqa: F401 - they register
from injected_faults.foreign_operators import PAIRS
from injected_faults.injection import GRADES, INJECTIONS, VARIANTS, Case, Injection

import srt
from sims.physics.turn_profiles import ProfileName
from sims.scenarios.scenario import scenario_from_dict
from sims.scenarios.simulation import simulate
from srt.diagnosis.faults import FAULTS
from srt.estimation.options import Options
from srt.exceptions import DataError, InputError
from srt.recording.protocol import load_protocol
from srt.recording.recording import SequenceLabel
from srt.sensor_errors import NAMES

SEEN, SHARE, SIGMAS = 0.99, 0.85, 4.0
"""Smallest shares of the injections, and of the drawn faults, that are named; largest error over sigma in silence."""
LADDER_UNITS = 40
"""Units of each severity below the stated one; 40 of 40 give a lower limit of 92.8 % at 95 % confidence."""
FIRST_UNITS = 8
"""Units run first at each step: an undetected severity mostly shows within these."""
MOST_RUNGS = 12
"""Largest number of halvings: a factor of 4096."""
LEAST_ONE = ("sequences", "samples", "columns", "channels", "windows")
"""Severity units that are counts: a step halves them, rounded up; one is the last."""
FACTORS = ("times", "times the noise")
"""Severity units that are factors: a step takes the square root."""
SHARES = ("of the planned length",)
"""Severity units that are a remaining share of the whole: a step halves the missing part."""
ALL_OR_NOTHING = ("", "-")
"""Severity units of a fault that is present or absent: there is no smaller severity."""
MOVED = {
    "gyro_lsb": ("gyro",), "accel_lsb": ("accel",), "gyro_factor": ("gyro",), "accel_factor": ("accel",),
    "one axis of another range": ("gyro", "accel"), "gyro_bias_drift": ("gyro_bias",),
    "gyro bias steps": ("gyro_bias",), "earth_rate_absent": ("gyro_bias",), "accel_bias_drift": ("accel_bias",),
    "wrong_angle and accel_bias_drift": ("accel_bias",), "accelerometer bias steps": ("accel_bias",),
    "accelerometer scale drifts": ("accel_scale",), "gyro scale drifts": ("gyro_scale",),
    "gyro_scale_drift": ("gyro_scale",), "offset subtracted twice": ("gyro_bias",),
    "low bits lost": ("gyro_bias", "accel_bias"), "bit of a converter stuck": ("gyro_bias", "accel_bias"),
    "bit_stuck": ("gyro_bias", "accel_bias"), "mounted at 45 deg": ("gyro", "accel"),
    "sensors askew in their housing": ("gyro", "accel"), "accelerometer board askew": ("accel",),
}  # fmt: skip
"""Parameters that a fault changes in truth, by the beginning of their names: calibration finds them, and should."""
CANNOT_BE_SEEN = (
    "gravity", "gravity of another country", "sample_rate", "clock fast", "nominal rate of a chip", "time_unit",
    "rate_contradicts_stamps", "stamps in minutes", "sample_rate and spikes", "time_unit and gyro_lsb", "low bits lost",
)  # fmt: skip
"""Kinds of which some severities are within the scale errors or asymmetries of a sound unit: no check tells them."""
OF_FIXTURE = (
    "north", "table faces the other way", "frame_turned", "east, north, up for north, east, down",
)  # fmt: skip
"""Faults of a heading or a frame, which units turned by hand do not have."""
OF_MOTION = (
    "labels_shifted", "labels_exchanged", "wrong_direction", "wrong_angle", "sequence_missing", "sequence_repeated",
    "unsettled", "bump", "creep", "vibration", "noisy_window", "sensor_time_offset", "gyro_axis_delayed",
    "accel_axis_delayed", "samples_lost", "increments_as_rates", "rates_as_increments", "gravity_absent", "spikes",
    "gyro_clipped", "accel_clipped", "latitude", "gyro_bias_drift", "units_joined", "accel_settling", "gyro_noise",
    "accel_noise", "asymmetry_omitted", "samples dropped, stamps closed up", "labels of a fast clock",
    "time of the labels from the start", "mounted anew in the middle", *(f"{a} and {b}" for a, b in PAIRS),
)  # fmt: skip
"""Faults of the motion, of the noise, or of a size relative to them, which are those of a simulated unit."""
KINDS = {**INJECTIONS, **VARIANTS}
case_of = lru_cache(LADDER_UNITS)(Case)
"""Unit of a grade and a seed, simulated once for faults in a row."""


class Outcome(NamedTuple):
    """First cause ("" for none), verdict, and largest error over sigma; NaN where nothing is calibrated."""

    first: str
    word: str
    error: float

    @property
    def harmless(self) -> bool:
        """True if nothing is named, and the verdict and the errors need nothing named."""
        return not self.first and self.word in ("sound", "partial") and not self.error > SIGMAS

    @property
    def told(self) -> str:
        """First cause, or what is said without one."""
        if self.first or self.harmless:
            return self.first or "nothing"
        return f"nothing, {self.word}" + (f" beyond {SIGMAS:g} sigma" if self.error > SIGMAS else "")


def outcome_of(
    make: Callable[[], srt.Recording],
    causes: Collection[str],
    truth: np.ndarray,
    moved: tuple[str, ...] = (),
    options: Options | None = None,
) -> Outcome:
    """Outcome of a recording whose making may find its fault.

    ``truth``, shape (27,), SI: those that begin with ``moved`` are changed by the fault and do not count.
    """
    try:
        found = srt.calibrate(make(), options=options)
    except (DataError, InputError) as error:
        return Outcome(error.fault or "refused", "failed", math.nan)
    faults = found.diagnostics.faults or ()
    # A note is a cause where it is the right one.
    first = next((f.fault for f in faults if f.effect != "note"), "") or next(
        (f.fault for f in faults if f.fault in causes), ""
    )
    seen = found.observed & np.array([not name.startswith(moved) for name in NAMES]) & (found.sigma > 0.0)
    error = np.max(np.abs(found.errors.vector - truth)[seen] / found.sigma[seen], initial=0.0)
    return Outcome(first, found.judgement.word, float(error))


def causes_of(kind: str) -> tuple[str, ...]:
    """Names of the catalogue that are right first causes of a kind."""
    return (kind,) if kind in FAULTS else KINDS[kind].causes


def severity_at(made: Injection, grade: str, rung: int) -> float | None:
    """Severity after ``rung`` halvings of the stated one; None if there is no such step."""
    stated = made.severity[grade]
    if rung == 0:
        return stated
    if made.unit in ALL_OR_NOTHING:
        return None
    if made.unit in LEAST_ONE:
        left = math.ceil(stated / 2.0**rung)
        return float(left) if left < math.ceil(stated / 2.0 ** (rung - 1)) else None
    if made.unit in FACTORS:
        return float(stated ** (0.5**rung))
    return 1.0 - (1.0 - stated) / 2.0**rung if made.unit in SHARES else stated / 2.0**rung


def injected(kind: str, grade: str, severity: float, seed: int) -> Outcome:
    """Outcome of one unit with a fault of this severity."""
    made, case = KINDS[kind], case_of(grade, seed)
    truth, moved = case.simulation.truth.vector, MOVED.get(kind, ())
    return outcome_of(partial(made.recording, case, severity), causes_of(kind), truth, moved, made.options)


class Detection(NamedTuple):
    """Detection of one fault in one grade.

    ``told`` counts what is named at the stated severity, which is None if the fault cannot be seen in this grade;
    ``smallest`` is the smallest severity seen.
    """

    kind: str
    severity: float | None
    told: Counter[str]
    smallest: float | None = None

    @property
    def right(self) -> int:
        return sum(self.told[cause] for cause in causes_of(self.kind))

    @property
    def seen(self) -> bool:
        """True if enough of the injections were named."""
        return 0 < SEEN * self.told.total() <= self.right

    def cell(self) -> str:
        """Cell of the table."""
        if self.severity is None:
            return "unseen"
        right, unit = f"{self.right}/{self.told.total()}", KINDS[self.kind].unit
        if unit in ALL_OR_NOTHING:
            return right
        smallest = "; none seen" if self.smallest is None else f"; ≥ {self.smallest:.4g}"
        return f"{self.severity:.4g} {unit}: {right}{smallest}"


def detection(kind: str, grade: str, seeds: range, jobs: int) -> Detection:
    """Inject a fault at its stated severity into all units, and at its halves into the first ones."""
    made = KINDS[kind]
    if grade not in made.severity:
        return Detection(kind, None, Counter())

    def told(severity: float, part: Sequence[int]) -> Counter[str]:
        done = harness.in_processes(jobs, injected, ((kind, grade, severity, seed) for seed in part))
        return Counter(outcome.told for outcome in done)

    def all_named(severity: float) -> bool:
        parts = seeds[:FIRST_UNITS], seeds[FIRST_UNITS:LADDER_UNITS]
        return all(set(told(severity, part)) <= {*causes_of(kind)} for part in parts)

    found = Detection(kind, made.severity[grade], told(made.severity[grade], seeds))
    for rung in range(MOST_RUNGS + 1):
        severity = severity_at(made, grade, rung)
        if severity is None or not (all_named(severity) if rung else found.seen):
            break
        found = found._replace(smallest=severity)
    return found


def catalogue(kinds: Sequence[str], grades: Sequence[str], seeds: range, jobs: int) -> bool:
    """Print the detection of faults; True if one is missed."""
    print(*markdown(("fault", "effect", *grades), (), 2 + len(grades)), sep="\n")
    notes, missed = [], False
    for kind in kinds:
        row = {grade: detection(kind, grade, seeds, jobs) for grade in grades}
        effect = FAULTS[causes_of(kind)[0]].effect if causes_of(kind) else ""
        print(f"| `{kind}` | {effect} | {' | '.join(one.cell() for one in row.values())} |", flush=True)
        for grade, one in row.items():
            if one.severity is None:
                notes.append(f"- `{kind}`, {grade}: {KINDS[kind].unseen.get(grade, '')}")
            elif one.right < one.told.total():
                others = Counter({cause: n for cause, n in one.told.items() if cause not in causes_of(kind)})
                notes.append(f"- `{kind}`, {grade}, named otherwise: {counts(others.elements())}")
            missed |= one.severity is not None and not one.seen
    print("", *notes, sep="\n")
    return missed


class ForeignCase(NamedTuple):
    """Unit of a generator that shares nothing with the simulator or the checks, for faults of what is recorded."""

    grade: str
    seed: int
    recording: srt.Recording


def foreign_unit(grade: str, seed: int, rng: np.random.Generator, *, by_hand: bool) -> tuple[ForeignCase, np.ndarray]:
    """Unit with labels, on a fixture of 1 mrad or turned by hand, and its errors, shape (27,), SI."""
    white = list(FOREIGN_GRADES.values())[GRADES.index(grade)]
    errors, hz = drawn_errors(white, rng), float(rng.choice([50.0, 100.0]))
    stated = (white.gyro_rad_per_sqrt_s, white.accel_m_s2_sqrt_s) if rng.random() < 0.5 else ()
    if by_hand:
        turns = hand_turns(rng, shortest_s=1.0, rest_s=5.0)
        unit = free_recording(turns, 5.0, errors, white, rng, profile="hand", hz=hz, labelled=True)
        unit = replace(unit, noise=srt.ImuNoise(*stated))
    else:
        profile, rate = str(rng.choice(PROFILES[:2])), float(rng.uniform(40.0, 90.0)) * DEG
        motion = on_fixture(table_1(), rng, rest_s=float(rng.uniform(5.0, 12.0)), rate_rad_s=rate, sigma_rad=1e-3)
        unit = motion.recording(errors, white, rng, hz=hz, profile=profile, noise=srt.ImuNoise(*stated))
    return ForeignCase(grade, seed, unit), np.array([errors.get(name, 0.0) for name in NAMES])


def drawn_fault(number: int, seed: int) -> tuple[str, str, Callable[[], srt.Recording], np.ndarray]:
    """Title, kind, making and true errors of a unit with a drawn fault of its stated severity.

    A fault of the motion is injected into a simulated unit; any other into a foreign one, whose labels are taken away
    in half of the recordings, unless the fault is in them.
    """
    rng = np.random.default_rng((seed, number))
    kind = str(rng.choice(list(KINDS)))
    made, unlabelled = KINDS[kind], rng.random() < 0.5
    grade, by_hand = str(rng.choice(list(made.severity))), rng.random() < 0.3 and kind not in OF_FIXTURE
    case: ForeignCase | Case
    if kind in OF_MOTION:
        case, test, unlabelled = Case(grade, seed + number), "simulated", False
        truth = case.simulation.truth.vector
    else:
        case, truth = foreign_unit(grade, seed + number, rng, by_hand=by_hand)
        test = ("by hand" if by_hand else "fixture") + (", no labels" if unlabelled else "")

    def make() -> srt.Recording:
        faulty = made.recording(case)
        return faulty.with_sequences(()) if unlabelled and faulty.sequences == case.recording.sequences else faulty

    return f"{number}: {kind}, {grade}, {test}", kind, make, truth


def drawn_outcome(number: int, seed: int) -> tuple[str, str, Outcome]:
    """Title, kind and outcome of a drawn fault."""
    title, kind, make, truth = drawn_fault(number, seed)
    return title, kind, outcome_of(make, (), truth, MOVED.get(kind, ()), KINDS[kind].options)


def drawn(seeds: range, seed: int, jobs: int) -> bool:
    """Print the outcome of each drawn fault, and the sums; True if too few are right, or one is silently wrong."""
    harmful, right, silent = 0, 0, 0
    for title, kind, outcome in harness.in_processes(jobs, drawn_outcome, ((number, seed) for number in seeds)):
        good, wrong = outcome.first in causes_of(kind), outcome.word == "sound" and outcome.error > SIGMAS
        if wrong and not good and kind in CANNOT_BE_SEEN:
            print(f"unseen   {title}: {outcome.error:.1f} sigma", flush=True)
            continue
        mark = "harmless" if outcome.harmless else "right" if good else "SILENT" if wrong else "wrong"
        print(f"{mark:9s}{title}: {outcome.told}, {outcome.word}, {outcome.error:.1f} sigma", flush=True)
        harmful, right, silent = harmful + (not outcome.harmless), right + good, silent + wrong
    print(f"right cause first in {right} of {harmful} that do harm ({right / max(1, harmful):.0%})")
    print(f"sound beyond {SIGMAS:g} sigma: {silent}")
    return right < SHARE * harmful or silent > 0


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


def processed(recording: srt.Recording, form: str, rng: np.random.Generator) -> srt.Recording:
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


def clean(seeds: range, seed: int, jobs: int) -> bool:
    """Print the recordings without a fault that raise a finding, and the verdicts; True if there is one."""
    alarms, words = 0, Counter[str]()
    for title, faults, word in harness.in_processes(jobs, clean_recording, ((number, seed) for number in seeds)):
        if faults or word not in ("sound", "partial"):
            print(f"{title}: {', '.join((*faults, word))}", flush=True)
        alarms, words[word] = alarms + bool(faults), words[word] + 1
    print(f"{alarms} of {len(seeds)} clean recordings raise a finding; verdicts: {counts(words.elements())}")
    return alarms > 0


def main(
    study: str = "catalogue",
    *,
    kinds: tuple[str, ...] = tuple(name for name in FAULTS if name in INJECTIONS),
    grades: tuple[str, ...] = GRADES,
    units: int = 200,
    first: int = 0,
    seed: int = 0,
    jobs: int = 2,
) -> int:
    numbers = range(first, first + units)
    if study == "catalogue":
        return int(catalogue(kinds, grades, range(seed + first, seed + first + units), jobs))
    return int((drawn if study == "drawn" else clean)(numbers, seed, jobs))


if __name__ == "__main__":
    harness.run(main, __doc__, study=("catalogue", "drawn", "clean"), kinds=KINDS, grades=GRADES)
