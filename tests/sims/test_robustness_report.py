"""Answers of a robustness campaign from tables whose answers are known, and the reports that say them."""

from __future__ import annotations

import base64
import re
import sys
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from itertools import product

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, chi2

import srt
from sims.robustness import figures, report, tables
from sims.robustness.convergence import convergence_map, percent
from sims.robustness.error_statistics import share_interval
from sims.robustness.summary import summarise
from sims.robustness.trial import OUTCOMES
from sims.robustness.trial_table import Header, read_trials
from srt.sensor_errors import DISPLAY_FACTORS, INDEX, NAMES, SYMBOLS


def header(**changes):
    given = {
        "name": "study",
        "description": "How far from true?",
        "seed": 7,
        "trials": 1,
        "grid": {},
        "random": {},
        "estimators": ("closed-form",),
        "noisy": True,
        "replay": "srt robustness study.toml --replay ",
    }
    return Header(**(given | changes))


def table(rows, types=None):
    """Rows as a campaign leaves them: what an outcome does not have is null."""
    complete = []
    for k, row in enumerate(rows):
        whole = {"point": 0, "replicate": k, "seed": 1000 + k, "estimator": "closed-form", "outcome": "converged"}
        whole |= row
        ran = whole["outcome"] not in ("no_imu", "refused")
        whole = {"status": whole["outcome"], "message": None, "playbacks": 4 if ran else None} | whole
        whole = {"distance": 0.5 if whole["outcome"] == "converged" else None, "simulate_s": 0.5} | whole
        whole = {"calibrate_s": None if whole["outcome"] == "no_imu" else 0.25, "largest": 2.0} | whole
        whole = {"nees": 27.0 if ran else None, "observed": 27 if ran else None} | whole
        for name, factor in zip(NAMES, DISPLAY_FACTORS, strict=True):
            values = {"truth": 0.0, "error": 1.0 / factor, "sigma": 1.0 / factor} if ran else {}
            whole = {f"{stem}_{name}": values.get(stem) for stem in ("truth", "error", "sigma")} | whole
        complete.append(whole)
    return pa.Table.from_pylist(complete)


def grid_rows(grid, estimators, trials, outcome):
    """Every point, trial and estimator; ``outcome(estimator, number, **settings)`` says what became of it."""
    return [
        {"point": p, "replicate": k, "estimator": name, **settings, "outcome": outcome(name, k, **settings)}
        for p, settings in enumerate(dict(zip(grid, v, strict=True)) for v in product(*grid.values()))
        for k in range(trials)
        for name in estimators
    ]


SCALES = {"scale_percent": [1.0, 10.0, 50.0], "misalignment_mrad": [1.0, 100.0, 300.0, 500.0]}


def staircase(name, number, scale_percent, misalignment_mrad):
    """Fail from scale 50 on if misaligned by 100 or more, and at 500; one unit of 300, 50 is no IMU."""
    if (scale_percent, misalignment_mrad, number) == (50.0, 300.0, 0):
        return "no_imu"
    hard = (scale_percent >= 50.0 and misalignment_mrad >= 100.0) or misalignment_mrad >= 500.0
    return "wrong_minimum" if hard and name == "closed-form" else "converged"


@pytest.fixture(scope="module")
def study():
    told = header(trials=4, grid=SCALES, estimators=("closed-form", "graph"))
    return table(grid_rows(SCALES, told.estimators, 4, staircase)), told


def test_the_outcomes_are_those_of_the_trials():
    assert tuple(tables.OUTCOME_WORDS) == tuple(OUTCOMES)
    assert tables.OUTCOME_WORDS["wrong_minimum"] == "wrong minimum"
    assert tables.OUTCOME_WORDS["no_imu"] == "no IMU"


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
    low, high = share_interval(k, n)
    expected = binomtest(k, n).proportion_ci(0.95, "exact")
    np.testing.assert_allclose((low, high), expected, rtol=1e-9, atol=1e-15)


def test_nothing_tried_says_nothing_of_a_share():
    assert share_interval(0, 0) == (0.0, 1.0)


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
    first, second = summarise(*study).regions
    # Boxes: 3 x 1 levels (12 trials) or 2 x 3 (24); the latter has more.
    assert [(limit.axis, limit.value, limit.upward, limit.whole) for limit in first.limits] == [
        ("scale_percent", 10.0, True, False),
        ("misalignment_mrad", 300.0, True, False),
    ]
    assert (first.trials, first.tried) == (24, 47)
    assert all(limit.whole for limit in second.limits)
    assert second.trials == 47
    text = " ".join(report.short_answer(*study))
    assert "closed-form converged in all 24 trials with scale_percent up to 10 and misalignment_mrad up to 300." in text
    # 1 - 0.05^(1/47) = 6.2 %: what all 47 could still hide.
    assert "graph converged in every trial (scale_percent 50 and misalignment_mrad 500 at most)" in text
    assert "fewer than 6.2 % of such trials fail" in text


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
def test_what_is_drawn_at_random_is_known_to_the_first_failure(failing, expected, count):
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


