"""Correction of readings as they arrive: lines of text and MAVLink."""
