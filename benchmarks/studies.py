"""Shared pieces of the studies: scores of calibrations, figures over many units, Markdown tables, parts of pages."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from srt.result.calibration import Calibration
    from srt.types import Array

ESTIMATORS = ("closed-form", "least-squares", "ekf", "graph")
USABLE = ("converged", "partial")


def nees_of(error: Array, covariance: Array) -> float:
    """Normalised estimation error squared, by the correlation: the parameters have very different units."""
    sigma = np.sqrt(np.diag(covariance))
    z = error / sigma
    return float(z @ np.linalg.solve(covariance / np.outer(sigma, sigma), z))


def _nothing() -> Array:
    return np.full(N_PARAMETERS, math.nan)


@dataclass(frozen=True, eq=False)
class Score:
    """Outcome of a calibration of a unit with known errors.

    ``error`` and ``z``, shape (27,), are estimate minus truth, SI, and the same over its sigma, NaN where not observed;
    ``nees`` is over all ``freedom`` observed parameters. ``word`` is the verdict, ``drift`` has the sensors whose drift
    is modelled, ``faults`` what the checks or the result name, ``named`` tells if that is the error that was put in,
    and ``scale_sigma`` is the largest sigma of the accelerometer scale factors. ``bound``, shape (27,), SI, is the
    Cramér-Rao bound where it is known; ``seconds`` is the CPU time.
    """

    status: str
    word: str = "refused"
    error: Array = field(default_factory=_nothing)
    z: Array = field(default_factory=_nothing)
    nees: float = math.nan
    freedom: int = 0
    drift: frozenset[str] = frozenset()
    scale_sigma: float = math.nan
    faults: tuple[str, ...] = ()
    checks: str = ""
    named: bool = False
    bound: Array | None = None
    seconds: float = math.nan

    @property
    def usable(self) -> bool:
        """Converged, all parameters observed or not."""
        return self.status in USABLE


def scored(found: Calibration, truth: Array) -> Score:
    """Score of a calibration; ``truth`` of shape (27,), SI."""
    # A parameter that is exactly known has no normalised error.
    seen, error, z, nees = found.observed & (found.sigma > 0.0), _nothing(), _nothing(), math.nan
    if seen.any():
        error[seen] = (found.errors.vector - truth)[seen]
        z[seen] = error[seen] / found.sigma[seen]
        nees = nees_of(error[seen], found.covariance[np.ix_(seen, seen)])
    drift = frozenset(term.sensor for term in found.diagnostics.drift or ())
    scale = float(found.sigma[GROUP_SLICES["accel_scale"]].max())
    return Score(found.status, found.judgement.word, error, z, nees, int(seen.sum()), drift, scale)


def pooled_nees(scores: Iterable[Score]) -> float:
    """NEES per parameter over all usable scores; NaN for none."""
    used = [s for s in scores if s.usable]
    return sum(s.nees for s in used) / sum(s.freedom for s in used) if used else math.nan


def rms(values: Array) -> float:
    """Root mean square of what is not NaN; NaN for nothing."""
    shown = np.asarray(values)[np.isfinite(values)]
    return float(np.sqrt(np.mean(shown**2))) if shown.size else math.nan


def counts(words: Iterable[str]) -> str:
    """Words with their number, the most frequent first; a dash for none."""
    return ", ".join(f"{n} {word}" for word, n in Counter(words).most_common()) or "-"


def figure(value: float, digits: int = 3) -> str:
    """Text of a number with this many digits, without an exponent; a dash for NaN."""
    if math.isnan(value):
        return "–"
    rounded = float(f"{value:.{digits}g}")
    decimals = digits - 1 - (math.floor(math.log10(rounded)) if rounded > 0.0 else 0)
    return f"{rounded:.{max(0, decimals)}f}"


def markdown(columns: Sequence[str], rows: Iterable[Sequence[str]], text: int = 1) -> Iterator[str]:
    """Lines of a Markdown table; columns after the first ``text`` are right-aligned."""
    yield f"| {' | '.join(columns)} |"
    yield "|" + "---|" * text + "---:|" * (len(columns) - text)
    yield from (f"| {' | '.join(row)} |" for row in rows)


def replace_tables(page: Path, tables: dict[str, str]) -> None:
    """Replace what stands between ``<!-- table: NAME -->`` and ``<!-- end of table -->`` in a page.

    Raises
    ------
    ValueError
        If a table has no place in the page.
    """
    end, text = "<!-- end of table -->", page.read_text(encoding="utf-8")
    for name, table in tables.items():
        before, begin, rest = text.partition(f"<!-- table: {name} -->")
        _, found, after = rest.partition(end)
        if not found:
            raise ValueError(f"{page}: no place for the table {name}")
        text = f"{before}{begin}\n\n{table}\n\n{end}{after}"
    page.write_text(text, encoding="utf-8")
