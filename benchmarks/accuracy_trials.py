"""Trials of simulated units: calibration by one estimator, and comparison with the truth.

A trial is a function of its seed. :func:`run` maps trials over seeds in any number of processes, with equal numbers.
Estimators are reached through the registry (:func:`srt.calibrate`) only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import harness
import numpy as np
from studies import scored

import srt
from sims.physics.fixture import FixtureDraw, draw_fixture, rotation
from sims.physics.free_motion import free_motion, random_attitude, random_turns
from sims.physics.imu import ImuModel, is_imu, read_out
from sims.physics.sequences import TABLE_1, table_sequences
from sims.physics.table_motion import table1_motion
from srt.constants import ARCSEC, DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G, STANDARD_GRAVITY_M_S2
from srt.recording.recording import Fixture, Site
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sims.physics.table_motion import Moves
    from srt.recording.recording import Kind, Recording
    from srt.result.calibration import Calibration
    from srt.types import Array


SITE: Final = Site(STANDARD_GRAVITY_M_S2, 5e-6, 45.0 * DEG)
"""Site of all trials: latitude 45°, standard gravity known to 5e-6 m/s² (1 sigma)."""
IN_G: Final = np.ones(N_PARAMETERS)
"""Divisor of the 27 errors: accelerometer bias in g, all others SI."""
IN_G[GROUP_SLICES["accel_bias"]] = STANDARD_GRAVITY_M_S2

GRADES: Final = {
    "navigation": ImuModel(
        gyro_noise=0.002 * DEG_PER_SQRT_H,
        accel_noise=5.0 * MICRO_G,
        gyro_quantization=0.5 * ARCSEC,
        accel_quantization=1e-5,
    ),
    "tactical": ImuModel(gyro_noise=0.0667 * DEG_PER_SQRT_H, accel_noise=60.0 * MICRO_G),
    "industrial": ImuModel(gyro_noise=0.15 * DEG_PER_SQRT_H, accel_noise=102.0 * MICRO_G),
}
"""White noise and quantization of three grades (configs/imu), without bias instability."""
INSTABILITY: Final = {
    "navigation": (0.001 * DEG_PER_H, 1.0 * MICRO_G),
    "tactical": (1.0 * DEG_PER_H, 50.0 * MICRO_G),
    "industrial": (0.5 * DEG_PER_H, 50.0 * MICRO_G),
}
"""Bias instability of gyros (rad/s) and accelerometers (m/s²) by grade: the Allan floor."""


def run(trial: Callable[[int], Any], seeds: Iterable[int], *, workers: int = 1) -> list[Any]:
    """Results of ``trial(seed)`` in the order of the seeds."""
    return list(harness.in_processes(workers, trial, ((seed,) for seed in seeds)))


def normal_errors(rng: np.random.Generator, sigma: float = 1e-3, gyro_bias: float = 0.0) -> SensorErrors:
    """Draw all errors with one sigma (biases of accelerometers in g), gyro bias uniform up to ``gyro_bias`` rad/s."""
    vector = rng.standard_normal(N_PARAMETERS) * sigma * IN_G
    vector[GROUP_SLICES["gyro_bias"]] = rng.uniform(-1.0, 1.0, 3) * gyro_bias
    return SensorErrors(vector)


def true_site(rng: np.random.Generator) -> Site:
    """Site with gravity drawn with its sigma."""
    return replace(SITE, gravity_m_s2=SITE.gravity_m_s2 + rng.standard_normal() * SITE.gravity_sigma_m_s2)


_LARGE: Final = {
    "gyro_scale": 0.5, "gyro_asymmetry": 0.01, "gyro_orthogonality": 0.3, "accel_bias": 1.0, "accel_scale": 0.5,
    "accel_asymmetry": 0.01, "accel_misalignment": 0.3, "gyro_bias": 1.0 * DEG,
}  # fmt: skip
"""Half width of the uniform distribution of large errors by group, SI."""


def large_errors(rng: np.random.Generator) -> tuple[SensorErrors, int]:
    """Draw uniform errors of ±50 % scale, ±0.3 rad, ±1 % asymmetry, ±1 m/s² and ±1 °/s; impossible units are redrawn.

    Returns
    -------
    errors : SensorErrors
    redrawn : int
        Number of draws that had a matrix with det ≤ 0, gyros not positive definite, or a singular value below 0.15.
    """
    redrawn = 0
    while True:
        vector = np.zeros(N_PARAMETERS)
        for group, bound in _LARGE.items():
            part = GROUP_SLICES[group]
            vector[part] = rng.uniform(-bound, bound, part.stop - part.start)
        if is_imu(SensorErrors(vector)):
            return SensorErrors(vector), redrawn
        redrawn += 1


def fixture_errors(rng: np.random.Generator, sigma_rad: float, stretch_rad: float = 0.0) -> FixtureDraw:
    """Draw levelling, north, mounting and rotation errors of one sigma.

    Half turns have an additional uniform error within ± ``stretch_rad``.
    """
    draw = draw_fixture(
        rng,
        table_sequences(tuple(TABLE_1)),
        level_sigma_rad=sigma_rad,
        north_sigma_rad=sigma_rad,
        mounting_sigma_rad=sigma_rad,
        rotation_sigma_rad=sigma_rad,
    )
    if stretch_rad and draw.legs is not None:
        # Only the half turns: full turns stay full, or their signature would be another.
        legs = tuple(
            leg
            + np.array([abs(angle) == 180.0 for _, angle in s.rotations])
            * rng.uniform(-stretch_rad, stretch_rad, len(leg))
            for leg, s in zip(draw.legs, table_sequences(tuple(TABLE_1)), strict=True)
        )
        draw = replace(draw, legs=legs)
    return draw


def error_in_quoted_units(calibration: Calibration, truth: SensorErrors) -> Array:
    """Estimate minus truth, shape (27,), accelerometer bias in g."""
    return np.asarray((calibration.errors.vector - truth.vector) / IN_G)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Outcome of one trial.

    ``error`` and ``sigma``, shape (27,), have the accelerometer bias in g, all others SI; ``nees`` is over the number
    of observed parameters; ``distance`` is the largest difference from the fixed point reached from the truth, over
    max(1e-8, 0.01 sigma), NaN if not asked.
    """

    error: Array
    sigma: Array
    nees: float
    status: str
    playbacks: int
    distance: float = float("nan")
    redrawn: int = 0


