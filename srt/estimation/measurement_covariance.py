"""Covariance of the SRT measurements, source by source (Savage 2020 [P], §9).

The sources are those of :mod:`srt.estimation.error_sources`. Each becomes a :class:`Disturbance`: the effect of
unit-variance draws on the attitude error φ of each sequence, and on the mean rate and mean specific force of each
window. One projection G takes all of them to the measurements, and ``R = G Gᵀ``. Correlations are therefore included: a
window shared by two rotations, the gyro bias pooled over all windows, one heading error for the whole recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.estimation import error_sources as sources
from srt.estimation.error_sources import NO_ERRORS
from srt.model.rotations import cross_matrix, rotation_matrix

if TYPE_CHECKING:
    from srt.estimation.error_sources import Slopes, Source, UnmodelledErrors
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


_ROUNDING: Final = 1e-12
"""Relative increase of a variance that keeps its Cholesky factor real."""


@dataclass(frozen=True, slots=True, eq=False)
class Disturbance:
    """Effect of S unit-variance draws of one source.

    Attributes
    ----------
    phi : ndarray, shape (K, 3, S), or None
        On φ in B_Strt, rad.
    rate : ndarray, shape (W, 3, S), or None
        On the compensated mean rate of each window, rad/s.
    force : ndarray, shape (W, 3, S), or None
        On the compensated mean specific force of each window, m/s².
    """

    phi: Array | None = None
    rate: Array | None = None
    force: Array | None = None


def project(measurements: SrtMeasurements, data: PreparedRecording, source: Disturbance, bias_gain: Array) -> Array:
    """Effect G of a source on the measurement vector z, shape (n_z, S).

    Parameters
    ----------
    measurements, data : SrtMeasurements, PreparedRecording
    source : Disturbance
    bias_gain : ndarray, shape (3,)
        Share of a sequence's own rest rate that is taken as its bias (0: pooled, 1: its own).
    """
    K, W = data.K, len(measurements.pool)
    parts = (source.phi, source.rate, source.force)
    S = next(a.shape[2] for a in parts if a is not None)
    phi = np.zeros((K, 3, S)) if source.phi is None else source.phi
    rest = np.zeros((3, S))
    if source.rate is not None:
        rate, by_regression = measurements.after_g_sensitivity(source.rate)
        rest = np.tensordot(measurements.pool, rate, 1)
        own = np.tensordot(measurements.share, rate, 1) - rest
        # The bias offset of a sequence is subtracted from the compensated rate.
        phi = phi + by_regression - _phi_per_rate(measurements) @ (bias_gain[:, None] * own)
    z = np.zeros((2 * K + W + 3, S))
    horizontal = measurements.attitude_effect @ phi
    if source.force is not None:
        change = measurements.integrals.C_end @ source.force[data.end] - source.force[data.start]
        horizontal = horizontal + measurements.basis @ change
        up = measurements.force / np.linalg.norm(measurements.force, axis=1, keepdims=True)
        z[2 * K : 2 * K + W] = -np.einsum("wa,was->ws", up, source.force)
    z[: 2 * K] = horizontal.reshape(2 * K, S)
    z[2 * K + W :] = rest
    return z


def _phi_per_rate(measurements: SrtMeasurements) -> Array:
    """Effect of an error of the compensated rate on φ, ∫ F Ĉ dt, shape (K, 3, 3), s."""
    out: Array = measurements.integrals.time @ measurements.gyro.matrix
    return out


def disturbances(
    measurements: SrtMeasurements, data: PreparedRecording, wander: Array, excess: UnmodelledErrors = NO_ERRORS
) -> dict[str, Disturbance]:
    """All error sources by name, in the order of the report.

    Parameters
    ----------
    measurements : SrtMeasurements
        Processed with ``with_noise=True``.
    data : PreparedRecording
    wander : ndarray, shape (3,), rad/s
        1-sigma of a sequence's gyro bias about the mean of the test (sensor axes), if no instability is stated.
    excess : UnmodelledErrors
        Errors beyond the noise of the sensors.
    """
    by = slopes_of(measurements)
    sensors = sources.white_noise(data, by, measurements.integrated) | sources.quantization(data, by)
    noise = {name: draws(source, data) for name, source in sensors.items()}
    up = measurements.force / np.linalg.norm(measurements.force, axis=1, keepdims=True)
    out = {
        "gyro_noise": noise["gyro_noise"],
        "gyro_quantization": noise["gyro_quantization"],
        "gyro_bias_instability": _bias_instability(measurements, data, by, wander),
        "accel_noise": noise["accel_noise"],
        "accel_quantization": noise["accel_quantization"],
        "accel_bias_instability": bias_drift(data, by, "accel"),
        "earth_rate_alignment": _earth_rate_error(measurements, data),
        **_latitude(measurements, data),
        "gravity": Disturbance(force=(data.recording.site.gravity_sigma_m_s2 * -up)[:, :, None]),
    }
    unmodelled = sources.unmodelled(data, excess)
    out |= {name: draws(unmodelled[name], data) for name in ("turn_excess", "pose_excess")}
    return out


def slopes_of(measurements: SrtMeasurements) -> Slopes:
    """Derivatives of the compensated data of measurements by the raw channels."""
    m = measurements
    return sources.slopes(m.gyro, m.accel, m.rate, m.force, m.integrals)


def draws(source: Source, data: PreparedRecording) -> Disturbance:
    """Unit draws of a source: one per component of every independent error and of every shared unknown."""
    count = {"force": len(data.windows.duration_s), "rate": len(data.windows.duration_s), "turn": data.K}
    own = {kind: _own_draw(_root(R)) for kind, R in source.own.items() if np.any(R)}
    first = np.cumsum([0, *(effect.shape[2] for effect in own.values())]).tolist()
    out = {kind: np.zeros((n, 3, first[-1] + 3 * source.unknowns)) for kind, n in count.items()}
    for (kind, effect), at in zip(own.items(), first, strict=False):
        out[kind][:, :, at : at + effect.shape[2]] = effect
    for kind, parts in source.shared.items():
        # A view, in which the shared unknowns have an axis of their own.
        shared = out[kind][:, :, first[-1] :].reshape(count[kind], 3, -1, 3)
        for number, J in parts:
            members = np.flatnonzero(number >= 0)
            shared[members, :, number[members]] += np.broadcast_to(J, (count[kind], 3, 3))[members]
        out[kind][:, :, first[-1] :] = shared.reshape(count[kind], 3, -1)
    acts = {kind: out[kind] for kind in (*source.own, *source.shared)}
    return Disturbance(phi=acts.get("turn"), rate=acts.get("rate"), force=acts.get("force"))


def _root(covariance: Array) -> Array:
    """Cholesky factors of covariances (n, 3, 3), some of which are zero."""
    size = np.einsum("naa->n", covariance)[:, None, None]
    scale = np.where(size > 0.0, size, 1.0)
    # Rounding must not make the covariance of a rotation about one axis indefinite.
    out = np.linalg.cholesky(covariance / scale + _ROUNDING * np.eye(3)) * np.sqrt(scale)
    return np.asarray(np.where(size > 0.0, out, 0.0))


def bias_drift(data: PreparedRecording, by: Slopes, sensor: str) -> Disturbance:
    """Bias instability of a sensor, as specified: of the gyros in windows and rotations, of the others in windows."""
    if sensor == "accel":
        return _following(by, sensor, data.noise.accel_flicker, (data.window_drift, None))
    if data.noise.gyro_flicker is None:
        raise ValueError("no bias instability is stated")
    return _following(by, sensor, data.noise.gyro_flicker, (data.drift.windows, data.drift.parts))


def accel_drift(measurements: SrtMeasurements, data: PreparedRecording, floor: Array) -> Array:
    """Effect on z of a bias instability of the accelerometers with Allan floors of shape (3,), shape (n_z, S)."""
    force = sources.accel_drift(data, slopes_of(measurements).force, floor)
    return project(measurements, data, Disturbance(force=force), np.zeros(3))


def force_errors(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Effect on z of independent errors of the compensated force of each window, shape (n_z, 3 W)."""
    W = len(data.windows.duration_s)
    return project(measurements, data, Disturbance(force=np.eye(3 * W).reshape(W, 3, 3 * W)), np.zeros(3))


