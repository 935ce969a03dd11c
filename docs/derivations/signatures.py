"""Signatures of the 17 rotation sequences, exact, from eqs. 3-5 and 20-21 of Savage 2020.

The derivation starts from the printed equations and shares nothing with the package, so that both can be compared::

    φ_End   = Σ C_Bi { [κ_LinScal + κ_Asym sign β̇] u θ + [I sin θ + (1 − cos θ)(u×)] κ_Mis u }             eq. 3
    δa      = −g (λ_LinScal + λ_Mis + λ_Asym A_Sign) u_Dwn + λ_Bias,   A_Sign = −diag(u_Dwn)               eq. 4
    Δa_H    = g u_Dwn × φ_End + (C_End δa_End − δa_Strt)_H,            Down = u_Dwn · δa                   eq. 5
    φ_Bias  = Σ C_Bi [I + (1 − cos θ)/θ (u×) + (1 − sin θ/θ)(u×)²] θ/β̇ κ_Bias                             eq. 20
    e(Δa_H) = g u_Dwn × { φ_Bias + T_Meas [I + F_Meas (C_End − I)] κ_Bias }                                eq. 21

``κ_ij = κ_ji = υ_ij / 2`` (eqs. 8-10) and ``λ_ij = μ_ij`` (eq. 11). The rate β̇ is a magnitude with the sign of θ.
Run the script to print the table::

    python docs/derivations/signatures.py
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import sympy as sp

AXES: Final = ("x", "y", "z")

g, T_MEAS, F_MEAS, RATE = sp.symbols("g T_Meas F_Meas β̇", positive=True)
"""Gravity, window length, response of the averaging to a unit ramp, magnitude of the rotation rate."""

_SYMBOLS: Final = {
    "gyro_scale": ("x:κxx", "y:κyy", "z:κzz"),
    "gyro_asymmetry": ("x:κxxx", "y:κyyy", "z:κzzz"),
    "gyro_orthogonality": ("xy:υxy", "yz:υyz", "zx:υzx"),
    "accel_bias": ("x:λx", "y:λy", "z:λz"),
    "accel_scale": ("x:λxx", "y:λyy", "z:λzz"),
    "accel_asymmetry": ("x:λxxx", "y:λyyy", "z:λzzz"),
    "accel_misalignment": ("xy:μxy", "xz:μxz", "yx:μyx", "yz:μyz", "zx:μzx", "zy:μzy"),
    "gyro_bias": ("x:κx", "y:κy", "z:κz"),
}
PARAMETERS: Final = {
    f"{group}_{entry.split(':')[0]}": sp.Symbol(entry.split(":")[1], real=True)
    for group, entries in _SYMBOLS.items()
    for entry in entries
}
"""Symbol of each sensor error by its full name."""

# Table 1 of the 2020 paper: down, along outer, initial (inner, outer) angle and rotations, degrees.
TABLE_1: Final = {
    "1": ("z", "y", (0, 0), ((360, "y"),)),
    "2": ("z", "x", (90, 0), ((360, "x"),)),
    "3": ("x", "y", (0, -90), ((360, "z"),)),
    "1a": ("z", "y", (0, 0), ((-360, "y"),)),
    "2a": ("z", "x", (90, 0), ((-360, "x"),)),
    "3a": ("x", "y", (0, -90), ((-360, "z"),)),
    "4": ("z", "y", (0, 0), ((180, "y"), (180, "z"), (180, "y"), (180, "z"))),
    "5": ("z", "x", (90, 0), ((180, "x"), (180, "z"), (180, "x"), (180, "z"))),
    "6": ("x", "y", (0, -90), ((180, "y"), (90, "z"), (180, "x"), (90, "z")) * 2),
    "7": ("y", "x", (90, 90), ((180, "x"),)),
    "8": ("z", "x", (90, 0), ((180, "x"),)),
    "9": ("x", "y", (0, -90), ((180, "z"),)),
    "10": ("y", "x", (90, 90), ((180, "z"),)),
    "11": ("z", "y", (0, 0), ((180, "y"),)),
    "12": ("x", "y", (0, -90), ((180, "y"),)),
    "13": ("z", "y", (0, 0), ((180, "z"), (180, "y"))),
    "14": ("z", "x", (90, 0), ((180, "z"), (180, "x"))),
}


@dataclass(frozen=True)
class Signature:
    """SRT measurements of one sequence as functions of the sensor errors.

    ``delta_a`` and ``bias`` hold the two horizontal components by axis of B_Strt; ``down`` holds "start" and "end".
    ``attitudes`` are the attitudes before each rotation, and after the last.
    """

    sequence: str
    attitudes: tuple[sp.Matrix, ...]
    phi: sp.Matrix
    delta_a: dict[str, sp.Expr]
    down: dict[str, sp.Expr]
    phi_bias: sp.Matrix
    bias: dict[str, sp.Expr]

    @property
    def C_end(self) -> sp.Matrix:
        return self.attitudes[-1]


def unit(axis: str) -> sp.Matrix:
    return sp.Matrix([int(axis == a) for a in AXES])


def cross(v: sp.Matrix) -> sp.Matrix:
    """Cross-product matrix (v×)."""
    return sp.Matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _diagonal(group: str) -> sp.Matrix:
    return sp.diag(*(PARAMETERS[f"{group}_{a}"] for a in AXES))


def _vector(group: str) -> sp.Matrix:
    return sp.Matrix([PARAMETERS[f"{group}_{a}"] for a in AXES])


def _gyro_misalignment() -> sp.Matrix:
    xy, yz, zx = (PARAMETERS[f"gyro_orthogonality_{pair}"] / 2 for pair in ("xy", "yz", "zx"))
    return sp.Matrix([[0, xy, zx], [xy, 0, yz], [zx, yz, 0]])


def _accel_misalignment() -> sp.Matrix:
    return sp.Matrix(3, 3, lambda i, j: 0 if i == j else PARAMETERS[f"accel_misalignment_{AXES[i]}{AXES[j]}"])


def turn(u: sp.Matrix, theta: sp.Expr) -> sp.Matrix:
    """Attitude after a rotation, eq. 3."""
    return sp.eye(3) + sp.sin(theta) * cross(u) + (1 - sp.cos(theta)) * cross(u) ** 2


def attitude_error(u: sp.Matrix, theta: sp.Expr) -> sp.Matrix:
    """Attitude error of one rotation, in the axes at its start (braces of eq. 3)."""
    scale = (_diagonal("gyro_scale") + _diagonal("gyro_asymmetry") * sp.sign(theta)) * u * theta
    bracket = sp.eye(3) * sp.sin(theta) + (1 - sp.cos(theta)) * cross(u)
    return scale + bracket * (_gyro_misalignment() * u)


def bias_error(u: sp.Matrix, theta: sp.Expr) -> sp.Matrix:
    """Attitude error of one rotation by the gyro biases, in the axes at its start (a term of eq. 20)."""
    ux = cross(u)
    bracket = sp.eye(3) + (1 - sp.cos(theta)) / theta * ux + (1 - sp.sin(theta) / theta) * ux**2
    return bracket * (theta / (sp.sign(theta) * RATE)) * _vector("gyro_bias")


def force_error(down: sp.Matrix) -> sp.Matrix:
    """Specific-force error of a stationary unit, eq. 4."""
    sign = -sp.diag(*down)
    linear = _diagonal("accel_scale") + _accel_misalignment() + _diagonal("accel_asymmetry") * sign
    return -g * linear * down + _vector("accel_bias")


def signature(sequence: str) -> Signature:
    """Evaluate eqs. 3-5 and 20-21 for one sequence of Table 1."""
    vertical, _, _, rotations = TABLE_1[sequence]
    down = unit(vertical)
    attitudes = [sp.eye(3)]
    phi, phi_bias = sp.zeros(3, 1), sp.zeros(3, 1)
    for degrees, axis in rotations:
        u, theta = unit(axis), sp.pi * sp.Rational(degrees, 180)
        phi += attitudes[-1] * attitude_error(u, theta)
        phi_bias += attitudes[-1] * bias_error(u, theta)
        attitudes.append(attitudes[-1] * turn(u, theta))
    C = attitudes[-1]
    start, end = force_error(down), force_error(C.T * down)
    change = g * down.cross(phi) + C * end - start
    windows = T_MEAS * (sp.eye(3) + F_MEAS * (C - sp.eye(3))) * _vector("gyro_bias")
    by_bias = g * down.cross(phi_bias + windows)
    horizontal = [(i, a) for i, a in enumerate(AXES) if a != vertical]
    return Signature(
        sequence,
        tuple(attitudes),
        phi.applyfunc(sp.expand),
        {a: sp.expand(change[i]) for i, a in horizontal},
        {"start": sp.expand(down.dot(start)), "end": sp.expand((C.T * down).dot(end))},
        phi_bias.applyfunc(sp.expand),
        {a: sp.expand(by_bias[i]) for i, a in horizontal},
    )


def signatures() -> dict[str, Signature]:
    """Signatures of the 17 sequences by id, in the order of Table 1."""
    return {name: signature(name) for name in TABLE_1}


def coefficients(expression: sp.Expr) -> dict[str, sp.Expr]:
    """Factor of every sensor error in an expression that is linear in them; zero factors are omitted."""
    factors = {name: sp.diff(expression, symbol) for name, symbol in PARAMETERS.items()}
    return {name: factor for name, factor in factors.items() if factor != 0}


def outer_axis_in_body(inner: sp.Expr) -> sp.Matrix:
    """Components in B of the outer axis, ``R_z(inner)ᵀ e_y``."""
    return turn(unit("z"), inner).T * unit("y")


def executable(inner_deg: int, rotations: tuple[tuple[int, str], ...]) -> bool:
    """True if every rotation is one of the inner axis (IMU z) or about an IMU axis along the outer axis."""
    inner = sp.pi * sp.Rational(inner_deg, 180)
    for degrees, axis in rotations:
        if axis == "z":
            inner += sp.pi * sp.Rational(degrees, 180)
        elif cross(unit(axis)) * outer_axis_in_body(inner) != sp.zeros(3, 1):
            return False
    return True


def main() -> None:
    for name, s in signatures().items():
        down, along, _, rotations = TABLE_1[name]
        turns = ", ".join(f"{degrees:+d} {axis}" for degrees, axis in rotations)
        print(f"{name}: {down} down, {along} along outer; {turns}")
        for axis, expression in s.delta_a.items():
            print(f"    Δa_{axis} = {sp.factor(expression)}")
        for when, expression in s.down.items():
            print(f"    Down_{when} = {expression}")
        for axis, expression in s.bias.items():
            print(f"    e_Bias(Δa_{axis}) = {sp.collect(expression, [RATE, T_MEAS])}")


if __name__ == "__main__":
    main()
