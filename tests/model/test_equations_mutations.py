"""Every sign of the model counts: each is flipped in turn, and the simulator must notice.

The sources of the measurement model, of the ideal rotations and of the closed form are parsed, one sign is changed at
a time (plus and minus swapped, a leading minus dropped, a table's coefficient negated), and the altered module is
held against references that share no line with it: derivatives through the simulator, integrals by brute force,
numerical derivatives of the exact compensation, and what the simulator's fixture has an IMU sense while it turns with
the Earth.
"""

import ast
import inspect
import sys
from functools import partial
from types import ModuleType

import numpy as np
import pytest
from ideal_table_1 import RATE_RAD_S, WINDOW_S, G, Simulated
from scipy.spatial.transform import Rotation

from sims.physics.fixture import FixtureDraw, FixtureGeometry, rotation
from srt.model import closed_form, measurement_model, rotation_integrals
from srt.model.rotations import cross_matrix
from srt.model.sensor_model import Triad, accel_triad, gyro_triad
from srt.model.table1 import AXES, SEQUENCES, RotationSequence
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

MODULES = (measurement_model, rotation_integrals, closed_form)
PERFECT = Triad(np.eye(3), np.zeros(3), np.zeros(3))

# --- references -----------------------------------------------------------------------------------------------------

ODD = RotationSequence("odd", "z", "y", 0.0, 0.0, (("x", 0.7), ("y", -1.9), ("z", 2.3), ("x", -0.4)))
"""No half turns here, so that no sine or cosine is 0 or ±1."""


