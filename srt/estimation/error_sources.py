"""Sources of error of a recording, one by one, as linear rows that all estimators read (Savage 2020 [P], §9).

A source acts on the compensated mean specific force ("force") and mean rate ("rate") of every window, and on the
attitude error φ of every rotation ("turn"), in two ways: errors of single windows and rotations, which are independent,
with their covariance; and errors that several of them share, as unit-variance unknowns with their derivatives. The
joint model whitens with the first and estimates the second; the closed form projects both onto the SRT measurements
(:mod:`srt.closed_form.measurement_covariance`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from srt.constants import EARTH_RATE_RAD_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.model.rotation_integrals import RotationIntegrals
    from srt.model.sensor_model import Triad
    from srt.noise.noise_model import NoiseModel
    from srt.recording.recording import Recording
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Indices, Mask


KINDS: Final = ("force", "rate", "turn")
"""Measurements that a source acts on."""


class Slopes(NamedTuple):
    """Derivatives of the compensated data with respect to errors of the raw channels.

    Those of several units have a leading axis of units.

    Attributes
    ----------
    force, rate : ndarray, shape (W, 3, 3)
        Of the mean specific force and mean rate of every window.
    angle : ndarray, shape (3, 3)
        Of the angle of a rotation, in the axes of its sample.
    integrals : RotationIntegrals
        Of the rotations, with their noise integrals.
    """

    force: Array
    rate: Array
    angle: Array
    integrals: RotationIntegrals


def slopes(gyro: Triad, accel: Triad, rate: Array, force: Array, integrals: RotationIntegrals) -> Slopes:
    """Derivatives at compensated mean rates and specific forces of the windows, shape (W, 3)."""
    angle = gyro.inverse
    return Slopes(accel.sensitivity(force), gyro.sensitivity(rate), angle, integrals)


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Errors of one source.

    Attributes
    ----------
    own : dict of str to ndarray, shape (n, 3, 3)
        Covariance of the errors of single windows ("force", "rate") and rotations ("turn"), which are independent.
    shared : dict of str to list of (ndarray of int, shape (n,); ndarray, shape (n or 1, 3, 3))
        Number of a shared unknown (−1: none) of three unit-variance components, and the derivatives by it.
    """

    own: dict[str, Array] = field(default_factory=dict)
    shared: dict[str, list[tuple[Indices, Array]]] = field(default_factory=dict)

    @property
    def unknowns(self) -> int:
        """Number of the shared unknowns."""
        return 1 + max((int(number.max(initial=-1)) for part in self.shared.values() for number, _ in part), default=-1)


def own_covariances(sources: Mapping[str, Source], kind: str) -> dict[str, Array]:
    """Covariance of the independent errors of a kind by source."""
    return {name: source.own[kind] for name, source in sources.items() if kind in source.own}


def white_noise(data: PreparedRecording, by: Slopes, integrated: Mask | None = None) -> dict[str, Source]:
    """Angle random walk of rotations and window means; velocity random walk of window means.

    Parameters
    ----------
    data : PreparedRecording
    by : Slopes
    integrated : ndarray of bool, shape (W,), optional
        Windows over which the attitude is integrated, so that their mean rate and φ share noise; without it, the two
        count as independent.
    """
    noise, windows, integrals = data.noise, data.windows, by.integrals
    if integrals.noise is None:
        raise ValueError("the measurements were processed without their noise integrals")
    T, q = windows.duration_s, noise.gyro_white
    squared = q[..., None, :] ** 2 + windows.gyro_excess
    rate = _through(by.rate, squared / T[:, None])
    turn = np.einsum("...kacb,...b->...kac", integrals.noise, q**2)
    shared: dict[str, list[tuple[Indices, Array]]] = {}
    if integrated is not None and integrated.any():
        number = np.where(integrated, np.cumsum(integrated) - 1, -1)
        mean = by.rate * np.sqrt(squared / T[:, None])[..., None, :]
        rate = np.where(integrated[:, None, None], 0.0, rate)
        shared = {"rate": [(number, mean)], "turn": []}
        for which, C in ((data.start, np.broadcast_to(np.eye(3), turn.shape)), (data.end, integrals.C_end)):
            # F is 1/2 on average over the window: that part of φ is the window mean; the remainder is independent.
            part = 0.5 * T[which, None, None] * C @ mean[..., which, :, :]
            shared["turn"].append((number[which], part))
            turn = turn - np.where(integrated[which, None, None], part @ np.swapaxes(part, -1, -2), 0.0)
        turn = turn + excess_of_turns(data, by, integrated)
    squared = noise.accel_white[..., None, :] ** 2 + windows.accel_excess
    force = _through(by.force, squared * windows.white_factor[:, None])
    return {"gyro_noise": Source({"rate": rate, "turn": turn}, shared), "accel_noise": Source({"force": force})}


