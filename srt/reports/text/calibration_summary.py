"""Summary of a calibration: status, verdict and advice in a few lines, then the table of the 27 parameters."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtri

from srt.constants import DEG_PER_H, DEG_PER_SQRT_H, MICRO_G
from srt.reports.parameters import group_heads, group_sigmas, units_for
from srt.reports.tables import WIDTH, decimals_for, fixed, text_table, wrap
from srt.reports.text.calibration import heading, held_summary, parameter_table, report, time_base
from srt.result.verdict import FAILED, SOUND, probability_text
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from srt.result.calibration import Calibration
    from srt.result.noise_figures import NoiseFigures
    from srt.sensor_errors import SensorErrors

PROBABILITY: Final = 0.95
"""Probability that the largest of the normalised errors stays below the bound that is stated."""
_MOST_LINES: Final = 41
"""Lines of the summary: the four that the command adds make 45, which a terminal of 50 lines shows with the prompt."""
_MOST_BEFORE_TABLE: Final = 9  # lines before the table of the parameters, below the fitness
_NOTE_LINES: Final = 2  # lines of one note; --details shows it whole
_MORE: Final = " ..."  # mark of a text that is cut; --details shows all of it
_ESTIMATE, _SCATTER = "estimated here:", "scatter of the biases here:"
_STATED_NOISE: Final = {
    "gyro_noise": ("gyro_noise_deg_per_sqrt_h", "gyro_noise_rad_per_sqrt_s", DEG_PER_SQRT_H, _ESTIMATE),
    "accel_noise": ("accel_noise_ug_per_sqrt_hz", "accel_noise_m_s2_sqrt_s", MICRO_G, _ESTIMATE),
    "gyro_bias_instability": ("gyro_bias_instability_deg_per_h", "gyro_bias_wander_rad_s", DEG_PER_H, _SCATTER),
    "accel_bias_instability": ("accel_bias_instability_ug", "accel_bias_wander_m_s2", MICRO_G, _SCATTER),
}
"""Keys of [imu] in recording.toml that replace an estimate: field of the estimate, unit in SI, and what it is.

