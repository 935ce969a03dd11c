"""Estimation without checks: initial estimates, iteration, solvers, leave-one-out, and the calibration made of it."""
