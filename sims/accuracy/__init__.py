"""Accuracy: Cramér-Rao bound and error budget."""
