"""One trial of a campaign: simulate a unit, calibrate it with every estimator, and compare with the truth."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import srt
from sims.physics.imu import is_imu
from sims.robustness.campaign import drawn_prior
from sims.scenarios.simulation import simulate
from srt.closed_form.estimator import UnitEstimate, estimate_units
from srt.constants import STANDARD_GRAVITY_M_S2
from srt.estimation.registry import automatic_estimator
from srt.exceptions import SrtError
from srt.model.platform_steps import many_recordings
from srt.result.calibration import Calibration
from srt.result.verdict import USABLE
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sims.robustness.campaign import Campaign, EstimatorChoice
    from sims.scenarios.simulation import Simulation
    from srt.estimation.options import Options
    from srt.recording.recording import Recording
    from srt.sensor_errors import SensorErrors

    Row = dict[str, Any]
    Found = Calibration | UnitEstimate

OUTCOMES: Final = {
    "converged": "the estimator reports convergence, and its result equals the one reached from the true errors",
    "wrong_minimum": "the estimator reports convergence, but to another result",
    "not_converged": "the estimator reports that it did not converge",
    "inconsistent": "the estimator reports that the measurements contradict its result",
    "outside_model": "the estimator reports that its estimate is no possible unit",
    "crashed": "the estimator raised an unexpected error: a defect of the estimator",
    "refused": "the estimator stopped with an error message on the input",
    "unverified": "the estimator reports convergence, but the start from the true errors did not converge: there is no "
    "reference result; counted as not converged",
    "no_imu": "the drawn errors are too large for a possible IMU; excluded from every rate",
}
"""Outcomes of a trial and their meaning; the last one is excluded from every rate."""

_EXACT: Final = np.full(N_PARAMETERS, 1e-8)
_EXACT[GROUP_SLICES["accel_bias"]] *= STANDARD_GRAVITY_M_S2
"""Tolerance of equal results if sigmas are below rounding errors: 1e-8; accelerometer bias: 1e-8 g."""
_DISTANCE_SIGMAS: Final = 0.01
"""Tolerance of equal results, sigma."""
_UNIT: Final = _EXACT / _EXACT.min()
"""Units in which errors are compared, SI: 1, 1 rad, 1 rad/s, and 1 g for accelerometer biases."""
UNIQUE_WITHIN: Final = 1e-3
"""Distance of a result from the true errors, in ``_UNIT``, below which it can be no other fixed point.

