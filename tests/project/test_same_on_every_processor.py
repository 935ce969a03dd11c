"""The same words, sequences and values, whichever kernels the processor selects and whatever the last bit of inputs."""

import json
import os
import subprocess
import sys
from functools import cache

import numpy as np
import process_results
import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

KERNELS = ("Haswell", "SkylakeX", "Nehalem")
SIMD = " ".join(name for name in __cpu_dispatch__ if __cpu_features__[name])
"""Instruction sets that numpy chooses between on this processor."""
reference = cache(process_results.results)


def results(name, *seed, **environment):
    """Results of a process with an environment; the test is skipped if the processor has no such kernels."""
    inherited = {key: value for key, value in os.environ.items() if not key.startswith(("OPENBLAS_", "NPY_"))}
    own = {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)} | environment
    run = subprocess.run(
        [sys.executable, process_results.__file__, name, *map(str, seed)],
        env=inherited | own, capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = json.loads(run.stdout)
    kernel = environment.get("OPENBLAS_CORETYPE")
    if kernel is not None and set(found["kernels"]) != {kernel}:
        pytest.skip(f"OpenBLAS has no kernels of {kernel} here: {', '.join(found['kernels']) or 'another library'}")
    return found["words"], found["values"]


def assert_same(name, found):
    words, values = reference(name)
    assert found[0] == words
    np.testing.assert_allclose(found[1], values, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["short plan"])
def test_old_kernels_and_other_last_bits_at_once(name):
    assert_same(name, results(name, 1, OPENBLAS_CORETYPE="Nehalem", NPY_DISABLE_CPU_FEATURES=SIMD))


@pytest.mark.campaign
@pytest.mark.parametrize("name", process_results.SUBJECTS)
@pytest.mark.parametrize("kernel", KERNELS)
def test_kernels_of_the_linear_algebra(kernel, name):
    assert_same(name, results(name, OPENBLAS_CORETYPE=kernel))


@pytest.mark.campaign
@pytest.mark.parametrize("name", process_results.SUBJECTS)
def test_instruction_sets_of_numpy(name):
    assert_same(name, results(name, NPY_DISABLE_CPU_FEATURES=SIMD))


@pytest.mark.campaign
@pytest.mark.parametrize("name", process_results.SUBJECTS)
def test_last_bits_of_the_inputs(name):
    assert_same(name, process_results.results(name, 2))
