"""Recording that a logger is still writing: its complete lines, read again whenever it has grown.

Two things do not end a test: lines that are no text in UTF-8 are left out, and a file that is replaced begins it anew.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from srt.exceptions import InputError
from srt.recording.folder import TOML_NAME, load_recording, read_document, samples_inside

if TYPE_CHECKING:
    from srt.recording.recording import Recording

_LINES: Final = (".csv", ".txt", ".tsv", ".dat", ".log")
"""Endings of samples that grow by lines; the last line may be incomplete."""


class GrowingRecording:
    """Recording on disk that grows.

    Parameters
    ----------
    path : path-like
        Folder, or its ``recording.toml``. The samples file need not exist yet.

    Attributes
    ----------
    notes : list of str
        Sentences on what was left out; whoever shows them removes them.
    begun_anew : bool
        True from a reading that found other samples than those before, until it is reset.

    Raises
    ------
    InputError
        No recording, or no samples file named.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        given = Path(path)
        self._toml = given if given.suffix == ".toml" else given / TOML_NAME
        self.folder = self._toml.parent
        document = read_document(given)
        self._labelled = "sequence" in document
        main = document.get("recording", {})
        name = main.get("samples") if isinstance(main, dict) else None
        if not isinstance(name, str) or not name:
            raise InputError(f"{self.folder}: recording.samples is missing: name the file that the logger writes.")
        self.samples = samples_inside(self._toml, name)
        self.size = -1
        self.notes: list[str] = []
        self.begun_anew = False
        self._directory = tempfile.TemporaryDirectory(prefix="srt-watch-")
        self._copy = Path(self._directory.name)
        self._target = self._copy / os.path.relpath(self.samples, self.folder)
        self._begin()

    def _begin(self) -> None:
        self._target.parent.mkdir(parents=True, exist_ok=True)
        self._target.write_bytes(b"")
        self._end = b""
        self._copied = self._lines = 0
        self._complete = True

    def __enter__(self) -> GrowingRecording:
        return self

    def __exit__(self, *_: object) -> None:
        self._directory.cleanup()

    def grown(self) -> bool:
        """True if the size of the samples differs from that of the last call."""
        with suppress(OSError):
            size = self.samples.stat().st_size
            if size != self.size:
                self.size = size
                return True
        return False

    def read(self) -> Recording | None:
        """Samples so far; None while there are too few.

        Raises
        ------
        InputError
            A file that cannot be read, except for an end that is not yet complete.
        """
        if not self.samples.is_file() or self.samples.stat().st_size == 0:
            return None
        if self.samples.suffix.lower() not in _LINES:
            with suppress(InputError):  # a format that is complete only when it is closed
                return load_recording(self.folder)
            return None
        try:
            self._append()
        except FileNotFoundError:  # a logger that begins a new file puts the old one away first
            return None
        return self._load()

    def without_unreadable(self) -> Recording | None:
        """Samples so far, if some lines were left out; None if the recording can be read as it is."""
        return None if self._complete else self._load()

    def _append(self) -> None:
        """Copy the complete lines that are new; all of them, where the file does not continue the one before."""
        with self.samples.open("rb") as source:
            source.seek(self._copied - len(self._end))
            new = source.read()
            if not new.startswith(self._end):
                self.notes.append(
                    f"{self.samples} was cut or replaced: the test begins anew with what it holds now; samples that it "
                    "held before are not in the result"
                )
                self.begun_anew = True
                self._begin()
                source.seek(0)
                new = source.read()
        new = new[len(self._end) : new.rfind(b"\n") + 1]
        with self._target.open("ab") as file:
            file.write(self._readable(new))
        self._copied += len(new)
        self._lines += new.count(b"\n")
        self._end = (self._end + new)[-_HEAD:]

    def _readable(self, lines: bytes) -> bytes:
        """Lines without those that are no text in UTF-8; the first of a file stays, as without it nothing is read."""
        text = lines.decode("utf-8", "surrogateescape")
        found = [match for match in _UNREADABLE.finditer(text) if self._lines or match.start()]
        if not found:
            return lines
        self._complete = False
        numbers = [self._lines + 1 + text.count("\n", 0, match.start()) for match in found[:_LISTED]]
        listed = ", ".join(map(str, numbers)) + ", ..." * (len(found) > _LISTED)
        self.notes.append(
            f"{self.samples}: lines that are no text in UTF-8 are left out (line {listed}): remove them from the file "
            "before it is used elsewhere"
        )
        ends = [0, *(match.end() for match in found)]
        starts = [*(match.start() for match in found), len(text)]
        kept = "".join(text[end:start] for end, start in zip(ends, starts, strict=True))
        return kept.encode("utf-8", "surrogateescape")

    def _load(self) -> Recording | None:
        shutil.copyfile(self._toml, self._copy / TOML_NAME)
        with self._target.open("rb") as file:
            if file.read(_HEAD).count(b"\n") < _FEWEST_LINES:
                return None
        try:
            return replace(load_recording(self._copy), source=str(self.folder))
        except InputError as error:
            sentence = str(error).replace(str(self._copy), str(self.folder))
            if self._labelled:
                sentence += f" A test that still runs has no labels: remove [[sequence]] from {TOML_NAME}."
            raise InputError(sentence) from None


_HEAD: Final = 1 << 12
"""First bytes in which lines are counted, and last bytes by which a file is known again."""
_UNREADABLE: Final = re.compile("^[^\n]*[\udc80-\udcff][^\n]*\n", re.MULTILINE)
"""Line with bytes that are not UTF-8, as the error handler surrogateescape gives them."""
_LISTED: Final = 5
"""Numbers of lines that a sentence lists."""
_FEWEST_LINES: Final = 4
"""Lines with which a table has a header and two samples."""
