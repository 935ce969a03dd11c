"""``srt calibrate``: tables, files, several recordings, and the exit code of every status."""

import json
import re
import shutil
import sys
import tomllib
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from foreign_fixture import write
from foreign_motion import GRADES, drawn_errors, hand_turns, windows
from foreign_motion import recording as foreign_recording
from scipy.stats import norm

import srt
import srt.estimation.registry
from srt.cli import main
from srt.constants import DEG_PER_SQRT_H, MICRO_G
from srt.reports.text.calibration import report
from srt.reports.text.calibration_summary import calibration_summary
from srt.sensor_errors import NAMES, SYMBOLS

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.fixture
def result(monkeypatch):
    """Let the estimator return what a test says."""

    def install(value):
        def estimate(recording, options, progress=None):
            if isinstance(value, Exception):
                raise value
            return value

        monkeypatch.setattr(srt.estimation.registry, "find_estimator", lambda name: estimate)

    return install


def rows_of(out):
    """Give the rows of the table of parameters by name."""
    return {cells[1]: cells for cells in map(str.split, out.splitlines()) if len(cells) > 1 and cells[1] in NAMES}


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares", "ekf"])
def test_progress_report_and_result_count_the_same_iterations(recording, tmp_path, shell, estimator):
    """Too small a stated noise makes the iteration resume with the noise that the residuals show."""
    shutil.copytree(recording, tmp_path / "unit-7")
    toml = tmp_path / "unit-7" / "recording.toml"
    toml.write_text(re.sub(r"(accel_noise_ug_per_sqrt_hz) = .*", r"\1 = 0.5", toml.read_text()))
    shown = []
    result = srt.calibrate(srt.read(tmp_path / "unit-7"), estimator, progress=lambda *step: shown.append(step))
    assert shown == list(enumerate(result.corrections, 1))
    assert result.message.startswith(f"Converged after {len(shown)} iterations.")
    grown = [n for n, (before, after) in enumerate(pairwise(result.corrections), 2) if after > before]
    assert (result.diagnostics.refits or ()) == tuple(grown)
    assert estimator == "closed-form" or grown
    text = " ".join(report(result, title="").split())
    sentence = f"They grow in iteration {', '.join(map(str, grown))}, the first with another model."
    assert (sentence in text) == bool(grown)


def test_iterations_from_the_start_with_another_model_are_counted_on(recording):
    """Without some sequences, what they alone determine is fixed, and the rest is estimated anew."""
    loaded, shown = srt.read(recording), []
    part = loaded.with_sequences(loaded.sequences[:9])
    found = srt.calibrate(part, "least-squares", ignore_moves=True, progress=lambda *step: shown.append(step))
    assert shown == list(enumerate(found.corrections, 1))
    assert f"Converged after {len(shown)} iterations" in found.message
    assert found.diagnostics.refits


def test_table_holds_every_parameter_as_the_library_finds_it(recording, calibration, shell):
    out, err = shell("calibrate", recording, "--details")
    rows = rows_of(out)
    assert list(rows) == list(NAMES)
    assert [row[0] for row in rows.values()] == list(SYMBOLS)
    factors = dict(zip(NAMES, srt.sensor_errors.DISPLAY_FACTORS, strict=True))
    for i, (name, (_, _, value, sigma, unit)) in enumerate(rows.items()):
        assert unit == srt.sensor_errors.DISPLAY_UNITS[i]
        exact = calibration.sigma[i] * factors[name]
        assert float(sigma) == pytest.approx(exact, rel=0.06)  # two digits
        assert float(value) == pytest.approx(calibration.errors[name] * factors[name], abs=0.06 * exact)
    assert "closed-form" in out
    assert "SN-7" in out
    assert "Converged after" in out
    assert "Residuals over sigma: rms" in out
    assert "-o FILE.json" in out
    assert err == ""  # no list of iterations where nothing moves


def test_summary_has_status_and_verdict_first_and_at_most_45_lines(recording, shell):
    lines = shell("calibrate", recording).out.splitlines()
    assert len(lines) <= 45
    first = lines.index("")
    assert first <= 10
    head = " ".join(" ".join(lines[:first]).split())
    assert re.match(
        r".*unit-7 \(serial SN-7\): closed-form, 27 of 27 measured Time base taken as exact: "
        r"1 ppm of clock is 1 ppm of every gyro scale factor\. Converged after \d+ iterations\. Verdict: Sound\. The ",
        head,
    )
    assert list(rows_of("\n".join(lines))) == list(NAMES)
    assert "--details" in lines[-1]
    assert "chi2" not in "\n".join(lines)


