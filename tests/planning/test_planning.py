"""Plans: the optimum and its bound, predicted accuracy against estimators and simulated units, what is out of reach."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sims
import srt
from sims.scenarios.plan_file import load_plan_file
from srt.estimation.goodness_of_fit import CONTRADICTION_PROBABILITY
from srt.estimation.observability import default_prior
from srt.exceptions import DataError, InputError
from srt.model.table1 import SEQUENCES
from srt.planning.candidates import from_catalogue
from srt.planning.conditions import N_UNKNOWNS, Conditions
from srt.planning.continuous_design import Columns, optimal_design
from srt.planning.fixture_kinematics import AxisKinematics, FixtureKinematics
from srt.planning.next_sequence import known_information, next_sequences
from srt.planning.plan import PlanLimits
from srt.planning.planner import make_plan, table_1_plan
from srt.planning.prediction import predict
from srt.result.verdict import MISFIT_PROBABILITY
from srt.sensor_errors import GROUP_SLICES, INDEX, NAMES

pytestmark = pytest.mark.usefixtures("short_search")

QUICK = PlanLimits(shortest_window_s=4.0, longest_window_s=30.0, largest_turn_deg=360, most_legs=2, most_sequences=12)
FEW = PlanLimits(shortest_window_s=2.0, longest_window_s=30.0, largest_turn_deg=360, most_legs=2, most_sequences=14)
ONE = replace(FEW, most_legs=1, most_sequences=4)
"""Limits of a fixture with one axis, which shows four parameters."""
STAND = FixtureKinematics(AxisKinematics(1.0, 10.0), AxisKinematics(1.0, 10.0), settle_s=0.5, pause_s=0.5)
WHITE = {"gyro_noise_deg_per_sqrt_h": 0.0667, "accel_noise_ug_per_sqrt_hz": 60.0}


def file_of(noise=None, **stand):
    """A shipped plan file with another fixture's freedom; ``noise`` replaces all figures of the unit."""
    base = load_plan_file("tactical-equal")
    imu = base.imu if noise is None else base.imu.model_copy(update={"noise": type(base.imu.noise)(**noise)})
    recording = base.recording.model_copy(update={"sample_rate_hz": 50.0})
    figures = {"settle_s": 0.5, "pause_s": 0.5, "acceleration_rad_s2": 10.0, **stand}
    return base.model_copy(update={"imu": imu, "stand": base.stand.model_copy(update=figures), "recording": recording})


def table_1_scenario(file, seed, **schedule):
    """Sequences of Table 1 with windows of 10 s, for the unit, fixture and site of a plan file."""
    return sims.scenario_from_dict(
        {
            "seed": seed,
            "imu": file.imu.model_dump(exclude_none=True),
            "fixture": file.fixture.model_dump(),
            "site": file.site.model_dump(exclude_none=True),
            "schedule": {"dwell_s": 10.0, "settle_s": 0.5, **schedule},
            "recording": {"sample_rate_hz": 50.0},
        }
    )


@pytest.fixture(scope="module")
def white():
    """A plan for a unit of white noise, with its file."""
    file = file_of(WHITE)
    plan = make_plan(file.stand.kinematics(), file.conditions(), file.targets.sigma(), total_s=300.0, limits=QUICK)
    return file, plan


def columns_of(strengths, costs):
    """Columns that each tell of one unknown."""
    q = len(strengths)
    rows = np.zeros((q, 1, q))
    rows[np.arange(q), 0, np.arange(q)] = np.sqrt(strengths)
    return Columns(rows, np.array(costs), 1e-9 * np.eye(q), np.arange(q), np.zeros(q))


@given(st.lists(st.tuples(st.floats(0.1, 10.0), st.floats(1.0, 50.0)), min_size=2, max_size=6))
@settings(max_examples=25, deadline=None)
def test_optimum_of_separate_unknowns(pairs):
    strengths, costs = np.array(pairs).T
    found = optimal_design(columns_of(strengths, costs), 100.0, gap=1e-3)
    # Equal variances: w_i a_i the same for all, with Σ c_i w_i = T.
    exact = math.sqrt(np.sum(costs / strengths) / 100.0)
    assert found.bound <= exact * (1.0 + 1e-6)
    # A billionth of the information is always there, and a hundredth of the time is spread over all columns.
    assert exact * (1.0 - 1e-6) <= found.ratio <= exact * (1.0 + 1.1e-3) / math.sqrt(0.99)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_no_weights_are_better_than_the_bound(seed):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((30, 3, 5))
    cost = rng.uniform(1.0, 20.0, 30)
    columns = Columns(rows, cost, 1e-6 * np.eye(5), np.arange(4), 0.01 * rng.uniform(0.0, 1.0, 4))
    found = optimal_design(columns, 50.0)
    # One per cent was asked for; half of one is what spreading a little of the time alike costs.
    assert found.gap <= 0.0152
    for _ in range(50):
        share = rng.dirichlet(np.full(30, rng.choice([0.05, 0.3, 1.0])))
        g, _ = columns.variances(columns.information(np.arange(30), 50.0 * share / cost))
        assert math.sqrt(g.max()) >= found.bound * (1.0 - 1e-9)


