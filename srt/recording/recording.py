"""Recording in memory: samples in SI units, site, fixture, IMU noise and sequence labels.

A *rate* sample is the mean over the interval that ends at its time stamp, an *increment* sample the integral over that
interval. Specific force at rest points up.

The constructor checks all values. The arrays become read-only views; they are copied only if they are not contiguous
float64.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar, get_args

import numpy as np

from srt.arguments import real_array, require_type
from srt.exceptions import InputError
from srt.model.table1 import AXES
from srt.presentation import Presented
from srt.recording.schema import FIXTURE_KEYS, IMU_KEYS, RECORDING_KEYS, SITE_KEYS, check_fields, short
from srt.recording.sequence_label import SequenceLabel
from srt.recording.timing import SampleTiming, sample_timing

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from numpy.typing import ArrayLike

    from srt.recording.applied import AppliedCorrection
    from srt.recording.protocol import Protocol
    from srt.types import Array, Indices

__all__ = [
    "GRAVITY_RANGE_M_S2", "LARGEST_VALUE", "WINDOW_TOLERANCE", "Fixture", "ImuNoise", "Kind", "Recording",
    "SequenceLabel", "Site", "require_bounded",
]  # fmt: skip

Kind = Literal["rate", "increment"]
Derived = TypeVar("Derived")

GRAVITY_RANGE_M_S2: Final = (9.5, 10.1)
"""Accepted gravity, m/s²; the Earth's surface has 9.76 to 9.84."""

LARGEST_VALUE: Final = 1e12
"""Bound of the magnitude of values from files, SI units: far above any sensor's range; sums of squares stay finite."""

_WOBBLE: Final = 0.01
"""Default wobble as a fraction of the rotation sigma: 2 seconds of arc for a fixture of 1 mrad.

Rotary tables on air bearings, the best, are specified to less than one second of arc; rolling bearings and floors have
more. A navigation-grade unit would gain little with one second, and zero would be wrong (docs/design/joint.md).
"""

_TIMING: Final = "timing"  # names of the intervals, and of the indices of the labels' windows, among the derived values
_WINDOWS: Final = "windows of the labels"
WINDOW_TOLERANCE: Final = 1e-6
"""Tolerance of window limits for the rounding of stamps, in intervals."""

_NUMBERS = frozenset({"sample_rate_hz", "clock_sigma_ppm"})  # keys of [recording] whose fields are numbers


GRAVITY_SIGMA_M_S2: Final = 5e-6
"""Standard deviation of a gravity that is given, m/s²: 0.5 mGal, as measured or transferred by gravimeter."""


@dataclass(frozen=True, slots=True)
class Site:
    """Site of the recording: gravity and latitude.

    Attributes
    ----------
    gravity_m_s2 : float
        Plumb-bob gravity, m/s².
    gravity_sigma_m_s2 : float
        Standard deviation of gravity, m/s²: a common error of the accelerometer scale factors.
    latitude_rad : float or None
        None: unknown; the gyro-bias sigma then includes the whole Earth rate.
    latitude_sigma_rad : float or None
        Standard deviation of the latitude, rad; None: not stated, and the latitude counts as exact.
    gravity_sigma_origin : "assumed" or None
        "assumed": nobody stated the standard deviation of gravity.

    Raises
    ------
    InputError
        Gravity or latitude outside the range on the Earth's surface, a sigma outside the range of its key in
        ``srt.recording.schema``.
    """

    gravity_m_s2: float
    gravity_sigma_m_s2: float = GRAVITY_SIGMA_M_S2
    latitude_rad: float | None = None
    latitude_sigma_rad: float | None = None
    gravity_sigma_origin: str | None = None

    def __post_init__(self) -> None:
        low, high = GRAVITY_RANGE_M_S2
        if not low <= self.gravity_m_s2 <= high:
            raise InputError(
                f"Gravity is {short(self.gravity_m_s2)} m/s², but between {low} and {high} is expected "
                "(the Earth's surface has 9.76 to 9.84): give it in m/s², positive."
            )
        check_fields("The site's", self, SITE_KEYS)


