"""Robustness campaigns: how far from true a unit may be before calibration, and how good the result then is."""
