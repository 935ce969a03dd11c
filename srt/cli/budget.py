"""``srt budget``: the accuracy that a scenario allows, source by source, before anyone goes to the lab."""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from srt.cli.calibrate import CHOICES
from srt.cli.jobs import PLOT_SUFFIXES, RESULT_SUFFIXES
from srt.cli.output import check_file, require_matplotlib
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sims.accuracy.budget import Budget
    from sims.scenarios.scenario import Scenario
    from srt.estimation.options import GyroBias


@click.command()
@click.argument("scenario", metavar="SCENARIO")
@click.option(
    "--estimator",
    "estimators",
    multiple=True,
    metavar="NAME",
    help="Repeatable. Default: closed-form, and the optimum (graph, or least-squares where gtsam is absent).",
)
@click.option("--paper", is_flag=True, help="The analysis of Savage 2020, §9, with the scenario's figures.")
@click.option("--draws", type=click.IntRange(min=2), default=30, show_default=True, help="Of the fixture's errors.")
@click.option(
    "--gyro-bias",
    type=click.Choice(CHOICES["gyro_bias"]),
    default="auto",
    show_default=True,
    help="As in calibrate, for all calibrations.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Result: FILE.json.")
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    help="Stacked bars: FILE.png, .pdf or .svg; of several estimators one each, as FILE-graph.png.",
)
@click.option("-q", "--quiet", is_flag=True, help="No progress and no tables; warnings and errors only.")
def budget(
    scenario: str,
    estimators: tuple[str, ...],
    paper: bool,
    draws: int,
    gyro_bias: GyroBias,
    output: Path | None,
    plot: Path | None,
    quiet: bool,
) -> int:
    """Predict the accuracy of SCENARIO: a TOML file, or the name of a shipped one such as 'demo'.

    For every parameter, one sigma by source: noise, quantisation and bias instability of gyros and accelerometers,
    Earth rate times alignment, gravity, g-sensitivity, errors of the fixture. --paper gives the numbers that the
    paper's own analysis gives for the same figures.

    Exit codes: 0 done; 1 a recording of the scenario cannot be calibrated; 2 wrong usage or unreadable input.
    """
    import sims

    if output is not None:
        check_file(output, RESULT_SUFFIXES, "The budget")
    if plot is not None:
        if paper:
            raise InputError("--paper makes a table, and no plot: leave one of the two options out.")
        check_file(plot, PLOT_SUFFIXES, "The plot")
        require_matplotlib()
    chosen = sims.load_scenario(scenario)
    if paper:
        return paper_mode(chosen, output, quiet=quiet)
    from sims.accuracy.budget import budget as predict
    from srt.recording.atomic_file import atomic_write_text

    names = estimators or default_estimators(gyro_bias)
    with budget_progress(quiet=quiet) as progress:
        found = predict(chosen, names, draws=draws, gyro_bias=gyro_bias, progress=progress)
    if output is not None:
        document = {"scenario": chosen.model_dump(mode="json"), "budgets": [b.as_dict() for b in found]}
        atomic_write_text(output, json.dumps(document, indent=2, allow_nan=False) + "\n")
    if plot is not None:
        from sims.accuracy.budget_figure import budget_figure
        from srt.reports.figures.style import save_figure

        for b in found:
            file = plot if len(found) == 1 else plot.with_name(f"{plot.stem}-{b.estimator}{plot.suffix}")
            save_figure(budget_figure(b, title=f"{scenario}: what limits {b.estimator}"), file)
    if not quiet:
        click.echo("\n\n".join(tables(b) for b in found))
    return 0


def default_estimators(gyro_bias: GyroBias = "auto") -> tuple[str, ...]:
    """The closed form, and the best estimator that can run here and takes the gyro bias so."""
    from importlib.util import find_spec

    joint = find_spec("gtsam") is not None and gyro_bias != "g-sensitive"
    return ("closed-form", "graph" if joint else "least-squares")


def tables(found: Budget) -> str:
    """Sources that matter as columns, and what is told beside them."""
    import numpy as np

    from sims.accuracy.budget import NOT_COUNTED
    from srt.reports.text.calibration import sources_table, wrap

    seen = np.flatnonzero(np.isfinite(found.total)).tolist()
    text = [f"Budget of {found.estimator}: one sigma; the squares of the sources add up"]
    text.append(sources_table(found.sources, found.total, seen))
    text.append("\nNot in the sum")
    text.append(sources_table(found.not_counted, None, seen))
    for name, meaning in NOT_COUNTED.items():
        text += wrap(f"{name.replace('_', ' ')}: {meaning}", "  ")
    return "\n".join(text)


def paper_mode(scenario: Scenario, output: Path | None, *, quiet: bool) -> int:
    """The paper's analysis with the noise, bias and fixture of a scenario."""
    from srt.noise.accuracy_analysis import QUANTITIES, paper_budget
    from srt.recording.atomic_file import atomic_write_text
    from srt.reports.text.tables import fixed, text_table

    setting = paper_setting(scenario)
    found = paper_budget(setting)
    if output is not None:
        rows = [
            {"quantity": q.symbol, "sequence": q.sequence, "component": q.component, "H_over_g": q.sensitivity}
            | {name: float(values[k]) for name, values in found.items()}
            for k, q in enumerate(QUANTITIES)
        ]
        document = {"format": "srt-paper-budget", "version": 1, "quantities": rows}
        atomic_write_text(output, json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
    if not quiet:
        sources = {name: values for name, values in found.items() if values.any()}
        heads = ["", "seq.", "unit", *(name.replace("_", "\n") for name in sources)]
        cells = [
            [q.symbol, q.sequence, q.unit, *(fixed(1e6 * float(values[k]), 2) for values in sources.values())]
            for k, q in enumerate(QUANTITIES)
        ]
        click.echo(
            f"Savage 2020, §9: sequences of {setting.time_s:g} s, two windows of {setting.window_s:g} s in it, "
            f"rotations at {setting.rate_rad_s:g} rad/s"
        )
        click.echo(text_table(heads, cells, "lll" + "r" * len(sources), gap=1))
    return 0


def paper_setting(scenario: Scenario) -> Any:
    """What the paper's analysis takes of a scenario; times are the paper's own."""
    from srt.noise.accuracy_analysis import PaperSetting

    noise, errors = scenario.imu.noise.si(), scenario.imu.errors.si()
    fixture, schedule = scenario.fixture, scenario.schedule
    if fixture is None or schedule is None:
        raise InputError("The paper's analysis is of the 17 sequences: take a scenario with a [fixture].")
    factor = scenario.errors.factor
    return PaperSetting(
        gyro_noise=noise["gyro_noise"],
        gyro_quantization=noise["gyro_quantization"],
        accel_noise=noise["accel_noise"],
        accel_quantization=noise["accel_quantization"],
        gyro_bias_instability=noise["gyro_bias_instability"],
        alignment_rad=fixture.north_sigma_mrad * 1e-3,
        sensor_errors=factor * max(errors["gyro_scale"], errors["gyro_orthogonality"], errors["accel_misalignment"]),
    )


@contextmanager
def budget_progress(*, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Lend a function that takes the numbers of finished and of all calibrations; a bar on a terminal alone."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("budget", total=None)
        yield lambda done, size: bar.update(task, completed=done, total=size)
