"""Verification of a calibration against its recording, and the history of attitude and specific force over the test.

A file whose values were edited can still be consistent. Processing the samples with those values then gives other
residuals than the file states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import DEG
from srt.estimation.earth_rate_regression import with_earth_rate_regression
from srt.estimation.options import Options
from srt.estimation.registry import BUILT_IN
from srt.estimation.rest_rate_scatter import bias_gain
from srt.estimation.srt_measurements import SrtProcessor
from srt.exceptions import DataError, InputError, clipped
from srt.model import rotations
from srt.model.table1 import SEQUENCES
from srt.result.applier import Applier
from srt.sensor_errors import GROUP_SLICES
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.recognition import label_sequences
from srt.sequences.stationary_windows import find_turns
from srt.sequences.stillness import moved_windows

if TYPE_CHECKING:
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.recording.recording import Recording
    from srt.reports.certificate.calibration_file import CalibrationFile
    from srt.result.calibration import Calibration
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


_SHARE: Final = 0.5
"""Tolerance of a residual, over its change by one sigma of the parameters. The last correction, which is not
re-processed, is a hundredth of a sigma; an edit that matters is more than a sigma."""
_EARTH_RATE_PASSES: Final = 4
"""Passes in which the unknown Earth rate becomes exact: its error falls by about 100 in each."""
_ROUNDING: Final = 1e-8
"""Rounding tolerance, of g and of 1 mrad/s: below the resolution of any unit."""
_USED: Final = ("average", "down", "window_attitude", "gyro_bias", "measured_vertical")
"""Options that affect the processing of a recording."""
_MOST: Final = 200
"""Number of attitudes in the history of a sequence: more than a figure resolves."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordingHistory:
    """Attitude and specific force over a test, from the corrected samples.

    Attributes
    ----------
    time, down : ndarray, shapes (m,) and (m, 3)
        Time, s, and the direction of down in IMU axes as the gyros propagate it through each sequence from its start;
        NaN between sequences.
    samples, force : ndarray, shapes (n,) and (n, 3)
        Time, s, and corrected specific force, m/s².
    breaks : ndarray of int
        Samples that begin after a gap.
    rest, excess : ndarray, shapes (W, 2) and (W,)
        Stationary windows, s, and their mean specific force less gravity, m/s².
    rest_down : ndarray, shape (W, 3)
        Direction of down in each window as the accelerometers measure it.
    turned_deg_s : float
        Highest rate of a turn, °/s, of means over a twentieth of a second.
    duration_s, rate_hz : float
    count : int
        Samples.
    """

    time: Array
    down: Array
    samples: Array
    force: Array
    breaks: Indices
    rest: Array
    excess: Array
    rest_down: Array
    turned_deg_s: float
    duration_s: float
    rate_hz: float
    count: int


def check_recording(source: CalibrationFile, recording: Recording, name: str) -> None:
    """Refuse a recording that is not the calibration's own.

    Parameters
    ----------
    source : CalibrationFile
    recording : Recording
    name : str
        Name of the recording in messages.

    Raises
    ------
    InputError
        Other samples, or another unit.
    """
    if not source.hashes:
        raise InputError(
            f"{source.name} does not say which samples it was made from, so that {name} cannot be told to be its "
            "recording: leave the recording out, or calibrate it again."
        )
    if recording.data_sha256 is None:
        raise InputError(f"{name} was made in memory and has no SHA-256: write it, and calibrate what was written.")
    if recording.data_sha256 not in source.hashes:
        raise InputError(
            f"{name} holds other samples (SHA-256 {str(recording.data_sha256)[:12]}...) than {source.name} was made "
            f"from ({source.hashes[0][:12]}...): name the recording that was calibrated."
        )
    if None not in (recording.serial, source.serial) and recording.serial != source.serial:
        raise InputError(
            f"{name} is of the unit {clipped(str(recording.serial))}, but {source.name} of "
            f"{clipped(str(source.serial))}: one of the two was edited; name the recording that was calibrated."
        )


