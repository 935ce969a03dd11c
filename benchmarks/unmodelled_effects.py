"""Verdicts on units with an effect that the sensor model does not have.

``python benchmarks/unmodelled_effects.py --count 20 --seed N --results FILE`` draws recordings of each effect on a
fixture (closed form and least squares) and turned by hand (least squares), nothing stated, and prints by effect how
many are sound, doubtful and failed, how many accuse a turn or sequence, and the largest error of a sound one over its
sigma. An effect is in all turns: none of them may be accused, and none may be sound beyond 4 sigma. FILE has one line
per calibration; those in it are not run again.

The motion, the sensor model and most effects are those of ``foreign_fixture.py`` and ``foreign_motion.py``.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import harness
import numpy as np
from foreign_fixture import GRAVITY_M_S2, LATITUDE_DEG, Motion, on_fixture, table_1
from foreign_motion import (
    DEG,
    GRADES,
    START_DEG,
    Extras,
    drawn_errors,
    hand_turns,
    motion_samples,
    readings,
    with_extras,
)
from scipy.spatial.transform import Rotation

import srt
from srt.exceptions import DataError, InputError
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

HZ, STEPS = 100.0, 10.0
G = GRAVITY_M_S2
PLACES = {"fixture": ("closed-form", "least-squares"), "hand": ("least-squares",)}
LIMIT_SIGMAS = 4.0

Table = np.ndarray


def scale_drift(rate: Table, force: Table, share: Table, rng: np.random.Generator) -> tuple[Table, Table]:
    """Scale factors of the gyros that change by 200 ppm in the test."""
    return 200e-6 * (share - 0.5)[:, None] * rng.choice([-1.0, 1.0], 3) * rate, 0.0 * force


def supply_sag(rate: Table, force: Table, share: Table, rng: np.random.Generator) -> tuple[Table, Table]:
    """Supply that falls in the last third of the test: biases by up to 20 µg and 1 °/h, scale factors by 100 ppm."""
    sag = np.clip(3.0 * share - 2.0, 0.0, 1.0)[:, None] ** 2
    bias = rng.choice([-1.0, 1.0], (2, 3)) * np.array([[DEG / 3600.0], [20e-6 * G]])
    return sag * (1e-4 * rate + bias[0]), sag * (1e-4 * force + bias[1])


def hysteresis(rate: Table, force: Table, _share: Table, _rng: np.random.Generator) -> tuple[Table, Table]:
    """Accelerometers that keep 50 µg of the sign of the last g that they felt."""
    felt = np.sign(force) * (np.abs(force) > 0.5 * G)
    for column in felt.T:
        last = np.maximum.accumulate(np.where(column != 0.0, np.arange(len(column)), 0))
        column[:] = column[last]
    return 0.0 * rate, 50e-6 * G * felt


def unchanged(rate: Table, force: Table, _share: Table, _rng: np.random.Generator) -> tuple[Table, Table]:
    """No change of the readings."""
    return 0.0 * rate, 0.0 * force


LEVER = ((0.02, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, 0.02))
EFFECTS: dict[str, tuple[Callable[..., tuple[Table, Table]], Extras]] = {
    "none": (unchanged, Extras()),
    "lag": (unchanged, Extras(lag_s=1e-3)),
    "size effect": (unchanged, Extras(lever_m=LEVER)),
    "k2": (unchanged, Extras(quadratic=(20e-6 / G,) * 3)),
    "hysteresis": (hysteresis, Extras()),
    "scale drift": (scale_drift, Extras()),
    "supply sag": (supply_sag, Extras()),
    "steps": (unchanged, Extras()),
}
ON_FACES = {
    "k2": {f"accel_asymmetry_{a}": 20e-6 for a in "xyz"},
    "hysteresis": {f"accel_scale_{a}": 50e-6 for a in "xyz"},
}
"""Errors that an effect equals where an axis feels plus or minus g."""
WITHOUT_VALUE = {"hysteresis": "accel_bias"}
"""Errors that an effect leaves without a single value."""


def _motion(place: str, rng: np.random.Generator) -> Motion:
    if place == "fixture":
        return on_fixture(table_1(), rng, rest_s=8.0, rate_rad_s=60.0 * DEG, sigma_rad=1e-3)
    turns = hand_turns(rng, shortest_s=1.5, longest_s=6.0, rest_s=5.0)
    return Motion(Rotation.from_euler("ZYX", START_DEG, degrees=True), 10.0, turns)


def drawn(effect: str, place: str, number: int, seed: int) -> tuple[srt.Recording, np.ndarray, str]:
    """Recording of a unit, its 27 errors, and the grade; the unit and its motion are the same for all effects."""
    rng = np.random.default_rng((seed, number, place == "hand"))
    name = list(GRADES)[number % len(GRADES)]
    grade, errors = GRADES[name], drawn_errors(GRADES[name], rng)
    motion, dt = _motion(place, rng), 1.0 / HZ
    rate, force = motion_samples(
        motion.turns, motion.start, motion.first_rest_s, dt, LATITUDE_DEG * DEG, "raised-cosine", rng
    )
    change, extras = EFFECTS[effect]
    force, added = with_extras(rate, force, extras, dt)
    share = np.linspace(0.0, 1.0, len(force))
    by_rate, by_force = change(rate.mean(axis=1), force, share, rng)
    gyro, accel = readings(rate, force, errors, grade, dt, rng)
    gyro, accel = gyro + by_rate, accel + by_force + added
    if effect == "steps":
        lsb = STEPS * np.sqrt(HZ) * np.array([grade.gyro_rad_per_sqrt_s, grade.accel_m_s2_sqrt_s])
        gyro, accel = (np.round(table / step) * step for table, step in zip((gyro, accel), lsb, strict=True))
    if place == "fixture":
        labels = [
            srt.SequenceLabel(tuple(row["start_static_s"]), tuple(row["end_static_s"]), id=row["id"])
            for row in motion.labels(0.1)
        ]
    else:
        clear = [(a + 0.05, b - 0.05) for a, b in motion.rests()]
        labels = [srt.SequenceLabel(a, b) for a, b in pairwise(clear)]
    fixture = srt.Fixture(0.0, 1e-3, 1e-3) if place == "fixture" else None
    site = srt.Site(G, latitude_rad=LATITUDE_DEG * DEG)
    made = srt.Recording(dt * np.arange(1, len(gyro) + 1), gyro, accel, site, fixture=fixture, sequences=tuple(labels))
    errors = errors | {name: errors.get(name, 0.0) + size for name, size in ON_FACES.get(effect, {}).items()}
    return made, np.array([errors.get(each, 0.0) for each in NAMES]), name


def outcome(effect: str, place: str, estimator: str, number: int, seed: int) -> dict[str, Any]:
    """Outcome of one calibration, as the results file has it."""
    recording, truth, grade = drawn(effect, place, number, seed)
    row: dict[str, Any] = {
        "effect": effect, "place": place, "estimator": estimator, "number": number, "seed": seed, "grade": grade,
    }  # fmt: skip
    try:
        found = srt.calibrate(recording, estimator=estimator)
    except (DataError, InputError) as error:
        return row | {"word": "refused", "reason": str(error), "accused": "", "error": 0.0, "parameter": ""}
    valued = np.array([not name.startswith(WITHOUT_VALUE.get(effect, "none")) for name in NAMES])
    seen = found.observed & (found.sigma > 0.0) & valued
    error = np.where(seen, np.abs(found.errors.vector - truth) / np.where(seen, found.sigma, 1.0), 0.0)
    accused = found.consistency and found.consistency.contradicting
    return row | {
        "word": found.judgement.word,
        "reason": found.judgement.reason,
        "accused": accused.title if accused else "",
        "error": float(error.max()),
        "parameter": NAMES[int(np.argmax(error))],
    }


def _rows(count: int, seed: int, effects: Iterable[str], file: Path | None, jobs: int) -> Iterator[dict[str, Any]]:
    done: dict[tuple[Any, ...], dict[str, Any]] = {}
    keys = ("effect", "place", "estimator", "number", "seed")
    if file is not None and file.exists():
        done = {tuple(row[k] for k in keys): row for row in map(json.loads, file.read_text().splitlines())}
    tasks = [(e, p, m, n, seed) for e in effects for p, by in PLACES.items() for m in by for n in range(count)]
    yield from (done[task] for task in tasks if task in done)
    left = [task for task in tasks if task not in done]
    for row in harness.in_processes(jobs, outcome, left):
        if file is not None:
            with file.open("a") as out:
                out.write(json.dumps(row) + "\n")
        yield row


def main(
    *, count: int = 20, seed: int = 20261203, effect: tuple[str, ...] = (), results: str = "", jobs: int = 1
) -> int:
    """Run, print the table, and return 1 if a turn is accused, or one is sound beyond 4 sigma."""
    rows = list(_rows(count, seed, effect or EFFECTS, Path(results) if results else None, jobs))
    print(f"{'effect':12s} {'place':8s} {'estimator':14s} sound doubtful failed accused  sound beyond 4 sigma, largest")
    bad = 0
    for name in effect or EFFECTS:
        for place, by in PLACES.items():
            for estimator in by:
                own = [r for r in rows if (r["effect"], r["place"], r["estimator"]) == (name, place, estimator)]
                words = [sum(r["word"] == word for r in own) for word in ("sound", "doubtful", "failed")]
                accused = sum(bool(r["accused"]) for r in own)
                sound = [r["error"] for r in own if r["word"] in ("sound", "partial")]
                beyond = sum(e > LIMIT_SIGMAS for e in sound)
                bad += accused + beyond
                print(f"{name:12s} {place:8s} {estimator:14s} {words[0]:5d} {words[1]:8d} {words[2]:6d} {accused:7d}  "
                      f"{beyond:3d}, {max(sound, default=0.0):.1f}")  # fmt: skip
    return int(bad > 0)


if __name__ == "__main__":
    harness.run(main, __doc__, effect=tuple(EFFECTS))
