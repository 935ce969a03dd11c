"""Calibration result: sensor errors with their covariance, compensation of readings, and the JSON file format.

The JSON form is versioned and complete: reading a file restores the written calibration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from srt.arguments import former_name, real_array, require_type
from srt.exceptions import InputError
from srt.presentation import Presented
from srt.result.applier import BLOCK, Applier
from srt.result.consistency import Consistency
from srt.result.diagnostics import Diagnostics
from srt.result.document import from_document, to_document
from srt.result.json_file import load_json_file, require_format, require_json, save_json_file
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Alignment, Provenance, StatedSite, Temperature
from srt.result.thermal_application import apply_over_temperature, state_at
from srt.result.thermal_errors import ThermalErrors
from srt.result.verdict import WITHOUT_VALUES, Verdict, verdict_on
from srt.sensor_errors import GROUPS, INDEX, N_PARAMETERS, NAMES, SYMBOLS, UNITS, SensorErrors
from srt.types import Array

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike

    from numpy.typing import ArrayLike

    from srt.types import Mask


FORMAT: Final = "srt-calibration"
VERSION: Final = 1
THERMAL_VERSION: Final = 2
"""Version of files with errors over temperature, which programs that know version 1 alone must refuse."""
STATUSES: Final = ("converged", "partial", "inconsistent", "not_converged", "outside_model")

FORMULA: Final = (
    "Readings are y = M v + s*|v| + b, with v the true value in MARS axes and * element by element. "
    "Gyros: M = I + [[gyro_scale_x, gyro_orthogonality_xy/2, gyro_orthogonality_zx/2], [gyro_orthogonality_xy/2, "
    "gyro_scale_y, gyro_orthogonality_yz/2], [gyro_orthogonality_zx/2, gyro_orthogonality_yz/2, gyro_scale_z]], "
    "s = gyro_asymmetry, b = gyro_bias (rad/s). Accelerometers: M = I + [[accel_scale_x, accel_misalignment_xy, "
    "accel_misalignment_xz], [accel_misalignment_yx, accel_scale_y, accel_misalignment_yz], [accel_misalignment_zx, "
    "accel_misalignment_zy, accel_scale_z]], s = accel_asymmetry, b = accel_bias (m/s^2). "
    "To correct a reading, solve for v: v = inverse(M + diag(s * sign(v))) (y - b), with the signs that the solution "
    "has itself. MARS is the frame in which the gyro matrix is symmetric; transpose(U) takes its components to the "
    "table-mounted frame. Not held: accelerometers were seen to 1 g only, where an asymmetry and a quadratic term are "
    "one and the same; gyros at the rates turned; temperature other than that of the test."
)
FORMULA_G_SENSITIVE: Final = (
    " The gyros follow specific force: before that, subtract diagnostics.g_sensitivity.matrix (rad/s per m/s^2, rows "
    "gyros, columns MARS axes) times the corrected specific force from the gyro readings."
)


NO_VALUES: Final = "the iteration ended without a solution"
"""Reason why a result that did not converge has no values."""
_CORRELATION_WITHIN: Final = 1e-6
"""Rounding of a correlation, whose size is at most 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Parameter:
    """Numbers of one parameter in a file."""

    value: float | None
    sigma: float | None
    observed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class _Frame:
    """Frame of the corrected readings in a file."""

    name: str
    U: Array | None
    U_sigma: float | None


