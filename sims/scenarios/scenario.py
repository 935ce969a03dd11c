"""Scenarios of a simulation as TOML, with the unit in every key, checked before the simulation starts.

Tables of a scenario::

    seed = 1     (the default; and motion_seed, for several units that run through one motion)
    [imu]        from = "navigation-rlg"; [imu.noise] and [imu.errors] lie over the grade's; frame_turn_mrad
    [fixture]    from = "lab-1mrad"; heading_deg              (absent with [free])
    [site]       from = "latitude-45"; latitude_deg, gravity_m_s2 or height_m
    [errors]     draw = "normal", "uniform" or "none"; factor; [errors.values] by name, SI
    [schedule]   sequences, repeats, dwell_s or dwells_s, rate_rad_s, ...
    [free]       in place of [schedule]: turns or rotations_deg, profile, peak_rate_rad_s or turn_duration_s, dwell_s
    [protocol]   in place of both: from = "19-positions", total_time_s; on the [fixture], or without one
    [recording]  sample_rate_hz, kind, format, ...

An unknown key is an error: a misspelt key must not leave a default in force.
"""

from __future__ import annotations

import difflib
import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from sims.physics.sequences import TABLE_1, TurnSequence, table_sequences
from sims.physics.turn_profiles import ProfileName  # noqa: TC001 - pydantic reads it
from sims.scenarios import library
from sims.scenarios.toml_table import LibraryTable, TomlTable, validated
from srt.constants import ARCSEC, DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G, STANDARD_GRAVITY_M_S2, normal_gravity_m_s2
from srt.exceptions import InputError
from srt.recording.protocol import Protocol, load_protocol
from srt.recording.recording import Site
from srt.sensor_errors import GROUPS, NAMES

if TYPE_CHECKING:
    from pathlib import Path

# Strict: a number in quotes, or true for 1, is a mistake that must not pass.
NonNegative = Annotated[float, Field(ge=0.0, strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, strict=True, allow_inf_nan=False)]
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Flag = Annotated[bool, Field(strict=True)]
Vector = tuple[Finite, Finite, Finite]


def _as_pair(value: object) -> object:
    """Make a pair of one dwell; refuse other values here, as pydantic would give one message per alternative."""
    pair = list(value) if isinstance(value, list | tuple) else [value, value]
    if len(pair) != 2 or not all(isinstance(v, int | float) and not isinstance(v, bool) and v > 0.0 for v in pair):
        raise ValueError(f"found {value!r}: give a positive number of seconds, or a pair [start, end] of them")
    return pair


TurnDuration = Annotated[float, Field(strict=True, ge=0.5, le=30.0, allow_inf_nan=False)]
"""Duration of a turn by hand, s."""
Dwells = Annotated[tuple[Positive, Positive], BeforeValidator(_as_pair)]
SignedAxis = Literal["x", "y", "z", "-x", "-y", "-z"]

MRAD = 1e-3
PPM = 1e-6
"""Milliradian and part per million in SI."""


class NoiseConfig(TomlTable):
    """Noise, quantization, range and g-sensitivity of a unit; an absent key means none."""

    gyro_noise_deg_per_sqrt_h: NonNegative = 0.0
    accel_noise_ug_per_sqrt_hz: NonNegative = 0.0
    gyro_bias_instability_deg_per_h: NonNegative = 0.0
    accel_bias_instability_ug: NonNegative = 0.0
    gyro_quantization_arcsec: NonNegative = 0.0
    accel_quantization_m_s: NonNegative = 0.0
    gyro_resolution_deg_s: NonNegative = 0.0
    accel_resolution_mg: NonNegative = 0.0
    gyro_range_deg_s: Positive | None = None
    accel_range_g: Positive | None = None
    gyro_g_sensitivity_deg_per_h_per_g: NonNegative = 0.0
    """Standard deviation of each matrix element; the matrix is drawn once per unit."""

    def si(self) -> dict[str, float]:
        """Arguments of :class:`sims.physics.imu.ImuModel` in SI units, except the g-sensitivity matrix."""
        return {
            "gyro_noise": self.gyro_noise_deg_per_sqrt_h * DEG_PER_SQRT_H,
            "accel_noise": self.accel_noise_ug_per_sqrt_hz * MICRO_G,
            "gyro_bias_instability": self.gyro_bias_instability_deg_per_h * DEG_PER_H,
            "accel_bias_instability": self.accel_bias_instability_ug * MICRO_G,
            "gyro_quantization": self.gyro_quantization_arcsec * ARCSEC,
            "accel_quantization": self.accel_quantization_m_s,
            "gyro_resolution": self.gyro_resolution_deg_s * DEG,
            "accel_resolution": self.accel_resolution_mg * 1e3 * MICRO_G,
            "gyro_range": math.inf if self.gyro_range_deg_s is None else self.gyro_range_deg_s * DEG,
            "accel_range": math.inf if self.accel_range_g is None else self.accel_range_g * STANDARD_GRAVITY_M_S2,
        }

    @property
    def g_sensitivity_sigma(self) -> float:
        """Standard deviation of each g-sensitivity, rad/s per m/s²."""
        return self.gyro_g_sensitivity_deg_per_h_per_g * DEG_PER_H / STANDARD_GRAVITY_M_S2


