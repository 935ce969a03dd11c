"""A part of the study of filter forms (``srt robustness filters``), and the page that shows its tables."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sims.robustness.campaign import load_campaign
from sims.robustness.error_statistics import NEAR_SIGMAS
from sims.robustness.trial import run_trial
from sims.robustness.trial_table import NEES_PROBABILITY
from sims.scenarios.simulation import simulate
from srt.sensor_errors import GROUP_SLICES

pytest.importorskip("filterpy")
pytest.importorskip("gtsam")
from scipy.stats import chi2

PAGE = Path(__file__).parents[2] / "docs" / "studies" / "filters.md"
FROM_ZERO = "one-pass filter from zero"
QUICK = (
    "closed form from the fixture",
    "iterated filter from zero",
    "one-pass filter from the fixture",
    FROM_ZERO,
)
UNUSED_TRIAL = 100
"""Number of a trial that the study does not contain."""


def trial(campaign, *, size, labels):
    """Rows of a fresh unit by label of the estimator."""
    chosen = tuple(e for e in campaign.estimators if e.label in labels)
    point = campaign.points.index({"matrix_percent": size})
    return {row["estimator"]: row for row in run_trial(replace(campaign, estimators=chosen), (point, UNUSED_TRIAL))}


def within(row):
    """True for a converged result with errors within its sigmas, one by one and together."""
    return (
        row["outcome"] == "converged"
        and row["largest"] <= NEAR_SIGMAS
        and row["nees"] < chi2.isf(NEES_PROBABILITY, row["observed"])
    )


def test_scale_factors_and_angles_by_one_number():
    """30 stands for ±30 % and ±0.3 rad."""
    campaign = load_campaign("filters")
    point = campaign.points.index({"matrix_percent": 30})
    truth = simulate(campaign.unit(point, UNUSED_TRIAL)[0]).truth.vector
    for group in ("gyro_scale", "accel_scale", "gyro_orthogonality", "accel_misalignment"):
        part = np.abs(truth[GROUP_SLICES[group]])
        # Of three even draws, all are below a hundredth of the bound with a probability of 1e-6.
        assert 0.003 < part.max() <= 0.3


@pytest.mark.parametrize(("size", "from_zero"), [(0.1, True), (10, False)])
def test_one_pass_from_zero_converges_for_small_errors_only(size, from_zero):
    """Linearisation errors of the first sequences, 0.1² rad² against 1e-5 rad of noise, stay in one pass."""
    rows = trial(load_campaign("filters"), size=size, labels=QUICK)
    assert all(within(row) == (from_zero or label != FROM_ZERO) for label, row in rows.items())
    assert len(rows[FROM_ZERO]["nis"]) == 17


@pytest.mark.campaign
@pytest.mark.parametrize("size", [0.3, 3, 50])
def test_all_forms_on_a_unit_of_their_own(size):
    """From the fixture all are right; no form reports convergence with errors beyond its sigmas."""
    campaign = load_campaign("filters")
    rows = trial(campaign, size=size, labels=[e.label for e in campaign.estimators])
    for label, row in rows.items():
        assert row["outcome"] != "crashed", row["message"]
        assert within(row) or (row["outcome"] != "converged" and row["message"] and label.endswith("zero"))


def test_the_page_is_of_the_campaign():
    """Table of the picture: every estimator and size; all estimators have the same units."""
    campaign, text = load_campaign("filters"), PAGE.read_text(encoding="utf-8")
    table = re.search(r"\*\*Within 5 sigma.*?\n\n(.*?)\n\n", text, re.S)[1].splitlines()
    head, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    assert head[1:] == [f"{size:g}" for size in campaign.grid["matrix_percent"]]
    assert [row[0] for row in rows] == [e.label for e in campaign.estimators]
    assert len({tuple(cell.split(" of ")[1] for cell in row[1:]) for row in rows}) == 1
