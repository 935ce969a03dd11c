"""Expected accuracy of a protocol, and of a plan with recorded moves, for the unit, site and fixture of a plan file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import srt
from sims.physics.imu import ImuModel
from sims.scenarios.scenario import ErrorsConfig, ProtocolConfig, Scenario
from sims.scenarios.simulation import simulate
from srt.exceptions import InputError
from srt.recording.protocol import load_protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from sims.scenarios.plan_file import PlanFile
    from srt.planning.plan import Plan
    from srt.types import Array

_SEED: Final = 1
_SAMPLE_RATE_HZ: Final = 50.0
"""Highest sample rate of a recording that only gives a covariance: a noise-free rotation needs no more."""
_MOST_PLANS: Final = 3
"""Plans of one test with recorded moves; the gain by the moves hardly differs between the second and the third."""


@dataclass(frozen=True, slots=True, eq=False)
class ProtocolAccuracy:
    """Expected sigma of the sensor errors.

    Attributes
    ----------
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


def sigma_with_moves(file: PlanFile, plan: Plan, estimator: str = "least-squares") -> Array:
    """Expected sigma where the moves between the sequences of a plan are recorded.

    The covariance is that of a noise-free simulated run for which the unit's noise is stated.

    Parameters
    ----------
    estimator : str
        Name of one that uses the moves.

    Returns
    -------
    ndarray, shape (27,), SI
        Infinite where not observed.
    """
    scenario = file.scenario(plan)
    assert scenario.schedule is not None
    recorded = scenario.schedule.model_copy(update={"moves": "recorded"})
    quiet = scenario.recording.model_copy(
        update={
            "noise": False,
            "label_sequences": True,
            "sample_rate_hz": min(scenario.recording.sample_rate_hz, _SAMPLE_RATE_HZ),
        }
    )
    changes = {"errors": ErrorsConfig(draw="none"), "schedule": recorded, "recording": quiet}
    recording = simulate(scenario.model_copy(update=changes)).recording
    figures: dict[str, Any] = file.imu.noise.si()
    stated = replace(recording, noise=ImuModel(**figures).stated())
    found = srt.calibrate(stated, estimator, checks=False)
    return np.where(found.observed, found.sigma, np.inf)


def plan_with_moves(file: PlanFile, *, progress: Callable[[str, int, float], None] | None = None) -> Plan:
    """Plan a test whose moves between the sequences are recorded.

    The planner selects sequences by what they show alone. Its targets are divided by the share of every sigma that the
    moves leave, from the plan before, until the plan that the moves complete meets the targets.

    Parameters
    ----------
    progress : callable, optional
        As for :func:`srt.planning.planner.make_plan`.

    Returns
    -------
    Plan
        With ``with_moves``; the best of a given length, or the shortest that meets its targets.

    Raises
    ------
    InputError, DataError
        As for :func:`srt.plan`.
    """
    task = file.task()
    targets = file.targets.sigma()
    wanted, plans = targets, []
    for _ in range(_MOST_PLANS):
        made = srt.plan(replace(task, targets=wanted), progress=progress)
        sigma = sigma_with_moves(file, made)
        plans.append(replace(made, targets=targets, with_moves=sigma, bound=np.nan))
        if len(plans) > 1 and (task.total_s is not None or not plans[-1].unmet):
            break
        wanted = targets * made.prediction.sigma / np.where(np.isfinite(sigma), sigma, made.prediction.sigma)
    if task.total_s is not None:
        return min(plans, key=lambda plan: plan.ratio)
    return min(plans, key=lambda plan: (bool(plan.unmet), plan.total_s))
