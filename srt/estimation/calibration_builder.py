"""Construction of a calibration from a solver result: status, covariance, warnings and provenance."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from srt.estimation.asymmetry_choice import asymmetry_choice
from srt.estimation.error_sources import EXCESSES, alignment_sigma, as_found, start_sigma, turns_estimated
from srt.estimation.fixed_parameters import parameters_due
from srt.estimation.goodness_of_fit import chi_square_probability, is_misfit
from srt.estimation.leave_one_out import consistency
from srt.estimation.rotation_accuracy import ExecutedRotations
from srt.estimation.unseen_errors import clock_effect, contradicted_statements, unseen_errors
from srt.result.calibration import Calibration, software
from srt.result.consistency import AddedNoise, ChiSquareTest
from srt.result.diagnostics import Undersampling
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Alignment, Provenance, SequenceTemperature, StatedSite, Temperature
from srt.result.verdict import LARGEST_RATIO, OF_FIXTURE, USABLE, p_value_text
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from srt.estimation.options import Options
    from srt.estimation.solver_result import SolverResult
    from srt.recording.recording import Recording
    from srt.result.consistency import Consistency
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array, Mask


def build_calibration(
    estimator: str,
    data: PreparedRecording,
    options: Options,
    result: SolverResult,
    fixed: Mapping[str, str],
    *,
    warnings: tuple[str, ...] = (),
) -> Calibration:
    """Build the calibration of a solver result.

    Parameters
    ----------
    estimator : str
    data : PreparedRecording
    options : Options
    result : SolverResult
    fixed : mapping of str to str
        Parameters not observed, with the reason.
    warnings : tuple of str
    """
    if result.status == "outside_model":
        fixed = dict.fromkeys(NAMES, "the iteration ended where the model does not hold")
    observed = np.array([name not in fixed for name in NAMES])
    inflation = _birge_ratio(result)
    drifted = _drifted_bias(data, result)
    total = drifted + (sum(result.covariance.values()) if result.total is None else result.total)
    covariance = reported_covariance(data, total, observed, inflation)
    chi_square, freedom = result.chi_square, result.degrees_of_freedom
    free = data.recording.fixture is None
    turned = ExecutedRotations(data, result, np.sqrt(np.diag(covariance)))
    evidence = None
    if observed.any():
        turns, changed = turns_estimated(data), result.scale_change
        against = -math.inf if changed is None else changed.gain
        statistics = observed, chi_square, freedom
        evidence = consistency(result.sequences, covariance, *statistics, estimated_from=turns, against=against)
        if _unmodelled_drift(result):  # it is in the residuals of all sequences
            evidence = replace(evidence, contradicting=None)
        evidence = _with_sensor_noise(evidence, data, result, covariance, observed, inflation, turned)
    contradicted = tuple(contradicted_statements(data.recording))
    status, message = _status(result, fixed, evidence, free=free, advice=_advice(data))
    return Calibration(
        estimator=estimator,
        status=status,
        message=message,
        errors=result.errors,
        covariance=covariance,
        corrections=result.corrections,
        fixed={name: fixed[name] for name in NAMES if name in fixed},
        contributions=_contributions(result, drifted, clock_effect(data), observed, inflation),
        U=None if data.nominal is None else result.U,
        U_sigma_rad=_mounting_sigma(data, result),
        residuals=result.residuals,
        site=stated_site(data.recording),
        noise=_noise(data, result, np.outer(observed, observed), inflation),
        alignment=stated_alignment(data.recording),
        temperature=_temperature(data),
        provenance=_provenance(data, options),
        diagnostics=replace(
            result.diagnostics,
            # Far from a solution the covariance may be singular.
            asymmetry=asymmetry_choice(result.errors, covariance, observed) if result.status == "converged" else {},
            unseen_errors=unseen_errors(as_found(data, result.unmodelled), observed),
            contradicted=(*contradicted, *_scale_change(result)) or None,
            not_shown=_not_shown(data, options, fixed),
            refits=result.refits or None,
            undersampling=_undersampling(data),
        ),
        consistency=evidence,
        warnings=(*contradicted, *warnings, *_warnings(data, result, observed, turned)),
    )


def _undersampling(data: PreparedRecording) -> Undersampling | None:
    """Error of the rotations by motion too fast, or by integration; None unless residuals show it."""
    if data.undersampling is None:
        return None
    rms = float(np.sqrt(np.mean(data.fast_motion**2)))
    return Undersampling(share=data.undersampling, angle_rad=data.undersampling * rms, noise_free=data.noise.noise_free)


def reported_covariance(data: PreparedRecording, total: Array, observed: Mask, inflation: float = 1.0) -> Array:
    """Covariance (27, 27) of the observed parameters as results state it: with inflated sigmas, and the clock's error.

    An error of the time scale is common to all measurements: the residuals do not show it, so the Birge ratio does not
    include it.
    """
    clock = clock_effect(data)
    covariance = np.where(np.outer(observed, observed), total * inflation**2 + np.outer(clock, clock), 0.0)
    return np.asarray(0.5 * (covariance + covariance.T))


def partial_or_converged(message: str, fixed: Collection[str]) -> tuple[str, str]:
    """Status and message of a converged result that nothing contradicts, by the parameters that are fixed."""
    return ("partial", f"{message} Fixed, not observed: {', '.join(fixed)}.") if fixed else ("converged", message)


def _not_shown(data: PreparedRecording, options: Options, fixed: Mapping[str, str]) -> tuple[str, ...] | None:
    """Parameters fixed for want of data that a recording of this kind should show; None without."""
    due = parameters_due(data)
    names = [name for name, needed in zip(NAMES, due, strict=True) if needed and name in fixed]
    return tuple(name for name in names if name not in options.fixed_names) or None


def _contributions(
    result: SolverResult, drifted: Array, clock: Array, observed: Mask, inflation: float
) -> dict[str, Array]:
    """Standard deviations of the parameters by source of error."""
    parts = {**result.covariance, "gyro_drift": drifted} if drifted.any() else result.covariance
    out = {
        source: np.where(observed, np.sqrt(np.maximum(np.diag(P), 0.0)) * inflation, 0.0) for source, P in parts.items()
    }
    return out | ({"clock": np.where(observed, np.abs(clock), 0.0)} if clock.any() else {})


def _drifted_bias(data: PreparedRecording, result: SolverResult) -> Array:
    """Covariance of the gyro bias by a modelled drift, shape (27, 27), where no bias instability is stated.

    The bias of this test is one sample of that of the unit. A steady change c has the standard deviation c/√12.
    """
    out = np.zeros((N_PARAMETERS, N_PARAMETERS))
    if data.noise.gyro_flicker is None:
        at = np.r_[GROUP_SLICES["gyro_bias"]]
        for term in result.drift:
            if term.modelled and term.sensor == "gyro":
                out[at, at] += term.change**2 / 12.0
    return out


def _mounting_sigma(data: PreparedRecording, result: SolverResult) -> float | None:
    """1-sigma of the mounting, rad; None without a fixture."""
    return None if data.nominal is None else alignment_sigma(as_found(data, result.unmodelled).recording)


def _birge_ratio(result: SolverResult) -> float:
    """Factor √(χ² / degrees of freedom) on all sigmas if the residuals exceed the noise, else 1.

    It is that of the specific forces if theirs is larger: gyros without excess noise must not hide that of the others.
    """
    fits = ((result.chi_square, result.degrees_of_freedom), result.force_fit)
    misfit = result.status == "converged" and is_misfit(*fits[0])
    return float(np.sqrt(max(chi_square / max(freedom, 1) for chi_square, freedom in fits))) if misfit else 1.0


def _advice(data: PreparedRecording) -> str:
    """Advice on a sequence that contradicts all others; the braces are for the option that leaves it out."""
    rated = ", and the stated rates about its axis" if any(label.rate for label in data.labels) else ""
    return (
        f"check its label, windows and rotation{rated}, and repeat it, or leave it out: '{{}}'. "
        "'--estimator graph --loss cauchy' gives it less weight."
    )


def _leaving_out(name: str) -> str:
    """Option of the command that leaves out a turn, pose, move or sequence."""
    if name.startswith("move "):
        return "--ignore-moves"
    bare = name.removeprefix("turn ").removeprefix("pose ")
    return f'--without-turn "{bare}"' if " " in bare else f"--without-turn {bare}"


def _status(
    result: SolverResult, fixed: Mapping[str, str], evidence: Consistency | None, *, free: bool, advice: str = ""
) -> tuple[str, str]:
    """Status and message: outside_model, not_converged, inconsistent, partial, converged, in this order.

    Without a fixture nothing bounds the errors of a rotation, and added noise that explains the residuals of several
    rotations is no contradiction, however large; nor is that of a fixture alone.
    """
    if result.status != "converged":
        return result.status, result.message
    suspect = None if evidence is None else evidence.contradicting
    robust = result.diagnostics.weights is not None  # a robust loss has reduced the weight of what contradicts
    if suspect is not None and not robust:
        again = f" (occurrence {suspect.occurrence})" if suspect.occurrence > 1 else ""
        numbered = suspect.sequence.startswith(("turn ", "pose ", "move "))
        which = suspect.sequence.capitalize() if numbered else f"Sequence {suspect.sequence}"
        return "inconsistent", (
            f"{which}{again} contradicts all others ({p_value_text(suspect.probability)}): "
            f"{advice.format(_leaving_out(suspect.sequence))}"
        )
    by_fixture = any(result.unmodelled) and not any(result.unmodelled.of_sensors)
    fits = not is_misfit(result.chi_square, result.degrees_of_freedom)
    explained = robust or evidence is None or ((free or by_fixture) and fits)
    statistic, freedom = result.sensor_noise_fit
    ratio, grown = np.sqrt(statistic / max(freedom, 1)), 1.0
    if evidence is not None and evidence.sigma_factor is not None:
        grown = evidence.sigma_factor[1]
    if is_misfit(statistic, freedom) and max(ratio, grown) > LARGEST_RATIO and not explained:
        if drift := _unmodelled_drift(result):
            return "inconsistent", drift
        # The noise of the rotations can be exceeded by far where that of the windows, in most residuals, is not.
        size = (
            f"The residuals are {ratio:.2g} times as large as the sensors' own noise explains"
            if ratio > LARGEST_RATIO
            else f"The noise that the residuals show makes sigmas {grown:.2g} times those of the sensors' own noise"
        )
        causes = (
            f"a wrong label, motion in windows, a wrong minimum, "
            f"{'a parameter fixed at a wrong value, ' if fixed else ''}noise stated far too small, or a unit that the "
            "sensor model does not describe."
        )
        causes = next(iter(_scale_change(result)), causes)
        return "inconsistent", f"{size} (chi-square {statistic:.4g} for {freedom} degrees of freedom): {causes}"
    return partial_or_converged(result.message, fixed)


def _scale_change(result: SolverResult) -> tuple[str, ...]:
    """Sentence on a change of scale factors, which may leave residuals that agree; empty without one."""
    changed = result.scale_change
    return () if changed is None or not changed.named else (f"{changed.sentence}.",)


def _unmodelled_drift(result: SolverResult) -> str:
    """Sentences on drift that the residuals show and the estimate does not include; empty without."""
    if all(row.modelled for row in result.diagnostics.drift or ()):
        return ""
    return " ".join(term.sentence for term in result.drift if not term.modelled)


def _with_sensor_noise(
    evidence: Consistency,
    data: PreparedRecording,
    result: SolverResult,
    covariance: Array,
    observed: Mask,
    inflation: float,
    turned: ExecutedRotations,
) -> Consistency:
    """Add the agreement of the residuals with the noise of the sensors, and what was added to it."""
    statistic, freedom = result.sensor_noise_fit
    noise = {
        kind: AddedNoise(added=size, own=own)
        for (kind, own), size in zip(_sensor_noise(data).items(), result.unmodelled, strict=True)
        if size > 0.0 or kind not in OF_FIXTURE
    }
    if turned.excess > 0.0:
        noise["turned_angle_rad"] = AddedNoise(added=turned.excess, own=turned.stated)
    of_unit = [source for source, size in zip(EXCESSES, result.unmodelled.of_unit, strict=True) if size > 0.0]
    added = sum(
        (result.covariance[source] for source in of_unit if source in result.covariance), np.zeros_like(covariance)
    )
    variance = np.diag(covariance)[observed]
    own_part = np.maximum(variance / inflation**2 - np.diag(added)[observed], 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.sqrt(variance / own_part)
    factor = factor[np.isfinite(factor)]
    return replace(
        evidence,
        own_noise=ChiSquareTest(
            chi_square=statistic,
            degrees_of_freedom=freedom,
            probability=chi_square_probability(statistic, freedom),
        ),
        added_noise=noise if any(row.added > 0.0 for row in noise.values()) else None,
        sigma_factor=(float(factor.min()), float(factor.max())) if factor.size else (1.0, 1.0),
    )


def _sensor_noise(data: PreparedRecording) -> dict[str, float]:
    """1-sigma noise in a rotation (rad), in mean force and rate of a window (m/s², rad/s); of the fixture (rad).

    The order is that of :class:`srt.estimation.error_sources.UnmodelledErrors`.
    """
    noise, windows = data.noise, data.windows.duration_s
    turning = np.diff(data.rotation, axis=1) * data.recording.nominal_interval_s
    window = float(np.median(windows))
    return {
        "rotation_rad": float(noise.gyro_white.max() * np.sqrt(np.median(turning))),
        "force_m_s2": float(np.hypot(noise.accel_white / np.sqrt(window), noise.accel_flicker).max()),
        "rate_rad_s": float(noise.gyro_white.max() / np.sqrt(window)),
        "wobble_rad": float(start_sigma(data.recording)[2]),
        "start_angle_rad": float(start_sigma(data.recording)[0]),
        "alignment_rad": alignment_sigma(data.recording),
    }


def _provenance(data: PreparedRecording, options: Options) -> Provenance:
    applied = data.recording.applied
    return Provenance(
        data_sha256=data.recording.data_sha256,
        software=software(),
        serial=data.recording.serial,
        date=data.recording.date,
        options=options.as_dict(),
        voided=data.voided,
        applied=None if applied is None else applied.document(),
    )


def stated_site(recording: Recording) -> StatedSite:
    """Site of a recording, as the result states it."""
    site = recording.site
    return StatedSite(
        latitude_deg=None if site.latitude_rad is None else float(np.degrees(site.latitude_rad)),
        gravity_m_s2=site.gravity_m_s2,
        gravity_sigma_m_s2=site.gravity_sigma_m_s2,
        latitude_sigma_deg=None if site.latitude_sigma_rad is None else float(np.degrees(site.latitude_sigma_rad)),
        gravity_sigma_origin=site.gravity_sigma_origin,
    )


def _noise(data: PreparedRecording, result: SolverResult, mask: Mask, inflation: float) -> NoiseFigures:
    noise = data.noise
    gyro_filter_s, accel_filter_s = (filter_s if filter_s > 0.0 else None for filter_s in noise.filter_s.tolist())
    gravity_effect, by_fixed = _shared_errors(result, mask, inflation)
    return NoiseFigures(
        gyro_filter_s=gyro_filter_s,
        accel_filter_s=accel_filter_s,
        gyro_noise_rad_per_sqrt_s=noise.gyro_white,
        accel_noise_m_s2_sqrt_s=noise.accel_white,
        gyro_reading_error_rad=noise.gyro_edge,
        accel_reading_error_m_s=noise.accel_edge,
        gyro_bias_wander_rad_s=result.wander,
        accel_bias_wander_m_s2=noise.accel_wander,
        estimated=noise.estimated,
        floored=noise.floored,
        sigma_inflation=inflation,
        gyro_bias_by_sequence_rad_s=result.bias_by_sequence,
        chi_square=result.chi_square,
        degrees_of_freedom=result.degrees_of_freedom,
        gravity_effect=gravity_effect,
        held_values_covariance=by_fixed,
    )


def _shared_errors(result: SolverResult, mask: Mask, inflation: float) -> tuple[Array | None, Array | None]:
    """Errors that all recordings of the unit share, so that averaging recordings does not reduce them.

    They are the effect of 1 sigma of gravity on every parameter, and the covariance due to fixed values; None without.
    """
    effect = None
    gravity, by_fixed = (
        np.where(mask, result.covariance.get(source, 0.0), 0.0) * inflation**2 for source in ("gravity", "held_values")
    )
    most = int(np.argmax(np.diag(gravity)))
    if gravity[most, most] > 0.0:
        effect = gravity[most] / np.sqrt(gravity[most, most])
        scale = effect[GROUP_SLICES["accel_scale"]].sum()
        effect = effect * (-1.0 if scale < 0.0 else 1.0)
    return effect, by_fixed if by_fixed.any() else None


def stated_alignment(recording: Recording) -> Alignment:
    """Fixture of a recording, as the result states it."""
    fixture = recording.fixture
    if fixture is None:
        return Alignment(fixture=False)
    return Alignment(
        fixture=True,
        heading_deg=None if fixture.heading_rad is None else float(np.degrees(fixture.heading_rad)),
        alignment_sigma_mrad=fixture.alignment_sigma_rad * 1e3,
        rotation_sigma_mrad=fixture.rotation_sigma_rad * 1e3,
        wobble_sigma_mrad=None if fixture.wobble_sigma_rad is None else fixture.wobble_sigma_rad * 1e3,
        nulls=("heading_deg",),
    )


def _temperature(data: PreparedRecording) -> Temperature | None:
    T = data.recording.temperature
    if T is None:
        return None
    samples = data.windows.samples
    rows = []
    for k, name in enumerate(data.ids):
        part = T[samples[data.start[k], 0] : samples[data.end[k], 1]]
        low, high = float(part.min()), float(part.max())
        rows.append(
            SequenceTemperature(
                sequence=name, occurrence=data.occurrences[k], mean_c=float(part.mean()), range_c=high - low
            )
        )
    return Temperature(float(T.mean()), float(T.max() - T.min()), tuple(rows))


def _warnings(
    data: PreparedRecording, result: SolverResult, observed: Mask, turned: ExecutedRotations
) -> tuple[str, ...]:
    messages = [f"{title} is void: {reason}." for title, reason in data.voided.items()]
    if result.integrated and len(result.integrated) < len(data.windows.duration_s):
        times = ", ".join(f"{data.recording.time[data.windows.samples[w, 0]]:.5g} s" for w in result.integrated)
        messages.append(
            f"The unit moved in the stationary windows from {times}; their attitude was integrated, not kept fixed."
        )
    messages += [term.sentence for term in result.drift]
    messages += _scale_change(result)
    if (slow := _undersampling(data)) is not None and not slow.noise_free:
        rate = 1.0 / data.recording.nominal_interval_s
        messages.append(
            f"The readings are too slow for these turns: motion faster than half of {rate:.3g} Hz is missed, "
            f"{np.degrees(slow.angle_rad):.2g}° per turn, which is in the sigmas. Set the low-pass of the sensor to a "
            f"third of the rate ({rate / 3.0:.2g} Hz) or less, log faster, or turn more softly."
        )
    if result.status in (*USABLE, "not_converged"):
        messages += turned.wrong_angles(result.unmodelled)
    if result.status in USABLE:
        messages += result.notes
    if data.recording.site.latitude_rad is None:
        messages.append("No latitude is given: the gyro-bias sigma includes the whole Earth rate as an unknown.")
    if data.noise.floored:
        messages.append(
            f"The {', '.join(data.noise.floored)} was raised to the lower limit (resolution of the readings, or 1e-10 "
            "rad/√s and 1e-9 g·√s)."
        )
    if data.noise.undithered:
        messages.append(
            f"The readings of {', '.join(data.noise.undithered)} have steps of more than twice their noise, so that "
            "their means at rest are off by a part of a step. It is corrected where noise shows it, and sigmas contain "
            "the remainder; record with a finer resolution."
        )
    fixed = int(N_PARAMETERS - observed.sum())
    if fixed and result.status != "outside_model":
        messages.append(f"{fixed} of {N_PARAMETERS} parameters are not observed; they are fixed.")
    return tuple(messages)
