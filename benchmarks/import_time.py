"""Import time of the package without that of numpy and scipy.

``python benchmarks/import_time.py`` starts fresh interpreters with ``-X importtime`` and adds up the time of every
module that neither belongs to numpy or scipy nor was imported by them. The measurement itself adds a few percent, and
other programs on the same core add more: the minimum is printed beside the median.
"""

from __future__ import annotations

import re
import subprocess
import sys
from statistics import median

REPEATS = 15
"""Fresh interpreters for each statement."""
OTHERS = ("numpy", "scipy")
STATEMENTS = {
    "import srt": "import srt",
    "load and apply": "import srt; srt.load_calibration, srt.Applier",
    "load and calibrate": "import srt; srt.load_recording, srt.calibrate; "
    "from srt.estimation.registry import find_estimator; find_estimator('closed-form')",
}
LINE = re.compile(r"import time: +(\d+) \| +\d+ \| ( *)(\S+)")


def spans(statement: str) -> tuple[float, float, int]:
    """Import time of this package and of numpy and scipy, s, and the number of modules of this package."""
    bare, full = (
        subprocess.run(
            [sys.executable, "-X", "importtime", "-c", code], capture_output=True, text=True, check=True
        ).stderr
        for code in ("pass", statement)
    )
    start = {name for _, _, name in LINE.findall(bare)}
    own, theirs, count = 0.0, 0.0, 0
    importers: list[tuple[int, bool]] = []
    # A module is printed after the modules that it imported: read backwards, its importer comes first.
    for microseconds, indent, name in reversed(LINE.findall(full)):
        depth = len(indent)
        while importers and importers[-1][0] >= depth:
            importers.pop()
        foreign = name.partition(".")[0] in OTHERS or (bool(importers) and importers[-1][1])
        importers.append((depth, foreign))
        if name in start:
            continue
        own, theirs = own + (not foreign) * int(microseconds), theirs + foreign * int(microseconds)
        count += not foreign
    return own * 1e-6, theirs * 1e-6, count


def main() -> None:
    spans("import srt, numpy, scipy")  # compiles the modules and fills the disk cache
    print(f"Python {sys.version.split()[0]}, {REPEATS} fresh interpreters each, ms: median (minimum)")
    print(f"{'':20}{'modules':>8}{'ours':>16}{'numpy, scipy':>18}")
    for title, statement in STATEMENTS.items():
        own, theirs, count = zip(*(spans(statement) for _ in range(REPEATS)), strict=True)
        figures = [f"{median(s) * 1e3:.1f} ({min(s) * 1e3:.1f})" for s in (own, theirs)]
        print(f"{title:20}{count[0]:8}{figures[0]:>16}{figures[1]:>18}")


if __name__ == "__main__":
    main()
