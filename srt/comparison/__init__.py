"""Several calibrations: estimators side by side, merged recordings, fleets and their outliers, parallel runs."""
