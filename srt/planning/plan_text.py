"""Text of plans for a terminal: tables of a plan, of proposals for the next sequence, and of a signature."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.planning.plan_document import format_sigma, symbols
from srt.planning.timetable import clock
from srt.ranking import ranked, significant
from srt.reports.parameters import sigma_text, value_text
from srt.reports.tables import text_table, wrap
from srt.reports.text.calibration import source_label
from srt.sensor_errors import DISPLAY_UNITS, INDEX, N_PARAMETERS, NAMES, SYMBOLS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srt.planning.candidates import Candidate
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.planning.next_sequence import Proposal
    from srt.planning.plan import Plan
    from srt.planning.signature_table import SignatureRow
    from srt.types import Array

_LABEL_WIDTH: Final = 38
"""Width of the column of sequences, characters."""
_TERMS_WIDTH: Final = 60
"""Width of the terms of a signature, characters."""


def plan_text(plan: Plan, title: str = "Plan") -> str:
    """Tables of a plan: its sequences, its expected accuracy, and the worst target."""
    lines = [f"{title}: {len(plan.candidates)} sequences in {clock(plan.total_s)} (min:s),"]
    lines.append(f"{clock(plan.moves_s)} of them moves and waits between the sequences\n")
    lines.append(_sequence_table(plan))
    lines.append("\nExpected accuracy, 1-sigma")
    lines.append(_accuracy_table(plan))
    last = f"Worst: {plan.worst} at {plan.ratio:.3f} of its target."
    if plan.with_moves is not None:
        last += " Record the moves between the sequences, too, and calibrate by least squares, EKF or graph."
    if math.isfinite(plan.bound):
        last += (
            f" With the closed form, no plan of this length and of such sequences can be below {plan.bound:.3f}, "
            f"{100.0 * (1.0 - plan.bound / plan.ratio):.0f} % less; estimators that use the fixture's geometry can."
        )
    return "\n".join([*lines, "", *wrap(last)])


def _sequence_table(plan: Plan) -> str:
    rows = []
    for number, (candidate, times, need) in enumerate(
        zip(plan.candidates, plan.timetable(), plan.prediction.needed_for, strict=True), start=1
    ):
        (a, b), (c, d) = times.start_static_s, times.end_static_s
        first, *more = textwrap.wrap(candidate.label, _LABEL_WIDTH, subsequent_indent="  ", break_on_hyphens=False)
        rows.append([str(number), clock(a), first, f"{b - a:.0f}", f"{d - c:.0f}", " ".join(symbols(need))])
        rows += [["", "", line, "", "", ""] for line in more]
    heads = ["", "clock", "down/outer rotations", "first\ns", "last\ns", "needed for"]
    return text_table(heads, rows, "rrlrrl", gap=1)


def _accuracy_table(plan: Plan) -> str:
    rows = []
    for k in range(N_PARAMETERS):
        # Half a digit, as 1.95, is printed alike whatever the last bit.
        sigma, target = float(plan.sigma[k]), significant(float(plan.targets[k]))
        if math.isinf(sigma):
            rows.append([SYMBOLS[k], DISPLAY_UNITS[k], "not observed", "", "", ""])
            continue
        source, share = plan.prediction.limiting(k)
        wanted = ["", ""] if math.isnan(target) else [value_text(k, target, sigma), f"{sigma / target:.2f}"]
        largest = f"{source_label(source)} {100.0 * share:.0f} %"
        rows.append([SYMBOLS[k], DISPLAY_UNITS[k], sigma_text(k, sigma), *wanted, largest])
    return text_table(["", "unit", "sigma", "target", "ratio", "largest source"], rows, "llrrrl")


def unmet_targets_text(plan: Plan) -> str:
    """Sentence on the targets that a plan does not meet, with the source of the worst."""
    source, share = plan.prediction.limiting(INDEX[plan.worst])
    return (
        f"The plan misses {len(plan.unmet)} of the targets: {plan.worst} stays at {plan.ratio:.3g} times its target, "
        f"{100.0 * share:.0f} % of its variance by {source.replace('_', ' ')}; allow more time, or take larger targets."
    )


def table_1_text(plan: Plan, table_1: Plan) -> str:
    """Comparison of a plan with Table 1 in the same time."""
    better = 100.0 * (1.0 - plan.ratio / table_1.ratio)
    return "\n".join(
        wrap(
            f"Table 1 in the same time, in its best order and with its best windows: {table_1.worst} at "
            f"{table_1.ratio:.3f} of its target; this plan is {better:.0f} % better."
        )
    )


def protocol_text(plan: Plan, name: str, sigma: Array, *, on_fixture: bool) -> str:
    """Comparison of a plan with a protocol in the same time; ``sigma``, shape (27,), is infinite where not observed."""
    wanted = ~np.isnan(plan.targets)
    missing = [NAMES[k] for k in np.flatnonzero(wanted & np.isinf(sigma))]
    ratio = np.where(wanted & np.isfinite(sigma), sigma / plan.targets, 0.0)
    worst = int(ranked(ratio)[0])
    where = "" if on_fixture else ", without the fixture, which cannot run it"
    said = f"Protocol {name} in the same time{where}: "
    if ratio[worst] > 0.0:
        said += f"{NAMES[worst]} at {ratio[worst]:.3f} of its target (this plan: {plan.ratio:.3f} at worst)"
    if missing:
        said += f"{'; ' if ratio[worst] > 0.0 else ''}not observed: {', '.join(missing)}"
    return "\n".join(wrap(said + "."))


def signature_text(candidate: Candidate, fixture: FixtureKinematics, rows: Iterable[SignatureRow]) -> str:
    """Signature of a sequence: the terms of each measured component."""
    inner, outer = candidate.start_deg
    lines = [
        f"{candidate.label}: from inner {inner}, outer {outer} deg, rotations of {candidate.rotation_s(fixture):.1f} s",
        "Over g; accelerometer biases in g, coefficients of gyro biases in s",
    ]
    for row in rows:
        terms = " ".join(f"{value:+.4g} {symbol}" for symbol, value in row.terms)
        first, *more = textwrap.wrap(terms, _TERMS_WIDTH, break_on_hyphens=False) or ["nothing"]
        lines += [f" {row.component:<14} {first}", *(f" {'':<14} {line}" for line in more)]
    return "\n".join(lines)


def proposals_text(proposals: Iterable[Proposal]) -> str:
    """Table of proposals for the next sequence, with the parameters that each improves."""
    rows = []
    for proposal in proposals:
        improved = [
            f"{SYMBOLS[INDEX[name]]} {format_sigma(before, INDEX[name])} to {format_sigma(after, INDEX[name])}"
            for name, before, after in proposal.improved
        ]
        inner, outer = proposal.candidate.start_deg
        rows.append(
            [
                proposal.candidate.label,
                f"{inner}, {outer}",
                f"{proposal.windows_s[0]:.0f}, {proposal.windows_s[1]:.0f}",
                clock(proposal.time_s),
                "none" if math.isinf(proposal.ratio) else f"{proposal.ratio:.2f}",
                improved[0] if improved else "",
            ]
        )
        rows += [[""] * 5 + [line] for line in improved[1:]]
    heads = ["down/outer rotations", "inner,\nouter", "windows\ns", "time\nmin:s", "worst\nratio", "improves"]
    return "\n".join(
        [
            "Sequences on which the optimal continuation of the test spends most time",
            text_table(heads, rows, "lrrrrl", gap=1),
        ]
    )
