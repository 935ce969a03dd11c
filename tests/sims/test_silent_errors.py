"""A part of the study of errors that gave wrong results without a word: two units of each row that can show."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2
from silent_errors import ESTIMATORS, ROWS, trial

UNITS = 2


@pytest.mark.parametrize("name", ["vibration, 5 µrad and 3 mg at 23 Hz", "vibration, 0.3 mrad at 7 Hz"])
def test_vibration_is_named_and_its_effect_removed(name):
    """NEES of all units and estimators, whose errors are alike, below the band of 1e-4."""
    pytest.importorskip("gtsam")
    nees, named, inconsistent = np.moveaxis(np.array([trial(name, 40 + u) for u in range(UNITS)]), 2, 0)
    assert nees.shape == (UNITS, len(ESTIMATORS))
    assert named.all()
    assert not inconsistent.any()
    assert np.all(27.0 * nees < chi2.isf(1e-4 / UNITS, 27))


def test_a_wrong_clock_and_gravity_are_told():
    pytest.importorskip("gtsam")
    for name in ("clock off by 1e-4", "gravity off by 342 ppm"):
        assert all(named for _, named, _ in trial(name, 40))
    assert all(nees < chi2.isf(1e-4, 27) / 27.0 for nees, _, _ in trial("clock off by 1e-4, sigma stated", 40))
    assert "none" in ROWS
