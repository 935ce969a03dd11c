"""Speed of single parts for ``speed.py``: correction of readings, inspection, units as arrays, large results."""

import resource
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import accuracy_trials
import numpy as np
import pyarrow as pa
import robustness
from numpy_load import Row, beside_load, cpu_time, numpy_load
from pyarrow import parquet

import sims
import srt
from sims.physics.imu import ImuModel, read_out
from sims.physics.table_motion import table1_motion
from sims.robustness.result_folder import ResultFolder
from sims.robustness.summary import summarise
from srt.cli.robustness import header_of
from srt.closed_form.formulas import SelectedFormulas
from srt.closed_form.iteration import iterate_units
from srt.comparison.fleet import FleetUnit, assemble_fleet
from srt.constants import DEG_PER_SQRT_H, MICRO_G
from srt.diagnosis import diagnose
from srt.diagnosis.inspection import inspect
from srt.estimation.initial_estimates import initial_estimate
from srt.estimation.options import Options
from srt.model.platform_steps import many_recordings
from srt.model.rotations import rotation_matrix
from srt.model.sensor_model import gyro_triad, outside_model
from srt.recording.recording import Fixture, Recording, Site
from srt.reports.figures.inspection import inspection_figure
from srt.reports.text.fleet import fleet_text
from srt.result.applier import Applier
from srt.result.calibration import Calibration
from srt.result.diagnostics import Diagnostics
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Provenance
from srt.sensor_errors import GROUP_SLICES, N_PARAMETERS, SensorErrors
from srt.sequences.checked_preparation import prepare_checked
from srt.sequences.prepared_units import together
from srt.sequences.recognition import recognise

LARGEST_ERRORS = {
    "gyro_scale": 0.5, "gyro_asymmetry": 0.01, "gyro_orthogonality": 0.3, "accel_bias": 1.0, "accel_scale": 0.5,
    "accel_asymmetry": 0.01, "accel_misalignment": 0.3, "gyro_bias": 0.02,
}  # fmt: skip
"""Largest sensor errors of the units that are calibrated as arrays, SI."""
PART = 1000
"""Rows of a part of the results, as a campaign writes them."""


def calibration(sigma: float = 0.01) -> Calibration:
    """Calibration of a unit whose errors are drawn with one sigma."""
    vector = np.random.default_rng(1).normal(0.0, sigma, N_PARAMETERS)
    U = rotation_matrix(np.array([0.1, -0.2, 0.15]))
    return Calibration("", "converged", "", SensorErrors(vector), np.eye(N_PARAMETERS) * 1e-8, U=U)


def correction(rounds: int) -> Iterator[Row]:
    """Arrays of readings, over one (n, 3) @ (3, 3) product, in slow motion and with random signs; single samples."""
    n, rng = 1_000_000, np.random.default_rng(2)
    rate = 0.3 * np.sin(2.0 * np.pi * np.arange(n)[:, None] / 200.0 / (200.0, 400.0, 600.0))
    slow = rate, np.column_stack([rate[:, 0], rate[:, 1], np.full(n, -9.80665)])
    signs = rng.normal(size=(n, 3)), 9.80665 * rng.normal(size=(n, 3))
    for what, readings, sigma in (("slow motion, 1 %", slow, 0.01), ("random signs, 15 %", signs, 0.15)):
        unit = calibration(sigma)
        out, matrix = tuple(map(np.empty_like, readings)), gyro_triad(unit.errors).matrix
        product, _ = beside_load(partial(cpu_time, partial(np.matmul, readings[0], matrix, out=out[0])), rounds)
        for frame in ("mars", "table"):
            call = partial(Applier(unit, frame=frame).apply, *readings, out=out)
            seconds, load_s = beside_load(partial(cpu_time, call), rounds)
            name = f"correction of {n:,} samples, {what}, {frame} axes, over one product: {seconds / n * 1e9:.0f} ns"
            yield Row(name, seconds, load_s, product)
    applier, count, sample = Applier(calibration()), 20_000, ([0.1, -0.2, 0.3], [1.0, 2.0, -9.0])
    seconds, load_s = beside_load(
        lambda: cpu_time(lambda: [applier.apply_sample(*sample) for _ in range(count)]), rounds
    )
    yield Row(f"correction of one sample at a time, {count:,}: {seconds / count * 1e6:.2f} µs", seconds, load_s)


