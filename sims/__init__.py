"""Simulator of the rotation test: fixture, IMU and scenarios, with the truth of every sample.

It shares no mathematics with the estimators: data from the model under test would prove nothing. From :mod:`srt` it
takes only the names of the sensor errors, the recording type and constants.

Two levels::

    simulation = sims.simulate(sims.load_scenario("demo"))              # from a configuration

    motion = sims.table1_motion(site=site, fixture_draw=draw)           # true integrals, reusable
    recording = sims.read_out(motion, errors, imu, rng, kind="rate")    # one unit's samples of it

Conventions are those of :mod:`srt`: B body (MARS) frame, NED, specific force at rest up, SI units inside,
``C_ab`` takes b-components to a-components.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sims.physics.fixture import FixtureDraw, draw_fixture, rotation
from sims.physics.free_motion import free_motion, random_attitude, random_turns
from sims.physics.imu import ImuModel, read_out
from sims.physics.motion import RateProfile
from sims.physics.sequences import TABLE_1, TurnSequence, table_sequences
from sims.physics.table_motion import Schedule, run_schedule, table1_motion
from sims.physics.true_motion import TrueMotion
from sims.scenarios.library import configs_path
from srt.exceptions import MissingExtraError

if TYPE_CHECKING:
    from sims.accuracy.budget import budget
    from sims.robustness.campaign import load_campaign
    from sims.robustness.run import run_campaign
    from sims.scenarios.plan_file import load_plan_file
    from sims.scenarios.scenario import Scenario, load_scenario, scenario_from_dict
    from sims.scenarios.simulation import Simulation, draw_errors, simulate

_NEEDS_PYDANTIC = {
    "Scenario": "scenarios.scenario",
    "budget": "accuracy.budget",
    "load_campaign": "robustness.campaign",
    "run_campaign": "robustness.run",
    "load_plan_file": "scenarios.plan_file",
    "load_scenario": "scenarios.scenario",
    "scenario_from_dict": "scenarios.scenario",
    "Simulation": "scenarios.simulation",
    "draw_errors": "scenarios.simulation",
    "simulate": "scenarios.simulation",
}
"""Names loaded on first use: the physics works without the extra 'sims'."""

__all__ = [
    "TABLE_1",
    "FixtureDraw",
    "ImuModel",
    "RateProfile",
    "Scenario",
    "Schedule",
    "Simulation",
    "TrueMotion",
    "TurnSequence",
    "budget",
    "configs_path",
    "draw_errors",
    "draw_fixture",
    "free_motion",
    "load_campaign",
    "load_plan_file",
    "load_scenario",
    "random_attitude",
    "random_turns",
    "read_out",
    "rotation",
    "run_campaign",
    "run_schedule",
    "scenario_from_dict",
    "simulate",
    "table1_motion",
    "table_sequences",
]


def __getattr__(name: str) -> Any:
    if name not in _NEEDS_PYDANTIC:
        raise AttributeError(f"module 'sims' has no attribute {name!r}")
    try:
        value = getattr(import_module(f"sims.{_NEEDS_PYDANTIC[name]}"), name)
    except ModuleNotFoundError as error:
        if error.name != "pydantic":
            raise
        raise MissingExtraError("pydantic", "sims", "A simulation scenario") from error
    globals()[name] = value
    return value