def noisy_rows(n, size, held=()):
    """Errors of ± their sigma but for those in ``size``, which are as many sigmas."""
    rows = []
    for k in range(n):
        row = {"nees": 27.0 * (1.0 + 0.001 * (-1) ** k)}
        for name, factor in zip(NAMES, DISPLAY_FACTORS, strict=True):
            row[f"error_{name}"] = (-1) ** k * size.get(name, 1.0) / factor
        rows.append(row | {f"{stem}_{name}": None for stem in ("error", "sigma") for name in held})
    return rows


def test_honesty_of_the_sigmas():
    n = 200
    rows = noisy_rows(n, {"gyro_scale_y": 1.3, "accel_bias_z": 0.7, "gyro_bias_x": 2.5}, held=["gyro_bias_z"])
    consistency = summarise(table(rows), header(trials=n)).consistency
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
    text = " ".join(report.short_answer(table(rows), header(trials=n)))
    assert "too small for 2 (gyro_scale_y, gyro_bias_x) and too large for 1 (accel_bias_z) of 26 parameters" in text


def test_sigmas_without_noise_are_not_judged(study):
    told = replace(study[1], noisy=False)
    assert summarise(study[0], told).consistency is None
    expected = "the sigmas are floors, and their consistency with the errors cannot be tested"
    assert expected in " ".join(report.short_answer(study[0], told))
    assert "in sigmas" not in report.markdown_tables(study[0], told)


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


def test_how_the_table_is_stored_does_not_matter(study):
    whole, told = study
    encoded = pa.concat_tables([whole.slice(30), whole.slice(0, 30)])
    for name in ("estimator", "outcome"):
        k = encoded.column_names.index(name)
        encoded = encoded.set_column(k, name, encoded.column(name).dictionary_encode())
    assert report.markdown_tables(encoded, told) == report.markdown_tables(whole, told)


@given(st.integers(1, 10**6), st.data())
def test_only_all_is_100_percent_and_only_none_is_0(n, data):
    k = data.draw(st.integers(0, n))
    for digits in (0, 1):
        text = percent(k / n, digits)
        assert (float(text) == 100.0) == (k == n)
        assert (float(text) == 0.0) == (k == 0)
        # Rounded to the digit, and kept off the ends by one more at most.
        assert abs(float(text) - 100.0 * k / n) <= 1.000001 * 10.0**-digits


def test_cells_of_a_map_say_their_share_and_empty_ones_are_hatched(study):
    told = replace(study[1], grid={**SCALES, "scale_percent": [1.0, 10.0, 50.0, 90.0]})
    found = summarise(study[0], told).maps[0]
    figure = figures.map_figure(found, told.estimators)
    panels = [axes for axes in figure.axes if axes.get_title(loc="left") in told.estimators]
    assert len(panels) == 2
    written = {(t.get_position()): t.get_text() for t in panels[0].texts}
    assert written[0, 0] == "100"
    assert written[2, 3] == "0"
    assert len(written) == 12
    hatched = [patch for patch in panels[0].patches if patch.get_hatch()]
    assert sorted((p.get_x() + 0.5, p.get_y() + 0.5) for p in hatched) == [(3, 0), (3, 1), (3, 2), (3, 3)]
    assert panels[0].collections[0].get_clim() == (0.0, 100.0)


def test_rings_are_around_dishonest_sigmas():
    found = summarise(table(noisy_rows(50, {"accel_scale_y": 2.0})), header()).consistency
    axes = figures.consistency_figure(found, ("closed-form",)).axes[0]
    rings = [line for line in axes.lines if line.get_markersize() == 12.0]
    assert [ring.get_xdata().tolist() for ring in rings] == [[INDEX["accel_scale_y"]]]
    assert len(axes.get_xticks()) == len(SYMBOLS)


HOSTILE = "<script>alert('1')</script> | $x_{$ `b` [link](http://evil.example) \n\x00 _dash_ & {{ 7*7 }} \u4e2d"


def one_axis():
    grid = {"scale_percent": [1.0, 10.0]}
    rows = grid_rows(
        grid, ["closed-form"], 3, lambda *_, scale_percent: "converged" if scale_percent < 5 else "refused"
    )
    return table(rows), header(grid=grid, trials=3)


def words():
    grid = {"grade": ["tactical", "consumer"], "noise": [True, False]}
    rows = grid_rows(grid, ["closed-form"], 2, lambda *_, grade, noise: "converged" if noise else "no_imu")
    return table(rows), header(grid=grid, trials=2)


def noise_free():
    grid = {"scale_percent": [1.0, 10.0]}
    rows = grid_rows(grid, ["ekf", "graph"], 2, lambda *_, **__: "converged")
    # Exactly right results, and a floor for a sigma.
    rows = [row | {f"error_{name}": 0.0 for name in NAMES[:9]} for row in rows]
    return table(rows), header(grid=grid, trials=2, noisy=False, estimators=("ekf", "graph"))


