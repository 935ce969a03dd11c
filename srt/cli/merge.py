"""``srt calibrate --merge``: one calibration from several recordings of a unit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from srt.cli.calibration_jobs import draw
from srt.cli.messages import announce, is_seen, say, show, warn
from srt.exceptions import DataError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from srt.cli.calibration_jobs import Display, Job
    from srt.estimation.options import Options
    from srt.result.calibration import Calibration


_DIFFERENT_UNITS: Final = 10.0
"""RMS over the 27 parameters of difference over sigma, above which the recordings are assumed to be of different units.

A single bias of one unit may differ by more between recordings; the RMS over all parameters does not."""


def run_merging(
    jobs: Sequence[Job], estimator: str, options: Options, display: Display, output: Path | None, plot: Path | None
) -> int:
    """Calibrate every recording, merge the results, write and print the merged one.

    Parameters
    ----------
    jobs : sequence of Job
        Recordings, or calibrations (.json) of recordings.

    Returns
    -------
    int
        Exit code 0; 1 if the recordings seem to be of different units. Recordings that are left out become warnings.

    Raises
    ------
    SrtError
        An input that cannot be read, recordings of different units, or none that can be merged.
    """
    from srt.comparison.merge import merge_calibrations
    from srt.reports.text.calibration import held_summary
    from srt.reports.text.repeatability import repeatability_text
    from srt.result.verdict import DOUBTFUL, PARTIAL

    found: dict[str, Calibration] = {}
    for job in jobs:
        try:
            found[job.name] = _calibration(job, estimator, options, display)
        except DataError as error:
            warn(f"{job.recording} is left out: {error}")
    if not found:
        raise DataError("None of the recordings can be calibrated, and there is nothing to merge.")
    if len(found) == 1:
        (name,) = found
        raise DataError(f"Only {name} can be calibrated, and there is nothing to merge it with.")
    merged = merge_calibrations(list(found.values()), list(found))
    repeated = merged.diagnostics.repeatability
    assert repeated is not None
    for row in repeated.left_out:
        warn(f"{row.name} is {row.status.replace('_', ' ')}, and was left out: {found[row.name].message}")
    if output is not None:
        merged.save(output)
    if not display.quiet:
        show(display.text(merged, str(output) if output is not None else ", ".join(found)))
        show(f"\n{repeatability_text(merged)}")
    draw(merged, plot, "merged", display.truth)
    announce(output, plot, quiet=display.quiet)
    if output is None and plot is None and not display.quiet:
        show("\nNothing was written: -o FILE.json keeps the result.")
    seen = is_seen(quiet=display.quiet)
    if merged.judgement.word == DOUBTFUL and not seen:
        warn(str(merged.judgement))
    if merged.fixed and not seen:
        partial = "the verdict is partial; " * (merged.judgement.word == PARTIAL)
        warn(f"{partial}fixed, not observed: {held_summary(merged)}.")
    ratio = math.sqrt(repeated.chi_square / max(repeated.degrees_of_freedom, 1))
    if ratio > _DIFFERENT_UNITS and not display.force:
        say(
            f"The recordings differ by {ratio:.3g} times their sigmas (RMS over all parameters): are they of one unit? "
            "Merge recordings of one unit only, or add --force."
        )
        return DataError.exit_code
    return 0


def _calibration(job: Job, estimator: str, options: Options, display: Display) -> Calibration:
    """Load a calibration, or calibrate the recording."""
    import srt
    from srt.cli.progress import iteration_progress

    if job.recording.suffix == ".json":
        return srt.load_calibration(job.recording, trust=display.trust)
    recording = display.load(job)
    with iteration_progress(job.name, quiet=display.quiet) as progress:
        calibration = srt.calibrate(recording, estimator, options=options, progress=progress, force=display.force)
    for title, reason in calibration.provenance.voided.items():
        warn(f"{job.recording}: {title} is void ({reason}).")
    return calibration