@dataclass(frozen=True, slots=True)
class Fixture:
    """Two-axis fixture: heading of the table x axis, clockwise from north, and 1-sigma accuracy.

    Attributes
    ----------
    heading_rad : float or None
        None: unknown (not zero).
    alignment_sigma_rad : float
        Error of each of base level x, y, north, mounting x, y, z and angle between the axes; constant in a recording.
    rotation_sigma_rad : float
        Error of each rotation, including the rotation to a start attitude; independent draws.
    wobble_sigma_rad : float or None
        Change of the tilt of the inner axis about the outer one from pose to pose: bearing wobble and floor movement.
        None: not stated; the default is a hundredth of ``rotation_sigma_rad``.

    Raises
    ------
    InputError
        A heading or sigma outside the range of its key in ``srt.recording.schema``.
    """

    heading_rad: float | None = 0.0
    alignment_sigma_rad: float = 1e-3
    rotation_sigma_rad: float = 1e-3
    wobble_sigma_rad: float | None = None

    def __post_init__(self) -> None:
        check_fields("The fixture's", self, FIXTURE_KEYS)

    @property
    def wobble(self) -> float:
        """Axis wobble, rad; if not stated, a hundredth of the rotation sigma."""
        return _WOBBLE * self.rotation_sigma_rad if self.wobble_sigma_rad is None else self.wobble_sigma_rad


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Stated noise of an IMU; None: not stated, to be estimated from the stationary windows.

    Attributes
    ----------
    gyro_noise : float or None
        Angular random walk, rad/√s.
    accel_noise : float or None
        Velocity random walk, m/s²·√s (that is m/s/√s).
    gyro_quantization : float or None
        Angle per pulse, rad.
    accel_quantization : float or None
        Velocity per pulse, m/s.
    gyro_bias_instability, accel_bias_instability : float or None
        rad/s, m/s².
    gyro_range, accel_range : float or None
        Saturation, rad/s, m/s².

    Raises
    ------
    InputError
        A value outside the range of its key in ``srt.recording.schema``; quantization and bias instability may be
        zero.
    """

    gyro_noise: float | None = None
    accel_noise: float | None = None
    gyro_quantization: float | None = None
    accel_quantization: float | None = None
    gyro_bias_instability: float | None = None
    accel_bias_instability: float | None = None
    gyro_range: float | None = None
    accel_range: float | None = None

    def __post_init__(self) -> None:
        check_fields("The unit's", self, IMU_KEYS)


_FIELDS: Final[dict[str, tuple[str, tuple[type, ...]]]] = {
    "site": ("a Site", (Site,)),
    "fixture": ("a Fixture or None", (Fixture, type(None))),
    "noise": ("an ImuNoise", (ImuNoise,)),
    "sequences": ("a tuple of SequenceLabel", (Iterable,)),
}
"""Content of fields of a recording, with their classes."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Recording(Presented):
    """Recording of an IMU: samples, site, fixture, noise and sequence labels.

    Attributes
    ----------
    time : ndarray, shape (n,), s
        Time stamps, strictly increasing; sample i covers the ``interval`` that ends at ``time[i]``.
    gyro : ndarray, shape (n, 3)
        rad/s for kind "rate", rad for "increment".
    accel : ndarray, shape (n, 3)
        m/s² for "rate", m/s for "increment".
    kind : "rate" or "increment"
    fixture : Fixture or None
        None: no fixture, attitudes and heading unknown (a free recording).
    sequences : tuple of SequenceLabel
        Empty: the recording is segmented automatically.
    sample_rate_hz : float or None
        Overrides the spacing of the time stamps, if given.
    temperature : ndarray, shape (n,), °C, or None
        One value broadcast to n samples is a stated, not a recorded temperature.
    data_sha256 : str or None
        Hash of the samples file.
    clock_sigma : float or None
        1-sigma relative error of the time base, one for the whole recording; None: not stated.
    applied : AppliedCorrection or None
        Correction that the readings had before they were logged; None: not known.
    protocol : Protocol or None
        Poses and turns of the test; they label a recording without labels.

    Raises
    ------
    InputError
        Inconsistent shapes, values that are not finite, time that does not increase, labels outside the samples.
    """

    time: Array
    gyro: Array
    accel: Array
    site: Site
    kind: Kind = "rate"
    fixture: Fixture | None = None
    noise: ImuNoise = field(default_factory=ImuNoise)
    sequences: tuple[SequenceLabel, ...] = ()
    sample_rate_hz: float | None = None
    temperature: Array | None = None
    serial: str | None = None
    date: str | None = None
    source: str | None = None
    data_sha256: str | None = None
    clock_sigma: float | None = None
    applied: AppliedCorrection | None = None
    protocol: Protocol | None = None
    _memo: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name, (needed, kinds) in _FIELDS.items():
            require_type(f"The field {name} of a recording", needed, getattr(self, name), *kinds)
        check_fields("The recording's", self, (key for key in RECORDING_KEYS if key.name in _NUMBERS))
        time = as_samples("time", self.time, 1)
        if time.size < 2:
            raise InputError(f"The recording holds {time.size} samples, but at least 2 are needed: check its file.")
        require_finite("time", time, None)
        object.__setattr__(self, "time", time)
        self._check_readings()
        if self.temperature is not None:
            self._check_samples("temperature", 1)
        require_increasing(time)
        object.__setattr__(self, "sequences", tuple(self.sequences))
        for label in self.sequences:
            require_type("The field sequences of a recording", _FIELDS["sequences"][0], label, SequenceLabel)
        if self.sequences:
            limits = [own for label in self.sequences for own in (label.start_static_s, label.end_static_s)]
            self._memo[_WINDOWS] = dict(zip(limits, self.windows(limits), strict=True))
        self._check_overlap([self._checked_rotation(label) for label in self.sequences])

    def _check_readings(self) -> None:
        if self.kind not in get_args(Kind):
            raise InputError(f"The kind of a recording is {self.kind!r}, but 'rate' or 'increment' is expected.")
        for name in ("gyro", "accel"):
            self._check_samples(name, 2)

    def _check_samples(self, name: str, dimensions: int) -> None:
        """Store checked samples, of which there must be as many as stamps."""
        values = as_samples(name, getattr(self, name), dimensions)
        if len(values) != self.time.size:
            raise InputError(f"{name} holds {len(values)} samples, but time {self.time.size}: they must agree.")
        require_finite(name, values, self.time)
        object.__setattr__(self, name, values)

    def _check_overlap(self, rotations: Sequence[tuple[int, int]]) -> None:
        """Refuse rotations that share samples: they would count as independent data."""
        last, end = None, 0
        for k in sorted(range(len(rotations)), key=rotations.__getitem__):
            first, stop = rotations[k]
            if last is not None and first < end:
                raise InputError(
                    f"{self.sequences[k].title} begins to rotate while {self.sequences[last].title} still does: the "
                    "same samples must not be labelled twice; correct the windows' times, or remove one label."
                )
            if stop > end:
                last, end = k, stop

    def _checked_rotation(self, label: SequenceLabel) -> tuple[int, int]:
        """First sample of the rotation of a label and of its end window; both windows must hold samples."""
        first, last, interval = float(self.time[0]), float(self.time[-1]), self.nominal_interval_s
        # One interval of tolerance on each side: some loggers stamp the start of a sample.
        low, high = first - 2.001 * interval, last + 1.001 * interval
        windows = []
        for name in ("start_static_s", "end_static_s"):
            a, b = getattr(label, name)
            if a < low or b > high:
                raise InputError(
                    f"{label.title}: {name} is [{a:g}, {b:g}], but the samples run from "
                    f"{round(first - interval, 9):g} to {last:g} s: correct the window, or the time unit.",
                    fault="labels_shifted",
                )
            window = self.window_indices(a, b)
            if window.stop <= window.start:
                raise InputError(
                    f"{label.title}: {name} [{a:g}, {b:g}] holds no sample (the interval is {interval:g} s): "
                    "widen the window, or label a part that was recorded.",
                    # An empty window that is longer than an interval lies in a jump of the time stamps.
                    fault="gap_in_sequence" if b - a > 2.0 * interval else None,
                )
            windows.append(window)
        return windows[0].stop, windows[1].start

    def memo(self, key: Hashable, make: Callable[[], Derived]) -> Derived:
        """Derived value of this recording, computed once and shared by diagnosis and estimators.

        ``key`` names the value, with all options that it depends on; exceptions of ``make`` are not stored.
        """
        if key not in self._memo:
            self._memo[key] = make()
        value: Derived = self._memo[key]
        return value

    def give(self, key: Hashable, value: object) -> None:
        """Store a derived value that was computed with those of other recordings, unless there is one."""
        self._memo.setdefault(key, value)

    def forget(self) -> None:
        """Drop the derived values, which refer to the recording in turn: both would wait for the garbage collector.

        It counts objects, not bytes, so that those of hundreds of recordings would stay in memory.
        """
        self._memo.clear()

    def __getstate__(self) -> dict[str, Any]:
        """Fields without the derived values, which another process recomputes."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "_memo"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in (state | {"_memo": {}}).items():
            object.__setattr__(self, name, value)

    @property
    def timing(self) -> SampleTiming:
        """Sampling intervals and gaps, computed at the first use."""
        return self.memo(_TIMING, lambda: sample_timing(self.time, self.sample_rate_hz))

    @property
    def interval_s(self) -> float | Array:
        """Duration of each sample, s: a number if uniform, else shape (n,)."""
        return self.timing.interval_s

    @property
    def nominal_interval_s(self) -> float:
        """Typical duration of a sample, s."""
        return self.timing.nominal_interval_s

    @property
    def rates_factor(self) -> float:
        """Factor from readings to rates: 1, or one over the interval for increments, 1/s."""
        return 1.0 if self.kind == "rate" else 1.0 / self.nominal_interval_s

    @property
    def gaps(self) -> Indices:
        """Indices of the first samples after interruptions; empty without interruptions."""
        return self.timing.gaps

    def gaps_inside(self, spans: ArrayLike) -> Indices:
        """First sample after an interruption inside each span of samples (n, 2), -1 without one, shape (n,).

        One right before a span is outside it.
        """
        start, stop = np.reshape(spans, (-1, 2)).T
        first = np.append(self.gaps, len(self.time))[np.searchsorted(self.gaps, start, side="right")]
        return np.where(first < stop, first, -1)

    def window_indices(self, a: float, b: float) -> slice:
        """Samples of the window [a, b], s: those with a + dt/2 < t <= b + dt/2; an empty slice if there are none.

        Adjacent windows have no sample in common and none between them, whatever the rounding of stamps and limits.
        """
        of_labels: dict[tuple[float, float], slice] = self.memo(_WINDOWS, dict)
        return of_labels.get((a, b)) or self.windows([(a, b)])[0]

    def windows(self, limits: Sequence[tuple[float, float]]) -> list[slice]:
        """:meth:`window_indices` of several windows, by their limits."""
        edge = (0.5 + WINDOW_TOLERANCE) * self.nominal_interval_s
        found = np.searchsorted(self.time, np.reshape(limits, (-1, 2)) + edge, side="right")
        return [slice(start, max(start, stop)) for start, stop in found.tolist()]

    def with_readings(
        self, gyro: Array, accel: Array, *, kind: Kind, noise: ImuNoise, serial: str | None = None
    ) -> Recording:
        """Recording of the same motion by another IMU.

        Only the readings and their kind are checked, as the other fields are those of this recording. Raises
        InputError.
        """
        other = copy(self)
        for name, value in {"gyro": gyro, "accel": accel, "kind": kind, "noise": noise, "serial": serial}.items():
            object.__setattr__(other, name, value)
        other._check_readings()
        other._memo.update({key: self._memo[key] for key in (_TIMING, _WINDOWS) if key in self._memo})
        return other

    def with_sequences(self, sequences: tuple[SequenceLabel, ...]) -> Recording:
        """Recording of the same samples with other labels."""
        return replace(self, sequences=sequences)


def require_bounded(recording: Recording) -> None:
    """Raise InputError that names the first value read from a file that is too large for its quantity.

    The limit is :data:`LARGEST_VALUE` in SI units, for time, readings and temperature.
    """
    for name in ("time", "gyro", "accel", "temperature"):
        values = getattr(recording, name)
        if values is None or max(values.max(), -values.min()) < LARGEST_VALUE:
            continue
        index = int(np.flatnonzero(np.abs(values) >= LARGEST_VALUE)[0])
        raise InputError(
            f"{place_of(name, values, index)[0]} is {values.flat[index]:.3g} in SI units, but every value must be "
            f"smaller than {LARGEST_VALUE:.0e}: correct the unit, or repair or remove the sample."
        )


def as_samples(name: str, given: object, dimensions: int) -> Array:
    """Read-only contiguous float64 view, copied only if needed, shape (n,) or (n, 3) by the number of dimensions.

    A value broadcast to n samples remains one value in memory. Raises InputError for another shape, masked values, or
    what does not consist of real numbers; it names the array.
    """
    values = np.asarray(real_array(name, given), dtype=np.float64)
    if values.ndim != dimensions or (dimensions == 2 and values.shape[1] != 3):
        expected = "(n, 3)" if dimensions == 2 else "(n,)"
        raise InputError(f"{name} has the shape {values.shape}, but {expected} is expected.")
    if values.strides != (0,):
        values = np.ascontiguousarray(values)
    values = values.view()
    values.flags.writeable = False
    return values


def require_finite(name: str, values: Array, time: Array | None) -> None:
    """Raise InputError that names the first value that is not finite, by column, sample and time."""
    # The sum is finite only if every term is, and takes a fraction of the time of a test of each term. It may also
    # overflow, so the terms are tested then.
    with np.errstate(over="ignore", invalid="ignore"):
        if math.isfinite(values.sum()):
            return
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size == 0:
        return
    where, row = place_of(name, values, int(bad[0]))
    when = "" if time is None else f", at {time[row]:.9g} s,"
    raise InputError(
        f"{where}{when} is {values.flat[bad[0]]} "
        f"({bad.size} such in this sensor), but every reading must be a finite number: "
        "repair or remove the sample.",
        fault="not_finite",
    )


def place_of(name: str, values: Array, index: int) -> tuple[str, int]:
    """Column and sample of a value by its flat index, as the start of a sentence, and the row."""
    row, column = divmod(index, values.size // len(values))
    full_name = f"{name}_{AXES[column]}" if values.ndim == 2 else name
    return f"Column {full_name}: sample {row + 1} of {len(values)}", row


def require_increasing(time: Array) -> None:
    """Raise InputError that names the first stamp which does not follow its predecessor."""
    rising = time[1:] > time[:-1]
    if rising.all():
        return
    bad = np.flatnonzero(~rising) + 1
    row = int(bad[0])
    what = "repeats" if time[row] == time[row - 1] else "goes back from"
    raise InputError(
        f"Column time: sample {row + 1} of {time.size} at {time[row]:.9g} s {what} {time[row - 1]:.9g} s "
        f"({bad.size} such in all), but time must increase: remove repeated samples, or restore the order.",
        fault="time_repeats" if what == "repeats" else "time_backwards",
    )
