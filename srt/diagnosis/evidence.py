"""Evidence for the checks: readings, windows, rotations and static poses of a recording, each computed once on demand.

This module refuses no recording for its values: the checks find impossible readings. Readings are raw, and converted
to SI by the declared units. ``rate`` and ``force`` are rates also for a recording of increments.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np

from srt.diagnosis.gravity_rotation import (
    block_means,
    gravity_relation,
    labelled_manoeuvres,
    missed_rotations,
    recognised_manoeuvres,
    turning_blocks,
)
from srt.diagnosis.jumps import NO_SPIKES, false_in_turns, find_jumps, largest_shift, wrapped_readings
from srt.diagnosis.label_shift import label_shift
from srt.diagnosis.rotation_readings import (
    ROUNDING,
    block_averages,
    find_rotations,
    raw_integrals,
    turning_windows,
)
from srt.diagnosis.stationary_rates import base_tilt, earth_rate, stationary_rate_fit, stationary_rates
from srt.diagnosis.time_offsets import attitude_step, force_effects, lag, stabilised_force, time_offset
from srt.diagnosis.triad_fits import (
    accel_fit,
    accel_ratios,
    gyro_fit,
    gyro_ratios_to_gravity,
    gyro_ratios_to_labels,
    measured_angles,
    raw_triads,
)
from srt.diagnosis.window_averages import quantization, window_averages
from srt.estimation.options import Options
from srt.exceptions import DataError
from srt.noise.quantization import smallest_step
from srt.sequences.clipping import clipped_samples
from srt.sequences.manoeuvres import end_attitude
from srt.sequences.preparation import nominal_attitude, prepare
from srt.sequences.recognition import labelled, recognise
from srt.sequences.stationary_windows import find_turns

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.diagnosis.gravity_rotation import ManoeuvreReadings
    from srt.diagnosis.jumps import Spikes
    from srt.diagnosis.label_shift import LabelShift
    from srt.diagnosis.time_offsets import AttitudeStep
    from srt.diagnosis.triad_fits import MeasuredAngles, ScaleRatios
    from srt.recording.recording import Recording, SequenceLabel
    from srt.result.calibration import Calibration
    from srt.sequences.clipping import Clipping
    from srt.sequences.preparation import PreparedRecording
    from srt.sequences.recognition import Recognition
    from srt.types import Array, Indices, Mask


SAMPLES: Final = 20_000
"""Number of samples that suffices for the tests of whole columns: more would only take longer."""
MANY: Final = 20
"""Fewest readings or values that exclude chance: of as many independent ones, all have one bit set with p = 1e-6, and
none lies in a band where as many are expected with p = 2e-9."""
_T = TypeVar("_T")


def _of(function: Callable[..., _T | None], *inputs: str) -> cached_property[_T | None]:
    """Quantity that a function computes from other quantities on demand; None if one of them is None."""

    def computed(evidence: Evidence) -> _T | None:
        values: list[Any] = []
        for name in inputs:
            values.append(getattr(evidence, name))
            if values[-1] is None:
                return None
        return function(*values)

    return cached_property(computed)


def _from(function: Callable[..., _T], *inputs: str) -> cached_property[_T]:
    """Quantity that a function computes from other quantities on demand, whether these are None or not."""
    return cached_property(lambda evidence: function(*(getattr(evidence, name) for name in inputs)))


class Evidence:
    """Quantities of one recording that the checks use.

    Parameters
    ----------
    recording : Recording
        If it has no labels, the recognised sequences or free rotations are used as labels.
    options : Options, optional
        Options of the calibration ``result``.
    """

    def __init__(self, recording: Recording, options: Options | None = None) -> None:
        self.recording = recording
        self.options = options or Options()
        self._once: dict[Any, Any] = {}

    def once(self, function: Callable[[Evidence], _T]) -> _T:
        """Value of a function of this evidence, computed once for all checks that use it."""
        if function not in self._once:
            self._once[function] = function(self)
        value: _T = self._once[function]
        return value

    # --- samples -----------------------------------------------------------------------------------------------------

    @cached_property
    def dt(self) -> float:
        """Nominal sampling interval, s."""
        return self.recording.nominal_interval_s

    @cached_property
    def per_rate(self) -> float:
        """Factor from stored values to rates: 1, or one over the interval for increments."""
        return self.recording.rates_factor

    @cached_property
    def rate(self) -> Array:
        """Gyro readings, shape (n, 3), rad/s."""
        return self.recording.gyro if self.per_rate == 1.0 else self.recording.gyro * self.per_rate

    @cached_property
    def force(self) -> Array:
        """Accelerometer readings, shape (n, 3), m/s²."""
        return self.recording.accel if self.per_rate == 1.0 else self.recording.accel * self.per_rate

    @cached_property
    def columns(self) -> Array:
        """Stored values of the six channels, gyros first, shape (6, n)."""
        return np.ascontiguousarray(np.hstack([self.recording.gyro, self.recording.accel]).T)

    @cached_property
    def extremes(self) -> tuple[Array, Array]:
        """Smallest and largest stored value of each channel, shape (6,)."""
        return self.columns.min(axis=1), self.columns.max(axis=1)

    @cached_property
    def zeros(self) -> Indices:
        """Number of zero readings of each channel, shape (6,)."""
        return np.asarray(np.count_nonzero(self.columns == 0.0, axis=1))

    @cached_property
    def cut_at_zero(self) -> Mask:
        """True for each channel that reads zero often, and one of the signs never, shape (6,)."""
        low, high = self.extremes
        return np.asarray((self.zeros >= MANY) & (low * high == 0.0) & (low < high))

    @cached_property
    def some(self) -> tuple[Array, Array]:
        """Stored values of gyros and accelerometers at samples that suffice for the tests of whole columns, (m, 3)."""
        every = max(1, len(self.recording.time) // SAMPLES)
        return self.recording.gyro[::every], self.recording.accel[::every]

    @cached_property
    def steps(self) -> Array:
        """Smallest step between the stored values of each channel, shape (2, 3); zero where they hardly repeat."""
        return np.array([smallest_step(table) for table in self.some])

    @cached_property
    def repeats(self) -> Mask:
        """True for each sample that equals the previous one, shape (9, n - 1).

        The rows are for all channels, the gyros, the accelerometers, and each of the six channels.
        """
        single = self.columns[:, 1:] == self.columns[:, :-1]
        triads = single[::3] & single[1::3] & single[2::3]
        return np.concatenate([triads.all(axis=0, keepdims=True), triads, single])

    @cached_property
    def noisy_channels(self) -> Mask:
        """True for each channel whose readings in the first window scatter by more than rounding, shape (6,)."""
        if self.data is None:
            return np.zeros(6, dtype=np.bool_)
        a, b = self.data.windows.samples[0].tolist()
        part = self.columns[:, a:b]
        largest = np.abs(part).reshape(2, -1).max(axis=1).repeat(3)
        return np.asarray(np.std(np.diff(part), axis=1) > ROUNDING * largest)

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
        return np.asarray(self.recording.gaps_inside(np.column_stack([first, last])) < 0)

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

    def window_place(self, window: int, later_s: float = 0.0) -> dict[str, object]:
        """Start of a window (or a time after it), s, and title of its sequence, as fields of a message."""
        data = self._data
        k = int(np.flatnonzero((data.start == window) | (data.end == window))[0])
        first = int(data.windows.samples[window, 0])
        return {"time": float(self.recording.time[first]) - self.dt + later_s, "sequence": self.title(k)}

    @cached_property
    def stationary_force(self) -> Array:
        """Mean accelerometer reading of each window, shape (W, 3), m/s²."""
        return self._data.windows.accel_mean - self._data.noise.accel_rounding

    @cached_property
    def poses(self) -> tuple[Array, Array]:
        """Nominal and measured specific force at start and end of each known sequence, (2 K', 3) each, m/s²."""
        nominal: list[Array] = []
        rows: list[int] = []
        gravity = self.recording.site.gravity_m_s2
        for k, sequence in enumerate(() if self.data is None else self.data.catalogue):
            if sequence is not None:
                down = nominal_attitude(sequence)[2]
                nominal += [-gravity * down, -gravity * (end_attitude(sequence).T @ down)]
                rows += [self._data.start[k], self._data.end[k]]
        return np.array(nominal).reshape(-1, 3), self.stationary_force[rows] if rows else np.zeros((0, 3))

    @cached_property
    def labelled_inputs(self) -> tuple[Array, Array]:
        """Labelled rotations of the gyros on a fixture, and rest, (L + 1, 3), rad; specific force of the poses, g."""
        if self.data is None or self.recording.fixture is None:
            return np.zeros((0, 3)), np.zeros((0, 3))
        turned = [s.axes * s.angles_rad[:, None] for s in self.data.catalogue if s is not None]
        return np.concatenate([np.zeros((1, 3)), *turned]), self.poses[0] / self.recording.site.gravity_m_s2

    quantization = _of(quantization, "data", "steps")
    """Quantization step of each channel in stored values, shape (6,)."""
    window_averages = _of(window_averages, "data", "columns", "quantization")
    """Averages inside the windows."""
    stationary_rates = _of(stationary_rates, "data", "gyro_fit")
    """Stationary rates and the design matrix of their model."""
    stationary_rate_fit = _of(stationary_rate_fit, "stationary_rates", "recording")
    """Bias, drift, g-sensitivity and Earth rate of the stationary rates."""
    base_tilt = _of(base_tilt, "data", "poses")
    """Tilt of the base in the static poses."""
    earth_rate = _of(earth_rate, "stationary_rate_fit", "recording", "base_tilt")
    """Earth rate in the windows, in level axes."""
    turning_windows = _of(turning_windows, "data", "columns", "raw_integrals")
    """True for each window in which the unit rotates as in a manoeuvre, shape (W,): its label is wrong."""

    @cached_property
    def label_shift(self) -> LabelShift | None:
        """Shift of the labels in time; None if they are not shifted."""
        data, seen, turning = self.data, self.raw_integrals, self.turning_windows
        if data is None or seen is None or turning is None or not self.has_labels:
            return None
        return label_shift(data, seen, self.contiguous, turning)

    @cached_property
    def unlabelled(self) -> Evidence:
        """Evidence of the same readings without labels."""
        own = Evidence(self.recording.with_sequences(()), self.options)
        own.recognition = self.recognition
        return own

    # --- rotations ---------------------------------------------------------------------------------------------------

    raw_integrals = _of(raw_integrals, "data")
    """Integrals of the readings over each sequence."""
    block_averages = _of(block_averages, "data", "contiguous")
    """Block averages of all manoeuvres without a gap."""

    rotations = _from(find_rotations, "data", "block_averages")
    """Measured and nominal rotations of the sequences."""
    gyro_fit = _from(gyro_fit, "rotations")
    """Fit of measured to nominal rotations."""
    accel_fit = _from(accel_fit, "poses")
    """Fit of measured to nominal specific force of the poses."""
    raw_triads = _from(raw_triads, "gyro_fit", "accel_fit")
    """Raw gyro matrix, and raw accelerometer matrix and bias, in the nominal frame."""

    @cached_property
    def measured_angles(self) -> MeasuredAngles | None:
        """Angles of the rotations on a fixture, without outliers; None with too few."""
        return None if self.recording.fixture is None else measured_angles(self.rotations)

    @cached_property
    def manoeuvres(self) -> ManoeuvreReadings | None:
        """Readings of the labelled manoeuvres, or of the recognised ones without labels; None if there are none."""
        if self.has_labels:
            return None if self.data is None else labelled_manoeuvres(self.data, self.contiguous)
        return None if self.recognition is None else recognised_manoeuvres(self.recording, self.recognition)

    block_means = _from(block_means, "recording")
    """Mean rates and specific forces of blocks of a tenth of a second."""
    turning_blocks = _of(turning_blocks, "recording", "manoeuvres", "block_means")
    """Blocks inside of the manoeuvres."""
    missed_rotations = _from(missed_rotations, "manoeuvres", "turning_blocks")
    """Angles that single gyros miss in each manoeuvre, and that they read, (K, 3) each, rad."""
    gravity_relation = _of(gravity_relation, "turning_blocks")
    """Matrix K of the rotation of gravity against the gyros, shape (3, 3)."""
    stabilised_force = _of(stabilised_force, "data", "block_averages", "raw_triads")
    """Gyro-stabilised specific force of all rotations."""
    force_effects = _of(force_effects, "stabilised_force")
    """Effects of accelerometer errors on the specific force in B."""
    time_offset = _of(time_offset, "stabilised_force", "force_effects")
    """Time offset between the sensors."""
    lag = _of(lag, "time_offset", "dt")
    """Possible causes of a lag of a triad or of one channel, most likely first; None if there is no lag."""

    @cached_property
    def attitude_step(self) -> AttitudeStep | None:
        """Largest step of the stabilised specific force on a fixture: the acceleration by hand has steps."""
        path, effects = self.stabilised_force, self.force_effects
        if path is None or effects is None or self.recording.fixture is None:
            return None
        void = [k for k, _ in self.clipped_parts if k is not None]
        # A spike of an accelerometer is a step of the specific force.
        spikes = self.unused_spikes[~self.unused_spikes.of_repeats(self.repeats[0])]
        void += [k for at in spikes.sample.tolist() if (k := self.sequence_at(at)) is not None]
        return attitude_step(path, effects, self.time_offset, self.dt, void)

    # --- single readings and scales ----------------------------------------------------------------------------------

    @cached_property
    def clipped_parts(self) -> list[tuple[int | None, tuple[Clipping, ...]]]:
        """Numbers of the sequences with saturated readings, and their channels; None for all samples without labels."""
        recording, data = self.recording, self.data
        if not self.has_labels:
            whole = clipped_samples(recording, slice(None))
            return [(None, whole)] if whole else []
        if data is None:
            return []
        windows = data.windows.samples
        parts = ((k, slice(int(windows[data.start[k], 0]), int(windows[data.end[k], 1]))) for k in range(data.K))
        return [(k, channels) for k, part in parts if (channels := clipped_samples(recording, part))]

    wrapped_readings = _from(wrapped_readings, "columns", "extremes", "recording", "data")
    """First axis of a triad that wraps, and the numbers of the samples after its jumps, by sensor."""

    _jumps = _of(find_jumps, "columns", "data", "contiguous", "quantization")

    @cached_property
    def spikes(self) -> Spikes:
        """Spikes inside the sequences, also those of samples that repeat."""
        found = self._jumps
        if found is None:
            return NO_SPIKES
        spikes = found.spikes
        # Shifted labels include fast moves of the fixture, which look like spikes of the gyros.
        turning = self.turning_windows
        if turning is not None and np.any(spikes.channel < 3) and turning.sum() > 1:
            spikes = spikes[spikes.channel >= 3]
        return spikes + false_in_turns(self._with_labels, self.options, found.suspects)

    @property
    def largest_spike_shift(self) -> float | None:
        """Largest shift of a sensor error by the spikes, in its sigma; None if it is not known."""
        return None if self._jumps is None else largest_shift(self.spikes, self._jumps.noise, self._data)

    @property
    def unused_spikes(self) -> Spikes:
        """Spikes of the accelerometers in rotations, which enter no result."""
        return NO_SPIKES if self._jumps is None else self._jumps.unused

    @cached_property
    def gyro_scales(self) -> ScaleRatios:
        """Ratios of measured to labelled angles; for free rotations, of the gyros to the rotation of gravity."""
        by_labels = gyro_ratios_to_labels(self.rotations, self.gyro_fit, self.recording.fixture)
        if self.has_labels and by_labels.known:
            return by_labels
        return gyro_ratios_to_gravity(by_labels, self.turning_blocks, self.gravity_relation)

    accel_scales = _from(accel_ratios, "recording", "manoeuvres", "accel_fit")
    """Ratios of the stationary specific force to gravity."""

    # --- calibration -------------------------------------------------------------------------------------------------

    @cached_property
    def result(self) -> Calibration | None:
        """Calibration of the recording with the options; None if the estimator fails."""
        return self.calibrated(self.options)

    def calibrated(self, options: Options) -> Calibration | None:
        """Calibration of the recording with other options; None if the estimator fails."""
        from srt.estimation.registry import automatic_estimator, find_estimator

        try:
            recording = self._with_labels
            return find_estimator(automatic_estimator(recording))(recording, options)
        except (DataError, np.linalg.LinAlgError):
            return None


def plain(value: Any) -> Any:
    """Value with numpy scalars and arrays converted to Python numbers and lists, for JSON."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
