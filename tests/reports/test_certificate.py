"""Certificates."""

import copy
import errno
import json
import os
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from certificate_cases import COMPONENTS, FACTORS, Reader, calibration
from scipy.stats import norm

import srt
from srt.reports.certificate import calibration_file, html_page, load_acceptance_limits, make_certificate, pdf
from srt.reports.certificate.calibration_file import FALSE_ALARM, changes_since
from srt.reports.certificate.figures import certificate_figures
from srt.reports.certificate.issue import write_certificate
from srt.reports.certificate.laboratory import Laboratory
from srt.result.calibration import Residual
from srt.result.consistency import Consistency, LeaveOneOut
from srt.result.json_file import json_text
from srt.result.provenance import Provenance, StatedSite
from srt.sensor_errors import DISPLAY_FACTORS, INDEX, NAMES, SYMBOLS, SensorErrors


@pytest.mark.parametrize("held", [(), ("accel_bias_z", "gyro_asymmetry_x", "gyro_asymmetry_y")], ids=["all", "held"])
def test_numbers_on_the_page_are_those_of_the_file(saved, plain_page, tmp_path, held):
    source = saved(calibration(held=held))
    read = Reader(plain_page(make_certificate(source)))
    document = json.loads((tmp_path / "unit.json").read_text())
    rows = read.table("U (k = 2)")
    assert len(rows) == 27
    exact = [numbers for numbers in read.values if numbers][:27]
    for row, numbers, stated, factor in zip(rows, exact, document["parameters"], DISPLAY_FACTORS, strict=True):
        assert row[:2] == [stated["symbol"], stated["name"].replace("_", " ")]
        assert numbers == [x for x in (stated["value"], stated["sigma"]) if x is not None]
        # Rounded to two digits of sigma at least: half a unit of the second is at most a twentieth of sigma.
        step = 0.005 if stated["sigma"] is None else 0.051 * stated["sigma"] * factor
        assert float(row[2]) == pytest.approx(stated["value"] * factor, abs=step)
        if stated["observed"]:
            assert float(row[3]) == pytest.approx(stated["sigma"] * factor, abs=step)
        else:
            assert row[3] == "fixed"
            assert SYMBOLS[INDEX[stated["name"]]] in read.text.split("Fixed, not measured")[1]
    for word in ("SN-1", "2026-05-04", "45°", "23.2 °C", "range 1.5 °C", f"{1:064x}", "test 0.1.0", source.sha256):
        assert word in read.text
    assert f"{27 - len(held)} of 27 parameters were estimated" in read.text


def test_matrices_to_apply_are_those_of_the_reading_model(saved, plain_page):
    result = calibration()
    read = Reader(plain_page(make_certificate(saved(result))))
    rows = [row for row in read.values if len(row) == 5]
    gyro, accel = np.array(rows).reshape(2, 3, 5)
    rng = np.random.default_rng(2)
    true = rng.standard_normal((2, 3))
    # y = M v + s |v| + b, from the page's numbers, must be undone by the library.
    readings = [m[:, :3] @ v + m[:, 3] * np.abs(v) + m[:, 4] for m, v in zip((gyro, accel), true, strict=True)]
    np.testing.assert_allclose(result.apply(*readings), true, rtol=0.0, atol=1e-13)


def test_residuals_are_summed_by_sequence(saved, plain_page):
    result = calibration()
    read = Reader(plain_page(make_certificate(saved(result))))
    table = next(t for t in read.tables if t[0][0] == "sequence")
    for row, k in zip(table[1:], range(3), strict=True):
        own = np.array([r.value for r in result.residuals[4 * k : 4 * k + 4]])
        assert row[:3] == [str(k + 1), "4", "4"]
        assert float(row[3]) == pytest.approx(np.sqrt(np.mean(own**2)), abs=0.0051)
        assert float(row[4]) == pytest.approx(own[np.argmax(np.abs(own))], abs=0.0051)
        assert row[5] == COMPONENTS[np.argmax(np.abs(own))].replace("_", " ")


