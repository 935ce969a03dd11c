"""From a recording to a calibration: the choice of estimator.

Estimators are functions ``(recording, options, progress) -> Calibration`` registered in the entry-point group
``srt.estimators``; any distribution can add its own.
"""

from __future__ import annotations

import importlib
from functools import cache
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, Final, Protocol

from srt.exceptions import InputError, MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.estimation.options import Options
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration

    Progress = Callable[[int, float], None]

GROUP: Final = "srt.estimators"
_BUILT_IN: Final = {
    "closed-form": "srt.estimation.closed_form_solver:estimate",
    "least-squares": "srt.estimation.least_squares_solver:estimate",
}


class Estimator(Protocol):
    """What an entry point of the group ``srt.estimators`` must be."""

    def __call__(self, recording: Recording, options: Options, progress: Progress | None = None) -> Calibration:
        """Calibrate a recording."""


def estimators() -> tuple[str, ...]:
    """Names of all registered estimators."""
    _installed.cache_clear()
    return tuple(sorted({*_BUILT_IN, *_installed()}))


@cache
def _installed() -> dict[str, str]:
    """Entry points of the group by name; listing what is installed takes as long as a tenth of a calibration."""
    return {entry.name: entry.value for entry in entry_points(group=GROUP)}


def find_estimator(name: str) -> Estimator:
    """Load an estimator by name.

    Raises
    ------
    InputError
        If none of that name is registered, or what it needs is not installed.
    """
    target = _BUILT_IN.get(name) or _installed().get(name)
    if target is None:  # it may have been installed since
        known = estimators()
        target = _installed().get(name)
        if target is None:
            raise InputError(f"There is no estimator {name!r}; installed are {', '.join(known)}.")
    module, _, attribute = target.partition(":")
    try:
        found: Estimator = getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as error:
        raise MissingExtraError(str(error.name), "all", f"The estimator {name!r}") from None
    return found


def calibrate(
    recording: Recording,
    estimator: str = "auto",
    *,
    options: Options | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> Calibration:
    """Calibrate an IMU from a recording.

    Parameters
    ----------
    recording : Recording
        Without labels, sequences of Table 1 made on a fixture are recognised; a free recording is cut into free turns.
    estimator : str
        "auto" takes the closed form where sequences of Table 1 are labelled on a fixture, least squares elsewhere.
        Others by name, see :func:`estimators`.
    options : Options, optional
    progress : callable, optional
        Called after every play-back with its number and the largest correction.
    **choices
        Fields of :class:`srt.estimation.options.Options`, instead of ``options``.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        Unknown estimator or option.
    DataError
        Data that cannot support a result.
    """
    from srt.estimation.options import Options as _Options
    from srt.sequences.recognition import label_sequences

    if options is None:
        unknown = sorted(set(choices) - set(_Options.__dataclass_fields__))
        if unknown:
            raise InputError(
                f"Unknown option {unknown[0]!r}; the options are {', '.join(_Options.__dataclass_fields__)}."
            )
        options = _Options(**choices)
    elif choices:
        raise InputError("Give either options or single choices, not both.")
    recording, recognition = label_sequences(recording)
    name = automatic_estimator(recording) if estimator == "auto" else estimator
    calibration = find_estimator(name)(recording, options, progress)
    return calibration if recognition is None else recognition.told_in(calibration)


def automatic_estimator(recording: Recording) -> str:
    """What "auto" stands for: the closed form for sequences of Table 1 on a fixture, else least squares."""
    from srt.model.table1 import SEQUENCES

    labelled = [s for s in recording.sequences if s.id in SEQUENCES]
    return "closed-form" if recording.fixture is not None and labelled else "least-squares"
