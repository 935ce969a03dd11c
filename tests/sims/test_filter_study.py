"""A twentieth of the study of filter forms (``srt robustness filters``), and the page that shows its tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from sims.robustness.campaign import load_campaign
from sims.robustness.trial import run_trial
from sims.robustness.trial_table import NEES_PROBABILITY

pytest.importorskip("filterpy")
pytest.importorskip("gtsam")
from scipy.stats import chi2

PAGE = Path(__file__).parents[2] / "docs" / "studies" / "filters.md"
QUICK = (
    "closed-form, fixture", "iterated, fixture", "iterated, narrow prior", "one-pass, wide prior",
    "one-pass, narrow prior",
)  # fmt: skip
ITERATED = ("closed-form, fixture", "least-squares, fixture", "graph, fixture", "iterated, fixture")
UNUSED_TRIAL = 100
"""Number of a trial that the study does not contain."""


def trial(campaign, *, scale, misalignment, labels):
    """Rows of a fresh unit by label of the estimator."""
    chosen = tuple(e for e in campaign.estimators if e.label in labels)
    point = campaign.points.index({"scale_percent": scale, "misalignment_mrad": misalignment})
    return {row["estimator"]: row for row in run_trial(replace(campaign, estimators=chosen), (point, UNUSED_TRIAL))}


def within(row):
    """True for a converged result with errors within its sigmas."""
    return row["outcome"] == "converged" and row["nees"] < chi2.isf(NEES_PROBABILITY, row["observed"])


@pytest.mark.parametrize(("scale", "misalignment", "one_pass"), [(0.1, 1, True), (10, 100, False)])
def test_one_pass_converges_for_small_errors_only(scale, misalignment, one_pass):
    """Linearisation errors of the first sequences, 0.1² rad² against 1e-5 rad of noise, stay in one pass."""
    rows = trial(load_campaign("filters"), scale=scale, misalignment=misalignment, labels=QUICK)
    assert all(within(rows[label]) for label in QUICK[:3])
    assert not within(rows["one-pass, wide prior"])
    assert within(rows["one-pass, narrow prior"]) == one_pass
    assert len(rows["iterated, fixture"]["nis"]) == 17


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "misalignment"), [(0.1, 10), (1, 600), (50, 300)])
def test_all_forms_on_a_twentieth_of_the_units(scale, misalignment):
    """No form reports convergence with errors beyond its sigmas, but for least squares from zero errors."""
    campaign = load_campaign("filters")
    rows = trial(campaign, scale=scale, misalignment=misalignment, labels=[e.label for e in campaign.estimators])
    assert all(within(rows[label]) for label in ITERATED)
    for label, row in rows.items():
        assert row["outcome"] != "crashed", row["message"]
        assert within(row) or row["outcome"] != "converged" or label == "least-squares, zero"
        assert row["outcome"] == "converged" or row["message"]


def test_the_page_has_every_estimator_of_the_campaign():
    text = PAGE.read_text(encoding="utf-8")
    for estimator in load_campaign("filters").estimators:
        assert f"**Converged, %: {estimator.label}**" in text