def test_limitations_follow_the_test(saved):
    told = {
        "temperature": "23.2 °C",
        "none": "not recorded",
        "held": "3 parameters were not measured",
        "latitude": "Earth rate",
    }
    whole = " ".join(make_certificate(saved(calibration())).limitations)
    assert told["temperature"] in whole
    assert "1 g" in whole
    assert told["held"] not in whole
    assert told["latitude"] not in whole
    bare = calibration(
        held=[n for n in NAMES if n.startswith("accel_asymmetry")],
        temperature=None,
        site=StatedSite(gravity_m_s2=9.8),
        U=None,
    )
    said = " ".join(make_certificate(saved(bare)).limitations)
    for word in ("none", "held", "latitude"):
        assert told[word] in said
    assert "no reference" in said


def test_a_full_disk_leaves_neither_page_nor_pdf(tmp_path, monkeypatch):
    calls = []

    def fsync(number):
        calls.append(number)
        if len(calls) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(html_page, "html_page", lambda _: "<p>")
    monkeypatch.setattr(pdf, "write_pdf", lambda _, path: path.write_bytes(b"%PDF"))
    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(srt.InputError, match="No space left"):
        write_certificate(None, tmp_path / "unit.html")
    assert list(tmp_path.iterdir()) == []


def test_the_residual_table_tells_redundant_from_dof(saved):
    note = make_certificate(saved(with_verdict(calibration()))).residuals.note
    assert "Redundant counts the residuals that are not zero, dof the combinations" in note


def test_a_sigma_that_nobody_stated_is_called_assumed(saved):
    lab = Laboratory(references={"gravity": "report G-17"})
    for origin, shown in ((None, "0.0029 m/s²"), ("assumed", "0.0029 m/s² (assumed)")):
        site = StatedSite(gravity_m_s2=9.81, gravity_sigma_m_s2=0.01 / 12**0.5, gravity_sigma_origin=origin)
        made = make_certificate(saved(calibration(site=site)), laboratory=lab)
        stated_there = "report G-17" + (" (the value; its uncertainty is assumed, not stated)" if origin else "")
        assert [cell.text for cell in made.references.rows[0][2:]] == [shown, stated_there]
        assert ("gravity 9.81 ± 0.0029 m/s² (assumed)" in str(made.description)) == (origin is not None)


