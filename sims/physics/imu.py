"""Simulated readings of an IMU with sensor errors, from a true motion.

Per sample of length dt, with the true integrals of :class:`sims.physics.true_motion.TrueMotion` (all in B)::

    gyro  = Mg ∫ω dt + κasym ∘ ∫|ω| dt + κbias dt + G ∫f dt + drift dt + N √dt · white
    accel = Ma ∫f dt + λasym ∘ ∫|f| dt + λbias dt           + drift dt + N √dt · white

then, in the order of a real signal chain: saturation of the mean over the sample, pulse quantization of the
running integral (the remainder is carried to the next sample), and rounding of the output word. Integrals are
exact: without noise and rounding, each 50 Hz increment is the sum of 20 increments at 1000 Hz. Mg and Ma are
built here from the 27 sensor errors, independently of :mod:`srt.model`.

*Bias instability* is flicker noise, approximated by a sum of first-order Gauss-Markov processes of equal
variance, with correlation times a decade apart from 1 s to 1000 s. Flicker noise of coefficient B has the
(one-sided) spectrum B²/(πf) and the Allan floor B √(2 ln 2 / π) = 0.664 B. Processes with times spaced by
the factor r give σ²/(f ln r) between their corner frequencies, hence σ² = B² ln r / π. The parameters
``*_bias_instability`` are the Allan floor, as in data sheets. Drift is constant within a sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.exceptions import InputError
from srt.recording.recording import ImuNoise

if TYPE_CHECKING:
    from sims.physics.true_motion import TrueMotion
    from srt.recording.recording import Kind, Recording
    from srt.sensor_errors import SensorErrors
    from srt.types import Array, Indices

CORRELATION_TIMES_S: Final = (1.0, 10.0, 100.0, 1000.0)
"""Correlation times of the processes whose sum is the bias instability."""
SMALLEST_SINGULAR_VALUE: Final = 0.15
"""Smallest accepted singular value of Mg and Ma; below it two axes are nearly parallel."""
_NEVER_DRAWN: Final = np.random.default_rng(0)
"""Generator of a model that is not random."""
ALLAN_FLOOR: Final = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Allan deviation at the floor of flicker noise with coefficient B = 1: 0.664."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuModel:
    """Noise, quantization, range and g-sensitivity of an IMU; zero or infinite means absent.

    Attributes
    ----------
    gyro_noise, accel_noise : float
        Angle random walk, rad/√s; velocity random walk, m/s/√s.
    gyro_bias_instability, accel_bias_instability : float
        Allan floor, rad/s and m/s².
    gyro_quantization, accel_quantization : float
        Size of a pulse, rad and m/s.
    gyro_resolution, accel_resolution : float
        Least significant bit of the output as a rate, rad/s and m/s²; the rounding error is not carried to the next
        sample.
    gyro_range, accel_range : float
        Saturation, rad/s and m/s².
    gyro_g_sensitivity : ndarray, shape (3, 3), rad/s per m/s²
        Row: gyro; column: axis of B of the specific force.
    """

    gyro_noise: float = 0.0
    accel_noise: float = 0.0
    gyro_bias_instability: float = 0.0
    accel_bias_instability: float = 0.0
    gyro_quantization: float = 0.0
    accel_quantization: float = 0.0
    gyro_resolution: float = 0.0
    accel_resolution: float = 0.0
    gyro_range: float = math.inf
    accel_range: float = math.inf
    gyro_g_sensitivity: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def is_random(self) -> bool:
        """True if the readings depend on random numbers."""
        return any(
            getattr(self, f"{sensor}_{what}") > 0.0
            for sensor in ("gyro", "accel")
            for what in ("noise", "bias_instability", "quantization")
        )

    def stated(self) -> ImuNoise:
        """Noise figures in the form that a recording states them; zero and infinite figures are not stated."""

        def figure(value: float) -> float | None:
            return value if 0.0 < value < math.inf else None

        return ImuNoise(
            figure(self.gyro_noise),
            figure(self.accel_noise),
            figure(self.gyro_quantization),
            figure(self.accel_quantization),
            figure(self.gyro_bias_instability),
            figure(self.accel_bias_instability),
            figure(self.gyro_range),
            figure(self.accel_range),
        )


def gyro_matrix(errors: SensorErrors) -> Array:
    """Build Mg: scale errors on the diagonal, half of each orthogonality error on both sides."""
    e = errors.as_dict()
    xy, yz, zx = (0.5 * e[f"gyro_orthogonality_{pair}"] for pair in ("xy", "yz", "zx"))
    return np.array(
        [
            [1.0 + e["gyro_scale_x"], xy, zx],
            [xy, 1.0 + e["gyro_scale_y"], yz],
            [zx, yz, 1.0 + e["gyro_scale_z"]],
        ]
    )


def accel_matrix(errors: SensorErrors) -> Array:
    """Build Ma: scale errors on the diagonal, misalignment of i toward j at [i, j]."""
    matrix = np.eye(3)
    for i, a in enumerate("xyz"):
        for j, b in enumerate("xyz"):
            matrix[i, j] += errors[f"accel_scale_{a}" if i == j else f"accel_misalignment_{a}{b}"]
    return matrix


def is_imu(errors: SensorErrors) -> bool:
    """True if an IMU with these errors is physically possible.

    Parameters
    ----------
    errors : SensorErrors

    Returns
    -------
    bool
        True if Mg is positive definite, as required for the MARS gauge; Ma has a positive determinant (no reversed
        axis, no left-handed triad); and no singular value of either is below :data:`SMALLEST_SINGULAR_VALUE`.
    """
    Mg, Ma = gyro_matrix(errors), accel_matrix(errors)
    singular = min(np.linalg.svd(M, compute_uv=False)[-1] for M in (Mg, Ma))
    return bool(np.linalg.eigvalsh(Mg)[0] > 0.0 and np.linalg.det(Ma) > 0.0 and singular >= SMALLEST_SINGULAR_VALUE)


def noise_free_increments(
    motion: TrueMotion, errors: SensorErrors, g_sensitivity: Array | None = None
) -> tuple[Array, Array]:
    """Noise-free increments of gyros (rad) and accelerometers (m/s) by the sensor model, shape (n, 3) each."""

    def linear(matrix: Array, integral: Array, absolute: Array, sensor: str) -> Array:
        # One row for each sensor: numpy takes ten times as long for n rows of three.
        rows = matrix @ integral.T
        rows += errors.group(f"{sensor}_asymmetry")[:, np.newaxis] * absolute.T
        rows += errors.group(f"{sensor}_bias")[:, np.newaxis] * motion.interval
        return rows

    gyro = linear(gyro_matrix(errors), motion.angle, motion.angle_abs, "gyro")
    if g_sensitivity is not None and np.any(g_sensitivity):
        gyro += g_sensitivity @ motion.velocity.T
    accel = linear(accel_matrix(errors), motion.velocity, motion.velocity_abs, "accel")
    return np.stack(list(gyro), axis=1), np.stack(list(accel), axis=1)


def read_out(
    motion: TrueMotion,
    errors: SensorErrors,
    imu: ImuModel | None = None,
    rng: np.random.Generator | None = None,
    *,
    kind: Kind = "rate",
    state_noise: bool = True,
    serial: str | None = None,
) -> Recording:
    """Record a true motion with an IMU.

    Parameters
    ----------
    motion : TrueMotion
    errors : SensorErrors
        Sensor errors in B.
    imu : ImuModel, optional
        Noise, quantization, range, g-sensitivity; by default all absent.
    rng : numpy.random.Generator, optional
        Required if the model is random; each triad uses its own spawned generator.
    kind : "rate" or "increment"
    state_noise : bool
        False: the recording omits the noise figures, so that a calibration must estimate them.
    serial : str, optional

    Raises
    ------
    InputError
        If the model is random and no generator is given.
    """
    model = imu or ImuModel()
    gyro, accel = noise_free_increments(motion, errors, model.gyro_g_sensitivity)
    if model.is_random():
        if rng is None:
            raise InputError("This IMU model is random: pass a numpy.random.Generator to read it out.")
        for_gyro, for_accel = rng.spawn(2)
    else:
        for_gyro = for_accel = _NEVER_DRAWN
    chains = (
        _Chain(
            model.gyro_noise, model.gyro_bias_instability, model.gyro_range,
            model.gyro_quantization, model.gyro_resolution,
        ),
        _Chain(
            model.accel_noise, model.accel_bias_instability, model.accel_range,
            model.accel_quantization, model.accel_resolution,
        ),
    )  # fmt: skip
    factor = 1.0 if kind == "increment" else 1.0 / motion.interval
    return motion.ideal.with_readings(
        chains[0].apply(gyro, motion, for_gyro) * factor,
        chains[1].apply(accel, motion, for_accel) * factor,
        kind=kind,
        noise=model.stated() if state_noise else ImuNoise(),
        serial=serial,
    )


@dataclass(frozen=True, slots=True)
class _Chain:
    """Signal chain of one triad: noise, drift, saturation, pulses, output word."""

    noise: float
    bias_instability: float
    range: float
    quantum: float
    resolution: float

    def apply(self, increments: Array, motion: TrueMotion, rng: np.random.Generator) -> Array:
        dt = motion.interval
        if self.noise > 0.0:
            increments = increments + self.noise * math.sqrt(dt) * rng.standard_normal(increments.shape)
        if self.bias_instability > 0.0:
            increments = increments + dt * drift(self.bias_instability, motion, rng)
        if self.range < math.inf:
            increments = np.clip(increments, -self.range * dt, self.range * dt)
        if self.quantum > 0.0:
            increments = _pulses(increments, self.quantum, motion.piece_starts, rng)
        if self.resolution > 0.0:
            bit = self.resolution * dt
            increments = np.round(increments / bit) * bit
        return increments


def _pulses(increments: Array, quantum: float, piece_starts: Indices, rng: np.random.Generator) -> Array:
    """Increments in whole pulses of the running integral; each gapless piece begins with a random remainder."""
    output = np.empty_like(increments)
    for piece in np.split(np.arange(len(increments)), piece_starts[1:]):
        remainder = rng.random((1, increments.shape[1]))
        running = np.floor(np.vstack([remainder, remainder + np.cumsum(increments[piece] / quantum, axis=0)]))
        output[piece] = np.diff(running, axis=0) * quantum
    return output


def drift(floor: float, motion: TrueMotion, rng: np.random.Generator) -> Array:
    """Bias instability of three independent sensors over a motion's samples, shape (n, 3).

    Parameters
    ----------
    floor : float
        Allan floor, in the unit of the result.
    motion : TrueMotion
        Motion with the sample times; the processes continue through gaps.
    rng : numpy.random.Generator
    """
    from scipy.signal import lfilter  # a heavy import that noise-free work does not need

    spacing = math.log(CORRELATION_TIMES_S[1] / CORRELATION_TIMES_S[0])
    sigma = floor / ALLAN_FLOOR * math.sqrt(spacing / math.pi)
    total = np.zeros((len(motion.time), 3))
    edges = [*motion.piece_starts.tolist(), len(motion.time)]
    for tau in CORRELATION_TIMES_S:
        keep = math.exp(-motion.interval / tau)
        fresh = sigma * math.sqrt(-math.expm1(-2.0 * motion.interval / tau))
        last, last_time = np.zeros(3), -math.inf
        for first, end in pairwise(edges):
            age = motion.time[first] - last_time
            begin = math.exp(-age / tau) * last
            begin = begin + sigma * math.sqrt(-math.expm1(-2.0 * age / tau)) * rng.standard_normal(3)
            shocks = fresh * rng.standard_normal((end - first, 3))
            shocks[0] = begin
            values = lfilter([1.0], [1.0, -keep], shocks, axis=0)
            total[first:end] += values
            last, last_time = values[-1], motion.time[end - 1]
    return total
