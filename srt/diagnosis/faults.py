"""Catalogue of the faults of a recording, read from ``faults.toml``: stages, names, messages and effects.

A fault can cause findings of faults that are listed after it. Of several findings, the first in this order is therefore
reported as the cause.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Final, Literal

Effect = Literal["exit 2", "exit 1", "warning", "note"]
"""Refused on reading; refused by the calibration; calibrated with a warning; reported only by ``srt inspect``."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault that a recording can have.

    Attributes
    ----------
    name : str
        Key for scripts and files.
    stage : str
        Key of :data:`STAGES`.
    title : str
        The fault in a few words.
    criterion : str
        Data that show the fault.
    sentence : str
        Message: what was found, where, what is expected, and what to do. The finding fills the fields in braces.
    effect : Effect
        Effect on reading and calibration.
    """

    name: str
    stage: str
    title: str
    criterion: str
    sentence: str
    effect: Effect


_CATALOGUE: Final = tomllib.loads(files(__package__).joinpath("faults.toml").read_text(encoding="utf-8"))

STAGES: Final[dict[str, str]] = _CATALOGUE["stages"]
"""Title of each stage of the checks, in the order in which they run."""

FAULTS: Final = {row["name"]: Fault(**row) for row in _CATALOGUE["fault"]}
"""All faults by name, each before the faults that it causes."""

RANK: Final = {name: rank for rank, name in enumerate(FAULTS)}
"""Number of each fault in the order of the catalogue."""
