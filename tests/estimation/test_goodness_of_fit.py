"""Statistics of residuals: chi-square of groups of them, in units of their noise, and of executed rotations."""

import math

import numpy as np
import pytest
from scipy.linalg import lstsq
from scipy.special import chdtrc
from scipy.stats import binom

from srt.estimation.goodness_of_fit import contradicting_group, faulty_group, specification_test
from srt.estimation.rotation_accuracy import scatter_ratio
from srt.estimation.white_residuals import PredictedGroups, WhiteResiduals
from srt.noise.drift_forms import likelihood_gain, residual_statistics


@pytest.mark.parametrize(("largest", "accused"), [(37.0, False), (40.0, True)])
def test_the_limit_of_a_contradiction_is_that_of_all_groups(largest, accused):
    """Of eighteen groups, one with p = 1e-5 is noise once in 5,000 recordings, and one with 3e-6 in 20,000."""
    tests = [(largest, 8), *[(8.0, 8)] * 17]
    chi_square, freedom = (sum(values) for values in zip(*tests, strict=True))
    found = contradicting_group(tests, chi_square, freedom)
    assert (found is not None) is accused
    assert 1e-4 / 18 < chdtrc(8, 37.0) < 1e-4


def test_a_noise_that_the_turns_themselves_show_is_no_better_known_than_their_scatter():
    """50 for 6 degrees of freedom: p = 5e-9 with noise that is stated, and 2e-4 with that of nineteen turns."""
    tests = [(50.0, 6), *[(6.0, 6)] * 18]
    chi_square, freedom = (sum(values) for values in zip(*tests, strict=True))
    assert contradicting_group(tests, chi_square, freedom)[1] == pytest.approx(chdtrc(6, 50.0))
    assert contradicting_group(tests, chi_square, freedom, estimated_from=19.0) is None
    number, p = contradicting_group([(200.0, 6), *tests[1:]], chi_square + 150.0, freedom, estimated_from=19.0)
    assert number == 0
    assert p <= 1e-4 / 19


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
        assert (faulty_group(tests, chi_square, 100, against=gain) is not None) is faulty
    assert faulty_group(tests, chi_square, 100) == contradicting_group(tests, chi_square, 100)


@pytest.mark.parametrize("error", [-1e-15, 0.0, 1e-15])
def test_of_groups_that_one_residual_tests_alike_the_first_is_named(error):
    assert contradicting_group([(30.0, 1), (30.0 * (1.0 + error), 1)], 30.0, 1)[0] == 0


def test_of_groups_without_a_probability_the_one_with_the_larger_chi_square_is_named():
    tests = [(30_000.0, 2), (90_000.0, 2), *[(2.0, 2)] * 8]
    assert contradicting_group(tests, 120_016.0, 100_000) == (1, 0.0)


def test_several_faults_are_not_one():
    """Two groups contradict the others: without the worse one, these still do not agree."""
    tests = [(400.0, 5), (300.0, 5), *[(10.0, 10)] * 8]
    assert contradicting_group(tests, 780.0, 90) is not None
    assert faulty_group(tests, 780.0, 90) is None


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


N, P, UNITS = 12, 4, 5
ROWS = np.arange(N).reshape(-1, 2)


def measurements():
    """Random measurements of units, derivatives and covariances; a parameter depends on another in the last unit."""
    rng = np.random.default_rng(20261126)
    H, root = rng.normal(size=(UNITS, N, P)), rng.normal(size=(UNITS, N, N))
    H[-1, :, 2] = 3.0 * H[-1, :, 0]
    return rng.normal(size=(UNITS, N)), H, root @ np.swapaxes(root, 1, 2) + np.eye(N)


def weighted_square_sum(z, H, R):
    """Smallest chi-square over the parameters, and its degrees of freedom, by another factorisation."""
    values, vectors = np.linalg.eigh(R)
    white = vectors.T / np.sqrt(values)[:, None]
    x, _, rank, _ = lstsq(white @ H, white @ z, cond=1e-10)
    return float(np.sum((white @ (z - H @ x)) ** 2)), len(z) - rank


