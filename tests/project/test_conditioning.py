"""Matrices that are singular but for rounding errors, whatever these are."""

import numpy as np
import pytest

from srt.conditioning import has_inverse, scaled_root


@pytest.mark.parametrize("seed", range(8))
def test_singular_to_rounding(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 4))
    singular = root @ rng.normal(size=(4, 6)) * (1.0 + 1e-16 * rng.normal(size=(6, 6)))
    assert not has_inverse(singular)
    with pytest.raises(np.linalg.LinAlgError):
        scaled_root(root @ root.T * (1.0 + 1e-16 * rng.normal(size=(6, 6))))


def test_units_do_not_count():
    """Regular matrices in any units, beside zeros and numbers that are not finite."""
    regular = np.random.default_rng(1).normal(size=(3, 3))
    units = np.array([1e-12, 1.0, 1e12])
    given = [units[:, None] * regular * units, np.zeros((3, 3)), np.full((3, 3), np.nan), np.diag([1.0, 0.0, 1.0])]
    assert has_inverse(np.array(given)).tolist() == [True, False, False, False]
    covariance = units[:, None] * (regular @ regular.T) * units
    L, scale = scaled_root(covariance)
    np.testing.assert_allclose(L @ L.T, covariance * np.outer(scale, scale), rtol=1e-12)
    np.testing.assert_allclose(np.diag(L @ L.T), 1.0, rtol=1e-12)
    with pytest.raises(np.linalg.LinAlgError):
        scaled_root(np.diag([1.0, np.nan]))
