"""Gyro g-sensitivity: the regression, its effect in rotations, its sigmas, and the test where it is not estimated."""

import importlib.util
import json
import math
from dataclasses import replace

import accuracy_trials
import numpy as np
import pytest
from g_sensitivity import BIAS_DEG_PER_S
from ideal_table_1 import player_of
from scipy.stats import binom, chi2

import sims
import srt
from sims.accuracy.budget import G_SENSITIVITY
from sims.physics.imu import ImuModel, read_out
from sims.scenarios.simulation import draw_errors
from srt import exporters
from srt.constants import DEG, DEG_PER_H, DEG_PER_SQRT_H, EARTH_RATE_RAD_S, MICRO_G, STANDARD_GRAVITY_M_S2
from srt.estimation import g_sensitivity_report
from srt.estimation.iterations import CONVERGED_CORRECTION
from srt.estimation.options import Options
from srt.estimation.srt_measurements import SrtProcessor
from srt.model.measurement_model import attitude_to_horizontal
from srt.recording.recording import Fixture, Site
from srt.reports.certificate.calibration_file import calibration_file
from srt.reports.certificate.content import make_certificate
from srt.reports.certificate.html_page import html_page
from srt.reports.certificate.recording_history import recording_history
from srt.result.calibration import FORMULA
from srt.result.diagnostics import Diagnostics
from srt.sensor_errors import GROUP_SLICES, NAMES, SensorErrors
from srt.sequences.preparation import prepare

PER_G = DEG_PER_H / STANDARD_GRAVITY_M_S2
GAMMA = np.array([[30.0, -12.0, 25.0], [8.0, -35.0, 14.0], [-20.0, 28.0, 17.0]]) * PER_G
SITE = Site(9.80665, latitude_rad=0.8)
IN_G = np.ones(27)
IN_G[GROUP_SLICES["accel_bias"]] = STANDARD_GRAVITY_M_S2
WHITE = ImuModel(gyro_noise=0.15 * DEG_PER_SQRT_H, accel_noise=102.0 * MICRO_G)
PLAN = """
seed = 3
[imu]
from = "consumer-mems"
[fixture]
from = "lab-1mrad"
[site]
from = "latitude-45"
[schedule]
dwell_s = 2.0
[recording]
sample_rate_hz = 50.0
"""
MEMS = {f"gyro_bias_{a}": BIAS_DEG_PER_S * DEG for a in "xyz"}


def motion_of(*, fixture=0.0, earth_rate=True, sequences=tuple(sims.TABLE_1), dwell_s=2.0, rate_hz=50.0):
    rng = np.random.default_rng(11)
    return accuracy_trials.table1_motion(
        site=SITE if earth_rate else Site(SITE.gravity_m_s2),
        sample_rate_hz=rate_hz,
        dwell_s=dwell_s,
        sequences=sequences,
        earth_rate=earth_rate,
        fixture_draw=accuracy_trials.fixture_errors(rng, fixture) if fixture else None,
        stated_fixture=Fixture(0.0, fixture, fixture) if fixture else Fixture(0.0, 1e-6, 1e-6),
    )


def unit(seed=1, size=1e-3):
    """Errors of a thousandth, or another part, and half a degree a second of bias."""
    sizes = {g: size for g in GROUP_SLICES if g not in ("accel_bias", "gyro_bias")} | {"accel_bias": 10.0 * size}
    return draw_errors(np.random.default_rng(seed), sizes, values=MEMS)


def played(recording, matrix=None, errors=None, **options):
    data, processor = player_of(recording, gyro_bias="g-sensitive", **options)
    return data, processor.process(errors or SensorErrors(), g_sensitivity=matrix, with_noise=True)


# --- what it does in the turns -----------------------------------------------------------------------------------


