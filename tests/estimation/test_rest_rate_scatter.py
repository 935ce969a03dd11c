"""Scatter of the gyro biases between sequences beyond the noise of the rates at rest."""

import numpy as np
import pytest
from scipy.integrate import quad

from srt.estimation.rest_rate_scatter import excess_variance

NOISE = np.array([1.0, 2.0, 4.0])


def posterior_mean(shown, freedom):
    """Mean of σ² by quadrature: variances (3,) of normal numbers of variance σ² + NOISE, σ uniform."""

    def density(sigma):
        variance = sigma**2 + NOISE
        return np.exp(-0.5 * freedom * np.sum(np.log(variance / NOISE) + shown / variance - shown / NOISE))

    parts = [quad(lambda s, power=power: s**power * density(s), 0.0, np.inf, epsabs=0.0)[0] for power in (0, 2)]
    return parts[1] / parts[0]


@pytest.mark.parametrize("share", [0.2, 0.7, 1.0, 1.3])
def test_rates_that_noise_explains_leave_room_for_what_it_hides(share):
    """17 rest rates with this share of the variance of noise: the mean over all scatters, by quadrature.

    3 %: the sum leaves out scatters of less than a hundredth of its scale, which is up to three times the mean.
    """
    rates = np.random.default_rng(5).normal(size=(17, 3))
    rates *= np.sqrt(share * NOISE / np.var(rates, axis=0, ddof=1))
    np.testing.assert_array_equal(excess_variance(rates, NOISE), 0.0)
    expected = posterior_mean(share * NOISE, 16)
    np.testing.assert_allclose(excess_variance(rates, NOISE, NOISE), expected, rtol=0.03)
