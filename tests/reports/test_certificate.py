"""Certificates: they say what the calibration says, refuse what contradicts itself, and take no text for markup."""

from __future__ import annotations

import copy
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import accuracy_trials
import numpy as np
import pytest
from matplotlib.figure import Figure

import srt
from sims.physics.free_motion import free_motion, random_attitude, random_turns
from sims.physics.imu import read_out
from sims.physics.table_motion import table1_motion
from srt.comparison.merge import merge_calibrations
from srt.recording.recording import Fixture
from srt.reports.certificate import (
    html_page,
    load_acceptance_limits,
    load_calibration_file,
    make_certificate,
    pdf,
    unit_description,
)
from srt.reports.certificate.figures import certificate_figures
from srt.reports.certificate.parameter_changes import FALSE_ALARM, changes_since
from srt.reports.certificate.recording_history import check_recording, recording_history
from srt.result.calibration import Residual
from srt.sensor_errors import DISPLAY_FACTORS, INDEX, NAMES, SYMBOLS, SensorErrors

COMPONENTS = ("horizontal_x", "horizontal_y", "start_down", "end_down")
FACTORS = np.array(DISPLAY_FACTORS)


def calibration(seed=1, held=(), sequences=3, **changes):
    """A calibration as an estimator would make it, with correlated errors."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((27, 60)) / FACTORS[:, None] / 8.0
    observed = np.array([name not in held for name in NAMES])
    given = {
        "estimator": "closed-form",
        "status": "partial" if held else "converged",
        "message": "Converged after 3 iterations.",
        "errors": SensorErrors(300.0 * rng.standard_normal(27) / FACTORS),
        "covariance": np.where(np.outer(observed, observed), root @ root.T, 0.0),
        "corrections": (1e-3, 1e-6, 1e-12),
        "held": dict.fromkeys(held, "held on request"),
        "U": np.eye(3),
        "U_sigma_rad": 1e-3,
        "residuals": tuple(
            Residual(str(k + 1), 1, c, float(rng.standard_normal()), 1.0) for k in range(sequences) for c in COMPONENTS
        ),
        "site": {"latitude_deg": 45.0, "gravity_m_s2": 9.80665, "gravity_sigma_m_s2": 5e-6},
        "alignment": {
            "fixture": True,
            "heading_deg": None,
            "alignment_sigma_mrad": 1.0,
            "rotation_sigma_mrad": 1.0,
        },
        "temperature": {"mean_c": 23.25, "range_c": 1.5, "sequences": []},
        "provenance": {
            "data_sha256": f"{seed:064x}",
            "software": "strapdown-rotation-test 0.1.0",
            "serial": "SN-1",
            "date": "2026-05-04",
            "options": {"hold": []},
            "voided": {},
        },
    }
    return srt.Calibration(**(given | changes))


@pytest.fixture
def saved(tmp_path):
    """Save a calibration and read it as a certificate does."""

    def save(result, name="unit.json"):
        result.save(tmp_path / name)
        return load_calibration_file(tmp_path / name)

    return save


@pytest.fixture
def plain_page(monkeypatch):
    """Leave the pictures out, which take a hundred times as long as all else."""
    monkeypatch.setattr(html_page, "certificate_figures", lambda certificate: ())
    return html_page.html_page


class Reader(HTMLParser):
    """Tags, texts and the tables of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts, self.tables, self.values = [], [], [], []
        self.inside = False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
            self.values.append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
            self.inside = True
        elif tag == "data":
            self.values[-1].append(float(dict(attributes)["value"]))

    def handle_endtag(self, tag):
        self.inside = self.inside and tag not in ("td", "th")

    def handle_data(self, data):
        self.texts.append(data)
        if self.inside:
            self.tables[-1][-1][-1] += data.strip()

    @property
    def text(self):
        return " ".join(" ".join(self.texts).split())


# What it says


@pytest.mark.parametrize("held", [(), ("accel_bias_z", "gyro_asymmetry_x", "gyro_asymmetry_y")], ids=["all", "held"])
def test_numbers_on_the_page_are_those_of_the_file(saved, plain_page, tmp_path, held):
    source = saved(calibration(held=held))
    read = Reader(plain_page(make_certificate(source)))
    document = json.loads((tmp_path / "unit.json").read_text())
    rows = read.tables[0][1:]
    assert len(rows) == 27
    exact = read.values[1:28]
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
    assert f"{27 - len(held)} of 27 parameters were measured" in read.text


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
        site={"gravity_m_s2": 9.8},
        U=None,
    )
    said = " ".join(make_certificate(saved(bare)).limitations)
    for word in ("none", "held", "latitude"):
        assert told[word] in said
    assert "no reference" in said


