"""Results of the estimators on 25 recordings, written to a folder, and compared with those of another version.

Before a change that must not alter results, ``--write DIR`` stores the calibrations of every recording and estimator;
afterwards ``--against DIR`` prints the largest difference of a value in sigmas, the largest relative difference of a
sigma, and the statuses and verdicts if they differ. ``--same A B`` compares two estimators with each other instead.
The exit code is 1 if a difference exceeds 1e-6.

The recordings are simulated from fixed seeds: test on the fixture, recorded moves, turns by hand, biases that drift,
missing sequences, g-sensitive gyros, protocols, stated rates, quantization, large errors, and nothing stated.
"""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path  # noqa: TC003 - the type of an option
from typing import TYPE_CHECKING, Any, Final

import accuracy_trials
import harness
from honesty_trials import drifting_unit

import sims
import srt

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.recording.recording import Recording

_NUMBER: Final = re.compile(r"[\d.]+(e[+-]?\d+)?")
SLOW: Final = {"sample_rate_hz": 50.0}
LARGEST: Final = 1e-6
"""Largest difference, in sigmas, that counts as none."""


def simulated(tables: dict[str, Any]) -> Recording:
    """Recording of a scenario given by its tables; latitude 45°, a fixture of 1 mrad and 50 Hz unless given."""
    base = {"imu": {"from": "tactical-fog"}, "site": {"from": "latitude-45"}, "recording": SLOW}
    fixture = {} if "free" in tables else {"fixture": {"from": "lab-1mrad"}}
    given = {name: table for name, table in {**base, **fixture, **tables}.items() if table is not None}
    return sims.simulate(sims.scenario_from_dict(given)).recording


def shipped(name: str) -> Recording:
    """Recording of a scenario of the library."""
    return sims.simulate(sims.load_scenario(name)).recording


def moving(seed: int, grade: str) -> Recording:
    """Test on the fixture with the moves between its sequences."""
    return accuracy_trials.fixture_recording(seed, grade, moves="recorded", sample_rate_hz=50.0)[0]


def drifting_biases(seed: int, form: str, change: str) -> Recording:
    """Industrial unit turned by hand, with biases that drift by "mg, °/h"."""
    return drifting_unit(seed, "industrial", form, change, profile="quintic")[0]


QUICK: Final = {"dwell_s": 4.0, "rate_rad_s": 2.0, "acceleration_rad_s2": 20.0}
HALF: Final = ["1", "2", "3", "1a", "4", "5", "6", "7", "8", "9", "13"]
SHIPPED: Final = (
    "demo", "tactical-fog", "industrial-mems", "consumer-mems", "navigation-rlg", "noise-free", "robustness",
    "free-mems",
)  # fmt: skip
SCENARIOS: Final[dict[str, dict[str, Any]]] = {
    "free tactical": {"seed": 31, "free": {"turns": 24, "dwell_s": 6.0}},
    "half of Table 1": {"seed": 32, "schedule": {**QUICK, "sequences": HALF}},
    "repeated": {"seed": 33, "schedule": {**QUICK, "repeats": 2}},
    "g-sensitive": {
        "seed": 34, "schedule": QUICK,
        "imu": {"from": "consumer-mems", "noise": {"gyro_g_sensitivity_deg_per_h_per_g": 400.0}},
    },
    "two-axis table": {"seed": 35, "protocol": {"from": "two-axis-table"}},
    "19 positions, no fixture": {"seed": 36, "fixture": None, "protocol": {"from": "19-positions"}},
    "rate table": {"seed": 37, "fixture": None, "protocol": {"from": "rate-table"}},
    "six faces": {"seed": 38, "fixture": None, "protocol": {"from": "six-face-tumble"}},
    "hand-turned protocol": {
        "seed": 39, "fixture": None, "imu": {"from": "industrial-mems"}, "protocol": {"from": "hand-turned"},
    },
    "pulses": {
        "seed": 40, "schedule": QUICK, "recording": {"sample_rate_hz": 100.0, "kind": "increment"},
        "imu": {"from": "navigation-rlg", "noise": {"gyro_quantization_arcsec": 2.0}},
    },
    "large errors": {"seed": 41, "errors": {"draw": "uniform", "factor": 40.0}, "schedule": QUICK},
    "nothing stated": {
        "seed": 42, "site": {"from": "latitude-45", "state_latitude": False}, "schedule": QUICK,
        "fixture": {"from": "lab-1mrad", "state_heading": False}, "recording": {**SLOW, "state_noise": False},
    },
}  # fmt: skip
RECORDINGS: Final[dict[str, Callable[[], Recording]]] = {
    **{name: partial(shipped, name) for name in SHIPPED},
    "moves tactical": partial(moving, 21, "tactical"),
    "moves navigation": partial(moving, 22, "navigation"),
    "drift linear": partial(drifting_biases, 100, "linear", "4, 300"),
    "drift warm-up": partial(drifting_biases, 101, "warm-up", "10, 1000"),
    "drift random walk": partial(drifting_biases, 102, "random walk", "0.1, 10"),
    **{name: partial(simulated, tables) for name, tables in SCENARIOS.items()},
}
"""Recordings by name."""