@pytest.mark.parametrize("window_attitude", ["held", "integrated"])
def test_effect_on_all_17_sequences_is_that_of_the_integral(window_attitude):
    """A g-sensitive unit without other errors, processed without g-sensitivity and without the Earth's rate.

    φ is then ∫ F Ĉ Γ f dt up to its square, |Γ| g T: as much again in the horizontal components and in â.
    """
    motion = motion_of(earth_rate=False)
    data, found = played(
        read_out(motion, SensorErrors(), ImuModel(gyro_g_sensitivity=GAMMA)), window_attitude=window_attitude
    )
    phi = np.einsum("kabc,bc->ka", found.integrals.velocity, GAMMA)
    expected = np.einsum("kia,ka->ki", attitude_to_horizontal(found.basis, found.acceleration), phi)
    z = found.z[: 2 * data.K].reshape(-1, 2)
    turned = np.linalg.norm(GAMMA, 2) * SITE.gravity_m_s2 * found.integrals.weight_s
    assert np.all(np.abs(z - expected) <= SITE.gravity_m_s2 * turned[:, None] ** 2)
    assert np.abs(z).max() > 10.0 * SITE.gravity_m_s2 * turned.max() ** 2
    assert len({*data.ids}) == 17


def test_taken_off_nothing_is_left():
    """Residual errors of a g-insensitive unit, too: the simulator samples f over the same intervals."""
    motion = motion_of(earth_rate=False)
    _, clean = played(read_out(motion, SensorErrors()))
    _, found = played(read_out(motion, SensorErrors(), ImuModel(gyro_g_sensitivity=GAMMA)), GAMMA)
    # Rounding: of n additions in the attitude, and of rates of 1 rad/s in the windows' means.
    np.testing.assert_allclose(found.z, clean.z, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.rest_rate, 0.0, rtol=0, atol=1e-15)


# --- without noise ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("estimator", "options"),
    [
        ("closed-form", {}),
        ("closed-form", {"kind": "increment"}),
        ("closed-form", {"window_attitude": "integrated"}),
        ("closed-form", {"step": "coefficients"}),
        ("closed-form", {"size": 0.1}),
    ],
    ids=str,
)
def test_noise_free_g_sensitivity_is_removed_entirely(estimator, options):
    """The parameters are those of the unit without g-sensitivity, on a faultless fixture.

    Γ g is renewed until it moves by less than the limit of convergence, a rate that acts for a sequence's time; of the
    parameters a tenth of that and more, accelerometers by g.
    """
    chosen = dict(options)
    truth, kind = unit(size=chosen.pop("size", 1e-3)), chosen.pop("kind", "rate")
    motion = motion_of()
    plain = srt.calibrate(read_out(motion, truth, kind=kind), estimator, **chosen, checks=False)
    recording = read_out(motion, truth, ImuModel(gyro_g_sensitivity=GAMMA), kind=kind)
    found = srt.calibrate(recording, estimator, gyro_bias="g-sensitive", **chosen, checks=False)
    assert found.status == plain.status == "converged"
    longest = max(s.end_static_s[1] - s.start_static_s[0] for s in recording.sequences)
    limit = CONVERGED_CORRECTION * longest
    assert np.abs((found.errors.vector - plain.errors.vector) / IN_G)[:24].max() < limit
    matrix = np.array(found.diagnostics.g_sensitivity.matrix)
    assert np.abs(matrix - GAMMA).max() * SITE.gravity_m_s2 < limit
    wrong = srt.calibrate(recording, estimator, gyro_bias="pooled", **chosen, checks=False)
    assert np.abs((wrong.errors.vector - truth.vector) / IN_G)[:24].max() > 1e3 * limit


def test_fixture_errors_leave_a_part_of_the_earth_rate():
    """Poses wrong by α misplace the Earth's rate by ω_e α, which Γ takes for its own.

    α: 3.5 sigmas of the five angles of a fixture. An element of Γ g is a weighted mean of what the poses' rates are
    wrong by, with weights of both signs whose absolute values add up to at most 2.
    """
    truth, sigma = unit(), 1e-3
    recording = read_out(motion_of(fixture=sigma), truth, ImuModel(gyro_g_sensitivity=GAMMA))
    found = srt.calibrate(recording, "closed-form", gyro_bias="g-sensitive", checks=False)
    matrix = np.array(found.diagnostics.g_sensitivity.matrix)
    left = np.abs(matrix - GAMMA).max() * SITE.gravity_m_s2
    assert left < 2.0 * EARTH_RATE_RAD_S * 3.5 * sigma * math.sqrt(5.0)
    stated = np.array(found.diagnostics.g_sensitivity.sigma)
    assert left > 0.0
    assert np.all(stated * SITE.gravity_m_s2 < 2.0 * EARTH_RATE_RAD_S * sigma * math.sqrt(5.0))


