"""What a calibration says of gyros that follow specific force: the matrix, its doubt, and whether it was left out.

Whether the gyros follow it is asked where it is not estimated. A sequence's bias is the same in both of its windows,
nearly, and the specific force of a unit that was turned over is not: the change of the rate at rest from the start to
the end of each sequence is fitted by the change of the specific force and a constant, each gyro for itself, and the
F-test compares that with the constant alone. A bias that wanders from sequence to sequence takes no part in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import fdtrc

from srt.constants import DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.estimation import measurement_covariance
from srt.estimation.g_sensitivity import KEY, LEAST_SPREAD, MODE

if TYPE_CHECKING:
    from srt.estimation.iteration import Solution
    from srt.estimation.srt_measurements import SrtMeasurements
    from srt.sequences.preparation import PlaybackData
    from srt.types import Array


FALSE_ALARM: Final = 1e-3
"""Of saying that gyros follow specific force which do not, by all three together."""
_LEAST_FREEDOM: Final = 3
_EARTH_SIGMAS: Final = 3.0
_DEG_PER_H_PER_G: Final = STANDARD_GRAVITY_M_S2 / DEG_PER_H


def rate_disturbances(measurements: SrtMeasurements, data: PlaybackData, wander: Array) -> Array:
    """What disturbs the rates of the windows, by unit draws of all sources, shape (W, 3, S), rad/s.

    Parameters
    ----------
    measurements : SrtMeasurements
        With its noise integrals.
    data : PlaybackData
    wander : ndarray, shape (3,), rad/s
        One sigma of a sequence's gyro bias about the test's, raw channels.
    """
    sources = measurement_covariance.disturbances(measurements, data, wander).values()
    return np.concatenate([source.rate for source in sources if source.rate is not None], axis=2)


def diagnostics(data: PlaybackData, solution: Solution) -> dict[str, Any]:
    """What goes to the result, as JSON values; empty where Γ is not estimated.

    ``matrix``, its ``sigma`` and its ``covariance`` (nine elements by rows) are SI, rows gyros and columns axes of B;
    ``rest_rate_scatter_rad_s`` is the rms of the windows' rates at rest about their mean with Γ in them and without,
    and what noise explains of the latter.
    """
    measurements = solution.measurements
    if measurements.poses is None:
        return {}
    disturbed = rate_disturbances(measurements, data, solution.wander)
    by_draw = np.einsum("ab,bcs->acs", measurements.gyro.matrix, measurements.poses.fit(disturbed)).reshape(9, -1)
    P = by_draw @ by_draw.T
    sigma = np.sqrt(np.diag(P)).reshape(3, 3)
    rate = measurements.after_g_sensitivity(disturbed)[0]
    expected = measurements.pool @ np.sum((rate - np.tensordot(measurements.pool, rate, 1)) ** 2, axis=2)
    left = measurements.rest_rate - measurements.pool @ measurements.rest_rate
    spread = measurements.force - measurements.pool @ measurements.force
    followed = np.linalg.solve(measurements.gyro.matrix, solution.g_sensitivity)
    return {
        KEY: {
            "matrix": solution.g_sensitivity.tolist(),
            "sigma": sigma.tolist(),
            "covariance": P.tolist(),
            "unit": "rad/s per m/s^2",
            "matrix_deg_per_h_per_g": (solution.g_sensitivity * _DEG_PER_H_PER_G).tolist(),
            "sigma_deg_per_h_per_g": (sigma * _DEG_PER_H_PER_G).tolist(),
            "not_seen_along": measurements.poses.unseen.tolist(),
            "rest_rate_scatter_rad_s": {
                "before": np.sqrt(measurements.pool @ (left + spread @ followed.T) ** 2).tolist(),
                "after": np.sqrt(measurements.pool @ left**2).tolist(),
                "expected": np.sqrt(expected).tolist(),
            },
        }
    }


def warnings(data: PlaybackData, measurements: SrtMeasurements) -> tuple[str, ...]:
    """Directions that the poses do not show; or that the gyros follow the specific force, where that is not asked."""
    if measurements.poses is not None:
        if not len(measurements.poses.unseen):
            return ()
        along = " and ".join("(" + ", ".join(f"{x:.2f}" for x in axis) + ")" for axis in measurements.poses.unseen)
        return (
            f"The windows do not show how the gyros follow specific force along {along}, where it varies by less than "
            f"{LEAST_SPREAD:g} g: g-sensitivity is zero there and its error in no sigma; add sequences with these axes "
            "up and down.",
        )
    size = significant_g_sensitivity(measurements, data)
    if size is None:
        return ()
    return (
        f"The rates at rest follow the specific force, by up to {size * _DEG_PER_H_PER_G:.2g} °/h/g, and the sigmas do "
        f"not know of it: --gyro-bias {MODE} (gyro_bias={MODE!r}) of closed-form and least-squares takes it into "
        "account.",
    )


def significant_g_sensitivity(measurements: SrtMeasurements, data: PlaybackData) -> float | None:
    """Largest element of Γ, rad/s per m/s², if the F-test says that there is one; else None.

    Where the Earth's rate is not known, part of it is fixed to the vertical and looks the same: what is smaller than
    three sigmas of that says nothing.
    """
    at_rest = ~(measurements.integrated[data.start] | measurements.integrated[data.end])
    if measurements.integrated.all():  # integrated on request, not because they moved
        at_rest[:] = True
    start, end = data.start[at_rest], data.end[at_rest]
    T = data.windows.duration_s
    root = np.sqrt(T[start] * T[end] / (T[start] + T[end]))[:, None]
    change = root * (measurements.force[end] - measurements.force[start])
    rate = root * (measurements.rest_rate[end] - measurements.rest_rate[start])
    if len(rate) <= _LEAST_FREEDOM:
        return None
    constant = root / np.linalg.norm(root)
    change, rate = (v - constant @ (constant.T @ v) for v in (change, rate))
    left, singular, right = np.linalg.svd(change, full_matrices=False)
    seen = singular > LEAST_SPREAD * data.gravity * np.linalg.norm(root)
    count, freedom = int(seen.sum()), len(rate) - 1 - int(seen.sum())
    if count == 0 or freedom < _LEAST_FREEDOM:
        return None
    by_force = left[:, seen].T @ rate
    explained, rest = np.sum(by_force**2, axis=0), np.sum((rate - left[:, seen] @ by_force) ** 2, axis=0)
    with np.errstate(divide="ignore"):
        F = np.divide(explained / count, rest / freedom, out=np.zeros(3), where=explained > 0.0)
    if np.min(fdtrc(count, freedom, F)) > FALSE_ALARM / 3.0:
        return None
    size = float(np.abs((right[seen].T / singular[seen]) @ by_force).max())
    doubt = _EARTH_SIGMAS * measurement_covariance.earth_rate_sigma(data)
    return size if size * data.gravity > doubt else None
