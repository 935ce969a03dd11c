"""Covariance of the SRT measurements, source by source (Savage 2020 [P], §9).

The sources are those of :mod:`srt.estimation.error_sources`. One projection takes errors of the attitude φ of each
sequence, and of the mean rate and mean specific force of each window, to the measurements; the effect G of the
unit-variance draws of a source gives ``R = G Gᵀ``. Correlations are therefore included: a window shared by two
rotations, the gyro bias pooled over all windows, one heading error for the whole recording.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.estimation import error_sources as sources
from srt.estimation.error_sources import Source
from srt.model.rotations import cross_matrix, rotation_matrix
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from srt.estimation.error_sources import Slopes
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices

    Draws = dict[str, Array]
    """Effects of S draws on errors of a kind ("turn", "rate", "force"), shape (..., n, 3, S) each."""


def projection(measurements: SrtMeasurements, data: PreparedRecording, bias_gain: Array) -> Draws:
    """Effect on z of φ in B_Strt, rad ("turn"), and of the windows' compensated means ("rate", "force").

    Parameters
    ----------
    measurements, data : SrtMeasurements, PreparedRecording
    bias_gain : ndarray, shape (..., 3)
        Share of a sequence's own rest rate that is taken as its bias (0: pooled, 1: its own).

    Returns
    -------
    dict of str to ndarray, shape (..., n_z, K or W, 3)
    """
    m, K, W = measurements, data.K, len(measurements.pool)
    each, unit, by_attitude = np.arange(K), np.eye(3 * W).reshape(W, 3, 3 * W), m.attitude_effect
    units, windows = m.z.shape[:-1], np.arange(W)
    turn, rate, force = (np.zeros((*units, 2 * K + W + 3, n, 3)) for n in (K, W, W))
    # The horizontal rows of sequence k are 2 k and 2 k + 1; views have them as axes of their own.
    of_turn, of_force = (G[..., : 2 * K, :, :].reshape(*units, K, 2, -1, 3) for G in (turn, force))
    of_turn[..., each, :, each, :] = np.moveaxis(by_attitude, -3, 0)
    turn[..., : 2 * K, :, :] = of_turn.reshape(*units, 2 * K, K, 3)
    seen, by_regression = m.after_g_sensitivity(unit)
    flat = seen.reshape(*seen.shape[:-3], W, -1)
    rest = (m.pool @ flat).reshape(*flat.shape[:-2], 3, -1)
    # The bias offset of a sequence is subtracted from the compensated rate.
    own = ((m.share - m.pool) @ flat).reshape(*flat.shape[:-2], K, 3, -1)
    by_bias = by_attitude @ m.integrals.time @ (m.gyro.matrix * bias_gain[..., None, :])[..., None, :, :]
    rate[..., : 2 * K, :, :] = (by_attitude @ by_regression - by_bias @ own).reshape(*units, 2 * K, W, 3)
    rate[..., 2 * K + W :, :, :] = rest.reshape(*rest.shape[:-1], W, 3)
    of_force[..., each, :, data.end, :] += np.moveaxis(m.basis @ m.integrals.C_end, -3, 0)
    of_force[..., each, :, data.start, :] -= np.moveaxis(m.basis, -3, 0)
    force[..., : 2 * K, :, :] = of_force.reshape(*units, 2 * K, W, 3)
    up = m.force / np.linalg.norm(m.force, axis=-1, keepdims=True)
    force[..., 2 * K + windows, windows, :] = -up
    return {"turn": turn, "rate": rate, "force": force}


def effect(projected: Draws, source: Source | Draws) -> Array:
    """Effect G on z of the unit draws of a source, or of its shared unknowns, shape (..., n_z, S)."""
    rows = projected["turn"].shape[:-2]
    if isinstance(source, Source):
        source = {kind: _of_unknowns(parts, source.unknowns) for kind, parts in source.shared.items()}
    by_kind = [
        projected[kind].reshape(*rows, -1) @ draws.reshape(*draws.shape[:-3], -1, draws.shape[-1])
        for kind, draws in source.items()
    ]
    return np.asarray(sum(by_kind)) if by_kind else np.zeros((*rows, 0))


def _of_unknowns(parts: list[tuple[Indices, Array]], unknowns: int) -> Array:
    """Effect of shared unknowns on the n errors of a kind, shape (..., n, 3, 3 unknowns)."""
    n, lead = len(parts[0][0]), np.broadcast_shapes(*(J.shape[:-3] for _, J in parts))
    out = np.zeros((*lead, n, 3, unknowns, 3))
    for number, J in parts:
        which = np.flatnonzero(number >= 0)
        each = np.broadcast_to(J, (*lead, n, 3, 3))[..., which, :, :]
        out[..., which, :, number[which], :] += np.moveaxis(each, -3, 0)
    return out.reshape(*lead, n, 3, -1)


def disturbances(measurements: SrtMeasurements, data: PreparedRecording, wander: Array) -> dict[str, Source | Draws]:
    """All error sources by name, in the order of the report.

    Parameters
    ----------
    measurements : SrtMeasurements
        Processed with ``with_noise=True``.
    data : PreparedRecording
    wander : ndarray, shape (..., 3), rad/s
        1-sigma of a sequence's gyro bias about the mean of the test (sensor axes), if no instability is stated.
    """
    by = slopes_of(measurements)
    noise = sources.white_noise(data, by, measurements.integrated) | sources.quantization(data, by)
    up = measurements.force / np.linalg.norm(measurements.force, axis=-1, keepdims=True)
    return {
        "gyro_noise": noise["gyro_noise"],
        "gyro_quantization": noise["gyro_quantization"],
        "gyro_bias_instability": _gyro_instability(measurements, data, by, wander),
        "accel_noise": noise["accel_noise"],
        "accel_quantization": noise["accel_quantization"],
        "accel_bias_instability": accel_drift(measurements, data.noise.accel_flicker, data.window_drift),
        "earth_rate_alignment": _earth_rate_error(measurements, data),
        **_latitude(measurements, data),
        "gravity": {"force": (data.recording.site.gravity_sigma_m_s2 * -up)[..., None]},
    }


def through(gain: Array, projected: Draws) -> Draws:
    """Effect on the parameters, gain (..., 27, n_z) times z, of what has a projection onto z."""
    rows = gain.shape[:-1]
    return {
        kind: (gain @ part.reshape(*part.shape[:-2], -1)).reshape(*rows, *part.shape[-2:])
        for kind, part in projected.items()
    }


def covariance(projected: Draws, found: Collection[Source | Draws]) -> Array:
    """Covariance of z, or of what else is projected, by several sources together, shape (..., n_z, n_z)."""
    return squared(np.concatenate([effect(projected, source) for source in found], axis=-1)) + _of_own(projected, found)


def covariance_by_source(
    measurements: SrtMeasurements, data: PreparedRecording, wander: Array, gain: Array, projected: Draws, held: Array
) -> dict[str, Array]:
    """Covariance of the parameters, shape (27, 27), source by source; their sum is that of the solution.

    Parameters
    ----------
    measurements, data, wander
        As for :func:`disturbances`.
    gain : ndarray, shape (27, n_z)
    projected : dict of str to ndarray
        :func:`projection`.
    held : ndarray, shape (n_z, 27)
        Effect on z of the fixed values, 1-sigma.
    """
    seen, found = through(gain, projected), disturbances(measurements, data, wander)
    out = {name: covariance(seen, [source]) for name, source in found.items()}
    out["gyro_bias_instability"] += bias_of_test(data, wander)
    return out | {"held_values": squared(gain @ held)}


def bias_of_test(data: PreparedRecording, wander: Array) -> Array:
    """Covariance (..., 27, 27) of the gyro bias during this test about that of the unit, which is reported.

    A bias differs from the unit's by one random draw. A stated bias instability includes this already: its part common
    to all windows is an error of the bias alone.
    """
    out = np.zeros((*wander.shape[:-1], N_PARAMETERS, N_PARAMETERS))
    if data.noise.gyro_flicker is None:
        bias = np.arange(N_PARAMETERS)[GROUP_SLICES["gyro_bias"]]
        out[..., bias, bias] = wander**2
    return out


def squared(root: Array) -> Array:
    """Covariance (..., n, n) of unit draws with this effect (..., n, q)."""
    return np.asarray(root @ np.swapaxes(root, -1, -2))


def _of_own(projected: Draws, found: Iterable[Source | Draws]) -> Array:
    """The part of :func:`covariance`, (..., n, n), by the errors of single windows and rotations."""
    rows = projected["turn"].shape[:-2]
    own: dict[str, Array] = {}
    for source in found:
        for kind, R in source.own.items() if isinstance(source, Source) else ():
            own[kind] = R + own.get(kind, 0.0)
    out = np.zeros((*rows, rows[-1]))
    for kind, R in own.items():
        P = projected[kind]
        # For every error of the kind, its projection, (..., n_z, 3), times its covariance.
        PR = np.empty_like(P)
        np.matmul(np.swapaxes(P, -2, -3), R, out=np.swapaxes(PR, -2, -3))
        out += PR.reshape(*rows, -1) @ np.swapaxes(P.reshape(*rows, -1), -1, -2)
    return out


def slopes_of(measurements: SrtMeasurements) -> Slopes:
    """Derivatives of the compensated data of measurements by the raw channels."""
    m = measurements
    return sources.slopes(m.gyro, m.accel, m.rate, m.force, m.integrals)


def accel_drift(measurements: SrtMeasurements, size: Array, course: Array) -> Draws:
    """Accelerometer biases of 1-sigma ``size``, shape (..., 3), that follow courses (W, n)."""
    if not np.any(size):
        return {}
    slope = measurements.accel.sensitivity(measurements.force)
    return {"force": sources.by_drift(slope * size[..., None, None, :], course)}


def _gyro_instability(
    measurements: SrtMeasurements, data: PreparedRecording, by: Slopes, wander: Array
) -> Source | Draws:
    """Gyro bias instability as specified; otherwise independent biases of the sequences, of 1-sigma ``wander``."""
    floor, parts = data.noise.gyro_flicker, by.integrals.time_parts
    if floor is not None and parts is not None:
        return {
            "turn": sources.by_drift(parts * floor[..., None, None, None, :], data.drift.parts),
            "rate": sources.by_drift(by.rate * floor[..., None, None, :], data.drift.windows),
        }
    own = (by.angle * wander[..., None, :])[..., None, :, :]
    in_turns = measurements.integrals.time @ measurements.gyro.matrix[..., None, :, :] @ own
    return Source(shared={"turn": [(np.arange(data.K), in_turns)], "rate": [(measurements.window_sequence, own)]})


def _earth_rate_error(measurements: SrtMeasurements, data: PreparedRecording) -> Draws:
    """Error of ω̂e: fixture attitude errors times the Earth rate, and the unknown part of the Earth rate."""
    axes = _attitude_errors(measurements, data)
    unknown = base_axes(measurements, data) * sources.unknown_earth_rate(data.recording, placed=True)
    turned = -cross_matrix(measurements.earth_rate) @ axes
    return _of_earth_rate(measurements, np.concatenate([turned, unknown], axis=-1))


def base_axes(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Axes of the fixture's base in B_Strt, shape (..., K, 3, 3)."""
    assert data.nominal is not None
    return np.asarray(measurements.U[..., None, :, :] @ np.swapaxes(data.nominal, 1, 2))