A correction c of 1e-3 to 1e-2 is followed by one of at most 30 c² (63 units of ±0.1 to ±50 %, three grades and none).
So the derivative of the measurements changes by less than itself within 1/30 of the truth, and the equations have one
solution there. The limit is a thirtieth of that.
"""
SAMPLED: Final = 10
"""Every so many trials the fixed point is computed in any case: an estimator that stops too early is noticed."""
TOGETHER: Final = ("closed-form",)
"""Estimators of which a batch is calibrated as arrays."""
_NEWTON: Final = ("closed-form",)
"""Estimators to which this applies. A filter that passes over the data once, or a robust loss, depends on its start."""


def run_trial(campaign: Campaign, task: tuple[int, int]) -> list[Row]:
    """Simulate one unit and calibrate it with every estimator of the campaign.

    Parameters
    ----------
    campaign : Campaign
    task : (int, int)
        Point of the grid, and number of the trial there.

    Returns
    -------
    list of dict
        One row for each estimator: the columns of :mod:`sims.robustness.result_folder`.
    """
    return run_batch(campaign, (task,))[0]


def run_batch(campaign: Campaign, tasks: Sequence[tuple[int, int]]) -> list[list[Row]]:
    """Rows of :func:`run_trial` of several trials, of which the closed form iterates those of one motion as arrays.

    The draws of a trial are its own, so that its numbers depend on the other trials of the batch by rounding alone.
    """
    # Overflow far from a solution is expected: the outcome of the trial records the failure.
    with np.errstate(all="ignore"), many_recordings(campaign.size):
        return _run(campaign, tasks)


def _run(campaign: Campaign, tasks: Sequence[tuple[int, int]]) -> list[list[Row]]:
    """Simulate the units of a batch, then calibrate all of them with each estimator."""
    rows: list[Row] = []
    simulations: list[Simulation] = []
    for point, number in tasks:
        began = time.thread_time()
        scenario, values = campaign.unit(point, number)
        simulation = simulate(scenario)
        row = {"point": point, "replicate": number, "seed": scenario.seed, **values}
        row |= {f"truth_{name}": value for name, value in simulation.truth.as_dict().items()}
        row["simulate_s"] = time.thread_time() - began
        rows.append(row)
        simulations.append(simulation)
    possible = [u for u, simulation in enumerate(simulations) if is_imu(simulation.truth)]
    sampled = [tasks[u][1] % SAMPLED == 0 for u in possible]
    out = [[row | {"estimator": e.label, "outcome": "no_imu"} for e in campaign.estimators] for row in rows]
    for column, choice in enumerate(campaign.estimators):
        own = [simulations[u] for u in possible]
        for u, found in zip(possible, scores(own, choice, sampled, fixed_point=campaign.fixed_point), strict=True):
            out[u][column] = rows[u] | found
    for simulation in simulations:
        simulation.recording.forget()
    return out


def score(simulation: Simulation, choice: EstimatorChoice, *, fixed_point: bool, sampled: bool = True) -> Row:
    """:func:`scores` of one simulation."""
    return scores([simulation], choice, [sampled], fixed_point=fixed_point)[0]


def scores(
    simulations: Sequence[Simulation], choice: EstimatorChoice, sampled: Sequence[bool], *, fixed_point: bool
) -> list[Row]:
    """Calibrate with one estimator; compare with the truth and with the fixed point reached from the truth.

    Parameters
    ----------
    simulations : sequence of Simulation
    choice : EstimatorChoice
    sampled : sequence of bool
        False: the fixed point is computed only if the result may be another one; else its distance is not known.
    fixed_point : bool
        True: compare with the fixed point. False: the reported status is not verified.

    Returns
    -------
    list of dict
        The columns of a row that depend on the estimator, for each simulation.
    """
    given = [_options(choice, simulation, at_truth=choice.from_truth) for simulation in simulations]
    recordings = [simulation.recording for simulation in simulations]
    # Few units are compared in any case: as arrays with the others, they cost no calls of their own.
    together = fixed_point and not choice.from_truth and choice.name in TOGETHER
    known = [u for u, own in enumerate(sampled) if own and together]
    at_truth = [_options(choice, simulations[u], at_truth=True) for u in known]
    both = _calibrated([*recordings, *(recordings[u] for u in known)], choice.name, [*given, *at_truth])
    results, references = both[: len(given)], dict(zip(known, both[len(given) :], strict=True))
    rows = [
        _score(choice, found, simulation.truth, spent)
        for simulation, (found, spent) in zip(simulations, results, strict=True)
    ]
    if not fixed_point:
        return rows
    to_compare: list[int] = []
    for u, ((found, _), simulation) in enumerate(zip(results, simulations, strict=True)):
        if isinstance(found, Exception) or found.status not in USABLE:
            continue
        if choice.from_truth:
            rows[u]["distance"] = 0.0
        elif not sampled[u] and is_unique(found, simulation.truth):
            rows[u]["distance"] = None
        else:
            to_compare.append(u)
    left = [u for u in to_compare if u not in references]
    at_truth = [_options(choice, simulations[u], at_truth=True) for u in left]
    references |= zip(left, _calibrated([recordings[u] for u in left], choice.name, at_truth), strict=True)
    for u in to_compare:
        found, reference = results[u][0], references[u][0]
        assert not isinstance(found, Exception)
        if isinstance(reference, Exception):  # any failure leaves no reference result
            rows[u]["message"] = f"{found.message} From the true errors: {reference}"
        if isinstance(reference, Exception) or reference.status not in USABLE:
            rows[u]["outcome"] = "unverified"
        else:
            rows[u]["distance"] = distance(found, reference)
            rows[u]["outcome"] = "converged" if rows[u]["distance"] <= 1.0 else "wrong_minimum"
    return rows


def _options(choice: EstimatorChoice, simulation: Simulation, *, at_truth: bool) -> Options:
    """Options of an estimator for one simulation, with its prior, from the given start or from the true errors."""
    changes: dict[str, Any] = {"start": simulation.truth} if at_truth else {}
    if choice.drawn_prior:
        changes["prior"] = drawn_prior(simulation.scenario)
    return replace(choice.options, **changes) if changes else choice.options


def _calibrated(
    recordings: Sequence[Recording], name: str, options: Sequence[Options]
) -> list[tuple[Found | Exception, float]]:
    """Calibration of each recording, or what is raised instead, and its CPU time, s; closed forms as arrays."""
    began = time.thread_time()
    if name in ("auto", *TOGETHER) and all(automatic_estimator(r) in TOGETHER for r in recordings):
        results = estimate_units(recordings, options)
        spent = (time.thread_time() - began) / max(len(results), 1)
        return [(found, spent) for found in results]
    out: list[tuple[Found | Exception, float]] = []
    for recording, chosen in zip(recordings, options, strict=True):
        began = time.thread_time()
        found: Found | Exception
        try:
            found = srt.calibrate(recording, name, options=chosen, checks=False)
        except Exception as error:  # a defect is an outcome: the other trials continue
            found = error
        out.append((found, time.thread_time() - began))
    return out


def _score(choice: EstimatorChoice, found: Found | Exception, truth: SensorErrors, spent: float) -> Row:
    """Columns of one result before it is compared with the fixed point."""
    if isinstance(found, SrtError):
        return _without_result(choice, "refused", str(found), spent)
    if isinstance(found, Exception):
        return _without_result(choice, "crashed", f"{type(found).__name__}: {found}", spent)
    innovations = (found.diagnostics.filter or ()) if isinstance(found, Calibration) else ()
    return {
        "estimator": choice.label,
        "status": found.status,
        "message": found.message,
        "outcome": "converged" if found.status in USABLE else found.status,
        "playbacks": len(found.corrections),
        "calibrate_s": spent,
        # Normalised innovations of a filter, over their degrees of freedom, in the order of time
        "nis": [row.nis / row.degrees_of_freedom for row in innovations],
        **errors_of(found, truth),
    }


def _without_result(choice: EstimatorChoice, outcome: str, message: str, spent: float) -> Row:
    return {"estimator": choice.label, "outcome": outcome, "message": message, "calibrate_s": spent}


def errors_of(found: Found, truth: SensorErrors) -> Row:
    """Errors, sigmas and NEES of the observed parameters; NaN for the others."""
    seen = found.observed
    difference = np.where(seen, found.errors.vector - truth.vector, np.nan)
    sigma = np.where(seen, found.sigma, np.nan)
    row: Row = {"observed": int(seen.sum()), "nees": np.nan, "largest": np.nan}
    if seen.any():
        scaled = difference[seen] / sigma[seen]
        correlation = found.covariance[np.ix_(seen, seen)] / np.outer(sigma[seen], sigma[seen])
        row["nees"] = float(scaled @ np.linalg.solve(correlation, scaled))
        row["largest"] = float(np.abs(scaled).max())
    for stem, vector in (("error", difference), ("sigma", sigma)):
        row |= {f"{stem}_{name}": value for name, value in zip(NAMES, vector.tolist(), strict=True)}
    return row


def is_unique(found: Found, truth: SensorErrors) -> bool:
    """True if a converged result is so close to the true errors that an iteration from there ends at the same one.

    A parameter that is not observed keeps its start value, which differs between the two.
    """
    difference = np.abs(found.errors.vector - truth.vector) / _UNIT
    return found.estimator in _NEWTON and bool(found.observed.all() and np.all(difference < UNIQUE_WITHIN))


def distance(found: Found, reference: Found) -> float:
    """Largest difference of two results over their tolerance, max(1e-8, 0.01 sigma), of the parameters both observe."""
    seen = found.observed & reference.observed
    if not seen.any():
        return 0.0
    difference = np.abs(found.errors.vector - reference.errors.vector)
    return float(np.max((difference / np.maximum(_EXACT, _DISTANCE_SIGMAS * found.sigma))[seen]))