def excess_of_turns(data: PreparedRecording, by: Slopes, integrated: Mask) -> Array:
    """Covariance of φ by windows that are noisier than the others and integrated, shape (..., K, 3, 3), rad²."""
    windows, total = data.windows, np.zeros(())
    # φ grows over a window at its start, and falls off over one at its end: the mean of the squares is a third.
    squared = windows.gyro_excess * np.where(integrated, windows.duration_s / 3.0, 0.0)[:, None]
    for which, C in ((data.start, np.eye(3)), (data.end, by.integrals.C_end)):
        total = total + _through(C @ by.rate[..., which, :, :], squared[..., which, :])
    return np.asarray(total)


def quantization(data: PreparedRecording, by: Slopes, *, shared: bool = True) -> dict[str, Source]:
    """Quantization of angle and velocity at the edges of the windows, where the rotations begin and end.

    Window and rotation share the error of their edge, with opposite signs. If ``shared`` is false, they count as
    independent, which is a good approximation for small quantization.
    """
    noise, T = data.noise, data.windows.duration_s[:, None, None]
    A = (by.angle * noise.gyro_edge[..., None, :])[..., None, :, :]
    per_rate, end = by.rate * noise.gyro_edge[..., None, None, :] / T, by.integrals.C_end @ A
    outer = per_rate @ np.swapaxes(per_rate, -1, -2)
    by_readings = noise.accel_edge[..., None, :] ** 2 * data.windows.edge_factor[:, None]
    # The mean of readings that are not dithered is off by the same in the whole window.
    by_readings = by_readings + noise.accel_step[..., None, :] ** 2
    by_steps = _through(by.rate, np.broadcast_to(noise.gyro_step[..., None, :] ** 2, by.rate.shape[:-1]))
    force = Source({"force": _through(by.force, by_readings)})
    if not shared:
        turn = A @ np.swapaxes(A, -1, -2) + end @ np.swapaxes(end, -1, -2)
        return {
            "gyro_quantization": Source({"rate": 2.0 * outer + by_steps, "turn": turn}),
            "accel_quantization": force,
        }
    edges = shared_edges(data)
    alone = np.sum(edges < 0, axis=1)[:, None, None]
    return {
        "gyro_quantization": Source(
            {"rate": alone * outer + by_steps, "turn": np.zeros_like(end)},
            {
                "rate": [(edges[:, 0], -per_rate), (edges[:, 1], per_rate)],
                "turn": [(edges[data.start, 1], -A), (edges[data.end, 0], end)],
            },
        ),
        "accel_quantization": force,
    }


def shared_edges(data: PreparedRecording) -> Indices:
    """Number of the error at the first and last edge of every window, shape (W, 2); −1 if no rotation shares it."""
    used = np.zeros((len(data.windows.duration_s), 2), dtype=np.bool_)
    used[data.end, 0] = used[data.start, 1] = True
    return np.where(used, np.cumsum(used.ravel()).reshape(used.shape) - 1, -1)


def raw_rate_variance(noise: NoiseModel, duration_s: Array) -> Array:
    """Noise variance of mean gyro readings over windows, white noise and quantization, (..., 3), (rad/s)².

    Parameters
    ----------
    noise : NoiseModel
    duration_s : ndarray, shape (...)
    """
    T = duration_s[..., None]
    figures = (noise.gyro_white, noise.gyro_edge, noise.gyro_step)
    white, edge, step = (x if x.ndim == 1 else x[:, None] for x in figures)
    return np.asarray(white**2 / T + 2.0 * (edge / T) ** 2 + step**2)


