"""How large readings are against what is known: turns against their labels, rest against gravity, by axis.

A unit may be off by half before it is calibrated, and differently by axis; a wrong unit or rate is off by one factor
on all of them. So what matters beside the factor is how alike the axes are, and whether one axis agrees with itself
over all turns and poses: where it does not, labels or windows are wrong and nothing is said about scales.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.diagnosis.frame_evidence import gravity_relation, turns_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.diagnosis.evidence import Evidence

    Array = NDArray[np.float64]

_MAD: Final = 1.4826
"""Sigma over median absolute deviation of a normal distribution."""


@dataclass(frozen=True, slots=True, eq=False)
class Scales:
    """Reading over truth of one triad.

    Attributes
    ----------
    typical : float
        Of the whole triad, by the median; NaN if nothing tells.
    axes : ndarray, shape (3,)
        By sensor axis; NaN where nothing tells.
    scatter : float
        One sigma by which the logarithm of one turn's or pose's ratio differs from that of its axis.
    """

    typical: float
    axes: Array
    scatter: float

    @property
    def known(self) -> bool:
        """Whether the triad has a positive, finite ratio."""
        return math.isfinite(self.typical) and self.typical > 0.0

    @property
    def by_axis(self) -> bool:
        """Whether each axis has one."""
        return bool(np.all(np.isfinite(self.axes)) and np.all(self.axes > 0.0))

    @property
    def common(self) -> float:
        """Mean logarithm of the three axes."""
        return float(np.mean(np.log(self.axes)))

    @property
    def unlike(self) -> float:
        """One sigma of the logarithm of an axis about the others, the scatter within axes included."""
        return math.hypot(float(np.std(np.log(self.axes), ddof=1)), self.scatter)


_RELATION_SIGMA: Final = 0.02
"""Of the logarithm of an axis, by the turning of gravity: pushes of a hand, and misalignment."""
_AGREE: Final = 0.2
_UNSEEN: Final = np.full(3, np.nan)
NOTHING: Final = Scales(float("nan"), _UNSEEN, float("nan"))


def gyro_scales(evidence: Evidence) -> Scales:
    """Turned against stated angles; of free turns, the gyros against the turning of gravity.

    Magnitudes only, each counted for the gyro that read most of it: whatever the axes, their signs and the sense of
    single turns, and by medians, so that a few wrong labels do not matter.
    """
    by_labels = _by_labels(evidence)
    if evidence.labelled and by_labels.known:
        return by_labels
    relation = gravity_relation(evidence)
    if relation is None:
        return by_labels
    axes = 1.0 / np.linalg.norm(relation, axis=0)
    by_gravity = Scales(float(np.median(axes)), axes, _RELATION_SIGMA)
    # Whoever counts turns in right angles may take half a turn for a quarter.
    agree = by_labels.known and abs(math.log(by_labels.typical / by_gravity.typical)) < _AGREE
    return by_labels if agree else by_gravity


def _by_labels(evidence: Evidence) -> Scales:
    if evidence.data is None:
        return NOTHING
    _, nominal, turned = evidence.legs
    if len(nominal) == 0:
        return NOTHING
    ratio = np.linalg.norm(turned, axis=1) / np.linalg.norm(nominal, axis=1)
    most = np.argmax(np.abs(turned), axis=1)
    axes = np.array([np.median(ratio[most == i]) if np.any(most == i) else np.nan for i in range(3)])
    if not np.all(ratio > 0.0):
        return Scales(float(np.median(ratio)), axes, math.inf)
    off = np.abs(np.log(ratio / axes[most]))
    fixture = evidence.recording.fixture
    executed = 0.0 if fixture is None else fixture.rotation_sigma_rad / math.pi
    return Scales(float(np.median(ratio)), axes, math.hypot(_MAD * float(np.median(off)), executed))


def accel_scales(evidence: Evidence) -> Scales:
    """Specific force at rest against gravity; by axis where the stated poses span space."""
    turns = turns_of(evidence)
    if turns is None or len(turns.force) == 0:
        return NOTHING
    gravity = evidence.recording.site.gravity_m_s2
    ratio = np.linalg.norm(turns.force, axis=1) / gravity
    typical = float(np.median(ratio))
    if not np.all(ratio > 0.0):
        return Scales(typical, _UNSEEN, math.inf)
    fit = None if evidence.data is None else evidence.accel_fit
    if fit is None or fit.rank < 3:
        return Scales(typical, _UNSEEN, _MAD * float(np.median(np.abs(np.log(ratio / typical)))))
    axes = np.linalg.norm(fit.matrix, axis=1)
    off = np.median(np.abs(fit.residual), axis=0) / (gravity * typical)
    return Scales(typical, axes, _MAD * float(off.max()))


def rest_spread(evidence: Evidence) -> float:
    """Logarithm of the upper over the lower quartile of specific force at rest; infinite without rest."""
    turns = turns_of(evidence)
    if turns is None or len(turns.force) == 0:
        return math.inf
    low, high = np.quantile(np.linalg.norm(turns.force, axis=1), (0.25, 0.75))
    return math.log(high / low) if low > 0.0 else math.inf
