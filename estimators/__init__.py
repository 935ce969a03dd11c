"""Estimators that check the closed form: Kalman filters (``ekf``) and a batch factor graph (``graph``).

An estimator is a function ``(recording, options, progress) -> srt.Calibration`` registered in the entry-point group
``srt.estimators``. Both use the measurements and Jacobians of :mod:`srt.model.measurement_model` and
:mod:`srt.estimation.srt_measurements`. They import neither the closed-form inversion nor the simulator: a check must
not share the code that it checks.

One :class:`~estimators.joint_model.JointModel` has the unknowns, measurements and noise of a recording;
:mod:`~estimators.linearisation` makes a linear system of it; a :class:`~estimators.solver.JointSolver` solves that, and
:mod:`~estimators.iteration` repeats both until the correction is negligible.

To add an estimator, see "Add an estimator" in docs/estimators.md.
"""
