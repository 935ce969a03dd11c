"""Documents of a plan: the operator's sheet in Markdown, labels for ``recording.toml``, and JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from srt.planning.plan import MET
from srt.planning.timetable import clock
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, INDEX, N_PARAMETERS, NAMES, SYMBOLS

if TYPE_CHECKING:
    from srt.planning.plan import Plan


def operator_sheet(plan: Plan, title: str) -> str:
    """Operator's sheet of a plan, in Markdown.

    Notes
    -----
    The last part holds labels for ``recording.toml`` at the planned times. They must be shifted to the start of the
    recording and corrected where the test deviated from the plan.
    """
    steps = plan.timetable()
    lines = [
        f"# {title}",
        "",
        f"{len(steps)} sequences, {clock(plan.total_s)} (min:s) from the first window to the last. The unit is mounted "
        "with z along the inner axis; at (0, 0) z is down and y along the outer axis. Angles of the axes are in "
        "degrees; rotations are signed in the sense of the fixture. Do not move the fixture in the stationary windows. "
        f"After the last rotation of a sequence, and after every move, wait {plan.fixture.settle_s:g} s."
        + ("" if plan.with_moves is None else " Let the log run on during the moves: the accuracy below counts them."),
        "",
        "| | clock | move to inner, outer | stationary | rotate | wait | stationary | down | needed for |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for number, (candidate, step, need) in enumerate(
        zip(plan.candidates, steps, plan.prediction.needed_for, strict=True), start=1
    ):
        inner, outer = candidate.start_deg
        turns = ", ".join(f"{'inner' if axis == 0 else 'outer'} {turn:+d}" for axis, turn in candidate.axis_rotations)
        (a, b), (c, d) = step.start_static_s, step.end_static_s
        lines.append(
            f"| {number} | {clock(a)} | {inner}, {outer} | {b - a:.1f} s | {turns} | {plan.fixture.settle_s:g} s | "
            f"{d - c:.1f} s | {candidate.down} to {candidate.end_down} | {', '.join(symbols(need))} |"
        )
    lines += ["", "## Expected accuracy", "", "| parameter | | 1-sigma | target | |", "|---|---|---|---|---|"]
    for k in range(N_PARAMETERS):
        sigma, target = float(plan.sigma[k]), float(plan.targets[k])
        missed = "missed" if sigma > target * MET else ""
        lines.append(
            f"| {NAMES[k]} | {SYMBOLS[k]} | {format_sigma(sigma, k)} | "
            f"{'' if math.isnan(target) else format_sigma(target, k)} | {missed} |"
        )
    lines += ["", "## Labels for recording.toml", "", "```toml", *labels(plan), "```", ""]
    return "\n".join(lines)


def labels(plan: Plan) -> list[str]:
    """TOML lines that label the sequences of a plan at their planned times."""
    out = []
    for number, (candidate, step) in enumerate(zip(plan.candidates, plan.timetable(), strict=True), start=1):
        rotations = ", ".join(f'["{axis}", {float(turn)!r}]' for axis, turn in candidate.rotations)
        out += [
            "[[sequence]]",
            f'id = "p{number:02d}"',
            f'down = "{candidate.down}"',
            f'along_outer = "{candidate.along_outer}"',
            f"rotations = [{rotations}]",
            f"start_static_s = [{step.start_static_s[0]:.2f}, {step.start_static_s[1]:.2f}]",
            f"end_static_s = [{step.end_static_s[0]:.2f}, {step.end_static_s[1]:.2f}]",
            "",
        ]
    return out[:-1]


def plan_document(plan: Plan) -> dict[str, Any]:
    """Plan as JSON types; SI units, null for values that do not exist."""

    def number(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    return {
        "format": "srt-plan",
        "version": 1,
        "total_s": plan.total_s,
        "moves_s": plan.moves_s,
        "worst_ratio": number(plan.ratio),
        "worst_parameter": plan.worst,
        "ratio_bound": number(plan.bound),
        "moves": "skipped" if plan.with_moves is None else "recorded",
        "ruling": [{"parameter": name, "weight": weight} for name, weight in plan.limiting_targets],
        "sequences": [
            {
                "id": f"p{k:02d}",
                "label": c.label,
                "down": c.down,
                "along_outer": c.along_outer,
                "rotations": [[axis, float(turn)] for axis, turn in c.rotations],
                "inner_deg": c.start_deg[0],
                "outer_deg": c.start_deg[1],
                "fixture_turns": [["inner" if axis == 0 else "outer", float(turn)] for axis, turn in c.axis_rotations],
                "start_static_s": list(step.start_static_s),
                "end_static_s": list(step.end_static_s),
                "needed_for": [{"parameter": name, "factor": number(factor)} for name, factor in need],
            }
            for k, (c, step, need) in enumerate(
                zip(plan.candidates, plan.timetable(), plan.prediction.needed_for, strict=True), start=1
            )
        ],
        "parameters": [
            {
                "name": NAMES[k],
                "sigma": number(plan.prediction.sigma[k]),
                "sigma_with_moves": None if plan.with_moves is None else number(plan.with_moves[k]),
                "target": number(plan.targets[k]),
                "sources": {name: number(values[k]) for name, values in plan.prediction.sources.items()},
            }
            for k in range(N_PARAMETERS)
        ],
    }


def format_sigma(value: float, k: int) -> str:
    """Format a sigma in the display unit of the parameter."""
    return "not observed" if math.isinf(value) else f"{value * DISPLAY_FACTORS[k]:.3g} {DISPLAY_UNITS[k]}"


def symbols(need: tuple[tuple[str, float], ...]) -> list[str]:
    """Symbols of the parameters that depend on a sequence; "!" marks those that no other sequence observes."""
    return [SYMBOLS[INDEX[name]] + ("!" if math.isinf(factor) else "") for name, factor in need]


def plan_frame(plan: Plan) -> Any:
    """Parameters by name, as a pandas DataFrame: expected sigma, target and their ratio."""
    from srt.reports.frames import frame_by_parameter

    factors = np.array(DISPLAY_FACTORS)
    return frame_by_parameter(
        symbol=list(SYMBOLS),
        sigma=plan.sigma * factors,
        target=plan.targets * factors,
        ratio=plan.ratios,
        unit=list(DISPLAY_UNITS),
    )
