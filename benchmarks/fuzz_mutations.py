"""Damage: what a bad disk, a cut-off copy, a careless editor or an attacker do to a file."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable

import numpy as np

INTEGERS = (0, 1, 2, 3, 7, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 40)
HUGE = ((1 << 63) - 1, 1 << 63, (1 << 64) - 1, (1 << 62) + 1)
WIDTHS = (1, 2, 4, 8)

TOKENS = (
    b"", b"nan", b"inf", b"-inf", b"1e999", b"-1e308", b"1e-320", b"-0.0", b"0", b"-1", b"1_000", b"0x10", b"1,5",
    b"9" * 400, b"18446744073709551616", b"true", b"[]", b"[[[]]]", b"{}", b'""', b"'", b'"', b"\x00", b"\xff\xfe",
    b"#", b"\n", b"\r", b";", b"\t", "°".encode(), b"[" * 3000, b"{a=" * 3000, b"1979-05-27T07:32:00Z", b"12:00:00",
    b'"/etc/passwd"', b'"../secret.csv"', b'"samples.csv/../../x.csv"', b'"recording.toml"', b'"."', b'"\\u0000"',
    b'"samples.h5"', b'"samples.npz"', b'"counts"', b'"deg/s"', b'"increment"', b"1e-300", b"4.9e-324", b"1e300",
    b"%s%n", b"${HOME}", b"__import__('os').system('true')", b"!!python/object/apply:os.system [\"true\"]", b"A" * 5000,
)  # fmt: skip
"""Words that replace numbers and words of text."""

_WORD = re.compile(rb"[A-Za-z0-9_.+-]+|\"[^\"\n]*\"")

Mutation = Callable[[bytearray, np.random.Generator], bytearray]


def mutate(data: bytes, name: str, pool: list[bytes], rng: np.random.Generator) -> bytes:
    """Damage a file in one to four places, with pieces of other files (``pool``).

    Members of a zip archive are damaged inside, too, as their checksums would hide it.
    """
    if name.endswith(".npz") and rng.random() < 0.6:
        return _inside_zip(data, pool, rng)
    text = _is_text(data)
    result = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 1, 2, 3, 4]))):
        table = TEXT if text and rng.random() < 0.7 else BINARY
        which = int(rng.integers(len(table) + 1))
        result = splice(result, pool, rng) if which == len(table) else table[which](result, rng)
    return bytes(result[: 1 << 20])


def turn_bits(data: bytearray, rng: np.random.Generator) -> bytearray:
    for _ in range(int(rng.integers(1, 9))):
        if data:
            data[_place(len(data), rng)] ^= 1 << int(rng.integers(8))
    return data


def set_bytes(data: bytearray, rng: np.random.Generator) -> bytearray:
    at = _place(len(data), rng)
    size = min(int(rng.integers(1, 17)), len(data) - at)
    data[at : at + size] = rng.integers(0, 256, size, dtype=np.uint8).tobytes()
    return data


def cut_off(data: bytearray, rng: np.random.Generator) -> bytearray:
    return data[: int(rng.integers(len(data) + 1))]


def cut_start(data: bytearray, rng: np.random.Generator) -> bytearray:
    return data[int(rng.integers(1, 65)) :]


def hostile_number(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Place where a count or a length may stand."""
    width = WIDTHS[int(rng.integers(4))]
    at = _place(max(len(data) - width, 1), rng)
    if rng.random() < 0.5:
        at -= at % width
    choice = (*INTEGERS, *HUGE, len(data), len(data) + 1, len(data) - at)
    value = choice[int(rng.integers(len(choice)))] & ((1 << 8 * width) - 1)
    data[at : at + width] = value.to_bytes(width, "little" if rng.random() < 0.8 else "big")
    return data


def small_step(data: bytearray, rng: np.random.Generator) -> bytearray:
    """One more or one less, where counts and lengths are nearly right."""
    if data:
        at = _place(len(data), rng)
        data[at] = (data[at] + int(rng.choice([-2, -1, 1, 2]))) % 256
    return data