def drift_form(
    measurements: SrtMeasurements,
    data: PreparedRecording,
    sensor: str,
    form: str,
    *,
    tested: bool = False,
) -> Disturbance:
    """Drift of a triad in one form, for unit coefficients: three draws for each function of it.

    With ``tested``, only the functions that the test of the form uses.
    """
    shape = data.drift_shapes[form].tested if tested else data.drift_shapes[form]
    return _following(slopes_of(measurements), sensor, 1.0, (shape.windows, shape.parts))


def _following(by: Slopes, sensor: str, size: Array | float, course: tuple[Array, Array | None]) -> Disturbance:
    """Effect of biases of 1-sigma ``size`` that follow given courses in the windows, and in the parts of rotations."""
    windows, parts = course
    if sensor == "accel":
        return Disturbance(force=sources.by_drift(by.force * size, windows))
    if by.integrals.time_parts is None or parts is None:
        raise ValueError("the measurements were processed without their noise integrals")
    return Disturbance(
        phi=sources.by_drift(by.integrals.time_parts * size, parts), rate=sources.by_drift(by.rate * size, windows)
    )


def covariances(
    measurements: SrtMeasurements,
    data: PreparedRecording,
    wander: Array,
    gain: Array,
    excess: UnmodelledErrors = NO_ERRORS,
) -> dict[str, Array]:
    """Covariance of z by source; the sum over the sources is the covariance of z."""
    out = {}
    for name, source in disturbances(measurements, data, wander, excess).items():
        G = project(measurements, data, source, gain)
        out[name] = G @ G.T
    return out


