"""Statements of the laboratory, coverage, budget and decision rule of a certificate."""

import math
from dataclasses import replace

import pytest
from certificate_cases import calibration

import srt
from srt.reports.certificate import load_acceptance_limits, make_certificate
from srt.reports.certificate.content import budget_table, coverage_probability
from srt.reports.certificate.laboratory import NOT_STATED, load_laboratory
from srt.sensor_errors import DISPLAY_FACTORS, GROUP_SLICES


def written(folder, text, name="lab.toml"):
    (folder / name).write_text(text)
    return folder / name


def test_missing_statements_are_one_sentence(saved):
    made = make_certificate(saved(calibration()))
    assert made.parties == ()
    assert made.equipment is None
    assert made.missing == (
        "Not stated: certificate number and date of issue, laboratory, customer, operator, approval, make and model of "
        "the unit, conditions of the laboratory, equipment, origin of the references."
    )
    assert len(made.references.head) == 3
    assert made.references.rows[3][2].text == NOT_STATED  # no time base was stated


def test_statements_and_coverage_are_those_of_the_file(saved, tmp_path):
    lab = load_laboratory(
        written(
            tmp_path,
            """
            [certificate]
            number = 42
            date_of_issue = 2026-11-22
            coverage_factor = 3
            [laboratory]
            name = "Lab"
            [references]
            gravity = "report G-17"
            [[equipment]]
            name = "fixture"
            serial = "F-3"
            """,
        )
    )
    made = make_certificate(saved(calibration()), laboratory=lab)
    stated = dict(made.parties)
    assert (stated["Certificate number"], stated["Date of issue"], stated["Laboratory"]) == ("42", "2026-11-22", "Lab")
    assert "Customer" not in stated
    missing = made.missing.removeprefix("Not stated: ").removesuffix(".").split(", ")
    assert missing[:4] == ["address of the laboratory", "accreditation", "customer", "operator"]
    assert missing[-3:] == ["origin of latitude", "origin of heading of the fixture", "origin of time base"]
    assert not {"certificate number", "laboratory", "equipment", "origin of gravity"} & set(missing)
    assert [cell.text for cell in made.equipment.rows[0]] == ["fixture", "F-3", NOT_STATED, NOT_STATED]
    assert made.references.rows[0][3].text == "report G-17"
    assert made.parameters.head[4] == "U (k = 3)"
    sigma = made.source.calibration.sigma
    for row, size, factor in zip(made.parameters.rows, sigma, DISPLAY_FACTORS, strict=True):
        # Two digits at least: half a unit of the second is at most a twentieth of the number.
        assert float(row[4].text) == pytest.approx(3.0 * size * factor, rel=0.051)
    assert "99.7 %" in made.parameters.note


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[labratory]", r"did you mean laboratory"),
        ("[laboratory]\nnam = 'x'", r"laboratory.nam is no known key \(did you mean name"),
        ("[laboratory]\nname = []", r"laboratory.name is \[\], but a text in quotes"),
        ("laboratory = 3", "laboratory is 3, but a section of keys"),
        ("[certificate]\ncoverage_factor = 0", "coverage_factor is 0"),
        ("[equipment]\nname = 'x'", "equipment is no list"),
        ("[", "is not valid TOML"),
    ],
)
def test_a_wrong_file_is_one_sentence(tmp_path, text, sentence):
    with pytest.raises(srt.InputError, match=sentence):
        load_laboratory(written(tmp_path, text))


def test_coverage_probability_of_common_factors():
    # GUM (JCGM 100), table G.1
    for factor, percent in ((1.0, 68.27), (1.645, 90.0), (1.96, 95.0), (2.0, 95.45), (2.576, 99.0), (3.0, 99.73)):
        assert 100.0 * coverage_probability(factor) == pytest.approx(percent, abs=0.01)


def test_squares_of_the_budget_add_up():
    result = calibration()
    share = {"gyro_noise": 0.6, "gravity": 0.8}
    result = replace(result, contributions={name: part * result.sigma for name, part in share.items()})
    table = budget_table(result, 2.0)
    assert len(table.rows) == len(GROUP_SLICES)
    for row in table.rows:
        first, second, total, expanded = (float(cell.text) for cell in row[2:])
        # Each is rounded to two digits of the total, half a unit of which is at most 5 %.
        assert math.hypot(first, second) == pytest.approx(total, rel=0.1)
        assert expanded == pytest.approx(2.0 * total, rel=0.1)
    assert budget_table(replace(result, contributions={}), 2.0) is None


def test_a_guard_band_fails_values_near_their_limit(saved, tmp_path):
    result = calibration()
    value, sigma = abs(result.errors.vector[0]), result.sigma[0]
    limit = f"[value]\ngyro_scale_x_ppm = {1e6 * (value + 1.5 * sigma):.17g}\n"
    for rule, failed in (
        ("", ()),
        ('[decision]\nrule = "simple"\n', ()),
        ('[decision]\nrule = "guarded"\n', ("gyro_scale_x",)),
        ('[decision]\nrule = "guarded"\nguard_sigmas = 1.0\n', ()),
    ):
        given = load_acceptance_limits(written(tmp_path, limit + rule, "limits.toml"))
        made = make_certificate(saved(result), limits=given)
        assert made.failed == failed
        assert made.decision == given.decision_rule
        assert ("guarded" in made.decision) == ("guarded" in rule)
    # At two sigma, the normal distribution leaves 2.3 % beyond the limit.
    assert (
        "at most 0.023"
        in load_acceptance_limits(
            written(tmp_path, limit + '[decision]\nrule = "guarded"', "limits.toml")
        ).decision_rule
    )
    for wrong in ("rule = 'strict'", "guard_sigmas = 2.0", "rule = 'guarded'\nguard_sigmas = -1.0", "band = 1"):
        with pytest.raises(srt.InputError, match=r"\[decision\]|decision\."):
            load_acceptance_limits(written(tmp_path, f"{limit}[decision]\n{wrong}", "limits.toml"))
