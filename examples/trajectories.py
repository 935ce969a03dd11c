"""An aircraft and a car: where they go, and what a faultless IMU on board measures.

A course is a table of steps in speed, heading and path angle, each as smooth as the polynomial :func:`smooth_step`, on
a standstill of 30 s. Attitude follows: an aircraft banks into its turns so that it feels no sideways force, a car leans
out of them, and both rock a little on top, a quarter of a period apart in roll and pitch, so that the IMU cones.

:func:`motion_of` leaves the rest to python-ins: trajectory, Earth, and the exact increments of rate and specific force.
It shares nothing with the rotation test or its simulator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import numpy as np

from srt.exceptions import InputError, MissingExtraError

if TYPE_CHECKING:
    from srt.types import Array


STANDSTILL_S: Final = 30.0
"""Rest at the start of every course, s: the biases are estimated in it."""
START_LLA: Final = (45.0, 10.0, 200.0)
"""Latitude and longitude, degrees, and altitude, m, of every course."""
ROCKING_SPEED_M_S: Final = 10.0
"""Speed at which a vehicle rocks with most of its amplitude; at rest it does not rock."""
G: Final = 9.81
"""Gravity of the bank angles, m/s²."""

Quantity = Literal["speed_m_s", "heading_deg", "path_deg"]


class SmoothChange(NamedTuple):
    """A smooth change of one quantity."""

    start_s: float
    duration_s: float
    quantity: Quantity
    change: float


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Course of a vehicle.

    Attributes
    ----------
    opening : tuple of SmoothChange
        Changes executed once; times count from the start of the course.
    cycle_start_s, cycle_s : float
        Start of the first cycle, and its length.
    cycle : tuple of SmoothChange
        Changes repeated in every cycle; times count from its start.
    roll_per_lateral_g : "balanced" or float, deg
        An aircraft banks into balanced turns; a car rolls outwards by this angle for each g of lateral acceleration.
    rocking_deg, rocking_hz : float
        Amplitude and frequency.
    """

    opening: tuple[SmoothChange, ...]
    cycle_start_s: float
    cycle_s: float
    cycle: tuple[SmoothChange, ...]
    roll_per_lateral_g: float | Literal["balanced"]
    rocking_deg: float
    rocking_hz: float


