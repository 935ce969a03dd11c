"""Coefficients of the errors that no residual shows, against calibrations of recordings that have them."""

from dataclasses import replace

import numpy as np
import pytest
from foreign_fixture import on_fixture, table_1, write
from foreign_motion import DEG, GRADES, GRAVITY_M_S2, drawn_errors
from injected_faults.injection import Case

import sims
import srt
from sims.scenarios.scenario import scenario_from_dict
from srt.constants import DEG_PER_H
from srt.sensor_errors import GROUP_SLICES, NAMES

FACTORS = {"ppm": 1e6, "°/h": 1.0 / DEG_PER_H}
SMALL = 20.0
"""Errors of 20 units: beyond the rounding of the iteration, with second-order effects of 4e-4."""


@pytest.fixture(scope="module", params=["rate", "increment"])
def calibrated(request):
    """A recording of rates or increments, its calibration, and its unseen errors by source."""
    recording = Case("tactical-fog", 3, {"recording": {"kind": request.param, "sample_rate_hz": 100.0}}).recording
    found = srt.calibrate(recording, "closed-form", checks=False)
    return recording, found, {row.source: row for row in found.diagnostics.unseen_errors}


def shifted(recording, source):
    """The recording with an error of 20 ppm, 20 mrad or 0.2°."""
    site, fixture = recording.site, recording.fixture
    if source == "time base":
        factor = 1.0 + SMALL * 1e-6
        labels = tuple(
            replace(
                s,
                start_static_s=tuple(factor * t for t in s.start_static_s),
                end_static_s=tuple(factor * t for t in s.end_static_s),
            )
            for s in recording.sequences
        )
        return replace(recording, time=recording.time * factor, sequences=labels)
    if source == "gravity":
        return replace(recording, site=replace(site, gravity_m_s2=site.gravity_m_s2 * (1.0 + SMALL * 1e-6)))
    if source == "latitude":
        return replace(recording, site=replace(site, latitude_rad=site.latitude_rad + SMALL * 0.01 * DEG))
    return replace(recording, fixture=replace(fixture, heading_rad=fixture.heading_rad + SMALL * 1e-3))


@pytest.mark.parametrize("source", ["time base", "gravity", "latitude", "heading"])
def test_coefficients(calibrated, source):
    recording, found, rows = calibrated
    row, part = rows[source], GROUP_SLICES[rows[source].group]
    error = SMALL * (0.01 if source == "latitude" else 1.0)
    wrong = srt.calibrate(shifted(recording, source), "closed-form", checks=False)
    change = (wrong.errors.vector - found.errors.vector)[part] * FACTORS[row.group_unit]
    if row.largest:
        # The poses turn the Earth rate to all axes; what remains is smaller.
        assert np.abs(change).max() <= 1.001 * error * row.coefficient
    else:
        np.testing.assert_allclose(change, error * row.coefficient, rtol=0.01)
    assert wrong.consistency.chi_square == pytest.approx(found.consistency.chi_square, abs=1.0)


def test_a_stated_sigma_is_told_and_in_the_result(calibrated):
    recording, found, rows = calibrated
    assert rows["time base"].sigma is None
    assert "not stated" in rows["time base"].sentence
    stated = srt.calibrate(replace(recording, clock_sigma=50e-6), "closed-form", checks=False)
    row = stated.diagnostics.unseen_errors[0]
    assert row.sigma == pytest.approx(50.0)
    part = GROUP_SLICES[row.group]
    np.testing.assert_allclose(stated.sigma[part] ** 2, found.sigma[part] ** 2 + (50e-6) ** 2, rtol=1e-6)


@pytest.mark.parametrize("estimator", ["closed-form", "least-squares", "graph"])
def test_a_stated_sigma_of_the_latitude_is_in_the_sigmas(calibrated, estimator):
    """The contribution is the change of the result when the recording states a latitude one sigma off."""
    pytest.importorskip("gtsam" if estimator == "graph" else "numpy")
    plain, _, _ = calibrated
    recording = replace(plain, site=replace(plain.site, latitude_sigma_rad=SMALL * 0.01 * DEG))
    found, wrong = (srt.calibrate(r, estimator, checks=False) for r in (recording, shifted(recording, "latitude")))
    contribution, change = found.contributions["latitude"], np.abs(wrong.errors.vector - found.errors.vector)
    bias = GROUP_SLICES["gyro_bias"]
    # The largest effect, of the gyro biases; products with the errors of unit and fixture are a few of 1e-3.
    np.testing.assert_allclose(contribution[bias], change[bias], atol=0.01 * change[bias].max())
    assert np.all(np.abs(contribution - change) <= 0.01 * contribution + 0.01 * found.sigma)
    rows = {row.source: row.sigma for row in found.diagnostics.unseen_errors}
    assert rows["latitude"] == pytest.approx(SMALL * 0.01)


