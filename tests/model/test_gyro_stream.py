"""Moving average of the gyro stream against scipy's filter."""

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from srt.model.gyro_stream import moving_average


@pytest.mark.parametrize("width", [1, 2, 5, 40, 101])
@pytest.mark.parametrize("n", [1, 7, 1000])
def test_moving_average_agrees_with_scipy(width, n):
    """The error is rounding of a cumulative sum of n values of order 1."""
    x = np.random.default_rng(n).standard_normal((3, n))
    expected = uniform_filter1d(x, width, axis=1, mode="nearest")
    bound = 4.0 * (n + width) * np.finfo(float).eps * np.abs(x).max()
    np.testing.assert_allclose(moving_average(x, width), expected, rtol=0.0, atol=bound)


def test_moving_average_of_zeros_is_zero_after_large_values():
    """A channel that reads exactly zero keeps no sign of what came before."""
    x = np.concatenate([np.random.default_rng(0).standard_normal(500) * 1e3, np.zeros(100)])[None]
    assert not moving_average(x, 20)[0, 520:].any()
