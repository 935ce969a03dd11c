"""Chi-square tests of groups of measurements, and the comparison of a faulty one with effects on all."""

import math

import numpy as np
import pytest

from srt.estimation.goodness_of_fit import contradicting_group, one_group_explains, specification_test
from srt.noise.drift_forms import likelihood_gain


def test_in_hand_the_limit_of_a_contradiction_is_that_of_all_turns():
    """A turn with p = 1e-5 of eighteen is accused on a fixture, where a label can be wrong, and not in hand."""
    tests = [(37.0, 8), *[(8.0, 8)] * 17]
    chi_square, freedom = (sum(values) for values in zip(*tests, strict=True))
    number, p = contradicting_group(tests, chi_square, freedom)
    assert number == 0
    assert 1e-4 / 18 < p < 1e-4
    assert contradicting_group(tests, chi_square, freedom, free=True) is None


@pytest.mark.parametrize("excess", [400.0, 1e6])
def test_the_cause_with_the_larger_likelihood_is_chosen(excess):
    """By one group of 5 of 100, or an effect of one coefficient; p-values of the larger excess are zero.

    The effect has 4 coefficients less, 18.4 in the gain, and is not one of ten groups, 4.6: it may leave a chi-square
    of 1.26 times that of the group, exp(0.230).
    """
    tests = [(excess, 5), *[(10.0, 10)] * 9]
    chi_square = 100.0 + excess
    equal = chi_square - 100.0 * math.exp((4.0 * math.log(100.0) + 2.0 * math.log(10.0)) / 100.0)
    for explained, faulty in ((equal - 1.0, True), (equal + 1.0, False)):
        gain = likelihood_gain(explained, 1, chi_square, 100)
        assert one_group_explains(tests, chi_square, 100, against=gain) is faulty
    assert one_group_explains(tests, chi_square, 100)


def test_several_faults_are_not_one():
    """Two groups contradict the others: without the worse one, these still do not agree."""
    tests = [(400.0, 5), (300.0, 5), *[(10.0, 10)] * 8]
    assert contradicting_group(tests, 780.0, 90) is not None
    assert not one_group_explains(tests, 780.0, 90)


@pytest.mark.parametrize("shift", [0.0, 6.0])
def test_the_difference_of_an_estimate_from_a_part_is_chi_square(shift):
    """Mean of 400 samples within 3.5 standard errors of (noncentral) chi-square; ``shift`` is in sigma."""
    rng = np.random.default_rng(20261129)
    H = rng.normal(size=(24, 4))
    z = rng.normal(size=(400, 24))
    solve = [np.linalg.pinv(H[:n]) for n in (8, 24)]
    own, other = (gain @ gain.T for gain in solve)
    wrong = shift * np.sqrt(np.diag(own)) * np.eye(4)[0]
    difference = z[:, :8] @ solve[0].T - z @ solve[1].T + wrong
    found, freedom = zip(*(specification_test(row, own, other) for row in difference), strict=True)
    assert set(freedom) == {4}
    beyond = float(wrong @ np.linalg.solve(own - other, wrong))
    assert abs(np.mean(found) - 4.0 - beyond) < 3.5 * math.sqrt(2.0 * (4.0 + 2.0 * beyond) / 400)
    assert specification_test(difference[0], own, own) == (0.0, 0)
