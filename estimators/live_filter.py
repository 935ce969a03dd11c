"""Kalman filter during a test: an estimate after every sequence, from all sequences so far.

With large sensor errors, a filter linearised about its own first estimate diverges. Every new sequence therefore first
updates a coarse, linear filter of the triads' matrices. Its measurements are the summed raw angles of the rotations
(reference: nominal angles) and the mean raw specific force of the poses (reference: nominal vertical), with the
standard deviation of the fixture. All sequences so far are then processed again from the original prior, linearised
about the coarse estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.accuracy_targets import compare_with_targets
from estimators.kalman_filter import KalmanSolver
from estimators.square_root_filter import SquareRootFilter
from srt.estimation.goodness_of_fit import chi_square_probability
from srt.estimation.initial_estimates import initial_estimate
from srt.estimation.observability import default_prior
from srt.exceptions import DataError, InputError
from srt.joint.iteration import iterate
from srt.joint.joint_model import JointModel
from srt.joint.solution_analysis import whole_solution
from srt.joint.solver import IterationState
from srt.model.gyro_stream import gyro_stream
from srt.model.sensor_model import Triad, to_mars
from srt.result.diagnostics import LiveEstimate
from srt.sensor_errors import GROUP_SLICES, NAMES
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.manoeuvres import end_attitude, rotation_angles

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.estimation.options import Options
    from srt.model.prior import Prior
    from srt.recording.recording import Recording, SequenceLabel
    from srt.sensor_errors import SensorErrors
    from srt.sequences.preparation import PreparedRecording
    from srt.types import Array


_MAX_STEP: Final = 0.1
"""Largest correction per iteration (dimensionless, rad, bias in g); few parameters are observable at first."""
_N: Final = 24
"""Unknowns of the coarse filter: gyro matrix (9), accelerometer matrix (9), accelerometer bias (3), gyro bias (3)."""


@dataclass(frozen=True, slots=True, eq=False)
class LiveReport:
    """Estimate after a sequence.

    Attributes
    ----------
    sequence : str
    occurrence : int
    status : str
        Status of the estimate: "converged", "not_converged" or "outside_model".
    errors : SensorErrors
    sigma : ndarray, shape (27,)
    nis : float
        Normalised innovation squared of this sequence, given all earlier ones.
    freedom : int
    innovations : ndarray, shape (freedom,)
    promised : bool
        True if every sigma is below 5 %, so that linearised sigmas are reliable.
    met : bool
        True if the sigmas are reliable and meet all targets.
    limiting : str or None
        Parameter with the largest ratio of sigma to target; None without targets.
    """

    sequence: str
    occurrence: int
    status: str
    errors: SensorErrors
    sigma: Array
    nis: float
    freedom: int
    innovations: Array
    promised: bool
    met: bool
    limiting: str | None

    @property
    def result(self) -> LiveEstimate:
        """Estimate as the result states it."""
        return LiveEstimate(
            sequence=self.sequence,
            occurrence=self.occurrence,
            status=self.status,
            values=self.errors.vector,
            sigma=self.sigma,
            nis=self.nis,
            degrees_of_freedom=self.freedom,
            probability=chi_square_probability(self.nis, self.freedom),
            innovations=self.innovations,
            promised=self.promised,
            targets_met=self.met,
            limiting=self.limiting,
        )


class LiveFilter:
    """Kalman filter to which sequences are added one by one.

    Parameters
    ----------
    options : Options
        Options, including the targets.

    Raises
    ------
    InputError
        If a recording has no fixture, or a label is not a sequence that the fixture can execute.
    """

    def __init__(self, options: Options) -> None:
        self.options = options
        self.prior = options.prior or default_prior()
        self.labels: list[SequenceLabel] = []
        self.coarse = CoarseFilter(self.prior)
        self.iteration: IterationState | None = None
        self.solver = KalmanSolver(self.prior)

    def add(self, recording: Recording, label: SequenceLabel) -> LiveReport:
        """Add a sequence.

        Parameters
        ----------
        recording : Recording
            All samples so far, including those of the new sequence.
        label : SequenceLabel
            The new sequence, later than all before it.

        Raises
        ------
        DataError
            If the sequence cannot be used, or the estimated triads are left-handed.
        """
        if recording.fixture is None or label.id is None:
            raise InputError("Live calibration needs labelled sequences on a fixture: give the whole recording.")
        if self.labels and label.start_static_s[0] < self.labels[-1].start_static_s[0]:
            raise InputError(f"{label.title} is earlier than the sequence before it: add sequences in their order.")
        alone = prepare_checked(recording.with_sequences((label,)), (label,), self.options.average)
        self.coarse.add(alone)
        self.labels.append(label)
        so_far = tuple(self.labels)
        data = prepare_checked(recording.with_sequences(so_far), so_far, self.options.average)
        # With few sequences there are several minima: the most probable one is used.
        starts = (self.coarse.estimate(), initial_estimate(data, self.options))
        self.solver, self.iteration = min((self._solve_from(data, start) for start in starts), key=_rank)
        return self._report(data)

    def _solve_from(
        self, data: PreparedRecording, start: tuple[SensorErrors, Array]
    ) -> tuple[KalmanSolver, IterationState]:
        """Process all sequences so far from the original prior, starting the iteration at ``start``."""
        joint, solver = JointModel(data, self.options, start), KalmanSolver(self.prior)
        requested = np.array([name in self.options.fixed_names for name in NAMES])
        iteration = IterationState(joint, joint.start, ~requested)
        with threadpool_limits(limits=1, user_api="blas"):
            return solver, iterate(solver, iteration, max_step=_MAX_STEP)

    def _report(self, data: PreparedRecording) -> LiveReport:
        assert self.iteration is not None
        found = self.solver.last
        if found is None or self.iteration.covariance is None:
            raise DataError(f"After {data.labels[-1].title} the filter cannot continue: {self.iteration.message}")
        sigma = self.iteration.sigma
        promised, met, limiting = compare_with_targets(sigma, self.options.targets)
        return LiveReport(
            sequence=data.ids[-1],
            occurrence=data.occurrences[-1],
            status=self.iteration.status,
            errors=self.iteration.state.errors,
            sigma=sigma,
            nis=float(found.nis[-1]),
            freedom=len(found.innovations[-1]),
            innovations=found.innovations[-1],
            promised=promised,
            met=met and self.iteration.status == "converged",
            limiting=limiting,
        )


def _rank(solution: tuple[KalmanSolver, IterationState]) -> tuple[bool, float]:
    """Sort key of solutions: converged ones first, then by the sum of squares of residuals and prior."""
    solver, iteration = solution
    if iteration.point is None or iteration.status == "outside_model":
        return True, math.inf
    residual = whole_solution(solver, iteration).residual
    return iteration.status != "converged", float(residual @ residual)


def run_live(recording: Recording, live: LiveFilter) -> Iterator[LiveReport]:
    """Add the sequences of a complete recording one by one."""
    for label in sorted(recording.sequences, key=lambda s: s.start_static_s[0]):
        yield live.add(recording, label)


class CoarseFilter:
    """Linear filter of the triads' matrices and biases, with the nominal motion of the fixture as reference.

    Parameters
    ----------
    prior : Prior
        Prior of the sensor errors; its standard deviations apply to the matrix elements and biases.
    """

    def __init__(self, prior: Prior) -> None:
        self.prior = prior
        sigma = np.sqrt(np.diag(prior.covariance))
        root = np.concatenate(
            [
                np.full(9, _largest(sigma, "gyro_scale", "gyro_orthogonality")),
                np.full(9, _largest(sigma, "accel_scale", "accel_misalignment")),
                sigma[GROUP_SLICES["accel_bias"]],
                sigma[GROUP_SLICES["gyro_bias"]],
            ]
        )
        self.gyro_asymmetry, self.accel_asymmetry = (
            _largest(sigma, "gyro_asymmetry"),
            _largest(sigma, "accel_asymmetry"),
        )
        mean = np.concatenate([np.eye(3).ravel(), np.eye(3).ravel(), np.zeros(6)])
        self.filter = SquareRootFilter(mean, np.diag(root))

    def add(self, data: PreparedRecording) -> None:
        """Update with the sequences of a session."""
        fixture = data.recording.fixture
        assert fixture is not None
        off = math.hypot(fixture.alignment_sigma_rad, fixture.rotation_sigma_rad)
        stream = gyro_stream(
            data.recording.gyro, data.recording.interval_s, data.rotation, data.rotation,
            rates=data.recording.kind == "rate",
        )  # fmt: skip
        nominal = data.nominal
        assert nominal is not None
        rest, force = data.windows.gyro_mean, data.windows.accel_mean
        earth = data.earth_rate_base()
        for k, sequence in enumerate(data.catalogue):
            assert sequence is not None
            start, end = data.start[k], data.end[k]
            rotations = rotation_angles(stream, k, sequence, 0.5 * (rest[start] + rest[end]))
            if rotations is not None:
                for rotation, axis, angle in zip(rotations, sequence.axes, sequence.angles_rad, strict=True):
                    error = math.hypot(off, self.gyro_asymmetry) * abs(angle) + fixture.rotation_sigma_rad
                    self._take(rotation, _matrix_rows(axis * angle, 0), error)
            down = nominal[k][2]
            for which, vertical in ((start, down), (end, end_attitude(sequence).T @ down)):
                H = _matrix_rows(-data.gravity * vertical, 9)
                H[:, 18:21] = np.eye(3)
                self._take(force[which], H, data.gravity * math.hypot(off, self.accel_asymmetry))
            H = _matrix_rows(nominal[k].T @ earth, 0)
            H[:, 21:] = np.eye(3)
            noise = data.noise.gyro_white.max() / math.sqrt(float(data.windows.duration_s[start]))
            self._take(rest[start], H, math.hypot(float(np.linalg.norm(earth)) * off, noise))

    def _take(self, z: Array, H: Array, sigma: float) -> None:
        self.filter.correct(z, H, noise_root=sigma * np.eye(3))

    def estimate(self) -> tuple[SensorErrors, Array]:
        """Sensor errors and U of the present estimate.

        Raises
        ------
        DataError
            If the estimated gyro triad is left-handed.
        """
        x = self.filter.x
        gyro = Triad(x[:9].reshape(3, 3), np.zeros(3), x[21:])
        errors, U = to_mars(gyro, Triad(x[9:18].reshape(3, 3), np.zeros(3), x[18:21]))
        return errors, U


def _matrix_rows(v: Array, first: int) -> Array:
    """Derivative of M v with respect to the states; elements of M start at state ``first``; shape (3, 24)."""
    H = np.zeros((3, _N))
    for row in range(3):
        H[row, first + 3 * row : first + 3 * row + 3] = v
    return H


def _largest(sigma: Array, *groups: str) -> float:
    return max(float(sigma[GROUP_SLICES[group]].max()) for group in groups)