@pytest.mark.parametrize(
    "hostile",
    [
        "</title><script>alert(1)</script>",
        '"; } body { display: none } /* \\',
        "a$b$c & \"'<b>",
        "\u202egnp\x00\n<!--",
        "x" * 5000,
    ],
)
def test_texts_of_files_are_no_markup(saved, hostile):
    """Text of files is escaped in the page and in its pictures, one of which shows the sequence's name."""
    result = calibration(sequences=1, held=("accel_bias_z",))
    result = replace(
        result,
        provenance=replace(
            result.provenance, serial=hostile, date=hostile, software=hostile, voided={hostile: hostile}
        ),
        estimator=hostile,
        warnings=(hostile,),
        fixed={"accel_bias_z": hostile},
        residuals=(Residual(hostile, 1, hostile, 1.0, 1.0),),
        corrections=(),
    )
    made = make_certificate(saved(result))
    drawn = [p for p in certificate_figures(made) if p.name == "residuals"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(html_page, "certificate_figures", lambda certificate: drawn)
        text = html_page.html_page(made)
    tags = {tag for tag, _ in Reader(text).tags}
    assert not tags & {"script", "b"}
    assert "<script" not in text
    assert not re.search("[\x00\u202e]", text)
    assert all(not key.startswith("on") for _, attributes in Reader(text).tags for key in attributes)
    assert max(map(len, made.unit.split("\n"))) <= 200
    # The foot of a printed page names the unit: a string of the style sheet without a character that could end it.
    foot = re.search(r'@bottom-left \{ content: "((?:[^\W_]|\\[0-9a-f]+ )*)";', text)
    assert re.sub(r"\\([0-9a-f]+) ", lambda c: chr(int(c[1], 16)), foot[1]) == made.title


def test_the_page_asks_for_nothing(saved):
    made = make_certificate(saved(calibration(sequences=2)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            html_page,
            "certificate_figures",
            lambda certificate: [p for p in certificate_figures(certificate) if p.name != "parameters"],
        )
        text = html_page.html_page(made)
        assert text == html_page.html_page(made)
    read = Reader(text)
    assert not {tag for tag, _ in read.tags} & {"script", "link", "iframe", "object", "embed"}
    for tag, attributes in read.tags:
        for key in ("src", "href", "xlink:href"):
            assert attributes.get(key, "#").startswith(("#", "data:image/png;base64,")), (tag, attributes)
    assert not re.search(r"@import|url\((?!#)", text)
    identifiers = [attributes["id"] for _, attributes in read.tags if "id" in attributes]
    assert len(identifiers) == len(set(identifiers)) > 0
    for svg in re.findall(r"<svg.*?</svg>", text, re.DOTALL):
        # As XML on its own: the prefix of links is the one thing that HTML knows without being told.
        root = ElementTree.fromstring(svg.replace("<svg ", '<svg xmlns:xlink="http://www.w3.org/1999/xlink" ', 1))  # noqa: S314 - of our own making
        assert root.get("viewBox")
        assert not re.search(r"#000000|#222222", svg)


# Pictures


def test_pictures_without_anything_in_them_are_left_out(saved):
    bare = calibration(held=NAMES[1:], residuals=(), corrections=(0.0,))
    assert [p.name for p in certificate_figures(make_certificate(saved(bare)))] == ["parameters"]


# Limits


def limits(tmp_path, text):
    (tmp_path / "limits.toml").write_text(text)
    return load_acceptance_limits(tmp_path / "limits.toml")


def test_limits_are_met_or_not(saved, tmp_path, plain_page):
    result = calibration(held=("gyro_bias_z",))
    value = result.errors.vector * FACTORS
    sigma = result.sigma * FACTORS
    given = limits(
        tmp_path,
        f"""
        [value]
        gyro_scale_ppm = {1.01 * np.abs(value[:3]).max()}
        gyro_scale_x_ppm = {0.99 * abs(value[0])}
        gyro_bias_deg_per_h = 1e9
        [sigma]
        accel_bias_ug = {0.99 * sigma[INDEX["accel_bias_y"]]}
        accel_misalignment_xy_urad = {1.01 * sigma[INDEX["accel_misalignment_xy"]]}
        """,
    )
    made = make_certificate(saved(result), limits=given)
    failed = {"gyro_scale_x", "gyro_bias_z"}
    failed |= {n for n in NAMES if n.startswith("accel_bias") and sigma[INDEX[n]] > 0.99 * sigma[INDEX["accel_bias_y"]]}
    assert set(made.failed) == failed
    assert made.outcome == "failed"
    rows = {row[1].replace(" ", "_"): row for row in Reader(plain_page(made)).table("U (k = 2)")}
    limited = [n for n in NAMES if n.startswith(("gyro_scale", "gyro_bias", "accel_bias"))] + ["accel_misalignment_xy"]
    for name in NAMES:
        result_cell = rows[name][6].removesuffix(" (not measured)")
        assert result_cell == ("" if name not in limited else "failed" if name in failed else "passed"), name
    assert make_certificate(saved(result), limits=limits(tmp_path, "[value]\ngyro_scale_ppm = 1e9")).outcome == "passed"


def test_no_limit_is_passed_by_a_doubtful_calibration(saved, tmp_path, plain_page):
    """chi-square 379 for 44 degrees of freedom: sigmas were too small by 2.9 before they were enlarged."""
    result = calibration()
    evidence = replace(result.consistency, chi_square=379.0, degrees_of_freedom=44, probability=5e-55)
    wide = limits(tmp_path, "[value]\ngyro_scale_ppm = 1e9")
    made = make_certificate(saved(replace(result, consistency=evidence)), limits=wide)
    assert (made.outcome, made.failed) == ("doubtful", ())
    page = plain_page(made)
    assert {row[6] for row in Reader(page).table("U (k = 2)")} == {"doubtful", ""}
    assert "Passed" not in page


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "limit nothing"),
        ("[value]\n", "limit nothing"),
        ("x = [", "not valid TOML"),
        ("[values]\na = 1", r"did you mean value\?"),
        ("value = 3", r"write \[value\]"),
        ("[value]\ngyro_scale = 3.0", "write gyro_scale_ppm"),
        ("[value]\ngyro_scale_x_ug = 3.0", "write gyro_scale_x_ppm"),
        ("[sigma]\ngyro_bias_ppm = 3.0", "write gyro_bias_deg_per_h"),
        ("[sigma]\ngyro_scal_ppm = 3.0", r"did you mean gyro_scale_ppm\?"),
        ("[sigma]\ngyro_scale_ppm = -3.0", "positive"),
        ("[sigma]\ngyro_scale_ppm = nan", "positive"),
        ("[sigma]\ngyro_scale_ppm = inf", "positive"),
        ("[sigma]\ngyro_scale_ppm = true", "positive"),
        ("[sigma]\ngyro_scale_ppm = '3'", "positive"),
    ],
)
def test_limits_that_are_none(tmp_path, text, message):
    with pytest.raises(srt.InputError, match=message):
        limits(tmp_path, text)