class ErrorSizes(TomlTable):
    """Standard deviation of each group of sensor errors before calibration; an absent key means zero."""

    gyro_scale_ppm: NonNegative = 0.0
    gyro_asymmetry_ppm: NonNegative = 0.0
    gyro_orthogonality_urad: NonNegative = 0.0
    accel_bias_ug: NonNegative = 0.0
    accel_scale_ppm: NonNegative = 0.0
    accel_asymmetry_ppm: NonNegative = 0.0
    accel_misalignment_urad: NonNegative = 0.0
    gyro_bias_deg_per_h: NonNegative = 0.0

    def si(self) -> dict[str, float]:
        """Sizes by group name, SI."""
        return {
            "gyro_scale": self.gyro_scale_ppm * PPM,
            "gyro_asymmetry": self.gyro_asymmetry_ppm * PPM,
            "gyro_orthogonality": self.gyro_orthogonality_urad * 1e-6,
            "accel_bias": self.accel_bias_ug * MICRO_G,
            "accel_scale": self.accel_scale_ppm * PPM,
            "accel_asymmetry": self.accel_asymmetry_ppm * PPM,
            "accel_misalignment": self.accel_misalignment_urad * 1e-6,
            "gyro_bias": self.gyro_bias_deg_per_h * DEG_PER_H,
        }


class ImuConfig(LibraryTable):
    """One IMU grade."""

    name: str
    description: str = ""
    noise: NoiseConfig = NoiseConfig()
    errors: ErrorSizes = ErrorSizes()
    frame_turn_mrad: Vector = (0.0, 0.0, 0.0)
    """Rotation vector that turns the table-mounted frame T into B."""
    frame_turn_sigma_mrad: NonNegative = 0.0
    """Standard deviation of an additional random rotation about each axis."""


class FixtureConfig(LibraryTable):
    """Fixture: standard deviations of its true errors, and values stated in the recording."""

    name: str
    description: str = ""
    heading_deg: Finite = 0.0
    level_sigma_mrad: NonNegative
    north_sigma_mrad: NonNegative
    mounting_sigma_mrad: NonNegative
    non_orthogonality_sigma_mrad: NonNegative
    rotation_sigma_mrad: NonNegative
    stated_alignment_sigma_mrad: Positive
    stated_rotation_sigma_mrad: Positive
    wobble_sigma_mrad: NonNegative = 0.0
    stated_wobble_sigma_mrad: NonNegative | None = None
    """If absent: a hundredth of the rotations' sigma, see :class:`srt.recording.recording.Fixture`."""
    state_heading: Flag = True

    def draw_sizes(self) -> dict[str, float]:
        """Keyword arguments of :func:`sims.physics.fixture.draw_fixture`, rad."""
        return {
            "level_sigma_rad": self.level_sigma_mrad * MRAD,
            "north_sigma_rad": self.north_sigma_mrad * MRAD,
            "mounting_sigma_rad": self.mounting_sigma_mrad * MRAD,
            "non_orthogonality_sigma_rad": self.non_orthogonality_sigma_mrad * MRAD,
            "rotation_sigma_rad": self.rotation_sigma_mrad * MRAD,
            "wobble_sigma_rad": self.wobble_sigma_mrad * MRAD,
        }


class SiteConfig(LibraryTable):
    """The site: latitude, and gravity given or by the WGS 84 normal formula."""

    name: str = ""
    description: str = ""
    latitude_deg: Annotated[float, Field(strict=True, ge=-90.0, le=90.0)]
    gravity_m_s2: Annotated[float, Field(strict=True, gt=9.0, lt=10.0)] | None = None
    height_m: Annotated[float, Field(strict=True, ge=-500.0, le=9000.0)] | None = None
    gravity_sigma_m_s2: Positive | None = None
    earth_rate: Flag = True
    state_latitude: Flag = True

    @model_validator(mode="after")
    def _one_gravity(self) -> Self:
        if (self.gravity_m_s2 is None) == (self.height_m is None):
            raise ValueError("give either gravity_m_s2 or height_m, including the keys from 'from'")
        return self

    def site(self) -> Site:
        """Site in SI units."""
        latitude = self.latitude_deg * DEG
        if self.gravity_m_s2 is not None:
            return Site(self.gravity_m_s2, self.gravity_sigma_m_s2 or 5e-6, latitude)
        assert self.height_m is not None
        return Site(normal_gravity_m_s2(latitude, self.height_m), self.gravity_sigma_m_s2 or 5e-4, latitude)


