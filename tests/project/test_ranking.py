"""Order of values that are equal but for rounding errors."""

import numpy as np
import pytest

from srt.ranking import ranked, rounded, significant


@pytest.mark.parametrize("error", [-1e-12, 0.0, 1e-12])
def test_near_ties_keep_their_order(error):
    keys = np.array([1.0, 1.0 + error, np.nan, 3.0, 3.0 + error, np.inf, -1.0])
    assert ranked(keys).tolist() == [5, 3, 4, 0, 1, 6, 2]
    assert ranked(np.stack([keys, keys], axis=1), axis=0)[:, 1].tolist() == [5, 3, 4, 0, 1, 6, 2]
    # Equal by columns, of very different sizes; equal over all, where the largest is the third.
    assert np.argmax(rounded(np.array([[5.0, 5.0 + error], [1e-9, (1.0 + error) * 1e-9]])), axis=1).tolist() == [0, 0]
    assert np.argmax(rounded(np.array([[5.0, 5.0 + error], [7.0, 7.0 + error]]), axis=None)) == 2


def test_values_that_differ_are_told_apart():
    assert ranked(np.array([1.0, 1.00001, 0.99999])).tolist() == [1, 0, 2]
    assert ranked(np.array([1e-18, 3e-17])).tolist() == [1, 0]


def test_differences_that_are_rounding_errors_are_equal_on_a_given_scale():
    assert ranked(np.array([1e-18, 3e-17, -2e-17]), scale=1.0).tolist() == [0, 1, 2]


@pytest.mark.parametrize("keys", [[], [0.0, 0.0], [np.inf, np.inf], [np.nan, np.nan], [5e-324, 5e-324]])
def test_keys_without_a_scale(keys):
    assert ranked(np.array(keys)).tolist() == list(range(len(keys)))


def test_keys_of_max_keep_the_order_of_equals():
    assert max([1e-30, 1e-30 * (1.0 + 1e-12)], key=significant) == 1e-30
    assert min([2e-30, 1e-30], key=significant) == 1e-30
