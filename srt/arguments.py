"""Checks of the arguments of public functions: a wrong one is refused in a sentence, where it comes in."""

from __future__ import annotations

import os
import warnings
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from srt.exceptions import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_Value = TypeVar("_Value")


def require_type(user: str, needed: str, value: object, *kinds: type) -> None:
    """Check the class of an argument.

    Parameters
    ----------
    user : str
        Function or class that takes the argument, as the start of a sentence: "An Applier".
    needed : str
        Kind of object that is expected, and its origin: "a calibration (srt.calibrate, srt.load_calibration)".
    value : object
    *kinds : type
        Classes of which the value may be.

    Raises
    ------
    InputError
        A value of another class.
    """
    if not isinstance(value, kinds):
        raise InputError(f"{user} needs {needed}, but an object of type {type(value).__name__} was given.")


def former_name(former: str, name: str, value: _Value) -> _Value:
    """Value of an attribute under its ``former`` name, with a DeprecationWarning at the line that uses it."""
    warnings.warn(f"{former} is called {name} now: the former name goes with the next version.", DeprecationWarning, 3)
    return value


def require_path(user: str, value: object) -> None:
    """Check that an argument is a path, as a text or path-like. Raises InputError."""
    require_type(user, "a path", value, str, os.PathLike)


def real_array(name: str, values: Any, *, dates: bool = False) -> NDArray[Any]:
    """Array of integers or floats, copied only if needed.

    Parameters
    ----------
    name : str
        Name in messages.
    values : array_like
    dates : bool
        Return dates and durations as they are.

    Raises
    ------
    InputError
        Masked values or complex numbers, of which a conversion would drop a part; what is no array of numbers.
    """
    if np.ma.is_masked(values):
        raise InputError(f"{name} has masked values, but every value must be known: fill them, or remove the samples.")
    kind = getattr(getattr(values, "dtype", None), "kind", "")
    if kind == "c":
        raise InputError(f"{name} has complex numbers, but real ones are expected: give their real part.")
    if dates and kind in ("m", "M"):  # with a time zone, of pandas, they are no array of numpy
        return values  # type: ignore[no-any-return]
    try:
        array = np.asarray(values)
        # Complex numbers in a list, and dates, have no safe cast; texts may be numbers.
        casting: Any = "unsafe" if array.dtype.kind in "bOUS" else "same_kind"
        return array if array.dtype.kind in "fiu" else array.astype(np.float64, casting=casting)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} does not consist of numbers: {error}.") from None
