"""Time and memory of large results: a fleet of 10,000 units, and the table of a campaign of a million rows.

``python benchmarks/sizes.py`` prints CPU time and the largest memory of each, in a process of its own; ``--units N``
and ``--rows N`` take other sizes. The values are drawn, because only their number matters.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import accuracy_trials
import numpy as np
import pyarrow as pa
import robustness
from pyarrow import parquet

import srt
from sims.robustness.result_folder import ResultFolder
from sims.robustness.summary import summarise
from srt.cli.robustness import header_of
from srt.comparison.fleet import FleetUnit, assemble_fleet
from srt.reports.text.fleet import fleet_text
from srt.result.diagnostics import Diagnostics
from srt.result.noise_figures import NoiseFigures
from srt.result.provenance import Provenance
from srt.sensor_errors import SensorErrors

PART = 1000
"""Rows of a part of the results, as a campaign writes them."""


class Clock:
    """Prints the CPU time of each step, and the peak of the memory so far."""

    def __init__(self) -> None:
        self._at = time.process_time()

    def step(self, name: str) -> None:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(f"{name}: {time.process_time() - self._at:.1f} s of CPU, memory {peak:.0f} MiB", flush=True)
        self._at = time.process_time()


def fleet(units: int) -> None:
    """Outlier test of a fleet and its tables, from the calibrations on."""
    recording, _ = accuracy_trials.noisy_recording(1, "navigation", sample_rate_hz=50.0)
    found = srt.calibrate(recording, "closed-form", checks=False)
    kept = replace(
        found,
        corrections=(),
        contributions={},
        residuals=(),
        noise=NoiseFigures(),
        diagnostics=Diagnostics(),
        provenance=Provenance(),
    )
    rng = np.random.default_rng(0)
    made = []
    for number in range(units):
        errors = SensorErrors(found.errors.vector + found.sigma * rng.standard_normal(27))
        one = replace(kept, errors=errors, covariance=found.covariance.copy())
        made.append(FleetUnit(f"unit {number}", f"folder {number}", str(number), one.status, one.message, 0, one))
    clock = Clock()
    assembled = assemble_fleet(made)
    clock.step(f"outlier test of {units:,} units")
    with tempfile.TemporaryDirectory() as folder:
        assembled.save_csv(Path(folder, "fleet.csv"))
        clock.step("fleet.csv")
        assembled.save_json(Path(folder, "fleet.json"))
        clock.step("fleet.json")
    fleet_text(assembled)
    clock.step("text")


def campaign(rows: int) -> None:
    """Results of a campaign: parts on disk to one sorted table, and its summary."""
    settings = replace(robustness.full(), trials=rows)
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        with ResultFolder(Path(folder), settings) as store:
            for number, first in enumerate(range(0, rows, PART)):
                columns = []
                for field in store.schema:
                    if field.name == "replicate":
                        values = first + rng.permutation(PART)
                    elif field.name in settings.grid:
                        values = [settings.grid[field.name][0]] * PART
                    elif field.name == "estimator":
                        values = ["closed-form"] * PART
                    elif field.name in ("outcome", "status"):
                        values = ["converged"] * PART
                    elif pa.types.is_string(field.type):
                        values = ["Converged after 4 iterations."] * PART
                    elif pa.types.is_list(field.type):
                        values = [[]] * PART
                    else:
                        values = np.zeros(PART) if field.name == "point" else np.abs(rng.standard_normal(PART))
                    columns.append(pa.array(values).cast(field.type, safe=False))
                table = pa.Table.from_arrays(columns, schema=store.schema)
                parquet.write_table(table, Path(folder, "parts", f"part-{number + 1:06d}.parquet"))
        clock = Clock()
        with ResultFolder(Path(folder), settings) as store:
            clock.step(f"resumed with {rows:,} rows")
            found = store.finish()
            clock.step("one sorted table")
        summarise(found, header_of(settings, "sizes"))
        clock.step("summary")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=10_000)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--only", choices=("fleet", "campaign"), help="in this process")
    arguments = parser.parse_args()
    if arguments.only == "fleet":
        fleet(arguments.units)
    elif arguments.only == "campaign":
        campaign(arguments.rows)
    else:
        for only in ("fleet", "campaign"):
            subprocess.run([sys.executable, __file__, "--only", only, *sys.argv[1:]], check=True)


if __name__ == "__main__":
    main()