class ErrorsConfig(TomlTable):
    """Sensor errors of the unit."""

    draw: Literal["normal", "uniform", "none"] = "normal"
    """Distribution of the drawn errors; uniform means within ±√3 sigma, the same sigma."""
    factor: NonNegative = 1.0
    """Factor on the sizes of the grade."""
    values: dict[str, Finite] = Field(default_factory=dict)
    """Values by parameter name, SI; they replace drawn values."""

    @model_validator(mode="after")
    def _known_names(self) -> Self:
        for name in self.values:
            if name not in NAMES:
                near = difflib.get_close_matches(name, NAMES, 1)
                hint = f"write {near[0]!r}" if near else f"the groups are {', '.join(g.name for g in GROUPS)}"
                raise ValueError(f"there is no sensor error named {name!r}: {hint}")
        return self


class CustomSequence(TomlTable):
    """A sequence that is not in Table 1."""

    id: str
    down: SignedAxis
    along_outer: SignedAxis
    """IMU axes that point down and along the outer axis at the start; a minus means the opposite direction."""
    rotations: Annotated[tuple[tuple[Literal["x", "y", "z"], Finite], ...], Field(min_length=1)]
    """IMU axis and signed angle in degrees, one after the other."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.id in TABLE_1:
            raise ValueError(f"the id {self.id!r} belongs to Table 1: choose another")
        try:
            self.turn_sequence()
        except InputError as error:
            raise ValueError(str(error)) from error
        return self

    def turn_sequence(self) -> TurnSequence:
        """Sequence as the fixture executes it."""
        return TurnSequence(self.id, self.down, self.along_outer, self.rotations)


class ScheduleConfig(TomlTable):
    """A run on the fixture."""

    sequences: tuple[str, ...] = tuple(TABLE_1)
    """Ids of Table 1 or of [[schedule.custom]], in the order of execution."""
    custom: tuple[CustomSequence, ...] = ()
    repeats: Annotated[int, Field(strict=True, ge=1)] = 1
    dwell_s: Positive = 10.0
    dwells_s: tuple[Dwells, ...] | None = None
    """Instead of dwell_s: a number or a pair [start window, end window] for each entry of ``sequences``."""
    leg_dwell_s: NonNegative = 0.0
    settle_s: NonNegative = 0.0
    pause_s: NonNegative = 1.0
    rate_rad_s: Positive = 1.0
    acceleration_rad_s2: Positive = 10.0
    moves: Literal["recorded", "skipped"] = "skipped"
    settling_amplitude_mrad: NonNegative = 0.0
    settling_frequency_hz: Positive = 8.0
    settling_decay_s: Positive = 0.1

    @model_validator(mode="after")
    def _known_sequences(self) -> Self:
        own = [s.id for s in self.custom]
        if not self.sequences:
            raise ValueError("sequences is empty: name at least one")
        for name in self.sequences:
            if name not in TABLE_1 and name not in own:
                raise ValueError(f"there is no sequence {name!r}: the ids are {', '.join([*TABLE_1, *own])}")
        if self.dwells_s is not None and len(self.dwells_s) != len(self.sequences):
            raise ValueError(
                f"dwells_s has {len(self.dwells_s)} entries, but there are {len(self.sequences)} sequences: give one "
                "for each"
            )
        return self

    def turn_sequences(self) -> tuple[TurnSequence, ...]:
        """All sequences in the order of execution, repeats included."""
        own = {s.id: s.turn_sequence() for s in self.custom}
        once = tuple(own[name] if name in own else table_sequences((name,))[0] for name in self.sequences)
        return once * self.repeats


class FreeConfig(TomlTable):
    """A free recording: turns by hand or by a servo between static poses."""

    turns: Annotated[int, Field(strict=True, ge=1)] | None = None
    """Number of random turns; or rotations_deg."""
    smallest_turn_deg: Positive = 60.0
    largest_turn_deg: Positive = 180.0
    rotations_deg: tuple[Vector, ...] | None = None
    """Rotation vectors in B."""
    profile: ProfileName = "quintic"
    """Profile of every turn, see :mod:`sims.physics.turn_profiles`."""
    peak_rate_rad_s: Positive = 2.0
    turn_duration_s: tuple[TurnDuration, TurnDuration] | None = None
    """Shortest and longest duration; each is drawn with uniform logarithm. Replaces peak_rate_rad_s."""
    dwell_s: Positive = 5.0
    settle_s: NonNegative = 0.0

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.turns is None) == (self.rotations_deg is None):
            raise ValueError("give either turns or rotations_deg")
        if self.smallest_turn_deg > self.largest_turn_deg:
            raise ValueError("smallest_turn_deg is above largest_turn_deg")
        if self.turn_duration_s is not None and self.turn_duration_s[0] > self.turn_duration_s[1]:
            raise ValueError("turn_duration_s has the longest turn first: give [shortest, longest]")
        if self.turn_duration_s is not None and "peak_rate_rad_s" in self.model_fields_set:
            raise ValueError("give either peak_rate_rad_s or turn_duration_s")
        return self


class ProtocolConfig(TomlTable):
    """A protocol (:mod:`srt.recording.protocol`), on the fixture of the scenario or without one."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)

    source: str = Field(alias="from")
    """Name of a shipped protocol, or path of a TOML file."""
    total_time_s: Positive | None = None
    """Duration of the test; the rests of the protocol are scaled to it."""
    placement_sigma_deg: NonNegative = 1.0
    """Without a fixture: standard deviation of the inclination, about each axis, of each pose that is placed."""
    turn_sigma_deg: NonNegative = 0.5
    """Without a fixture: standard deviation of the angle of each turn; stated rates have the protocol's own."""
    settle_s: NonNegative = 0.2

    def protocol(self) -> Protocol:
        """Protocol with its rests for the total time."""
        found = load_protocol(self.source)
        return found if self.total_time_s is None else found.lasting(self.total_time_s)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        try:
            self.protocol()
        except InputError as error:
            raise ValueError(str(error)) from error
        return self