def _latitude(measurements: SrtMeasurements, data: PreparedRecording) -> dict[str, Source | Draws]:
    """Error of the stated latitude, one draw for the recording; empty if its sigma is not stated."""
    error, fixture = sources.latitude_error(data.recording, placed=True), data.recording.fixture
    if not error.any() or fixture is None:
        return {}
    level = rotation_matrix(np.array([0.0, 0.0, -(fixture.heading_rad or 0.0)])) @ error
    return {"latitude": _of_earth_rate(measurements, (base_axes(measurements, data) @ level)[..., None])}


def _of_earth_rate(measurements: SrtMeasurements, delta: Array) -> Draws:
    """Effect of errors of ω̂e in B_Strt, shape (..., K, 3, S), rad/s."""
    # ∫ exp(−ω̂e× t) dt over the sequence, to the second order in the Earth's angle.
    T = measurements.integrals.weight_s[..., None]
    X = cross_matrix(measurements.earth_rate * T)
    turned = (np.eye(3) - X / 2.0 + X @ X / 6.0) @ delta
    to_body = np.swapaxes(measurements.window_attitude, -1, -2)
    return {"turn": T[..., None] * turned, "rate": to_body @ delta[..., measurements.window_sequence, :, :]}


def fixture_axes(measurements: SrtMeasurements, data: PreparedRecording) -> tuple[Array, Array]:
    """Axes of the fixture's errors in B_Strt, unit vectors, shapes (..., K, 3, 4) and (..., K, 3, 3).

    Base level x, y and north and the non-orthogonality of the fixture's axes have one error per recording; the initial
    inner and outer angle and the axis wobble have one per sequence.
    """
    assert data.nominal is not None
    to_body = base_axes(measurements, data)
    # The axes lean about the horizontal axis across the outer one, base y.
    leaning = to_body @ np.cross([0.0, 1.0, 0.0], data.nominal[:, :, 2])[..., None]
    inner = np.broadcast_to(measurements.U[..., None, :, 2:], leaning.shape)
    executed = np.concatenate([inner, to_body[..., 1:2], leaning], axis=-1)
    return np.concatenate([to_body, leaning], axis=-1), executed


def _attitude_errors(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Fixture attitude errors as rotation vectors in B_Strt per unit draw, shape (..., K, 3, S).

    The mounting error is estimated in U. With a measured vertical, only the rotation about the vertical remains.
    """
    common, executed = fixture_axes(measurements, data)
    common = common * sources.alignment_sigma(data.recording)
    executed = executed * sources.start_sigma(data.recording)
    own = executed[..., None, :] * np.eye(data.K)[:, None, :, None]
    axes = np.concatenate([common, own.reshape(*own.shape[:-2], -1)], axis=-1)
    if measurements.nominal_vertical:
        return np.asarray(axes)
    force = measurements.force[..., data.start, :]
    up = (force / np.linalg.norm(force, axis=-1, keepdims=True))[..., None]
    return np.asarray(up @ (np.swapaxes(up, -1, -2) @ axes))
