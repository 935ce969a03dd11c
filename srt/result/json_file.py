"""Results in JSON files: written with a digest of their content, read as a whole or refused in one sentence.

The digest is the SHA-256 of the document without the digest, as JSON with sorted keys and no spaces. It does not
depend on the layout of the file, and it tells an edit or a damaged digit from what the software wrote. It is no
signature: whoever edits a file can compute it anew.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import TYPE_CHECKING, Any, Final, TypeVar

from srt.arguments import require_path
from srt.exceptions import InputError
from srt.recording.atomic_file import atomic_write_text
from srt.recording.file_guards import read_bounded

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from os import PathLike

_Result = TypeVar("_Result")

_DIGEST: Final = "digest"
"""Key of the digest in the document."""


def save_json_file(path: str | PathLike[str], document: Mapping[str, Any]) -> None:
    """Write a result with its digest, whole or not at all.

    Raises InputError if the path cannot be written.
    """
    require_path("Saving", path)
    atomic_write_text(path, json_text(document))


def json_text(document: Mapping[str, Any]) -> str:
    """Text of the file of a result, with its digest."""
    signed = {**document, _DIGEST: _digest(document)}
    return json.dumps(signed, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def require_json(document: Mapping[str, Any]) -> None:
    """Refuse what strict JSON cannot hold, at any depth: NaN, infinite numbers, arrays and other objects.

    Raises InputError: it names the first such value, as "diagnostics.filter.3.probability".
    """
    try:
        json.dumps(document, allow_nan=False)
    except (TypeError, ValueError):
        for key, value in document.items():
            _refuse_first(value, key)
        raise


def _refuse_first(value: object, name: str) -> None:
    if isinstance(value, dict):
        for key, part in value.items():
            _refuse_first(part, f"{name}.{key}")
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            _refuse_first(part, f"{name}.{number}")
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{name} is {value}, which a JSON file cannot hold: give None in place of it.")
    elif value is not None and not isinstance(value, str | int | float):
        raise InputError(f"{name} is a {type(value).__name__}, which a JSON file cannot hold: give numbers and lists.")


def parse_json(text: str) -> Any:
    """Read JSON. Raises InputError, a clause that follows "it is"."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid JSON ({error}): is it truncated?") from None


def load_json_file(
    path: str | PathLike[str],
    noun: str,
    from_document: Callable[[dict[str, Any]], _Result],
    *,
    trust: bool = False,
    signed: bool = False,
) -> _Result:
    """Read a result from its JSON file.

    Parameters
    ----------
    path : path-like
    noun : str
        Name of the result, for messages: "calibration".
    from_document : callable
        Function that builds the result from the document. It raises InputError on what it does not accept.
    trust : bool
        Accept a document that differs from its digest.
    signed : bool
        Refuse a document without a digest, which is accepted otherwise.

    Raises InputError if the file cannot be read, is no JSON, is not complete, is not accepted, or differs from its
    digest.
    """
    require_path(f"Reading a {noun}", path)
    try:
        document = parse_json(read_bounded(path).decode("utf-8"))
    except OSError as error:
        raise InputError(f"The {noun} {path} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError as error:
        raise InputError(f"The {noun} {path} is not text in UTF-8 ({error.reason}): name a JSON file.") from None
    except InputError as error:
        raise InputError(f"The {noun} {path} is {error}") from None
    try:
        result = from_document(document)
        changed = unchanged_document(document) is False
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path} is not a complete {noun} ({type(error).__name__}: {error}); it was edited or truncated."
        ) from None
    # After the checks above: what is wrong in itself is named by what is wrong, and only the rest by the digest.
    if signed and _DIGEST not in document:
        raise InputError(f"{path} has no digest, so that nothing tells whether it was edited: calibrate again.")
    if changed and not trust:
        raise InputError(
            f"{path} was changed after it was written (its content does not match its digest): take the original "
            f"{noun}, or accept the change with --trust (trust=True in Python)."
        )
    return result


def require_format(document: object, noun: str, name: str, version: int) -> None:
    """Raise InputError for a document that is not of this format and version."""
    if not isinstance(document, dict) or document.get("format") != name:
        raise InputError(f'this is no {noun} (its "format" is not "{name}").')
    if document.get("version") != version:
        raise InputError(f"its version is {document.get('version')!r}, but this software reads version {version}.")


def unchanged_document(document: Any) -> bool | None:
    """True if a document matches its digest, False if it does not, None if it has none."""
    if not isinstance(document, dict) or _DIGEST not in document:
        return None
    try:
        return bool(document[_DIGEST] == _digest(document))
    except (ValueError, RecursionError):  # numbers that no document of this program holds
        return False


def _digest(document: Mapping[str, Any]) -> str:
    content = {key: value for key, value in document.items() if key != _DIGEST}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()
