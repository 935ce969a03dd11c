"""Plausibility of readings: wrong units, clipped readings and interruptions, told from means and extremes.

A unit may be wrong by half before it is calibrated, so only what no such unit could read is refused: a rest
of 0.35 to 1.8 g and turns of 0.35 to 1.8 times the label are believed. A wrong unit is off by a factor of its
own, mostly far beyond that, and the same in every window; one window off alone is a wrong label or a
disturbance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import ARCSEC, DEG, STANDARD_GRAVITY_M_S2
from srt.exceptions import DataError
from srt.model.table1 import AXES
from srt.noise.noise_model import smallest_step

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from srt.recording.recording import Recording
    from srt.types import Array, Indices, Mask

LEGAL_RATIO: Final = (0.35, 1.8)
"""Reading over truth of an uncalibrated unit: 50 % of scale factor, and 1 m/s² or its like of bias."""

_MATCH = math.log(1.8)  # a unit is recognised through the errors of an uncalibrated sensor
_COUNTS_ABOVE = 60.0  # no factor above a right angle in degrees is told for sure from counts
_AS_GOOD = math.log(1.25)  # causes that lie so close to the best one are named with it

_G = STANDARD_GRAVITY_M_S2
_ACCEL_CAUSES = (
    (1.0 / _G, "the values look like g, declared as m/s²"),
    (_G, "the values look like m/s², declared as g"),
    (1e3 / _G, "the values look like mg, declared as m/s²"),
    (1e3, "the values look like mg declared as g, or like mm/s²"),
    (1e-3, "the values look like g, declared as mg"),
    (1e-3 * _G, "the values look like m/s², declared as mg"),
    (1.0 / 0.3048, "the values look like ft/s², declared as m/s²"),
    (100.0, "the values look like cm/s², declared as m/s²"),
)
_GYRO_CAUSES = (
    (1.0 / DEG, "the values look like degrees, declared as radians"),
    (DEG, "the values look like radians, declared as degrees"),
    (1.0 / ARCSEC, "the values look like deg/h, declared as rad/s"),
    (ARCSEC, "the values look like rad/s, declared as deg/h"),
    (3600.0, "the values look like deg/h, declared as deg/s"),
    (1.0 / 3600.0, "the values look like deg/s, declared as deg/h"),
    (30.0 / math.pi, "the values look like revolutions per minute, declared as rad/s"),
    (1e3, "the values look like thousandths of the declared unit"),
)
_INCREMENTS = "the values look like increments per sample, declared as rates"
_RATES = 'the values look like rates, declared as increments (key kind of recording.toml: "rate")'

_NO_NOISE: Final = 1e-7
"""Second difference of neighbouring readings over the largest reading, below which there is no noise: the Earth's rate
in a turn of 1 rad/s makes 1e-8 at 100 Hz, a navigation unit's noise 1e-5."""

_MOSTLY_NOISY: Final = 0.5
"""Share of the held readings during which another channel of the triad is noisy: clipping silences one alone."""

_PILE: Final = 5
"""Readings at an extreme, and their number over that of the readings one step inside, that no noise makes."""

_NOISY: Final = 0.5
"""Step of the readings over their noise, below which equal readings are no matter of resolution."""

_LEAST_GYRO_RAD_S: Final = 0.2
_LEAST_ACCEL_M_S2: Final = 0.5 * _G
"""Smallest ranges that are believed: an output held at zero (dead band) is another fault."""

_RANGE_MARGIN: Final = 0.999
"""Largest count over the round figure of the data sheet."""

_BEYOND: Final = 1.001
"""Reading over the stated range, from which the range is stated wrongly: it did not stop the reading."""

_LARGEST_COUNT: Final = 2 ** np.array([12, 14, 16, 18, 20, 24]) // 2
"""Full scale of signed converters, counts."""

_MEDIAN_OF_DIFFERENCES: Final = 0.954
"""Median of the absolute difference of two normal readings, in sigmas of one: 0.6745 √2."""

_STRETCHES: Final = 8
_STRETCH: Final = 1000
"""Number and length of the stretches of readings that resolution and noise are taken from."""

