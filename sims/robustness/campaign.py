"""Campaign files: units to simulate and estimators to run on them, as TOML, checked before anything runs.

Tables of a campaign::

    [campaign]   name, description, seed, trials (of every point of the grid), fixed_point, trials_per_motion
    [scenario]   as for ``srt simulate``; from = "name" takes one of the library, with these keys laid over it
    [grid]       key = [values]: every combination of the lists is a point
    [random]     key = {low, high, log} or {choices}: drawn anew for every trial
    [[estimator]]  name, label, start, prior = "drawn" (distribution of the drawn errors), and any other option

A key is one of :data:`AXES`, each of which sets several keys of a scenario by one number, or a dotted key of the
scenario, as ``schedule.dwell_s``. A unit and its recording depend only on the seed, the point and the number of the
trial: every estimator gets the same recording, and one trial can be repeated without the others.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from pydantic import Field

from sims.physics.sequences import TABLE_1
from sims.scenarios import library
from sims.scenarios.scenario import Finite, Flag, Scenario, scenario_from_dict
from sims.scenarios.toml_table import TomlTable, validated
from srt.estimation.options import Options
from srt.estimation.registry import find_estimator
from srt.exceptions import InputError, did_you_mean
from srt.model.prior import Prior
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

Value = float | int | str | bool
STARTS: Final = ("truth", "unguided")
"""Starts that only campaigns have: true errors, and zero without the stages of the option "zero"."""


@dataclass(frozen=True, slots=True)
class AxisDefinition:
    """Quantity that a campaign can vary, stated as one number or word.

    Attributes
    ----------
    keys : tuple of str
        Keys of the scenario that it sets.
    factor : float
        Conversion from the unit of the axis to that of the scenario. For sensor errors the value is the half width of a
        uniform distribution or the sigma of a normal one.
    error : bool
        True for a size of sensor errors.
    text : str
        Description.
    kind : type
        float, int or str.
    """

    keys: tuple[str, ...]
    factor: float
    text: str
    error: bool = False
    kind: type = float


AXES: Final[Mapping[str, AxisDefinition]] = {
    "scale_percent": AxisDefinition(
        ("imu.errors.gyro_scale_ppm", "imu.errors.accel_scale_ppm"), 1e4, "scale factors", True
    ),
    "misalignment_mrad": AxisDefinition(
        ("imu.errors.gyro_orthogonality_urad", "imu.errors.accel_misalignment_urad"),
        1e3,
        "angles between gyros, and of accelerometers to the body axes",
        True,
    ),
    "matrix_percent": AxisDefinition(
        (
            "imu.errors.gyro_scale_ppm",
            "imu.errors.accel_scale_ppm",
            "imu.errors.gyro_orthogonality_urad",
            "imu.errors.accel_misalignment_urad",
        ),
        1e4,
        "scale factors, %, and angles between axes, hundredths of a radian",
        True,
    ),
    "asymmetry_ppm": AxisDefinition(
        ("imu.errors.gyro_asymmetry_ppm", "imu.errors.accel_asymmetry_ppm"), 1.0, "scale-factor asymmetries", True
    ),
    "gyro_asymmetry_ppm": AxisDefinition(("imu.errors.gyro_asymmetry_ppm",), 1.0, "of the gyros alone", True),
    "accel_bias_mg": AxisDefinition(("imu.errors.accel_bias_ug",), 1e3, "accelerometer biases", True),
    "gyro_bias_deg_s": AxisDefinition(("imu.errors.gyro_bias_deg_per_h",), 3600.0, "gyro biases", True),
    "fixture_mrad": AxisDefinition(
        (
            "fixture.level_sigma_mrad",
            "fixture.north_sigma_mrad",
            "fixture.mounting_sigma_mrad",
            "fixture.non_orthogonality_sigma_mrad",
            "fixture.rotation_sigma_mrad",
            "fixture.stated_alignment_sigma_mrad",
            "fixture.stated_rotation_sigma_mrad",
        ),
        1.0,
        "levelling, north, mounting, axes and rotations of the fixture, true and stated",
    ),
    "grade": AxisDefinition(("imu",), 1.0, "grade of the unit: a name of configs/imu", kind=str),
    "missing_sequences": AxisDefinition((), 1.0, "sequences left out, chosen at random", kind=int),
    "repeated_sequences": AxisDefinition((), 1.0, "sequences run twice, chosen at random", kind=int),
}


class CampaignTable(TomlTable):
    """Table [campaign]."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    description: str = ""
    seed: Annotated[int, Field(strict=True, ge=0)]
    trials: Annotated[int, Field(strict=True, ge=1)]
    """Trials of every point of the grid."""
    fixed_point: Flag = True
    """True: where a result is not close to the truth, also iterate from the true errors, to detect wrong minima; False:
    the status is not verified."""
    trials_per_motion: Annotated[int, Field(strict=True, ge=1)] = 1
    """Number of successive trials of all points that run through one motion, with one draw of the fixture's errors."""


