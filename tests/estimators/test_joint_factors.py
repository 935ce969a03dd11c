"""Factors of the graph against the rows of the linearised system, and its elimination against the dense solution."""

import math
from dataclasses import replace

import numpy as np
import pytest

from srt.model.prior import Prior
from srt.recording.recording import ImuNoise
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS

pytest.importorskip("gtsam")
import gtsam
from dense_solution import solve
from jacobian_cases import CASES, EPS, VARIANTS, make, simulated_motions

from estimators.factor_graph import FactorGraph
from estimators.graph import solve_linear
from srt.joint.linearisation import Linearisation, linearise

# --- factors and rows -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def motions():
    return simulated_motions()


DRIFT_ROWS = {"d": "drift_start", "n": "drift_noise", "dnd": "drift_step"}


def columns_of(case, built, key):
    """Columns of the system for a variable, and the matrix from their corrections to the variable's."""
    columns = built.columns_of(key)
    if chr(gtsam.symbolChr(key)) == "a":
        return columns, case.state.attitude[gtsam.symbolIndex(key)].T
    return columns, np.eye(len(columns))


def normal(A, b):
    return A.T @ A, A.T @ b, b @ b


def factor_system(case, built, i):
    """Jacobian over the system's columns and residual of a factor, whitened."""
    factor = built.graph.at(i).linearize(built.values)
    J, right = factor.jacobian()
    A, at = np.zeros((len(J), len(case.system.active))), 0
    for key in list(factor.keys()):
        columns, to_variable = columns_of(case, built, key)
        A[:, columns] = J[:, at : at + len(columns)] @ to_variable
        at += len(columns)
    return A, -right


def measured_rows(built, rows, kind, number):
    """Rows of a measurement."""
    if kind == "window":
        return np.concatenate([rows["force"].index[number], rows["rate"].index[number]])
    members = [n for k, n, _ in built.measured if k == kind]
    return rows[kind].index[members.index(number)]


def rows_of_factor(case, built, i):
    """Rows of the system that a factor stands for; None for a heading that is given, which has no rows."""
    rows = {r.kind: r for r in case.system.rows}
    if i < len(built.measured):
        return measured_rows(built, rows, *built.measured[i][:2])
    keys = built.graph.at(i).keys()
    letters, number = "".join(chr(gtsam.symbolChr(k)) for k in keys), gtsam.symbolIndex(keys[0])
    if letters in DRIFT_ROWS:
        kinds = [f"{sensor}_{DRIFT_ROWS[letters]}" for sensor in case.system.compensated.drift]
        return np.concatenate([rows[kind].index[number] for kind in kinds])
    if letters == "bb":
        order = case.joint.order.tolist()
        return rows["walk"].index[order.index(number)]
    if letters == "a":
        return None
    kinds = {"f": "base", "u": "mounting", "l": "non_orthogonality", "g": "gravity", "q": "edge"}
    kinds["t"] = "table_rate"
    kind = (kinds | {"e": f"earth_rate:{number}"}).get(letters)
    return rows["prior"].index[0] if kind is None else rows[kind].index[number if kind == "edge" else 0]


def build(case):
    return FactorGraph(
        Linearisation(case.joint, case.state, case.system.compensated, case.system.free), prior=case.prior
    )


@pytest.mark.parametrize(("variant", "size"), CASES)
def test_factors_are_the_rows_of_the_system(motions, variant, size):
    """JᵀJ, Jᵀr and rᵀr of every factor, at a point where no residual vanishes; together they are the whole system."""
    case = make(motions, VARIANTS[variant], size)
    built, system = build(case), case.system
    rows = system.A.toarray()
    left = np.ones(len(system.b), dtype=bool)
    for i in range(built.graph.size()):
        A, b = factor_system(case, built, i)
        at = rows_of_factor(case, built, i)
        if at is None:
            # A heading: along the vertical alone, of a column that the system does not estimate.
            (column,) = np.flatnonzero(np.abs(A[0]) > 1e-12 * np.abs(A).max())
            assert not system.active[column]
            continue
        left[at] = False
        here = system.active & (A.any(axis=0) | rows[at].any(axis=0))
        found, expected = normal(A[:, here], b), normal(rows[at][:, here], system.b[at])
        size_b = math.sqrt(expected[2])
        d = np.sqrt(np.diag(expected[0]))
        if i < len(built.measured) and built.measured[i][0] in {"start", "end"}:
            # All coefficients of an attitude are of one size: some are zero but for the rounding of the largest.
            d = np.maximum(d, 1e-3 * d.max())
        where = (variant, i, built.measured[i] if i < len(built.measured) else built.graph.at(i).keys())
        assert np.all(np.abs(found[0] - expected[0]) <= 1e-12 * np.outer(d, d)), where
        assert np.all(np.abs(found[1] - expected[1]) <= 1e-12 * d * max(size_b, 1.0)), where
        assert abs(found[2] - expected[2]) <= 1e-12 * max(expected[2], 1.0), where
    # Rows without a factor: those that no estimated column is in.
    assert not rows[left][:, system.active].any()


# Of navigation grade; and a prior near enough that 3 or 4 sequences leave no direction open.
GRADE = ImuNoise(5.8e-7, 5e-5, 2.4e-6, 1e-5, 5e-9, 1e-5)


def known(motions, variant):
    case = make(motions, VARIANTS[variant], "tiny", GRADE, off=False)
    prior = Prior.from_sigma(np.full(N_PARAMETERS, 1e-5))
    system = linearise(case.joint, case.state, case.system.compensated, case.system.free, prior)
    return replace(case, prior=prior, system=system)


def parameters(case, built, solution):
    """Covariance of the reported parameters from that of the graph's variables."""
    E = case.system.columns.parameter_map()
    spread = np.concatenate([E[:, columns_of(case, built, key)[0]] for key in solution.keys], axis=1)
    return spread @ solution.covariance @ spread.T


@pytest.mark.parametrize("variant", VARIANTS)
def test_elimination_is_the_dense_solution(motions, variant):
    """Corrections and covariance of the parameters, by gtsam's elimination and by one QR of all rows.

    Both are backward stable: what they may differ by is rounding times the condition of the scaled system. The graph
    holds what is known of the Earth's rate by a sigma of 1e-6 of the unknown part, which adds to a bias's variance.
    """
    case = known(motions, variant)
    built, E = build(case), case.system.columns.parameter_map()
    solution, dense = solve_linear(built, built.values), solve(case.system)
    A = case.system.A.toarray()[:, case.system.active]
    rounding = 100.0 * EPS * np.linalg.cond(A / np.linalg.norm(A, axis=0))
    P = (E @ dense.root) @ (E @ dense.root).T
    sigma = np.sqrt(np.diag(P))
    known_rate = 1e-6 * max(float(c.unknown_sigma.max()) for c in case.joint.level_frames)
    held = (known_rate / sigma[GROUP_SLICES["gyro_bias"]].min()) ** 2
    assert np.abs((parameters(case, built, solution) - P) / np.outer(sigma, sigma)).max() <= rounding + held
    found = np.zeros(len(case.system.active))
    for key in solution.keys:
        found[columns_of(case, built, key)[0]] = solution.delta.at(key)
    assert np.abs(E @ (found - dense.delta) / sigma).max() <= rounding * np.linalg.norm(case.system.b)
    assert rounding + held < 1e-7
