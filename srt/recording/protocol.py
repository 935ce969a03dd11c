"""Protocols: the poses and turns of a calibration test, as TOML files.

A protocol is a list of steps. A step places the unit in a pose, or continues from the pose before; it may then rotate
the unit, and the unit rests. Angles are nominal: the estimators measure what was turned. Keys of the file::

    description = "..."
    rate_deg_s = 60.0            # peak rate of a turn
    acceleration_deg_s2 = 300.0
    rest_s = 10.0                # stationary window; a pair is [before, after] a turn
    place_s = 5.0                # to place the unit in a pose
    rate_sigma_ppm = 50.0        # of the stated rates, one error for all
    [[step]]
    id = "1"                     # a sequence of Table 1, or:
    down = "-x"                  # IMU axis (or vector) that points down; without it, the step continues
    along_outer = "y"            # IMU axis along the outer axis of a two-axis fixture
    rotations = [["y", 90.0], [[0.6, 0.8, 0.0], -120.0]]   # IMU axis and angle in degrees; none: a pose
    turn_s = 9.0                 # duration of the rotations with smooth ends, in place of rate_deg_s
    stated_rate_deg_s = 100.0    # constant rate that a rate table states; its sign is that of the angle
    rest_s, rate_deg_s           # of this step
    repeat = 3
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import DEG
from srt.exceptions import InputError, did_you_mean
from srt.model.rotations import rotation_matrix
from srt.model.table1 import AXES, SEQUENCES, SIGNED_AXES, axis_vector
from srt.recording.schema import (
    LARGEST_PPM,
    LARGEST_RATE_DEG_S,
    LARGEST_TIME_S,
    Key,
    finite_numbers,
    number,
    read_fields,
    text,
    whole,
)
from srt.recording.toml_text import read_toml

if TYPE_CHECKING:
    from srt.types import Array

_Executed = tuple[str, str, tuple[tuple[str, float], ...]]
_MOST_STEPS: Final = 1000  # largest number of steps of a protocol: no test has more, and a wrong ``repeat`` ends here
_ALONG: Final = 1e-6  # largest deviation of a nominal direction from an IMU axis, rad


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One step of a protocol."""

    number: int  # position in the file, from 1; repeats have the same
    rotations: tuple[tuple[Array, float], ...]  # unit vector in IMU axes, shape (3,), and angle, rad
    rest_s: tuple[float, float]  # before and after the rotations; a pose and a step that continues have the second
    rate_rad_s: float  # peak of the rotations
    acceleration_rad_s2: float
    id: str | None = None  # sequence of Table 1
    down: Array | None = None  # vertical in the pose that the unit is placed in, IMU axes, shape (3,); None: continues
    along_outer: str | None = None  # IMU axis along the outer axis of a fixture, as "y" or "-x"
    turn_s: float | None = None  # duration of all rotations, with smooth ends, in place of rate and acceleration
    stated_rate_rad_s: float | None = None  # constant rate that a rate table states, with the sign of the angle

    @property
    def pose(self) -> bool:
        """True if the step does not rotate the unit."""
        return not self.rotations

    def durations_s(self) -> tuple[float, ...]:
        """Duration of each rotation, s."""
        angles = [abs(angle) for _, angle in self.rotations]
        if self.turn_s is not None:
            return tuple(self.turn_s * angle / sum(angles) for angle in angles)
        ramp = self.rate_rad_s / self.acceleration_rad_s2
        short = self.rate_rad_s * ramp
        return tuple(
            angle / self.rate_rad_s + ramp if angle > short else 2.0 * math.sqrt(angle / self.acceleration_rad_s2)
            for angle in angles
        )

    def turned(self) -> Array:
        """Nominal rotation, components after to before, shape (3, 3)."""
        C = np.eye(3)
        for axis, angle in self.rotations:
            C = C @ rotation_matrix(axis * angle)
        return C

    def described(self) -> str:
        """Words of a step, as "turn +90° about y"."""
        if self.pose:
            return f"pose with {_direction(self.down)} down"
        turns = [f"{angle / DEG:+.6g}° about {_direction(axis)}" for axis, angle in self.rotations]
        return f"{'turn' if len(turns) == 1 else 'turns'} {', '.join(turns)}"


