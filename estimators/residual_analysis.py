"""What the joint solution says of its measurements: residuals, every sequence against all others, noise left over."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import chdtrc

from srt.estimation.leave_one_out import (
    LEAST_PREDICTED_SHARE,
    ConsistencyTest,
    LeaveOneOutEstimate,
    SequenceDiagnostics,
    leave_one_out_estimate,
    most_contradicted,
    named,
)
from srt.noise.variance_components import restricted_likelihood
from srt.result.calibration import Residual
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Sequence as SequenceOf

    from estimators.dense_solution import DenseSolution
    from estimators.joint_model import JointModel
    from estimators.linear_system import LinearSystem
    from srt.types import Indices


_COMPONENTS: Final = {"force": "xyz", "rate": "xyz", "turn": "xyz"}
_INDEPENDENT: Final = 1e-10
_WITNESSED: Final = 0.05


def residuals(joint: JointModel, system: LinearSystem, solution: DenseSolution) -> tuple[Residual, ...]:
    """Residuals of force, rate and turn at the solution, each with the sigma it should have."""
    data = joint.data
    left = system.b + system.A @ solution.delta
    leverage = np.einsum("ij,ij->i", system.A @ solution.root, system.A @ solution.root)
    out = []
    for kind, axes in _COMPONENTS.items():
        rows = system.rows_of(kind)
        for member, index in enumerate(rows.index):
            k = int(rows.owner[member])
            name = kind if kind == "turn" else f"{_which(joint, k, member)}_{kind}"
            for axis, i in zip(axes, index.tolist(), strict=True):
                sigma = float(np.sqrt(max(1.0 - leverage[i], 0.0)))
                # Whitened: the value is in units of the measurement's own sigma.
                sigma = 0.0 if sigma < 1e-6 else sigma
                out.append(Residual(data.ids[k], data.occurrences[k], f"{name}_{axis}", float(left[i]), sigma))
    return tuple(out)


def _which(joint: JointModel, k: int, window: int) -> str:
    """Role of a window in its sequence; one without its turn is named apart."""
    if window == joint.data.start[k]:
        return "start"
    return "end" if window == joint.data.end[k] else "lone"


def contradictions(joint: JointModel, system: LinearSystem, solution: DenseSolution) -> list[ConsistencyTest]:
    """Every sequence against all the others, in time order: chi-square of its residuals as the others predict it."""
    left = system.b + system.A @ solution.delta
    spread = system.A @ solution.root
    reported = system.parameter_map() @ solution.root
    sigma = np.linalg.norm(reported, axis=1)
    reported = reported / np.where(sigma > 0.0, sigma, 1.0)[:, None]
    owned, out = _owned(system), []
    for k in joint.order.tolist():
        at = owned[k]
        v, H = left[at], spread[at]
        # What the data of a sequence alone decide, its own attitudes, leaves no residual there: directions without one.
        values, vectors = np.linalg.eigh(np.eye(len(at)) - H @ H.T)
        seen = values > LEAST_PREDICTED_SHARE
        statistic = float(np.sum((vectors[:, seen].T @ v) ** 2 / values[seen]))
        # Of them, those that move reported parameters: what nothing else shows of these.
        alone, moving_windows, _ = np.linalg.svd(reported @ (H.T @ vectors[:, ~seen]), full_matrices=False)
        open_ = alone[:, moving_windows > _WITNESSED]
        out.append(ConsistencyTest(statistic, int(seen.sum()), open_.shape[1], named(open_)))
    return out


def deletion_table(
    joint: JointModel, system: LinearSystem, solution: DenseSolution, against: SequenceOf[ConsistencyTest] | None = None
) -> list[dict[str, Any]]:
    """Set :func:`contradictions` as JSON values.

    Returns
    -------
    list of dict
        Sequence, occurrence, chi_square, degrees_of_freedom, probability; in time order.
    """
    data = joint.data
    return [
        {
            "sequence": data.ids[k],
            "occurrence": data.occurrences[k],
            "chi_square": row.chi_square,
            "degrees_of_freedom": row.freedom,
            "probability": float(chdtrc(row.freedom, row.chi_square)) if row.freedom else 1.0,
        }
        for k, row in zip(joint.order.tolist(), against or contradictions(joint, system, solution), strict=True)
    ]


def leave_one_out_estimates(
    joint: JointModel, system: LinearSystem, solution: DenseSolution
) -> list[LeaveOneOutEstimate]:
    """The estimate without each sequence, in time order; windows that other sequences use stay."""
    left = system.b + system.A @ solution.delta
    spread = system.A @ solution.root
    reported = system.parameter_map() @ solution.root
    free = np.flatnonzero(system.free)
    sigma = np.linalg.norm(reported[free], axis=1)
    unit = reported[free] / sigma[:, None]
    back = np.zeros((N_PARAMETERS, len(free)))
    back[free, np.arange(len(free))] = 1.0 / sigma
    full = np.linalg.inv(unit @ unit.T)
    shared, out = _shared_rows(joint, system), []
    owned = _owned(system)
    for k in joint.order.tolist():
        at = np.setdiff1d(owned[k], shared)
        H = spread[at]
        effect = full @ (unit @ H.T)
        # Woodbury in the information of the parameters alone, which lives where their covariance without it does not.
        values, vectors = np.linalg.eigh(np.eye(len(at)) - H @ H.T + H @ unit.T @ effect)
        there = values > _INDEPENDENT
        seen = effect @ vectors[:, there] / np.sqrt(values[there])
        rest = full - seen @ seen.T
        gradient = seen @ (vectors[:, there].T @ left[at] / np.sqrt(values[there]))
        information = np.stack([back @ full @ back.T, back @ rest @ back.T])
        out.append(leave_one_out_estimate(information, back @ gradient, system.free))
    return out


def evidence(
    joint: JointModel, system: LinearSystem, solution: DenseSolution, against: SequenceOf[ConsistencyTest]
) -> tuple[SequenceDiagnostics, ...]:
    """What the verdict has of every sequence, in time order; empty where the estimate's covariance is singular."""
    data = joint.data
    try:
        without = leave_one_out_estimates(joint, system, solution)
    except np.linalg.LinAlgError:
        return ()
    return tuple(
        SequenceDiagnostics(data.ids[k], data.occurrences[k], contradiction, left)
        for k, contradiction, left in zip(joint.order.tolist(), against, without, strict=True)
    )


