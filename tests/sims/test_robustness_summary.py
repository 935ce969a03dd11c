"""Summary of a robustness campaign from tables of trials whose results are known."""

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from campaign_tables import SCALES, grid_rows, header, noisy_rows, staircase_study, table
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, chi2

import srt
from sims.robustness import report, tables
from sims.robustness.convergence import convergence_map, percent
from sims.robustness.error_statistics import share_interval
from sims.robustness.summary import summarise
from sims.robustness.trial import OUTCOMES
from sims.robustness.trial_table import read_trials
from srt.sensor_errors import NAMES


@pytest.fixture(scope="module")
def study():
    return staircase_study()


def test_counts_leave_out_what_is_no_imu(study):
    found = summarise(*study)
    counts = found.outcomes.loc["closed-form", list(OUTCOMES)].to_dict()
    # 12 points of 4 trials; 2 points fail for scale and 3 for misalignment, one less a trial that is no IMU.
    assert counts == dict.fromkeys(OUTCOMES, 0) | {"converged": 28, "wrong_minimum": 19, "no_imu": 1}
    assert found.outcomes["judged"].tolist() == [47, 47]
    assert found.outcomes["converged"].tolist() == [28, 47]
    assert (found.units, found.impossible) == (48, 1)
    (at,) = found.settings.query("scale_percent == '50' and misalignment_mrad == '300'").index
    assert found.points.loc[(at, "closed-form"), "wrong_minimum"] == 3
    assert found.points[list(OUTCOMES)].to_numpy().sum() == study[0].num_rows


@pytest.mark.parametrize(("k", "n"), [(0, 10), (10, 10), (3, 10), (997, 1000), (0, 1)])
def test_interval_of_a_share(k, n):
    assert share_interval(0, 0) == (0.0, 1.0)
    low, high = share_interval(k, n)
    expected = binomtest(k, n).proportion_ci(0.95, "exact")
    np.testing.assert_allclose((low, high), expected, rtol=1e-9, atol=1e-15)


def test_map_of_the_first_two_axes(study):
    told = replace(study[1], grid={**SCALES, "schedule.dwell_s": [5.0, 10.0]})
    long = pa.Table.from_pylist([row | {"schedule.dwell_s": 5.0} for row in study[0].to_pylist()])
    found = summarise(long, told).maps[0]
    assert (found.across.name, found.up.name, found.averaged) == (*SCALES, ("schedule.dwell_s",))
    expected = [[1, 1, 1], [1, 1, 0], [1, 1, 0], [0, 0, 0]]
    np.testing.assert_array_equal(found.share, [expected, np.ones((4, 3))])
    np.testing.assert_array_equal(found.judged[0], [[4, 4, 4], [4, 4, 4], [4, 4, 3], [4, 4, 4]])


def test_map_of_any_two_axes_with_words_and_empty_cells(study):
    told = replace(study[1], grid={**SCALES, "grade": ["tactical", "consumer"]})
    rows = [row | {"grade": "consumer"} for row in study[0].to_pylist() if row["scale_percent"] < 50.0]
    found = convergence_map(read_trials(pa.Table.from_pylist(rows), told), "grade", "scale_percent")
    assert found.across.labels == ("tactical", "consumer")
    assert found.averaged == ("misalignment_mrad",)
    # Neither tactical nor scale 50 was run; of the four misalignments, the closed form fails at one.
    nan = np.nan
    np.testing.assert_array_equal(
        found.share, [[[nan, 0.75], [nan, 0.75], [nan, nan]], [[nan, 1], [nan, 1], [nan, nan]]]
    )
    with pytest.raises(srt.InputError, match="does not vary 'dwell_s': its axes are scale_percent"):
        convergence_map(read_trials(*study), "dwell_s")


