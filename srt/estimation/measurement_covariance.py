"""Covariance of the SRT measurements, source by source (Savage 2020 [P], §9).

Each error source is a :class:`Disturbance`: the effect of unit-variance draws on the attitude error φ of each sequence,
and on the mean rate and mean specific force of each window. One projection G takes all of them to the measurements, and
``R = G Gᵀ``. Correlations are therefore included: a window shared by two rotations, the gyro bias pooled over all
windows, one heading error for the whole recording.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import chdtri

from srt.constants import EARTH_RATE_RAD_S
from srt.estimation.drift_model import NOTHING
from srt.estimation.earth_rate_regression import earth_rate_regression
from srt.estimation.g_sensitivity import MODE as G_SENSITIVE
from srt.model import measurement_model as model
from srt.model.rotations import cross_matrix

if TYPE_CHECKING:
    from srt.estimation.drift_model import Unmodelled
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.model.rotation_integrals import RotationIntegrals
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask


_SCATTER_PROBABILITY: Final = 1e-3
"""p-value of chi-square below which the biases of the sequences differ by more than their noise."""


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
    stated : ndarray, shape (K, 2, S), or None
        On the measurements that compare with a stated vertical, m/s², or a stated rate, rad/s.
    """

    phi: Array | None = None
    rate: Array | None = None
    force: Array | None = None
    stated: Array | None = None


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
    parts = (source.phi, source.rate, source.force, source.stated)
    S = next(a.shape[2] for a in parts if a is not None)
    phi = np.zeros((K, 3, S)) if source.phi is None else source.phi
    rest = np.zeros((3, S))
    if source.rate is not None:
        rate, by_regressions = measurements.after_g_sensitivity(source.rate)
        if measurements.earth_rate_regression is not None:
            rate, by_earth_rate = measurements.earth_rate_regression.after(rate, measurements.integrals.weight_s)
            by_regressions = by_regressions + by_earth_rate
        rest = np.tensordot(measurements.pool, rate, 1)
        own = np.tensordot(measurements.share, rate, 1) - rest
        # The bias offset of a sequence is subtracted from the compensated rate.
        phi = phi + by_regressions - _phi_per_rate(measurements) @ (bias_gain[:, None] * own)
    z = np.zeros((2 * K + W + 3, S))
    horizontal = measurements.attitude_effect @ phi
    if source.force is not None:
        horizontal = horizontal + measurements.stated.change_of_force(
            measurements.basis, measurements.integrals, source.force[data.start], source.force[data.end]
        )
        up = measurements.force / np.linalg.norm(measurements.force, axis=1, keepdims=True)
        z[2 * K : 2 * K + W] = -np.einsum("wa,was->ws", up, source.force)
    if source.stated is not None:
        horizontal = horizontal + source.stated
    z[: 2 * K] = horizontal.reshape(2 * K, S)
    z[2 * K + W :] = rest
    return z


def _phi_per_rate(measurements: SrtMeasurements) -> Array:
    """Effect of an error of the compensated rate on φ, ∫ F Ĉ dt, shape (K, 3, 3), s."""
    out: Array = measurements.integrals.time @ measurements.gyro.matrix
    return out


def bias_gain(measurements: SrtMeasurements, data: PreparedRecording, mode: str, wander: Array) -> Array:
    """Share of a sequence's own rest rate that is used as its bias, shape (3,).

    For biases that differ between sequences by σ and rest rates with noise s, the best linear estimate takes the share
    σ² / (σ² + s²) of a sequence's own deviation. Where a bias instability is stated, the share minimises the remaining
    drift in the rotations, because the bias keeps drifting after the window.
    """
    if mode not in ("auto", G_SENSITIVE):
        return np.full(3, 1.0 if mode == "per-sequence" else 0.0)
    if data.K < 2:
        return np.zeros(3)
    own = rest_rate_variance(measurements, data)
    if data.noise.gyro_flicker is not None:
        rest = data.drift.windows
        pooled = measurements.pool @ rest
        deviation = measurements.share @ rest - pooled
        shared = float(np.mean(np.sum((data.drift.turns - pooled) * deviation, axis=1)))
        size = np.linalg.inv(measurements.gyro.matrix) ** 2 @ data.noise.gyro_flicker**2
        variance = size * float(np.mean(np.sum(deviation**2, axis=1))) + own
        return np.clip(size * shared / np.maximum(variance, 1e-300), 0.0, 1.0)
    return np.asarray(wander**2 / np.maximum(wander**2 + own, 1e-300))


