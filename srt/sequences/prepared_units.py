"""Recordings of several units that went through one schedule, prepared alike, as one with a leading axis of units."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from srt.exceptions import InputError
from srt.model.gyro_stream import joined_streams
from srt.sequences.preparation import PreparedRecording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srt.model.gyro_stream import GyroStream
    from srt.model.sensor_model import Triad
    from srt.noise.noise_model import NoiseModel
    from srt.types import Array, Indices, Mask


@dataclass(frozen=True, eq=False)
class PreparedUnits(PreparedRecording):
    """Prepared recordings of units, whose readings and noise have a leading axis of units.

    Schedule, labels, windows, fixture and site are those of the first; they are alike in all (:func:`alike`).
    """

    units: tuple[PreparedRecording, ...] = field(default=(), kw_only=True)

    @cached_property
    def noise(self) -> NoiseModel:
        """Noise of the units, shape (units, 3) each."""
        found = [unit.noise for unit in self.units]
        by_name = {f.name: [getattr(noise, f.name) for noise in found] for f in fields(found[0])}
        stacked: dict[str, Any] = {
            name: np.stack(values)
            for name, values in by_name.items()
            if isinstance(values[0], np.ndarray) and name != "filter_s"
        }
        return replace(found[0], **stacked)

    def of_units(self, which: Indices) -> PreparedUnits:
        """Some of the units."""
        return _joined([self.units[u] for u in which.tolist()])

    def means(self, gyro: Triad, accel: Triad) -> tuple[Array, Array]:
        """Mean readings of gyros and accelerometers in every window, (units, W, 3), less vibration and rounding."""
        if all(unit.vibration is None for unit in self.units):
            noise = self.noise
            return self.windows.gyro_mean - noise.gyro_rounding, self.windows.accel_mean - noise.accel_rounding
        found = [unit.means(gyro.of(u), accel.of(u)) for u, unit in enumerate(self.units)]
        return np.stack([gyros for gyros, _ in found]), np.stack([forces for _, forces in found])

    def rectified(self, gyro: Triad, accel: Triad) -> tuple[Array, Array]:
        """Mean of the absolute values by vibration over the absolute mean, (units, W, 3)."""
        found = [unit.rectified(gyro.of(u), accel.of(u)) for u, unit in enumerate(self.units)]
        return np.stack([rates for rates, _ in found]), np.stack([forces for _, forces in found])

    def stream(self, integrated: Mask, *, with_force: bool = False) -> tuple[GyroStream, Array | None, Array | None]:
        """Samples to integrate over, those of one unit after those of another."""
        streams, forces, weights = zip(
            *(unit.stream(integrated, with_force=with_force) for unit in self.units), strict=True
        )
        if len(self.units) == 1:
            return streams[0], forces[0], weights[0]
        force = None if forces[0] is None else np.concatenate(forces, axis=1)
        return joined_streams(streams), force, None if weights[0] is None else np.concatenate(weights)


def together(units: Sequence[PreparedRecording]) -> PreparedUnits:
    """Prepared recordings as one.

    Raises
    ------
    InputError
        If their schedules, sites, fixtures or stated noise differ.
    """
    first = units[0]
    for number, unit in enumerate(units[1:], 2):
        if not alike(first, unit):
            raise InputError(
                f"Unit {number} differs from the first in schedule, labels, site, fixture or stated noise, but units "
                "that are calibrated together have these in common: calibrate it by itself."
            )
    return _joined(units)


def _joined(units: Sequence[PreparedRecording]) -> PreparedUnits:
    first = units[0]
    by_unit = ("gyro_mean", "gyro_halves", "accel_halves", "accel_mean", "gyro_excess", "accel_excess")
    windows = replace(
        first.windows, **{name: np.stack([getattr(unit.windows, name) for unit in units]) for name in by_unit}
    )
    shared = {f.name: getattr(first, f.name) for f in fields(PreparedRecording)}
    return PreparedUnits(**{**shared, "windows": windows}, units=tuple(units))


def alike(first: PreparedRecording, unit: PreparedRecording) -> bool:
    """True if two units went through one schedule on one fixture.

    The rotations may differ in length, as in runs of one schedule that are executed one after another, unless an
    instability of the biases makes the times matter.
    """
    a, b = first.recording, unit.recording
    if (a.site, a.fixture, a.kind, a.noise) != (b.site, b.fixture, b.kind, b.noise):
        return False
    if first.untimed != unit.untimed or not all(
        np.array_equal(getattr(first, name), getattr(unit, name)) for name in ("start", "end")
    ):
        return False
    if np.array_equal(first.windows.samples, unit.windows.samples) and first.labels == unit.labels:
        return np.array_equal(a.interval_s, b.interval_s)
    return (
        isinstance(a.interval_s, float)
        and a.interval_s == b.interval_s
        and np.array_equal(first.windows.duration_s, unit.windows.duration_s)
        and not any(own.noise.gyro_flicker is not None or own.noise.accel_flicker.any() for own in (first, unit))
    )
