"""Fixed numpy load beside what is timed: the ratio of the two moves less with the machine and its other work."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


def numpy_load() -> None:
    """Fixed work: element-wise, sorting and small dense matrices, about as a calibration mixes them."""
    rng = np.random.default_rng(0)
    for _ in range(12):
        matrix = rng.standard_normal((400, 400))
        np.linalg.inv(matrix)
        np.sort(rng.standard_normal(200_000))
        np.cumsum(matrix)


def cpu_time(call: Callable[[], object]) -> float:
    """CPU time of a call, s."""
    began = time.process_time()
    call()
    return time.process_time() - began


def beside_load(measure: Callable[[], float], rounds: int) -> tuple[float, float]:
    """Medians of a time and of the numpy load, measured in turns after one run of each; s."""
    measure()
    pairs = [(cpu_time(numpy_load), measure()) for _ in range(rounds)]
    load_s, seconds = np.median(np.array(pairs), axis=0).tolist()
    return seconds, load_s


@dataclass(frozen=True)
class Row:
    """Line of the table: name, CPU time and that of the numpy load beside it, s, and what to compare it with."""

    name: str
    seconds: float
    load_s: float
    limit_s: float | None = None
    peer: str = ""

    def text(self) -> str:
        limit = "" if self.limit_s is None else f"{self.seconds / self.limit_s:.0f}"
        return f"| {self.name} | {self.seconds * 1e3:.1f} | {self.seconds / self.load_s:.3f} | {limit} | {self.peer} |"
