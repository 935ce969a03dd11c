"""Error of the time base: its effect is that of stretched time stamps, and a stated sigma is in the covariance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from injected_faults.injection import Case

import srt
from srt.sensor_errors import GROUP_SLICES, NAMES

STRETCH = 1e-4


@cache
def noise_free(kind):
    form = {"kind": kind, "sample_rate_hz": 50.0}
    return Case("navigation-rlg", 3).changed(imu={"from": "perfect"}, recording=form).recording


@pytest.mark.parametrize(
    ("kind", "estimator"),
    [
        ("increment", "closed-form"),
        ("rate", "least-squares"),
        ("rate", "graph"),
        pytest.param("rate", "closed-form", marks=pytest.mark.slow),
        pytest.param("increment", "least-squares", marks=pytest.mark.slow),
        pytest.param("increment", "graph", marks=pytest.mark.slow),
    ],
)
def test_effect_is_that_of_stretched_stamps(kind, estimator):
    """Differences of two calibrations of the same samples; the time base is wrong by 100 ppm in one of them."""
    pytest.importorskip("gtsam" if estimator == "graph" else "numpy")
    sound = noise_free(kind)
    stretched = replace(
        sound,
        time=sound.time * (1.0 + STRETCH),
        sequences=tuple(
            replace(
                label,
                start_static_s=tuple(t * (1.0 + STRETCH) for t in label.start_static_s),
                end_static_s=tuple(t * (1.0 + STRETCH) for t in label.end_static_s),
            )
            for label in sound.sequences
        ),
    )
    before, after = (srt.calibrate(r, estimator, checks=False) for r in (sound, stretched))
    change = after.errors.vector - before.errors.vector
    stated = srt.calibrate(replace(sound, clock_sigma=STRETCH), estimator, checks=False)
    effect = stated.contributions["clock"]
    # Beside the first order: products with the errors of unit and fixture, a few of 1e-3 each.
    for group in ("gyro_scale", "accel_scale"):
        part = GROUP_SLICES[group]
        np.testing.assert_allclose(np.abs(change[part]), effect[part], atol=2e-2 * STRETCH)
    rest = np.array([not name.startswith(("gyro_scale", "accel_scale", "accel_bias", "gyro_bias")) for name in NAMES])
    assert np.all(np.abs(change[rest]) < 2e-2 * STRETCH)


def test_a_stated_sigma_is_common_to_the_gyro_scales():
    recording = Case("tactical-fog", 4).changed(recording={"kind": "rate"}).recording
    plain, stated = (srt.calibrate(r, checks=False) for r in (recording, replace(recording, clock_sigma=50e-6)))
    scale = GROUP_SLICES["gyro_scale"]
    added = stated.covariance[scale, scale] - plain.covariance[scale, scale]
    np.testing.assert_allclose(added, np.full((3, 3), 50e-6**2), rtol=1e-6)


def test_the_key_is_read_written_and_bounded(tmp_path):
    recording = replace(noise_free("rate"), clock_sigma=2e-6)
    srt.write_recording(recording, tmp_path / "r", samples_format="npz")
    text = (tmp_path / "r" / "recording.toml").read_text()
    assert "clock_sigma_ppm = 2.0" in text
    assert srt.load_recording(tmp_path / "r").clock_sigma == pytest.approx(2e-6)
    (tmp_path / "r" / "recording.toml").write_text(text.replace("clock_sigma_ppm = 2.0", "clock_sigma_ppm = -1.0"))
    with pytest.raises(srt.InputError, match="clock_sigma_ppm"):
        srt.load_recording(tmp_path / "r")
