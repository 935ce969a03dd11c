"""The example runs, and the README shows what the examples are and print."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
EXAMPLES = ["examples/quickstart.py"]  # the navigation example has tests of its own


def run(example, folder):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}
    return subprocess.run(
        [sys.executable, "-W", "error", str(example)],
        cwd=folder,
        env=environment,
        capture_output=True,
        encoding="utf-8",
        check=True,
    ).stdout


def test_readme_shows_the_quickstart_and_its_output(tmp_path):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = re.search(r"<!-- example: (\S+) -->\n```python\n(.*?)```", readme, re.DOTALL)
    printed = re.search(r"<!-- output -->\n```\n(.*?)```", readme, re.DOTALL)
    assert shown
    assert [shown[1]] == EXAMPLES
    assert printed
    source = (ROOT / shown[1]).read_text(encoding="utf-8")
    assert shown[2] in source
    assert run(ROOT / shown[1], tmp_path) == printed[1]
