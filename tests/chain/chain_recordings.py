"""Recordings of the chain tests by name, of generators that share nothing with the simulator or the estimators.

Rests of 3 s and turns at 2.5 rad/s at 50 Hz: all errors are observed, and a recording takes a tenth of a second.
"""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from foreign_fixture import Motion, by_protocol, on_fixture, table_1, write
from foreign_motion import DEG, GRADES, GRAVITY_M_S2, START_DEG, Grade, Rotation, drawn_errors, drift_course, hand_turns
from numpy.random import Generator

Samples = dict[str, np.ndarray]
Tables = dict[str, dict[str, Any]]

SEED = 20261126
REST_S, RATE_RAD_S, SIGMA_RAD, HZ = 3.0, 2.5, 1e-3, 50.0
CLEAR_S = 0.1
"""Left out of the labelled windows next to a turn, s."""
PROTOCOLS = Path(__file__).parents[2] / "configs" / "protocol"
ALL = ("closed-form", "least-squares", "ekf", "graph")
JOINT = ALL[1:]
"""Estimators of recordings without a fixture: the closed form needs Table 1 on one."""


def noise_alone(grade: Grade) -> Tables:
    """White noise of a grade, and no bias instability."""
    return {
        "imu": {
            "gyro_noise_deg_per_sqrt_h": grade.gyro_rad_per_sqrt_s / DEG * 60.0,
            "accel_noise_ug_per_sqrt_hz": grade.accel_m_s2_sqrt_s / 9.80665e-6,
            "gyro_bias_instability_deg_per_h": 0.0,
            "accel_bias_instability_ug": 0.0,
        }
    }


def fixture_and_noise(grade: Grade) -> Tables:
    """Noise, and the sigmas of the fixture."""
    sigma_mrad = 1e3 * SIGMA_RAD
    return noise_alone(grade) | {
        "fixture": {"heading_deg": 0.0, "alignment_sigma_mrad": sigma_mrad, "rotation_sigma_mrad": sigma_mrad}
    }


def bare_fixture(grade: Grade) -> Tables:
    """A fixture without heading and sigmas, at an unknown latitude; no noise."""
    return bare(grade) | {"fixture": {}}


def bare(grade: Grade) -> Tables:
    """Gravity alone."""
    return {"site": {"gravity_m_s2": GRAVITY_M_S2}}


def fixture_motion(rng: Generator, without: tuple[str, ...] = ()) -> Motion:
    ids = [name for name in table_1() if name not in without]
    return on_fixture(ids, rng, rest_s=REST_S, rate_rad_s=RATE_RAD_S, sigma_rad=SIGMA_RAD)


def hand_motion(rng: Generator) -> Motion:
    turns = hand_turns(rng, shortest_s=1.0, longest_s=4.0, rest_s=REST_S)
    return Motion(Rotation.from_euler("ZYX", START_DEG, degrees=True), 4.0, turns)


def protocol_motion(name: str, rng: Generator) -> Motion:
    document = tomllib.loads((PROTOCOLS / f"{name}.toml").read_text(encoding="utf-8"))
    rate_error = rng.normal(0.0, 1e-6 * document.get("rate_sigma_ppm", 0.0))
    return by_protocol(document, rng, rest_s=REST_S, rate_rad_s=1.5, rate_error=rate_error)


def joined(samples: Samples, tables: Tables, motion: Motion, rng: Generator) -> None:
    """Recordings of single sequences, joined: the moves were not recorded."""
    kept = motion.without_moves(samples["time"])
    samples |= {name: values[kept] for name, values in samples.items()}


def pulses(samples: Samples, tables: Tables, motion: Motion, rng: Generator) -> None:
    """Increments in whole pulses of 0.5 arcsec and 10 µm/s."""
    dt = samples["time"][0]
    for name, quantum in (("gyro", 0.5 / 3600.0 * DEG), ("accel", 1e-5)):
        total = np.floor(np.cumsum(dt * samples[name], axis=0) / quantum + rng.uniform(size=3))
        samples[name] = quantum * np.diff(total, axis=0, prepend=0.0)
    tables["recording"] = {"kind": "increment", "gyro_unit": "rad", "accel_unit": "m/s"}
    tables["imu"] |= {"gyro_quantization_arcsec": 0.5, "accel_quantization_m_s": 1e-5}


def counts(samples: Samples, tables: Tables, motion: Motion, rng: Generator) -> None:
    """Counts of 16 bits at 250°/s and 2 g, with an offset of the converter."""
    offset, units = 12, {"gyro": DEG / 131.0, "accel": 9.80665 / 16384.0}
    for name, lsb in units.items():
        samples[name] = np.round(samples[name] / lsb) + offset
    tables["recording"] = {
        key: value
        for name, lsb in units.items()
        for key, value in ((f"{name}_unit", "counts"), (f"{name}_lsb", lsb), (f"{name}_offset_counts", offset))
    }


