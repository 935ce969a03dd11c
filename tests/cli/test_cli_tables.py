"""Numbers and tables as text."""

import math

import pytest

from srt.reports.tables import decimals_for, fixed, text_table


@pytest.mark.parametrize(
    ("sigma", "decimals"),
    [
        (1234.0, 0),
        (12.0, 0),
        (10.0, 0),
        (9.9, 1),
        (1.0, 1),
        (0.36, 2),
        (0.0081, 4),
        (1e-9, 6),
        (0.0, 6),
        (math.nan, 6),
        (math.inf, 6),
    ],
)
def test_decimals_show_two_digits_of_sigma(sigma, decimals):
    assert decimals_for(sigma) == decimals


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [
        (132.414, 2, "132.41"),
        (-0.004, 2, "0.00"),  # no minus before nothing
        (-0.0, 6, "0.000000"),
        (1.2e-9, 6, "1.2e-09"),
        (-1.2e-9, 6, "-1.2e-09"),
        (2.5e8, 1, "2.500e+08"),
        (math.nan, 3, "-"),
    ],
)
def test_numbers(value, decimals, text):
    assert fixed(value, decimals) == text


def test_columns_line_up_and_nothing_trails():
    table = text_table(["name", "two\nlines"], [["a", "1.5"], None, ["long name", "-10.25"]], "lr")
    assert table.splitlines() == [
        "               two",
        " name        lines",
        " -----------------",
        " a             1.5",
        "",
        " long name  -10.25",
    ]