# --- with noise ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [12, pytest.param(60, marks=pytest.mark.campaign)])
def test_units_are_within_their_sigmas(n):
    """MEMS units of 0.5 °/s and 30 °/h/g, each with errors, Γ and noise of its own, on one 1 mrad fixture.

    A standard deviation from n draws has a standard error of 1 / √(2n), a mean of chi-squares with 9 degrees of freedom
    over 9 one of √(2 / 9n). Neither gravity nor north is drawn, which count for nothing beside this noise.
    """
    motion = motion_of(fixture=1e-3)
    rng = np.random.default_rng(2024)
    errors, variances, nees = [], np.zeros(27), 0.0
    for _ in range(n):
        truth = draw_errors(rng, dict.fromkeys(GROUP_SLICES, 1e-3), values=MEMS)
        matrix = rng.standard_normal((3, 3)) * 30.0 * PER_G
        recording = read_out(motion, truth, replace(WHITE, gyro_g_sensitivity=matrix), rng)
        found = srt.calibrate(recording, "closed-form", gyro_bias="g-sensitive", checks=False)
        errors.append(found.errors.vector - truth.vector)
        variances += found.sigma**2 / n
        stated = found.diagnostics.g_sensitivity
        error = (np.array(stated.matrix) - matrix).ravel()
        nees += float(error @ np.linalg.solve(np.array(stated.covariance), error)) / 9.0 / n
    squares = np.array(errors) ** 2 / variances
    ratio = np.sqrt(squares.mean(axis=0))
    band = 3.5 / math.sqrt(2.0 * n)
    assert np.all(np.abs(ratio - 1.0) < band), dict(zip(NAMES, ratio.round(3), strict=True))
    # Over all parameters: parameters of one unit are correlated, units are not.
    by_unit = squares.mean(axis=1)
    assert abs(by_unit.mean() - 1.0) < 3.5 * by_unit.std(ddof=1) / math.sqrt(n)
    assert abs(nees - 1.0) < 3.5 * math.sqrt(2.0 / (9.0 * n))


def test_a_bias_that_wanders_besides():
    """One bias for each sequence on top, of 20 °/h: its size is found, though Γ takes part of its scatter.

    A standard deviation of 3 (K − 1) independent deviations, less nine of Γ: 3.5 / √(2 · 39), and a tenth for noise.
    """
    rng, size = np.random.default_rng(5), 20.0 * DEG_PER_H
    recording = read_out(motion_of(), SensorErrors(), ImuModel(gyro_noise=1e-6, gyro_g_sensitivity=GAMMA), rng)
    gyro = recording.gyro.copy()
    for label in recording.sequences:
        part = slice(
            recording.window_indices(*label.start_static_s).start, recording.window_indices(*label.end_static_s).stop
        )
        gyro[part] += rng.standard_normal(3) * size
    found = srt.calibrate(replace(recording, gyro=gyro), "closed-form", gyro_bias="g-sensitive", checks=False)
    wander = np.sqrt(np.mean(found.noise.gyro_bias_wander_rad_s**2))
    assert abs(wander / size - 1.0) < 3.5 / math.sqrt(78.0) + 0.1
    stated = found.diagnostics.g_sensitivity
    error = (np.array(stated.matrix) - GAMMA).ravel()
    # The wander comes into the covariance of Γ: nine elements, chi-square at 1e-4 with the sigma's own doubt of 40 %.
    assert error @ np.linalg.solve(np.array(stated.covariance), error) < chi2.ppf(1 - 1e-4, 9) * 1.4**2


# --- what is not seen ---------------------------------------------------------------------------------------------