def test_chi_square_is_that_of_weighted_least_squares():
    found = WhiteResiduals.of(*measurements())
    for u, (z, H, R) in enumerate(zip(*measurements(), strict=True)):
        chi_square, freedom = weighted_square_sum(z, H, R)
        assert found.freedom[u] == freedom == N - P + (u == UNITS - 1)
        assert found.chi_square[u] == pytest.approx(chi_square, rel=1e-10)
        assert found.of_unit(u).test == (found.chi_square[u], freedom)


def test_statistics_tell_the_gain_of_an_effect():
    """Chi-square falls by gᵀ N⁻¹ g where an effect is estimated, too."""
    effect = np.random.default_rng(1).normal(size=(N, 2))
    for z, H, R in zip(*measurements(), strict=True):
        found = WhiteResiduals.of(z, H, R).statistics(effect)
        gain = found.gradient @ np.linalg.solve(found.information, found.gradient)
        less, freedom = weighted_square_sum(z, np.hstack([H, effect]), R)
        assert (found.chi_square - gain, found.freedom - 2) == (pytest.approx(less, rel=1e-10), freedom)


def test_white_measurements_have_the_same_statistics():
    """Of coefficients of a drift, with a derivative that depends on one before it."""
    effect = np.random.default_rng(1).normal(size=(N, 2))
    for z, H, _ in zip(*measurements(), strict=True):
        (one,), other = residual_statistics(z, H, effect), WhiteResiduals.of(z, H, np.eye(N)).statistics(effect)
        assert one.freedom == other.freedom
        for name in ("gradient", "information", "chi_square"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-9, atol=1e-12)


def test_groups_are_predicted_by_the_others():
    """Chi-square of a group is what all measurements have beyond the others."""
    z, H, R = measurements()
    found = PredictedGroups.of(WhiteResiduals.of(z, H, R), R, ROWS)
    for u in range(UNITS):
        whole, freedom = weighted_square_sum(z[u], H[u], R[u])
        for g, own in enumerate(ROWS):
            left = np.setdiff1d(np.arange(N), own)
            rest, others = weighted_square_sum(z[u, left], H[u, left], R[u][np.ix_(left, left)])
            assert found.chi_square[u, g] == pytest.approx(whole - rest, rel=1e-9)
            assert found.freedom[u, g] == freedom - others == 2


def test_what_only_one_group_shows_is_not_predicted():
    z, H, R = (part[0] for part in measurements())
    H[2:, 1] = 0.0
    found = PredictedGroups.of(WhiteResiduals.of(z, H, np.diag(np.diag(R))), np.diag(np.diag(R)), ROWS)
    assert found.freedom.tolist() == [1, 2, 2, 2, 2, 2]
    # The direction that is not predicted is that of the parameter.
    unseen = found.directions[0][:, ~found.predicted[0]][:, 0]
    assert abs(unseen @ H[:2, 1]) == pytest.approx(np.linalg.norm(unseen) * np.linalg.norm(H[:2, 1]), rel=1e-9)


def test_fewer_measurements_than_parameters_leave_nothing():
    z, H, R = (part[0] for part in measurements())
    found = WhiteResiduals.of(z[:3], H[:3], R[:3, :3])
    assert found.test == (pytest.approx(0.0, abs=1e-20), 0)
    assert PredictedGroups.of(found, R[:3, :3], np.array([[0, 1]])).freedom.tolist() == [0]


def test_a_covariance_that_is_none_is_refused():
    z, H, R = measurements()
    R[2] = np.where(np.eye(N), 1.0, 2.0)
    with pytest.raises(np.linalg.LinAlgError):
        WhiteResiduals.of(z, H, R)


@pytest.mark.parametrize("seed", range(4))
def test_a_covariance_that_is_singular_to_rounding_gives_the_same_whatever_the_rounding(seed):
    """Without noise of their own, the measurements scatter in four directions alone, and agree in the others."""
    rng = np.random.default_rng(1)
    root, H, drawn = rng.normal(size=(N, 4)), rng.normal(size=(N, P)), rng.normal(size=4)
    off = np.random.default_rng(seed).normal(size=(N, N))
    found = WhiteResiduals.of(root @ drawn, H, root @ root.T * (1.0 + 2e-16 * (off + off.T)))
    assert found.chi_square == pytest.approx(drawn @ drawn, rel=1e-6)


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
