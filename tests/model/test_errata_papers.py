"""The errata of the two papers: the printed form fails, ours holds, by derivation and by simulation.

[N] is Savage 2017, part 3; [P] is Savage 2020. The biases' effects are stated as estimate minus truth.
"""

import math
from fractions import Fraction

import numpy as np
import pytest
import sympy as sp
from ideal_table_1 import RATE_RAD_S, WINDOW_S, G
from scipy.stats import chi2

import sims
from srt.estimation.options import Options
from srt.exceptions import InputError
from srt.model import srt_formulas
from srt.model.rotation_integrals import ideal_rotations
from srt.model.table1 import SEQUENCES
from srt.recording.recording import Site
from srt.sensor_errors import INDEX, SensorErrors
from srt.sequences.preparation import prepare
from srt.sequences.window_means import averaging_weights


def symbols_of(derivation):
    return {str(s): s for s in derivation.PARAMETERS.values()} | {
        "g": derivation.g,
        "T": derivation.T_MEAS,
        "F": derivation.F_MEAS,
        "r": derivation.RATE,
    }


def parse(derivation, text):
    return sp.sympify(text, locals=symbols_of(derivation))


def same(a, b):
    return sp.simplify(sp.expand(a - b)) == 0


def factor_of(derivation, text, parameter, *, window_s=0.0):
    """Factor of one sensor error in a printed expression, as a number."""
    values = {
        derivation.g: G,
        derivation.RATE: RATE_RAD_S,
        derivation.T_MEAS: window_s,
        derivation.F_MEAS: 0.5,
    }
    return float(sp.diff(parse(derivation, text), derivation.PARAMETERS[parameter]).subs(values))


# --- 1: [N] Table 1, sequences 2 and 2a --------------------------------------------------------------------------


@pytest.mark.parametrize(("sequence", "degrees"), [("2", 360), ("2a", -360)])
def test_erratum_1_sequences_2_and_2a_start_with_x_along_the_outer_axis(derivation, simulated, sequence, degrees):
    # Printed in [N]: y along outer, inner 0.
    assert not derivation.executable(0, ((degrees, "x"),))
    with pytest.raises(InputError, match="does not lie along the outer axis"):
        sims.TurnSequence(sequence, "z", "y", (("x", float(degrees)),))
    # [P], and ours: x along outer, inner +90.
    assert derivation.executable(90, ((degrees, "x"),))
    ours = SEQUENCES[sequence]
    assert (ours.along_outer, ours.inner_rad, ours.outer_rad) == ("x", math.pi / 2, 0.0)
    sign = math.copysign(1.0, degrees)
    by_simulation = simulated("held").row(sequence, "y")[INDEX["gyro_scale_x"]]
    assert abs(by_simulation - sign * 2 * math.pi * G) < simulated("held").tolerance(sequence)[0]


# --- 2: [P] eq. 13, accelerometer asymmetry ----------------------------------------------------------------------

ASYMMETRY_FROM = (("y", "7"), ("z", "8"), ("x", "9"))


@pytest.mark.parametrize(("axis", "sequence"), ASYMMETRY_FROM)
def test_erratum_2_accelerometer_asymmetry_takes_plus_two_lambda(derivation, simulated, axis, sequence):
    bias, asymmetry = (derivation.PARAMETERS[f"accel_{what}_{axis}"] for what in ("bias", "asymmetry"))
    down = derivation.signature(sequence).down
    difference = down["end"] - down["start"]
    printed = -(difference - 2 * bias) / (2 * derivation.g)
    ours = -(difference + 2 * bias) / (2 * derivation.g)
    assert same(ours, asymmetry)
    assert same(printed, asymmetry + 2 * bias / derivation.g)

    # A unit with this bias alone has no asymmetry: the simulator's Down, per unit of bias.
    run = simulated("held")
    column = INDEX[f"accel_bias_{axis}"]
    measured = run.row(sequence, "end")[column] - run.row(sequence, "start")[column]
    rounding = 1e-8  # of a central difference: 1e-16 · g / 1e-5, and the square of the step in |f|
    assert abs(-(measured + 2.0) / (2 * G)) < rounding
    assert abs(-(measured - 2.0) / (2 * G) - 2.0 / G) < rounding
    chosen = srt_formulas.formulas(SEQUENCES)
    A = srt_formulas.inversion_matrix(chosen, G)
    J = np.array([run.row(c.sequence, c.kind) for c in srt_formulas.components(chosen)])
    assert abs((A @ J[:, column])[INDEX[f"accel_asymmetry_{axis}"]]) < 1e-4 / G