def test_summary_says_what_to_do(calibration):
    found = replace(
        calibration,
        warnings=("The residuals are larger than the noise explains. " * 8, "Another one. " * 20),
        noise=replace(calibration.noise, estimated=("gyro_noise", "gyro_quantization")),
    )
    lines = calibration_summary(found, title="x", source="unit-7", truth=calibration.errors).splitlines()
    assert len(lines) + 3 <= 45  # the command adds three: an empty line, files written, and the hint at --details
    assert list(rows_of("\n".join(lines))) == list(NAMES)
    assert lines.index("") <= 10
    head = " ".join(" ".join(lines[: lines.index("")]).split())
    assert "# To do: add this below [imu] of recording.toml, with values of the data sheet gyro_noise_deg_per" in head
    assert "'srt inspect unit-7 --deep'" in head
    assert max(map(len, lines)) <= 80
    moved = replace(calibration, diagnostics=replace(calibration.diagnostics, unused_moves=16))
    head = " ".join(calibration_summary(moved, title="x").split("\n\n")[0].split())
    assert "To do: 16 recorded moves are not used by the closed form: '--estimator least-squares' uses them." in head
    gained = replace(moved, diagnostics=replace(moved.diagnostics, sigma_with_moves=(0.36, 0.604)))
    head = " ".join(calibration_summary(gained, title="x").split("\n\n")[0].split())
    assert "closed form: '--estimator least-squares' gives 0.36-0.60 of these sigmas." in head
    failed = replace(calibration, status="not_converged", message="It is not done.")
    head = calibration_summary(failed, title="x", source="unit-7").split("\n\n")[0]
    assert "Status not converged: It is not done." in head
    assert "srt inspect unit-7 --deep" in head


def test_the_noise_to_state_can_be_pasted_with_the_estimates_as_comments(recording, tmp_path, shell):
    shutil.copytree(recording, tmp_path / "unit-7")
    toml = tmp_path / "unit-7" / "recording.toml"
    stated = tomllib.loads(toml.read_text())["imu"]
    bare = re.sub(r"\n\[imu\]\n(.+\n)+", "\n", toml.read_text())
    toml.write_text(bare)
    out = shell("calibrate", tmp_path / "unit-7").out
    assert len(out.splitlines()) <= 45
    block = re.search(r"^\[imu\].*\n(?:\w+ = .*\n){4}", out, re.M)[0]
    noise = srt.calibrate(srt.read(tmp_path / "unit-7")).noise
    found = {
        "gyro_noise_deg_per_sqrt_h": noise.gyro_noise_rad_per_sqrt_s / DEG_PER_SQRT_H,
        "accel_bias_instability_ug": noise.accel_bias_wander_m_s2 / MICRO_G,
    }
    for key, estimate in re.findall(r"^(\w+) = +# .*: (\S+)$", block, re.M):
        if key in found:
            assert float(estimate) == pytest.approx(found[key].max(), rel=0.05)  # two digits
        block = block.replace(f"{key} = ", f"{key} = {stated[key]} ")
    toml.write_text(f"{bare}\n{block}")
    assert tomllib.loads(block)["imu"].items() <= stated.items()
    assert "To do: add" not in shell("calibrate", tmp_path / "unit-7").out
    toml.write_text(bare.replace("[site]", "[imu]\ngyro_quantization_arcsec = 0.0\n\n[site]"))
    out = shell("calibrate", tmp_path / "unit-7").out
    assert "# To do: add this below [imu] of recording.toml, with values of the data sheet\n" in out


@pytest.mark.parametrize(
    "more", [[], ["--details"], ["--budget"], ["--hold", "gyro_bias_z"], ["--estimator", "least-squares"], ["--truth"]]
)
def test_report_fits_80_columns_without_escape_codes(recording, more, shell):
    more = [*more, str(recording / "truth.json")] if more == ["--truth"] else more
    out = shell("calibrate", recording, *more).out
    assert "\x1b" not in out
    # Paths are not broken: a line that holds one may be longer.
    assert max(len(line) for line in out.splitlines() if str(recording) not in line) <= 80


def test_contributions_are_the_largest_of_the_library(recording, calibration, shell):
    out = shell("calibrate", recording, "--details").out
    line = next(line for line in out.split("Largest sources of sigma")[1].splitlines() if line.startswith(" κxx "))
    sizes = sorted((float(v[0]) * 1e6 for v in calibration.contributions.values()), reverse=True)
    shown = [float(number) for number in re.findall(r"\d\.\d+", line)]
    assert shown == pytest.approx(sizes[: len(shown)], abs=0.006)


