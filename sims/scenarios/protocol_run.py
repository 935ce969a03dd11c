"""Runs of a protocol: on the fixture of a scenario, or without one."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sims.physics.fixture import draw_fixture, rotation
from sims.physics.free_motion import Placement, Turn, placed_motion
from sims.physics.motion import RateProfile
from sims.physics.sequences import TABLE_1, TurnSequence
from sims.physics.table_motion import Schedule, run_schedule
from sims.physics.turn_profiles import trapezoid
from sims.scenarios.scenario import MRAD
from srt.constants import DEG
from srt.exceptions import InputError
from srt.ranking import rounded
from srt.recording.recording import Fixture, SequenceLabel

if TYPE_CHECKING:
    from sims.physics.true_motion import TrueMotion
    from sims.scenarios.scenario import ProtocolConfig, Scenario
    from srt.recording.protocol import Protocol, Step
    from srt.types import Array


def protocol_run(
    scenario: Scenario, U: Array, for_fixture: np.random.Generator, for_motion: np.random.Generator
) -> TrueMotion:
    """Execute the protocol of a scenario: on its fixture, if it has one.

    Raises
    ------
    InputError
        A step that the fixture cannot execute: which, and why.
    """
    assert scenario.protocol is not None
    protocol = scenario.protocol.protocol()
    if scenario.fixture is None:
        return _free_run(scenario, scenario.protocol, protocol, for_motion)
    return table_run(scenario, _schedule(protocol, scenario.protocol.settle_s), U, for_fixture)


def _schedule(protocol: Protocol, settle_s: float) -> Schedule:
    """Schedule of the fixture; all turns have the rate of the first, and a pose is two adjoining windows."""
    sequences: list[TurnSequence] = []
    dwells: list[tuple[float, float]] = []
    continued, waiting = set[int](), 0.0
    executed = protocol.on_fixture()
    for number, (step, (down, outer, rotations)) in enumerate(zip(protocol.steps, executed, strict=True)):
        if step.stated_rate_rad_s is not None:
            raise InputError(
                f"Step {step.number} of protocol {protocol.name!r} runs at a stated rate, which the two-axis fixture "
                "does not state: leave [fixture] out."
            )
        if _begins_chain(protocol, number):
            waiting = step.rest_s[1]  # the start window of the next step
            continue
        turns = tuple((axis, angle / DEG) for axis, angle in rotations)
        table = TABLE_1.get(step.id or "")
        sequences.append(table or TurnSequence(f"step {step.number}" if turns else None, down, outer, turns))
        half = 0.5 * step.rest_s[1]
        if step.down is None and not protocol.steps[number - 1].pose:
            continued.add(len(dwells))
        before = waiting if step.down is None else step.rest_s[0]
        dwells.append((before, step.rest_s[1]) if turns else (half, half))
    turning = next((step for step in protocol.steps if not step.pose), protocol.steps[0])
    profile = RateProfile(turning.rate_rad_s, turning.acceleration_rad_s2)
    return Schedule(
        tuple(sequences),
        profile,
        settle_s=settle_s,
        dwells_s=tuple(dwells),
        pause_s=protocol.place_s,
        continued=frozenset(continued),
    )


def table_run(scenario: Scenario, schedule: Schedule, U: Array, rng: np.random.Generator) -> TrueMotion:
    """Run a schedule on the fixture of a scenario, with drawn errors of the fixture."""
    assert scenario.fixture is not None
    fixture = scenario.fixture
    return run_schedule(
        schedule,
        site=scenario.site.site(),
        sample_rate_hz=scenario.recording.sample_rate_hz,
        heading_rad=fixture.heading_deg * DEG,
        fixture_draw=draw_fixture(rng, schedule.sequences, **fixture.draw_sizes()),
        U=U,
        stated_fixture=Fixture(
            fixture.heading_deg * DEG if fixture.state_heading else None,
            fixture.stated_alignment_sigma_mrad * MRAD,
            fixture.stated_rotation_sigma_mrad * MRAD,
            None if fixture.stated_wobble_sigma_mrad is None else fixture.stated_wobble_sigma_mrad * MRAD,
        ),
        earth_rate=scenario.site.earth_rate,
        start_time_s=scenario.recording.start_time_s,
    )


def _free_run(scenario: Scenario, config: ProtocolConfig, protocol: Protocol, rng: np.random.Generator) -> TrueMotion:
    """Run a protocol without a fixture: poses as a hand places them, at any heading."""
    table_error = float(rng.standard_normal()) * (protocol.rate_sigma or 0.0)
    placements: list[Placement] = []
    for step in protocol.steps:
        legs = tuple(
            _turn(step, axis, angle, duration, config, table_error, rng)
            for (axis, angle), duration in zip(step.rotations, step.durations_s(), strict=True)
        )
        if step.down is not None:
            attitude = _placed(step.down, config.placement_sigma_deg * DEG, rng)
            placements.append(Placement(attitude, step.rest_s[0] if legs else step.rest_s[1]))
        if legs:
            last = placements[-1]
            placements[-1] = replace(last, steps=(*last.steps, legs), rests_s=(*last.rests_s, step.rest_s[1]))
    motion, starts_s = placed_motion(
        tuple(placements),
        site=scenario.site.site(),
        pause_s=protocol.place_s,
        settle_s=config.settle_s,
        sample_rate_hz=scenario.recording.sample_rate_hz,
        earth_rate=scenario.site.earth_rate,
        start_time_s=scenario.recording.start_time_s,
        rng=rng,
    )
    steps = [step for number, step in enumerate(protocol.steps) if not _begins_chain(protocol, number)]
    labels = (
        _label(step, protocol.rate_sigma, pair, start)
        for step, pair, start in zip(steps, motion.windows, starts_s, strict=True)
    )
    return replace(motion, labels=tuple(labels))


def _begins_chain(protocol: Protocol, number: int) -> bool:
    """True for a pose that the next step continues from: it is the window before that step's turn."""
    following = protocol.steps[number + 1 : number + 2]
    return protocol.steps[number].pose and bool(following) and following[0].down is None