def test_one_vertical_shows_no_g_sensitivity_and_a_warning_says_so():
    """z down throughout: bias and Γ are one thing, in the windows; the directions that are not seen are told."""
    motion = motion_of(sequences=("1", "2", "1a", "2a"), earth_rate=False)
    recording = read_out(motion, SensorErrors(), ImuModel(gyro_g_sensitivity=GAMMA))
    found = srt.calibrate(recording, "closed-form", gyro_bias="g-sensitive", checks=False)
    stated = found.diagnostics.g_sensitivity
    assert not np.array(stated.matrix).any()
    unseen = np.array(stated.not_seen_along)
    np.testing.assert_allclose(unseen @ unseen.T, np.eye(3), rtol=0, atol=1e-12)
    assert any("is not observable: the specific force varies" in w for w in found.warnings)
    bias = found.errors.vector[GROUP_SLICES["gyro_bias"]]
    # To second order: what is left of the compensation at the estimate.
    np.testing.assert_allclose(bias, -SITE.gravity_m_s2 * GAMMA[:, 2], rtol=1e-3)


def test_two_verticals_show_one_direction():
    motion = motion_of(sequences=("1", "1a", "3", "3a"), earth_rate=False)
    recording = read_out(motion, SensorErrors(), ImuModel(gyro_g_sensitivity=GAMMA))
    data, found = played(recording)
    unobserved = found.poses.unobserved
    assert unobserved.shape == (2, 3)
    along = np.array([1.0, 0.0, -1.0]) / math.sqrt(2.0)
    np.testing.assert_allclose(unobserved @ along, 0.0, atol=1e-9)
    # What is seen is Γ along it: the rates differ between z down and x down.
    np.testing.assert_allclose(found.poses.fit(found.rest_rate) @ along, GAMMA @ along, rtol=1e-9)
    np.testing.assert_allclose(found.poses.weights.sum(axis=0), 0.0, atol=1e-15)
    assert data.K == 4


# --- the test for it ----------------------------------------------------------------------------------------------


def test_rates_that_noise_alone_moves_raise_no_alarm_more_often_than_stated(monkeypatch):
    """Drawn rates of windows with a bias for each sequence; at a false-alarm rate that can be counted."""
    monkeypatch.setattr(g_sensitivity_report, "FALSE_ALARM_PROBABILITY", 0.3)
    recording = read_out(motion_of(fixture=1e-9), SensorErrors())
    data = prepare(recording, recording.sequences)
    found = SrtProcessor(data, Options()).process(SensorErrors())
    rng, n = np.random.default_rng(7), 2000
    own = rng.standard_normal((n, data.K, 3))[:, found.window_sequence] * 10.0
    rates = 1e-4 * (own + rng.standard_normal((n, *found.rest_rate.shape)))
    alarms = sum(
        g_sensitivity_report.significant_g_sensitivity(data, found.force, r, found.integrated) is not None
        for r in rates
    )
    # Half of the rate for three gyros one by one, and half for all of them: the share of three independent p-values.
    p = rng.random((1_000_000, 3))
    either = np.minimum(3.0 * p.min(axis=1), chi2.sf(-2.0 * np.log(p).sum(axis=1), 6)) <= 0.15
    low, high = binom.ppf([2.5e-4, 1 - 2.5e-4], n, either.mean())
    assert low <= alarms <= high


def test_auto_estimates_what_the_residuals_show_and_says_so():
    rng, motion = np.random.default_rng(8), motion_of(fixture=1e-3)
    loud = srt.calibrate(read_out(motion, unit(), replace(WHITE, gyro_g_sensitivity=GAMMA), rng), "closed-form")
    assert any("was estimated too" in w for w in loud.warnings)
    assert loud.judgement.word == "sound"
    sigma = np.array(loud.diagnostics.g_sensitivity.sigma)
    assert np.all(np.abs(np.array(loud.diagnostics.g_sensitivity.matrix) - GAMMA) < 4.0 * sigma)
    quiet = srt.calibrate(read_out(motion, unit(), WHITE, rng), "closed-form")
    assert not any("g-sensitive" in w for w in quiet.warnings)
    assert quiet.diagnostics.g_sensitivity is None
    assert quiet.to_dict()["formula"] == FORMULA


