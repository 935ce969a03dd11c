"""Directions of the unknown part of the Earth rate: all three without a latitude, the horizontal ones without heading.

The directions are fixed to the Earth: those of the fixture's base for its sequences, those of the first pose for a
chain of free turns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.estimation.error_sources import unknown_earth_rate

if TYPE_CHECKING:
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


def unknown_earth_rate_components(data: PreparedRecording) -> int:
    """Number of unknown components of the Earth rate: three without a latitude, two without a heading, else none."""
    unknown = unknown_earth_rate(data.recording, placed=bool(data.placed.all()))
    return int(np.count_nonzero(unknown))


def unknown_earth_rate_draws(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Unknown part of the Earth rate (no latitude or no heading), per unit draw in B_Strt, shape (K, 3, S), rad/s."""
    directions = unknown_earth_rate_components(data)
    if not directions:
        return np.zeros((data.K, 3, 0))
    recording = data.recording
    size = unknown_earth_rate(recording, placed=False).max()
    on_fixture = unknown_earth_rate(recording, placed=True).any()
    of_fixture = np.zeros((data.K, 3, 0))
    if data.nominal is not None and on_fixture:
        frames = measurements.U @ np.swapaxes(data.nominal, 1, 2)
        of_fixture = frames[:, :, :directions] * data.placed[:, None, None]
    free = _unknown_in_chains(measurements, data, directions)
    return np.asarray(size * np.concatenate([of_fixture, free], axis=2))


def _unknown_in_chains(measurements: SrtMeasurements, data: PreparedRecording, directions: int) -> Array:
    """Directions of the unknown Earth rate of free turns, in B_Strt, shape (K, 3, chains · directions).

    The Earth-fixed frame is propagated if a rotation starts from the end window of another.
    """
    turns = np.flatnonzero(~data.placed).tolist()
    down = -measurements.force[data.start] / np.linalg.norm(measurements.force[data.start], axis=1, keepdims=True)
    chains = 0
    carried: dict[int, tuple[int, Array]] = {}
    found: list[tuple[int, Array]] = []
    for k in turns:
        if int(data.start[k]) in carried:
            chain, frame = carried[int(data.start[k])]
        else:
            # From the raw readings, so that the draws mean the same in all iterations.
            least_vertical = int(np.argmin(np.abs(data.windows.accel_mean[data.start[k]])))
            first = np.cross(down[k], np.eye(3)[least_vertical])
            first /= np.linalg.norm(first)
            chain, frame = chains, np.stack([first, np.cross(down[k], first), down[k]], axis=1)
            chains += 1
        found.append((chain, frame))
        carried[int(data.end[k])] = chain, measurements.integrals.C_end[k].T @ frame
    out = np.zeros((data.K, 3, chains, directions))
    for k, (chain, frame) in zip(turns, found, strict=True):
        out[k, :, chain] = frame[:, :directions]
    return out.reshape(data.K, 3, chains * directions)
