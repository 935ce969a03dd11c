"""Injection of single faults of a stated severity into simulated recordings, to test the diagnosis.

Each injection models the physical cause of a fault, independently of the check that detects the fault. The modules
``logger``, ``execution`` and ``site_and_drift`` register injections when imported.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Self

import numpy as np

from sims.scenarios.scenario import Scenario, scenario_from_dict
from sims.scenarios.simulation import Simulation, simulate
from srt.estimation.options import Options
from srt.exceptions import InputError
from srt.recording.recording import Recording

GRADES: Final = ("navigation-rlg", "tactical-fog", "industrial-mems", "consumer-mems")
"""Names of the unit configurations, best first."""


@dataclass(frozen=True)
class Case:
    """One unit on the 1 mrad fixture, run through the 17 sequences; the recording is simulated on first use.

    Attributes
    ----------
    grade : str
    seed : int
    changes : mapping
        Changes of the scenario relative to the standard test, by section: ``{"schedule": {"dwell_s": 5.0}}``.
    """

    grade: str
    seed: int
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @cached_property
    def scenario(self) -> Scenario:
        """Scenario with labels, 100 Hz, windows of 10 s, rotations at 1 rad/s; increments for the two best grades."""
        increments = self.grade in ("navigation-rlg", "tactical-fog")
        values: dict[str, dict[str, Any]] = {
            "imu": {"from": self.grade},
            "fixture": {"from": "lab-1mrad"},
            "site": {"from": "latitude-45"},
            "schedule": {"dwell_s": 10.0, "rate_rad_s": 1.0, "acceleration_rad_s2": 10.0, "settle_s": 0.2},
            "recording": {"sample_rate_hz": 100.0, "kind": "increment" if increments else "rate"},
        }
        for section, keys in self.changes.items():
            values[section] = {**values.get(section, {}), **keys}
        return scenario_from_dict({"seed": self.seed, **values})

    @cached_property
    def simulation(self) -> Simulation:
        """Simulation with true sensor errors and true motion."""
        return simulate(self.scenario)

    @property
    def recording(self) -> Recording:
        """Recording without the fault."""
        return self.simulation.recording

    def changed(self, **sections: Mapping[str, Any]) -> Self:
        """Case with the same unit and changes of the test, by section as in ``changes``."""
        merged = {name: dict(keys) for name, keys in self.changes.items()}
        for name, keys in sections.items():
            merged[name] = {**merged.get(name, {}), **keys}
        return type(self)(self.grade, self.seed, merged)


Apply = Callable[[Case, float, np.random.Generator], "Recording"]


@dataclass(frozen=True, slots=True)
class Injection:
    """Injection of one fault.

    Attributes
    ----------
    fault : str
        Name in the catalogue of faults.
    apply : callable
        Function of a case, a severity and a random generator; returns the recording with the fault. It raises
        InputError if the construction of the recording detects the fault.
    severity : mapping of str to float
        Stated severity by grade. In a grade that is not a key, the fault is not detectable.
    unit : str
        Unit of the severity.
    options : Options or None
        Options of the calibration, for a fault in the options.
    unseen : mapping of str to str
        Reasons why the fault is not detectable, by grade.
    causes : tuple of str
        Names of the catalogue that are correct findings.
    """

    fault: str
    apply: Apply
    severity: Mapping[str, float]
    unit: str
    options: Options | None = None
    unseen: Mapping[str, str] = field(default_factory=dict)
    causes: tuple[str, ...] = ()

    def recording(self, case: Case, severity: float | None = None) -> Recording:
        """Recording of a case with the fault; the random numbers depend on the seed of the case and on the fault."""
        rng = np.random.default_rng([case.seed, *self.fault.encode()])
        return self.apply(case, self.severity[case.grade] if severity is None else severity, rng)


@dataclass(frozen=True)
class FaultyCase(Case):
    """Case whose recording already has a fault, to inject a second one.

    Attributes
    ----------
    faulty : Recording or None
        Recording with the first fault.
    """

    faulty: Recording | None = None

    @property
    def recording(self) -> Recording:
        """Recording with the first fault."""
        assert self.faulty is not None
        return self.faulty


INJECTIONS: Final[dict[str, Injection]] = {}
"""Injections by fault of the catalogue, one for each fault."""
VARIANTS: Final[dict[str, Injection]] = {}
"""Further injections by name: faults in a form other than that of the catalogue, and pairs of faults."""


def injection(
    fault: str,
    severity: float | Mapping[str, float],
    unit: str,
    *,
    options: Options | None = None,
    unseen: Mapping[str, str] | None = None,
    also: tuple[str, ...] = (),
) -> Callable[[Apply], Apply]:
    """Register the injection of a fault; a single severity applies to all grades in which the fault is detectable.

    ``also`` are further correct findings, for smaller severities: a factor of 2 is a wrong count value, but a factor of
    1.5 is not.
    """
    missing = dict(unseen or {})
    by_grade = severity if isinstance(severity, Mapping) else dict.fromkeys(GRADES, severity)
    by_grade = {grade: by_grade[grade] for grade in GRADES if grade in by_grade and grade not in missing}

    def register(apply: Apply) -> Apply:
        if fault in INJECTIONS:
            raise InputError(f"The fault {fault!r} has two injections, but one is expected: remove one of them.")
        INJECTIONS[fault] = Injection(fault, apply, by_grade, unit, options, missing, (fault, *also))
        return apply

    return register


def variant(kind: str, severity: float, unit: str, *causes: str) -> Callable[[Apply], Apply]:
    """Register a further injection; ``causes`` are the names of the catalogue that are correct findings for it."""

    def register(apply: Apply) -> Apply:
        if kind in VARIANTS or kind in INJECTIONS:
            raise InputError(f"The name {kind!r} has two injections, but one is expected: rename one of them.")
        VARIANTS[kind] = Injection(kind, apply, dict.fromkeys(GRADES, severity), unit, causes=causes)
        return apply

    return register
