"""Mount alignment ([P] §10): attitude of the sensor axes in the mount."""
