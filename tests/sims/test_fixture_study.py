"""A part of the study of the fixture: axes three sigmas from square with known rotations, and recorded moves."""

import honesty
import numpy as np
import pytest
from studies import Score

FIXTURE = honesty.STUDIES["fixture"]


def test_the_limits_of_a_cell_are_met():
    pytest.importorskip("gtsam")
    rows = [FIXTURE.trial(("navigation", 3, 0.05), unit, list(FIXTURE.limited)) for unit in range(4000, 4003)]
    for name in FIXTURE.limited:
        assert not FIXTURE.beyond([row[name] for row in rows], len(FIXTURE.limited))


@pytest.mark.campaign
@pytest.mark.parametrize(
    "arguments",
    [
        {"study": "fixture", "units": 10, "first": 30_000},
        {"study": "fixture-moves", "only": ("1",), "units": 25, "first": 31_000},
    ],
    ids=["axes out of square", "moves"],
)
def test_a_twentieth_of_the_study(arguments):
    pytest.importorskip("gtsam")
    assert honesty.main(**arguments, jobs=1) == 0


@pytest.mark.parametrize(
    "fault",
    [{"error": np.full(27, 2.0)}, {"nees": 4.0 * 27.0}, {"status": "inconsistent"}, {"named": True}],
    ids=["errors of twice the bound", "half the sigma reported", "all accused", "all in disagreement"],
)
def test_each_limit_is_told(fault):
    sound = {"status": "converged", "error": np.ones(27), "nees": 27.0, "freedom": 27, "bound": np.ones(27)}
    assert not FIXTURE.beyond([Score(**sound)] * 20, 7)
    assert FIXTURE.beyond([Score(**(sound | fault))] * 20, 7)
