"""Acceptance limits: largest absolute values and largest sigmas, from a TOML file with units in its keys."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, clipped, did_you_mean
from srt.recording.toml_text import read_toml
from srt.sensor_errors import DISPLAY_FACTORS, DISPLAY_UNITS, GROUP_SLICES, INDEX, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from pathlib import Path

    from srt.result.calibration import Calibration
    from srt.types import Array, Mask


SUFFIXES: Final = {"ppm": "ppm", "µrad": "urad", "µg": "ug", "°/h": "deg_per_h"}
"""Unit suffixes of the keys, by display unit."""
SECTIONS: Final = ("value", "sigma")
GUARD_SIGMAS: Final = 2.0
"""Guard band of guarded acceptance: the expanded uncertainty with k = 2 (ILAC-G8)."""


@dataclass(frozen=True, slots=True, eq=False)
class AcceptanceLimits:
    """Largest absolute value and largest sigma of every parameter."""

    value: Array  # shape (27,), SI; NaN where there is no limit
    sigma: Array  # likewise
    name: str  # of the file, without its folder
    guard_sigmas: float = 0.0  # guard band of the values; 0: simple acceptance

    @property
    def decision_rule(self) -> str:
        """Decision rule in sentences (ILAC-G8)."""
        both = "A sigma passes if it is not larger than its limit; a parameter that was not measured fails."
        if self.guard_sigmas == 0.0:
            return (
                "Decision rule: simple acceptance. A value passes if it lies within its limit; its uncertainty is not "
                f"subtracted, so that a true value at the limit is accepted in half of all cases. {both}"
            )
        return (
            f"Decision rule: guarded acceptance with a guard band of {self.guard_sigmas:g} sigma. A value passes if it "
            f"lies within its limit less {self.guard_sigmas:g} sigma; the probability of accepting a true value beyond "
            f"the limit is at most {0.5 * math.erfc(self.guard_sigmas / math.sqrt(2.0)):.2g}. {both}"
        )

    @property
    def given(self) -> Mask:
        """Mask of the parameters with a limit, shape (27,)."""
        return np.asarray(~np.isnan(self.value) | ~np.isnan(self.sigma))

    def met(self, calibration: Calibration) -> Mask:
        """Mask of the parameters that meet their limits, shape (27,); a fixed one meets none."""
        # Written so that NaN, no limit, is met.
        guard = self.guard_sigmas * np.where(calibration.observed, calibration.sigma, 0.0)
        value = ~(np.abs(calibration.errors.vector) + guard > self.value)
        sigma = ~(calibration.sigma > self.sigma)
        return np.asarray((value & sigma & calibration.observed) | ~self.given)


def load_acceptance_limits(path: Path) -> AcceptanceLimits:
    """Read a file of limits: sections ``[value]`` and ``[sigma]``, keys such as ``gyro_scale_ppm``.

    A section ``[decision]`` has ``rule`` ("simple" or "guarded") and ``guard_sigmas``, the guard band (default 2). A
    key names a parameter or a group, and the unit of the table after it; a parameter's own limit goes before that of
    its group.

    Raises InputError: a file that cannot be read, an unknown key, a wrong unit, or a limit that is no positive number.
    """
    document = read_toml(path)
    unknown = [key for key in document if key not in (*SECTIONS, "decision")]
    if unknown:
        raise InputError(
            f"The limits {path} have a part {clipped(unknown[0])!r}{did_you_mean(unknown[0], SECTIONS)}: "
            "the sections are [value] and [sigma], and [decision]."
        )
    found = {section: _section(path, section, document.get(section, {})) for section in SECTIONS}
    guard = _guard_sigmas(path, document.get("decision", {}))
    limits = AcceptanceLimits(found["value"], found["sigma"], path.name, guard)
    if not limits.given.any():
        raise InputError(f"The limits {path} limit nothing: add a key such as gyro_scale_ppm = 300.0 under [value].")
    return limits


def _guard_sigmas(path: Path, table: Any) -> float:
    """Guard band of the section [decision]."""
    known = ("rule", "guard_sigmas")
    if not isinstance(table, dict) or set(table) - set(known):
        raise InputError(f"The limits {path}: [decision] has the keys {' and '.join(known)} only; correct it.")
    rule, width = table.get("rule", "simple"), table.get("guard_sigmas")
    if rule not in ("simple", "guarded") or (rule == "simple" and width is not None):
        raise InputError(
            f'The limits {path}: decision.rule is {clipped(repr(rule))}; write "simple", without guard_sigmas, or '
            '"guarded".'
        )
    if width is not None and (isinstance(width, bool) or not isinstance(width, int | float) or not 0.0 < width < 10.0):
        raise InputError(f"The limits {path}: decision.guard_sigmas is {clipped(repr(width))}; give a number up to 10.")
    return 0.0 if rule == "simple" else GUARD_SIGMAS if width is None else float(width)


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
