"""Results in JSON files, read as a whole or refused in one sentence."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, TypeVar

from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from os import PathLike

_Result = TypeVar("_Result")


def load_json_file(path: str | PathLike[str], noun: str, from_document: Callable[[dict[str, Any]], _Result]) -> _Result:
    """Read a result from its JSON file.

    Parameters
    ----------
    path : path-like
    noun : str
        Name of the result, for messages: "calibration".
    from_document : callable
        Function that builds the result from the document. It raises InputError on what it does not accept.

    Raises
    ------
    InputError
        If the file cannot be read, is no JSON, is not complete, or is not accepted.
    """
    try:
        with open(path, encoding="utf-8") as file:  # noqa: PTH123 - any path-like is welcome
            document = json.load(file)
    except OSError as error:
        raise InputError(f"The {noun} {path} cannot be read: {error.strerror}.") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"The {noun} {path} is not valid JSON ({error}): is it truncated?") from None
    try:
        return from_document(document)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path} is not a complete {noun} ({type(error).__name__}: {error}); it was edited or truncated."
        ) from None
