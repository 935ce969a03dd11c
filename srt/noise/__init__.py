"""Noise of a unit: estimated from stationary windows, bias instability, Allan deviation, accuracy of the paper."""