# Since the last calibration


def test_change_is_over_the_combined_sigma(saved, plain_page):
    old = calibration(seed=1, held=("accel_bias_x",))
    new = replace(calibration(seed=2), errors=old.errors)
    shifted = new.errors.vector.copy()
    shifted[0] += 4.0 * np.hypot(new.sigma[0], old.sigma[0])
    shifted[1] -= 3.0 * np.hypot(new.sigma[1], old.sigma[1])
    new = replace(new, errors=SensorErrors(shifted))
    source, before = saved(new, "new.json"), saved(old, "old.json")
    change = changes_since(source, before)
    expected = np.zeros(27)
    expected[:2] = 4.0, -3.0
    expected[INDEX["accel_bias_x"]] = np.nan
    np.testing.assert_allclose(change.ratio, expected, atol=1e-9)
    assert change.names == ("gyro_scale_x",)
    # Bonferroni's bound: at most 1 % of unchanged units have any of the 26 parameters flagged, two-sided.
    assert FALSE_ALARM == 0.01
    assert change.limit == pytest.approx(norm.isf(0.01 / (2 * 26)), rel=1e-9)
    rows = {row[1]: row for row in Reader(plain_page(make_certificate(source, change=change))).table("change / sigma")}
    assert rows["gyro scale x"][-2:] == ["+4.00", "changed"]
    assert rows["gyro scale y"][-2:] == ["-3.00", ""]
    assert rows["accel bias x"][-1] == "not measured in both"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"provenance": Provenance(serial="SN-2", data_sha256=f"{2:064x}")}, "is of the unit SN-2"),
        ({"provenance": Provenance(serial="SN-1", data_sha256=f"{1:064x}")}, "same samples"),
        ({"status": "not_converged"}, "status not_converged"),
    ],
)
def test_an_earlier_calibration_that_is_none(saved, changes, message):
    new = saved(calibration(seed=1), "new.json")
    old = saved(calibration(seed=2, **changes), "old.json")
    with pytest.raises(srt.InputError, match=message):
        changes_since(new, old)


def test_a_serial_that_is_not_stated_is_said(saved):
    new = saved(calibration(seed=1), "new.json")
    nameless = calibration(seed=2, provenance=Provenance(data_sha256=f"{2:064x}"))
    made = make_certificate(new, change=changes_since(new, saved(nameless, "old.json")))
    assert any("one unit is assumed" in note for note in made.change_notes)
    assert not any(
        "one unit is assumed" in n
        for n in make_certificate(new, change=changes_since(new, saved(calibration(seed=3), "old.json"))).change_notes
    )


