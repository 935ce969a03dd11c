"""Formulas of the closed form, [P] eqs. 13-14, as tables ([P]: Savage 2020, [N]: Savage 2017 part 3).

Every sensor error is a linear combination of one or two measured components and of errors already determined. One sign
differs from the printed eq. 13: the accelerometer asymmetry is ``λ_iii = −(End − Strt + 2 λ_i) / 2g``. Eqs. 4-5 and
[N] eqs. 53-55 give the plus; eq. 13 prints a minus.

The estimator ``closed-form``, which applies them to a recording, is :mod:`srt.closed_form.estimator`.
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
    """Component of an SRT measurement: a sequence, and "x", "y", "z" of Δa_H in B_Strt or "start" / "end" of a_Down."""

    sequence: str
    kind: str


@dataclass(frozen=True, slots=True)
class Formula:
    """``parameter = Σ coefficient · component + Σ coefficient · parameter``.

    Components and accelerometer biases are divided by g.
    """

    parameter: str
    components: tuple[tuple[float, Component], ...]
    parameters: tuple[tuple[float, str], ...] = ()


def _f(parameter: str, *components: tuple[float, str, str], given: tuple[tuple[float, str], ...] = ()) -> Formula:
    return Formula(parameter, tuple((c, Component(s, k)) for c, s, k in components), given)


_4PI, _2PI = 4.0 * math.pi, 2.0 * math.pi

_GYRO_SCALE: Final = (("x", "2", "2a", "y", 1.0), ("y", "1", "1a", "x", -1.0), ("z", "3", "3a", "y", -1.0))
"""First six formulas of eq. 13, or the three of eq. 14, which :func:`formulas` writes out: gyro axis, sequence,
sequence of opposite rotation, component and sign of the signature."""

_EQUATION_13_AFTER_GYRO_SCALE: Final = (
    _f("gyro_orthogonality_yz", (1 / 4, "4", "y")),  # υyz = Δ4y/4g
    _f("gyro_orthogonality_zx", (1 / 4, "5", "x")),  # υzx = Δ5x/4g
    _f("gyro_orthogonality_xy", (1 / 4, "6", "y")),  # υxy = Δ6y/4g
    # λx = −Δ14x/2 − gυzx, λy = −Δ13y/2 − gυyz, λz = −[Δ7z + πg(κxx + κxxx)]/2
    _f("accel_bias_x", (-1 / 2, "14", "x"), given=((-1.0, "gyro_orthogonality_zx"),)),
    _f("accel_bias_y", (-1 / 2, "13", "y"), given=((-1.0, "gyro_orthogonality_yz"),)),
    _f(
        "accel_bias_z",
        (-1 / 2, "7", "z"),
        given=((-math.pi / 2, "gyro_scale_x"), (-math.pi / 2, "gyro_asymmetry_x")),
    ),
    # μxy = (Δ7x − gυxy)/2g; the others alike, from their own sequences
    _f("accel_misalignment_xy", (1 / 2, "7", "x"), given=((-1 / 2, "gyro_orthogonality_xy"),)),
    _f("accel_misalignment_xz", (1 / 2, "8", "x"), given=((-1 / 2, "gyro_orthogonality_zx"),)),
    _f("accel_misalignment_yx", (1 / 2, "12", "y"), given=((-1 / 2, "gyro_orthogonality_xy"),)),
    _f("accel_misalignment_yz", (1 / 2, "11", "y"), given=((-1 / 2, "gyro_orthogonality_yz"),)),
    _f("accel_misalignment_zx", (1 / 2, "9", "z"), given=((-1 / 2, "gyro_orthogonality_zx"),)),
    _f("accel_misalignment_zy", (1 / 2, "10", "z"), given=((-1 / 2, "gyro_orthogonality_yz"),)),
    # λii = −(End + Strt)/2g, λiii = −(End − Strt + 2λi)/2g; x from sequence 9, y from 7, z from 8
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
"""Formulas of eq. 13 after the first six."""


def formulas(sequences: Collection[str], *, asymmetry: bool = True) -> tuple[Formula, ...]:
    """Formulas that a set of sequences supports, in an order in which each follows those that it uses.

    Parameters
    ----------
    sequences : collection of str
        Ids of the recorded sequences.
    asymmetry : bool
        False omits gyro scale-factor asymmetry: [P] eq. 14 replaces the first six formulas of eq. 13. This is always so
        for an axis without its sequence of opposite rotation (1a-3a).

    Returns
    -------
    tuple of Formula
        Formulas of the parameters that these sequences determine.
    """
    have = set(sequences)
    chosen: list[Formula] = []
    for axis, forward, reverse, kind, sign in _GYRO_SCALE:
        pair = ((sign, forward), (-sign, reverse))
        if {forward, reverse} <= have:  # κyy = −(Δ1x − Δ1ax)/4πg, κyyy = −(Δ1x + Δ1ax)/4πg; x and z alike
            chosen.append(_f(f"gyro_scale_{axis}", *((c / _4PI, s, kind) for c, s in pair)))
            if asymmetry:
                chosen.append(_f(f"gyro_asymmetry_{axis}", *((sign / _4PI, s, kind) for s in (forward, reverse))))
        else:  # [P] eq. 14: κyy = −Δ1x/2πg
            chosen.extend(_f(f"gyro_scale_{axis}", (c / _2PI, s, kind)) for c, s in pair if s in have)
    found = {f.parameter for f in chosen}
    # A gyro asymmetry without a formula is fixed at a given value; formulas that use it remain valid.
    given = {name for name in NAMES if name.startswith("gyro_asymmetry")} - found
    for formula in _EQUATION_13_AFTER_GYRO_SCALE:
        if {c.sequence for _, c in formula.components} <= have and {p for _, p in formula.parameters} <= found | given:
            kept = tuple((c, p) for c, p in formula.parameters if p in found)
            chosen.append(Formula(formula.parameter, formula.components, kept))
            found.add(formula.parameter)
    return tuple(chosen)


def components(chosen: tuple[Formula, ...]) -> tuple[Component, ...]:
    """Measured components that formulas use, each once, in order of first use."""
    return tuple(dict.fromkeys(c for f in chosen for _, c in f.components))


def inversion_matrix(chosen: tuple[Formula, ...], gravity_m_s2: float) -> Array:
    """Matrix that gives the parameters from the measured components ([P] eq. 13).

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
    """Names of the parameters without a formula; the gyro biases need none."""
    found = {f.parameter for f in chosen}
    return tuple(n for n in NAMES if n not in found and not n.startswith("gyro_bias"))


def sequences_needed(parameter: str) -> tuple[str, ...]:
    """Sequences that the full formula of a parameter uses, directly or through others; none if it has no formula."""
    table = {f.parameter: f for f in formulas([str(i) for i in range(1, 15)] + ["1a", "2a", "3a"])}
    if (formula := table.get(parameter)) is None:
        return ()
    needed = {c.sequence for _, c in formula.components}
    for _, other in formula.parameters:
        needed |= set(sequences_needed(other))
    return tuple(sorted(needed, key=lambda s: (int(s.rstrip("a")), s)))
