"""Closed form on simulated units, and its accuracy on an imperfect fixture."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from worse_recordings import CASES, unit_of

import srt
from sims.physics.fixture import draw_fixture
from sims.physics.imu import ImuModel, read_out
from sims.physics.sequences import table_sequences
from sims.physics.table_motion import table1_motion
from srt.closed_form.fixture_accuracy import fixture_excess
from srt.closed_form.formulas import SelectedFormulas
from srt.closed_form.iteration import iterate, iterate_units
from srt.constants import DEG_PER_H, DEG_PER_SQRT_H, MICRO_G
from srt.estimation.error_sources import NO_ERRORS
from srt.estimation.initial_estimates import initial_estimate
from srt.estimation.iterations import CONVERGED_CORRECTION, CONVERGED_SIGMAS, PARAMETER_UNITS
from srt.estimation.options import Options
from srt.model.rotations import rotation_matrix
from srt.model.sensor_model import Triad, outside_model, triads
from srt.recording.recording import Fixture, ImuNoise, Site
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.prepared_units import together

SIZES = np.zeros(N_PARAMETERS)
for group, size in {
    "gyro_scale": 0.5, "gyro_asymmetry": 0.01, "gyro_orthogonality": 0.3, "accel_bias": 1.0, "accel_scale": 0.5,
    "accel_asymmetry": 0.01, "accel_misalignment": 0.3, "gyro_bias": 0.02,
}.items():  # fmt: skip
    SIZES[GROUP_SLICES[group]] = size
"""Largest errors: ±50 %, 0.3 rad, 1 m/s², 1 °/s."""
IMU = ImuModel(gyro_noise=0.1 * DEG_PER_SQRT_H, accel_noise=50.0 * MICRO_G)
COUNT = 14


@cache
def motion(dwell_s=2.0):
    return table1_motion(
        site=Site(9.80665, 5e-6, 0.8), stated_fixture=Fixture(0.3, 1e-3, 1e-3), heading_rad=0.3,
        sample_rate_hz=50.0, rate_rad_s=3.0, dwell_s=dwell_s,
    )  # fmt: skip


def prepared(recording):
    return prepare_checked(recording, recording.sequences, "linear")


@cache
def units():
    """Prepared units with errors of up to 50 % and 0.3 rad, and their true errors."""
    rng = np.random.default_rng(20261125)
    truth = []
    while len(truth) < COUNT:
        errors = SensorErrors(rng.uniform(-1.0, 1.0, N_PARAMETERS) * SIZES)
        if outside_model(errors) is None:
            truth.append(errors)
    return [prepared(read_out(motion(), errors, IMU, rng)) for errors in truth], truth


def starts(truth, rng=None):
    """Initial estimates 1e-2 from the truth, and no rotation to MARS."""
    rng = np.random.default_rng(1) if rng is None else rng
    vectors = np.stack([errors.vector for errors in truth])
    return vectors + 1e-2 * SIZES * rng.standard_normal(vectors.shape), np.tile(np.eye(3), (len(truth), 1, 1))


def together_in(batch):
    """Solutions of the units in batches of a size."""
    data, truth = units()
    first, U = starts(truth)
    formulas = SelectedFormulas(data[0], Options())
    out = []
    for a in range(0, COUNT, batch):
        own = slice(a, a + batch)
        out += iterate_units(together(data[own]), Options(), formulas, first[own], U[own])
    return out


def sigma(solution):
    return np.sqrt(np.diag(solution.covariance))


def test_batches_of_any_size_give_the_same():
    one, seven, all_of_them = (together_in(batch) for batch in (1, 7, COUNT))
    for alone, *others in zip(one, seven, all_of_them, strict=True):
        assert alone.status == "converged"
        for other in others:
            assert (other.status, len(other.corrections)) == (alone.status, len(alone.corrections))
            np.testing.assert_allclose(other.errors.vector, alone.errors.vector, rtol=0, atol=1e-12)
            assert np.all(np.abs(other.errors.vector - alone.errors.vector) <= 1e-9 * sigma(alone))
            np.testing.assert_allclose(sigma(other), sigma(alone), rtol=1e-9)
            scale = np.sqrt(np.diag(alone.measurement_covariance))
            off = (other.measurement_covariance - alone.measurement_covariance) / np.outer(scale, scale)
            assert np.abs(off).max() < 1e-9


def test_stated_bias_instability_of_units_together():
    """The drift within rotations has as many parts for units together as for each of them."""
    stated = ImuNoise(gyro_bias_instability=0.01 * DEG_PER_H, accel_bias_instability=10.0 * MICRO_G)
    data, truth = units()
    data = [prepared(replace(unit.recording, noise=stated)) for unit in data]
    first, U = starts(truth)
    formulas = SelectedFormulas(data[0], Options())
    found = iterate_units(together(data), Options(), formulas, first, U)
    alone = iterate(data[0], Options(), formulas, SensorErrors(first[0]), U[0])
    np.testing.assert_allclose(found[0].errors.vector, alone.errors.vector, rtol=0, atol=1e-12)
    np.testing.assert_allclose(sigma(found[0]), sigma(alone), rtol=1e-9)


def test_errors_are_within_their_sigmas():
    """NEES over the units is chi-square."""
    nees = 0.0
    for solution, truth in zip(together_in(COUNT), units()[1], strict=True):
        off = solution.errors.vector - truth.vector
        nees += off @ np.linalg.solve(solution.covariance, off)
    freedom = N_PARAMETERS * COUNT
    assert abs(nees - freedom) < 3.5 * np.sqrt(2.0 * freedom)


@pytest.mark.parametrize("step", ["jacobian", "coefficients"])
@pytest.mark.parametrize("imu", [IMU, ImuModel()], ids=["noise", "noise-free"])
def test_what_would_follow_the_last_correction_is_negligible(imu, step):
    """Iterations from the result change it by at most the tolerance."""
    _, truth = units()
    options, rng = Options(step=step), np.random.default_rng(4)
    data = together([prepared(read_out(motion(), errors, imu, rng)) for errors in truth])
    formulas, (first, U) = SelectedFormulas(data.units[0], options), starts(truth)
    found = iterate_units(data, options, formulas, first, U)
    assert {solution.status for solution in found} == {"converged"}
    reached, U = np.stack([solution.errors.vector for solution in found]), np.stack([solution.U for solution in found])
    sigma = np.stack([np.sqrt(np.diag(solution.covariance)) for solution in found])
    further = np.stack([solution.errors.vector for solution in iterate_units(data, options, formulas, reached, U)])
    tolerance = np.maximum(CONVERGED_CORRECTION * PARAMETER_UNITS, CONVERGED_SIGMAS * sigma)
    assert np.all(np.abs(further - reached) <= tolerance)


def test_a_unit_that_diverges_leaves_the_others():
    data, truth = units()
    first, U = starts(truth)
    first[3, GROUP_SLICES["gyro_scale"]] = 40.0
    formulas = SelectedFormulas(data[0], Options())
    found = iterate_units(together(data), Options(), formulas, first, U)
    assert found[3].status != "converged"
    alone = iterate(data[3], Options(), formulas, SensorErrors(first[3]), U[3])
    assert (found[3].status, found[3].message) == (alone.status, alone.message)
    for k, (other, usual) in enumerate(zip(found, together_in(COUNT), strict=True)):
        if k != 3:
            np.testing.assert_allclose(other.errors.vector, usual.errors.vector, rtol=0, atol=1e-12)


def test_a_unit_that_moved_in_a_window_leaves_the_others():
    data, truth = units()
    first, U = starts(truth)
    recording = data[5].recording
    a, b = data[5].windows.samples[8].tolist()
    gyro = recording.gyro.copy()
    gyro[(a + b) // 2 : b, 0] += 3e-3
    moved = [*data[:5], prepared(replace(recording, gyro=gyro)), *data[6:]]
    formulas = SelectedFormulas(data[0], Options())
    found = iterate_units(together(moved), Options(), formulas, first, U)
    assert [bool(solution.integrated) for solution in found] == [k == 5 for k in range(COUNT)]
    alone = iterate(moved[5], Options(), formulas, SensorErrors(first[5]), U[5])
    np.testing.assert_allclose(found[5].errors.vector, alone.errors.vector, rtol=0, atol=1e-12)


def test_units_of_other_schedules_are_refused():
    data, truth = units()
    other = prepared(read_out(motion(3.0), truth[0], IMU, np.random.default_rng(2)))
    with pytest.raises(srt.SrtError, match="Unit 2 differs from the first in schedule"):
        together([data[0], other])


def test_triads_of_units_are_those_of_each():
    rng = np.random.default_rng(3)
    vectors = rng.uniform(-1.0, 1.0, (5, N_PARAMETERS)) * 0.5 * SIZES
    readings = rng.standard_normal((5, 400, 3))
    for sensor, both in enumerate(triads(vectors)):
        for u, own in enumerate(triads(vectors[u])[sensor] for u in range(5)):
            assert isinstance(own, Triad)
            np.testing.assert_allclose(both.compensate(readings)[u], own.compensate(readings[u]), rtol=0, atol=1e-14)
            np.testing.assert_array_equal(both.sensitivity(readings)[u], own.sensitivity(readings[u]))


STATED = 1e-4


@cache
def solved():
    """A unit on a fixture of 0.1 mrad, as stated."""
    case = CASES["alignment of 1 mrad, 0.1 stated"]._replace(alignment_rad=STATED)
    recording, _ = unit_of(case, 0)
    data, options = prepare_checked(recording, recording.sequences, "linear"), Options()
    return data, iterate(data, options, SelectedFormulas(data, options), *initial_estimate(data, options))


def excess(tilts, force_errors=0.0, **stated):
    """Errors that are found after rotations (K, 3) of the starts and errors of their specific forces."""
    data, solution = solved()
    force = solution.measurements.force.copy()
    force[data.start] = np.einsum("kab,kb->ka", rotation_matrix(tilts), force[data.start]) + force_errors
    return fixture_excess(replace(data, **stated), replace(solution.measurements, force=force), solution.covariance)


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


def test_bias_instability_of_the_accelerometers_does_not_accuse_the_fixture():
    """A bias of 1 mg that differs from start to start, with and without such an instability in the noise model."""
    drawn = np.random.default_rng(4).normal(0.0, 1e-3 * 9.80665, (solved()[0].K, 3))
    assert excess(np.zeros_like(drawn), drawn, accel_instability=1e-3 * 9.80665) == NO_ERRORS
    assert excess(np.zeros_like(drawn), drawn) != NO_ERRORS


@pytest.mark.parametrize("ids", [("1", "2"), ("4", "5")])
def test_two_sequences_that_contradict_the_fixture_add_no_error_of_it(ids):
    """One contrast of two verticals cannot tell start angles, alignment and wobble apart."""
    rng, size = np.random.default_rng(4), 3e-3  # the verticals of this draw contradict 1 mrad
    kinds = ("level", "north", "mounting", "rotation")
    draw = draw_fixture(rng, table_sequences(ids), **{f"{kind}_sigma_rad": size for kind in kinds})
    motion = table1_motion(
        site=Site(9.80665, 5e-6, 0.8), stated_fixture=Fixture(0.0, 1e-3, 1e-3), sample_rate_hz=50.0, dwell_s=4.0,
        sequences=ids, fixture_draw=draw,
    )  # fmt: skip
    found = srt.calibrate(read_out(motion, SensorErrors(), IMU, rng), "closed-form")
    assert (found.status, found.consistency.added_noise) == ("partial", None)