def test_an_unknown_earth_rate_is_not_taken_for_it():
    """The Earth's rate along the vertical looks like a multiple of the unit matrix, of 15 °/h/g at most."""
    recording = read_out(motion_of(fixture=1e-3), SensorErrors(), ImuModel(gyro_noise=1e-7), np.random.default_rng(9))
    blind = replace(recording, site=replace(recording.site, latitude_rad=None))
    found = srt.calibrate(blind, "closed-form")
    assert not any("g-sensitive" in w for w in found.warnings)


# --- results ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """A recording, and its calibration by the command."""
    folder = tmp_path_factory.mktemp("unit")
    rng = np.random.default_rng(10)
    recording = read_out(motion_of(fixture=1e-3), unit(), replace(WHITE, gyro_g_sensitivity=GAMMA), rng)
    srt.write_recording(recording, folder / "rec", samples_format="npz")
    return folder


def test_command_and_file(calibrated, shell):
    file = calibrated / "result.json"
    out = shell("calibrate", calibrated / "rec", "--gyro-bias", "g-sensitive", "--details", "-o", file).out
    assert "Gyro g-sensitivity, and scatter" in out
    assert max(map(len, out.splitlines())) <= 80
    document = json.loads(file.read_text())
    assert document["formula"].startswith(FORMULA)
    assert "diagnostics.g_sensitivity.matrix" in document["formula"]
    assert document["provenance"]["options"]["gyro_bias"] == "g-sensitive"
    loaded = srt.load_calibration(file)
    stated = loaded.diagnostics.g_sensitivity
    scatter = stated.rest_rate_scatter_rad_s
    assert np.all(np.array(scatter.before) > 2.0 * np.array(scatter.after))
    # Rms of 34 rates with four unknowns: a sigma of 30, 3.5 standard errors of it.
    np.testing.assert_allclose(scatter.after, scatter.expected, rtol=3.5 / math.sqrt(60.0))
    np.testing.assert_allclose(np.sqrt(np.diag(stated.covariance)), np.ravel(stated.sigma), rtol=1e-12)
    assert loaded.to_dict() == {k: v for k, v in document.items() if k != "digest"}


@pytest.mark.slow
def test_the_certificate_shows_it(calibrated):
    file = calibrated / "again.json"
    recording = srt.load_recording(calibrated / "rec")
    found = srt.calibrate(recording, "closed-form", gyro_bias="g-sensitive")
    found.save(file)
    source = calibration_file(file)
    certificate = make_certificate(source, course=recording_history(source, recording, "rec"))
    table = certificate.g_sensitivity
    shown = np.array([[cell.value for cell in row[1::2]] for row in table.rows])
    np.testing.assert_array_equal(shown, found.diagnostics.g_sensitivity.matrix)
    assert "y − Γ f" in " ".join(certificate.application.sentences)
    if importlib.util.find_spec("jinja2"):
        assert "Gyro g-sensitivity" in html_page(certificate)


