"""Accuracy of a fixture from the verticals of its starts, with tilts put into the measured forces."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from worse_recordings import CASES, unit_of

from srt.closed_form.fixture_accuracy import fixture_excess
from srt.closed_form.formulas import SelectedFormulas
from srt.closed_form.iteration import iterate
from srt.estimation.error_sources import NO_ERRORS
from srt.estimation.initial_estimates import initial_estimate
from srt.estimation.options import Options
from srt.model.rotations import rotation_matrix
from srt.sequences.checked_preparation import prepare_checked

STATED = 1e-4


@cache
def solved():
    """A unit on a fixture of 0.1 mrad, as stated."""
    case = CASES["alignment of 1 mrad, 0.1 stated"]._replace(alignment_rad=STATED)
    recording, _ = unit_of(case, 0)
    data, options = prepare_checked(recording, recording.sequences, "linear"), Options()
    return data, iterate(data, options, SelectedFormulas(data, options), *initial_estimate(data, options))


def excess(tilts):
    """Errors that are found after rotations (K, 3) of the starts."""
    data, solution = solved()
    force = solution.measurements.force.copy()
    force[data.start] = np.einsum("kab,kb->ka", rotation_matrix(tilts), force[data.start])
    return fixture_excess(data, replace(solution.measurements, force=force), solution.total)


def test_a_fixture_as_stated_has_no_excess():
    assert excess(np.zeros((solved()[0].K, 3))) == NO_ERRORS


def test_starts_that_scatter_are_found_with_their_size():
    """Each start has two errors of tilt; those along the lean of the axis pass for wobble, so that half may be left."""
    tilts = np.random.default_rng(3).normal(0.0, 1e-3, (solved()[0].K, 3))
    found = excess(tilts)
    assert found.angle == pytest.approx(1e-3, rel=3.5 / math.sqrt(2.0 * len(tilts)))


@pytest.mark.parametrize("tilt_rad", [2e-3, 0.05])
def test_one_wrong_start_does_not_accuse_the_fixture(tilt_rad):
    tilts = np.zeros((solved()[0].K, 3))
    tilts[6] = tilt_rad
    assert excess(tilts) == NO_ERRORS
