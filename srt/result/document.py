"""Results as JSON documents: dataclasses that are written and read by their fields and type hints.

The key of a field is that of its metadata, or its name without the underscore that tells it from a word of Python. A
field without a default is always written. One whose default is None is left out while it is None, unless the field
``nulls`` of its object names it. A field ``further`` holds the keys that are no fields. Arrays and tuples become lists.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Final, NamedTuple, NoReturn, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from srt.exceptions import InputError, clipped, did_you_mean

_Kind = TypeVar("_Kind")

_FURTHER, _NULLS = "further", "nulls"
_PLAIN: Final = frozenset({float, int, str, bool, NoneType})
_SCALARS: Final[dict[Any, tuple[Any, str]]] = {
    float: (int | float, "a finite number"), int: (int, "an integer"), str: (str, "a text"),
    bool: (bool, "true or false"),
}  # fmt: skip
"""Types that a value may have, and their name in messages, by type hint."""


class _Field(NamedTuple):
    name: str
    key: str
    hint: Any
    required: bool


@cache
def _fields(kind: Any) -> tuple[_Field, ...]:
    hints = get_type_hints(kind)
    return tuple(
        _Field(
            f.name,
            f.metadata.get("key", f.name.rstrip("_")),
            hints[f.name],
            f.default is MISSING and f.default_factory is MISSING,
        )
        for f in fields(kind)
    )


def to_document(value: object) -> Any:
    """JSON values of an object: dataclasses and mappings as dictionaries, arrays and tuples as lists."""
    kind: Any = type(value)
    if kind in _PLAIN:  # most values; a result is converted whenever it is made, to check it
        return value
    if isinstance(value, list | tuple):
        return [part if type(part) in _PLAIN else to_document(part) for part in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value):
        return _fields_document(value, kind)
    if isinstance(value, Mapping):
        return {key: part if type(part) in _PLAIN else to_document(part) for key, part in value.items()}
    return value


def _fields_document(value: object, kind: Any) -> dict[str, Any]:
    out: dict[str, Any] = {}
    nulls = getattr(value, _NULLS, ())
    for name, key, _, required in _fields(kind):
        part = getattr(value, name)
        if name == _FURTHER:
            out |= to_document(part)
        elif name != _NULLS and (part is not None or required or name in nulls):
            out[key] = part if type(part) in _PLAIN else to_document(part)
    return out


def from_document(kind: type[_Kind], document: object, name: str) -> _Kind:
    """Read an object of a dataclass from JSON values.

    Parameters
    ----------
    kind : type
        The dataclass.
    document : object
    name : str
        Name of the document in messages.

    Raises InputError: a key that is missing or not known, or a value of another type; the message names the path of the
    key.
    """
    return cast("_Kind", _read(kind, document, name))


def _read(hint: Any, value: object, name: str) -> object:
    reader = _READERS.get(get_origin(hint))
    if reader is not None:
        return reader(get_args(hint), value, name)
    if hint in _SCALARS:
        kind, expected = _SCALARS[hint]
        fits = isinstance(value, kind) and isinstance(value, bool) == (hint is bool)
        return value if fits and (isinstance(value, str) or _is_finite(value)) else _refuse(value, name, expected)
    return value if hint is Any else _read_fields(hint, value, name)


def _read_fields(kind: type, value: object, name: str) -> object:
    """Object of a dataclass from its keys."""
    rest, found = _keys(value, name), {}
    known = {f.name: f for f in _fields(kind)}
    special = known.pop(_FURTHER, None), known.pop(_NULLS, None)
    for f in known.values():
        if f.key in rest:
            found[f.name] = _read(f.hint, rest.pop(f.key), f"{name}.{f.key}")
        elif f.required:
            raise InputError(f"{name}.{f.key} is missing: the file was edited or truncated.")
    if special[0] is not None:
        found[_FURTHER] = rest
    elif rest:
        key = next(iter(rest))
        raise InputError(f"{name} has an unknown key, {clipped(key)}{did_you_mean(key, known)}: remove it.")
    if special[1] is not None:
        found[_NULLS] = tuple(key for key, part in found.items() if part is None)
    return kind(**found)


def _read_union(alternatives: tuple[Any, ...], value: object, name: str) -> object:
    if value is None and NoneType in alternatives:
        return None
    *others, last = (hint for hint in alternatives if hint is not NoneType)
    for hint in others:
        try:
            return _read(hint, value, name)
        except InputError:
            continue
    return _read(last, value, name)


def _read_tuple(elements: tuple[Any, ...], value: object, name: str) -> tuple[object, ...]:
    any_number = elements[-1] is Ellipsis
    if not isinstance(value, list) or not (any_number or len(value) == len(elements)):
        _refuse(value, name, "a list" if any_number else f"a list of {len(elements)}")
    hints = [elements[0]] * len(value) if any_number else elements
    return tuple(_read(hint, part, f"{name}.{i}") for i, (hint, part) in enumerate(zip(hints, value, strict=True)))


def _read_mapping(arguments: tuple[Any, ...], value: object, name: str) -> object:
    return {key: _read(arguments[1], part, f"{name}.{key}") for key, part in _keys(value, name).items()}


def _has_truth_value(values: list[Any]) -> bool:
    return any(_has_truth_value(part) if isinstance(part, list) else isinstance(part, bool) for part in values)


def _read_array(_: tuple[Any, ...], value: object, name: str) -> object:
    try:
        out = np.array(value)
    except ValueError:  # rows of different lengths
        out = np.array(None)
    numbers = isinstance(value, list) and (out.dtype.kind in "fi" or out.size == 0) and np.isfinite(out).all()
    numbers = numbers and not _has_truth_value(cast("list[Any]", value))  # numpy takes true for 1
    return out.astype(np.float64) if numbers else _refuse(value, name, "a list of finite numbers")


_READERS: Final = {
    Union: _read_union, UnionType: _read_union, tuple: _read_tuple, Mapping: _read_mapping, np.ndarray: _read_array
}  # fmt: skip
"""Functions that read the values of generic types."""


def _keys(value: object, name: str) -> dict[str, object]:
    return dict(value) if isinstance(value, dict) else _refuse(value, name, "an object with keys")


def _is_finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond the floats
        return False


def _refuse(value: object, name: str, expected: str) -> NoReturn:
    raise InputError(f"{name} is {clipped(repr(value))}: {expected} is expected.")