VEHICLES: Final = {
    "aircraft": Vehicle(
        opening=(
            SmoothChange(30.0, 25.0, "speed_m_s", 70.0),
            SmoothChange(52.0, 8.0, "path_deg", 5.0),
            SmoothChange(60.0, 60.0, "speed_m_s", 50.0),
            SmoothChange(280.0, 20.0, "path_deg", -5.0),
        ),
        cycle_start_s=300.0,
        cycle_s=500.0,
        cycle=(
            SmoothChange(0.0, 45.0, "heading_deg", 90.0),
            SmoothChange(60.0, 90.0, "heading_deg", -180.0),
            SmoothChange(160.0, 30.0, "speed_m_s", 40.0),
            SmoothChange(200.0, 10.0, "path_deg", -3.0),
            SmoothChange(215.0, 60.0, "heading_deg", 100.0),
            SmoothChange(280.0, 10.0, "path_deg", 3.0),
            SmoothChange(290.0, 30.0, "speed_m_s", -40.0),
            SmoothChange(325.0, 165.0, "heading_deg", 360.0),
        ),
        roll_per_lateral_g="balanced",
        rocking_deg=0.5,
        rocking_hz=0.4,
    ),
    "car": Vehicle(
        opening=(),
        cycle_start_s=STANDSTILL_S,
        cycle_s=240.0,
        cycle=(
            SmoothChange(0.0, 10.0, "speed_m_s", 13.0),
            SmoothChange(15.0, 12.0, "heading_deg", 90.0),
            SmoothChange(30.0, 10.0, "speed_m_s", 12.0),
            SmoothChange(42.0, 20.0, "heading_deg", -60.0),
            SmoothChange(65.0, 6.0, "path_deg", 3.0),
            SmoothChange(85.0, 6.0, "path_deg", -6.0),
            SmoothChange(105.0, 6.0, "path_deg", 3.0),
            SmoothChange(115.0, 12.0, "speed_m_s", -16.0),
            SmoothChange(130.0, 24.0, "heading_deg", 270.0),
            SmoothChange(160.0, 12.0, "heading_deg", -90.0),
            SmoothChange(180.0, 8.0, "speed_m_s", 8.0),
            SmoothChange(190.0, 12.0, "heading_deg", -90.0),
            SmoothChange(205.0, 10.0, "speed_m_s", -17.0),  # and stands for the rest of the cycle, as at traffic lights
        ),
        roll_per_lateral_g=-4.0,
        rocking_deg=0.3,
        rocking_hz=1.5,
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Kinematics of a vehicle.

    Attributes
    ----------
    time : ndarray, shape (n,), s
    velocity_n : ndarray, shape (n, 3), m/s
        North, east, down.
    roll_pitch_heading_deg : ndarray, shape (n, 3)
    """

    time: Array
    velocity_n: Array
    roll_pitch_heading_deg: Array


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A course with what a faultless IMU measures on it.

    Attributes
    ----------
    trajectory : pandas.DataFrame
        A Trajectory of python-ins: position, velocity and attitude at n + 1 times.
    interval_s : float
    angle, velocity : ndarray, shape (n, 3), rad and m/s
        Integrals of the rate relative to inertial space and of the specific force over the n intervals, body axes.
    """

    trajectory: Any
    interval_s: float
    angle: Array
    velocity: Array

    @property
    def time(self) -> Array:
        """Ends of the intervals, shape (n,), s."""
        return np.asarray(self.trajectory.index, dtype=np.float64)[1:]

    @property
    def still(self) -> slice:
        """Samples of the standstill at the start."""
        return slice(0, round(STANDSTILL_S / self.interval_s))


def smooth_step(u: Array) -> Array:
    """Rise from 0 to 1 over 0 ≤ u ≤ 1 with three continuous derivatives; 0 before and 1 after."""
    u = np.clip(u, 0.0, 1.0)
    return u**4 * (35.0 - u * (84.0 - u * (70.0 - 20.0 * u)))


def smooth_slope(u: Array) -> Array:
    """Derivative of :func:`smooth_step`; its peak is 35/16."""
    u = np.clip(u, 0.0, 1.0)
    return 140.0 * (u * (1.0 - u)) ** 3


def course_of(name: str, minutes: float, sample_rate_hz: float) -> Course:
    """Run a vehicle's table.

    Parameters
    ----------
    name : str
        A key of :data:`VEHICLES`.
    minutes : float
    sample_rate_hz : float

    Raises
    ------
    InputError
        An unknown vehicle, or a course that ends before its standstill.
    """
    if name not in VEHICLES:
        raise InputError(f"There is no vehicle {name!r}: the names are {', '.join(VEHICLES)}.")
    if not 60.0 * minutes > STANDSTILL_S:
        raise InputError(f"The course lasts {minutes:g} minutes, but the first {STANDSTILL_S:g} s are stood still.")
    vehicle = VEHICLES[name]
    time = np.arange(round(60.0 * minutes * sample_rate_hz) + 1) / sample_rate_hz
    cycles = max(math.ceil((time[-1] - vehicle.cycle_start_s) / vehicle.cycle_s), 0)
    starts = vehicle.cycle_start_s + vehicle.cycle_s * np.arange(cycles)
    steps = vehicle.opening + tuple(s._replace(start_s=s.start_s + start) for start in starts for s in vehicle.cycle)
    values = {q: np.zeros_like(time) for q in ("speed_m_s", "heading_deg", "path_deg")}
    heading_rate_deg_s = np.zeros_like(time)
    for start, duration, quantity, change in steps:
        u = (time - start) / duration
        values[quantity] += change * smooth_step(u)
        if quantity == "heading_deg":
            heading_rate_deg_s += change / duration * smooth_slope(u)
    speed, heading, path = values["speed_m_s"], np.radians(values["heading_deg"]), np.radians(values["path_deg"])
    level = speed * np.cos(path)
    lateral_g = level * np.radians(heading_rate_deg_s) / G
    phase = 2.0 * np.pi * vehicle.rocking_hz * time
    rocking = vehicle.rocking_deg * -np.expm1(-((speed / ROCKING_SPEED_M_S) ** 2))
    balanced = vehicle.roll_per_lateral_g == "balanced"
    roll = np.degrees(np.arctan(lateral_g)) if balanced else float(vehicle.roll_per_lateral_g) * lateral_g
    return Course(
        time,
        np.column_stack([level * np.cos(heading), level * np.sin(heading), -speed * np.sin(path)]),
        np.column_stack(
            [roll + rocking * np.sin(phase), values["path_deg"] + rocking * np.cos(phase), values["heading_deg"]]
        ),
    )


def pyins_modules() -> Any:
    """Import python-ins.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import pyins
    except ModuleNotFoundError as error:
        if error.name != "pyins":
            raise
        raise MissingExtraError("python-ins", "examples", "The navigation example") from None
    return pyins


def motion_of(course: Course) -> Motion:
    """Position and exact increments of a course, computed by python-ins."""
    pyins = pyins_modules()
    trajectory, imu = pyins.sim.generate_imu(
        course.time, START_LLA, course.roll_pitch_heading_deg, course.velocity_n, "increment"
    )
    # python-ins repeats the first increment, so that there are as many rows as times.
    increments = np.ascontiguousarray(imu.to_numpy(dtype=np.float64)[1:])
    interval = float(course.time[1] - course.time[0])
    return Motion(trajectory, interval, increments[:, :3].copy(), increments[:, 3:].copy())
