"""Intervals and gaps from stamps that are rounded, jittered and interrupted."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from srt.exceptions import InputError
from srt.recording.timing import sample_timing, stamp_resolution, stamped_interval

N = 5000


def stamps(dt, n=N, start=12.0):
    return start + dt * np.arange(n)


@pytest.mark.parametrize("dt", [0.005, 1 / 208, 1 / 300, 0.1])
def test_exact_stamps_give_one_interval(dt):
    timing = sample_timing(stamps(dt))
    assert isinstance(timing.interval_s, float)
    # stamps near 500 s carry 6e-14 s of rounding, spread over the recording
    assert timing.interval_s == pytest.approx(dt, rel=1e-12)
    assert timing.nominal_interval_s == timing.interval_s
    assert timing.gaps.size == 0


@pytest.mark.parametrize("rounding", [np.round, np.floor])
@pytest.mark.parametrize(
    ("dt", "unit"),
    [(1 / 208, 1e-6), (1 / 300, 1e-3), (1 / 400, 1e-3), (1 / 800, 1e-3), (1 / 104, 1e-3), (1 / 833, 1e-4)],
)
def test_rounded_stamps_give_one_interval_not_noise(dt, unit, rounding):
    timing = sample_timing(rounding(stamps(dt) / unit) * unit)
    assert isinstance(timing.interval_s, float)
    assert timing.gaps.size == 0
    # Stamps off by one unit at most tilt a line over N samples by no more than 1.5 unit / N.
    assert abs(timing.interval_s - dt) < 1.5 * unit / N


def test_true_jitter_is_believed_stamp_by_stamp():
    time = stamps(0.01) + np.random.default_rng(5).uniform(-0.002, 0.002, N)
    time[3000:] += 7.0
    timing = sample_timing(time)
    assert timing.gaps.tolist() == [3000]
    expected = np.diff(time, prepend=np.nan)
    expected[[0, 3000]] = timing.nominal_interval_s
    np.testing.assert_array_equal(timing.interval_s, expected)
    # 1.2e-3 s of rms jitter over 3000 samples: the slope's sigma is sqrt(12) 1.2e-3 / 3000^1.5 = 2.5e-8 s
    assert timing.nominal_interval_s == pytest.approx(0.01, abs=1.5e-7)
    assert not timing.interval_s.flags.writeable


def test_jitter_up_to_two_percent_counts_as_rounding():
    jitter = np.random.default_rng(5).uniform(-0.018, 0.018, N)
    assert isinstance(sample_timing(stamps(0.01) + 0.01 * jitter).interval_s, float)
    assert not isinstance(sample_timing(stamps(0.01) + 0.02 * jitter).interval_s, float)


@given(
    lengths=st.lists(st.integers(2, 60), min_size=1, max_size=8),
    gap=st.floats(2.0, 1e6),
    dt=st.floats(1e-4, 0.1),
    unit=st.sampled_from([1e-9, 1e-6]),
)
def test_pieces_of_any_length_share_one_interval(lengths, gap, dt, unit):
    """But for samples that are often lost one by one: such stamps may be those of a lower rate, rounded to a step."""
    steps, gaps = sum(lengths) - 1, len(lengths) - 1
    assume(gap > 2.02 or steps <= 100 or gaps <= 0.05 * steps)
    pieces, start = [], 0.0
    for length in lengths:
        pieces.append(start + dt * np.arange(length))
        start = pieces[-1][-1] + gap * dt
    time = np.round(np.concatenate(pieces) / unit) * unit
    timing = sample_timing(time)
    assert isinstance(timing.interval_s, float)
    assert timing.gaps.tolist() == np.cumsum(lengths)[:-1].tolist()
    assert timing.interval_s == pytest.approx(dt, abs=2 * unit + 1e-12 * start)


def test_a_given_rate_overrides_the_stamps():
    time = stamps(0.01) + np.random.default_rng(5).uniform(-0.004, 0.004, N)
    timing = sample_timing(time, 100.0)
    assert timing.interval_s == 0.01
    assert timing.gaps.size == 0


@pytest.mark.parametrize("kind", ["even", "rounded", "jitter", "bursts", "late once", "gaps", "slow clock"])
def test_interval_of_stamps_lies_within_its_precision(kind):
    """Arrival times of a host: bursts of ten, one of them late by half a second, and a clock that is slewed."""
    rng, true = np.random.default_rng(20261128), stamps(0.01, 20_000)
    index, gaps = np.arange(true.size), np.array([], dtype=int)
    time = {
        "rounded": np.floor(true * 1e3) / 1e3,
        "jitter": true + rng.uniform(-0.004, 0.004, true.size),
        "bursts": true[index // 10 * 10 + 9] + 1e-5 * (index % 10) + rng.uniform(0.0, 0.02, 2000)[index // 10],
        "late once": true + 0.5 * (index // 10 == 1234),
        "gaps": true + 60.0 * (index // 700) + rng.uniform(-0.004, 0.004, true.size),
        "slow clock": true + 3e-3 * np.sin(true / 40.0),
    }.get(kind, true)
    if kind == "gaps":
        gaps = np.arange(700, true.size, 700)
    interval, largest = stamped_interval(time, gaps)
    assert abs(interval - 0.01) <= largest
    # Of 0.5 s late in one part of 20 s, a slope of 6 * 10 * 0.5 / 2000² at most; a tenth of it, Student's factor 10.
    assert largest < {"even": 1e-12, "rounded": 7.5e-7}.get(kind, 7.5e-6)
    assert stamped_interval(time[:50], gaps[:0])[1] == np.inf


def test_with_a_given_rate_lost_samples_are_gaps_but_bursts_are_not():
    late = np.ceil(np.arange(N) / 10) * 0.1 + 1e-5 * (np.arange(N) % 10)  # ten samples arrive at once
    time = np.sort(late)
    assert sample_timing(time, 100.0).gaps.size == 0
    time[2500:] += 0.5
    assert len(sample_timing(time, 100.0).gaps) == 1
    assert sample_timing(np.delete(stamps(0.01), 77), 100.0).gaps.tolist() == [77]


@pytest.mark.parametrize("rate", [10.0, 50.0, 200.0, 1e5])
def test_a_rate_that_contradicts_the_stamps_is_refused(rate):
    with pytest.raises(InputError, match=r"sample_rate_hz is .* advance by 0\.01 s per sample"):
        sample_timing(stamps(0.01), rate)


@pytest.mark.parametrize(
    ("time", "unit"),
    [
        (np.arange(3.0), 1.0),
        (0.1 * np.arange(3000), 0.1),
        (0.001 * np.arange(17, 90_000, 7), 0.001),
        (1e-6 * np.arange(10**9, 10**9 + 500), 1e-6),
    ],
)
def test_resolution_of_decimal_stamps(time, unit):
    assert stamp_resolution(time) == pytest.approx(unit)


def test_resolution_of_other_stamps_is_that_of_floats():
    assert stamp_resolution(np.sqrt(np.arange(2.0, 900.0))) < 1e-13
    # one stamp off the grid is enough
    time = 0.001 * np.arange(5000)
    time[1234] += 2e-4
    assert stamp_resolution(time) == pytest.approx(1e-4)


@pytest.mark.parametrize("interval_ms", [5.0, 4.6, 7.3])
def test_stamps_of_a_clock_of_4_ms(interval_ms):
    """An autopilot's log: steps of whole ticks. Each lost sample and gap is found, and the interval to 1e-5."""
    rng, interval = np.random.default_rng(int(10 * interval_ms)), 1e-3 * interval_ms
    true = interval * np.arange(1, 40_001)
    keep = rng.random(true.size) > 1.0 / 400.0
    keep[[0, -1]] = True
    for at in rng.uniform(0.0, true[-1], 7):
        keep[(true > at) & (true < at + rng.uniform(0.05, 0.5))] = False
    timing = sample_timing(np.round(true[keep] / 0.004) * 0.004)
    lost = np.flatnonzero(np.diff(np.flatnonzero(keep)) > 1) + 1
    # A slope through pieces of some hundred samples, each with stamps late by 4 ms / sqrt(12) at random.
    assert timing.nominal_interval_s == pytest.approx(interval, rel=1e-4)
    assert np.ndim(timing.interval_s) == 0
    # Beside a lost sample or the first one, some may be told twice: within ten samples all delays have occurred.
    assert set(lost) <= set(timing.gaps)
    beside = np.abs(timing.gaps[:, None] - np.append(lost, 0)).min(axis=1)
    assert beside.max() <= 10


def test_samples_lost_at_random_are_no_coarse_clock():
    """A quarter of the samples of 4 ms are lost: the interval is 4 ms, and each step of 8 ms or more is a gap."""
    rng = np.random.default_rng(2)
    time = 0.004 * np.flatnonzero(rng.random(20_000) > 0.25)
    timing = sample_timing(time)
    assert timing.nominal_interval_s == pytest.approx(0.004)
    np.testing.assert_array_equal(timing.gaps, np.flatnonzero(np.diff(time) > 0.006) + 1)
