"""Faults injected into simulated recordings; a module registers its injections when it is imported."""
