"""Content of an inspection of a recording: time stamps, stationary windows, noise, manoeuvres and faults."""

from __future__ import annotations

import math
import tomllib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from srt.constants import DEG, DEG_PER_H, STANDARD_GRAVITY_M_S2
from srt.diagnosis.faults import FAULTS
from srt.diagnosis.staged_diagnosis import StagedDiagnosis
from srt.exceptions import DataError, MissingExtraError
from srt.model.rotations import from_rotation_vector, prefix_product, rotation_vector, to_matrix
from srt.model.table1 import AXES
from srt.noise.allan import CHANNELS, TERMS, AllanDeviation, allan_deviation
from srt.noise.noise_model import hidden_gyro_step, noise_model
from srt.presentation import Presented
from srt.ranking import rounded
from srt.recording.folder import TOML_NAME
from srt.recording.reading import read
from srt.recording.recording import ImuNoise, Recording
from srt.recording.schema import IMU_KEYS, in_file_unit
from srt.result.document import to_document
from srt.sequences.plausibility import check_interval
from srt.sequences.recognition import recognise
from srt.sequences.rest_detection import longest_rest
from srt.sequences.stationary_windows import MIN_TURN_RAD

if TYPE_CHECKING:
    from os import PathLike

    from srt.diagnosis import Diagnosis
    from srt.diagnosis.fitness import Fitness
    from srt.noise.allan import AllanDeviation
    from srt.sequences.recognition import RecognisedManoeuvre, Recognition
    from srt.types import Array, Indices

_ON_AXIS: Final = 0.94
"""Smallest cosine of the angle between a rotation and a sensor axis at which the axis is named: 20°, as uncalibrated
axes deviate by some degrees."""
_ENOUGH: Final = 1 << 19
"""Number of stationary samples that gives the noise to one per cent; if there are more, some windows are omitted."""
_STEPS: Final = 256
"""Number of small rotations into which a manoeuvre is divided for the net rotation: enough for one degree."""


def inspect(source: Any, *, deep: bool = False, **stated: Any) -> Inspection:
    """Inspect a recording: rate, gaps, noise at rest, stationary windows, rotations, recognised sequences, faults.

    Parameters
    ----------
    source : Recording, path-like, or arrays
        Recording, or what :func:`srt.read` makes one of.
    deep : bool
        Also calibrate, and look for faults that only a calibration shows.
    **stated
        Keywords of :func:`srt.read`.

    Returns
    -------
    Inspection

    Raises
    ------
    InputError
        A source that cannot be read.
    """
    recording = read(source, **stated)
    recognition: Recognition | None
    try:
        check_interval(recording)
        recognition = recognise(recording)
        windows, summary = recognition.windows, recognition.summary
        turns = tuple(_turn(recording, turn) for turn in recognition.turns)
    except DataError as error:
        recognition, summary, turns = None, str(error), ()
        rest = longest_rest(recording)
        windows = np.array([] if rest is None else [rest], dtype=np.intp).reshape(-1, 2)
    if recognition is not None and recording.fixture is None:
        if recognition.by_chance:
            # A drift of the biases, or a knock, parts windows without a rotation.
            count = sum(
                any(abs(leg.angle_deg) * DEG >= MIN_TURN_RAD for leg in (turn.net, *turn.legs)) for turn in turns
            )
            summary = f"{count} free rotations between {len(windows)} stationary windows; no fixture is stated."
            turns = tuple(replace(turn, sequence=None, confidence=0.0, reason="") for turn in turns)
        else:
            summary += (
                " No fixture is stated, so that a calibration uses them as free rotations: state the fixture if one "
                "was used."
            )
    noise, allan = _noise(recording, windows)
    staged = StagedDiagnosis(recording, recognition=recognition)
    diagnosis = staged.before_calibration()
    return Inspection(
        fitness=staged.fitness(),
        kind=recording.kind,
        units=declared_units(recording.source) if recording.source else {},
        serial=recording.serial,
        stamps=_stamps(recording),
        stillness=_stillness(recording, windows),
        noise=noise,
        allan=allan,
        turns=turns,
        summary=summary,
        temperature=_temperature(recording),
        diagnosis=staged.with_calibration() if deep else diagnosis,
        calibrated=deep,
        hidden_gyro_step_rad_s=hidden_gyro_step(recording, windows) if len(windows) else 0.0,
    )