def brute_force_integrals(sequence, rate):
    """The integrals of a rotation by Gauss-Legendre quadrature of scipy's rotations, 40 nodes in each."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    C = np.eye(3)
    out = {
        "rate": np.zeros((3, 3, 3)),
        "abs_rate": np.zeros((3, 3)),
        "time": np.zeros((3, 3)),
        "noise": np.zeros((3, 3, 3)),
        "angle": np.zeros(3),
        "weight_s": 0.0,
    }
    for axis, angle in sequence.rotations:
        u = np.eye(3)[AXES.index(axis)]
        duration = abs(angle) / rate
        for x, w in zip(nodes, weights, strict=True):
            A = C @ Rotation.from_rotvec(0.5 * (x + 1.0) * angle * u).as_matrix()
            dt = 0.5 * w * duration
            ω = u * angle / duration
            out["rate"] += dt * A[:, :, None] * ω
            out["abs_rate"] += dt * A * np.abs(ω)
            out["time"] += dt * A
            out["noise"] += dt * np.einsum("ab,cb->acb", A, A)
            out["angle"] += dt * ω
            out["weight_s"] += dt
        C = C @ Rotation.from_rotvec(angle * u).as_matrix()
    return out | {"C_end": C}


REFERENCE = {name: brute_force_integrals(s, 0.8) for name, s in {"odd": ODD, "6": SEQUENCES["6"]}.items()}


def ramped_integrals(sequence, rate, acceleration):
    """Integrals over time with a trapezoidal rate: Gaussian quadrature of the angle at each time."""
    x, w = np.polynomial.legendre.leggauss(60)
    C, time, noise, weight_s = np.eye(3), np.zeros((3, 3)), np.zeros((3, 3, 3)), 0.0
    most = rate
    for u, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
        rate = min(most, np.sqrt(abs(angle) * acceleration))  # a triangle where the angle is small
        ramp_s = rate / acceleration
        total = abs(angle) / rate + ramp_s
        for a, b in ((0.0, ramp_s), (ramp_s, total - ramp_s), (total - ramp_s, total)):
            for t, dt in zip(0.5 * (a + b + (b - a) * x), 0.5 * (b - a) * w, strict=True):
                beta = 0.5 * acceleration * min(t, ramp_s) ** 2 + rate * max(0.0, min(t, total - ramp_s) - ramp_s)
                late = max(0.0, t - total + ramp_s)
                beta += rate * late - 0.5 * acceleration * late**2
                A = C @ Rotation.from_rotvec(np.sign(angle) * beta * u).as_matrix()
                time += dt * A
                noise += dt * np.einsum("ab,cb->acb", A, A)
        weight_s += total
        C = C @ Rotation.from_rotvec(angle * u).as_matrix()
    return {"time": time, "noise": noise, "weight_s": weight_s}


RAMPED = ramped_integrals(ODD, 0.8, 1.3)
WINDOW_NOISE = 5.0 / 3.0  # of one window of 5 s: ∫ F² dt of a ramp from 0 to 1

ERRORS = SensorErrors(np.random.default_rng(5).uniform(-0.1, 0.1, N_PARAMETERS))
FORCE = np.array([[3.0, -7.0, 5.0], [-8.0, 2.0, 4.0]])
OMEGA = np.array([[0.3, -0.8, 0.5], [-0.4, 0.9, -0.2]])


def minus_derivative(triad_of, errors, reading, rectified=0.0):
    """Minus d(compensated)/d(estimate): change of the compensated value per error of the estimate.

    By vibration, the mean reading has asymmetry times a rectified rate besides, which the estimate takes off.
    """
    step = 1e-5

    def compensated(estimate):
        triad = triad_of(estimate)
        return triad.compensate(reading - triad.asymmetry * rectified)

    columns = [
        (compensated(errors.plus(-d)) - compensated(errors.plus(d))) / (2 * step) for d in step * np.eye(N_PARAMETERS)
    ]
    return np.stack(columns, axis=-1)


# Truncation of the central difference: step² times the third derivative, some 10 · 6 · |f| here; rounding 1e-16 / step.
NUMERICAL = 1e-10 * 60 * 10 + 1e-10
FORCE_JACOBIAN = minus_derivative(accel_triad, ERRORS, accel_triad(ERRORS).read(FORCE))
RATE_JACOBIAN = minus_derivative(gyro_triad, ERRORS, gyro_triad(ERRORS).read(OMEGA))
RECTIFIED = np.array([[0.05, 0.2, 0.1], [0.3, 0.02, 0.15]])
READING = gyro_triad(ERRORS).read(OMEGA) + gyro_triad(ERRORS).asymmetry * RECTIFIED
VIBRATING_JACOBIAN = minus_derivative(gyro_triad, ERRORS, READING, RECTIFIED)

# An Earth that turns by 0.08 rad while the fixture does: in the real one's 1e-3 a wrong sign would hide.
EARTH_NED = np.array([0.02, -0.005, -0.015])
TURN_S = 3.0
HEADING = 0.7
DRAW = FixtureDraw(base=np.array([0.05, -0.08, 0.1]), mounting=np.array([-0.06, 0.09, 0.04]))
MARS = rotation([0.2, -0.1, 0.3])
FIXTURE = FixtureGeometry.build(HEADING, DRAW, MARS)
BASE, MOUNTED = rotation(DRAW.base), MARS @ rotation(DRAW.mounting).T
START, END = (0.4, -0.7), (1.9, 1.1)
"""Inner and outer angle."""


def sensed_turn():
    """B_End to B_Strt against inertial space, from the rates that a gyro on the fixture senses between two poses.

    Both axes turn at a constant rate; 400 steps of fourth order leave 1e-12 rad.
    """
    speed = (np.array(END) - START) / TURN_S
    dt = TURN_S / 400
    C = Rotation.identity()

    def rate(t):
        inner, outer = START + speed * t
        earth = FIXTURE.attitude(inner, outer).T @ EARTH_NED
        at = FIXTURE.turned(np.array(inner), np.array(outer))
        return FIXTURE.turning_rate(at, np.array(speed[0]), np.array(speed[1])) + earth

    for i in range(400):
        one, two = (rate(dt * (i + 0.5 + side * np.sqrt(3) / 6)) for side in (-1.0, 1.0))
        C = C * Rotation.from_rotvec(0.5 * dt * (one + two) + np.sqrt(3) / 12 * dt**2 * np.cross(one, two))
    return C.as_matrix()


TURNED = sensed_turn()
WINDOWS = np.stack([FIXTURE.attitude(*START), FIXTURE.attitude(*END)])
# Not on the fixture, nor near what was measured: no residual, sine or cosine is 0 or 1 here.
ELSEWHERE = WINDOWS @ Rotation.from_rotvec([[0.3, -0.2, 0.25], [-0.15, 0.35, 0.2]]).as_matrix()


def on_fixture(inner, outer):
    """R_y(outer) R_z(inner)."""
    return Rotation.from_euler("YZ", [outer, inner]).as_matrix()


# --- the check ------------------------------------------------------------------------------------------------------


def close(a, b, tolerance):
    return bool(np.all(np.abs(np.asarray(a) - np.asarray(b)) <= tolerance))


def integrals_hold(integrals):
    for name, sequence in {"odd": ODD, "6": SEQUENCES["6"]}.items():
        expected = REFERENCE[name]
        found = integrals.ideal_rotations([sequence], 0.8)
        if not all(close(getattr(found, key)[0], value, 1e-12) for key, value in expected.items()):
            return False
        if name == "odd":
            ramped = integrals.ideal_rotations([sequence], 0.8, acceleration_rad_s2=1.3)
            if not all(close(getattr(ramped, key)[0], value, 1e-12) for key, value in RAMPED.items()):
                return False
        # Windows by eq. 21 and by the noise of a ramp.
        found = integrals.ideal_rotations([sequence], 0.8, 5.0, 0.3)
        C = expected["C_end"]
        windows = 5.0 * (0.7 * np.eye(3) + 0.3 * C)
        noise = WINDOW_NOISE * (np.einsum("ab,cb->acb", np.eye(3), np.eye(3)) + np.einsum("ab,cb->acb", C, C))
        if not (
            close(found.time[0], expected["time"] + windows, 1e-12)
            and close(found.noise[0], expected["noise"] + noise, 1e-12)
            and close(found.weight_s[0], expected["weight_s"] + 5.0, 1e-12)
        ):
            return False
    return True


def table_1_holds(model, integrals, run, window_s):
    """All components of the 17 sequences against the simulator."""
    for name, s in SEQUENCES.items():
        found = integrals.ideal_rotations([s], RATE_RAD_S, window_s)
        horizontal = [a for a in AXES if a != s.down]
        down = np.eye(3)[[AXES.index(s.down)]]
        basis = np.eye(3)[[AXES.index(a) for a in horizontal]][None]
        if not close(basis[0], basis[0] @ model.horizontal_projector(down)[0], 1e-15):
            return False
        f_start = -G * down
        f_end = np.einsum("kab,ka->kb", found.C_end, f_start)
        rows = dict(zip(horizontal, model.horizontal_jacobian(found, basis, f_start, f_end, PERFECT)[0], strict=True))
        rows |= {
            "start": model.down_jacobian(f_start, PERFECT)[0],
            "end": model.down_jacobian(f_end, PERFECT)[0],
        }
        if not all(close(row, run.row(name, c), run.tolerance(name)) for c, row in rows.items()):
            return False
    return True


def model_holds(model):
    """Jacobians away from zero error and directions off the axes, which Table 1 does not show."""
    down = np.array([[0.6, -0.48, 0.64]])
    return (
        close(model.force_error_jacobian(FORCE, accel_triad(ERRORS)), FORCE_JACOBIAN, NUMERICAL)
        and close(model.rate_error_jacobian(OMEGA, gyro_triad(ERRORS)), RATE_JACOBIAN, NUMERICAL)
        and close(model.rate_error_jacobian(OMEGA, gyro_triad(ERRORS), RECTIFIED), VIBRATING_JACOBIAN, NUMERICAL)
        and close(model.horizontal_projector(down)[0] @ down[0], 0.0, 1e-15)
        and close(model.horizontal_projector(down)[0] @ np.array([0.8, 0.36, -0.48]), [0.8, 0.36, -0.48], 1e-15)
    )


def derivative(function, step=1e-5):
    """Central differences of a function of three small numbers, the derivative's index last."""
    return np.stack([(function(d) - function(-d)) / (2 * step) for d in step * np.eye(3)], axis=-1)


