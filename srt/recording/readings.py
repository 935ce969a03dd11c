"""Readings of recordings by window and of six channels, and values that are derived from them once."""

from __future__ import annotations

from functools import wraps
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from srt.arguments import require_type
from srt.recording.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from srt.types import Array, Indices

Function = TypeVar("Function", bound="Callable[..., Any]")


def derived(make: Function) -> Function:
    """Function of a recording and hashable options that computes each value once, see :meth:`Recording.memo`.

    Raises
    ------
    InputError
        If the first argument is no recording.
    """

    @wraps(make)
    def stored(recording: Recording, *args: Any, **options: Any) -> Any:
        require_type(make.__name__, "a recording (srt.read makes one of arrays)", recording, Recording)
        key = (make, args, tuple(sorted(options.items())))
        return recording.memo(key, lambda: make(recording, *args, **options))

    return cast("Function", stored)


def six_channels(recording: Recording, samples: slice | Indices) -> Array:
    """Readings of gyros and accelerometers as rates, shape (n, 6)."""
    return np.concatenate([recording.gyro[samples], recording.accel[samples]], axis=1) * recording.rates_factor


def by_length(values: Array, windows: Indices) -> Iterator[tuple[Indices, Array]]:
    """Samples of windows, those of one length together.

    ``windows``, shape (W, 2), are the first samples and those one past the last. Yields the numbers of the windows,
    shape (w,), and their samples, shape (w, samples, ...).
    """
    lengths = windows[:, 1] - windows[:, 0]
    for n in np.unique(lengths).tolist():
        which = np.flatnonzero(lengths == n)
        yield which, values[windows[which, :1] + np.arange(n)]


def side_by_side(readings: Sequence[Array], windows: Sequence[Indices]) -> Iterator[tuple[Indices, Array]]:
    """:func:`by_length` of recordings with windows of equal lengths, shape (w, samples, 3 for each recording)."""
    for of_units in zip(*(by_length(*pair) for pair in zip(readings, windows, strict=True)), strict=True):
        tables = [table for _, table in of_units]
        yield of_units[0][0], tables[0] if len(tables) == 1 else np.concatenate(tables, axis=2)


def of_each(values: Array) -> Array:
    """Values (..., 3 for each recording) of readings side by side, shape (recordings, ..., 3)."""
    apart = values.reshape(*values.shape[:-1], -1, 3)
    return np.ascontiguousarray(np.moveaxis(apart, -2, 0))
