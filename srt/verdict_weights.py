"""Weighted least squares without each sequence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt import measurement_noise
from srt.g_sensitivity import carried
from srt.held import held_sigma
from srt.model import measurement_model as model
from srt.sensor_errors import N_PARAMETERS
from srt.verdict import LeftOut, reestimate
from srt.verdict_playback import pools_left

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.iteration import Solution
    from srt.options import Options
    from srt.sequences.preparation import PlaybackData
    from srt.verdict_playback import Owned

    Array = NDArray[np.float64]


def without_sequences(data: PlaybackData, options: Options, solution: Solution, owned: list[Owned]) -> list[LeftOut]:
    """Weighted least squares on what is left: the block of a sequence taken out of the inverse covariance.

    The measurements are the rows u of horizontal and down components, and a pooled rate p. Of a Gaussian (u, p) the
    information is that of u and that of p given u, so that each sequence costs no more than its own few rows.
    """
    playback, n = solution.playback, len(solution.playback.z)
    estimated = np.asarray(solution.gain.any(axis=1), dtype=np.bool_)
    # The weights are those of the noise; what held values add to the covariance came after them.
    by_held = playback.H * np.where(estimated, 0.0, held_sigma(data, options))
    noise = solution.measurement_covariance - by_held @ by_held.T
    sigma = np.sqrt(np.maximum(np.diag(solution.gain @ noise @ solution.gain.T), 0.0))
    unit = np.where(estimated, sigma, 0.0)
    back = np.divide(1.0, unit, out=np.zeros_like(unit), where=unit > 0.0)
    # Of the last pool nothing is taken: the estimate with all sequences.
    pools = np.concatenate([pools_left(data, solution, owned), playback.pool[None]])
    gain = _bias_gain(data, options, solution)
    with_u, own = _pooled_noise(data, solution, gain, pools)
    rates = playback.rest_rate
    H_pools = np.einsum("kw,wap->kap", pools, model.rate_error_jacobian(playback.rate, playback.gyro)) * unit
    z_pools = playback.z[n - 3 :] + (pools - playback.pool) @ rates
    pooled = np.concatenate([H_pools, z_pools[:, :, None]], axis=2)
    # Taking off whole biases instead of their differences from the pooled one changes no estimate, and leaves the
    # pooled rate to its own rows.
    T = np.eye(n)[: n - 3]
    T[: 2 * data.K, n - 3 :] = -_offset_effect(data, solution, gain)
    R = T @ noise @ T.T
    scale = 1.0 / np.sqrt(np.diag(R))
    A = np.linalg.inv(R * np.outer(scale, scale)) * np.outer(scale, scale)
    X = np.concatenate([T @ playback.H * unit, (T @ playback.z)[:, None], T @ with_u], axis=1)
    AX = A @ X
    F = X.T @ AX
    found = []
    for k, D in enumerate([rows for rows, _ in owned] + [np.array([], dtype=np.intp)]):
        at = np.concatenate([np.arange(N_PARAMETERS + 1), N_PARAMETERS + 1 + 3 * k + np.arange(3)])
        block = AX[np.ix_(D, at)]
        left = F[np.ix_(at, at)] - block.T @ np.linalg.solve(A[np.ix_(D, D)], block)
        seen, cross = left[:-3, :-3], left[-3:, :-3]
        if pools[k].any():
            innovation = pooled[k] - cross
            seen = seen + innovation.T @ np.linalg.solve(own[k] - left[-3:, -3:], innovation)
        found.append(((seen[:-1, :-1] * np.outer(back, back)), seen[:-1, -1] * back))
    full = found[-1][0]
    return [reestimate(np.stack([full, N]), g, estimated) for N, g in found[:-1]]


def _bias_gain(data: PlaybackData, options: Options, solution: Solution) -> Array:
    """Share of a sequence's own rest rate that was taken as its bias."""
    compensated = np.sqrt(np.linalg.inv(solution.playback.gyro.matrix) ** 2 @ solution.wander**2)
    return measurement_noise.bias_gain(solution.playback, data, options.gyro_bias, compensated)


def _offset_effect(data: PlaybackData, solution: Solution, gain: Array) -> Array:
    """What a pooled rate does to the horizontal components through the biases less it, shape (2 K, 3)."""
    playback = solution.playback
    per_rate = playback.integrals.time @ playback.gyro.matrix
    M = model.attitude_to_horizontal(playback.basis, playback.acceleration)
    return np.asarray((M @ per_rate * gain).reshape(2 * data.K, 3))


def _pooled_noise(data: PlaybackData, solution: Solution, gain: Array, pools: Array) -> tuple[Array, Array]:
    """Covariance of rates pooled in P ways with the measurements, shape (n_z, 3 P), and of each, shape (P, 3, 3)."""
    playback = solution.playback
    with_z = np.zeros((len(playback.z), 3 * len(pools)))
    own = np.zeros((len(pools), 3, 3))
    for source in measurement_noise.disturbances(playback, data, solution.wander).values():
        if source.rate is not None:
            pooled = np.tensordot(pools, carried(playback, source.rate)[0], 1)
            with_z += measurement_noise.project(playback, data, source, gain) @ pooled.reshape(3 * len(pools), -1).T
            own += pooled @ np.swapaxes(pooled, 1, 2)
    return with_z, own
