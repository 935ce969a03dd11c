"""Effect of an uncompensated gyro bias on all 17 sequences (Savage 2020, §9.4): to second order, and in pairs.

The bias turns the attitude wrongly by the ordered exponential of ``v = C κ``, C the true attitude against the start,
``dE/dt = E [v×]``: ``E = 1 + ∫ [v×] dt + ∫∫ [v(s)×][v(t)×] ds dt + ...`` with s before t; its term of order n is at
most ``(|κ| T)^n / n!``. The specific force of the end, which is −g u in start axes, is then carried to ``−g E u``.
"""

import math

import numpy as np
import pytest
from conftest import RAMP_S, RATE_RAD_S, SAMPLE_RATE_HZ, WINDOW_S, G

import sims
from srt.constants import DEG
from srt.estimation.options import Options
from srt.estimation.srt_measurements import SrtProcessor
from srt.model.rotation_integrals import ideal_rotations
from srt.model.rotations import cross_matrix, rotation_matrix
from srt.model.table1 import AXES, SEQUENCES
from srt.recording.recording import Site
from srt.sensor_errors import SensorErrors
from srt.sequences.preparation import prepare

BIAS = np.array([0.12, -0.08, 0.1]) * DEG
STEPS = 4000
"""Steps of the quadrature per rotation: the midpoint rule is off by (π / STEPS)² / 24 of a half turn's integral."""


@pytest.fixture(scope="module")
def motion():
    """Table 1 on a faultless fixture that does not turn with the Earth."""
    return sims.run_schedule(
        sims.Schedule(
            sims.table_sequences(tuple(sims.TABLE_1)),
            sims.RateProfile(RATE_RAD_S, RATE_RAD_S / RAMP_S),
            dwell_s=WINDOW_S,
        ),
        site=Site(G),
        sample_rate_hz=SAMPLE_RATE_HZ,
        earth_rate=False,
    )


def horizontal(motion, bias):
    """Change of the horizontal acceleration of every sequence, data with a bias played back as if there were none."""
    errors = SensorErrors.from_dict({f"gyro_bias_{a}": float(b) for a, b in zip("xyz", bias, strict=True)})
    recording = sims.read_out(motion, errors)
    data = prepare(recording, recording.sequences)
    z = SrtProcessor(data, Options()).process(SensorErrors()).z[: 2 * data.K].reshape(-1, 2)
    down = [AXES.index(SEQUENCES[name].down) for name in data.ids]
    out = np.zeros((data.K, 3))
    for row, values, d in zip(out, z, down, strict=True):
        row[[a for a in range(3) if a != d]] = values
    return {name: (row, d) for name, row, d in zip(data.ids, out, down, strict=True)}


def by_order(sequence, bias):
    """First and second term of E − 1 for rotations at a constant rate, and how long they take."""
    C, v, dt = np.eye(3), [], []
    for u, angle in zip(sequence.axes, sequence.angles_rad, strict=True):
        part = (np.arange(STEPS) + 0.5) / STEPS * angle
        v.append(np.einsum("ab,nbc,c->na", C, rotation_matrix(part[:, None] * u), bias))
        dt.append(np.full(STEPS, abs(angle) / RATE_RAD_S / STEPS))
        C = C @ rotation_matrix(angle * u)
    turns, dt = np.concatenate(v) * np.concatenate(dt)[:, None], np.concatenate(dt)
    before = np.cumsum(turns, axis=0) - 0.5 * turns
    second = np.einsum("nab,nbc->ac", cross_matrix(before), cross_matrix(turns))
    return cross_matrix(turns.sum(axis=0)), second, float(dt.sum())


