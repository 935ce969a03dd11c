"""Command lines and processes of the benchmarks, with one thread of linear algebra each; imported before numpy."""

from __future__ import annotations

import argparse
import inspect
import os
import sys
from types import NoneType
from typing import TYPE_CHECKING, Any, get_args, get_origin, get_type_hints

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

# The matrices are small: threads would wait for each other. Child processes inherit it.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")


MOST_LISTED = 12
"""Values of an argument that the help lists."""


def run(main: Callable[..., int | None], doc: str | None, **choices: Collection[str]) -> None:
    """Call a function with the arguments of the command line, and exit with the code that it gives.

    Keyword arguments are options of their names, of the types of their annotations: a bool is a flag, a tuple takes
    several values. The others are positional. ``choices`` holds the allowed values of an argument by its name.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    hints = get_type_hints(main)
    for name, argument in inspect.signature(main).parameters.items():
        hint, option = hints[name], argument.kind is argument.KEYWORD_ONLY
        label = f"--{name.replace('_', '-')}" if option else name
        if hint is bool:
            parser.add_argument(label, action="store_true")
            continue
        kind = next(each for each in get_args(hint) or (hint,) if each not in (NoneType, ...))
        given: dict[str, Any] = {"type": kind, "choices": choices.get(name), "metavar": kind.__name__.upper()}
        if name in choices and len(choices[name]) <= MOST_LISTED:
            del given["metavar"]
        if argument.default is not argument.empty:
            given |= {"default": argument.default, "help": "default: %(default)s"}
        if get_origin(hint) is tuple:
            given["nargs"] = "+" if option else "*"
        elif not option and argument.default is not argument.empty:
            given["nargs"] = "?"
        parser.add_argument(label, **given)
    sys.exit(main(**vars(parser.parse_args())))


def in_processes(jobs: int, trial: Callable[..., Any], tasks: Iterable[Sequence[Any]]) -> Iterator[Any]:
    """Results of ``trial(*task)`` in the order of the tasks."""
    from joblib import Parallel, delayed

    return iter(Parallel(n_jobs=jobs, return_as="generator")(delayed(trial)(*task) for task in tasks))
