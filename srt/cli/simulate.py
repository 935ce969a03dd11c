"""``srt simulate``: a recording from a scenario, with its truth."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import click

from srt.cli.grouped_command import RenamedOption
from srt.cli.messages import show
from srt.cli.names import Name
from srt.cli.output_paths import SAMPLES_FORMATS, check_recording_target
from srt.cli.overwriting import overwrite_option
from srt.cli.path_type import PATH

if TYPE_CHECKING:
    from pathlib import Path

    from sims import Scenario, Simulation


@click.command()
@click.argument("scenario", metavar="SCENARIO", type=Name("scenarios", file=True))
@click.option("-o", "--output", required=True, type=PATH, help="Folder to write.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed; default: that of the scenario, or 1.")
@click.option(
    "--samples-format",
    cls=RenamedOption,
    earlier=("--format",),
    type=click.Choice(SAMPLES_FORMATS),
    help="Default: as in SCENARIO.",
)
@overwrite_option(folder=True)
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
def simulate(
    scenario: str, output: Path, seed: int | None, samples_format: str | None, overwrite: bool, quiet: bool
) -> int:
    """Simulate SCENARIO: a TOML file, or the name of a shipped one such as 'demo'.

    The folder then holds the recording (recording.toml and samples) and truth.json, the true sensor errors:
    'srt calibrate DIR --truth DIR/truth.json' shows the errors of a calibration.
    """
    import sims

    chosen = sims.load_scenario(scenario)
    check_recording_target(output, overwrite=overwrite)
    simulation = run_scenario(chosen, seed)
    samples_format = samples_format or chosen.recording.format
    write_simulation(simulation, output, samples_format=samples_format, overwrite=overwrite)
    if not quiet:
        show(summary(simulation, output, samples_format))
    return 0


def run_scenario(scenario: Scenario, seed: int | None) -> Simulation:
    """Simulate a scenario, with another seed if one is given."""
    import sims

    if seed is not None:
        scenario = scenario.model_copy(update={"seed": seed})
    simulation: Simulation = sims.simulate(scenario)
    return simulation


def write_simulation(simulation: Simulation, folder: Path, *, samples_format: str, overwrite: bool) -> None:
    """Write recording and truth.

    Raises
    ------
    InputError
        If they cannot be written.
    """
    import srt
    from srt.cli.truth import NAME, write_truth

    srt.write_recording(simulation.recording, folder, samples_format=samples_format, overwrite=overwrite)
    try:
        write_truth(simulation.truth_dict(), folder / NAME)
    except BaseException:
        # An old truth must not stay beside new samples.
        with suppress(OSError):
            (folder / NAME).unlink(missing_ok=True)
        raise


def summary(simulation: Simulation, folder: Path, samples_format: str) -> str:
    """Text of a simulation: description, samples, sequences, files."""
    from srt.reports.tables import wrap

    recording, scenario = simulation.recording, simulation.scenario
    interval = recording.nominal_interval_s
    if recording.sequences:
        ids = " ".join(label.id or "-" for label in recording.sequences)
        sequences = f"{len(recording.sequences)} sequences: {ids}"
    else:
        sequences = f"{len(simulation.windows)} turns, not labelled"
    seconds = recording.time.size * interval
    lines = [
        scenario.description or "A simulated recording",
        f"{recording.time.size} samples ({recording.kind}) at {1.0 / interval:g} Hz, {seconds:.1f} s",
        sequences,
        f"seed {scenario.seed}",
        f"Written to {folder}: recording.toml, samples.{samples_format}, truth.json",
    ]
    return "\n".join(line for text in lines for line in wrap(text))