class UnmodelledErrors(NamedTuple):
    """Standard deviations of errors that the residuals show beyond the noise.

    Attributes
    ----------
    rotation : float, rad
    force : float, m/s²
        Mean specific force of a window.
    rate : float, rad/s
        Mean rate of a window.
    wobble : float, rad
        Wobble of the fixture's axes beyond the stated one, per pose.
    angle : float, rad
        Inner and outer start angle beyond the stated accuracy, per pose.
    alignment : float, rad
        Levelling, north, mounting and non-orthogonality of the axes beyond the stated accuracy.
    """

    rotation: float = 0.0
    force: float = 0.0
    rate: float = 0.0
    wobble: float = 0.0
    angle: float = 0.0
    alignment: float = 0.0

    @property
    def of_fixture(self) -> UnmodelledErrors:
        """Errors of a fixture that is less accurate than stated, the others zero.

        Wobble alone, of some µrad, can be another small error of the unit; it then counts as that.
        """
        worse = self.angle > 0.0 or self.alignment > 0.0
        return self._replace(rotation=0.0, force=0.0, rate=0.0) if worse else NO_ERRORS

    @property
    def of_sensors(self) -> tuple[float, float, float]:
        """Errors of rotations, specific forces and rates."""
        return self[:3]

    @property
    def of_unit(self) -> UnmodelledErrors:
        """All other errors, those of the fixture zero."""
        return self._replace(wobble=0.0, angle=0.0, alignment=0.0) if any(self.of_fixture) else self


NO_ERRORS: Final = UnmodelledErrors()
"""Residuals that agree with the noise."""
LARGEST_FIXTURE_RAD: Final = 0.02
"""Largest error of a fixture, 1-sigma, about 1°: turns by hand are as accurate, and a larger one is a wrong label."""
EXCESSES: Final = ("turn_excess", "pose_excess", "rest_excess", "wobble_excess", "angle_excess", "alignment_excess")
"""Sources of the unmodelled errors, in the order of :class:`UnmodelledErrors`."""


UNDERSAMPLING: Final = "gyro_undersampling"
"""Source of the error by motion that is too fast for the sample rate."""


def unmodelled(data: PreparedRecording, errors: UnmodelledErrors) -> dict[str, Source]:
    """Unmodelled errors of rotations, specific forces and rates."""
    W, unit = len(data.windows.duration_s), np.eye(3)
    return {
        "turn_excess": Source({"turn": np.broadcast_to(errors.rotation**2 * unit, (data.K, 3, 3))}),
        "pose_excess": Source({"force": np.broadcast_to(errors.force**2 * unit, (W, 3, 3))}),
        "rest_excess": Source({"rate": np.broadcast_to(errors.rate**2 * unit, (W, 3, 3))}),
    }


def undersampled_motion(data: PreparedRecording) -> dict[str, Source]:
    """Error of the rotations by motion that is too fast for the sample rate; none unless residuals show it.

    It is independent from rotation to rotation, see docs/theory/uncertainty.md.
    """
    if data.undersampling is None:
        return {}
    variance = (data.undersampling * data.fast_motion) ** 2
    return {UNDERSAMPLING: Source({"turn": variance[:, None, None] * np.eye(3)})}


def turns_estimated(data: PreparedRecording) -> float:
    """Number of rotations from whose residuals the size of their error was estimated; infinite if it was not."""
    return math.inf if data.undersampling is None else float(data.K)


def walk_between_windows(data: PreparedRecording, by: Slopes, sigma: float) -> Source:
    """Random walk of the gyro biases in rotations, about what the windows before and after them show.

    Parameters
    ----------
    data : PreparedRecording
    by : Slopes
    sigma : float, rad/s
        Standard deviation of the walk at the end of the recording.
    """
    if by.integrals.time_parts is None:
        raise ValueError("the measurements were processed without their noise integrals")
    effect = sigma * by_drift(by.integrals.time_parts, data.walk_between_windows)
    return Source({"turn": effect @ np.swapaxes(effect, 1, 2)})


def by_drift(slope: Array, course: Array) -> Array:
    """Effect of a bias that follows each of S courses in each of the three channels, shape (..., n, d, 3 S).

    Parameters
    ----------
    slope : ndarray, shape (..., W, d, 3) or (..., K, P, d, 3)
        Derivatives by the biases in every window, or in the parts of every rotation.
    course : ndarray, shape (W, S) or (K, P, S)
        Bias in the same windows or parts.
    """
    d, S = slope.shape[-2], course.shape[-1]
    if course.ndim == 2:
        by_window = slope[..., None, :] * course[:, None, :, None]
        return np.asarray(by_window.reshape(*slope.shape[:-1], 3 * S))
    over_parts = slope.reshape(*slope.shape[:-2], 3 * d).swapaxes(-1, -2) @ course
    shape = over_parts.shape[:-2]
    return np.asarray(over_parts.reshape(*shape, d, 3, S).swapaxes(-1, -2).reshape(*shape, d, 3 * S))