def test_the_largest_region_without_failure(study):
    found = summarise(*study)
    first, second = found.regions
    # Boxes: 3 x 1 levels (12 trials) or 2 x 3 (24); the latter has more.
    assert [(limit.axis, limit.value, limit.upward, limit.whole) for limit in first.limits] == [
        ("scale_percent", 10.0, True, False),
        ("misalignment_mrad", 300.0, True, False),
    ]
    assert (first.trials, first.tried) == (24, 47)
    assert all(limit.whole for limit in second.limits)
    assert second.trials == 47
    text = " ".join(tables.sentences(found))
    assert "closed-form converged in all 24 trials with scale_percent up to 10 and misalignment_mrad up to 300." in text
    # 1 - 0.05^(1/47) = 6.2 %: what all 47 could still hide.
    assert "graph converged in every trial (scale_percent 50 and misalignment_mrad 500 at most)" in text
    assert "fewer than 6.2 % of such trials fail" in text


def test_convergence_and_sigmas_are_judged_together():
    """NEES of 60 is beyond 27 parameters (p = 0.0003), 50 is not (p = 0.005); other statuses are counted apart."""
    rows = [{"nees": 20.0}, {"nees": 50.0}, {"nees": 60.0}, {"nees": 2700.0, "outcome": "not_converged"}]
    rows += [{"outcome": "refused"}, {"outcome": "no_imu"}]
    grid = {"scale_percent": [1.0, 2.0]}
    found = summarise(table([row | {"scale_percent": 1.0} for row in rows]), header(grid=grid))
    counts = ["judged", "estimates", "converged", "within", "beyond"]
    assert found.shares.loc["closed-form", counts].tolist() == [5, 4, 3, 2, 1]
    medians = found.shares.loc["closed-form", ["nees", "nees_all"]]
    np.testing.assert_allclose(medians.astype(float), [50.0 / 27.0, 55.0 / 27.0], rtol=1e-12)
    assert found.maps[0].beyond.tolist() == [[[1, 0]]]
    assert tables.map_tables(found.maps[0], ("closed-form",))[0].rows == (("all", "60 (20)", ""),)
    quiet = summarise(table([row | {"scale_percent": 1.0} for row in rows]), header(grid=grid, noisy=False))
    assert quiet.maps[0].beyond.sum() == 0
    assert tables.share_table(quiet).rows == ()


def test_errors_by_level_are_those_of_estimates_of_any_status():
    """Of ±1 %, an error of 101 ppm is more than 1 %, in a parameter whose size the axis states."""
    rows = [{"largest": 4.9}, {"largest": 5.1}, {"outcome": "not_converged"}, {"outcome": "refused"}]
    rows += [{"error_accel_scale_y": -101e-6, "nees": 54.0, "calibrate_s": 0.75}, {"outcome": "no_imu"}]
    rows += [{"error_accel_misalignment_xy": 1.0}, {"outcome": "inconsistent"}]
    grid = {"scale_percent": [1.0, 2.0, 3.0]}
    told = header(grid=grid, trials=8)
    other = [{"scale_percent": 2.0, "error_accel_scale_y": -101e-6, "point": 1}]
    found = summarise(table([row | {"scale_percent": 1.0} for row in rows] + other), told)
    shown = {t.title: t for t in tables.score_tables(found)}
    (right,), (close,) = (shown[f"Within {what}, by scale_percent"].rows for what in ("5 sigma", "1 % of the size"))
    assert right == ("closed-form", "4 of 7", "1 of 1", "–")
    assert close == ("closed-form", "4 of 7", "1 of 1", "–")
    assert shown["NEES/n, by scale_percent"].rows == (("closed-form", "1", "1", "–"),)
    assert shown["CPU time, s, by scale_percent"].head == ("estimator", "1", "2", "3")
    assert "**Within 5 sigma, by scale_percent**" in report.markdown_tables(found)
    two = {**grid, "misalignment_mrad": [1.0, 2.0]}
    rows = grid_rows(two, told.estimators, 1, lambda *_, **__: "converged")
    assert tables.score_tables(summarise(table(rows), header(grid=two))) == ()