@dataclass(frozen=True, slots=True)
class Residual:
    """Residual of one measurement after the last iteration: component, value, 1-sigma (m/s² or rad/s)."""

    sequence: str
    occurrence: int
    component: str
    value: float
    sigma: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Calibration(Presented):
    """A calibrated unit.

    Attributes
    ----------
    estimator : str
    status : str
        "converged", "partial" (some parameters fixed), "inconsistent" (the measurements contradict each other),
        "not_converged" or "outside_model". Only the first two are usable.
    message : str
        The status in a sentence.
    errors : SensorErrors
        Those of the last iteration if a result did not converge; files and reports do not contain them.
    covariance : ndarray, shape (27, 27)
        Zero in the rows and columns of fixed parameters.
    corrections : tuple of float
        Largest correction of each iteration.
    fixed : dict of str to str
        Fixed parameters with the reason; zero, or with the value of the fixture's nominal angles, a start or a prior.
    contributions : dict of str to ndarray, shape (27,)
        One sigma by source of error.
    U : ndarray, shape (3, 3), or None
        Table-mounted to MARS components; None without a fixture.
    U_sigma_rad : float or None
    residuals : tuple of Residual
    site : StatedSite
    noise : NoiseFigures
    alignment : Alignment
    temperature : Temperature or None
    provenance : Provenance
    diagnostics : Diagnostics
        Further output of the estimator, such as the innovations of every sequence.
    consistency : Consistency or None
        Consistency of the measurements; None if unknown. :attr:`judgement` states it in words.
    warnings : tuple of str
    thermal : ThermalErrors or None
        Errors over temperature; ``errors`` and ``covariance`` are then those at the middle of the range.
    """

    estimator: str
    status: str
    message: str
    errors: SensorErrors
    covariance: Array
    corrections: tuple[float, ...] = ()
    fixed: Mapping[str, str] = field(default_factory=dict)
    contributions: Mapping[str, Array] = field(default_factory=dict)
    U: Array | None = None
    U_sigma_rad: float | None = None
    residuals: tuple[Residual, ...] = ()
    site: StatedSite = field(default_factory=StatedSite)
    noise: NoiseFigures = field(default_factory=NoiseFigures)
    alignment: Alignment = field(default_factory=Alignment)
    temperature: Temperature | None = None
    provenance: Provenance = field(default_factory=Provenance)
    diagnostics: Diagnostics = field(default_factory=Diagnostics)
    consistency: Consistency | None = None
    warnings: tuple[str, ...] = ()
    thermal: ThermalErrors | None = None

    def __post_init__(self) -> None:
        """Refuse what the file of the result could not hold, when it is made and not when it is saved.

        Raises
        ------
        InputError
        """
        require_type("The field errors of a calibration", "srt.SensorErrors", self.errors, SensorErrors)
        if self.status not in STATUSES:
            raise InputError(f"The status of a calibration is {self.status!r}, not one of {', '.join(STATUSES)}.")
        unknown = [name for name in self.fixed if name not in INDEX]
        if unknown:
            raise InputError(f"The calibration holds {unknown[0]!r} fixed, which is none of the {N_PARAMETERS} errors.")
        shapes = {"covariance": (N_PARAMETERS, N_PARAMETERS), "U": (3, 3)}
        for name, shape in shapes.items():
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _frozen(f"{name} of a calibration", getattr(self, name), shape))
        size = (N_PARAMETERS,)
        contributions = {k: _frozen(f"The contribution {k}", v, size) for k, v in self.contributions.items()}
        object.__setattr__(self, "contributions", contributions)
        _check_covariance(self.covariance)
        if self.U_sigma_rad is not None and self.U_sigma_rad < 0.0:
            raise InputError(f"U_sigma_rad of a calibration is {self.U_sigma_rad}, but a sigma is not negative.")
        tables = ("site", "noise", "alignment", "temperature", "provenance", "diagnostics", "consistency")
        require_json({name: to_document(getattr(self, name)) for name in (*tables, "corrections")})
        if not np.isfinite(np.array([(r.value, r.sigma) for r in self.residuals])).all():
            raise InputError("residuals of a calibration has values that are not finite numbers: estimate it again.")

    @property
    def sigma(self) -> Array:
        """1-sigma of every parameter, shape (27,); NaN for fixed parameters."""
        out: Array = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        out[[INDEX[name] for name in self.fixed]] = np.nan
        return out

    @property
    def has_values(self) -> bool:
        """False if the iteration ended without a solution: status "not_converged" or "outside_model"."""
        return self.status not in WITHOUT_VALUES

    @property
    def values(self) -> Array:
        """Values of the parameters as reports show them, SI, shape (27,); NaN without a solution."""
        return self.errors.vector if self.has_values else np.full(N_PARAMETERS, np.nan)

    @property
    def as_written(self) -> Calibration:
        """The calibration as files and reports contain it: without a solution, no value and no sigma."""
        if self.has_values:
            return self
        return replace(
            self,
            errors=SensorErrors(),
            covariance=np.zeros((N_PARAMETERS, N_PARAMETERS)),
            fixed=dict.fromkeys(NAMES, NO_VALUES),
            contributions={},
            U=None,
            U_sigma_rad=None,
            noise=replace(
                self.noise, gyro_bias_by_sequence_rad_s=None, gravity_effect=None, held_values_covariance=None
            ),
            diagnostics=replace(self.diagnostics, g_sensitivity=None, asymmetry=None, not_shown=None),
        )

    def require_values(self) -> None:
        """Raise InputError if the calibration did not converge, so that there is nothing to apply."""
        if not self.has_values:
            raise InputError(f"The calibration has the status {self.status} and no values: calibrate the unit again.")
        self.require_one_temperature()

    def require_one_temperature(self) -> None:
        """Raise InputError if the errors depend on temperature, for uses that are made of one."""
        if self.thermal is not None:
            raise InputError(
                "The errors of this calibration depend on temperature, and nothing says which one is meant: take those "
                "of one temperature, at(T) or 'srt thermal UNIT.json --at T -o UNIT-T.json'."
            )

    def at(self, temperature_c: float, *, clip: bool = False) -> Calibration:
        """Calibration at a temperature of a unit that was calibrated over temperature.

        Parameters
        ----------
        temperature_c : float, °C
        clip : bool
            Outside the range of the tests, hold the values of its end, with the slope there in the sigmas.

        Raises
        ------
        InputError
            A calibration of one temperature, or a temperature outside the range that is not clipped.
        """
        return replace(self, **state_at(self.thermal, temperature_c, clip=clip))

    @property
    def held(self) -> Mapping[str, str]:
        """Former name of ``fixed``."""
        return former_name("Calibration.held", "fixed", self.fixed)

    @property
    def verdict(self) -> Consistency | None:
        """Former name of ``consistency``."""
        return former_name("Calibration.verdict", "consistency", self.consistency)

    @property
    def judgement(self) -> Verdict:
        """Verdict in words: sound, partial, doubtful or failed, with the reason."""
        return verdict_on(self)

    @property
    def g_sensitivity(self) -> Array | None:
        """Gyro g-sensitivity Γ, ω̃ = Mg ω + Γ f + b, MARS axes, shape (3, 3), rad/s per m/s²; None if not estimated."""
        stated = self.diagnostics.g_sensitivity
        return None if stated is None else stated.matrix

    @property
    def g_sensitivity_covariance(self) -> Array | None:
        """Covariance of Γ by rows, shape (9, 9); None if not estimated, or for files of earlier versions."""
        stated = self.diagnostics.g_sensitivity
        return None if stated is None else stated.covariance

    @property
    def observed(self) -> Mask:
        """Mask of the parameters that the recording determined, shape (27,)."""
        return np.array([name not in self.fixed for name in NAMES])

    def apply(
        self,
        gyro: ArrayLike,
        accel: ArrayLike,
        *,
        kind: Literal["rate", "increment"] = "rate",
        dt: float | ArrayLike | None = None,
        frame: Literal["mars", "table"] = "mars",
        out: tuple[Array, Array] | None = None,
        temperature_c: ArrayLike | None = None,
        clip: bool = False,
    ) -> tuple[Array, Array]:
        """Correct readings by the exact inverse of the sensor model, sample by sample.

        Parameters
        ----------
        gyro, accel : array_like, shape (n, 3) or (3,)
            Readings: rad/s and m/s², or for increments rad and m/s.
        kind : "rate" or "increment"
        dt : float or array_like, shape (n,), s
            Duration of increments; needed for kind "increment" and for nothing else.
        frame : "mars" or "table"
            Axes of the result.
        out : (ndarray, ndarray), optional
            Arrays to write the result to: float64, of the shapes of the readings; the readings themselves are allowed.
        temperature_c : float or array_like, shape (n,), °C
            Temperature of the samples; needed for a calibration over temperature and for nothing else.
        clip : bool
            Hold the errors at the end of the range for temperatures outside it.

        Returns
        -------
        gyro, accel : ndarray
            Corrected readings, of the shapes and units of the input.

        Raises
        ------
        InputError
            A calibration that did not converge, shapes that do not fit, values that are not finite, ``dt`` missing or
            given with rates, no table frame, or errors so large that a reading has no single true value.

        Notes
        -----
        In a loop, create one :class:`srt.result.applier.Applier` and use it: it is this method without the preparation,
        and corrects single samples in microseconds.

        Asymmetry s rectifies the noise of a channel near zero: a bias of about 0.8 s times the 1-sigma noise of a
        sample remains in the mean.
        """
        if kind not in ("rate", "increment"):
            raise InputError(f"kind is {kind!r}; it must be 'rate' or 'increment'.")
        if (kind == "increment") != (dt is not None):
            raise InputError("Give dt, the duration of the samples in seconds, with increments and only with them.")
        if temperature_c is not None or self.thermal is not None:
            return apply_over_temperature(self, (gyro, accel), temperature_c, clip=clip, out=out, dt=dt, frame=frame)
        # Work arrays no larger than the readings, so that a call with one sample allocates little.
        block = min(max(gyro.size // 3, 1), BLOCK) if isinstance(gyro, np.ndarray) else BLOCK
        return Applier(self, frame=frame, block=block).apply(gyro, accel, dt=dt, out=out)

    def to_dict(self) -> dict[str, Any]:
        """JSON form as a dictionary, without NaN."""
        return self.as_written._document()

    def _document(self) -> dict[str, Any]:
        sigma, observed = self.sigma, self.observed
        parameters = []
        for i, name in enumerate(NAMES):
            row: dict[str, Any] = {
                "name": name,
                "symbol": SYMBOLS[i],
                "value": float(self.errors.vector[i]) if self.has_values else None,
                "sigma": float(sigma[i]) if observed[i] else None,
                "unit": UNITS[i],
                "observed": bool(observed[i]),
            }
            if not observed[i]:
                row["held_reason"] = self.fixed[name]
            parameters.append(row)
        return {
            "format": FORMAT,
            "version": VERSION if self.thermal is None else THERMAL_VERSION,
            "estimator": self.estimator,
            "status": self.status,
            "message": self.message,
            "warnings": list(self.warnings),
            "iterations": [{"max_correction": c} for c in self.corrections],
            "parameters": parameters,
            "covariance": self.covariance.tolist() if self.has_values else None,
            "frame": {
                "name": "MARS",
                "U": None if self.U is None else self.U.tolist(),
                "U_sigma": self.U_sigma_rad,
            },
            "formula": FORMULA
            + "".join(f" Readings have {g.formula} besides." for g in GROUPS if g.further)
            + ("" if self.diagnostics.g_sensitivity is None else FORMULA_G_SENSITIVE),
            "site": to_document(self.site),
            "noise": {**to_document(self.noise), "contributions": to_document(self.contributions)},
            "alignment": to_document(self.alignment),
            "temperature": to_document(self.temperature),
            **({} if self.thermal is None else {"thermal": to_document(self.thermal)}),
            "residuals": to_document(self.residuals),
            "provenance": to_document(self.provenance),
            "diagnostics": to_document(self.diagnostics),
            "verdict": {} if self.consistency is None else to_document(self.judgement) | to_document(self.consistency),
        }

    def save(self, path: str | PathLike[str]) -> None:
        """Write the JSON form with its digest, whole or not at all. Raises InputError if the path cannot be written."""
        save_json_file(path, self.to_dict())


def load_calibration(path: str | PathLike[str], *, trust: bool = False, signed: bool = False) -> Calibration:
    """Read a calibration.

    Parameters
    ----------
    path : path-like
    trust : bool
        Accept a file that was changed after it was written.
    signed : bool
        Refuse a file without a digest, as of an early version.

    Raises
    ------
    InputError
        If the file cannot be read, is no calibration, is of another version, is not consistent, or differs from its
        digest.
    """
    return load_json_file(path, "calibration", _from_dict, trust=trust, signed=signed)


def _from_dict(document: dict[str, Any]) -> Calibration:
    thermal = document.get("thermal") if isinstance(document, dict) else None
    require_format(document, "calibration file", FORMAT, VERSION if thermal is None else THERMAL_VERSION)
    parameters = document["parameters"]
    names = tuple(p["name"] for p in parameters)
    if names != NAMES:
        raise InputError(f"its parameters are not the {N_PARAMETERS} sensor errors in their order.")
    status, covariance = from_document(str, document["status"], "status"), np.zeros((N_PARAMETERS, N_PARAMETERS))
    if document["covariance"] is not None or status not in WITHOUT_VALUES:
        covariance = from_document(Array, document["covariance"], "covariance")
    for i, p in enumerate(parameters):
        from_document(_Parameter, {key: p.get(key) for key in ("value", "sigma", "observed")}, f"parameters.{i}")
        if p["value"] is None and (status not in WITHOUT_VALUES or p["observed"]):
            raise InputError(f"{p['name']} has no value, though the status is {status}.")
        if p["observed"] and not math.isclose(p["sigma"], math.sqrt(covariance[i, i]), rel_tol=1e-6, abs_tol=1e-300):
            raise InputError(f"the sigma of {p['name']} does not agree with the covariance.")
    noise, verdict = (dict(document.get(key, {})) for key in ("noise", "verdict"))
    for key in ("word", "reason"):  # they follow from the rest
        verdict.pop(key, None)
    parts = noise.pop("contributions", {})
    contributions = {key: from_document(Array, part, f"noise.contributions.{key}") for key, part in parts.items()}
    frame, temperature = from_document(_Frame, document["frame"], "frame"), document["temperature"]
    return Calibration(
        estimator=from_document(str, document["estimator"], "estimator"),
        status=status,
        message=from_document(str, document["message"], "message"),
        errors=SensorErrors(np.array([p["value"] or 0.0 for p in parameters], dtype=np.float64)),
        covariance=covariance,
        corrections=tuple(from_document(float, s["max_correction"], "iterations") for s in document["iterations"]),
        fixed={p["name"]: from_document(str, p["held_reason"], p["name"]) for p in parameters if not p["observed"]},
        contributions=contributions,
        U=frame.U,
        U_sigma_rad=frame.U_sigma,
        residuals=tuple(from_document(Residual, r, f"residuals.{i}") for i, r in enumerate(document["residuals"])),
        site=from_document(StatedSite, document["site"], "site"),
        noise=from_document(NoiseFigures, noise, "noise"),
        alignment=from_document(Alignment, document["alignment"], "alignment"),
        temperature=None if temperature is None else from_document(Temperature, temperature, "temperature"),
        provenance=from_document(Provenance, document["provenance"], "provenance"),
        diagnostics=from_document(Diagnostics, document.get("diagnostics", {}), "diagnostics"),
        consistency=from_document(Consistency, verdict, "verdict") if verdict else None,
        warnings=from_document(tuple[str, ...], document.get("warnings", []), "warnings"),
        thermal=None if thermal is None else from_document(ThermalErrors, thermal, "thermal"),
    )


def _frozen(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Read-only array of finite numbers of a shape, copied unless it is one. Raises InputError."""
    out = np.asarray(real_array(name, values), dtype=np.float64)
    if out.shape != shape:
        raise InputError(f"{name} has the shape {out.shape}, but {shape} is expected.")
    if not np.isfinite(out).all():
        raise InputError(f"{name} has values that are not finite numbers: estimate it again.")
    if out.flags.writeable:
        out = out.copy()
        out.flags.writeable = False
    return out


def _check_covariance(covariance: Array) -> None:
    """Raise InputError for a matrix that is no covariance: not symmetric, or with impossible variances."""
    if not np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0):
        raise InputError("The covariance of a calibration is not symmetric.")
    variance = np.diag(covariance)
    if np.any(variance < 0.0):
        raise InputError(f"The covariance of a calibration has a negative variance: {NAMES[int(variance.argmin())]}.")
    sigma = np.sqrt(variance)
    if np.any(np.abs(covariance) > np.outer(sigma, sigma) * (1.0 + _CORRELATION_WITHIN)):
        raise InputError("The covariance of a calibration has a correlation above 1.")


@cache
def software() -> str:
    """Name and version of this software, for the provenance of a result."""
    try:
        return f"strapdown-rotation-test {version('strapdown-rotation-test')}"
    except ModuleNotFoundError:  # importlib.metadata.PackageNotFoundError: a source tree that is not installed
        return "strapdown-rotation-test (not installed)"
