"""The command line ``srt``: the composition root, and the only part of the package that prints.

Every command is one module, imported when it is run, so that ``srt --help`` is fast. Results go to standard output;
progress, warnings and errors go to standard error. The text of results is made in ``srt.reports.text``.

Exit codes: 0 success; 1 the data cannot support a result, or not a converged one; 2 wrong usage or unreadable
input, or a standard output that cannot be written; 130 interrupted (129 and 143 by SIGHUP and SIGTERM), 141 standard
output closed by its reader.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from srt.exceptions import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: those of the process.

    Returns
    -------
    int
        The exit code.
    """
    try:
        from srt.cli.app import run
    except ModuleNotFoundError as error:
        if error.name != "click":
            raise
        print(f"srt: {MissingExtraError('click', 'cli', 'The command line')}", file=sys.stderr)
        return 2
    return run(sys.argv[1:] if arguments is None else arguments)
