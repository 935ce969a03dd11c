"""Calibrations inside navigation software: factors with the sensor errors as variables."""
