"""Calibration file checked for completeness and consistency, as input of a certificate.

A calibration states many values twice: sigmas and the covariance's diagonal, names and units beside each value.
An edit by hand mostly changes one of the two.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.arguments import require_type
from srt.exceptions import InputError, clipped
from srt.model.sensor_model import outside_model
from srt.recording.bounded_file import read_bounded
from srt.result.calibration import Calibration, load_calibration
from srt.result.json_file import json_text
from srt.result.verdict import USABLE
from srt.sensor_errors import INDEX, N_PARAMETERS, SYMBOLS, UNITS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_ROUNDING: Final = 1e-6
"""Relative tolerance between values stated twice: numbers are written in full, so the difference is rounding."""
_ROTATION: Final = 1e-6
"""Largest departure of U from orthogonality."""
_HASH_DIGITS: Final = 64
"""Hexadecimal digits of a SHA-256."""
_LARGEST_COUNT: Final = 2**53
"""Largest integer that doubles count exactly to."""


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFile:
    """Calibration and its file.

    Attributes
    ----------
    calibration : Calibration
    name : str
        Name of the file, without its folder.
    sha256 : str
        SHA-256 of the file.
    """

    calibration: Calibration
    name: str
    sha256: str

    @property
    def serial(self) -> str | None:
        """Serial of the unit; None if not stated."""
        serial: str | None = self.calibration.provenance.get("serial")
        return serial

    @property
    def hashes(self) -> tuple[str, ...]:
        """SHA-256 of the samples of all recordings of the calibration."""
        provenance = self.calibration.provenance
        tables = provenance.get("recordings") or [provenance]
        return tuple(t["data_sha256"] for t in tables if t.get("data_sha256"))


def calibration_file(source: Calibration | str | PathLike[str], *, trust: bool = False) -> CalibrationFile:
    """Calibration of a certificate, from its file or from memory; the hash of the latter is that of its file."""
    require_type("A certificate", "a calibration, or the path of one", source, Calibration, str, PathLike)
    if not isinstance(source, Calibration):
        return load_calibration_file(Path(source), trust=trust)
    text = json_text(source.to_dict())
    reason = _defect(source, json.loads(text))
    if reason is not None:
        raise InputError(f"The calibration is not consistent: {reason}.")
    return CalibrationFile(source, "not saved", hashlib.sha256(text.encode()).hexdigest())


def load_calibration_file(path: Path, *, trust: bool = False) -> CalibrationFile:
    """Read and check a calibration file.

    Parameters
    ----------
    path : Path
    trust : bool
        Accept a file that was changed after it was written.

    Returns
    -------
    CalibrationFile

    Raises
    ------
    InputError
        As :func:`srt.load_calibration` raises it; parts that are missing or of a wrong type, and parts that contradict
        each other.
    """
    try:
        data = read_bounded(path)
        calibration = load_calibration(path, trust=True)
        document = json.loads(data, parse_constant=_number, parse_float=_number, parse_int=_number)
    except OSError as error:
        raise InputError(f"The calibration {path} cannot be read: {error.strerror}.") from None
    except (ValueError, IndexError, OverflowError, RecursionError) as error:
        raise InputError(f"{path} is not a complete calibration ({clipped(str(error))}); it was edited.") from None
    reason = _defect(calibration, document)
    if reason is not None:
        raise InputError(
            f"The calibration {path} was edited or truncated: {reason}; take the file that 'srt calibrate' wrote."
        )
    if not trust:
        load_calibration(path)  # compares the digest, after what is wrong in itself was named
    return CalibrationFile(calibration, path.name, hashlib.sha256(data).hexdigest())


def _number(text: str) -> float:
    """Read a number that a calibration can hold; infinite ones, and integers beyond all floats, are none."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"it holds {clipped(text, 12)}")
    return int(text) if text.lstrip("-").isdecimal() and abs(value) < _LARGEST_COUNT else value


def _defect(calibration: Calibration, document: Mapping[str, Any]) -> str | None:
    """First defect of a calibration; None without a defect."""
    for key, fits, expected in _PARTS:
        value: Any = {"verdict": {}, **document}  # a verdict may be absent, but nothing else in its place
        for step in key.split("."):
            value = value.get(step) if isinstance(value, dict) else None
        if not fits(value):
            return f"{key} is not {expected}"
    return (
        _inconsistent_row(document)
        or _inconsistent_covariance(calibration)
        or _inconsistent_verdict(calibration, document.get("verdict", {}))
    )


def _inconsistent_row(document: Mapping[str, Any]) -> str | None:
    for row, unit, symbol in zip(document["parameters"], UNITS, SYMBOLS, strict=True):
        for key, expected in (("unit", unit), ("symbol", symbol)):
            if row.get(key) != expected:
                return f"the {key} of {row['name']} is {clipped(repr(row.get(key)))} instead of {expected!r}"
        if not _is_number(row["value"]) or not isinstance(row["observed"], bool):
            return f"{row['name']} has a value that is no number, or does not say whether it was observed"
        if not row["observed"] and (row.get("sigma") is not None or not isinstance(row.get("held_reason"), str)):
            return f"{row['name']} is held, but has a sigma or no reason"
    return None


