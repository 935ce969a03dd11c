"""Run of a campaign, from the start or resumed after an interruption."""

from __future__ import annotations

from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final

from sims.robustness.result_folder import ResultFolder
from sims.robustness.trial import TOGETHER, run_batch
from srt.comparison.parallel import Engine

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from os import PathLike

    import pyarrow as pa

    from sims.robustness.campaign import Campaign

    Progress = Callable[[int, int], None]

LARGEST_BATCH: Final = 32
"""Largest number of trials of a batch: their recordings are in memory together."""
OWN_MOTIONS: Final = 16
"""The same for trials with a motion each, which is in memory, too."""
_SHARES: Final = 16
"""Least number of batches of a campaign, so that the workers finish together and an interruption costs little."""


def run_campaign(
    campaign: Campaign,
    folder: str | PathLike[str],
    *,
    engine: Engine | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
) -> pa.Table:
    """Run the trials of a campaign that are not yet in a folder.

    Parameters
    ----------
    campaign : Campaign
    folder : path-like
        Folder of the results; created if absent.
    engine : Engine, optional
        Default: this process alone. The numbers do not depend on it.
    fresh : bool
        Delete earlier results in the folder.
    progress : callable, optional
        Called with the numbers of finished and of all trials, for the first time before the first trial.

    Returns
    -------
    pyarrow.Table
        One row for each trial and estimator, sorted; also in ``results.parquet`` in the folder.

    Raises
    ------
    InputError
        If the folder has results of another campaign or is not writable, or the scheduler does not answer.
    DataError
        If a worker process died; finished trials are kept.
    """
    with ResultFolder(Path(folder), campaign, fresh=fresh) as store:
        # The folder may also contain trials of an earlier, longer run of the same campaign.
        finished = sum(number < campaign.trials for _, number in store.done)
        if progress is not None:
            progress(finished, campaign.size)
        left = (task for task in campaign.tasks if task not in store.done)
        batches = batched(left, batch_size(campaign))
        for trials in (engine or Engine()).run(partial(run_batch, campaign), batches):
            for rows in trials:
                store.add(rows)
            finished += len(trials)
            if progress is not None:
                progress(finished, campaign.size)
        return store.finish()


def batch_size(campaign: Campaign) -> int:
    """Number of trials that a worker takes at a time.

    More than one where all estimators calibrate units as arrays.
    """
    if not all(choice.name in TOGETHER for choice in campaign.estimators):
        return 1
    largest = OWN_MOTIONS if campaign.trials_per_motion == 1 else LARGEST_BATCH
    return min(largest, max(1, campaign.size // _SHARES))


def batched(tasks: Iterable[tuple[int, int]], size: int) -> Iterator[tuple[tuple[int, int], ...]]:
    """Tasks in batches, in their order."""
    left = iter(tasks)
    while batch := tuple(islice(left, size)):
        yield batch
