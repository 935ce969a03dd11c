"""Estimation without checks: initial estimates, iteration, solvers, leave-one-out, and the resulting calibration."""
