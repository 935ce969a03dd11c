"""Units against their fleet: how often sound ones are flagged, how surely bad ones, and that none hides another."""

import csv
import io
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

import srt
from srt.comparison.fleet import COLUMNS, calibrate_fleet
from srt.comparison.outliers import (
    EXPECTED_FALSE_FLAGS,
    MINIMUM_UNITS,
    critical_value,
    find_outliers,
    middle_and_scatter,
    tail_probability,
)
from srt.sensor_errors import N_PARAMETERS, NAMES

NO_SIGMA = 1e-9
"""Tolerance for units whose spread is 1; it changes no digit that counts."""


def flags_of_fleets(rng, units, fleets, *, spread=1.0, sigma=None):
    """Count the false flags of every one of many sound fleets of 27 parameters, each judged as a table is."""
    shape = (units, fleets * N_PARAMETERS)
    own = np.full(shape, NO_SIGMA) if sigma is None else sigma(shape)
    y = spread * rng.standard_normal(shape) + own * rng.standard_normal(shape)
    return find_outliers(y, own).flagged.sum(axis=0).reshape(fleets, N_PARAMETERS).sum(axis=1)


def check_rate(flags, expected):
    """Hold a mean count to 3.5 of its standard errors.

    Flags of one fleet come together at times (few others that happen to agree flag two units), so the scatter of the
    counts is the larger of what they show and that of independent flags.
    """
    error = math.sqrt(max(np.var(flags), expected) / len(flags))
    assert abs(np.mean(flags) - expected) < 3.5 * error


@pytest.mark.parametrize(
    ("units", "fleets", "times"),
    [
        (6, 3000, 1),
        (9, 3000, 1),
        (21, 1500, 1),
        *(pytest.param(n, 500, 20, marks=pytest.mark.campaign) for n in (6, 7, 8, 10, 12, 16, 20, 25, 36, 60)),
    ],
)
def test_sound_fleets_are_flagged_as_often_as_stated(units, fleets, times):
    """The worst case, no measurement errors; the limits, one of them between knots, are those of the program."""
    rng = np.random.default_rng(units)
    check_rate(np.concatenate([flags_of_fleets(rng, units, fleets) for _ in range(times)]), EXPECTED_FALSE_FLAGS)


@pytest.mark.parametrize("units", [6, 8, 15, 24, 45, 120])
def test_limits_solve_their_equation(units):
    """Limits hold at the knots and between them; the scatter is taken from 20 parts of the draws."""
    rng = np.random.default_rng(units)
    draws = {6: 40_000, 8: 40_000, 15: 10_000, 24: 3_000, 45: 1_000, 120: 100}[units]
    parts = [tail_probability(units, critical_value(units), rng, draws) for _ in range(20)]
    expected = EXPECTED_FALSE_FLAGS / N_PARAMETERS / units
    # The table has three decimals and comes from draws of its own, which show beyond 1 % of the chance.
    assert abs(np.mean(parts) - expected) < 3.5 * np.std(parts, ddof=1) / math.sqrt(20) + 0.01 * expected


def test_limit_goes_to_that_of_a_known_fleet():
    """Five million units: the normal quantile of 0.01 / 27 / n on both sides, which the limit never falls below."""
    for units in (6, 30, 300, 5_000_000):
        assert units * N_PARAMETERS * 2.0 * ndtr(-critical_value(units)) < EXPECTED_FALSE_FLAGS * (1.0 + 1e-9)
    assert 5_000_000 * N_PARAMETERS * 2.0 * ndtr(-critical_value(5_000_000)) == pytest.approx(
        EXPECTED_FALSE_FLAGS, rel=1e-3
    )
    assert 5.0 < critical_value(1000) < critical_value(100_000)


def unequal(rng):
    return {
        "decades": lambda shape: np.exp(rng.uniform(math.log(0.1), math.log(10.0), shape)),
        "two kinds": lambda shape: np.where(rng.random(shape) < 0.4, 0.01, 3.0),
        "equal": np.ones,
    }


@pytest.mark.parametrize("kind", ["decades", "two kinds", "equal"])
@pytest.mark.parametrize("spread", [0.0, 1.0, 5.0])
def test_sigmas_of_all_kinds_flag_no_more_than_stated(kind, spread):
    rng = np.random.default_rng(8)
    flags = flags_of_fleets(rng, 8, 800, spread=spread, sigma=unequal(rng)[kind])
    # Counts are close to Poisson's: 3.5 standard errors of the stated rate.
    assert np.mean(flags) < EXPECTED_FALSE_FLAGS + 3.5 * math.sqrt(EXPECTED_FALSE_FLAGS / len(flags))