def test_predicted_sigma_is_that_of_the_estimator():
    """The planner counts what each sequence shows, without the tilt of the fixture's poses."""
    file = file_of(WHITE)
    scenario = table_1_scenario(file, 3)
    found = srt.calibrate(sims.simulate(scenario).recording, "least-squares", fixture_states=False)
    candidates = [from_catalogue(s, STAND) for s in SEQUENCES.values()]
    predicted = predict(candidates, np.full((17, 2), 10.0), STAND, file.conditions()).sigma
    # Ramps of 0.1 s at both ends of turns of 3 s and more are not at constant rate: 3 % in time, half of it in sigma;
    # units with errors of 0.3 % and the pooled bias (1 % of the information) do the rest.
    np.testing.assert_allclose(predicted / np.sqrt(np.diag(found.covariance)), 1.0, atol=0.03)


def test_drift_is_counted_about_as_the_estimator_does():
    file = file_of()
    candidates = [from_catalogue(s, STAND) for s in SEQUENCES.values()]
    scenario = table_1_scenario(file, 3)
    found = srt.calibrate(sims.simulate(scenario).recording, "least-squares", fixture_states=False)
    ratio = predict(candidates, np.full((17, 2), 10.0), STAND, file.conditions()).sigma / np.sqrt(
        np.diag(found.covariance)
    )
    # Drift counts as alike within a sequence and, beyond a minute, within the test: between the two the planner is
    # on the safe side for what rests on the difference of far windows.
    assert np.all((ratio > 0.8) & (ratio < 1.3)), dict(zip(NAMES, ratio.round(2), strict=True))


def test_a_plan_and_its_bound(white):
    _, plan = white
    assert plan.total_s == pytest.approx(300.0, rel=1e-6)
    assert plan.bound <= plan.ratio
    steps = plan.timetable()
    assert steps[-1].end_static_s[1] == pytest.approx(plan.total_s, abs=1e-6)
    assert all(c.obstacle(plan.fixture) is None for c in plan.candidates)
    assert np.all((plan.windows_s >= 4.0 - 1e-9) & (plan.windows_s <= 30.0 + 1e-9))
    # Sources add up to the variance.
    squares = sum(v**2 for v in plan.prediction.sources.values())
    np.testing.assert_allclose(np.sqrt(squares)[:24], plan.prediction.sigma[:24], rtol=1e-6)


def test_a_plan_is_better_than_table_1(white):
    file, plan = white
    table_1 = table_1_plan(file.stand.kinematics(), file.conditions(), file.targets.sigma(), 300.0, QUICK)
    assert plan.bound < plan.ratio < table_1.ratio


def test_needed_for_gives_the_growth_of_sigma_without_the_sequence(white):
    _, plan = white
    for k, need in enumerate(plan.prediction.needed_for[:4]):
        rest = [i for i in range(len(plan.candidates)) if i != k]
        without = predict(
            [plan.candidates[i] for i in rest], plan.windows_s[rest], plan.fixture, plan.conditions, plan.targets
        )
        for name, factor in need:
            growth = without.sigma[INDEX[name]] / plan.prediction.sigma[INDEX[name]]
            assert growth == pytest.approx(factor, rel=1e-6)


def nees_of_units(file, plan, estimator, units, first):
    """Mean of the normalised squared errors of simulated units by the predicted covariance, gravity left out.

    The attitudes of the fixture are not counted, as in the prediction.
    """
    gravity = plan.prediction.sources["gravity"]
    # Gravity acts on the three scales alike, and in full.
    P = plan.prediction.covariance - np.outer(gravity, gravity)
    scenario, total, doubted = file.scenario(plan), 0.0, 0
    for seed in range(first, first + units):
        simulation = sims.simulate(scenario.model_copy(update={"seed": seed}))
        found = srt.calibrate(simulation.recording, estimator, checks=False, fixture_states=False)
        doubted += found.status != "converged"
        error = found.errors.vector - simulation.truth.vector
        total += float(error @ np.linalg.solve(P, error))
    by_chance = units * (MISFIT_PROBABILITY + CONTRADICTION_PROBABILITY)
    assert doubted <= by_chance + 3.5 * math.sqrt(by_chance)
    return total / units


