"""Signature of a sequence: coefficients of the sensor errors in its measured components (Savage 2020 [P], Table 2)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.model.table1 import AXES, SEQUENCES, SIGNED_AXES, RotationSequence
from srt.planning.candidates import from_catalogue
from srt.planning.information import COMPONENTS, Signatures
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SYMBOLS

if TYPE_CHECKING:
    from srt.planning.candidates import Candidate
    from srt.planning.conditions import Conditions
    from srt.planning.fixture_kinematics import FixtureKinematics

_TURN: Final = re.compile(r"([+-]?\d+)([xyz])$")
_ROUNDING: Final = 1e-9
"""Coefficient below which a term is rounding error; the others are of the order of one, or of seconds."""
_FORCE_ROWS: Final = 4
"""Components of specific force; the other rows are rates at rest, and show the gyro bias in every sequence."""


@dataclass(frozen=True, slots=True)
class SignatureRow:
    """Terms of one measured component.

    Attributes
    ----------
    component : str
        Name such as "horizontal x", in IMU axes at the start.
    terms : tuple of (str, float)
        Symbols and coefficients of the component over g. Accelerometer biases are in g; the coefficients of gyro biases
        are in s.
    """

    component: str
    terms: tuple[tuple[str, float], ...]


def parse_sequence(text: str, fixture: FixtureKinematics) -> Candidate:
    """Read a sequence in the notation of plans, ``z/y +180y +180z``, or the id of a sequence of Table 1.

    Raises
    ------
    InputError
        A text that is not a sequence, or a sequence that the fixture cannot execute; the message names the rotation.
    """
    if text in SEQUENCES:
        return from_catalogue(SEQUENCES[text], fixture)
    start, *turns = text.split()
    down, _, along_outer = start.partition("/")
    matches = [_TURN.match(turn) for turn in turns]
    if down not in SIGNED_AXES or along_outer not in SIGNED_AXES or not turns or None in matches:
        raise InputError(
            f"{text!r} is no sequence: write the axis that is down, the one along the outer axis, and the "
            "rotations about IMU axes in degrees, as 'z/y +180y +180z', or an id of Table 1."
        )
    rotations = tuple((m[2], math.radians(int(m[1]))) for m in matches if m is not None)
    return from_catalogue(RotationSequence(text, down, along_outer, math.nan, math.nan, rotations), fixture)


def signature(candidate: Candidate, fixture: FixtureKinematics, conditions: Conditions) -> tuple[SignatureRow, ...]:
    """Signature of a sequence by component ([P] eq. 5, for any rotations)."""
    H = Signatures([candidate], fixture, conditions).H[0, :_FORCE_ROWS, :N_PARAMETERS] / conditions.gravity_m_s2
    H[:, GROUP_SLICES["accel_bias"]] *= conditions.gravity_m_s2
    horizontal = [axis for axis in AXES if axis != candidate.down[-1]]
    names = [f"horizontal {axis}" for axis in horizontal] + list(COMPONENTS[2:_FORCE_ROWS])
    return tuple(
        SignatureRow(name, tuple((SYMBOLS[k], float(row[k])) for k in np.flatnonzero(np.abs(row) > _ROUNDING)))
        for name, row in zip(names, H, strict=True)
    )
