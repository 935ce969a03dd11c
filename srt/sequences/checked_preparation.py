"""Preparation of a labelled recording with checks: unusable data is voided or refused."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.noise.noise_model import noise_models
from srt.noise.random_walk import allan_octaves, octaves_key
from srt.recording.recording import of_each, side_by_side
from srt.sequences.clipping import clipped_samples, clipping_levels
from srt.sequences.plausibility import check_interval, check_rest, check_turns, gap_inside
from srt.sequences.preparation import means_key, move_title, noise_key, prepare, prepared_key, sequence_of_label
from srt.sequences.window_means import average_windows

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from srt.recording.recording import Recording, SequenceLabel
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.window_means import Average
    from srt.types import Array, Indices

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
    for label, gap in zip(labels, recording.memo(_gaps_key(labels), lambda: _gaps(recording, labels)), strict=True):
        if gap is None:
            whole.append(label)
        else:
            voided[label.title] = f"samples are missing before {recording.time[gap]:.6g} s"
    data = prepare(recording, whole, average, voided=voided, poses=poses, moves=moves)
    # Units are checked before clipping: degrees read as radians exceed any range.
    dt = recording.nominal_interval_s
    check_rest(data.windows.accel_mean, data.gravity, lambda: _window_titles(data), interval_s=dt)
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


def _gaps_key(labels: tuple[SequenceLabel, ...]) -> Hashable:
    return "gaps", labels


def _gaps(recording: Recording, labels: tuple[SequenceLabel, ...]) -> list[int | None]:
    """First sample after a gap inside each sequence; None without a gap."""
    inside = (gap_inside(recording, _part(recording, label)) for label in labels if recording.gaps.size)
    return [int(gaps[0]) if gaps.size else None for gaps in inside] or [None] * len(labels)


def _part(recording: Recording, label: SequenceLabel) -> slice:
    """Samples of a sequence, from the start of its first window to the end of its last."""
    return slice(
        recording.window_indices(*label.start_static_s).start, recording.window_indices(*label.end_static_s).stop
    )


def _window_titles(data: PreparedRecording) -> list[str]:
    return [f"The window from {data.recording.time[a]:.6g} s" for a in data.windows.samples[:, 0].tolist()]


def _check_turned(data: PreparedRecording) -> None:
    """Check the magnitudes of single-axis rotations against their labels: wrong gyro units, for any axis mapping."""
    sequences = [sequence_of_label(label) for label in data.labels]
    single = [k for k, s in enumerate(sequences) if s is not None and len(s.rotations) == 1]
    if not single:
        return
    recording, rest = data.recording, data.windows.gyro_mean
    spans = data.rotation[single]
    angle, seconds = recording.memo(_turns_key(spans), lambda: _turned([recording], spans)[0])
    angle = angle - 0.5 * (rest[data.start[single]] + rest[data.end[single]]) * seconds[:, None]
    nominal = [abs(s.rotations[0][1]) for k in single if (s := sequences[k]) is not None]
    titles = [data.labels[k].title for k in single]
    check_turns(np.linalg.norm(angle, axis=1), nominal, titles, interval_s=recording.nominal_interval_s)


def _turns_key(spans: Indices) -> Hashable:
    return "turns", spans.tobytes()


def _turned(recordings: Sequence[Recording], spans: Indices) -> list[tuple[Array, Array]]:
    """Angles that the gyros turned by in spans of samples, (spans, 3), rad, and their duration, s, by recording."""
    first, gyro = recordings[0], side_by_side([own.gyro for own in recordings])
    interval = first.interval_s
    steps = [np.full(b - a, interval) if isinstance(interval, float) else interval[a:b] for a, b in spans.tolist()]
    weights = steps if first.kind == "rate" else [np.ones(len(own)) for own in steps]
    angles = np.stack([own @ gyro[a:b] for own, (a, b) in zip(weights, spans.tolist(), strict=True)])
    seconds = np.array([own.sum() for own in steps])
    return [(own, seconds) for own in of_each(angles)]


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
    rate = recording.memo(_rates_key(samples), lambda: _rates([recording], samples)[0])
    angle = np.abs(np.cumsum(rate * (T / rate.shape[1])[:, None, None], axis=1)).max(axis=1)
    limit = np.maximum(_MOTION_RAD, _MOTION_SIGMAS * (noise.gyro_white * np.sqrt(T)[:, None] + noise.gyro_edge))
    for w in np.flatnonzero(np.any(angle > limit, axis=1)).tolist():
        chunk = int(np.argmax(np.max(np.abs(rate[w]), axis=1)))
        raise DataError(
            f"The unit moves in the stationary window from {recording.time[samples[w, 0]]:.6g} s: the gyros turn by "
            f"{np.degrees(angle[w].max()):.3g}° around {recording.time[_chunks(samples)[w, chunk]]:.6g} s; "
            "correct the window's times or leave the sequence out."
        )


def _chunks(samples: Indices) -> Indices:
    """Limits of the parts of windows, shape (W, parts + 1)."""
    n = min(_CHUNKS, int(np.diff(samples, axis=1).min()))
    return np.linspace(samples[:, 0], samples[:, 1], n + 1, axis=1).astype(np.intp)


def _rates_key(samples: Indices) -> Hashable:
    return "rates in windows", samples.tobytes()


def _rates(recordings: Sequence[Recording], samples: Indices) -> list[Array]:
    """Mean rates in the parts of windows less their median, shape (W, parts, 3), rad/s, of each recording of a run."""
    first, gyro, edges = recordings[0], side_by_side([own.gyro for own in recordings]), _chunks(samples)
    sums = np.stack([np.add.reduceat(gyro[e[0] : e[-1]], e[:-1] - e[0], axis=0) for e in edges])
    rate = sums / np.diff(edges, axis=1)[:, :, None]
    if first.kind == "increment":
        rate = rate / first.nominal_interval_s
    rate -= np.median(rate, axis=1, keepdims=True)
    return list(of_each(rate))


def prepare_together(units: Sequence[tuple[Recording, tuple[SequenceLabel, ...], Average]]) -> None:
    """Compute what :func:`prepare_checked` needs of recordings, which then find it derived: those of one run as arrays.

    Parameters
    ----------
    units : sequence of (Recording, tuple of SequenceLabel, Average)
        Arguments of that function.
    """
    runs: list[tuple[list[Recording], tuple[SequenceLabel, ...], Average]] = []
    for recording, labels, average in units:
        alike = (own for own, *how in runs if how == [labels, average] and _of_one_run(own[0], recording))
        if (run := next(alike, None)) is None:
            runs.append(([recording], labels, average))
        elif recording not in run:
            run.append(recording)
    for run, labels, average in runs:
        if len(run) > 1 and labels:
            _derive_together(run, labels, average)


def _derive_together(recordings: Sequence[Recording], labels: tuple[SequenceLabel, ...], average: Average) -> None:
    try:
        data = prepare(recordings[0], labels, average)
    except DataError:  # as each will tell
        return
    samples = data.windows.samples
    single = [s is not None and len(s.rotations) == 1 for s in data.catalogue]
    spans = data.rotation[single]
    windows = average_windows(recordings, samples, average)
    tables: list[tuple[Hashable, Sequence[object]]] = [
        (means_key(samples, average), windows),
        (octaves_key(samples), allan_octaves(recordings, samples)),
        (_rates_key(samples), _rates(recordings, samples)),
        (_gaps_key(labels), [_gaps(recordings[0], labels)] * len(recordings)),
    ]
    if len(spans):
        tables.append((_turns_key(spans), _turned(recordings, spans)))
    _give(recordings, tables)
    units = zip(recordings, windows, strict=True)
    prepared = [replace(data, recording=recording, windows=own) for recording, own in units]
    noise = noise_models(recordings, samples)
    _give(recordings, [(noise_key(samples), noise), (prepared_key(labels, average), prepared)])


def _give(recordings: Sequence[Recording], tables: Sequence[tuple[Hashable, Sequence[object]]]) -> None:
    """Store derived values of recordings, by name."""
    for key, values in tables:
        for recording, value in zip(recordings, values, strict=True):
            recording.memo(key, partial(_given, value))


def _given(value: object) -> object:
    return value


def _of_one_run(first: Recording, other: Recording) -> bool:
    """True if two recordings have the same samples in time, the same kind and the same stated noise."""
    return (
        (first.kind, first.sample_rate_hz, first.noise) == (other.kind, other.sample_rate_hz, other.noise)
        and len(first.time) == len(other.time)
        and (first.time is other.time or np.array_equal(first.time, other.time))
    )