def score(calibration: Calibration, truth: SensorErrors) -> Trial:
    """Compare a calibration with the truth."""
    found = scored(calibration, truth.vector)
    nees = found.nees / found.freedom if found.freedom else float("nan")
    error = calibration.errors.vector - truth.vector
    return Trial(error / IN_G, calibration.sigma / IN_G, nees, calibration.status, len(calibration.corrections))


def exact_trial(
    seed: int,
    *,
    sample_rate_hz: float = 200.0,
    kind: Kind = "rate",
    turned_rad: float = 0.0,
    sigma: float = 1e-3,
    earth_rate: bool = True,
    **options: Any,
) -> Trial:
    """Noise-free trial on a perfect fixture; MARS turned from the mount by ``turned_rad`` about a random axis."""
    rng = np.random.default_rng(seed)
    truth = normal_errors(rng, sigma, 1.0 * DEG)
    axis = rng.standard_normal(3)
    U = rotation(turned_rad * axis / np.linalg.norm(axis))
    motion = table1_motion(site=SITE, sample_rate_hz=sample_rate_hz, U=U, earth_rate=earth_rate)
    return score(srt.calibrate(read_out(motion, truth, kind=kind), "closed-form", checks=False, **options), truth)


def fixture_trial(
    seed: int,
    *,
    sigma_rad: float = 1e-3,
    stretch_rad: float = 0.0,
    earth_rate: bool = True,
    sample_rate_hz: float = 100.0,
    **options: Any,
) -> Trial:
    """Noise-free trial on a fixture with errors."""
    rng = np.random.default_rng(seed)
    truth = normal_errors(rng, 1e-3, 1.0 * DEG)
    motion = table1_motion(
        site=SITE if earth_rate else replace(SITE, latitude_rad=None),
        sample_rate_hz=sample_rate_hz,
        fixture_draw=fixture_errors(rng, sigma_rad, stretch_rad),
        stated_fixture=Fixture(0.0, max(sigma_rad, 1e-9), max(sigma_rad, 1e-9)),
        earth_rate=earth_rate,
    )
    return score(srt.calibrate(read_out(motion, truth), "closed-form", checks=False, **options), truth)


