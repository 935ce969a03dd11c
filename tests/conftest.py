"""Fixtures: symbolic derivation, derivatives through the simulator, certificates, readers of logs in a fork."""

import contextlib
import gc
import importlib.util
import os
import re
import sys
from collections import Counter
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from ideal_table_1 import STEPS, Simulated, component_rows, ideal_motion, player_of

import sims
from srt.sensor_errors import N_PARAMETERS, SensorErrors
from srt.sequences.preparation import PreparedRecording

# No test is timed: on a busy machine the first import alone can take longer than the deadline of an example.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

with contextlib.suppress(ModuleNotFoundError):
    from threadpoolctl import threadpool_limits

    # Test workers are processes already: run without the Makefile, their threads would only wait for one another.
    threadpool_limits(limits=1)

DERIVATIONS = Path(__file__).parents[1] / "docs" / "derivations"


@pytest.hookimpl(wrapper=True)
def pytest_collection(session):
    """Importing the tests makes objects that stay: the search for garbage among them took a quarter of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture
def shell(capfd):
    """Run a command line, whose exit code is known: its standard output and standard error."""
    from srt.cli import main

    def run(*words, code=0):
        assert main([str(word) for word in words]) == code, capfd.readouterr()
        return capfd.readouterr()

    return run


@pytest.fixture
def refused(shell):
    """Run a command line that says one sentence, or so many at most, and nothing else: what it says."""

    def run(*words, code=2, sentences=1):
        out, err = shell(*words, code=code)
        assert out == ""
        assert re.fullmatch(r"srt: [^\n]*[.?]\n", err), err
        # A full stop inside would be followed by a capital; figures and file names are not.
        assert len(re.findall(r"[.?!] [A-Z]", err)) < sentences, err
        return err

    return run


@pytest.fixture
def saved(tmp_path):
    """Save a calibration and read it as a certificate does."""
    from certificate_cases import saved_calibration

    return partial(saved_calibration, tmp_path)


@pytest.fixture
def plain_page(monkeypatch):
    """Pages of certificates without the pictures, which take a hundred times as long as all else."""
    from srt.reports.certificate import html_page

    monkeypatch.setattr(html_page, "certificate_figures", lambda certificate: ())
    return html_page.html_page


@pytest.fixture(scope="session")
def derivation():
    """Import docs/derivations/signatures.py, which is no part of any package."""
    spec = importlib.util.spec_from_file_location("signatures", DERIVATIONS / "signatures.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def simulated():
    """Give Simulated by window attitude, "held" or "integrated"; each is made once."""

    @cache
    def make(window_attitude: str) -> Simulated:
        def measure(vector: np.ndarray) -> tuple[PreparedRecording, np.ndarray]:
            recording = sims.read_out(ideal_motion(), SensorErrors(vector))
            data, processor = player_of(recording, window_attitude=window_attitude)
            return data, processor.process(SensorErrors()).z

        data, z = measure(np.zeros(N_PARAMETERS))
        columns = [(measure(step)[1] - measure(-step)[1]) / (2.0 * step.max()) for step in np.diag(STEPS)]
        return Simulated(data, z, np.stack(columns, axis=1), component_rows(data))

    return make


@pytest.fixture
def forked_readers(monkeypatch):
    """Readers of logs in a fork of this process: a new interpreter takes 0.3 s, and test_importers_child starts it."""
    import fuzz

    from srt.recording.importers import child_process

    if hasattr(os, "fork"):
        monkeypatch.setattr(child_process, "spawn", fuzz.Fork)


@pytest.fixture(scope="module")
def plain_layout():
    """Figures without the arrangement of their parts, half of the time of drawing: for tests that ask for the file."""
    with pytest.MonkeyPatch.context() as patch:
        with contextlib.suppress(ModuleNotFoundError):
            from matplotlib.layout_engine import ConstrainedLayoutEngine

            patch.setattr(ConstrainedLayoutEngine, "execute", lambda engine, figure: None)
        yield


@pytest.fixture(scope="module")
def blank_figures(plain_layout):
    """Figures that are made, and not drawn: for tests that only ask whether the file is there."""
    with pytest.MonkeyPatch.context() as patch:
        with contextlib.suppress(ModuleNotFoundError):
            from matplotlib.figure import Figure

            patch.setattr(Figure, "draw", lambda figure, renderer: None)
        yield


def pytest_terminal_summary(terminalreporter):
    """Count the blocks of the documentation over all pages: tests/project/test_docs_run.py gives those of a page."""
    total = Counter()
    for report in terminalreporter.getreports("passed"):
        total.update(dict(report.user_properties).get("documentation", {}) if report.when == "call" else {})
    if total:
        kinds = ", ".join(f"{total[kind]} {kind}" for kind in ("run", "parsed", "skipped"))
        terminalreporter.write_line(f"Commands and blocks of README and docs: {kinds}")


@pytest.fixture(scope="module")
def short_search():
    """Plans by an eighth of the search: for tests of what is in a plan, not of how near to the best it is."""
    from srt.planning import annealing

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(annealing, "TRIALS", annealing.TRIALS // 8)
        yield