def hostile():
    rows = [{"estimator": HOSTILE, HOSTILE: HOSTILE, "outcome": name, "message": HOSTILE} for name in OUTCOMES]
    told = header(name=HOSTILE, description=HOSTILE, grid={HOSTILE: [HOSTILE, "b"]}, estimators=(HOSTILE,))
    return table(rows), replace(told, replay=HOSTILE, random={})


def only(outcome):
    grid = {"scale_percent": [1.0, 10.0]}
    return table(grid_rows(grid, ["graph"], 2, lambda *_, **__: outcome)), header(grid=grid, estimators=("graph",))


CASES = {
    "one axis, one estimator": one_axis,
    "no axis": lambda: (table([{}, {"outcome": "refused"}]), header(trials=2)),
    "axes of words": words,
    "noise-free": noise_free,
    "all failed": lambda: only("not_converged"),
    "none an IMU": lambda: only("no_imu"),
    "no rows": lambda: (table([{"scale_percent": 1.0}]).slice(0, 0), header(grid={"scale_percent": [1.0, 2.0]})),
    "no columns": lambda: (pa.table({}), header(grid={"scale_percent": [1.0, 2.0]}, random={"fixture_mrad": "0 to 1"})),
    "hostile text": hostile,
}


@cache
def page_of(case):
    return report.html_report(*CASES[case]())


class Page(HTMLParser):
    """Tags that are open, those that were met, and the text."""

    VOID = ("meta", "img", "link")

    def __init__(self, source):
        super().__init__()
        self.open, self.tags, self.attributes, self.text = [], set(), [], ""
        self.feed(source)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes += attrs
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.mark.parametrize("case", CASES)
def test_reports_of_all_kinds_of_campaigns(case):
    given, told = CASES[case]()
    source = page_of(case)
    page = Page(source)
    assert not page.open
    # Nothing from elsewhere, and nothing that runs.
    assert not page.tags & {"script", "link", "iframe", "object", "embed", "base", "form"}
    for name, value in page.attributes:
        assert not name.startswith("on")
        assert name not in ("href", "srcset", "action")
        assert name != "src" or value.startswith("data:image/svg+xml;base64,")
    assert "@import" not in source
    assert "url(" not in source
    for picture in re.findall(r"base64,([A-Za-z0-9+/=]+)", source):
        drawn = base64.b64decode(picture)
        assert drawn.startswith(b"<svg")
        assert b"<script" not in drawn
        assert b"nan" not in drawn.lower()
    for sentence in report.short_answer(given, told):
        assert "nan" not in sentence
        assert " ".join(sentence.split()).replace("\x00", "") in " ".join(page.text.split()).replace(
            "\ufffd", ""
        ).replace("\x00", "")
    summary = report.text_summary(given, told)
    assert {len(row) for row in summary} == {len(summary[0])}
    assert [row[0] for row in summary[1:]] == list(told.estimators)
    for block in report.markdown_tables(given, told).split("\n\n"):
        lines = [line for line in block.splitlines() if line.startswith("|")]
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) <= 1
        assert "<script" not in block


def test_hostile_text_is_shown_and_not_obeyed():
    page = page_of("hostile text")
    assert "&lt;script&gt;alert(&#39;1&#39;)&lt;/script&gt;" in page
    assert "{{ 7*7 }}" in page


def test_the_page_is_the_same_from_the_same_numbers():
    assert report.html_report(*noise_free()) == page_of("noise-free")


def test_the_page_says_how_much_is_done_and_what_was_averaged(study):
    given, told = study
    text = Page(report.html_report(given, replace(told, trials=10))).text
    assert "48 units with known sensor errors were simulated, of 120 that are planned" in text
    assert "1 of the drawn units was no IMU" in text
    assert "closed-form: 28 of 47 trials converged (59.6 %" in text
    assert "19 wrong minimum" in text
    assert "scale factors" in text


def test_unverified_statuses_are_said_to_be():
    rows = [{"distance": None}, {"distance": None}]
    assert summarise(table(rows), header()).unverified
    assert "the reported status was not verified" in " ".join(report.short_answer(table(rows), header()))
    assert not summarise(table([{}]), header()).unverified


def test_many_points_are_cut_to_those_that_failed(monkeypatch):
    monkeypatch.setattr(tables, "POINTS", 5)
    grid = {"scale_percent": [float(v) for v in range(20)]}
    rows = grid_rows(grid, ["graph"], 1, lambda *_, scale_percent: "refused" if scale_percent >= 10 else "converged")
    found = tables.point_table(summarise(table(rows), header(grid=grid, estimators=("graph",))))
    assert [row[1] for row in found.rows] == ["10", "11", "12", "13", "14"]
    assert "Of 20 rows, 10 have a failure; the first 5" in found.note


def test_an_absent_jinja_says_what_to_install(monkeypatch, study):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(srt.MissingExtraError, match=r"pip install 'strapdown-rotation-test\[campaign\]'"):
        report.html_report(*study)


def test_numbers_as_people_read_them():
    shown = [tables.number(v) for v in (0.0, 0.00012, 0.0123, 1.0, 999.4, 12345.6, 2e7, np.nan)]
    assert shown == ["0", "1.2e-04", "0.0123", "1", "999", "12346", "2.00e+07", "–"]
