"""Search for the order and the sequences of a test, and the fast model of its drift."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from test_planning import WHITE, file_of

from srt.model.table1 import SEQUENCES
from srt.planning.annealing import AnnealedSearch
from srt.planning.candidates import from_catalogue
from srt.planning.drift_chain import DriftChain
from srt.planning.information import Signatures
from srt.planning.order import moves_between
from srt.planning.plan import PlanLimits, accuracy_criterion
from srt.planning.prediction import predict, variances_of_test

pytestmark = pytest.mark.usefixtures("short_search")

SHOWN = ("1", "1a", "2", "2a", "8", "11")


def chain_of(ids=tuple(SEQUENCES), total_s=520.0, noise=None):
    file = file_of(noise) if noise else file_of()
    stand = file.stand.kinematics()
    candidates = [from_catalogue(SEQUENCES[name], stand) for name in ids]
    criterion = accuracy_criterion(Signatures(candidates, stand, file.conditions()), file.targets.sigma(), PlanLimits())
    moves_s = moves_between(candidates, stand)
    return file, candidates, DriftChain(criterion, np.arange(len(ids)), moves_s, total_s)


@pytest.mark.parametrize(
    ("noise", "least", "most"), [(WHITE, 1.0 - 1e-6, 1.0 + math.log(1.2) ** 2 / 16.0), (None, 0.9, 1.6)]
)
def test_the_fast_model_is_the_whole_covariance_but_for_drift_within_sequences(noise, least, most):
    """Without drift linear interpolation alone differs: information between lengths with a ratio of 1.2 is too small by
    log(1.2)² / 8 at most. With drift sigmas are too large, by a factor of up to 1.5 for asymmetries in a mean order.
    """
    _, _, chain = chain_of(noise=noise)
    rng = np.random.default_rng(1)
    orders = np.array([rng.permutation(17) for _ in range(6)])
    fast, windows = chain.variances(orders, np.zeros_like(orders))
    for order, own, variances in zip(orders, windows, fast, strict=True):
        both, moves = np.repeat(own[:, None], 2, axis=1), chain.moves_s[order[:-1], order[1:]]
        ratio = np.sqrt(variances / variances_of_test(chain.criterion, order, both, moves))
        assert np.all((ratio > least) & (ratio < most)), ratio


def test_variances_of_a_test_are_those_of_its_prediction():
    file, candidates, chain = chain_of()
    windows = np.random.default_rng(2).uniform(5.0, 15.0, (17, 2))
    moves = np.diagonal(chain.moves_s, 1)
    found = variances_of_test(chain.criterion, np.arange(17), windows, moves)
    targets = file.targets.sigma()
    sigma = predict(candidates, windows, file.stand.kinematics(), file.conditions(), targets).sigma
    np.testing.assert_allclose(np.sqrt(found), (sigma / targets)[chain.criterion.targets], rtol=1e-9)


def test_windows_take_the_whole_time_and_stay_within_their_limits():
    _, _, chain = chain_of()
    rng = np.random.default_rng(3)
    members = np.array([rng.permutation(17) for _ in range(5)])
    steps = rng.integers(0, 5, members.shape)
    windows = chain.windows_s(members, steps)[0]
    moves = chain.moves_s[members[:, :-1], members[:, 1:]].sum(axis=1)
    np.testing.assert_allclose(2.0 * windows.sum(axis=1) + chain.between_s.sum() + moves, 520.0, rtol=1e-12)
    assert np.all((windows >= 5.0 - 1e-9) & (windows <= 60.0 + 1e-9))
    # A sequence with more steps has the longer windows.
    assert all(np.all(np.diff(own[np.argsort(each)]) >= -1e-9) for own, each in zip(windows, steps, strict=True))
    assert not np.isfinite(chain_of(total_s=100.0)[2].windows_s(members, steps)[0]).any()


def test_the_order_that_is_found_is_nearly_the_best_of_all():
    _, _, chain = chain_of(SHOWN, total_s=200.0)
    orders = np.array(list(permutations(range(len(SHOWN)))))
    best = np.log(chain.variances(orders, np.zeros_like(orders))[0].max(axis=1)).min()
    search = AnnealedSearch(chain, most=0)
    test, _ = search.best([np.arange(len(SHOWN))])
    assert sorted(test.members) == list(range(len(SHOWN)))
    fast = chain.variances(np.array([test.members]), np.array([test.steps]))[0]
    # Lengths of the windows are searched as well, and the whole covariance decides: 3 % of sigma between the models.
    assert math.log(fast.max()) < best + 2.0 * 0.03


@pytest.mark.parametrize(("total_s", "found"), [(520.0, True), (60.0, False)])
def test_a_selection_that_does_not_fit_is_none(total_s, found):
    _, _, chain = chain_of(total_s=total_s)
    assert (AnnealedSearch(chain, most=0).best([np.arange(17)]) is not None) == found