@dataclass(frozen=True, slots=True, eq=False)
class Protocol:
    """Poses and turns of a test."""

    name: str  # of a shipped protocol, or path of a file
    description: str
    steps: tuple[Step, ...]  # repeats written out
    place_s: float  # time to place the unit in a pose
    rate_sigma: float | None = None  # 1-sigma relative error of the stated rates

    @property
    def total_s(self) -> float:
        """Duration of the test: placing, rests and turns, s."""
        return self._rests_s() + self._others_s()

    def _rests_s(self) -> float:
        return sum(sum(s.rest_s) if s.down is not None and not s.pose else s.rest_s[1] for s in self.steps)

    def _others_s(self) -> float:
        placed = sum(s.down is not None for s in self.steps)
        return placed * self.place_s + sum(sum(s.durations_s()) for s in self.steps)

    def lasting(self, total_s: float) -> Protocol:
        """Protocol with all rests scaled to this duration of the test. Raises InputError if the turns last longer."""
        left = total_s - self._others_s()
        if left <= 0.0:
            raise InputError(
                f"The turns and placings of protocol {self.name!r} last {self._others_s():.0f} s, which leaves no rest "
                f"in {total_s:g} s: give more time."
            )
        factor = left / self._rests_s()
        return replace(
            self, steps=tuple(replace(s, rest_s=(s.rest_s[0] * factor, s.rest_s[1] * factor)) for s in self.steps)
        )

    @property
    def states_attitudes(self) -> bool:
        """True if every placing states the IMU axis along the outer axis, so that attitudes on a fixture are known."""
        return all(step.along_outer is not None for step in self.steps if step.down is not None)

    def on_fixture(self) -> tuple[_Executed, ...]:
        """Steps as a two-axis fixture executes them: IMU axes down and along the outer axis, and rotations (rad).

        Where a placing does not state the axis along the outer axis, it is one with which the fixture can execute the
        steps up to the next placing. Raises InputError: which step the fixture cannot execute, and why.
        """
        placings = [number for number, step in enumerate(self.steps) if step.down is not None]
        chains = [self.steps[first:last] for first, last in pairwise([*placings, len(self.steps)])]
        return tuple(executed for chain in chains for executed in self._chain_on_fixture(chain))

    def _chain_on_fixture(self, chain: tuple[Step, ...]) -> list[_Executed]:
        """Steps from a placing to the last one before the next."""
        placed, refused = chain[0], None
        down = None if placed.down is None else _axis_name(placed.down)
        if down is None:
            raise self._impossible(placed, "down is not an IMU axis, and the fixture's angles are quarter turns there")
        # The opposite sense of an axis turns the fixture by half a turn, and makes nothing possible.
        for outer in [placed.along_outer] if placed.along_outer else [axis for axis in "yx" if axis != down[-1]]:
            try:
                return self._executed(chain, down, outer)
            except InputError as error:
                refused = refused or error
        assert refused is not None
        raise refused

    def _executed(self, chain: tuple[Step, ...], down: str, outer: str) -> list[_Executed]:
        """Steps of a chain from the attitude with one IMU axis down, and another along the outer axis."""
        if outer[-1] in (down[-1], "z"):
            raise self._impossible(
                chain[0],
                f"{outer} cannot be along the outer axis: z is the inner axis"
                + ("" if outer[-1] == "z" else f", and {down[-1]} is vertical"),
            )
        u, along = axis_vector(down), axis_vector(outer)
        C = np.stack([np.cross(along, u), along, u])  # IMU to fixture base: rows are x, the outer axis y, and down
        out = []
        for step in chain:
            names = _axis_name(C[2]), _axis_name(C[1])
            if names[0] is None or names[1] is None:
                raise self._impossible(step, "no IMU axis is down, or none lies along the outer axis")
            rotations = []
            for axis, angle in step.rotations:
                name = _axis_name(axis)
                if name is None:
                    raise self._impossible(step, "it turns about an axis between those of the IMU")
                if name[-1] != "z" and abs(abs(float(C[1] @ axis)) - 1.0) > _ALONG:
                    raise self._impossible(
                        step, f"IMU {name[-1]} is then neither the inner axis, which is z, nor along the outer axis"
                    )
                rotations.append((name[-1], -angle if name.startswith("-") else angle))
                C = C @ rotation_matrix(axis * angle)
            out.append((names[0], names[1], tuple(rotations)))
        return out

    def _impossible(self, step: Step, why: str) -> InputError:
        return InputError(
            f"Step {step.number} of protocol {self.name!r} ({step.described()}) cannot run on a two-axis fixture: "
            f"{why}; correct the step, or leave [fixture] out."
        )