def rate_table(protocol="rate-table", kind="rate"):
    """Recording on a rate table by its shipped protocol, or that of a file."""
    tables = {
        "seed": 1,
        "imu": {"from": "tactical-fog"},
        "site": {"from": "latitude-45"},
        "protocol": {"from": str(protocol)},
        "recording": {"sample_rate_hz": 20.0, "kind": kind},
    }
    return sims.simulate(scenario_from_dict(tables)).recording


def wrong_rates(recording, *, first_only):
    """The recording with the stated rate of the first run, or of all, 20 ppm too large."""
    labels = list(recording.sequences)
    runs = [k for k, label in enumerate(labels) if label.rate is not None]
    for k in runs[:1] if first_only else runs:
        axis, rate = labels[k].rate
        labels[k] = replace(labels[k], rate=(axis, rate * (1.0 + SMALL * 1e-6)))
    return recording.with_sequences(tuple(labels))


def slower_clock(recording):
    """The recording with stamps that are 20 ppm too far apart, and labels of the same clock."""
    factor = 1.0 + SMALL * 1e-6

    def scaled(window):
        return None if window is None else tuple(factor * t for t in window)

    names = ("start_static_s", "end_static_s", "steady_s")
    labels = tuple(replace(s, **{name: scaled(getattr(s, name)) for name in names}) for s in recording.sequences)
    return replace(recording, time=recording.time * factor, sequences=labels)


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_coefficients_on_a_rate_table(kind):
    """Effects of the common error of the stated rates, of one run's, and of the time base, on scale factors."""
    recording = rate_table(kind=kind)
    found = srt.calibrate(recording, "least-squares", checks=False)
    rows = {(row.source, row.group): row for row in found.diagnostics.unseen_errors}
    for source, changed, axes in (
        ("the stated rates", wrong_rates(recording, first_only=False), [0, 1, 2]),
        ("one stated rate alone", wrong_rates(recording, first_only=True), [0]),
        ("time base", slower_clock(recording), [0, 1, 2]),
    ):
        wrong = srt.calibrate(changed, "least-squares", checks=False)
        assert wrong.consistency.chi_square == pytest.approx(found.consistency.chi_square, abs=0.1)
        change = (wrong.errors.vector - found.errors.vector) * 1e6
        for group in ("gyro_scale", "accel_scale"):
            row = rows.get((source, group))
            expected = np.zeros(3)
            if row is not None:
                assert row.axes == "xyz"
                expected[axes] = SMALL * row.coefficient
            np.testing.assert_allclose(change[GROUP_SLICES[group]], expected, atol=0.01 * SMALL)
    assert rows["the stated rates", "gyro_scale"].sigma == pytest.approx(20.0)
    assert ("time base", "gyro_scale") in rows or kind == "rate"


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_a_stated_clock_on_a_rate_table(kind):
    """Rates are compared with rates: gyros that output rates do not depend on the time base, increments do."""
    recording = rate_table(kind=kind)
    exact, stated = (
        srt.calibrate(replace(recording, clock_sigma=sigma), "least-squares", checks=False) for sigma in (0.0, 50e-6)
    )
    for group, counts in (("gyro_scale", kind == "increment"), ("accel_scale", kind == "increment")):
        added = stated.sigma[GROUP_SLICES[group]] ** 2 - exact.sigma[GROUP_SLICES[group]] ** 2
        np.testing.assert_allclose(added, (50e-6) ** 2 if counts else 0.0, rtol=1e-6, atol=1e-18)


def test_a_run_at_another_rate_shows_a_wrong_one(tmp_path):
    """Two rates about an axis in the same sense contradict each other; the result no longer lists the error of one."""
    runs = [
        f'[[step]]\n{down}rotations = [["{axis}", {sense * 3600.0}]]\nstated_rate_deg_s = {rate}\n'
        for axis in "xyz"
        for rate, senses in ((100.0, (1, -1)), (50.0, (1, -1)))
        for sense, down in zip(senses, (f'down = "{axis}"\n' if rate > 50.0 else "", ""), strict=True)
    ]
    poses = [f'[[step]]\ndown = "-{axis}"\n' for axis in "xyz"]
    protocol = tmp_path / "two-rates.toml"
    protocol.write_text(
        'description = "two rates"\nrest_s = 20.0\nplace_s = 30.0\nacceleration_deg_s2 = 50.0\n'
        "rate_sigma_ppm = 20.0\n" + "".join(runs + poses)
    )
    recording = rate_table(protocol)
    found = srt.calibrate(recording, "least-squares", checks=False)
    assert "one stated rate alone" not in {row.source for row in found.diagnostics.unseen_errors}
    labels = list(recording.sequences)
    k = next(k for k, label in enumerate(labels) if label.rate is not None)
    axis, rate = labels[k].rate
    labels[k] = replace(labels[k], rate=(axis, rate * 1.001))
    wrong = srt.calibrate(recording.with_sequences(tuple(labels)), "least-squares", checks=False)
    assert wrong.status == "inconsistent"
    assert "the stated rates about its axis" in wrong.message


