"""The result put together: from what any estimator found to a calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import chdtri

from srt.estimation import g_sensitivity_report
from srt.estimation.leave_one_out import evidence_of, verdict
from srt.result.calibration import Calibration, Residual
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES
from srt.sequences.manoeuvres import wrong_turns

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.estimation.iteration import Solution
    from srt.estimation.leave_one_out import Evidence, WithoutSequences
    from srt.estimation.options import Options
    from srt.sensor_errors import SensorErrors
    from srt.sequences.preparation import PlaybackData
    from srt.types import Array, Mask


MISFIT_PROBABILITY: Final = 1e-3
_GROSS_RATIO: Final = 100.0
_GROSS_G: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Outcome:
    """What any estimator hands over to be made a calibration.

    Attributes
    ----------
    errors : SensorErrors
    U : ndarray, shape (3, 3)
        T to MARS components; ignored without a fixture.
    covariance : mapping of str to ndarray, shape (27, 27)
        By source of error.
    corrections : tuple of float
        Largest correction of each play-back.
    status, message : str
    residuals : tuple of Residual
    statistic : float
        Smallest weighted square sum of the residuals.
    freedom : int
        Its degrees of freedom.
    gross : bool
        Whether a misfit is no matter of noise.
    integrated : tuple of int
        Windows whose attitude was integrated.
    wander : ndarray, shape (3,), rad/s
        One sigma of a sequence's gyro bias about the test's, raw channels.
    bias_by_sequence : ndarray, shape (K, 3), rad/s
    turned : ndarray, shape (K, 3, 3)
        C_End of every sequence as the gyros measured it.
    total : ndarray, shape (27, 27), optional
        Covariance as the estimator itself has it; default the sum over the sources.
    diagnostics : mapping
        What else the estimator reports, as JSON values.
    evidence : tuple of Evidence
        Every sequence against the others, if the estimator has it.
    solution : Solution, optional
        Of an iterated solver; None for joint estimators.
    """

    errors: SensorErrors
    U: Array
    covariance: Mapping[str, Array]
    corrections: tuple[float, ...]
    status: str
    message: str
    residuals: tuple[Residual, ...]
    statistic: float
    freedom: int
    gross: bool
    integrated: tuple[int, ...]
    wander: Array
    bias_by_sequence: Array
    turned: Array
    total: Array | None = None
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    evidence: tuple[Evidence, ...] = ()
    solution: Solution | None = None


def outcome_of(
    data: PlaybackData,
    options: Options,
    solution: Solution,
    held: Mapping[str, str],
    without_sequences: WithoutSequences,
) -> Outcome:
    """Outcome of an iterated solution.

    Parameters
    ----------
    data : PlaybackData
    options : Options
    solution : Solution
    held : mapping of str to str
        Parameters not observed and the reason.
    without_sequences : WithoutSequences
        Leave-one-out of the solver.
    """
    fixed = np.array([name in held for name in NAMES])
    statistic, freedom = chi_square(solution, fixed)
    outside = solution.status == "outside_model"
    return Outcome(
        errors=solution.errors,
        U=solution.U,
        covariance=solution.covariance,
        corrections=solution.corrections,
        status=solution.status,
        message=solution.message,
        residuals=_residuals(data, solution),
        statistic=statistic,
        freedom=freedom,
        gross=freedom > 0 and _is_gross(data, solution, statistic / freedom),
        integrated=solution.integrated,
        wander=solution.wander,
        bias_by_sequence=solution.bias_by_sequence,
        turned=solution.playback.integrals.C_end,
        diagnostics=g_sensitivity_report.diagnostics(data, solution),
        evidence=() if outside else evidence_of(without_sequences, data, options, solution, fixed),
        solution=solution,
    )


def assemble(
    estimator: str,
    data: PlaybackData,
    options: Options,
    outcome: Outcome,
    held: Mapping[str, str],
    *,
    warnings: tuple[str, ...] = (),
    inflation: float = 1.0,
) -> Calibration:
    """Put a calibration together.

    Parameters
    ----------
    estimator : str
    data : PlaybackData
    options : Options
    outcome : Outcome
    held : mapping of str to str
        Parameters not observed and the reason.
    warnings : tuple of str
    inflation : float
        Factor on all sigmas (least squares whose residuals are larger than the noise explains).
    """
    if outcome.status == "outside_model":
        held = dict.fromkeys(NAMES, "the iteration ended where the model does not hold")
    observed = np.array([name not in held for name in NAMES])
    mask = np.outer(observed, observed)
    total = sum(outcome.covariance.values()) if outcome.total is None else outcome.total
    covariance = np.where(mask, total, 0.0) * inflation**2
    covariance = 0.5 * (covariance + covariance.T)
    status, message = outcome.status, outcome.message
    statistic, freedom = outcome.statistic, outcome.freedom
    misfit = inflation == 1.0 and status == "converged" and is_misfit(statistic, freedom)
    if misfit and outcome.gross:
        status = "not_converged"
        message = (
            f"The iteration came to rest after {len(outcome.corrections)} play-backs, but the measurements contradict "
            f"the result grossly (chi-square {statistic:.2g} for {freedom} degrees of freedom): a wrong minimum, a "
            "wrong label, or a unit that the model does not describe."
        )
    elif misfit:
        warnings = (
            *warnings,
            f"The measurements contradict each other more than their noise explains (chi-square {statistic:.0f} for "
            f"{freedom} degrees of freedom): some error source is not in the sigmas, which are too small by a factor "
            f"of about {np.sqrt(statistic / freedom):.2g} or more (bias instability, g-sensitivity, a bumped window?).",
        )
    if status == "converged" and held:
        status = "partial"
        message = f"{message} Held, not observed: {', '.join(held)}."
    fixture = data.recording.fixture
    return Calibration(
        estimator=estimator,
        status=status,
        message=message,
        errors=outcome.errors,
        covariance=covariance,
        corrections=outcome.corrections,
        held={name: held[name] for name in NAMES if name in held},
        contributions={
            source: np.where(observed, np.sqrt(np.maximum(np.diag(P), 0.0)) * inflation, 0.0)
            for source, P in outcome.covariance.items()
        },
        U=None if data.nominal is None else outcome.U,
        U_sigma_rad=None if data.nominal is None or fixture is None else fixture.alignment_sigma_rad,
        residuals=outcome.residuals,
        site=_site(data),
        noise=_noise(data, outcome, inflation)
        | {"chi_square": statistic, "degrees_of_freedom": freedom}
        | _shared_errors(outcome, mask, inflation),
        alignment=_alignment(data),
        temperature=_temperature(data),
        provenance={
            "data_sha256": data.recording.data_sha256,
            "software": software(),
            "serial": data.recording.serial,
            "date": data.recording.date,
            "options": options.as_dict(),
            "voided": dict(data.voided),
        },
        diagnostics=outcome.diagnostics,
        verdict=verdict(outcome.evidence, covariance, observed, statistic, freedom) if observed.any() else {},
        warnings=(*warnings, *_warnings(data, outcome, observed)),
    )


def _is_gross(data: PlaybackData, solution: Solution, ratio: float) -> bool:
    """Whether a misfit is no matter of noise: a hundred times its variance, and a hundredth of g in the mean."""
    components = solution.playback.z[: 2 * data.K]
    return ratio > _GROSS_RATIO and float(np.sqrt(np.mean(components**2))) > _GROSS_G * data.gravity


def chi_square(solution: Solution, held: Mask) -> tuple[float, int]:
    """Smallest weighted square sum of the residuals over all values of the parameters not held; degrees of freedom."""
    R, z = solution.measurement_covariance, solution.playback.z
    if held.all():
        return 0.0, 0
    with np.errstate(all="ignore"):
        scale = 1.0 / np.sqrt(np.diag(R))
        scaled = R * np.outer(scale, scale)
    try:
        L = np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:
        return 0.0, 0  # far outside the model a covariance is none: such a result has failed, and says so
    H = np.linalg.solve(L, solution.playback.H[:, ~held] * scale[:, None])
    y = np.linalg.solve(L, z * scale)
    orthonormal, _ = np.linalg.qr(H / np.linalg.norm(H, axis=0))
    y = y - orthonormal @ (orthonormal.T @ y)
    return float(y @ y), len(z) - int((~held).sum())


def is_misfit(statistic: float, freedom: int) -> bool:
    """Whether residuals are larger than chance makes them once in a thousand recordings."""
    return freedom > 0 and statistic > float(chdtri(freedom, MISFIT_PROBABILITY))


@cache
def software() -> str:
    """Name and version of this software, as a calibration's provenance states it."""
    try:
        return f"strapdown-rotation-test {version('strapdown-rotation-test')}"
    except ModuleNotFoundError:  # importlib.metadata.PackageNotFoundError, a source tree that is not installed
        return "strapdown-rotation-test (not installed)"


