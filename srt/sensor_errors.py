"""The 27 sensor errors as a declared list: names, order, units, effects on readings, priors; and their values.

A further error is a row of ``GROUPS``: estimators, covariances, reports, files and certificates take all from
there. Sensor model of a triad in the MARS frame B (``ω`` the true angular rate, ``f`` the true specific force)::

    ω̃ = Mg ω + κ_Asym ∘ |ω| + κ_Bias + noise      Mg = I + κ_LinScal + κ_Mis,  κ_ij = κ_ji = υ_ij / 2
    f̃ = Ma f + λ_Asym ∘ |f| + λ_Bias + noise      Ma = I + λ_LinScal + λ_Mis,  λ_ij = μ_ij

Savage 2020, eqs. 6-11. Biases are in rad/s and m/s², everything else is dimensionless or rad.
Readings, compensation and gauge by these equations are in :mod:`srt.model.sensor_model`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from srt.arguments import real_array
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import ArrayLike

    from srt.types import Array


@dataclass(frozen=True, slots=True)
class MatrixElements:
    """Effect of errors that are elements of the sensor matrix.

    Attributes
    ----------
    places : tuple
        For each error the (row, column) of its element, or of those that share it in equal parts.
    """

    places: tuple[tuple[tuple[int, int], ...], ...]

    def __call__(self, true: Array) -> Array:
        """Derivative of readings of true values (..., 3) with respect to the n errors, shape (..., 3, n)."""
        out = np.zeros((*true.shape, len(self.places)))
        for p, places in enumerate(self.places):
            for i, j in places:
                out[..., i, p] = true[..., j] / len(places)
        return out


def rectified(true: Array) -> Array:
    """Effect of asymmetries on readings of true values (..., 3): their absolute values, shape (..., 3, 3)."""
    return np.abs(true)[..., None] * np.eye(3)


def constant(true: Array) -> Array:
    """Effect of biases on readings of true values (..., 3), shape (..., 3, 3)."""
    return np.broadcast_to(np.eye(3), (*true.shape, 3))


@dataclass(frozen=True, slots=True)
class ParameterGroup:
    """Group of like parameters in the state.

    Attributes
    ----------
    name : str
        Common stem of the parameter names; it begins with the sensor, "gyro" or "accel".
    suffixes : tuple of str
        Suffix of each parameter; its full name is ``name_suffix``.
    symbols : tuple of str
        The papers' symbols.
    unit : str
        SI unit.
    display_unit, display_factor : str, float
        Unit in printed tables, and the number of such units in one SI unit.
    effect : callable
        Derivative of the readings with respect to the parameters: of true values in MARS axes (..., 3), shape
        (..., 3, n). Of another function than those of this module, it may be anything small beside 1.
    full : float
        Value, SI, that changes readings of 1 g or 1 rad/s by their whole size.
    prior_sigma, widest_sigma : float
        Standard deviation without any data, SI, on a fixture; and without one, which also decides what is observed.
    per_kelvin : float
        Usual change with temperature, SI, where no test shows it.
    omissible : bool
        True if a test may leave it out: such parameters are the first to be fixed.
    shown_by : str
        Motion that makes the parameters observable.
    heading : str
        Heading of a column, in two lines.
    formula : str
        Effect on a reading in words of the file, as "accel_quadratic * v^2", where it is none of the others'.
    """

    name: str
    suffixes: tuple[str, ...]
    symbols: tuple[str, ...]
    unit: str
    display_unit: str
    display_factor: float
    effect: Callable[[Array], Array]
    full: float
    prior_sigma: float
    widest_sigma: float
    shown_by: str
    heading: str
    per_kelvin: float
    omissible: bool = False
    formula: str = ""

    @property
    def sensor(self) -> str:
        """Sensor with these errors, "gyro" or "accel"."""
        return self.name.partition("_")[0]

    @property
    def further(self) -> bool:
        """True for an effect that matrix, asymmetry and bias of a triad do not have."""
        return not isinstance(self.effect, MatrixElements) and self.effect not in (rectified, constant)


_AXES = ("x", "y", "z")
_PAIRS = ("xy", "yz", "zx")
_ORDERED_PAIRS = ("xy", "xz", "yx", "yz", "zx", "zy")
_G = 9.80665  # m/s²
_DEG_H = 206264.80624709636  # rad/s to °/h


def _place(pair: str) -> tuple[int, int]:
    return _AXES.index(pair[0]), _AXES.index(pair[1])


_DIAGONAL = MatrixElements(tuple((_place(axis * 2),) for axis in _AXES))
_SYMMETRIC = MatrixElements(tuple((_place(pair), _place(pair[::-1])) for pair in _PAIRS))
_SINGLE = MatrixElements(tuple((_place(pair),) for pair in _ORDERED_PAIRS))

# Name, suffixes, symbols, unit, displayed unit and its number in an SI unit, effect, value of full size, prior sigma on
# a fixture and without one, motion that shows it, heading, usual change per kelvin
GROUPS: Final = (
    ParameterGroup(
        "gyro_scale", _AXES, ("κxx", "κyy", "κzz"), "1", "ppm", 1e6, _DIAGONAL, 1.0, 0.3, 0.3,
        "a rotation about the axis while it is horizontal, or a run at a stated rate about it", "gyro\nscale", 1e-4,
    ),
    ParameterGroup(
        "gyro_asymmetry", _AXES, ("κxxx", "κyyy", "κzzz"), "1", "ppm", 1e6, rectified, 1.0, 1e-3, 0.01,
        "rotations about the axis in both senses while it is horizontal", "gyro\nasym.", 2e-6, omissible=True,
    ),
    ParameterGroup(
        "gyro_orthogonality", _PAIRS, ("υxy", "υyz", "υzx"), "rad", "µrad", 1e6, _SYMMETRIC, 1.0, 0.3, 0.3,
        "half turns about both axes in alternation", "gyro\northo.", 5e-6,
    ),
    ParameterGroup(
        "accel_bias", _AXES, ("λx", "λy", "λz"), "m/s^2", "µg", 1e6 / _G, constant, _G, 3.0, 3.0,
        "poses with the axis up, down and horizontal", "accel\nbias", 2e-3,
    ),
    ParameterGroup(
        "accel_scale", _AXES, ("λxx", "λyy", "λzz"), "1", "ppm", 1e6, _DIAGONAL, 1.0, 0.3, 0.3,
        "poses with the axis up and down", "accel\nscale", 1e-4,
    ),
    ParameterGroup(
        "accel_asymmetry", _AXES, ("λxxx", "λyyy", "λzzz"), "1", "ppm", 1e6, rectified, 1.0, 3e-3, 0.01,
        "poses with the axis up, down, horizontal and inclined", "accel\nasym.", 2e-6, omissible=True,
    ),
    ParameterGroup(
        "accel_misalignment", _ORDERED_PAIRS, ("μxy", "μxz", "μyx", "μyz", "μzx", "μzy"), "rad", "µrad", 1e6, _SINGLE,
        1.0, 0.3, 0.3, "half turns about axes near both, and poses between them", "mis-\nalign.", 5e-6,
    ),
    ParameterGroup(
        "gyro_bias", _AXES, ("κx", "κy", "κz"), "rad/s", "°/h", _DEG_H, constant, 1.0, 0.3, 0.3, "longer rests",
        "gyro\nbias", 1.5e-4,
    ),
)  # fmt: skip
"""Groups in the order of the state, which the file format fixes; the gyro biases are the last."""

NAMES: Final = tuple(f"{g.name}_{s}" for g in GROUPS for s in g.suffixes)
SYMBOLS: Final = tuple(s for g in GROUPS for s in g.symbols)
UNITS: Final = tuple(g.unit for g in GROUPS for _ in g.suffixes)
DISPLAY_UNITS: Final = tuple(g.display_unit for g in GROUPS for _ in g.suffixes)
DISPLAY_FACTORS: Final = tuple(g.display_factor for g in GROUPS for _ in g.suffixes)
N_PARAMETERS: Final = len(NAMES)
INDEX: Final = {name: i for i, name in enumerate(NAMES)}
"""Position of each parameter in the state, by name."""


def _group_slices() -> dict[str, slice]:
    slices, start = {}, 0
    for group in GROUPS:
        slices[group.name] = slice(start, start + len(group.suffixes))
        start += len(group.suffixes)
    return slices


GROUP_SLICES: Final = _group_slices()
"""Position of each group in the state: ``x[GROUP_SLICES["gyro_scale"]]``."""
OF_SENSOR: Final = {sensor: tuple(g for g in GROUPS if g.sensor == sensor) for sensor in ("gyro", "accel")}
"""Groups of each triad."""
FURTHER: Final = np.array([g.further for g in GROUPS for _ in g.suffixes])
"""Parameters with effects that matrix, asymmetry and bias do not have, shape (27,)."""
OMISSIBLE: Final = np.array([g.omissible for g in GROUPS for _ in g.suffixes])
"""Parameters that a test may leave out, shape (27,)."""


def by_parameter(attribute: str) -> Array:
    """Number of each parameter that its group states, as "full", shape (27,), SI."""
    return np.concatenate([np.full(len(g.suffixes), getattr(g, attribute), dtype=np.float64) for g in GROUPS])


def expand_names(names: Iterable[str]) -> tuple[str, ...]:
    """Parameter names, in state order, of a list of parameter and group names.

    Parameters
    ----------
    names : iterable of str
        Parameter names ("gyro_scale_x") or group names ("gyro_scale").

    Raises
    ------
    InputError
        If a name is neither.
    """
    wanted: set[str] = set()
    for name in names:
        if name in GROUP_SLICES:
            wanted.update(NAMES[GROUP_SLICES[name]])
        elif name in INDEX:
            wanted.add(name)
        else:
            known = ", ".join(GROUP_SLICES)
            raise InputError(
                f"There is no sensor error named {name!r}: use one of the groups {known}, "
                "or a single parameter such as gyro_scale_x."
            )
    return tuple(n for n in NAMES if n in wanted)


def collapse_names(names: Iterable[str]) -> tuple[str, ...]:
    """List of group and parameter names that :func:`expand_names` expands to these names, whole groups first."""
    wanted = set(names)
    groups = [group for group, where in GROUP_SLICES.items() if wanted.issuperset(NAMES[where])]
    return (*groups, *(name for name in NAMES if name in wanted.difference(expand_names(groups))))


@dataclass(frozen=True, slots=True, eq=False)
class SensorErrors:
    """Values of the 27 sensor errors of one IMU, immutable.

    Attributes
    ----------
    vector : ndarray, shape (27,)
        Values in the order of :data:`NAMES`, SI units; read-only.

    Raises
    ------
    InputError
        If the vector has another shape or holds a value that is not finite.
    """

    vector: Array = field(default_factory=lambda: np.zeros(N_PARAMETERS))

    def __post_init__(self) -> None:
        vector = np.array(real_array("The vector of sensor errors", self.vector), dtype=np.float64)
        if vector.shape != (N_PARAMETERS,):
            raise InputError(f"Sensor errors are a vector of {N_PARAMETERS} numbers, not of shape {vector.shape}.")
        if not np.all(np.isfinite(vector)):
            bad = ", ".join(n for n, v in zip(NAMES, vector, strict=True) if not np.isfinite(v))
            raise InputError(f"Sensor errors must be finite numbers; these are not: {bad}.")
        vector.flags.writeable = False
        object.__setattr__(self, "vector", vector)

    @classmethod
    def from_dict(cls, values: Mapping[str, float]) -> SensorErrors:
        """Build sensor errors from values by name; others are zero. Raises InputError for an unknown name."""
        unknown = sorted(set(values) - set(NAMES))
        if unknown:
            raise InputError(f"Unknown sensor error {unknown[0]!r}; the names are {', '.join(NAMES)}.")
        return cls(real_array("The vector of sensor errors", [values.get(name, 0.0) for name in NAMES]))

    def as_dict(self) -> dict[str, float]:
        """Values by name, in state order."""
        return dict(zip(NAMES, self.vector.tolist(), strict=True))

    def group(self, name: str) -> Array:
        """Values of one group, in the order of its suffixes (read-only)."""
        return self.vector[GROUP_SLICES[name]]

    def __getitem__(self, name: str) -> float:
        return float(self.vector[INDEX[name]])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SensorErrors) and np.array_equal(self.vector, other.vector)

    def __hash__(self) -> int:
        return hash(self.vector.tobytes())

    def plus(self, delta: ArrayLike) -> SensorErrors:
        """Sum with a correction of shape (27,)."""
        return SensorErrors(self.vector + np.asarray(delta, dtype=np.float64))