@pytest.mark.parametrize(
    ("estimator", "units"),
    [("least-squares", 5), *(pytest.param(e, 300, marks=pytest.mark.campaign) for e in ("least-squares", "graph"))],
)
def test_simulated_units_have_the_predicted_accuracy(white, estimator, units):
    file, plan = white
    mean = nees_of_units(file, plan, estimator, units, 1000)
    # 27 degrees of freedom, 3.5 standard errors; sigmas are predicted to 3 %, squares to 6 %.
    assert abs(mean / 27.0 - 1.0) < 3.5 * math.sqrt(2.0 / 27.0 / units) + 0.06


@pytest.mark.parametrize(
    "stand",
    [
        {"inner": {"travel_deg": (-180.0, 180.0)}, "outer": {"travel_deg": (-180.0, 180.0)}},
        pytest.param(
            {"inner": {"travel_deg": (-90.0, 100.0)}, "outer": {"travel_deg": (-100.0, 190.0)}}, marks=pytest.mark.slow
        ),
    ],
    ids=["half turns either way", "odd limits"],
)
def test_plans_for_limited_travel_are_executed(stand):
    file = file_of(WHITE)
    axes = {name: type(file.stand.inner)(**axis) for name, axis in stand.items()}
    file = file.model_copy(update={"stand": file.stand.model_copy(update=axes)})
    limits = replace(FEW, most_sequences=10)
    plan = make_plan(file.stand.kinematics(), file.conditions(), file.targets.sigma(), total_s=250.0, limits=limits)
    for candidate in plan.candidates:
        for axis, angles in zip(plan.fixture.axes, zip(*candidate.path_deg, strict=True), strict=True):
            assert axis.travel_deg[0] <= min(angles) <= max(angles) <= axis.travel_deg[1]
    found = srt.calibrate(sims.simulate(file.scenario(plan)).recording, "least-squares")
    assert found.status == "converged"
    assert found.observed.all()


ONE_AXIS = {"turns": False, "positions_deg": (0.0, 90.0), "set_s": 60.0}
SHOWN_BY_ONE_AXIS = ("gyro_scale_x", "gyro_scale_y", "gyro_asymmetry_x", "gyro_asymmetry_y")


def one_axis_stand(file):
    """The outer axis alone; the unit is remounted by hand, in a minute."""
    return file.stand.model_copy(update={"inner": type(file.stand.inner)(**ONE_AXIS)}).kinematics()


def test_a_fixture_with_one_axis():
    file = file_of(WHITE)
    stand, everything = one_axis_stand(file), file.targets.sigma()
    with pytest.raises(DataError, match=r"can execute shows gyro_scale_z, .*: take these targets out"):
        make_plan(stand, file.conditions(), everything, total_s=400.0, limits=FEW)
    some = np.full(27, math.nan)
    for name in SHOWN_BY_ONE_AXIS:
        some[INDEX[name]] = everything[INDEX[name]]
    plan = make_plan(stand, file.conditions(), some, total_s=400.0, limits=FEW)
    assert plan.ratio < 2.0
    assert {axis for c in plan.candidates for axis, _ in c.axis_rotations} == {1}


@pytest.mark.parametrize("axes", ["one", pytest.param("two", marks=pytest.mark.campaign)])
def test_the_shortest_test_meets_all_targets_and_hardly_more(axes):
    file = file_of(WHITE)
    wanted = np.full(27, math.nan)
    if axes == "one":
        stand = one_axis_stand(file)
        wanted[[INDEX[name] for name in SHOWN_BY_ONE_AXIS]] = 1e-5
    else:
        stand = file.stand.kinematics()
        wanted[GROUP_SLICES["gyro_scale"]], wanted[GROUP_SLICES["accel_bias"]] = 1e-5, 5e-4
    shortest = make_plan(stand, file.conditions(), wanted, limits=ONE if axes == "one" else FEW)
    assert shortest.unmet == ()
    # Sequences are whole: not more than half of the time more than is needed.
    assert shortest.ratio > 1.5**-0.5
    assert shortest.bound < shortest.ratio


@pytest.mark.slow
def test_targets_that_one_short_sequence_each_would_meet():
    file = file_of(WHITE)
    wanted = np.full(27, math.nan)
    wanted[[INDEX[name] for name in SHOWN_BY_ONE_AXIS]] = 1e-2
    plan = make_plan(one_axis_stand(file), file.conditions(), wanted, limits=ONE)
    assert plan.unmet == ()
    assert plan.ratio < 0.5