def _owned(system: LinearSystem) -> dict[int, Indices]:
    """Rows of every sequence."""
    owned: dict[int, list[Indices]] = {}
    for rows in system.rows:
        for owner, index in zip(rows.owner.tolist(), rows.index, strict=True):
            if owner >= 0:
                owned.setdefault(owner, []).append(index)
    return {k: np.concatenate(rows) for k, rows in owned.items()}


def _shared_rows(joint: JointModel, system: LinearSystem) -> Indices:
    """Rows of windows that two sequences use."""
    data = joint.data
    uses = np.bincount(np.concatenate([data.start, data.end]), minlength=len(data.windows.duration_s))
    windows = np.flatnonzero(uses > 1)
    return np.concatenate([system.rows_of(kind).index[windows].ravel() for kind in ("force", "rate")])


def contradiction_warnings(table: SequenceOf[dict[str, Any]]) -> list[str]:
    """Name the sequence that contradicts the others most, if its chance is small."""
    worst = most_contradicted(table)
    if worst is None:
        return []
    again = f" (occurrence {worst['occurrence']})" if worst["occurrence"] > 1 else ""
    return [
        f"Sequence {worst['sequence']}{again} contradicts all the others (chi-square {worst['chi_square']:.3g} for "
        f"{worst['degrees_of_freedom']} degrees of freedom): look at its windows and its turn, leave it out, or use a "
        "robust loss."
    ]


def unmodelled_noise(joint: JointModel, system: LinearSystem) -> tuple[float, float, float]:
    """One sigma of attitude per turn, of force and of rate per window beyond the noise (restricted maximum likelihood).

    Returns
    -------
    tuple of float
        rad, m/s², rad/s.
    """
    m = len(system.b)
    parts = []
    known = np.eye(m)
    for kind, present, source in (
        ("turn", joint.unmodelled_sigma[0], "turn_excess"),
        ("force", joint.unmodelled_sigma[1], "pose_excess"),
        ("rate", joint.unmodelled_sigma[2], "rest_excess"),
    ):
        rows = system.rows_of(kind)
        W = system.whitening[kind]
        unit = W @ np.swapaxes(W, 1, 2)
        part = np.zeros((m, m))
        for index, block in zip(rows.index, unit, strict=True):
            part[np.ix_(index, index)] = block
        if source in rows.sources:
            known = known - present**2 * part
        parts.append(part)
    turn, force, rate = np.sqrt(restricted_likelihood(system.b, system.A[:, system.active], known, tuple(parts)))
    return float(turn), float(force), float(rate)