def test_budget_adds_up_to_sigma(recording, shell):
    table = shell("calibrate", recording, "--budget").out.split("Sources of sigma")[1].split("Residuals")[0]
    row = next(line.split() for line in table.splitlines() if line.startswith(" κxx "))
    sigma, *sizes = map(float, row[2:])
    assert len(sizes) >= 6
    assert np.hypot.reduce(sizes) == pytest.approx(sigma, abs=0.01)


def test_truth_adds_error_and_error_over_sigma(recording, calibration, shell):
    truth = json.loads((recording / "truth.json").read_text())["parameters"]
    for name, row in rows_of(shell("calibrate", recording, "--truth", recording / "truth.json").out).items():
        error, ratio = map(float, row[-2:])
        i = NAMES.index(name)
        expected = (calibration.errors[name] - truth[name]) / calibration.sigma[i]
        assert ratio == pytest.approx(expected, abs=0.006)
        assert error * ratio >= 0.0


def test_result_file_is_the_librarys(recording, calibration, tmp_path, shell):
    path = tmp_path / "result.json"
    out, _ = shell("calibrate", recording, "-o", path, "--plot", tmp_path / "x.svg")
    # The command looks for faults too, and found none.
    expected = replace(calibration, diagnostics=replace(calibration.diagnostics, faults=())).to_dict()
    assert srt.load_calibration(path).to_dict() == expected
    assert sorted(p.name for p in tmp_path.iterdir()) == ["result.json", "x.svg"]
    assert str(path) in out


def test_options_reach_the_estimator(recording, tmp_path, shell):
    path = tmp_path / "result.json"
    chosen = {
        "average": "overlapping",
        "down": "paper",
        "window_attitude": "integrated",
        "gyro_bias": "pooled",
        "step": "coefficients",
        "start": "zero",
        "max_playbacks": 9,
    }
    flags = [text for name, value in chosen.items() for text in (f"--{name.replace('_', '-')}", str(value))]
    flags += ["--no-asymmetry", "--hold", "accel_bias", "--hold", "gyro_scale_x"]
    # This unit has asymmetries, and the residuals of a calibration without contradict it.
    shell("calibrate", recording, "-q", "-o", path, *flags, code=1)
    assert srt.load_calibration(path).status == "inconsistent"
    kept = srt.load_calibration(path).provenance.options
    assert chosen.items() <= kept.items()
    assert kept["asymmetry"] is False
    assert kept["hold"] == ["gyro_scale_x", "accel_bias_x", "accel_bias_y", "accel_bias_z"]


def test_held_parameters_are_marked_with_the_reason(recording, shell):
    out, err = shell("calibrate", recording, "--hold", "accel_bias_y")
    assert rows_of(out)["accel_bias_y"][3] == "fixed"
    assert "accel_bias_y: fixed on request" in out
    assert "Status partial" in out
    assert err.splitlines()[-1].startswith("srt: warning: ")
    assert err.splitlines()[-1].endswith("fixed, not observed: accel_bias_y: fixed on request.")


@pytest.mark.parametrize("status", ["not_converged", "outside_model"])
def test_no_convergence_is_1_and_the_file_says_so(recording, calibration, result, tmp_path, status, shell):
    result(replace(calibration, status=status, message="It is not done."))
    path = tmp_path / "result.json"
    out, err = shell("calibrate", recording, "-o", path, code=1)
    assert srt.load_calibration(path).status == status
    assert f"Status {status.replace('_', ' ')}: It is not done." in out
    assert err == f"srt: {recording}: It is not done; {path} holds it with that status.\n"


def test_several_recordings_are_kept_apart_and_a_failed_one_stops_none(recording, tmp_path, shell):
    for name in ("a", "b", "c"):
        shutil.copytree(recording, tmp_path / name)
    (tmp_path / "b" / "samples.npz").write_bytes(b"no samples")
    paths = [str(tmp_path / name) for name in ("a", "b", "c")]
    output = tmp_path / "results"
    figure = tmp_path / "plot.png"
    out, err = shell("calibrate", *paths, "-o", output, "--plot", figure, code=2)
    assert sorted(p.name for p in output.iterdir()) == ["a.json", "c.json"]
    assert sorted(p.name for p in tmp_path.glob("*.png")) == ["plot-a.png", "plot-c.png"]
    failures = [line for line in err.splitlines() if line.startswith("srt: ")]
    assert len(failures) == 1
    assert paths[1] in failures[0]
    assert out.count("Converged after") == 2