def recording_history(source: CalibrationFile, recording: Recording, name: str) -> RecordingHistory:
    """Process a recording with the values of the calibration, and collect its history.

    Parameters
    ----------
    source : CalibrationFile
    recording : Recording
        Its own, see :func:`check_recording`.
    name : str
        Name of the recording in messages.

    Raises
    ------
    InputError
        If the values do not follow from the recording.
    """
    calibration = source.calibration
    options = _options(calibration, source.name)
    try:
        labelled, _ = label_sequences(recording)
        labels = labelled.sequences or find_turns(labelled)
        if calibration.estimator == "closed-form":
            labels = tuple(s for s in labels if s.id in SEQUENCES)
        data = prepare_checked(labelled, labels, options.average)
    except DataError as error:
        raise InputError(f"{name} cannot be processed, unlike when {source.name} was made: {error}") from None
    # Other estimators define their residuals differently.
    if calibration.estimator in BUILT_IN and not _follows(calibration, data, options):
        raise InputError(
            f"The values in {source.name} do not follow from {name}: processed with them, its samples give other "
            "residuals than the file has, so that one of the two was edited; calibrate the recording again."
        )
    return _history(calibration, data)


def _options(calibration: Calibration, name: str) -> Options:
    given: dict[str, Any] = calibration.provenance.get("options") or {}
    try:
        return Options(**{key: given[key] for key in _USED if key in given})
    except (InputError, TypeError):
        raise InputError(f"{name} states unknown options: it was edited; calibrate again.") from None


def _follows(calibration: Calibration, data: PreparedRecording, options: Options) -> bool:
    """True if the recording, processed with the values of the calibration, gives the residuals that it states."""
    K, W = data.K, len(data.windows.duration_s)
    stated = _stated(calibration, data)
    offset = _array(calibration.noise.get("gyro_bias_by_sequence_rad_s"), (K, 3))
    wander = _array(calibration.noise.get("gyro_bias_wander_rad_s"), (3,))
    if stated is None or offset is None or wander is None:
        return False
    how: dict[str, Any] = {
        "U": calibration.U,
        "nominal_vertical": not options.measured_vertical,
        "bias_offset": offset,
        "g_sensitivity": _array((calibration.diagnostics.get("g_sensitivity") or {}).get("matrix"), (3, 3)),
    }
    whole = options.window_attitude == "integrated"

    def processed(integrated: Mask) -> SrtMeasurements:
        """SRT measurements at the values of the calibration, the unknown Earth rate included as least squares does."""
        processor = SrtProcessor(data, options, integrated)
        measurements = processor.process(calibration.errors, **how)
        for _ in range(_EARTH_RATE_PASSES if calibration.estimator == "least-squares" else 0):
            before = measurements.earth_rate_regression
            if before is not None:
                measurements = processor.process(
                    calibration.errors, **how, earth_rate_offset=before.rate @ before.draws
                )
            by_sensor = np.sqrt(np.linalg.inv(measurements.gyro.matrix) ** 2 @ wander**2)
            gain = bias_gain(measurements, data, options.gyro_bias, by_sensor)
            draws = None if before is None else before.draws
            measurements = with_earth_rate_regression(measurements, data, by_sensor, gain, draws)
            if measurements.earth_rate_regression is None:
                break
        return measurements

    playback = processed(np.full(W, whole))
    first = _within(calibration, playback, stated, data)
    # The iteration integrates the attitude over windows that moved; the file does not name these windows. The
    # horizontal components of a sequence depend on the choice, and may match with either window integrated.
    left = playback.rest_rate - playback.pool @ playback.rest_rate
    compensated = np.sqrt(np.linalg.inv(playback.gyro.matrix) ** 2 @ wander**2)
    moved = moved_windows(data, playback.gyro, playback.accel, left, compensated)
    turns = first[: 2 * K].reshape(K, 2).all(axis=1)
    for integrated in (moved, np.ones(W, dtype=np.bool_), np.arange(W) % 2 == 0, np.arange(W) % 2 == 1):
        if whole or turns.all():
            break
        again = processed(integrated)
        turns |= _within(calibration, again, stated, data)[: 2 * K].reshape(K, 2).all(axis=1)
    # The file has no rate at rest; its residual is zero for the closed form only, if all windows are at rest.
    checked = calibration.estimator == "closed-form" and calibration.observed[GROUP_SLICES["gyro_bias"]].all()
    rates = first[-3:].all() or moved.any() or not checked
    return bool(turns.all() and first[2 * K : -3].all() and rates)


