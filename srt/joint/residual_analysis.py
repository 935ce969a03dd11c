"""Residuals of the joint solution, consistency of each sequence with the others, and unmodelled errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.sparse.linalg import splu
from scipy.special import chdtri

from srt.estimation.error_sources import EXCESSES, LARGEST_FIXTURE_RAD, UNDERSAMPLING, UnmodelledErrors, shared_edges
from srt.estimation.goodness_of_fit import CONTRADICTION_PROBABILITY, chi_square_probability
from srt.estimation.leave_one_out import (
    ConsistencyTest,
    LeaveOneOutEstimate,
    SequenceDiagnostics,
    leave_one_out_estimate,
    participating,
)
from srt.estimation.white_residuals import LEAST_PREDICTED_SHARE
from srt.noise.variance_components import RestrictedLikelihood
from srt.result.calibration import Residual
from srt.result.consistency import SequenceTest
from srt.result.verdict import MISFIT_PROBABILITY
from srt.sensor_errors import N_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from collections.abc import Sequence as SequenceOf

    from srt.joint.block_solution import BlockSolution
    from srt.joint.joint_model import JointModel
    from srt.joint.linear_system import LinearSystem
    from srt.types import Array, Indices, Mask


_AXES: Final = {"force": "xyz", "rate": "xyz", "turn": "xyz", "stated_rate": "12"}
"""Kinds of rows whose residuals are reported, with the names of their components; of a stated rate, its two halves."""
_EVERY: Final = slice(None)
_SOURCES: Final = {
    "turn_excess": (("turn", "heading"), _EVERY),
    "pose_excess": (("force",), _EVERY),
    "rest_excess": (("rate",), _EVERY),
    "wobble_excess": (("start", "end"), slice(-1, None)),
    "angle_excess": (("start",), slice(0, 2)),
    "alignment_excess": (("base", "mounting", "non_orthogonality"), _EVERY),
}
"""Kinds of rows that each of the unmodelled errors affects, and the components; the last of an attitude is wobble."""
_OF_FIXTURE: Final = ("wobble_excess", "angle_excess", "alignment_excess")
_BEYOND_STATED: Final = ("angle_excess", "alignment_excess")
"""Unmodelled errors that are estimated only where the residuals show them, as they accuse the statement."""
_INDEPENDENT: Final = 1e-10
"""Smallest eigenvalue (at most 1) of a residual direction that remains determined without the sequence."""
_SMALLEST_LEVERAGE: Final = 0.05
"""Smallest effect of a residual direction on a parameter, in sigmas of the parameter, that is relevant."""
_NO_RESIDUAL: Final = 1e-6
"""Smallest sigma of a residual relative to that of its measurement; below it, the residual is a rounding error."""


def residuals(joint: JointModel, solution: BlockSolution) -> tuple[Residual, ...]:
    """Residuals of force, rates and rotation in units of the measurement's sigma, each with its expected sigma."""
    data = joint.data
    residual, leverage = solution.residual, solution.leverage
    out = []
    for rows in solution.system.rows:
        kind = rows.kind
        for member, index in enumerate(rows.index if kind in _AXES else ()):
            k = int(rows.owner[member])
            name = f"{_role(joint, k, member)}_{kind}" if kind in ("force", "rate") else kind
            for axis, i in zip(_AXES[kind], index.tolist(), strict=True):
                sigma = float(np.sqrt(max(1.0 - leverage[i], 0.0)))
                sigma = 0.0 if sigma < _NO_RESIDUAL else sigma
                out.append(Residual(data.ids[k], data.occurrences[k], f"{name}_{axis}", float(residual[i]), sigma))
    return tuple(out)


def _role(joint: JointModel, k: int, window: int) -> str:
    """Role of a window in its sequence: "start", "end", or "lone" for a pose whose rotation is not used."""
    if window == joint.data.start[k]:
        return "start"
    return "end" if window == joint.data.end[k] else "lone"


def contradictions(joint: JointModel, solution: BlockSolution) -> list[ConsistencyTest]:
    """Chi-square of each sequence as predicted from all others, in time order."""
    residual = solution.residual
    sigma = np.sqrt(np.maximum(np.diag(solution.covariance), 0.0))
    reported = solution.rows_with_parameters / np.where(sigma > 0.0, sigma, 1.0)
    owned, out = _owned(solution.system), []
    for step, k in enumerate(joint.order.tolist()):
        at = owned[k]
        v, H = residual[at], solution.predicted_root(step, at)
        # Directions that only this sequence determines, such as its own attitudes, have no residual.
        values, vectors = np.linalg.eigh(np.eye(len(at)) - H @ H.T)
        seen = values > LEAST_PREDICTED_SHARE
        statistic = float(np.sum((vectors[:, seen].T @ v) ** 2 / values[seen]))
        # The other sequences cannot check the reported parameters that depend on these directions.
        alone, effect, _ = np.linalg.svd(reported[at].T @ vectors[:, ~seen], full_matrices=False)
        unchecked = alone[:, effect > _SMALLEST_LEVERAGE]
        out.append(ConsistencyTest(statistic, int(seen.sum()), unchecked.shape[1], participating(unchecked)))
    return out


