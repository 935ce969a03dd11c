"""Covariance of the SRT measurements, source by source (Savage 2020 [P], §9).

The sources are those of :mod:`srt.estimation.error_sources`. One projection takes errors of the attitude φ of each
sequence, and of the mean rate and mean specific force of each window, to the measurements; the effect G of the
unit-variance draws of a source gives ``R = G Gᵀ``. Correlations are therefore included: a window shared by two
rotations, the gyro bias pooled over all windows, one heading error for the whole recording.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation import error_sources as sources
from srt.estimation.error_sources import Source
from srt.model.rotations import cross_matrix, rotation_matrix

if TYPE_CHECKING:
    from srt.estimation.error_sources import Slopes
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array

    Draws = dict[str, Array]
    """Effects of S draws on errors of a kind ("turn", "rate", "force"), shape (n, 3, S) each."""


_ROUNDING: Final = 1e-12
"""Relative increase of a variance that keeps its Cholesky factor real."""


def projection(measurements: SrtMeasurements, data: PreparedRecording, bias_gain: Array) -> Draws:
    """Effect on z of φ in B_Strt, rad ("turn"), and of the windows' compensated means ("rate", "force").

    Parameters
    ----------
    measurements, data : SrtMeasurements, PreparedRecording
    bias_gain : ndarray, shape (3,)
        Share of a sequence's own rest rate that is taken as its bias (0: pooled, 1: its own).

    Returns
    -------
    dict of str to ndarray, shape (n_z, K or W, 3)
    """
    m, K, W = measurements, data.K, len(measurements.pool)
    each, unit = np.arange(K), np.eye(3 * W).reshape(W, 3, 3 * W)
    turn, rate, force = np.zeros((2 * K + W + 3, K, 3)), *np.zeros((2, 2 * K + W + 3, W, 3))
    turn[: 2 * K].reshape(K, 2, K, 3)[each, :, each] = m.attitude_effect
    seen, by_regression = m.after_g_sensitivity(unit)
    rest = np.tensordot(m.pool, seen, 1)
    # The bias offset of a sequence is subtracted from the compensated rate.
    own = np.tensordot(m.share, seen, 1) - rest
    phi = by_regression - m.integrals.time @ m.gyro.matrix @ (bias_gain[:, None] * own)
    rate[: 2 * K] = (m.attitude_effect @ phi).reshape(2 * K, W, 3)
    rate[2 * K + W :] = rest.reshape(3, W, 3)
    horizontal = force[: 2 * K].reshape(K, 2, W, 3)
    horizontal[each, :, data.end] += m.basis @ m.integrals.C_end
    horizontal[each, :, data.start] -= m.basis
    windows = np.arange(W)
    force[2 * K + windows, windows] = -m.force / np.linalg.norm(m.force, axis=1, keepdims=True)
    return {"turn": turn, "rate": rate, "force": force}


def effect(projected: Draws, source: Source | Draws) -> Array:
    """Effect G on z of the unit draws of a source, shape (n_z, S); those of its shared unknowns come last."""
    n_z = len(projected["turn"])
    if not isinstance(source, Source):
        by_kind = (
            projected[kind].reshape(n_z, -1) @ draws.reshape(-1, draws.shape[2]) for kind, draws in source.items()
        )
        return np.asarray(sum(by_kind))
    out = [np.einsum("znd,nde->zne", projected[kind], _root(R)) for kind, R in source.own.items() if np.any(R)]
    shared = np.zeros((n_z, source.unknowns, 3))
    for kind, parts in source.shared.items():
        for number, J in parts:
            member = number[:, None] == np.arange(source.unknowns)
            by_each = np.einsum("znd,nde->zen", projected[kind], np.broadcast_to(J, (len(number), 3, 3)))
            shared += (by_each @ member).swapaxes(1, 2)
    return np.concatenate([part.reshape(n_z, -1) for part in (*out, shared)], axis=1)


def _root(covariance: Array) -> Array:
    """Cholesky factors of covariances (n, 3, 3), some of which are zero."""
    size = np.einsum("naa->n", covariance)[:, None, None]
    scale = np.where(size > 0.0, size, 1.0)
    # Rounding must not make the covariance of a rotation about one axis indefinite.
    out = np.linalg.cholesky(covariance / scale + _ROUNDING * np.eye(3)) * np.sqrt(scale)
    return np.asarray(np.where(size > 0.0, out, 0.0))


def disturbances(measurements: SrtMeasurements, data: PreparedRecording, wander: Array) -> dict[str, Source | Draws]:
    """All error sources by name, in the order of the report.

    Parameters
    ----------
    measurements : SrtMeasurements
        Processed with ``with_noise=True``.
    data : PreparedRecording
    wander : ndarray, shape (3,), rad/s
        1-sigma of a sequence's gyro bias about the mean of the test (sensor axes), if no instability is stated.
    """
    by = slopes_of(measurements)
    noise = sources.white_noise(data, by, measurements.integrated) | sources.quantization(data, by)
    up = measurements.force / np.linalg.norm(measurements.force, axis=1, keepdims=True)
    return {
        "gyro_noise": noise["gyro_noise"],
        "gyro_quantization": noise["gyro_quantization"],
        "gyro_bias_instability": _gyro_instability(measurements, data, by, wander),
        "accel_noise": noise["accel_noise"],
        "accel_quantization": noise["accel_quantization"],
        "accel_bias_instability": accel_drift(measurements, data.noise.accel_flicker, data.window_drift),
        "earth_rate_alignment": _earth_rate_error(measurements, data),
        **_latitude(measurements, data),
        "gravity": {"force": (data.recording.site.gravity_sigma_m_s2 * -up)[:, :, None]},
    }


def covariances(
    projected: Draws, measurements: SrtMeasurements, data: PreparedRecording, wander: Array
) -> dict[str, Array]:
    """Covariance of z by source; the sum over the sources is the covariance of z."""
    found = {name: effect(projected, source) for name, source in disturbances(measurements, data, wander).items()}
    return {name: G @ G.T for name, G in found.items()}


def slopes_of(measurements: SrtMeasurements) -> Slopes:
    """Derivatives of the compensated data of measurements by the raw channels."""
    m = measurements
    return sources.slopes(m.gyro, m.accel, m.rate, m.force, m.integrals)


def accel_drift(measurements: SrtMeasurements, size: Array | float, course: Array) -> Draws:
    """Accelerometer biases of 1-sigma ``size`` that follow courses (W, n)."""
    return {"force": sources.by_drift(slopes_of(measurements).force * size, course)}


def _gyro_instability(
    measurements: SrtMeasurements, data: PreparedRecording, by: Slopes, wander: Array
) -> Source | Draws:
    """Gyro bias instability as specified; otherwise independent biases of the sequences, of 1-sigma ``wander``."""
    floor, parts = data.noise.gyro_flicker, by.integrals.time_parts
    if floor is not None and parts is not None:
        return {
            "turn": sources.by_drift(parts * floor, data.drift.parts),
            "rate": sources.by_drift(by.rate * floor, data.drift.windows),
        }
    own = by.angle * wander
    in_turns = measurements.integrals.time @ measurements.gyro.matrix @ own
    return Source(shared={"turn": [(np.arange(data.K), in_turns)], "rate": [(measurements.window_sequence, own[None])]})


def _earth_rate_error(measurements: SrtMeasurements, data: PreparedRecording) -> Draws:
    """Error of ω̂e: fixture attitude errors times the Earth rate, and the unknown part of the Earth rate."""
    axes = _attitude_errors(measurements, data)
    unknown = _base(measurements, data) * sources.unknown_earth_rate(data.recording, placed=True)
    parts = [np.cross(axes, measurements.earth_rate[:, :, None], axis=1), unknown]
    return _of_earth_rate(measurements, np.concatenate(parts, axis=2))


def _base(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Axes of the fixture's base in B_Strt, shape (K, 3, 3)."""
    assert data.nominal is not None
    return np.asarray(measurements.U @ np.swapaxes(data.nominal, 1, 2))


