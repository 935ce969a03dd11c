"""From a recording to the stands of a mount alignment: windows, compensated means, and what is wrong with them."""

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
from srt.mount.alignment import MountAlignment, align_mount, poses, require_both
from srt.noise.noise_model import noise_model
from srt.recording.recording import Fixture
from srt.result.calibration import software
from srt.sensor_errors import GROUP_SLICES, NAMES
from srt.sequences.plausibility import check_interval, check_rest, clipped_samples, clipping_levels, gap_inside
from srt.sequences.stationary_windows import find_windows, window_times
from srt.sequences.window_means import average_windows

if TYPE_CHECKING:
    from srt.model.sensor_model import Triad
    from srt.noise.noise_model import NoiseModel
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.sequences.window_means import Windows
    from srt.types import Array, Indices


_FORCE_WITHIN: Final = 0.01
"""Of gravity, within which the compensated force of a stand must lie: 1 % is 10 mrad, no calibrated unit's error."""
_IMPOSSIBLE: Final = 1e-6
_ANGLE_GROUPS: Final = ("accel_bias", "accel_misalignment")


@dataclass(frozen=True, slots=True, eq=False)
class Stands:
    """Stands of a recording that are level or pitched.

    Attributes
    ----------
    times_s : ndarray, shape (s, 2)
        From the start of the first sample to the stamp of the last.
    force : ndarray, shape (s, 3), m/s²
        Compensated mean specific force, in B.
    covariance : dict of str to ndarray, shape (3 s, 3 s), (m/s²)²
        By source: "accel_noise" (with pulses and drift) and "calibration".
    left_out : int
        Stationary windows in other attitudes.
    """

    times_s: Array
    force: Array
    covariance: dict[str, Array]
    left_out: int

    @property
    def titles(self) -> tuple[str, ...]:
        """What messages call the stands."""
        return tuple(f"the stand from {a:.6g} s to {b:.6g} s" for a, b in self.times_s.tolist())


def mount_from_recording(
    recording: Recording,
    calibration: Calibration,
    *,
    level_sigma_rad: float | None = None,
    axis_sigma_rad: float | None = None,
) -> MountAlignment:
    """Estimate the mount angles from a recording of a level and a pitched stand.

    Parameters
    ----------
    recording : Recording
        Raw readings. Without labels its stationary windows are found; of sequences of Table 1 the start attitudes
        with y along the outer axis are taken.
    calibration : Calibration
        Of the unit; whether its status is good enough is for the caller to say.
    level_sigma_rad, axis_sigma_rad : float, optional
        As in :func:`srt.mount.alignment.align_mount`; default 1 mrad, or what the recording states of its fixture: the
        alignment sigma for the axis, and √2 of it for the level, which both base and mounting take part in.

    Returns
    -------
    MountAlignment

    Raises
    ------
    InputError
        Sigmas that are not positive, or a calibration that is no IMU's.
    DataError
        No level or no pitched stand, a stand that cannot be used, or a unit that moved.
    """
    stated = (recording.fixture or Fixture()).alignment_sigma_rad
    by_default = stated if recording.fixture is None else math.sqrt(2.0) * stated
    level = by_default if level_sigma_rad is None else level_sigma_rad
    axis = stated if axis_sigma_rad is None else axis_sigma_rad
    stands = find_stands(recording, calibration, level_sigma_rad=level)
    mount = align_mount(
        stands.force, stands.covariance, level_sigma_rad=level, axis_sigma_rad=axis, titles=stands.titles
    )
    rows = tuple(
        {**stand, "start_s": a, "end_s": b} for stand, (a, b) in zip(mount.stands, stands.times_s.tolist(), strict=True)
    )
    provenance = {
        "data_sha256": recording.data_sha256,
        "calibration_data_sha256": calibration.provenance.get("data_sha256"),
        "serial": recording.serial or calibration.provenance.get("serial"),
        "software": software(),
        "level_sigma_rad": level,
        "axis_sigma_rad": axis,
    }
    warnings = [*mount.warnings]
    if stands.left_out:
        warnings.append(
            f"{stands.left_out} stationary windows are neither level nor pitched by 90°, and were left out."
        )
    held = [name for group in _ANGLE_GROUPS for name in NAMES[GROUP_SLICES[group]] if name in calibration.held]
    if held:
        warnings.append(
            f"The calibration holds {', '.join(held)} without a sigma, so the mount's sigmas are too small."
        )
    return replace(mount, stands=rows, warnings=tuple(warnings), provenance=provenance)


