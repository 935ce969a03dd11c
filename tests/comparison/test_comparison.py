"""Comparison of estimators, and the difference to expect between two of them."""

import json
from dataclasses import dataclass, replace
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from figure_texts import require_readable
from scipy.stats import binom, chi2, norm

import srt
import srt.comparison.estimator_comparison
from sims.scenarios.scenario import scenario_from_dict
from sims.scenarios.simulation import simulate
from srt.comparison.estimate_difference import EXPECTED_SIGMA_FLOOR, FALSE_ALARM, expected_covariance
from srt.comparison.estimator_comparison import compare, default_estimators, run_estimators
from srt.estimation.fixed_parameters import POSE_FRAME
from srt.reports.figures.comparison import comparison_figure
from srt.result.provenance import Provenance
from srt.sensor_errors import DISPLAY_FACTORS, GROUP_SLICES, INDEX, N_PARAMETERS, NAMES

DRAWS = 1000
UNITS = 1.0 / np.array(DISPLAY_FACTORS)


def calibration(values, covariance, name="closed-form", **changes):
    result = srt.Calibration(name, "converged", "Converged.", srt.SensorErrors(values), covariance, corrections=(1e-9,))
    return replace(result, **changes)


def hold(result, *names):
    covariance = result.covariance.copy()
    for name in names:
        covariance[INDEX[name]] = covariance[:, INDEX[name]] = 0.0
    return replace(result, covariance=covariance, fixed=dict.fromkeys(names, "held on request"), status="partial")