def test_the_worst_code_wins_and_the_recording_is_named(recording, result, tmp_path, shell):
    shutil.copytree(recording, tmp_path / "a")
    result(srt.DataError("It cannot be."))
    err = shell("calibrate", tmp_path / "a", tmp_path / "absent", code=2).err.splitlines()
    assert err[0] == f"srt: {tmp_path / 'a'}: It cannot be."
    assert err[1].startswith(f"srt: There is no recording {tmp_path / 'absent'}")
    shell("calibrate", tmp_path / "a", recording, code=1)


def test_the_title_of_the_picture_has_verdict_serial_and_date(
    recording, calibration, result, tmp_path, monkeypatch, shell
):
    drawn = []
    monkeypatch.setattr("srt.reports.figures.calibration.save_figure", lambda figure, _: drawn.append(figure))
    result(replace(calibration, provenance=replace(calibration.provenance, date="2026-05-04"), consistency=None))
    shell("calibrate", recording, "--plot", tmp_path / "x.png")
    (title,) = [text.get_text() for text in drawn[0].subfigs[0].texts]
    assert title == "unit-7, serial SN-7, 2026-05-04: doubtful, closed-form"


def test_two_recordings_of_one_name_would_replace_each_other(recording, tmp_path, refused):
    assert "Two recordings are named unit-7" in refused("calibrate", recording, recording, "-o", tmp_path)


def test_a_recording_is_named_once(recording, refused):
    assert "unit-7 is named twice" in refused("calibrate", recording, recording)


def test_a_folder_takes_the_result_under_the_recordings_name(recording, tmp_path, shell):
    shell("calibrate", recording / "recording.toml", "-q", "-o", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["unit-7.json"]


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        ("{", "not valid JSON"),
        ("[]", "no truth of version 1"),
        ('{"format": "srt-truth", "version": 2}', "no truth of version 1"),
        ('{"format": "srt-truth", "version": 1, "parameters": {"gyro_scale_x": 0}}', "27 sensor errors"),
        (json.dumps({"format": "srt-truth", "version": 1, "parameters": dict.fromkeys(NAMES, "1")}), "no number"),
        (json.dumps({"format": "srt-truth", "version": 1, "parameters": dict.fromkeys(NAMES, float("nan"))}), "finite"),
    ],
)
def test_a_wrong_truth_is_refused_first(tmp_path, text, fragment, shell):
    (tmp_path / "truth.json").write_text(text)
    err = shell("calibrate", "absent", "--truth", tmp_path / "truth.json", code=2).err
    assert fragment in err
    assert err.count("\n") == 1