# --- 3: [P] eq. 12, Down of sequence 9 ---------------------------------------------------------------------------


def test_erratum_3_down_of_sequence_9_has_lambda_x_like_the_other_axes(derivation, simulated):
    printed = {"start": "-g*(λxx - λxxx) - λx", "end": "-g*(λxx + λxxx) + λx"}
    ours = {"start": "-g*(λxx - λxxx) + λx", "end": "-g*(λxx + λxxx) - λx"}
    found = derivation.signature("9").down
    for when in ("start", "end"):
        assert same(found[when], parse(derivation, ours[when]))
        assert not same(found[when], parse(derivation, printed[when]))
        row = simulated("held").row("9", when)
        assert abs(row[INDEX["accel_bias_x"]] - factor_of(derivation, ours[when], "accel_bias_x")) < 1e-8
        assert abs(row[INDEX["accel_bias_x"]] - factor_of(derivation, printed[when], "accel_bias_x")) > 1.0
    # Both misprints together cancel, which hides the second erratum for x.
    start, end = (parse(derivation, printed[when]) for when in ("start", "end"))
    λx, λxxx = (derivation.PARAMETERS[f"accel_{what}_x"] for what in ("bias", "asymmetry"))
    assert same(-(end - start - 2 * λx) / (2 * derivation.g), λxxx)


# --- 4: [P] eq. 22, effect of gyro bias as estimate minus truth --------------------------------------------------

# Sequence, component, its coefficient and the quantity it determines, our error, the printed one ("similarly"
# carried over sign by sign) where it differs. r is |β̇|, T is T_Meas, F is F_Meas.
SCALE = "(1/r + T/(2*pi))"
BIAS_EFFECTS = (
    ("1", "x", "-2*pi*g", "κyy + κyyy", f"{SCALE}*κy", f"-{SCALE}*κy"),
    ("2", "y", "2*pi*g", "κxx + κxxx", f"{SCALE}*κx", f"-{SCALE}*κx"),
    ("3", "y", "-2*pi*g", "κzz + κzzz", f"{SCALE}*κz", f"-{SCALE}*κz"),
    ("1a", "x", "2*pi*g", "κyy - κyyy", f"-{SCALE}*κy", None),
    ("2a", "y", "-2*pi*g", "κxx - κxxx", f"-{SCALE}*κx", None),
    ("3a", "y", "2*pi*g", "κzz - κzzz", f"-{SCALE}*κz", None),
    ("4", "y", "4*g", "υyz", "(κy + κz)/r + T*κx/4", "(κy + κz)/r - T*κx/4"),
    ("5", "x", "4*g", "υzx", "(κx + κz)/r - T*κy/4", None),
    ("6", "y", "4*g", "υxy", "(κx + κy)/r - T*κz/4", None),
    ("7", "x", "2*g", "μxy + υxy/2", "κy/r + T*(1 - 2*F)*κz/2", None),
    ("8", "x", "2*g", "μxz + υzx/2", "κz/r - T*(1 - 2*F)*κy/2", "κz/r + T*(1 - 2*F)*κy/2"),
    ("9", "z", "2*g", "μzx + υzx/2", "κx/r + T*(1 - 2*F)*κy/2", None),
    ("10", "z", "2*g", "μzy + υyz/2", "κy/r - T*(1 - 2*F)*κx/2", "κy/r + T*(1 - 2*F)*κx/2"),
    ("11", "y", "2*g", "μyz + υyz/2", "κz/r + T*(1 - 2*F)*κx/2", None),
    ("12", "y", "2*g", "μyx + υxy/2", "κx/r - T*(1 - 2*F)*κz/2", "κx/r + T*(1 - 2*F)*κz/2"),
    (
        "7",
        "z",
        "-2",
        "λz + pi*g/2*(κxx + κxxx)",
        "pi*g/2*(1/r + T/pi)*κx",
        "-pi*g/2*(1/r + T/pi)*κx",
    ),
    ("13", "y", "-2", "λy + g*υyz", "g*((κz + κy)/r - T*κx/2)", "-g*((κz + κy)/r - T*κx/2)"),
    ("14", "x", "-2", "λx + g*υzx", "g*((κx + κz)/r + T*κy/2)", "-g*((κx + κz)/r - T*κy/2)"),
)


def test_erratum_4_covers_all_17_sequences():
    assert {effect[0] for effect in BIAS_EFFECTS} == set(SEQUENCES)