class RecordingConfig(TomlTable):
    """Recording of the samples."""

    sample_rate_hz: Positive = 200.0
    kind: Literal["rate", "increment"] = "rate"
    format: Literal["csv", "parquet", "npz", "h5"] = "csv"
    start_time_s: Finite = 0.0
    noise: Flag = True
    """False: no noise, drift, quantization, range or g-sensitivity, whatever the grade says."""
    state_noise: Flag = True
    """False: the recording does not state the noise figures."""
    label_sequences: Flag = True
    serial: str | None = None


class Scenario(TomlTable):
    """Complete scenario of one simulation."""

    description: str = ""
    seed: Annotated[int, Field(strict=True, ge=0)] = 1
    motion_seed: Annotated[int, Field(strict=True, ge=0)] | None = None
    """Seed of the motion: the fixture's errors and the unit's orientation on it. Scenarios of several units can share
    it; by default these are drawn with ``seed``."""
    imu: ImuConfig
    site: SiteConfig
    fixture: FixtureConfig | None = None
    errors: ErrorsConfig = ErrorsConfig()
    schedule: ScheduleConfig | None = None
    free: FreeConfig | None = None
    protocol: ProtocolConfig | None = None
    recording: RecordingConfig = RecordingConfig()

    @model_validator(mode="after")
    def _fixture_or_free(self) -> Self:
        if sum(part is not None for part in (self.schedule, self.free, self.protocol)) != 1:
            raise ValueError("give one of a [schedule] for the fixture, a [free] recording, and a [protocol]")
        if self.schedule is not None and self.fixture is None:
            raise ValueError("a [schedule] needs a [fixture] to run on")
        if self.free is not None and self.fixture is not None:
            raise ValueError("a [free] recording has no [fixture]: remove that table")
        return self


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Read a scenario by its name in the library or by the path of a TOML file.

    Raises
    ------
    InputError
        In one sentence: what was found, where, what was expected, and what to do.
    """
    path = library.find("scenario", name_or_path)
    return scenario_from_dict(library.read_toml(path), name=path.name, near=path.parent)


def scenario_from_dict(tables: dict[str, Any], *, name: str = "scenario", near: Path | None = None) -> Scenario:
    """Build a scenario from tables as TOML gives them, with ``from`` resolved.

    Parameters
    ----------
    tables : dict
    name : str
        Name of the scenario in error messages.
    near : Path, optional
        Folder that relative paths in ``from`` start from.
    """
    return validated(Scenario, library.resolved(tables, name=name, near=near), name)