# Files that were edited or cut


EDITS = {
    "parameters.0.unit": ["ppm", None, 3],
    "parameters.3.symbol": ["κxx"],
    "parameters.0.value": ["1", None, float("nan"), 1e400, 10**400, True, -3.0],
    "parameters.0.sigma": [0.0, None, "x", 1.0],
    "parameters.0.observed": [False, 1],
    "covariance.0.0": [-1.0, 1.0, None, 10**400],
    "frame.U": [[[1.0]], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], "x"],
    "frame.U_sigma": [-1.0, "x"],
    "status": ["certified", "partial "],
    "version": [0, 2, "1"],
    "format": ["srt-truth"],
    "site": [None, [], "x"],
    "site.latitude_deg": ["45", 10**400],
    "temperature": ["20", {"mean_c": 20.0}],
    "residuals.0.value": [None, "x", 1e400],
    "residuals.0.sigma": [-1.0],
    "residuals.0.component": [None],
    "provenance": [None, []],
    "provenance.serial": [3, ["a"]],
    "provenance.date": [3],
    "provenance.data_sha256": ["abc", 3],
    "provenance.options": ["x"],
    "verdict": [None, [], {"chi_square": 1.0}],
    "verdict.probability": [-1.0, "x"],
    "verdict.sequences": [None, [{}], [3]],
    "verdict.parameters": [
        [{"name": "x", "sigma": 1.0}],
        [{"name": [], "sigma": 1.0}],
        [{"name": "gyro_scale_x", "sigma": 1.0}],
    ],
    "iterations": [None, [{}], [{"max_correction": None}]],
    "warnings": [None, [3]],
    "estimator": [None, 3],
}


def with_verdict(result):
    judged = {"chi_square": 2.0, "degrees_of_freedom": 2, "probability": 0.4}
    shown = {"checkable": "yes", "only_witness_of": (), "lost_without": (), "largest_influence": None, "influence": {}}
    sequences = tuple(LeaveOneOut(sequence=str(k + 1), occurrence=1, **judged, **shown) for k in range(3))
    return replace(result, consistency=Consistency(**judged, sequences=sequences))


@pytest.mark.parametrize("place", EDITS)
def test_an_edited_file_is_refused(tmp_path, place):
    document = json.loads(json_text(with_verdict(calibration()).to_dict()))
    *steps, last = (int(step) if step.isdecimal() else step for step in place.split("."))
    for value in EDITS[place]:
        edited = copy.deepcopy(document)
        part = edited
        for step in steps:
            part = part[step]
        part[last] = value
        (tmp_path / "x.json").write_text(json.dumps(edited))
        with pytest.raises(srt.InputError) as caught:
            calibration_file(tmp_path / "x.json")
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 400


def test_a_file_without_a_digest_is_refused(tmp_path):
    """Nothing tells whether its values are those that were written."""
    (tmp_path / "x.json").write_text(json.dumps(calibration().to_dict()))
    srt.load_calibration(tmp_path / "x.json")
    with pytest.raises(srt.InputError, match="has no digest"):
        calibration_file(tmp_path / "x.json")


def test_a_truncated_file_is_refused_wherever_it_was_cut(tmp_path):
    text = json_text(calibration().to_dict())
    for share in np.linspace(0.0, 0.999, 12):
        (tmp_path / "x.json").write_text(text[: int(share * len(text))])
        with pytest.raises(srt.InputError):
            calibration_file(tmp_path / "x.json")
    with pytest.raises(srt.InputError, match="cannot be read"):
        calibration_file(tmp_path / "absent.json")
    with pytest.raises(srt.InputError, match="cannot be read"):
        calibration_file(tmp_path)


@pytest.mark.parametrize("status", ["not_converged", "outside_model"])
def test_nothing_is_certified_by_what_did_not_converge(saved, status):
    with pytest.raises(srt.DataError, match="nothing can be certified"):
        make_certificate(saved(calibration(status=status)))