def test_effect_of_a_bias_on_all_17_sequences_to_second_order(motion):
    measured = horizontal(motion, BIAS)
    assert set(measured) == set(SEQUENCES)
    size, seen = float(np.linalg.norm(BIAS)), 0
    for name, (delta, d) in measured.items():
        sequence = SEQUENCES[name]
        first, second, T = by_order(sequence, BIAS)
        # Eq. 20 is the first order in closed form.
        (closed,) = ideal_rotations([sequence], RATE_RAD_S).time
        quadrature = size * T * (math.pi / STEPS) ** 2
        np.testing.assert_allclose(first, cross_matrix(closed @ BIAS), rtol=0, atol=quadrature)
        u = np.eye(3)[d]
        level = np.eye(3) - np.outer(u, u)
        left = [np.linalg.norm(delta - level @ (order @ (-G * u))) for order in (first, first + second)]
        # Each rotation's ramps and what is left of its last sample add up to two ramps' time (see conftest); the
        # quadrature is of first and second order alike; rounding of a sum of g.
        n = len(sequence.angles_rad)
        exact = G * (size * (n + 4) * RAMP_S + 2.0 * quadrature) + 1e-12 * G
        x = size * T
        assert left[1] <= G * x**3 / 6.0 * math.exp(x) + exact, name
        assert left[0] <= G * x**2 / 2.0 * math.exp(x) + exact, name
        seen += left[0] > 5.0 * left[1]
    # The second order is there: without it most sequences are off by several times more. (Some have little of it.)
    assert seen > len(SEQUENCES) / 2


def test_the_remainder_after_the_first_order_is_quadratic(motion):
    """Half the bias leaves a quarter of it."""
    whole, half = horizontal(motion, BIAS), horizontal(motion, 0.5 * BIAS)
    size = float(np.linalg.norm(BIAS))
    for name, (delta, d) in whole.items():
        first, _, T = by_order(SEQUENCES[name], BIAS)
        rotations = len(SEQUENCES[name].angles_rad)
        u = np.eye(3)[d]
        level = -G * (np.eye(3) - np.outer(u, u))
        remainder, smaller = delta - level @ first @ u, half[name][0] - 0.5 * (level @ first @ u)
        x, exact = size * T, G * size * ((rotations + 4) * RAMP_S + 2.0 * T * (math.pi / STEPS) ** 2)
        # Beyond the second order: x³/6 of the whole, x³/48 of the half taken four times; times e^x for what follows.
        beyond = G * x**3 * (1.0 / 6.0 + 1.0 / 12.0) * math.exp(x)
        np.testing.assert_allclose(remainder, 4.0 * smaller, rtol=0, atol=beyond + 3.0 * exact + 5e-12 * G)


PAIRS = {"x": ("2", "2a", 1, 1.0), "y": ("1", "1a", 0, -1.0), "z": ("3", "3a", 1, -1.0)}


@pytest.mark.parametrize("axis", PAIRS)
def test_bias_of_a_reversed_pair_cancels_in_the_scale_factor_and_adds_to_the_asymmetry(motion, axis):
    """Eq. 13: the bias does not enter κii = ±(Δ − Δa) / 4πg; it adds κi / β̇ to κiii = ±(Δ + Δa) / 4πg."""
    forward, back, component, sign = PAIRS[axis]
    measured = horizontal(motion, BIAS)
    plus, minus = (measured[name][0][component] for name in (forward, back))
    scale, asymmetry = sign * (plus - minus) / (4.0 * math.pi * G), sign * (plus + minus) / (4.0 * math.pi * G)
    x = float(np.linalg.norm(BIAS)) * 2.0 * math.pi / RATE_RAD_S
    # Two sequences, each off by its second order and two ramps.
    left = 2.0 * (x**2 / 2.0 * math.exp(x) + float(np.linalg.norm(BIAS)) * 5 * RAMP_S) / (4.0 * math.pi)
    expected = BIAS["xyz".index(axis)] / RATE_RAD_S
    assert abs(scale) <= left
    assert abs(asymmetry - expected) <= left
    assert abs(expected) > 10.0 * left  # what cancels is there to be seen
