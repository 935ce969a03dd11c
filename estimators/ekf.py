"""Estimator ``ekf``: Kalman filter iterated over the whole test, or live after every sequence."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.covariance_filter import CovarianceFilter
from estimators.kalman_filter import KalmanSolver
from estimators.sequential_filter import SequentialFilter, initial_prior, run_sequentially
from estimators.square_root_filter import SquareRootFilter
from estimators.unscented_filter import UnscentedFilter
from srt.estimation.iterations import PARAMETER_UNITS
from srt.estimation.observability import default_prior
from srt.joint.calibration_run import run
from srt.joint.recording_opening import open_joint_model
from srt.sensor_errors import NAMES

if TYPE_CHECKING:
    from srt.estimation.options import Options
    from srt.estimation.registry import Progress
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration


def estimate(recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
    """Calibrate by the iterated extended Kalman filter.

    Raises
    ------
    InputError
        If an option belongs to another estimator.
    DataError
        As :func:`srt.sequences.checked_preparation.prepare_checked`.
    """
    options.refuse(("loss",), "The Kalman filter")
    prior = options.prior or default_prior()
    solver = KalmanSolver(prior, CovarianceFilter if options.filter == "covariance" else SquareRootFilter)
    if options.filter != "iterated":
        options.refuse(("live",), f"The filter {options.filter!r}")
    if options.filter in ("one-pass", "per-sequence", "unscented"):
        # These filters have no state for the attitude in which a sequence ends and a move begins.
        joint = open_joint_model(recording, replace(options, ignore_moves=True))
        prior = initial_prior(joint, prior)
        free = np.array([name not in options.fixed_names for name in NAMES])
        if options.filter == "unscented":
            return run_sequentially(UnscentedFilter(joint, prior, free), joint, progress)
        return run_sequentially(SequentialFilter(joint, prior, options.filter, free), joint, progress)
    if not options.live:
        return run(open_joint_model(recording, options), solver, progress)
    from estimators.live_filter import LiveFilter, run_live

    live = LiveFilter(options)
    reports = []
    for report in run_live(recording, live):
        reports.append(report.result)
        if progress is not None:
            progress(len(reports), float(np.max(report.sigma / PARAMETER_UNITS)))
    # The reports are of the sequences alone; the result includes the moves between them.
    calibration = run(open_joint_model(recording, options), solver, None)
    return replace(calibration, diagnostics=replace(calibration.diagnostics, live=tuple(reports)))
