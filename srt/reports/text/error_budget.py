"""Text of an error budget: predicted 1-sigma errors by source, and the paper's own analysis (Savage 2020, §9)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srt.noise.accuracy_analysis import QUANTITIES
from srt.ranking import significant
from srt.reports.tables import fixed, text_table, wrap
from srt.reports.text.calibration import sources_table
from srt.sensor_errors import GROUP_SLICES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.noise.accuracy_analysis import PaperSetting
    from srt.types import Array


def budget_text(
    estimator: str,
    sources: Mapping[str, Array],
    total: Array,
    not_counted: Mapping[str, Array],
    meanings: Mapping[str, str],
    *,
    details: bool = True,
) -> str:
    """Tables of the sources of error, those in the sum and those apart from it, shape (27,) each, SI.

    ``total`` is the root sum of squares of the sources; infinite where a parameter is not observed. ``meanings``
    explain the sources that are not in the sum. Without ``details``, the parameter with the largest sigma of each group
    is shown.
    """
    seen = np.flatnonzero(np.isfinite(total)).tolist()
    if not details:
        groups = [[i for i in seen if part.start <= i < part.stop] for part in GROUP_SLICES.values()]
        worst = [max(group, key=lambda i: significant(float(total[i]))) for group in groups if group]
        head = f"Budget of {estimator}, largest of each group: 1-sigma; the squares of the sources add up"
        return "\n".join([*wrap(head), sources_table(sources, total, worst)])
    text = [f"Budget of {estimator}: 1-sigma; the squares of the sources add up"]
    text.append(sources_table(sources, total, seen))
    text.append("\nNot in the sum")
    text.append(sources_table(not_counted, None, seen))
    for name, meaning in meanings.items():
        text += wrap(f"{name.replace('_', ' ')}: {meaning}", "  ")
    return "\n".join(text)


def paper_budget_text(setting: PaperSetting, found: Mapping[str, Array]) -> str:
    """Table of the paper's analysis, one row for each quantity of the closed form."""
    sources = {name: values for name, values in found.items() if values.any()}
    heads = ["", "seq.", "unit", *(name.replace("_", "\n") for name in sources)]
    cells = [
        [q.symbol, q.sequence, q.unit, *(fixed(1e6 * float(values[k]), 2) for values in sources.values())]
        for k, q in enumerate(QUANTITIES)
    ]
    title = (
        f"Savage 2020, §9: sequences of {setting.time_s:g} s with two windows of {setting.window_s:g} s, "
        f"rotations at {setting.rate_rad_s:g} rad/s"
    )
    return f"{title}\n{text_table(heads, cells, 'lll' + 'r' * len(sources), gap=1)}"
