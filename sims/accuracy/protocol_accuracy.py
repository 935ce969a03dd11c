"""Expected accuracy of a protocol for the unit, site and fixture of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import srt
from sims.scenarios.scenario import ErrorsConfig, ProtocolConfig, Scenario
from sims.scenarios.simulation import simulate
from srt.exceptions import InputError
from srt.recording.protocol import load_protocol

if TYPE_CHECKING:
    from sims.scenarios.plan_file import PlanFile
    from srt.types import Array

_SEED = 1


@dataclass(frozen=True, slots=True, eq=False)
class ProtocolAccuracy:
    """Expected sigma of the sensor errors.

    Attributes
    ----------
    name : str
    on_fixture : bool
        False: the fixture cannot run the protocol, which is then run without one.
    sigma : ndarray, shape (27,), SI
        Infinite where not observed.
    """

    name: str
    on_fixture: bool
    sigma: Array


def protocol_accuracy(name: str, plan: PlanFile, total_s: float) -> ProtocolAccuracy:
    """Sigma that least squares reports for one simulated run of this length, of a unit without errors.

    Raises
    ------
    InputError
        An unknown protocol, or one whose turns alone last longer.
    """
    protocol = load_protocol(name).lasting(total_s)
    stated = any(step.stated_rate_rad_s is not None for step in protocol.steps)
    try:
        protocol.on_fixture()
        on_fixture = not stated
    except InputError:
        on_fixture = False
    scenario = Scenario(
        seed=_SEED,
        imu=plan.imu,
        site=plan.site,
        fixture=plan.fixture if on_fixture else None,
        errors=ErrorsConfig(draw="none"),
        protocol=ProtocolConfig.model_validate({"from": name, "total_time_s": total_s}),
        recording=plan.recording,
    )
    found = srt.calibrate(simulate(scenario).recording, "least-squares", checks=False)
    return ProtocolAccuracy(name, on_fixture, np.where(found.observed, found.sigma, np.inf))
