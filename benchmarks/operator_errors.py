"""Operator's errors in a running test: share that the monitor names before the next sequence turns, and false alarms.

``python benchmarks/operator_errors.py --trials 100`` simulates tests with recorded moves, one error each, for units of
three grades. The monitor gets the samples up to the moment at which the next sequence starts to turn, and must name the
sequence and the kind of error. A skipped sequence shows, at the latest, when the sequence after it has been done. In
the samples before the error, nothing must be named.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import harness
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # injected_faults

from injected_faults.execution import slipped

import sims
from sims.physics.sequences import TABLE_1
from srt.planning.monitoring.run_monitor import run_state, truncated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.recording.recording import Recording

GRADES = ("navigation-rlg", "tactical-fog", "industrial-mems")
KINDS = ("moved", "bumped", "wrong turn", "wrong direction", "skipped")
SEED = 20_26
NAMED_AS = {
    "moved": {"moved", "creep", "bump", "noisy_window"},
    "bumped": {"moved", "creep", "bump", "noisy_window"},
    "wrong turn": {"wrong turn", "skipped"},  # the wrong turn may end where a later sequence starts
    "wrong direction": {"wrong direction"},
    "skipped": {"skipped", "wrong attitude"},
}
"""Kinds of the monitor that name an error."""
CREEP_RAD_S = {"navigation-rlg": 100e-6, "tactical-fog": 300e-6, "industrial-mems": 1e-3}
"""Motion in a window: as of a loose clamp or a hand on the table, above the noise of the grade."""
BUMP_RAD = {"navigation-rlg": 1e-3, "tactical-fog": 1e-3, "industrial-mems": 5e-3}


@dataclass(frozen=True)
class Trial:
    """One test with one error: samples up to the deadline, the sequence concerned, and the samples before it."""

    grade: str
    kind: str
    sequence: str
    until_deadline: Recording
    before: Recording


def scenario(
    grade: str, seed: int, order: Sequence[str], custom: Sequence[dict[str, Any]] = (), moves: str = "recorded"
) -> sims.Scenario:
    """A test with windows of 8 s."""
    return sims.scenario_from_dict(
        {
            "seed": seed,
            "imu": {"from": grade},
            "fixture": {"from": "lab-1mrad"},
            "site": {"from": "latitude-45"},
            "schedule": {
                "moves": moves, "dwell_s": 8.0, "settle_s": 0.5,
                "sequences": tuple(order), "custom": tuple(custom),
            },
            "recording": {"sample_rate_hz": 100.0},
        }
    )  # fmt: skip


def wrong_rotations(name: str, kind: str, rng: np.random.Generator) -> tuple[tuple[str, float], ...]:
    """Rotations of a sequence done wrong: reversed, or the last one a quarter or half turn off."""
    rotations = TABLE_1[name].rotations
    if kind == "wrong direction":
        return tuple((axis, -angle) for axis, angle in rotations)
    (*first, (axis, angle)) = rotations
    off = float(rng.choice([-90.0, 90.0, 180.0]))
    return (*first, (axis, angle + math.copysign(off, angle) if angle + off else angle + 90.0))


def trial(grade: str, kind: str, seed: int) -> Trial:
    """Simulate one test with one error at a random sequence but the last."""
    rng = np.random.default_rng([SEED, GRADES.index(grade), KINDS.index(kind), seed])
    ids = list(TABLE_1)
    k = int(rng.integers(0 if kind != "skipped" else 1, len(ids) - 1))
    name, order, custom = ids[k], list(ids), []
    if kind in ("wrong turn", "wrong direction"):
        own = {"down": TABLE_1[name].down, "along_outer": TABLE_1[name].along_outer}
        custom = [{"id": "wrong", **own, "rotations": wrong_rotations(name, kind, rng)}]
        order[k] = "wrong"
    elif kind == "skipped":
        order.remove(name)
    run = sims.simulate(scenario(grade, int(rng.integers(1 << 30)), order, custom))
    motion = run.motion
    if kind in ("moved", "bumped"):
        a, b = motion.windows[k][int(rng.integers(2))]
        axis = rng.standard_normal(3)
        if kind == "moved":
            up = motion.velocity[(motion.time > a) & (motion.time < b)].mean(axis=0)
            axis = np.cross(up, axis)  # a turn about the vertical is one of the fixture's own
            length = float(rng.uniform(0.5, 0.9)) * (b - a)
            start, size = float(rng.uniform(a, b - length)), CREEP_RAD_S[grade] * length
        else:
            length = float(rng.uniform(0.1, 0.3))
            start, size = a + float(rng.uniform(0.15, 0.85)) * (b - a - length), BUMP_RAD[grade]
        motion = slipped(motion, start, length, size * axis / np.linalg.norm(axis), steady=kind == "moved")
    recording = replace(
        sims.read_out(motion, run.truth, run.imu, rng, kind="rate", state_noise=True), site=run.recording.site
    )
    after = k + 1  # in place of a skipped sequence, the next one stands at k: the one after it is the deadline
    deadline = motion.windows[after][0][1] if after < len(motion.windows) else float(recording.time[-1])
    before = motion.windows[k - 1][1][1] if k else motion.windows[0][0][0] + 1.0
    return Trial(grade, kind, name, truncated(recording, deadline), truncated(recording, before))


def outcome(one: Trial) -> tuple[bool, bool]:
    """Two truth values: the error was named in time; something was named before it."""
    found = run_state(one.until_deadline).errors
    named = any(error.sequence == one.sequence and error.kind in NAMED_AS[one.kind] for error in found)
    return named, bool(run_state(one.before).errors)


def main(*, trials: int = 20) -> None:
    print(f"{'grade':18}{'error':18}{'named':>10}{'false alarms':>14}")
    total: Counter[str] = Counter()
    for grade in GRADES:
        for kind in KINDS:
            results = [outcome(trial(grade, kind, seed)) for seed in range(trials)]
            named, false = (sum(column) for column in zip(*results, strict=True))
            total += Counter(named=named, false=false, trials=len(results))
            print(f"{grade:18}{kind:18}{named:6} /{len(results):3}{false:10} /{len(results):3}", flush=True)
    print(f"{'all':36}{total['named']:6} /{total['trials']:3}{total['false']:10} /{total['trials']:3}")


if __name__ == "__main__":
    harness.run(main, __doc__)
