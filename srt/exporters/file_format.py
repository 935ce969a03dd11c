"""Description of an export format, and checked reading of its fields."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.exceptions import InputError, optional
from srt.exporters.export_model import origin
from srt.result.json_file import parse_json
from srt.sensor_errors import GROUPS, INDEX

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from srt.exporters.export_model import ExportModel
    from srt.result.calibration import Calibration
    from srt.types import Array, Mask

    Texts = Mapping[str, str]
    Fields = dict[str, Array]

ABSENT: Final = "there is no"
"""Opening of the refusal of a file without a field: it may well be of another format."""
ROUNDING: Final = 1e-11
"""Relative rounding of two orders of the same operations in double precision (condition numbers reach 10)."""
SINGLE: Final = 2e-6
"""The same for files in single precision: 6e-8 for each of about a dozen numbers, times a margin of 3."""

_AXES: Final = {
    "mars": "MARS, those of the calibration",
    "table": "those of the table-mounted frame",
    "accel": "those that the accelerometer matrix defines",
}
_ROTATION_WITHIN: Final = 1e-6
"""Largest departure from orthogonality of a rotation written with seven digits."""
_ZERO_WITHIN: Final = 1e-12
"""Largest entry that counts as rounding of zero."""


@dataclass(frozen=True, slots=True)
class Exporter:
    """Export format."""

    name: str  # on the command line
    title: str  # in text
    suffixes: tuple[str, ...]  # endings that its file may have, the first preferred
    formula: str  # formula of the target, ASCII
    write: Callable[[ExportModel], dict[str, str]]  # the texts of its files, by part
    read: Callable[[Texts], Fields]  # fields by name out of the texts; raises InputError
    # the target's formula: (fields, gyro, accel), shapes (n, 3) in SI, to the corrected ones in SI
    apply: Callable[[Fields, Array, Array], tuple[Array, Array]]
    losses: tuple[str, ...] = ()  # parts of a calibration that it does not hold, beside asymmetry and covariance
    advice: tuple[str, ...] = ()  # notes on the use of the file
    # axes that it can be written in, the first by default: "mars", "table" or, where the format decides them, "accel"
    frames: tuple[str, ...] = ("mars", "table")
    parts: tuple[str, ...] = ("",)  # appended to the stem of the file's name; one empty part is one file
    companions: tuple[str, ...] = ()  # parts that are written beside these and not needed to read a file
    triangle: str | None = None  # "lower" or "upper", shape of the accelerometer matrix in axes "accel"
    # the linear part comes back to this fraction of the largest value; None where the format is too small for it
    within: float | None = ROUNDING
    biases: bool = True  # True if it holds biases
    options: frozenset[str] = frozenset()  # ExportSettings that it takes; others are refused
    asymmetry: bool = False  # True if it holds asymmetry
    g_sensitivity: bool = False  # True if it holds gyro g-sensitivity
    # How to find the correction that a log was made under, where the parameters replace that inside the unit.
    find_applied: str = ""
    # sentences on what the target does with these parameters, given the model and the fields of the file
    limits: Callable[[ExportModel, Fields], tuple[str, ...]] = lambda model, fields: ()  # noqa: ARG005

    @property
    def imports(self) -> bool:
        """True if it can be read as a pre-calibration: it holds the linear part, and not a whole calibration."""
        return self.within is not None and not self.asymmetry

    def measured(self, observed: Mask) -> bool:
        """True if any of the parameters that the file holds is among the observed ones, shape (27,)."""
        lacking = ("asymmetry",) * (not self.asymmetry) + ("bias",) * (not self.biases)
        return any(observed[k] for name, k in INDEX.items() if not any(word in name for word in lacking))


def further_errors(calibration: Calibration) -> tuple[str, ...]:
    """Groups of errors of a calibration that no format of another program holds, in words."""
    groups = (group.name for group in GROUPS if group.further and calibration.errors.group(group.name).any())
    return tuple(name.replace("_", " ") for name in groups)


def heading(item: Exporter, model: ExportModel) -> list[str]:
    """ASCII lines for a comment: unit, origin, formula, axes and losses."""
    lost: tuple[str, ...] = () if item.asymmetry else ("scale-factor asymmetry",)
    lost += ("g-sensitivity",) if model.calibration.g_sensitivity is not None and not item.g_sensitivity else ()
    return [
        f"{item.title}; generated, do not edit.",
        *origin(model.calibration),
        f"formula: {item.formula}",
        f"axes: {_AXES[model.frame]}; a vector v in MARS axes is C v in these, C =",
        *(f"  [{', '.join(f'{value:.15g}' for value in row)}]" for row in model.C_FB.tolist()),
        *(model.applied_lines()),
        *(f"not held: {loss}" for loss in (*lost, *further_errors(model.calibration), *item.losses, "covariance")),
    ]


def matrix(
    document: Any, path: str, within: str = "", *, triangle: str | None = None, turn: bool = False, flat: bool = False
) -> Array:
    """Take a matrix of 3 by 3 out of a nested document, which has an inverse. Raises InputError.

    Parameters
    ----------
    path : str
        Keys, separated by points, as messages name them.
    within : str
        Keys before these, with a point at the end.
    triangle : "lower", "upper" or None
        Shape that its reader takes.
    turn : bool
        True for a rotation.
    flat : bool
        True for nine numbers by rows.
    """
    values = field(document, within + path, (9,) if flat else (3, 3)).reshape(3, 3)
    if turn:
        return rotation(values, path)
    return invertible(values if triangle is None else triangular(values, path, triangle), path)


def each_sensor(
    correct: Callable[[Fields, str, Array], Array],
) -> Callable[[Fields, Array, Array], tuple[Array, Array]]:
    """Formula of a target for both triads alike; ``correct`` takes fields, "gyro" or "accel", and readings."""
    return lambda fields, gyro, accel: (correct(fields, "gyro", gyro), correct(fields, "accel", accel))


def field(document: Any, path: str, shape: tuple[int, ...]) -> Array:
    """Take an array out of a nested document.

    Parameters
    ----------
    path : str
        Keys, separated by points.

    Returns
    -------
    ndarray

    Raises InputError: absent, of another shape, or not finite numbers.
    """
    found = document
    for key in path.split("."):
        if not isinstance(found, dict) or key not in found:
            raise InputError(f"{ABSENT} {path} in it: it was truncated, or is of another format.")
        found = found[key]
    return numbers(found, path, shape)


def numbers(found: Any, name: str, shape: tuple[int, ...]) -> Array:
    """Make an array of finite numbers of the shape, or raise InputError."""
    try:
        values = np.array(found, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} is not {_sized(shape)} numbers: it was edited.") from None
    if values.shape != shape:
        raise InputError(
            f"{name} has the shape {values.shape}, but {_sized(shape)} numbers are expected: it was edited."
        )
    if not np.all(np.isfinite(values)):
        raise InputError(f"{name} holds values that are not finite numbers: it was edited.")
    return values


def triangular(values: Array, name: str, triangle: str) -> Array:
    """Refuse a matrix with entries that its reader would ignore."""
    dropped = np.triu(values, 1) if triangle == "lower" else np.tril(values, -1)
    if np.abs(dropped).max() > _ZERO_WITHIN:
        raise InputError(
            f"{name} is not {triangle}-triangular (an entry of {np.abs(dropped).max():.3g} would be dropped silently): "
            "factor it, or export the calibration anew."
        )
    return values


def rotation(values: Array, name: str) -> Array:
    """Refuse a matrix that is no rotation."""
    if np.abs(values @ values.T - np.eye(3)).max() > _ROTATION_WITHIN or np.linalg.det(values) < 0.0:
        raise InputError(f"{name} is no rotation: it was edited.")
    return values


def invertible(values: Array, name: str) -> Array:
    """Refuse a matrix without an inverse."""
    if not np.linalg.svd(values, compute_uv=False)[-1] > _ROTATION_WITHIN:
        raise InputError(f"{name} has no inverse: it was edited.")
    return values


def to_json(document: Mapping[str, Any]) -> str:
    """Write JSON, numbers in full."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def from_json(text: str) -> dict[str, Any]:
    """Read JSON that holds a mapping. Raises InputError."""
    try:
        document = parse_json(text)
    except InputError as error:
        raise InputError(f"it is {error}") from None
    return _mapping(document)