def test_power():
    """One of 40 units 8 spreads off is found.

    S, from 39 others, has a sigma of about 0.12; the limit is 5.13 S √(1 + π/78). The margin 8 − 5.13 · 1.02 = 2.8 is
    then 2.3 of its sigma √(1 + (5.13 · 0.12)²) = 1.18: a chance of 0.99. Of 400 at least 0.99 − 3.5 √(0.0099 / 400).
    """
    rng = np.random.default_rng(40)
    y = rng.standard_normal((40, 400))
    y[11] += 8.0
    flagged = find_outliers(y, np.full(y.shape, 0.1)).flagged
    assert np.mean(flagged[11]) > 0.99 - 3.5 * math.sqrt(0.99 * 0.01 / 400)


@pytest.mark.parametrize(("units", "bad"), [(6, 2), (9, 3), (13, 4), (21, 6)])
def test_bad_units_hide_neither_themselves_nor_each_other(units, bad):
    """A quarter of the others, and the unit itself; all to one side and alike, which hides them best."""
    assert bad - 1 == max(1, (units - 1) // 4)
    rng = np.random.default_rng(units)
    y = rng.standard_normal((units, 200))
    y[:bad] += 1e6
    flagged = find_outliers(y, np.full(y.shape, 0.1)).flagged
    assert flagged[:bad].all()
    assert not flagged[bad:].any()


def test_a_value_no_worse_than_its_sigma_is_not_flagged():
    """The same value twice: once measured as well as the others, once with a sigma that explains it."""
    y = np.random.default_rng(3).standard_normal((20, 1))
    y[4] = 30.0
    sigma = np.full(y.shape, 0.1)
    assert find_outliers(y, sigma).flagged[4]
    sigma[4] = 30.0
    assert not find_outliers(y, sigma).flagged[4]


def test_scatter_is_not_less_than_the_sigmas_say():
    """Units that agree by chance far better than they are measured make no outlier of one that does not."""
    y = np.zeros((10, 1))
    y[3] = 2.0
    judged = find_outliers(y, np.ones(y.shape))
    assert judged.scatter == judged.others_scatter[3] == 1.0
    assert judged.z[3, 0] == pytest.approx(2.0 / math.sqrt(1.0 + math.pi / 18.0), rel=1e-12)
    assert not judged.flagged.any()


@pytest.mark.parametrize("units", [6, 7, 12])
def test_others_are_all_but_the_unit(units):
    rng = np.random.default_rng(units)
    y = rng.standard_normal((units, 5))
    y[:2] = y[2]  # equal values must not confuse the ranks
    judged = find_outliers(y, np.full(y.shape, NO_SIGMA))
    for unit in range(units):
        median, scatter = middle_and_scatter(np.delete(y, unit, axis=0).T)
        np.testing.assert_allclose(judged.others_median[unit], median, rtol=1e-14)
        np.testing.assert_allclose(judged.others_scatter[unit], np.maximum(scatter, NO_SIGMA), rtol=1e-14)


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1), units=st.integers(1, 15), missing=st.floats(0.0, 0.6), shift=st.floats(-1e3, 1e3)
)
def test_order_origin_and_scale_of_values_do_not_matter(seed, units, missing, shift):
    rng = np.random.default_rng(seed)
    y, sigma = rng.standard_t(2, (units, 4)), rng.uniform(0.01, 2.0, (units, 4))
    sigma[rng.random(sigma.shape) < missing] = np.nan
    judged = find_outliers(y, sigma)
    order = rng.permutation(units)
    again = find_outliers(y[order], sigma[order])
    np.testing.assert_array_equal(again.z, judged.z[order])
    np.testing.assert_array_equal(again.median, judged.median)
    np.testing.assert_array_equal(again.scatter, judged.scatter)
    turned = find_outliers(shift - 3.0 * y, 3.0 * sigma)
    # Rounding of the shifted values, 1e-13, over the least denominator, 3 · 0.01.
    np.testing.assert_allclose(turned.z, -judged.z, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(turned.scatter, 3.0 * judged.scatter, rtol=1e-9)


def test_too_few_units_are_not_judged():
    y = np.zeros((MINIMUM_UNITS, 2))
    y[0] = 1e9
    sigma = np.ones(y.shape)
    sigma[1, 1] = np.nan  # held: one short of the minimum
    judged = find_outliers(y, sigma)
    assert judged.flagged.tolist() == [[True, False]] + [[False, False]] * (MINIMUM_UNITS - 1)
    assert np.isfinite(judged.limit[0])
    assert np.isnan(judged.limit[1])
    assert np.isnan(judged.z[:, 1]).all()
    assert judged.median[1] == 0.0
    for units in range(4):
        few = find_outliers(y[:units], sigma[:units])
        assert np.isnan(few.z).all()
        assert np.isfinite(few.median).all() == (units > 0)


def test_unknown_sigmas_are_excluded_from_the_outlier_test():
    rng = np.random.default_rng(1)
    y, sigma = rng.standard_normal((8, 3)), np.ones((8, 3))
    judged = find_outliers(y, sigma)
    for unknown in (np.nan, 0.0, -1.0, np.inf):
        more = find_outliers(np.vstack([y, np.full(3, 1e9)]), np.vstack([sigma, np.full(3, unknown)]))
        np.testing.assert_array_equal(more.z[:8], judged.z)
        assert np.isnan(more.z[8]).all()


def test_shapes_that_differ_are_refused():
    with pytest.raises(srt.InputError, match=r"shape \(8, 3\) and sigmas of shape \(8, 2\)"):
        find_outliers(np.zeros((8, 3)), np.ones((8, 2)))


class DyingEngine:
    """Its workers die of one task, with whatever else they had at hand."""

    def run(self, function, tasks):
        for task in tasks:
            if task.name == "bad":
                raise srt.DataError("A worker died.")
            yield function(task)


def test_a_unit_that_kills_its_worker_stops_no_other(tmp_path):
    told = []
    names = ("a", "bad", "c", "d")
    fleet = calibrate_fleet({n: tmp_path / n for n in names}, engine=DyingEngine(), finished=told.append)
    assert [unit.name for unit in fleet.units] == list(names)
    assert sorted(unit.name for unit in told) == sorted(names)
    assert [unit.exit_code for unit in fleet.units] == [2, 1, 2, 2]
    assert fleet.units[1].message == "A worker died."
    assert fleet.units[3].message.startswith(f"There is no recording {tmp_path / 'd'}")
    fleet.save_csv(tmp_path / "fleet.csv")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "fleet.csv").read_bytes().decode())))
    assert [row["unit"] for row in rows] == list(names)
    assert tuple(rows[0]) == COLUMNS
    assert all(row["status"] == "failed" and row["value"] == "" for row in rows)


