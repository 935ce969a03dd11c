"""Scatter of executed rotations against the stated accuracy of a fixture."""

import math

import numpy as np
import pytest
from scipy.stats import binom

from srt.estimation.rotation_accuracy import scatter_ratio


def test_rotations_as_stated_have_no_other_scatter():
    """By chance one in a thousand; four of 1000 with p = 0.02."""
    rng = np.random.default_rng(1)
    draws = [scatter_ratio(rng.normal(0.0, 1e-3, 12), 1e-3) for _ in range(1000)]
    assert np.sum(np.array(draws) > 1.0) <= binom.isf(1e-4, 1000, 1e-3)


@pytest.mark.parametrize("wrong", [0, 1, 4])
def test_the_scatter_is_that_of_the_rotations_without_wrong_angles(wrong):
    """Mean over 200 draws; the median of 12 with four wrong ones is their 0.75 quantile, which adds a tenth at most."""
    rng, ratios = np.random.default_rng(2), []
    for _ in range(200):
        error = rng.normal(0.0, 1e-3, 12)
        error[:wrong] += math.radians(5.0)
        ratios.append(scatter_ratio(error, 1e-4))
    assert np.mean(ratios) == pytest.approx(10.0, rel=3.5 / math.sqrt(2.0 * (12 - wrong) * 200) + 0.1)


def test_a_few_rotations_show_no_scatter():
    assert scatter_ratio(np.full(5, 1.0), 1e-3) == 1.0
    assert scatter_ratio(np.full(6, 1.0), 1e-3) == pytest.approx(1000.0)


def test_wrong_angles_alone_are_no_scatter():
    error = np.r_[np.full(5, 1.0), np.full(7, 5e-4)]
    assert scatter_ratio(error, 1e-3) == 1.0
