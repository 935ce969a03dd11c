"""Markov states of the bias instability against the covariance of averages of the same noise, and against 1/f."""

import math

import numpy as np
import pytest

from srt.noise import markov_drift
from srt.noise.bias_instability import CORRELATION_TIMES_S, PROCESS_VARIANCE, correlation_times, flicker_covariance
from srt.noise.markov_drift import carried, markov_steps


def chain(steps):
    """Covariance of the averages of all steps, by propagation of the states from their distribution at the start."""
    K, n, M = steps.by_state.shape
    size = n + M
    # Effects of the draws, those of the first states and then those of every step, on the states and on all averages.
    states, means = np.zeros((M, M + K * size)), np.zeros((K, n, M + K * size))
    states[:, :M] = np.eye(M)
    for k in range(K):
        own = slice(M + k * size, M + (k + 1) * size)
        means[k] = steps.by_state[k] @ states
        means[k, :, own] += steps.root[k, :n]
        states = steps.decay[k][:, None] * states
        states[:, own] += steps.root[k, n:]
    means = means.reshape(K * n, -1)
    return means @ means.T


def sequences(pause):
    """Windows of 10 s around a rotation in three parts, of several lengths, with pauses between the sequences."""
    start, end, at = [], [], 5.0
    for turn in (6.3, 12.6, 3.1, 25.0):
        edges = at + np.array([0.0, 10.0, 10.0 + turn / 3, 10.0 + turn / 1.5, 10.0 + turn, 20.0 + turn])
        start.append(edges[:-1])
        end.append(edges[1:])
        at = edges[-1] + pause
    start, end = np.array(start), np.array(end)
    return start, end, (start[:, 0], np.append(start[1:, 0], end[-1, -1]))


@pytest.mark.parametrize("pause", [0.0, 8.0])
def test_chain_has_the_covariance_of_the_averages(pause, monkeypatch):
    """With a state for every process the chain is exact; the roots are regularised by 1e-12 of the variances."""
    monkeypatch.setattr(markov_drift, "CARRIED_S", 0.0)
    start, end, span = sequences(pause)
    times = correlation_times(float(end.max() - start.min()))
    found = chain(markov_steps(start, end, span, times))
    expected = flicker_covariance(start.ravel(), end.ravel(), times)
    assert np.abs(found - expected).max() <= 1e-10 * expected.max()


@pytest.mark.parametrize("pause", [0.0, 8.0])
def test_processes_without_a_state_matter_between_adjoining_averages_only(pause):
    """Faster ones lose their covariance between steps: at most (τ/T₁)(τ/T₂) of a process, apart e^(−pause/τ) of it."""
    start, end, span = sequences(pause)
    times = correlation_times(float(end.max() - start.min()))
    found = chain(markov_steps(start, end, span, times))
    expected = flicker_covariance(start.ravel(), end.ravel(), times)
    inside = np.kron(np.eye(len(start)), np.ones((start.shape[1],) * 2)) > 0.0
    assert np.abs(found - expected)[inside].max() <= 1e-10 * expected.max()
    lost = (expected - found)[~inside]
    fast = [tau for tau in times if tau not in carried(times)]
    bound = PROCESS_VARIANCE * sum((tau / 10.0) ** 2 * math.exp(-pause / tau) for tau in fast)
    assert 0.0 <= lost.max() <= bound * (1.0 + 1e-9)
    assert lost.max() < 0.005 * expected.diagonal().min()


def spectrum(frequency, times):
    """Two-sided spectrum of the sum of processes for an Allan floor of one, over that of flicker noise."""
    own = sum(2.0 * PROCESS_VARIANCE * tau / (1.0 + (2.0 * np.pi * frequency * tau) ** 2) for tau in times)
    return own * 4.0 * math.log(2.0) * frequency


def test_fit_to_flicker_noise():
    """The spectrum ripples by 2 / cosh(π² / ln 10) = 5.5 % (2.8 % of a sigma) where processes continue on both sides.

    The sum over processes a decade apart is a sum over n of sech(x − n ln 10), whose Fourier series has the relative
    amplitudes 2 sech(π² m / ln 10). A sum that ends with the process τ lacks (2 / π) atan(1 / (√10 ω τ)).
    """
    ripple, second, third = (2.0 / math.cosh(m * math.pi**2 / math.log(10.0)) for m in (1, 2, 3))
    endless = 10.0 ** np.arange(-12, 13.0)
    over = spectrum(np.geomspace(1e-2, 1.0, 2001), endless) - 1.0
    assert over.max() == pytest.approx(ripple + second, abs=1.1 * third)
    assert over.min() == pytest.approx(-ripple + second, abs=1.1 * third)
    assert ripple == pytest.approx(0.055, rel=1e-3)
    # The processes in use, a decade inside their range.
    frequency = 1.0 / (2.0 * np.pi * np.geomspace(10.0 * CORRELATION_TIMES_S[0], 0.1 * CORRELATION_TIMES_S[-1], 501))
    found = spectrum(frequency, CORRELATION_TIMES_S)
    missing = 2.0 / math.pi * math.atan(1.0 / math.sqrt(1000.0))
    assert np.all(np.abs(found - 1.0) < ripple + second + 2.0 * missing)
