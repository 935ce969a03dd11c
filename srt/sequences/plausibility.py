"""Plausibility of readings: wrong units and interruptions, from means and extremes.

An uncalibrated IMU may have errors of 80 %. Therefore a specific force at rest of 0.185 to 2.1 g, and rotations of 0.35
to 1.8 times the label, are accepted. A wrong unit changes all windows by the same factor, mostly a much larger one. A
deviation in one window only is a wrong label or a disturbance.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG
from srt.exceptions import DataError
from srt.sequences.wrong_units import WRONG_UNITS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike

    from srt.recording.recording import Recording
    from srt.types import Array, Mask, Sensor

LEGAL_RATIO: Final[dict[Sensor, tuple[float, float]]] = {"gyro": (0.35, 1.8), "accel": (0.185, 2.1)}
"""Accepted ratio of reading to truth for an uncalibrated IMU. Accelerometers: scale-factor errors of 80 % with
misalignments and biases; the nearest wrong units have 0.102 (g; 1.8 times that is 0.184) and 3.28 (ft/s²). Gyros: 50 %
and a bias; a time base that is off by a factor of two has 2.0."""

_MATCH = math.log(1.8)  # largest distance of a ratio from a cause: the errors of an uncalibrated sensor
_COUNTS_ABOVE = 60.0  # above it (degrees declared as radians: 57), raw counts are possible too
_AS_GOOD = math.log(1.25)  # a second cause this close to the best one is named too

_NAMES: Final[dict[Sensor, str]] = {"gyro": "gyro", "accel": "accelerometer"}
_INCREMENTS = "the values look like increments per sample, declared as rates"
_RATES = 'the values look like rates, declared as increments (key kind of recording.toml, or argument: "rate")'

SHORTEST_INTERVAL_S: Final = 5e-6
LONGEST_INTERVAL_S: Final = 0.5


def check_interval(recording: Recording) -> None:
    """Refuse an implausible sampling interval, which mostly means a wrong time unit.

    Raises
    ------
    DataError
        An interval outside 5 µs to 0.5 s.
    """
    interval = recording.nominal_interval_s
    if not SHORTEST_INTERVAL_S <= interval <= LONGEST_INTERVAL_S:
        faster = "record at 10 Hz or more, or " if interval > LONGEST_INTERVAL_S else ""
        raise DataError(
            f"The samples are {interval:.3g} s apart, but {SHORTEST_INTERVAL_S:g} to "
            f"{LONGEST_INTERVAL_S:g} s is expected: {faster}check the time unit (key time_unit of recording.toml, or "
            "argument)."
        )


def check_rest(
    mean_accel: ArrayLike, gravity: float, labels: Callable[[], Sequence[str]], *, interval_s: float | None = None
) -> None:
    """Refuse implausible accelerometer means at rest.

    Parameters
    ----------
    mean_accel : array_like, shape (k, 3), m/s²
        Mean uncompensated specific force of each stationary window.
    gravity : float
        m/s².
    labels : callable
        Returns the name of each window in messages.
    interval_s : float, optional
        Sampling interval, with which increments taken for rates (or back) are recognised.

    Raises
    ------
    DataError
        A magnitude outside 0.185 to 2.1 g, with its likely cause.
    """
    magnitude = np.linalg.norm(np.asarray(mean_accel, dtype=np.float64).reshape(-1, 3), axis=1)
    ratio = magnitude / gravity
    bad = np.flatnonzero(~_is_legal(ratio, "accel"))
    if bad.size == 0:
        return
    typical, names = float(np.median(ratio)), labels()
    if _is_legal(typical, "accel"):
        k = int(bad[0])
        raise DataError(
            f"{names[k]}: the accelerometers read {magnitude[k]:.4g} m/s² in the mean, but about "
            f"{gravity:.4g} is expected at rest ({bad.size} of {ratio.size} windows): the unit moved, or a "
            "reading is clipped; correct the window, or leave it out."
        )
    raise DataError(
        f"At rest the accelerometers read {typical * gravity:.4g} m/s² ({bad.size} of {ratio.size} windows, "
        f"first {names[int(bad[0])]}), but about {gravity:.4g} is expected: "
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
    return None if _is_legal(ratio, "accel") else _cause(ratio, "accel", interval_s)


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
    bad = np.flatnonzero(~_is_legal(ratio, "gyro"))
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
    cause = _cause(typical, "gyro", interval_s)
    raise DataError(f"{labels[k]}: {found}, and the other turns are like it: {cause}; correct gyro_unit or kind.")


def _is_legal(ratio: float | Array, sensor: Sensor) -> Mask:
    low, high = LEGAL_RATIO[sensor]
    return np.asarray((ratio >= low) & (ratio <= high))


def _cause(ratio: float, sensor: Sensor, interval_s: float | None) -> str:
    """Likely cause of a ratio, or the two causes that explain it about equally well."""
    if ratio < 1e-6:
        return f"the {_NAMES[sensor]} columns hold nothing, or something else"
    causes = [(each.factor, str(each)) for each in WRONG_UNITS[sensor]]
    if interval_s is not None:
        causes += [(interval_s, _INCREMENTS), (1.0 / interval_s, _RATES)]
    distance = sorted((abs(math.log(ratio / factor)), text) for factor, text in causes)
    nearest = distance[0][0]
    if nearest > _MATCH and ratio > 5.0:
        return "the values look like counts; state the unit as counts, with the value of one"
    if nearest > _MATCH:
        return f"no known unit explains it; check which columns hold the {_NAMES[sensor]} readings"
    named = [text for d, text in distance[:2] if d - nearest <= _AS_GOOD]
    if ratio > _COUNTS_ABOVE:
        named.append("raw counts declared as a unit")
    return ", or ".join(named)
