"""Steps of the sensor errors between two sequences: one recording of two units, a restart, or a switched range.

The stationary rates, the magnitudes of the stationary specific force, which no attitude changes, and the angles of the
rotations show a step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import fdtrc

from srt.diagnosis.cause_comparison import Cause, explain
from srt.diagnosis.false_alarms import FALSE_ALARM
from srt.diagnosis.findings import Fault
from srt.diagnosis.stationary_rates import whitened
from srt.diagnosis.triad_fits import LEAST_FREEDOM
from srt.noise.drift_forms import WARM_UP
from srt.sequences.stationary_windows import MIN_TURN_RAD

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.diagnosis.cause_comparison import Explanation
    from srt.diagnosis.evidence import Evidence
    from srt.diagnosis.findings import Finding
    from srt.diagnosis.stationary_rates import StationaryRates
    from srt.types import Array

_LEAST_SEQUENCES: Final = 3
"""Fewest sequences on each side of a step: a change of a single sequence is a disturbance."""


def units_joined(evidence: Evidence) -> Iterator[Finding]:
    """Test gyros and accelerometers for a step between two successive sequences, against a drift.

    Statistic: reduction of the squared residuals by a step, of rates, of specific forces or of angles. Distribution: F,
    with the number of stepping parameters and the degrees of freedom of the residuals.
    """
    rates, data, turned = evidence.stationary_rates, evidence.data, evidence.raw_integrals
    if rates is None or data is None or turned is None or not evidence.has_labels:
        return
    if np.any(turned.absolute.max(axis=1) < MIN_TURN_RAD):
        return  # static poses without a rotation are placed less accurately: their readings differ by more than noise
    cuts = range(_LEAST_SEQUENCES, data.K - _LEAST_SEQUENCES + 1)
    order = np.argsort(data.windows.samples[data.start, 0])
    place = np.zeros(len(data.windows.samples), dtype=np.intp)
    place[data.start[order]] = place[data.end[order]] = np.arange(data.K)
    drifts = _drifts(0.5 * (rates.start + rates.end))
    shapes = np.array([*drifts, *(place[rates.window] >= cut for cut in cuts)], dtype=np.float64)
    ranked = [_explained(y, fixed, own @ shapes.T, len(drifts)) for y, fixed, own in _residuals(evidence, rates)]
    if not ranked or not cuts:
        return
    score = np.sum([[e.score for e in explained[1:]] for explained in ranked], axis=0)
    best = len(drifts) + int(np.argmax(score[len(drifts) :]))
    more = float(score[best] - score[: len(drifts)].max())
    doubt = min(_probability(explained[0], explained[1 + best]) for explained in ranked)
    if doubt < FALSE_ALARM / (len(ranked) * len(cuts)) and more > -np.log(FALSE_ALARM):
        before, after = (evidence.title(int(k)) for k in order[cuts[best - len(drifts)] - 1 :][:2])
        yield UNITS_JOINED.found(before=before, after=after, ratio=more)


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


def _drifts(time: Array) -> list[Array]:
    """Shapes of a drift over the times, from zero upwards: linear, and those of a warm-up."""
    share = (time - time.min()) / max(float(np.ptp(time)), 1e-300)
    return [share, *(-np.expm1(-share / slow) for slow in WARM_UP.values())]


def _probability(null: Explanation, step: Explanation) -> float:
    """p-value of the reduction of the residuals by a step (F test)."""
    more = null.freedom - step.freedom
    if more <= 0 or step.freedom < LEAST_FREEDOM:
        return 1.0
    return float(fdtrc(more, step.freedom, (null.square - step.square) / more / (step.square / step.freedom)))


def _explained(values: Array, nuisance: Array, changes: Array, drifts: int) -> list[Explanation]:
    """Explanation without a change, then one for each change, shape (n, k, changes); the first ones are drifts."""
    count = changes.shape[2]
    causes = [Cause("change", changes[:, :, i], {}, drifts if i < drifts else count - drifts) for i in range(count)]
    return explain(values, [Cause("", np.zeros((len(values), 0)), {}), *causes], nuisance)


def _residuals(evidence: Evidence, rates: StationaryRates) -> Iterator[tuple[Array, Array, Array]]:
    """Residuals of equal variance, nuisance columns, and the effect of a separate change in each window, (n, k, W).

    With a stated bias instability, these are the stationary rates, which a bias changes, and the magnitudes of specific
    force with a mean for each upward face; on a fixture, the measured angles, which a scale factor changes.
    """
    data, turns, noise = evidence.data, evidence.measured_angles, evidence.recording.noise
    windows = np.eye(len(rates.rate))
    if noise.gyro_bias_instability is not None:
        own = np.einsum("ij,wv->wijv", np.eye(3), windows)
        values, fixed, moved = (whitened(rates.covariance, table) for table in (rates.rate, rates.columns, own))
        yield values, fixed, moved
    force = evidence.stationary_force[rates.window]
    size = np.linalg.norm(force, axis=1)
    if data is not None and noise.accel_bias_instability is not None and np.all(size > 0.0):
        up = force / size[:, None]
        upward = np.abs(up) == np.abs(up).max(axis=1, keepdims=True)
        faces = np.hstack([upward & (up > 0.0), upward & (up <= 0.0)]).astype(np.float64)
        faces = faces[:, faces.any(axis=0)]
        T = rates.end - rates.start
        white = float(np.mean(data.noise.accel_white**2)) / T + 2.0 * (float(np.mean(data.noise.accel_edge)) / T) ** 2
        # Attitude errors of the fixture act only through the misalignments: a relative sigma of 1e-8 allows for them.
        drift = noise.accel_bias_instability**2 * (up @ up.T) * rates.flicker
        covariance = drift + np.diag(white + 1e-16 * size**2)
        own = faces[:, :, None] * windows[:, None, :]
        values, fixed, moved = (whitened(covariance[None], table[:, None]) for table in (size, faces, own))
        yield values, fixed, moved
    if data is not None and turns is not None:
        at = data.start[turns.sequence][:, None] == rates.window
        yield turns.measured, turns.fixed, turns.by_axis[:, :, None] * at[:, None, :]


def gyro_scale_drift(evidence: Evidence) -> Iterator[Finding]:
    """Test the measured angles of the rotations for a drift of the scale factors that is common to the gyros.

    Statistic: reduction of the squared residuals by a drift. Distribution: F, one degree of freedom and those of the
    residuals.
    """
    data, turns = evidence.data, evidence.measured_angles
    if data is None or turns is None:
        return
    time = evidence.recording.time[data.rotation[turns.sequence, 0]]
    shapes = np.array(_drifts(time))
    changes = (np.linalg.norm(turns.by_axis, axis=1) * shapes).T[:, None, :]
    null, *drifts = _explained(turns.measured, turns.fixed, changes, len(shapes))
    best = max(drifts, key=lambda explanation: explanation.score)
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