@dataclass
class LinearModel:
    """White noise of one on A x, in display units; estimated from all rows, and from the first half of them."""

    A: np.ndarray
    rng: np.random.Generator

    def gain(self, rows):
        gain = np.zeros((N_PARAMETERS, len(self.A)))
        gain[:, :rows] = np.linalg.pinv(self.A[:rows])
        gain *= UNITS[:, None]
        return gain, gain @ gain.T

    def draw(self):
        """Give the estimates of one recording, whose truth is zero."""
        noise = self.rng.standard_normal(len(self.A))
        return {
            name: calibration(gain @ noise, covariance, name)
            for name, (gain, covariance) in {"closed-form": self.half, "least-squares": self.all}.items()
        }

    def __post_init__(self):
        self.half, self.all = self.gain(len(self.A) // 2), self.gain(len(self.A))


@pytest.fixture
def model():
    rng = np.random.default_rng(4)
    # Columns of unequal size that lean on each other, as those of the rotation test do.
    mix = np.eye(N_PARAMETERS) + 0.1 * rng.standard_normal((N_PARAMETERS, N_PARAMETERS))
    return LinearModel(rng.standard_normal((100, N_PARAMETERS)) @ mix * rng.uniform(0.3, 3.0, N_PARAMETERS), rng)


@pytest.fixture
def pair(model):
    return model.draw()


def shifted(result, name, amount):
    delta = np.zeros(N_PARAMETERS)
    delta[INDEX[name]] = amount
    return replace(result, errors=result.errors.plus(delta))


def test_normalised_differences_are_standard_normal_and_false_alarms_as_stated(model):
    comparisons = [compare(model.draw()) for _ in range(DRAWS)]
    pairs = [c.differences["closed-form"] for c in comparisons]
    assert {c.reference for c in comparisons} == {"least-squares"}
    normalised = np.array([p.normalised for p in pairs])
    # Sums of squares of 27 parameters, each within a band that all keep with probability 0.9997.
    sums = np.sum(normalised**2, axis=0)
    edge = 1e-4 / N_PARAMETERS
    assert chi2.ppf(edge, DRAWS) < sums.min()
    assert sums.max() < chi2.isf(edge, DRAWS)
    # The shape, by the counts beyond one and two sigma.
    for limit in (1.0, 2.0):
        counts = np.sum(np.abs(normalised) > limit, axis=0)
        expected = 2.0 * norm.sf(limit)
        assert binom.ppf(edge, DRAWS, expected) <= counts.min()
        assert counts.max() <= binom.isf(edge, DRAWS, expected)
    # No eigenvalue needs its floor here: the chi-square has its 27 degrees of freedom.
    statistic = sum(p.chi_square for p in pairs)
    assert chi2.ppf(1e-4, DRAWS * N_PARAMETERS) < statistic < chi2.isf(1e-4, DRAWS * N_PARAMETERS)
    # The joint test alone gives half of the false alarms; with the other half there are FALSE_ALARM at most.
    alarms = sum(not c.agree for c in comparisons)
    assert binom.ppf(1e-3, DRAWS, 0.5 * FALSE_ALARM) <= alarms <= binom.isf(1e-3, DRAWS, FALSE_ALARM)


def test_exchanged_roles_raise_no_false_alarm_and_are_noted(model):
    comparisons = [compare(model.draw(), reference="closed-form") for _ in range(300)]
    assert sum(not c.agree for c in comparisons) <= binom.isf(1e-3, 300, FALSE_ALARM)
    assert comparisons[0].differences["least-squares"].smaller_sigma == NAMES
    assert "closed-form is not efficient for them" in comparisons[0].notes[0]
    np.testing.assert_allclose(
        comparisons[0].differences["least-squares"].expected_sigma,
        compare(comparisons[0].calibrations).differences["closed-form"].expected_sigma,
        rtol=1e-12,  # rounding of the eigenvalues of Pa - Pb and of Pb - Pa: n eps of the largest
    )


def test_the_reference_needs_to_be_clearly_less_efficient_for_a_note(pair):
    twin = replace(pair["least-squares"], covariance=0.91 * pair["least-squares"].covariance)
    assert compare({"a": pair["least-squares"], "b": twin}, reference="a").notes == ()
    twin = replace(twin, covariance=0.89 * pair["least-squares"].covariance)
    assert len(compare({"a": pair["least-squares"], "b": twin}, reference="a").notes) == 1


@pytest.mark.parametrize("name", ["gyro_scale_x", "accel_scale_z", "gyro_bias_y"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_planted_difference_is_found_and_named(pair, name, sign):
    before = compare(pair).differences["closed-form"]
    assert before.agrees
    # Six spreads from where the two agree exactly.
    wanted = sign * 6.0 * before.expected_sigma[INDEX[name]] - before.difference[INDEX[name]]
    comparison = compare(pair | {"closed-form": shifted(pair["closed-form"], name, wanted)})
    after = comparison.differences["closed-form"]
    assert after.normalised[INDEX[name]] == pytest.approx(sign * 6.0)
    assert [NAMES[i] for i in np.flatnonzero(after.differing)] == [name]
    assert not comparison.agree
    found = f"closed-form differs from least-squares: {name} by 6.0 times the expected standard deviation"
    assert found in comparison.verdict


def test_a_difference_of_all_together_is_found_though_none_alone_is_large(pair):
    D = pair["closed-form"].covariance - pair["least-squares"].covariance
    scale = pair["closed-form"].sigma
    eigenvalues, vectors = np.linalg.eigh(D / np.outer(scale, scale))
    # Nine of its own sigmas along the direction in which the two should differ least.
    delta = 9.0 * np.sqrt(eigenvalues[0]) * vectors[:, 0] * scale
    values = pair["least-squares"].errors.plus(delta)
    comparison = compare(pair | {"closed-form": replace(pair["closed-form"], errors=values)})
    assert comparison.differences["closed-form"].chi_square == pytest.approx(81.0)
    assert not comparison.differences["closed-form"].differing.any()
    assert not comparison.agree
    assert "in all parameters together, though in none alone" in comparison.verdict
    assert comparison.differences["closed-form"].p_value == pytest.approx(chi2.sf(81.0, 27))


def test_efficient_twins_may_differ_by_a_few_twentieths_of_sigma(pair):
    best = pair["least-squares"]
    sigma = float(best.sigma[INDEX["accel_bias_x"]])
    for share, agree in ((0.1, True), (0.3, False)):
        comparison = compare({"least-squares": best, "graph": shifted(best, "accel_bias_x", share * sigma)})
        assert comparison.reference == "graph"
        assert comparison.agree is agree
        normalised = comparison.differences["least-squares"].normalised[INDEX["accel_bias_x"]]
        assert normalised == pytest.approx(-share / EXPECTED_SIGMA_FLOOR)


def test_the_limit_is_for_all_parameters_of_all_pairs(pair):
    four = pair | {"ekf": pair["least-squares"], "graph": hold(pair["least-squares"], "gyro_bias_x")}
    comparison = compare(four)
    limit = comparison.differences["closed-form"].limit
    assert {p.limit for p in comparison.differences.values()} == {limit}
    assert (2.0 * norm.cdf(limit) - 1.0) ** (3 * 26) == pytest.approx(1.0 - 0.5 * FALSE_ALARM, rel=1e-12)
    assert {p.least_p_value for p in comparison.differences.values()} == {0.5 * FALSE_ALARM / 3}


def test_agreement_is_a_sentence(pair):
    comparison = compare(pair | {"ekf": pair["least-squares"]})
    worst = max(abs(comparison.differences["closed-form"].normalised))
    assert comparison.verdict.startswith("ekf, closed-form and least-squares agree: largest difference ")
    largest = NAMES[comparison.differences["closed-form"].largest]
    assert f"{worst:.1f} times its expected standard deviation ({largest} of closed-form; " in comparison.verdict
    assert comparison.differences["closed-form"].efficiency == pytest.approx(
        np.sqrt(np.mean((pair["closed-form"].sigma / pair["least-squares"].sigma) ** 2))
    )


def test_order_of_references():
    names = ["theirs", "closed-form", "least-squares", "ekf", "graph"]
    rest = {name: calibration(np.zeros(27), np.eye(27), name) for name in names}
    for expected in (*reversed(names[1:]), "theirs"):
        assert compare(rest).reference == expected
        del rest[expected]


def test_held_parameters_are_not_compared_but_named(pair):
    comparison = compare({"closed-form": hold(pair["closed-form"], "gyro_scale_x"), "graph": pair["least-squares"]})
    one = comparison.differences["closed-form"]
    assert int(one.compared.sum()) == 26
    assert np.isnan(one.difference[0])
    assert np.isnan(one.normalised[0])
    assert comparison.notes == ("Fixed by closed-form and not by the others: gyro_scale_x.",)
    both = {name: hold(result, "gyro_scale_x") for name, result in pair.items()}
    assert compare(both).notes == ()
    # What is compared is judged as if there were no more: the marginal difference.
    everything = compare(pair).differences["closed-form"]
    np.testing.assert_allclose(one.normalised[1:], everything.normalised[1:])


def test_nothing_in_common_is_no_agreement(pair):
    gyro, accel = (tuple(n for n in NAMES if n.startswith(kind)) for kind in ("gyro", "accel"))
    comparison = compare({"closed-form": hold(pair["closed-form"], *gyro), "ekf": hold(pair["least-squares"], *accel)})
    assert not comparison.agree
    assert comparison.verdict == "closed-form and ekf observed no parameter in common."
    json.dumps(comparison.as_dict(), allow_nan=False)


def test_a_sigma_of_zero_is_not_compared(pair):
    exact = replace(pair["least-squares"], covariance=np.zeros((27, 27)))
    assert not compare({"closed-form": pair["closed-form"], "graph": exact}).differences["closed-form"].compared.any()


def test_results_that_did_not_converge_are_shown_but_not_compared(pair):
    lost = replace(pair["least-squares"], status="not_converged", message="Not converged after 3 iterations.")
    comparison = compare(pair | {"graph": lost}, reference="graph")
    assert comparison.reference == "least-squares"
    assert set(comparison.differences) == {"closed-form"}
    assert comparison.agree
    assert not comparison.complete
    assert "The reference asked for, graph, gave no usable result; it is least-squares instead." in comparison.notes
    assert any("Not converged after 3" in note for note in comparison.notes)
    assert "graph" in comparison.calibrations


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_results_are_no_agreement(pair, count):
    comparison = compare(dict(list(pair.items())[:count]), failures={"ekf": "It cannot be."})
    assert not comparison.agree
    assert comparison.verdict.startswith("There is nothing to compare: ")
    assert comparison.as_dict()["failed"] == [{"name": "ekf", "message": "It cannot be."}]


def test_wrong_references_and_recordings_are_refused(pair):
    with pytest.raises(srt.InputError, match=r"'graph' is not among .*: closed-form, least-squares\."):
        compare(pair, reference="graph")
    marked = {n: replace(c, provenance=Provenance(data_sha256=n)) for n, c in pair.items()}
    with pytest.raises(srt.InputError, match="different recordings"):
        compare(marked)


def test_json_is_finite_and_holds_what_was_found(pair, tmp_path):
    comparison = compare(
        {"closed-form": hold(pair["closed-form"], "accel_bias_z"), "least-squares": pair["least-squares"]},
        seconds={"closed-form": 0.5},
        failures={"ekf": "It cannot be."},
        left_out={"graph": "It is not installed."},
        truth=srt.SensorErrors(),
    )
    comparison.save(tmp_path / "x.json")
    document = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))
    assert {key: value for key, value in document.items() if key != "digest"} == comparison.as_dict()
    assert (document["format"], document["version"]) == ("srt-comparison", 1)
    assert document["verdict"] == comparison.verdict
    assert [p["name"] for p in document["parameters"]] == list(NAMES)
    first, second = document["estimators"]
    assert (first["name"], first["seconds"], second["seconds"]) == ("closed-form", 0.5, None)
    assert (first["observed"], first["status"], first["playbacks"]) == (26, "partial", 1)
    assert second["comparison"] is None
    i = INDEX["accel_bias_z"]
    one = comparison.differences["closed-form"]
    for key, name in (("difference", "difference"), ("spread", "expected_sigma"), ("normalised", "normalised")):
        assert first["comparison"][key][i] is None
        assert first["comparison"][key][0] == getattr(one, name)[0]
    assert first["sigma"][i] is None
    assert first["error_over_sigma"][0] == pair["closed-form"].errors.vector[0] / pair["closed-form"].sigma[0]
    assert document["failed"][0]["name"] == "ekf"
    assert document["left_out"] == [{"name": "graph", "message": "It is not installed."}]


@pytest.fixture
def registry(monkeypatch, pair):
    """Let the estimators be what a test says, and recordings be labelled."""
    monkeypatch.setattr(srt.comparison.estimator_comparison, "label_sequences", lambda recording: (recording, None))

    def fails(recording, options, progress=None):
        raise srt.DataError("It cannot be.")

    def answers(recording, options, progress=None):
        if progress is not None:
            progress(1, 1e-3)
        return pair["least-squares"]

    def find(name):
        if name == "absent":
            raise srt.MissingExtraError("absent", "all", "The estimator 'absent'")
        return fails if name == "ekf" else answers

    monkeypatch.setattr(srt.comparison.estimator_comparison, "find_estimator", find)


def test_estimators_run_in_order_and_one_that_fails_stops_none(registry, pair):
    said = []
    calibrations, seconds, failures = run_estimators(
        SimpleNamespace(sequences=()), ["graph", "ekf", "least-squares"], progress=lambda *step: said.append(step)
    )
    assert list(calibrations) == ["graph", "least-squares"]
    assert failures == {"ekf": "It cannot be."}
    assert list(seconds) == ["graph", "ekf", "least-squares"]
    assert all(0.0 <= s < 1.0 for s in seconds.values())
    assert said == [("graph", 1, 1e-3), ("least-squares", 1, 1e-3)]
    assert compare(calibrations, failures=failures).failures == failures


def test_poses_alone_are_compared_in_the_axes_of_single_results(registry, pair, monkeypatch):
    held = []

    def estimator(recording, options, progress):
        held.append(options.hold)
        return pair["least-squares"]

    monkeypatch.setattr(srt.comparison.estimator_comparison, "find_estimator", lambda name: estimator)
    poses = SimpleNamespace(sequences=(SimpleNamespace(pose=True),), fixture=None)
    run_estimators(poses, ["graph", "least-squares"])
    assert held == [POSE_FRAME, POSE_FRAME]


def test_an_estimator_that_is_not_installed_is_refused_first(registry):
    with pytest.raises(srt.MissingExtraError, match="pip install"):
        run_estimators(None, ["graph", "absent"])


def test_default_estimators_are_those_that_fit(monkeypatch, registry):
    monkeypatch.setattr(srt.comparison.estimator_comparison, "ESTIMATORS", ("closed-form", "absent", "graph"))
    for automatic, left in (("closed-form", {"absent"}), ("least-squares", {"closed-form", "absent"})):
        monkeypatch.setattr(
            srt.comparison.estimator_comparison, "automatic_estimator", lambda recording, name=automatic: name
        )
        names, left_out = default_estimators(SimpleNamespace(sequences=()))
        assert set(left_out) == left
        assert "pip install" in left_out["absent"]
        assert set(names) == {"closed-form", "absent", "graph"} - left


def figures(pair):
    best = pair["least-squares"]
    four = pair | {"ekf": best, "graph": hold(best, "gyro_scale_x")}
    far = shifted(best, "accel_bias_y", 300.0 * best.sigma[INDEX["accel_bias_y"]])
    return {
        "two": (compare(pair), "unit"),
        "four with truth": (compare(four, truth=srt.SensorErrors()), None),
        "all far apart": (compare(four | {"ekf": far, "theirs": far}), "unit"),
        "one": (compare({"graph": best}), "unit"),
    }


@pytest.mark.parametrize("case", ["two", "four with truth", "all far apart", "one"])
def test_texts_of_the_figure_neither_overlap_nor_leave_it(pair, case):
    comparison, title = figures(pair)[case]
    before = dict(mpl.rcParams)
    figure = comparison_figure(comparison, title=title)
    assert dict(mpl.rcParams) == before
    titles = [figure._suptitle, *figure.legends[0].get_texts()]
    require_readable(figure, figure.axes, titles, 27 + len(GROUP_SLICES))


def test_marks_of_the_figure_are_the_differences_in_sigmas_of_the_reference(pair):
    comparison = compare(pair)
    figure = comparison_figure(comparison)
    differences, ratios = figure.axes
    drawn = differences.containers[-1].lines[0].get_ydata()
    one = comparison.differences["closed-form"]
    np.testing.assert_allclose(drawn, one.difference / pair["least-squares"].sigma)
    bands = [patch.get_height() for patch in differences.patches]
    np.testing.assert_allclose(bands, 2.0 * one.expected_sigma / pair["least-squares"].sigma)
    np.testing.assert_allclose(ratios.lines[-1].get_ydata(), one.sigma_ratio)


def test_nothing_usable_is_nothing_to_draw():
    with pytest.raises(srt.InputError, match="nothing to draw"):
        comparison_figure(compare({}, failures={"ekf": "It cannot be."}))


BOTH = ("closed-form", "least-squares")
RECORDINGS = 8


def recording(grade, seed):
    schedule = {"dwell_s": 2.0, "rate_rad_s": 3.0, "acceleration_rad_s2": 30.0, "settle_s": 0.1, "leg_dwell_s": 0.2}
    scenario = {"seed": seed, "imu": {"from": grade}, "schedule": schedule, "recording": {"sample_rate_hz": 50.0}}
    places = {"fixture": {"from": "lab-1mrad"}, "site": {"from": "latitude-45"}}
    return simulate(scenario_from_dict(scenario | places)).recording


@pytest.fixture(scope="module")
def stated():
    """Comparisons of tactical units with stated noise."""
    return [srt.compare(recording("tactical-fog", 1000 + number), BOTH) for number in range(RECORDINGS)]


def test_single_and_joint_tests_have_one_covariance_which_exceeds_the_difference_of_either_order():
    rng = np.random.default_rng(8)

    def estimate(name):
        root = rng.standard_normal((N_PARAMETERS, 100)) * 1e-4
        errors = srt.SensorErrors(rng.standard_normal(N_PARAMETERS) * 1e-3)
        return srt.Calibration(name, "converged", "Converged.", errors, root @ root.T)

    # Neither estimate is better in all directions: the difference of their covariances is indefinite.
    pair = {name: estimate(name) for name in BOTH}
    first, second = pair.values()
    D = first.covariance - second.covariance
    assert np.linalg.eigvalsh(D)[[0, -1]].prod() < 0.0
    C = expected_covariance(first, second, np.ones(N_PARAMETERS, dtype=bool))
    rounding = 1e-12 * np.trace(C)
    for lower in (0.0 * D, D - rounding * np.eye(N_PARAMETERS), -D - rounding * np.eye(N_PARAMETERS)):
        assert np.linalg.eigvalsh(C - lower)[0] > 0.0
    one = compare(pair).differences["closed-form"]
    np.testing.assert_allclose(one.expected_sigma, np.sqrt(np.diag(C)))
    assert one.chi_square == pytest.approx(one.difference @ np.linalg.solve(C, one.difference))


def test_differences_of_simulated_recordings_are_as_large_as_expected(stated):
    pairs = [comparison.differences["closed-form"] for comparison in stated]
    freedom = RECORDINGS * N_PARAMETERS
    assert chi2.ppf(1e-3, freedom) < sum(pair.chi_square for pair in pairs) < chi2.isf(1e-3, freedom)
    assert sum(not pair.agrees for pair in pairs) <= binom.isf(1e-3, RECORDINGS, FALSE_ALARM)


def test_sigmas_enlarged_by_residuals_raise_no_false_alarm():
    """The closed form multiplies its sigmas, least squares adds noise; neither covariance is that of the true noise."""
    made = recording("navigation-rlg", 1008)
    understated = {
        f"{sensor}_{kind}": 0.6 * getattr(made.noise, f"{sensor}_{kind}")
        for sensor in ("gyro", "accel")
        for kind in ("noise", "bias_instability")
    }
    compared = srt.compare(replace(made, noise=replace(made.noise, **understated)), BOTH)
    assert {c.judgement.word for c in compared.calibrations.values()} == {"doubtful"}
    assert compared.agree, compared.verdict


@pytest.mark.parametrize("seed", [300, 301])
def test_recorded_moves_with_bias_instability_raise_no_disagreement(seed):
    """The closed form has the covariance of the instability over the windows, the others have Markov states."""
    pytest.importorskip("gtsam")
    scenario = scenario_from_dict(
        {
            "seed": seed,
            "imu": {"from": "tactical-fog"},
            "fixture": {"from": "lab-1mrad"},
            "site": {"from": "latitude-45"},
            "schedule": {"dwell_s": 5.0, "rate_rad_s": 2.0, "acceleration_rad_s2": 20.0, "moves": "recorded"},
            "recording": {"sample_rate_hz": 50.0},
        }
    )
    compared = srt.compare(simulate(scenario).recording, ("closed-form", "least-squares", "graph"))
    assert compared.agree, compared.verdict
