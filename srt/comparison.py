"""Several calibrations of one recording, set against each other: whether they agree as far as they should.

Two estimates x and x_opt of the same parameters from the same data share most of their noise, so the root sum of
squares of their sigmas says nothing about their difference d = x − x_opt. If x_opt is efficient, d is uncorrelated with
it (else a mixture of the two would beat it), and::

    cov(d) = P − P_opt

(Hausman 1978, Econometrica 46, 1251). Judged are every parameter on the diagonal of that matrix, and all of them
together on its inverse. Where P is the smaller of the two the roles are exchanged: the absolute value is taken.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import chdtrc, ndtri

from srt.atomic import atomic_write_text
from srt.estimation import automatic_estimator, find_estimator
from srt.exceptions import DataError, InputError, SrtError
from srt.options import Options
from srt.sensor_errors import NAMES, SYMBOLS, UNITS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from os import PathLike

    from numpy.typing import NDArray

    from srt.calibration import Calibration
    from srt.recording import Recording
    from srt.sensor_errors import SensorErrors

    Array = NDArray[np.float64]
    Mask = NDArray[np.bool_]
    Progress = Callable[[str, int, float], None]

FORMAT: Final = "srt-comparison"
VERSION: Final = 1

ESTIMATORS: Final = ("closed-form", "least-squares", "ekf", "graph")
"""Those compared where none are named: the least efficient first."""

USABLE: Final = ("converged", "partial")
"""Statuses whose values and sigmas mean what they say."""

FALSE_ALARM: Final = 0.01
"""Probability that estimators which differ by chance alone are said to disagree: half of it for the largest difference
of any one parameter, half for the joint tests."""

LEAST_SPREAD: Final = 0.05
"""Floor of an expected spread, in units of the larger sigma. Two efficient estimators expect no difference at all, and
still differ by their stopping rules (0.01 sigma), by terms of second order and by how they treat shared noise: nobody
needs to know that below a twentieth of sigma."""

CLEARLY_SMALLER: Final = 0.95
"""Ratio of variances below which the reference is not the efficient estimate of a parameter."""

_NAMED: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """One estimator against the reference.

    Attributes
    ----------
    estimator, reference : str
    compared : ndarray of bool, shape (27,)
        Parameters that both observed.
    difference : ndarray, shape (27,), SI
        Estimator less reference; NaN where not compared, as in the next three.
    spread : ndarray, shape (27,), SI
        One sigma that the difference should have.
    normalised : ndarray, shape (27,)
        Difference over spread.
    sigma_ratio : ndarray, shape (27,)
        Sigma over that of the reference.
    limit : float
        What a normalised difference exceeds by chance hardly ever, see :data:`FALSE_ALARM`.
    chi_square, p_value : float
        Of all differences together, with as many degrees of freedom as parameters are compared. The floor on the
        spread can only raise the p-value.
    least_p_value : float
        What the p-value falls below by chance hardly ever.
    """

    estimator: str
    reference: str
    compared: Mask
    difference: Array
    spread: Array
    normalised: Array
    sigma_ratio: Array
    limit: float
    chi_square: float
    p_value: float
    least_p_value: float

    @property
    def differing(self) -> Mask:
        """Parameters that differ by more than the limit, shape (27,)."""
        out: Mask = self.compared & ~(np.abs(self.normalised) <= self.limit)
        return out

    @property
    def agrees(self) -> bool:
        """Whether chance explains all differences, each alone and together; False if nothing is compared."""
        return bool(self.compared.any()) and not self.differing.any() and self.p_value >= self.least_p_value

    @property
    def largest(self) -> int | None:
        """Index of the parameter with the largest normalised difference."""
        return int(np.nanargmax(np.abs(self.normalised))) if self.compared.any() else None

    @property
    def efficiency(self) -> float:
        """Root mean square of the ratio of sigmas to the reference's; NaN if nothing is compared."""
        ratio = self.sigma_ratio[self.compared]
        return float(np.sqrt(np.mean(ratio**2))) if ratio.size else math.nan

    @property
    def smaller_sigma(self) -> tuple[str, ...]:
        """Parameters of which the reference is not the efficient estimate: its variance is clearly the larger."""
        return _names(self.compared & (self.sigma_ratio**2 < CLEARLY_SMALLER))

    def as_dict(self) -> dict[str, Any]:
        """The JSON form; arrays in SI, None where not compared."""
        return {
            "reference": self.reference,
            "agrees": self.agrees,
            "compared": int(self.compared.sum()),
            "sigma_ratio_rms": self.efficiency if self.compared.any() else None,
            "difference": _finite(self.difference),
            "spread": _finite(self.spread),
            "normalised": _finite(self.normalised),
            "limit": self.limit,
            "differing": list(_names(self.differing)),
            "smaller_sigma": list(self.smaller_sigma),
            "chi_square": self.chi_square,
            "p_value": self.p_value,
            "least_p_value": self.least_p_value,
        }

    def sentence(self) -> str:
        """Say how the two compare, without a full stop."""
        if not self.compared.any():
            return f"{self.estimator} and {self.reference} observed no parameter in common"
        if self.agrees:
            return f"{self.estimator} agrees with {self.reference}"
        differing = np.flatnonzero(self.differing)
        if not differing.size:
            return (
                f"{self.estimator} differs from {self.reference} in all parameters together, though in none alone "
                f"(chi-square {self.chi_square:.0f} for {int(self.compared.sum())}, probability {self.p_value:.1g})"
            )
        worst = differing[np.argsort(-np.abs(self.normalised[differing]), kind="stable")]
        named = _some([f"{NAMES[i]} by {abs(self.normalised[i]):.1f}" for i in worst])
        limit = f"(limit {self.limit:.1f})"
        return f"{self.estimator} differs from {self.reference}: {named} expected spreads {limit}"


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Calibrations of one recording side by side.

    Attributes
    ----------
    calibrations : mapping of str to Calibration
        By the estimator's name, whatever their status.
    reference : str or None
        The estimate taken as efficient; None if none is usable.
    pairs : mapping of str to Pair
        Of every other usable estimate with the reference.
    seconds : mapping of str to float
    failures, left_out : mapping of str to str
        Estimators that ran without a result, and those that were not run, with the reason in a sentence.
    truth : SensorErrors or None
    notes : tuple of str
    """

    calibrations: Mapping[str, Calibration]
    reference: str | None
    pairs: Mapping[str, Pair]
    seconds: Mapping[str, float] = field(default_factory=dict)
    failures: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    truth: SensorErrors | None = None
    notes: tuple[str, ...] = ()

    @property
    def agree(self) -> bool:
        """Whether there are two usable estimates at least, and all agree with the reference."""
        return bool(self.pairs) and all(pair.agrees for pair in self.pairs.values())

    @property
    def complete(self) -> bool:
        """Whether every estimator that ran ended with a usable result."""
        return not self.failures and all(c.status in USABLE for c in self.calibrations.values())

    @property
    def verdict(self) -> str:
        """The outcome in a sentence."""
        if self.reference is None:
            return "There is nothing to compare: no estimator gave a usable result."
        if not self.pairs:
            return f"There is nothing to compare: only {self.reference} gave a usable result."
        if not self.agree:
            ordered = sorted(self.pairs.values(), key=lambda pair: pair.agrees)
            return "; ".join(pair.sentence() for pair in ordered) + "."
        worst = max(self.pairs.values(), key=lambda pair: float(np.nanmax(np.abs(pair.normalised))))
        assert worst.largest is not None
        return (
            f"{_listing([self.reference, *self.pairs])} agree: largest difference "
            f"{abs(worst.normalised[worst.largest]):.1f} expected spreads ({NAMES[worst.largest]} of "
            f"{worst.estimator}; limit {worst.limit:.1f})."
        )

    def error_over_sigma(self, name: str) -> Array:
        """Error of an estimate over its sigma, shape (27,); NaN where held, or without a truth."""
        true = np.nan if self.truth is None else self.truth.vector
        return _ratio(self.calibrations[name].errors.vector - true, self.calibrations[name].sigma)

    def rms_error(self, name: str) -> float:
        """Root mean square of error over sigma of an estimate; NaN without a truth."""
        ratio = self.error_over_sigma(name)
        seen = ratio[np.isfinite(ratio)]
        return float(np.sqrt(np.mean(seen**2))) if seen.size else math.nan

    def as_dict(self) -> dict[str, Any]:
        """The JSON form: SI, in the order of the parameters; None for what there is not, and no NaN."""
        first = next(iter(self.calibrations.values()), None)
        kept = ("data_sha256", "serial", "date", "software", "options")
        return {
            "format": FORMAT,
            "version": VERSION,
            "verdict": self.verdict,
            "agree": self.agree,
            "reference": self.reference,
            "false_alarm_probability": FALSE_ALARM,
            "notes": list(self.notes),
            "parameters": [{"name": n, "symbol": s, "unit": u} for n, s, u in zip(NAMES, SYMBOLS, UNITS, strict=True)],
            "truth": None if self.truth is None else self.truth.vector.tolist(),
            "estimators": [self._estimate_dict(name) for name in self.calibrations],
            "failed": [{"name": name, "message": text} for name, text in self.failures.items()],
            "left_out": [{"name": name, "message": text} for name, text in self.left_out.items()],
            "provenance": {} if first is None else {k: v for k, v in first.provenance.items() if k in kept},
        }

    def save(self, path: str | PathLike[str]) -> None:
        """Write the JSON form, whole or not at all. Raises InputError if the path cannot be written."""
        atomic_write_text(path, json.dumps(self.as_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n")

    def _estimate_dict(self, name: str) -> dict[str, Any]:
        calibration, pair = self.calibrations[name], self.pairs.get(name)
        return {
            "name": name,
            "status": calibration.status,
            "message": calibration.message,
            "playbacks": len(calibration.corrections),
            "seconds": self.seconds.get(name),
            "observed": int(calibration.observed.sum()),
            "value": calibration.errors.vector.tolist(),
            "sigma": _finite(calibration.sigma),
            "held": dict(calibration.held),
            "error_over_sigma": None if self.truth is None else _finite(self.error_over_sigma(name)),
            "comparison": None if pair is None else pair.as_dict(),
        }


def compare(
    calibrations: Mapping[str, Calibration],
    *,
    reference: str | None = None,
    seconds: Mapping[str, float] | None = None,
    failures: Mapping[str, str] | None = None,
    left_out: Mapping[str, str] | None = None,
    truth: SensorErrors | None = None,
) -> Comparison:
    """Set calibrations of one recording against each other.

    Parameters
    ----------
    calibrations : mapping of str to Calibration
        By any names; they appear in that order.
    reference : str, optional
        Which one is taken as efficient. Default: graph, ekf, least-squares, closed-form, others in their order; the
        first that is usable.
    seconds : mapping of str to float, optional
        How long each took.
    failures, left_out : mapping of str to str, optional
        Estimators without a result, and those not run, with the reason.
    truth : SensorErrors, optional

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        A reference that is not among them, or calibrations of different recordings.
    """
    failures = dict(failures or {})
    known = [*calibrations, *failures]
    if reference is not None and reference not in known:
        raise InputError(f"The reference {reference!r} is not among the estimators compared: {', '.join(known)}.")
    if len({c.provenance.get("data_sha256") for c in calibrations.values()} - {None}) > 1:
        raise InputError("The calibrations are of different recordings (data_sha256), and cannot be compared.")
    usable = [name for name, c in calibrations.items() if c.status in USABLE]
    chosen = reference if reference in usable else min(usable, key=_rank, default=None)
    pairs: dict[str, Pair] = {}
    if chosen is not None:
        others = {name: calibrations[name] for name in usable if name != chosen}
        shared = {name: _shared(c, calibrations[chosen]) for name, c in others.items()}
        count = sum(int(mask.sum()) for mask in shared.values())
        for name, other in others.items():
            pairs[name] = _pair(name, other, chosen, calibrations[chosen], shared[name], count, len(others))
    return Comparison(
        calibrations=dict(calibrations),
        reference=chosen,
        pairs=pairs,
        seconds=dict(seconds or {}),
        failures=failures,
        left_out=dict(left_out or {}),
        truth=truth,
        notes=tuple(_notes(calibrations, reference, chosen, pairs)),
    )


def default_estimators(recording: Recording) -> tuple[tuple[str, ...], dict[str, str]]:
    """Estimators of :data:`ESTIMATORS` that can run here and on this recording; the others with the reason.

    Returns
    -------
    names : tuple of str
    left_out : dict of str to str
    """
    names, left_out = [], {}
    for name in ESTIMATORS:
        try:
            find_estimator(name)
            if name == "closed-form" and automatic_estimator(recording) != name:
                raise DataError(
                    "The closed form needs labelled sequences of Table 1 on a fixture, and this recording has none."
                )
        except SrtError as error:
            left_out[name] = str(error)
        else:
            names.append(name)
    return tuple(names), left_out


def run_estimators(
    recording: Recording,
    names: Sequence[str],
    options: Options | None = None,
    progress: Progress | None = None,
) -> tuple[dict[str, Calibration], dict[str, float], dict[str, str]]:
    """Calibrate one recording with several estimators; one that fails does not stop the others.

    Parameters
    ----------
    recording : Recording
    names : sequence of str
    options : Options, optional
        The same for all.
    progress : callable, optional
        Called after every play-back with the estimator's name, its number and the largest correction.

    Returns
    -------
    calibrations : dict of str to Calibration
    seconds : dict of str to float
        Of every estimator, without the import of its module.
    failures : dict of str to str
        Why an estimator gave no result.

    Raises
    ------
    InputError
        An estimator that is not registered, or whose packages are not installed.
    """
    options = Options() if options is None else options
    calibrations: dict[str, Calibration] = {}
    seconds: dict[str, float] = {}
    failures: dict[str, str] = {}
    found = {name: find_estimator(name) for name in names}  # imported before any clock starts
    for name, estimator in found.items():
        started = perf_counter()
        try:
            calibrations[name] = estimator(recording, options, None if progress is None else partial(progress, name))
        except SrtError as error:
            failures[name] = str(error)
        seconds[name] = perf_counter() - started
    return calibrations, seconds, failures


def _listing(names: Iterable[str]) -> str:
    """Join names as a sentence does: "a, b and c"."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _some(names: Sequence[str]) -> str:
    """Name the first few, and count the others."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"


def _finite(values: Array) -> list[float | None]:
    """Numbers, and None for what JSON cannot hold."""
    return [value if math.isfinite(value) else None for value in values.tolist()]


def _rank(name: str) -> int:
    """Place in the order of efficiency, the most efficient first; strangers after those known."""
    return -ESTIMATORS.index(name) if name in ESTIMATORS else 1


def _names(mask: Mask) -> tuple[str, ...]:
    return tuple(name for name, chosen in zip(NAMES, mask, strict=True) if chosen)


def _ratio(a: Array, b: Array) -> Array:
    """a/b, NaN where b is not positive."""
    out: Array = np.divide(a, b, out=np.full(a.shape, np.nan), where=b > 0.0)
    return out


def _shared(a: Calibration, b: Calibration) -> Mask:
    """Parameters that two calibrations observed (a held one's sigma is NaN), with a sigma to judge them by."""
    mask: Mask = (a.sigma > 0.0) & (b.sigma > 0.0)
    return mask


def _pair(
    name: str, other: Calibration, reference_name: str, reference: Calibration, shared: Mask, count: int, pairs: int
) -> Pair:
    """Compare two estimates, one of ``pairs`` with ``count`` parameters in all."""
    scale = np.where(shared, np.fmax(other.sigma, reference.sigma), np.nan)
    difference = np.where(shared, other.errors.vector - reference.errors.vector, np.nan)
    excess = other.covariance - reference.covariance
    spread = np.maximum(np.sqrt(np.abs(np.diag(excess))), LEAST_SPREAD * scale)
    statistic, p_value = _joint((difference / scale)[shared], (excess / np.outer(scale, scale))[np.ix_(shared, shared)])
    return Pair(
        estimator=name,
        reference=reference_name,
        compared=shared,
        difference=difference,
        spread=spread,
        normalised=difference / spread,
        sigma_ratio=np.where(shared, _ratio(other.sigma, reference.sigma), np.nan),
        limit=_limit(count),
        chi_square=statistic,
        p_value=p_value,
        least_p_value=0.5 * FALSE_ALARM / pairs,
    )


def _limit(count: int) -> float:
    """Two-sided normal quantile that the largest of ``count`` draws exceeds with half of FALSE_ALARM (Šidák).

    Exact for independent draws; correlated ones exceed it more rarely.
    """
    alone = -math.expm1(math.log1p(-0.5 * FALSE_ALARM) / max(count, 1))
    return float(-ndtri(0.5 * alone))


def _joint(difference: Array, covariance: Array) -> tuple[float, float]:
    """Chi-square of differences in units of sigma, and its p-value.

    Parameters
    ----------
    difference : ndarray, shape (n,)
    covariance : ndarray, shape (n, n)
        Expected; of its eigenvalues the size counts, floored: where the two estimates are one, both are rounding.
    """
    if not difference.size:
        return 0.0, 1.0
    eigenvalues, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    variance = np.maximum(np.abs(eigenvalues), LEAST_SPREAD**2)
    statistic = float(np.sum((vectors.T @ difference) ** 2 / variance))
    return statistic, float(chdtrc(difference.size, statistic))


def _notes(
    calibrations: Mapping[str, Calibration], wanted: str | None, chosen: str | None, pairs: Mapping[str, Pair]
) -> Iterable[str]:
    """What a reader of the verdict should know besides, in sentences."""
    if wanted is not None and chosen not in (wanted, None):
        yield f"The reference asked for, {wanted}, gave no usable result; it is {chosen} instead."
    for name, calibration in calibrations.items():
        if calibration.status not in USABLE:
            status = calibration.status.replace("_", " ")
            yield f"{name} is not compared, its status being {status}: {calibration.message}"
    for name, pair in pairs.items():
        if pair.smaller_sigma:
            yield (
                f"{name} states a smaller sigma than {pair.reference} for {_some(pair.smaller_sigma)}: there "
                f"{pair.reference} is not the efficient one, or has enlarged its sigmas for its residuals."
            )
    usable = [name for name in calibrations if name in pairs or name == chosen]
    alone: dict[tuple[str, ...], list[str]] = {}
    for parameter in NAMES:
        holders = tuple(name for name in usable if parameter in calibrations[name].held)
        if holders and holders != tuple(usable):
            alone.setdefault(holders, []).append(parameter)
    for holders, parameters in alone.items():
        yield f"Held by {_listing(holders)} and not by the others: {_some(parameters)}."
