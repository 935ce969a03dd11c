"""Tests on a two-axis fixture and by the steps of protocols, written as folders of recordings.

A fixture with errors, or a hand, executes the turns; their motion and the readings are those of ``foreign_motion.py``.
Nothing is shared with the simulator or the estimators.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from foreign_motion import DEG, GRAVITY_M_S2, Grade, Turn, motion_samples, readings, windows
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    import srt

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
        motion = self.turns, self.start, self.first_rest_s
        rate, force = motion_samples(*motion, dt, LATITUDE_DEG * DEG, profile, rng)
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

    def recording(
        self,
        errors: dict[str, float],
        grade: Grade,
        rng,
        *,
        hz: float = 50.0,
        profile: str = "raised-cosine",
        stated_rad: float = 1e-3,
        noise: srt.ImuNoise | None = None,
        recorded: Iterable[str] = (),
    ) -> srt.Recording:
        """Labelled recording on a fixture whose accuracy is ``stated_rad``; of the sequences ``recorded``, or all."""
        import srt

        samples = self.sampled(errors, grade, rng, hz=hz, profile=profile)
        labels = tuple(
            srt.SequenceLabel(tuple(row["start_static_s"]), tuple(row["end_static_s"]), id=row["id"])
            for row in self.labels(0.1)
            if not recorded or row["id"] in recorded
        )
        site, fixture = (
            srt.Site(GRAVITY_M_S2, latitude_rad=LATITUDE_DEG * DEG),
            srt.Fixture(0.0, stated_rad, stated_rad),
        )
        read = samples["time"], samples["gyro"], samples["accel"]
        return srt.Recording(*read, site, fixture=fixture, sequences=labels, noise=noise or srt.ImuNoise())

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