def declared_units(path: str | PathLike[str]) -> dict[str, str]:
    """Units that the ``recording.toml`` of a readable recording declares; empty if there is none."""
    toml = Path(path)
    toml = toml / TOML_NAME if toml.is_dir() else toml
    if toml.suffix != ".toml" or not toml.is_file():
        return {}
    with toml.open("rb") as file:
        main = tomllib.load(file).get("recording", {})
    return {name: str(main[f"{name}_unit"]) for name in ("gyro", "accel", "time") if f"{name}_unit" in main}


def _stamps(recording: Recording) -> TimeStampSummary:
    dt, time, gaps = recording.nominal_interval_s, recording.time, recording.gaps
    steps = np.diff(time) - dt
    missing = steps[gaps - 1]
    longest = int(np.argmax(rounded(missing))) if gaps.size else None
    steps[gaps - 1] = 0.0
    return TimeStampSummary(
        samples=len(time),
        first_s=float(time[0]) - dt,
        duration_s=float(time[-1] - time[0]) + dt,
        rate_hz=1.0 / dt,
        even=isinstance(recording.interval_s, float),
        jitter=float(np.sqrt(steps @ steps / len(steps))) / dt,
        gaps=len(gaps),
        missing_s=float(missing.sum()),
        longest_gap_s=None if longest is None else float(missing[longest]),
        longest_gap_at_s=None if longest is None else float(time[gaps[longest]]),
    )


def _stillness(recording: Recording, windows: Indices) -> StationarySummary | None:
    if len(windows) == 0:
        return None
    dt = recording.nominal_interval_s
    tables = (recording.gyro, recording.accel)
    means = np.array([[table[a:b].mean(axis=0) for table in tables] for a, b in windows.tolist()])
    means *= recording.rates_factor
    force = np.linalg.norm(means[:, 1], axis=1) / STANDARD_GRAVITY_M_S2
    lengths = (windows[:, 1] - windows[:, 0]) * dt
    rate = lengths @ means[:, 0] / lengths.sum() / DEG_PER_H
    return StationarySummary(
        windows_s=tuple((float(recording.time[a] - dt), float(recording.time[b - 1])) for a, b in windows.tolist()),
        total_s=float(lengths.sum()),
        force_g=(float(force.min()), float(np.median(force)), float(force.max())),
        rate_deg_per_h=(float(rate[0]), float(rate[1]), float(rate[2])),
    )


def _noise(recording: Recording, windows: Indices) -> tuple[NoiseSummary | None, AllanDeviation | None]:
    if len(windows) == 0:
        return None, None
    stated = {
        key.name: in_file_unit(float(value), key.factor)
        for key in IMU_KEYS
        if (value := getattr(recording.noise, str(key.attribute))) is not None
    }
    try:
        allan = allan_deviation(recording, windows)
    except (DataError, MissingExtraError) as error:
        return NoiseSummary(_short_figures(recording, windows), stated, str(error)), None
    return NoiseSummary(allan.figures(), stated, None), allan


