"""Tests on a two-axis fixture and by the steps of protocols, written as folders of recordings.

A fixture with errors, or a hand, executes the turns; their motion and the readings are those of ``foreign_motion.py``.
Nothing is shared with the simulator or the estimators.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from foreign_motion import DEG, GRADES, GRAVITY_M_S2, Grade, Turn, attitudes, readings, true_samples, windows
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

LATITUDE_DEG = 34.0
COLUMNS = ("time", *(f"{sensor}_{a}" for sensor in ("gyro", "accel") for a in "xyz"))

TABLE_1 = """
1  z/y +360y
2  z/x +360x
3  x/y +360z
1a z/y -360y
2a z/x -360x
3a x/y -360z
4  z/y +180y +180z +180y +180z
5  z/x +180x +180z +180x +180z
6  x/y +180y +90z +180x +90z +180y +90z +180x +90z
7  y/x +180x
8  z/x +180x
9  x/y +180z
10 y/x +180z
11 z/y +180y
12 x/y +180y
13 z/y +180z +180y
14 z/x +180z +180x
"""
"""Table 1 of Savage 2020: IMU axes down and along the outer axis at the start, then angles in deg and IMU axes."""

_START_DEG = {"z/y": (0.0, 0.0), "z/x": (0.0, 90.0), "x/y": (-90.0, 0.0), "y/x": (90.0, 90.0)}
"""Outer and inner angle at the start of a sequence: the body axes reach the base by the inner, then the outer one."""

EYE = np.eye(3)


@dataclass(frozen=True)
class Motion:
    """Turns of a test with the rests between them.

    ``sequences`` holds an id and the indices of the first and last turn; the rest before the first and the rest after
    the last are the stationary windows. ``moves`` holds the indices of turns that belong to no sequence.
    """

    start: Rotation
    first_rest_s: float
    turns: list[Turn]
    sequences: tuple[tuple[str, int, int], ...] = ()
    moves: frozenset[int] = frozenset()

    def sampled(
        self, errors: dict[str, float], grade: Grade | None, rng, *, hz: float = 50.0, profile: str = "raised-cosine"
    ) -> dict[str, np.ndarray]:
        """Columns of rates as the unit reads them, SI: time (n,), gyro and accel (n, 3)."""
        dt = 1.0 / hz
        body = attitudes(self.turns, self.start, self.first_rest_s, dt, profile, rng)
        rate, force = true_samples(body, dt, LATITUDE_DEG * DEG)
        gyro, accel = readings(rate, force, errors, grade, dt, rng)
        return {"time": dt * np.arange(1, len(gyro) + 1), "gyro": gyro, "accel": accel}

    def rests(self) -> list[tuple[float, float]]:
        """Rest before each turn and after the last one, s."""
        return windows(self.turns, self.first_rest_s)

    def labels(self, clear_s: float) -> list[dict[str, Any]]:
        """Sequences as recording.toml states them; ``clear_s`` is left out next to the turns."""
        rests = [[round(a + clear_s, 6), round(b - clear_s, 6)] for a, b in self.rests()]
        return [
            {"id": name, "start_static_s": rests[first], "end_static_s": rests[last + 1]}
            for name, first, last in self.sequences
        ]

    def without_moves(self, time: np.ndarray) -> np.ndarray:
        """True for the samples outside of the moves, shape (n,)."""
        rests = self.rests()
        return ~np.any([(time > rests[i][1]) & (time <= rests[i + 1][0]) for i in self.moves], axis=0)


def table_1() -> dict[str, tuple[str, list[tuple[str, float]]]]:
    """Sequences of Table 1: start, and IMU axes with angles in rad."""
    rows = (row.split() for row in TABLE_1.strip().splitlines())
    return {name: (start, [(t[-1], float(t[:-1]) * DEG) for t in turns]) for name, start, *turns in rows}


def on_fixture(
    ids: Iterable[str],
    rng,
    *,
    rest_s: float,
    rate_rad_s: float,
    sigma_rad: float,
    alignment_rad: float | None = None,
    wobble_rad: float | None = None,
) -> Motion:
    """Sequences of Table 1 on a two-axis fixture: outer axis along y of a level base, inner axis along z of the unit.

    Level, north, mounting and the angle between the axes have one error each, every rotation and start angle has its
    own, all of ``sigma_rad``, or the former of ``alignment_rad``; the axis wobble is a hundredth of ``sigma_rad``, or
    ``wobble_rad``. A move takes the shortest way.
    """
    alignment_rad = sigma_rad if alignment_rad is None else alignment_rad
    wobble_rad = 0.01 * sigma_rad if wobble_rad is None else wobble_rad
    base, mount = (Rotation.from_rotvec(rng.normal(0.0, alignment_rad, 3)) for _ in range(2))
    square = rng.normal(0.0, alignment_rad)
    attitude: Rotation | None = None
    turns: list[Turn] = []
    sequences, moves = [], set()
    for name in ids:
        start, rotations = table_1()[name]
        nominal = np.array(_START_DEG[start]) * DEG
        outer, inner = nominal + rng.normal(0.0, sigma_rad, 2)
        tilt = Rotation.from_rotvec((square + rng.normal(0.0, wobble_rad)) * EYE[0])
        placed = base * Rotation.from_rotvec(outer * EYE[1]) * tilt * Rotation.from_rotvec(inner * EYE[2]) * mount
        if attitude is None:
            first = placed
        else:
            moves.add(len(turns))
            turns.append(_shortest(attitude, placed, rate_rad_s, rest_s))
        attitude, begin = placed, len(turns)
        level = Rotation.from_euler("YZ", nominal)
        for letter, angle in rotations:
            axis, true_angle = EYE["xyz".index(letter)], angle + rng.normal(0.0, sigma_rad)
            if letter == "z":
                along = mount.inv().apply(axis)
                inner += true_angle
            else:
                below = tilt * Rotation.from_rotvec(inner * EYE[2]) * mount
                along = np.sign(level.apply(axis)[1]) * below.inv().apply(EYE[1])
            attitude = attitude * Rotation.from_rotvec(true_angle * along)
            level = level * Rotation.from_rotvec(angle * axis)
            turns.append(Turn(tuple(along), true_angle, _duration(true_angle, rate_rad_s), 0.2))
        turns[-1] = Turn(turns[-1].axis, turns[-1].angle_rad, turns[-1].duration_s, rest_s)
        sequences.append((name, begin, len(turns) - 1))
    return Motion(first, rest_s, turns, tuple(sequences), frozenset(moves))


def by_protocol(document: dict[str, Any], rng, *, rest_s: float, rate_rad_s: float, rate_error: float = 0.0) -> Motion:
    """Steps of a protocol as a hand executes them, from the tables of its file.

    Rests and durations are given here, as the estimators need angles alone; a stated rate is kept, with the relative
    error of the table, and is that of the profile "constant-rate". Poses are placed to 1°, turns to 0.5°.
    """
    attitude: Rotation | None = None
    turns: list[Turn] = []
    for step in document["step"]:
        rotations = [(_vector(axis), angle * DEG) for axis, angle in step.get("rotations", ())]
        down, outer = step.get("down"), step.get("along_outer")
        if "id" in step:
            start, named = table_1()[step["id"]]
            down, outer = start.split("/")
            rotations = [(_vector(axis), angle) for axis, angle in named]
        for _ in range(step.get("repeat", 1)):
            if down is not None:
                placed = _pose(down, outer) * Rotation.from_rotvec(rng.normal(0.0, 1.0 * DEG, 3))
                if attitude is None:
                    first = placed
                else:
                    turns.append(_shortest(attitude, placed, rate_rad_s, rest_s))
                attitude = placed
            for i, (axis, angle) in enumerate(rotations):
                stated = step.get("stated_rate_deg_s")
                true_angle, along = angle + rng.normal(0.0, 0.5 * DEG), axis + rng.normal(0.0, 0.5 * DEG, 3)
                seconds = (
                    _duration(angle, rate_rad_s)
                    if stated is None
                    else abs(true_angle) / (stated * DEG * (1.0 + rate_error))
                )
                rest = rest_s if i == len(rotations) - 1 else 0.2
                turns.append(Turn(tuple(along), true_angle, seconds, rest))
                attitude = attitude * Rotation.from_rotvec(true_angle * along / np.linalg.norm(along))
    return Motion(first, rest_s, turns)


def _vector(direction: str | list[float]) -> np.ndarray:
    """Unit vector of a signed axis or of three numbers."""
    if isinstance(direction, str):
        return (-1.0 if direction[0] == "-" else 1.0) * EYE["xyz".index(direction[-1])]
    return np.array(direction) / np.linalg.norm(direction)


def _pose(down: str | list[float], outer: str | None) -> Rotation:
    """Attitude with one IMU direction down, and another to the east where it is stated."""
    below = _vector(down)
    across = np.cross(below, EYE[int(np.argmin(np.abs(below)))]) if outer is None else _vector(outer)
    across = across / np.linalg.norm(across)
    return Rotation.from_matrix(np.stack([np.cross(across, below), across, below]))


def _shortest(before: Rotation, after: Rotation, rate_rad_s: float, rest_s: float) -> Turn:
    vector = (before.inv() * after).as_rotvec()
    angle = float(np.linalg.norm(vector))
    return Turn(tuple(vector / angle), angle, _duration(angle, rate_rad_s), rest_s)


def _duration(angle_rad: float, rate_rad_s: float) -> float:
    """Duration of a turn at this mean rate, at least half a second."""
    return max(abs(angle_rad) / rate_rad_s, 0.5)


@dataclass
class Trial:
    """Recording in the making: readings (n, 3) in SI units, true rests and labels in s, statements, and true errors."""

    grade: str
    motion: Motion
    fixture: bool
    labelled: bool
    stated: bool
    dt: float
    rng: np.random.Generator
    noise_seed: tuple[int, ...]
    errors: dict[str, float]
    rate: np.ndarray = field(default_factory=lambda: np.zeros(0))
    force: np.ndarray = field(default_factory=lambda: np.zeros(0))
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))
    gyro: np.ndarray = field(default_factory=lambda: np.zeros(0))
    accel: np.ndarray = field(default_factory=lambda: np.zeros(0))
    labels: list[dict] = field(default_factory=list)
    gravity: float = GRAVITY_M_S2
    latitude_deg: float = LATITUDE_DEG
    noise_factor: float = 1.0
    moved: str = "none"

    @property
    def unit(self) -> Grade:
        return GRADES[self.grade]

    @property
    def sample_noise(self) -> tuple[float, float]:
        """Standard deviation of a sample of gyros and accelerometers."""
        root = math.sqrt(self.dt)
        return self.unit.gyro_rad_per_sqrt_s / root, self.unit.accel_m_s2_sqrt_s / root

    def read(self, errors: dict[str, float] | None = None) -> None:
        """Make the readings of the true motion."""
        rng = np.random.default_rng(self.noise_seed)
        self.gyro, self.accel = readings(self.rate, self.force, errors or self.errors, self.unit, self.dt, rng)
        self.time = self.dt * np.arange(1, len(self.gyro) + 1)
        self.labels = self.motion.labels(0.1) if self.labelled else []

    def table(self, sensor: int) -> np.ndarray:
        return (self.gyro, self.accel)[sensor]

    def an_axis(self) -> int:
        return int(self.rng.integers(3))

    def a_sign(self) -> float:
        return float(self.rng.choice([-1.0, 1.0]))

    def a_direction(self) -> np.ndarray:
        vector = self.rng.normal(size=3)
        return vector / np.linalg.norm(vector)

    def edges(self) -> np.ndarray:
        """Edges of the samples, s."""
        return self.dt * np.arange(len(self.force) + 1)

    def a_turn(self) -> tuple[int, int]:
        """First and last sample of a turn of a sequence of more than half a second."""
        rests, moves = self.motion.rests(), self.motion.moves
        turns = [(rests[i][1], rests[i + 1][0]) for i in range(len(rests) - 1) if i not in moves]
        a, b = turns[int(self.rng.integers(len(turns)))]
        return int(a / self.dt) + 2, int(b / self.dt) - 2

    def a_rest(self) -> tuple[int, int]:
        """First and last sample of a rest next to a sequence, of more than 2 s."""
        rests = [r for r in self.motion.rests() if r[1] - r[0] > 2.0]
        a, b = rests[int(self.rng.integers(len(rests)))]
        return int(a / self.dt) + 6, int(b / self.dt) - 6

    def without(self, gone: np.ndarray, *, renumbered: bool, by_count: bool) -> None:
        """Lose samples; renumbered stamps have no gap, as they come from the count of samples, and so do the labels."""
        keep = ~gone
        if by_count:
            for label in self.labels:
                for key in ("start_static_s", "end_static_s"):
                    label[key] = [t - self.dt * int(gone[: round(t / self.dt)].sum()) for t in label[key]]
        self.gyro, self.accel = self.gyro[keep], self.accel[keep]
        self.time = self.dt * np.arange(1, keep.sum() + 1) if renumbered else self.time[keep]

    def recording(self):
        import srt

        labels = tuple(
            srt.SequenceLabel(tuple(row["start_static_s"]), tuple(row["end_static_s"]), id=row["id"])
            for row in self.labels
        )
        white, k = self.unit, self.noise_factor
        stated = (k * white.gyro_rad_per_sqrt_s, k * white.accel_m_s2_sqrt_s) if self.stated else ()
        return srt.Recording(
            self.time,
            self.gyro,
            self.accel,
            srt.Site(self.gravity, latitude_rad=self.latitude_deg * DEG),
            fixture=srt.Fixture(0.0, 1e-3, 1e-3) if self.fixture else None,
            sequences=labels,
            noise=srt.ImuNoise(*stated),
        )


def write(folder: Path, samples: dict[str, np.ndarray], tables: dict[str, dict[str, Any]], labels=(), *, ending="npz"):
    """Write a recording: the samples as .npz or .csv, tables and labels as recording.toml."""
    folder.mkdir(parents=True)
    table = np.column_stack([samples["time"], samples["gyro"], samples["accel"]])
    if ending == "csv":
        np.savetxt(folder / "samples.csv", table, "%.12g", ",", header=",".join(COLUMNS), comments="")
    else:
        np.savez(folder / "samples.npz", **dict(zip(COLUMNS, table.T, strict=True)))
    recording = {"samples": f"samples.{ending}", "gyro_unit": "rad/s", "accel_unit": "m/s^2"}
    site = {"gravity_m_s2": GRAVITY_M_S2, "latitude_deg": LATITUDE_DEG}
    parts = {"recording": recording, "site": site, **tables}
    parts["recording"] = recording | tables.get("recording", {})
    text = [_section(f"[{name}]", keys) for name, keys in parts.items()]
    text += [_section("[[sequence]]", label) for label in labels]
    (folder / "recording.toml").write_text("\n".join(text), encoding="utf-8")


def _section(head: str, keys: dict[str, Any]) -> str:
    lines = (f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}" for key, value in keys.items())
    return "\n".join([head, *lines, ""])
