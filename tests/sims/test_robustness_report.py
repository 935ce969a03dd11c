"""Figures and pages that report a robustness campaign."""

import base64
import re
import sys
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import pyarrow as pa
import pytest
from campaign_tables import grid_rows, header, staircase_study, table

import srt
from sims.robustness import report, tables
from sims.robustness.summary import summarise
from sims.robustness.trial import OUTCOMES
from srt.sensor_errors import NAMES


@pytest.fixture(scope="module")
def study():
    return staircase_study()


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
def summary_of(case):
    return summarise(*CASES[case]())


@cache
def page_of(case):
    return report.html_report(summary_of(case))


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


QUICK = {"one axis, one estimator", "noise-free", "all failed", "no columns", "hostile text"}


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[] if case in QUICK else pytest.mark.slow) for case in CASES]
)
def test_reports_of_all_kinds_of_campaigns(case):
    found, source = summary_of(case), page_of(case)
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
    for sentence in tables.sentences(found):
        assert "nan" not in sentence
        assert " ".join(sentence.split()).replace("\x00", "") in " ".join(page.text.split()).replace(
            "\ufffd", ""
        ).replace("\x00", "")
    summary = report.text_summary(found)
    assert {len(row) for row in summary} == {len(summary[0])}
    assert [row[0] for row in summary[1:]] == list(found.header.estimators)
    for block in report.markdown_tables(found).split("\n\n"):
        lines = [line for line in block.splitlines() if line.startswith("|")]
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) <= 1
        assert "<script" not in block


def test_hostile_text_is_shown_and_not_obeyed():
    page = page_of("hostile text")
    assert "&lt;script&gt;alert(&#39;1&#39;)&lt;/script&gt;" in page
    assert "{{ 7*7 }}" in page


def test_the_page_says_how_much_is_done_and_what_was_averaged(study, monkeypatch):
    for name, nothing in (("_maps", ()), ("_sizes", ()), ("_consistency", None), ("_effort", None)):
        monkeypatch.setattr(report, name, lambda _, nothing=nothing: nothing)  # the text alone is looked at
    given, told = study
    text = Page(report.html_report(summarise(given, replace(told, trials=10)))).text
    assert "48 units with known sensor errors were simulated, of 120 that are planned" in text
    assert "1 of the drawn units was no IMU" in text
    assert "closed-form: 28 of 47 trials converged (59.6 %" in text
    assert "19 wrong minimum" in text
    assert "scale factors" in text


def test_unverified_statuses_are_said_to_be():
    rows = [{"distance": None}, {"distance": None}]
    found = summarise(table(rows), header())
    assert found.unverified
    assert "the reported status was not verified" in " ".join(tables.sentences(found))
    assert not summarise(table([{}]), header()).unverified


def test_trials_of_one_motion_are_said_to_be_correlated():
    alone, shared = (
        " ".join(tables.sentences(summarise(table([{}]), h))) for h in (header(), header(trials_per_motion=50))
    )
    assert "Each 50 successive trials have the same motion" in shared
    assert "same motion" not in alone


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
        report.html_report(summarise(*study))
