"""Simulation of a scenario: a recording and its truth."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from sims.physics.fixture import rotation
from sims.physics.free_motion import free_motion, random_attitude, random_durations, random_turns
from sims.physics.imu import ImuModel, read_out
from sims.physics.motion import RateProfile
from sims.physics.table_motion import Schedule
from sims.scenarios.protocol_run import protocol_run, table_run
from sims.scenarios.scenario import MRAD
from srt.constants import DEG
from srt.exceptions import InputError
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from sims.physics.fixture import FixtureDraw
    from sims.physics.true_motion import TrueMotion
    from sims.scenarios.scenario import Scenario, ScheduleConfig
    from srt.recording.recording import Recording
    from srt.types import Array

TRUTH_FORMAT = "srt-truth"
TRUTH_VERSION = 1
_KEPT: Final = 4
"""Number of motions that are kept: those of some points of a grid, at 150 bytes a sample."""


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """Recording and true parameters.

    Attributes
    ----------
    recording : srt.recording.recording.Recording
    truth : srt.sensor_errors.SensorErrors
        In B.
    U : ndarray, shape (3, 3)
        Rotation from table-mounted components T to B.
    fixture_draw : FixtureDraw or None
        None for a free recording.
    imu : ImuModel
        IMU model used, with its noise and g-sensitivity.
    windows : tuple of ((start, end), (start, end))
        Stationary windows before and after each turn, s, whether or not the recording labels them.
    motion : TrueMotion
        True integrals; ``read_out`` makes of them a recording of the same motion with other errors.
    """

    recording: Recording
    truth: SensorErrors
    U: Array
    fixture_draw: FixtureDraw | None
    imu: ImuModel
    windows: tuple[tuple[tuple[float, float], tuple[float, float]], ...]
    motion: TrueMotion
    scenario: Scenario

    def truth_dict(self) -> dict[str, Any]:
        """Truth as plain values for JSON, SI units."""
        draw = self.fixture_draw
        return {
            "format": TRUTH_FORMAT,
            "version": TRUTH_VERSION,
            "parameters": self.truth.as_dict(),
            "frame": {"name": "MARS", "U": self.U.tolist()},
            "gyro_g_sensitivity": self.imu.gyro_g_sensitivity.tolist(),
            "fixture": None
            if draw is None
            else {
                "base": draw.base.tolist(),
                "mounting": draw.mounting.tolist(),
                "non_orthogonality": draw.non_orthogonality,
                "starts": None if draw.starts is None else draw.starts.tolist(),
                "legs": None if draw.legs is None else [e.tolist() for e in draw.legs],
                "wobble": None if draw.wobble is None else draw.wobble.tolist(),
            },
            "windows": [[list(first), list(second)] for first, second in self.windows],
            "seed": self.scenario.seed,
            "scenario": self.scenario.model_dump(mode="json"),
        }

    def write_truth(self, path: Path | str) -> None:
        """Write the truth as JSON, atomically."""
        target = Path(path)
        partial = target.with_name(target.name + ".part")
        try:
            partial.write_text(json.dumps(self.truth_dict(), indent=2, allow_nan=False) + "\n", encoding="utf-8")
            partial.replace(target)
        except OSError as error:
            raise InputError(f"The truth cannot be written to {target}: {error.strerror}.") from None
        finally:
            partial.unlink(missing_ok=True)


def draw_errors(
    rng: np.random.Generator,
    sizes: dict[str, float],
    *,
    distribution: str = "normal",
    values: dict[str, float] | None = None,
) -> SensorErrors:
    """Draw the 27 sensor errors.

    Parameters
    ----------
    sizes : dict
        Standard deviation by group name, SI; zero for absent groups.
    distribution : "normal", "uniform" or "none"
        Uniform: within ±√3 sigma, so that its standard deviation is the same.
    values : dict, optional
        Values by parameter name, SI; they replace drawn values.
    """
    drawn = np.zeros(N_PARAMETERS)
    for name, at in GROUP_SLICES.items():
        count = at.stop - at.start
        # Both are always drawn, so that a seed gives the same numbers for either distribution and if a group is
        # switched off.
        normal, uniform = rng.standard_normal(count), rng.uniform(-math.sqrt(3.0), math.sqrt(3.0), count)
        if distribution != "none":
            drawn[at] = sizes.get(name, 0.0) * (normal if distribution == "normal" else uniform)
    errors = SensorErrors(drawn)
    return SensorErrors.from_dict(errors.as_dict() | values) if values else errors


def simulate(scenario: Scenario, rng: np.random.Generator | None = None) -> Simulation:
    """Run a scenario.

    Parameters
    ----------
    rng : numpy.random.Generator, optional
        Default: a generator of the scenario's seed. Sensor errors, unit, fixture, motion and noise each
        draw from a child of their own, so that a change in one leaves the others' numbers alone. With a seed of its
        own, the motion does not draw from it.
    """
    generator = np.random.default_rng(scenario.seed) if rng is None else rng
    for_errors, for_unit, for_fixture, for_motion, for_noise = generator.spawn(5)
    sizes = {name: size * scenario.errors.factor for name, size in scenario.imu.errors.si().items()}
    truth = draw_errors(for_errors, sizes, distribution=scenario.errors.draw, values=scenario.errors.values)
    model = imu_model(scenario, for_unit)
    if scenario.motion_seed is None:
        motion = _motion(scenario, for_unit, for_fixture, for_motion)
    else:
        motion = _kept_motion(_MotionKey.of(scenario))
    stated = scenario.recording
    recording = read_out(
        motion, truth, model, for_noise, kind=stated.kind, state_noise=stated.state_noise, serial=stated.serial
    )
    if not stated.label_sequences:
        recording = recording.with_sequences(())
    if not scenario.site.state_latitude:
        recording = replace(recording, site=replace(recording.site, latitude_rad=None))
    return Simulation(recording, truth, motion.U, motion.draw, model, motion.windows, motion, scenario)


def _motion(
    scenario: Scenario, for_unit: np.random.Generator, for_fixture: np.random.Generator, for_motion: np.random.Generator
) -> TrueMotion:
    """Protocol, free recording or schedule of a scenario, executed; the unit's orientation on the table is drawn."""
    turn = np.array(scenario.imu.frame_turn_mrad) * MRAD
    turn = turn + for_unit.standard_normal(3) * scenario.imu.frame_turn_sigma_mrad * MRAD
    U = rotation(turn).T
    if scenario.protocol is not None:
        return protocol_run(scenario, U, for_fixture, for_motion)
    if scenario.free is not None:
        return _free_run(scenario, for_motion)
    assert scenario.schedule is not None
    return table_run(scenario, schedule_of(scenario.schedule), U, for_fixture)


