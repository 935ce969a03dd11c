"""Importers of foreign formats: samples in SI units, with every assumption stated."""
