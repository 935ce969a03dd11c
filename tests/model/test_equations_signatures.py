"""The signatures of the 17 sequences: as a table, from the paper's equations, from the model, from the simulator."""

import numpy as np
import pytest
import sympy as sp
from ideal_table_1 import RATE_RAD_S, WINDOW_S, G

from srt.model import measurement_model as model
from srt.model.rotation_integrals import ideal_rotations
from srt.model.sensor_model import Triad
from srt.model.table1 import AXES, SEQUENCES
from srt.sensor_errors import INDEX, N_PARAMETERS

PERFECT = Triad(np.eye(3), np.zeros(3), np.zeros(3))

# Largest term is 2πg; a component sums at most eight rotations of a few operations each.
ROUNDING = 64 * np.finfo(float).eps * 2 * np.pi * G

# Δa_H by component; what is not listed is zero (a_Down is below).
DELTA_A = {
    "1": {"x": "-2*pi*g*(κyy + κyyy)"},
    "2": {"y": "2*pi*g*(κxx + κxxx)"},
    "3": {"y": "-2*pi*g*(κzz + κzzz)"},
    "1a": {"x": "2*pi*g*(κyy - κyyy)"},
    "2a": {"y": "-2*pi*g*(κxx - κxxx)"},
    "3a": {"y": "2*pi*g*(κzz - κzzz)"},
    "4": {"y": "4*g*υyz"},
    "5": {"x": "4*g*υzx"},
    "6": {"y": "4*g*υxy"},
    "7": {"x": "2*g*(μxy + υxy/2)", "z": "-2*λz - pi*g*(κxx + κxxx)"},
    "8": {"x": "2*g*(μxz + υzx/2)", "y": "-2*λy + pi*g*(κxx + κxxx)"},
    "9": {"z": "2*g*(μzx + υzx/2)", "y": "-2*λy - pi*g*(κzz + κzzz)"},
    "10": {"z": "2*g*(μzy + υyz/2)", "x": "-2*λx + pi*g*(κzz + κzzz)"},
    "11": {"y": "2*g*(μyz + υyz/2)", "x": "-2*λx - pi*g*(κyy + κyyy)"},
    "12": {"y": "2*g*(μyx + υxy/2)", "z": "-2*λz + pi*g*(κyy + κyyy)"},
    "13": {"y": "-2*(λy + g*υyz)", "x": "2*g*μxz - g*υzx + pi*g*(κyy + κyyy)"},
    "14": {"x": "-2*(λx + g*υzx)", "y": "2*g*μyz - g*υyz - pi*g*(κxx + κxxx)"},
}
DOWN = {axis: f"-g*(λ{axis * 2} - λ{axis * 3}) + λ{axis}" for axis in "xyz"}
UP = {axis: f"-g*(λ{axis * 2} + λ{axis * 3}) - λ{axis}" for axis in "xyz"}
END_DOWN = {
    name: (UP if name in {"7", "8", "9", "10", "11", "12", "13", "14"} else DOWN)[SEQUENCES[name].down]
    for name in DELTA_A
}


def listed(sequence):
    """Text of every component of a sequence, the zero ones included."""
    down = SEQUENCES[sequence].down
    components = {a: DELTA_A[sequence].get(a, "0") for a in "xyz" if a != down}
    return components | {"start": DOWN[down], "end": END_DOWN[sequence]}


def parsed(derivation, text):
    names = {str(s): s for s in derivation.PARAMETERS.values()}
    return sp.sympify(text, locals=names | {"g": derivation.g})


def row_of(derivation, text):
    """Coefficients of a signature as a row of a Jacobian."""
    out = np.zeros(N_PARAMETERS)
    for name, factor in derivation.coefficients(parsed(derivation, text)).items():
        out[INDEX[name]] = float(factor.subs(derivation.g, G))
    return out


def ideal_jacobian(sequence, *, window_s=0.0, rate=RATE_RAD_S):
    """Model of an ideally executed sequence: components "x", "y", "z", "start", "end" by name."""
    s = SEQUENCES[sequence]
    integrals = ideal_rotations([s], rate, window_s)
    horizontal = [a for a in AXES if a != s.down]
    basis = np.eye(3)[[AXES.index(a) for a in horizontal]][None]
    f_start = -G * np.eye(3)[[AXES.index(s.down)]]
    f_end = np.einsum("kab,ka->kb", integrals.C_end, f_start)
    # An axis that is horizontal reads exactly nothing: rounding in C_end is no specific force.
    f_end = np.where(np.abs(f_end) < 1e-12 * G, 0.0, f_end)
    rows = model.horizontal_jacobian(integrals, basis, f_start, f_end, PERFECT)[0]
    return dict(zip(horizontal, rows, strict=True)) | {
        "start": model.down_jacobian(f_start, PERFECT)[0],
        "end": model.down_jacobian(f_end, PERFECT)[0],
    }