def _axis_name(vector: Array) -> str | None:
    """Signed IMU axis along a unit vector, None if it lies between axes."""
    i = int(np.argmax(np.abs(vector)))
    name = ("-" if vector[i] < 0.0 else "") + AXES[i]
    return None if abs(abs(float(vector[i])) - 1.0) > _ALONG else name


def _direction(vector: Array | None) -> str:
    if vector is None:
        return "the same axis"
    return _axis_name(vector) or "(" + ", ".join(f"{x:.3g}" for x in vector) + ")"


def _unit_vector(value: Any) -> Array:
    """IMU direction from a signed axis or three numbers; ValueError for anything else."""
    if isinstance(value, str) and value in SIGNED_AXES:
        return np.asarray(axis_vector(value))
    vector = np.array(finite_numbers(value, 3))
    size = float(np.linalg.norm(vector))
    if not (math.isfinite(size) and size > 0.0):
        raise ValueError
    return np.asarray(vector / size)


def _read_rotations(value: Any) -> tuple[tuple[Array, float], ...]:
    if not isinstance(value, list) or not value:
        raise ValueError
    out = []
    for item in value:
        if not isinstance(item, list) or len(item) != 2:
            raise ValueError
        (angle,) = finite_numbers(item[1:], 1, bool)
        out.append((_unit_vector(item[0]), angle * DEG))
    return tuple(out)


def _read_rests(value: Any) -> tuple[float, float]:
    before, after = finite_numbers(value if isinstance(value, list) else [value] * 2, 2, lambda v: v > 0.0)
    return before, after


_LARGEST_ACCELERATION_DEG_S2: Final = 1e9  # bound of accelerations, °/s²: the largest rate within a millisecond
_RATE: Final = number("rate_deg_s", "deg/s", "rate_rad_s", factor=DEG, above=0.0, high=LARGEST_RATE_DEG_S)
_RESTS: Final = Key("rest_s", "a positive number of seconds, or a pair [before, after]", _read_rests, "rest_s")
PROTOCOL_KEYS: Final = (
    text("description", "description"),
    _RATE,
    number(
        "acceleration_deg_s2", "deg/s²", "acceleration_rad_s2", factor=DEG, above=0.0, high=_LARGEST_ACCELERATION_DEG_S2
    ),
    _RESTS,
    number("place_s", "s", "place_s", low=0.0, high=LARGEST_TIME_S),
    number("rate_sigma_ppm", "ppm", "rate_sigma", factor=1e-6, low=1e-6, high=LARGEST_PPM),
)
STEP_KEYS: Final = (
    text("id", "id", tuple(SEQUENCES)),
    Key("down", 'an IMU axis like "-x", or a vector of three numbers', _unit_vector, "down"),
    text("along_outer", "along_outer", SIGNED_AXES),
    Key("rotations", 'a list like [["y", 90.0]] of axes and degrees, not zero', _read_rotations, "rotations"),
    _RESTS,
    _RATE,
    number("turn_s", "s", "turn_s", above=0.0, high=LARGEST_TIME_S),
    number("stated_rate_deg_s", "deg/s", "stated_rate_rad_s", factor=DEG, above=0.0, high=LARGEST_RATE_DEG_S),
    whole("repeat", "repeat", 1, _MOST_STEPS),
)
"""Keys of the file and of a [[step]]."""

_DEFAULTS: Final[dict[str, Any]] = {
    "description": "",
    "rate_rad_s": 60.0 * DEG,
    "acceleration_rad_s2": 300.0 * DEG,
    "rest_s": (10.0, 10.0),
    "place_s": 5.0,
    "rate_sigma": None,
}


def protocols_path() -> Path:
    """Find the shipped protocols: inside the installed package, or at the top of a checkout."""
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "protocols", package.parent / "configs" / "protocol"):
        if candidate.is_dir():
            return candidate
    raise InputError("The shipped protocols are missing from this installation: install the package again.")


def protocol_names() -> tuple[str, ...]:
    """Names of the shipped protocols, sorted."""
    return tuple(sorted(path.stem for path in protocols_path().glob("*.toml")))


