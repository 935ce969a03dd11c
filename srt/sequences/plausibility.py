"""Plausibility of readings: wrong units, clipped readings and interruptions, from means and extremes.

An uncalibrated IMU may have errors of 80 %. Therefore a specific force at rest of 0.185 to 2.1 g, and rotations of 0.35
to 1.8 times the label, are accepted. A wrong unit changes all windows by the same factor, mostly a much larger one. A
deviation in one window only is a wrong label or a disturbance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG, STANDARD_GRAVITY_M_S2
from srt.exceptions import DataError
from srt.model.table1 import AXES
from srt.noise.noise_model import smallest_step
from srt.sequences.wrong_units import WRONG_UNITS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from srt.recording.recording import Recording
    from srt.types import Array, Indices, Mask, Sensor

LEGAL_RATIO: Final[dict[Sensor, tuple[float, float]]] = {"gyro": (0.35, 1.8), "accel": (0.185, 2.1)}
"""Accepted ratio of reading to truth for an uncalibrated IMU. Accelerometers: scale-factor errors of 80 % with
misalignments and biases; the nearest wrong units have 0.102 (g; 1.8 times that is 0.184) and 3.28 (ft/s²). Gyros: 50 %
and a bias; a time base that is off by a factor of two has 2.0."""

_MATCH = math.log(1.8)  # largest distance of a ratio from a cause: the errors of an uncalibrated sensor
_COUNTS_ABOVE = 60.0  # above it (degrees declared as radians: 57), raw counts are possible too
_AS_GOOD = math.log(1.25)  # a second cause this close to the best one is named too

_INCREMENTS = "the values look like increments per sample, declared as rates"
_RATES = 'the values look like rates, declared as increments (key kind of recording.toml: "rate")'

_NO_NOISE: Final = 1e-7
"""Ratio of the second difference of successive readings to the largest reading, below which readings are noise-free:
the Earth rate in a rotation of 1 rad/s makes 1e-8 at 100 Hz, the noise of a navigation-grade unit 1e-5."""

_HELD: Final = 50
"""Number of equal readings of a pulse output in a row from which an extreme is held: by chance at 4 % of the rates."""

_WANDERS: Final = 0.6
"""Wander of running sums over so many samples, in pulses, above which noise moves a reading: a quarter of a pulse for
each sample leaves so many equal ones the probability 1e-7; without noise the pulses alone wander by 0.3."""

_WANDER_PIECES: Final = 200
"""Number of pieces of a recording that show this wander."""

_MOSTLY_NOISY: Final = 0.5
"""Share of repeated extreme readings with noise in another channel of the triad, above which they are clipped."""

_IN_A_ROW: Final = 3
"""Smallest number of extreme readings in a row that are clipped."""

_LARGEST: Final = 2000
"""Number of largest readings of a channel, which tell how often they repeat."""

_CHANCE: Final = 1e-6
"""Probability that the extreme of a channel repeats in a row by chance: 1.2e-5 for the twelve extremes."""

_PILE: Final = 23
"""Number of readings at an extreme from which they are clipped. In the tail of noise each reading is one step inside
with at least the same probability, so that 23 of 23 at the extreme have 1.2e-7, 1.4e-6 for the twelve extremes."""

_PILE_RATIO: Final = 5
"""Ratio of that number to the number one step inside."""

_NOISY: Final = 0.5
"""Ratio of the resolution to the noise below which equal readings are not explained by the resolution."""

_LEAST_GYRO_RAD_S: Final = 0.2
_LEAST_ACCEL_M_S2: Final = 0.5 * STANDARD_GRAVITY_M_S2
"""Smallest accepted range limits, rad/s and m/s²: an output fixed at zero (dead band) is another fault."""

_RANGE_MARGIN: Final = 0.999
"""Ratio of the largest count to the rounded range of the data sheet."""

_BEYOND: Final = 1.001
"""Ratio of a reading to the stated range above which the range is wrong, because it did not limit the reading."""

_LARGEST_COUNT: Final = 2 ** np.array([12, 14, 16, 18, 20, 24]) // 2
"""Full scale of signed converters, counts."""

_MEDIAN_OF_DIFFERENCES: Final = 0.954
"""Median absolute difference of two readings with normal noise, in sigma of one reading: 0.6745 √2."""

_STRETCHES: Final = 8
_STRETCH: Final = 1000
"""Number of stretches of readings, and their length in samples, from which resolution and noise are estimated."""

_REPEATS: Final = 0.2
"""Share of readings equal to the one before, above which the resolution is coarse (pulses, or a unit at rest)."""

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
    """Refuse an implausible sampling interval, which mostly means a wrong time unit.

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
    """Refuse implausible accelerometer means at rest.

    Parameters
    ----------
    mean_accel : array_like, shape (k, 3), m/s²
        Mean uncompensated specific force of each stationary window.
    gravity : float
        m/s².
    labels : sequence of str
        Name of each window in messages.
    interval_s : float, optional
        Sampling interval, with which increments taken for rates (or back) are recognised.

    Raises
    ------
    DataError
        A magnitude outside 0.185 to 2.1 g, with its likely cause.
    """
    magnitude = np.linalg.norm(np.asarray(mean_accel, dtype=np.float64).reshape(-1, 3), axis=1)
    ratio = magnitude / gravity
    bad = _illegal(ratio, "accel")
    if bad.size == 0:
        return
    typical = float(np.median(ratio))
    if _is_legal(typical, "accel"):
        k = int(bad[0])
        raise DataError(
            f"{labels[k]}: the accelerometers read {magnitude[k]:.4g} m/s² in the mean, but about "
            f"{gravity:.4g} is expected at rest ({bad.size} of {ratio.size} windows): the unit moved, or a "
            "reading is clipped; correct the window, or leave it out."
        )
    raise DataError(
        f"At rest the accelerometers read {typical * gravity:.4g} m/s² ({bad.size} of {ratio.size} windows, "
        f"first {labels[int(bad[0])]}), but about {gravity:.4g} is expected: "
        f"{size_cause(typical * gravity, gravity, interval_s)}; correct accel_unit or kind."
    )