def _own_draw(blocks: Array) -> Array:
    """Block-diagonal arrangement of (n, d, m) blocks, so that each has its own m draws, shape (n, d, n m)."""
    n, rows, m = blocks.shape
    out = np.zeros((n, rows, n, m))
    out[np.arange(n), :, np.arange(n)] = blocks
    return out.reshape(n, rows, n * m)


def _bias_instability(measurements: SrtMeasurements, data: PreparedRecording, by: Slopes, wander: Array) -> Disturbance:
    """Gyro bias instability as specified; otherwise independent biases of the sequences, of 1-sigma ``wander``."""
    if data.noise.gyro_flicker is not None:
        return bias_drift(data, by, "gyro")
    own = _own_draw(np.broadcast_to(by.angle * wander, (data.K, 3, 3)))
    return Disturbance(phi=_phi_per_rate(measurements) @ own, rate=own[measurements.window_sequence])


def _earth_rate_error(measurements: SrtMeasurements, data: PreparedRecording) -> Disturbance:
    """Error of ω̂e: fixture attitude errors times the Earth rate, and the unknown part of the Earth rate."""
    axes = _attitude_errors(measurements, data)
    unknown = _base(measurements, data) * sources.unknown_earth_rate(data.recording, placed=True)
    parts = [np.cross(axes, measurements.earth_rate[:, :, None], axis=1), unknown]
    return _of_earth_rate(measurements, np.concatenate(parts, axis=2))


def _base(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Axes of the fixture's base in B_Strt, shape (K, 3, 3)."""
    assert data.nominal is not None
    return np.asarray(measurements.U @ np.swapaxes(data.nominal, 1, 2))


def _latitude(measurements: SrtMeasurements, data: PreparedRecording) -> dict[str, Disturbance]:
    """Error of the stated latitude, one draw for the recording; empty if its sigma is not stated."""
    error, fixture = sources.latitude_error(data.recording, placed=True), data.recording.fixture
    if not error.any() or fixture is None:
        return {}
    level = rotation_matrix(np.array([0.0, 0.0, -(fixture.heading_rad or 0.0)])) @ error
    return {"latitude": _of_earth_rate(measurements, (_base(measurements, data) @ level)[:, :, None])}


def _of_earth_rate(measurements: SrtMeasurements, delta: Array) -> Disturbance:
    """Effect of errors of ω̂e in B_Strt, shape (K, 3, S), rad/s."""
    seen = np.einsum("wab,was->wbs", measurements.window_attitude, delta[measurements.window_sequence])
    # ∫ exp(−ω̂e× t) dt over the sequence, to the second order in the Earth's angle.
    T = measurements.integrals.weight_s[:, None]
    X = cross_matrix(measurements.earth_rate * T)
    turned = (np.eye(3) - X / 2.0 + X @ X / 6.0) @ delta
    return Disturbance(phi=T[:, :, None] * turned, rate=seen)


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
    axes = np.concatenate([common, _own_draw(executed)], axis=2)
    if measurements.nominal_vertical:
        return np.asarray(axes)
    up = measurements.force[data.start] / np.linalg.norm(measurements.force[data.start], axis=1, keepdims=True)
    vertical: Array = up[:, :, None] * np.einsum("ka,kas->ks", up, axes)[:, None, :]
    return vertical