def result(recording: Recording, estimator: str) -> dict[str, Any]:
    """Calibration as JSON values with its verdict in one word; the message of a refusal."""
    try:
        found = srt.calibrate(recording, estimator, checks=False)
    except srt.SrtError as error:
        return {"refused": str(error)}
    return {**found.to_dict(), "word": found.judgement.word, "reason": found.judgement.reason}


def difference(new: dict[str, Any], old: dict[str, Any]) -> tuple[float, float, str]:
    """Largest difference of a value in sigmas, largest relative difference of a sigma, and what else differs."""
    if "refused" in new or "refused" in old:
        messages = [one.get("refused", one.get("status")) for one in (old, new)]
        return 0.0, 0.0, "" if messages[0] == messages[1] else " -> ".join(map(str, messages))
    notes = [f"{key}: {old[key]} -> {new[key]}" for key in ("status", "word") if new[key] != old[key]]
    # The figures of a reason follow from the values, which a wide prior changes by a thousandth of a sigma.
    before, after = (_NUMBER.sub("#", one.get("reason", new["reason"])) for one in (old, new))
    notes += [f"{before} -> {after}"] if before != after else []
    values, sigmas = [0.0], [0.0]
    for row, before in zip(new["parameters"], old["parameters"], strict=True):
        if row["observed"] != before["observed"]:
            notes.append(f"{row['name']} observed: {before['observed']} -> {row['observed']}")
        elif row["observed"] and before["sigma"] > 0.0:
            values.append(abs(row["value"] - before["value"]) / before["sigma"])
            sigmas.append(abs(row["sigma"] / before["sigma"] - 1.0))
    return max(values), max(sigmas), "; ".join(notes)


def line(name: str, estimator: str, compared: tuple[float, float, str]) -> bool:
    """Print one comparison; True if there is no difference."""
    value, sigma, notes = compared
    same = value <= LARGEST and sigma <= LARGEST and not notes
    print(
        f"{name:28s} {estimator:14s} {value:9.1e} sigma {sigma:9.1e}  {'' if same else 'DIFFERS '}{notes}", flush=True
    )
    return same


def main(
    *,
    estimators: tuple[str, ...] = ("closed-form", "ekf", "graph"),
    recordings: tuple[str, ...] = tuple(RECORDINGS),
    write: Path | None = None,
    against: Path | None = None,
    same: tuple[str, ...] = (),
) -> int:
    """Write or compare the results."""
    good = True
    for name in recordings:
        recording = RECORDINGS[name]()
        if same:
            new, old = (result(recording, estimator) for estimator in same)
            good &= line(name, " = ".join(same), difference(new, old))
            continue
        for estimator in estimators:
            found, file = result(recording, estimator), f"{name.replace(' ', '-')}.{estimator}.json"
            if write is not None:
                write.mkdir(parents=True, exist_ok=True)
                (write / file).write_text(json.dumps(found), encoding="utf-8")
            if against is not None:
                old = json.loads((against / file).read_text(encoding="utf-8"))
                good &= line(name, estimator, difference(found, old))
    return 0 if good else 1


if __name__ == "__main__":
    harness.run(main, __doc__, recordings=RECORDINGS)
