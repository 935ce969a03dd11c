"""Certificates of laboratories and of their recordings."""

import math
from dataclasses import replace

import accuracy_trials
import numpy as np
import pytest
from certificate_cases import Reader, calibration, drawn
from small_units import on_fixture

import srt
from sims.physics.free_motion import free_motion, random_attitude, random_turns
from sims.physics.imu import read_out
from srt.comparison.merge import merge_calibrations
from srt.reports.certificate import html_page, load_acceptance_limits, make_certificate, pdf, unit_description
from srt.reports.certificate.calibration_file import changes_since
from srt.reports.certificate.content import budget_table, coverage_probability
from srt.reports.certificate.figures import certificate_figures
from srt.reports.certificate.laboratory import NOT_STATED, load_laboratory
from srt.reports.certificate.recording_history import check_recording, recording_history
from srt.sensor_errors import DISPLAY_FACTORS, GROUP_SLICES

# The recording


@pytest.fixture(scope="module")
def recordings():
    """Two tests of one unit on the table, with the noise of a navigation unit."""
    rng = np.random.default_rng(5)
    truth = accuracy_trials.normal_errors(rng, gyro_bias=1e-6)
    out = []
    for k in range(2):
        motion = on_fixture(rng, rate_rad_s=2.0, dwell_s=4.0)
        made = read_out(motion, truth, accuracy_trials.GRADES["navigation"], rng, serial="SN-1")
        out.append(replace(made, data_sha256=f"{k + 1:064x}"))
    return out


@pytest.fixture(scope="module")
def calibrations(recordings):
    return [srt.calibrate(recording) for recording in recordings]


def test_another_recording_is_refused(recordings, calibrations, saved):
    source = saved(calibrations[0])
    with pytest.raises(srt.InputError, match="holds other samples"):
        check_recording(source, recordings[1], "there")
    with pytest.raises(srt.InputError, match=r"is of the unit SN-2, but unit\.json of SN-1"):
        check_recording(source, replace(recordings[0], serial="SN-2"), "there")
    site = replace(recordings[0].site, latitude_rad=0.8)
    with pytest.raises(srt.InputError, match=r"there states latitude_deg = 45\.8\d+, but unit\.json"):
        check_recording(source, replace(recordings[0], site=site), "there")
    check_recording(source, replace(recordings[0], serial=None), "there")
    provenance = replace(calibrations[0].provenance, data_sha256=None)
    with pytest.raises(srt.InputError, match="does not say which samples"):
        check_recording(saved(replace(calibrations[0], provenance=provenance)), recordings[0], "there")


def test_the_course_of_the_test(recordings, calibrations, saved):
    """The drawn attitude leads from the accelerometers' down at each start to that at each end.

    Between them: angle random walk of 0.002 °/√h and pulses, 4 µrad; the Earth in a sequence's 25 s, 2 mrad;
    and the table, which is level to 1 mrad or else not at all at rest. 10 mrad hold all of it.
    """
    source = saved(calibrations[0])
    course = recording_history(source, recordings[0], "there")
    for ends in np.flatnonzero(np.isnan(course.down[:, 0])):
        at = np.argmin(np.abs(course.rest.mean(axis=1) - course.time[ends - 1]))
        assert np.linalg.norm(course.down[ends - 1] - course.rest_down[at]) < 1e-2
    # Specific force at rest is gravity, to what the sigmas of scale, bias and asymmetry leave of it: microgravities.
    assert np.max(np.abs(course.excess)) < 1e-4 * 9.80665
    assert course.turned_deg_s == pytest.approx(np.degrees(2.0), rel=0.01)
    assert course.count == recordings[0].time.size
    figure = drawn(make_certificate(source, course=course), "test")
    marks = figure.axes[2].lines[1].get_ydata()
    np.testing.assert_allclose(marks, course.excess / 9.80665e-6)


def test_a_merged_calibration(recordings, calibrations, saved, plain_page):
    """It belongs to each of its recordings, names them all, and is no earlier calibration of one of them."""
    merged = saved(merge_calibrations(calibrations), "merged.json")
    for recording in recordings:
        check_recording(merged, recording, "there")
    course = recording_history(merged, recordings[1], "there")
    read = Reader(plain_page(make_certificate(merged, course=course)))
    rows = next(t for t in read.tables if "SHA-256 of the samples" in t[0])[1:]
    assert [row[3] for row in rows] == [recording.data_sha256 for recording in recordings]
    assert "contains no residuals" in read.text
    with pytest.raises(srt.InputError, match="same samples"):
        changes_since(merged, saved(calibrations[0]))