@pytest.mark.parametrize("effect", BIAS_EFFECTS, ids=lambda e: f"{e[0]}-{e[1]}")
def test_erratum_4_effect_of_gyro_bias_as_estimate_minus_truth(derivation, simulated, effect):
    sequence, component, coefficient, quantity, ours, printed = effect
    found = derivation.signature(sequence)
    factor = parse(derivation, coefficient)
    # The quantity is what this component determines, and eq. 21 over its coefficient is its error.
    assert same(found.delta_a[component], factor * parse(derivation, quantity))
    assert same(found.bias[component] / factor, parse(derivation, ours))
    if printed is not None:
        assert not same(parse(derivation, ours), parse(derivation, printed))

    run = simulated("integrated")
    divisor = float(factor.subs(derivation.g, G))
    distances = {"ours": 0.0, "printed": 0.0}
    for axis in "xyz":
        name = f"gyro_bias_{axis}"
        by_simulation = run.row(sequence, component)[INDEX[name]] / divisor
        tolerance = run.tolerance(sequence)[INDEX[name]] / abs(divisor)
        expected = factor_of(derivation, ours, name, window_s=WINDOW_S)
        assert abs(by_simulation - expected) <= tolerance
        if printed is not None:
            wrong = factor_of(derivation, printed, name, window_s=WINDOW_S)
            distances["printed"] = max(distances["printed"], abs(by_simulation - wrong) / tolerance)
    # With F = 1/2 the sign of (1 − 2F) cannot be seen in data; every other misprint is.
    if printed is not None and "F" not in printed:
        assert distances["printed"] > 100.0


def test_erratum_4_magnitudes_stand(derivation):
    """The three numbers of [P] §9.4: |β̇| = 1 rad/s, T_Meas = 10 s, F_Meas = 1/2, biases of 0.1 °/h."""
    bias = 0.1 * math.pi / 180 / 3600
    effects = {(e[0], e[1]): parse(derivation, e[4]) for e in BIAS_EFFECTS}
    κ = [derivation.PARAMETERS[f"gyro_bias_{a}"] for a in "xyz"]
    setting = {derivation.RATE: 1, derivation.T_MEAS: 10, derivation.F_MEAS: sp.Rational(1, 2)}

    def value(expression, x, y, z):
        return float(expression.subs(setting | dict(zip(κ, (x, y, z), strict=True))))

    # κx + κy = 0.1, κz = −0.1; κy = 0.1; κx = 0.1, κy + κz = −0.1 °/h. Printed to two or three digits.
    assert round(value(effects["6", "y"], bias / 2, bias / 2, -bias) * 1e6, 1) == 1.7
    assert abs(value(effects["7", "x"], 0, bias, 0) * 1e6 - 0.49) < 0.01
    assert abs(value(effects["13", "y"] / derivation.g, bias, -bias / 2, -bias / 2) * 1e6 + 2.91) < 0.005


# --- 5: [N] eqs. 47 and 65 ---------------------------------------------------------------------------------------


def test_erratum_5_eq_47_repeats_eq_33(derivation, simulated):
    found = derivation.signature("6")
    printed = sp.Matrix([0, parse(derivation, "-4*(κx + κz)/r"), 0])
    ours = sp.Matrix([0, 0, parse(derivation, "-4*(κx + κy)/r")])
    assert found.phi_bias == ours.applyfunc(sp.expand)
    assert derivation.signature("5").phi_bias == printed.applyfunc(sp.expand)  # it belongs to sequence 5
    # Ours leads to eq. 48, the printed one does not: y is −g φ_z, z is g φ_y, with x down.
    eq_48 = {"y": "4*g*((κx + κy)/r - T*κz/4)", "z": "g*T*κy"}
    for component, text in eq_48.items():
        assert same(found.bias[component], parse(derivation, text))
    windows = parse(derivation, "g*T*κy")
    assert not same(derivation.g * printed[1] + windows, parse(derivation, eq_48["z"]))
    run = simulated("integrated")
    for component, text in eq_48.items():
        for axis in "xyz":
            expected = factor_of(derivation, text, f"gyro_bias_{axis}", window_s=WINDOW_S)
            column = INDEX[f"gyro_bias_{axis}"]
            assert abs(run.row("6", component)[column] - expected) <= run.tolerance("6")[column]


