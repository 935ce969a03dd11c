"""Borders of the legs of a manoeuvre, from marks written by hand."""

import numpy as np
import pytest

from srt.sequences.manoeuvres import leg_borders


def marks(*runs):
    """Marks from (mark, samples) pairs."""
    return np.repeat([mark for mark, _ in runs], [samples for _, samples in runs])


@pytest.mark.parametrize(
    ("runs", "by_stops", "through_stops"),
    [
        # One rotation between two stops: all samples are its own.
        ([(-1, 10), (0, 50), (-1, 10)], [0, 70], [0, 70]),
        # Two axes without a pause: the border is the change.
        ([(0, 40), (1, 60)], [0, 40, 100], [0, 40, 100]),
        # Two axes with a pause of 20 samples: its middle.
        ([(0, 40), (-1, 20), (1, 60)], [0, 50, 120], [0, 50, 120]),
        # A stop within a rotation about one axis: two rotations, or one.
        ([(2, 40), (-1, 20), (2, 60)], [0, 50, 120], [0, 120]),
        # A transient of 1 % between two axes belongs half to either; within one axis it is ignored or divides.
        ([(0, 98), (2, 2), (1, 100)], [0, 99, 200], [0, 99, 200]),
        ([(0, 98), (2, 2), (0, 100)], [0, 99, 200], [0, 200]),
        # Nothing rotates.
        ([(-1, 30)], [0, 30], [0, 30]),
    ],
)
def test_borders_of_legs(runs, by_stops, through_stops):
    assert leg_borders(marks(*runs), through_stops=False).tolist() == by_stops
    assert leg_borders(marks(*runs), through_stops=True).tolist() == through_stops
