"""Tables [[sequence]] and the key ``protocol`` of ``recording.toml``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from srt.exceptions import InputError
from srt.recording.protocol import load_protocol
from srt.recording.schema import POSE_KEYS, SEQUENCE_KEYS, emit_section, fields_of, read_section, toml_value
from srt.recording.sequence_label import SequenceLabel

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srt.recording.protocol import Protocol
    from srt.recording.recording import Recording


def read_sequences(file: str, values: object) -> tuple[SequenceLabel, ...]:
    """Labels of the tables [[sequence]]; one with ``static_s`` is a pose.

    Raises
    ------
    InputError
        An unknown key, a wrong type or value, a window that is missing.
    """
    if not isinstance(values, list):
        raise InputError(f"{file}: sequence is no list: write each as [[sequence]], in double brackets.")
    labels = []
    for number, value in enumerate(values, start=1):
        posed = isinstance(value, dict) and "static_s" in value
        keys = POSE_KEYS if posed else SEQUENCE_KEYS
        section = read_section(file, f"sequence[{number}]", value, keys)
        for name in () if posed else ("start_static_s", "end_static_s"):
            if name not in section:
                raise InputError(f"{file}: sequence[{number}].{name} is missing: add the window [from, to] in s.")
        try:
            labels.append((SequenceLabel.of_pose if posed else SequenceLabel)(**fields_of(section, keys)))
        except InputError as error:
            raise InputError(f"{file}: sequence[{number}]: {error}") from None
    return tuple(labels)


def sequence_lines(label: SequenceLabel) -> list[str]:
    """Lines of the table of a label."""
    return emit_section(label, POSE_KEYS if label.pose else SEQUENCE_KEYS)


def read_protocol(file: str, document: Mapping[str, Any]) -> Protocol | None:
    """Protocol that [recording] names; a relative path starts from the folder of the file."""
    main = document.get("recording")
    name = main.get("protocol") if isinstance(main, dict) else None
    if not isinstance(name, str):
        return None
    try:
        return load_protocol(name, near=Path(file).parent)
    except InputError as error:
        raise InputError(f"{file}: recording.protocol: {error}", fault=error.fault) from None


def protocol_lines(recording: Recording, folder: Path) -> list[str]:
    """Line of the protocol of a recording in this folder; the path of a file is relative to it."""
    if recording.protocol is None:
        return []
    name = recording.protocol.name
    return [f"protocol = {toml_value(os.path.relpath(name, folder) if name.endswith('.toml') else name)}"]
