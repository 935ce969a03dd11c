"""Text of a running test: one line a sequence with the sigmas after it, errors, and what to do next."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from srt.constants import DEG
from srt.model.table1 import SEQUENCES
from srt.reports.parameters import group_heads, group_sigmas
from srt.reports.tables import text_table, wrap
from srt.sensor_errors import DISPLAY_UNITS, GROUP_SLICES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srt.planning.monitoring.accuracy import SequenceAccuracy
    from srt.planning.monitoring.run_monitor import RunState


def progress_text(state: RunState, history: Sequence[SequenceAccuracy], targets: Mapping[str, float]) -> str:
    """Table of a test so far, its errors, and the next sequence.

    Parameters
    ----------
    history : sequence of SequenceAccuracy
        After each sequence of ``state.labels``.
    targets : mapping of str to float, SI
    """
    wrong = {error.sequence for error in state.errors}
    rows: list[list[str] | None] = []
    for number, (label, after) in enumerate(zip(state.labels, history, strict=False), start=1):
        last = max(k for k, each in enumerate(state.labels, start=1) if each.id == label.id)
        found = "repeat" if label.id in wrong and number == last else "still"
        rows.append([label.id or "", found, *group_sigmas(after.sigma)])
    heads = ["seq.", "", *group_heads()]
    lines = ["Largest 1-sigma of each group after each sequence (-: not all observed)"]
    lines += [text_table(heads, rows, "ll" + "r" * len(GROUP_SLICES), gap=1), ""]
    lines += wrap(unrecorded_text(state))
    for error in state.errors:
        lines += wrap(f"! {error.sentence}")
    lines += wrap(next_text(state))
    lines += wrap(targets_text(history, targets)) if targets else []
    return "\n".join(lines)


def unrecorded_text(state: RunState) -> str:
    """Sentence on moves that the recording does not contain; empty if it contains all."""
    if state.unrecorded_s is None:
        return ""
    return f"The moves between the sequences are not recorded (first after {state.unrecorded_s:.1f} s): none is judged."


def next_text(state: RunState) -> str:
    """Sentence on the sequence to do next."""
    again = next((error.sequence for error in state.errors), None)
    name = again if again is not None else state.next
    if name is None:
        return f"All {len(state.order)} sequences are done."
    sequence = SEQUENCES[name]
    turns = ", ".join(f"{angle / DEG:+.0f}° {axis}" for axis, angle in sequence.rotations)
    verb = "Repeat" if name in state.done else "Next:"
    return (
        f"{verb} sequence {name}: {sequence.down} down, {sequence.along_outer} along the outer axis; stand still, "
        f"rotate {turns}, stand still."
    )


def targets_text(history: Sequence[SequenceAccuracy], targets: Mapping[str, float]) -> str:
    """Sentence on the targets."""
    short = history[-1].shortfall(targets) if history else None
    if short is None:
        return "Targets: no sequence is complete yet."
    name, ratio = short
    if ratio <= 1.0:
        return f"All targets are met; {name} is nearest to its target: {ratio:.2g} of it."
    if math.isinf(ratio):
        return f"Targets: {name} is not observed yet."
    return f"Targets: the sigma of {name} is {ratio:.2g} times the wanted one."


def sequence_line(state: RunState, number: int, after: SequenceAccuracy) -> str:
    """Line on one sequence, where there is no terminal."""
    label = state.labels[number]
    sigmas = ", ".join(
        f"{name.replace('_', ' ')} {text} {DISPLAY_UNITS[part.start]}"
        for (name, part), text in zip(GROUP_SLICES.items(), group_sigmas(after.sigma), strict=True)
        if text != "-"
    )
    return f"sequence {label.id} done at {label.end_static_s[1]:.1f} s; sigma: {sigmas or 'nothing observed yet'}"
