"""Truth of a simulated recording: ``srt simulate`` writes it, ``--truth`` reads it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

from srt.exceptions import InputError
from srt.recording.atomic_file import atomic_write_text
from srt.result.json_file import load_json_file
from srt.sensor_errors import NAMES, SensorErrors

if TYPE_CHECKING:
    from pathlib import Path

NAME: Final = "truth.json"
FORMAT: Final = "srt-truth"
VERSION: Final = 1
"""Version of the format."""


def write_truth(document: dict[str, Any], path: Path) -> None:
    """Write the truth, whole or not at all. Raises InputError if it cannot be written."""
    atomic_write_text(path, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def load_truth(path: Path) -> SensorErrors:
    """Read the sensor errors that a simulated recording was made with.

    Raises
    ------
    InputError
        If the file cannot be read, or is not one that ``srt simulate`` wrote.
    """
    return load_json_file(path, "truth", _errors)


def _errors(document: Any) -> SensorErrors:
    if not isinstance(document, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
        raise InputError(f"it is no truth of version {VERSION}: name the {NAME} that simulate wrote.")
    parameters = document.get("parameters")
    if not isinstance(parameters, dict) or set(parameters) != set(NAMES):
        raise InputError(f"it does not hold the {len(NAMES)} sensor errors: let simulate write it again.")
    if not all(isinstance(value, int | float) for value in parameters.values()):
        raise InputError("it holds a sensor error that is no number: let simulate write it again.")
    return SensorErrors.from_dict(parameters)