class RandomTable(TomlTable):
    """Distribution from which every trial draws a quantity."""

    low: Finite | None = None
    high: Finite | None = None
    log: Flag = False
    """True: the logarithm is uniform between the bounds."""
    choices: Annotated[tuple[Value, ...], Field(min_length=1)] | None = None

    def model_post_init(self, _context: object) -> None:
        """Require either bounds or choices."""
        bounds = self.low is not None and self.high is not None
        if bounds == (self.choices is not None) or (self.low is None) != (self.high is None):
            raise ValueError("give either low and high, or choices")
        if self.low is not None and self.high is not None:
            if self.low > self.high:
                raise ValueError("low is above high")
            if self.log and self.low <= 0.0:
                raise ValueError("log needs a low above 0")

    def draw(self, rng: np.random.Generator) -> Value:
        """Draw one value."""
        if self.choices is not None:
            return self.choices[int(rng.integers(len(self.choices)))]
        assert self.low is not None
        assert self.high is not None
        if self.log:
            return math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        return float(rng.uniform(self.low, self.high))

    def __str__(self) -> str:
        if self.choices is not None:
            return "one of " + ", ".join(map(str, self.choices))
        return f"{self.low:g} to {self.high:g}" + (", log" if self.log else "")


class _CampaignFile(TomlTable):
    campaign: CampaignTable
    scenario: dict[str, Any]
    grid: dict[str, Annotated[tuple[Value, ...], Field(min_length=1)]] = Field(default_factory=dict)
    random: dict[str, RandomTable] = Field(default_factory=dict)
    estimator: Annotated[tuple[dict[str, Any], ...], Field(min_length=1)]


@dataclass(frozen=True, slots=True)
class EstimatorChoice:
    """Estimator and its options.

    Attributes
    ----------
    label : str
        Name in the results.
    name : str
        Name in the registry, or "auto".
    options : Options
    from_truth : bool
        True: start at the true errors.
    drawn_prior : bool
        True: the prior is the distribution from which the campaign draws the errors.
    """

    label: str
    name: str
    options: Options
    from_truth: bool = False
    drawn_prior: bool = False


@dataclass(frozen=True)
class Campaign:
    """Campaign after validation.

    Attributes
    ----------
    name, description : str
    seed, trials : int
    fixed_point : bool
    trials_per_motion : int
    scenario : dict
        Tables of the scenario common to all trials, ``from`` resolved.
    grid : dict of str to tuple
    random : dict of str to RandomTable
    estimators : tuple of EstimatorChoice
    text : str
        Content of the file.
    """

    name: str
    description: str
    seed: int
    trials: int
    fixed_point: bool
    trials_per_motion: int
    scenario: dict[str, Any]
    grid: dict[str, tuple[Value, ...]]
    random: dict[str, RandomTable]
    estimators: tuple[EstimatorChoice, ...]
    text: str = field(default="", repr=False)

    @cached_property
    def points(self) -> tuple[dict[str, Value], ...]:
        """Values of the grid's axes at every point, the last axis fastest."""
        return tuple(dict(zip(self.grid, values, strict=True)) for values in itertools.product(*self.grid.values()))

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of all axes: those of the grid, then the random ones."""
        return (*self.grid, *self.random)

    @property
    def tasks(self) -> Iterator[tuple[int, int]]:
        """Point and number of every trial: all trials of a motion, point by point, before those of the next.

        So a partial run covers the grid, and a motion that the point does not change is computed once.
        """
        trials, size = range(self.trials), self.trials_per_motion
        blocks = (trials[first : first + size] for first in trials[::size])
        return ((point, k) for block in blocks for point in range(len(self.points)) for k in block)

    @property
    def size(self) -> int:
        """Number of trials."""
        return len(self.points) * self.trials

    @property
    def noisy(self) -> bool:
        """True if the recordings have noise. Without noise a sigma is a floor and unrelated to the error."""
        varied = self.grid.get("recording.noise", ())
        fixed = Scenario.model_fields["recording"].get_default()
        return bool(self.scenario.get("recording", {}).get("noise", fixed.noise)) and False not in varied

    @cached_property
    def digest(self) -> str:
        """Hash of all settings that the numbers of a trial depend on; the number of trials is not one of them."""
        parts = {
            "seed": self.seed,
            "scenario": self.scenario,
            "grid": self.grid,
            "random": {key: table.model_dump() for key, table in self.random.items()},
            "fixed_point": self.fixed_point,
            "estimators": [
                (e.label, e.name, e.options.as_dict(), e.from_truth, e.drawn_prior) for e in self.estimators
            ],
        }
        if self.trials_per_motion > 1:
            parts["trials_per_motion"] = self.trials_per_motion
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    def unit(self, point: int, trial: int) -> tuple[Scenario, dict[str, Value]]:
        """Scenario of one trial, and the values of all axes in it.

        Parameters
        ----------
        point, trial : int

        Raises
        ------
        InputError
            If a value is not valid in a scenario.
        """
        seeds = np.random.SeedSequence(self.seed, spawn_key=(point, trial))
        rng = np.random.default_rng(seeds.spawn(1)[0])
        drawn = {key: table.draw(rng) for key, table in self.random.items()}
        values = {**self.points[point], **drawn}
        tables = self.scenario
        for key, value in values.items():
            tables = library.overlay(tables, _set(key, value, tables))
        tables = _with_sequences(tables, values, rng)
        tables = {**tables, "seed": _number(seeds)}
        if self.trials_per_motion > 1:
            of_motion = np.random.SeedSequence(self.seed, spawn_key=(trial // self.trials_per_motion,))
            tables = {**tables, "motion_seed": _number(of_motion)}
        return scenario_from_dict(tables, name=f"{self.name}, point {point}"), values


def _number(seeds: np.random.SeedSequence) -> int:
    """Seed of 63 bits: what TOML can hold, so that a trial's scenario can be written down."""
    return int(seeds.generate_state(1, np.uint64)[0] >> np.uint64(1))


