"""Recordings that are worse than what is stated of them, by a generator that shares nothing with the estimators.

Each case is a fixture less accurate than stated, a unit whose biases move, or readings that no noise model covers. A
cell is the mean NEES per observed parameter (1 if all sigmas are true), the largest error over its sigma, the verdicts,
and what the result names: the drift it models and its warnings of sequences or moves that contradict.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from foreign_fixture import LATITUDE_DEG, on_fixture, table_1
from foreign_motion import DEG, GRADES, GRAVITY_M_S2, drawn_errors, hand_turns, recording
from joblib import Parallel, delayed

import srt
from srt.result.verdict import OF_FIXTURE
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Callable

SEED = 20261128
HZ = 50.0


class Case(NamedTuple):
    """One kind of recording.

    ``disturbed`` changes the readings; ``true_sigma_rad`` is the accuracy of the fixture, ``stated_sigma_rad`` that
    which the recording states. Its alignment and its wobble can have another one.
    """

    grade: str
    disturbed: Callable[[srt.Recording, np.random.Generator], srt.Recording]
    motion: str = "fixture"
    true_sigma_rad: float = 1e-3
    stated_sigma_rad: float = 1e-3
    alignment_rad: float | None = None
    wobble_rad: float | None = None


def as_it_is(unit: srt.Recording, _: np.random.Generator) -> srt.Recording:
    """Readings without a disturbance."""
    return unit


CASES: dict[str, Case] = {
    "fixture of 1 mrad, 0.1 stated": Case("tactical", as_it_is, stated_sigma_rad=1e-4),
    "fixture of 1 mrad, 0.1 stated, navigation grade": Case("navigation", as_it_is, stated_sigma_rad=1e-4),
    "fixture of 1 mrad as stated": Case("tactical", as_it_is),
    "rotations of 1 mrad, 0.1 stated": Case("tactical", as_it_is, stated_sigma_rad=1e-4, alignment_rad=1e-4),
    "alignment of 1 mrad, 0.1 stated": Case(
        "tactical", as_it_is, true_sigma_rad=1e-4, stated_sigma_rad=1e-4, alignment_rad=1e-3
    ),
    "axis wobble of 1 mrad, not stated": Case("tactical", as_it_is, wobble_rad=1e-3),
}
"""Cases by name."""


def unit_of(case: Case, seed: int) -> tuple[srt.Recording, dict[str, float]]:
    """One recording of a case, with its noise stated, and the errors of the unit."""
    rng = np.random.default_rng((SEED, seed))
    grade = GRADES[case.grade]
    errors = drawn_errors(grade, rng)
    if case.motion == "hand":
        unit = recording(hand_turns(rng, shortest_s=1.0), 5.0, errors, grade, rng)
    else:
        motion = on_fixture(
            table_1(),
            rng,
            rest_s=10.0,
            rate_rad_s=60.0 * DEG,
            sigma_rad=case.true_sigma_rad,
            alignment_rad=case.alignment_rad,
            wobble_rad=case.wobble_rad,
        )
        samples = motion.sampled(errors, grade, rng, hz=HZ)
        labels = tuple(
            srt.SequenceLabel(tuple(row["start_static_s"]), tuple(row["end_static_s"]), id=row["id"])
            for row in motion.labels(0.1)
        )
        site = srt.Site(GRAVITY_M_S2, latitude_rad=LATITUDE_DEG * DEG)
        fixture = srt.Fixture(0.0, case.stated_sigma_rad, case.stated_sigma_rad)
        unit = srt.Recording(
            samples["time"], samples["gyro"], samples["accel"], site, fixture=fixture, sequences=labels
        )
    unit = replace(unit, noise=srt.ImuNoise(grade.gyro_rad_per_sqrt_s, grade.accel_m_s2_sqrt_s, 0.0, 0.0, 0.0, 0.0))
    return case.disturbed(unit, rng), errors


def outcome(name: str, seed: int, estimator: str) -> dict[str, Any]:
    """NEES, number of observed parameters, largest error over sigma, verdict, and what is named."""
    unit, errors = unit_of(CASES[name], seed)
    try:
        found = srt.calibrate(unit, estimator)
    except srt.InputError as error:
        return {"nees": math.nan, "seen": 0, "worst": math.nan, "word": "refused", "named": str(error)[:60]}
    seen = found.observed & (found.sigma > 0.0)
    if found.status not in ("converged", "partial") or not seen.any():
        return {"nees": math.nan, "seen": 0, "worst": math.nan, "word": found.status, "named": ""}
    truth = np.array([errors.get(name, 0.0) for name in NAMES])
    z = (found.errors.vector - truth)[seen] / found.sigma[seen]
    P = found.covariance[np.ix_(seen, seen)] / np.outer(found.sigma[seen], found.sigma[seen])
    named = [f"{row.sensor} {row.form}" for row in found.diagnostics.drift or ()]
    named += [f.fault for f in found.diagnostics.faults or ()]
    if found.verdict is not None and found.verdict.contradicting is not None:
        named.append(f"contradicts: {found.verdict.contradicting.sequence}")
    added = found.verdict.added_noise if found.verdict is not None else None
    named += [OF_FIXTURE[kind] for kind in added or () if kind in OF_FIXTURE]
    named += ["move left out" for _ in found.provenance.voided]
    named += ["label" for warning in found.warnings if "check the label" in warning]
    return {
        "nees": float(z @ np.linalg.solve(P, z)),
        "seen": int(seen.sum()),
        "worst": float(np.abs(z).max()),
        "word": found.judgement.word,
        "named": ", ".join(named),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=int, default=10, help="of each cell")
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES), metavar="CASE")
    parser.add_argument("--estimators", nargs="+", default=["closed-form", "least-squares", "ekf", "graph"])
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    print(f"{options.units} units a cell, seed {SEED}\n")
    print("| case | estimator | NEES / n | largest error, sigma | verdicts | named |")
    print("|---|---|---:|---:|---|---|", flush=True)
    for name in options.cases:
        for estimator in options.estimators:
            if CASES[name].motion == "hand" and estimator == "closed-form":
                continue
            rows = Parallel(n_jobs=options.jobs)(delayed(outcome)(name, i, estimator) for i in range(options.units))
            words = Counter(row["word"] for row in rows).most_common()
            named = Counter(what for row in rows for what in sorted(set(row["named"].split(", ")))).most_common()
            words, named = ("; ".join(f"{n} {what}" for what, n in part if what) for part in (words, named))
            nees = np.nansum([row["nees"] for row in rows]) / max(sum(row["seen"] for row in rows), 1)
            worst = np.nanmax([row["worst"] for row in rows] + [0.0])
            print(f"| {name} | {estimator} | {nees:.2f} | {worst:.1f} | {words} | {named} |", flush=True)


if __name__ == "__main__":
    main()
