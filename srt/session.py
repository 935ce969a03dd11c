"""From a recording to play-back data: what cannot be used is refused or voided here, each with one sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.playback_data import PlaybackData, prepare, sequence_of_label
from srt.recording_checks import (
    check_interval,
    check_rest,
    check_turns,
    clipped_samples,
    clipping_levels,
    gap_inside,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.options import Options
    from srt.recording.recording import Recording, SequenceLabel

    Array = NDArray[np.float64]

_CHUNKS: Final = 20
_MOTION_RAD: Final = 5e-3
_MOTION_SIGMAS: Final = 8.0


def open_session(
    recording: Recording,
    labels: tuple[SequenceLabel, ...],
    options: Options,
    *,
    poses: tuple[SequenceLabel, ...] = (),
) -> PlaybackData:
    """Check a labelled recording and prepare it for play-back; of ``poses`` the start windows alone.

    Sequences with a gap or clipped samples are voided; the result says so.

    Raises
    ------
    DataError
        If no sequence is left, readings at rest or turns are impossible (wrong units), or the unit moved in a
        stationary window.
    """
    check_interval(recording)
    voided: dict[str, str] = {}
    whole = []
    for label in labels:
        gaps = gap_inside(recording, _part(recording, label))
        if gaps.size:
            voided[label.title] = f"samples are missing before {recording.time[int(gaps[0])]:.6g} s"
        else:
            whole.append(label)
    data = prepare(recording, whole, options, voided=voided, poses=poses)
    _check_overlap(data)
    # Units before clipping: degrees taken for radians are beyond any range.
    dt = recording.nominal_interval_s
    check_rest(data.windows.accel_mean, data.gravity, _window_titles(data), interval_s=dt)
    _check_turned(data)
    levels = clipping_levels(recording)
    clipped = {label.title: clipped_samples(recording, _part(recording, label), levels) for label in whole}
    voided |= {title: str(channels[0]) for title, channels in clipped.items() if channels}
    if any(clipped.values()):
        left = [s for s in whole if not clipped[s.title]]
        data = prepare(recording, left, options, voided=voided, poses=poses)
    if recording.sequences:
        # Windows found by the segmentation are as still as the unit ever was; what moves in them is integrated.
        _check_stillness(data)
    return data


def _part(recording: Recording, label: SequenceLabel) -> slice:
    """Samples of a sequence, from the start of its first window to the end of its last."""
    return slice(
        recording.window_indices(*label.start_static_s).start, recording.window_indices(*label.end_static_s).stop
    )


def _check_overlap(data: PlaybackData) -> None:
    """Refuse rotations that share samples: they would count as independent data."""
    order = np.argsort(data.rotation[:, 0])
    ends = np.maximum.accumulate(data.rotation[order, 1])
    for k in np.flatnonzero(data.rotation[order[1:], 0] < ends[:-1]).tolist():
        raise DataError(
            f"{data.labels[order[k + 1]].title} begins to rotate while {data.labels[order[k]].title} still does: the "
            "same samples must not be labelled twice; correct the windows' times."
        )


def _window_titles(data: PlaybackData) -> list[str]:
    return [f"The window from {data.recording.time[a]:.6g} s" for a in data.windows.samples[:, 0].tolist()]


def _check_turned(data: PlaybackData) -> None:
    """Magnitudes of single-axis turns against their labels: units of the gyros, whatever their axes."""
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


def _check_stillness(data: PlaybackData) -> None:
    """Refuse a window in which the unit visibly turned; small drifts are integrated later instead of held."""
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
