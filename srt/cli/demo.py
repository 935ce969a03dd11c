"""``srt demo``: simulation and calibration of a unit, and comparison with the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from srt.cli.calibrate import report_problems, run_job
from srt.cli.calibration_jobs import Display, Job
from srt.cli.messages import is_seen, show
from srt.cli.output_paths import check_directory, check_recording_target, make_directory, picture_in
from srt.cli.overwriting import TOML, check_replaceable, is_unchanged, overwrite_allowed, overwrite_option
from srt.cli.path_type import PATH
from srt.cli.simulate import run_scenario, summary, write_simulation

if TYPE_CHECKING:
    from pathlib import Path

SCENARIO = "demo"


@click.command()
@click.option(
    "-o", "--output", default="demo-output", show_default=True, type=PATH, help="Folder for recording, result and plot."
)
@click.option("--seed", type=click.IntRange(min=0), help="Seed of unit, fixture and noise.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="The last sentence only.")
def demo(output: Path, seed: int | None, quiet: bool) -> int:
    """Run the whole chain on a simulated unit: a navigation-grade IMU on a fixture of 1 mrad.

    The recording is written, read again and calibrated as by 'srt calibrate', and the result is compared with the
    truth of the simulator.
    """
    import sims
    from srt.cli.truth import NAME, load_truth
    from srt.estimation.options import Options

    folder = output / "recording"
    check_directory(output)
    # A recording with a truth beside it was simulated, and can be replaced while its recording.toml is unchanged.
    simulated = (folder / NAME).is_file() and bool(is_unchanged(folder / TOML))
    check_recording_target(folder, overwrite=overwrite_allowed() or simulated)
    check_replaceable(output / "calibration.json", output / "calibration.png")
    plot = picture_in(output)
    make_directory(output)
    scenario = sims.load_scenario(SCENARIO)
    simulation = run_scenario(scenario, seed)
    samples_format = scenario.recording.format
    write_simulation(simulation, folder, samples_format=samples_format, overwrite=True)
    if not quiet:
        show(f"{summary(simulation, folder, samples_format)}\n")
    truth = load_truth(folder / NAME)
    job = Job(folder, SCENARIO, output / "calibration.json", plot)
    calibration = run_job(job, "auto", Options(), Display(truth, quiet=quiet))
    if not quiet:
        show()
    from srt.reports.text.calibration_summary import largest_error_text

    show(largest_error_text(calibration, truth))
    code = report_problems(job, calibration, seen=is_seen(quiet=quiet))
    if plot is not None and not quiet:
        show(f"\nThe picture, with how to read it: {plot}")
    return code