def an_hour() -> Recording:
    """Table 1 six times at 1 kHz, with the moves between the sequences, without labels."""
    scenario = sims.load_scenario("navigation-rlg")
    schedule = scenario.schedule.model_copy(update={"repeats": 6, "dwell_s": 10.8})
    recording = scenario.recording.model_copy(update={"sample_rate_hz": 1000.0})
    return sims.simulate(scenario.model_copy(update={"schedule": schedule, "recording": recording})).recording


def inspection(rounds: int) -> Iterator[Row]:
    """Inspection of a long log without reading it, over one sum of its columns, and its memory."""
    recording = an_hour()
    read_s = cpu_time(lambda: (recording.gyro.sum(axis=0), recording.accel.sum(axis=0)))
    found = inspect(replace(recording))
    what = f"{len(recording.time):,} samples"
    for name, call in {
        "inspection with recognition": inspect,
        "recognition alone": recognise,
        "diagnosis alone": partial(diagnose, calibrating=False),
        "figure of the inspection": lambda fresh: inspection_figure(fresh, found),
    }.items():
        seconds, load_s = beside_load(lambda call=call: cpu_time(lambda: call(replace(recording))), min(rounds, 3))
        yield Row(f"{name}, {what}", seconds, load_s, read_s)
    load_s = cpu_time(numpy_load)
    seconds, memory = traced(lambda: inspect(replace(recording)))
    yield Row(f"the same traced: memory {1.0 + memory / nbytes(recording):.2f} of the samples", seconds, load_s, read_s)


def nbytes(recording: Recording) -> int:
    """Bytes of the samples."""
    return sum(a.nbytes for a in (recording.time, recording.gyro, recording.accel))


def traced(call: Callable[[], object]) -> tuple[float, int]:
    """CPU time of a call while its memory is traced, which takes time, and its peak of bytes."""
    tracemalloc.start()
    seconds = cpu_time(call)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return seconds, peak


def units_as_arrays(_rounds: int, count: int = 1024, batches: tuple[int, ...] = (1, 7, 32, 256)) -> Iterator[Row]:
    """Closed form of many units of one motion (windows of 2 s, 3 rad/s, 50 Hz), by the size of the batch.

    Units of ±50 % and 0.3 rad; those that are no IMU or have no initial estimate are drawn again. Simulation,
    preparation and initial estimates are not timed.
    """
    rng, sizes = np.random.default_rng(20261125), np.zeros(N_PARAMETERS)
    for group, size in LARGEST_ERRORS.items():
        sizes[GROUP_SLICES[group]] = size
    imu = ImuModel(gyro_noise=0.1 * DEG_PER_SQRT_H, accel_noise=50.0 * MICRO_G)
    motion = table1_motion(
        site=Site(9.80665, 5e-6, 0.8), stated_fixture=Fixture(0.3, 1e-3, 1e-3), heading_rad=0.3,
        sample_rate_hz=50.0, rate_rad_s=3.0, dwell_s=2.0,
    )  # fmt: skip
    data, starts = [], []
    while len(data) < count:
        errors = SensorErrors(rng.uniform(-1.0, 1.0, N_PARAMETERS) * sizes)
        if outside_model(errors) is not None:
            continue
        recording = read_out(motion, errors, imu, rng)
        try:
            unit = prepare_checked(recording, recording.sequences, "linear")
            starts.append(initial_estimate(unit, Options()))
        except srt.SrtError:
            continue
        data.append(unit)
    formulas = SelectedFormulas(data[0], Options())
    vectors, U = np.stack([errors.vector for errors, _ in starts]), np.stack([U for _, U in starts])
    single, base = [], 0.0
    for batch in batches:
        found: list = []
        load_s, began = cpu_time(numpy_load), time.process_time()
        with many_recordings(count):
            for own in (slice(a, a + batch) for a in range(0, count, batch)):
                found += iterate_units(together(data[own]), Options(), formulas, vectors[own], U[own])
        took = time.process_time() - began
        single, base = single or found, base or took
        off = max(
            float(np.abs((x.errors.vector - y.errors.vector) / np.sqrt(np.diag(sum(y.covariance.values())))).max())
            for x, y in zip(found, single, strict=True)
            if y.status == "converged"
        )
        converged = sum(x.status == "converged" for x in found)
        yield Row(
            f"closed form of {count} units, batch {batch}: {count / took:.0f} a second, ratio {base / took:.2f}, "
            f"{converged} converged, {off:.1e} sigma from single runs", took, load_s,
        )  # fmt: skip