def without_bias(row):
    return np.where(np.arange(N_PARAMETERS) < N_PARAMETERS - 3, row, 0.0)


@pytest.mark.parametrize("sequence", DELTA_A)
def test_derivation_gives_the_listed_signature(derivation, sequence):
    found = derivation.signature(sequence)
    for component, text in listed(sequence).items():
        expression = (found.delta_a | found.down)[component]
        assert sp.expand(expression - parsed(derivation, text)) == 0, component


@pytest.mark.parametrize("sequence", DELTA_A)
def test_model_gives_the_listed_signature(derivation, sequence):
    found = ideal_jacobian(sequence)
    for component, text in listed(sequence).items():
        np.testing.assert_allclose(
            without_bias(found[component]), row_of(derivation, text), rtol=0, atol=ROUNDING, err_msg=component
        )


@pytest.mark.parametrize("window_attitude", ["held", "integrated"])
@pytest.mark.parametrize("sequence", DELTA_A)
def test_bias_effect_of_model_derivation_and_simulator_agree(derivation, simulated, sequence, window_attitude):
    window_s = WINDOW_S if window_attitude == "integrated" else 0.0
    model_rows = ideal_jacobian(sequence, window_s=window_s)
    run = simulated(window_attitude)
    values = {
        derivation.g: G,
        derivation.RATE: RATE_RAD_S,
        derivation.T_MEAS: window_s,
        derivation.F_MEAS: sp.Rational(1, 2),
    }
    for component, expression in derivation.signature(sequence).bias.items():
        expected = np.zeros(3)
        for name, factor in derivation.coefficients(expression).items():
            expected[INDEX[name] - N_PARAMETERS] = float(factor.subs(values))
        np.testing.assert_allclose(
            model_rows[component][-3:], expected, rtol=0, atol=ROUNDING * (1.0 + window_s), err_msg=component
        )
        excess = np.abs(run.row(sequence, component)[-3:] - expected) - run.tolerance(sequence)[-3:]
        assert excess.max() <= 0.0, component


@pytest.mark.parametrize("window_attitude", ["held", "integrated"])
def test_every_entry_of_the_jacobian_by_simulation(simulated, window_attitude):
    """All 68 components and 27 errors at once, zeros included."""
    run = simulated(window_attitude)
    window_s = WINDOW_S if window_attitude == "integrated" else 0.0
    compared = 0
    for sequence in SEQUENCES:
        for component, row in ideal_jacobian(sequence, window_s=window_s).items():
            off = np.abs(run.row(sequence, component) - row)
            assert np.all(off <= run.tolerance(sequence)), (sequence, component)
            compared += row.size
    assert compared == 68 * N_PARAMETERS


def test_rest_rate_measures_the_gyro_bias_alone(simulated):
    """The rate at rest contains the bias alone if the Earth does not rotate."""
    J = simulated("held").J[-3:]
    # The mean of 34 windows of bias · 1 against z = bias: rounding of the difference only.
    np.testing.assert_allclose(J, np.eye(3, N_PARAMETERS, N_PARAMETERS - 3), rtol=0, atol=1e-9)


def test_the_68_measurements_determine_all_24_errors(simulated):
    rows = [row for name in SEQUENCES for row in ideal_jacobian(name).values()]
    H = without_bias(np.array(rows))[:, :24] / G
    H[:, [INDEX[f"accel_bias_{a}"] for a in "xyz"]] *= G  # per g
    assert H.shape == (68, 24)
    singular = np.linalg.svd(H, compute_uv=False)
    assert np.linalg.matrix_rank(H) == 24
    # Not merely above rounding: no error is seen 1e3 times worse than another.
    assert singular[-1] > 1e-3 * singular[0]
    measured = without_bias(simulated("held").J[:-3])[:, :24]
    assert np.linalg.matrix_rank(measured, tol=1e-3 * G * singular[-1]) == 24


def test_a_bias_cancels_in_the_scale_factor_of_a_reversed_pair(derivation):
    """Over sequences k and ka it falls wholly on the asymmetry."""
    for k in "123":
        forward, back = derivation.signature(k), derivation.signature(k + "a")
        for axis in forward.bias:
            assert sp.expand(forward.bias[axis] - back.bias[axis]) == 0
