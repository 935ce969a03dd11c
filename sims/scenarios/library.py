"""Library of the shipped configurations, found by name or by path.

A section of a scenario may say ``from = "name"``: the file of that name in the section's folder of the
library, or a path relative to the scenario, is read first and the section's own keys are laid over it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from srt.exceptions import InputError
from srt.recording import toml_text

FOLDERS: Final = ("imu", "fixture", "site", "scenario", "robustness", "plan")
"""Folders of the library."""


def configs_path() -> Path:
    """Find the shipped configurations: inside the installed package, or at the top of a checkout.

    Raises
    ------
    InputError
        If neither is there.
    """
    here = Path(__file__).resolve().parents[1]
    for candidate in (here / "configs", here.parent / "configs"):
        if all((candidate / folder).is_dir() for folder in FOLDERS):
            return candidate
    raise InputError("The shipped configurations are missing from this installation: install the package again.")


def names(folder: str) -> tuple[str, ...]:
    """Names of the shipped configurations of a folder, sorted."""
    return tuple(sorted(path.stem for path in (configs_path() / folder).glob("*.toml")))


def find(folder: str, name_or_path: str | Path, *, near: Path | None = None) -> Path:
    """Resolve a name in the library, or a path to a TOML file.

    Parameters
    ----------
    folder : str
        One of :data:`FOLDERS`.
    name_or_path : str or Path
        A name without ".toml" is looked up in the library; anything else is a path.
    near : Path, optional
        Folder that a relative path starts from; default the working directory.

    Raises
    ------
    InputError
        If there is no such file.
    """
    text = str(name_or_path)
    if not text.endswith(".toml"):
        path = configs_path() / folder / f"{text}.toml"
        if Path(text).name == text and path.is_file():
            return path
        raise InputError(
            f"There is no shipped {folder} configuration {text!r}: the names are {', '.join(names(folder))}; "
            "a file of your own ends in .toml."
        )
    path = Path(text)
    if not path.is_absolute() and near is not None:
        path = near / path
    if not path.is_file():
        raise InputError(f"There is no file {path}: give the path of a TOML file, or a name of the library.")
    return path


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Raises InputError if it cannot be read or is not TOML."""
    return toml_text.read_toml(path)


def overlay(base: dict[str, Any], top: dict[str, Any]) -> dict[str, Any]:
    """Merge one table into another, recursively; neither is changed."""
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        merged[key] = overlay(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return merged


def resolved(tables: dict[str, Any], *, name: str, near: Path | None = None) -> dict[str, Any]:
    """Merge the sections of a scenario into the files named by their ``from``.

    Parameters
    ----------
    tables : dict
        Tables of a scenario; not changed.
    name : str
        Name of the scenario in error messages.
    near : Path, optional
        Folder that relative paths in ``from`` start from.

    Raises
    ------
    InputError
        If ``from`` is not text, or the file does not exist.
    """
    out = dict(tables)
    for section in ("imu", "fixture", "site"):
        table = out.get(section)
        if isinstance(table, dict) and "from" in table:
            source = table["from"]
            if not isinstance(source, str):
                raise InputError(f"{name}: [{section}] from is {source!r}: give a name of the library or a path.")
            own = {key: value for key, value in table.items() if key != "from"}
            out[section] = overlay(read_toml(find(section, source, near=near)), own)
    protocol = out.get("protocol")
    if isinstance(protocol, dict) and near is not None and str(protocol.get("from", "")).endswith(".toml"):
        out["protocol"] = protocol | {"from": str(near / protocol["from"])}
    return out
