"""Spikes in recordings of a generator that shares nothing with the checks: which are named, and which are silent.

``python benchmarks/spikes.py`` draws 1 to 500 single readings, or bursts of 2 and 5, of 3 to 1000 sigma, at rest or in
turns, on a fixture, turned by smooth hands and by shaking ones, in units of four grades. It prints the share that is
named, by the shift of the result, and the recordings without spikes in which some are named. The exit code is 1 if
fewer than 95 % are named that shift the result by 2 sigma on a fixture or by smooth hands, if a clean recording is
accused, or if a result with spikes is sound and beyond 4 sigma.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import harness
import numpy as np
from foreign_fixture import on_fixture, table_1
from foreign_motion import DEG, SHAKING, drawn_errors, hand_turns
from foreign_motion import GRADES as FOREIGN_GRADES
from foreign_motion import recording as free_recording
from studies import markdown

import srt
from srt.diagnosis.evidence import Evidence
from srt.exceptions import DataError
from srt.noise.allan import CHANNELS
from srt.result.verdict import SOUND, USABLE
from srt.sensor_errors import NAMES

SIGMAS, FOUND = 4.0, 0.95
"""Largest error over sigma in silence, and smallest share of harmful spikes that are named."""
MOTIONS = ("fixture", "hand", SHAKING)
PLACES = ("rest", "start", "middle", "end")
"""Places of spikes; the start and the end are the first and the last tenth of a turn."""
SPIKES = ((1, 1), (5, 1), (50, 1), (500, 1), (1, 2), (1, 5), (10, 5))
"""Numbers of the bursts, and the readings of each."""
HARMFUL = (2.0, 4.0, 10.0, math.inf)
"""Limits of the classes of spikes by the shift of the result, in its sigmas; the first ones do no harm."""


@lru_cache(len(MOTIONS) * len(FOREIGN_GRADES))
def spiked_unit(motion: str, grade: str, seed: int) -> tuple[srt.Recording, Any, np.ndarray]:
    """Recording without spikes, its calibration, and its true errors, shape (27,), SI."""
    rng = np.random.default_rng((seed, MOTIONS.index(motion), list(FOREIGN_GRADES).index(grade)))
    white = FOREIGN_GRADES[grade]
    errors = drawn_errors(white, rng)
    if motion == "fixture":
        moved = on_fixture(table_1(), rng, rest_s=8.0, rate_rad_s=60.0 * DEG, sigma_rad=1e-3)
        unit = moved.recording(errors, white, rng, hz=50.0, profile="trapezoid", noise=srt.ImuNoise())
    else:
        unit = free_recording(hand_turns(rng, count=18), 5.0, errors, white, rng, profile=motion)
    return unit, srt.calibrate(unit, force=True), np.array([errors.get(name, 0.0) for name in NAMES])


class Spiked(NamedTuple):
    """Outcome of spikes: ``shift`` of the result in its sigmas, ``named`` as spikes, ``silent``: sound but wrong."""

    title: str
    motion: str
    place: str
    shift: float
    named: bool
    silent: bool


def spiked(number: int, seed: int) -> Spiked:
    """Outcome of drawn spikes."""
    rng = np.random.default_rng((seed, 59, number))
    motion, place, grade = MOTIONS[number % len(MOTIONS)], str(rng.choice(PLACES)), str(rng.choice([*FOREIGN_GRADES]))
    unit, before, truth = spiked_unit(motion, grade, seed)
    data = Evidence(unit).data
    spans = data.rotation if place != "rest" else data.windows.samples
    low, high = {"rest": (0.05, 0.95), "start": (0.0, 0.1), "middle": (0.1, 0.9), "end": (0.9, 1.0)}[place]
    begin, length = spans[:, 0], np.diff(spans, axis=1)[:, 0]
    parts = np.stack([begin + low * length, begin + high * length], axis=1).astype(int).tolist()
    rows = np.concatenate([np.arange(a + 1, max(a + 2, b - 5)) for a, b in parts])
    count, readings = SPIKES[int(rng.integers(len(SPIKES)))]
    channel, size = int(rng.integers(6)), 10.0 ** rng.uniform(math.log10(3.0), 3.0)
    values = np.hstack([unit.gyro, unit.accel])
    a, b = data.windows.samples[0].tolist()
    sigma = float(np.std(np.diff(values[a:b, channel]))) / math.sqrt(2.0)
    for at in rng.choice(rows, min(count, len(rows) // 2), replace=False).tolist():
        values[at : at + readings, channel] += size * sigma * rng.choice([-1.0, 1.0])
    title = f"{number}: {count} of {readings} in {CHANNELS[channel]}, {size:.3g} sigma, {motion} ({place}), {grade}"
    try:
        found = srt.calibrate(replace(unit, gyro=values[:, :3], accel=values[:, 3:]), force=True)
    except DataError as refused:
        return Spiked(f"{title}: refused, {refused.fault}", motion, place, math.inf, refused.fault == "spikes", False)
    both = before.observed & found.observed & (before.sigma > 0.0) & (found.sigma > 0.0)
    shift = np.max(np.abs(found.errors.vector - before.errors.vector)[both] / before.sigma[both], initial=0.0)
    if found.status not in USABLE:
        shift = math.inf
    error = np.max(np.abs(found.errors.vector - truth)[both] / found.sigma[both], initial=0.0)
    faults, word = {fault.fault for fault in found.diagnostics.faults or ()}, found.judgement.word
    title = (
        f"{title}: {word}, {', '.join(sorted(faults)) or 'nothing named'}, shift {shift:.1f}, error {error:.1f} sigma"
    )
    return Spiked(title, motion, place, float(shift), "spikes" in faults, word == SOUND and error > SIGMAS)


def main(*, seed: int = 59, first: int = 0, units: int = 96, jobs: int = 1) -> int:
    rows = list(harness.in_processes(jobs, spiked, ((number, seed) for number in range(first, first + units))))
    print(*(row.title for row in rows if row.silent or (row.shift > HARMFUL[0] and not row.named)), sep="\n")
    classes = [f"named at {a:g}-{b:g} sigma" for a, b in pairwise(HARMFUL)]
    print(*markdown(("motion", "place", f"named below {HARMFUL[0]:g} sigma", *classes, "silent"), (), 2), sep="\n")
    for motion in MOTIONS:
        for place in PLACES:
            own = [row for row in rows if (row.motion, row.place) == (motion, place)]
            at = np.searchsorted(HARMFUL[:-1], [row.shift for row in own])
            cells = [[row.named for row, k in zip(own, at, strict=True) if k == n] for n in range(len(HARMFUL))]
            told = " | ".join(f"{sum(cell)}/{len(cell)}" for cell in cells)
            print(f"| {motion} | {place} | {told} | {sum(row.silent for row in own)} |")
    clean = [spiked_unit(motion, grade, seed)[1] for motion in MOTIONS for grade in FOREIGN_GRADES]
    alarms = sum("spikes" in {fault.fault for fault in result.diagnostics.faults or ()} for result in clean)
    print(f"named in {alarms} of {len(clean)} recordings without spikes")
    smooth = [row.named for row in rows if row.motion != SHAKING and row.shift > HARMFUL[0]]
    share = sum(smooth) / max(1, len(smooth))
    print(f"on a fixture and by smooth hands {share:.0%} of {len(smooth)} named beyond {HARMFUL[0]:g} sigma")
    return int(share < FOUND or alarms > 0 or any(row.silent for row in rows))


if __name__ == "__main__":
    harness.run(main, __doc__)
