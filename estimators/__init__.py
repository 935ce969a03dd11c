"""Solvers of the joint model that need further packages: Kalman filters (``ekf``) and a factor graph (``graph``).

An estimator is a function ``(recording, options, progress) -> srt.Calibration`` registered in the entry-point group
``srt.estimators``. Both use the model, the iteration and the analysis of :mod:`srt.joint`. They import neither the
closed-form inversion nor the simulator: a check must not share the code that it checks.

To add an estimator, see "Add an estimator" in docs/estimators.md.
"""
