"""Accuracy analysis of Savage 2020 [P], §9: errors of the measured quantities by source, as in the paper.

Each sequence measures one combination of errors ``x`` in one component of Δa_H, which is ``±H x`` ([P] eq. 15, Table
2). A disturbance e of that component gives the error ``e / H`` (eq. 16). The attitude error by gyro bias (eqs. 20-21)
comes from :mod:`srt.model.rotation_integrals`, its effect on the result (eq. 22) from :func:`bias_effects`. As in the
paper the attitude is integrated
over the windows, averages are linear, and all sequences have one duration. The estimators of this package are better
(``srt budget`` without ``--paper``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import EARTH_RATE_RAD_S, STANDARD_GRAVITY_M_S2
from srt.exceptions import InputError
from srt.model import measurement_model as model
from srt.model.rotation_integrals import ideal_rotations
from srt.model.table1 import AXES, SEQUENCES, axis_vector

if TYPE_CHECKING:
    from srt.types import Array


_PULSE: Final = math.sqrt(1.0 / 6.0)
"""Rms of the difference of two pulse counter errors, each uniform within one pulse: √(2/12) ([P] §9.1)."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """Quantity that one component of one sequence measures.

    Attributes
    ----------
    symbol : str
        Combination of errors, in the symbols of the paper; accelerometer biases in g.
    component : str
        "x", "y" or "z" of Δa_H in B_Strt.
    sensitivity : float
        ±H / g, the component over g for a unit of the quantity (Table 2).
    unit : str
        Unit of 1e-6: ppm, µrad or µg.
    """

    symbol: str
    sequence: str
    component: str
    sensitivity: float
    unit: str


def _scale(symbol: str, sequence: str, component: str, sign: float) -> Quantity:
    return Quantity(symbol, sequence, component, sign * 2.0 * math.pi, "ppm")


QUANTITIES: Final = (
    _scale("κyy + κyyy", "1", "x", -1.0),
    _scale("κxx + κxxx", "2", "y", 1.0),
    _scale("κzz + κzzz", "3", "y", -1.0),
    _scale("κyy − κyyy", "1a", "x", 1.0),
    _scale("κxx − κxxx", "2a", "y", -1.0),
    _scale("κzz − κzzz", "3a", "y", 1.0),
    Quantity("υyz", "4", "y", 4.0, "µrad"),
    Quantity("υzx", "5", "x", 4.0, "µrad"),
    Quantity("υxy", "6", "y", 4.0, "µrad"),
    Quantity("μxy + υxy/2", "7", "x", 2.0, "µrad"),
    Quantity("μxz + υzx/2", "8", "x", 2.0, "µrad"),
    Quantity("μzx + υzx/2", "9", "z", 2.0, "µrad"),
    Quantity("μzy + υyz/2", "10", "z", 2.0, "µrad"),
    Quantity("μyz + υyz/2", "11", "y", 2.0, "µrad"),
    Quantity("μyx + υxy/2", "12", "y", 2.0, "µrad"),
    Quantity("λz/g + (π/2)(κxx + κxxx)", "7", "z", -2.0, "µg"),
    Quantity("λy/g + υyz", "13", "y", -2.0, "µg"),
    Quantity("λx/g + υzx", "14", "x", -2.0, "µg"),
)
"""Table 2, one row for each quantity that eq. 13 reads."""


@dataclass(frozen=True, slots=True)
class PaperSetting:
    """Assumptions of the analysis, SI; the defaults are those of the paper's example.

    Attributes
    ----------
    gyro_noise : float
        Angle random walk, rad/√s.
    gyro_quantization : float
        Pulse, rad.
    accel_noise : float
        m/s²/√Hz.
    accel_quantization : float
        Pulse, m/s.
    gyro_bias : tuple of float
        Remaining κx, κy, κz after calibration of the gyro bias, rad/s.
    gyro_bias_instability : float
        1-sigma of an additional bias of each axis, rad/s.
    alignment_rad : float
        Error of the alignment to north, and of the fixture.
    sensor_errors : float
        Size of scale-factor errors and misalignments before the test.
    window_s : float
        T_Meas of each of the two windows.
    rotation_s : float
        Time that all rotations of a sequence take.
    rate_rad_s : float
        β̇ of a rotation.
    """

    gyro_noise: float = 0.0
    gyro_quantization: float = 0.0
    accel_noise: float = 0.0
    accel_quantization: float = 0.0
    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_bias_instability: float = 0.0
    alignment_rad: float = 1e-3
    sensor_errors: float = 1e-3
    window_s: float = 10.0
    rotation_s: float = 20.0
    rate_rad_s: float = 1.0
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2

    def __post_init__(self) -> None:
        for name in ("window_s", "rotation_s", "rate_rad_s", "gravity_m_s2"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} is {value!r}; it must be a positive number.")

    @property
    def time_s(self) -> float:
        """Duration of a sequence including its windows, s."""
        return 2.0 * self.window_s + self.rotation_s


def paper_budget(setting: PaperSetting) -> dict[str, Array]:
    """Errors of the quantities by source, one sigma except for the gyro bias, which has a sign.

    Returns
    -------
    dict of str to ndarray, shape (18,)
        By source; errors of :data:`QUANTITIES`, dimensionless (rad, parts, g). "..._before" is before the first
        iteration, which makes these two negligible (§8, §9.3).
    """
    per_attitude = 1.0 / np.abs([q.sensitivity for q in QUANTITIES])
    T = setting.time_s
    per_force = math.sqrt(2.0) / (setting.window_s * setting.gravity_m_s2)  # two windows, their mean, in g
    attitude = {
        "gyro_noise": setting.gyro_noise * math.sqrt(T),
        "gyro_quantization": setting.gyro_quantization * _PULSE,
        "accel_noise": per_force * setting.accel_noise * math.sqrt(setting.window_s),
        "accel_quantization": per_force * setting.accel_quantization * _PULSE,
        "earth_rate_alignment": setting.alignment_rad * EARTH_RATE_RAD_S * T,
        "earth_rate_sensor_errors_before": setting.sensor_errors * EARTH_RATE_RAD_S * T,
        "second_order_before": setting.alignment_rad * setting.sensor_errors,
    }
    out: dict[str, Array] = {name: size * per_attitude for name, size in attitude.items()}
    by_bias = bias_effects(setting)
    out["gyro_bias"] = by_bias @ np.array(setting.gyro_bias)
    out["gyro_bias_instability"] = setting.gyro_bias_instability * np.linalg.norm(by_bias, axis=1)
    return out


def bias_effects(setting: PaperSetting) -> Array:
    """Errors of the quantities by a gyro bias of 1 rad/s about each axis ([P] eq. 22), shape (18, 3), s."""
    integrals = ideal_rotations(tuple(SEQUENCES.values()), setting.rate_rad_s, setting.window_s)
    number = {name: k for k, name in enumerate(SEQUENCES)}
    rows = []
    for quantity in QUANTITIES:
        k = number[quantity.sequence]
        down = axis_vector(SEQUENCES[quantity.sequence].down)
        basis = np.eye(3)[[AXES.index(quantity.component)]][None]
        # At rest the specific force points up; in units of g.
        by_attitude = model.attitude_to_horizontal(basis, -down[None])[0, 0]
        rows.append(by_attitude @ integrals.time[k] / quantity.sensitivity)
    return np.array(rows)
