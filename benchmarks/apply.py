"""CPU time of the correction of readings: arrays, relative to one matrix product, and single samples.

``python benchmarks/apply.py`` on one core; a sample is three gyros and three accelerometers.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import time
from collections.abc import Callable

import numpy as np

from srt.model.rotations import rotation_matrix
from srt.model.sensor_model import accel_triad, gyro_triad
from srt.result.applier import Applier
from srt.result.calibration import Calibration
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors

REPEATS = 25
"""Repeats of each timing; figures are medians."""
G = 9.80665
"""Standard gravity, m/s²."""


def medians(calls: dict[str, Callable[[], object]], repeats: int = REPEATS) -> dict[str, float]:
    """Median CPU time of each call, s; the calls take turns, so that other load affects all of them alike."""
    spans: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(repeats):
        for name, call in calls.items():
            began = time.process_time()
            call()
            spans[name].append(time.process_time() - began)
    return {name: float(np.median(span)) for name, span in spans.items()}


def unit(sigma: float, *, asymmetry: bool = True) -> Calibration:
    vector = np.random.default_rng(1).normal(0.0, sigma, N_PARAMETERS)
    if not asymmetry:
        vector[GROUP_SLICES["gyro_asymmetry"]] = vector[GROUP_SLICES["accel_asymmetry"]] = 0.0
    U = rotation_matrix(np.array([0.1, -0.2, 0.15]))
    return Calibration("", "converged", "", SensorErrors(vector), np.eye(N_PARAMETERS) * 1e-8, U=U)


def steady(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A vehicle: slow turns about every axis, gravity, 100 s at a time on one side of zero."""
    t = np.arange(n) / 200.0
    rate = 0.3 * np.sin(2.0 * np.pi * t[:, None] / (200.0, 400.0, 600.0))
    return rate, np.column_stack([rate[:, 0], rate[:, 1], np.full(n, -G)])


def random(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Every sample in an octant of its own: the worst there is."""
    rng = np.random.default_rng(2)
    return rng.normal(size=(n, 3)), G * rng.normal(size=(n, 3))


def arrays(n: int) -> None:
    print(f"arrays of {n} samples, given out=")
    for title, calibration, true in (
        ("slow motion, 1 % errors", unit(0.01), steady(n)),
        ("slow motion, no asymmetry", unit(0.01, asymmetry=False), steady(n)),
        ("random signs, 1 % errors", unit(0.01), random(n)),
        ("random signs, 15 % errors", unit(0.15), random(n)),
    ):
        gyro, accel = gyro_triad(calibration.errors).read(true[0]), accel_triad(calibration.errors).read(true[1])
        out = np.empty_like(gyro), np.empty_like(accel)
        matrix = gyro_triad(calibration.errors).matrix
        mars, table = Applier(calibration), Applier(calibration, frame="table")
        span = medians(
            {
                "product": lambda gyro=gyro, matrix=matrix, out=out: np.matmul(gyro, matrix, out=out[0]),
                "MARS": lambda a=mars, y=(gyro, accel), out=out: a.apply(*y, out=out),
                "table": lambda a=table, y=(gyro, accel), out=out: a.apply(*y, out=out),
                "increments": lambda a=mars, y=(gyro, accel), out=out: a.apply(*y, dt=0.005, out=out),
            }
        )
        product = span.pop("product")
        costs = ", ".join(f"{name} {s / n * 1e9:.0f} ns (ratio {s / product:.1f})" for name, s in span.items())
        print(f"  {title}: {costs}; one (n, 3) @ (3, 3) product {product / n * 1e9:.1f} ns")


def single() -> None:
    calibration, count = unit(0.01), 20_000
    mars, table = Applier(calibration), Applier(calibration, frame="table")
    lists = [0.1, -0.2, 0.3], [1.0, 2.0, -9.0]
    given = tuple(np.array(v) for v in lists)
    out = np.empty(3), np.empty(3)

    def loop(call: Callable[[], object]) -> Callable[[], None]:
        def run() -> None:
            for _ in range(count):
                call()

        return run

    span = medians(
        {
            "lists": loop(lambda: mars.apply_sample(*lists)),
            "lists, table frame": loop(lambda: table.apply_sample(*lists)),
            "lists, increment": loop(lambda: mars.apply_sample(*lists, dt=0.005)),
            "arrays, out=": loop(lambda: mars.apply_sample(*given, out=out)),
            "for comparison, two products of numpy": loop(lambda: (mars_matrix @ given[0], mars_matrix @ given[1])),
        },
        repeats=9,
    )
    print("one sample at a time: " + ", ".join(f"{name} {s / count * 1e6:.2f} µs" for name, s in span.items()))


def others() -> None:
    calibration, n = unit(0.01), 20_000
    applier, readings = Applier(calibration), random(n)
    one = np.zeros(3)
    span = medians(
        {
            "making": lambda: Applier(calibration),
            "call": lambda: calibration.apply(one, one),
            "covariance": lambda: applier.sample_covariance(*readings),
        }
    )
    print(
        f"making an Applier {span['making'] * 1e6:.0f} µs, "
        f"Calibration.apply of one sample {span['call'] * 1e6:.0f} µs, "
        f"covariance {span['covariance'] / n * 1e6:.2f} µs per sample"
    )


mars_matrix = gyro_triad(unit(0.01).errors).matrix

if __name__ == "__main__":
    arrays(1_000_000)
    arrays(4096)
    single()
    others()
