"""Recordings of two units, or of one that was restarted or switched, joined into one: steps between two sequences.

Three sets of residuals show them: the stationary rates, the magnitudes of the stationary specific force, which the
attitude of the fixture does not enter, and the angles of the rotations. The first two are weighted by white noise and
the stated bias instability. A step between two sequences competes with a drift of the same parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtrc

from srt.diagnosis.cause_comparison import Cause, compare
from srt.diagnosis.findings import FALSE_ALARM, check, finding
from srt.diagnosis.rotation_readings import computed_once, raw_integrals, robust_fit, rotation_angles
from srt.diagnosis.site import BIAS, DRIFT, stationary_rates
from srt.noise.bias_instability import flicker_covariance
from srt.sequences.stationary_windows import MIN_TURN_RAD

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.cause_comparison import Explanation
    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.diagnosis.site import StationaryRates
    from srt.types import Array, Indices

_LEAST_SEQUENCES: Final = 3
"""Sequences on each side of a step at least: one alone is a disturbance."""
_SLOWNESS: Final = (0.1, 0.3)
"""Time constants of a warm-up tried beside a linear drift, relative to the test."""
_OUTLIER: Final = 8.0
"""Residual over the median residual, above which a rotation is an outlier."""
_MOST_OUTLIERS: Final = 0.2
"""Share of outliers from which they are none."""
_LEAST_FREEDOM: Final = 8
"""Degrees of freedom, fewer of which do not tell the scatter."""


@check("units_joined")
def units_joined(evidence: Evidence) -> Iterator[Finding]:
    """Compare steps between any two sequences with a drift, in gyros and accelerometers."""
    rates, data = stationary_rates(evidence), evidence.data
    if rates is None or data is None or not evidence.has_labels or _has_poses(evidence):
        return  # single poses beside turns differ by more than noise: they are not all placed as accurately
    order = np.argsort(data.windows.samples[data.start, 0])
    place = np.zeros(len(data.windows.samples), dtype=np.intp)
    place[data.start[order]] = place[data.end[order]] = np.arange(data.K)
    place = place[rates.window]
    time = 0.5 * (rates.start + rates.end)
    share = (time - time.min()) / np.ptp(time)
    cuts = range(_LEAST_SEQUENCES, data.K - _LEAST_SEQUENCES + 1)
    shapes = [("gyro_bias_drift", share, 3), *(("gyro_bias_drift", np.exp(-share / slow), 3) for slow in _SLOWNESS)]
    shapes += [("units_joined", (place >= cut).astype(np.float64), len(cuts)) for cut in cuts]
    every = (_gyros(evidence, rates, shapes), _forces(evidence, rates, shapes), _angles(evidence, rates.window, shapes))
    ranked = [found for found in every if found]
    if not ranked or not cuts:
        return
    score = np.sum([[e.score for e in explained[1:]] for explained in ranked], axis=0)
    drifts = 1 + len(_SLOWNESS)
    best = drifts + int(np.argmax(score[drifts:]))
    doubt = min(_probability(explained[0], explained[1 + best]) for explained in ranked)
    if doubt < FALSE_ALARM / (len(ranked) * len(cuts)) and score[best] - score[:drifts].max() > -np.log(FALSE_ALARM):
        at = cuts[best - drifts]
        yield finding(
            "units_joined",
            before=evidence.title(int(order[at - 1])),
            after=evidence.title(int(order[at])),
            ratio=float(score[best] - score[:drifts].max()),
        )


def _has_poses(evidence: Evidence) -> bool:
    """True if some sequence is a pose without a rotation."""
    turned = raw_integrals(evidence)
    return turned is None or bool(np.any(turned.absolute.max(axis=1) < MIN_TURN_RAD))


def _probability(null: Explanation, step: Explanation) -> float:
    """Probability of as large a reduction of the residuals by chance (F test)."""
    more = null.freedom - step.freedom
    if more <= 0 or step.freedom < _LEAST_FREEDOM:
        return 1.0
    return float(fdtrc(more, step.freedom, (null.square - step.square) / more / (step.square / step.freedom)))


def _explained(values: Array, nuisance: Array, shapes: list[tuple[str, Array, int]], moved: Array) -> list[Explanation]:
    """Explanations in the order of the shapes, after that by nothing; ``moved`` are the columns that a shape scales."""
    causes = [Cause("", np.zeros((len(values), 0)), {"place": 0})]
    causes += [
        Cause(fault, moved @ shape, {"place": 1 + place}, choices)
        for place, (fault, shape, choices) in enumerate(shapes)
    ]
    return sorted(compare(values, causes, nuisance), key=lambda explanation: explanation.cause.details["place"])


def _gyros(evidence: Evidence, rates: StationaryRates, shapes: list[tuple[str, Array, int]]) -> list[Explanation]:
    """Explanations of the stationary rates; empty without a stated bias instability, or with too few windows."""
    if evidence.recording.noise.gyro_bias_instability is None:
        return []
    W, columns = len(rates.rate), rates.columns
    fixed = np.delete(columns, np.r_[DRIFT], axis=2)
    roots = [np.linalg.cholesky(rates.covariance[axis]) for axis in range(3)]

    def whitened(table: Array) -> Array:
        return np.concatenate([solve_triangular(L, table[:, axis], lower=True) for axis, L in enumerate(roots)])

    # The whitened effect of a bias of each window alone: shape (3 W, 3, W).
    own = (columns[:, :, BIAS, None] * np.eye(W)[:, None, None, :]).reshape(W, 3, -1)
    return _explained(whitened(rates.rate), whitened(fixed), shapes, whitened(own).reshape(3 * W, 3, W))


class _Angles(NamedTuple):
    """Rotations without outliers: sequences, angles, |nominal| by axis, columns of scale factor and asymmetry."""

    sequence: Indices
    measured: Array
    by_axis: Array
    fixed: Array


@computed_once
def _rotations(evidence: Evidence) -> _Angles | None:
    """Measured angles of the rotations; None with too few on a fixture.

    A rotation with lost samples, or of another angle, is an outlier, while a step changes many.
    """
    if evidence.data is None or evidence.recording.fixture is None:
        return None
    numbers, nominal, turned = rotation_angles(evidence)
    measured = np.einsum("la,la->l", turned, nominal) / np.linalg.norm(nominal, axis=1)
    by_axis = np.abs(nominal)
    fixed = np.concatenate([by_axis, nominal], axis=1)
    if len(numbers) < _LEAST_FREEDOM + fixed.shape[1]:
        return None
    left = np.abs(measured - (fixed @ robust_fit(fixed, np.repeat(measured[:, None], 3, axis=1)))[:, 0])
    outlier = left > _OUTLIER * np.median(left)
    kept = ~outlier if outlier.mean() < _MOST_OUTLIERS else np.ones(len(numbers), dtype=np.bool_)
    return _Angles(numbers[kept], measured[kept], by_axis[kept], fixed[kept])


def _angles(evidence: Evidence, windows: Indices, shapes: list[tuple[str, Array, int]]) -> list[Explanation]:
    """Explanations of the measured angles by scale factors that change; empty with too few rotations on a fixture."""
    data, turns = evidence.data, _rotations(evidence)
    if data is None or turns is None:
        return []
    at = data.start[turns.sequence][:, None] == windows
    return _explained(turns.measured, turns.fixed, shapes, turns.by_axis[:, :, None] * at[:, None, :])


@check("gyro_scale_drift")
def gyro_scale_drift(evidence: Evidence) -> Iterator[Finding]:
    """Test the measured angles of the rotations for scale factors that drift, common to the gyros."""
    data, turns = evidence.data, _rotations(evidence)
    if data is None or turns is None:
        return
    time = evidence.recording.time[data.rotation[turns.sequence, 0]]
    share = (time - time.min()) / max(float(np.ptp(time)), 1e-300)
    shapes = [share, *(1.0 - np.exp(-share / slow) for slow in _SLOWNESS)]
    nothing = Cause("", np.zeros((len(share), 0)), {})
    size = np.linalg.norm(turns.by_axis, axis=1)
    causes = [Cause("gyro_scale_drift", (size * shape)[:, None], {}, len(shapes)) for shape in shapes]
    ranked = compare(turns.measured, [nothing, *causes], turns.fixed)
    null = next(e for e in ranked if not e.cause.fault)
    best = next(e for e in ranked if e.cause.fault)
    if _probability(null, best) < FALSE_ALARM / len(shapes):
        change, sigma = 1e6 * float(best.value[0]), 1e6 * float(best.sigma[0])
        yield finding("gyro_scale_drift", change_ppm=change, sigma_ppm=sigma)


def _forces(evidence: Evidence, rates: StationaryRates, shapes: list[tuple[str, Array, int]]) -> list[Explanation]:
    """Explanations of the magnitudes of specific force by face; empty without a stated bias instability."""
    data, instability = evidence.data, evidence.recording.noise.accel_bias_instability
    if data is None or instability is None:
        return []
    force = evidence.stationary_force[rates.window]
    size = np.linalg.norm(force, axis=1)
    if np.any(size == 0.0):
        return []
    up = force / size[:, None]
    axis = np.argmax(np.abs(up), axis=1)
    face = 2 * axis + (up[np.arange(len(up)), axis] > 0.0)
    faces, which = np.unique(face, return_inverse=True)
    dummies = np.eye(len(faces))[which]
    white = float(np.mean(data.noise.accel_white**2)) / (rates.end - rates.start)
    edge = 2.0 * (float(np.mean(data.noise.accel_edge)) / (rates.end - rates.start)) ** 2
    covariance = instability**2 * (up @ up.T) * flicker_covariance(rates.start, rates.end) + np.diag(white + edge)
    # An attitude that is off by the fixture's accuracy enters with the misalignments alone: rounding stands for it.
    L = np.linalg.cholesky(covariance + np.diag(1e-16 * size**2))
    own = dummies[:, :, None] * np.eye(len(up))[:, None, :]
    moved = solve_triangular(L, own.reshape(len(up), -1), lower=True).reshape(len(up), len(faces), len(up))
    return _explained(solve_triangular(L, size, lower=True), solve_triangular(L, dummies, lower=True), shapes, moved)
