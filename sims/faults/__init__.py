"""Faults injected into simulated recordings, and the study of how surely they are named."""