_REPEATS: Final = 0.2
"""Share of readings that equal the one before, above which the resolution is coarse: pulses, or a unit at rest."""

SHORTEST_INTERVAL_S: Final = 5e-6
LONGEST_INTERVAL_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class ClippingLevels:
    """Readings beyond which a channel is clipped, in the units of the recording's columns.

    Attributes
    ----------
    low, high : ndarray, shape (6,)
        gyro x, y, z, accelerometer x, y, z; infinite where no limit is known or seen.
    """

    low: Array
    high: Array


@dataclass(frozen=True, slots=True)
class Clipping:
    """One channel that reached its limit.

    Attributes
    ----------
    channel : str
        Name of the column.
    count : int
        Samples at the limit.
    first_s : float
        Time of the first of them, s.
    """

    channel: str
    count: int
    first_s: float

    def __str__(self) -> str:
        return f"{self.channel} is at the limit of its range in {self.count} samples, from {self.first_s:.6g} s"


def check_interval(recording: Recording) -> None:
    """Refuse a sampling interval that no strapdown IMU has, mostly a wrong time unit.

    Parameters
    ----------
    recording : Recording

    Raises
    ------
    DataError
        An interval outside 5 µs to 0.5 s.
    """
    interval = recording.nominal_interval_s
    if not SHORTEST_INTERVAL_S <= interval <= LONGEST_INTERVAL_S:
        raise DataError(
            f"The samples are {interval:.3g} s apart, but {SHORTEST_INTERVAL_S:g} to "
            f"{LONGEST_INTERVAL_S:g} s is expected: check the time unit (key time_unit of recording.toml)."
        )


def check_rest(
    mean_accel: ArrayLike, gravity: float, labels: Sequence[str], *, interval_s: float | None = None
) -> None:
    """Refuse accelerometer means at rest that no unit could read.

    Parameters
    ----------
    mean_accel : array_like, shape (k, 3), m/s²
        Mean uncompensated specific force of each stationary window.
    gravity : float
        m/s².
    labels : sequence of str
        What messages call each window.
    interval_s : float, optional
        Sampling interval, with which increments taken for rates (or back) are recognised.

    Raises
    ------
    DataError
        A magnitude outside 0.35 to 1.8 g, with its likely cause.
    """
    magnitude = np.linalg.norm(np.asarray(mean_accel, dtype=np.float64).reshape(-1, 3), axis=1)
    ratio = magnitude / gravity
    bad = _illegal(ratio)
    if bad.size == 0:
        return
    typical = float(np.median(ratio))
    if _is_legal(typical):
        k = int(bad[0])
        raise DataError(
            f"{labels[k]}: the accelerometers read {magnitude[k]:.4g} m/s² in the mean, but about "
            f"{gravity:.4g} is expected at rest ({bad.size} of {ratio.size} windows): the unit moved, or a "
            "reading is clipped; correct the window, or leave it out."
        )
    cause = _likely_cause(typical, _ACCEL_CAUSES, interval_s) or _unknown_cause(typical, "accelerometer")
    raise DataError(
        f"At rest the accelerometers read {typical * gravity:.4g} m/s² ({bad.size} of {ratio.size} windows, "
        f"first {labels[int(bad[0])]}), but about {gravity:.4g} is expected: {cause}; "
        "correct accel_unit or kind."
    )


