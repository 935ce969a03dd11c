"""Stationary windows of an unlabelled recording, to the sample, and the free turns between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.blocks import BLOCK_S, blocks_of, find_rest, still_runs
from srt.exceptions import DataError
from srt.recording.recording import SequenceLabel
from srt.window_edges import split_at_jumps, to_the_sample

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.recording.recording import Recording

    Array = NDArray[np.float64]

MIN_WINDOW_S: Final = 1.0
MIN_TURN_RAD: Final = 0.1


def find_windows(recording: Recording) -> NDArray[np.intp]:
    """Stationary windows, first sample and one past the last, shape (W, 2), in time order.

    Two that adjoin without a sample between them lie on both sides of a join: the attitude jumps there, as where
    recordings were put end to end.

    Raises
    ------
    DataError
        If fewer than two are found, with what was looked for.
    """
    blocks = blocks_of(recording)
    rest = find_rest(blocks)
    runs = still_runs(rest.still, blocks)
    shortest = max(MIN_WINDOW_S, 3 * BLOCK_S)
    dt = recording.nominal_interval_s
    found = to_the_sample(recording, blocks, runs)
    if recording.fixture is not None:
        # A hand wobbles as a bad join would; on a fixture only a join, or a bump, makes a step.
        found = split_at_jumps(recording, found, blocks.floor)
    windows = [w for w in found if w[1] - w[0] >= shortest / dt - 0.5]
    if len(windows) < 2:
        raise DataError(
            f"Only {len(windows)} stationary windows of at least {shortest:g} s were found in the recording; "
            "stillness, turn, stillness is needed: let the unit rest between turns, or label the windows."
        )
    return np.array(windows, dtype=np.intp)


def find_turns(recording: Recording) -> tuple[SequenceLabel, ...]:
    """Free turns between successive stationary windows: each pose ends one turn and starts the next.

    A disturbance that left the unit where it was makes no turn: of the windows around it the longer is kept.

    Raises
    ------
    DataError
        If the recording holds no turn between two windows.
    """
    windows = find_windows(recording)
    dt = recording.nominal_interval_s
    gaps = recording.gaps
    rates = 1.0 if recording.kind == "rate" else 1.0 / dt
    kept: list[tuple[int, int]] = [(int(windows[0, 0]), int(windows[0, 1]))]
    breaks: list[bool] = []
    for a, b in windows[1:].tolist():
        last_a, last_b = kept[-1]
        apart = a == last_b or bool(np.any((gaps > last_a) & (gaps < b)))
        rest = recording.gyro[last_a:last_b].mean(axis=0)
        angle = np.linalg.norm((recording.gyro[last_b:a] - rest).sum(axis=0)) * rates * dt
        path = np.linalg.norm((recording.gyro[last_b:a] - rest), axis=1).sum() * rates * dt
        if not apart and max(float(angle), 0.2 * float(path)) < MIN_TURN_RAD:
            if b - a > last_b - last_a:
                kept[-1] = (a, b)
            continue
        kept.append((a, b))
        breaks.append(apart)
    labels = tuple(
        SequenceLabel(window_times(recording, first), window_times(recording, second))
        for first, second, apart in zip(kept[:-1], kept[1:], breaks, strict=True)
        if not apart
    )
    if not labels:
        raise DataError(
            f"{len(windows)} stationary windows were found, but no turn between two of them: the unit was not rotated."
        )
    return labels


def window_times(recording: Recording, window: tuple[int, int]) -> tuple[float, float]:
    """Window bounds in time: the interval of the first sample begins one step before its stamp."""
    dt = recording.nominal_interval_s
    return float(recording.time[window[0]] - dt), float(recording.time[window[1] - 1])
