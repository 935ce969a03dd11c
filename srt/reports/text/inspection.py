"""Text of an inspection: overview of the recording, noise, rotations and findings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from srt.constants import DEG_PER_H
from srt.diagnosis.faults import FAULTS
from srt.noise.allan import CHANNELS, TERMS
from srt.reports.tables import text_table, wrap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from srt.reports.inspection import Inspection, ManoeuvreSummary
    from srt.result.diagnostics import RunnerUp

_LABEL: Final = 13  # width of the labels of the overview, characters
_MOST_TURNS: Final = 60  # largest number of rotations in the table; the JSON form holds all
_LEGS_WIDTH: Final = 32
_LABEL_WIDTH: Final = 9
"""Widths of the columns of axes with angles and of labels, characters: the table fits within 80."""
_SHOWN: Final = TERMS[:3]
_DISPLAY: Final = {"accel_quantization_m_s": ("µm/s", 1e6), "gyro_quantization_arcsec": ("arcsec", 1.0)}
"""Units of the table where they differ from those of the key."""

_EFFECTS: Final = {"exit 2": "Refused", "exit 1": "Refused", "warning": "Warning", "note": "Note"}


def inspection_report(inspection: Inspection, *, title: str = "Inspection") -> str:
    """Text of the whole report, in lines of at most 80 characters, without a line feed at the end."""
    serial = f" (serial {inspection.serial})" if inspection.serial else ""
    parts = [
        "\n".join([*wrap(str(inspection.fitness)), *wrap(f"{title}{serial}"), *_overview(inspection)]),
        "\n".join(_noise(inspection)),
        "\n".join(_turns(inspection)),
        "\n".join(_findings(inspection)),
    ]
    return "\n\n".join(part for part in parts if part)


def inspection_summary(inspection: Inspection, *, title: str, reworded: Callable[[str], str] = str) -> str:
    """Overview of the recording and findings (``reworded``), without the tables, in lines of at most 80 characters."""
    head = [*wrap(reworded(str(inspection.fitness))), *wrap(title)]
    return "\n".join([*head, *_overview(inspection), *_findings(inspection, reworded)])


def significant(value: float, digits: int = 3) -> str:
    """Text of a number with the given number of digits, without an exponent if that is readable."""
    text = f"{value:#.{digits}g}"
    if "e" in text:
        text = f"{value:.0f}" if abs(value) >= 1.0 else f"{value:.{digits - 1}e}"
    return text.rstrip(".")


def _line(label: str, text: str) -> Iterable[str]:
    """Lines of an entry of the overview, indented under its text."""
    first, *more = wrap(text, " " * _LABEL) or [" " * _LABEL]
    yield f" {label:<{_LABEL - 1}}{first[_LABEL:]}"
    yield from (line[2:] for line in more)


def _overview(inspection: Inspection) -> Iterable[str]:
    stamps, still = inspection.stamps, inspection.stillness
    covers = "means over each interval" if inspection.kind == "rate" else "integrals over each interval"
    length = _duration(stamps.duration_s) + (" with the gaps" if stamps.gaps else "")
    yield from _line("Samples", f"{stamps.samples}, kind {inspection.kind} ({covers}), {length}")
    even = "evenly spaced" if stamps.even else f"unevenly spaced, by {stamps.jitter:.2%} of an interval (rms)"
    yield from _line("Rate", f"{stamps.rate_hz:.6g} Hz, {even}")
    yield from _line("Gaps", _gaps(inspection))
    if inspection.units:
        named = {"gyro": "gyros", "accel": "accelerometers", "time": "time"}
        yield from _line("Units", ", ".join(f"{named[k]} {unit}" for k, unit in inspection.units.items()) + " declared")
    if still is not None:
        low, middle, high = still.force_g
        span = f" ({low:.4f} to {high:.4f} by pose)" if len(still.windows_s) > 1 else ""
        rate = ", ".join(f"{axis} {significant(r)}" for axis, r in zip("xyz", still.rate_deg_per_h, strict=True))
        yield from _line("At rest", f"accelerometers {middle:.4f} g{span}; gyros {rate} °/h, the Earth's part included")
    if inspection.temperature is not None:
        t = inspection.temperature
        text = f"{t.first_c:.1f} °C, stated"
        if t.recorded:
            text = f"{t.first_c:.1f} °C at the start, {t.last_c:.1f} °C at the end"
            text += f", {t.lowest_c:.1f} to {t.highest_c:.1f} °C"
        yield from _line("Temperature", text)
    yield from _line("Stillness", _stillness(inspection))
    yield from _line("Recognised" if inspection.turns else "Turns", inspection.summary)


def _duration(seconds: float) -> str:
    if seconds < 600.0:
        return f"{seconds:.4g} s"
    return f"{seconds:.0f} s ({seconds / 60.0:.1f} min)"


def _gaps(inspection: Inspection) -> str:
    stamps = inspection.stamps
    if not stamps.gaps:
        return "none"
    longest = f"{stamps.longest_gap_s:.3g} s before {stamps.longest_gap_at_s:.6g} s"
    return f"{stamps.gaps}, the longest {longest}; {stamps.missing_s:.4g} s are missing in total"


def _stillness(inspection: Inspection) -> str:
    still = inspection.stillness
    if still is None:
        return "none found"
    lengths = still.lengths_s
    recorded = max(inspection.stamps.duration_s - inspection.stamps.missing_s, 1e-9)
    share = f"{still.total_s / recorded:.0%} of what was recorded"
    if len(lengths) == 1:
        return f"one window of {lengths[0]:.4g} s, {share}"
    span = list(dict.fromkeys(f"{length:.3g}" for length in (min(lengths), max(lengths))))
    return f"{len(lengths)} windows of {' to '.join(span)} s, {share}"


def _noise(inspection: Inspection) -> Iterable[str]:
    noise, allan = inspection.noise, inspection.allan
    if noise is None:
        return
    if allan is not None:
        count = "one window" if allan.windows == 1 else f"{allan.windows} windows, the longest"
        yield from wrap(
            f"Noise at rest, from the Allan deviation of {count} of {_duration(allan.longest_s)}, with 95 % intervals"
        )
    else:
        assert inspection.stillness is not None
        number = len(inspection.stillness.windows_s)
        yield "Noise at rest, from the one window" if number == 1 else f"Noise at rest, from {number} windows"
    yield from (line for s in range(2) for line in _noise_table(noise.figures, noise.stated, s).split("\n"))
    if noise.note is not None:
        yield from wrap(noise.note)


def _noise_table(figures: dict[str, dict[str, Any]], stated: dict[str, float], sensor: int) -> str:
    """Table of the noise of three gyros or accelerometers, with the stated values."""
    channels = CHANNELS[3 * sensor : 3 * sensor + 3]
    known = [term.keys[sensor] for term in _SHOWN]
    interval = any("low" in f for c in channels for f in figures[c].values())
    headers, alignment = [("gyro", "accel.")[sensor]], "l"
    for term, key in zip(_SHOWN, known, strict=True):
        headers += [
            f"{term.title.replace('bias instability', 'bias inst.')}\n{_DISPLAY.get(key, (term.units[sensor],))[0]}"
        ]
        headers += [""] * interval
        alignment += "rl" if interval else "r"
    rows: list[list[str] | None] = []
    for channel in channels:
        row = [channel[-1]]
        for key in known:
            row += _cells(figures[channel].get(key), _DISPLAY.get(key, ("", 1.0))[1])[: 1 + interval]
        rows.append(row)
    if any(key in stated for key in known):
        row = ["stated"]
        for key in known:
            row += [f"{stated[key] * _DISPLAY.get(key, ('', 1.0))[1]:.3g}" if key in stated else "", ""][: 1 + interval]
        rows.append(row)
    return text_table(headers, rows, alignment)


def _cells(figure: dict[str, float] | None, factor: float) -> list[str]:
    """Value and interval of one figure."""
    if figure is None:
        return ["-", ""]
    if "below" in figure:
        return [f"< {significant(figure['below'] * factor, 2)}", ""]
    interval = (
        f"{significant(figure['low'] * factor)}..{significant(figure['high'] * factor)}" if "low" in figure else ""
    )
    return [significant(figure["value"] * factor), interval]


def _turns(inspection: Inspection) -> Iterable[str]:
    turns = inspection.turns
    if not turns:
        return
    named = any(turn.sequence for turn in turns)
    labelled = any(turn.labelled for turn in turns)
    headers, alignment = ["from, s", "to, s", "rotation", "fastest\n°/s"], "rrlr"
    if named:
        headers, alignment = [*headers, "seq.", "sure"], alignment + "lr"
    if labelled:
        headers, alignment = [*headers, "label"], alignment + "l"
    rows: list[list[str] | None] = []
    for turn in turns[:_MOST_TURNS]:
        lines = _leg_lines(turn)
        row = [f"{turn.start_s:.2f}", f"{turn.end_s:.2f}", lines[0], f"{turn.fastest_deg_s:.0f}"]
        if named:
            row += [turn.sequence, f"{turn.confidence:.0%}"] if turn.sequence else ["-", ""]
        if labelled:
            row.append((turn.labelled or "-")[:_LABEL_WIDTH])
        rows.append(row)
        rows += [["", "", line, *[""] * (len(headers) - 3)] for line in lines[1:]]
    yield from text_table(headers, rows, alignment).split("\n")
    if len(turns) > _MOST_TURNS:
        yield f" ... and {len(turns) - _MOST_TURNS} more turns; --json FILE holds all."


def _leg_lines(turn: ManoeuvreSummary) -> list[str]:
    """Lines of the rotations that a manoeuvre consists of."""
    lines = [""]
    whole = turn.parts == (turn.net,)
    for text in (f"net {leg}" if whole else str(leg) for leg in turn.parts):
        if lines[-1] and len(lines[-1]) + 2 + len(text) > _LEGS_WIDTH:
            lines[-1] += ","
            lines.append("")
        lines[-1] += f", {text}" if lines[-1] else text
    return lines


def runner_up_sentence(other: RunnerUp) -> str:
    """Sentence that names a second fault, and how much less likely it is."""
    lower = max(0.0, other.log_likelihood_lower)
    return f"Nearly as likely (log-likelihood lower by {lower:.2g}): {FAULTS[other.fault].title}."


def _findings(inspection: Inspection, reworded: Callable[[str], str] = str) -> Iterable[str]:
    findings = inspection.diagnosis.findings
    if not findings:
        yield "No fault found."
    if inspection.not_looked_for and inspection.diagnosis.refusal is None:
        yield from wrap(f"Not looked for without a calibration (--deep): {', '.join(inspection.not_looked_for)}.")
    if step := inspection.hidden_gyro_step_rad_s:
        yield from wrap(
            f"Not looked for: gyro_bias_drift. The rates were rounded to steps of {significant(step / DEG_PER_H)} °/h "
            "before they were corrected. Their noise does not average the steps out, and the corrected rates do not "
            "show them: inspect the recording of before the correction."
        )
    if inspection.diagnosis.judgement is not None:
        yield from wrap(f"Verdict: {inspection.diagnosis.judgement}")
    for finding in findings:
        beside = "" if finding.runner_up is None else f" {runner_up_sentence(finding.runner_up)}"
        yield from wrap(f"{_EFFECTS[finding.effect]}: {reworded(finding.sentence)}{beside}")
