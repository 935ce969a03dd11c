"""Faults of the stated site and of the temperature, and drift, noise and scale-factor asymmetry of the unit."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from injected_faults.changes import low_passed, moved_labels, per_sample, sign
from injected_faults.injection import GRADES, Case, injection
from sims.physics.imu import ImuModel, read_out
from sims.physics.true_motion import TrueMotion
from srt.constants import DEG, DEG_PER_H, MICRO_G, normal_gravity_m_s2
from srt.estimation.options import Options
from srt.recording.recording import Recording
from srt.types import Array

_ANOMALY_M_S2: Final = 5e-4
"""Standard deviation of a gravity anomaly, m/s²: the uncertainty of normal gravity."""
_HEIGHT_M: Final = 200.0
"""Largest height above sea level of the place whose latitude is stated, m."""

_NO_LATITUDE = (
    "A g-sensitivity of 180 °/h/g masks the vertical component of the Earth rate. With a bias instability of 20 °/h, "
    "the sigma of the horizontal component is 6 °/h, but the component itself is only 0 to 15 °/h at any latitude."
)
_NO_NORTH = (
    "With a bias instability of 20 °/h, the sigma of the horizontal component of the Earth rate is 6 °/h. Even a "
    "heading that is wrong by 180° changes this component by only 21 °/h, which is 3.3 sigma; detection needs 7 sigma."
)


@injection("gravity", 0.025, "m/s²")
def gravity(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The stated gravity is that of another place, or has a wrong digit."""
    site = case.recording.site
    stated = site.gravity_m_s2 + severity * sign(rng)
    return replace(case.recording, site=replace(site, gravity_m_s2=stated))


