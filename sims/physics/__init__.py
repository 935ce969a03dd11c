"""Physics of the simulator: fixture, motion, IMU and disturbances; no mathematics in common with the estimators."""
