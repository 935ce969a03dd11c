"""Coverage-guided form of the fuzzer, where atheris is installed: it keeps the inputs that reach new lines of a reader.

``python benchmarks/fuzz_atheris.py NAME [-runs=10000] [-max_total_time=60] ...``, with libFuzzer's options. It stops at
the first input that ends in anything but a recording or a clear error, and writes it to ./crash-...
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import atheris

with atheris.instrument_imports(include=["srt", "pyulog", "rosbags", "pymavlink"]):
    import fuzz

    from srt.exceptions import DataError, InputError
    from srt.recording.importer_registry import IMPORTERS
    from srt.recording.importers import child_process

    # Readers and their libraries are loaded on use elsewhere; only what is imported here is watched.
    for module in ("pyulog.core", "pymavlink.DFReader", "rosbags.rosbag1.reader", "rosbags.rosbag2.reader"):
        importlib.import_module(module)
    for target in IMPORTERS.values():
        importlib.import_module(target.partition(":")[0])

LARGEST = 1 << 16


def main() -> None:
    name, *options = sys.argv[1:]
    child_process.spawn, child_process.impose = fuzz.InProcess, lambda _: True
    seeds = fuzz.seeds_of(name)
    with TemporaryDirectory(prefix="fuzz-") as scratch:
        folder, corpus = Path(scratch) / "input", Path(scratch) / "corpus"
        corpus.mkdir()
        # The first byte says which file of which seed the others replace.
        targets = [(seed, each) for seed in seeds for each in seed.damaged or tuple(sorted(seed.files))]
        for number, (seed, each) in enumerate(targets):
            (corpus / f"seed-{number}").write_bytes(bytes([number]) + seed.files[each])

        def one(data: bytes) -> None:
            if not data:
                return
            seed, replaced = targets[data[0] % len(targets)]
            fuzz._fresh(folder)
            for each, valid in seed.files.items():
                (folder / each).write_bytes(data[1:] if each == replaced else valid)
            try:
                fuzz.read(name, seed, folder / seed.target)
            except (InputError, DataError):
                return

        atheris.Setup([sys.argv[0], f"-max_len={LARGEST}", *options, str(corpus)], one)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
