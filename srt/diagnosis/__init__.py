"""Diagnosis of recordings: a catalogue of faults, a check for each, and the most likely cause in one sentence."""

from __future__ import annotations

from srt.diagnosis.faults import FAULTS, Fault
from srt.diagnosis.findings import Finding
from srt.diagnosis.staged_diagnosis import Diagnosis, diagnose

__all__ = ["FAULTS", "Diagnosis", "Fault", "Finding", "diagnose"]