def _residuals(data: PlaybackData, solution: Solution) -> tuple[Residual, ...]:
    """What the last play-back left, with the sigma it should have: zero where a component is solved exactly."""
    z, sigma = solution.playback.z, np.sqrt(np.maximum(np.diag(solution.residual_covariance), 0.0))
    own = np.sqrt(np.diag(solution.measurement_covariance))
    sigma[sigma < 1e-6 * own] = 0.0
    rows = []
    for k, name in enumerate(data.ids):
        sequence = data.catalogue[k]
        horizontal = ("1", "2") if sequence is None else sequence.horizontal
        for j, axis in enumerate(horizontal):
            rows.append((name, data.occurrences[k], f"horizontal_{axis}", 2 * k + j))
        for label, w in (("start_down", data.start[k]), ("end_down", data.end[k])):
            rows.append((name, data.occurrences[k], label, 2 * data.K + int(w)))
    return tuple(Residual(n, o, c, float(z[i]), float(sigma[i])) for n, o, c, i in rows)


def _site(data: PlaybackData) -> dict[str, Any]:
    site = data.recording.site
    return {
        "latitude_deg": None if site.latitude_rad is None else float(np.degrees(site.latitude_rad)),
        "gravity_m_s2": site.gravity_m_s2,
        "gravity_sigma_m_s2": site.gravity_sigma_m_s2,
    }


