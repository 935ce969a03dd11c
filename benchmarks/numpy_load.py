"""Fixed numpy load beside what is timed: the ratio of the two moves less with the machine and its other work."""

import time
from collections.abc import Callable

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
