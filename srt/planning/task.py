"""Planning of a test for a fixture, the noise of a unit and target sigmas."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from srt.exceptions import InputError
from srt.planning.plan import Plan, PlanLimits
from srt.planning.planner import make_plan
from srt.sensor_errors import INDEX, N_PARAMETERS, expand_names

if TYPE_CHECKING:
    from collections.abc import Callable

    from srt.planning.conditions import Conditions
    from srt.planning.fixture_kinematics import FixtureKinematics
    from srt.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class PlanTask:
    """Task for the planner.

    Attributes
    ----------
    targets : ndarray, shape (27,), or mapping of str to float, SI
        Target sigma of every parameter, NaN for none; or of parameters and groups by name.
    total_s : float or None
        Length of the test, s; None: the shortest that meets the targets.
    """

    fixture: FixtureKinematics
    conditions: Conditions
    targets: Array | Mapping[str, float]
    total_s: float | None = None
    limits: PlanLimits = field(default_factory=PlanLimits)


class PlanFileLike(Protocol):
    """File of a plan that gives its task, as ``sims.load_plan_file`` reads it."""

    def task(self) -> PlanTask:
        """Task of the file."""


def plan(
    task: PlanTask | PlanFileLike,
    *,
    total_time_s: float | None = None,
    progress: Callable[[str, int, float], None] | None = None,
) -> Plan:
    """Plan a rotation test.

    Parameters
    ----------
    task : PlanTask, or the plan file that ``sims.load_plan_file`` gives
    total_time_s : float, optional
        Length of the test, s, instead of that of the task.
    progress : callable, optional
        As for :func:`srt.planning.planner.make_plan`.

    Raises
    ------
    InputError
        Another object, or a task that is not complete.
    DataError
        A target that the fixture cannot observe, or that no test reaches.
    """
    chosen: Any = task if isinstance(task, PlanTask) else getattr(task, "task", lambda: None)()
    if not isinstance(chosen, PlanTask):
        raise InputError(
            f"A plan needs a task, and a {type(task).__name__} was given: read the plan file by "
            "sims.load_plan_file(...), or make a srt.planning.task.PlanTask."
        )
    if total_time_s is not None:
        chosen = replace(chosen, total_s=total_time_s)
    return make_plan(
        chosen.fixture,
        chosen.conditions,
        _target_vector(chosen.targets),
        total_s=chosen.total_s,
        limits=chosen.limits,
        progress=progress,
    )


def _target_vector(targets: Array | Mapping[str, float]) -> Array:
    """Target sigma of every parameter, shape (27,), NaN for none; a parameter's own precedes its group's."""
    if not isinstance(targets, Mapping):
        return np.asarray(targets, dtype=np.float64)
    wanted = np.full(N_PARAMETERS, math.nan)
    for name in sorted(targets, key=lambda name: name in INDEX):
        wanted[[INDEX[each] for each in expand_names([name])]] = targets[name]
    return wanted
