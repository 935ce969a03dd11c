"""Errors that no residual shows: time base, gravity, latitude, heading and stated rates, and what they shift.

Statements that the time stamps or the Earth contradict are of the same kind: the residuals agree with them.

All measurements share them, so that they agree however large the error is. Each has a coefficient, and a stated sigma
where the recording gives one; the sigmas of the result include it then. A latitude without sigma counts as exact.
The error of one run at a stated rate is not shared, but nothing contradicts it where no other run about that axis has
the same sense.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.constants import DEG_PER_H, EARTH_RATE_RAD_S
from srt.model.table1 import AXES
from srt.recording.timing import stamped_interval
from srt.result.diagnostics import UnseenError
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask

_PPM = 1e6
_CRYSTAL: Final = 1e-4
"""Largest relative error of the clock that stamps samples: crystals are cut to 5e-5, and change by as much."""
_SAME_RATE: Final = 1e-6
"""Largest relative difference of equal rates: a rate is typed with few digits, and a clock is not known to more."""
_EARTH_GRAVITY_M_S2: Final = (9.76, 9.84)
"""Range of gravity on land, from the highest summits of the tropics to the poles."""
_GRAVITY_SIGMAS: Final = 3.0
"""Tolerance of a stated gravity, in its sigma."""


class _Effect(NamedTuple):
    """Effect of an error on the parameters of a group; on those of some axes, "" for all."""

    group: str
    coefficient: float
    unit: str
    axes: str = ""
    largest: bool = False


def unseen_errors(data: PreparedRecording, observed: Mask) -> tuple[UnseenError, ...]:
    """Errors that no residual shows.

    Parameters
    ----------
    data : PreparedRecording
    observed : ndarray of bool, shape (27,)
        Parameters that the recording shows.
    """
    recording, site, fixture = data.recording, data.recording.site, data.recording.fixture
    clock, origin = _clock_sigma(recording)
    base = ("ppm", None if clock is None else clock * _PPM)
    rows = [_row("time base", base, effect, origin) for effect in _time_base(data)]
    gravity = ("ppm", site.gravity_sigma_m_s2 / site.gravity_m_s2 * _PPM)
    rows.append(_row("gravity", gravity, _Effect("accel_scale", -1.0, "ppm")))
    if site.latitude_rad is not None:
        # |dω/dφ| is the Earth rate itself; the poses decide how much of it falls on an axis.
        per_degree = EARTH_RATE_RAD_S * math.radians(1.0) / DEG_PER_H
        sigma = site.latitude_sigma_rad
        stated = None if sigma is None else math.degrees(sigma)
        rows.append(_row("latitude", ("°", stated), _Effect("gyro_bias", per_degree, "°/h", largest=True)))
        if fixture is not None and fixture.heading_rad is not None:
            per_mrad = EARTH_RATE_RAD_S * math.cos(site.latitude_rad) * 1e-3 / DEG_PER_H
            sigma = fixture.alignment_sigma_rad * 1e3
            rows.append(_row("heading", ("mrad", sigma), _Effect("gyro_bias", per_mrad, "°/h", largest=True)))
    return (*rows, *_stated_rates(data, observed))


def contradicted_statements(recording: Recording) -> Iterator[str]:
    """Sentences on a sample rate that contradicts the time stamps, and on a gravity that no place on Earth has."""
    excess = _rate_excess(recording)
    # One interval over the whole recording allows for the rounding of the stamps.
    if abs(excess) > _CRYSTAL + 1.0 / recording.time.size:
        stated = recording.sample_rate_hz or 0.0
        sensor = "gyro" if recording.kind == "rate" else "accelerometer"
        yield (
            f"sample_rate_hz is {stated:.6g}, but the time stamps have a rate of {stated / (1.0 + excess):.6g} Hz: if "
            f"they are right, every {sensor} scale factor is wrong by {abs(excess) * _PPM:.3g} ppm. Correct the rate, "
            "or remove it."
        )
    site = recording.site
    low, high = _EARTH_GRAVITY_M_S2
    beyond = max(low - site.gravity_m_s2, site.gravity_m_s2 - high)
    if site.latitude_rad is None and beyond > _GRAVITY_SIGMAS * site.gravity_sigma_m_s2:
        yield (
            f"gravity_m_s2 is {site.gravity_m_s2:.6g}, but gravity on Earth is {low} to {high} m/s²: every "
            f"accelerometer scale factor is wrong by at least {beyond / site.gravity_m_s2 * _PPM:.3g} ppm. Correct it, "
            "or state latitude_deg and height_m instead."
        )


def _rate_excess(recording: Recording) -> float:
    """Relative difference of a stated sample rate from that of the time stamps; zero within their precision."""
    stated = recording.sample_rate_hz
    if stated is None:
        return 0.0
    interval, largest = recording.memo("interval of stamps", lambda: stamped_interval(recording.time, recording.gaps))
    excess = stated * interval - 1.0
    return excess if abs(excess) > max(_SAME_RATE, stated * largest) else 0.0


def _clock_sigma(recording: Recording) -> tuple[float | None, str]:
    """1-sigma of the time base as stated; else what a stated sample rate differs from the stamps by, and its origin."""
    if recording.clock_sigma is not None:
        return recording.clock_sigma, ""
    excess = abs(_rate_excess(recording))
    return (excess, ", by which sample_rate_hz differs from the time stamps") if excess else (None, "")


def clock_effect(data: PreparedRecording) -> Array:
    """Effect of one sigma of the time base on the parameters, shape (27,), SI."""
    out = np.zeros(N_PARAMETERS)
    for effect in _time_base(data):
        part = np.arange(N_PARAMETERS)[GROUP_SLICES[effect.group]]
        part = part[[AXES.index(axis) for axis in effect.axes]] if effect.axes else part
        out[part] = effect.coefficient * (_clock_sigma(data.recording)[0] or 0.0)
    return out


def _time_base(data: PreparedRecording) -> list[_Effect]:
    """Effects of the time base.

    Time stretched by 1 + ε stretches the angles that rates add up to: ε of a gyro scale. Increments are angles, but
    their velocities become specific force by the time: −ε of every accelerometer scale. Runs at a stated rate compare
    rates: the time base does not matter if the gyro reads rates; increments become rates by the time: −ε of the scale.
    """
    rated = {label.rate[0] for label in data.labels if label.rate is not None}
    rotated = "".join(axis for axis in AXES if axis not in rated)
    if data.recording.kind == "rate":
        return [_Effect("gyro_scale", 1.0, "ppm", rotated if rated else "")] if rotated else []
    by_rate = [_Effect("gyro_scale", -1.0, "ppm", "".join(sorted(rated)))] if rated else []
    return [_Effect("accel_scale", -1.0, "ppm"), *by_rate]


def _stated_rates(data: PreparedRecording, observed: Mask) -> list[UnseenError]:
    """Errors of the stated rates: the common one, and that of a run which no other run contradicts.

    With an asymmetry, each sense has a scale factor of its own, κ ± κ_Asym: half of a run's error is κ's. Without, two
    runs about an axis contradict each other.
    """
    runs = [label for label in data.labels if label.rate is not None]
    if not runs:
        return []
    axes = "".join(sorted({label.rate[0] for label in runs if label.rate is not None}))
    sigma = runs[0].rate_sigma
    common = ("ppm", None if sigma is None else sigma * _PPM)
    rows = [_row("the stated rates", common, _Effect("gyro_scale", -1.0, "ppm", axes))]
    asymmetric = dict(zip(AXES, observed[GROUP_SLICES["gyro_asymmetry"]].tolist(), strict=True))
    senses = Counter(
        (axis, asymmetric[axis] and rate > 0.0) for axis, rate in (label.rate for label in runs if label.rate)
    )
    for half in (True, False):
        alone = "".join(
            sorted({axis for (axis, _), count in senses.items() if count == 1 and asymmetric[axis] == half})
        )
        if alone:
            effect = _Effect("gyro_scale", -0.5 if half else -1.0, "ppm", alone)
            run = "A second run about the axis"
            remedy = f"{run} in the same sense, at another rate," if half else run
            row = _row("one stated rate alone", ("ppm", None), effect)
            rows.append(replace(row, sentence=f"{row.sentence} {remedy} shows such an error."))
    return rows


def _row(source: str, error: tuple[str, float | None], effect: _Effect, by: str = "") -> UnseenError:
    unit, sigma = error
    size = f"{'up to ' if effect.largest else ''}{effect.coefficient:.3g} {effect.unit}"
    name = effect.group.replace("_", " ")
    where = f"every {name}" if effect.axes in ("", "".join(AXES)) else f"{name} {' and '.join(effect.axes)}"
    origin = "the time base" if source == "time base" else source
    known = "not stated" if sigma is None else f"{sigma:.3g} {unit}"
    return UnseenError(
        source=source,
        unit=unit,
        sigma=sigma,
        group=effect.group,
        axes=effect.axes or "".join(AXES),
        coefficient=effect.coefficient,
        group_unit=effect.unit,
        largest=effect.largest,
        sentence=f"An error of 1 {unit} in {origin} changes {where} by {size}. The 1-sigma of {origin} is {known}{by}.",
    )
