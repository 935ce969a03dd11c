"""Solver result: the common form in which every estimator hands over its solution."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from srt.estimation.error_sources import NO_ERRORS
from srt.result.diagnostics import Diagnostics

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.estimation.drift_model import DriftEstimate
    from srt.estimation.error_sources import UnmodelledErrors
    from srt.estimation.leave_one_out import SequenceDiagnostics
    from srt.estimation.scale_changes import ScaleChange
    from srt.result.calibration import Residual
    from srt.sensor_errors import SensorErrors
    from srt.types import Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SolverResult:
    """Solution of an estimator, complete enough to build a calibration.

    Attributes
    ----------
    errors : SensorErrors
    U : ndarray, shape (3, 3)
        T to MARS components; ignored without a fixture.
    covariance : mapping of str to ndarray, shape (27, 27)
        By source of error.
    corrections : tuple of float
        Largest correction of each iteration.
    refits : tuple of int
        See :class:`srt.estimation.iterations.Iterations`.
    status, message : str
    residuals : tuple of Residual
    chi_square : float
        Smallest weighted square sum of the residuals.
    degrees_of_freedom : int
    sensor_noise_fit : tuple of float and int
        Chi-square and degrees of freedom with the noise of the sensors alone.
    unmodelled : UnmodelledErrors
        Unmodelled errors that were added to the noise.
    integrated : tuple of int
        Windows whose attitude was integrated.
    wander : ndarray, shape (3,), rad/s
        1-sigma of a sequence's gyro bias about the mean of the test (sensor axes).
    bias_by_sequence : ndarray, shape (K, 3), rad/s
    end_attitude : ndarray, shape (K, 3, 3)
        C_End of every sequence as the gyros measured it.
    total : ndarray, shape (27, 27), optional
        Covariance as the estimator itself computes it; default the sum over the sources.
    diagnostics : Diagnostics
        Further output of the estimator.
    force_fit : tuple of float and int, optional
        Chi-square and degrees of freedom of the residuals of the specific forces alone, where no noise is added.
    sequences : tuple of SequenceDiagnostics
        Leave-one-out diagnostics of every sequence, where the estimator computes them.
    drift : tuple of DriftEstimate
        Bias drift within the recording that the residuals show.
    scale_change : ScaleChange, optional
        Most likely change of scale factors within the recording, where the residuals do not agree.
    notes : tuple of str
        Warnings on effects beyond the 27 errors, for a usable result.
    """

    errors: SensorErrors
    U: Array
    covariance: Mapping[str, Array]
    corrections: tuple[float, ...]
    status: str
    message: str
    residuals: tuple[Residual, ...]
    chi_square: float
    degrees_of_freedom: int
    sensor_noise_fit: tuple[float, int]
    refits: tuple[int, ...] = ()
    unmodelled: UnmodelledErrors = NO_ERRORS
    integrated: tuple[int, ...]
    wander: Array
    bias_by_sequence: Array
    end_attitude: Array
    total: Array | None = None
    diagnostics: Diagnostics = field(default_factory=Diagnostics)
    force_fit: tuple[float, int] = (0.0, 0)
    sequences: tuple[SequenceDiagnostics, ...] = ()
    drift: tuple[DriftEstimate, ...] = ()
    scale_change: ScaleChange | None = None
    notes: tuple[str, ...] = ()
