"""A part of the study of the fixture: axes three sigmas from square with known rotations, and recorded moves."""

import numpy as np
import pytest
from fixture_study import EFFICIENT, ESTIMATORS, Cell, CellResult, UnitResult, main, study


def test_the_limits_of_a_cell_are_met():
    pytest.importorskip("gtsam")
    (result,) = study([Cell("navigation", 3.0, 0.05, "skipped")], 3, 4000, 1)
    assert not list(result.failures(3 * len(EFFICIENT) + 1))
    assert len(result.row()) == 4 + len(ESTIMATORS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        "--units 10 --seed 30000",
        "--moves recorded --rotation-mrad 1 --non-orthogonality-mrad 1 --units 25 --seed 31000",
    ],
)
def test_a_twentieth_of_the_study(arguments):
    pytest.importorskip("gtsam")
    assert main(arguments.split()) == 0


def test_failures_are_told():
    """Errors of twice the bound, of which half the sigma is reported, in units that are all accused."""
    bad = UnitResult(np.full((4, 27), 2.0), (4.0 * 27.0,) * 4, (True,) * 4, disagree=True)
    told = list(CellResult(Cell("tactical", 0.0, 1.0, "skipped"), [bad] * 20).failures(7))
    assert len(told) == 3 * len(EFFICIENT) + 1
    assert any("NEES is 108.0" in line for line in told)
