"""Catalogue of the faults of a recording, read from ``faults.toml``: stages, names, messages and effects.

The order is that of causes: a fault higher in the catalogue makes those below it appear, so the first finding by this
order is named as the cause.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Final, Literal

Effect = Literal["exit 2", "exit 1", "warning", "note"]
"""Refused on reading; refused by calibration; calibrated with a warning; told by ``srt inspect`` alone."""


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
        The data that reveal it.
    sentence : str
        Message with fields in braces that the finding fills: what was found, where, what is expected, what to do.
    effect : Effect
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
"""All faults by name, causes before their consequences."""

RANK: Final = {name: rank for rank, name in enumerate(FAULTS)}
"""Place of each fault in the order of causes."""
