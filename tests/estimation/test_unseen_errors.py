"""Coefficients of the errors that no residual shows, against calibrations of recordings that have them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import srt
from sims.faults.injection import Case
from srt.constants import DEG, DEG_PER_H
from srt.sensor_errors import GROUP_SLICES

FACTORS = {"ppm": 1e6, "°/h": 1.0 / DEG_PER_H}
SMALL = 20.0
"""Errors of 20 units: beyond the rounding of the iteration, with second-order effects of 4e-4."""


@pytest.fixture(scope="module", params=["rate", "increment"])
def calibrated(request):
    """A recording of rates or increments, its calibration, and its unseen errors by source."""
    recording = Case("tactical-fog", 3, {"recording": {"kind": request.param, "sample_rate_hz": 100.0}}).recording
    found = srt.calibrate(recording, "least-squares", checks=False)
    return recording, found, {row["source"]: row for row in found.diagnostics["unseen_errors"]}


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
    row, part = rows[source], GROUP_SLICES[rows[source]["group"]]
    error = SMALL * (0.01 if source == "latitude" else 1.0)
    wrong = srt.calibrate(shifted(recording, source), "least-squares", checks=False)
    change = (wrong.errors.vector - found.errors.vector)[part] * FACTORS[row["group_unit"]]
    if row["largest"]:
        # The poses turn the Earth rate to all axes; what remains is smaller.
        assert np.abs(change).max() <= 1.001 * error * row["coefficient"]
    else:
        np.testing.assert_allclose(change, error * row["coefficient"], rtol=0.01)
    assert wrong.verdict["chi_square"] == pytest.approx(found.verdict["chi_square"], abs=1.0)


def test_a_stated_sigma_is_told_and_in_the_result(calibrated):
    recording, found, rows = calibrated
    assert rows["time base"]["sigma"] is None
    assert "not stated" in rows["time base"]["sentence"]
    stated = srt.calibrate(replace(recording, clock_sigma=50e-6), "least-squares", checks=False)
    row = stated.diagnostics["unseen_errors"][0]
    assert row["sigma"] == pytest.approx(50.0)
    part = GROUP_SLICES[row["group"]]
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
    rows = {row["source"]: row["sigma"] for row in found.diagnostics["unseen_errors"]}
    assert rows["latitude"] == pytest.approx(SMALL * 0.01)