def turned_by(v):
    return Rotation.from_rotvec(v).as_matrix()


def poses_hold(model):
    """Force and rate of windows: nothing left at the truth, and derivatives away from it."""
    earth = np.broadcast_to(EARTH_NED, (2, 3))
    force, rate = -G * WINDOWS[:, 2], WINDOWS.transpose(0, 2, 1) @ EARTH_NED
    residual, by_attitude, by_gravity = model.specific_force_residual(force, ELSEWHERE, G)
    at_rest, rate_by_attitude, by_earth = model.angular_rate_residual(rate, ELSEWHERE, earth)
    return (
        close(model.specific_force_residual(force, WINDOWS, G)[0], 0.0, 1e-14)
        and close(model.angular_rate_residual(rate, WINDOWS, earth)[0], 0.0, 1e-16)
        and close(
            by_attitude,
            derivative(lambda v: model.specific_force_residual(force, ELSEWHERE @ turned_by(v), G)[0]),
            NUMERICAL,
        )
        and close(by_gravity, model.specific_force_residual(force, ELSEWHERE, G + 1.0)[0] - residual, 1e-14)
        and close(
            rate_by_attitude,
            derivative(lambda v: model.angular_rate_residual(rate, ELSEWHERE @ turned_by(v), earth)[0]),
            NUMERICAL,
        )
        and close(by_earth, derivative(lambda v: model.angular_rate_residual(rate, ELSEWHERE, earth + v)[0]), NUMERICAL)
        and close(at_rest, rate - ELSEWHERE.transpose(0, 2, 1) @ EARTH_NED, 1e-16)
    )