def window_rate_variance(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Noise variance of the compensated mean rate of every window, shape (W, 3), (rad/s)²."""
    D2 = np.linalg.inv(measurements.gyro.matrix) ** 2
    T = data.windows.duration_s
    raw = data.noise.gyro_white**2 / T[:, None] + 2.0 * (data.noise.gyro_edge / T[:, None]) ** 2
    return np.asarray(raw @ D2.T)


def rest_rate_variance(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Noise variance of one sequence's rest rate, averaged over sequences, shape (3,), (rad/s)²."""
    own = measurements.share[~data.is_move]
    return np.asarray(np.mean(own**2 @ window_rate_variance(measurements, data), axis=0))


def earth_rate_sigma(data: PreparedRecording) -> float:
    """1-sigma error of the Earth rate in a pose, rad/s."""
    site, fixture = data.recording.site, data.recording.fixture
    if site.latitude_rad is None:
        return EARTH_RATE_RAD_S / math.sqrt(3.0)
    if fixture is None or fixture.heading_rad is None:
        return EARTH_RATE_RAD_S * math.cos(site.latitude_rad) / math.sqrt(2.0)
    return EARTH_RATE_RAD_S * math.hypot(fixture.alignment_sigma_rad, fixture.rotation_sigma_rad)


def excess_variance(rates: Array, expected: Array, *, bounded: bool = False) -> Array:
    """Variance of biases between sequences beyond what their noise explains, shape (3,), (rad/s)².

    Parameters
    ----------
    rates : ndarray, shape (K, 3), rad/s
        Rest rate of each sequence.
    expected : ndarray, shape (3,), (rad/s)²
        Variance by noise alone. An axis has no excess if noise explains its rates (chi-square, p > 1e-3) with or
        without the sequence that deviates most.
    bounded : bool
        True: an axis without excess has what the three axes together cannot exclude, as no figure is stated.
    """
    n = len(rates) - 1

    def scatters(values: Array) -> Mask:
        m = len(values) - 1
        squares = np.sum((values - values.mean(axis=0)) ** 2, axis=0)
        return np.asarray(squares > expected * chdtri(m, _SCATTER_PROBABILITY))

    wanders, near = scatters(rates), rates
    if n > 2:
        # A varying bias shows in many sequences; a deviation of one sequence alone is a fault of that sequence.
        order = np.argsort(np.abs(rates - np.median(rates, axis=0)), axis=0)
        near = np.take_along_axis(rates, order, axis=0)[:-1]
        wanders &= scatters(near)
    own = np.where(wanders, np.var(rates, axis=0, ddof=1) - expected, 0.0)
    # The gyros of a unit are alike: if two scatter, the third does too, although its biases happen to lie closer.
    alike = own.mean() if np.count_nonzero(wanders) == 2 else 0.0
    if bounded:
        shown = np.mean(np.maximum(own, np.var(near, axis=0, ddof=1) - expected))
        alike = max(alike, shown, 0.0) + float(expected.mean()) * math.sqrt(2.0 / (3.0 * n))
    return np.asarray(np.where(wanders, own, alike))


def disturbances(
    measurements: SrtMeasurements, data: PreparedRecording, wander: Array, excess: Unmodelled = NOTHING
) -> dict[str, Disturbance]:
    """All error sources by name, in the order of the report.

    Parameters
    ----------
    measurements : SrtMeasurements
        Processed with ``with_noise=True``.
    data : PreparedRecording
    wander : ndarray, shape (3,), rad/s
        1-sigma of a sequence's gyro bias about the mean of the test (sensor axes), if no instability is stated.
    excess : Unmodelled
        Errors beyond the noise of the sensors.
    """
    noise, windows = data.noise, data.windows
    T = windows.duration_s
    D_force = measurements.accel.sensitivity(measurements.force)
    white = noise.accel_white * np.sqrt(windows.white_factor)[:, None]
    edge = noise.accel_edge * np.sqrt(windows.edge_factor)[:, None]
    up = measurements.force / np.linalg.norm(measurements.force, axis=1, keepdims=True)
    out = {
        "gyro_noise": _gyro_noise(measurements, data),
        "gyro_quantization": _gyro_quantization(measurements, data),
        "gyro_bias_instability": _bias_instability(measurements, data, wander),
        "accel_noise": Disturbance(force=_own_draw(D_force * white[:, None, :])),
        "accel_quantization": Disturbance(force=_own_draw(D_force * edge[:, None, :])),
        "accel_bias_instability": accel_drift(data, D_force),
        "earth_rate_alignment": _earth_rate_error(measurements, data),
        **_stated_values(measurements, data),
        "gravity": Disturbance(force=(data.recording.site.gravity_sigma_m_s2 * -up)[:, :, None]),
        "turn_excess": Disturbance(phi=_own_draw(np.broadcast_to(excess.rotation * np.eye(3), (data.K, 3, 3)))),
        "pose_excess": Disturbance(force=_own_draw(np.broadcast_to(excess.force * np.eye(3), (len(T), 3, 3)))),
    }
    for term in excess.drift:
        out[f"{term.sensor}_drift ({term.form})"] = drift_form(measurements, data, *term)
    return out


def covariances(
    measurements: SrtMeasurements,
    data: PreparedRecording,
    wander: Array,
    gain: Array,
    excess: Unmodelled = NOTHING,
) -> dict[str, Array]:
    """Covariance of z by source; the sum over the sources is the covariance of z."""
    out = {}
    for name, source in disturbances(measurements, data, wander, excess).items():
        G = project(measurements, data, source, gain)
        out[name] = G @ G.T
    return out


def with_earth_rate_regression(
    measurements: SrtMeasurements, data: PreparedRecording, wander: Array, bias_gain: Array, draws: Array | None
) -> SrtMeasurements:
    """Measurements with the unknown Earth rate estimated from the rates at rest and removed.

    Without a heading, the horizontal part of the Earth rate is unknown; without a latitude, all three components are.
    The effect on z is not linear: over a long recording the second order is many sigma of a navigation-grade unit. The
    unknown part is therefore estimated from the rates of the windows and removed before z is formed, as g-sensitivity
    is. The Jacobian and the covariance include this estimate.

    Parameters
    ----------
    measurements, data : SrtMeasurements, PreparedRecording
    wander : ndarray, shape (3,), rad/s
        1-sigma of the bias between sequences, compensated.
    bias_gain : ndarray, shape (3,)
        As in :func:`project`.
    draws : ndarray, shape (S,), or None
        Estimate with which the data were processed; the new estimate replaces it to first order.
    """
    n = unknown_earth_rate_components(data)
    if not n:
        return measurements
    rate = _unknown_earth_rate(measurements, data)
    seen = np.einsum("wab,was->wbs", measurements.window_attitude, rate[measurements.window_sequence])
    regression = earth_rate_regression(rate, seen, np.sqrt(window_rate_variance(measurements, data) + wander**2), n)
    phi = measurements.integrals.weight_s[:, None, None] * rate
    on_z = project(measurements, data, Disturbance(phi=phi, rate=seen), bias_gain)
    by_errors = regression.fit(model.rate_error_jacobian(measurements.rate, measurements.gyro))
    used = np.zeros(rate.shape[2]) if draws is None else draws
    present = regression.fit((measurements.rest_rate + seen @ used)[:, :, None])[:, 0]
    return replace(
        measurements,
        z=measurements.z - on_z @ (present - used),
        H=measurements.H - on_z @ by_errors,
        rest_rate=measurements.rest_rate - seen @ (present - used),
        earth_rate_regression=replace(regression, draws=present, by_errors=by_errors),
    )


def _own_draw(blocks: Array) -> Array:
    """Block-diagonal arrangement of (n, 3, m) blocks, so that each has its own m draws, shape (n, 3, n m)."""
    n, rows, m = blocks.shape
    out = np.zeros((n, rows, n, m))
    out[np.arange(n), :, np.arange(n)] = blocks
    return out.reshape(n, rows, n * m)


def _gyro_noise(measurements: SrtMeasurements, data: PreparedRecording) -> Disturbance:
    """Angular random walk: in the rotations, in the window means, and in integrated windows."""
    if measurements.integrals.noise is None:
        raise ValueError("the measurements were processed without their noise integrals")
    T, q = data.windows.duration_s, data.noise.gyro_white
    D = np.linalg.inv(measurements.gyro.matrix)
    means = _own_draw(D[None] * (q / np.sqrt(T)[:, None])[:, None, :])
    shared = np.zeros((data.K, 3, means.shape[2]))
    outer = measurements.integrals.noise.copy()
    for which in (data.start, data.end):
        for k, w in enumerate(which.tolist()):
            if measurements.integrated[w]:
                # F is 1/2 on average over the window: that part of φ is the window mean; the remainder is independent
                # noise.
                C = measurements.integrals.C_end[k] if which is data.end else np.eye(3)
                A = C @ D
                outer[k] -= 0.25 * T[w] * np.einsum("ab,cb->acb", A, A)
                shared[k] += 0.5 * T[w] * C @ means[w]
    covariance = outer @ q**2
    own = _own_draw(np.asarray(np.linalg.cholesky(covariance + 1e-30 * np.eye(3)), dtype=np.float64))
    steady = _steady_rate_noise(measurements, data)
    silent = np.zeros((data.K, 3, steady.shape[2])), np.zeros((len(T), 3, steady.shape[2]))
    return Disturbance(
        phi=np.concatenate([own, shared, silent[0]], axis=2),
        rate=np.concatenate([np.zeros((*means.shape[:2], own.shape[2])), means, silent[1]], axis=2),
        stated=np.concatenate([np.zeros((data.K, 2, own.shape[2] + means.shape[2])), steady], axis=2),
    )


def _steady_rate_noise(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """White noise and quantization of the mean rates that compare with a stated rate, shape (K, 2, 2 R)."""
    stated, noise = measurements.stated, data.noise
    T = stated.duration_s[:, :, None]
    along = np.einsum("rha,ab->rhb", stated.spin_axes(measurements.gyro), np.linalg.inv(measurements.gyro.matrix))
    variance = np.sum(along**2 * (noise.gyro_white**2 / T + 2.0 * (noise.gyro_edge / T) ** 2), axis=2)
    out = np.zeros((data.K, 2, *variance.shape))
    for r, k in enumerate(stated.rated.tolist()):
        out[k, [0, 1], r, [0, 1]] = np.sqrt(variance[r])
    return out.reshape(data.K, 2, -1)


def _stated_values(measurements: SrtMeasurements, data: PreparedRecording) -> dict[str, Disturbance]:
    """Errors of the values that the labels state: rates of a table, one draw for the recording, and verticals."""
    out = {}
    stated, fixture = measurements.stated, data.recording.fixture
    if stated.rated.size:
        rate = np.zeros((data.K, 2, 1))
        rate[stated.rated, :, 0] = (stated.sigma * stated.stated)[:, None]
        out["stated_rate"] = Disturbance(stated=rate)
    if stated.directed and fixture is not None and data.nominal is not None:
        # Levelling and mounting have one draw per recording, the executed angles one per pose.
        to_body = measurements.U @ np.swapaxes(data.nominal, 1, 2)
        mounting = np.broadcast_to(np.eye(3) * fixture.alignment_sigma_rad, (data.K, 3, 3))
        inner = np.broadcast_to(measurements.U[:, 2], (data.K, 3))
        executed = np.stack([inner, to_body[:, :, 1]], axis=2) * fixture.rotation_sigma_rad
        axes = np.concatenate([to_body * fixture.alignment_sigma_rad, mounting, _own_draw(executed)], axis=2)
        tilt = np.cross(axes, to_body[:, :, 2, None], axis=1)
        out["stated_vertical"] = Disturbance(stated=data.gravity * (measurements.basis @ tilt))
    return out


def _gyro_quantization(measurements: SrtMeasurements, data: PreparedRecording) -> Disturbance:
    """Angle quantization error at the window boundaries, where the rotations begin and end."""
    K, W, T = data.K, len(data.windows.duration_s), data.windows.duration_s
    A = np.linalg.inv(measurements.gyro.matrix) * data.noise.gyro_edge
    phi, rate = np.zeros((K, 3, W, 2, 3)), np.zeros((W, 3, W, 2, 3))
    windows, turns = np.arange(W), np.arange(K)
    rate[windows, :, windows, 0], rate[windows, :, windows, 1] = -A / T[:, None, None], A / T[:, None, None]
    phi[turns, :, data.start, 1] = -A
    phi[turns, :, data.end, 0] = measurements.integrals.C_end @ A
    return Disturbance(phi=phi.reshape(K, 3, -1), rate=rate.reshape(W, 3, -1))


def _bias_instability(measurements: SrtMeasurements, data: PreparedRecording, wander: Array) -> Disturbance:
    """Gyro bias instability as specified; otherwise independent biases of the sequences, of 1-sigma ``wander``."""
    D = np.asarray(np.linalg.inv(measurements.gyro.matrix), dtype=np.float64)
    stated = measurements.stated
    axes = stated.spin_axes(measurements.gyro)
    if data.noise.gyro_flicker is not None:
        by_axis = axes @ (D * data.noise.gyro_flicker)
        in_run = by_axis[:, :, :, None] * data.drift.turns[stated.rated][:, None, None, :]
        effect = np.zeros((data.K, 2, in_run.shape[2] * in_run.shape[3]))
        effect[stated.rated] = in_run.reshape(*in_run.shape[:2], effect.shape[2])
        return replace(gyro_drift(data, measurements.integrals, D), stated=effect)
    own = _own_draw(np.broadcast_to(D * wander, (data.K, 3, 3)))
    effect = np.zeros((data.K, 2, own.shape[2]))
    effect[stated.rated] = axes @ own[stated.rated]
    return Disturbance(phi=_phi_per_rate(measurements) @ own, rate=own[measurements.window_sequence], stated=effect)


def gyro_drift(data: PreparedRecording, integrals: RotationIntegrals, slope: Array) -> Disturbance:
    """Gyro bias instability, as specified, in rotations and windows.

    Parameters
    ----------
    data : PreparedRecording
    integrals : RotationIntegrals
        With the parts of the time integral.
    slope : ndarray, shape (3, 3) or (W, 3, 3)
        Compensated rate per unit bias of the readings.
    """
    if data.noise.gyro_flicker is None or integrals.time_parts is None:
        raise ValueError("no bias instability is stated, or the measurements have no noise integrals")
    phi = np.einsum("kpab,kpn->kabn", integrals.time_parts * data.noise.gyro_flicker, data.drift.parts)
    slope = np.broadcast_to(slope * data.noise.gyro_flicker, (len(data.drift.windows), 3, 3))
    rate = slope[:, :, :, None] * data.drift.windows[:, None, None, :]
    return Disturbance(phi=phi.reshape(*phi.shape[:2], -1), rate=rate.reshape(*rate.shape[:2], -1))


def accel_drift(data: PreparedRecording, slope: Array) -> Disturbance:
    """Accelerometer bias instability, as specified, in the windows.

    Parameters
    ----------
    data : PreparedRecording
    slope : ndarray, shape (W, 3, 3)
        Compensated specific force per unit bias of the readings.
    """
    force = (slope * data.noise.accel_flicker)[:, :, :, None] * data.window_drift[:, None, None, :]
    return Disturbance(force=force.reshape(*force.shape[:2], -1))


def drift_form(
    measurements: SrtMeasurements, data: PreparedRecording, sensor: str, form: str, sigma: float = 1.0
) -> Disturbance:
    """Drift of a triad in one form, for coefficients of 1-sigma ``sigma``: three draws for each function of it."""
    shape = data.drift_shapes[form]
    if sensor == "accel":
        slope = sigma * measurements.accel.sensitivity(measurements.force)
        return Disturbance(force=_flat(np.einsum("wab,wn->wanb", slope, shape.windows)))
    if measurements.integrals.time_parts is None:
        raise ValueError("the measurements were processed without their noise integrals")
    slope = sigma * np.asarray(np.linalg.inv(measurements.gyro.matrix), dtype=np.float64)
    phi = np.einsum("kpab,kpn->kanb", sigma * measurements.integrals.time_parts, shape.parts)
    return Disturbance(phi=_flat(phi), rate=_flat(np.einsum("ab,wn->wanb", slope, shape.windows)))


def _flat(draws: Array) -> Array:
    return draws.reshape(*draws.shape[:2], -1)


def _earth_rate_error(measurements: SrtMeasurements, data: PreparedRecording) -> Disturbance:
    """Error of ω̂e: fixture attitude errors times the Earth rate, and the unknown part of the Earth rate."""
    axes = _attitude_errors(measurements, data)
    parts = [np.cross(axes, measurements.earth_rate[:, :, None], axis=1), _unknown_earth_rate(measurements, data)]
    delta = np.concatenate(parts, axis=2)
    seen = np.einsum("wab,was->wbs", measurements.window_attitude, delta[measurements.window_sequence])
    # ∫ exp(−ω̂e× t) dt over the sequence, to the second order in the Earth's angle.
    T = measurements.integrals.weight_s[:, None]
    X = cross_matrix(measurements.earth_rate * T)
    turned = (np.eye(3) - X / 2.0 + X @ X / 6.0) @ delta
    return Disturbance(phi=T[:, :, None] * turned, rate=seen)


def _attitude_errors(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Fixture attitude errors as rotation vectors in B_Strt per unit draw, shape (K, 3, S).

    Base level x, y and north and the non-orthogonality of the fixture's axes have one draw per recording, the initial
    inner and outer angle one per sequence. The mounting error is estimated in U. With a measured vertical, only the
    rotation about the vertical remains.
    """
    fixture = data.recording.fixture
    if fixture is None or data.nominal is None:
        return np.zeros((data.K, 3, 0))
    to_body = measurements.U @ np.swapaxes(data.nominal, 1, 2)
    # The axes lean about the horizontal axis across the outer one, base y.
    leaning = np.cross([0.0, 1.0, 0.0], data.nominal[:, :, 2])
    common = np.concatenate([to_body, np.einsum("kab,kb->ka", to_body, leaning)[:, :, None]], axis=2)
    base = common * fixture.alignment_sigma_rad
    inner = np.broadcast_to(measurements.U[:, 2], (data.K, 3))
    executed = np.stack([inner, to_body[:, :, 1]], axis=2) * fixture.rotation_sigma_rad
    axes = np.concatenate([base, _own_draw(executed)], axis=2) * data.placed[:, None, None]
    if measurements.nominal_vertical:
        return np.asarray(axes)
    down = -measurements.force[data.start] / np.linalg.norm(measurements.force[data.start], axis=1, keepdims=True)
    vertical: Array = down[:, :, None] * np.einsum("ka,kas->ks", down, axes)[:, None, :]
    return vertical


def unknown_earth_rate_components(data: PreparedRecording) -> int:
    """Number of unknown components of the Earth rate: three without a latitude, two without a heading, else none."""
    site, fixture = data.recording.site, data.recording.fixture
    if site.latitude_rad is None:
        return 3
    return 2 if not data.placed.all() or fixture is None or fixture.heading_rad is None else 0


def _unknown_earth_rate(measurements: SrtMeasurements, data: PreparedRecording) -> Array:
    """Unknown part of the Earth rate (no latitude or no heading), per unit draw in B_Strt, shape (K, 3, S), rad/s."""
    site = data.recording.site
    directions = unknown_earth_rate_components(data)
    if not directions:
        return np.zeros((data.K, 3, 0))
    share = 1.0 if site.latitude_rad is None else math.cos(site.latitude_rad)
    size = EARTH_RATE_RAD_S * share / math.sqrt(directions)
    fixture = data.recording.fixture
    of_fixture = np.zeros((data.K, 3, 0))
    if data.nominal is not None and (site.latitude_rad is None or fixture is None or fixture.heading_rad is None):
        frames = measurements.U @ np.swapaxes(data.nominal, 1, 2)
        of_fixture = frames[:, :, :directions] * data.placed[:, None, None]
    free = _unknown_in_chains(measurements, data, directions)
    return np.asarray(size * np.concatenate([of_fixture, free], axis=2))


def _unknown_in_chains(measurements: SrtMeasurements, data: PreparedRecording, directions: int) -> Array:
    """Directions of the unknown Earth rate of free turns, in B_Strt, shape (K, 3, chains · directions).

    The Earth-fixed frame is propagated if a rotation starts from the end window of another.
    """
    turns = np.flatnonzero(~data.placed).tolist()
    down = -measurements.force[data.start] / np.linalg.norm(measurements.force[data.start], axis=1, keepdims=True)
    chains = 0
    carried: dict[int, tuple[int, Array]] = {}
    found: list[tuple[int, Array]] = []
    for k in turns:
        if int(data.start[k]) in carried:
            chain, frame = carried[int(data.start[k])]
        else:
            # From the raw readings, so that the draws mean the same in all iterations.
            least_vertical = int(np.argmin(np.abs(data.windows.accel_mean[data.start[k]])))
            first = np.cross(down[k], np.eye(3)[least_vertical])
            first /= np.linalg.norm(first)
            chain, frame = chains, np.stack([first, np.cross(down[k], first), down[k]], axis=1)
            chains += 1
        found.append((chain, frame))
        carried[int(data.end[k])] = chain, measurements.integrals.C_end[k].T @ frame
    out = np.zeros((data.K, 3, chains, directions))
    for k, (chain, frame) in zip(turns, found, strict=True):
        out[k, :, chain] = frame[:, :directions]
    return out.reshape(data.K, 3, chains * directions)