def table_1_test(folder, **tables):
    """Table 1 on a fixture of 1 mrad, 50 Hz, by a generator that shares nothing with the estimators."""
    rng = np.random.default_rng(20261203)
    errors = drawn_errors(GRADES["tactical"], rng)
    motion = on_fixture(table_1(), rng, rest_s=10.0, rate_rad_s=60.0 * DEG, sigma_rad=1e-3)
    samples = motion.sampled(errors, GRADES["tactical"], rng)
    fixture = {"heading_deg": 0.0, "alignment_sigma_mrad": 1.0, "rotation_sigma_mrad": 1.0}
    write(folder, samples, {"fixture": fixture, **tables}, motion.labels(0.1))
    return errors


@pytest.mark.parametrize("stamps", ["even", "milliseconds", "jitter"])
@pytest.mark.parametrize(("ppm", "warned"), [(-4000.0, True), (200.0, True), (80.0, False), (0.0, False)])
def test_a_sample_rate_against_the_stamps_is_named_or_in_the_sigmas(tmp_path, ppm, warned, stamps):
    """An error of the rate is one of every gyro scale, in agreement with all residuals; crystals have 100 ppm."""
    errors = table_1_test(tmp_path / "unit")
    unit = srt.load_recording(tmp_path / "unit")
    jitter = np.random.default_rng(20261204).uniform(-4e-3, 4e-3, unit.time.size)
    time = {"even": unit.time, "milliseconds": np.floor(unit.time * 1e3) / 1e3, "jitter": unit.time + jitter}[stamps]
    found = srt.calibrate(replace(unit, time=time, sample_rate_hz=50.0 * (1.0 + ppm * 1e-6)), checks=False)
    at = GROUP_SLICES["gyro_scale"]
    expected = np.array([(1.0 + errors[name]) / (1.0 + ppm * 1e-6) - 1.0 for name in NAMES[at]])
    base = found.contributions.get("clock", np.zeros(27))[at]
    # The jitter of 2.3 ms over 25,000 samples gives the mean rate of ten parts 1 ppm.
    np.testing.assert_allclose(base, abs(ppm) * 1e-6, atol=0.05e-6 * abs(ppm) + (4e-6 if stamps == "jitter" else 1e-12))
    assert np.all(np.abs(found.errors.vector[at] - expected) < 3.5 * np.sqrt(found.sigma[at] ** 2 - base**2))
    said = "but the time stamps have a rate of 50 Hz"
    assert any(said in text for text in found.warnings) == warned
    assert (found.judgement.word, said in found.judgement.reason) == (
        ("doubtful", True) if warned else ("sound", False)
    )


def test_a_stated_clock_replaces_the_difference_from_the_stamps(tmp_path, shell):
    table_1_test(tmp_path / "unit", recording={"sample_rate_hz": 50.01})
    found = srt.calibrate(tmp_path / "unit")
    assert found.diagnostics.unseen_errors[0].sentence.endswith(
        "is 200 ppm, by which sample_rate_hz differs from the time stamps."
    )
    assert "every gyro scale factor is wrong by 200 ppm" in shell("calibrate", tmp_path / "unit", "-q").err
    stated = srt.calibrate(replace(srt.load_recording(tmp_path / "unit"), clock_sigma=5e-6))
    np.testing.assert_allclose(stated.contributions["clock"][GROUP_SLICES["gyro_scale"]], 5e-6, rtol=1e-6)
    assert stated.judgement.word == "doubtful"


@pytest.mark.parametrize(
    ("site", "warned"),
    [
        ({"gravity_m_s2": 9.6}, True),
        ({"gravity_m_s2": 9.85}, True),
        ({"gravity_m_s2": 9.79468}, False),
        ({"gravity_m_s2": 9.85, "gravity_sigma_m_s2": 0.05}, False),
    ],
)
def test_gravity_that_no_place_has_warns_without_a_latitude(tmp_path, site, warned):
    errors = table_1_test(tmp_path / "unit", site=site)
    found = srt.calibrate(tmp_path / "unit")
    said = [text for text in found.warnings if "gravity on Earth is 9.76 to 9.84 m/s²" in text]
    assert bool(said) == warned
    assert found.judgement.word == ("doubtful" if warned else "sound"), found.judgement
    if warned:
        assert said[0] in found.judgement.reason
        at = GROUP_SLICES["accel_scale"]
        factor = GRAVITY_M_S2 / site["gravity_m_s2"]
        expected = [factor * (1.0 + errors[name]) - 1.0 for name in NAMES[at]]
        assert np.all(np.abs(found.errors.vector[at] - expected) < 3.5 * found.sigma[at])