def large_trial(seed: int, *, sigma_rad: float = 5e-3, sample_rate_hz: float = 100.0, **options: Any) -> Trial:
    """Noise-free trial with large initial errors on a 5 mrad fixture; started from the truth too (fixed point)."""
    rng = np.random.default_rng(seed)
    truth, redrawn = large_errors(rng)
    motion = table1_motion(
        site=SITE,
        sample_rate_hz=sample_rate_hz,
        fixture_draw=fixture_errors(rng, sigma_rad),
        stated_fixture=Fixture(0.0, sigma_rad, sigma_rad, wobble_sigma_rad=0.0),
    )
    recording = read_out(motion, truth)
    found = srt.calibrate(recording, "closed-form", checks=False, **options)
    reference = srt.calibrate(recording, "closed-form", checks=False, **{**options, "start": truth})
    difference = np.abs(found.errors.vector - reference.errors.vector) / IN_G
    distance = float(np.max(difference / np.maximum(1e-8, 0.01 * found.sigma / IN_G)))
    return replace(score(found, truth), distance=distance, redrawn=redrawn)


NOISE_FREE: Final[dict[str, Callable[[int], Trial]]] = {
    "perfect fixture": exact_trial,
    **{f"perfect fixture, {hz:g} Hz": partial(exact_trial, sample_rate_hz=hz) for hz in (50.0, 100.0, 1000.0)},
    "perfect fixture, increments": partial(exact_trial, kind="increment"),
    "perfect fixture, MARS turned by 0.2 rad": partial(exact_trial, turned_rad=0.2),
    "1 mrad": fixture_trial,
    "1 mrad, Earth's rate off": partial(fixture_trial, earth_rate=False),
    "3 mrad": partial(fixture_trial, sigma_rad=3e-3),
    "10 mrad": partial(fixture_trial, sigma_rad=1e-2),
    "1 mrad, half turns of 150°-210°": partial(fixture_trial, stretch_rad=30.0 * DEG),
    "large errors, 5 mrad": large_trial,
}
"""Cases without noise: 200 Hz and errors of 1e-3 on a perfect fixture, 100 Hz on others, and :func:`large_errors`."""


def noise_free(cell: tuple[str], unit: int, _estimators: object) -> dict[str, Trial]:
    """Closed form on one unit of a case."""
    return {"closed-form": NOISE_FREE[cell[0]](unit)}


def noisy_recording(
    seed: int,
    grade: str,
    *,
    instability: bool = False,
    g_sensitivity: float = 0.0,
    state_noise: bool = True,
    sigma_rad: float = 1e-3,
    sample_rate_hz: float = 100.0,
) -> tuple[Recording, SensorErrors]:
    """Recording of a noisy unit on a 1 mrad fixture: random walks, quantization, constant bias, gravity with its sigma.

    ``instability`` and ``g_sensitivity`` (rad/s per m/s², one sigma of each matrix element) are off by default.
    """
    rng = np.random.default_rng(seed)
    truth = normal_errors(rng, 1e-3, 10.0 * DEG_PER_H)
    motion = table1_motion(
        site=true_site(rng),
        sample_rate_hz=sample_rate_hz,
        fixture_draw=fixture_errors(rng, sigma_rad),
        stated_fixture=Fixture(0.0, sigma_rad, sigma_rad, wobble_sigma_rad=0.0),
    )
    imu = replace(GRADES[grade], gyro_g_sensitivity=rng.standard_normal((3, 3)) * g_sensitivity)
    if instability:
        gyro, accel = INSTABILITY[grade]
        imu = replace(imu, gyro_bias_instability=gyro, accel_bias_instability=accel)
    return read_out(motion.stated_as(site=SITE), truth, imu, rng, state_noise=state_noise), truth


