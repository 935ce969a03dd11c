"""Defects of real logs in recordings of an independent generator: named, and no wrong result; one unit of each."""

import numpy as np
import pytest
from honesty import STUDIES
from honesty_recordings import DEFECTS


def outcome(name, unit):
    return STUDIES["defects"].trial((name,), unit, [])["default"]


@pytest.mark.parametrize("name", [name for name in DEFECTS if name not in {"none", "none, 9 turns"}])
def test_a_defect_is_named_or_harmless(name):
    found = outcome(name, 0)
    assert set(DEFECTS[name].named) <= set(found.faults)
    if found.usable:
        # Of at most 27 normal errors of ten recordings, one in a hundred has one beyond 4.2 sigma.
        assert np.nanmax(np.abs(found.z)) <= 4.2
    else:
        assert found.status == "refused"
        assert found.faults


def test_a_shake_on_all_axes_is_clipped():
    """All three axes hold their extremes at once, and show no noise there."""
    assert outcome("shake at ±32767", 4).faults[0] == "gyro_clipped"
