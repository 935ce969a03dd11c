"""Consistency of the measurements of a calibration: chi-square, leave-one-out tests, observability."""

# Annotations are evaluated: srt.result.document reads files by them.
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True, kw_only=True)
class ChiSquareTest:
    """Chi-square with its p-value; None without degrees of freedom."""

    chi_square: float
    degrees_of_freedom: int
    probability: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceResult:
    """Result of one run of a sequence; of merged calibrations, of one recording."""

    sequence: str
    occurrence: int

    @property
    def title(self) -> str:
        """Name, with the number of the run after the first."""
        return f"{self.sequence} ({self.occurrence})" if self.occurrence > 1 else self.sequence


@dataclass(frozen=True, slots=True, kw_only=True)
class Contradiction(SequenceResult):
    """Sequence that contradicts all others, with the p-value."""

    probability: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceTest(SequenceResult):
    """Chi-square of a sequence against the prediction from all others."""

    chi_square: float
    degrees_of_freedom: int
    probability: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Influence:
    """Shift of a parameter without a sequence, in sigma."""

    parameter: str
    sigmas: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaveOneOut(SequenceTest):
    """Leave-one-out test of a sequence.

    Attributes
    ----------
    checkable : "yes", "partly" or "no"
    only_witness_of : tuple of str
        Parameters that this sequence alone determines in part.
    lost_without : tuple of str
        Parameters that are not observable without it.
    largest_influence : Influence or None
    influence : mapping of str to float or None
        Shift of every parameter without it, in sigma; None for lost parameters.
    """

    checkable: str
    only_witness_of: tuple[str, ...]
    lost_without: tuple[str, ...]
    largest_influence: Influence | None
    influence: Mapping[str, float | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class InformationShare(SequenceResult):
    """Share of a parameter's information that is lost without a sequence."""

    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """Correlation of a parameter's error with that of another."""

    with_: str
    value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterObservability:
    """Observability of a parameter.

    Attributes
    ----------
    name : str
    sigma : float, SI
    witnesses : float or None
        Effective number of sequences that determine it.
    shown_by : tuple of InformationShare
        Sequences with a notable share, the largest first.
    information : tuple of float
        Share by sequence.
    variance_inflation : float
        Variance over that with all other parameters known.
    largest_correlation : Correlation or None
    """

    name: str
    sigma: float
    witnesses: float | None
    shown_by: tuple[InformationShare, ...]
    information: tuple[float, ...]
    variance_inflation: float
    largest_correlation: Correlation | None


@dataclass(frozen=True, slots=True, kw_only=True)
class WeakestCombination:
    """Combination of parameters whose sigma the data reduce least, relative to the prior sigma."""

    sigma_over_prior: float
    combination: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class AddedNoise:
    """Unmodelled noise that was added, and noise of the sensors, 1-sigma, SI."""

    added: float
    own: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Consistency(ChiSquareTest):
    """Consistency of the measurements: chi-square with the noise as used, and its parts.

    Attributes
    ----------
    contradicting : Contradiction or None
    sequences : tuple of LeaveOneOut
        In the order of the sequences.
    parameters : tuple of ParameterObservability
        Observed parameters.
    weakest_combination : WeakestCombination or None
    own_noise : ChiSquareTest or None
        With the noise of the sensors alone; None for merged calibrations.
    added_noise : mapping of str to AddedNoise, or None
        By kind: "rotation_rad", "force_m_s2", "rate_rad_s", and of the fixture, whose own is the stated accuracy,
        "wobble_rad", "start_angle_rad", "alignment_rad", and "turned_angle_rad", which enters no sigma: the gyros
        measure the rotations.
    sigma_factor : (float, float) or None
        Smallest and largest sigma over that of the noise of the sensors.
    between_recordings : bool or None
        True if the sigmas of a merged calibration include a scatter between recordings.
    doubtful_recordings : tuple of str, or None
        Merged recordings with a doubtful verdict.
    """

    contradicting: Contradiction | None = None
    sequences: tuple[LeaveOneOut, ...] = ()
    parameters: tuple[ParameterObservability, ...] = ()
    weakest_combination: WeakestCombination | None = None
    own_noise: ChiSquareTest | None = None
    added_noise: Mapping[str, AddedNoise] | None = None
    sigma_factor: tuple[float, float] | None = None
    between_recordings: bool | None = None
    doubtful_recordings: tuple[str, ...] | None = None
    nulls: tuple[str, ...] = field(default=("contradicting", "weakest_combination"), compare=False)

    @property
    def sensor_noise_test(self) -> ChiSquareTest:
        """Test against the noise of the sensors; of merged calibrations, against the sigmas of the recordings."""
        return self.own_noise or self
