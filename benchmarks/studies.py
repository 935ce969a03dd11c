"""Shared pieces of the studies: scores of calibrations, figures over many units, Markdown tables."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from srt.result.calibration import Calibration
    from srt.types import Array

Cell = tuple[Any, ...]
"""Properties of the units of a row of a table."""
Rows = dict[str, "Score"]
"""Scores of one unit by estimator or method."""
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

    ``error``, ``z`` and ``sigma``, shape (27,), are estimate minus truth, SI, the same over its sigma, and the sigma,
    NaN where not observed; ``nees`` is over all ``freedom`` observed parameters. ``word`` is the verdict, ``drift`` has
    the sensors whose drift is modelled, ``faults`` what the checks or the result name, and ``named`` tells if that is
    the error that was put in. ``bound``, shape (27,), SI, is the Cramér-Rao bound where it is known; ``seconds`` is the
    CPU time; ``innovations`` are those of the filter by sequence.
    """

    status: str
    word: str = "refused"
    error: Array = field(default_factory=_nothing)
    z: Array = field(default_factory=_nothing)
    sigma: Array = field(default_factory=_nothing)
    nees: float = math.nan
    freedom: int = 0
    drift: frozenset[str] = frozenset()
    faults: tuple[str, ...] = ()
    named: bool = False
    bound: Array | None = None
    seconds: float = math.nan
    innovations: tuple[Array, ...] = ()

    @property
    def scale_sigma(self) -> float:
        """Largest sigma of the accelerometer scale factors."""
        return float(np.nanmax(self.sigma[GROUP_SLICES["accel_scale"]]))

    @property
    def usable(self) -> bool:
        """Converged, all parameters observed or not."""
        return self.status in USABLE


def scored(found: Calibration, truth: Array) -> Score:
    """Score of a calibration; ``truth`` of shape (27,), SI."""
    # A parameter that is exactly known has no normalised error.
    seen, nees = found.observed & (found.sigma > 0.0), math.nan
    error, sigma = (np.where(seen, values, math.nan) for values in (found.errors.vector - truth, found.sigma))
    z = error / sigma
    if seen.any():
        nees = nees_of(error[seen], found.covariance[np.ix_(seen, seen)])
    drift = frozenset(term.sensor for term in found.diagnostics.drift or ())
    return Score(found.status, found.judgement.word, error, z, sigma, nees, int(seen.sum()), drift)


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


def markdown(columns: Sequence[str], rows: Iterable[Sequence[str]], text: int = 1) -> Iterator[str]:
    """Lines of a Markdown table; columns after the first ``text`` are right-aligned."""
    yield f"| {' | '.join(columns)} |"
    yield "|" + "---|" * text + "---:|" * (len(columns) - text)
    yield from (f"| {' | '.join(row)} |" for row in rows)
