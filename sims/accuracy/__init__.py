"""Accuracy: Cramér-Rao bound, error budget, efficiency, and studies of many simulated units."""
