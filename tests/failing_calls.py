"""Layer over the calls that change files, of which one fails: what a full or broken disk does to a command."""

import builtins
import errno
import io
import os
from pathlib import Path


class FailingCalls:
    """Layer over the calls that change files in a folder: the call of the given number fails.

    Parameters
    ----------
    monkeypatch : pytest.MonkeyPatch
    folder : Path
        Calls on other paths are passed on.
    failing : int
        Number of the call; -1: none fails.
    number : int
        Error of the system.
    """

    OS_CALLS = ("fsync", "replace", "rename", "unlink", "link", "mkdir", "rmdir")

    def __init__(self, monkeypatch, folder, failing, number=errno.ENOSPC):
        self.folder, self.failing, self.number, self.calls = folder, failing, number, []
        for name in self.OS_CALLS:
            monkeypatch.setattr(os, name, self.wrapped(name, getattr(os, name)))
        monkeypatch.setattr(os, "open", self.opened_descriptor(os.open))
        for module in (builtins, io):
            monkeypatch.setattr(module, "open", self.opened(module.open))

    @property
    def failed(self):
        """Name of the call that failed, "none" if there were fewer calls."""
        return self.calls[self.failing] if 0 <= self.failing < len(self.calls) else "none"

    def __len__(self):
        return len(self.calls)

    def count(self, name):
        self.calls.append(name)
        if len(self.calls) - 1 == self.failing:
            raise OSError(self.number, os.strerror(self.number))

    def inside(self, file):
        return isinstance(file, str | os.PathLike) and Path(file).is_relative_to(self.folder)

    def wrapped(self, name, call):
        def layer(*args, **kwargs):
            if name == "fsync" or self.inside(args[0]):
                self.count(name)
            return call(*args, **kwargs)

        return layer

    def opened_descriptor(self, call):
        def layer(file, flags, *args, **kwargs):
            if self.inside(file) and flags & (os.O_WRONLY | os.O_RDWR):
                self.count("open")
            return call(file, flags, *args, **kwargs)

        return layer

    def opened(self, call):
        def layer(file, mode="r", *args, **kwargs):
            if not self.inside(file) or mode in ("r", "rb"):
                return call(file, mode, *args, **kwargs)
            self.count("open")
            stream = call(file, mode, *args, **kwargs)
            return Writing(stream, self) if "w" in mode or "a" in mode else stream

        return layer


class Writing:
    """Open file whose writes, and whose closing, are counted: what is buffered is written when it is closed."""

    def __init__(self, stream, calls):
        self.stream, self.calls = stream, calls

    def write(self, data):
        self.calls.count("write")
        return self.stream.write(data)

    def writelines(self, lines):
        self.calls.count("write")
        return self.stream.writelines(lines)

    def close(self):
        if not self.stream.closed:
            self.stream.close()
            self.calls.count("close")

    def __enter__(self):
        return self

    def __exit__(self, *args):
        self.close()

    def __iter__(self):
        return iter(self.stream)

    def __getattr__(self, name):
        return getattr(self.stream, name)