def load_campaign(path: str | Path) -> Campaign:
    """Read a campaign from a TOML file, or a name of configs/robustness, and check all of it.

    Raises
    ------
    InputError
        In one sentence: what was found, where, what was expected, and what to do.
    """
    file = library.find("robustness", path)
    tables = library.read_toml(file)
    read = validated(_CampaignFile, tables, file.name)
    estimators = tuple(_estimator(table, file.name) for table in read.estimator)
    labels = [e.label for e in estimators]
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise InputError(f"{file.name}: two estimators are labelled {twice!r}: give each a label of its own.")
    both = sorted(set(read.grid) & set(read.random))
    if both:
        raise InputError(f"{file.name}: {both[0]!r} is in [grid] and in [random]: keep one.")
    campaign = Campaign(
        **dict(read.campaign),
        scenario=_resolved(read.scenario, file),
        grid=dict(read.grid),
        random=dict(read.random),
        estimators=estimators,
        text=file.read_text(encoding="utf-8"),
    )
    for axis in campaign.axes:
        _check_axis(axis, campaign, file.name)
    for point in range(len(campaign.points)):  # find a bad value before the campaign runs
        try:
            scenario, _ = campaign.unit(point, 0)
            if any(e.drawn_prior for e in estimators):
                drawn_prior(scenario)
        except InputError as error:
            raise InputError(f"{file.name}: {error}") from None
    return campaign


def drawn_prior(scenario: Scenario) -> Prior:
    """Prior with mean zero and the standard deviations from which the errors of a scenario are drawn.

    Raises
    ------
    InputError
        If a group of errors is not drawn, as a prior needs a standard deviation above zero.
    """
    sizes, sigma = scenario.imu.errors.si(), np.zeros(N_PARAMETERS)
    for group, at in GROUP_SLICES.items():
        sigma[at] = scenario.errors.factor * sizes[group] * (scenario.errors.draw != "none")
        if not np.all(sigma[at] > 0.0):
            raise InputError(
                f'prior = "drawn" needs errors of every group, and {group} is not drawn: give its size in '
                "[scenario.imu.errors], or leave out the prior."
            )
    return Prior.from_sigma(sigma)


def _resolved(tables: dict[str, Any], file: Path) -> dict[str, Any]:
    """Tables of the scenario with those that ``from`` names below them, its sections' own ``from`` included."""
    own = {key: value for key, value in tables.items() if key != "from"}
    if "from" in tables:
        source = library.find("scenario", str(tables["from"]), near=file.parent)
        own = library.overlay(library.read_toml(source), own)
    own.setdefault("seed", 0)
    return library.resolved(own, name=file.name, near=file.parent)