def _noise(data: PlaybackData, outcome: Outcome, inflation: float) -> dict[str, Any]:
    noise = data.noise
    return {
        "gyro_noise_rad_per_sqrt_s": noise.gyro_white.tolist(),
        "accel_noise_m_s2_sqrt_s": noise.accel_white.tolist(),
        "gyro_reading_error_rad": noise.gyro_edge.tolist(),
        "accel_reading_error_m_s": noise.accel_edge.tolist(),
        "gyro_bias_wander_rad_s": outcome.wander.tolist(),
        "accel_bias_wander_m_s2": noise.accel_wander.tolist(),
        "estimated": list(noise.estimated),
        "floored": list(noise.floored),
        "sigma_inflation": inflation,
        "gyro_bias_by_sequence_rad_s": outcome.bias_by_sequence.tolist(),
    }


def _shared_errors(outcome: Outcome, mask: Mask, inflation: float) -> dict[str, Any]:
    """What other recordings of the unit have in common with this one, and no mean takes away.

    ``gravity_effect`` is what one sigma of gravity does to every parameter; of held values it is the covariance.
    """
    out: dict[str, Any] = {}
    gravity, by_held = (
        np.where(mask, outcome.covariance.get(source, 0.0), 0.0) * inflation**2 for source in ("gravity", "held_values")
    )
    most = int(np.argmax(np.diag(gravity)))
    if gravity[most, most] > 0.0:
        effect = gravity[most] / np.sqrt(gravity[most, most])
        scale = effect[GROUP_SLICES["accel_scale"]].sum()
        out["gravity_effect"] = (effect * (-1.0 if scale < 0.0 else 1.0)).tolist()
    if by_held.any():
        out["held_values_covariance"] = by_held.tolist()
    return out


def _alignment(data: PlaybackData) -> dict[str, Any]:
    fixture = data.recording.fixture
    if fixture is None:
        return {"fixture": False}
    wobble = {} if fixture.wobble_sigma_rad is None else {"wobble_sigma_mrad": fixture.wobble_sigma_rad * 1e3}
    return {
        "fixture": True,
        "heading_deg": None if fixture.heading_rad is None else float(np.degrees(fixture.heading_rad)),
        "alignment_sigma_mrad": fixture.alignment_sigma_rad * 1e3,
        "rotation_sigma_mrad": fixture.rotation_sigma_rad * 1e3,
        **wobble,
    }


def _temperature(data: PlaybackData) -> dict[str, Any] | None:
    T = data.recording.temperature
    if T is None:
        return None
    samples = data.windows.samples
    rows = []
    for k, name in enumerate(data.ids):
        part = T[samples[data.start[k], 0] : samples[data.end[k], 1]]
        low, high = float(part.min()), float(part.max())
        rows.append(
            {
                "sequence": name,
                "occurrence": data.occurrences[k],
                "mean_c": float(part.mean()),
                "range_c": high - low,
            }
        )
    return {"mean_c": float(T.mean()), "range_c": float(T.max() - T.min()), "sequences": rows}


def _warnings(data: PlaybackData, outcome: Outcome, observed: Mask) -> tuple[str, ...]:
    said = [f"{title} is void: {reason}." for title, reason in data.voided.items()]
    if outcome.integrated and len(outcome.integrated) < len(data.windows.duration_s):
        times = ", ".join(f"{data.recording.time[data.windows.samples[w, 0]]:.5g} s" for w in outcome.integrated)
        said.append(
            f"The unit did not stand quite still in the windows from {times}: their attitude was integrated, not held."
        )
    if outcome.status in ("converged", "partial", "not_converged"):
        said += wrong_turns(data, outcome.turned, outcome.U)
    if outcome.solution is not None and outcome.status in ("converged", "partial"):
        said += g_sensitivity_report.warnings(data, outcome.solution.playback)
    if data.recording.site.latitude_rad is None:
        said.append("No latitude is given: the Earth's rate is a bounded unknown in the gyro-bias sigma.")
    if data.noise.floored:
        said.append(
            f"The noise of {', '.join(data.noise.floored)} was raised to the floor (resolution, or 1e-10 rad/√s and "
            "1e-9 g·√s)."
        )
    lost = int(N_PARAMETERS - observed.sum())
    if lost:
        said.append(f"{lost} of {N_PARAMETERS} parameters are held, not observed; their values are the start's.")
    return tuple(said)
