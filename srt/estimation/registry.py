"""Registry of estimators, and the choice of one for a recording.

Estimators are functions ``(recording, options, progress) -> Calibration``. Those of ``srt`` are listed here. Those of
other packages are entry points of the group ``srt.estimators``: this repository states its own in ``pyproject.toml``,
and any distribution can add more. An estimator that is to be compared by default also needs its name in
:data:`ESTIMATORS`. The recipe is in ``docs/estimators.md``.
"""

from __future__ import annotations

import importlib
import inspect
from contextlib import nullcontext
from functools import cache
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Final, Protocol

from srt.arguments import require_type
from srt.estimation.fixed_parameters import in_frame_of_poses
from srt.estimation.options import Options
from srt.exceptions import InputError, MissingExtraError
from srt.model.table1 import SEQUENCES
from srt.result.calibration import Calibration
from srt.sequences.recognition import label_sequences

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager
    from importlib.metadata import EntryPoint

    from srt.recording.recording import Recording

    Progress = Callable[[int, float], None]

GROUP: Final = "srt.estimators"
OWN_PACKAGE: Final = "estimators"
"""Package with the other estimators of this distribution; the extras that they need have their names."""
BUILT_IN: Final = {
    "closed-form": "srt.closed_form.estimator:estimate",
    "least-squares": "srt.joint.least_squares:estimate",
}
"""Estimators of ``srt`` itself."""
ESTIMATORS: Final = (*BUILT_IN, "ekf", "graph")
"""Estimators of this distribution, the least efficient first: compared by default, with fixed colours in figures."""

COMPLETING: Final = frozenset({"10", "11", "12", "13", "14"})
"""Sequences of Table 1 that complete the formulas of others, and alone support none."""


class Estimator(Protocol):
    """Signature of the entry points of the group ``srt.estimators``."""

    def __call__(self, recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
        """Calibrate a recording."""


def estimators() -> tuple[str, ...]:
    """Names of all registered estimators."""
    _installed.cache_clear()
    return tuple(sorted({*BUILT_IN, *_installed()}))


@cache
def _installed() -> dict[str, EntryPoint]:
    """Entry points of the group by name; cached, as listing them takes a tenth of the time of a calibration."""
    return {entry.name: entry for entry in entry_points(group=GROUP)}


def find_estimator(name: str) -> Estimator:
    """Load an estimator by name.

    Raises
    ------
    InputError
        If no estimator of that name is registered, a package that it needs is not installed, it cannot be loaded, or it
        cannot be called as an estimator.
    """
    require_type("estimator=", "the name of an estimator", name, str)
    if name in BUILT_IN:
        module, _, attribute = BUILT_IN[name].partition(":")
        built_in: Estimator = getattr(importlib.import_module(module), attribute)
        return built_in
    if name not in _installed():  # the package may have been installed since the last call
        known = estimators()
        if name not in _installed():
            raise InputError(f"There is no estimator {name!r}; installed are {', '.join(known)}.")
    entry = _installed()[name]
    found = _load(entry)
    try:
        inspect.signature(found).bind(None, None, None)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"The estimator {name!r} ({entry.value}) cannot be called with a recording, options and progress "
            f"({error}): correct it, or uninstall {_distribution(entry)}."
        ) from None
    return found


def _load(entry: EntryPoint) -> Estimator:
    """Object of an entry point. Raises InputError in a sentence, whatever its module raises."""
    try:
        module, _, attribute = entry.value.partition(":")
        found: Estimator = getattr(importlib.import_module(module), attribute)
    except Exception as error:  # code of others can fail in any way
        # An estimator of this distribution has an extra of its own name, with the packages that it needs.
        if isinstance(error, ModuleNotFoundError) and _is_ours(entry):
            raise MissingExtraError(str(error.name), entry.name, f"The estimator {entry.name!r}") from None
        raise InputError(
            f"The estimator {entry.name!r} ({entry.value}) cannot be loaded ({type(error).__name__}: {error}): repair "
            f"or uninstall {_distribution(entry)}."
        ) from None
    return found


def _is_ours(entry: EntryPoint) -> bool:
    return entry.value.partition(".")[0] == OWN_PACKAGE


def _distribution(entry: EntryPoint) -> str:
    """Name of the distribution of an entry point, as "the package x"."""
    return "its package" if entry.dist is None else f"the package {entry.dist.name}"


def estimate(
    recording: Recording, estimator: str = "auto", options: Options | None = None, progress: Progress | None = None
) -> Calibration:
    """Estimate the sensor errors, without checks for faults of the recording.

    Linear algebra runs in one thread: with matrices of a few hundred rows, more threads give no gain, and on a busy
    machine they were ten times slower.

    Parameters
    ----------
    recording : Recording
    estimator : str
    options : Options, optional
    progress : callable, optional
        As for :func:`srt.calibrate`.

    Raises
    ------
    InputError
        Unknown estimator.
    DataError
        Data that cannot support a result.
    """
    recording, recognition = label_sequences(recording)
    name = automatic_estimator(recording) if estimator == "auto" else estimator
    with _one_thread():
        calibration = find_estimator(name)(recording, in_frame_of_poses(recording, options or Options()), progress)
    if not isinstance(calibration, Calibration):
        raise InputError(
            f"The estimator {name!r} gave an object of type {type(calibration).__name__}, but a Calibration is "
            "expected: correct the estimator."
        )
    return calibration if recognition is None else recognition.told_in(calibration)


def _one_thread() -> AbstractContextManager[object]:
    """Keep linear algebra to one thread where threadpoolctl is installed."""
    try:
        from threadpoolctl import threadpool_limits
    except ModuleNotFoundError:
        return nullcontext()
    limits: AbstractContextManager[object] = threadpool_limits(limits=1, user_api="blas")
    return limits


def automatic_estimator(recording: Recording) -> str:
    """Name that "auto" stands for: the closed form for sequences of Table 1 on a fixture, else least squares."""
    labelled = {s.id for s in recording.sequences if s.id in SEQUENCES} - COMPLETING
    return "closed-form" if recording.fixture is not None and labelled else "least-squares"
