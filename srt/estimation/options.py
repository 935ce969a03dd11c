"""Options of the estimators; docs/design/defaults.md has the measurements behind the defaults."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from srt.arguments import require_type
from srt.exceptions import InputError, did_you_mean
from srt.model.prior import Prior
from srt.recording.schema import shown
from srt.sensor_errors import SensorErrors, expand_names
from srt.sequences.window_means import Average

if TYPE_CHECKING:
    from collections.abc import Callable

Down = Literal["tilt-immune", "paper"]
WindowAttitude = Literal["held", "integrated"]
GyroBias = Literal["auto", "pooled", "per-sequence", "g-sensitive"]
Step = Literal["jacobian", "coefficients"]
Start = Literal["auto", "zero"]
Loss = Literal["squared", "huber", "cauchy"]
Filter = Literal["iterated", "per-sequence", "one-pass", "covariance", "unscented"]

MOST_ITERATIONS: Final = 10_000
"""Largest number of iterations that can be asked for: hours of computation, where a calibration takes about ten."""


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the estimators.

    Attributes
    ----------
    average : "linear" or "overlapping"
        Averaging of specific force over a window: mean, or mean of overlapping half-window means (triangular weights),
        with less quantization noise and 15 % more white noise.
    down : "tilt-immune" or "paper"
        ``g − |mean â|``, or ``û_dwn · â + g`` with the nominal vertical (Savage 2020, eq. 1).
    window_attitude : "held" or "integrated"
        Attitude in the stationary windows of the closed form: constant (except in windows that moved), or integrated
        from the gyros. Joint estimation integrates it in windows that moved.
    gyro_bias : "auto", "pooled", "per-sequence" or "g-sensitive"
        One bias for the test, one per sequence, or a weighting of both by the bias instability ("auto");
        "g-sensitive": as "auto", with gyro g-sensitivity estimated too. With "auto", it is
        estimated where the residuals contradict the noise and the rest rates show it (F-test).
    step : "jacobian" or "coefficients"
        Correction of an iteration: by the full Jacobian, added; or by the coefficients of eq. 13, composed.
    start : "auto", "zero" or SensorErrors
        Initial estimate: from the fixture's nominal angles (without a fixture, from gravity); from zero errors, the
        shortest rotations first, without nominal angles; or given errors.
    asymmetry : bool
        False fixes gyro scale-factor asymmetry at its initial value (eq. 14).
    hold : tuple of str
        Parameters or groups fixed at their initial value.
    max_playbacks : int
        Largest number of iterations; few suffice where all parameters are observed.
    measured_vertical : bool
        From the second iteration on, take the vertical of each pose from the measured specific force; False: always
        the nominal one.
    filter : "iterated", "per-sequence", "one-pass", "covariance" or "unscented"
        Form of the Kalman filter: square-root form, iterated over the test; each sequence iterated; one pass linearised
        about the running estimate; covariance form, iterated over the test; unscented. Forms that process each sequence
        once have no start "zero".
    loss : "squared", "huber" or "cauchy"
        Loss of the factor graph: squared is efficient, the robust ones reduce the weight of outliers.
    fixture_states : bool
        Estimate levelling, north, mounting and gravity in joint estimation (all but the closed form); False: north and
        gravity as stated, level from the accelerometers.
    prior : Prior, optional
        Prior of the sensor errors, for joint estimation; default: very wide.
    ignore_moves : bool
        Use the sequences alone; False: recorded moves between them are measurements, too (not for the closed form).
    live : bool
        Run the Kalman filter as during the test: after every sequence, on all sequences so far.
    targets : mapping of str to float
        Required 1-sigma of parameters or groups, SI; the Kalman filter reports the sequence that reaches all.
    """

    average: Average = "linear"
    down: Down = "tilt-immune"
    window_attitude: WindowAttitude = "held"
    gyro_bias: GyroBias = "auto"
    step: Step = "jacobian"
    start: Start | SensorErrors = "auto"
    asymmetry: bool = True
    hold: tuple[str, ...] = ()
    max_playbacks: int = 40
    measured_vertical: bool = True
    loss: Loss = "squared"
    filter: Filter = "iterated"
    fixture_states: bool = True
    prior: Prior | None = None
    ignore_moves: bool = False
    live: bool = False
    targets: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        kinds = {"max_playbacks": int, "asymmetry": bool, "measured_vertical": bool, "fixture_states": bool}
        kinds |= {"live": bool, "ignore_moves": bool}
        for name, kind in kinds.items():
            value = getattr(self, name)
            if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
                raise InputError(f"Option {name} is {value!r}; it must be of type {kind.__name__}.")
        if self.prior is not None and not isinstance(self.prior, Prior):
            raise InputError(f"Option prior is {self.prior!r}; it must be a Prior, or None for none.")
        if isinstance(self.hold, str) or not all(isinstance(name, str) for name in _iterable(self.hold)):
            raise InputError(f"Option hold is {self.hold!r}; it must be a sequence of names of parameters or groups.")
        for name, allowed in _CHOICES.items():
            value = getattr(self, name)
            if name == "start" and isinstance(value, SensorErrors):
                continue
            if not isinstance(value, str) or value not in allowed:
                raise InputError(f"Option {name} is {value!r}; it must be one of {', '.join(map(repr, allowed))}.")
        object.__setattr__(self, "hold", expand_names(self.hold))
        object.__setattr__(self, "targets", _targets(self.targets))
        if not 1 <= self.max_playbacks <= MOST_ITERATIONS:
            raise InputError(
                f"max_playbacks is {shown(self.max_playbacks)}; a number from 1 to {MOST_ITERATIONS} is expected."
            )

    @property
    def fixed_names(self) -> tuple[str, ...]:
        """Names of the parameters fixed on request."""
        extra = () if self.asymmetry else ("gyro_asymmetry",)
        return expand_names((*self.hold, *extra))

    def refuse(self, names: Iterable[str], who: str) -> None:
        """Raise InputError for options that an estimator does not have.

        Parameters
        ----------
        names : iterable of str
            Options that must have their default value.
        who : str
            Name of the estimator, for the message.

        Raises
        ------
        InputError
            For the first option with another value.
        """
        for f in fields(self):
            default = f.default_factory() if callable(f.default_factory) else f.default
            value = getattr(self, f.name)
            if f.name in names and value != default:
                shown = f"{f.name}={value!r}" if isinstance(value, (str, bool)) else f.name
                raise InputError(f"{who} has no option {shown}: leave it out, or choose another estimator.")

    def as_dict(self) -> dict[str, Any]:
        """Values that a calibration's provenance stores."""
        convert: dict[str, Callable[[Any], Any]] = {
            "start": lambda v: v.as_dict() if isinstance(v, SensorErrors) else v,
            "hold": list,
            "targets": dict,
            "prior": lambda v: None if v is None else v.as_dict(),
        }
        return {f.name: convert.get(f.name, lambda v: v)(getattr(self, f.name)) for f in fields(self)}