def test_innovations_and_causes_by_estimator():
    left = "The filter 'x' failed in sequence {}: left."
    ended = "The filter 'x' ended {} sigma (gyro_scale_x) from it."
    rows = [{"nis": [1.0, 3.0]}, {"nis": [2.0, 5.0]}, {"nis": [3.0, 4.0]}]
    rows += [{"outcome": "not_converged", "nis": [], "message": left.format(number)} for number in ("2a", "17")]
    rows += [{"outcome": "not_converged", "nis": None, "message": ended.format(size)} for size in ("3.2e+04", "5")]
    rows += [{"outcome": "not_converged", "nis": None, "message": ended.format("13.3")}]
    found = summarise(table(rows), header())
    assert tables.innovation_table(found).rows == (("closed-form", "3", "2", "4"),)
    assert tables.cause_table(found).rows == (
        ("closed-form", "3", "not converged", "The filter 'x' ended … sigma from it."),
        ("closed-form", "2", "not converged", "The filter 'x' failed in sequence …: left."),
    )


def test_one_failure_is_enough_to_end_a_region():
    grid = {"scale_percent": [1.0, 2.0, 3.0], "misalignment_mrad": [1.0, 2.0]}
    once = (("scale_percent", 2.0), ("misalignment_mrad", 2.0))
    rows = grid_rows(
        grid, ["graph"], 9, lambda _, k, **v: "refused" if k == 4 and tuple(v.items()) == once else "converged"
    )
    (found,) = summarise(table(rows), header(grid=grid, estimators=("graph",))).regions
    assert [(limit.value, limit.upward) for limit in found.limits] == [(3.0, True), (1.0, True)]
    assert found.trials == 27


def test_levels_of_a_grid_are_in_order_however_they_were_listed():
    grid = {"scale_percent": [50, 1.0, 10.0], "grade": ["tactical", "consumer"]}
    rows = grid_rows(
        grid,
        ["graph"],
        1,
        lambda *_, **v: "refused" if v == {"scale_percent": 50, "grade": "tactical"} else "converged",
    )
    rows = [row | {"scale_percent": float(row["scale_percent"])} for row in rows]
    found = summarise(table(rows), header(grid=grid, estimators=("graph",))).maps[0]
    assert (found.across.labels, found.up.labels) == (("1", "10", "50"), ("tactical", "consumer"))
    np.testing.assert_array_equal(found.share, [[[1, 1, 0], [1, 1, 1]]])


def test_a_long_time_can_be_the_easy_end():
    grid = {"schedule.dwell_s": [1.0, 2.0, 5.0, 10.0]}
    rows = grid_rows(
        grid, ["closed-form"], 3, lambda _, k, **v: "refused" if v["schedule.dwell_s"] < 4 and k else "converged"
    )
    (found,) = summarise(table(rows), header(grid=grid)).regions
    assert [(limit.value, limit.upward) for limit in found.limits] == [(5.0, False)]
    assert found.trials == 6


@pytest.mark.parametrize(("failing", "expected", "count"), [(47, 46.0, 46), (2, 1.0, 1), (1, None, 0)])
def test_the_limit_of_a_random_quantity_is_its_first_failure(failing, expected, count):
    rows = [
        {"scale_percent": float(v), "outcome": "not_converged" if v >= failing else "converged"} for v in range(1, 101)
    ]
    (found,) = summarise(table(rows), header(trials=100, random={"scale_percent": "1 to 100"})).regions
    assert [limit.value for limit in found.limits] == ([] if expected is None else [expected])
    assert (found.trials, found.tried) == (count, 100)


