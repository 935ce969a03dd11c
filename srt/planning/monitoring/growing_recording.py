"""Recording that a logger is still writing: its complete lines, read again whenever it has grown."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from srt.exceptions import InputError
from srt.recording.folder import TOML_NAME, load_recording, read_document

if TYPE_CHECKING:
    import os

    from srt.recording.recording import Recording

_LINES: Final = (".csv", ".txt", ".tsv", ".dat", ".log")
"""Endings of samples that grow by lines; the last line may be incomplete."""


class GrowingRecording:
    """Recording on disk that grows.

    Parameters
    ----------
    path : path-like
        Folder, or its ``recording.toml``. The samples file need not exist yet.

    Raises
    ------
    InputError
        No recording, or no samples file named.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        given = Path(path)
        self.folder = given.parent if given.suffix == ".toml" else given
        document = read_document(given)
        self._labelled = "sequence" in document
        main = document.get("recording", {})
        name = main.get("samples") if isinstance(main, dict) else None
        if not isinstance(name, str) or not name:
            raise InputError(f"{self.folder}: recording.samples is missing: name the file that the logger writes.")
        self.samples = self.folder / name
        self.size = -1
        self._copy = tempfile.TemporaryDirectory(prefix="srt-watch-")
        self._copied = 0

    def __enter__(self) -> GrowingRecording:
        return self

    def __exit__(self, *_: object) -> None:
        self._copy.cleanup()

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
        copy = Path(self._copy.name)
        shutil.copyfile(self.folder / TOML_NAME, copy / TOML_NAME)
        target = copy / self.samples.name
        with self.samples.open("rb") as source:
            source.seek(self._copied)
            new = source.read()
        complete = new.rfind(b"\n") + 1
        with target.open("ab") as file:
            file.write(new[:complete])
        self._copied += complete
        if target.read_bytes()[:_HEAD].count(b"\n") < _FEWEST_LINES:
            return None
        try:
            return replace(load_recording(copy), source=str(self.folder))
        except InputError as error:
            sentence = str(error).replace(str(copy), str(self.folder))
            if self._labelled:
                sentence += f" A test that still runs has no labels: remove [[sequence]] from {TOML_NAME}."
            raise InputError(sentence) from None


_HEAD: Final = 1 << 12
"""First bytes in which lines are counted."""
_FEWEST_LINES: Final = 4
"""Lines with which a table has a header and two samples."""
