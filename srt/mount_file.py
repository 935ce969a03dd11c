"""Mount alignments on disk: versioned JSON, complete; what is read back is what was written."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError
from srt.mount_alignment import ANGLES, MountAlignment
from srt.recording.atomic import atomic_write_text

if TYPE_CHECKING:
    from os import PathLike

FORMAT: Final = "srt-mount-alignment"
VERSION: Final = 1
FORMULA: Final = (
    "C_nm = C_nb C_bm: attitude of the mount from that of the sensor axes (MARS), with C_bm = matrix, mount to sensor "
    "components. The angles are those of the sensor axes in the mount: transpose(C_bm) = Rz(yaw) Ry(pitch) Rx(roll)."
)
_ROUNDING: Final = 1e-9


def to_dict(mount: MountAlignment) -> dict[str, Any]:
    """The JSON form as a dictionary; no NaN in it."""
    angles = zip(ANGLES, mount.angles_rad.tolist(), mount.sigma_rad.tolist(), strict=True)
    return {
        "format": FORMAT,
        "version": VERSION,
        "method": mount.method,
        "angles": [{"name": name, "value": value, "sigma": sigma, "unit": "rad"} for name, value, sigma in angles],
        "matrix": mount.matrix.tolist(),
        "covariance": mount.covariance.tolist(),
        "sources": {name: sigma.tolist() for name, sigma in mount.sources.items()},
        "formula": FORMULA,
        "stands": [dict(stand) for stand in mount.stands],
        "warnings": list(mount.warnings),
        "provenance": dict(mount.provenance),
    }


def write(mount: MountAlignment, path: str | PathLike[str]) -> None:
    """Write the JSON form, whole or not at all. Raises InputError if the path cannot be written."""
    atomic_write_text(path, json.dumps(to_dict(mount), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def load_mount_alignment(path: str | PathLike[str]) -> MountAlignment:
    """Read a mount alignment.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    MountAlignment

    Raises
    ------
    InputError
        If the file cannot be read, is no mount alignment, is of another version, or is not consistent.
    """
    try:
        with open(path, encoding="utf-8") as file:  # noqa: PTH123 - any path-like is welcome
            document = json.load(file)
    except OSError as error:
        raise InputError(f"The mount alignment {path} cannot be read: {error.strerror}.") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"The mount alignment {path} is not valid JSON ({error}): is it truncated?") from None
    try:
        return _from_dict(document)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path} is not a complete mount alignment ({type(error).__name__}: {error}); it was edited or truncated."
        ) from None


def _from_dict(document: dict[str, Any]) -> MountAlignment:
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f'this is no mount alignment (its "format" is not "{FORMAT}").')
    if document.get("version") != VERSION:
        raise InputError(f"its version is {document.get('version')!r}, but this software reads version {VERSION}.")
    C, P = (np.array(document[name], dtype=np.float64) for name in ("matrix", "covariance"))
    if C.shape != (3, 3) or not np.allclose(C @ C.T, np.eye(3), rtol=0.0, atol=_ROUNDING) or np.linalg.det(C) < 0.0:
        raise InputError("its matrix is no rotation of 3 by 3.")
    if P.shape != (3, 3) or not np.all(np.isfinite(P)) or not np.array_equal(P, P.T) or not np.all(np.diag(P) >= 0.0):
        raise InputError("its covariance is no symmetric matrix of 3 by 3 finite numbers.")
    mount = MountAlignment(
        C,
        P,
        {name: np.array(sigma, dtype=np.float64) for name, sigma in document["sources"].items()},
        document["method"],
        tuple(document["stands"]),
        tuple(document["warnings"]),
        document["provenance"],
    )
    if [angle["name"] for angle in document["angles"]] != list(ANGLES):
        raise InputError(f"its angles are not {', '.join(ANGLES)}.")
    for angle, value, sigma in zip(document["angles"], mount.angles_rad, mount.sigma_rad, strict=True):
        if not math.isclose(angle["value"], value, rel_tol=0.0, abs_tol=_ROUNDING):
            raise InputError(f"its {angle['name']} does not agree with the matrix.")
        if not math.isclose(angle["sigma"], sigma, rel_tol=_ROUNDING, abs_tol=1e-300):
            raise InputError(f"the sigma of its {angle['name']} does not agree with the covariance.")
    return mount