def _targets(targets: object) -> dict[str, float]:
    """Required 1-sigma of every parameter that a target names, by its own name or its group's."""
    if not isinstance(targets, Mapping):
        raise InputError(f"Option targets is {targets!r}; it must map names of parameters or groups to sigmas.")
    out: dict[str, float] = {}
    for name, sigma in targets.items():
        if isinstance(sigma, bool) or not isinstance(sigma, (int, float)) or not 0.0 < sigma <= sys.float_info.max:
            raise InputError(f"The target of {name} is {shown(sigma)}; it must be a positive sigma in SI units.")
        for parameter in expand_names([name]):
            out[parameter] = min(float(sigma), out.get(parameter, float("inf")))
    return out


def _iterable(value: object) -> Iterable[object]:
    """Elements of an iterable; for any other value one element that is not a name."""
    return value if isinstance(value, Iterable) else (None,)


_CHOICES = {
    "average": get_args(Average),
    "down": get_args(Down),
    "window_attitude": get_args(WindowAttitude),
    "gyro_bias": get_args(GyroBias),
    "step": get_args(Step),
    "start": get_args(Start),
    "loss": get_args(Loss),
    "filter": get_args(Filter),
}


def chosen_options(options: Options | None, choices: Mapping[str, Any]) -> Options:
    """Options given as an object or as keywords.

    Raises
    ------
    InputError
        Both, or an unknown choice.
    """
    if options is not None:
        if choices:
            raise InputError("Give either options or single choices, not both.")
        require_type("options=", "srt.Options", options, Options)
        return options
    known = [f.name for f in fields(Options)]
    for name in sorted(set(choices) - set(known)):
        raise InputError(f"Unknown option {name!r}{did_you_mean(name, known)}; the options are {', '.join(known)}.")
    return Options(**choices)