def contradicting_rests(joint: JointModel, solution: BlockSolution) -> Mask:
    """Windows whose mean rate contradicts all other measurements, shape (W,)."""
    rows = solution.system.rows_of("rate")
    H = [solution.predicted_root(int(joint.rank[k]), at) for k, at in zip(rows.owner, rows.index, strict=True)]
    own, residual = np.eye(3) - np.stack([root @ root.T for root in H]), solution.residual[rows.index]
    tested = np.linalg.eigvalsh(own)[:, 0] > LEAST_PREDICTED_SHARE
    own[~tested] = np.eye(3)
    statistic = np.einsum("wa,wa->w", residual, np.linalg.solve(own, residual[:, :, None])[:, :, 0])
    return np.asarray(tested & (statistic > chdtri(3, CONTRADICTION_PROBABILITY / len(own))))


def deletion_table(
    joint: JointModel, solution: BlockSolution, against: SequenceOf[ConsistencyTest] | None = None
) -> tuple[SequenceTest, ...]:
    """Results of :func:`contradictions` by sequence, in time order."""
    data = joint.data
    return tuple(
        SequenceTest(
            sequence=data.ids[k],
            occurrence=data.occurrences[k],
            chi_square=row.chi_square,
            degrees_of_freedom=row.degrees_of_freedom,
            probability=chi_square_probability(row.chi_square, row.degrees_of_freedom),
        )
        for k, row in zip(joint.order.tolist(), against or contradictions(joint, solution), strict=True)
    )


def leave_one_out_estimates(joint: JointModel, solution: BlockSolution) -> list[LeaveOneOutEstimate]:
    """Estimates with each sequence omitted, in time order; windows shared with other sequences are kept."""
    system, residual = solution.system, solution.residual
    free = np.flatnonzero(system.free)
    sigma = np.sqrt(np.diag(solution.covariance)[free])
    unit = solution.rows_with_parameters[:, free] / sigma
    back = np.zeros((N_PARAMETERS, len(free)))
    back[free, np.arange(len(free))] = 1.0 / sigma
    full = np.linalg.inv(solution.covariance[np.ix_(free, free)] / np.outer(sigma, sigma))
    shared, out = _shared_rows(joint, system), []
    owned = _owned(system)
    for step, k in enumerate(joint.order.tolist()):
        at = np.setdiff1d(owned[k], shared)
        H = solution.predicted_root(step, at)
        effect = full @ unit[at].T
        # Woodbury identity in information form: without the sequence the covariance may not exist.
        values, vectors = np.linalg.eigh(np.eye(len(at)) - H @ H.T + unit[at] @ effect)
        there = values > _INDEPENDENT
        seen = effect @ vectors[:, there] / np.sqrt(values[there])
        rest = full - seen @ seen.T
        gradient = seen @ (vectors[:, there].T @ residual[at] / np.sqrt(values[there]))
        information = np.stack([back @ full @ back.T, back @ rest @ back.T])
        out.append(leave_one_out_estimate(information, back @ gradient, system.free))
    return out


def sequence_diagnostics(
    joint: JointModel, solution: BlockSolution, against: SequenceOf[ConsistencyTest]
) -> tuple[SequenceDiagnostics, ...]:
    """Consistency and leave-one-out estimate by sequence, in time order; empty if the covariance is singular."""
    data = joint.data
    try:
        estimates = leave_one_out_estimates(joint, solution)
    except np.linalg.LinAlgError:
        return ()
    return tuple(
        SequenceDiagnostics(data.ids[k], data.occurrences[k], test, estimate)
        for k, test, estimate in zip(joint.order.tolist(), against, estimates, strict=True)
    )


def _owned(system: LinearSystem) -> dict[int, Indices]:
    """Row numbers by sequence."""
    owned: dict[int, list[Indices]] = {}
    for rows in system.rows:
        for owner, index in zip(rows.owner.tolist(), rows.index, strict=True):
            if owner >= 0:
                owned.setdefault(owner, []).append(index)
    return {k: np.concatenate(rows) for k, rows in owned.items()}


