"""How to apply a calibration: the formula, and its numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.certificate.tables import Cell, Table
from srt.model.sensor_model import accel_triad, gyro_triad

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.model.sensor_model import Triad
    from srt.result.calibration import Calibration

    Array = NDArray[np.float64]

READING: Final = "y = M v + s ∘ |v| + b"
CORRECTION: Final = "v = (M + diag(s ∘ sign v))⁻¹ (y − b)"
MATHTEXT: Final = (
    r"$y = M\,v + s \circ |v| + b$",
    r"$v = \left(M + \mathrm{diag}(s \circ \mathrm{sign}\,v)\right)^{-1} (y - b)$",
)
"""The same two formulas as the PDF sets them."""


@dataclass(frozen=True, slots=True)
class Application:
    """How to apply a calibration.

    Attributes
    ----------
    formulas : tuple of str
        What a unit reads, and how to correct it.
    sentences : tuple of str
        What the symbols are.
    tables : tuple of Table
        M, s and b of gyros and accelerometers, and U where it is known.
    """

    formulas: tuple[str, ...]
    sentences: tuple[str, ...]
    tables: tuple[Table, ...]


def apply_section(calibration: Calibration) -> Application:
    """Say how to apply a calibration.

    Parameters
    ----------
    calibration : Calibration
    """
    sentences = [
        "y: what the unit reads; v: the true value. Gyros in rad/s, accelerometers in m/s²; each has its own M, s and "
        "b. ∘ multiplies element by element.",
        "Take the signs of v from inverse(M) (y − b) first, then from v itself until they stay. Where s is zero, one "
        "step is all.",
        "Readings that are increments of a time step T: divide them by T, correct, multiply by T.",
        "v is in MARS axes, those in which the matrix M of the gyros is symmetric.",
    ]
    tables = [
        _triad("Gyros: M, s, b (rad/s)", gyro_triad(calibration.errors)),
        _triad("Accelerometers: M, s, b (m/s²)", accel_triad(calibration.errors)),
    ]
    if calibration.U is not None:
        sigma = calibration.U_sigma_rad
        known = "" if sigma is None else f", known to {1e3 * sigma:.2g} mrad per axis"
        sentences.append(f"transpose(U) v is in the axes of the table on which the unit was mounted{known}.")
        rows = tuple(tuple(Cell(f"{x:+.9f}", x) for x in row) for row in calibration.U.tolist())
        tables.append(Table("U", ("", "", ""), rows, "rrr"))
    sentences.append("'srt apply' does this to a recording, 'srt apply --c-header' writes it as C.")
    return Application((READING, CORRECTION), tuple(sentences), tuple(tables))


def _triad(title: str, triad: Triad) -> Table:
    numbers = np.column_stack([triad.matrix, triad.asymmetry, triad.bias]).tolist()
    rows = tuple(
        tuple(Cell(f"{x:+.6e}" if column == 4 else f"{x:+.9f}", x) for column, x in enumerate(row)) for row in numbers
    )
    return Table(title, ("M, column 1", "column 2", "column 3", "s", "b"), rows, "rrrrr")
