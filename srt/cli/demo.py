"""``srt demo``: simulate a unit, calibrate it as ``srt calibrate`` does, and compare with the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from srt.cli.calibrate import judge, run_job
from srt.cli.jobs import Display, Job
from srt.cli.output import check_directory, make_directory, require_matplotlib, warn
from srt.cli.simulate import check_target, run_scenario, summary, write_simulation
from srt.exceptions import MissingExtraError

if TYPE_CHECKING:
    from srt.result.calibration import Calibration
    from srt.sensor_errors import SensorErrors

SCENARIO = "demo"
PROBABILITY = 0.95


@click.command()
@click.option(
    "-o",
    "--output",
    default="demo-output",
    show_default=True,
    type=click.Path(path_type=Path),
    help="Folder for recording, result and plot.",
)
@click.option("--seed", type=click.IntRange(min=0), help="Of another unit, fixture and noise; default: the scenario's.")
@click.option("-q", "--quiet", is_flag=True, help="The last sentence only.")
def demo(output: Path, seed: int | None, quiet: bool) -> int:
    """Run the whole chain on a simulated unit: a navigation-grade IMU on a fixture of 1 mrad.

    The recording is written, read again and calibrated as 'srt calibrate' does it, and the result is set
    beside the truth that the simulator knows.
    """
    import sims
    from srt.cli.truth import NAME, load_truth
    from srt.estimation.options import Options

    folder = output / "recording"
    check_directory(output)
    # A recording that lies beside its truth was simulated, and can be replaced; no other will be.
    check_target(folder, overwrite=(folder / NAME).is_file())
    plot: Path | None = output / "calibration.png"
    try:
        require_matplotlib()
    except MissingExtraError as error:
        plot = None
        warn(f"No plot will be made: {error}")
    make_directory(output)
    scenario = sims.load_scenario(SCENARIO)
    simulation = run_scenario(scenario, seed)
    samples_format = scenario.recording.format
    write_simulation(simulation, folder, samples_format=samples_format, overwrite=True)
    if not quiet:
        click.echo(f"{summary(simulation, folder, samples_format)}\n")
    truth = load_truth(folder / NAME)
    job = Job(folder, SCENARIO, output / "calibration.json", plot)
    calibration = run_job(job, "auto", Options(), Display(truth, quiet=quiet))
    if not quiet:
        click.echo()
    click.echo(verdict(calibration, truth))
    return judge(job, calibration)


def verdict(calibration: Calibration, truth: SensorErrors) -> str:
    """Set the largest error beside what chance alone explains.

    Parameters
    ----------
    calibration : Calibration
    truth : SensorErrors

    Returns
    -------
    str
        Sentences, wrapped.

    Notes
    -----
    The bound x solves (2Φ(x) − 1)^n = 0.95. That is exact for n independent normal errors; for correlated
    ones the probability of staying below it is at least as large (Šidák's inequality).
    """
    import numpy as np
    from scipy.stats import norm

    from srt.reports.text.calibration import wrap
    from srt.sensor_errors import NAMES

    seen = np.flatnonzero(calibration.observed)
    ratio = np.abs(calibration.errors.vector - truth.vector)[seen] / calibration.sigma[seen]
    n, worst = len(seen), int(np.argmax(ratio))
    bound = float(norm.ppf(0.5 + 0.5 * PROBABILITY ** (1.0 / n)))
    if ratio[worst] <= bound:
        judgement = "is as expected"
    else:
        judgement = "is not as expected: chance alone explains it in 1 of 20 at most"
    return "\n".join(
        wrap(
            f"The largest error is {ratio[worst]:.2f} sigma ({NAMES[seen[worst]]}); the largest of {n} "
            f"normal draws stays below {bound:.2f} sigma in {PROBABILITY:.0%} of all runs or more, "
            f"so this run {judgement}."
        )
    )
