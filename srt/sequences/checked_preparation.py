"""Preparation of a labelled recording with checks: unusable data is voided or refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import DataError
from srt.noise.random_walk import allan_octaves, octaves_key
from srt.recording.readings import derived, of_each, side_by_side
from srt.sequences.clipping import clipped_samples
from srt.sequences.manoeuvres import whole_rotations
from srt.sequences.plausibility import check_interval, check_rest, check_turns
from srt.sequences.preparation import means_key, move_title, prepare, sequence_of_label
from srt.sequences.window_means import average_windows, windows_of_labels

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Sequence

    from srt.recording.recording import Recording, SequenceLabel
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.window_means import Average
    from srt.types import Array, Indices

_CHUNKS: Final = 20
"""Number of parts of a window whose mean rates are summed to the angle."""

_MOTION_RAD: Final = 5e-3
_MOTION_SIGMAS: Final = 8.0
"""Limits of the angle turned inside a window, rad and in sigma; above both the window is refused, else integrated."""


@derived
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
    check_interval(recording)
    gaps = dict(zip(labels, recording.gaps_inside(_spans(recording, labels)).tolist(), strict=True))
    voided = {
        label.title: f"samples are missing before {recording.time[gap]:.6g} s"
        for label, gap in gaps.items()
        if gap >= 0
    }
    whole = tuple(label for label in labels if gaps[label] < 0)
    data = prepare(recording, whole, average, voided=tuple(voided.items()), poses=poses, moves=moves)
    # Units are checked before clipping: degrees read as radians exceed any range.
    dt = recording.nominal_interval_s
    check_rest(data.windows.accel_mean, data.gravity, lambda: _window_titles(data), interval_s=dt)
    _check_turned(data)
    _check_rates(data)
    if clipped_samples(recording, slice(None)):
        titles = {label: label.title for label in whole} | {label: move_title(label) for label in moves}
        each = (clipped_samples(recording, slice(*span)) for span in _spans(recording, titles))
        clipped = {label: str(found[0]) for label, found in zip(titles, each, strict=True) if found}
        voided |= {titles[label]: reason for label, reason in clipped.items()}
        whole, moves = (tuple(label for label in some if label not in clipped) for some in (whole, moves))
        data = prepare(recording, whole, average, voided=tuple(voided.items()), poses=poses, moves=moves)
    if recording.sequences:
        # Windows that were detected contain no large motion; small motion in them is integrated.
        _check_stillness(data)
    return data


def _spans(recording: Recording, labels: Iterable[SequenceLabel]) -> list[tuple[int, int]]:
    """First sample of the start window of each sequence, and one past the last of its end window."""
    windows = recording.windows([own for label in labels for own in (label.start_static_s, label.end_static_s)])
    return [(first.start, last.stop) for first, last in zip(windows[::2], windows[1::2], strict=True)]


def _window_titles(data: PreparedRecording) -> list[str]:
    return [f"The window from {data.recording.time[a]:.6g} s" for a in data.windows.samples[:, 0].tolist()]


def _check_turned(data: PreparedRecording) -> None:
    """Check the magnitudes of single-axis rotations against their labels: wrong gyro units, for any axis mapping."""
    sequences = [sequence_of_label(label) for label in data.labels]
    single = [k for k, s in enumerate(sequences) if s is not None and len(s.rotations) == 1]
    if not single:
        return
    rest = data.windows.gyro_mean
    angle = whole_rotations(data.rotation_stream, 0.5 * (rest[data.start] + rest[data.end]))[single]
    nominal = [abs(s.rotations[0][1]) for k in single if (s := sequences[k]) is not None]
    titles = [data.labels[k].title for k in single]
    check_turns(np.linalg.norm(angle, axis=1), nominal, titles, interval_s=data.recording.nominal_interval_s)


_RATE_AGREES: Final = (0.25, 4.0)
"""Range of a reading over the stated rate about its axis; scale errors of 50 % and a misread unit lie apart."""


def _check_rates(data: PreparedRecording) -> None:
    """Refuse a stated rate that contradicts the readings in sense, axis or size."""
    recording = data.recording
    for label in data.labels:
        if label.rate is None or label.steady_s is None:
            continue
        mean = recording.gyro[recording.window_indices(*label.steady_s)].mean(axis=0) * recording.rates_factor
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
    rate = recording.memo(_rates_key(samples), lambda: _rates([recording], [samples])[0])
    angle = np.abs(np.cumsum(rate * (T / rate.shape[1])[:, None, None], axis=1)).max(axis=1)
    limit = np.maximum(_MOTION_RAD, _MOTION_SIGMAS * (noise.gyro_white * np.sqrt(T)[:, None] + noise.gyro_edge))
    for w in np.flatnonzero(np.any(angle > limit, axis=1)).tolist():
        chunk = samples[w, 0] + _chunks(samples)[w, int(np.argmax(np.max(np.abs(rate[w]), axis=1)))]
        raise DataError(
            f"The unit moves in the stationary window from {recording.time[samples[w, 0]]:.6g} s: the gyros turn by "
            f"{np.degrees(angle[w].max()):.3g}° around {recording.time[chunk]:.6g} s; "
            "correct the window's times or leave the sequence out."
        )


def _chunks(samples: Indices) -> Indices:
    """Limits of the parts of windows, shape (W, parts + 1), counted from the first sample of each."""
    length = np.diff(samples, axis=1)[:, 0]
    return np.linspace(0, length, min(_CHUNKS, int(length.min())) + 1, axis=1).astype(np.intp)


def _rates_key(samples: Indices) -> Hashable:
    return "rates in windows", samples.tobytes()


def _rates(recordings: Sequence[Recording], samples: Sequence[Indices]) -> list[Array]:
    """Mean rates in the parts of windows less their median, shape (W, parts, 3), rad/s, of each recording."""
    edges = _chunks(samples[0])
    rate = np.empty((len(edges), edges.shape[1] - 1, 3 * len(recordings)))
    for which, gyro in side_by_side([own.gyro for own in recordings], samples):
        rate[which] = np.add.reduceat(gyro, edges[which[0], :-1], axis=1)
    rate *= recordings[0].rates_factor / np.diff(edges, axis=1)[:, :, None]
    rate -= np.median(rate, axis=1, keepdims=True)
    return list(of_each(rate))


def prepare_together(units: Sequence[tuple[Recording, tuple[SequenceLabel, ...], Average]]) -> None:
    """Compute what :func:`prepare_checked` needs of recordings, those of one kind as arrays; they find it derived.

    Parameters
    ----------
    units : sequence of (Recording, tuple of SequenceLabel, Average)
        Arguments of that function.
    """
    alike: list[tuple[list[Recording], list[Indices], Average]] = []
    for recording, labels, average in units:
        try:
            samples = windows_of_labels(recording, labels)[0] if labels else None
        except DataError:  # as it will tell
            continue
        if samples is None:
            continue
        like = (own for own in alike if own[2] == average and _as_arrays((own[0][0], own[1][0]), (recording, samples)))
        if (group := next(like, None)) is None:
            alike.append(([recording], [samples], average))
        elif recording not in group[0]:
            group[0].append(recording)
            group[1].append(samples)
    for group in alike:
        if len(group[0]) > 1:
            _derive_together(*group)


def _derive_together(recordings: Sequence[Recording], samples: Sequence[Indices], average: Average) -> None:
    def give(key: Callable[[Indices], Hashable], values: Sequence[object]) -> None:
        for recording, own, value in zip(recordings, samples, values, strict=True):
            recording.give(key(own), value)

    give(lambda own: means_key(own, average), average_windows(recordings, samples, average))
    give(octaves_key, allan_octaves(recordings, samples))
    give(_rates_key, _rates(recordings, samples))


def _as_arrays(first: tuple[Recording, Indices], other: tuple[Recording, Indices]) -> bool:
    """True if two recordings have the same kind and stated noise, and equal windows with samples of equal duration."""
    (a, of_a), (b, of_b) = first, other
    if (a.kind, a.sample_rate_hz, a.noise) != (b.kind, b.sample_rate_hz, b.noise):
        return False
    if not np.array_equal(np.diff(of_a), np.diff(of_b)):
        return False
    if isinstance(a.interval_s, float):
        return a.interval_s == b.interval_s
    return np.array_equal(of_a, of_b) and np.array_equal(a.interval_s, b.interval_s)
