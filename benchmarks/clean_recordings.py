"""Findings, verdicts and errors of recordings without a fault, by a generator that shares nothing with the checks.

``python benchmarks/clean_recordings.py --clean 500 --handled 200 --seed N --results FILE`` draws clean recordings (on a
fixture or turned by hand, 20 to 2000 Hz, four grades, noise stated or not, with labels or without) and hand-turned ones
that were handled: knocks in the turns, the unit set down while it turns, shaking hands, or all of these. It prints
every finding with its sentence and every verdict that is not sound, then the shares by kind. "missed" is the largest
rotation of a turn that coning-corrected samples do not show, over the random walk of the turn. ``--first N`` begins
there. FILE has one line per recording, written when it is done; those in it are not run again.

The attitude is exact at a tenth of the sampling interval, a reading is a mean over its interval, and the biases are
sums of Gauss-Markov processes. The motion on the fixture and the sensor model are those of ``foreign_fixture.py`` and
``foreign_motion.py``. The exit code is 1 if more than one in 500 clean recordings or any handled one has a finding, if
one is fatal, if fewer than 99 % of the clean ones are sound, or if a handled one is sound beyond 4 sigma.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import harness
import numpy as np
from foreign_fixture import on_fixture, table_1
from foreign_motion import (
    DEG,
    EARTH_RATE_RAD_S,
    GRADES,
    START_DEG,
    Turn,
    angle_share,
    drawn_errors,
    hand_turns,
    readings,
    windows,
)
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from worse_recordings import INSTABILITY

import srt
from srt.exceptions import DataError, InputError
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

SUBSTEPS = 10
"""Attitude steps per sampling interval."""
RATES_HZ = {20.0: 2, 25.0: 2, 50.0: 4, 62.5: 2, 100.0: 5, 125.0: 2, 200.0: 3, 400.0: 2, 1000.0: 1, 2000.0: 1}
"""Sample rates and their relative frequency; handled recordings have 50 Hz and more."""
HANDLED = ("knocks", "set down", "shaking", "all of them")
STATED = ("nothing", "white noise", "white noise and bias instability")
FORMS = {
    "navigation": ("exact", "pulses"),
    "tactical": ("exact", "pulses", "steps"),
    "industrial": ("exact", "steps", "low pass"),
    "consumer": ("exact", "steps", "low pass"),
}
"""Forms of the readings by grade: steps are those of a converter, 0.1 to 1 sigma of the noise, as pulses are."""
CORRELATION_S = 4.0 ** np.arange(-2, 7)
"""Correlation times of the bias: with a factor of 4 between them, each has the Allan floor as its sigma.