def _turn(
    step: Step,
    axis: Array,
    angle: float,
    duration_s: float,
    config: ProtocolConfig,
    table_error: float,
    rng: np.random.Generator,
) -> Turn:
    """One rotation as it is executed."""
    if step.stated_rate_rad_s is not None:
        angle *= 1.0 + table_error
    else:
        angle += float(rng.standard_normal()) * config.turn_sigma_deg * DEG
    if step.turn_s is not None:
        return Turn(axis * angle, duration_s, "raised-cosine")
    ramp = min(0.5, step.rate_rad_s / step.acceleration_rad_s2 / duration_s)
    return Turn(axis * angle, duration_s, trapezoid(ramp))


def _label(
    step: Step, rate_sigma: float | None, pair: tuple[tuple[float, float], tuple[float, float]], start_s: float
) -> SequenceLabel:
    if step.pose:
        return SequenceLabel.of_pose((pair[0][0], pair[1][1]))
    if step.stated_rate_rad_s is None:
        return SequenceLabel(*pair)
    ramp = step.rate_rad_s / step.acceleration_rad_s2
    steady = start_s + ramp, start_s + step.durations_s()[0] - ramp
    axis = "xyz"[int(np.argmax(np.abs(step.rotations[0][0])))]
    sense = float(np.sign(step.rotations[0][0].sum()))
    return SequenceLabel(*pair, rate=(axis, sense * step.stated_rate_rad_s), rate_sigma=rate_sigma, steady_s=steady)


def _placed(down: Array, sigma_rad: float, rng: np.random.Generator) -> Array:
    """C_NED,B of a pose with a given vertical, inclined by a hand, at a random heading."""
    first = np.cross(down, np.eye(3)[int(np.argmin(rounded(np.abs(down))))])
    first /= np.linalg.norm(first)
    level = np.stack([first, np.cross(down, first), down])
    heading = rotation([0.0, 0.0, rng.uniform(0.0, 2.0 * math.pi)])
    tilt = rotation(np.array([*rng.standard_normal(2), 0.0]) * sigma_rad)
    return np.asarray(heading @ tilt @ level)
