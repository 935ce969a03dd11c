"""A walk through a MATLAB file (levels 4 and 5 to 7) that checks it before a library is let near its arrays.

The parser of the library follows types and lengths as it finds them, out of its own memory if need be. So every
element is first held against its bytes: its type, its length, the product of its dimensions. What passes is handed over
variable by variable. Cells and texts may stand in structs; objects, function handles and sparse matrices are not handed
over.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from srt.recording.file_guards import DEFLATE_LIMIT, SLACK_BYTES

if TYPE_CHECKING:
    from collections.abc import Iterator

HEADER_BYTES: Final = 128

CLASSES: Final = {
    1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 6: "double", 7: "single", 8: "int8", 9: "uint8",
    10: "int16", 11: "uint16", 12: "int32", 13: "uint32", 14: "int64", 15: "uint64", 16: "function", 17: "opaque",
}  # fmt: skip
NUMERIC: Final = frozenset(CLASSES[i] for i in range(6, 16))

_MATRIX, _COMPRESSED = 14, 15
_NUMBER_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
_TEXT_BYTES = {**_NUMBER_BYTES, 16: 1, 17: 2, 18: 4}
_COMPLEX = 0x08
_DEEPEST = 8
_MOST_DIMENSIONS = 32
_MOST_VARIABLES = 10_000

_LEVEL_4_BYTES = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}
_LEVEL_4_HEADER = 20


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable of a file.

    Attributes
    ----------
    name : str
    kind : str
        Of :data:`CLASSES`.
    shape : tuple of int
    data : bytes
        A whole MATLAB file that holds this variable alone; empty if it is of a kind that is not handed over.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    data: bytes


@dataclass(frozen=True, slots=True)
class _Element:
    type: int
    start: int
    stop: int
    next: int


def variables(data: bytes) -> Iterator[Variable]:
    """Walk through a file.

    Parameters
    ----------
    data : bytes

    Yields
    ------
    Variable
        Checked.

    Raises
    ------
    ValueError
        What does not add up, in a few words.
    """
    if data[:4] and 0 in data[:4]:
        yield from _level_4(data)
        return
    order = {b"IM": "<", b"MI": ">"}.get(data[126:HEADER_BYTES])
    if order is None:
        raise ValueError("its header is not MATLAB's")
    at, count = HEADER_BYTES, 0
    # A few bytes short of a tag are padding.
    while at + 8 <= len(data):
        count += 1
        if count > _MOST_VARIABLES:
            raise ValueError("it holds too many variables")
        element = _element(data, at, len(data), order)
        packed = element.type == _COMPRESSED
        whole = _inflated(data[element.start : element.stop], order) if packed else data[at : element.stop]
        at = element.next
        element = _element(whole, 0, len(whole), order)
        if element.type != _MATRIX:
            raise ValueError(f"an element of type {element.type} stands where a variable is expected")
        yield _variable(data[:HEADER_BYTES], whole, element, order)


def _variable(header: bytes, whole: bytes, element: _Element, order: str) -> Variable:
    kind, _ = _flags(whole, element, order)
    if kind in ("opaque", "object", "function", "sparse"):
        return Variable("", kind, (), b"")
    name, shape = _check_matrix(whole, element, order, _DEEPEST)
    return Variable(name, kind, shape, header + whole)


def _inflated(packed: bytes, order: str) -> bytes:
    """The one element that a compressed one holds, no longer than it says."""
    inflater = zlib.decompressobj()
    try:
        start = inflater.decompress(packed, 8)
        length = _length(start, 0, order)
        if length > DEFLATE_LIMIT * len(packed) + SLACK_BYTES:
            raise ValueError("a compressed variable is stated to be larger than it can be")
        rest = inflater.decompress(inflater.unconsumed_tail, length + 8)
    except zlib.error as error:
        raise ValueError(f"a compressed variable is damaged: {error}") from None
    return start + rest


def _length(data: bytes, at: int, order: str) -> int:
    if at + 8 > len(data):
        raise ValueError("it ends within an element")
    return int(struct.unpack_from(f"{order}I", data, at + 4)[0])


def _element(data: bytes, at: int, end: int, order: str) -> _Element:
    """Read a tag; the element lies within the bytes given."""
    if at + 8 > end:
        raise ValueError("it ends within an element")
    first, length = struct.unpack_from(f"{order}II", data, at)
    if first >> 16:
        # A small element has its length and up to four bytes of data within the tag.
        small = first >> 16
        if small > 4:
            raise ValueError("a small element is too long")
        return _Element(first & 0xFFFF, at + 4, at + 4 + small, at + 8)
    stop = at + 8 + length
    if stop > end:
        raise ValueError("an element is longer than the file")
    return _Element(first, at + 8, stop, stop if first == _COMPRESSED else min(at + 8 + -(-length // 8) * 8, end))


def _flags(data: bytes, matrix: _Element, order: str) -> tuple[str, int]:
    flags = _element(data, matrix.start, matrix.stop, order)
    if flags.type != 6 or flags.stop - flags.start != 8:
        raise ValueError("a variable lacks its flags")
    word = struct.unpack_from(f"{order}I", data, flags.start)[0]
    kind = CLASSES.get(word & 0xFF)
    if kind is None:
        raise ValueError(f"a variable is of the unknown class {word & 0xFF}")
    return kind, word >> 8 & 0xFF


def _check_matrix(data: bytes, matrix: _Element, order: str, depth: int) -> tuple[str, tuple[int, ...]]:
    """Check a variable with all in it; return name and shape."""
    if depth == 0:
        raise ValueError("structs are nested too deeply")
    kind, flags = _flags(data, matrix, order)
    if kind in ("opaque", "object", "function", "sparse"):
        raise ValueError(f"a struct holds a {kind}; save it without")
    end = matrix.stop
    dimensions = _element(data, _element(data, matrix.start, end, order).next, end, order)
    count = (dimensions.stop - dimensions.start) // 4
    if dimensions.type != 5 or not 2 <= count <= _MOST_DIMENSIONS:
        raise ValueError("a variable lacks its dimensions")
    shape = struct.unpack_from(f"{order}{count}i", data, dimensions.start)
    if min(shape) < 0:
        raise ValueError("a dimension is negative")
    name = _element(data, dimensions.next, end, order)
    if name.type not in _TEXT_BYTES:
        raise ValueError("a variable lacks its name")
    size = math.prod(shape)
    if kind in ("cell", "struct"):
        _check_nested(data, name.next, end, order, (size, kind, depth))
    else:
        allowed = _NUMBER_BYTES if kind in NUMERIC else _TEXT_BYTES
        at = name.next
        for _ in range(2 if flags & _COMPLEX else 1):
            part = _element(data, at, end, order)
            length = part.stop - part.start
            if part.type not in allowed or length % allowed[part.type]:
                raise ValueError(f"the data of a variable are of the unknown type {part.type}")
            # A text in UTF-8 may take more bytes than characters.
            if kind in NUMERIC and length // allowed[part.type] != size:
                raise ValueError("the data of a variable do not fill its dimensions")
            at = part.next
    return data[name.start : name.stop].decode("latin-1"), tuple(int(n) for n in shape)


def _check_nested(data: bytes, at: int, end: int, order: str, what: tuple[int, str, int]) -> None:
    """Check the variables within a cell or a struct."""
    count, kind, depth = what
    if kind == "struct":
        width = _element(data, at, end, order)
        if width.type != 5 or width.stop - width.start != 4:
            raise ValueError("a struct lacks the length of its names")
        length = struct.unpack_from(f"{order}i", data, width.start)[0]
        names = _element(data, width.next, end, order)
        total = names.stop - names.start
        if names.type not in (1, 2) or not 0 < length <= 256 or total % length:
            raise ValueError("a struct lacks its names")
        count *= total // length
        at = names.next
    # Each takes a tag of eight bytes at least.
    if count > (end - at) // 8:
        raise ValueError("a struct or cell holds more than its bytes can")
    for _ in range(count):
        inner = _element(data, at, end, order)
        if inner.type != _MATRIX:
            raise ValueError(f"an element of type {inner.type} stands where a variable is expected")
        if inner.stop > inner.start:
            _check_matrix(data, inner, order, depth - 1)
        at = inner.next


def _level_4(data: bytes) -> Iterator[Variable]:
    at, count = 0, 0
    while at < len(data):
        count += 1
        if at + _LEVEL_4_HEADER > len(data) or count > _MOST_VARIABLES:
            raise ValueError("it ends within a variable")
        order = "<" if struct.unpack_from("<i", data, at)[0] in range(5000) else ">"
        code, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", data, at)
        machine, reserved, precision, form = code // 1000, code // 100 % 10, code // 10 % 10, code % 10
        if machine != (order == ">") or reserved or precision not in _LEVEL_4_BYTES or form not in (0, 1, 2):
            raise ValueError("a variable is of an unknown type")
        if min(rows, columns) < 0 or not 0 < length <= 256 or imaginary not in (0, 1):
            raise ValueError("a variable has an impossible size")
        stop = at + _LEVEL_4_HEADER + length + rows * columns * _LEVEL_4_BYTES[precision] * (1 + imaginary)
        if stop > len(data):
            raise ValueError("a variable is longer than the file")
        name = data[at + _LEVEL_4_HEADER : at + _LEVEL_4_HEADER + length].rstrip(b"\0").decode("latin-1")
        kind = ("double", "char", "sparse")[form]
        yield Variable(name, kind, (rows, columns), b"" if kind == "sparse" else data[at:stop])
        at = stop
