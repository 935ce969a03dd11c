"""Plan files: targets, unit, fixture and limits of a test to plan; and plans as scenarios to simulate.

Tables of a plan file::

    [imu] [fixture] [site]   as in a scenario: noise of the unit, errors of the fixture, place
    [stand]      what the fixture can do: rate_rad_s, acceleration_rad_s2, settle_s, pause_s, and for each axis
                 [stand.inner], [stand.outer]: travel_deg, or turns = false with positions_deg and set_s
    [targets]    one sigma wanted: of groups by the keys of [imu.errors], of single parameters in
                 [targets.parameters] by name, SI
    [plan]       total_time_s (absent: the shortest test that meets the targets), shortest_window_s,
                 longest_window_s, largest_turn_deg, most_legs, most_sequences,
                 longest_test_h
    [recording]  as in a scenario, for the simulation of the plan
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping  # noqa: TC003 - pydantic reads it
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from sims.scenarios import library
from sims.scenarios.scenario import (
    CustomSequence,
    ErrorSizes,
    Finite,
    FixtureConfig,
    Flag,
    ImuConfig,
    NonNegative,
    Positive,
    RecordingConfig,
    Scenario,
    ScheduleConfig,
    SiteConfig,
)
from sims.scenarios.toml_table import TomlTable, validated
from srt.constants import DEG
from srt.exceptions import InputError
from srt.planning.conditions import Conditions
from srt.planning.fixture_kinematics import AxisKinematics, FixtureKinematics
from srt.planning.plan import PlanLimits
from srt.planning.task import PlanTask
from srt.sensor_errors import GROUP_SLICES, INDEX, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from pathlib import Path

    from srt.planning.plan import Plan
    from srt.types import Array

_Count = Annotated[int, Field(strict=True, ge=1)]


class AxisConfig(TomlTable):
    """Freedom of one axis of the fixture."""

    travel_deg: tuple[Finite, Finite] | None = None
    """Limits of the angle; if absent, slip rings allow any angle."""
    turns: Flag = True
    """False: the axis is set by hand between sequences, to one of ``positions_deg``."""
    positions_deg: tuple[Finite, ...] = (0.0,)
    set_s: NonNegative = 0.0
    """Time to set the axis by hand."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = self.model_fields_set
        if self.turns and given & {"positions_deg", "set_s"}:
            raise ValueError("positions_deg and set_s are for an axis that is set by hand: add turns = false")
        if not self.turns and self.travel_deg is not None:
            raise ValueError("an axis with turns = false has no travel_deg: give its positions_deg")
        return self


class StandConfig(TomlTable):
    """Capabilities of the fixture."""

    rate_rad_s: Positive = 1.0
    acceleration_rad_s2: Positive = 10.0
    settle_s: NonNegative = 0.0
    pause_s: NonNegative = 1.0
    inner: AxisConfig = AxisConfig()
    outer: AxisConfig = AxisConfig()

    def kinematics(self) -> FixtureKinematics:
        """Give the fixture's freedom in the planner's terms."""

        def axis(config: AxisConfig) -> AxisKinematics:
            return AxisKinematics(
                self.rate_rad_s, self.acceleration_rad_s2, config.travel_deg, config.turns, config.positions_deg,
                config.set_s,
            )  # fmt: skip

        return FixtureKinematics(axis(self.inner), axis(self.outer), self.settle_s, self.pause_s)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        try:
            self.kinematics()
        except InputError as error:
            raise ValueError(str(error)) from error
        return self


class TargetsConfig(TomlTable):
    """Target sigma by group; an absent key means no target."""

    gyro_scale_ppm: Positive | None = None
    gyro_asymmetry_ppm: Positive | None = None
    gyro_orthogonality_urad: Positive | None = None
    accel_bias_ug: Positive | None = None
    accel_scale_ppm: Positive | None = None
    accel_asymmetry_ppm: Positive | None = None
    accel_misalignment_urad: Positive | None = None
    gyro_bias_deg_per_h: Positive | None = None
    parameters: Mapping[str, Positive] = Field(default_factory=dict)
    """Target sigma of single parameters by name, SI; it precedes that of the group."""

    @model_validator(mode="after")
    def _known_names(self) -> Self:
        for name in self.parameters:
            if name not in NAMES:
                near = difflib.get_close_matches(name, NAMES, 1)
                hint = f"write {near[0]!r}" if near else f"the names are those of a calibration, as {NAMES[0]!r}"
                raise ValueError(f"there is no sensor error named {name!r}: {hint}")
        if not self.model_fields_set:
            raise ValueError("there is no target: give the target sigma of at least one group")
        return self

    def sigma(self) -> Array:
        """Target sigma of every parameter, SI, NaN without a target, shape (27,)."""
        groups = self.model_dump(exclude={"parameters"}, exclude_none=True)
        sizes = ErrorSizes(**groups).si()
        wanted = np.full(N_PARAMETERS, math.nan)
        for name, part in GROUP_SLICES.items():
            if sizes[name] > 0.0:
                wanted[part] = sizes[name]
        for name, value in self.parameters.items():
            wanted[INDEX[name]] = value
        return wanted