def accel_drift(data: PreparedRecording, by_force: Array, floor: Array) -> Array:
    """Effect on the mean specific forces of a bias instability of the accelerometers, (W, 3, S).

    It is for instability beyond that of the weights, which all estimators add to their covariance: with weights that
    included it, it would cost accuracy where it does not exist.

    Parameters
    ----------
    data : PreparedRecording
    by_force : ndarray, shape (W, 3, 3)
        Derivative of the mean specific forces by the raw ones.
    floor : ndarray, shape (3,), m/s²
        Allan floors of the channels.
    """
    return by_drift(by_force * floor[..., None, None, :], data.window_drift)


def start_sigma(recording: Recording) -> Array:
    """Standard deviation of inner angle, outer angle and axis wobble of a pose, shape (3,), rad; zero without fixture.

    The non-orthogonality of the axes is common to all poses, as levelling and north are; see ``alignment_sigma``.
    """
    fixture = recording.fixture
    if fixture is None:
        return np.zeros(3)
    return np.array([fixture.rotation_sigma_rad, fixture.rotation_sigma_rad, fixture.wobble])


def as_found(data: PreparedRecording, errors: UnmodelledErrors) -> PreparedRecording:
    """Recording whose fixture has the accuracy that the residuals show, in place of the stated one."""
    fixture = data.recording.fixture
    if fixture is None or not any(errors.of_fixture):
        return data
    true = replace(
        fixture,
        alignment_sigma_rad=math.hypot(fixture.alignment_sigma_rad, errors.alignment),
        rotation_sigma_rad=math.hypot(fixture.rotation_sigma_rad, errors.angle),
        wobble_sigma_rad=math.hypot(fixture.wobble, errors.wobble),
    )
    return replace(data, recording=replace(data.recording, fixture=true))


def alignment_sigma(recording: Recording) -> float:
    """Standard deviation of levelling, north, mounting and non-orthogonality of the axes, rad."""
    return 0.0 if recording.fixture is None else recording.fixture.alignment_sigma_rad


def unknown_earth_rate(recording: Recording, *, placed: bool) -> Array:
    """Standard deviation of the unknown part of the Earth rate, north, east, down, shape (3,), rad/s.

    All components are unknown without a latitude, the horizontal ones without a heading. A free turn, not ``placed`` on
    the fixture, has no heading.
    """
    latitude, fixture = recording.site.latitude_rad, recording.fixture
    if latitude is None:
        return np.full(3, EARTH_RATE_RAD_S / math.sqrt(3.0))
    if placed and fixture is not None and fixture.heading_rad is not None:
        return np.zeros(3)
    return np.array([1.0, 1.0, 0.0]) * EARTH_RATE_RAD_S * math.cos(latitude) / math.sqrt(2.0)


def latitude_error(recording: Recording, *, placed: bool) -> Array:
    """Error of the known Earth rate by one sigma of the latitude, north, east, down, shape (3,), rad/s.

    The horizontal part of a free turn, not ``placed`` on the fixture, is unknown at any latitude.
    """
    latitude, sigma = recording.site.latitude_rad, recording.site.latitude_sigma_rad
    if latitude is None or sigma is None:
        return np.zeros(3)
    error = -sigma * EARTH_RATE_RAD_S * np.array([math.sin(latitude), 0.0, math.cos(latitude)])
    return np.where(unknown_earth_rate(recording, placed=placed) > 0.0, 0.0, error)


def earth_rate_sigma(recording: Recording, excess: UnmodelledErrors = NO_ERRORS) -> float:
    """1-sigma error of the Earth rate in a pose, rad/s, with what the fixture has beyond its stated accuracy."""
    unknown = float(unknown_earth_rate(recording, placed=True).max())
    rotation, _, _ = start_sigma(recording)
    known = math.hypot(alignment_sigma(recording), rotation, excess.alignment, excess.angle)
    return unknown or EARTH_RATE_RAD_S * known


def _through(D: Array, variance: Array) -> Array:
    """Covariance of compensated values from the variances of raw channels, (..., n, 3, 3)."""
    return np.asarray((D * variance[..., None, :]) @ np.swapaxes(D, -1, -2))
