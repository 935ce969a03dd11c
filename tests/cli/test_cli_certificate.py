"""``srt certificate``: the files it writes, the sentence and the exit code of every outcome."""

import json
import re
import shutil
import sys

import pytest
from small_units import calibrated, simulated

import srt
import srt.reports.certificate.html_page
import srt.reports.certificate.pdf
from srt.cli import main
from srt.result.json_file import json_text
from srt.result.provenance import Provenance

pytestmark = pytest.mark.usefixtures("plain_layout")


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Make two recordings, taken for one unit's, and their calibrations."""
    folder = tmp_path_factory.mktemp("lab")
    for name, seed in (("new", 3), ("old", 4)):
        simulated(folder / name, seed=seed, dwell_s=3.0, sample_rate_hz=50.0)
        assert main(["calibrate", str(folder / name), "-o", str(folder / f"{name}.json"), "-q"]) == 0
    return folder


@pytest.fixture
def no_pictures(monkeypatch):
    """Leave out what takes long: the pictures, and the PDF with its fonts."""
    monkeypatch.setattr(srt.reports.certificate.html_page, "certificate_figures", lambda certificate: ())
    monkeypatch.setattr(srt.reports.certificate.pdf, "write_pdf", lambda certificate, path: path.write_bytes(b"%PDF"))


def edited(lab, tmp_path, name="edited.json", **changes):
    document = json.loads((lab / "new.json").read_text())
    del document["digest"]
    for key, value in changes.items():
        document["provenance" if key in ("serial", "data_sha256") else key] = (
            {**document["provenance"], key: value} if key in ("serial", "data_sha256") else value
        )
    (tmp_path / name).write_text(json_text(document))
    return tmp_path / name


def test_page_and_pdf_with_everything(lab, tmp_path, capfd):
    (tmp_path / "limits.toml").write_text("[value]\naccel_bias_ug = 1e6\n[sigma]\ngyro_scale_ppm = 1e-6\n")
    arguments = ["certificate", str(lab / "new.json"), str(lab / "new"), "-o", str(tmp_path / "out" / "deep")]
    arguments += ["--limits", str(tmp_path / "limits.toml"), "--against", str(lab / "old.json")]
    assert main(arguments) == 1
    out, err = capfd.readouterr()
    warning, failure = err.splitlines()
    assert warning.startswith("srt: warning: ")
    assert "changed significantly: " in warning
    assert "are not met by gyro_scale_x (κxx), gyro_scale_y (κyy), gyro_scale_z (κzz)." in failure
    assert "3 of 6 parameters with a limit failed" in out
    page, document = (tmp_path / "out" / "deep" / f"new-certificate.{suffix}" for suffix in ("html", "pdf"))
    assert {path.name for path in page.parent.iterdir()} == {page.name, document.name}
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") == 5
    assert "As found and as left: change since the last calibration" in text
    data = document.read_bytes()
    assert data.startswith(b"%PDF")
    assert b"/Type /Page" in data
    assert b"http:" not in data.replace(b"http://matplotlib.org", b"").replace(b"https://matplotlib.org", b"")


@pytest.mark.usefixtures("no_pictures")
def test_places(lab, tmp_path, monkeypatch, shell):
    monkeypatch.chdir(tmp_path)
    out, err = shell("certificate", lab / "new.json")
    assert shell("certificate", lab / "new.json", "-o", "x.html", "-q") == ("", "")
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{stem}.{suffix}" for stem in ("new-certificate", "x") for suffix in ("html", "pdf")
    }
    assert (tmp_path / "x.html").read_bytes() == (tmp_path / "new-certificate.html").read_bytes()
    assert out.count("Written: ") == 1
    assert err == ""


@pytest.mark.usefixtures("no_pictures")
def test_a_unit_without_a_serial_is_warned_of(tmp_path, shell):
    calibrated(provenance=Provenance(data_sha256="0" * 64, software="test")).save(tmp_path / "unit.json")
    err = shell("certificate", tmp_path / "unit.json", "-o", tmp_path / "out", "-q").err
    assert "the certificate names no unit: state serial in recording.toml" in err