def test_erratum_5_eq_65_has_one_g_too_many(derivation, simulated):
    inner = {
        "x": "-g*((2*κx - pi*κy)/r + T*(1 - 2*F)*κy)",
        "y": "-2*g*((κy + κz)/r - T*κx/2)",
    }
    found = derivation.signature("13").bias
    run = simulated("integrated")
    for component, text in inner.items():
        printed = f"g*({text})"
        assert same(found[component], parse(derivation, text))
        assert not same(found[component], parse(derivation, printed))
        for axis in "xyz":
            name = f"gyro_bias_{axis}"
            measured, tolerance = run.row("13", component)[INDEX[name]], run.tolerance("13")[INDEX[name]]
            ours, wrong = (factor_of(derivation, t, name, window_s=WINDOW_S) for t in (text, printed))
            assert abs(measured - ours) <= tolerance
            assert ours == 0.0 or abs(measured - wrong) > 1000 * tolerance


# --- 6: [P] §9.2, the averaging algorithm and white noise ---------------------------------------------------------


@pytest.mark.parametrize("half", [1, 2, 5, 50, 1000])
def test_erratum_6_overlapping_averages_cost_a_factor_of_root_four_thirds(half):
    """Means over h of n = 2h samples, averaged, have triangular weights: Σw² = (2h + 1) / 3h(h + 1), against 1/2h."""
    n = 2 * half
    rise = list(range(1, half + 1))
    counts = [*rise, *rise[::-1]]
    exact = [Fraction(c, half * (half + 1)) for c in counts]
    assert sum(exact) == 1
    assert sum(w * w for w in exact) == Fraction(2 * half + 1, 3 * half * (half + 1))
    weights = averaging_weights(n, "overlapping")
    np.testing.assert_allclose(weights, [float(w) for w in exact], rtol=4 * n * np.finfo(float).eps)
    # Not "unaffected by the averaging algorithm": the variance grows by 2(2h + 1)/3(h + 1) → 4/3.
    ratio = float(np.sum(weights**2) / np.sum(averaging_weights(n, "linear") ** 2))
    assert ratio == pytest.approx(2 * (2 * half + 1) / (3 * (half + 1)), rel=1e-12)
    # 1.155 in sigma for long windows, from below.
    limit = math.sqrt(4 / 3)
    assert limit * (1 - 1 / (2 * (half + 1))) < math.sqrt(ratio) < limit


def test_erratum_6_in_simulated_windows():
    """Variance of window means of white noise, both algorithms, against N²/T and 4/3 of it."""
    noise, window_s, rate_hz = 1e-3, 2.0, 100.0
    motion = sims.table1_motion(
        site=Site(G), sequences=("1", "7"), dwell_s=window_s, sample_rate_hz=rate_hz, earth_rate=False
    )
    still = sims.read_out(motion, SensorErrors())
    rng = np.random.default_rng(20)
    squares = {"linear": [], "overlapping": []}
    for _ in range(60):
        recording = sims.read_out(motion, SensorErrors(), sims.ImuModel(accel_noise=noise), rng)
        for average, found in squares.items():
            options = Options(average=average)
            noisy = prepare(recording, recording.sequences, options.average).windows
            clean = prepare(still, still.sequences, options.average).windows
            found.append((noisy.accel_mean - clean.accel_mean) ** 2)
            assert noisy.white_factor[0] == pytest.approx(
                {"linear": 1.0, "overlapping": 2 * 201 / (3 * 101)}[average] / window_s, rel=1e-12
            )
    count = np.size(squares["linear"])
    low, high = chi2.ppf([1e-4, 1 - 1e-4], count) / count
    linear, overlapping = (np.mean(squares[a]) * window_s / noise**2 for a in ("linear", "overlapping"))
    assert low < linear < high
    assert low < overlapping / (2 * 201 / (3 * 101)) < high
    assert overlapping > high  # "unaffected" is refuted by the data alone


def test_erratum_6_does_not_touch_the_ramp_response():
    """F_Meas = 1/2 for both algorithms: a symmetric weighting answers a ramp with its middle."""
    for average in ("linear", "overlapping"):
        for n in (2, 7, 200):
            weights = averaging_weights(n, average)
            ramp = (np.arange(n) + 0.5) / n
            assert weights @ ramp == pytest.approx(0.5, abs=n * np.finfo(float).eps)
    seven = SEQUENCES["7"]
    C = ideal_rotations([seven]).C_end[0]
    with_windows = ideal_rotations([seven], window_s=10.0).time[0] - ideal_rotations([seven]).time[0]
    np.testing.assert_allclose(with_windows, 10.0 * (np.eye(3) + 0.5 * (C - np.eye(3))), atol=1e-14)
