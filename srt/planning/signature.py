"""What one sequence shows: which errors, in which component, how strongly."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.model.table1 import AXES, SEQUENCES, SIGNED_AXES, Sequence
from srt.planning.candidates import from_catalogue
from srt.planning.information import COMPONENTS, Signatures
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SYMBOLS

if TYPE_CHECKING:
    from srt.planning.candidates import Candidate
    from srt.planning.information import Conditions
    from srt.planning.stand import Stand

_TURN: Final = re.compile(r"([+-]?\d+)([xyz])$")
_NOTHING: Final = 1e-9
_ROWS: Final = 4
"""Rows of a sequence that are specific force: the rates at rest show the gyro bias, whatever the sequence."""


@dataclass(frozen=True, slots=True)
class Row:
    """One component, and what it shows.

    Attributes
    ----------
    component : str
        "horizontal x" and the like, in IMU axes at the start.
    terms : tuple of (str, float)
        Symbols and coefficients: of the component over g, accelerometer biases in g, gyro biases in rad/s, so that
        theirs are in s.
    """

    component: str
    terms: tuple[tuple[str, float], ...]


def parse_sequence(text: str, stand: Stand) -> Candidate:
    """Read a sequence as plans write it, ``z/y +180y +180z``, or the id of one of Table 1.

    Raises
    ------
    InputError
        A text that is no sequence, or one that the fixture cannot execute: which rotation, and why.
    """
    if text in SEQUENCES:
        return from_catalogue(SEQUENCES[text], stand)
    start, *turns = text.split()
    down, _, along_outer = start.partition("/")
    matches = [_TURN.match(turn) for turn in turns]
    if down not in SIGNED_AXES or along_outer not in SIGNED_AXES or not turns or None in matches:
        raise InputError(
            f"{text!r} is no sequence: write what is down and what lies along the outer axis, then the turns about IMU "
            "axes in degrees, as 'z/y +180y +180z', or an id of Table 1."
        )
    rotations = tuple((m[2], math.radians(int(m[1]))) for m in matches if m is not None)
    return from_catalogue(Sequence(text, down, along_outer, math.nan, math.nan, rotations), stand)


def signature(candidate: Candidate, stand: Stand, conditions: Conditions) -> tuple[Row, ...]:
    """What a sequence shows, by component (Savage 2020, eq. 5, for any rotations).

    Parameters
    ----------
    candidate : Candidate
    stand : Stand
    conditions : Conditions
    """
    H = Signatures([candidate], stand, conditions).H[0, :_ROWS, :N_PARAMETERS] / conditions.gravity_m_s2
    H[:, GROUP_SLICES["accel_bias"]] *= conditions.gravity_m_s2
    horizontal = [axis for axis in AXES if axis != candidate.down[-1]]
    names = [f"horizontal {axis}" for axis in horizontal] + list(COMPONENTS[2:_ROWS])
    return tuple(
        Row(name, tuple((SYMBOLS[k], float(row[k])) for k in np.flatnonzero(np.abs(row) > _NOTHING)))
        for name, row in zip(names, H, strict=True)
    )
