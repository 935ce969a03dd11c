"""Sizes to which the columns of a Parquet file decode, by its footer and the headers of its pages.

Its library trusts the headers and does not show them, and ends the process where a part of the footer is damaged that
it parses on demand. Footer and headers are structs of Thrift's compact protocol.
"""

from __future__ import annotations

import mmap
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

_FOOTER_BYTES: Final = 8  # at the end of the file: length of the footer, and a mark

# Fields of the structs, by the format's definition.
_FILE_GROUPS, _GROUP_CHUNKS, _GROUP_ROWS, _CHUNK_COLUMN = 4, 1, 3, 3
_COLUMN_PATH, _COLUMN_STORED, _COLUMN_DATA, _COLUMN_DICTIONARY = 3, 7, 9, 11
_PAGE_DECODED, _PAGE_STORED = 2, 3

_BOOLEANS: Final = (1, 2)
_INTEGERS: Final = (4, 5, 6)
_FIXED: Final = {3: 1, 7: 8}
"""Bytes of values by their type: byte and double."""
_TEXT, _LISTS, _STRUCT = 8, (9, 10), 12
_LONGEST_SHIFT: Final = 63  # bits by which the last byte of an integer is shifted


class DecodedSize(NamedTuple):
    """Size of some columns of a file when decoded."""

    rows: int  # of all groups of rows
    page_bytes: int


def decoded_size(path: Path, columns: Collection[str]) -> DecodedSize:
    """Size of some columns when decoded. Raises ValueError or LookupError for a file that cannot be understood."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        length = int.from_bytes(data[-_FOOTER_BYTES:-4], "little")
        footer, _ = _struct(data, max(len(data) - _FOOTER_BYTES - length, 0))
        groups = footer.get(_FILE_GROUPS, [])
        chunks = [chunk[_CHUNK_COLUMN] for group in groups for chunk in group[_GROUP_CHUNKS]]
        chunks = [chunk for chunk in chunks if chunk[_COLUMN_PATH][0].decode("utf-8", "replace") in columns]
        if sum(chunk[_COLUMN_STORED] for chunk in chunks) > len(data):
            raise ValueError("its columns overlap")
        pages = sum(size for chunk in chunks for size in _page_sizes(data, chunk))
        return DecodedSize(sum(group[_GROUP_ROWS] for group in groups), pages)


def _page_sizes(data: mmap.mmap, chunk: dict[int, Any]) -> Iterator[int]:
    """Sizes of the pages of one column in one group of rows, decompressed."""
    # A dictionary comes before the data; some writers state 0 for none.
    at = min(chunk.get(_COLUMN_DICTIONARY) or chunk[_COLUMN_DATA], chunk[_COLUMN_DATA])
    end = at + chunk[_COLUMN_STORED]
    while at < end:
        header, at = _struct(data, at)
        if min(header[_PAGE_DECODED], header[_PAGE_STORED]) < 0:
            raise ValueError("a page has a negative size")
        yield header[_PAGE_DECODED]
        at += header[_PAGE_STORED]


def _struct(data: mmap.mmap, at: int) -> tuple[dict[int, Any], int]:
    """Values of a struct by field, and the place after it."""
    fields: dict[int, Any] = {}
    field = 0
    while head := data[at]:
        at, step, kind = at + 1, head >> 4, head & 15
        if step:
            field += step
        else:
            field, at = _integer(data, at)
        if kind not in _BOOLEANS:  # the type of a boolean field is its value
            fields[field], at = _value(data, at, kind)
    return fields, at + 1


def _value(data: mmap.mmap, at: int, kind: int) -> tuple[Any, int]:
    """Value, and the place after it; None for one that no field of interest has."""
    if kind in _INTEGERS:
        return _integer(data, at)
    if kind == _TEXT:
        length, at = _varint(data, at)
        return data[at : at + length], at + length
    if kind == _STRUCT:
        return _struct(data, at)
    if kind not in _LISTS:
        return None, at + _FIXED[kind]
    count, kind, at = data[at] >> 4, data[at] & 15, at + 1
    if count == 15:
        count, at = _varint(data, at)
    if count > len(data) - at:
        raise ValueError("a list is longer than the file")
    values = []
    for _ in range(count):
        value, at = (None, at + 1) if kind in _BOOLEANS else _value(data, at, kind)
        values.append(value)
    return values, at


def _varint(data: mmap.mmap, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, _LONGEST_SHIFT + 1, 7):
        byte = data[at]
        value, at = value | (byte & 127) << shift, at + 1
        if byte < 128:
            return value, at
    raise ValueError("an integer does not end")


def _integer(data: mmap.mmap, at: int) -> tuple[int, int]:
    """Signed integer, of which even and odd codes are positive and negative."""
    value, at = _varint(data, at)
    return (value >> 1) ^ -(value & 1), at