def size_cause(force: float, gravity: float, interval_s: float | None = None) -> str | None:
    """Likely cause of an implausible size of specific force; None if it is plausible at rest.

    Parameters
    ----------
    force : float
        Typical size, m/s².
    gravity : float
        m/s².
    interval_s : float, optional
        Sampling interval, with which increments taken for rates (or back) are recognised.
    """
    ratio = force / gravity
    if _is_legal(ratio, "accel"):
        return None
    return _likely_cause(ratio, "accel", interval_s) or _unknown_cause(ratio, "accelerometer")


def check_turns(
    angle_rad: ArrayLike, nominal_rad: ArrayLike, labels: Sequence[str], *, interval_s: float | None = None
) -> None:
    """Refuse implausible gyro angles.

    Parameters
    ----------
    angle_rad : array_like, shape (k,), rad
        Uncompensated gyro angle of each turn, along its nominal axis.
    nominal_rad : array_like, shape (k,), rad
        Signed angle that its label states.
    labels : sequence of str
        Name of each rotation in messages.
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
    bad = _illegal(ratio, "gyro")
    if bad.size == 0:
        return
    k = int(bad[0])
    found = f"the gyros turned by {angle[k] / DEG:.4g}°, but {nominal[k] / DEG:.4g}° is stated"
    typical = float(np.median(np.abs(ratio)))
    if _is_legal(typical, "gyro"):
        cause = "correct its id, its windows, or the order and sign of the gyro axes"
        if ratio[k] < 0.0 and _is_legal(-float(ratio[k]), "gyro"):
            cause = "it turned the other way, or an axis of the gyros is reversed; correct its id, or the sign"
        raise DataError(f"{labels[k]}: {found} ({bad.size} of {ratio.size} turns): {cause}.")
    cause = _likely_cause(typical, "gyro", interval_s) or _unknown_cause(typical, "gyro")
    raise DataError(f"{labels[k]}: {found}, and the other turns are like it: {cause}; correct gyro_unit or kind.")


def clipping_levels(recording: Recording) -> ClippingLevels:
    """Find the readings at which channels are clipped, from the stated range and from the readings.

    A noisy channel does not repeat its extreme reading. Clipped, whatever range is stated, are three equal readings in
    a row at the extreme, or more where large readings repeat by chance; many more readings there than one step inside;
    several at the full scale of a converter with fewer beside them. Pulses are clipped where several axes or senses
    hold one extreme. Other coarse, and noise-free readings repeat at any value: clipping is then found by the stated
    range only.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    ClippingLevels
    """
    return recording.memo("clipping levels", lambda: _clipping_levels(recording))


def _clipping_levels(recording: Recording) -> ClippingLevels:
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
            # A pulse output adds the remainder of the previous sample.
            beyond = (_BEYOND * stated + 2.0 * (pulse or 0.0) / dt) * per_sample
            if _RANGE_MARGIN * stated * per_sample <= peak <= beyond:
                high[3 * s : 3 * s + 3] = _RANGE_MARGIN * stated * per_sample
                low[3 * s : 3 * s + 3] = -_RANGE_MARGIN * stated * per_sample
        triad = slice(3 * s, 3 * s + 3)
        bottom, top = _limits_seen(values, least * per_sample)
        low[triad], high[triad] = np.maximum(low[triad], bottom), np.minimum(high[triad], top)
        if pulse is not None:
            held = _held_pulses(values, least * per_sample, pulse * per_sample / dt)
            low[triad], high[triad] = np.maximum(low[triad], held[0]), np.minimum(high[triad], held[1])
    return ClippingLevels(low, high)


def _limits_seen(triad: Array, least: float) -> tuple[Array, Array]:
    """Lowest and highest readings of the channels of a triad if they are range limits; otherwise infinite."""
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    starts = np.linspace(0, max(len(triad) - _STRETCH, 0), _STRETCHES).astype(int)
    some = np.concatenate([triad[a : a + _STRETCH] for a in starts.tolist()])
    # Channel by channel: a reduction over the rows of three readings takes ten times as long.
    smallest, largest = np.array([(channel.min(), channel.max()) for channel in triad.T]).T
    smooth = _NO_NOISE * float(max(largest.max(), -smallest.min()))
    for axis in range(3):
        channel = np.ascontiguousarray(triad[:, axis])
        ends = ((-1.0, low, smallest[axis]), (1.0, high, largest[axis]))
        # A channel is not clipped at an extreme that it reads once.
        repeated = [(sign, limits) for sign, limits, end in ends if np.count_nonzero(channel == end) > 1]
        if not repeated:
            continue
        inner = (some[:, axis] > smallest[axis]) & (some[:, axis] < largest[axis])
        differences = np.abs(np.diff(some[:, axis]))[inner[1:] & inner[:-1]]
        if not differences.size or np.mean(differences == 0.0) > _REPEATS:
            continue
        step = float(smallest_step(some[inner, axis][:, None])[0])
        noise = float(np.median(differences)) / _MEDIAN_OF_DIFFERENCES
        if step > _NOISY * noise:
            continue
        for sign, limits in repeated:
            extreme = float(largest[axis] if sign > 0.0 else -smallest[axis])
            if extreme > least and _is_limit(sign * channel, (extreme, step, noise), triad, axis, smooth):
                limits[axis] = sign * extreme
    return low, high


def _held_pulses(triad: Array, least: float, pulse: float) -> tuple[Array, Array]:
    """Lowest and highest readings of channels with pulses if they are range limits; otherwise infinite.

    The remainder of a pulse is carried to the next sample, so that readings stay equal only where a sample has a whole
    number of pulses: for n samples, within 1/n of it. Two axes, or senses of one, do so at the largest reading of the
    triad only if it is clipped there; a channel whose noise adds up to pulses does so at its largest reading.
    """
    peak = float(np.abs(triad).max())
    held = np.array([[_longest_run(triad[:, axis] == sign * peak) >= _HELD for axis in range(3)] for sign in (-1, 1)])
    seen = held & (peak > least) & (held.sum() > 1)
    low, high = np.where(seen[0], -peak, -np.inf), np.where(seen[1], peak, np.inf)
    for axis in np.flatnonzero(_wander_of_sums(triad) > _WANDERS * pulse).tolist():
        channel = triad[:, axis]
        smallest, largest = float(channel.min()), float(channel.max())
        if smallest < -least and _longest_run(channel == smallest) >= _HELD:
            low[axis] = smallest
        if largest > least and _longest_run(channel == largest) >= _HELD:
            high[axis] = largest
    return low, high


def _wander_of_sums(triad: Array) -> Array:
    """Standard deviation of running sums about a line, over as many samples as count as held, by channel; typical."""
    starts = np.linspace(0, len(triad) - _HELD, _WANDER_PIECES).astype(int) if len(triad) > _HELD else np.zeros(0, int)
    if not starts.size:
        return np.zeros(3)
    pieces = triad[starts[:, None] + np.arange(_HELD)]
    sums = np.cumsum(pieces - pieces.mean(axis=1, keepdims=True), axis=1)
    return np.asarray(np.median(sums.std(axis=1), axis=0))


def _longest_run(at: Mask) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], at, [False]))))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _is_limit(channel: Array, levels: tuple[float, float, float], triad: Array, axis: int, smooth: float) -> bool:
    """Return True if noisy readings are clipped at their largest value; ``levels`` are that, their step and noise.

    A noise-free rotation at a constant rate also repeats its extreme, but then the other axes are ``smooth`` too.
    """
    extreme, step, noise = levels
    # Only readings close to the extreme matter, and there are few.
    close = np.flatnonzero(channel >= extreme - max(1.5 * step, noise))
    below = extreme - channel[close]
    at = close[below == 0.0]
    held = at[:-2][at[2:] - at[:-2] == 2]
    if held.size:
        roughness = np.abs(triad[held + 2] - 2.0 * triad[held + 1] + triad[held])
        noisy = float(np.mean(np.any(np.delete(roughness, axis, axis=1) > smooth, axis=1))) > _MOSTLY_NOISY
        if not noisy or _longest_run(channel == extreme) >= _fewest_in_a_row(channel, extreme):
            return noisy
    # Pulses that were corrected repeat a reading with those of the other axes: such rows count once.
    count = len(np.unique(triad[at], axis=0))
    inside = int(np.count_nonzero((below < 1.5 * step) & (below > 0.5 * step)))
    # Normal noise has many readings in the sigma below its largest; a shake that reaches the limit has few.
    tail = int(np.count_nonzero((below < noise) & (below > 0.0)))
    # Two's complement: the negative full scale is one count larger.
    full_scale = step > 0.0 and bool(np.any(np.abs(extreme / step - _LARGEST_COUNT + 0.5) <= 0.51))
    return (count >= _PILE and count >= _PILE_RATIO * inside) or (full_scale and count > max(1, tail))


def _fewest_in_a_row(channel: Array, extreme: float) -> int:
    """Number of extreme readings in a row that chance does not make, by how often large readings repeat.

    Filtered readings repeat where the sample that enters the filter equals the one that leaves it.
    """
    below = channel[:-1] < extreme
    large = below & (channel[:-1] >= np.partition(channel, -min(len(channel), _LARGEST))[-min(len(channel), _LARGEST)])
    repeats = np.count_nonzero(channel[1:][large] == channel[:-1][large])
    rate = (repeats + 1.0) / (np.count_nonzero(large) + 2.0)
    return max(_IN_A_ROW, 1 + math.ceil(math.log(_CHANCE) / math.log(rate)))


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


def _is_legal(ratio: float, sensor: Sensor) -> bool:
    low, high = LEGAL_RATIO[sensor]
    return low <= ratio <= high


def _illegal(ratio: Array, sensor: Sensor) -> Indices:
    low, high = LEGAL_RATIO[sensor]
    return np.flatnonzero(~((ratio >= low) & (ratio <= high)))


def _likely_cause(ratio: float, sensor: Sensor, interval_s: float | None) -> str | None:
    """Likely cause of a ratio, or the two causes that explain it about equally well."""
    if ratio <= 0.0:
        return None
    causes = [(each.factor, str(each)) for each in WRONG_UNITS[sensor]]
    if interval_s is not None:
        causes += [(interval_s, _INCREMENTS), (1.0 / interval_s, _RATES)]
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
