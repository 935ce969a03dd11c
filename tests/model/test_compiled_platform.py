"""Compiled steps of the analytic platform: the same integrals as numpy, chosen where they pay, and only there."""

from pathlib import Path

import numpy as np
import pytest
from platform_streams import random_stream

from srt.model import analytic_platform, platform_steps
from srt.model.analytic_platform import integrate_attitude
from srt.model.platform_steps import COMPILED_RECORDINGS, COMPILED_SAMPLES, many_recordings
from srt.model.sensor_model import Triad

numba = pytest.importorskip("numba")
compiled_platform = pytest.importorskip("srt.model.compiled_platform")

SQUEEZED = Triad(np.array([[1.3, 0.2, -0.1], [0.2, 0.7, 0.05], [-0.1, 0.05, 1.1]]), np.full(3, 0.01), np.full(3, 2e-3))
SYMMETRIC = Triad(SQUEEZED.matrix, np.zeros(3), SQUEEZED.bias)
FIELDS = ("C_end", "rate", "abs_rate", "time", "weight_s", "angle", "noise", "time_parts", "C_turned")


def both(stream, triad, **more):
    """Integrals and attitudes by numpy and compiled."""
    K = len(stream.starts) - 1
    earth = 7e-5 * np.random.default_rng(2).normal(size=(K, 3))
    offset = 1e-4 * np.random.default_rng(3).normal(size=(K, 3))
    out = []
    for recordings in (1, COMPILED_RECORDINGS):
        with many_recordings(recordings):
            out.append(integrate_attitude(stream, triad, earth, bias_offset=offset, with_noise=True, **more))
    return out


@pytest.mark.parametrize("triad", [SQUEEZED, SYMMETRIC])
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("noise", [None, 2e-5])
def test_compiled_integrals_are_those_of_numpy(triad, weighted, noise, monkeypatch):
    """Fast and slow rotations, kinks, channels at rest with noise, sequences of one sample, several blocks."""
    monkeypatch.setattr(analytic_platform, "BLOCK", 1500)
    stream = random_stream(weighted=weighted)
    sample_noise = None if noise is None else np.full(3, noise)
    (numpy, C), (compiled, compiled_C) = both(stream, triad, sample_noise_rad=sample_noise)
    for name in FIELDS:
        expected, found = getattr(numpy, name), getattr(compiled, name)
        scale = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * scale, err_msg=name)
    np.testing.assert_allclose(compiled_C, C, rtol=0, atol=1e-12)


def test_signs_of_noise_are_the_same():
    """The sign of a sample near zero selects among slopes that differ by 2 %: one other choice would show."""
    stream = random_stream(weighted=False)
    noise = np.full(3, 2e-5)
    steps, compiled = (
        kind(stream, SQUEEZED, np.zeros((len(stream.starts) - 1, 3)), noise)
        for kind in (platform_steps.Steps, platform_steps.CompiledSteps)
    )
    n = len(stream.interval_s)
    expected, found = steps.block(0, n)[0], compiled.block(0, n)[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)
    hard = platform_steps.Steps(stream, SQUEEZED, np.zeros((len(stream.starts) - 1, 3)), None).block(0, n)[0]
    assert np.abs(hard - expected).max() > 1e-7


@pytest.mark.parametrize(
    ("samples", "recordings", "kind"),
    [
        (COMPILED_SAMPLES - 1, COMPILED_RECORDINGS - 1, platform_steps.Steps),
        (COMPILED_SAMPLES, 1, platform_steps.CompiledSteps),
        (10, COMPILED_RECORDINGS, platform_steps.CompiledSteps),
    ],
)
def test_compiled_where_it_pays(samples, recordings, kind, monkeypatch):
    stream, none = random_stream(weighted=False), np.zeros((1, 3))
    monkeypatch.setattr(platform_steps, "COMPILED_SAMPLES", COMPILED_SAMPLES - samples + len(stream.interval_s))
    with many_recordings(recordings):
        assert type(platform_steps.steps_of(stream, SYMMETRIC, none, None)) is kind
        monkeypatch.setattr(platform_steps, "_compiled_block", lambda: None)
        assert type(platform_steps.steps_of(stream, SYMMETRIC, none, None)) is platform_steps.Steps


def test_code_that_cannot_be_stored_is_compiled_all_the_same():
    """Source without a file, for which numba finds no folder to store compiled code in."""
    source = Path(compiled_platform.__file__).read_text(encoding="utf-8")
    names = {"__name__": "compiled_platform_without_a_file"}
    exec(compile(source, "<no file>", "exec"), names)  # noqa: S102
    with pytest.raises(RuntimeError, match="cannot cache"):
        numba.njit(cache=True)(names["_limited"].py_func)
    assert names["_limited"](1.0, 2.0, 4.0) == 1.5
