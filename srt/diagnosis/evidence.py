"""Evidence for the checks: readings, windows, rotations and static poses of a recording, each computed once on demand.

This module refuses no recording for its values: the checks find impossible readings. Readings are raw, and converted
to SI by the declared units. ``rate`` and ``force`` are rates also for a recording of increments.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from srt.estimation.options import Options
from srt.exceptions import DataError
from srt.sequences.manoeuvres import end_attitude
from srt.sequences.preparation import nominal_attitude, prepare
from srt.sequences.recognition import labelled, recognise
from srt.sequences.stationary_windows import find_turns

if TYPE_CHECKING:
    from srt.recording.recording import Recording, SequenceLabel
    from srt.result.calibration import Calibration
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.recognition import Recognition
    from srt.types import Array, Mask


class Evidence:
    """Quantities of one recording that the checks use.

    Parameters
    ----------
    recording : Recording
        If it has no labels, the recognised sequences or free rotations are used as labels.
    options : Options, optional
        Options of the calibration ``result``.
    result : Calibration, optional
        Calibration of the recording, if it is already known.
    """

    def __init__(self, recording: Recording, options: Options | None = None, result: Calibration | None = None) -> None:
        self.recording = recording
        self.options = options or Options()
        self._result = result

    # --- samples -----------------------------------------------------------------------------------------------------

    @cached_property
    def dt(self) -> float:
        """Nominal sampling interval, s."""
        return self.recording.nominal_interval_s

    @cached_property
    def per_rate(self) -> float:
        """Factor from stored values to rates: 1, or one over the interval for increments."""
        return 1.0 if self.recording.kind == "rate" else 1.0 / self.dt

    @cached_property
    def rate(self) -> Array:
        """Gyro readings, shape (n, 3), rad/s."""
        return self.recording.gyro if self.per_rate == 1.0 else self.recording.gyro * self.per_rate

    @cached_property
    def force(self) -> Array:
        """Accelerometer readings, shape (n, 3), m/s²."""
        return self.recording.accel if self.per_rate == 1.0 else self.recording.accel * self.per_rate

    # --- recognised and labelled sequences ---------------------------------------------------------------------------

    @cached_property
    def recognition(self) -> Recognition | None:
        """Stationary windows, manoeuvres and sequences found in the samples; None with fewer than two windows."""
        try:
            return recognise(self.recording)
        except DataError:
            return None

    @cached_property
    def has_labels(self) -> bool:
        """True if the recording has labels of its own."""
        return bool(self.recording.sequences)

    @cached_property
    def labels(self) -> tuple[SequenceLabel, ...]:
        """Labels of the recording; without any, those of the recognised sequences or free rotations; may be empty."""
        if self.has_labels:
            return self.recording.sequences
        if self.recognition is None:
            return ()
        if self.recording.fixture is not None or not self.recognition.by_chance:
            return self.recognition.labels
        try:
            return find_turns(self.recording)
        except DataError:
            return ()

    @property
    def _with_labels(self) -> Recording:
        return self.recording if self.has_labels else labelled(self.recording, self.labels)

    @cached_property
    def data(self) -> PreparedRecording | None:
        """Labelled recording, prepared for estimation without checks; None if it cannot be prepared."""
        try:
            return prepare(self._with_labels, self.labels, self.options.average)
        except DataError:
            return None

    @cached_property
    def contiguous(self) -> Mask:
        """True for each sequence without a gap between its first and last sample, shape (K,)."""
        data = self._data
        first, last = data.windows.samples[data.start, 0], data.windows.samples[data.end, 1]
        gaps = self.recording.gaps
        return np.asarray(np.searchsorted(gaps, first, side="right") == np.searchsorted(gaps, last, side="left"))

    @property
    def _data(self) -> PreparedRecording:
        if self.data is None:
            raise DataError("The recording has no sequence with two stationary windows: check the labels.")
        return self.data

    def title(self, sequence: int) -> str:
        """Name of a sequence in messages, such as "sequence 7"."""
        data = self._data
        again = f" (occurrence {data.occurrences[sequence]})" if data.occurrences[sequence] > 1 else ""
        name = data.ids[sequence]
        return f"{name}{again}" if data.catalogue[sequence] is None else f"sequence {name}{again}"

    def sequence_at(self, sample: int) -> int | None:
        """Number of the sequence whose windows or rotation contain a sample; None if there is none."""
        if self.data is None:
            return None
        first = self.data.windows.samples[self.data.start, 0]
        last = self.data.windows.samples[self.data.end, 1]
        inside = np.flatnonzero((first <= sample) & (sample < last))
        return int(inside[0]) if inside.size else None

    def place_title(self, sample: int) -> str:
        """Name in messages of the sequence that contains a sample, or "that part" if there is none."""
        k = self.sequence_at(sample)
        return "that part" if k is None else self.title(k)

    # --- stationary windows ------------------------------------------------------------------------------------------

    @cached_property
    def stationary_rate(self) -> Array:
        """Mean gyro reading of each window, shape (W, 3), rad/s."""
        return self._data.windows.gyro_mean

    @cached_property
    def stationary_force(self) -> Array:
        """Mean accelerometer reading of each window, shape (W, 3), m/s²."""
        return self._data.windows.accel_mean

    @cached_property
    def poses(self) -> tuple[Array, Array]:
        """Nominal and measured specific force at start and end of each known sequence, (2 K', 3) each, m/s²."""
        data = self._data
        nominal, reading = [], []
        for k, sequence in enumerate(data.catalogue):
            if sequence is None:
                continue
            down = nominal_attitude(sequence)[2]
            nominal += [-data.gravity * down, -data.gravity * (end_attitude(sequence).T @ down)]
            reading += [self.stationary_force[data.start[k]], self.stationary_force[data.end[k]]]
        return np.array(nominal).reshape(-1, 3), np.array(reading).reshape(-1, 3)

    # --- calibration -------------------------------------------------------------------------------------------------

    @cached_property
    def result(self) -> Calibration | None:
        """Calibration of the recording with the options; None if the estimator fails."""
        from srt.estimation.registry import automatic_estimator, find_estimator

        try:
            recording = self._with_labels
            return find_estimator(automatic_estimator(recording))(recording, self.options)
        except (DataError, np.linalg.LinAlgError):
            return None


def plain(value: Any) -> Any:
    """Value with numpy scalars and arrays converted to Python numbers and lists, for JSON."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
