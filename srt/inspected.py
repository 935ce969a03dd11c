"""What an inspection holds. Figures are in the units that people expect, which their names carry."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from srt.noise.allan import CHANNELS

if TYPE_CHECKING:
    from srt.diagnosis import Diagnosis
    from srt.noise.allan import AllanDeviation

FORMAT: Final = "srt-inspection"
VERSION: Final = 1

_MOST_LEGS: Final = 8
"""That a table shows of a turn; sequence 6 has as many."""
_NEGLIGIBLE: Final = 0.03
"""Share of a turn below which a leg is the wobble of a hand, or of axes that are not orthogonal."""


@dataclass(frozen=True, slots=True)
class Stamps:
    """Time stamps and what they say of the sampling.

    Attributes
    ----------
    samples : int
    first_s, duration_s : float
        Start of the first sample, and from there to the last stamp.
    rate_hz : float
    even : bool
        Whether the stamps lie on a straight line to within their rounding; if not, every sample has its own interval.
    jitter : float
        Rms deviation of a step from the interval, in intervals, gaps apart.
    gaps : int
    missing_s : float
        All of them together.
    longest_gap_s, longest_gap_at_s : float or None
        The longest, and the time of the first sample after it.
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
class Stillness:
    """The stationary windows, and what the sensors read in them.

    Attributes
    ----------
    windows_s : tuple of (float, float)
        From the start of the first sample to the stamp of the last.
    total_s : float
    force_g : (float, float, float)
        Magnitude of the specific force by window: least, median, greatest.
    rate_deg_per_h : (float, float, float)
        Mean reading of gyro x, y, z over all windows.
    """

    windows_s: tuple[tuple[float, float], ...]
    total_s: float
    force_g: tuple[float, float, float]
    rate_deg_per_h: tuple[float, float, float]

    @property
    def lengths_s(self) -> tuple[float, ...]:
        """Duration of every window."""
        return tuple(b - a for a, b in self.windows_s)


@dataclass(frozen=True, slots=True)
class Leg:
    """A stretch of a turn about one axis, as the gyros read it.

    Attributes
    ----------
    axis : str or None
        Sensor axis, None where none is near.
    direction : (float, float, float)
        Unit vector of the rotation, in sensor axes, along which the angle is positive.
    angle_deg : float
        Signed where the axis is named.
    """

    axis: str | None
    direction: tuple[float, float, float]
    angle_deg: float

    def __str__(self) -> str:
        axis = self.axis or f"({' '.join(f'{v:.2f}' for v in self.direction)})"
        return f"{axis} {self.angle_deg:+.0f}°"


@dataclass(frozen=True, slots=True)
class TurnSeen:
    """One turn between two rests.

    Attributes
    ----------
    start_s, end_s : float
    legs : tuple of Leg
        Stretches about one sensor axis each; many small ones where a hand turned the unit.
    net : Leg
        The whole turn as one rotation from its start.
    fastest_deg_s : float
    sequence : str or None
        Recognised as this one of Table 1.
    confidence : float
        0 to 1.
    reason : str
    labelled : str or None
        What its label says, where the recording has labels: an id, or "free turn".
    """

    start_s: float
    end_s: float
    legs: tuple[Leg, ...]
    net: Leg
    fastest_deg_s: float
    sequence: str | None
    confidence: float
    reason: str
    labelled: str | None

    @property
    def parts(self) -> tuple[Leg, ...]:
        """What tables show: the legs about sensor axes, or the net rotation alone where a hand made it of many."""
        path = sum(abs(leg.angle_deg) for leg in self.legs)
        legs = tuple(leg for leg in self.legs if abs(leg.angle_deg) > _NEGLIGIBLE * path)
        few = len(legs) <= _MOST_LEGS and all(leg.axis for leg in legs)
        return legs if self.sequence is not None or few else (self.net,)


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise at rest by channel.

    Attributes
    ----------
    figures : dict
        By channel, then by key of the section [imu] of ``recording.toml``: ``value`` with ``low`` and ``high`` (95 %)
        where an Allan deviation could be taken; ``below`` for a bias instability that was not reached.
    stated : dict
        What the recording states, by the same keys.
    note : str or None
        Why there is no Allan deviation.
    """

    figures: dict[str, dict[str, Any]]
    stated: dict[str, float]
    note: str | None


@dataclass(frozen=True, slots=True)
class Temperature:
    """Temperature in °C; ``recorded`` is False where one value was stated for all samples."""

    first_c: float
    last_c: float
    lowest_c: float
    highest_c: float
    recorded: bool


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """All that ``srt inspect`` shows.

    Attributes
    ----------
    kind : "rate" or "increment"
    units : dict
        Of ``gyro``, ``accel`` and ``time`` as the recording declares them; empty where that is not known.
    serial : str or None
    stamps : Stamps
    stillness : Stillness or None
        None: no rest was found.
    noise : Noise or None
    allan : AllanDeviation or None
    turns : tuple of TurnSeen
    summary : str
        What the recording was recognised as, or why it was not, in a sentence.
    temperature : Temperature or None
    diagnosis : Diagnosis
    calibrated : bool
        Whether faults were looked for that only a calibration shows.
    """

    kind: str
    units: dict[str, str]
    serial: str | None
    stamps: Stamps
    stillness: Stillness | None
    noise: Noise | None
    allan: AllanDeviation | None
    turns: tuple[TurnSeen, ...]
    summary: str
    temperature: Temperature | None
    diagnosis: Diagnosis
    calibrated: bool

    def as_dict(self) -> dict[str, Any]:
        """All of it as JSON values."""
        parts = ("stamps", "stillness", "noise", "temperature")
        return {
            "format": FORMAT,
            "version": VERSION,
            "kind": self.kind,
            "units": self.units,
            "serial": self.serial,
            **{name: None if getattr(self, name) is None else asdict(getattr(self, name)) for name in parts},
            "allan": None if self.allan is None else _curves(self.allan),
            "turns": [asdict(turn) for turn in self.turns],
            "summary": self.summary,
            "calibrated": self.calibrated,
            "findings": self.diagnosis.as_dicts(),
        }


def _curves(allan: AllanDeviation) -> dict[str, Any]:
    """Curves as JSON values, SI; None where a channel never changes."""
    out: dict[str, Any] = {"tau_s": allan.tau_s.tolist(), "windows": allan.windows, "total_s": allan.total_s}
    for name in ("deviation", "low", "high"):
        rows = getattr(allan, name).tolist()
        out[name] = {c: None if math.isnan(row[0]) else row for c, row in zip(CHANNELS, rows, strict=True)}
    return out