def to_yaml(document: Mapping[str, Any], head: str = "") -> str:
    """Write YAML, numbers in full and in a form that every reader takes for numbers. Raises MissingExtraError."""
    yaml = _yaml()

    class Dumper(yaml.SafeDumper):  # type: ignore[misc, name-defined]
        """Indents lists below their key: OpenCV's FileStorage, which reads for OpenVINS, requires it."""

        def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:  # noqa: ARG002
            return super().increase_indent(flow, indentless=False)

    # PyYAML writes 1.0e-05; a YAML 1.1 reader takes 1e-05 for a string. Only lists of numbers stand in one line.
    flat = not any(isinstance(value, list | dict) for value in document.values())
    options: dict[str, Any] = {"sort_keys": False, "default_flow_style": False if flat else None, "width": 1000}
    return head + str(yaml.dump(_unsigned_zeros(document), Dumper=Dumper, **options))


def _unsigned_zeros(value: Any) -> Any:
    """Document without -0.0, which products of zeros leave."""
    if isinstance(value, dict):
        return {key: _unsigned_zeros(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_unsigned_zeros(each) for each in value]
    return value + 0.0 if isinstance(value, float) else value


def from_yaml(text: str) -> dict[str, Any]:
    """Read YAML that holds a mapping, with or without OpenCV's first line. Raises InputError, MissingExtraError."""
    yaml = _yaml()
    first, _, rest = text.partition("\n")
    try:
        document = yaml.safe_load(rest if first.startswith("%YAML:") else text)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"it is not valid YAML ({reason}): is it truncated?") from None
    return _mapping(document)


def whole_lines(text: str) -> list[str]:
    """Split text into lines; the last must end, or a number in it may be half a number. Raises InputError."""
    if not text.endswith("\n"):
        raise InputError("its last line does not end: it was truncated.")
    return text.splitlines()


def single(values: Array) -> Array:
    """Round to the numbers that single precision has."""
    return np.asarray(values, dtype=np.float32).astype(np.float64)


def solved(matrix: Array, vectors: Array) -> Array:
    """Rows of shape (n, 3), each multiplied by the inverse of a matrix."""
    return np.asarray(np.linalg.solve(matrix, vectors.T).T, dtype=np.float64)


def rows(matrix: Array, vectors: Array) -> Array:
    """Rows of shape (n, 3), each multiplied by a matrix."""
    return np.asarray(vectors @ matrix.T)


def _mapping(document: Any) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise InputError("it holds no fields by name: it was truncated, or is of another format.")
    return document


def _sized(shape: Sequence[int]) -> str:
    return " by ".join(map(str, shape))


def _yaml() -> Any:
    with optional("yaml", "formats", "This format", "pyyaml"):
        import yaml
    return yaml
