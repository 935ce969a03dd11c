"""Diagnosis of recordings: a catalogue of faults, checks that find them, and one sentence on the most likely cause."""

from __future__ import annotations

from srt.diagnosis.faults import FAULTS
from srt.diagnosis.findings import Fault, Finding
from srt.diagnosis.staged_diagnosis import Diagnosis, diagnose

__all__ = ["FAULTS", "Diagnosis", "Fault", "Finding", "diagnose"]