The two-sided spectrum of the sum is sigma² / (2 |f| ln 4) = floor² / (4 |f| ln 2), that of flicker noise.
"""
BIAS_HZ = 50.0
"""Rate at which the bias is drawn: faster flicker noise is far below the white noise."""
SIGMAS, SOUND_SHARE, FINDINGS_SHARE = 4.0, 0.99, 1.0 / 500.0


@dataclass(frozen=True)
class Handling:
    """Effects of the hand on turns."""

    carried: bool = False
    knocks: bool = False
    set_down: bool = False
    shaking: bool = False

    @property
    def rings(self) -> bool:
        """True if the unit oscillates after its turns."""
        return self.knocks or self.set_down


class Segment(NamedTuple):
    """Turn by fine steps: attitude relative to its start, shape (n, 4), and acceleration in level axes, (n, 3)."""

    relative: np.ndarray
    acceleration: np.ndarray


def tremor(n: int, step: float, rng: np.random.Generator) -> np.ndarray:
    """Band-limited noise of 3 to 12 Hz with unit variance per axis, shape (n, 3)."""
    frequency = np.fft.rfftfreq(n, step)
    band = (frequency > 3.0) & (frequency < 12.0)
    spectrum = np.zeros((len(frequency), 3), complex)
    spectrum[band] = rng.normal(size=(band.sum(), 3)) + 1j * rng.normal(size=(band.sum(), 3))
    course = np.fft.irfft(spectrum, n, axis=0)
    return course / course.std()


def half_sine(t: np.ndarray, begin: float, duration: float) -> np.ndarray:
    """Pulse of unit height."""
    s = (t - begin) / duration
    return np.where((s > 0.0) & (s < 1.0), np.sin(np.pi * np.clip(s, 0.0, 1.0)), 0.0)


def ringing(t: np.ndarray, begin: float, hz: float, largest_deg_s: float, rng: np.random.Generator) -> np.ndarray:
    """Rotation of the unit by a knock, rad, shape (n, 3): it decays within a sample or many, and ends."""
    frequency = rng.uniform(8.0, min(40.0, 0.4 * hz))
    decay, rate = 0.06 ** rng.uniform(1.0, 2.0), rng.uniform(0.1, 1.0) * largest_deg_s * DEG
    direction = rng.normal(size=3)
    s = np.clip(t - begin, 0.0, None)
    fading = np.clip(1.0 - s / (10.0 * decay), 0.0, 1.0) ** 2
    course = rate / (2.0 * np.pi * frequency) * np.sin(2.0 * np.pi * frequency * s) * np.exp(-s / decay) * fading
    return course[:, None] * direction / np.linalg.norm(direction)


RING_S = 0.6
"""Longest oscillation after a turn."""


def share_by_rate(t: np.ndarray, duration: float, landing: float, at: float) -> np.ndarray:
    """Share of the angle of a turn that ends on the table: the rate falls to zero within ``landing`` from ``at`` on."""
    moving = np.where(t < at, np.sin(np.pi * np.clip(t / duration, 0.0, 1.0)), 0.0)
    rate = moving + np.where(t < at, 0.0, np.sin(np.pi * at / duration) * np.clip(1.0 - (t - at) / landing, 0.0, 1.0))
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))])
    return angle / angle[-1]


def segment(turn: Turn, hz: float, profile: str, handling: Handling, rng: np.random.Generator) -> Segment:
    """Turn on a fixture, whose profile is exact, or by a hand."""
    step = 1.0 / (hz * SUBSTEPS)
    tail = RING_S if handling.rings else 0.0
    t = step * np.arange(int(np.ceil((turn.duration_s + tail) / step)) + 1)
    s = np.clip(t / turn.duration_s, 0.0, 1.0)
    share, end = angle_share(profile, s), turn.duration_s
    stray, acceleration = np.zeros((len(t), 3)), np.zeros((len(t), 3))

    def pulse(begin: float, least: float, most: float) -> np.ndarray:
        """Acceleration of a knock over 1 to 3 samples, in a random direction."""
        return half_sine(t, begin, rng.uniform(1.0, 3.0) / hz)[:, None] * _direction(rng) * rng.uniform(least, most)

    if handling.set_down:
        end = rng.uniform(0.8, 0.97) * turn.duration_s
        landing = rng.uniform(1.0, 3.0) / hz
        share = share_by_rate(t, turn.duration_s, landing, end)
        acceleration += pulse(end, 10.0, 90.0)
        stray += ringing(t, end, hz, 80.0, rng)
        end += landing
    held = np.clip(t / end, 0.0, 1.0)
    inside = np.sin(np.pi * held) ** 2
    if handling.carried:
        waves = rng.normal(0.0, 0.05, (3, 3))
        stray += (inside * np.sin(np.pi * held))[:, None] * (
            np.sin(2 * np.pi * np.outer(held, [1.0, 2.3, 3.7])) @ waves
        )
        acceleration += (inside * np.sin(2.0 * np.pi * held))[:, None] * rng.normal(0.0, 0.6, 3)
    if handling.shaking:
        held_firmly = np.clip(np.minimum(t, end - t) / 0.1, 0.0, 1.0)
        held_firmly = (held_firmly**2 * (3.0 - 2.0 * held_firmly))[:, None]
        # At 6 Hz, 1 °/s is 0.46 mrad.
        stray += held_firmly * tremor(len(t), step, rng) * rng.uniform(0.5, 6.0) * 0.46e-3
        acceleration += held_firmly * tremor(len(t), step, rng) * rng.uniform(0.1, 1.0)
    if handling.knocks:
        acceleration += pulse(0.0, 2.0, 20.0)
        for begin in turn.duration_s * rng.uniform(0.05, 1.0, rng.poisson(0.7)):
            acceleration += pulse(begin, 5.0, 90.0)
            stray += ringing(t, begin, hz, 40.0, rng)
    along = np.array(turn.axis) / np.linalg.norm(turn.axis) * turn.angle_rad
    relative = Rotation.from_rotvec(share[:, None] * along) * Rotation.from_rotvec(stray)
    return Segment(relative.as_quat(), acceleration)


def _direction(rng: np.random.Generator) -> np.ndarray:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


@dataclass(frozen=True)
class Place:
    """Latitude, and normal gravity of the ellipsoid (WGS 84) at sea level."""

    latitude_rad: float

    @property
    def gravity_m_s2(self) -> float:
        """Somigliana's formula."""
        s2 = np.sin(self.latitude_rad) ** 2
        return float(9.7803253359 * (1.0 + 0.00193185265241 * s2) / np.sqrt(1.0 - 0.00669437999013 * s2))

    def sensed(self, body: Rotation, step: float, acceleration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates of sub-steps (n, SUBSTEPS, 3) and mean specific force of samples (n, 3) from fine attitudes."""
        earth = EARTH_RATE_RAD_S * np.array([np.cos(self.latitude_rad), 0.0, -np.sin(self.latitude_rad)])
        before, after = body[:-1], body[1:]
        turned = (before.inv() * after).as_rotvec()
        middle = before * Rotation.from_rotvec(0.5 * turned)
        rate = turned / step + middle.inv().apply(earth)
        pull = acceleration - np.array([0.0, 0.0, self.gravity_m_s2])
        half = 0.5 * (pull[1:] + pull[:-1])
        # Simpson's rule over each sub-step.
        force = (before.inv().apply(pull[:-1]) + 4.0 * middle.inv().apply(half) + after.inv().apply(pull[1:])) / 6.0
        return rate.reshape(-1, SUBSTEPS, 3), force.reshape(-1, SUBSTEPS, 3).mean(axis=1)


def product(rotations: Rotation) -> Rotation:
    """Product of all rotations in their order."""
    while len(rotations) > 1:
        if len(rotations) % 2:
            rotations = Rotation.concatenate([rotations, Rotation.identity(1)])
        rotations = rotations[0::2] * rotations[1::2]
    return rotations[0]


class Samples(NamedTuple):
    """Readings without noise, (n, 3) each, and the samples in rest, (n,).

    ``missed`` is the largest of the rotations that the coning-corrected samples of a turn do not show, over the square
    root of the duration of the turn, rad/√s.
    """

    gyro: np.ndarray
    accel: np.ndarray
    resting: np.ndarray
    missed: float


class Test(NamedTuple):
    """Turns of a test, with the rests between them, and how they are executed."""

    start: Rotation
    first_rest_s: float
    turns: list[Turn]
    profile: str
    handling: Handling = Handling()
    moves: frozenset[int] = frozenset()

    def recorded(self, time: np.ndarray) -> np.ndarray:
        """True for samples outside of the moves, which a logger that is stopped between sequences does not have."""
        rests = windows(self.turns, self.first_rest_s)
        return ~np.any(
            [np.zeros(len(time), bool), *((time > rests[i][1]) & (time <= rests[i + 1][0]) for i in self.moves)], axis=0
        )


def samples(test: Test, place: Place, errors: dict[str, float], hz: float, rng: np.random.Generator) -> Samples:
    """Samples of a test by a unit with these errors."""
    step, dt = 1.0 / (hz * SUBSTEPS), 1.0 / hz
    rests = windows(test.turns, test.first_rest_s)
    count = round(rests[-1][1] * hz)
    gyro, accel, resting = np.empty((count, 3)), np.empty((count, 3)), np.ones(count, bool)
    attitude, done, missed = test.start, 0, 0.0

    def read(body: Rotation, acceleration: np.ndarray, place_of: slice) -> np.ndarray:
        rate, force = place.sensed(body, step, acceleration)
        gyro[place_of], accel[place_of] = readings(rate, force, errors, None, dt, rng)
        return rate

    def rest(stop: int) -> None:
        still = Rotation.from_quat(np.tile(attitude.as_quat(), (SUBSTEPS + 1, 1)))
        read(still, np.zeros((SUBSTEPS + 1, 3)), slice(done, stop))

    for turn, (_, begin) in zip(test.turns, rests[:-1], strict=True):
        moved = segment(turn, hz, test.profile, test.handling, rng)
        first = round(begin / step)
        a, b = first // SUBSTEPS, -(-(first + len(moved.relative) - 1) // SUBSTEPS)
        rest(a)
        before, after = first - a * SUBSTEPS, b * SUBSTEPS - first - len(moved.relative) + 1
        quaternions = np.pad(moved.relative, ((before, after), (0, 0)), mode="edge")
        acceleration = np.pad(moved.acceleration, ((before, after), (0, 0)))
        rate = read(attitude * Rotation.from_quat(quaternions), acceleration, slice(a, b))
        angles = dt * rate.mean(axis=1)
        # Coning correction of a rate that is linear over two samples.
        angles[1:] += np.cross(angles[:-1], angles[1:]) / 12.0
        exact, sampled = (product(Rotation.from_rotvec(each)) for each in (step * rate.reshape(-1, 3), angles))
        missed = max(missed, float((exact.inv() * sampled).magnitude()) / np.sqrt((b - a) * dt))
        attitude, done = attitude * Rotation.from_quat(moved.relative[-1]), b
        resting[a:b] = False
    rest(count)
    return Samples(gyro, accel, resting, missed)


def bias_course(floor: float, count: int, hz: float, resting: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Wandering of a bias with an Allan floor, shape (count, 3), zero on average at rest."""
    coarse = int(count / hz * BIAS_HZ) + 2
    sum_of = np.zeros((coarse, 3))
    for tau in CORRELATION_S:
        kept = np.exp(-1.0 / (BIAS_HZ * tau))
        drawn = rng.normal(0.0, floor * np.sqrt(1.0 - kept**2), (coarse, 3))
        drawn[0] = rng.normal(0.0, floor, 3)
        sum_of += lfilter([1.0], [1.0, -kept], drawn, axis=0)
    at, grid = np.arange(count) / hz, np.arange(coarse) / BIAS_HZ
    course = np.stack([np.interp(at, grid, column) for column in sum_of.T], axis=1)
    return course - course[resting].mean(axis=0)


class Drawn(NamedTuple):
    """Recording of a unit with known errors, shape (27,), SI.

    ``missed`` is the largest rotation that the samples of a turn do not show, over the random walk of this turn.
    """

    kind: str
    title: str
    recording: srt.Recording
    truth: np.ndarray
    missed: float


def drawn(number: int, seed: int, *, handled: bool) -> Drawn:
    """Recording without a fault."""
    rng = np.random.default_rng((seed, int(handled), number))
    name = list(GRADES)[number % len(GRADES)]
    grade, place = GRADES[name], Place(float(rng.uniform(-60.0, 65.0)) * DEG)
    rates = {hz: n for hz, n in RATES_HZ.items() if hz >= 50.0 or not handled}
    hz = float(rng.choice(list(rates), p=np.array(list(rates.values())) / sum(rates.values())))
    kind, test, labels, fixture = _test(handled, hz, rng)
    errors = drawn_errors(grade, rng)
    seen = samples(test, place, errors, hz, rng)
    stated = str(rng.choice(STATED))
    floors, form = INSTABILITY[name], str(rng.choice(FORMS[name]))
    (gyro, gyro_noise), (accel, accel_noise) = (
        as_read(table, white, floor, hz, seen.resting, form, rng)
        for table, white, floor in zip(
            (seen.gyro, seen.accel), (grade.gyro_rad_per_sqrt_s, grade.accel_m_s2_sqrt_s), floors, strict=True
        )
    )
    noise = (
        srt.ImuNoise()
        if stated == STATED[0]
        else srt.ImuNoise(gyro_noise[0], accel_noise[0], gyro_noise[1], accel_noise[1])
    )
    if stated == STATED[2]:
        noise = replace(noise, gyro_bias_instability=floors[0], accel_bias_instability=floors[1])
    labelled, time = rng.random() < 0.5, np.arange(1, len(gyro) + 1) / hz
    recorded = test.recorded(time) if labelled and rng.random() < 0.5 else np.ones(len(time), bool)
    time = time + rng.choice([0.0, 1e-3], p=[0.7, 0.3]) / hz * rng.normal(size=len(time))
    recording = srt.Recording(
        np.round(time, 6)[recorded],
        gyro[recorded],
        accel[recorded],
        srt.Site(place.gravity_m_s2, latitude_rad=place.latitude_rad if rng.random() < 0.75 else None),
        kind="increment" if form == "pulses" else "rate",
        fixture=fixture,
        noise=noise,
        sequences=labels if labelled else (),
    )
    title = f"{number}: {kind}, {name}, {hz:g} Hz, {form}, {stated} stated, {'with' if labelled else 'without'} labels"
    truth = np.array([errors.get(each, 0.0) for each in NAMES])
    return Drawn(kind, title, recording, truth, seen.missed / grade.gyro_rad_per_sqrt_s)


def _test(
    handled: bool, hz: float, rng: np.random.Generator
) -> tuple[str, Test, tuple[srt.SequenceLabel, ...], srt.Fixture | None]:
    """Kind of the recording, its motion, and labels and fixture that may be stated."""
    if not handled and rng.random() < 0.5:
        rest, rate = float(rng.uniform(5.0, 12.0)), float(rng.uniform(40.0, 90.0)) * DEG
        motion = on_fixture(table_1(), rng, rest_s=rest, rate_rad_s=rate, sigma_rad=1e-3)
        labels = tuple(
            srt.SequenceLabel(tuple(row["start_static_s"]), tuple(row["end_static_s"]), id=row["id"])
            for row in motion.labels(0.1)
        )
        profile = str(rng.choice(["raised-cosine", "trapezoid"]))
        test = Test(motion.start, motion.first_rest_s, motion.turns, profile, moves=motion.moves)
        return "fixture", test, labels, srt.Fixture(0.0, 1e-3, 1e-3)
    kind = str(rng.choice(HANDLED)) if handled else "by hand"
    every = kind == HANDLED[3]
    handling = Handling(True, *(every or kind == one for one in HANDLED[:3]))
    # A turn of fewer samples is not sampled well enough for the errors of a good gyro.
    turns = hand_turns(
        rng, shortest_s=max(1.0, 60.0 / hz), longest_s=6.0, count=30, rest_s=float(rng.uniform(4.0, 8.0))
    )
    start = Rotation.from_euler("ZYX", START_DEG, degrees=True)
    first_rest = float(rng.uniform(5.0, 20.0))
    clear = 0.05 + (RING_S if handling.rings else 0.0)
    rests = [(a + clear if i else a, b - 0.05) for i, (a, b) in enumerate(windows(turns, first_rest))]
    labels = tuple(srt.SequenceLabel(a, b) for a, b in pairwise(rests))
    return kind, Test(start, first_rest, turns, "raised-cosine", handling), labels, None


def as_read(
    table: np.ndarray, white: float, floor: float, hz: float, resting: np.ndarray, form: str, rng: np.random.Generator
) -> tuple[np.ndarray, tuple[float, float]]:
    """Readings with white noise and wandering biases in one of the forms; random walk, and size of a pulse."""
    sigma = white * np.sqrt(hz)
    table = table + rng.normal(0.0, sigma, table.shape) + bias_course(floor, len(table), hz, resting, rng)
    least = rng.uniform(0.1, 1.0) * sigma
    if form == "pulses":  # a count contains the remainder of the one before
        total = np.cumsum(np.vstack([np.zeros(3), table / hz]), axis=0)
        return np.diff(np.floor(total / (least / hz)), axis=0) * (least / hz), (white, least / hz)
    if form == "low pass":  # of first order, at a fifth of the sample rate; gyros and accelerometers lag by the same
        kept = np.exp(-2.0 * np.pi * 0.2)
        table = lfilter([1.0 - kept], [1.0, -kept], table, axis=0, zi=kept * table[:1])[0]
    if form == "exact":
        return table, (white, 0.0)
    return np.round(table / least) * least, (float(np.hypot(white, least / np.sqrt(12.0 * hz))), 0.0)


def outcome(number: int, seed: int, handled: bool) -> dict[str, Any]:
    """Outcome of one recording, as the results file has it."""
    kind, title, recording, truth, missed = drawn(number, seed, handled=handled)
    row = {"number": number, "seed": seed, "handled": handled, "kind": kind, "title": title, "missed": missed}
    try:
        found = srt.calibrate(recording)
    except (DataError, InputError) as error:
        return row | {"word": "refused", "faults": [[error.fault or "refused", "fatal", str(error)]], "error": 0.0}
    faults = [[f.fault, f.effect, f.sentence] for f in found.diagnostics.faults or ()]
    faults += [["contradicted", "warning", sentence] for sentence in found.diagnostics.contradicted or ()]
    seen = found.observed & (found.sigma > 0.0)
    error = np.where(seen, np.abs(found.errors.vector - truth) / np.where(seen, found.sigma, 1.0), 0.0)
    most = int(np.argmax(error))
    verdict = found.judgement
    return row | {
        "word": verdict.word, "sentence": verdict.reason, "faults": faults,
        "error": float(error[most]), "parameter": NAMES[most],
    }  # fmt: skip


def told(row: dict[str, Any]) -> Iterable[str]:
    """Findings in a recording, and its verdict if it is not sound."""
    for name, effect, sentence in row["faults"]:
        yield f"{name} ({effect}): {sentence}"
    if row["word"] not in ("sound", "refused"):
        yield f"{row['word']}, {row['error']:.1f} sigma: {row['sentence']}"


def report(rows: Sequence[dict[str, Any]]) -> Iterable[str]:
    """Shares by kind."""
    for kind in dict.fromkeys(row["kind"] for row in rows):
        own = [row for row in rows if row["kind"] == kind]
        named = Counter(name for row in own for name in {fault[0] for fault in row["faults"]})
        codes = ", ".join(f"{name} {n}" for name, n in named.most_common()) or "none"
        fatal = sum(row["word"] == "refused" for row in own)
        words = Counter(row["word"] for row in own)
        beyond = sum(row["error"] > SIGMAS for row in own)
        silent = sum(row["error"] > SIGMAS and row["word"] == "sound" for row in own)
        yield (
            f"{kind}: {len(own)} recordings; sound {words['sound'] / len(own):.1%}; with a finding "
            f"{sum(bool(row['faults']) for row in own) / len(own):.1%} ({codes}); fatal {fatal / len(own):.1%}; beyond "
            f"{SIGMAS:g} sigma {beyond / len(own):.1%}, sound {silent / len(own):.1%}"
        )


def failed(rows: Sequence[dict[str, Any]]) -> bool:
    """True if the recordings do not meet what is expected of them."""
    clean, handled = ([row for row in rows if row["handled"] == which] for which in (False, True))
    accused = sum(bool(row["faults"]) for row in clean) > max(1.0, FINDINGS_SHARE * len(clean))
    sound = sum(row["word"] == "sound" for row in clean) < SOUND_SHARE * len(clean)
    silent = any(row["word"] == "sound" and row["error"] > SIGMAS for row in handled)
    return accused or sound or silent or any(row["faults"] for row in handled) or any(
        row["word"] == "refused" for row in rows
    )  # fmt: skip


def main(
    *,
    clean: int = 500,
    handled: int = 200,
    first: int = 0,
    seed: int = 0,
    jobs: int = 1,
    results: Path = Path("clean_recordings.jsonl"),
) -> int:
    lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
    rows = [row for row in map(json.loads, lines) if row["seed"] == seed]
    done = {(row["handled"], row["number"]) for row in rows}
    wanted = [(which, n) for which, count in ((False, clean), (True, handled)) for n in range(first, first + count)]
    rows = [row for row in rows if (row["handled"], row["number"]) in set(wanted)]
    tasks = [(n, seed, which) for which, n in wanted if (which, n) not in done]
    for row in harness.in_processes(jobs, outcome, tasks):
        with results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        rows.append(row)
        for line in told(row):
            print(f"{row['title']}, missed {row['missed']:.2f}: {line}", flush=True)
    print(*report(rows), sep="\n")
    return int(failed(rows))


if __name__ == "__main__":
    harness.run(main, __doc__)
