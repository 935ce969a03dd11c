"""Preparation of a recording: sequences, window means and rotation samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np

from srt.constants import EARTH_RATE_RAD_S
from srt.exceptions import DataError
from srt.model.analytic_platform import equal_parts, parts_per_rotation
from srt.model.gyro_stream import GyroStream, gyro_stream
from srt.model.table1 import SEQUENCES, RotationSequence, axis_vector
from srt.noise.bias_instability import DriftDraws, drift_draws, interval_times, window_draws
from srt.noise.bias_steps import step_shapes
from srt.noise.drift_forms import WALK, DriftShape, DriftShapes, Intervals, walk_between_windows
from srt.noise.noise_model import NoiseModel, noise_model
from srt.recording.readings import derived
from srt.recording.sequence_label import POSE_MIDDLE
from srt.sequences.manoeuvres import end_attitude
from srt.sequences.vibration import Vibration, rectified, vibration
from srt.sequences.window_means import LEAST_SAMPLES, Windows, average_windows, averaging_weights, windows_of_labels

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Mapping

    from srt.model.sensor_model import Triad
    from srt.recording.recording import Recording, SequenceLabel
    from srt.sequences.window_means import Average
    from srt.types import Array, Indices, Mask


Derived = TypeVar("Derived")
_DIFFERENCES: Final = 8
"""Order of the differences of successive readings that show fast motion."""


@lru_cache(maxsize=8)
def _values_of_schedule(_schedule: Hashable) -> dict[Hashable, Any]:
    """Values that units of one schedule have in common, by name; of the last schedules."""
    return {}


def sequence_of_label(label: SequenceLabel) -> RotationSequence | None:
    """Catalogue entry of a label: Table 1, its own description, or None for a free turn."""
    if label.id in SEQUENCES:
        return SEQUENCES[label.id]
    if label.down is None or label.along_outer is None or (label.id is None and not label.pose):
        return None
    return RotationSequence(
        label.id or "pose", label.down, label.along_outer, float("nan"), float("nan"), label.rotations
    )


@cache
def nominal_attitude(sequence: RotationSequence) -> Array:
    """C_nom at the start of a sequence: table-mounted body frame T to fixture base, shape (3, 3), read-only.

    The base z axis is down and its y axis the outer axis; for Table 1 this is R_y(outer) R_z(inner).
    """
    down, outer = axis_vector(sequence.down), axis_vector(sequence.along_outer)
    C = np.stack([np.cross(outer, down), outer, down])
    C.flags.writeable = False
    return C


@dataclass(frozen=True, eq=False)
class PreparedRecording:
    """K sequences over W stationary windows.

    Attributes
    ----------
    catalogue : tuple of RotationSequence or None
        Per sequence; None for a free turn.
    start, end : ndarray of int, shape (K,)
        Window that each sequence starts and ends with; turns may share windows.
    voided : dict of str to str
        Sequences left out, with the reason.
    poses : tuple of (SequenceLabel, int)
        Windows of sequences that lost their end, which joint estimation uses alone: label and window.
    moves : int
        Number of moves between sequences, the last of the K.
    accel_instability, gyro_instability : float, m/s² and rad/s, optional
        Bias instability that residuals show, in place of that of the windows alone.
    undersampling : float, optional
        Error of the rotations by undersampled motion that residuals show, as a share of :attr:`fast_motion`.
    """

    recording: Recording
    labels: tuple[SequenceLabel, ...]
    catalogue: tuple[RotationSequence | None, ...]
    windows: Windows
    start: Indices
    end: Indices
    average: Average
    voided: dict[str, str]
    poses: tuple[tuple[SequenceLabel, int], ...] = ()
    moves: int = 0
    accel_instability: float | None = None
    gyro_instability: float | None = None
    undersampling: float | None = None

    @cached_property
    def noise(self) -> NoiseModel:
        """Stated noise of the unit, completed from the windows without their vibration; one fit for equal windows."""
        samples, line, found = self.windows.samples, self.vibration, self._noise_with_vibration
        if line is not None:
            key = ("noise without vibration", samples.tobytes())
            found = self.recording.memo(key, lambda: noise_model(line.removed(self.recording, samples), samples))
        if self.accel_instability is not None:
            found = found.with_accel_instability(self.accel_instability)
        return found if self.gyro_instability is None else found.with_gyro_instability(self.gyro_instability, samples)

    @property
    def _noise_with_vibration(self) -> NoiseModel:
        samples = self.windows.samples
        return self.recording.memo(("noise", samples.tobytes()), lambda: noise_model(self.recording, samples))

    @property
    def K(self) -> int:
        """Number of sequences, and moves between them."""
        return len(self.labels)

    @cached_property
    def is_move(self) -> Mask:
        """True for moves between sequences, shape (K,)."""
        return np.arange(self.K) >= self.K - self.moves

    @property
    def gravity(self) -> float:
        """Plumb-bob gravity, m/s²."""
        return self.recording.site.gravity_m_s2

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Id of each sequence; free turns and poses are numbered."""
        names = [
            label.id or f"{'pose' if label.pose else 'turn'} {label.number or k + 1}"
            for k, label in enumerate(self.labels)
        ]
        fixed = np.flatnonzero(~self.is_move).tolist()
        before, after = ({int(which[k]): names[k] for k in fixed} for which in (self.end, self.start))
        for k in np.flatnonzero(self.is_move).tolist():
            names[k] = f"move {before[int(self.start[k])]} to {after[int(self.end[k])]}"
        return tuple(names)

    @cached_property
    def posed(self) -> Mask:
        """True for the sequences that are poses without a rotation, shape (K,)."""
        return np.array([label.pose for label in self.labels])

    @cached_property
    def occurrences(self) -> tuple[int, ...]:
        """Occurrence of each sequence's id, counted from one."""
        return tuple(self.ids[: k + 1].count(name) for k, name in enumerate(self.ids))

    @cached_property
    def nominal(self) -> Array | None:
        """C_nom of every start, T to base, shape (K, 3, 3); None without a fixture, or without a nominal attitude.

        A free turn starts where a sequence starts or ends; where it does not (:attr:`placed`), the row has no meaning.
        """
        starts = self._nominal_starts
        return np.stack([starts.get(k, np.eye(3)) for k in range(self.K)]) if starts else None

    @cached_property
    def placed(self) -> Mask:
        """True for the sequences and free turns whose nominal start attitude is known, shape (K,)."""
        return np.array([k in self._nominal_starts for k in range(self.K)], dtype=np.bool_)

    @cached_property
    def _nominal_starts(self) -> dict[int, Array]:
        if self.recording.fixture is None:
            return {}
        known = {k: nominal_attitude(s) for k, s in enumerate(self.catalogue) if s is not None}
        poses = {
            int(self.end[k]): C @ end_attitude(s) for k, C in known.items() if (s := self.catalogue[k]) is not None
        }
        poses |= {int(self.start[k]): C for k, C in known.items()}
        free = (k for k, s in enumerate(self.catalogue) if s is None and int(self.start[k]) in poses)
        return known | {k: poses[int(self.start[k])] for k in free}

    def without_moves(self, reasons: Mapping[int, str]) -> PreparedRecording:
        """Recording without some moves, which are listed with the others that are void.

        Parameters
        ----------
        reasons : mapping of int to str
            Reason by position of the move.
        """
        voided = self.voided | {move_title(self.labels[k]): reason for k, reason in reasons.items()}
        count = self.K - self.moves
        moves = tuple(label for k, label in enumerate(self.labels[count:], count) if k not in reasons)
        poses, reasons_of_all = tuple(label for label, _ in self.poses), tuple(voided.items())
        return prepare(
            self.recording, self.labels[:count], self.average, voided=reasons_of_all, poses=poses, moves=moves
        )

    @cached_property
    def rotation(self) -> Indices:
        """Samples of each rotation, first and one past the last, shape (K, 2)."""
        return np.stack([self.windows.samples[self.start, 1], self.windows.samples[self.end, 0]], axis=1)

    @cached_property
    def vibration(self) -> Vibration | None:
        """Line of the spectrum of the windows; None if there is none."""
        samples = self.windows.samples
        key = ("vibration", samples.tobytes())
        return self.recording.memo(key, lambda: vibration(self.recording, samples, lambda: self._noise_with_vibration))

    def means(self, gyro: Triad, accel: Triad) -> tuple[Array, Array]:
        """Mean readings of both triads in every window, (W, 3), less vibration, its rectified part and rounding."""
        windows, line, noise = self.windows, self.vibration, self.noise
        rest, accel_mean = windows.gyro_mean - noise.gyro_rounding, windows.accel_mean - noise.accel_rounding
        if line is None:
            return rest, accel_mean
        rate, force = self.rectified(gyro, accel)
        of_gyro, of_accel = line.means(windows.samples, self.average)
        return rest - of_gyro - gyro.asymmetry * rate, accel_mean - of_accel - accel.asymmetry * force

    def rectified(self, gyro: Triad, accel: Triad) -> tuple[Array, Array]:
        """Mean of the absolute values of the channels in every window over the absolute mean, by vibration, (W, 3).

        Of rates, rad/s, and of specific forces, m/s²: asymmetry makes a bias of it.
        """
        means = (("gyro", gyro, self.windows.gyro_mean), ("accel", accel, self.windows.accel_mean))
        if self.vibration is None:
            zero = np.zeros(self.windows.gyro_mean.shape)
            return zero, zero
        line = self.vibration
        rate, force = (rectified(t.compensate(mean), line.amplitude(sensor, t)) for sensor, t, mean in means)
        return rate, force

    def of_schedule(self, name: Hashable, make: Callable[[], Derived]) -> Derived:
        """Value that times, labels, windows, site and fixture determine: computed once for all units of a schedule."""
        if name not in self._shared:
            self._shared[name] = make()
        value: Derived = self._shared[name]
        return value

    def of_labels(self, name: Hashable, make: Callable[[], Derived]) -> Derived:
        """Value that labels without their times, site and fixture determine: also common to runs of one schedule."""
        own = self.recording
        shared = _values_of_schedule((self.untimed, own.site, own.fixture))
        if name not in shared:
            shared[name] = make()
        value: Derived = shared[name]
        return value

    @cached_property
    def untimed(self) -> tuple[tuple[object, ...], ...]:
        """Labels without their times."""
        return tuple(
            (own.id, own.down, own.along_outer, own.rotations, own.pose, own.rate, own.rate_sigma, own.number)
            for own in self.labels
        )

    @cached_property
    def _shared(self) -> dict[Hashable, Any]:
        own = self.recording
        if own.temperature is not None:  # drift may follow it
            return {}
        return _values_of_schedule(
            (self.labels, self.windows.samples.tobytes(), own.time.tobytes(), own.site, own.fixture)
        )

    @property
    def drift(self) -> DriftDraws:
        """Unit draws of the drift that bias instability brings into windows and rotations."""
        own = self.windows.samples, self.rotation, self.recording.time
        return self.of_schedule("drift", lambda: drift_draws(*own))

    @property
    def window_drift(self) -> Array:
        """Unit draws of the drift of the windows alone, shape (W, W)."""
        own = self.windows.samples, self.recording.time
        return self.of_schedule("drift of windows", lambda: window_draws(*own))

    @property
    def drift_shapes(self) -> DriftShapes:
        """Shapes of a bias drift within the recording, by form."""
        return self.of_schedule("drift shapes", lambda: DriftShapes(self._drift_intervals))

    @property
    def step_shapes(self) -> dict[str, DriftShape]:
        """Shapes of a step of the biases, by form: one for every place of the step."""
        return self.of_schedule("step shapes", lambda: step_shapes(self._drift_intervals))

    def drift_shape(self, sensor: str, form: str) -> DriftShape:
        """Shape of a form of drift, or of a step, as it acts on a sensor."""
        return (self.drift_shapes if form in self.drift_shapes else self.step_shapes)[form].of(sensor)

    @cached_property
    def walk_between_windows(self) -> Array:
        """Root of the covariance of a random walk in rotations, given the windows, shape (K, P, P)."""
        return walk_between_windows(self._drift_intervals, self.drift_shapes[WALK])

    @cached_property
    def _drift_intervals(self) -> Intervals:
        samples, parts = self.windows.samples, parts_per_rotation(self.K)
        edges = equal_parts(self.rotation, parts)
        middle = samples.sum(axis=1) // 2
        halves = np.column_stack([samples[:, 0], middle, middle, samples[:, 1]]).reshape(-1, 2)
        parts_of_rotations = np.stack([edges[:, :-1].ravel(), edges[:, 1:].ravel()], axis=1)
        spans = np.concatenate([samples, parts_of_rotations, halves])
        start, end = interval_times(spans, self.recording.time)
        temperature = None
        if self.recording.temperature is not None:
            total = np.concatenate([[0.0], np.cumsum(self.recording.temperature)])
            first = np.minimum(spans[:, 0], len(total) - 2)
            last = np.maximum(spans[:, 1], first + 1)
            temperature = (total[last] - total[first]) / (last - first)
        return Intervals(start, end, len(samples), (self.K, parts), temperature)

    def earth_rate_base(self) -> Array:
        """Known part of the Earth's rate in fixture base axes, rad/s.

        Zero without a latitude; only the vertical part without a heading.
        """
        site, fixture = self.recording.site, self.recording.fixture
        if site.latitude_rad is None:
            return np.zeros(3)
        down = -EARTH_RATE_RAD_S * np.sin(site.latitude_rad)
        heading = None if fixture is None else fixture.heading_rad
        if heading is None:
            return np.array([0.0, 0.0, down])
        north = EARTH_RATE_RAD_S * np.cos(site.latitude_rad)
        return np.array([north * np.cos(heading), -north * np.sin(heading), down])

    def stream(self, integrated: Mask, *, with_force: bool = False) -> tuple[GyroStream, Array | None, Array | None]:
        """Gyro samples to integrate over.

        Parameters
        ----------
        integrated : ndarray of bool, shape (W,)
            Windows in which the attitude is integrated; it is constant in the others.
        with_force : bool
            Return the specific force of all samples even if no window is integrated.

        Returns
        -------
        stream : GyroStream
        force : ndarray, shape (3, n), or None
            Raw specific force of the samples, m/s²; None if no window is integrated and ``with_force`` is False.
        weights : ndarray, shape (n,), or None
            Averaging weight of each sample in its window, 0 outside the integrated windows; None if there are none.
        """
        if not with_force and not integrated.any():
            return self.rotation_stream, None, None
        spans, samples = self.rotation.copy(), self.windows.samples
        open_start, open_end = integrated[self.start], integrated[self.end]
        spans[open_start, 0] = samples[self.start[open_start], 0]
        spans[open_end, 1] = samples[self.end[open_end], 1]
        recording = self.recording
        F = weights = None
        n = int((spans[:, 1] - spans[:, 0]).sum())
        force = np.empty((3, n))
        if integrated.any():
            F, weights = np.ones(n), np.zeros(n)
        at = 0
        for k, (a, b) in enumerate(spans.tolist()):
            rows = recording.accel[a:b].T
            if recording.kind == "increment":
                interval = recording.interval_s
                rows = rows / (interval if isinstance(interval, float) else interval[a:b])
            force[:, at : at + b - a] = rows
            for is_end, flagged, w in ((False, open_start[k], self.start[k]), (True, open_end[k], self.end[k])):
                if flagged and F is not None and weights is not None:
                    lo, hi = samples[w] - a + at
                    weight = averaging_weights(hi - lo, self.average)
                    # Mid-sample share of the average that an attitude error at this sample acts on.
                    before = np.cumsum(weight) - 0.5 * weight
                    F[lo:hi] = 1.0 - before if is_end else before
                    weights[lo:hi] = weight
            at += b - a
        stream = self._gyro_stream(spans, F)
        self._remove_vibration(stream, open_start, open_end)
        return stream, force, weights

    @cached_property
    def rotation_stream(self) -> GyroStream:
        """Gyro samples of the rotations alone, the attitude constant in all windows."""
        stream = self._gyro_stream(self.rotation, None)
        self._remove_vibration(stream, *np.zeros((2, self.K), dtype=np.bool_))
        return stream

    @cached_property
    def fast_motion(self) -> Array:
        """Motion of every rotation near half the sample rate, as an angle of each axis, shape (K,), rad.

        Motion above half the sample rate folds back, and continues that below: eighth differences pass the upper third
        of the band, and leave white noise as it is. Increments have none. Without noise it is the angle turned.
        """
        stream, recording = self.rotation_stream, self.recording
        if self.noise.noise_free:
            return np.asarray(np.add.reduceat(np.linalg.norm(stream.increments, axis=0), stream.starts[:-1]))
        if recording.kind == "increment":
            return np.zeros(self.K)
        squares = np.zeros(stream.increments.shape[1] + 1)
        differences = np.diff(stream.increments, _DIFFERENCES, axis=1)
        squares[1 : 1 + differences.shape[1]] = np.sum(differences**2, axis=0)
        total = np.cumsum(squares) / math.comb(2 * _DIFFERENCES, _DIFFERENCES)
        first, last = stream.starts[:-1], np.maximum(stream.starts[1:] - _DIFFERENCES, stream.starts[:-1])
        lengths = np.diff(stream.starts)
        white = np.sum(self.noise.gyro_white**2) * recording.nominal_interval_s * (last - first)
        # Differences that reach beyond a rotation are left out: the others stand for them.
        used = lengths / np.maximum(last - first, 1)
        return np.asarray(np.sqrt(np.maximum(total[last] - total[first] - white, 0.0) * used / 3.0))

    def _gyro_stream(self, spans: Indices, F: Array | None) -> GyroStream:
        recording = self.recording
        return gyro_stream(
            recording.gyro, recording.interval_s, spans, self.rotation, rates=recording.kind == "rate", F=F
        )

    def _remove_vibration(self, stream: GyroStream, open_start: Mask, open_end: Mask) -> None:
        """Let the rotations begin and end at the mean attitude of the windows, which a vibrating unit leaves."""
        if self.vibration is None:
            return
        angles = self.vibration.angles(self.windows.samples)
        for k, (first, last) in enumerate(stream.rotation.tolist()):
            if not open_start[k]:
                stream.increments[:, first] += angles[self.start[k], 1]
            if not open_end[k]:
                stream.increments[:, last - 1] -= angles[self.end[k], 0]


