"""Estimator ``least-squares``: the joint model, solved sequence by sequence by orthogonal triangularisation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srt.estimation.observability import default_prior
from srt.joint.block_solution import BlockSolution
from srt.joint.calibration_run import run
from srt.joint.linearisation import with_prior
from srt.joint.recording_opening import open_joint_model
from srt.joint.solver import JointSolver, LinearSolution

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.estimation.registry import Progress
    from srt.joint.linearisation import Linearisation
    from srt.model.prior import Prior
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration


class BlockSolver(JointSolver):
    """Least-squares solution of the linearised joint model (:mod:`srt.joint.block_solution`).

    Parameters
    ----------
    prior : Prior or None
    """

    name = "least-squares"

    def __init__(self, prior: Prior | None = None) -> None:
        self.prior = prior

    def solve(self, point: Linearisation) -> LinearSolution:
        """Solve for all columns."""
        whole = BlockSolution(with_prior(point.system, point.joint, point.state, self.prior))
        correction = point.columns.parameter_map() @ whole.delta
        return LinearSolution(whole.delta, correction, whole.covariance, whole)


def estimate(recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
    """Calibrate by least squares over all measurements.

    Raises
    ------
    InputError
        If an option belongs to another estimator.
    DataError
        As :func:`srt.sequences.checked_preparation.prepare_checked`.
    """
    options.refuse(("loss", "filter", "live", "targets"), "Least squares")
    return run(open_joint_model(recording, options), BlockSolver(options.prior or default_prior()), progress)