def test_apply_and_exports_say_whether_they_compensate_g_sensitivity(calibrated, shell):
    file, out, header = (calibrated / name for name in ("applied.json", "out", "unit.h"))
    recording = srt.load_recording(calibrated / "rec")
    found = srt.calibrate(recording, "closed-form", gyro_bias="g-sensitive")
    found.save(file)
    assert shell("apply", file, calibrated / "rec", "-o", out, "--c-header", header, "-q").err == ""
    assert "g_sensitivity[9]" in header.read_text()
    plain = replace(found, diagnostics=Diagnostics())
    _, force = plain.apply(recording.gyro, recording.accel)
    matrix = np.array(found.diagnostics.g_sensitivity.matrix)
    # Γ f comes off the readings, and what is left is corrected as without it; readings below 10 round to 1e-15.
    expected, _ = plain.apply(recording.gyro - force @ matrix.T, recording.accel)
    np.testing.assert_allclose(srt.load_recording(out).gyro, expected, rtol=0, atol=1e-14)
    applier = srt.Applier(found)
    one = applier.apply_sample(recording.gyro[7], recording.accel[7])[0]
    np.testing.assert_array_equal(one, found.apply(recording.gyro[7], recording.accel[7])[0])
    assert "g-sensitivity" in exporters.export(found, "basalt").losses
    assert "g-sensitivity" not in exporters.export(found, "kalibr").losses
    other = replace(found, diagnostics=Diagnostics(), provenance=replace(found.provenance, data_sha256="0" * 64))
    merged = srt.merge_calibrations([found, other], ["a", "b"])
    assert any("is not merged: a have it" in w for w in merged.warnings)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_readings_without_it(kind):
    """Corrected readings of a unit are those of one that does not follow specific force."""
    motion, truth = motion_of(), unit()
    sensitive, plain = (
        read_out(motion, truth, ImuModel(gyro_g_sensitivity=m), kind=kind) for m in (GAMMA, np.zeros((3, 3)))
    )
    found = srt.calibrate(sensitive, "closed-form", gyro_bias="g-sensitive")
    dt = {"dt": 0.02} if kind == "increment" else {}
    gyro, _ = found.apply(sensitive.gyro, sensitive.accel, kind=kind, **dt)
    expected, _ = replace(found, diagnostics=Diagnostics()).apply(plain.gyro, plain.accel, kind=kind, **dt)
    size = np.abs(sensitive.gyro - plain.gyro).max()
    # A sample in which f changes its sign has no one sign of the asymmetry: half of what f changes by at 1 rad/s. The
    # correction of the gyros makes at most a few per cent more of a difference of readings.
    asymmetry = np.abs(truth.vector[GROUP_SLICES["accel_asymmetry"]]).sum()
    assert np.abs(gyro - expected).max() < 1.1 * size * asymmetry * 0.5 * 0.02


def test_covariance_of_corrected_samples_has_it():
    """The covariance by differences: of the 27 errors, through Γ f too, and of the nine elements of Γ."""
    found = srt.calibrate(read_out(motion_of(), unit(), ImuModel(gyro_g_sensitivity=GAMMA)), gyro_bias="g-sensitive")
    stated = found.diagnostics.g_sensitivity
    y, f = np.array([0.4, -0.7, 0.2]), np.array([4.0, -5.0, 7.0])

    def corrected(errors, matrix):
        changed = Diagnostics(g_sensitivity=replace(stated, matrix=matrix))
        return np.hstack(srt.Applier(replace(found, errors=errors, diagnostics=changed)).apply(y, f))

    matrix = np.array(stated.matrix)
    step = 1e-6
    J = [
        (
            corrected(SensorErrors(found.errors.vector + d), matrix)
            - corrected(SensorErrors(found.errors.vector - d), matrix)
        )
        / (2.0 * step)
        for d in step * np.eye(27)
    ]
    G = [
        (corrected(found.errors, matrix + d.reshape(3, 3)) - corrected(found.errors, matrix - d.reshape(3, 3)))
        / (2.0 * step)
        for d in step * np.eye(9)
    ]
    J, G = np.transpose(J), np.transpose(G)
    expected = J @ found.covariance @ J.T + G @ np.array(stated.covariance) @ G.T
    # Central differences of 1e-6: second order 1e-12 of values below 10, rounding 1e-16 · 10 / 1e-6.
    np.testing.assert_allclose(
        srt.Applier(found).sample_covariance(y, f), expected, rtol=1e-6, atol=1e-6 * expected.max()
    )


@pytest.mark.slow
def test_budget_command(tmp_path, shell):
    """Estimating g-sensitivity leaves less than 1e-3 of its effect in the error budget.

    Without it, the residuals contradict the result; the budget shows by how much it is off.
    """
    plan, rows = tmp_path / "short.toml", {}
    plan.write_text(PLAN)
    for mode in ("pooled", "g-sensitive"):
        file = tmp_path / f"{mode}.json"
        arguments = ["budget", str(plan), "--estimator", "closed-form", "--draws", "2", "--gyro-bias", mode]
        assert shell(*arguments, "-o", file, "-q").out == ""
        rows[mode] = json.loads(file.read_text())["budgets"][0]["sources"][G_SENSITIVITY]
    for name in NAMES[:6]:
        assert rows["g-sensitive"][name] < 1e-3 * rows["pooled"][name]
