"""Faults of a laboratory in recordings of a generator that shares nothing with the checks: causes, verdicts, errors.

``python benchmarks/fault_verdicts.py --count 200 --seed N`` draws grade, kind of test, kind of fault, size and place of
each recording from its number (:mod:`foreign_faults`). A row has the first cause found, whether it is a right one, the
verdict, the largest error over sigma against the true errors, and the noncentrality: chi-square of the residuals less
that of the same recording without the fault. A fault is harmless if nothing is named, the verdict is sound and no error
is beyond 4 sigma. The exit code is 1 if the right cause is first in less than 85 % of the others, or if a recording is
silent beyond 4 sigma with a noncentrality of more than 25.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import harness
import numpy as np
from foreign_faults import KINDS, Kind
from foreign_fixture import LATITUDE_DEG, Motion, Trial, on_fixture, table_1
from foreign_motion import DEG, GRADES, PROFILES, START_DEG, attitudes, drawn_errors, hand_turns, true_samples
from scipy.spatial.transform import Rotation

import srt
from srt.exceptions import DataError, InputError
from srt.sensor_errors import NAMES

SHARE, SIGMAS, NONCENTRALITY = 0.85, 4.0, 25.0
"""Smallest share of right causes; error over sigma, and noncentrality, of a wrong result that residuals show."""


def trial(kind: Kind, size: float, seed: tuple[int, ...], *, faulty: bool) -> Trial:
    """Recording of a unit with the fault, or the same one without it."""
    rng = np.random.default_rng((*seed, 1))
    needs = kind.needs.split()
    grade = str(rng.choice([name for name in GRADES if name in needs] or list(GRADES)))
    fixture = bool(rng.random() < 0.7) or bool({"fixture", "labelled"} & {*needs})
    labelled = fixture and (bool(rng.random() < 0.6) or "labelled" in needs)
    stated = bool(rng.random() < 0.5) or "stated" in needs
    dt = 1.0 / float(rng.choice([50.0, 100.0]))
    if fixture:
        rate = float(rng.uniform(40.0, 90.0)) * DEG
        motion = on_fixture(table_1(), rng, rest_s=float(rng.uniform(5.0, 12.0)), rate_rad_s=rate, sigma_rad=1e-3)
        profile = str(rng.choice(PROFILES[:2]))
    else:
        start = Rotation.from_euler("ZYX", START_DEG, degrees=True)
        motion, profile = Motion(start, 5.0, hand_turns(rng, shortest_s=1.0, rest_s=5.0)), "hand"
    t = Trial(grade, motion, fixture, labelled, stated, dt, np.random.default_rng((*seed, 2)), (*seed, 3), {})
    t.errors = drawn_errors(t.unit, rng)
    if faulty and kind.stage == "plan":
        kind.change(t, size)
    body = attitudes(motion.turns, motion.start, motion.first_rest_s, dt, profile, rng)
    t.rate, t.force = true_samples(body, dt, LATITUDE_DEG * DEG)
    if faulty and kind.stage == "motion":
        kind.change(t, size)
    t.read()
    if faulty and kind.stage == "readings":
        kind.change(t, size)
    return t


class Row(NamedTuple):
    """Outcome of a recording; ``error`` is the largest error over sigma, NaN where nothing is calibrated."""

    text: str
    right: bool
    first: str
    verdict: str
    error: float
    noncentrality: float


def largest_error(found: srt.Calibration, t: Trial) -> float:
    """Largest error over sigma of the observed parameters that the fault does not move in truth."""
    truth = np.array([t.errors.get(name, 0.0) for name in NAMES])
    seen = found.observed & np.array([not name.startswith(t.moved) for name in NAMES])
    return float(np.max(np.abs(found.errors.vector - truth)[seen] / found.sigma[seen], initial=0.0))


def chi_square(found: srt.Calibration) -> float:
    return math.nan if found.verdict is None else found.verdict.sensor_noise_test.chi_square


def examined(number: int, seed: int, only: tuple[str, ...] = ()) -> Row:
    """Outcome of one recording."""
    rng = np.random.default_rng((seed, number))
    name = str(rng.choice([k for k in KINDS if not only or any(word in k for word in only)]))
    kind = KINDS[name]
    size = float(np.exp(rng.uniform(math.log(kind.low), math.log(kind.high))))
    t = trial(kind, size, (seed, number), faulty=True)
    test = ("labelled " if t.labelled else "") + ("fixture" if t.fixture else "by hand")
    text = f"{number}: {name} {size:.3g}, {t.grade}, {test}, {1.0 / t.dt:.0f} Hz"
    causes = kind.causes.split()
    try:
        found = srt.calibrate(t.recording())
    except (DataError, InputError) as error:
        return Row(text, error.fault in causes, error.fault or "refused", "failed", math.nan, math.nan)
    first = next((f.fault for f in found.diagnostics.faults or () if f.effect != "note"), "")
    word, error = found.judgement.word, largest_error(found, t)
    more = 0.0
    if word == "sound" and error > SIGMAS:
        more = chi_square(found) - chi_square(
            srt.calibrate(trial(kind, size, (seed, number), faulty=False).recording())
        )
    return Row(text, first in causes, first, word, error, more)


def harmless(row: Row) -> bool:
    """True if nothing is named and no word is needed: sound or partial, within 4 sigma."""
    return not row.first and row.verdict in ("sound", "partial") and row.error <= SIGMAS


def silent(row: Row) -> bool:
    """True if a result called sound is wrong, and the residuals show it."""
    return row.verdict == "sound" and row.error > SIGMAS and row.noncentrality > NONCENTRALITY


def main(*, count: int = 200, first: int = 0, seed: int = 0, only: tuple[str, ...] = ()) -> int:
    rows = []
    for number in range(first, first + count):
        row = examined(number, seed, only)
        rows.append(row)
        mark = "harmless" if harmless(row) else "right" if row.right else "SILENT" if silent(row) else "wrong"
        more = f", noncentrality {row.noncentrality:.0f}" if row.noncentrality else ""
        named = f"{row.first or 'nothing'}, {row.verdict}, {row.error:.1f} sigma{more}"
        print(f"{mark:9s}{row.text}: {named}", flush=True)
    does_harm = [row for row in rows if not harmless(row)]
    right, wrong = sum(row.right for row in does_harm), sum(silent(row) for row in rows)
    beyond = sum(row.verdict == "sound" and row.error > SIGMAS for row in rows)
    percent = 100.0 * right / max(1, len(does_harm))
    print(f"right cause first in {right} of {len(does_harm)} that do harm ({percent:.0f} %)")
    print(f"sound beyond {SIGMAS:g} sigma: {beyond}, with a noncentrality of more than {NONCENTRALITY:g}: {wrong}")
    return int(right < SHARE * len(does_harm) or wrong > 0)


if __name__ == "__main__":
    harness.run(main, __doc__)
