"""Acceptance limits: largest absolute values and largest sigmas, from a TOML file with units in its keys."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, clipped, did_you_mean
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, INDEX, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from pathlib import Path

    from srt.result.calibration import Calibration
    from srt.types import Array, Mask


SUFFIXES: Final = {"ppm": "ppm", "µrad": "urad", "µg": "ug", "°/h": "deg_per_h"}
"""Unit suffixes of the keys, by display unit."""
SECTIONS: Final = ("value", "sigma")


@dataclass(frozen=True, slots=True, eq=False)
class AcceptanceLimits:
    """Largest absolute value and largest sigma of every parameter.

    Attributes
    ----------
    value, sigma : ndarray, shape (27,), SI
        NaN where there is no limit.
    name : str
        Name of the file, without its folder.
    """

    value: Array
    sigma: Array
    name: str

    @property
    def given(self) -> Mask:
        """Mask of the parameters with a limit, shape (27,)."""
        return np.asarray(~np.isnan(self.value) | ~np.isnan(self.sigma))

    def met(self, calibration: Calibration) -> Mask:
        """Mask of the parameters that meet their limits, shape (27,); a fixed one meets none.

        Parameters
        ----------
        calibration : Calibration
        """
        # Written so that NaN, no limit, is met.
        value = ~(np.abs(calibration.errors.vector) > self.value)
        sigma = ~(calibration.sigma > self.sigma)
        return np.asarray((value & sigma & calibration.observed) | ~self.given)


def load_acceptance_limits(path: Path) -> AcceptanceLimits:
    """Read a file of limits: sections ``[value]`` and ``[sigma]``, keys such as ``gyro_scale_ppm``.

    A key names a parameter or a group, and the unit of the table after it; a parameter's own limit goes before that
    of its group.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        A file that cannot be read, an unknown key, a wrong unit, or a limit that is no positive number.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"The limits {path} cannot be read: {error.strerror}.") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"The limits {path} are not valid TOML: {clipped(str(error), 120)}.") from None
    unknown = [key for key in document if key not in SECTIONS]
    if unknown:
        raise InputError(
            f"The limits {path} have a part {clipped(unknown[0])!r}{did_you_mean(unknown[0], SECTIONS)}: "
            "the sections are [value] and [sigma]."
        )
    found = {section: _section(path, section, document.get(section, {})) for section in SECTIONS}
    limits = AcceptanceLimits(found["value"], found["sigma"], path.name)
    if not limits.given.any():
        raise InputError(f"The limits {path} limit nothing: add a key such as gyro_scale_ppm = 300.0 under [value].")
    return limits


def _section(path: Path, section: str, table: Any) -> Array:
    if not isinstance(table, dict):
        raise InputError(f"The limits {path}: {section} is no section; write [{section}].")
    out = np.full(N_PARAMETERS, np.nan)
    # Groups first, so that a parameter's own limit replaces its group's.
    for names in (GROUP_SLICES, INDEX):
        for key, value in table.items():
            name = _name(path, section, key)
            if name not in names:
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < math.inf:
                raise InputError(
                    f"The limits {path}: {section}.{key} is {clipped(repr(value))}; give a positive number."
                )
            part = GROUP_SLICES[name] if name in GROUP_SLICES else slice(INDEX[name], INDEX[name] + 1)
            out[part] = value / np.array(DISPLAY_FACTORS)[part]
    return out


def _name(path: Path, section: str, key: str) -> str:
    """Parameter or group of a key."""
    known = {name: _suffix(part.start) for name, part in GROUP_SLICES.items()}
    known |= {name: _suffix(i) for i, name in enumerate(NAMES)}
    keys = {f"{name}_{unit}": name for name, unit in known.items()}
    if key in keys:
        return keys[key]
    stem = max((name for name in known if key == name or key.startswith(f"{name}_")), key=len, default=None)
    if stem is not None:
        raise InputError(f"The limits {path}: {section}.{clipped(key)} is in another unit: write {stem}_{known[stem]}.")
    raise InputError(
        f"The limits {path}: there is no {section}.{clipped(key)}{did_you_mean(key, keys)}; "
        "a key is a parameter or a group with its unit, as gyro_scale_ppm."
    )


def _suffix(i: int) -> str:
    return SUFFIXES[DISPLAY_UNITS[i]]