class PlanOptions(TomlTable):
    """Limits of the test: total time, windows, rotations and sequences."""

    total_time_s: Positive | None = None
    shortest_window_s: Positive = 5.0
    longest_window_s: Positive = 60.0
    largest_turn_deg: Annotated[int, Field(strict=True, ge=90)] = 1080
    most_legs: _Count = 8
    longest_test_h: Positive = 8.0
    most_sequences: _Count = 40
    moves: Literal["recorded", "skipped"] = "skipped"
    """Moves between the sequences: recorded for an estimator that uses them, or skipped."""

    def limits(self) -> PlanLimits:
        """Limits as the planner takes them."""
        return PlanLimits(
            self.shortest_window_s, self.longest_window_s, self.largest_turn_deg, self.most_legs,
            self.longest_test_h * 3600.0, self.most_sequences,
        )  # fmt: skip

    @model_validator(mode="after")
    def _possible(self) -> Self:
        try:
            self.limits()
        except InputError as error:
            raise ValueError(str(error)) from error
        return self


class PlanFile(TomlTable):
    """Complete plan file."""

    description: str = ""
    imu: ImuConfig
    site: SiteConfig
    fixture: FixtureConfig
    stand: StandConfig = StandConfig()
    targets: TargetsConfig
    plan: PlanOptions = PlanOptions()
    recording: RecordingConfig = RecordingConfig()

    def task(self) -> PlanTask:
        """Task for the planner."""
        return PlanTask(
            self.stand.kinematics(), self.conditions(), self.targets.sigma(), self.plan.total_time_s, self.plan.limits()
        )

    def conditions(self) -> Conditions:
        """Noise of the unit, site and fixture in the planner's terms."""
        noise, site = self.imu.noise.si(), self.site.site()
        pulse = math.sqrt(12.0)
        assert site.latitude_rad is not None
        return Conditions(
            gyro_white=noise["gyro_noise"],
            accel_white=noise["accel_noise"],
            gyro_edge=noise["gyro_quantization"] / pulse,
            accel_edge=noise["accel_quantization"] / pulse,
            gyro_instability=noise["gyro_bias_instability"],
            accel_instability=noise["accel_bias_instability"],
            **({} if self.plan.total_time_s is None else {"test_s": self.plan.total_time_s}),
            latitude_rad=site.latitude_rad,
            heading_rad=self.fixture.heading_deg * DEG,
            gravity_m_s2=site.gravity_m_s2,
            gravity_sigma_m_s2=site.gravity_sigma_m_s2,
            alignment_sigma_rad=self.fixture.north_sigma_mrad * 1e-3,
            rotation_sigma_rad=self.fixture.rotation_sigma_mrad * 1e-3,
        )

    def scenario(self, plan: Plan, *, seed: int = 1) -> Scenario:
        """Scenario of a plan, for ``srt simulate``.

        The sequences have the ids ``p01``, ``p02`` and so on, in the order of execution.
        """
        custom = {
            f"p{number:02d}": CustomSequence.model_validate(
                {
                    "id": f"p{number:02d}",
                    "down": c.down,
                    "along_outer": c.along_outer,
                    "rotations": tuple((axis, float(turn)) for axis, turn in c.rotations),
                }
            )
            for number, c in enumerate(plan.candidates, start=1)
        }
        schedule = ScheduleConfig(
            sequences=tuple(custom),
            custom=tuple(custom.values()),
            dwells_s=tuple((round(float(a), 3), round(float(b), 3)) for a, b in plan.windows_s),
            settle_s=self.stand.settle_s,
            pause_s=self.stand.pause_s,
            moves=self.plan.moves,
            rate_rad_s=self.stand.rate_rad_s,
            acceleration_rad_s2=self.stand.acceleration_rad_s2,
        )
        return Scenario(
            description=f"Plan of {len(custom)} sequences, {plan.total_s:.0f} s",
            seed=seed,
            imu=self.imu,
            site=self.site,
            fixture=self.fixture,
            schedule=schedule,
            recording=self.recording,
        )


def load_plan_file(name_or_path: str | Path) -> PlanFile:
    """Read a plan file by its name in the library or by the path of a TOML file.

    Raises
    ------
    InputError
        In one sentence: what was found, where, what was expected, and what to do.
    """
    path = library.find("plan", name_or_path)
    return plan_file_from_dict(library.read_toml(path), name=path.name, near=path.parent)


def plan_file_from_dict(tables: dict[str, Any], *, name: str = "plan", near: Path | None = None) -> PlanFile:
    """Build a plan file from tables as TOML gives them, with ``from`` resolved; see :func:`load_plan_file`."""
    return validated(PlanFile, library.resolved(tables, name=name, near=near), name)


def scenario_toml(scenario: Scenario) -> str:
    """Write a scenario as TOML."""
    import tomli_w

    return tomli_w.dumps(scenario.model_dump(mode="json", exclude_none=True))
