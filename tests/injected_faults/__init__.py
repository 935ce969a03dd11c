"""Faults injected into simulated recordings."""
