"""Accuracy budget of a scenario: predicted sigma of every parameter by source.

The covariance of the estimator on a recording of the scenario gives the parts of noise, quantization, bias instability,
alignment times the Earth's rate, and gravity. Unmodelled effects are simulated separately, without noise: g-sensitivity
one element at a time, and the fixture's errors by draws, minus the part that the alignment explains. Some effects are
reported but not counted: those that the first iteration removes, and that of an unmeasured gyro bias.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import srt
from sims.physics.imu import ImuModel, read_out
from sims.scenarios.simulation import simulate
from srt.exceptions import DataError, InputError
from srt.sensor_errors import N_PARAMETERS, NAMES, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from sims.scenarios.scenario import Scenario
    from sims.scenarios.simulation import Simulation
    from srt.estimation.options import GyroBias
    from srt.recording.recording import Recording
    from srt.result.calibration import Calibration
    from srt.types import Array

    Progress = Callable[[int, int], None]

G_SENSITIVITY: Final = "g_sensitivity"
FIXTURE: Final = "fixture"
NOT_COUNTED: Final = {
    "earth_rate_before_iteration": "Earth rate times sensor errors, before the first iteration",
    "second_order_before_iteration": "products of errors, fixture's and unit's, before it",
    "gyro_bias_if_not_measured": "the unit's gyro bias, were it not measured in the windows",
}
"""Effects that are reported but not included in the total, with their descriptions."""
_CALIBRATED: Final = ("converged", "partial", "inconsistent")
"""Status of a calibration that ended at a solution. Residuals that contradict it, as those of gyros with a bias that
depends on specific force do, are no obstacle: the budget shows their effect."""
_PERFECT: Final = {
    f"{name}_sigma_mrad": 0.0 for name in ("level", "north", "mounting", "non_orthogonality", "rotation", "wobble")
}


@dataclass(frozen=True, slots=True, eq=False)
class Budget:
    """Predicted accuracy of one estimator on a scenario.

    Attributes
    ----------
    sources : dict of str to ndarray, shape (27,)
        One sigma of every parameter by source, SI; NaN where the parameter is not estimated.
    not_counted : dict of str to ndarray, shape (27,)
        Size of the effects in :data:`NOT_COUNTED`.
    """

    estimator: str
    sources: dict[str, Array]
    not_counted: dict[str, Array]

    @property
    def total(self) -> Array:
        """Standard deviation of every parameter from all sources, shape (27,), SI."""
        return np.asarray(np.sqrt(np.sum([s**2 for s in self.sources.values()], axis=0)))

    @property
    def limiting(self) -> tuple[str | None, ...]:
        """Largest source of every parameter; None for parameters that are not estimated."""
        names, sizes = list(self.sources), np.array(list(self.sources.values()))
        largest = np.argmax(np.nan_to_num(sizes), axis=0)
        seen = np.isfinite(self.total)
        return tuple(names[k] if known else None for k, known in zip(largest.tolist(), seen.tolist(), strict=True))

    def as_dict(self) -> dict[str, Any]:
        """JSON values in SI units; null for parameters that are not estimated."""

        def plain(values: Array) -> dict[str, float | None]:
            return {n: None if np.isnan(v) else float(v) for n, v in zip(NAMES, values, strict=True)}

        return {
            "format": "srt-budget",
            "version": 1,
            "estimator": self.estimator,
            "sources": {name: plain(values) for name, values in self.sources.items()},
            "total": plain(self.total),
            "not_counted": {name: plain(values) for name, values in self.not_counted.items()},
        }


def budget(
    scenario: Scenario,
    estimators: Sequence[str] = ("closed-form",),
    *,
    draws: int = 30,
    gyro_bias: GyroBias = "auto",
    progress: Progress | None = None,
) -> tuple[Budget, ...]:
    """Predict the accuracy of a scenario on the fixture.

    Parameters
    ----------
    scenario : Scenario
        Its seed draws the unit's errors, and the fixture's draws.
    estimators : sequence of str
        Names in the registry.
    draws : int
        Number of draws of the fixture's errors; their rms is known to 1 / √(2 draws).
    gyro_bias : str
        How all calibrations take the gyro bias, as in :class:`srt.Options`.
    progress : callable, optional
        Called with the numbers of finished and of all calibrations.

    Returns
    -------
    tuple of Budget
        One for each estimator.

    Raises
    ------
    InputError
        A free scenario: without a fixture nothing is known of the motion beforehand.
    DataError
        A calibration that does not converge even without noise.
    """
    if scenario.schedule is None or scenario.fixture is None:
        raise InputError("A budget needs a scenario with a [fixture] and a [schedule]: a free recording has no plan.")
    count = _Counted(progress, len(estimators) * (2 * draws + 15), gyro_bias)
    rig = _Rig(scenario, draws)
    return tuple(_budget(name, rig, count) for name in estimators)


class _Counted:
    """Calibration with a report of the progress."""

    def __init__(self, progress: Progress | None, size: int, gyro_bias: GyroBias) -> None:
        self._progress, self._size, self._done, self._gyro_bias = progress, size, 0, gyro_bias

    def __call__(self, recording: Recording, estimator: str, **choices: Any) -> Calibration:
        found = srt.calibrate(recording, estimator, gyro_bias=self._gyro_bias, checks=False, **choices)
        if "max_playbacks" not in choices and found.status not in _CALIBRATED:
            raise DataError(f"A recording of the scenario does not calibrate: {found.message}")
        self.step()
        return found

    def step(self, number: int = 1) -> None:
        self._done += number
        if self._progress is not None:
            self._progress(min(self._done, self._size), self._size)


class _Rig:
    """Recordings of a scenario: with all noise; and without noise, on a fixture with fewer errors."""

    def __init__(self, scenario: Scenario, draws: int) -> None:
        self.scenario, self.draws = scenario, draws
        assert scenario.fixture is not None
        quiet = scenario.recording.model_copy(update={"noise": False, "label_sequences": True})
        figures: dict[str, Any] = scenario.imu.noise.si()
        self.model = ImuModel(**figures)
        self._quiet = scenario.model_copy(update={"recording": quiet})
        perfect = scenario.fixture.model_copy(update=_PERFECT)
        labelled = scenario.recording.model_copy(update={"label_sequences": True})
        whole = scenario.model_copy(update={"recording": labelled})
        self.noisy = simulate(whole).recording
        noise = scenario.imu.noise.model_copy(update={"gyro_g_sensitivity_deg_per_h_per_g": 0.0})
        imu = scenario.imu.model_copy(update={"noise": noise})
        self.insensitive = simulate(whole.model_copy(update={"imu": imu})).recording
        self._still_earth = scenario.site.model_copy(update={"earth_rate": False, "state_latitude": False})
        # The true gravity is the stated one: its uncertainty is a separate source.
        self.still = simulate(self._quiet.model_copy(update={"fixture": perfect}))

    def sensed(self, simulation: Simulation, imu: ImuModel | None = None) -> Recording:
        """Noise-free recording that states the noise of the scenario."""
        recording = read_out(simulation.motion, simulation.truth, imu, kind=self.scenario.recording.kind)
        return replace(recording, noise=self.model.stated(), site=simulation.recording.site)

    def fixtures(self, *, earth: bool) -> list[Simulation]:
        """The unit on newly drawn fixtures; without ``earth``, the Earth does not rotate and no latitude is stated."""
        site = self.scenario.site if earth else self._still_earth
        out = []
        for k in range(self.draws):
            # The unit is that of the scenario; only the fixture is drawn again.
            drawn = self._quiet.model_copy(update={"seed": self.scenario.seed + 1 + k, "site": site})
            values = self.still.truth.as_dict()
            errors = self.scenario.errors.model_copy(update={"draw": "none", "values": values})
            out.append(simulate(drawn.model_copy(update={"errors": errors})))
        return out

    def standing(self) -> Simulation:
        """The unit on a perfect fixture on an Earth that does not rotate."""
        return simulate(self.still.scenario.model_copy(update={"site": self._still_earth}))


def _of_sources(found: Calibration) -> dict[str, Array]:
    """Sigma by source of a calibration, shape (27,), without the factor by which residuals enlarge all of them.

    The effect behind that factor, as a bias that depends on specific force, is a source of its own.
    """
    return {name: sizes / (found.noise.sigma_inflation or 1.0) for name, sizes in found.contributions.items()}


def _budget(estimator: str, rig: _Rig, calibrate: _Counted) -> Budget:
    truth = rig.still.truth.vector
    noisy = calibrate(rig.noisy, estimator)
    seen = noisy.observed

    def shown(values: Array) -> Array:
        return np.where(seen, values, np.nan)

    contributions = _of_sources(noisy)
    # With a bias that changes with the pose, the estimator uses one bias per sequence, which adds noise. That scatter
    # is not bias instability, and g-sensitivity has a separate row.
    drifting = _of_sources(calibrate(rig.insensitive, estimator))
    contributions |= {name: sizes for name, sizes in drifting.items() if name == "gyro_bias_instability"}
    sources = {name: shown(sizes) for name, sizes in contributions.items() if np.any(sizes > 0.0)}
    plain = calibrate(rig.sensed(rig.still), estimator)
    size = rig.scenario.imu.noise.g_sensitivity_sigma
    if size > 0.0 and rig.scenario.recording.noise:
        squares = np.zeros(N_PARAMETERS)
        for element in np.ndindex(3, 3):
            G = np.zeros((3, 3))
            G[element] = size
            found = calibrate(rig.sensed(rig.still, ImuModel(gyro_g_sensitivity=G)), estimator)
            squares += (found.errors.vector - plain.errors.vector) ** 2
        sources[G_SENSITIVITY] = shown(np.sqrt(squares))
    else:
        calibrate.step(9)
    after, before = np.zeros(N_PARAMETERS), np.zeros(N_PARAMETERS)
    once = {"max_playbacks": 1, "start": SensorErrors(), "step": "coefficients"}
    for simulation in rig.fixtures(earth=True):
        after += (calibrate(rig.sensed(simulation), estimator).errors.vector - plain.errors.vector) ** 2
    for simulation in rig.fixtures(earth=False):
        before += (calibrate(rig.sensed(simulation), "closed-form", **once).errors.vector - truth) ** 2
    explained = contributions.get("earth_rate_alignment", np.zeros(N_PARAMETERS)) ** 2
    sources[FIXTURE] = shown(np.sqrt(np.maximum(after / rig.draws - explained, 0.0)))
    first = calibrate(rig.sensed(rig.still), "closed-form", **once).errors.vector
    alone = calibrate(rig.sensed(rig.standing()), "closed-form", **once).errors.vector
    # The gyro bias is fixed at zero; the final status of this iteration is irrelevant.
    held = {"hold": ("gyro_bias",), "start": SensorErrors(), "max_playbacks": 20}
    unmeasured = calibrate(rig.sensed(rig.still), estimator, **held).errors.vector
    return Budget(
        estimator,
        sources,
        {
            "earth_rate_before_iteration": shown(np.abs(first - alone)),
            "second_order_before_iteration": shown(np.sqrt(before / rig.draws)),
            "gyro_bias_if_not_measured": shown(np.abs(unmeasured - plain.errors.vector)),
        },
    )