def load_protocol(name_or_path: str | Path, *, near: Path | None = None) -> Protocol:
    """Read a protocol by its name among the shipped ones, or by the path of a TOML file, which ends in ".toml".

    A relative path starts from ``near``, by default the working directory. Raises InputError.
    """
    name = str(name_or_path)
    path = Path(name) if near is None else near / name
    if name.endswith(".toml"):
        name = str(path)
    else:
        known = protocol_names()
        if name not in known:
            raise InputError(
                f"There is no shipped protocol {name!r}{did_you_mean(name, known)}: the names are "
                f"{', '.join(known)}; a file of your own ends in .toml."
            )
        path = protocols_path() / f"{name}.toml"
    return protocol_from_dict(read_toml(path), name=name)


def protocol_from_dict(document: dict[str, Any], *, name: str) -> Protocol:
    """Build a protocol from tables as TOML gives them; see :func:`load_protocol`."""
    main = {key: value for key, value in document.items() if key != "step"}
    common = _DEFAULTS | read_fields(name, "the top level", main, PROTOCOL_KEYS)
    tables = document.get("step")
    if not isinstance(tables, list) or not tables:
        raise InputError(f"{name}: there is no step: add each as [[step]], in double brackets.")
    steps: list[Step] = []
    for count, table in enumerate(tables, start=1):
        given = read_fields(name, f"step[{count}]", table, STEP_KEYS)
        repeat = given.pop("repeat", 1)
        step = _step(name, count, given, common)
        if not steps and step.down is None:
            raise InputError(f"{name}: step[1] continues from no pose: give down, the IMU axis that points down.")
        steps += [step] * repeat
        if len(steps) > _MOST_STEPS:
            raise InputError(f"{name}: there are more than {_MOST_STEPS} steps: check repeat.")
    if common["rate_sigma"] is None and any(s.stated_rate_rad_s is not None for s in steps):
        raise InputError(f"{name}: rate_sigma_ppm, the 1-sigma error of the stated rates, is missing: add it.")
    return Protocol(name, common["description"], tuple(steps), common["place_s"], common["rate_sigma"])


def _step(name: str, count: int, given: dict[str, Any], common: dict[str, Any]) -> Step:
    """One step with the defaults of the file, checked."""
    where = f"{name}: step[{count}]"
    if "id" in given:
        extra = sorted(set(given) & {"down", "along_outer", "rotations"})
        if extra:
            raise InputError(f"{where}: Table 1 defines sequence {given['id']!r}: leave {', '.join(extra)} out.")
        sequence = SEQUENCES[given["id"]]
        given |= {
            "down": axis_vector(sequence.down),
            "along_outer": sequence.along_outer,
            "rotations": tuple(zip(sequence.axes, sequence.angles_rad.tolist(), strict=True)),
        }
    if "down" not in given and "rotations" not in given:
        raise InputError(f"{where} has neither down nor rotations: place the unit in a pose, or rotate it.")
    if "along_outer" in given and "down" not in given:
        raise InputError(f"{where} gives along_outer without down: give both, or neither.")
    rotations = given.get("rotations", ())
    stated = given.get("stated_rate_rad_s")
    if stated is not None:
        if len(rotations) != 1 or _axis_name(rotations[0][0]) is None or "turn_s" in given or "rate_rad_s" in given:
            raise InputError(
                f"{where}: a stated rate needs one rotation about an IMU axis, and neither turn_s nor rate_deg_s."
            )
        given |= {"rate_rad_s": stated, "stated_rate_rad_s": math.copysign(stated, rotations[0][1])}
    if not rotations and ("turn_s" in given or "rate_rad_s" in given):
        raise InputError(
            f"{where} is a pose, which has no turn_s and no rate_deg_s: give rotations, or leave them out."
        )
    if "turn_s" in given and "rate_rad_s" in given:
        raise InputError(f"{where}: give either turn_s or rate_deg_s.")
    usual = {key: common[key] for key in ("rest_s", "rate_rad_s", "acceleration_rad_s2")}
    step = Step(count, **({"rotations": (), **usual} | given))
    if stated is not None and sum(step.durations_s()) < 3.0 * stated / step.acceleration_rad_s2:
        raise InputError(
            f"{where}: the stated rate {stated / DEG:g}°/s lasts less than a third of the rotation: turn by a larger "
            "angle, or raise acceleration_deg_s2."
        )
    return step