def turns_hold(model):
    """The turn between two poses, and its part about the vertical, as gyros sense it; derivatives elsewhere."""
    T, earth = np.array([TURN_S]), EARTH_NED[None]
    off_start, off_end = ELSEWHERE[:1], ELSEWHERE[1:]

    def found(s=0.0, e=0.0, c=0.0, ω=0.0):
        C = turned_by(np.zeros(3) - c) @ TURNED[None]
        s, e = (turned_by(np.zeros(3) + v) for v in (s, e))
        return model.rotation_residual(C, off_start @ s, off_end @ e, earth + ω, T), off_start @ s

    # The left Jacobian of the Earth's turn is taken to first order: (ω_e T)² / 6 of the derivative is left out. What
    # multiplies it, the inverse Jacobian of a residual below 1 rad, and the next order are below 1.5 together.
    neglected = 1.5 * TURN_S * (np.linalg.norm(EARTH_NED) * TURN_S) ** 2 / 6.0
    held = close(model.rotation_residual(TURNED[None], WINDOWS[:1], WINDOWS[1:], earth, T)[0], 0.0, 1e-11)
    for part in (lambda whole, _: whole, model.heading_residual):
        _, *by = part(*found())
        for name, J in zip("secω", by, strict=True):
            expected = derivative(lambda v, name=name, part=part: part(*found(**{name: v}))[0])
            held = held and close(J, expected, NUMERICAL + neglected * (name == "ω"))
    return held and close(part(*found())[0], off_start[0, 2] @ found()[0][0][0], 1e-15)


def stated_rates_hold(model):
    """A unit that turns at the stated rate, and about the same axis with the Earth; derivatives away from it."""
    axis, stated = np.array([0.6, -0.48, 0.64]), 0.5
    executed = (stated + EARTH_NED @ axis) * axis
    _, by_rate, by_earth = model.stated_rate_residual(OMEGA[0], EARTH_NED, stated)
    return (
        close(model.stated_rate_residual(executed, EARTH_NED, stated)[0], 0.0, 1e-15)
        and close(
            by_rate, derivative(lambda v: model.stated_rate_residual(OMEGA[0] + v, EARTH_NED, stated)[0]), NUMERICAL
        )
        and close(
            by_earth, derivative(lambda v: model.stated_rate_residual(OMEGA[0], EARTH_NED + v, stated)[0]), NUMERICAL
        )
    )


