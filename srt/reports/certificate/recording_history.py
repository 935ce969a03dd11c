"""Recording of a calibration: told by the digest of its samples and by its statements, and its course over the test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import DEG
from srt.estimation.calibration_builder import stated_alignment, stated_site
from srt.exceptions import DataError, InputError, clipped
from srt.model import rotations
from srt.result.applier import Applier
from srt.result.document import to_document
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.stationary_windows import find_turns

if TYPE_CHECKING:
    from srt.recording.recording import Recording
    from srt.reports.certificate.calibration_file import CalibrationFile
    from srt.result.calibration import Calibration
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices


_MOST: Final = 200  # number of attitudes in the history of a sequence: more than a figure resolves


@dataclass(frozen=True, slots=True, eq=False)
class RecordingHistory:
    """Attitude and specific force over a test, from the corrected samples."""

    time: Array  # s, shape (m,)
    down: Array  # in IMU axes as the gyros propagate it from the start of each sequence, (m, 3); NaN between sequences
    samples: Array  # time, s, shape (n,)
    force: Array  # corrected specific force, m/s², shape (n, 3)
    breaks: Indices  # samples that begin after a gap
    rest: Array  # stationary windows, s, shape (W, 2)
    excess: Array  # their mean specific force less gravity, m/s², shape (W,)
    rest_down: Array  # down in each window as the accelerometers measure it, shape (W, 3)
    turned_deg_s: float  # highest rate of a turn, of means over a twentieth of a second
    duration_s: float
    rate_hz: float
    count: int  # samples


def check_recording(source: CalibrationFile, recording: Recording, name: str) -> None:
    """Refuse a recording, called ``name``, that is not the calibration's own.

    Raises InputError: other samples, another unit, or another site or fixture.
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
            f"{clipped(str(source.serial))}: name the recording that was calibrated."
        )
    calibration = source.calibration
    made = to_document(calibration.site) | to_document(calibration.alignment)
    stated = to_document(stated_site(recording)) | to_document(stated_alignment(recording))
    for key in {**made, **stated}:
        # Merged recordings state what they have in common alone.
        if made.get(key) != stated.get(key) and not (made.get(key) is None and len(source.hashes) > 1):
            raise InputError(
                f"{name} states {key} = {stated.get(key)}, but {source.name} was made with {made.get(key)}: restore "
                "the statement of the recording, or calibrate it again."
            )


def recording_history(source: CalibrationFile, recording: Recording, name: str) -> RecordingHistory:
    """Course of attitude and specific force over the recording of a calibration, corrected with its values.

    See :func:`check_recording`. Raises InputError, which says ``name``, if the recording cannot be processed.
    """
    origin = next(each for each in source.origins if each.data_sha256 == recording.data_sha256)
    average = origin.options.get("average", "linear")
    try:
        data = prepare_checked(recording, recording.sequences or find_turns(recording), average)
    except DataError as error:
        raise InputError(f"{name} cannot be processed, unlike when {source.name} was made: {error}") from None
    return _history(source.calibration, data)


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