def test_targets_out_of_reach_name_the_limit():
    conditions, targets = file_of().conditions(), np.full(27, math.nan)
    targets[GROUP_SLICES["accel_scale"]] = 1e-8
    with pytest.raises(DataError, match=r"out of reach however long the test is.*gravity"):
        make_plan(STAND, conditions, targets, limits=FEW)
    targets = np.full(27, math.nan)
    targets[INDEX["gyro_scale_x"]] = 1e-6
    short = PlanLimits(4.0, 30.0, 360, 1, 400.0, most_sequences=6)
    with pytest.raises(DataError, match=r"out of reach in 0.111 h: gyro_scale_x stays at .* % of its variance by"):
        make_plan(one_axis_stand(file_of()), conditions, targets, limits=short)


@pytest.mark.parametrize(
    ("change", "said"),
    [(lambda t: t * math.nan, "no target"), (lambda t: -t, "not positive"), (lambda t: t[:5], "shape")],
)
def test_targets_that_are_none(change, said):
    with pytest.raises(InputError, match=said):
        make_plan(STAND, file_of().conditions(), change(file_of().targets.sigma()), total_s=300.0)


def test_a_time_that_is_too_short():
    for total_s in (5.0, 60.0):  # no sequence, and some that do not observe all targets
        with pytest.raises(InputError, match=f"^{total_s:g} s are too short for a test that observes all targets"):
            make_plan(STAND, file_of().conditions(), file_of().targets.sigma(), total_s=total_s, limits=ONE)
    with pytest.raises(InputError, match="too short for 17 sequences"):
        table_1_plan(STAND, file_of().conditions(), file_of().targets.sigma(), 200.0, QUICK)


@pytest.mark.parametrize("figures", [{"gyro_white": -1.0, "accel_white": 1.0}, {"gyro_white": 0.0, "accel_white": 1.0}])
def test_conditions_without_noise_or_sense(figures):
    with pytest.raises(InputError, match="gyro"):
        Conditions(**figures)


@pytest.fixture(scope="module")
def half_done():
    """A test that ran but for the sequences about z, and its file.

    With a wide prior it keeps what the test shows of combinations of unobserved parameters; with that of the fixture,
    more of them are fixed.
    """
    file = file_of(WHITE)
    ids = [name for name in SEQUENCES if name not in {"3", "3a", "6", "9", "10"}]
    scenario = table_1_scenario(file, 9, sequences=ids)
    return file, srt.calibrate(sims.simulate(scenario).recording, "least-squares", prior=default_prior())


def test_the_next_sequences_show_what_is_missing(half_done):
    file, so_far = half_done
    assert so_far.status == "partial"
    known = known_information(so_far, file.conditions())
    targets = file.targets.sigma()
    proposals = next_sequences(file.stand.kinematics(), file.conditions(), targets, known, limits=QUICK)
    assert 1 <= len(proposals) <= 5
    assert len({p.candidate.key for p in proposals}) == len(proposals)
    # Only turns about z and about the diagonal of x and y are missing: all that is proposed has a turn about z.
    assert all(any(axis == "z" for axis, _ in p.candidate.rotations) for p in proposals[:2])
    # Run all that is proposed in both senses, for asymmetry, and everything is seen.
    candidates = [p.candidate for p in proposals]
    candidates += [
        replace(c, axis_rotations=tuple((axis, -turn) for axis, turn in c.axis_rotations)) for c in candidates
    ]
    windows = np.array([p.windows_s for p in proposals] * 2)
    both = predict(candidates, windows, file.stand.kinematics(), file.conditions(), targets, known=known)
    assert np.all(both.sigma[np.isfinite(targets)] < 30.0 * targets[np.isfinite(targets)])


def test_known_information_is_that_of_the_sequences():
    """Information of a calibration plus one predicted sequence equals the prediction of all sequences together."""
    file = file_of(WHITE)
    conditions, stand = file.conditions(), file.stand.kinematics()
    done = [from_catalogue(s, stand) for s in SEQUENCES.values()]
    scenario = table_1_scenario(file, 9)
    found = srt.calibrate(sims.simulate(scenario).recording, "least-squares", fixture_states=False)
    known = known_information(found, conditions)
    assert known.shape == (N_UNKNOWNS, N_UNKNOWNS)
    more = [from_catalogue(SEQUENCES["8"], stand)]
    added = predict(more, np.full((1, 2), 10.0), stand, conditions, known=known)
    together = predict(done + more, np.full((18, 2), 10.0), stand, conditions)
    # As above: ramps and errors of 0.3 % make 3 %.
    np.testing.assert_allclose(added.sigma / together.sigma, 1.0, atol=0.03)


def test_a_calibration_that_observed_nothing(half_done):
    file, so_far = half_done
    nothing = replace(so_far, fixed=dict.fromkeys(NAMES, "none"), covariance=np.zeros((27, 27)))
    with pytest.raises(InputError, match="observed nothing"):
        known_information(nothing, file.conditions())
