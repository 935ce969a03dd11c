"""``srt compare``: tables, files, and the exit code of every outcome."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from g_sensitive import with_g_sensitivity

import srt
import srt.comparison.estimator_comparison
import srt.estimation.registry
from srt.cli.calibrate import calibrate
from srt.cli.compare import SHARED_OPTIONS, compare
from srt.constants import MICRO_G
from srt.recording.writing import write_recording
from srt.result.consistency import AddedNoise
from srt.result.diagnostics import Drift
from srt.sensor_errors import DISPLAY_FACTORS, INDEX, NAMES

pytestmark = pytest.mark.usefixtures("blank_figures")

BOTH = ("--estimator", "closed-form", "--estimator", "least-squares")


@pytest.fixture(scope="session")
def calibrations(recording, calibration):
    return {"closed-form": calibration, "least-squares": srt.calibrate(srt.load_recording(recording), "least-squares")}


@pytest.fixture
def results(monkeypatch):
    """Let estimators return, or raise, what a test says; those not named are not installed."""

    def install(**values):
        by_name = {name.replace("_", "-"): value for name, value in values.items()}

        def find(name):
            def estimate(recording, options, progress=None):
                if isinstance(by_name[name], Exception):
                    raise by_name[name]
                return by_name[name]

            if name not in by_name:
                raise srt.MissingExtraError("some-package", "all", f"The estimator {name!r}")
            return estimate

        for module in (srt.estimation.registry, srt.comparison.estimator_comparison):
            monkeypatch.setattr(module, "find_estimator", find)

    return install


def rows_of(out):
    """Give the rows of the table of parameters by name."""
    rows = [line.split() for line in out.splitlines()]
    return {cells[0]: cells for cells in reversed(rows) if cells and cells[0] in NAMES}


def test_table_holds_estimates_and_differences_as_the_library_finds_them(recording, calibrations, shell):
    out, err = shell("compare", recording, *BOTH, "--details")
    expected = srt.comparison.estimator_comparison.compare(calibrations).differences["closed-form"]
    rows = rows_of(out)
    assert list(rows) == list(reversed(NAMES))
    for name, (_, _, *estimates, normalised) in rows.items():
        i = INDEX[name]
        for text, calibration in zip(estimates, calibrations.values(), strict=True):
            value, sigma = map(float, text.split("±"))
            exact = calibration.sigma[i] * DISPLAY_FACTORS[i]
            assert sigma == pytest.approx(exact, rel=0.06)  # two digits
            assert value == pytest.approx(calibration.errors[name] * DISPLAY_FACTORS[i], abs=0.06 * exact)
        assert float(normalised) == pytest.approx(expected.normalised[i], abs=0.051)
    assert "SN-7" in out
    assert re.search(r"least-squares +converged +sound +\d+\.\d\d +1\.00 +- +\d+ +27 .* reference", out)
    assert re.search(r"closed-form +converged .* agrees", out)
    assert "least-squares and closed-form agree: largest difference" in out
    assert err == ""


def test_the_verdict_comes_first_and_the_tables_fit_a_terminal(recording, calibrations, shell):
    assert shell("compare", recording, *BOTH, "--truth", recording / "truth.json", "-q").out == ""
    lines = shell("compare", recording, *BOTH, "--truth", recording / "truth.json").out.splitlines()
    assert lines[2].startswith("least-squares and closed-form agree")
    assert max(map(len, lines[1:])) <= 80  # the first has the path
    # The reference with its sigma, and the difference of the other.
    assert all(len(cells) == 4 for cells in rows_of("\n".join(lines).split("Errors over sigma")[0]).values())


def test_truth_adds_errors_over_sigma(recording, calibrations, shell):
    truth = recording / "truth.json"
    table = shell("compare", recording, *BOTH, "--truth", truth).out.split("Errors over sigma")[1]
    true = json.loads(truth.read_text())["parameters"]
    for name, (_, _, _, *ratios) in rows_of(table).items():
        for text, calibration in zip(ratios, calibrations.values(), strict=True):
            error = calibration.errors[name] - true[name]
            assert float(text) == pytest.approx(error / calibration.sigma[INDEX[name]], abs=0.006)


def test_files(recording, calibrations, tmp_path, shell):
    result, figure = tmp_path / "result.json", tmp_path / "figure.svg"
    truth = str(recording / "truth.json")
    arguments = [*BOTH, "--reference", "closed-form", "-o", str(result), "--plot", str(figure), "--truth", truth]
    out, err = shell("compare", recording / "recording.toml", *arguments)
    document = json.loads(result.read_text(encoding="utf-8"))
    assert (document["agree"], document["reference"]) == (True, "closed-form")
    for estimate in document["estimators"]:
        expected = calibrations[estimate["name"]]
        assert estimate["value"] == expected.errors.vector.tolist()
        assert estimate["seconds"] > 0.0
        assert np.isfinite(estimate["error_over_sigma"]).all()
    assert document["provenance"]["serial"] == "SN-7"
    assert figure.read_bytes().startswith(b"<?xml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["figure.svg", "result.json"]
    assert f"Written: {result}, {figure}" in out
    # The closed form is not efficient: a note, but no reason to fail.
    assert "closed-form is not efficient for them" in err


def test_options_reach_the_estimators(recording, tmp_path, shell):
    chosen = {"average": "overlapping", "start": "zero", "max_playbacks": 9}
    flags = [text for name, value in chosen.items() for text in (f"--{name.replace('_', '-')}", str(value))]
    flags += ["--no-asymmetry", "--hold", "accel_bias"]
    shell("compare", recording, "-q", "-o", tmp_path / "x.json", *BOTH, *flags, code=1)
    document = json.loads((tmp_path / "x.json").read_text())
    kept = document["provenance"]["options"]
    assert chosen.items() <= kept.items()
    assert kept["asymmetry"] is False
    assert kept["hold"] == ["accel_bias_x", "accel_bias_y", "accel_bias_z"]
    assert document["estimators"][0]["observed"] == 21


def test_shared_options_are_those_of_calibrate():
    there = {p.name: p for p in calibrate.params}
    here = {p.name: p for p in compare.params}
    assert all(here[name] is there[name] for name in SHARED_OPTIONS)


def test_quiet_says_nothing_of_what_is_well(recording, shell):
    assert shell("compare", recording, "-q", *BOTH) == ("", "")


def test_those_left_out_are_named_with_what_to_install(recording, calibrations, results, tmp_path, shell):
    results(**{name.replace("-", "_"): c for name, c in calibrations.items()})
    out, err = shell("compare", recording, "-o", tmp_path / "x.json")
    for name in ("ekf", "graph"):
        sentence = f"{name} is left out: The estimator {name!r} needs the package 'some-package'"
        assert sentence in " ".join(out.split())
        assert sentence in err
    assert [e["name"] for e in json.loads((tmp_path / "x.json").read_text())["left_out"]] == ["ekf", "graph"]


def test_disagreement_is_1_and_written_all_the_same(recording, calibrations, results, tmp_path, shell):
    best = calibrations["least-squares"]
    delta = np.zeros(27)
    delta[INDEX["accel_scale_z"]] = 20.0 * best.sigma[INDEX["accel_scale_z"]]
    results(closed_form=replace(calibrations["closed-form"], errors=best.errors.plus(delta)), least_squares=best)
    path, figure = tmp_path / "x.json", tmp_path / "x.png"
    out, err = shell("compare", recording, *BOTH, "-o", path, "--plot", figure, code=1)
    assert json.loads(path.read_text())["agree"] is False
    assert figure.exists()
    assert rows_of(out)["accel_scale_z"][-1].endswith("*")
    assert "differs" in out
    assert "closed-form differs from least-squares: accel_scale_z by" in err
    assert err.count("\n") == 1


def test_a_drift_that_the_closed_form_does_not_model_makes_verdicts_differ_and_is_named(recording, tmp_path, shell):
    loaded = srt.load_recording(recording)
    ramp = 20.0 * MICRO_G * np.linspace(-0.5, 0.5, len(loaded.time))[:, None]
    write_recording(replace(loaded, accel=loaded.accel + ramp, data_sha256=None), tmp_path / "unit-7")
    out, err = shell("compare", tmp_path / "unit-7", *BOTH, "-o", tmp_path / "x.json", code=1)
    reason = (
        "closed-form is doubtful, least-squares sound: least-squares models a bias drift of the accelerometers "
        "(linear), closed-form does not."
    )
    assert f"srt: {tmp_path / 'unit-7'}: {reason}\n" in err
    assert reason in " ".join(out.split())
    document = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))
    assert (document["agree"], document["verdicts_differ"]) == (True, reason)
    assert "least-squares and closed-form agree" in document["verdict"]


FORCE = {"force_m_s2": AddedNoise(added=1e-4, own=1e-4), "rate_rad_s": AddedNoise(added=0.0, own=1e-6)}
LINEAR, FOUND = (
    {"drift": (Drift(sensor="gyro", form="linear", change_rad_s=np.ones(3), modelled=modelled),)}
    for modelled in (True, False)
)
G_SENSITIVE = {"g_sensitivity": with_g_sensitivity(np.zeros((3, 3))).g_sensitivity}


@pytest.mark.parametrize(
    ("of_closed_form", "of_others", "added", "sentence"),
    [
        (
            *({}, {}, {"added_noise": FORCE}),
            "least-squares, ekf and graph are doubtful, closed-form sound: least-squares, ekf and graph model added "
            "noise of the specific forces, closed-form does not.",
        ),
        (
            *(FOUND, LINEAR, {}),
            "closed-form is doubtful, the others sound: least-squares, ekf and graph model a bias drift of the gyros "
            "(linear), closed-form does not.",
        ),
        (
            *(G_SENSITIVE, {}, {}),
            "closed-form is doubtful, the others sound: closed-form models the g-sensitivity of the gyros, "
            "least-squares, ekf and graph do not.",
        ),
        (
            *({"unused_moves": 16}, {}, {}),
            "closed-form is doubtful, the others sound: closed-form does not use the 16 recorded moves.",
        ),
        ({}, {}, {}, "closed-form is doubtful, the others sound, though all model the same effects."),
    ],
)
def test_different_verdicts_are_1_and_what_only_some_of_the_estimators_model_is_named(
    recording, calibrations, results, of_closed_form, of_others, added, sentence, shell
):
    closed, best = calibrations["closed-form"], calibrations["least-squares"]
    others = replace(
        best,
        diagnostics=replace(best.diagnostics, **of_others),
        consistency=replace(best.consistency, **added, sigma_factor=(1.0, 2.0)),
    )
    inflated = replace(closed.noise, sigma_inflation=1.0 if added else 2.0)
    results(
        closed_form=replace(closed, diagnostics=replace(closed.diagnostics, **of_closed_form), noise=inflated),
        **dict.fromkeys(("least_squares", "ekf", "graph"), others),
    )
    assert f"srt: {recording}: {sentence}\n" in shell("compare", recording, "-q", code=1).err


def test_a_failed_estimator_stops_none_and_is_1(recording, calibrations, results, tmp_path, shell):
    results(ekf=srt.DataError("It cannot be."), **{n.replace("-", "_"): c for n, c in calibrations.items()})
    path = tmp_path / "x.json"
    out, err = shell("compare", recording, *BOTH, "--estimator", "ekf", "--reference", "ekf", "-o", path, code=1)
    assert re.search(r"ekf +failed .* no result", out)
    assert "ekf failed: It cannot be." in out
    assert "least-squares and closed-form agree" in out
    assert f"srt: {recording}: ekf failed: It cannot be.\n" in err
    assert "gave no usable result; it is least-squares instead" in err
    assert json.loads(path.read_text())["failed"] == [{"name": "ekf", "message": "It cannot be."}]


def test_no_convergence_is_1(recording, tmp_path, shell):
    path, figure = tmp_path / "x.json", tmp_path / "x.png"
    arguments = [*BOTH, "--max-playbacks", "1", "-o", str(path), "--plot", str(figure)]
    out, err = shell("compare", recording, *arguments, code=1)
    assert "no estimator gave a usable result" in " ".join(out.split())
    assert "no estimator gave a usable result" in err
    assert json.loads(path.read_text())["reference"] is None
    # Nothing is drawn, and nothing is said to be.
    assert not figure.exists()
    assert str(figure) not in out


def test_a_recording_for_fewer_than_two_is_1(recording, calibrations, results, tmp_path, refused):
    free = tmp_path / "free"
    shutil.copytree(recording, free)
    text = (free / "recording.toml").read_text().split("[[sequence]]")[0]
    (free / "recording.toml").write_text(re.sub(r"\[fixture\][^\[]*", "", text))
    results(**{name.replace("-", "_"): c for name, c in calibrations.items()})
    sentence = refused("compare", free, "-q", code=1)
    assert "Fewer than two estimators can run" in sentence
    assert "closed-form is left out: The closed form needs labelled sequences of Table 1" in sentence


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        (["--estimator", "magic", "--estimator", "least-squares"], ["no estimator 'magic'", "closed-form"]),
        (["--estimator", "closed-form"], ["two estimators", "closed-form"]),
        (["--estimator", "closed-form", "--estimator", "closed-form"], ["two estimators"]),
        ([*BOTH, "--reference", "graph"], ["'graph' is not among", "closed-form, least-squares"]),
        (["--reference", "magic"], ["'magic' is not among", "ekf, graph"]),
        (["-o", "x.txt"], ["x.txt", ".json"]),
        (["-o", "absent/x.json"], ["absent/x.json", "No such file"]),
        (["--plot", "x.gif"], ["x.gif", ".png"]),
        (["--hold", "gyro_scal"], ["gyro_scal", "gyro_scale"]),
        ([*BOTH, "--truth", "absent.json"], ["absent.json", "No such file"]),
    ],
)
def test_wrong_usage_is_one_sentence_and_2_before_the_work(
    recording, arguments, fragments, tmp_path, monkeypatch, refused
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("srt.recording.folder.load_recording", lambda path: pytest.fail(f"{path} was read first"))
    err = refused("compare", recording, *arguments)
    for fragment in fragments:
        assert fragment in err
    assert list(tmp_path.iterdir()) == []


def test_a_reference_that_cannot_run_here_is_2(recording, calibrations, results, refused):
    results(**{name.replace("-", "_"): c for name, c in calibrations.items()})
    err = refused("compare", recording, "--reference", "graph")
    assert "The reference graph cannot run here: The estimator 'graph' needs" in err


@pytest.mark.parametrize(
    ("spoil", "fragment"),
    [
        (lambda d: d.update(windows=(np.array(d["windows"]) + 1.0).tolist()), "not that of this recording"),
        (lambda d: d["scenario"]["recording"].update(serial="SN-8"), "not that of this recording"),
        (lambda d: d.update(windows=3), "as simulate"),
    ],
)
def test_the_truth_of_another_recording_is_refused(recording, tmp_path, spoil, fragment, refused):
    document = json.loads((recording / "truth.json").read_text())
    spoil(document)
    (tmp_path / "truth.json").write_text(json.dumps(document))
    err = refused("compare", recording, *BOTH, "--truth", tmp_path / "truth.json")
    assert fragment in err


def test_the_truth_of_another_unit_of_the_same_schedule_is_suspected(recording, tmp_path, refused):
    document = json.loads((recording / "truth.json").read_text())
    document["parameters"] = {name: -value for name, value in document["parameters"].items()}
    (tmp_path / "truth.json").write_text(json.dumps(document))
    err = refused("compare", recording, "-q", *BOTH, "--truth", tmp_path / "truth.json", code=0)
    assert "is it the truth of another recording?" in err