def means_key(samples: Indices, average: Average) -> Hashable:
    """Name of the means of windows among the derived values of a recording."""
    return "window means", samples.tobytes(), average


def move_title(label: SequenceLabel) -> str:
    """Name of a move in messages."""
    return f"The move at {label.start_static_s[1]:g} s"


@derived
def prepare(
    recording: Recording,
    labels: tuple[SequenceLabel, ...],
    average: Average = "linear",
    *,
    voided: tuple[tuple[str, str], ...] = (),
    poses: tuple[SequenceLabel, ...] = (),
    moves: tuple[SequenceLabel, ...] = (),
) -> PreparedRecording:
    """Average the windows and set up the sequences; ``poses`` contribute only their start windows.

    ``moves`` are free turns from an end window to a start window; those of sequences that are missing are left out.

    Raises
    ------
    DataError
        If no sequence is left, or a rotation would have no samples.
    """
    starts, ends = {s.start_static_s for s in labels}, {s.end_static_s for s in labels}
    moves = tuple(s for s in moves if s.start_static_s in ends and s.end_static_s in starts)
    if not labels:
        reasons = [f"{k}: {v}" for k, v in voided]
        shown = "; ".join(reasons[:2]) + (f"; and {len(reasons) - 2} more" if len(reasons) > 2 else "")
        raise DataError(f"No usable sequence is left in the recording ({shown or 'none is labelled'}).")
    labels = (*labels, *moves)
    samples, (start, end) = windows_of_labels(recording, labels)
    slices = {(a, b): w for w, (a, b) in enumerate(samples.tolist())}
    alone = []
    for label in poses:
        s = recording.window_indices(*label.start_static_s)
        if s.stop - s.start >= LEAST_SAMPLES:
            alone.append((label, slices.setdefault((s.start, s.stop), len(slices))))
    samples = np.array(list(slices), dtype=np.intp)
    for k, label in enumerate(labels):
        if samples[end[k], 0] <= samples[start[k], 1]:
            if label.pose:
                raise DataError(
                    f"{label.title} holds {samples[end[k], 1] - samples[start[k], 0]} samples, but a pose needs at "
                    f"least {1.0 / POSE_MIDDLE:.0f}: let the unit rest longer, or widen its window."
                )
            raise DataError(
                f"Sequence {label.id or k + 1} has no samples between its start window (until "
                f"{label.start_static_s[1]:g} s) and its end window (from {label.end_static_s[0]:g} s): "
                "the rotation must lie between them."
            )
    return PreparedRecording(
        recording=recording,
        labels=labels,
        catalogue=tuple(sequence_of_label(label) for label in labels),
        windows=recording.memo(
            means_key(samples, average), lambda: average_windows([recording], [samples], average)[0]
        ),
        start=start,
        end=end,
        average=average,
        voided=dict(voided),
        poses=tuple(alone),
        moves=len(moves),
    )