def _inconsistent_covariance(calibration: Calibration) -> str | None:
    observed, covariance = calibration.observed, calibration.covariance
    sigma = np.sqrt(np.maximum(np.diag(covariance)[observed], 0.0))
    if covariance[~observed].any():
        return "the covariance of held parameters is not zero"
    if not np.all(sigma > 0.0):
        return "a sigma is not positive"
    correlation = covariance[np.ix_(observed, observed)] / np.outer(sigma, sigma)
    if sigma.size and np.linalg.eigvalsh(correlation)[0] < -_ROUNDING:
        return "the covariance is none (a combination of parameters would have a negative variance)"
    sizes = calibration.contributions.values()
    if any(size.shape != (N_PARAMETERS,) or not np.all(np.isfinite(size)) for size in sizes):
        return f"a source of error does not have {N_PARAMETERS} sigmas"
    return _inconsistent_status(calibration)


def _inconsistent_status(calibration: Calibration) -> str | None:
    U = calibration.U
    if U is not None and (
        U.shape != (3, 3) or not np.allclose(U @ U.T, np.eye(3), atol=_ROTATION) or np.linalg.det(U) < 0.0
    ):
        return "frame.U is no rotation"
    if calibration.status == "converged" and calibration.held:
        return "it says converged, but parameters are held"
    reason = outside_model(calibration.errors) if calibration.status in USABLE else None
    return None if reason is None else f"it says {calibration.status}, but {reason}"


def _inconsistent_verdict(calibration: Calibration, written: Mapping[str, Any]) -> str | None:
    word = written.get("word")
    if calibration.status in USABLE and word is not None and word != calibration.judgement.word:
        return f"its verdict is {clipped(repr(word))} instead of {calibration.judgement.word!r}"
    sigma = calibration.sigma
    for row in calibration.verdict.get("parameters", ()):
        if str(row.get("name")) not in INDEX or not _is_number(row.get("sigma")):
            return "a parameter of the verdict is none"
        if not math.isclose(row["sigma"], sigma[INDEX[row["name"]]], rel_tol=_ROUNDING):
            return f"the verdict has another sigma of {row['name']} than the covariance"
    return None


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _or_none(fits: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: value is None or fits(value)


def _is_hash(value: object) -> bool:
    return isinstance(value, str) and len(value) == _HASH_DIGITS and set(value) <= set("0123456789abcdef")


def _list_of(fits: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, list) and all(map(fits, value))


def _table(**columns: Callable[[object], bool]) -> Callable[[object], bool]:
    """Test for a table with at least these columns."""
    return lambda value: isinstance(value, dict) and all(fits(value.get(key)) for key, fits in columns.items())


def _whole_table(**columns: Callable[[object], bool]) -> Callable[[object], bool]:
    """Test for a table in which all of these columns are present."""
    fits = _table(**columns)
    return lambda value: isinstance(value, dict) and set(columns) <= set(value) and fits(value)


def _is_chance(value: object) -> bool:
    return _is_number(value) and 0.0 <= value <= 1.0  # type: ignore[operator]


def _is_size(value: object) -> bool:
    return _is_number(value) and value >= 0.0  # type: ignore[operator]


def _is_verdict(value: object) -> bool:
    """True for a complete verdict, and for an absent one."""
    judged = {"chi_square": _is_size, "degrees_of_freedom": _is_size, "probability": _or_none(_is_chance)}
    sequences = _list_of(_whole_table(sequence=_is_text, occurrence=_is_number, **judged))
    whole = _whole_table(**judged, sequences=sequences, parameters=_list_of(_table()))
    return value == {} or whole(value)


_PROVENANCE: Final = {
    "serial": _or_none(_is_text),
    "date": _or_none(_is_text),
    "data_sha256": _or_none(_is_hash),
    "software": _or_none(_is_text),
}
_PARTS: Final[tuple[tuple[str, Callable[[object], bool], str], ...]] = (
    ("estimator", _is_text, "a name"),
    ("message", _is_text, "a sentence"),
    ("warnings", _or_none(_list_of(_is_text)), "a list of sentences"),
    ("iterations", _list_of(_table(max_correction=_is_size)), "a list of corrections"),
    ("frame.U_sigma", _or_none(_is_size), "a sigma"),
    ("site", _table(latitude_deg=_or_none(_is_number), gravity_m_s2=_or_none(_is_size)), "a site"),
    ("site.gravity_sigma_m_s2", _or_none(_is_size), "a sigma"),
    ("alignment", _table(), "a table"),
    ("noise", _table(), "a table"),
    ("diagnostics", _or_none(_table()), "a table"),
    ("temperature", _or_none(_table(mean_c=_is_number, range_c=_is_size)), "a mean and a range"),
    (
        "residuals",
        _list_of(
            _table(sequence=_is_text, occurrence=_is_number, component=_is_text, value=_is_number, sigma=_is_size)
        ),
        "a list of residuals",
    ),
    ("provenance", _table(**_PROVENANCE, options=_or_none(_table()), voided=_or_none(_table())), "a provenance"),
    ("provenance.recordings", _or_none(_list_of(_table(**_PROVENANCE))), "a list of provenances"),
    ("verdict", _is_verdict, "a whole verdict"),
)
"""Checked parts of the file: key, test, and expectation in words."""
