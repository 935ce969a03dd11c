"""Static poses of a recording for the mount alignment: windows, compensated means, and checks."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.exceptions import DataError, InputError
from srt.model.measurement_model import force_error_jacobian
from srt.model.sensor_model import accel_triad, outside_model
from srt.model.table1 import SEQUENCES
from srt.mount.alignment import MountAlignment, align_mount, pose_kinds, require_both
from srt.noise.bias_instability import window_draws
from srt.noise.noise_model import noise_model
from srt.recording.recording import Fixture
from srt.result.calibration import software
from srt.sensor_errors import GROUP_SLICES, NAMES
from srt.sequences.clipping import clipped_samples
from srt.sequences.plausibility import check_interval, check_rest
from srt.sequences.stationary_windows import find_windows, window_times
from srt.sequences.window_means import LEAST_SAMPLES, average_windows

if TYPE_CHECKING:
    from srt.model.sensor_model import Triad
    from srt.noise.noise_model import NoiseModel
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.sequences.window_means import Windows
    from srt.types import Array, Indices


_FORCE_WITHIN: Final = 0.01
"""Largest relative difference of compensated force and gravity: a calibrated unit is far better than 1 % (10 mrad)."""
_IMPOSSIBLE: Final = 1e-6
"""p-value of the tilt within a pose by its noise, below which the unit moved."""
_ANGLE_GROUPS: Final = ("accel_bias", "accel_misalignment")
"""Parameters on which the angles depend."""


@dataclass(frozen=True, slots=True, eq=False)
class StaticPoses:
    """Level and pitched static poses of a recording."""

    times_s: Array  # shape (s, 2); start of the first sample and stamp of the last
    force: Array  # shape (s, 3), m/s²; compensated mean specific force, in B
    # shape (3 s, 3 s), (m/s²)²; by source: "accel_noise" (with quantization and drift) and "calibration"
    covariance: dict[str, Array]
    omitted: int  # number of stationary windows in other attitudes

    @property
    def titles(self) -> tuple[str, ...]:
        """Names of the poses in messages."""
        return tuple(f"the static pose from {a:.6g} s to {b:.6g} s" for a, b in self.times_s.tolist())


def mount_from_recording(
    recording: Recording,
    calibration: Calibration,
    *,
    level_sigma_rad: float | None = None,
    axis_sigma_rad: float | None = None,
) -> MountAlignment:
    """Estimate the mount angles from a recording of a level and a pitched static pose.

    Parameters
    ----------
    recording : Recording
        Raw readings. Without labels the stationary windows are found; of sequences of Table 1 the start attitudes with
        y along the outer axis are used.
    calibration : Calibration
        Calibration of the unit; the caller judges its status.
    level_sigma_rad, axis_sigma_rad : float, optional
        As in :func:`srt.mount.alignment.align_mount`; default 1 mrad, or the alignment sigma of the fixture stated in
        the recording for the axis, and √2 of it for the level (base and mounting). If the calibration is of the same
        recording, its sigma of the mounting is used, which contains what it found beyond the stated one.

    Raises
    ------
    InputError
        Sigmas that are not positive, or a calibration outside of the sensor model.
    DataError
        No level or no pitched pose, a pose that cannot be used, or a unit that moved.
    """
    alignment = (recording.fixture or Fixture()).alignment_sigma_rad
    if recording.data_sha256 is not None and recording.data_sha256 == calibration.provenance.data_sha256:
        alignment = calibration.U_sigma_rad or alignment
    by_default = alignment if recording.fixture is None else math.sqrt(2.0) * alignment
    level = by_default if level_sigma_rad is None else level_sigma_rad
    axis = alignment if axis_sigma_rad is None else axis_sigma_rad
    found = find_poses(recording, calibration, level_sigma_rad=level)
    mount = align_mount(found.force, found.covariance, level_sigma_rad=level, axis_sigma_rad=axis, titles=found.titles)
    rows = tuple(
        {**pose, "start_s": a, "end_s": b} for pose, (a, b) in zip(mount.poses, found.times_s.tolist(), strict=True)
    )
    provenance = {
        "data_sha256": recording.data_sha256,
        "calibration_data_sha256": calibration.provenance.data_sha256,
        "serial": recording.serial or calibration.provenance.serial,
        "software": software(),
        "level_sigma_rad": level,
        "axis_sigma_rad": axis,
    }
    warnings = [*mount.warnings]
    if found.omitted:
        warnings.append(f"{found.omitted} stationary windows are neither level nor pitched by 90°, and were omitted.")
    fixed = [name for group in _ANGLE_GROUPS for name in NAMES[GROUP_SLICES[group]] if name in calibration.fixed]
    if fixed:
        warnings.append(
            f"The calibration fixes {', '.join(fixed)} without a sigma, so the mount's sigmas are too small."
        )
    return replace(mount, poses=rows, warnings=tuple(warnings), provenance=provenance)


def find_poses(recording: Recording, calibration: Calibration, *, level_sigma_rad: float) -> StaticPoses:
    """Average and compensate the static poses of a recording.

    Parameters
    ----------
    level_sigma_rad : float
        Tilt within a pose above which the unit moved, if the noise does not explain it, rad.

    Raises InputError, DataError as :func:`mount_from_recording`.
    """
    calibration.require_values()
    reason = outside_model(calibration.errors)
    if reason is not None:
        raise InputError(f"The calibration cannot be applied: {reason}; calibrate the unit again.")
    check_interval(recording)
    samples = _candidates(recording)
    windows = average_windows([recording], [samples], "linear")[0]
    times = np.array([window_times(recording, (a, b)) for a, b in samples.tolist()])
    names = [f"The static pose from {a:.6g} s to {b:.6g} s" for a, b in times.tolist()]
    g = recording.site.gravity_m_s2
    check_rest(windows.accel_mean, g, lambda: names, interval_s=recording.nominal_interval_s)
    accel = accel_triad(calibration.errors)
    force = accel.compensate(windows.accel_mean)
    kind = pose_kinds(force)
    require_both(kind)
    used = np.flatnonzero(~np.isnan(kind))
    _check_samples(recording, samples, used, names)
    off = np.abs(np.linalg.norm(force, axis=1) / g - 1.0)
    worst = used[np.argmax(off[used])]
    if off[worst] > _FORCE_WITHIN:
        raise DataError(
            f"{names[worst]}: the compensated specific force is {100.0 * off[worst]:.2g} % off gravity, but a "
            "calibrated unit is right to 1 %: the calibration is of another unit, or the unit moved."
        )
    noise = noise_model(recording, samples)
    _check_stationary(windows, accel, noise, used, names, level_sigma_rad)
    variance = (noise.accel_white**2 + windows.accel_excess) * windows.white_factor[
        :, None
    ] + noise.accel_edge**2 * windows.edge_factor[:, None]
    D = accel.sensitivity(force[used])
    # Bias instability is one drift over all poses, about the bias that the calibration states.
    draws = window_draws(samples[used], recording.time)
    drift = (draws @ draws.T)[:, :, None] * (noise.accel_flicker**2 + noise.accel_unseen**2)
    drift[np.diag_indices(len(used))] += variance[used]
    own = np.einsum("sab,stb,tcb->satc", D, drift, D)
    J = force_error_jacobian(force[used], accel).reshape(3 * len(used), -1)
    covariance = {"accel_noise": own.reshape(3 * len(used), -1), "calibration": J @ calibration.covariance @ J.T}
    return StaticPoses(times[used], force[used], covariance, len(kind) - len(used))


def _candidates(recording: Recording) -> Indices:
    """Windows that may be poses: first sample and one past the last, shape (W, 2), in time order."""
    labels = recording.sequences
    if not labels:
        return find_windows(recording)
    if any(label.id in SEQUENCES for label in labels):
        # With y along the outer axis the inner angle of the fixture is zero, as on a fixture with one axis.
        starts = [s for s in labels if s.id in SEQUENCES and SEQUENCES[s.id].along_outer == "y"]
        bounds = [label.start_static_s for label in starts]
    else:
        bounds = [window for label in labels for window in (label.start_static_s, label.end_static_s)]
    found = sorted({(s.start, s.stop) for s in (recording.window_indices(*b) for b in bounds)})
    if not found:
        raise DataError(
            "None of the labelled sequences starts with y along the outer axis: a pose with z down and one with x "
            "down are needed."
        )
    return np.array(found, dtype=np.intp)


def _check_samples(recording: Recording, samples: Indices, used: Indices, names: list[str]) -> None:
    """Refuse poses that are too short, interrupted or saturated."""
    for i in used.tolist():
        part = slice(*samples[i].tolist())
        if part.stop - part.start < LEAST_SAMPLES:
            raise DataError(f"{names[i]} holds one sample; a pose needs at least two: widen its window.")
        if (recording.gaps_inside(samples[i]) >= 0).any():
            raise DataError(f"{names[i]} has samples missing: the unit may have moved meanwhile; record it again.")
        clipped = [c for c in clipped_samples(recording, part) if c.channel.startswith("accel")]
        if clipped:
            raise DataError(f"{names[i]}: {clipped[0]}; an alignment needs readings inside the range.")


def _check_stationary(
    windows: Windows, accel: Triad, noise: NoiseModel, used: Indices, names: list[str], sigma_rad: float
) -> None:
    """Refuse a pose whose second half is tilted against the first by more than noise and levelling."""
    halves = accel.compensate(windows.accel_halves[used])
    T = 0.5 * windows.duration_s[used, None]
    up = halves.mean(axis=1)
    size = np.linalg.norm(up, axis=1, keepdims=True)
    up /= size
    change = halves[:, 1] - halves[:, 0]
    change -= up * np.einsum("sa,sa->s", up, change)[:, None]
    D2 = np.linalg.inv(accel.matrix) ** 2
    # The difference of two adjoining halves takes three velocity readings with weights 1, -2, 1.
    variance = (2.0 * noise.accel_white**2 / T + 6.0 * (noise.accel_edge / T) ** 2) @ D2.T + 2.0 * noise.accel_wander**2
    tilt = np.linalg.norm(change, axis=1) / size[:, 0]
    moved = (np.sum(change**2 / variance, axis=1) > chdtri(2, _IMPOSSIBLE)) & (tilt > sigma_rad)
    if moved.any():
        i = int(np.argmax(np.where(moved, tilt, 0.0)))
        raise DataError(
            f"{names[used[i]]} is not stationary: its second half is tilted by {1e3 * tilt[i]:.3g} mrad against the "
            "first, more than noise and levelling explain; the unit moved, or its accelerometers drift."
        )