def test_a_unit_that_did_not_change(recordings, calibrations, saved):
    """One fixed pair of tests; by the bound on false alarms, one pair in a hundred would fail."""
    change = changes_since(saved(calibrations[1], "new.json"), saved(calibrations[0], "old.json"))
    assert change.names == ()


def test_a_free_recording(saved, plain_page):
    """No fixture, no heading, no labels: turned by hand, and told so."""
    rng = np.random.default_rng(11)
    turns = random_turns(rng, 24, smallest_rad=1.0, largest_rad=3.0)
    motion = free_motion(
        turns, attitude=random_attitude(rng), site=accuracy_trials.SITE, sample_rate_hz=50.0, dwell_s=3.0
    )
    made = read_out(motion, accuracy_trials.normal_errors(rng, 3e-3, 1e-5), accuracy_trials.GRADES["tactical"], rng)
    recording = replace(made, data_sha256="1" * 64)
    result = srt.calibrate(recording)
    assert result.estimator == "least-squares"
    source = saved(result)
    check_recording(source, recording, "there")
    read = Reader(plain_page(make_certificate(source, course=recording_history(source, recording, "there"))))
    assert "none (turned freely)" in read.text
    assert "no reference" in read.text
    assert "no serial" in read.text


def test_tables_of_many_columns_fit_the_page(saved, monkeypatch):
    """Sources beyond those of a plain test; a column as narrow as nothing took forever to set."""
    monkeypatch.setattr(pdf, "certificate_figures", lambda certificate: ())
    result = calibration()
    sources = {f"accelerometer drift {'form ' * k}{k}": result.sigma / 5.0 for k in range(25)}
    made = make_certificate(saved(replace(result, contributions=sources)))
    document = pdf._Document("x")
    _, widths = document._fitted(made.budget)
    assert len(widths) == 29
    assert sum(widths) == pytest.approx(document.epw)
    assert min(widths) > 3.0  # two digits of the smallest letters
    pdf._write(made, document)
    assert document.output()


def test_the_pdf_holds_any_text_and_the_same_certificate_makes_the_same_file(saved, tmp_path, monkeypatch):
    monkeypatch.setattr(pdf, "certificate_figures", lambda certificate: ())
    hostile = "<b>" + "long" * 60 + " 測試 $x$ **bold** {nb} \\ )"
    provenance = replace(calibration().provenance, serial=hostile, date=hostile)
    made = make_certificate(saved(calibration(provenance=provenance, warnings=(hostile,))))
    for name in ("x.pdf", "y.pdf"):
        pdf.write_pdf(made, tmp_path / name)
    written = (tmp_path / "x.pdf").read_bytes()
    assert written.startswith(b"%PDF")
    assert written.rstrip().endswith(b"%%EOF")
    assert written == (tmp_path / "y.pdf").read_bytes()
    other = make_certificate(saved(calibration(seed=8)))
    pdf.write_pdf(other, tmp_path / "y.pdf")
    assert written != (tmp_path / "y.pdf").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["closed-form", "merged", "held", "least-squares"])
def test_both_forms_of_every_kind(recordings, calibrations, saved, tmp_path, kind):
    result = {
        "closed-form": lambda: calibrations[0],
        "merged": lambda: merge_calibrations(calibrations),
        "held": lambda: srt.calibrate(recordings[0], asymmetry=False, start=calibrations[0].errors),
        "least-squares": lambda: srt.calibrate(recordings[0], "least-squares"),
    }[kind]()
    source = saved(result)
    made = make_certificate(source, course=recording_history(source, recordings[0], "there"))
    text = html_page.html_page(made)
    assert text.count("<svg") == len(certificate_figures(made))
    pdf.write_pdf(made, tmp_path / "x.pdf")
    assert (tmp_path / "x.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({}, "rotation sigma 1 mrad"),
        ({"wobble_sigma_mrad": 0.02}, "rotation sigma 1 mrad, wobble 0.02 mrad"),
        # Of merged recordings that state different ones.
        ({"nulls": ("wobble_sigma_mrad",)}, "rotation sigma 1 mrad, wobble not stated"),
    ],
)
def test_the_fixtures_wobble_is_told_where_it_is_stated(stated, said):
    given = calibration()
    text = unit_description._fixture(replace(given, alignment=replace(given.alignment, **stated)), merged=False)
    assert text.endswith(said)


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
