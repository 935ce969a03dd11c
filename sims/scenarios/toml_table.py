"""Tables of TOML files as pydantic models, and sentences on what is wrong in them."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence


class TomlTable(BaseModel):
    """A table of a scenario, a plan or a campaign: frozen, and strict about its keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class LibraryTable(TomlTable):
    """A table whose key ``from`` names an entry of the library that its other keys replace values of."""


_Table = TypeVar("_Table", bound=TomlTable)


def validated(model: type[_Table], tables: dict[str, Any], name: str) -> _Table:
    """Check the tables of a file against their model. Raises InputError, which begins with the name of the file."""
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        raise InputError(f"{name}: {_validation_sentence(error, model)}") from None


_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "text in quotes",
    "finite_number": "a finite number",
    "tuple_type": "an array",
    "model_type": "a table",
    "dict_type": "a table",
    "greater_than": "a number above {gt:g}",
    "greater_than_equal": "a number not below {ge:g}",
    "less_than": "a number below {lt:g}",
    "less_than_equal": "a number not above {le:g}",
    "literal_error": "{expected}",
}
"""Expected value by pydantic's type of error; the names in braces are from its context."""


def _validation_sentence(error: ValidationError, root: type[BaseModel]) -> str:
    """Sentence on the first error of a validation.

    Parameters
    ----------
    error : pydantic.ValidationError
    root : type
        Validated model, which defines the known keys.
    """
    first = error.errors(include_url=False)[0]
    path, kind, context = first["loc"], first["type"], first.get("ctx", {})
    *parents, last = path or ("",)
    where = f"[{_dotted(parents)}]" if parents else "the top level"
    if kind == "extra_forbidden":
        known = _keys_at(parents, root)
        near = difflib.get_close_matches(str(last), known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"the keys there are {', '.join(known)}."
        return f"unknown key {last!r} in {where}: {hint}"
    if kind == "missing" and isinstance(last, str):
        return f"the key {last!r} is missing from {where}: add it."
    if kind == "value_error":
        place = f"in [{_dotted(path)}], " if path else ""
        return f"{place}{first['msg'].removeprefix('Value error, ').rstrip('.')}."
    if kind == "missing":
        return f"{_dotted(parents)} has too few values: {int(last) + 1} are needed."
    expected = _EXPECTED.get(kind)
    if expected is None:
        return f"{_dotted(path)} is {first['input']!r}: {first['msg'][:1].lower()}{first['msg'][1:]}."
    return f"{_dotted(path)} is {first['input']!r}: give {expected.format(**context)}."


def _dotted(path: Sequence[int | str]) -> str:
    """Location in a scenario as a dotted key, with array positions counted from 1."""
    text = ""
    for part in path:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}"
    return text.removeprefix(".")


def _keys_at(path: Sequence[int | str], root: type[BaseModel]) -> list[str]:
    """Known keys of the table at a location."""
    model = root
    for part in path:
        if isinstance(part, int) or part not in model.model_fields:
            continue  # a place in an array, or a name that the file's author chose
        annotation = model.model_fields[part].annotation
        model = next(t for t in _flatten(annotation) if isinstance(t, type) and issubclass(t, BaseModel))
    keys = list(model.model_fields)
    keys = ["from" if key == "source" else key for key in keys]
    return [*keys, "from"] if issubclass(model, LibraryTable) else keys


def _flatten(annotation: object) -> list[object]:
    arguments = get_args(annotation)
    return [annotation] if not arguments else [t for a in arguments for t in _flatten(a)]
