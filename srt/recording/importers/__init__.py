"""Importers of foreign formats: samples in SI units, with every assumption stated.

:data:`srt.recording.importer_registry.IMPORTERS` lists them; a new format needs a line there.
"""