def starts_hold(model):
    """Angles of the fixture, over the border of a half turn too, and the lean of its axes."""
    off = np.array([0.03, -0.02])
    angles = np.array([START, END, (np.pi - 0.01, 0.2), (0.3, 0.02 - np.pi)])
    attitude = np.stack([FIXTURE.attitude(*(a + off)) for a in angles])
    nominal = np.stack([on_fixture(*a) for a in angles])
    lean = 0.05
    leaning = FixtureGeometry(FIXTURE.base_from_ned, lean, FIXTURE.body_from_inner).attitude(*START)[None]

    def residual(a=0.0, b=0.0, u=0.0, n=0.0):
        a, b, u = (turned_by(np.zeros(3) + v) for v in (a, b, u))
        return model.start_attitude_residual(ELSEWHERE @ a, nominal[:2], BASE @ b, MOUNTED @ u, HEADING, lean + n)[0]

    _, by_attitude, by_base, by_U, by_lean = model.start_attitude_residual(
        ELSEWHERE, nominal[:2], BASE, MOUNTED, HEADING, lean
    )
    return (
        close(model.start_attitude_residual(attitude, nominal, BASE, MOUNTED, HEADING)[0], [*off, 0.0], 1e-14)
        and close(
            model.start_attitude_residual(leaning, nominal[:1], BASE, MOUNTED, HEADING)[0][0, 2], -np.sin(lean), 1e-14
        )
        and close(by_attitude, derivative(lambda v: residual(a=v)), NUMERICAL)
        and close(by_base, derivative(lambda v: residual(b=v)), NUMERICAL)
        and close(by_U, derivative(lambda v: residual(u=v)), NUMERICAL)
        and close(by_lean[..., 0], derivative(lambda v: residual(n=v[0]))[..., 0], NUMERICAL)
        and close(
            model.start_attitude_residual(leaning, nominal[:1], BASE, MOUNTED, HEADING, lean)[0][0, 2], 0.0, 1e-14
        )
    )


def inversion_holds(closed, run):
    for sequences, kept in (
        (list(SEQUENCES), range(24)),
        ([s for s in SEQUENCES if not s.endswith("a")], [*range(3), *range(6, 24)]),
        ([s for s in SEQUENCES if s not in {"1", "2", "3"}], [*range(3), *range(6, 24)]),
    ):
        chosen = closed.formulas(sequences)
        components = closed.components(chosen)
        A = closed.inversion_matrix(chosen, G)
        J = np.array([run.row(c.sequence, c.kind) for c in components])
        tolerance = np.abs(A) @ np.array([Simulated.tolerance(c.sequence) for c in components])
        index = np.ix_(kept, kept)
        if not close((A @ J)[index], np.eye(len(kept)), tolerance[index]):
            return False
    return closed.sequences_needed("accel_asymmetry_z") == ("2", "2a", "7", "8")


def holds(simulated, model=measurement_model, integrals=rotation_integrals, closed=closed_form):
    """Every check that the given modules take part in, of which at most one is altered."""
    if closed is not closed_form:
        return inversion_holds(closed, simulated("held"))
    return (
        (model is not measurement_model or integrals_hold(integrals))
        and model_holds(model)
        and poses_hold(model)
        and turns_hold(model)
        and stated_rates_hold(model)
        and starts_hold(model)
        and table_1_holds(model, integrals, simulated("held"), 0.0)
        and table_1_holds(model, integrals, simulated("integrated"), WINDOW_S)
        and inversion_holds(closed, simulated("held"))
    )


# --- mutants --------------------------------------------------------------------------------------------------------


WITHOUT_EFFECT = ("angle + np.pi",)
"""Half a turn before the remainder by a whole one: added or taken off, the remainder is the same."""


def sign_changes(tree):
    """Every sign of a module, as (place, function that flips it in this tree)."""
    skipped: set[int] = set()
    parents = {id(child): parent for parent in ast.walk(tree) for child in ast.iter_child_nodes(parent)}
    for node in ast.walk(tree):
        # Defaults are choices, annotations are types; copysign takes no sign from its first argument.
        if isinstance(node, ast.arguments) or (isinstance(node, ast.Attribute) and node.attr == "copysign"):
            outer = parents[id(node)] if isinstance(node, ast.Attribute) else node
            skipped |= {id(n) for n in ast.walk(outer)}
    changes = []
    for node in ast.walk(tree):
        if id(node) in skipped or (isinstance(node, ast.BinOp) and ast.unparse(node) in WITHOUT_EFFECT):
            continue
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Add | ast.Sub):
            change = swap
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            change = drop_minus
        elif is_positive_number(node, parents):
            change = negate
        else:
            continue
        changes.append((f"{node.lineno}:{node.col_offset}", partial(change, node)))
    return changes


