"""Recordings: samples in SI units, the keys of recording.toml, files, and importers of foreign formats."""
