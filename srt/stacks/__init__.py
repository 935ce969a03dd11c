"""Calibrations inside navigation software: readings corrected as they arrive, and factors of navigation graphs."""
