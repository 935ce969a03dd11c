"""The closed-form inversion of the 17 sequences: Savage 2020, eqs. 13-14, as a table.

Every sensor error is a combination of one to two measured components and of errors already found. Two signs differ
from the printed eq. 13: the accelerometer asymmetry is ``λ_iii = −(End − Strt + 2 λ_i) / 2g`` (eqs. 4-5 and the 2017
examples, eqs. 53-55, give the plus; eq. 13 prints a minus).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.sensor_errors import INDEX, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Collection

    from srt.types import Array


class Component(NamedTuple):
    """One measured number: a sequence and "x", "y", "z" of Δa_H in B_Strt, or "start" / "end" for a_Down."""

    sequence: str
    kind: str


@dataclass(frozen=True, slots=True)
class Formula:
    """``parameter = Σ coefficient · component + Σ coefficient · parameter``.

    Coefficients are for components divided by g, and for accelerometer biases divided by g.
    """

    parameter: str
    components: tuple[tuple[float, Component], ...]
    parameters: tuple[tuple[float, str], ...] = ()


def _f(parameter: str, *components: tuple[float, str, str], given: tuple[tuple[float, str], ...] = ()) -> Formula:
    return Formula(parameter, tuple((c, Component(s, k)) for c, s, k in components), given)


_4PI, _2PI = 4.0 * math.pi, 2.0 * math.pi

# Scale factor, per gyro axis: sequence, its reversed twin, component and sign of the signature.
_SCALE = (("x", "2", "2a", "y", 1.0), ("y", "1", "1a", "x", -1.0), ("z", "3", "3a", "y", -1.0))

_COMMON: Final = (
    _f("gyro_orthogonality_yz", (1 / 4, "4", "y")),
    _f("gyro_orthogonality_zx", (1 / 4, "5", "x")),
    _f("gyro_orthogonality_xy", (1 / 4, "6", "y")),
    _f("accel_bias_x", (-1 / 2, "14", "x"), given=((-1.0, "gyro_orthogonality_zx"),)),
    _f("accel_bias_y", (-1 / 2, "13", "y"), given=((-1.0, "gyro_orthogonality_yz"),)),
    _f(
        "accel_bias_z",
        (-1 / 2, "7", "z"),
        given=((-math.pi / 2, "gyro_scale_x"), (-math.pi / 2, "gyro_asymmetry_x")),
    ),
    _f("accel_misalignment_xy", (1 / 2, "7", "x"), given=((-1 / 2, "gyro_orthogonality_xy"),)),
    _f("accel_misalignment_xz", (1 / 2, "8", "x"), given=((-1 / 2, "gyro_orthogonality_zx"),)),
    _f("accel_misalignment_yx", (1 / 2, "12", "y"), given=((-1 / 2, "gyro_orthogonality_xy"),)),
    _f("accel_misalignment_yz", (1 / 2, "11", "y"), given=((-1 / 2, "gyro_orthogonality_yz"),)),
    _f("accel_misalignment_zx", (1 / 2, "9", "z"), given=((-1 / 2, "gyro_orthogonality_zx"),)),
    _f("accel_misalignment_zy", (1 / 2, "10", "z"), given=((-1 / 2, "gyro_orthogonality_yz"),)),
    *(
        formula
        for axis, sequence in (("x", "9"), ("y", "7"), ("z", "8"))
        for formula in (
            _f(f"accel_scale_{axis}", (-1 / 2, sequence, "end"), (-1 / 2, sequence, "start")),
            _f(
                f"accel_asymmetry_{axis}",
                (-1 / 2, sequence, "end"),
                (1 / 2, sequence, "start"),
                given=((-1.0, f"accel_bias_{axis}"),),
            ),
        )
    ),
)


def formulas(sequences: Collection[str], *, asymmetry: bool = True) -> tuple[Formula, ...]:
    """The formulas that a set of sequences supports, each after those it needs.

    Parameters
    ----------
    sequences : collection of str
        Ids that were executed.
    asymmetry : bool
        False leaves out gyro scale-factor asymmetry: eq. 14 in place of the first six formulas of eq. 13. An axis
        without its reversed sequence (1a-3a) is treated so in any case.

    Returns
    -------
    tuple of Formula
        Of the parameters that can be found; the others are missing from it.
    """
    have = set(sequences)
    chosen: list[Formula] = []
    for axis, forward, reverse, kind, sign in _SCALE:
        pair = ((sign, forward), (-sign, reverse))
        if {forward, reverse} <= have:
            chosen.append(_f(f"gyro_scale_{axis}", *((c / _4PI, s, kind) for c, s in pair)))
            if asymmetry:
                chosen.append(_f(f"gyro_asymmetry_{axis}", *((sign / _4PI, s, kind) for s in (forward, reverse))))
        else:
            chosen.extend(_f(f"gyro_scale_{axis}", (c / _2PI, s, kind)) for c, s in pair if s in have)
    found = {f.parameter for f in chosen}
    # Without its own formula a gyro asymmetry is held at a given value and costs nothing else.
    given = {name for name in NAMES if name.startswith("gyro_asymmetry")} - found
    for formula in _COMMON:
        if {c.sequence for _, c in formula.components} <= have and {p for _, p in formula.parameters} <= found | given:
            kept = tuple((c, p) for c, p in formula.parameters if p in found)
            chosen.append(Formula(formula.parameter, formula.components, kept))
            found.add(formula.parameter)
    return tuple(chosen)


def components(chosen: tuple[Formula, ...]) -> tuple[Component, ...]:
    """The measured components that formulas use, each once, in order of first use."""
    return tuple(dict.fromkeys(c for f in chosen for _, c in f.components))


def inversion_matrix(chosen: tuple[Formula, ...], gravity_m_s2: float) -> Array:
    """Coefficients of eq. 13: parameters from components.

    Returns
    -------
    ndarray, shape (27, number of components)
        In SI units (components in m/s²); rows of parameters without a formula are zero. Columns follow
        :func:`components`.
    """
    order = {c: j for j, c in enumerate(components(chosen))}
    A = np.zeros((N_PARAMETERS, len(order)))
    for formula in chosen:
        row = np.zeros(len(order))
        for coefficient, component in formula.components:
            row[order[component]] += coefficient
        for coefficient, parameter in formula.parameters:
            row += coefficient * A[INDEX[parameter]]
        A[INDEX[formula.parameter]] = row
    A /= gravity_m_s2
    A[[INDEX[f"accel_bias_{axis}"] for axis in "xyz"]] *= gravity_m_s2
    return A


def missing_parameters(chosen: tuple[Formula, ...]) -> tuple[str, ...]:
    """The names of the 24 closed-form parameters that have no formula."""
    found = {f.parameter for f in chosen}
    return tuple(n for n in NAMES if n not in found and not n.startswith("gyro_bias"))


def sequences_needed(parameter: str) -> tuple[str, ...]:
    """The sequences that a parameter's full formula reads, directly or through other parameters."""
    table = {f.parameter: f for f in formulas([str(i) for i in range(1, 15)] + ["1a", "2a", "3a"])}
    formula = table[parameter]
    needed = {c.sequence for _, c in formula.components}
    for _, other in formula.parameters:
        needed |= set(sequences_needed(other))
    return tuple(sorted(needed, key=lambda s: (int(s.rstrip("a")), s)))
