"""A plan for people and programs: when what happens, the operator's sheet, labels for the recording, JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from srt.planning.prediction import timetable_s
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, INDEX, N_PARAMETERS, NAMES, SYMBOLS

if TYPE_CHECKING:
    from srt.planning.plan import Plan


@dataclass(frozen=True, slots=True)
class Step:
    """One sequence of a plan on the clock; time zero is the beginning of the first window.

    Attributes
    ----------
    start_static_s, end_static_s : (float, float)
        The windows.
    move_s : float
        Time of the move to the start attitude, waits left out.
    """

    start_static_s: tuple[float, float]
    end_static_s: tuple[float, float]
    move_s: float


def timetable(plan: Plan) -> tuple[Step, ...]:
    """When every sequence of a plan runs, if nobody loses time."""
    moves = [0.0]
    for before, candidate in pairwise(plan.candidates):
        waits = plan.stand.pause_s + plan.stand.settle_s
        moves.append(plan.stand.move_s(before.end_deg, candidate.start_deg) - waits)
    borders = timetable_s(plan.candidates, plan.windows_s, plan.stand).tolist()
    return tuple(Step((a, b), (c, d), move) for (a, b, c, d), move in zip(borders, moves, strict=True))


def operator_sheet(plan: Plan, title: str) -> str:
    """What to do at the fixture, in Markdown.

    Parameters
    ----------
    plan : Plan
    title : str

    Notes
    -----
    The last part are labels for ``recording.toml``: the planned times, to be shifted to where the recording begins
    and corrected to what was done.
    """
    steps = timetable(plan)
    lines = [
        f"# {title}",
        "",
        f"{len(steps)} sequences, {clock(plan.total_s)} (min:s) from the first window to the last. The unit stands "
        "with z along the inner axis; at (0, 0) z is down and y along the outer axis. Angles of the axes are in "
        "degrees, turns are by the fixture's own sense. Stand still in the windows; after the last turn of a sequence, "
        f"and after every move, wait {plan.stand.settle_s:g} s for the fixture to settle.",
        "",
        "| | clock | go to inner, outer | stand | turn | wait | stand | down | needed most for |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for number, (candidate, step, need) in enumerate(
        zip(plan.candidates, steps, plan.prediction.needed_for, strict=True), start=1
    ):
        inner, outer = candidate.start_deg
        turns = ", ".join(f"{'inner' if axis == 0 else 'outer'} {turn:+d}" for axis, turn in candidate.legs)
        (a, b), (c, d) = step.start_static_s, step.end_static_s
        lines.append(
            f"| {number} | {clock(a)} | {inner}, {outer} | {b - a:.1f} s | {turns} | {plan.stand.settle_s:g} s | "
            f"{d - c:.1f} s | {candidate.down} to {candidate.end_down} | {', '.join(symbols(need))} |"
        )
    lines += ["", "## Expected accuracy", "", "| parameter | | one sigma | target | |", "|---|---|---|---|---|"]
    for k in range(N_PARAMETERS):
        sigma, target = float(plan.prediction.sigma[k]), float(plan.targets[k])
        missed = "missed" if sigma > target * (1.0 + 1e-4) else ""
        lines.append(
            f"| {NAMES[k]} | {SYMBOLS[k]} | {shown(sigma, k)} | {'' if math.isnan(target) else shown(target, k)} | "
            f"{missed} |"
        )
    lines += ["", "## Labels for recording.toml", "", "```toml", *labels(plan), "```", ""]
    return "\n".join(lines)


def labels(plan: Plan) -> list[str]:
    """Lines of TOML that label the sequences of the plan at their planned times."""
    out = []
    for number, (candidate, step) in enumerate(zip(plan.candidates, timetable(plan), strict=True), start=1):
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
    """Give a plan as JSON types; SI units, null where there is nothing."""

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
        "ruling": [{"parameter": name, "weight": weight} for name, weight in plan.ruling],
        "sequences": [
            {
                "id": f"p{k:02d}",
                "label": c.label,
                "down": c.down,
                "along_outer": c.along_outer,
                "rotations": [[axis, float(turn)] for axis, turn in c.rotations],
                "inner_deg": c.start_deg[0],
                "outer_deg": c.start_deg[1],
                "fixture_turns": [["inner" if axis == 0 else "outer", float(turn)] for axis, turn in c.legs],
                "start_static_s": list(step.start_static_s),
                "end_static_s": list(step.end_static_s),
                "needed_for": [{"parameter": name, "factor": number(factor)} for name, factor in need],
            }
            for k, (c, step, need) in enumerate(
                zip(plan.candidates, timetable(plan), plan.prediction.needed_for, strict=True), start=1
            )
        ],
        "parameters": [
            {
                "name": NAMES[k],
                "sigma": number(plan.prediction.sigma[k]),
                "target": number(plan.targets[k]),
                "sources": {name: number(values[k]) for name, values in plan.prediction.sources.items()},
            }
            for k in range(N_PARAMETERS)
        ],
    }


def clock(seconds: float) -> str:
    """Write minutes and seconds."""
    return f"{int(seconds + 0.5) // 60}:{int(seconds + 0.5) % 60:02d}"


def shown(value: float, k: int) -> str:
    """Write a sigma in the parameter's usual unit."""
    return "not seen" if math.isinf(value) else f"{value * DISPLAY_FACTORS[k]:.3g} {DISPLAY_UNITS[k]}"


def symbols(need: tuple[tuple[str, float], ...]) -> list[str]:
    """Symbols of parameters that a sequence is needed for; what it alone shows has an exclamation mark."""
    return [SYMBOLS[INDEX[name]] + ("!" if math.isinf(factor) else "") for name, factor in need]
