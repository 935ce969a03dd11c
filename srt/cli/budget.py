"""``srt budget``: predicted accuracy of a scenario, by source of error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from srt.cli.calibrate import choice_option
from srt.cli.messages import announce, figure_title, show
from srt.cli.names import Name
from srt.cli.output_paths import PLOT_SUFFIXES, RESULT_SUFFIXES, check_file, check_place, require_matplotlib
from srt.cli.overwriting import check_replaceable, overwrite_option
from srt.cli.path_type import PATH
from srt.cli.progress import count_progress
from srt.exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sims.scenarios.scenario import Scenario
    from srt.estimation.options import GyroBias


@click.command()
@click.argument("scenario", metavar="SCENARIO", type=Name("scenarios", file=True))
@click.option(
    "--estimator",
    "estimators",
    type=Name("estimators"),
    multiple=True,
    metavar="NAME",
    help="Repeatable. Default: closed-form and least-squares.",
)
@click.option("--paper", is_flag=True, help="Analysis of Savage 2020, §9, with the noise of the scenario.")
@click.option("--draws", type=click.IntRange(min=2), default=30, show_default=True, help="Draws of the fixture errors.")
@choice_option("--gyro-bias", "Model of the gyro bias, as in calibrate.")
@click.option("-o", "--output", type=PATH, help="Result: FILE.json.")
@click.option(
    "--plot", type=PATH, help="Figure: FILE.png, .pdf or .svg; one for each estimator, as FILE-least-squares.png."
)
@click.option("--details", is_flag=True, help="Show all parameters, and the errors that are not in the sum.")
@overwrite_option()
@click.option("-q", "--quiet", is_flag=True, help="No progress and no tables; warnings and errors only.")
def budget(
    scenario: str,
    estimators: tuple[str, ...],
    paper: bool,
    draws: int,
    gyro_bias: GyroBias,
    output: Path | None,
    plot: Path | None,
    details: bool,
    quiet: bool,
) -> int:
    """Predict the accuracy of SCENARIO: a TOML file, or the name of a shipped one such as 'demo'.

    It prints the 1-sigma error by source, for the worst parameter of each group or (--details) for all: noise,
    quantization and bias instability of gyros and accelerometers, Earth rate times alignment, gravity, g-sensitivity,
    fixture. --paper prints the paper's own analysis for the same noise.

    Exit codes: 0 success; 1 a recording of the scenario cannot be calibrated; 2 wrong usage or unreadable input.
    """
    import sims

    check_file(output, RESULT_SUFFIXES, "The budget")
    if plot is not None and paper:
        raise InputError("--paper makes a table, and no plot: leave one of the two options out.")
    names = estimators or ("closed-form", "least-squares")
    figures = {} if plot is None else figure_paths(plot, names)
    chosen = sims.load_scenario(scenario)
    if paper:
        return paper_mode(chosen, output, quiet=quiet)
    from sims.accuracy.budget import budget as predict
    from srt.result.json_file import save_json_file

    with count_progress("budget", quiet=quiet, lines=False) as progress:
        found = predict(chosen, names, draws=draws, gyro_bias=gyro_bias, progress=progress)
    if output is not None:
        document = {"scenario": chosen.model_dump(mode="json"), "budgets": [b.as_dict() for b in found]}
        save_json_file(output, document)
    if figures:
        from sims.accuracy.budget_figure import budget_figure
        from srt.reports.figures.style import save_figure

        for b in found:
            drawn = budget_figure(b, title=figure_title(f"{scenario}: error budget of {b.estimator}"))
            save_figure(drawn, figures[b.estimator])
    if not quiet:
        from sims.accuracy.budget import NOT_COUNTED
        from srt.reports.text.error_budget import budget_text

        texts = [
            budget_text(b.estimator, b.sources, b.total, b.not_counted, NOT_COUNTED, details=details) for b in found
        ]
        show("\n\n".join(texts))
        if not details:
            show("\n--details shows all parameters, and the errors that are not in the sum.")
    announce(output, *figures.values(), quiet=quiet)
    return 0


def figure_paths(plot: Path, estimators: Sequence[str]) -> dict[str, Path]:
    """Paths of the figures by estimator, after the check that they can be written. Raises SrtError."""
    check_place(plot, PLOT_SUFFIXES, "The plot")
    require_matplotlib()
    one = len(estimators) == 1
    paths = {name: plot if one else plot.with_name(f"{plot.stem}-{name}{plot.suffix}") for name in estimators}
    check_replaceable(*paths.values())
    return paths


def paper_mode(scenario: Scenario, output: Path | None, *, quiet: bool) -> int:
    """Print the analysis of the paper for the noise, bias and fixture of a scenario."""
    from srt.noise.accuracy_analysis import QUANTITIES, paper_budget
    from srt.result.json_file import save_json_file

    setting = paper_setting(scenario)
    found = paper_budget(setting)
    if output is not None:
        rows = [
            {"quantity": q.symbol, "sequence": q.sequence, "component": q.component, "H_over_g": q.sensitivity}
            | {name: float(values[k]) for name, values in found.items()}
            for k, q in enumerate(QUANTITIES)
        ]
        save_json_file(output, {"format": "srt-paper-budget", "version": 1, "quantities": rows})
    if not quiet:
        from srt.reports.text.error_budget import paper_budget_text

        show(paper_budget_text(setting, found))
    announce(output, quiet=quiet)
    return 0


def paper_setting(scenario: Scenario) -> Any:
    """Inputs of the paper's analysis from a scenario; the times are those of the paper."""
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