def _within(calibration: Calibration, playback: SrtMeasurements, stated: Array, data: PreparedRecording) -> Mask:
    """Mask of the measurements that match the stated residuals within the tolerance."""
    by_sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", playback.H, calibration.covariance, playback.H), 0.0))
    unit = np.append(np.full(len(stated), data.gravity), [1e-3, 1e-3, 1e-3])
    away = np.abs(playback.z - np.concatenate([stated, np.zeros(3)]))
    return np.asarray(away <= _SHARE * by_sigma + _ROUNDING * unit)


def _stated(calibration: Calibration, data: PreparedRecording) -> Array | None:
    """Residuals of the file in the order of the measurements; None if they are of other sequences."""
    K = data.K
    if len(calibration.residuals) != 4 * K:
        return None
    out = np.zeros(2 * K + len(data.windows.duration_s))
    for k, (name, occurrence) in enumerate(zip(data.ids, data.occurrences, strict=True)):
        rows = calibration.residuals[4 * k : 4 * k + 4]
        if any((r.sequence, r.occurrence) != (name, occurrence) for r in rows):
            return None
        places = (2 * k, 2 * k + 1, 2 * K + int(data.start[k]), 2 * K + int(data.end[k]))
        out[list(places)] = [r.value for r in rows]
    return out


def _array(value: object, shape: tuple[int, ...]) -> Array | None:
    try:
        out = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return out if out.shape == shape and bool(np.all(np.isfinite(out))) else None


def _history(calibration: Calibration, data: PreparedRecording) -> RecordingHistory:
    recording = data.recording
    interval = recording.interval_s
    increments = recording.kind == "increment"
    gyro, force = Applier(calibration).apply(recording.gyro, recording.accel, dt=interval if increments else None)
    dt = np.broadcast_to(np.asarray(interval, dtype=np.float64), recording.time.shape)
    angle = gyro if increments else gyro * dt[:, None]
    force = force / dt[:, None] if increments else force
    mean = Applier(calibration).apply(data.windows.gyro_mean, data.windows.accel_mean)[1]
    size = np.linalg.norm(mean, axis=1)
    rest_down = -mean / size[:, None]
    samples = data.windows.samples
    times, downs, fastest = [], [], 0.0
    width = max(1, round(0.05 / recording.nominal_interval_s))
    for k in range(data.K):
        a, b = int(samples[data.start[k], 0]), int(samples[data.end[k], 1])
        turn = slice(*data.rotation[k].tolist())
        fastest = max(fastest, _fastest(angle[turn], dt[turn], width))
        # The Earth turns by a few thousandths of a degree in a sequence's time: less than a line is wide.
        chained = rotations.prefix_product(rotations.from_rotation_vector(np.ascontiguousarray(angle[a:b].T)))
        at = np.unique(np.linspace(0, b - a - 1, _MOST).astype(np.intp))
        C = rotations.to_matrix(np.ascontiguousarray(chained[:, at]))
        downs += [np.einsum("abn,a->nb", C, rest_down[data.start[k]]), np.full((1, 3), np.nan)]
        times += [recording.time[a:b][at], recording.time[b - 1 : b]]
    rest = recording.time[samples - np.array([0, 1])]
    return RecordingHistory(
        time=np.concatenate(times),
        down=np.concatenate(downs),
        samples=recording.time,
        force=force,
        breaks=recording.gaps,
        rest=rest,
        excess=size - data.gravity,
        rest_down=rest_down,
        turned_deg_s=fastest / DEG,
        duration_s=float(recording.time[-1] - recording.time[0]) + recording.nominal_interval_s,
        rate_hz=1.0 / recording.nominal_interval_s,
        count=recording.time.size,
    )


def _fastest(angle: Array, dt: Array, width: int) -> float:
    """Highest rate of means over ``width`` samples, rad/s."""
    starts = np.arange(0, len(dt) - width + 1, width)
    if not len(starts):
        starts = np.array([0])
    turned, took = np.add.reduceat(angle, starts, axis=0), np.add.reduceat(dt, starts)
    return float(np.max(np.linalg.norm(turned, axis=1) / took))
