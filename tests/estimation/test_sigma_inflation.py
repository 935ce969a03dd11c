"""Sigma where the residuals exceed the stated noise, and where they are white."""

from dataclasses import replace

import numpy as np
import pytest
from injected_faults.execution import labels_exchanged
from injected_faults.injection import Case
from scipy.linalg import lstsq

import srt
from srt.estimation.white_residuals import PredictedGroups, WhiteResiduals
from srt.noise.drift_forms import residual_statistics

ALL = ("closed-form", "least-squares", "ekf", "graph")


@pytest.fixture(scope="module")
def wrong_noise():
    """Industrial unit whose accelerometers are stated to have no bias instability, but have 50 µg."""
    recording = Case("industrial-mems", 31).recording
    return replace(recording, noise=replace(recording.noise, accel_bias_instability=0.0))


@pytest.mark.parametrize("estimator", ALL[1:])
def test_noise_is_added_and_told(wrong_noise, estimator):
    found = srt.calibrate(wrong_noise, estimator, checks=False)
    assert found.status == "converged"
    assert found.judgement.word == "doubtful"
    own, added = found.verdict.own_noise, found.verdict.added_noise
    assert own.probability < 1e-3 <= found.verdict.probability
    # The bias instability of this unit, 50 µg, between windows.
    assert added["force_m_s2"].added == pytest.approx(50e-6 * 9.81, rel=1.0)
    low, high = found.verdict.sigma_factor
    assert 1.0 <= low < high
    # The sources add up to the sigma that is reported.
    total = np.sqrt(sum(part**2 for part in found.contributions.values()))
    np.testing.assert_allclose(total, found.sigma, rtol=1e-6)


def test_the_closed_form_enlarges_all_sigmas(wrong_noise):
    """Its Birge ratio is that of all residuals, or of the specific forces alone where these show more."""
    found = srt.calibrate(wrong_noise, "closed-form", checks=False)
    assert found.judgement.word == "doubtful"
    assert found.verdict.added_noise is None
    ratio = np.sqrt(found.verdict.chi_square / found.verdict.degrees_of_freedom)
    assert found.noise.sigma_inflation >= ratio > 1.0
    assert found.verdict.sigma_factor == pytest.approx((found.noise.sigma_inflation,) * 2)


def test_a_unit_with_stated_noise_keeps_its_sigmas():
    found = srt.calibrate(Case("industrial-mems", 31).recording, "closed-form", checks=False)
    assert found.judgement.word == "sound"
    assert found.verdict.added_noise is None
    assert found.noise.sigma_inflation == 1.0


def test_exchanged_labels_are_no_noise():
    """Exchanged labels: a gyro bias is 15 sigma off. All estimators name the sequence."""
    case = Case("navigation-rlg", 20261135)
    exchanged = labels_exchanged(case, 2.0, np.random.default_rng((20261122, 13)))
    for estimator in ("closed-form", "least-squares"):
        found = srt.calibrate(exchanged, estimator, checks=False)
        assert found.status == "inconsistent"
        assert "contradicts all others" in found.message


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
