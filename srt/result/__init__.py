"""Calibrations: parameters with their covariance, and their application to samples."""