def find_stands(recording: Recording, calibration: Calibration, *, level_sigma_rad: float) -> Stands:
    """Average and compensate the stands of a recording.

    Parameters
    ----------
    recording : Recording
    calibration : Calibration
    level_sigma_rad : float
        Tilt within a stand that is taken for motion if the noise does not explain it.

    Raises
    ------
    InputError, DataError
        As :func:`mount_from_recording`.
    """
    reason = outside_model(calibration.errors)
    if reason is not None:
        raise InputError(f"The calibration cannot be applied: {reason}; calibrate the unit again.")
    check_interval(recording)
    samples = _candidates(recording)
    windows = average_windows(recording, samples, "linear")
    times = np.array([window_times(recording, (a, b)) for a, b in samples.tolist()])
    names = [f"The stand from {a:.6g} s to {b:.6g} s" for a, b in times.tolist()]
    g = recording.site.gravity_m_s2
    check_rest(windows.accel_mean, g, names, interval_s=recording.nominal_interval_s)
    accel = accel_triad(calibration.errors)
    force = accel.compensate(windows.accel_mean)
    kind = poses(force)
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
    _check_still(windows, accel, noise, used, names, level_sigma_rad)
    variance = (
        noise.accel_white**2 * windows.white_factor[:, None]
        + noise.accel_edge**2 * windows.edge_factor[:, None]
        + noise.accel_wander**2
    )
    D = accel.sensitivity(force[used])
    own = np.zeros((len(used), 3, len(used), 3))
    rows = np.arange(len(used))
    own[rows, :, rows] = np.einsum("sab,sb,scb->sac", D, variance[used], D)
    J = force_error_jacobian(force[used], accel).reshape(3 * len(used), -1)
    covariance = {
        "accel_noise": own.reshape(3 * len(used), -1),
        "calibration": J @ calibration.covariance @ J.T,
    }
    return Stands(times[used], force[used], covariance, len(kind) - len(used))


def _candidates(recording: Recording) -> Indices:
    """Windows to look at, first sample and one past the last, shape (W, 2), in time order."""
    labels = recording.sequences
    if not labels:
        return find_windows(recording)
    if any(label.id in SEQUENCES for label in labels):
        # With y along the outer axis the fixture stands as one of a single axis; elsewhere its inner angle is not 0.
        starts = [s for s in labels if s.id in SEQUENCES and SEQUENCES[s.id].along_outer == "y"]
        bounds = [label.start_static_s for label in starts]
    else:
        bounds = [window for label in labels for window in (label.start_static_s, label.end_static_s)]
    found = sorted({(s.start, s.stop) for s in (recording.window_indices(*b) for b in bounds)})
    if not found:
        raise DataError(
            "None of the labelled sequences starts with y along the outer axis: a stand with z down and one with x "
            "down are needed."
        )
    return np.array(found, dtype=np.intp)


def _check_samples(recording: Recording, samples: Indices, used: Indices, names: list[str]) -> None:
    """Refuse stands that are too short, interrupted or clipped."""
    levels = clipping_levels(recording)
    for i in used.tolist():
        part = slice(*samples[i].tolist())
        if part.stop - part.start < 2:
            raise DataError(f"{names[i]} holds one sample; a stand needs at least two: widen its window.")
        if gap_inside(recording, part).size:
            raise DataError(f"{names[i]} has samples missing: the unit may have moved meanwhile; record it again.")
        clipped = [c for c in clipped_samples(recording, part, levels) if c.channel.startswith("accel")]
        if clipped:
            raise DataError(f"{names[i]}: {clipped[0]}; an alignment needs readings inside the range.")


def _check_still(
    windows: Windows, accel: Triad, noise: NoiseModel, used: Indices, names: list[str], sigma_rad: float
) -> None:
    """Refuse a stand whose second half is tilted against the first by more than its noise and the levelling."""
    halves = accel.compensate(windows.accel_halves[used])
    T = 0.5 * windows.duration_s[used, None]
    up = halves.mean(axis=1)
    size = np.linalg.norm(up, axis=1, keepdims=True)
    up /= size
    change = halves[:, 1] - halves[:, 0]
    change -= up * np.einsum("sa,sa->s", up, change)[:, None]
    D2 = np.linalg.inv(accel.matrix) ** 2
    # Three readings of the velocity make the difference of two adjoining halves: 1, -2, 1.
    variance = (2.0 * noise.accel_white**2 / T + 6.0 * (noise.accel_edge / T) ** 2) @ D2.T + 2.0 * noise.accel_wander**2
    tilt = np.linalg.norm(change, axis=1) / size[:, 0]
    moved = (np.sum(change**2 / variance, axis=1) > chdtri(2, _IMPOSSIBLE)) & (tilt > sigma_rad)
    if moved.any():
        i = int(np.argmax(np.where(moved, tilt, 0.0)))
        raise DataError(
            f"{names[used[i]]} does not stand still: its second half is tilted by {1e3 * tilt[i]:.3g} mrad against the "
            "first, more than noise and levelling explain; the unit moved, or its accelerometers drift."
        )