def _short_figures(recording: Recording, windows: Indices) -> dict[str, dict[str, Any]]:
    """Noise of windows that are too short for an Allan deviation, by channel and key."""
    every = max(1, int((windows[:, 1] - windows[:, 0]).sum()) // _ENOUGH)
    model = noise_model(replace(recording, noise=ImuNoise()), windows[::every])
    pulses, walk = TERMS[0], TERMS[1]
    out: dict[str, dict[str, Any]] = {}
    for s, sensor in enumerate(("gyro", "accel")):
        white, edge = getattr(model, f"{sensor}_white"), getattr(model, f"{sensor}_edge")
        for axis, name in enumerate(AXES):
            out[f"{sensor}_{name}"] = {walk.keys[s]: {"value": float(white[axis] / walk.scales[s])}}
            if edge[axis] > 0.0:
                pulse = float(edge[axis] * np.sqrt(12.0) / pulses.scales[s])
                out[f"{sensor}_{name}"][pulses.keys[s]] = {"value": pulse}
    return out


def _turn(recording: Recording, turn: RecognisedManoeuvre) -> ManoeuvreSummary:
    dt, per_rate = recording.nominal_interval_s, recording.rates_factor
    moving = recording.gyro[turn.first : turn.last] * per_rate
    start, end = float(recording.time[turn.first] - dt), float(recording.time[turn.last - 1])
    around = (s for s in recording.sequences if s.start_static_s[0] < 0.5 * (start + end) < s.end_static_s[1])
    label = next(around, None)
    return ManoeuvreSummary(
        start_s=start,
        end_s=end,
        legs=tuple(_leg(leg) for leg in turn.legs),
        net=_leg(_net(moving * dt)),
        fastest_deg_s=float(np.sqrt(np.einsum("na,na->n", moving, moving).max(initial=0.0))) / DEG,
        sequence=turn.sequence,
        confidence=float(turn.confidence),
        reason=turn.reason,
        labelled=None if label is None else label.id or "free turn",
    )


def _leg(vector: Array) -> RotationSummary:
    angle = float(np.linalg.norm(vector))
    direction = vector / max(angle, 1e-12)
    k = int(np.argmax(np.abs(direction)))
    on_axis = bool(abs(direction[k]) >= _ON_AXIS)
    sense = float(np.sign(direction[k])) if on_axis else 1.0
    x, y, z = (direction * sense).tolist()
    return RotationSummary(AXES[k] if on_axis else None, (x, y, z), angle * sense / DEG)


def _net(angles: Array) -> Array:
    """Rotation vector of the product of successive small rotations, shape (3,), rad; biases are not removed."""
    steps = np.add.reduceat(angles, np.arange(0, len(angles), max(1, len(angles) // _STEPS)), axis=0)
    product = prefix_product(from_rotation_vector(np.ascontiguousarray(steps.T)))[:, -1:]
    vector: Array = rotation_vector(np.moveaxis(to_matrix(product), 2, 0))[0]
    return vector


def _temperature(recording: Recording) -> TemperatureSummary | None:
    values = recording.temperature
    if values is None:
        return None
    recorded = values.strides != (0,)
    ends = (float(values[0]), float(values[-1]))
    return TemperatureSummary(*ends, *((float(values.min()), float(values.max())) if recorded else ends), recorded)


FORMAT: Final = "srt-inspection"
VERSION: Final = 1
"""Name and version of the JSON form."""

_MOST_LEGS: Final = 8
"""Largest number of rotations of a manoeuvre that a table lists: sequence 6 has as many."""
_NEGLIGIBLE: Final = 0.03
"""Share of the total angle of a manoeuvre below which a rotation is not listed: it is due to an unsteady hand or to
non-orthogonal axes."""


@dataclass(frozen=True, slots=True)
class TimeStampSummary:
    """Sampling of a recording according to its time stamps.

    It begins at the start of the first sample. The stamps are ``even`` if they are evenly spaced within their rounding;
    otherwise each sample has its own interval. The ``jitter`` is the rms deviation of the steps of the stamps from the
    nominal interval, in intervals, without the gaps. The longest gap is at the first sample after it.
    """

    samples: int
    first_s: float
    duration_s: float
    rate_hz: float
    even: bool
    jitter: float
    gaps: int
    missing_s: float
    longest_gap_s: float | None
    longest_gap_at_s: float | None


@dataclass(frozen=True, slots=True)
class StationarySummary:
    """Stationary windows, and the sensor readings in them.

    ``windows_s`` has the start of the first sample and the stamp of the last sample of each window; ``force_g`` the
    smallest, median and largest magnitude of the mean specific force of a window; ``rate_deg_per_h`` the mean readings
    of gyros x, y and z over all windows.
    """

    windows_s: tuple[tuple[float, float], ...]
    total_s: float
    force_g: tuple[float, float, float]
    rate_deg_per_h: tuple[float, float, float]

    @property
    def lengths_s(self) -> tuple[float, ...]:
        """Duration of each window, s."""
        return tuple(b - a for a, b in self.windows_s)


@dataclass(frozen=True, slots=True)
class RotationSummary:
    """Rotation about one axis, as the gyros measure it.

    ``axis`` is the name of the sensor axis, None if the rotation axis is not near one; ``direction`` is the unit vector
    along the rotation axis, in sensor axes. The angle is positive if no axis is named.
    """

    axis: str | None
    direction: tuple[float, float, float]
    angle_deg: float

    def __str__(self) -> str:
        if self.axis is not None:
            return f"{self.axis} {self.angle_deg:+.0f}°"
        return f"{self.angle_deg:+.0f}° about ({' '.join(f'{v:.2f}' for v in self.direction)})"


@dataclass(frozen=True, slots=True)
class ManoeuvreSummary:
    """Manoeuvre between two stationary windows.

    ``legs`` are the rotations, each about one sensor axis, or many small ones for a rotation by hand; ``sequence`` is
    the recognised one of the 17, with a confidence from 0 to 1 and the reason why it is low or none was recognised;
    ``labelled`` is the label in the recording: a sequence id, "free turn" or None.
    """

    start_s: float
    end_s: float
    legs: tuple[RotationSummary, ...]
    net: RotationSummary
    fastest_deg_s: float
    sequence: str | None
    confidence: float
    reason: str
    labelled: str | None

    @property
    def parts(self) -> tuple[RotationSummary, ...]:
        """Rotations that a table lists: those about sensor axes, or only the net rotation for a rotation by hand."""
        path = sum(abs(leg.angle_deg) for leg in self.legs)
        legs = tuple(leg for leg in self.legs if abs(leg.angle_deg) > _NEGLIGIBLE * path)
        few = len(legs) <= _MOST_LEGS and all(leg.axis for leg in legs)
        return legs if self.sequence is not None or few else (self.net,)


@dataclass(frozen=True, slots=True)
class NoiseSummary:
    """Noise in the stationary windows, by channel.

    ``figures`` are dictionaries by channel, then by key of the section [imu] of ``recording.toml``: ``value`` is the
    estimate, ``low`` and ``high`` its 95 % interval, if it is from an Allan deviation, and ``below`` the upper limit of
    a bias instability that the windows are too short to show. ``stated`` has the values of the recording by the same
    keys, ``note`` the reason why there is no Allan deviation.
    """

    figures: dict[str, dict[str, Any]]
    stated: dict[str, float]
    note: str | None


@dataclass(frozen=True, slots=True)
class TemperatureSummary:
    """Temperature in °C; ``recorded`` is False if one stated value holds for all samples."""

    first_c: float
    last_c: float
    lowest_c: float
    highest_c: float
    recorded: bool


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Inspection(Presented):
    """Content of ``srt inspect``.

    ``fitness`` is judged before any calibration. ``units`` are the declared units of ``gyro``, ``accel`` and ``time``,
    empty if unknown; ``stillness`` is None if no stationary window was found; ``summary`` is the result of the
    recognition in one sentence. ``calibrated`` is True if the checks that need a calibration were run.
    ``hidden_gyro_step_rad_s`` is the step to which rates were rounded before they were corrected, 0 if the noise
    averages it out.
    """

    fitness: Fitness
    kind: str
    units: dict[str, str]
    serial: str | None
    stamps: TimeStampSummary
    stillness: StationarySummary | None
    noise: NoiseSummary | None
    allan: AllanDeviation | None
    turns: tuple[ManoeuvreSummary, ...]
    summary: str
    temperature: TemperatureSummary | None
    diagnosis: Diagnosis
    calibrated: bool
    hidden_gyro_step_rad_s: float = 0.0

    @property
    def not_looked_for(self) -> tuple[str, ...]:
        """Names of the faults that were not checked because their checks need a calibration."""
        return () if self.calibrated else tuple(fault.name for fault in FAULTS.values() if fault.needs_result)

    def as_dict(self) -> dict[str, Any]:
        """Content as JSON values."""
        parts = ("stamps", "stillness", "noise", "temperature")
        return {
            "format": FORMAT,
            "version": VERSION,
            "fit": {"word": self.fitness.word, "reason": self.fitness.reason},
            "kind": self.kind,
            "units": self.units,
            "serial": self.serial,
            **{name: None if getattr(self, name) is None else asdict(getattr(self, name)) for name in parts},
            "allan": None if self.allan is None else _curves(self.allan),
            "turns": [asdict(turn) for turn in self.turns],
            "summary": self.summary,
            "calibrated": self.calibrated,
            "findings": to_document(self.diagnosis.faults),
            "not_looked_for": list(self.not_looked_for),
            "verdict": None if self.diagnosis.judgement is None else asdict(self.diagnosis.judgement),
        }


def _curves(allan: AllanDeviation) -> dict[str, Any]:
    """Curves as JSON values, SI; None for a constant channel."""
    out: dict[str, Any] = {"tau_s": allan.tau_s.tolist(), "windows": allan.windows, "total_s": allan.total_s}
    for name in ("deviation", "low", "high"):
        rows = getattr(allan, name).tolist()
        out[name] = {c: None if math.isnan(row[0]) else row for c, row in zip(CHANNELS, rows, strict=True)}
    return out
