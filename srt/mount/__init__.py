"""Mount alignment (Savage 2020, §10): attitude of the sensor axes in the mount."""