def _estimator(table: dict[str, Any], name: str) -> EstimatorChoice:
    """One [[estimator]], its options checked as the library checks them."""
    options = {key: value for key, value in table.items() if key not in ("name", "label")}
    estimator, label = table.get("name"), table.get("label", table.get("name"))
    if not isinstance(estimator, str) or not isinstance(label, str):
        raise InputError(f'{name}: an [[estimator]] lacks its name, or it is no text: add name = "closed-form".')
    unknown = next((key for key in options if key not in Options.__dataclass_fields__), None)
    if unknown is not None:
        near = did_you_mean(unknown, Options.__dataclass_fields__)
        raise InputError(
            f"{name}: [[estimator]] {label!r} has an unknown option {unknown!r}{near}: the options are "
            f"{', '.join(Options.__dataclass_fields__)}."
        )
    from_truth, prior = options.get("start") == "truth", options.pop("prior", None)
    if prior not in (None, "drawn"):
        raise InputError(
            f'{name}: [[estimator]] {label!r} has the prior {prior!r}: give "drawn", the distribution of the drawn '
            "errors, or leave it out for the default."
        )
    if options.get("start") in STARTS:
        options["start"] = SensorErrors()
    try:
        if estimator != "auto":
            find_estimator(estimator)
        return EstimatorChoice(label, estimator, Options(**options), from_truth, prior == "drawn")
    except InputError as error:
        raise InputError(f"{name}: [[estimator]] {label!r}: {error}") from None


def _check_axis(key: str, campaign: Campaign, name: str) -> None:
    """Refuse an axis that is not a key of a scenario, or that would have no effect."""
    axis = AXES.get(key)
    if axis is None and "." not in key:
        raise InputError(
            f"{name}: there is nothing named {key!r} to vary{did_you_mean(key, AXES)}: the names are "
            f"{', '.join(AXES)}, or a key of a scenario with its table, as schedule.dwell_s."
        )
    if axis is not None and axis.error and campaign.scenario.get("errors", {}).get("draw") == "none":
        raise InputError(f'{name}: {key} has no effect while [scenario.errors] draw is "none": take "uniform".')
    values = campaign.grid.get(key, ())
    if axis is not None:
        wrong = next((v for v in values if not _is(v, axis.kind)), None)
        if wrong is not None:
            kind = {float: "a number", int: "a whole number", str: "a name in quotes"}[axis.kind]
            raise InputError(f"{name}: [grid] {key} has {wrong!r}: give {kind}.")


def _is(value: Value, kind: type) -> bool:
    return isinstance(value, (int, float) if kind is float else kind) and not isinstance(value, bool)


def _set(key: str, value: Value, tables: Mapping[str, Any]) -> dict[str, Any]:
    """Tables that set one axis in a scenario."""
    axis = AXES.get(key)
    if axis is None:
        return _nested(key, value)
    if key == "grade":
        grade = library.read_toml(library.find("imu", str(value)))
        # The grade changes only name and noise; the errors are those of the campaign.
        return {"imu": {k: grade[k] for k in ("name", "noise") if k in grade}}
    factor = axis.factor
    if axis.error:
        settings = tables.get("errors", {})
        if settings.get("draw", "normal") == "uniform":
            factor /= math.sqrt(3.0)  # a scenario states sigmas
        factor /= settings.get("factor", 1.0)
    out: dict[str, Any] = {}
    for name in axis.keys:
        out = library.overlay(out, _nested(name, float(value) * factor))
    return out


def _nested(key: str, value: Value) -> dict[str, Any]:
    table: Any = value
    for part in reversed(key.split(".")):
        table = {part: table}
    assert isinstance(table, dict)
    return table


def _with_sequences(tables: dict[str, Any], values: Mapping[str, Value], rng: np.random.Generator) -> dict[str, Any]:
    """Omit and repeat as many sequences as two axes state."""
    missing, repeated = (int(values.get(key, 0)) for key in ("missing_sequences", "repeated_sequences"))
    if not missing and not repeated:
        return tables
    schedule = tables.get("schedule", {})
    all_ids = list(schedule.get("sequences", TABLE_1))
    if not 0 <= missing < len(all_ids) or not 0 <= repeated <= len(all_ids) - missing:
        raise InputError(
            f"missing_sequences is {missing} and repeated_sequences {repeated}, of {len(all_ids)} sequences in all: "
            "leave one at least, and repeat no more than are left."
        )
    out = set(rng.choice(len(all_ids), missing, replace=False).tolist())
    left = [k for k in range(len(all_ids)) if k not in out]
    order = [*left, *(left[k] for k in rng.choice(len(left), repeated, replace=False).tolist())]
    changed = {"sequences": [all_ids[k] for k in order]}
    dwells = schedule.get("dwells_s")
    if isinstance(dwells, list) and len(dwells) == len(all_ids):  # else the scenario's own check refuses it
        changed["dwells_s"] = [dwells[k] for k in order]
    return library.overlay(tables, {"schedule": changed})