@pytest.mark.parametrize(
    "hostile", ["</title><script>alert(1)</script>", "a$b$c & \"'<b>", "\u202egnp\x00\n<!--", "x" * 5000]
)
def test_texts_of_files_are_no_markup(saved, hostile):
    """In the page with its pictures: the sequence's name stands in one."""
    result = calibration(sequences=1, held=("accel_bias_z",))
    result = replace(
        result,
        provenance={
            **result.provenance,
            "serial": hostile,
            "date": hostile,
            "software": hostile,
            "voided": {hostile: hostile},
        },
        estimator=hostile,
        warnings=(hostile,),
        held={"accel_bias_z": hostile},
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


def drawn(made, name):
    figure = Figure()
    next(p for p in certificate_figures(made) if p.name == name).draw(made, figure)
    return figure


def test_correlations_are_drawn_of_what_was_measured(saved):
    result = calibration(held=("gyro_scale_y",))
    figure = drawn(make_certificate(saved(result)), "correlation")
    seen = result.observed
    sigma = result.sigma[seen]
    expected = result.covariance[np.ix_(seen, seen)] / np.outer(sigma, sigma)
    picture = figure.axes[0].collections[0].get_array()
    np.testing.assert_allclose(picture[..., 3], np.minimum(np.abs(expected), 1.0), atol=1e-12)
    red = picture[..., 0] > 0.5
    np.testing.assert_array_equal(red, expected > 0.0)


def test_residuals_are_drawn_over_their_sigma(saved):
    result = calibration(sequences=30)
    doubled = replace(result, residuals=tuple(replace(r, sigma=2.0) for r in result.residuals))
    axes = drawn(make_certificate(saved(doubled)), "residuals").axes[0]
    points = np.sort(np.concatenate([line.get_ydata() for line in axes.lines[3:]]))
    np.testing.assert_allclose(points, np.sort([0.5 * r.value for r in result.residuals]))


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
    rows = {row[1].replace(" ", "_"): row for row in Reader(plain_page(made)).tables[0][1:]}
    limited = [n for n in NAMES if n.startswith(("gyro_scale", "gyro_bias", "accel_bias"))] + ["accel_misalignment_xy"]
    for name in NAMES:
        result_cell = rows[name][5].removesuffix(" (not measured)")
        assert result_cell == ("" if name not in limited else "failed" if name in failed else "passed"), name
    assert make_certificate(saved(result), limits=limits(tmp_path, "[value]\ngyro_scale_ppm = 1e9")).outcome == "passed"


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
    rows = {row[1]: row for row in Reader(plain_page(make_certificate(source, change=change))).tables[1][1:]}
    assert rows["gyro scale x"][-2:] == ["+4.00", "changed"]
    assert rows["gyro scale y"][-2:] == ["-3.00", ""]
    assert rows["accel bias x"][-1] == "not measured in both"


def test_flags_are_family_wise(saved):
    """Of units that did not change, at most 1 % have any parameter flagged: Bonferroni's bound, so that with 27
    parameters of which many are correlated the share is at most 0.01.

    In 2000 trials 20 are expected at the most; a binomial of 0.01 exceeds 20 + 3.5 sqrt(20) = 36 with a chance
    below 5e-4. Independent errors come near the bound: fewer than 20 - 3.5 sqrt(20) = 4 would be as unlikely.
    """
    a, b = calibration(seed=1), calibration(seed=2)
    diagonal = [replace(c, covariance=np.diag(np.diag(c.covariance))) for c in (a, b)]
    change = changes_since(saved(diagonal[1], "new.json"), saved(diagonal[0], "old.json"))
    rng = np.random.default_rng(3)
    ratios = rng.standard_normal((2000, 27))
    flagged = int(np.sum(np.any(np.abs(ratios) > change.limit, axis=1)))
    assert FALSE_ALARM == 0.01
    assert 4 <= flagged <= 36


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"provenance": {"serial": "SN-2", "data_sha256": f"{2:064x}"}}, "is of the unit SN-2"),
        ({"provenance": {"serial": "SN-1", "data_sha256": f"{1:064x}"}}, "same samples"),
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
    nameless = calibration(seed=2, provenance={"data_sha256": f"{2:064x}"})
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
    sequences = [{"sequence": str(k + 1), "occurrence": 1, **judged} for k in range(3)]
    return replace(result, verdict={**judged, "sequences": sequences, "parameters": [], "weakest_combination": None})


@pytest.mark.parametrize("place", EDITS)
def test_an_edited_file_is_refused(tmp_path, place):
    document = with_verdict(calibration()).to_dict()
    *steps, last = (int(step) if step.isdecimal() else step for step in place.split("."))
    for value in EDITS[place]:
        edited = copy.deepcopy(document)
        part = edited
        for step in steps:
            part = part[step]
        part[last] = value
        (tmp_path / "x.json").write_text(json.dumps(edited))
        with pytest.raises(srt.InputError) as caught:
            load_calibration_file(tmp_path / "x.json")
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 400


def test_an_edited_covariance_is_refused(tmp_path):
    """Sigmas that agree with the diagonal, and correlations beyond one."""
    document = calibration().to_dict()
    document["covariance"][0][1] = document["covariance"][1][0] = 10.0 * document["covariance"][0][0]
    (tmp_path / "x.json").write_text(json.dumps(document))
    with pytest.raises(srt.InputError, match="covariance is none"):
        load_calibration_file(tmp_path / "x.json")