def fleet(units: int) -> Iterator[tuple[str, Callable[[], object]]]:
    """Steps of a fleet from the calibrations on: outlier test and tables."""
    recording, _ = accuracy_trials.noisy_recording(1, "navigation", sample_rate_hz=50.0)
    found = replace(
        srt.calibrate(recording, "closed-form", checks=False), corrections=(), contributions={}, residuals=(),
        noise=NoiseFigures(), diagnostics=Diagnostics(), provenance=Provenance(),
    )  # fmt: skip
    rng, made = np.random.default_rng(0), []
    for number in range(units):
        errors = SensorErrors(found.errors.vector + found.sigma * rng.standard_normal(27))
        one = replace(found, errors=errors, covariance=found.covariance.copy())
        made.append(FleetUnit(f"unit {number}", f"folder {number}", str(number), one.status, one.message, 0, one))
    done: list = []
    yield f"outlier test of {units:,} units", lambda: done.append(assemble_fleet(made))
    with tempfile.TemporaryDirectory() as folder:
        yield "fleet.csv", lambda: done[0].save_csv(Path(folder, "fleet.csv"))
        yield "fleet.json", lambda: done[0].save_json(Path(folder, "fleet.json"))
    yield "text of the fleet", lambda: fleet_text(done[0])


def campaign(rows: int) -> Iterator[tuple[str, Callable[[], object]]]:
    """Steps of the results of a campaign: parts on disk to one sorted table, and its summary."""
    settings, rng = replace(robustness.full(), trials=rows), np.random.default_rng(0)
    texts = {"estimator": "closed-form", "outcome": "converged", "status": "converged"}
    texts |= {name: values[0] for name, values in settings.grid.items()}

    def column(field: pa.Field, first: int) -> pa.Array:
        if field.name == "replicate":
            values = first + rng.permutation(PART)
        elif field.name in texts or pa.types.is_string(field.type):
            values = [texts.get(field.name, "Converged after 4 iterations.")] * PART
        elif pa.types.is_list(field.type):
            values = [[]] * PART
        else:
            values = np.zeros(PART) if field.name == "point" else np.abs(rng.standard_normal(PART))
        return pa.array(values).cast(field.type, safe=False)

    with tempfile.TemporaryDirectory() as folder:
        with ResultFolder(Path(folder), settings) as store:
            for number, first in enumerate(range(0, rows, PART)):
                table = pa.Table.from_arrays([column(field, first) for field in store.schema], schema=store.schema)
                parquet.write_table(table, Path(folder, "parts", f"part-{number + 1:06d}.parquet"))
        found: list = []
        with ResultFolder(Path(folder), settings) as store:
            yield f"one sorted table of {rows:,} trials", lambda: found.append(store.finish())
        yield "its summary", lambda: summarise(found[0], header_of(settings, "sizes"))


def sizes(_rounds: int, units: int = 10_000, rows: int = 1_000_000) -> Iterator[Row]:
    """Large results; the values are drawn, because only their number matters."""
    for steps in (fleet(units), campaign(rows)):
        for name, step in steps:
            load_s, seconds = cpu_time(numpy_load), cpu_time(step)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            yield Row(f"{name}; memory of the process so far {peak:.0f} MiB", seconds, load_s)
