"""Preparation of a labelled recording with checks: unusable data is voided or refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.sequences.clipping import clipped_samples, clipping_levels
from srt.sequences.plausibility import check_interval, check_rest, check_turns, gap_inside
from srt.sequences.preparation import move_title, prepare, sequence_of_label

if TYPE_CHECKING:
    from srt.recording.recording import Recording, SequenceLabel
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.window_means import Average

_CHUNKS: Final = 20
"""Number of parts of a window whose mean rates are summed to the angle."""

_MOTION_RAD: Final = 5e-3
_MOTION_SIGMAS: Final = 8.0
"""Limits of the angle turned inside a window, rad and in sigma; above both the window is refused, else integrated."""


def prepare_checked(
    recording: Recording,
    labels: tuple[SequenceLabel, ...],
    average: Average = "linear",
    *,
    poses: tuple[SequenceLabel, ...] = (),
    moves: tuple[SequenceLabel, ...] = (),
) -> PreparedRecording:
    """Check a labelled recording and prepare it; ``poses`` contribute only their start windows.

    Sequences with a gap or clipped samples are voided, and moves with clipped samples; the result says so.

    Raises
    ------
    DataError
        If no sequence is left, readings at rest or turns are impossible (wrong units), or the unit moved in a
        stationary window.
    """
    key = ("checked", tuple(labels), average, tuple(poses), tuple(moves))
    return recording.memo(key, lambda: _prepare_checked(recording, tuple(labels), average, tuple(poses), tuple(moves)))


def _prepare_checked(
    recording: Recording,
    labels: tuple[SequenceLabel, ...],
    average: Average,
    poses: tuple[SequenceLabel, ...],
    moves: tuple[SequenceLabel, ...],
) -> PreparedRecording:
    check_interval(recording)
    voided: dict[str, str] = {}
    whole = []
    for label in labels:
        gaps = gap_inside(recording, _part(recording, label)) if recording.gaps.size else recording.gaps
        if gaps.size:
            voided[label.title] = f"samples are missing before {recording.time[int(gaps[0])]:.6g} s"
        else:
            whole.append(label)
    data = prepare(recording, whole, average, voided=voided, poses=poses, moves=moves)
    # Units are checked before clipping: degrees read as radians exceed any range.
    dt = recording.nominal_interval_s
    check_rest(data.windows.accel_mean, data.gravity, _window_titles(data), interval_s=dt)
    _check_turned(data)
    _check_rates(data)
    levels = clipping_levels(recording)
    parts = {**{s: s.title for s in whole}, **{s: move_title(s) for s in moves}}
    if not clipped_samples(recording, slice(None), levels):
        parts = {}
    clipped = {label: clipped_samples(recording, _part(recording, label), levels) for label in parts}
    voided |= {parts[label]: str(channels[0]) for label, channels in clipped.items() if channels}
    if any(clipped.values()):
        left, left_moves = ([s for s in some if not clipped[s]] for some in (whole, moves))
        data = prepare(recording, left, average, voided=voided, poses=poses, moves=left_moves)
    if recording.sequences:
        # Windows that were detected contain no large motion; small motion in them is integrated.
        _check_stillness(data)
    return data


def _part(recording: Recording, label: SequenceLabel) -> slice:
    """Samples of a sequence, from the start of its first window to the end of its last."""
    return slice(
        recording.window_indices(*label.start_static_s).start, recording.window_indices(*label.end_static_s).stop
    )


def _window_titles(data: PreparedRecording) -> list[str]:
    return [f"The window from {data.recording.time[a]:.6g} s" for a in data.windows.samples[:, 0].tolist()]


def _check_turned(data: PreparedRecording) -> None:
    """Check the magnitudes of single-axis rotations against their labels: wrong gyro units, for any axis mapping."""
    turned, nominal, titles = [], [], []
    recording = data.recording
    for k, label in enumerate(data.labels):
        sequence = sequence_of_label(label)
        if sequence is None or len(sequence.rotations) != 1:
            continue
        a, b = data.rotation[k].tolist()
        dt = recording.interval_s if isinstance(recording.interval_s, float) else recording.interval_s[a:b]
        steps = np.full(b - a, dt) if isinstance(dt, float) else dt
        rest = 0.5 * (data.windows.gyro_mean[data.start[k]] + data.windows.gyro_mean[data.end[k]])
        angle = (steps if recording.kind == "rate" else np.ones(b - a)) @ recording.gyro[a:b] - rest * steps.sum()
        turned.append(float(np.linalg.norm(angle)))
        nominal.append(abs(sequence.rotations[0][1]))
        titles.append(label.title)
    if turned:
        check_turns(turned, nominal, titles, interval_s=recording.nominal_interval_s)


_RATE_AGREES: Final = (0.25, 4.0)
"""Range of a reading over the stated rate about its axis; scale errors of 50 % and a misread unit lie apart."""


def _check_rates(data: PreparedRecording) -> None:
    """Refuse a stated rate that contradicts the readings in sense, axis or size."""
    recording = data.recording
    for label in data.labels:
        if label.rate is None or label.steady_s is None:
            continue
        mean = recording.gyro[recording.window_indices(*label.steady_s)].mean(axis=0)
        if recording.kind == "increment":
            mean = mean / recording.nominal_interval_s
        axis, stated = label.rate
        low, high = _RATE_AGREES
        if not low <= mean["xyz".index(axis)] / stated <= high:
            read = ", ".join(f"{value:.4g}" for value in np.degrees(mean))
            raise DataError(
                f"{label.title} states {np.degrees(stated):g}°/s about {axis}, but the gyros read ({read}) °/s: "
                "correct the sense, the axis or the rate, or the unit of the readings."
            )


def _check_stillness(data: PreparedRecording) -> None:
    """Refuse a window in which the unit rotated; smaller drifts are integrated later."""
    recording, noise = data.recording, data.noise
    samples, T = data.windows.samples, data.windows.duration_s
    n = min(_CHUNKS, int(np.diff(samples, axis=1).min()))
    edges = np.linspace(samples[:, 0], samples[:, 1], n + 1, axis=1).astype(int)
    sums = np.stack([np.add.reduceat(recording.gyro[e[0] : e[-1]], e[:-1] - e[0], axis=0) for e in edges])
    rate = sums / np.diff(edges, axis=1)[:, :, None]
    if recording.kind == "increment":
        rate = rate / recording.nominal_interval_s
    rate -= np.median(rate, axis=1, keepdims=True)
    angle = np.abs(np.cumsum(rate * (T / n)[:, None, None], axis=1)).max(axis=1)
    limit = np.maximum(_MOTION_RAD, _MOTION_SIGMAS * (noise.gyro_white * np.sqrt(T)[:, None] + noise.gyro_edge))
    for w in np.flatnonzero(np.any(angle > limit, axis=1)).tolist():
        chunk = int(np.argmax(np.max(np.abs(rate[w]), axis=1)))
        raise DataError(
            f"The unit moves in the stationary window from {recording.time[edges[w, 0]]:.6g} s: the gyros turn by "
            f"{np.degrees(angle[w].max()):.3g}° around {recording.time[edges[w, chunk]]:.6g} s; "
            "correct the window's times or leave the sequence out."
        )