The biases of the sequences scatter by more than the bias instability, as windows and test take long."""
_QUANTIZATION: Final = {"gyro_quantization", "accel_quantization"}


def calibration_summary(
    calibration: Calibration,
    *,
    title: str = "Calibration",
    truth: SensorErrors | None = None,
    source: str = "",
) -> str:
    """Status, verdict and advice, then the table of the parameters, in lines of at most 80 characters.

    ``title`` is the path of the recording; ``truth`` adds columns of the truth, the error, and the error over sigma;
    ``source`` is the path of the recording for the command that looks for faults; empty: none.
    """
    calibration = calibration.as_written
    head = [line for text in verdict_lines(calibration, title) for line in wrap(text)]
    advice = [line for text in _advice(calibration, source) for line in wrap(text)]
    notes = [line for text in _notes(calibration) for line in _shortened(wrap(text), _NOTE_LINES)]
    lines = [*head, *_shortened(notes, _MOST_BEFORE_TABLE - len(head) - len(advice)), *advice]
    parameters, gap = parameter_table(calibration, truth), 1 if truth is not None else 2
    shown = parameters.text(gap=gap)
    if len(lines) + 1 + len(shown.splitlines()) > _MOST_LINES:
        shown = parameters.text(gap=gap, grouped=False)
    tables = (live_table(calibration), shown)
    return "\n".join([*lines, *(f"\n{table}" for table in tables if table)])


def calibration_text(
    calibration: Calibration,
    *,
    title: str,
    truth: SensorErrors | None = None,
    source: str = "",
    details: bool = False,
    budget: bool = False,
    verdict: bool = False,
) -> str:
    """Summary of a calibration; with one of the flags, the whole report."""
    if details or budget or verdict:
        return report(calibration, title=title, truth=truth, budget=budget, verdict=verdict)
    return calibration_summary(calibration, title=title, truth=truth, source=source)


def calibration_html(calibration: Calibration) -> str:
    """Status and verdict of a calibration, and the table of its parameters."""
    calibration = calibration.as_written
    lines = "<br>".join(map(escape, verdict_lines(calibration, "Calibration")))
    return f"<p>{lines}</p>{parameter_table(calibration).html()}"


def live_table(calibration: Calibration) -> str:
    """Sigmas after each sequence of a live filter; empty without one."""
    reports = calibration.diagnostics.live
    if not reports:
        return ""
    units = units_for(calibration.errors.vector)
    rows = [
        [report.sequence, probability_text(report.probability), *group_sigmas(report.sigma, units)]
        for report in reports
    ]
    met = next((report.sequence for report in reports if report.targets_met), None)
    heads = ["seq.", "p", *group_heads(units)]
    lines = [
        *wrap("Largest 1-sigma of each group after each sequence; p of its innovations given all sequences before"),
        text_table(heads, rows, "l" + "r" * (len(heads) - 1), gap=1),
    ]
    if calibration.diagnostics.targets:
        lines += wrap("The targets are not met." if met is None else f"All targets are met after sequence {met}.")
    return "\n".join(lines)


def largest_error_text(calibration: Calibration, truth: SensorErrors) -> str:
    """Sentences, wrapped, on the largest normalised error and the bound that chance explains.

    The bound x solves (2Φ(x) − 1)^n = 0.95. That is exact for n independent normal errors; for correlated ones the
    probability of staying below it is at least as large (Šidák's inequality).
    """
    seen = np.flatnonzero(calibration.observed)
    ratio = np.abs(calibration.errors.vector - truth.vector)[seen] / calibration.sigma[seen]
    n, worst = len(seen), int(np.argmax(ratio))
    bound = float(ndtri(0.5 + 0.5 * PROBABILITY ** (1.0 / n)))
    agrees = "agrees with the truth" if ratio[worst] <= bound else "does not agree with the truth at the 95 % level"
    return "\n".join(
        wrap(
            f"The largest error is {ratio[worst]:.2f} sigma ({NAMES[seen[worst]]}); the largest of {n} "
            f"normal draws stays below {bound:.2f} sigma in {PROBABILITY:.0%} of all runs or more, "
            f"so this run {agrees}."
        )
    )


def verdict_lines(calibration: Calibration, title: str) -> Iterator[str]:
    """Heading, time base that is not stated, status, and agreement of the measurements."""
    yield heading(calibration, title)
    if exact := time_base(calibration):
        yield exact
    message = calibration.message.split(" Fixed, not observed:")[0].split(" Held, not observed:")[0]
    yield message if calibration.status == "converged" else f"Status {calibration.status.replace('_', ' ')}: {message}"
    judgement = calibration.judgement
    # A failed status is its own reason, and the line before it holds that.
    yield f"Verdict: {judgement.word}" if judgement.word == FAILED else f"Verdict: {judgement}"


def _notes(calibration: Calibration) -> Iterator[str]:
    """Warnings, the temperature of values that depend on it, and the parameters that are fixed with the reason."""
    if (thermal := calibration.thermal) is not None:
        middle = 0.5 * (thermal.lowest_c + thermal.highest_c)
        yield f"Note: the values are those at {middle:.1f} °C, the middle of the range; at(T) gives those of another."
    if calibration.fixed and calibration.has_values:
        yield f"Fixed, not observed: {held_summary(calibration)}."
    yield from (f"Note: {sentence}" for sentence in calibration.warnings)


def _advice(calibration: Calibration, source: str) -> Iterator[str]:
    """Next steps for the user."""
    estimated = [name for name in _STATED_NOISE if name in (calibration.noise.estimated or ())]
    if {"gyro_noise", "accel_noise"} & {*estimated} or (estimated and calibration.judgement.word != SOUND):
        yield from _noise_to_state(calibration.noise, estimated)
    if source and (calibration.judgement.word != SOUND or calibration.warnings):
        yield f"To do: look for faults of the recording with 'srt inspect {source} --deep'."
    if moves := calibration.diagnostics.unused_moves:
        low, high = calibration.diagnostics.sigma_with_moves or (0.0, 0.0)
        gain = f"gives {low:.2f}-{high:.2f} of these sigmas" if high else "uses them"
        yield f"To do: {moves} recorded moves are not used by the closed form: '--estimator least-squares' {gain}."


def _noise_to_state(noise: NoiseFigures, estimated: Sequence[str]) -> Iterator[str]:
    """Lines to paste into recording.toml: keys without a value, and the estimates as comments.

    An estimate is no statement: in place of the data sheet's value, the same readings would count twice.
    """
    absent = {*_STATED_NOISE, *_QUANTIZATION} <= {*(noise.estimated or ())}
    where = "[imu]  # To do: add this to" if absent else "# To do: add this below [imu] of"
    yield f"{where} recording.toml, with values of the data sheet"
    for key, figure, unit, what in map(_STATED_NOISE.__getitem__, estimated):
        found = getattr(noise, figure)
        size = 0.0 if found is None else float(np.max(found)) / unit
        yield f"{key + ' =':<36}{f'# {what} {fixed(size, decimals_for(size))}' * (size > 0.0)}".rstrip()


def _shortened(lines: list[str], most: int) -> list[str]:
    """First lines of a text, with a mark where it goes on."""
    if len(lines) <= most or most <= 0:
        return lines[: max(most, 0)]
    last = lines[most - 1].removesuffix(_MORE)
    while len(last) + len(_MORE) > WIDTH:
        last = last.rpartition(" ")[0]
    return [*lines[: most - 1], last + _MORE]
