"""Readers of foreign formats: any log in, samples in SI units out, each assumption said."""
