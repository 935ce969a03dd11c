"""Figures of results; matplotlib is loaded on use."""
