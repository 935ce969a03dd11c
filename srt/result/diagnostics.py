"""Further results of a calibration: what an estimator and the checks state beside the 27 errors."""

# Annotations are evaluated: srt.result.document reads files by them.
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from srt.arguments import former_name
from srt.result.consistency import SequenceResult, SequenceTest
from srt.result.repeatability import Repeatability
from srt.types import Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Innovation(SequenceResult):
    """Innovation test (NIS) of a sequence given those before, and the sigmas after it, shape (27,), SI."""

    nis: float
    degrees_of_freedom: int
    probability: float | None
    innovations: Array
    sigma: Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LiveEstimate(SequenceResult):
    """Estimate of a live filter after a sequence, SI.

    Attributes
    ----------
    status : str
    values, sigma : ndarray, shape (27,)
    nis, degrees_of_freedom, probability, innovations
        Innovation test of the sequence given those before.
    promised : bool
        True if linearised sigmas are reliable.
    targets_met : bool
    limiting : str or None
        Parameter with the largest ratio of sigma to target.
    """

    status: str
    values: Array
    sigma: Array
    nis: float
    degrees_of_freedom: int
    probability: float | None
    innovations: Array
    promised: bool
    targets_met: bool
    limiting: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """Required sigmas, SI.

    Attributes
    ----------
    wanted : mapping of str to float
        By parameter.
    met_after : str or None
        Sequence after which all are met.
    limiting : str or None
        Parameter with the largest ratio of final sigma to target.
    shortfall : float or None
        This ratio.
    """

    wanted: Mapping[str, float]
    met_after: str | None
    limiting: str | None
    shortfall: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """Distance of a filter's estimate from the optimum of all measurements, and range of the ratio of the sigmas."""

    distance_sigma: float
    parameter: str
    sigma_ratio: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceWeight(SequenceResult):
    """Weight of a sequence under a robust loss."""

    weight: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RestRateScatter:
    """Rms of the rest rates about their mean, shape (3,), rad/s: before and after Γ is subtracted, and by noise."""

    before: Array
    after: Array
    expected: Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GSensitivity:
    """Gyro g-sensitivity Γ, rows gyros and columns axes of MARS, shapes (3, 3).

    Attributes
    ----------
    matrix, sigma : ndarray, rad/s per m/s²
    covariance : ndarray, shape (9, 9), or None
        Covariance of the elements by rows; None in files of earlier versions.
    unit : str
    matrix_deg_per_h_per_g, sigma_deg_per_h_per_g : ndarray
    not_seen_along : ndarray, shape (m, 3)
        Unit vectors along which Γ is not observable.
    rest_rate_scatter_rad_s : RestRateScatter
    """

    matrix: Array
    sigma: Array
    covariance: Array | None = None
    unit: str = "rad/s per m/s^2"
    matrix_deg_per_h_per_g: Array
    sigma_deg_per_h_per_g: Array
    not_seen_along: Array
    rest_rate_scatter_rad_s: RestRateScatter


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Drift:
    """Bias drift of a sensor that the residuals show: form, and change of each channel over the recording."""

    sensor: str
    form: str
    change_rad_s: Array | None = None
    change_m_s2: Array | None = None
    modelled: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Undersampling:
    """Error of the rotations by motion too fast for the sample rate, or by the integration of a simulation.

    Attributes
    ----------
    share : float
        Error over the motion near half the sample rate; 0.4 is expected, to 30 %. Without noise: over the angle.
    angle_rad : float
        1-sigma error of each axis, root mean square over the rotations.
    noise_free : bool
        The readings have no noise but rounding.
    """

    share: float
    angle_rad: float
    noise_free: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Value and 1-sigma of a parameter, SI."""

    value: float
    sigma: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AsymmetryTest:
    """Test that all asymmetries of a group are zero, and the parameters that it affects most without them."""

    estimated: tuple[str, ...]
    chi_square: float
    degrees_of_freedom: int
    probability: float
    without: Mapping[str, Estimate]


@dataclass(frozen=True, slots=True, kw_only=True)
class UnseenError:
    """Error that no residual shows.

    Attributes
    ----------
    source : str
    unit : str
    sigma : float or None
        Stated 1-sigma of the error in ``unit``.
    group, axes : str
        Parameters that it changes.
    coefficient : float
        Change by one ``unit``, in ``group_unit``; its largest size where ``largest`` is true.
    group_unit : str
    largest : bool
    sentence : str
    """

    source: str
    unit: str
    sigma: float | None
    group: str
    axes: str
    coefficient: float
    group_unit: str
    largest: bool
    sentence: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RecognisedSequence(SequenceResult):
    """Sequence that was recognised: its stationary windows and the confidence."""

    start_static_s: tuple[float, float]
    end_static_s: tuple[float, float]
    confidence: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RecognisedSequences:
    """Sequences that were recognised, with a sentence on all."""

    summary: str
    sequences: tuple[RecognisedSequence, ...]


@dataclass(frozen=True, slots=True)
class RunnerUp:
    """Fault that explains the same data nearly as well, and its difference of log-likelihood from the best fault."""

    fault: str
    log_likelihood_lower: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Fault of the recording: key in the catalogue, effect on the calibration, sentence and its values."""

    fault: str
    effect: str
    sentence: str
    details: Mapping[str, Any]
    runner_up: RunnerUp | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Diagnostics:
    """Further results; None for those that an estimator does not have.

    Attributes
    ----------
    sequences : tuple of SequenceTest, or None
    filter : tuple of Innovation, or None
        Kalman filter, in the order of the sequences.
    targets : Targets or None
    optimum : Optimum or None
        Filters that process the test once.
    loss : str or None
        Robust loss of the factor graph.
    weights : tuple of SequenceWeight, or None
    g_sensitivity : GSensitivity or None
    possible_accel_drift_sigma_m_s2 : float or None
        1-sigma of the change of the accelerometer biases over the recording by a drift that is not significant.
    drift : tuple of Drift, or None
    undersampling : Undersampling or None
    before_integration : Diagnostics or None
        Results before windows that moved were integrated.
    unused_moves : int or None
        Number of recorded moves that the closed form does not use.
    sigma_with_moves : (float, float) or None
        Smallest and largest sigma of least squares, which uses them, over that of the result.
    asymmetry : mapping of str to AsymmetryTest, or None
        By group.
    unseen_errors : tuple of UnseenError, or None
    contradicted : tuple of str, or None
        Sentences on statements of the recording that its time stamps or the Earth contradict, and on values that the
        moves contradict.
    not_shown : tuple of str, or None
        Parameters that a recording of this kind should show, and that this one does not.
    refits : tuple of int, or None
        Numbers of the iterations, from 1, at which the corrections grow because another model is fitted.
    live : tuple of LiveEstimate, or None
    recognition : RecognisedSequences or None
    faults : tuple of Fault, or None
    repeatability : Repeatability or None
        Merged calibrations.
    further : mapping of str to object
        Output of estimators of other distributions, as JSON values beside the others.
    """

    sequences: tuple[SequenceTest, ...] | None = None
    filter: tuple[Innovation, ...] | None = None
    targets: Targets | None = None
    optimum: Optimum | None = None
    loss: str | None = None
    weights: tuple[SequenceWeight, ...] | None = None
    g_sensitivity: GSensitivity | None = None
    possible_accel_drift_sigma_m_s2: float | None = None
    drift: tuple[Drift, ...] | None = None
    undersampling: Undersampling | None = None
    before_integration: "Diagnostics | None" = field(default=None, metadata={"key": "held"})
    unused_moves: int | None = None
    sigma_with_moves: tuple[float, float] | None = None
    asymmetry: Mapping[str, AsymmetryTest] | None = None
    unseen_errors: tuple[UnseenError, ...] | None = None
    contradicted: tuple[str, ...] | None = None
    not_shown: tuple[str, ...] | None = None
    refits: tuple[int, ...] | None = None
    live: tuple[LiveEstimate, ...] | None = None
    recognition: RecognisedSequences | None = None
    faults: tuple[Fault, ...] | None = None
    repeatability: Repeatability | None = None
    further: Mapping[str, Any] = field(default_factory=dict)

    @property
    def held(self) -> "Diagnostics | None":
        """Former name of ``before_integration``."""
        return former_name("Diagnostics.held", "before_integration", self.before_integration)