def test_values_drawn_at_random_are_binned_evenly():
    rows = [{"scale_percent": float(v)} for v in np.random.default_rng(1).permutation(160)]
    axis = read_trials(table(rows), header(random={"scale_percent": "0 to 159"})).axes[0]
    assert np.bincount(axis.codes).tolist() == [20] * 8
    assert (axis.codes == axis.values // 20).all()


def test_accuracy_is_in_display_units():
    errors = {10.0: (3.0, 4.0), 20.0: (6.0, -8.0)}
    rows = [
        {"scale_percent": scale, "error_gyro_scale_x": error * 1e-6, "sigma_gyro_scale_x": 2e-6}
        | {f"{stem}_gyro_scale_{axis}": None for stem in ("error", "sigma") for axis in "yz"}
        for scale, pair in errors.items()
        for error in pair
    ]
    rows.append({"scale_percent": 20.0, "outcome": "wrong_minimum", "error_gyro_scale_x": 1.0})
    found = summarise(table(rows), header(grid={"scale_percent": [10.0, 20.0, 30.0]}))
    overall, by_scale = found.accuracy
    np.testing.assert_allclose(by_scale.array("rms")[0, :2, 0], np.sqrt([12.5, 50.0]))
    np.testing.assert_allclose(by_scale.array("largest")[0, :2, 0], [4.0, 8.0])
    np.testing.assert_allclose(by_scale.array("rms_in_sigma")[0, :2, 0], np.sqrt([12.5, 50.0]) / 2.0)
    np.testing.assert_allclose(by_scale.array("largest_in_sigma")[0, :2, 0], [2.0, 4.0])
    assert by_scale.array("count")[0, :, 0].tolist() == [2, 2, 0]
    assert np.isnan(by_scale.array("rms")[0, 2]).all()
    np.testing.assert_allclose(overall.array("rms")[0, 0], [np.sqrt(31.25)] + [1.0] * 7)
    assert overall.array("count")[0, 0].tolist() == [4, 12, 12, 12, 12, 12, 24, 12]


def test_honesty_of_the_sigmas():
    n = 200
    rows = noisy_rows(n, {"gyro_scale_y": 1.3, "accel_bias_z": 0.7, "gyro_bias_x": 2.5}, held=["gyro_bias_z"])
    summary = summarise(table(rows), header(trials=n))
    consistency = summary.consistency
    found, nees = consistency.parameters.loc["closed-form"], consistency.nees.loc["closed-form"]
    assert tuple(found.index) == NAMES
    assert found["rms"]["gyro_scale_y"] == pytest.approx(1.3)
    assert found["rms"].iloc[0] == pytest.approx(1.0)
    assert found["half_width"].iloc[0] == pytest.approx(3.5 / np.sqrt(400.0))
    assert list(found.index[found["too_small"]]) == ["gyro_scale_y", "gyro_bias_x"]
    assert list(found.index[found["too_large"]]) == ["accel_bias_z"]
    assert found["count"]["gyro_bias_z"] == 0
    assert np.isnan(found["rms"]["gyro_bias_z"])
    assert found["coverage"]["gyro_bias_x"] == 0.0  # 2.5 sigmas are outside
    assert found["coverage"]["gyro_scale_y"] == 1.0  # 1.3 are inside
    # 26 parameters and the NEES share the 1 %, both sides of each alike.
    tail = 0.01 / 27 / 2
    assert chi2.sf(n * found["high"].iloc[0] ** 2, n) == pytest.approx(tail, rel=1e-6)
    assert chi2.cdf(n * found["low"].iloc[0] ** 2, n) == pytest.approx(tail, rel=1e-6)
    assert chi2.sf(27 * n * nees["high"], 27 * n) == pytest.approx(tail, rel=1e-6)
    assert nees["nees"] == pytest.approx(1.0)
    assert not nees["inconsistent"]
    text = " ".join(tables.sentences(summary))
    assert "too small for 2 (gyro_scale_y, gyro_bias_x) and too large for 1 (accel_bias_z) of 26 parameters" in text


def test_sigmas_without_noise_are_not_judged(study):
    told = replace(study[1], noisy=False)
    found = summarise(study[0], told)
    assert found.consistency is None
    expected = "the sigmas are floors, and their consistency with the errors cannot be tested"
    assert expected in " ".join(tables.sentences(found))
    assert "in sigmas" not in report.markdown_tables(found)


def test_play_backs_and_time():
    rows = [{"playbacks": n, "calibrate_s": 0.1 * n} for n in (3, 3, 4, 7)]
    rows += [{"outcome": "not_converged", "playbacks": 50, "calibrate_s": 9.0}, {"outcome": "no_imu"}]
    found = summarise(table(rows), header()).effort
    assert found.histogram.columns.tolist() == [3, 4, 5, 6, 7]
    assert found.histogram.to_numpy().tolist() == [[2, 1, 0, 0, 1]]
    own = found.table.loc["closed-form"]
    assert (own["median"], own["most"]) == (3.5, 7.0)
    assert own["seconds"] == pytest.approx(0.4)  # of 0.3, 0.3, 0.4, 0.7 and 9
    assert found.simulate_s == 0.5
    assert found.total_s == pytest.approx(6 * 0.5 + 1.7 + 9.0)


def test_a_unit_is_simulated_once_for_all_estimators(study):
    assert summarise(*study).effort.total_s == pytest.approx(48 * 0.5 + 2 * 47 * 0.25)


def test_first_failures_with_the_command_that_repeats_them():
    kinds = [name for name in OUTCOMES if name not in ("converged", "no_imu")]
    rows = [{"point": 9, "replicate": 1, "outcome": name, "estimator": name} for name in kinds]
    rows += [
        {"point": k % 5, "replicate": k // 5, "outcome": "refused", "estimator": "graph"} for k in range(49, -1, -1)
    ]
    rows = [row | {"scale_percent": float(row["point"]), "message": "too large"} for row in rows]
    rows += [{"estimator": "graph", "outcome": name, "scale_percent": 1.0} for name in ("converged", "no_imu")]
    told = header(estimators=(*kinds, "graph"), grid={"scale_percent": [0.0, 1.0, 2.0, 3.0, 4.0, 9.0]})
    found = summarise(table(rows), told).failures
    assert found.loc[found["estimator"] != "graph", "outcome"].tolist() == kinds
    listed = list(found[found["estimator"] == "graph"].itertuples())
    assert [(f.point, f.replicate) for f in listed] == [(p, k) for p in (0, 1) for k in range(10)]
    assert listed[11].replay == "srt robustness study.toml --replay 1:1"
    assert (listed[11].message, listed[11].settings) == ("too large", {"scale_percent": "1"})
    titles = [t.title for t in report._failure_tables(summarise(table(rows), told))]
    assert titles == [f"{name}: 1 failed" for name in kinds] + ["graph: 50 failed, the first 20"]


def test_a_trial_that_is_there_twice_is_refused():
    rows = [{"point": 3, "replicate": 4}, {"point": 3, "replicate": 4, "outcome": "refused"}]
    with pytest.raises(srt.DataError, match="has trial 3:4 of closed-form twice"):
        summarise(table(rows), header())


@pytest.mark.parametrize(
    ("row", "column", "message"),
    [
        ({"outcome": "fine"}, None, "outcome 'fine'"),
        ({"estimator": "magic"}, None, "estimator 'magic'"),
        ({}, "error_gyro_scale_x", "lacks the column 'error_gyro_scale_x'"),
        ({}, "scale_percent", "lacks the column 'scale_percent'"),
    ],
)
def test_a_table_of_something_else_is_refused(row, column, message):
    given = table([row | {"scale_percent": 1.0}])
    given = given.drop_columns([column]) if column else given
    with pytest.raises(srt.InputError, match=message):
        summarise(given, header(grid={"scale_percent": [1.0]}))


def test_the_summary_does_not_depend_on_the_storage_of_the_table(study):
    whole, told = study
    encoded = pa.concat_tables([whole.slice(30), whole.slice(0, 30)])
    for name in ("estimator", "outcome"):
        k = encoded.column_names.index(name)
        encoded = encoded.set_column(k, name, encoded.column(name).dictionary_encode())
    assert report.markdown_tables(summarise(encoded, told)) == report.markdown_tables(summarise(whole, told))


@given(st.integers(1, 10**6), st.data())
def test_only_all_is_100_percent_and_only_none_is_0(n, data):
    k = data.draw(st.integers(0, n))
    for digits in (0, 1):
        text = percent(k / n, digits)
        assert (float(text) == 100.0) == (k == n)
        assert (float(text) == 0.0) == (k == 0)
        # Rounded to the digit, and kept off the ends by one more at most.
        assert abs(float(text) - 100.0 * k / n) <= 1.000001 * 10.0**-digits
