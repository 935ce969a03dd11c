"""Gyro-stabilised specific force in rotations: transformed to B_Strt, the body frame at the start of a sequence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srt.diagnosis.rotation_readings import invert_readings
from srt.model import rotations

if TYPE_CHECKING:
    from srt.diagnosis.rotation_readings import BlockAverages
    from srt.diagnosis.triad_fits import RawTriads
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices


@dataclass(frozen=True, slots=True, eq=False)
class StabilisedForce:
    """Specific force averaged over blocks of about 10 ms, transformed by the gyros to B_Strt of its sequence.

    Attributes
    ----------
    attitude : ndarray, shape (m, 3, 3)
        Attitude at the middle of the block, from the gyros: B to B_Strt.
    rate, force : ndarray, shape (m, 3), rad/s and units of gravity
        Rate, less the stationary mean, and specific force in B.
    up, up_body : ndarray, shape (m, 3)
        Measured vertical at the start of the block's sequence in B_Strt, and in B at the middle of the block.
    force_start : ndarray, shape (m, 3)
        Specific force in B_Strt, in units of gravity; constant for a perfect IMU.
    """

    attitude: Array
    rate: Array
    force: Array
    up: Array
    up_body: Array
    force_start: Array


def stabilised_force(data: PreparedRecording, path: BlockAverages, triads: RawTriads) -> StabilisedForce:
    """Gyro-stabilised specific force of all rotations."""
    gyro, accel, bias = triads
    rate = invert_readings(gyro, path.rate)
    angle = rate * path.step_s
    attitude = _attitudes(angle, path.starts)
    vertical = invert_readings(accel, data.windows.accel_mean[data.start] - bias)
    size = np.linalg.norm(vertical, axis=1, keepdims=True)
    up = np.divide(vertical, size, out=np.zeros_like(vertical), where=size > 0.0)
    force = invert_readings(accel, path.force - bias) / data.gravity
    up = up[path.sequence]
    up_body = np.einsum("ma,mab->mb", up, attitude)
    return StabilisedForce(attitude, rate, force, up, up_body, np.einsum("mab,mb->ma", attitude, force))


def _attitudes(angle: Array, starts: Indices) -> Array:
    """Attitude at the middle of each step, relative to the start of its chain of rotation vectors, (n, 3, 3)."""
    half = rotations.from_rotation_vector(np.ascontiguousarray(0.5 * angle.T))
    ends = rotations.prefix_product(rotations.multiply(half, half))
    begins = np.concatenate([[[1.0], [0.0]], ends[:, starts[1:-1] - 1]], axis=1)
    # One product over all chains, times the inverse attitude at the start of each chain and of half the last step.
    back = np.repeat(rotations.conjugate(begins), np.diff(starts), axis=1)
    middle = rotations.multiply(rotations.multiply(back, ends), rotations.conjugate(half))
    return np.ascontiguousarray(np.moveaxis(rotations.to_matrix(middle), 2, 0))