def is_positive_number(node, parents):
    """A float that bears no minus yet, or the 1 in a fraction such as 1 / 4; other integers only count and index."""
    if not isinstance(node, ast.Constant) or isinstance(parents[id(node)], ast.UnaryOp):
        return False
    fraction = isinstance(parents[id(node)], ast.BinOp) and isinstance(parents[id(node)].op, ast.Div)
    number = isinstance(node.value, float) or (isinstance(node.value, int) and fraction)
    return number and node.value != 0 and (not fraction or parents[id(node)].left is node)


def swap(node):
    node.op = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()


def drop_minus(node):
    node.op = ast.UAdd()


def negate(node):
    node.value = -node.value


def load(module, tree, monkeypatch):
    """The module that an altered tree makes."""
    name = f"mutant_of_{module.__name__.replace('.', '_')}"
    mutant = ModuleType(name)
    monkeypatch.setitem(sys.modules, name, mutant)
    exec(compile(tree, name, "exec"), mutant.__dict__)  # noqa: S102 - our own source with one sign changed
    return mutant


KEYWORD = {measurement_model: "model", rotation_integrals: "integrals", closed_form: "closed"}


def test_the_unchanged_model_holds(simulated):
    assert holds(simulated)


@pytest.mark.parametrize("module", MODULES, ids=lambda m: m.__name__)
def test_every_changed_sign_is_noticed(simulated, monkeypatch, module):
    source = inspect.getsource(module)
    count = len(sign_changes(ast.parse(source)))
    assert count >= {measurement_model: 25, rotation_integrals: 15, closed_form: 30}[module]  # the source was read
    survivors = []
    for target in range(count):
        tree = ast.parse(source)
        where, change = sign_changes(tree)[target]
        change()
        try:
            unnoticed = holds(simulated, **{KEYWORD[module]: load(module, tree, monkeypatch)})
        except (ArithmeticError, LookupError, TypeError, ValueError, np.linalg.LinAlgError):
            continue  # it does not even run
        if unnoticed:
            survivors.append(where)
    assert not survivors, f"sign changes of {module.__name__} at line:column that nothing notices: {survivors}"


@pytest.mark.parametrize("table", ["GYRO_BASIS", "ACCEL_BASIS"])
def test_every_changed_sign_of_a_parameter_s_place_is_noticed(simulated, monkeypatch, table):
    """The sign of each matrix entry of a parameter, two entries for a non-orthogonality."""
    original = getattr(measurement_model, table)
    for place in np.argwhere(original):
        altered = original.copy()
        altered[tuple(place)] *= -1.0
        monkeypatch.setattr(measurement_model, table, altered)
        assert not table_1_holds(measurement_model, rotation_integrals, simulated("held"), 0.0), place


def test_every_changed_sign_of_the_cross_product_is_noticed(simulated, monkeypatch):
    for module in (measurement_model, rotation_integrals):
        for i, j in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)):

            def altered(v, i=i, j=j):
                out = cross_matrix(v)
                out[..., i, j] *= -1.0
                return out

            with monkeypatch.context() as patch:
                patch.setattr(module, "cross_matrix", altered)
                assert not holds(simulated), (module.__name__, i, j)


def test_tolerances_tell_a_flipped_entry_of_the_jacobian(simulated):
    """No nonzero entry is so small that its negative would pass."""
    run = simulated("integrated")
    for name, s in SEQUENCES.items():
        for component in [a for a in AXES if a != s.down] + ["start", "end"]:
            row = run.row(name, component)
            tolerance = run.tolerance(name)
            seen = np.abs(row) > tolerance
            assert np.all(2.0 * np.abs(row[seen]) > 100.0 * tolerance[seen])
            # What counts as seen is what the paper's equations have.
            assert seen.sum() >= 1
    assert np.abs(run.J[-3:, GROUP_SLICES["gyro_bias"]] - np.eye(3)).max() < 1e-9