@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize(
    ("place", "message"),
    [("x.pdf", "ends in .html"), ("x.json", "ends in .html"), ("file", "is a file"), ("absent/x.html", "Cannot write")],
)
def test_places_that_are_none(lab, tmp_path, monkeypatch, place, message, refused):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert message in refused("certificate", lab / "new.json", "-o", place)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize(
    ("changes", "others", "code", "message"),
    [
        ({"version": 2}, (), 2, "its version is 2"),
        ({"format": "x"}, (), 2, "no calibration file"),
        ({"status": "not_converged"}, (), 1, "nothing can be certified"),
        ({"verdict": None}, (), 2, "not a complete calibration"),
        ({}, ("old",), 2, "holds other samples"),
        ({"serial": "SN-8"}, ("new",), 2, "is of the unit SN-7"),
        ({"data_sha256": None}, ("new",), 2, "does not say which samples"),
        ({"serial": "SN-8"}, ("--against", "old.json"), 2, "of the unit SN-7"),
        ({}, ("--against", "new.json"), 2, "same samples"),
        ({}, ("--against", "old.toml"), 2, "not valid JSON"),
        ({}, ("--limits", "old.toml"), 2, "the sections are"),
        ({}, ("--limits", "absent.toml"), 2, "cannot be read"),
        ({}, ("absent",), 2, "absent"),
    ],
)
def test_input_that_is_refused(lab, tmp_path, changes, others, code, message, refused):
    path = edited(lab, tmp_path, **changes)
    more = [other if other.startswith("--") else str(lab / other) for other in others]
    assert message in refused("certificate", path, *more, "-o", tmp_path / "out", code=code)
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("no_pictures")
def test_an_edited_value_and_a_truncated_file_are_refused(lab, tmp_path, refused):
    document = json.loads((lab / "new.json").read_text())
    document["parameters"][9]["value"] *= 0.5
    path = tmp_path / "edited.json"
    for digest, message in ((document["digest"], "does not match its digest"), (None, "has no digest")):
        path.write_text(json.dumps({k: v for k, v in document.items() if k != "digest" or digest}))
        assert message in refused("certificate", path, lab / "new", "-o", tmp_path / "x.html")
    path.write_bytes((lab / "new.json").read_bytes()[:9999])
    assert "truncated" in refused("certificate", path, "-o", tmp_path / "x.html")
    assert not list(tmp_path.glob("x.*"))


@pytest.mark.usefixtures("no_pictures")
def test_a_recording_with_edited_surroundings_is_refused(lab, tmp_path, refused):
    """The samples are the same, but gravity is not: the sentence names both files and both values."""
    shutil.copytree(lab / "new", tmp_path / "new")
    toml = tmp_path / "new" / "recording.toml"
    text = re.sub(r"(?m)^gravity_m_s2 = .*$", "gravity_m_s2 = 9.81", toml.read_text())
    assert text != toml.read_text()
    toml.write_text(text)
    sentence = refused("certificate", lab / "new.json", tmp_path / "new", "-o", tmp_path / "x.html")
    assert f"{tmp_path / 'new'} states gravity_m_s2 = 9.81, but new.json was made with 9.8" in sentence


def test_nothing_is_left_of_a_certificate_that_fails(lab, tmp_path, monkeypatch, refused):
    def fail(certificate, path):
        path.write_bytes(b"%PDF half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(srt.reports.certificate.html_page, "certificate_figures", lambda certificate: ())
    monkeypatch.setattr(srt.reports.certificate.pdf, "write_pdf", fail)
    assert "No space left" in refused("certificate", lab / "new.json", "-o", tmp_path / "x.html")
    assert list(tmp_path.iterdir()) == []


def test_an_absent_jinja2_says_what_to_install(lab, tmp_path, monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    err = refused("certificate", lab / "new.json", "-o", tmp_path / "x.html")
    assert "pip install 'strapdown-rotation-test[report]'" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_pictures")
def test_an_edited_calibration_needs_trust(lab, tmp_path, shell, refused):
    """A scale factor that the sensor model allows, and a covariance that fits: the digest alone tells."""
    document = json.loads((lab / "new.json").read_text())
    document["parameters"][0]["value"] = 0.5
    (tmp_path / "edited.json").write_text(json.dumps(document))
    unit = tmp_path / "edited.json"
    lines = (["export", unit, "--to", "imucal"], ["apply", unit, "--c-header", tmp_path / "x.h"], ["certificate", unit])
    for line in lines:
        assert "changed after it was written" in refused(*line)
        if line[0] != "certificate":
            shell(*line, "--trust")
