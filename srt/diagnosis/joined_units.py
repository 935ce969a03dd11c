"""Steps of the sensor errors between two sequences: one recording of two units, a restart, or a switched range.

Three sets of residuals show a step: the stationary rates, the magnitudes of the stationary specific force (which do not
depend on the fixture's attitude), and the angles of the rotations. White noise and the stated bias instability weight
the first two sets. The likelihood of a step between two sequences is compared with that of a drift of the same
parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtrc

from srt.diagnosis.cause_comparison import Cause, compare
from srt.diagnosis.false_alarms import FALSE_ALARM
from srt.diagnosis.findings import Fault
from srt.diagnosis.stationary_rates import BIAS, DRIFT
from srt.diagnosis.triad_fits import LEAST_FREEDOM
from srt.sequences.stationary_windows import MIN_TURN_RAD

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.cause_comparison import Explanation
    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.diagnosis.stationary_rates import StationaryRates
    from srt.types import Array, Indices

_LEAST_SEQUENCES: Final = 3
"""Fewest sequences on each side of a step: a change of a single sequence is a disturbance."""
_SLOWNESS: Final = (0.1, 0.3)
"""Time constants of an exponential drift (warm-up), the alternative to a linear one, relative to the test duration."""


def units_joined(evidence: Evidence) -> Iterator[Finding]:
    """Test gyros and accelerometers for a step between two successive sequences, against a drift.

    Statistic: reduction of the squared residuals by a step, of rates, of specific forces or of angles. Distribution: F,
    with the number of stepping parameters and the degrees of freedom of the residuals.
    """
    rates, data = evidence.stationary_rates, evidence.data
    if rates is None or data is None or not evidence.has_labels or _has_poses(evidence):
        return  # static poses without a rotation are placed less accurately: their readings differ by more than noise
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
        yield UNITS_JOINED.found(
            before=evidence.title(int(order[at - 1])),
            after=evidence.title(int(order[at])),
            ratio=float(score[best] - score[:drifts].max()),
        )


UNITS_JOINED: Final = Fault(
    "units_joined",
    "Two units, or a restart, are joined in one recording",
    "stationary rates, magnitudes of specific force and rotation angles: a step between two sequences fits better than"
    " a drift",
    "The sensor errors change abruptly between {before} and {after} (log-likelihood higher by {ratio:.3g} than that of"
    " a drift): the recording joins two units, or the unit was restarted; calibrate each part separately.",
    "warning",
    units_joined,
)


def _has_poses(evidence: Evidence) -> bool:
    """True if some sequence is a static pose without a rotation."""
    turned = evidence.raw_integrals
    return turned is None or bool(np.any(turned.absolute.max(axis=1) < MIN_TURN_RAD))


def _probability(null: Explanation, step: Explanation) -> float:
    """p-value of the reduction of the residuals by a step (F test)."""
    more = null.freedom - step.freedom
    if more <= 0 or step.freedom < LEAST_FREEDOM:
        return 1.0
    return float(fdtrc(more, step.freedom, (null.square - step.square) / more / (step.square / step.freedom)))


def _explained(values: Array, nuisance: Array, shapes: list[tuple[str, Array, int]], moved: Array) -> list[Explanation]:
    """Explanation without a change, then one per shape (change over time), in their order.

    ``moved @ shape`` are the columns of a shape.
    """
    causes = [Cause("", np.zeros((len(values), 0)), {"place": 0})]
    causes += [
        Cause(fault, moved @ shape, {"place": 1 + place}, choices)
        for place, (fault, shape, choices) in enumerate(shapes)
    ]
    return sorted(compare(values, causes, nuisance), key=lambda explanation: explanation.cause.details["place"])


def _gyros(evidence: Evidence, rates: StationaryRates, shapes: list[tuple[str, Array, int]]) -> list[Explanation]:
    """Explanations of the stationary rates; empty without a stated bias instability."""
    if evidence.recording.noise.gyro_bias_instability is None:
        return []
    W, columns = len(rates.rate), rates.columns
    fixed = np.delete(columns, np.r_[DRIFT], axis=2)
    roots = [np.linalg.cholesky(rates.covariance[axis]) for axis in range(3)]

    def whitened(table: Array) -> Array:
        return np.concatenate([solve_triangular(L, table[:, axis], lower=True) for axis, L in enumerate(roots)])

    # Whitened effect of a separate bias in each window, shape (3 W, 3, W).
    own = (columns[:, :, BIAS, None] * np.eye(W)[:, None, None, :]).reshape(W, 3, -1)
    return _explained(whitened(rates.rate), whitened(fixed), shapes, whitened(own).reshape(3 * W, 3, W))


def _angles(evidence: Evidence, windows: Indices, shapes: list[tuple[str, Array, int]]) -> list[Explanation]:
    """Explanations of the measured angles by scale-factor changes; empty without a fixture or with few rotations."""
    data, turns = evidence.data, evidence.measured_angles
    if data is None or turns is None:
        return []
    at = data.start[turns.sequence][:, None] == windows
    return _explained(turns.measured, turns.fixed, shapes, turns.by_axis[:, :, None] * at[:, None, :])


def gyro_scale_drift(evidence: Evidence) -> Iterator[Finding]:
    """Test the measured angles of the rotations for a drift of the scale factors that is common to the gyros.

    Statistic: reduction of the squared residuals by a drift. Distribution: F, one degree of freedom and those of the
    residuals.
    """
    data, turns = evidence.data, evidence.measured_angles
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
        yield GYRO_SCALE_DRIFT.found(change_ppm=change, sigma_ppm=sigma)


GYRO_SCALE_DRIFT: Final = Fault(
    "gyro_scale_drift",
    "The gyro scale factors, or the clock, drift during the test",
    "trend of the measured rotation angles, compared with their scatter",
    "The measured rotation angles change by {change_ppm:+.3g} ± {sigma_ppm:.2g} ppm from the beginning to the end of "
    "the test: the gyro scale factors or the clock of the samples drift; let the unit warm up, and repeat the test.",
    "warning",
    gyro_scale_drift,
)


def _forces(evidence: Evidence, rates: StationaryRates, shapes: list[tuple[str, Array, int]]) -> list[Explanation]:
    """Explanations of specific-force magnitudes, with a mean per upward face; empty without stated bias instability."""
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
    covariance = instability**2 * (up @ up.T) * rates.flicker + np.diag(white + edge)
    # Attitude errors of the fixture act only through the misalignments: a relative sigma of 1e-8 allows for them.
    L = np.linalg.cholesky(covariance + np.diag(1e-16 * size**2))
    own = dummies[:, :, None] * np.eye(len(up))[:, None, :]
    moved = solve_triangular(L, own.reshape(len(up), -1), lower=True).reshape(len(up), len(faces), len(up))
    return _explained(solve_triangular(L, size, lower=True), solve_triangular(L, dummies, lower=True), shapes, moved)