def fixture_recording(
    seed: int,
    grade: str,
    *,
    non_orthogonality_rad: float | None = None,
    rotation_sigma_rad: float = 1e-3,
    moves: Moves = "skipped",
    sample_rate_hz: float = 100.0,
) -> tuple[Recording, SensorErrors]:
    """Recording of a noisy unit on a fixture that is as stated: alignment 1 mrad, wobble a hundredth of the rotations.

    ``non_orthogonality_rad`` is drawn with the alignment sigma if not given.
    """
    rng = np.random.default_rng(seed)
    truth = normal_errors(rng, 1e-3, 10.0 * DEG_PER_H)
    site, stated = true_site(rng), Fixture(0.0, 1e-3, rotation_sigma_rad)
    alignment = ("level_sigma_rad", "north_sigma_rad", "mounting_sigma_rad", "non_orthogonality_sigma_rad")
    draw = draw_fixture(
        rng,
        table_sequences(tuple(TABLE_1)),
        **dict.fromkeys(alignment, stated.alignment_sigma_rad),
        rotation_sigma_rad=rotation_sigma_rad,
        wobble_sigma_rad=stated.wobble,
    )
    if non_orthogonality_rad is not None:
        draw = replace(draw, non_orthogonality=non_orthogonality_rad)
    motion = table1_motion(
        site=site, sample_rate_hz=sample_rate_hz, fixture_draw=draw, stated_fixture=stated, moves=moves
    )
    return read_out(motion.stated_as(site=SITE), truth, GRADES[grade], rng), truth


def noisy_trial(
    seed: int, *, grade: str, estimator: str = "closed-form", calibration: Any = None, **unit: Any
) -> Trial:
    """Calibrate one noisy unit; ``calibration`` holds options of the estimator, the rest describes the unit."""
    recording, truth = noisy_recording(seed, grade, **unit)
    return score(srt.calibrate(recording, estimator, checks=False, **(calibration or {})), truth)


def free_trial(seed: int, *, turns: int = 36, sample_rate_hz: float = 100.0) -> Trial:
    """A consumer MEMS unit turned by hand: no fixture, no labels, noise estimated."""
    rng = np.random.default_rng(seed)
    sizes = {"gyro_scale": 0.01, "gyro_asymmetry": 1e-3, "gyro_orthogonality": 0.01, "accel_bias": 0.2}
    sizes |= {"accel_scale": 0.01, "accel_asymmetry": 1e-3, "accel_misalignment": 0.01, "gyro_bias": 0.01}
    vector = np.concatenate(
        [rng.standard_normal(GROUP_SLICES[g].stop - GROUP_SLICES[g].start) * s for g, s in sizes.items()]
    )
    truth = SensorErrors(vector)
    site = true_site(rng)
    motion = free_motion(
        random_turns(rng, turns, smallest_rad=0.8, largest_rad=3.0),
        site=site,
        attitude=random_attitude(rng),
        sample_rate_hz=sample_rate_hz,
    )
    imu = ImuModel(gyro_noise=0.3 * DEG_PER_SQRT_H, accel_noise=200.0 * MICRO_G)
    recording = read_out(motion.stated_as(site=SITE), truth, imu, rng, state_noise=False)
    return score(srt.calibrate(recording, checks=False), truth)


def normalised(trials: Iterable[Trial]) -> Array:
    """Errors over their reported sigma, shape (trials, 27)."""
    return np.array([t.error / t.sigma for t in trials])