@pytest.mark.parametrize("name", ["=1+1", "+1", "-1", "@SUM(1)", "\t=1"])
def test_names_are_no_formulas_in_a_spreadsheet(tmp_path, name):
    fleet = calibrate_fleet({name: tmp_path / "none"})
    fleet.save_csv(tmp_path / "fleet.csv")
    (row,) = csv.DictReader(io.StringIO((tmp_path / "fleet.csv").read_bytes().decode()))
    assert row["unit"] == "'" + name
    assert row["message"] == fleet.units[0].message
    assert fleet.to_dict()["units"][0]["name"] == name  # JSON is not opened by spreadsheets


def test_a_defect_of_the_program_is_one_units_own(tmp_path, monkeypatch):
    def defect(path):
        raise ZeroDivisionError("of\nzero")

    monkeypatch.setattr("srt.recording.folder.load_recording", defect)
    (unit,) = calibrate_fleet([tmp_path]).units
    assert unit.exit_code == 1
    assert unit.message.startswith("The program failed (ZeroDivisionError: of zero): ")


def test_a_recording_twice_is_refused(tmp_path):
    with pytest.raises(srt.InputError, match="is named twice"):
        calibrate_fleet([tmp_path, tmp_path])


def test_an_empty_fleet_has_a_document():
    document = calibrate_fleet([]).to_dict()
    assert document["units"] == document["rows"] == []
    assert [row["name"] for row in document["parameters"]] == list(NAMES)


@pytest.mark.parametrize("kind", ["normal", "rounded", "ties", "outliers"])
def test_large_fleets_get_the_numbers_of_the_list_of_all_pairs(kind, monkeypatch):
    """Counting pairs instead of listing them gives the same result to the last bit, ties included."""
    rng = np.random.default_rng(20261122)
    for units in (6, 7, 8, 13, 40, 100):
        y = rng.standard_normal((units, 4)) * 10.0 ** rng.integers(-9, 6)
        if kind == "rounded":
            y = np.round(y / np.abs(y).max(), 1)
        elif kind == "ties":
            y = rng.integers(0, 3, y.shape).astype(float)
        elif kind == "outliers":
            y[rng.integers(units)] *= 1e6
        sigma = np.abs(rng.standard_normal(y.shape)) + 1e-3
        listed = find_outliers(y, sigma)
        with monkeypatch.context() as patch:
            patch.setattr("srt.comparison.outliers._FEW_UNITS", 0)
            counted = find_outliers(y, sigma)
        for name in ("median", "scatter", "limit", "others_median", "others_scatter", "z"):
            np.testing.assert_array_equal(getattr(listed, name), getattr(counted, name), err_msg=f"{name}, {units}")