def check_turns(
    angle_rad: ArrayLike, nominal_rad: ArrayLike, labels: Sequence[str], *, interval_s: float | None = None
) -> None:
    """Refuse turns that no gyros could have read so.

    Parameters
    ----------
    angle_rad : array_like, shape (k,), rad
        Uncompensated gyro angle of each turn, along its nominal axis.
    nominal_rad : array_like, shape (k,), rad
        Signed angle that its label states.
    labels : sequence of str
        What messages call each turn.
    interval_s : float, optional
        Sampling interval, with which increments taken for rates (or back) are recognised.

    Raises
    ------
    DataError
        A ratio outside 0.35 to 1.8, with its likely cause.
    """
    angle = np.atleast_1d(np.asarray(angle_rad, dtype=np.float64))
    nominal = np.atleast_1d(np.asarray(nominal_rad, dtype=np.float64))
    ratio = angle / nominal
    bad = _illegal(ratio)
    if bad.size == 0:
        return
    k = int(bad[0])
    found = f"the gyros turned by {angle[k] / DEG:.4g}°, but {nominal[k] / DEG:.4g}° is stated"
    typical = float(np.median(np.abs(ratio)))
    if _is_legal(typical):
        cause = "correct its id, its windows, or the order and sign of the gyro axes"
        if ratio[k] < 0.0 and _is_legal(-float(ratio[k])):
            cause = "it turned the other way, or an axis of the gyros is reversed; correct its id, or the sign"
        raise DataError(f"{labels[k]}: {found} ({bad.size} of {ratio.size} turns): {cause}.")
    cause = _likely_cause(typical, _GYRO_CAUSES, interval_s) or _unknown_cause(typical, "gyro")
    raise DataError(f"{labels[k]}: {found}, and the other turns are like it: {cause}; correct gyro_unit or kind.")


def clipping_levels(recording: Recording) -> ClippingLevels:
    """Find the readings at which channels are clipped, stated or seen.

    Readings of a noisy channel never repeat at an extreme by chance. A value held for three readings there, many more
    readings at it than one step inside, or several at the full scale of a converter, is a limit, whatever range is
    stated. Coarse and noise-free readings repeat everywhere: in them clipping shows only by the stated range.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    ClippingLevels
    """
    dt = recording.nominal_interval_s
    per_sample = dt if recording.kind == "increment" else 1.0
    low, high = np.full(6, -np.inf), np.full(6, np.inf)
    noise = recording.noise
    sensors = (
        (recording.gyro, noise.gyro_range, noise.gyro_quantization, _LEAST_GYRO_RAD_S),
        (recording.accel, noise.accel_range, noise.accel_quantization, _LEAST_ACCEL_M_S2),
    )
    for s, (values, stated, pulse, least) in enumerate(sensors):
        if stated is not None:
            peak = max(float(values.max()), -float(values.min()))
            # Pulses carry over what is left of the sample before.
            beyond = (_BEYOND * stated + 2.0 * (pulse or 0.0) / dt) * per_sample
            if _RANGE_MARGIN * stated * per_sample <= peak <= beyond:
                high[3 * s : 3 * s + 3] = _RANGE_MARGIN * stated * per_sample
                low[3 * s : 3 * s + 3] = -_RANGE_MARGIN * stated * per_sample
        triad = slice(3 * s, 3 * s + 3)
        bottom, top = _limits_seen(values, least * per_sample)
        low[triad], high[triad] = np.maximum(low[triad], bottom), np.minimum(high[triad], top)
    return ClippingLevels(low, high)


def _limits_seen(triad: Array, least: float) -> tuple[Array, Array]:
    """Lowest and highest readings of the channels of a triad where they are limits; infinite where they are not."""
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    starts = np.linspace(0, max(len(triad) - _STRETCH, 0), _STRETCHES).astype(int)
    some = np.concatenate([triad[a : a + _STRETCH] for a in starts.tolist()])
    # Without noise a turn at one rate repeats its extreme too, but then the other channels are smooth meanwhile.
    roughness = np.abs(triad[2:] - 2.0 * triad[1:-1] + triad[:-2])
    noisy = roughness > _NO_NOISE * float(np.abs(triad).max())
    for axis in range(3):
        channel = triad[:, axis]
        inner = (some[:, axis] > channel.min()) & (some[:, axis] < channel.max())
        differences = np.abs(np.diff(some[:, axis]))[inner[1:] & inner[:-1]]
        if not differences.size or np.mean(differences == 0.0) > _REPEATS:
            continue
        step = float(smallest_step(some[inner, axis][:, None])[0])
        if step > _NOISY * float(np.median(differences)) / _MEDIAN_OF_DIFFERENCES:
            continue
        others = np.asarray(np.any(np.delete(noisy, axis, axis=1), axis=1))
        for sign, limits in ((-1.0, low), (1.0, high)):
            extreme = float((sign * channel).max())
            if extreme > least and _is_limit(sign * channel, extreme, step, others):
                limits[axis] = sign * extreme
    return low, high


