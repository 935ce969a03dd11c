"""Text of the noise terms of a unit at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from srt.constants import HOUR_S
from srt.noise.noise_terms import ALL_TERMS
from srt.reports.tables import text_table, wrap

if TYPE_CHECKING:
    from srt.noise.allan import AllanDeviation
    from srt.noise.noise_terms import NoiseTerms


_SHOWN: Final = {"m/s": ("mm/s", 1e-3)}  # unit in tables, and its factor, where that of the key makes long numbers


def noise_report(terms: NoiseTerms, allan: AllanDeviation, *, title: str) -> str:
    """Tables of the noise terms of gyros and accelerometers, and those of the Allan deviation of the same window."""
    lines = [
        f"Noise of {title}: {duration(terms.length_s)} at rest, {1.0 / terms.interval_s:.4g} Hz",
        "Maximum likelihood with 95 % intervals; fit of the Allan deviation; < : upper limit, 95 %",
    ]
    for sensor in range(2):
        lines += ["", _table(terms, allan, sensor)]
    lines.append("")
    for channel, reason in terms.refused.items():
        lines += wrap(
            f"No terms of {channel.replace('_', ' ')}: {reason}. A filter, interpolated samples, vibration or a "
            "changing noise give such readings."
        )
    lines += wrap(
        "Record needed: length at which the 95 % interval is within ± 50 % of the value, the longest of the three "
        "axes; for an upper limit at least that."
    )
    return "\n".join(lines)


def duration(seconds: float) -> str:
    """Time in s, min, h or days; "> 3 years" for an infinite one."""
    if not np.isfinite(seconds):
        return "> 3 years"
    for unit, size in (("days", 24.0 * HOUR_S), ("h", HOUR_S), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"


def _table(terms: NoiseTerms, allan: AllanDeviation, sensor: int) -> str:
    rows: list[list[str] | None] = []
    channels = range(3 * sensor, 3 * sensor + 3)
    for t, term in enumerate(ALL_TERMS):
        unit, factor = _SHOWN.get(term.units[sensor], (term.units[sensor], 1.0))
        scale = term.scales[sensor] * factor
        needed = float(np.nanmax(np.append(terms.needed_s[list(channels), t], 0.0)))
        least = "" if all(terms.resolved[c, t] for c in channels) or not np.isfinite(needed) else "≥ "
        name = f"{term.title}, {unit}"
        rows.append([name, *(_value(terms, c, t, scale) for c in channels), least + duration(needed)])
        if terms.resolved[list(channels), t].any():
            rows.append(["", *(_interval(terms, c, t, scale) for c in channels), ""])
        if t < allan.value.shape[1] and np.isfinite(allan.value[list(channels), t]).any():
            fitted = [allan.value[c, t] / scale for c in channels]
            rows.append(["  Allan fit", *("-" if np.isnan(v) else f"{v:.3g}" for v in fitted), ""])
    return text_table((("gyros", "accelerometers")[sensor], "x", "y", "z", "record\nneeded"), rows, "lrrrr")


def _value(terms: NoiseTerms, c: int, t: int, scale: float) -> str:
    if np.isnan(terms.high[c, t]):
        return "-"
    return f"{terms.value[c, t] / scale:.3g}" if terms.resolved[c, t] else f"< {terms.high[c, t] / scale:.2g}"


def _interval(terms: NoiseTerms, c: int, t: int, scale: float) -> str:
    return f"{terms.low[c, t] / scale:.3g} to {terms.high[c, t] / scale:.3g}" if terms.resolved[c, t] else ""