def test_an_estimator_of_others_is_found_by_its_name(recording, calibration, monkeypatch, shell):
    from importlib.metadata import EntryPoint

    class Module:
        @staticmethod
        def estimate(recording, options, progress=None):
            return replace(calibration, estimator="theirs", contributions={}, residuals=())

    monkeypatch.setitem(sys.modules, "their_module", Module)
    entry = EntryPoint("theirs", "their_module:estimate", "srt.estimators")
    monkeypatch.setattr(srt.estimation.registry, "entry_points", lambda group: [entry])
    out = shell("calibrate", recording, "--estimator", "theirs").out
    assert "theirs" in out
    assert "Largest sources of sigma" not in out


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("import no_such_package_of_theirs", "cannot be loaded (ModuleNotFoundError: No module named 'no_such"),
        ("raise RuntimeError('no licence')", "cannot be loaded (RuntimeError: no licence): repair or uninstall"),
        ("other = 1", "cannot be loaded (AttributeError"),
        ("def estimate(recording): ...", "cannot be called with a recording, options and progress"),
        ("estimate = 3", "cannot be called with a recording, options and progress"),
        ("def estimate(recording, options, progress): return 3", "gave an object of type int, but a Calibration"),
    ],
)
def test_a_defective_estimator_of_others_is_one_sentence(recording, monkeypatch, tmp_path, source, sentence, shell):
    from importlib.metadata import EntryPoint

    (tmp_path / "their_defect.py").write_text(source + "\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "their_defect", raising=False)
    entry = EntryPoint("theirs", "their_defect:estimate", "srt.estimators")
    monkeypatch.setattr(srt.estimation.registry, "entry_points", lambda group: [entry])
    srt.estimators()
    err = shell("calibrate", recording, "--estimator", "theirs", code=2).err
    assert sentence in err
    assert "pip install" not in err
    assert err.count("\n") == 1


def test_progress_on_a_terminal_is_one_moving_line_and_plain_without_rich(recording, monkeypatch, shell):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")  # a narrower terminal takes two lines
    assert shell("calibrate", recording).err.count("\n") <= 1
    monkeypatch.setitem(sys.modules, "rich.console", None)
    assert shell("calibrate", recording).err == ""
    monkeypatch.setattr("srt.cli.progress._LINE_EVERY_S", -1.0)  # an iteration takes longer
    assert "iteration 1, largest correction" in shell("calibrate", recording).err


@pytest.mark.parametrize("word", ["doubtful", "failed"])
def test_a_verdict_is_printed_once(recording, calibration, result, tmp_path, monkeypatch, shell, word):
    """A redirected report leaves the terminal without it; the standard error then says it."""
    bad = replace(calibration, status="inconsistent", message="Sequence 4 contradicts the others.")
    if word == "doubtful":
        bad = replace(calibration, consistency=None)
    result(bad)
    code = int(word == "failed")
    reason = bad.message if word == "failed" else bad.judgement.reason
    redirected = shell("calibrate", recording, code=code)
    assert (redirected.out.count(reason), redirected.err.count(reason[:-1])) == (1, 1)
    quiet = shell("calibrate", recording, "-q", code=code)
    assert (quiet.out, quiet.err.count(reason[:-1])) == ("", 1)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    seen = shell("calibrate", recording, code=code)
    assert (seen.out.count(reason), seen.err) == (1, "")


def turned_by_hand(folder):
    """A unit turned by hand, one turn of which the gyros read 1.1° too far; and its errors (foreign generator).

    Its noise is stated in the labelled recording, and found in the other one.
    """
    rng = np.random.default_rng((20261207, 0))
    errors = drawn_errors(GRADES["tactical"], rng)
    turns = hand_turns(rng, shortest_s=1.0)
    unit = foreign_recording(turns, 5.0, errors, GRADES["tactical"], rng, hz=50.0)
    rests = windows(turns, 5.0)
    a, b = rests[7][1], rests[8][0]
    during = (unit.time > a + 0.3 * (b - a)) & (unit.time < a + 0.6 * (b - a))
    gyro = unit.gyro.copy()
    gyro[during, 0] += 0.02 / (during.sum() * unit.nominal_interval_s)
    inner = [[round(start + 0.05, 3), round(end - 0.05, 3)] for start, end in rests]
    labels = [{"start_static_s": before, "end_static_s": after} for before, after in pairwise(inner)]
    samples = {"time": unit.time, "gyro": gyro, "accel": unit.accel}
    write(folder / "free", samples, {})
    figures = {"gyro_noise_deg_per_sqrt_h": 0.05, "gyro_bias_instability_deg_per_h": 0.01}
    figures |= {"accel_noise_ug_per_sqrt_hz": 50.0, "accel_bias_instability_ug": 1.0}
    write(folder / "labelled", samples, {"imu": figures}, labels)
    return np.array([errors.get(name, 0.0) for name in NAMES])


@pytest.mark.slow
def test_advice_on_a_turn_that_contradicts_is_a_command_that_works(tmp_path, capfd, shell):
    errors = turned_by_hand(tmp_path)
    file = tmp_path / "without.json"
    for name in ("labelled", "free"):
        # A turn shares its windows with the next one, which may be named first.
        advised = []
        while main(["calibrate", str(tmp_path / name), "-q", "-o", str(file), *advised]) == 1 and len(advised) < 6:
            err = capfd.readouterr().err
            advised += re.search("'(--without-turn .*?)'", err)[1].split()
        assert {"7", "8"} >= set(advised[1::2])
        assert "8" in advised[1::2]
        found = srt.load_calibration(file)
        assert found.judgement.word == "sound"
        assert list(found.provenance.voided.values()) == ["left out on request"] * (len(advised) // 2)
        # Of 27 normal errors, one in a thousand has one beyond 4.2 sigma.
        assert np.nanmax(np.abs((found.errors.vector - errors) / found.sigma)[found.observed]) <= 4.2
    advised = re.search("'(--estimator .*?)'", err)[1].split()
    pytest.importorskip("gtsam")
    file = tmp_path / "unit.json"
    shell("calibrate", tmp_path / "free", "-q", "-o", file, *advised)
    found = srt.load_calibration(file)
    seen = found.observed
    # 27 errors of one unit: the largest of them, family-wise 1 %.
    limit = norm.ppf(1.0 - 0.005 / seen.sum())
    assert np.all(np.abs(found.errors.vector - errors)[seen] < limit * found.sigma[seen])