def drift(samples: Samples, tables: Tables, motion: Motion, rng: Generator, *, accel_mg: float, gyro_deg_h: float):
    """Linear drift of both triads in a random direction of the channels; zero on average at rest."""
    course = drift_course("linear", samples["time"], motion.rests(), rng)[:, None]
    for name, size in (("accel", accel_mg * 9.80665e-3), ("gyro", gyro_deg_h * DEG / 3600.0)):
        direction = rng.normal(size=3)
        samples[name] = samples[name] + size * course * direction / np.linalg.norm(direction)


def in_accel_axes(errors: dict[str, float]) -> dict[str, float]:
    """Scales and misalignments in axes with x along accelerometer x and y in the plane of x and y."""
    pairs = [(i, j, a + b) for i, a in enumerate("xyz") for j, b in enumerate("xyz") if i != j]
    matrix = np.eye(3) + np.diag([errors[f"accel_scale_{a}"] for a in "xyz"])
    for i, j, pair in pairs:
        matrix[i, j] = errors[f"accel_misalignment_{pair}"]
    # M = L Q with a rotation Q; the columns of the decomposition have any sign.
    lower = np.linalg.qr(matrix.T)[1].T
    lower = lower * np.sign(np.diag(lower))
    return {f"accel_scale_{a}": lower[i, i] - 1.0 for i, a in enumerate("xyz")} | {
        f"accel_misalignment_{pair}": lower[i, j] for i, j, pair in pairs
    }


@dataclass(frozen=True)
class Case:
    """One recording of the chain.

    ``known``: the stated noise is all that there is, so that NEES has its chi-square distribution on both sides.
    ``accel_axes``: poses alone, whose result is in the axes of the accelerometers.
    """

    motion: Callable[[Generator], Motion]
    grade: str
    estimators: tuple[str, ...] = ALL
    effects: tuple[Callable[..., None], ...] = ()
    tables: Callable[[Grade], Tables] = fixture_and_noise
    keys: dict[str, Any] | None = None
    labelled: bool = True
    known: bool = True
    hz: float = HZ
    profile: str = "raised-cosine"
    ending: str = "npz"
    accel_axes: bool = False

    def make(self, name: str, folder: Path) -> np.ndarray:
        """Write the recording; give the true errors, shape (27,), in the order of ``srt.NAMES``."""
        import srt

        rng = np.random.default_rng((SEED, crc32(name.encode())))
        grade, motion = GRADES[self.grade], self.motion(rng)
        errors = drawn_errors(grade, rng)
        samples = motion.sampled(errors, grade, rng, hz=self.hz, profile=self.profile)
        tables = self.tables(grade)
        for effect in self.effects:
            effect(samples, tables, motion, rng)
        tables["recording"] = {"serial": name, **tables.get("recording", {}), **(self.keys or {})}
        write(folder, samples, tables, motion.labels(CLEAR_S) if self.labelled else (), ending=self.ending)
        if self.accel_axes:
            errors |= in_accel_axes(errors)
        return np.array([errors[each] for each in srt.NAMES])


def _protocol(name: str) -> Case:
    profile = "constant-rate" if name == "rate-table" else "raised-cosine"
    return Case(
        partial(protocol_motion, name), "tactical", JOINT, tables=noise_alone, keys={"protocol": name}, labelled=False,
        profile=profile, accel_axes=name.endswith("face-tumble"),
    )  # fmt: skip


CASES = {
    "moves": Case(fixture_motion, "navigation"),
    "missing": Case(partial(fixture_motion, without=("6", "9")), "tactical"),
    "joined-missing": Case(partial(fixture_motion, without=("6", "9")), "tactical", effects=(joined,)),
    "unlabelled": Case(fixture_motion, "tactical", labelled=False, ending="csv"),
    "nothing-stated": Case(fixture_motion, "navigation", tables=bare_fixture, known=False),
    "pulses": Case(fixture_motion, "navigation", effects=(pulses,), hz=200.0),
    "counts": Case(
        fixture_motion, "consumer", effects=(joined, counts), tables=bare_fixture, known=False, ending="csv"
    ),
    # The closed form does not estimate drift: it says so, and its status is inconsistent.
    "drift": Case(
        fixture_motion, "tactical", JOINT, (partial(drift, accel_mg=1.0, gyro_deg_h=10.0),), known=False
    ),
    "hand-turned": Case(hand_motion, "tactical", JOINT, tables=noise_alone, labelled=False),
    "hand-turned-unstated": Case(
        hand_motion, "consumer", JOINT, tables=bare, labelled=False, known=False, profile="hand"
    ),
    # The Kalman filter and the graph do not estimate drift without a fixture: their sigmas are too small.
    "hand-turned-drift": Case(
        hand_motion, "industrial", ("least-squares",), (partial(drift, accel_mg=2.0, gyro_deg_h=100.0),),
        tables=noise_alone, labelled=False, known=False,
    ),
    **{f"protocol-{path.stem}": _protocol(path.stem) for path in sorted(PROTOCOLS.glob("*.toml"))},
}  # fmt: skip
"""Recordings by name. Without labels the tables of poses and turns are found, or given by the protocol."""