def _latitude(measurements: SrtMeasurements, data: PreparedRecording) -> dict[str, Source | Draws]:
    """Error of the stated latitude, one draw for the recording; empty if its sigma is not stated."""
    error, fixture = sources.latitude_error(data.recording, placed=True), data.recording.fixture
    if not error.any() or fixture is None:
        return {}
    level = rotation_matrix(np.array([0.0, 0.0, -(fixture.heading_rad or 0.0)])) @ error
    return {"latitude": _of_earth_rate(measurements, (_base(measurements, data) @ level)[:, :, None])}


def _of_earth_rate(measurements: SrtMeasurements, delta: Array) -> Draws:
    """Effect of errors of ω̂e in B_Strt, shape (K, 3, S), rad/s."""
    # ∫ exp(−ω̂e× t) dt over the sequence, to the second order in the Earth's angle.
    T = measurements.integrals.weight_s[:, None]
    X = cross_matrix(measurements.earth_rate * T)
    turned = (np.eye(3) - X / 2.0 + X @ X / 6.0) @ delta
    to_body = measurements.window_attitude.swapaxes(1, 2)
    return {"turn": T[:, :, None] * turned, "rate": to_body @ delta[measurements.window_sequence]}


def _attitude_errors(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Fixture attitude errors as rotation vectors in B_Strt per unit draw, shape (K, 3, S).

    Base level x, y and north and the non-orthogonality of the fixture's axes have one draw per recording; the initial
    inner and outer angle and the axis wobble have one per sequence. The mounting error is estimated in U. With a
    measured vertical, only the rotation about the vertical remains.
    """
    assert data.nominal is not None
    to_body = _base(measurements, data)
    # The axes lean about the horizontal axis across the outer one, base y.
    leaning = np.einsum("kab,kb->ka", to_body, np.cross([0.0, 1.0, 0.0], data.nominal[:, :, 2]))[:, :, None]
    common = np.concatenate([to_body, leaning], axis=2) * sources.alignment_sigma(data.recording)
    inner = np.broadcast_to(measurements.U[:, 2:], (data.K, 3, 1))
    executed = np.concatenate([inner, to_body[:, :, 1:2], leaning], axis=2) * sources.start_sigma(data.recording)
    own = np.zeros((data.K, 3, data.K, 3))
    own[np.arange(data.K), :, np.arange(data.K)] = executed
    axes = np.concatenate([common, own.reshape(data.K, 3, -1)], axis=2)
    if measurements.nominal_vertical:
        return np.asarray(axes)
    up = measurements.force[data.start] / np.linalg.norm(measurements.force[data.start], axis=1, keepdims=True)
    vertical: Array = up[:, :, None] * np.einsum("ka,kas->ks", up, axes)[:, None, :]
    return vertical
