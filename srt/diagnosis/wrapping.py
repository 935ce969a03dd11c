"""Readings of binary words that wrap around, or whose sign is misread: jumps that no motion makes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.false_alarms import limit
from srt.diagnosis.rotation_readings import MAD, rates_factor

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices


_MOTION: Final = {"gyro": 10.0, "accel": 100.0}
"""Largest rate of change over the whole range of a channel in a motion on a fixture or by hand, rad/s² and m/s³."""
_EDGE: Final = 0.1
"""Largest deviation of a jump from the range, and width of the bands between which readings with a misread sign jump,
relative to the range: noise, and the readings missing next to a jump."""
_SYMMETRY: Final = 0.02
"""Largest distance of the middle of the range from zero, relative to the range: the range of signed words is
symmetric."""
_BESIDE: Final = 20
"""Number of samples on each side of a jump with which it is compared."""
_FLIPS: Final = 5
"""Fewest jumps per window, as noise about zero makes them if the sign is misread."""
_STAYS: Final = 5
"""Number of samples on each side of a jump over which a reading stays in its band: a shock swings back at once."""
_FEWEST: Final = 10
"""Fewest jumps with a misread sign after which the readings of an accelerometer stay in the other band."""


def wrapped_readings(
    columns: Array, recording: Recording, data: PreparedRecording | None
) -> dict[str, tuple[int, Indices]]:
    """First axis of a triad that wraps, and the numbers of the samples after its jumps, by sensor.

    Parameters
    ----------
    columns : ndarray, shape (6, n)
        Stored readings.
    recording : Recording
    data : PreparedRecording or None
    """
    found: dict[str, tuple[int, Indices]] = {}
    for channel, column in enumerate(columns):
        sensor = ("gyro", "accel")[channel // 3]
        if sensor not in found and (jumps := _jumps(column, recording, data, sensor)).size:
            found[sensor] = channel % 3, jumps
    return found


def _jumps(column: Array, recording: Recording, data: PreparedRecording | None, sensor: str) -> Indices:
    """Samples after a jump by the whole range against the slope, or between zero and one of the extremes.

    If signed words are read as unsigned ones, small negative values appear at the upper end of the range. If words of
    sign and magnitude are read as two's complement, or the reverse, they appear at the lower end. Noise about zero then
    makes gyros jump at rest. A change of sign of the gravity component makes accelerometers jump in rotations.
    """
    low, high = float(column.min()), float(column.max())
    step = np.diff(column)
    large = np.flatnonzero(np.abs(step) > 0.5 * max(-low, high)) + 1
    fastest = _MOTION[sensor] * recording.nominal_interval_s / rates_factor(recording)
    for a, b in ((low, high), (0.0, low), (0.0, high)):
        size = abs(b - a)
        if large.size == 0 or size < fastest or size < (1.0 - _EDGE) * max(-low, high):
            continue
        wraps = a != 0.0 and abs(high + low) <= _SYMMETRY * size
        if wraps:
            # The reading continues at its slope after the jump. A spike deviates by 1.5 times its size from the slope.
            jump = np.abs(step[1:-1] - 0.5 * (step[:-2] + step[2:]))
            inner = large[(large > 1) & (large < len(step))]
            inner = inner[np.abs(jump[inner - 2] - size) < _EDGE * size]
            # Vibration that reaches the extremes jumps everywhere.
            beside = np.clip(inner[:, None] - 2 + np.arange(-_BESIDE, _BESIDE + 1), 0, len(jump) - 1)
            usual: Array = limit("normal", tests=len(column), both_sides=True) * MAD * np.median(jump[beside], axis=1)
            jumps = inner[size > usual]
        else:
            apart = np.abs(column[large[:, None] + np.array([-1, 0])][:, :, None] - np.array([a, b]))
            jumps = large[np.all(apart.min(axis=2) < _EDGE * size, axis=1)]
            jumps = jumps[np.abs(step[jumps - 1]) > 0.5 * size]
        jumps = jumps[~np.isin(jumps, recording.gaps)]
        if data is not None:
            first, last = data.windows.samples[data.start, 0], data.windows.samples[data.end, 1]
            jumps = jumps[np.any((first < jumps[:, None]) & (jumps[:, None] < last), axis=1)]
        if wraps and len(jumps) >= 2:
            return jumps
        if wraps or data is None:
            continue
        windows = data.windows.samples
        inside = np.searchsorted(windows[:, 0], jumps, side="left") - 1  # a jump to the first sample is not inside
        at_rest = (inside >= 0) & (jumps < windows[np.maximum(inside, 0), 1])
        if np.count_nonzero(at_rest) >= _FLIPS * len(windows):
            return jumps
        far = jumps[(jumps >= _STAYS) & (jumps <= len(column) - _STAYS)]
        levels = [np.median(column[far[:, None] + np.arange(n, n + _STAYS)], axis=1) for n in (-_STAYS, 0)]
        if sensor == "accel" and np.count_nonzero(np.abs(levels[1] - levels[0]) > 0.5 * size) >= _FEWEST:
            return jumps
    return np.zeros(0, dtype=np.intp)