@injection(
    "earth_rate_absent", 1.0, "", unseen={"consumer-mems": _NO_LATITUDE.replace("at any latitude", "by latitude")}
)
def earth_rate_absent(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit subtracts the mean gyro reading of each stationary window, from that window until the next one."""
    recording = case.recording
    gyro = recording.gyro.copy()
    spans = [span for s in recording.sequences for span in (s.start_static_s, s.end_static_s)]
    windows = sorted((w.start, w.stop) for w in (recording.window_indices(*span) for span in spans))
    for (start, stop), following in zip(windows, [*(w[0] for w in windows[1:]), len(gyro)], strict=True):
        gyro[start:following] -= recording.gyro[start:stop].mean(axis=0)
    return replace(recording, gyro=gyro)


@injection(
    "latitude",
    {"navigation-rlg": 2.0, "tactical-fog": 45.0, "industrial-mems": 45.0},
    "°",
    unseen={"consumer-mems": _NO_LATITUDE},
)
def latitude(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The stated latitude and gravity are those of another place."""
    true = case.scenario.site.latitude_deg
    stated = true + severity * sign(rng)
    if abs(stated) > 90.0:
        stated = true - math.copysign(severity, stated)
    gravity_m_s2 = normal_gravity_m_s2(stated * DEG, rng.uniform(0.0, _HEIGHT_M))
    site = replace(
        case.recording.site, latitude_rad=stated * DEG, gravity_m_s2=gravity_m_s2, gravity_sigma_m_s2=_ANOMALY_M_S2
    )
    return replace(case.recording, site=site)


@injection(
    "north",
    {"navigation-rlg": 2.0, "tactical-fog": 90.0, "industrial-mems": 90.0},
    "°",
    unseen={"consumer-mems": _NO_NORTH},
)
def north(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The stated heading is that of a magnetic compass, or that of the wrong axis of the table."""
    fixture = case.recording.fixture
    assert fixture is not None
    assert fixture.heading_rad is not None
    off = severity * DEG * sign(rng)
    return replace(case.recording, fixture=replace(fixture, heading_rad=fixture.heading_rad + off))


def _temperatures(case: Case, start_c: float, rise_c: float, rng: np.random.Generator) -> Array:
    """Temperature of the circuit board, °C: approaches its final value exponentially; the resolution is 1/16 °C."""
    time = case.recording.time - case.recording.time[0]
    slowness = rng.uniform(0.3, 1.5) * time[-1]
    shape = np.expm1(-time / slowness) / np.expm1(-time[-1] / slowness)
    noise = 0.05 * rng.standard_normal(time.size)
    out: Array = np.round((start_c + rise_c * shape + noise) * 16.0) / 16.0
    return out


@injection("temperature_unit", 45.0, "°C, in K or °F")
def temperature_unit(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The temperature is in K or °F instead of °C."""
    celsius = _temperatures(case, severity, rng.uniform(-1.0, 1.0), rng)
    other = (celsius + 273.15, 1.8 * celsius + 32.0)[int(rng.integers(2))]
    return replace(case.recording, temperature=other)


@injection("temperature_drift", 6.0, "°C")
def temperature_drift(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The unit warms up during the test, or cools down after a temperature chamber."""
    start = rng.uniform(15.0, 40.0)
    return replace(case.recording, temperature=_temperatures(case, start, severity * sign(rng), rng))


def _drift(time: Array, rng: np.random.Generator) -> Array:
    """Share of a drift after switch-on, linear or with a decreasing rate: 0 at the first sample, 1 at the last."""
    share = (time - time[0]) / (time[-1] - time[0])
    if rng.random() < 0.5:
        slowness = rng.uniform(0.4, 1.5)
        share = np.expm1(-share / slowness) / np.expm1(-1.0 / slowness)
    return np.asarray(share)


@injection(
    "gyro_bias_drift",
    {"navigation-rlg": 0.3, "tactical-fog": 30.0, "industrial-mems": 30.0, "consumer-mems": 600.0},
    "°/h",
)
def gyro_bias_drift(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The bias of one gyro drifts after switch-on, linearly or with a decreasing rate."""
    motion = case.simulation.motion
    share = _drift(motion.time, rng)
    angle = motion.angle.copy()
    angle[:, int(rng.integers(3))] += sign(rng) * severity * DEG_PER_H * motion.interval * share
    return _again(case, replace(motion, angle=angle), case.simulation.imu, rng)


@injection("units_joined", 1.0, "")
def units_joined(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The recording joins the first sequences of one unit and the last sequences of another unit of the same grade."""
    first, second = case.recording, Case(case.grade, case.seed + 7_000_000, case.changes).recording
    count = int(rng.integers(5, len(first.sequences) - 4))
    end, begin = first.sequences[count - 1].end_static_s[1], second.sequences[count].start_static_s[0]
    rows, others = first.time <= end + 1e-6, second.time > begin + 1e-6
    later = end + rng.uniform(20.0, 200.0) - begin
    moved = moved_labels(second.sequences[count:], lambda time: time + later)
    return replace(
        first,
        time=np.concatenate([first.time[rows], second.time[others] + later]),
        gyro=np.concatenate([first.gyro[rows], second.gyro[others]]),
        accel=np.concatenate([first.accel[rows], second.accel[others]]),
        sequences=first.sequences[:count] + moved,
    )


@injection("gyro_scale_drift", 3000.0, "ppm")
def gyro_scale_drift(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The scale factors of all gyros change by the same relative amount, linearly in time."""
    recording, time = case.recording, case.recording.time
    share = (time - time[0]) / (time[-1] - time[0])
    factor = 1.0 + 1e-6 * severity * sign(rng) * share[:, np.newaxis]
    return replace(recording, gyro=recording.gyro * factor)


@injection(
    "accel_bias_drift",
    {"navigation-rlg": 0.2, "tactical-fog": 4.0, "industrial-mems": 8.0, "consumer-mems": 100.0},
    "mg",
)
def accel_bias_drift(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The bias of one accelerometer drifts after switch-on, linearly or with a decreasing rate."""
    share = _drift(case.recording.time, rng)
    accel = case.recording.accel.copy()
    unit = per_sample(case.recording)
    accel[:, int(rng.integers(3))] += sign(rng) * severity * 1e3 * MICRO_G * share * unit
    return replace(case.recording, accel=accel)


@injection("accel_settling", dict(zip(GRADES, (50.0, 500.0, 500.0, 1500.0), strict=True)), "ppm")
def accel_settling(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """A share of the accelerometer readings follows a change of specific force with a time constant of 3 s."""
    motion = case.simulation.motion
    share = sign(rng) * 1e-6 * severity
    velocity = motion.velocity.copy()
    for piece in np.split(np.arange(len(velocity)), motion.piece_starts[1:]):
        true = motion.velocity[piece]
        velocity[piece] += share * (low_passed(true, motion.interval, 3.0) - true)
    return _again(case, replace(motion, velocity=velocity), case.simulation.imu, rng)


@injection(
    "gyro_noise",
    {"navigation-rlg": 3.0, "tactical-fog": 2.0, "industrial-mems": 2.0, "consumer-mems": 2.0},
    "times",
)
def gyro_noise(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The gyros are noisier than stated, or the stated noise is too large."""
    return _noise(case, "gyro_noise", severity, rng)


@injection("accel_noise", 2.0, "times")
def accel_noise(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """The accelerometers are noisier than stated, or the stated noise is too large."""
    return _noise(case, "accel_noise", severity, rng)


def _noise(case: Case, name: str, factor: float, rng: np.random.Generator) -> Recording:
    imu, recording = case.simulation.imu, case.recording
    larger = factor * getattr(imu, name)
    if rng.random() < 0.5:
        return _again(case, case.simulation.motion, replace(imu, **{name: larger}), rng)
    return replace(recording, noise=replace(recording.noise, **{name: larger}))


@injection(
    "asymmetry_omitted",
    {"navigation-rlg": 10.0, "tactical-fog": 300.0, "industrial-mems": 200.0, "consumer-mems": 1500.0},
    "ppm",
    options=Options(asymmetry=False),
)
def asymmetry_omitted(case: Case, severity: float, rng: np.random.Generator) -> Recording:
    """One gyro has an asymmetry that is large for its grade; the others have none."""
    values = dict.fromkeys(("gyro_asymmetry_x", "gyro_asymmetry_y", "gyro_asymmetry_z"), 0.0)
    values[f"gyro_asymmetry_{'xyz'[int(rng.integers(3))]}"] = 1e-6 * severity * sign(rng)
    return case.changed(errors={"values": values}).recording


def _again(case: Case, motion: TrueMotion, imu: ImuModel, rng: np.random.Generator) -> Recording:
    """Recording of another motion or unit model, with new noise samples; the stated noise is unchanged."""
    again = read_out(motion, case.simulation.truth, imu, rng, kind=case.recording.kind)
    return replace(case.recording, gyro=again.gyro, accel=again.accel)
