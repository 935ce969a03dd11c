"""Many independent tasks on the processes of one machine (joblib) or of many (Dask): the same code, the same numbers.

A task is a picklable value, and what is done with it a function at the top of a module; everything random in it comes
from the value. Every worker keeps to one thread of linear algebra: the last digits of a matrix product depend on how
many share it, and threads of neighbours only wait for one another.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Final, TypeVar

from srt.exceptions import DataError, InputError, optional

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    T = TypeVar("T")
    R = TypeVar("R")

_AHEAD: Final = 4
"""Number of tasks submitted ahead for each worker: no worker waits, and the memory stays constant."""
_MOST_PER_CORE: Final = 16
"""Largest number of processes for each core: more only use up memory, and starting them alone takes minutes."""
_PARENT_S: Final = 1.0
"""Time between two looks of a worker for the process that started it, s."""
_CONNECT_S: Final = 2.0
"""Time allowed for the connection to a Dask scheduler, s: one that runs answers in tenths of a second."""


@dataclass(frozen=True, slots=True)
class Engine:
    """Processes that run tasks.

    Attributes
    ----------
    workers : int
        Processes on this machine; 1 runs in this one, 0 stands for one on each core.
    scheduler : str, optional
        Address of a Dask scheduler, as ``tcp://host:8786``; its workers are used instead.

    Raises
    ------
    InputError
        Fewer workers than none, or many more than cores.
    """

    workers: int = 1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise InputError(f"The number of workers is {self.workers}; give 1 or more, or 0 for one on each core.")
        most = _MOST_PER_CORE * (os.cpu_count() or 1)
        if self.scheduler is None and self.workers > most:
            raise InputError(
                f"The number of workers is {self.workers}, but this machine has {os.cpu_count() or 1} cores: give at "
                f"most {most}, or 0 for one on each core."
            )

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Results as they come, in no particular order.

        Parameters
        ----------
        function : callable
            Function of a module, as other processes import it. What it raises ends the run.
        tasks : iterable
            Taken as they are needed, so that any number of them takes no memory.

        Yields
        ------
        object
            Return value of the function for a task.

        Raises
        ------
        DataError
            A worker that died.
        InputError
            A scheduler that does not answer.
        MissingExtraError
            Without joblib, or Dask, or threadpoolctl.
        """
        call = partial(single_threaded, function)
        if self.scheduler is not None:
            return _on_cluster(call, tasks, self.scheduler)
        workers = self.workers or os.cpu_count() or 1
        return (call(task) for task in tasks) if workers == 1 else _on_this_machine(call, tasks, workers)


def _of_parent(parent: int, call: Callable[[T], R], task: T) -> R:
    """Call a function in a worker that ends when its parent has ended."""
    _end_with(parent)
    return call(task)


@cache
def _end_with(parent: int) -> None:
    """Start a thread that ends this process once its parent has ended, as by SIGKILL, which no handler sees.

    Where the system does not give orphans another parent (Windows), idle workers end by themselves after minutes.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_PARENT_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def single_threaded(function: Callable[[T], R], task: T) -> R:
    """Call a function while linear algebra keeps to one thread."""
    with one_thread("campaign"):
        return function(task)


@contextmanager
def one_thread(extra: str) -> Iterator[None]:
    """Keep linear algebra to one thread: on matrices as small as here, threads would mostly wait for one another.

    Raises
    ------
    MissingExtraError
        Without threadpoolctl, which the named extra brings.
    """
    with optional("threadpoolctl", extra, "Keeping linear algebra to one thread"):
        from threadpoolctl import threadpool_limits
    with threadpool_limits(limits=1):
        yield


@contextmanager
def _ended_managers_are_silent() -> Iterator[None]:
    """Keep a manager of worker processes that were killed on purpose from printing a traceback.

    Interrupted while it waits for a result, joblib kills the workers and drops their tasks while the manager's thread
    still hands tasks out: the thread ends with a KeyError, which nobody can act on.
    """
    before = threading.excepthook

    def hook(args: threading.ExceptHookArgs) -> None:
        if not getattr(getattr(args.thread, "executor_flags", None), "kill_workers", False):
            before(args)

    threading.excepthook = hook
    try:
        yield
    finally:
        threading.excepthook = before


def _on_this_machine(call: Callable[[Any], R], tasks: Iterable[Any], workers: int) -> Iterator[R]:
    with optional("joblib", "campaign", "Running in several processes"):
        from joblib import Parallel, delayed, parallel_config
        from joblib.externals.loky.process_executor import TerminatedWorkerError
    given_up = threading.Event()
    wanted = (task for task in tasks if not given_up.is_set())
    with _ended_managers_are_silent(), parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = Parallel(
            n_jobs=workers, return_as="generator_unordered", batch_size=1, pre_dispatch=_AHEAD * workers
        )
        results = parallel(delayed(_of_parent)(os.getpid(), call, task) for task in wanted)
        try:
            for result in results:  # noqa: UP028 - "yield from" would close it before the tasks ahead have ended
                yield result
        except TerminatedWorkerError:
            raise DataError(
                "A worker process was ended from outside or ran out of memory: what finished before is kept; "
                "run the same again to go on, with fewer workers."
            ) from None
        except GeneratorExit:
            # Closing joblib in the middle kills its workers while a thread still hands tasks to them, and warns of
            # the results not used. The few tasks ahead end by themselves, and what they raise has no reader.
            given_up.set()
            with suppress(Exception):
                deque(results, maxlen=0)
            raise


def _on_cluster(call: Callable[[Any], R], tasks: Iterable[Any], address: str) -> Iterator[R]:
    with optional("distributed", "cluster", "Running on a Dask scheduler"):
        from distributed import Client, as_completed
        from distributed.scheduler import KilledWorker
    try:
        client = Client(address, timeout=_CONNECT_S)
    except (OSError, ValueError, TimeoutError, MemoryError) as error:  # MemoryError: another service answers
        reason = str(error).splitlines()[0].rstrip(".") if str(error) else type(error).__name__
        raise InputError(
            f"No Dask scheduler answers at {address!r} ({reason}): start one with 'dask scheduler' and workers with "
            f"'dask worker ADDRESS --nthreads 1', and give its address, as tcp://host:8786."
        ) from None
    with client:
        threads = sum(client.nthreads().values())
        if threads == 0:
            raise InputError(
                f"The Dask scheduler at {address} has no workers: start them with 'dask worker {address}'."
            )
        waiting = iter(tasks)
        # Tasks that are alike are not the same: Dask would give the result of one for both.
        submit = partial(client.submit, call, pure=False)
        first = [submit(task) for _, task in zip(range(_AHEAD * threads), waiting, strict=False)]
        running = as_completed(first, with_results=True)
        try:
            for future, result in running:
                yield result
                future.release()
                for task in waiting:
                    running.add(submit(task))
                    break
        except KilledWorker:
            raise DataError(
                "Workers of the cluster died over one task, several times: what finished before is kept; look at the "
                "workers' memory, and run the same again to go on."
            ) from None
