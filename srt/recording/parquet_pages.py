"""Sizes that the pages of a Parquet file decode to, by their headers, which its library trusts.

A header is a struct of Thrift's compact protocol; pyarrow does not show it, and its metadata may state other sizes.
"""

from __future__ import annotations

import mmap
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

_DECODED, _STORED = 2, 3
"""Fields of a page's header: its size when decompressed, and in the file."""
_BOOLEANS: Final = (1, 2)
_INTEGERS: Final = (4, 5, 6)
_FIXED: Final = {3: 1, 7: 8}
"""Bytes of values by their type: byte and double."""
_TEXT, _LISTS, _STRUCT = 8, (9, 10), 12
_LONGEST_VARINT: Final = 63  # bits by which the last byte of an integer is shifted


def decoded_bytes(path: Path, metadata: Any, columns: Collection[str]) -> int:
    """Bytes of all pages of some columns when decompressed.

    ``metadata`` is pyarrow's. Raises ValueError or LookupError for headers that cannot be read.
    """
    groups = map(metadata.row_group, range(metadata.num_row_groups))
    chunks = [
        chunk
        for group in groups
        for chunk in map(group.column, range(group.num_columns))
        if chunk.path_in_schema in columns and chunk.num_values
    ]
    total = 0
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if sum(chunk.total_compressed_size for chunk in chunks) > len(data):
            raise ValueError("its columns overlap")
        for chunk in chunks:
            # A dictionary comes before the data; some writers state 0 for none.
            at = min(chunk.dictionary_page_offset or chunk.data_page_offset, chunk.data_page_offset)
            end = at + chunk.total_compressed_size
            while at < end:
                header, at = _struct(data, at)
                if min(header[_DECODED], header[_STORED]) < 0:
                    raise ValueError("a page has a negative size")
                total += header[_DECODED]
                at += header[_STORED]
    return total


def _struct(data: mmap.mmap, at: int) -> tuple[dict[int, int], int]:
    """Integers of a struct by field, and the place after it."""
    fields: dict[int, int] = {}
    field = 0
    while head := data[at]:
        at, step, kind = at + 1, head >> 4, head & 15
        if step:
            field += step
        else:
            field, at = _integer(data, at)
        if kind in _INTEGERS:
            fields[field], at = _integer(data, at)
        elif kind not in _BOOLEANS:  # the type of a boolean field is its value
            at = _after(data, at, kind)
    return fields, at + 1


def _after(data: mmap.mmap, at: int, kind: int) -> int:
    """Place after a value."""
    if kind in _INTEGERS:
        return _varint(data, at)[1]
    if kind == _TEXT:
        length, at = _varint(data, at)
        return at + length
    if kind == _STRUCT:
        return _struct(data, at)[1]
    if kind in _LISTS:
        count, kind, at = data[at] >> 4, data[at] & 15, at + 1
        if count == 15:
            count, at = _varint(data, at)
        for _ in range(count):
            at = at + 1 if kind in _BOOLEANS else _after(data, at, kind)
        return at
    return at + _FIXED[kind]


def _varint(data: mmap.mmap, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, _LONGEST_VARINT + 1, 7):
        byte = data[at]
        value, at = value | (byte & 127) << shift, at + 1
        if byte < 128:
            return value, at
    raise ValueError("an integer of a page's header does not end")


def _integer(data: mmap.mmap, at: int) -> tuple[int, int]:
    """Signed integer, of which even and odd codes are positive and negative."""
    value, at = _varint(data, at)
    return (value >> 1) ^ -(value & 1), at
