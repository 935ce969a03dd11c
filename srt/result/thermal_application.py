"""Correction of readings by errors that depend on temperature, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

import numpy as np

from srt.exceptions import InputError
from srt.result.applier import Applier, ErrorsInFrames
from srt.result.provenance import Temperature
from srt.sensor_errors import N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from srt.result.thermal_errors import ThermalErrors
    from srt.types import Array, Mask

_LEAST_NODES: Final = 64
_SAMPLES_PER_NODE: Final = 4000
"""Temperatures for which the inverse sensor model is made: all that occur, or where these are more, so many.

Between two, corrected values are interpolated. Over 80 K, with an error that changes by 1 % along a curve like those of
real units, 64 temperatures leave 2e-6 of a reading.
"""


class OverTemperature(ErrorsInFrames, Protocol):
    """Attributes of a calibration over temperature; :class:`srt.Calibration` has them."""

    @property
    def thermal(self) -> ThermalErrors | None:
        """Errors over temperature."""


@dataclass(frozen=True, slots=True, eq=False)
class _AtTemperature:
    """Attributes that an applier reads of a calibration, at one temperature."""

    whole: OverTemperature
    errors: SensorErrors

    @property
    def U(self) -> Array | None:
        return self.whole.U

    @property
    def covariance(self) -> Array:
        return self.whole.covariance

    @property
    def observed(self) -> Mask:
        return self.whole.observed

    @property
    def g_sensitivity(self) -> Array | None:
        return self.whole.g_sensitivity

    @property
    def g_sensitivity_covariance(self) -> Array | None:
        return self.whole.g_sensitivity_covariance

    def require_values(self) -> None:
        """Nothing: the curves have values."""


def state_at(thermal: ThermalErrors | None, temperature_c: float, *, clip: bool) -> dict[str, Any]:
    """Fields of a calibration at a temperature, as ``Calibration.at`` has them. Raises InputError."""
    if thermal is None:
        raise InputError("This calibration is of one temperature: 'srt thermal' makes one of several.")
    if not clip:
        thermal.require_inside(temperature_c, "The temperature that is asked for")
    parts = thermal.covariance_at(temperature_c)
    return {
        "errors": SensorErrors(thermal.values(temperature_c)),
        "covariance": sum(parts.values(), np.zeros((N_PARAMETERS, N_PARAMETERS))),
        "contributions": {source: np.sqrt(np.maximum(np.diag(P), 0.0)) for source, P in parts.items()},
        "temperature": Temperature(float(temperature_c), 0.0),
        "thermal": None,
    }


def apply_over_temperature(
    calibration: OverTemperature,
    readings: tuple[ArrayLike, ArrayLike],
    temperature_c: ArrayLike | None,
    *,
    clip: bool,
    out: tuple[Array, Array] | None,
    dt: float | ArrayLike | None,
    frame: Literal["mars", "table"],
) -> tuple[Array, Array]:
    """Correct readings (n, 3) that have one temperature, or one each, (n,), °C.

    The arguments are those of :meth:`srt.result.calibration.Calibration.apply`.

    Raises
    ------
    InputError
        A calibration over temperature without temperatures or the reverse; temperatures of another shape, outside the
        range of the calibration (unless clipped), or not finite.
    """
    if temperature_c is None:
        raise InputError("The errors of this calibration depend on temperature: give temperature_c.")
    if calibration.thermal is None:
        raise InputError("This calibration is of one temperature: leave out temperature_c.")
    if np.ndim(temperature_c) == 0:
        errors = state_at(calibration.thermal, float(np.asarray(temperature_c)), clip=clip)["errors"]
        return Applier(_AtTemperature(calibration, errors), frame=frame).apply(*readings, dt=dt, out=out)
    gyro, accel = (np.asarray(part, dtype=np.float64) for part in readings)
    T = np.asarray(temperature_c, dtype=np.float64)
    if gyro.ndim != 2 or T.shape != gyro.shape[:1] or accel.shape != gyro.shape:
        raise InputError(
            f"temperature_c has the shape {T.shape}, the readings {gyro.shape} and {accel.shape}: give one number, or "
            "one for each sample of readings of shape (n, 3)."
        )
    found = _each_at_its_own(calibration, gyro, accel, T, clip=clip, dt=dt, frame=frame)
    for target, part in zip(out or (), found, strict=False):
        target[:] = part
    return out or found


def _each_at_its_own(
    calibration: OverTemperature,
    gyro: Array,
    accel: Array,
    T: Array,
    *,
    clip: bool,
    dt: float | ArrayLike | None,
    frame: Literal["mars", "table"],
) -> tuple[Array, Array]:
    thermal = calibration.thermal
    assert thermal is not None
    if not clip:
        thermal.require_inside(T, "The readings")
    T = np.clip(T, thermal.lowest_c, thermal.highest_c)
    out = np.zeros_like(gyro), np.zeros_like(accel)
    nodes, most = np.unique(T), max(_LEAST_NODES, T.size // _SAMPLES_PER_NODE)
    if nodes.size > most:
        nodes = np.linspace(nodes[0], nodes[-1], most)
    models = thermal.values(nodes)

    @lru_cache(maxsize=2)
    def applier(node: int) -> Applier:
        return Applier(_AtTemperature(calibration, SensorErrors(models[node])), frame=frame)

    cell = np.clip(np.searchsorted(nodes, T, side="right") - 1, 0, max(nodes.size - 2, 0))
    order = np.argsort(cell, kind="stable")
    occupied, begins = np.unique(cell[order], return_index=True)
    for c, members in zip(occupied.tolist(), np.split(order, begins[1:]), strict=True):
        first, last = int(members[0]), int(members[-1])
        rows = slice(first, last + 1) if last - first == members.size - 1 else members
        step = np.broadcast_to(dt, T.shape)[rows] if dt is not None else None
        share = (T[rows] - nodes[c]) / (nodes[c + 1] - nodes[c]) if nodes.size > 1 else np.zeros(members.size)
        for node, weight in ((c, 1.0 - share), (c + 1, share)):
            if not weight.any():
                continue
            for target, part in zip(out, applier(node).apply(gyro[rows], accel[rows], dt=step), strict=True):
                target[rows] += weight[:, None] * part
    return out
