"""Wrong units, clipped readings and interruptions: told apart from a unit that is merely far off."""

import math

import numpy as np
import pytest

from srt.exceptions import DataError
from srt.recording.recording import ImuNoise, Recording, Site
from srt.sequences.clipping import clipped_samples
from srt.sequences.plausibility import check_interval, check_rest, check_turns

G = 9.80665
DT = 0.01
POSES = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]) * G
LABELS = [f"window {i}" for i in range(1, 7)]


def sentence(check, *args, **kwargs):
    with pytest.raises(DataError) as caught:
        check(*args, **kwargs)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 1
    return str(caught.value)


@pytest.mark.parametrize("seed", range(20))
def test_half_of_scale_and_a_metre_of_bias_are_legal(seed):
    rng = np.random.default_rng(seed)
    scale = 1.0 + rng.uniform(-0.5, 0.5, 3)
    check_rest(POSES * scale + rng.uniform(-1.0, 1.0, 3), G, lambda: LABELS, interval_s=DT)
    check_turns(2 * math.pi * scale * [1, -1, 1], 2 * math.pi * np.array([1, -1, 1]), LABELS, interval_s=DT)


@pytest.mark.parametrize("ratio", [0.19, 0.3, 1.89, 2.05])
def test_accelerometers_with_errors_of_80_percent_are_legal(ratio):
    check_rest(POSES * ratio, G, lambda: LABELS, interval_s=DT)


@pytest.mark.parametrize("ratio", [0.3, 2.0])
def test_rotations_of_a_third_or_twice_the_label_are_refused(ratio):
    turns = 2 * math.pi * np.array([1, -1, 1])
    with pytest.raises(DataError):
        check_turns(ratio * turns, turns, LABELS, interval_s=DT)


@pytest.mark.parametrize(
    ("factor", "kwargs", "fragment"),
    [
        (1 / G, {}, "look like g, declared as m/s²"),
        (G, {}, "look like m/s², declared as g"),
        (1e3 / G, {}, "look like mg, declared as m/s²"),
        (1e3, {}, "look like mg, declared as g"),
        (1e-3, {}, "look like g, declared as mg"),
        (1e-3 * G, {}, "look like m/s², declared as mg"),
        (1e3, {}, "look like mm/s², declared as m/s²"),
        (1 / 0.3048, {}, "look like ft/s²"),
        (20000.0, {}, "look like counts"),
        (0.005, {"interval_s": 0.005}, "increments per sample, declared as rates"),
        (200.0, {"interval_s": 0.005}, "look like rates, declared as increments"),
        # at 10 Hz an increment and a value in g look alike: both are named
        (0.1, {"interval_s": 0.1}, "declared as m/s²"),
        (0.1, {"interval_s": 0.1}, "declared as rates"),
        (0.0, {}, "hold nothing"),
        (0.03, {}, "no known unit"),
    ],
)
@pytest.mark.parametrize("error", [0.75, 1.0, 1.3])
def test_a_wrong_accelerometer_unit_is_named(factor, kwargs, fragment, error):
    message = sentence(check_rest, POSES * factor * error, G, lambda: LABELS, **kwargs)
    assert fragment in message
    assert "6 of 6 windows, first window 1" in message
    assert "about 9.807 is expected" in message


def test_one_window_off_is_no_unit():
    means = POSES.copy()
    means[3] *= 4.0
    message = sentence(check_rest, means, G, lambda: LABELS)
    assert "window 4: the accelerometers read 39.23 m/s²" in message
    assert "1 of 6 windows" in message
    assert "unit moved" in message