@dataclass(frozen=True, slots=True)
class _MotionKey:
    """All that a motion with a seed of its own depends on."""

    seed: int
    tables: str
    scenario: Scenario = field(compare=False)

    @classmethod
    def of(cls, scenario: Scenario) -> _MotionKey:
        assert scenario.motion_seed is not None
        tables: dict[str, Any] = dict.fromkeys(("site", "fixture", "schedule", "free", "protocol"), True)
        tables["recording"] = {"sample_rate_hz", "start_time_s"}
        tables["imu"] = {"frame_turn_mrad", "frame_turn_sigma_mrad"}
        return cls(scenario.motion_seed, scenario.model_dump_json(include=tables), scenario)


@lru_cache(maxsize=_KEPT)
def _kept_motion(key: _MotionKey) -> TrueMotion:
    """Motion with a seed of its own; the last ones are kept, as a campaign reads them out for many units."""
    motion = _motion(key.scenario, *np.random.default_rng(key.seed).spawn(3))
    for values in (motion.time, motion.angle, motion.angle_abs, motion.velocity, motion.velocity_abs):
        values.flags.writeable = False  # all recordings of the motion have them in common
    return motion


def imu_model(scenario: Scenario, rng: np.random.Generator) -> ImuModel:
    """Noise model of the unit with a drawn g-sensitivity; a perfect IMU if the scenario has no noise."""
    noise = scenario.imu.noise
    g_sensitivity = rng.standard_normal((3, 3)) * noise.g_sensitivity_sigma
    if not scenario.recording.noise:
        return ImuModel()
    return ImuModel(**noise.si(), gyro_g_sensitivity=g_sensitivity)


def schedule_of(config: ScheduleConfig) -> Schedule:
    """Schedule in SI units from its configuration."""
    profile = RateProfile(
        config.rate_rad_s,
        config.acceleration_rad_s2,
        config.settling_amplitude_mrad * MRAD,
        config.settling_frequency_hz,
        config.settling_decay_s,
    )
    return Schedule(
        config.turn_sequences(),
        profile,
        dwell_s=config.dwell_s,
        leg_dwell_s=config.leg_dwell_s,
        settle_s=config.settle_s,
        moves=config.moves,
        pause_s=config.pause_s,
        dwells_s=None if config.dwells_s is None else config.dwells_s * config.repeats,
    )


def _free_run(scenario: Scenario, rng: np.random.Generator) -> TrueMotion:
    free = scenario.free
    assert free is not None
    attitude = random_attitude(rng)
    if free.rotations_deg is not None:
        turns = np.array(free.rotations_deg) * DEG
    else:
        assert free.turns is not None
        turns = random_turns(
            rng, free.turns, smallest_rad=free.smallest_turn_deg * DEG, largest_rad=free.largest_turn_deg * DEG
        )
    return free_motion(
        turns,
        site=scenario.site.site(),
        attitude=attitude,
        peak_rate_rad_s=free.peak_rate_rad_s,
        profile=free.profile,
        durations_s=None if free.turn_duration_s is None else random_durations(rng, len(turns), *free.turn_duration_s),
        rng=rng,
        dwell_s=free.dwell_s,
        settle_s=free.settle_s,
        sample_rate_hz=scenario.recording.sample_rate_hz,
        earth_rate=scenario.site.earth_rate,
        start_time_s=scenario.recording.start_time_s,
    )
