"""Physics of the simulator: fixture, motion and IMU; no mathematics in common with the estimators."""