def test_a_truncated_file_is_refused_wherever_it_was_cut(tmp_path):
    text = json.dumps(calibration().to_dict())
    for share in np.linspace(0.0, 0.999, 12):
        (tmp_path / "x.json").write_text(text[: int(share * len(text))])
        with pytest.raises(srt.InputError):
            load_calibration_file(tmp_path / "x.json")
    with pytest.raises(srt.InputError, match="cannot be read"):
        load_calibration_file(tmp_path / "absent.json")
    with pytest.raises(srt.InputError, match="cannot be read"):
        load_calibration_file(tmp_path)


@pytest.mark.parametrize("status", ["not_converged", "outside_model"])
def test_nothing_is_certified_by_what_did_not_converge(saved, status):
    with pytest.raises(srt.DataError, match="nothing can be certified"):
        make_certificate(saved(calibration(status=status)))


# The recording


@pytest.fixture(scope="module")
def recordings():
    """Two tests of one unit on the table, with the noise of a navigation unit."""
    rng = np.random.default_rng(5)
    truth = accuracy_trials.normal_errors(rng, gyro_bias=1e-6)
    out = []
    for k in range(2):
        motion = table1_motion(
            site=accuracy_trials.SITE,
            sample_rate_hz=50.0,
            rate_rad_s=2.0,
            dwell_s=4.0,
            fixture_draw=accuracy_trials.fixture_errors(rng, 1e-3),
            stated_fixture=Fixture(0.0, 1e-3, 1e-3),
        )
        made = read_out(motion, truth, accuracy_trials.GRADES["navigation"], rng, serial="SN-1")
        out.append(replace(made, data_sha256=f"{k + 1:064x}"))
    return out


@pytest.fixture(scope="module")
def calibrations(recordings):
    return [srt.calibrate(recording) for recording in recordings]


def test_values_follow_from_the_recording(recordings, calibrations, saved):
    """Each value moved by five of its sigma leaves residuals that the file does not have."""
    source = saved(calibrations[0])
    check_recording(source, recordings[0], "there")
    recording_history(source, recordings[0], "there")
    for i in range(27):
        vector = calibrations[0].errors.vector.copy()
        vector[i] += 5.0 * calibrations[0].sigma[i]
        edited = saved(replace(calibrations[0], errors=SensorErrors(vector)), "edited.json")
        with pytest.raises(srt.InputError, match="do not follow from there"):
            recording_history(edited, recordings[0], "there")


def test_windows_that_moved_are_no_sign_of_an_edit(recordings, saved):
    """A window in which the unit turns a little is integrated, which the file does not tell of single windows."""
    recording = recordings[0]
    gyro = recording.gyro.copy()
    for k in (2, 5, 9):
        label = recording.sequences[k]
        part = recording.window_indices(*(label.start_static_s if k == 5 else label.end_static_s))
        middle = (part.start + part.stop) // 2
        gyro[middle : middle + 10, 2] += 5e-3  # 1 mrad in 0.2 s
    moved = replace(recording, gyro=gyro)
    result = srt.calibrate(moved, "least-squares")
    assert result.status == "converged"
    recording_history(saved(result), moved, "there")


def test_another_recording_is_refused(recordings, calibrations, saved):
    source = saved(calibrations[0])
    with pytest.raises(srt.InputError, match="holds other samples"):
        check_recording(source, recordings[1], "there")
    with pytest.raises(srt.InputError, match=r"is of the unit SN-2, but unit\.json of SN-1"):
        check_recording(source, replace(recordings[0], serial="SN-2"), "there")
    check_recording(source, replace(recordings[0], serial=None), "there")
    provenance = {**calibrations[0].provenance, "data_sha256": None}
    with pytest.raises(srt.InputError, match="does not say which samples"):
        check_recording(saved(replace(calibrations[0], provenance=provenance)), recordings[0], "there")


def test_the_course_of_the_test(recordings, calibrations, saved):
    """What is drawn: the gyros lead from the accelerometers' down at each start to that at each end.

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
    """No fixture, no heading, no labels: turned by hand, told so, and its values still follow from it."""
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
    vector = result.errors.vector.copy()
    vector[INDEX["accel_bias_x"]] += 5.0 * result.sigma[INDEX["accel_bias_x"]]
    with pytest.raises(srt.InputError, match="do not follow"):
        recording_history(saved(replace(result, errors=SensorErrors(vector)), "edited.json"), recording, "there")


def test_the_pdf_holds_any_text_and_the_same_certificate_makes_the_same_file(saved, tmp_path, monkeypatch):
    monkeypatch.setattr(pdf, "certificate_figures", lambda certificate: ())
    hostile = "<b>" + "long" * 60 + " 測試 $x$ **bold** {nb} \\ )"
    provenance = {**calibration().provenance, "serial": hostile, "date": hostile}
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
        "held": lambda: srt.calibrate(recordings[0], asymmetry=False),
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
        ({"wobble_sigma_mrad": None}, "rotation sigma 1 mrad, wobble not stated"),
    ],
)
def test_the_fixtures_wobble_is_told_where_it_is_stated(stated, said):
    given = calibration()
    text = unit_description._fixture(replace(given, alignment={**given.alignment, **stated}), merged=False)
    assert text.endswith(said)