def drop_piece(data: bytearray, rng: np.random.Generator) -> bytearray:
    at = _place(len(data), rng)
    del data[at : at + int(rng.integers(1, 129))]
    return data


def double_piece(data: bytearray, rng: np.random.Generator) -> bytearray:
    at = _place(len(data), rng)
    piece = data[at : at + int(rng.integers(1, 513))]
    data[at:at] = piece * int(rng.integers(1, 9))
    return data


def splice(data: bytearray, pool: list[bytes], rng: np.random.Generator) -> bytearray:
    """A piece of another file put in or over."""
    other = pool[int(rng.integers(len(pool)))]
    start = _place(len(other), rng)
    piece = other[start : start + int(rng.integers(1, 1025))]
    at = _place(len(data), rng)
    over = len(piece) if rng.random() < 0.5 else 0
    data[at : at + over] = piece
    return data


def zero_piece(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Blocks of zeros, as of a disk that lost some."""
    at = _place(len(data), rng)
    size = min(int(2 ** rng.integers(2, 10)), len(data) - at)
    data[at : at + size] = bytes(size)
    return data


def replace_word(data: bytearray, rng: np.random.Generator) -> bytearray:
    words = [match.span() for match in _WORD.finditer(data)]
    if words:
        start, end = words[int(rng.integers(len(words)))]
        data[start:end] = TOKENS[int(rng.integers(len(TOKENS)))]
    return data


def insert_token(data: bytearray, rng: np.random.Generator) -> bytearray:
    at = _place(len(data), rng)
    data[at:at] = TOKENS[int(rng.integers(len(TOKENS)))]
    return data


def swap_words(data: bytearray, rng: np.random.Generator) -> bytearray:
    words = list(_WORD.finditer(data))
    if words:
        start, end = words[int(rng.integers(len(words)))].span()
        data[start:end] = words[int(rng.integers(len(words)))].group()
    return data


def edit_lines(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Drop, double or move a line."""
    lines = bytes(data).split(b"\n")
    i, j = (int(rng.integers(len(lines))) for _ in range(2))
    line = lines[i]
    if rng.random() < 0.6:
        del lines[i]
    if rng.random() < 0.6:
        lines.insert(j, line)
    return bytearray(b"\n".join(lines))


BINARY: tuple[Mutation, ...] = (
    turn_bits, set_bytes, cut_off, cut_start, hostile_number, hostile_number, small_step, drop_piece, double_piece,
    zero_piece,
)  # fmt: skip
TEXT: tuple[Mutation, ...] = (replace_word, replace_word, replace_word, insert_token, swap_words, edit_lines)


def _place(size: int, rng: np.random.Generator) -> int:
    """Place of a damage: in half of the cases within the first or the last bytes, where headers and footers stand."""
    if size < 1:
        return 0
    if rng.random() < 0.5:
        near = int(min(size, 2 ** rng.integers(3, 10)))
        at = int(rng.integers(near))
        return at if rng.random() < 0.7 else size - 1 - at
    return int(rng.integers(size))


def _is_text(data: bytes) -> bool:
    return not any(c < 9 for c in data[:200])


def _inside_zip(data: bytes, pool: list[bytes], rng: np.random.Generator) -> bytes:
    """Damage one member of an archive, its checksum made anew; sometimes its name."""
    source = zipfile.ZipFile(io.BytesIO(data))
    names = source.namelist()
    chosen = names[int(rng.integers(len(names)))]
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        for name in names:
            member = source.read(name)
            if name == chosen:
                member = mutate(member, "member.npy", pool, rng)
                if rng.random() < 0.1:
                    name = ("../" * 3 + name, "/" + name, name * 50, "a\x01.npy")[int(rng.integers(4))]  # noqa: PLW2901
            target.writestr(name, member)
    return out.getvalue()
