"""Entry point of the commands ``srt`` and ``strapdown-srt``, outside the package ``srt``.

The subtitle library ``srt`` has the same two names. Where its module comes first on the path of Python, as from the
site-packages of a user, it hides the package; this module then says so. Where it was installed later, the command
``srt`` is its own; ``strapdown-srt`` and ``python -m strapdown_srt`` remain.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path


def main() -> int:
    """Run the command line, if the package ``srt`` is the one that was installed with this module.

    Returns
    -------
    int
        The exit code; 2 where another module answers to the name.
    """
    own = Path(__file__).resolve().with_name("srt")
    spec = find_spec("srt")  # reads no code: another module is not run
    found = None if spec is None or spec.origin is None else Path(spec.origin).resolve()
    if found is None or found.parent != own:
        print(
            f"srt: Python finds {found or 'nothing'} by the name srt, not {own} of strapdown-rotation-test: "
            "uninstall the other distribution of this name (pip uninstall srt, for the subtitle library) and install "
            "strapdown-rotation-test again, or install it in an environment of its own.",
            file=sys.stderr,
        )
        return 2
    from srt.cli import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
