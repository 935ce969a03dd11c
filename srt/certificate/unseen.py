"""What a test of rests and turns cannot see, said of the test that there was."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srt.sensor_errors import GROUP_SLICES, NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srt.certificate.replay import Course
    from srt.result.calibration import Calibration


def unseen(calibration: Calibration, course: Course | None) -> tuple[str, ...]:
    """List what the test cannot see.

    Parameters
    ----------
    calibration : Calibration
    course : Course or None
        Names the fastest turn, if there is a recording.
    """
    return tuple(_sentences(calibration, course))


def _sentences(calibration: Calibration, course: Course | None) -> Iterator[str]:
    if calibration.held:
        count = len(calibration.held)
        yield f"{count} parameters were not measured: what stands in their place was there before the test."
    if not {*NAMES[GROUP_SLICES["accel_asymmetry"]]} <= set(calibration.held):
        yield (
            "Accelerometers were seen at no more than 1 g. An asymmetry and a quadratic term look the same there, and "
            "beyond 1 g the two part."
        )
    else:
        yield "Accelerometers were seen at no more than 1 g: a quadratic term is not known, and grows beyond 1 g."
    fastest = "" if course is None else f" (up to {course.turned_deg_s:.3g} °/s)"
    yield (
        f"Gyros were seen at the rates of the turns{fastest}: a scale factor that depends on the rate, near zero or "
        "beyond, is not known."
    )
    known = calibration.temperature
    yield (
        "The temperature of the test was not recorded, and what changes with temperature is not known."
        if known is None
        else f"What changes with temperature: the test was made at {known['mean_c']:.1f} °C, within "
        f"{known['range_c']:.1f} °C."
    )
    yield (
        "Dependence of the gyros on acceleration, and of all sensors on vibration, pressure, supply and magnetic "
        "field: no parameter stands for it, and part of it would be in the values."
    )
    yield (
        "Delays and bandwidth of the sensors, and where in the unit the accelerometers sit: the unit stands still when "
        "specific force is taken."
    )
    yield (
        "What changes from one switching-on to the next, or with age, beyond what the sigmas of the biases hold."
        if calibration.provenance.get("recordings")
        else "What changes from one switching-on to the next, or with age: this is one test on one day."
    )
    yield (
        "How the MARS axes lie in the unit's housing: "
        + (
            "U leads to the axes of the table only, as well as the unit was mounted on it."
            if calibration.U is not None
            else "there is no reference for it in this test."
        )
    )
    if calibration.site.get("latitude_deg") is None:
        yield "The Earth's rate: without a latitude it stays in the gyro biases, whose sigmas hold it."
    yield ("Gravity is taken as stated: an error of it is an error of all accelerometer scale factors alike.")