def _is_limit(channel: Array, extreme: float, step: float, others_noisy: Mask) -> bool:
    """Tell whether noisy readings stop at their largest value."""
    at = channel == extreme
    held = at[2:] & at[1:-1] & at[:-2]
    if held.any():
        return float(np.mean(others_noisy[held])) > _MOSTLY_NOISY
    count, inside = int(at.sum()), int(np.sum(np.abs(channel - (extreme - step)) < 0.5 * step))
    # Two's complement reaches one count farther down.
    full_scale = step > 0.0 and bool(np.any(np.abs(extreme / step - _LARGEST_COUNT + 0.5) <= 0.51))
    return (count >= _PILE and count >= _PILE * inside) or (full_scale and count > 1)


def clipped_samples(recording: Recording, part: slice, levels: ClippingLevels | None = None) -> tuple[Clipping, ...]:
    """Find the channels that are clipped in a part of a recording; a sequence with any of them is void.

    Parameters
    ----------
    recording : Recording
    part : slice
        Samples to look at.
    levels : ClippingLevels, optional
        From :func:`clipping_levels`, to be found once for all parts of a recording.

    Returns
    -------
    tuple of Clipping
        Empty: nothing is clipped.
    """
    levels = clipping_levels(recording) if levels is None else levels
    found = []
    for s, (sensor, values) in enumerate((("gyro", recording.gyro), ("accel", recording.accel))):
        block = values[part]
        mine = slice(3 * s, 3 * s + 3)
        if not (np.isfinite(levels.high[mine]).any() or np.isfinite(levels.low[mine]).any()):
            continue
        beyond = (block >= levels.high[mine]) | (block <= levels.low[mine])
        for axis in np.flatnonzero(beyond.any(axis=0)):
            at = np.flatnonzero(beyond[:, axis])
            first = float(recording.time[part][at[0]])
            found.append(Clipping(f"{sensor}_{AXES[axis]}", int(at.size), first))
    return tuple(found)


def gap_inside(recording: Recording, part: slice) -> Indices:
    """Find the interruptions inside a part of a recording, across which nothing can be integrated.

    Parameters
    ----------
    recording : Recording
    part : slice
        Samples of a sequence.

    Returns
    -------
    ndarray of int
        Indices of the samples that follow an interruption; one right before the part is outside it.
    """
    gaps = recording.gaps
    inside: Indices = gaps[(gaps > part.start) & (gaps < part.stop)]
    return inside


def _is_legal(ratio: float) -> bool:
    return LEGAL_RATIO[0] <= ratio <= LEGAL_RATIO[1]


def _illegal(ratio: Array) -> Indices:
    return np.flatnonzero(~((ratio >= LEGAL_RATIO[0]) & (ratio <= LEGAL_RATIO[1])))


def _likely_cause(ratio: float, causes: tuple[tuple[float, str], ...], interval_s: float | None) -> str | None:
    """Name the cause, or the two causes that explain a ratio about equally well."""
    if ratio <= 0.0:
        return None
    if interval_s is not None:
        causes = (*causes, (interval_s, _INCREMENTS), (1.0 / interval_s, _RATES))
    distance = sorted((abs(math.log(ratio / factor)), text) for factor, text in causes)
    nearest = distance[0][0]
    if nearest > _MATCH:
        return None
    named = [text for d, text in distance[:2] if d - nearest <= _AS_GOOD]
    if ratio > _COUNTS_ABOVE:
        named.append("raw counts declared as a unit")
    return ", or ".join(named)


def _unknown_cause(ratio: float, sensor: str) -> str:
    if ratio < 1e-6:
        return f"the {sensor} columns hold nothing, or something else"
    if ratio > 5.0:
        return "the values look like counts; state the unit as counts, with the value of one"
    return f"no known unit explains it; check which columns hold the {sensor} readings"
