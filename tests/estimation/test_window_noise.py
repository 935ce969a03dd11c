"""White noise and edges of means and rotations, from the weights of the samples and the angles at the ends alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_noise_sources import quiet

from srt.closed_form import measurement_covariance
from srt.estimation import error_sources
from srt.model.rotations import rotation_matrix
from srt.sequences.window_means import averaging_weights


@pytest.mark.parametrize("name", ["accel_noise", "accel_quantization"])
def test_noise_of_a_mean_force_follows_the_weights_of_its_samples(name):
    """White noise S has the variance S / dt in a sample; an edge is in the two samples beside it, with both signs."""
    data, measurements = quiet()
    by, dt = measurement_covariance.slopes_of(measurements), data.recording.nominal_interval_s
    white = name == "accel_noise"
    found = (error_sources.white_noise if white else error_sources.quantization)(data, by)[name]
    density = data.noise.accel_white**2 / dt if white else (data.noise.accel_edge / dt) ** 2
    for w, (first, last) in enumerate(data.windows.samples.tolist()):
        weights = averaging_weights(last - first, "linear")
        squares = weights @ weights if white else np.sum(np.diff(np.pad(weights, 1)) ** 2)
        effect = by.force[w] * np.sqrt(density * squares)
        np.testing.assert_allclose(found.own["force"][w], effect @ effect.T, rtol=1e-6, atol=1e-9 * density.max())


def test_a_rotation_has_the_edges_of_both_of_its_ends():
    """The channels are turned to one another, so that a derivative is not its own transpose."""
    data, measurements = quiet()
    by = measurement_covariance.slopes_of(measurements)
    by = by._replace(angle=by.angle @ rotation_matrix(np.array([0.3, -0.2, 0.5])))
    q = np.diag(data.noise.gyro_edge * np.array([1.0, 2.0, 3.0]))
    noise = replace(data.noise, gyro_edge=np.diag(q))
    parts = SimpleNamespace(noise=noise, windows=data.windows, start=data.start, end=data.end)
    found = error_sources.quantization(parts, by, shared=False)
    for C, turn in zip(by.integrals.C_end, found["gyro_quantization"].own["turn"], strict=True):
        edge = by.angle @ q @ q @ by.angle.T
        np.testing.assert_allclose(turn, edge + C @ edge @ C.T, rtol=1e-9, atol=1e-9 * np.abs(edge).max())