def _shared_rows(joint: JointModel, system: LinearSystem) -> Indices:
    """Rows of windows shared by two sequences, and the priors of the errors at their edges."""
    data = joint.data
    uses = np.bincount(np.concatenate([data.start, data.end]), minlength=len(data.windows.duration_s))
    windows = np.flatnonzero(uses > 1)
    members = {"force": windows, "rate": windows}
    if system.compensated.edges.unknowns:
        edges = shared_edges(data)[windows].ravel()
        members["edge"] = edges[edges >= 0]
    return np.concatenate([system.rows_of(kind).index[at].ravel() for kind, at in members.items()])


class UnmodelledNoise(NamedTuple):
    """Unmodelled errors that residuals may show.

    Attributes
    ----------
    likelihood : RestrictedLikelihood
        Their components in the order of :data:`EXCESSES`.
    """

    likelihood: RestrictedLikelihood

    def of_fixture(self) -> UnmodelledErrors:
        """Errors of the fixture, if they were the only ones."""
        return self._estimate(np.isin(EXCESSES, _OF_FIXTURE))

    def of_all(self) -> UnmodelledErrors:
        """Errors of unit and fixture; those of a fixture that would be larger than any are errors of the unit."""
        found = self._estimate(np.ones(len(EXCESSES), dtype=np.bool_))
        if max(found.angle, found.alignment) > LARGEST_FIXTURE_RAD:
            return self._estimate(~np.isin(EXCESSES, _BEYOND_STATED))
        return found

    def _estimate(self, used: Mask) -> UnmodelledErrors:
        found = self.likelihood.significant(used, np.isin(EXCESSES, _BEYOND_STATED), MISFIT_PROBABILITY)[1]
        return UnmodelledErrors(*np.sqrt(found).tolist())


def unmodelled_noise(joint: JointModel, system: LinearSystem) -> UnmodelledNoise:
    """Unmodelled errors by restricted maximum likelihood."""
    return UnmodelledNoise(_likelihood(joint, system, _SOURCES, EXCESSES))


def undersampling_likelihood(joint: JointModel, system: LinearSystem) -> RestrictedLikelihood:
    """Likelihood of two components of the rotations' error: equal for all, and as their fast motion."""
    turns = {"turn_excess": _SOURCES["turn_excess"], UNDERSAMPLING: (("turn",), _EVERY)}
    return _likelihood(joint, system, turns, tuple(turns), joint.data.fast_motion)


def _likelihood(
    joint: JointModel,
    system: LinearSystem,
    affected: Mapping[str, tuple[tuple[str, ...], slice]],
    components: SequenceOf[str],
    fast_motion: Array | None = None,
) -> RestrictedLikelihood:
    """Restricted likelihood of variance components, by the kinds of rows and components that each affects."""
    # The states of the bias instability are part of the known covariance, not unknowns.
    drift = np.concatenate([np.arange(c.start, c.stop) for n, c in system.columns.items() if "_drift" in n])
    priors = [rows.index.ravel() for rows in system.rows if "_drift" in rows.kind]
    kept = np.setdiff1d(np.arange(len(system.b)), np.concatenate([drift[:0], *priors]))
    m = len(kept)
    known = np.zeros((m, m))
    if len(drift):
        root = splu(system.A[np.concatenate(priors)][:, drift].tocsc()).solve(np.eye(len(drift)))
        effect = system.A[kept][:, drift] @ root
        known += effect @ effect.T
    roots = [[np.zeros((m, 0))] for _ in components]
    # A prior that follows the data does not show the accuracy of the mounting.
    silent = ("mounting",) if joint.choice.U_note else ()
    estimated = {*EXCESSES, *components}
    for rows in system.rows:
        if "_drift" in rows.kind:
            continue
        at = np.searchsorted(kept, rows.index)
        block = at[:, :, None], at[:, None, :]
        # The known sources are summed: the total less large unmodelled errors would be rounding error.
        known[block] += sum(share for source, share in rows.sources.items() if source not in estimated)
        for root, source in zip(roots, components, strict=True):
            kinds, parts = affected[source]
            if rows.kind in kinds and rows.kind not in silent:
                W = system.whitening[rows.kind][:, :, parts]
                if source == UNDERSAMPLING and fast_motion is not None:
                    W = W * fast_motion[rows.owner, None, None]
                columns = np.zeros((m, *W[:, 0].shape))
                columns[at, np.arange(len(at))[:, None]] = W
                root.append(columns.reshape(m, -1))
    others = system.active.copy()
    others[drift] = False
    H = system.A[kept][:, np.flatnonzero(others)].toarray()
    return RestrictedLikelihood(system.b[kept], H, known, tuple(np.hstack(root) for root in roots))
