"""Three corrections of a gyro bias that depends on specific force (g-sensitivity): residual predicted and observed.

``python benchmarks/g_sensitivity.py --units 2500`` prints the table of docs/g-sensitivity.md.

At rest a gyro reads ``κ + Γ f_w + n_w`` in window w beyond the Earth's rate, n_w of variance ``s² = N² / T``. After the
correction, the residual bias over the W windows of K sequences of two has for each gyro the mean square

    pooled:        ``σ² Σ_w |f_w − f̄|² / W  + s² / W``       one bias for all
    per-sequence:  ``σ² Σ_w |f_w − f̄_k|² / W + s² / 2``      each sequence's own two windows
    g-sensitive:   ``4 s² / W``                               bias and Γ, four unknowns for each gyro

with σ the 1-sigma size of the elements of Γ. :mod:`sims.accuracy.budget` predicts the effect on the parameters; units
simulated with all sensor and fixture errors show it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import harness
import numpy as np
from studies import markdown, nees_of

import srt
from sims.accuracy.budget import Budget, budget
from sims.scenarios.scenario import load_scenario
from sims.scenarios.simulation import simulate
from srt.constants import DEG, DEG_PER_H, DEG_PER_SQRT_H
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, NAMES, SYMBOLS

if TYPE_CHECKING:
    from sims.scenarios.scenario import Scenario
    from sims.scenarios.simulation import Simulation
    from srt.estimation.options import GyroBias
    from srt.result.calibration import Calibration
    from srt.types import Array


MODES: Final[tuple[GyroBias, ...]] = ("pooled", "per-sequence", "g-sensitive")
NOISE: Final = {
    "gyro_noise_deg_per_sqrt_h": 0.15,
    "accel_noise_ug_per_sqrt_hz": 102.0,
    "gyro_g_sensitivity_deg_per_h_per_g": 30.0,
}
"""White noise of the industrial grade, and the g-sensitivity of its gyros without compensation."""
BIAS_DEG_PER_S: Final = 0.5
"""Bias of every gyro, °/s: typical of industrial MEMS gyros before calibration."""
_BIAS: Final = GROUP_SLICES["gyro_bias"]


class BiasCorrection(NamedTuple):
    """Prediction and observation of one correction of the gyro bias.

    ``observed``, shape (27,), SI, is the rms error over the units, ``left_predicted`` and ``left_observed`` the rms of
    the residual gyro bias in the windows, rad/s. ``nees`` is the mean of the squared error of Γ over its covariance, by
    its nine elements; NaN where it is not estimated.
    """

    predicted: Budget
    observed: Array
    left_predicted: float
    left_observed: float
    nees: float


def mems_scenario(*, dwell_s: float = 10.0, sample_rate_hz: float = 100.0) -> Scenario:
    """Scenario of Table 1 with an industrial MEMS unit: bias 0.5 °/s in every gyro, Γ of 30 °/h/g, white noise only."""
    base = load_scenario("industrial-mems")
    assert base.schedule is not None
    bias = {f"gyro_bias_{axis}": BIAS_DEG_PER_S * DEG for axis in "xyz"}
    imu = base.imu.model_copy(update={"noise": type(base.imu.noise)(**NOISE)})
    recording = {"sample_rate_hz": sample_rate_hz, "label_sequences": True, "kind": "rate"}
    schedule = {"dwell_s": dwell_s, "moves": "skipped", "settle_s": 0.5}
    return base.model_copy(
        update={
            "imu": imu,
            "errors": base.errors.model_copy(update={"values": base.errors.values | bias}),
            "recording": base.recording.model_copy(update=recording),
            "schedule": base.schedule.model_copy(update=schedule),
        }
    )


def study(plan: Scenario, units: int, *, first_seed: int, draws: int = 30) -> dict[GyroBias, BiasCorrection]:
    """Predict and observe all three corrections, by units of consecutive seeds, each with errors, Γ, fixture and noise.

    ``plan`` is labelled, with windows of one length; gyro noise and g-sensitivity alone disturb its rates at rest. The
    prediction takes ``draws`` simulated fixtures.
    """
    squares = {mode: np.zeros(27) for mode in MODES}
    left = {mode: np.zeros(2) for mode in MODES}
    nees = dict.fromkeys(MODES, math.nan) | {"g-sensitive": 0.0}
    for seed in range(first_seed, first_seed + units):
        unit = simulate(plan.model_copy(update={"seed": seed}))
        for mode in MODES:
            found = srt.calibrate(unit.recording, "closed-form", gyro_bias=mode, checks=False)
            squares[mode] += (found.errors.vector - unit.truth.vector) ** 2 / units
            left[mode] += np.array([_predicted(plan, unit, mode), _observed(unit, found)]) / units
            if mode == "g-sensitive":
                assert found.g_sensitivity is not None
                assert found.g_sensitivity_covariance is not None
                error = (found.g_sensitivity - unit.imu.gyro_g_sensitivity).ravel()
                nees[mode] += nees_of(error, found.g_sensitivity_covariance) / 9.0 / units
    predicted = {mode: budget(plan, draws=draws, gyro_bias=mode)[0] for mode in MODES}
    rms = {mode: np.sqrt(left[mode]).tolist() for mode in MODES}
    return {m: BiasCorrection(predicted[m], np.sqrt(squares[m]), rms[m][0], rms[m][1], nees[m]) for m in MODES}


def _forces(unit: Simulation) -> Array:
    """Specific force at the start and the end of every sequence, shape (K, 2, 3), m/s², in B."""
    g = unit.recording.site.gravity_m_s2
    return -g * unit.motion.attitudes[:, :, 2]


def _predicted(plan: Scenario, unit: Simulation, mode: GyroBias) -> float:
    """Predicted mean square of the residual bias of each gyro of a unit, (rad/s)²."""
    force = _forces(unit)
    first, last = unit.recording.sequences[0].start_static_s
    noise = (plan.imu.noise.gyro_noise_deg_per_sqrt_h * DEG_PER_SQRT_H) ** 2 / (last - first)
    sigma2, W = plan.imu.noise.g_sensitivity_sigma**2, 2 * len(force)
    if mode == "g-sensitive":
        return float(4.0 * noise / W)
    pooled = mode == "pooled"
    mean = force.mean(axis=(0, 1)) if pooled else force.mean(axis=1, keepdims=True)
    return float(sigma2 * np.sum((force - mean) ** 2) / W + noise / (W if pooled else 2.0))


def _observed(unit: Simulation, found: Calibration) -> float:
    """Observed mean square of the residual bias of each gyro in the windows, (rad/s)²."""
    force = _forces(unit)
    Gamma = unit.imu.gyro_g_sensitivity.copy()
    if found.g_sensitivity is not None:
        Gamma -= found.g_sensitivity
    own = np.asarray(found.noise.gyro_bias_by_sequence_rad_s)
    bias = unit.truth.vector[_BIAS] - found.errors.vector[_BIAS]
    return float(np.mean((bias - own[:, None] + force @ Gamma.T) ** 2))


def main(*, units: int = 300, seed: int = 5000, dwell: float = 4.0, rate: float = 50.0) -> None:
    """Units, first seed, length of each window (s) and sample rate (Hz)."""
    plan = mems_scenario(dwell_s=dwell, sample_rate_hz=rate)
    found = study(plan, units, first_seed=seed)

    def row(name: str, unit: str, factor: float, pairs: list[tuple[float, float]]) -> list[str]:
        return [
            name,
            unit,
            *(text for p, o in pairs for text in (f"{factor * p:.3g}", f"{factor * o:.3g}", f"{p / o:.3f}")),
        ]

    rows = [
        row("bias left at rest", "°/h", 1.0 / DEG_PER_H, [(f.left_predicted, f.left_observed) for f in found.values()])
    ]
    for i in range(len(NAMES)):
        sizes = [(float(f.predicted.total[i]), float(f.observed[i])) for f in found.values()]
        rows.append(row(SYMBOLS[i], DISPLAY_UNITS[i], DISPLAY_FACTORS[i], sizes))
    columns = [f"{mode}: {what}" for mode in MODES for what in ("predicted", "observed", "ratio")]
    print(*markdown(("", "unit", *columns), rows, 2), sep="\n")
    print(f"\nSquared error of the g-sensitivity over its covariance, by nine: {found['g-sensitive'].nees:.3f}")


if __name__ == "__main__":
    harness.run(main, __doc__)
