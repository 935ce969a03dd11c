"""Noise of an IMU: noise model, bias instability, Allan deviation, and the accuracy analysis of the paper."""