@pytest.mark.parametrize(
    ("factor", "kwargs", "fragment"),
    [
        (180 / math.pi, {}, "degrees, declared as radians"),
        (math.pi / 180, {}, "radians, declared as degrees"),
        (180 / math.pi * 3600, {}, "deg/h, declared as rad/s"),
        (math.pi / 180 / 3600, {}, "rad/s, declared as deg/h"),
        (3600.0, {}, "deg/h, declared as deg/s"),
        (1 / 3600, {}, "deg/s, declared as deg/h"),
        (60 / (2 * math.pi), {}, "revolutions per minute"),
        (0.005, {"interval_s": 0.005}, "increments per sample"),
        (200.0, {"interval_s": 0.005}, "rates, declared as increments"),
        (1e6, {}, "counts"),
        (0.0, {}, "hold nothing"),
    ],
)
@pytest.mark.parametrize("error", [0.8, 1.0, 1.25])
def test_a_wrong_gyro_unit_is_named(factor, kwargs, fragment, error):
    turns = np.array([2 * math.pi, -2 * math.pi, math.pi])
    message = sentence(check_turns, turns * factor * error, turns, LABELS, **kwargs)
    assert fragment in message
    assert "360° is stated" in message


def test_one_turn_off_is_a_wrong_label():
    turns = np.array([2 * math.pi, math.pi, -math.pi, math.pi])
    found = turns.copy()
    found[2] = math.pi
    message = sentence(check_turns, found, turns, LABELS)
    assert "window 3: the gyros turned by 180°, but -180° is stated (1 of 4 turns)" in message
    assert "the other way" in message
    found[2] = 0.01
    assert "correct its id, its windows" in sentence(check_turns, found, turns, LABELS)


def recording(gyro, accel=None, *, dt=DT, time=None, **fields):
    n = len(gyro)
    time = dt * np.arange(1, n + 1) if time is None else time
    accel = np.random.default_rng(2).normal([0, 0, G], 0.01, (n, 3)) if accel is None else accel
    return Recording(time, gyro, accel, Site(G), **fields)


def turning(peak=3.0, sigma=1e-3, n=3000):
    """Stillness, one smooth turn about z, stillness."""
    gyro = np.zeros((n, 3))
    gyro[1000:2000, 2] = peak * np.sin(np.pi * np.arange(1000) / 1000)
    return gyro + sigma * np.random.default_rng(1).standard_normal((n, 3))


@pytest.mark.parametrize("kind", ["rate", "increment"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_clipping_shows_by_repeated_extremes(kind, sign):
    per_sample = DT if kind == "increment" else 1.0
    gyro = sign * np.minimum(turning(), 2.5) * per_sample
    clipped = recording(gyro, np.random.default_rng(2).normal(0, G, (3000, 3)) * per_sample, kind=kind)
    (found,) = clipped_samples(clipped, slice(900, 2100))
    assert found.channel == "gyro_z"
    at = np.flatnonzero(np.abs(gyro[:, 2]) == 2.5 * per_sample)
    assert (found.count, found.first_s) == (at.size, clipped.time[at[0]])
    assert str(found).startswith(f"gyro_z is at the limit of its range in {at.size} samples, from ")
    assert clipped_samples(clipped, slice(0, 900)) == ()


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_a_stated_range_is_believed(kind):
    per_sample = DT if kind == "increment" else 1.0
    gyro = turning(peak=3.0, sigma=0.0) * per_sample
    noise = ImuNoise(gyro_range=3.0, accel_range=2 * G)
    accel = np.tile([0.0, 0.0, G], (3000, 1)) * per_sample
    accel[50, 0] = -2 * G * per_sample
    clipped = recording(gyro, accel, kind=kind, noise=noise)
    found = clipped_samples(clipped, slice(0, 3000))
    assert [c.channel for c in found] == ["gyro_z", "accel_x"]
    assert (found[1].count, found[1].first_s) == (1, pytest.approx(0.51))
    wide = recording(gyro, accel, kind=kind, noise=ImuNoise(gyro_range=3.1, accel_range=3 * G))
    assert clipped_samples(wide, slice(0, 3000)) == ()


def test_gaps_inside_a_part():
    time = DT * np.arange(1.0, 3001.0)
    time[1000:] += 5.0
    time[2000:] += 5.0
    broken = recording(turning(), time=time)
    assert broken.gaps_inside([(0, 3000), (1000, 2000), (999, 2000), (1000, 2001)]).tolist() == [1000, -1, 1000, 2000]


@pytest.mark.parametrize("dt", [1e-7, 10.0])
def test_an_interval_no_imu_has_is_refused(dt):
    check_interval(recording(turning()))
    assert "time unit" in sentence(check_interval, recording(turning(), dt=dt))
